"""Fields of modules that declare their numbers: each field states unit, check, plausible range and labels once.

```python
class Slipper(ShapeChecked):
    mass: Float[Array, ""] = field("kg", positive, plausible=(0.1, 1e4), symbol="m")
```

Errors, `repr`, scene files, parameters, datasets, axes and options of the command line read these declarations.
"""

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import AbstractArray, PyTree

from .checks import Check, check_no_clock, require, shown_number
from .tracing import is_traced


def field(
    unit: str,
    check: Callable[[str, str], Check],
    *,
    plausible: tuple[float, float] | None = None,
    optional: bool = False,
    text: str = "",
    symbol: str = "",
    shown_unit: str = "",
    **more: object,
) -> Any:
    """Return a field of a `ShapeChecked` module: a number or an array of numbers [`unit`], or None if its default is.

    **Arguments:** `unit`: SI unit, "" or "1" for pure numbers; `check`: `positive`, `finite`, ... of
    `slipperjax.tools.checks`; `plausible`: values outside this range [unit] give an `ImplausibleWarning`;
    `optional`: whether None is allowed, as it always is where None is the default; `text`: description in a few
    words, by default the names that lead to the field; `symbol`: in LaTeX; `shown_unit`: unit in pictures and on the
    command line, by default `unit`; `more`: as for `equinox.field`.
    """
    optional = optional or more.get("default", 0) is None
    converter = dataclasses.replace(check("", unit), plausible=plausible, optional=optional)
    labels = {"text": text, "symbol": symbol, "shown_unit": shown_unit}
    return eqx.field(converter=converter, metadata={"labels": labels}, **more)


class StaticFunction(eqx.Module):
    """A function as a pytree without leaves, so that JAX takes modules that hold it."""

    function: Callable = eqx.field(static=True)

    def __call__(self, *args: object, **options: object) -> Any:
        return self.function(*args, **options)


def with_static_functions(tree: PyTree) -> PyTree:
    """Return a pytree in which leaves that are functions, such as a network's activations, are static."""
    if not any(callable(leaf) for leaf in jax.tree.leaves(tree)):
        return tree
    return jax.tree.map(lambda leaf: StaticFunction(leaf) if callable(leaf) else leaf, tree)


class ShapeChecked(eqx.Module):
    """Base of modules that check on construction that their array fields have the shapes of their annotations.

    Functions in the fields become static, see `with_static_functions`, so that all leaves are numbers. `repr` gives
    one line, with units, without the fields that are None.
    """

    def __init_subclass__(cls, **more: object):
        super().__init_subclass__(**more)
        # a field's check must name the field in errors, but `field` does not know the name
        for name, declared in vars(cls).items():
            check = getattr(declared, "metadata", {}).get("converter")
            if isinstance(check, Check):
                named = dataclasses.replace(check, name=name)
                declared.metadata = types.MappingProxyType({**declared.metadata, "converter": named})

    def __repr__(self) -> str:
        parts = []
        for part in dataclasses.fields(self):
            value = getattr(self, part.name)
            if value is not None:
                parts.append(f"{part.name}={shown_number(value)} {unit_of(type(self), part.name)}".rstrip())
        return f"{type(self).__name__}({', '.join(parts)})"

    def check_of(self, name: str) -> Check | None:
        """Return the check of a field's values, by default its converter; None where it has none."""
        return declared_check(type(self), name)

    def __check_init__(self):
        for part in dataclasses.fields(self):
            shapes = _shapes(part)
            value = getattr(self, part.name)
            if not part.metadata.get("static", False) and (fixed := with_static_functions(value)) is not value:
                # equinox freezes modules before this check
                object.__setattr__(self, part.name, fixed)
            # some fields take a module in place of an array, such as a table
            absent = value is None or isinstance(value, eqx.Module)
            if shapes and not absent and not any(isinstance(value, shape) for shape in shapes):
                raise ValueError(
                    f"Argument `{part.name}` must be of shape ({shapes[0].dim_str.replace(' ', ', ')}), "
                    f"but has shape {jnp.shape(value)}."
                )


def unit_of(kind: type, name: str) -> str:
    """Return the unit of a module's field; empty where it has none."""
    metadata = _metadata(kind, name)
    return metadata.get("unit", getattr(metadata.get("converter"), "unit", ""))


def declared_check(kind: type, name: str) -> Check | None:
    """Return the check that a module's field declares; None where it has none."""
    check = _metadata(kind, name).get("converter")
    return check if isinstance(check, Check) else None


def labels_of(kind: type, name: str) -> dict[str, str]:
    """Return text, symbol and shown unit of a field made by `field`; all are empty for other fields."""
    return dict(_metadata(kind, name).get("labels", {"text": "", "symbol": "", "shown_unit": ""}))


def axes_of(kind: type, name: str, default: int) -> int:
    """Return the number of axes in the annotation of a module's field, or `default` where it has none."""
    shapes = [shape for part in dataclasses.fields(kind) if part.name == name for shape in _shapes(part)]
    return len(shapes[0].dim_str.split()) if shapes else default


def check_table(table: ShapeChecked, rows: str, *columns: str, least: int = 1) -> None:
    """Raise `ValueError` unless the field `rows` has at least `least` increasing numbers, and each of the fields
    `columns` has one value for each number."""
    places = getattr(table, rows)
    listed = places.ndim == 1 and len(places) >= least
    require(listed, rows, f"be {least} or more numbers", shown=f"of shape {places.shape}")
    for name in columns:
        shape = jnp.shape(getattr(table, name))
        need = f"have one value per {rows}, {len(places)}"
        require(shape[:1] == places.shape, name, need, shown=f"shape {shape}")
    # the order of traced numbers is not known
    if not is_traced(places):
        require(np.all(np.diff(np.asarray(places, float)) > 0), rows, "increase", np.asarray(places))
        if rows == "time":
            check_no_clock(rows, np.asarray(places))


def _metadata(kind: type, name: str) -> Mapping[str, Any]:
    """Return the metadata of a module's field; empty where it has no such field."""
    for part in dataclasses.fields(kind):
        if part.name == name:
            return part.metadata
    return {}


def _shapes(part: dataclasses.Field) -> list[type[AbstractArray]]:
    """Return the array types in a field's annotation, such as Float[Array, "points 3"]."""
    return [
        kind
        for kind in (part.type, *typing.get_args(part.type))
        if isinstance(kind, type) and issubclass(kind, AbstractArray)
    ]
