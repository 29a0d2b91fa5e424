"""The base class of the package's modules: shapes are checked on construction, and `repr` is short and has units."""

import dataclasses
import typing
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .validate import brief, unit_of

LONGEST = 6
"""Entries up to which an array is written out."""


def shown_number(value: Any) -> str:
    """A number, or a small array of them, with five digits; of a large one its shape and range."""
    if isinstance(value, jax.core.Tracer):
        return f"<traced {value.dtype}{list(value.shape)}>"
    if not isinstance(value, jax.Array | np.ndarray | np.generic | float):
        return brief(value)
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        return brief(value)
    if array.ndim == 0:
        return f"{array:.5g}"
    if array.size <= LONGEST:
        return str([shown_number(part) for part in array]).replace("'", "")
    return f"<{' x '.join(map(str, array.shape))}, {array.min():.5g} to {array.max():.5g}>"


def shown_module(module: eqx.Module) -> str:
    """A module on one line: its class, and its fields with their units; those that are None are left out."""
    kind, parts = type(module), []
    for field in dataclasses.fields(module):
        value, unit = getattr(module, field.name), unit_of(kind, field.name)
        if value is not None:
            parts.append(f"{field.name}={shown_number(value)}{f' {unit}' if unit else ''}")
    return f"{kind.__name__}({', '.join(parts)})"


def axes_of(kind: type, name: str, default: int) -> int:
    """The number of axes that the annotation of a module's field gives it, or `default` where it gives none."""
    field = {f.name: f for f in dataclasses.fields(kind)}[name]
    shapes = _shapes(field)
    return len(shapes[0].dim_str.split()) if shapes else default


def _shapes(field: dataclasses.Field) -> list[Any]:
    """The array types in a field's annotation."""
    return [a for a in (field.type, *typing.get_args(field.type)) if hasattr(a, "dim_str")]


class ShapeChecked(eqx.Module):
    """A module that checks on construction that its array fields have the shapes of their annotations.

    Its `repr` is one line, with units.
    """

    def __repr__(self) -> str:
        return shown_module(self)

    def __check_init__(self):
        for field in dataclasses.fields(self):
            shapes = _shapes(field)
            value = getattr(self, field.name)
            if shapes and value is not None and not any(isinstance(value, shape) for shape in shapes):
                raise ValueError(
                    f"Argument `{field.name}` must be of shape ({shapes[0].dim_str.replace(' ', ', ')}), "
                    f"but has shape {jnp.shape(value)}."
                )
