"""Modules as plain data for JSON and TOML, and modules from such data, without running code that a file names."""

import dataclasses
import functools
import hashlib
import inspect
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix

from .checks import brief, hint
from .code import code_digest
from .fields import StaticFunction
from .tracing import is_traced

TYPE = "type"
"""Key of a description that holds the name of the class."""
OPAQUE = "opaque"
"""Key in place of a value that plain data cannot hold, such as a function."""

NORMS = {
    f"optimistix.{norm.__name__}": norm for norm in (optimistix.max_norm, optimistix.rms_norm, optimistix.two_norm)
}
"""Functions in diffrax's solvers, by their names in descriptions."""


def type_name(kind: type) -> str:
    """Return the name of a class in descriptions, for other packages with the package's name: diffrax.Tsit5."""
    package = kind.__module__.split(".")[0]
    return kind.__name__ if package in (__name__.split(".")[0], "__main__") else f"{package}.{kind.__name__}"


def subclasses(base: type) -> Iterator[type]:
    """Yield all subclasses of a class that were defined in this process, those of users included."""
    for kind in base.__subclasses__():
        yield kind
        yield from subclasses(kind)


def describe(value: object) -> Any:
    """Return a module, or a dataclass, as nested dicts of plain values, which `build` turns into an equal module.

    Arrays become lists of numbers; 64-bit numbers are restored to the last bit. Quantities of pint become numbers in
    SI units. A module that holds a value which is not plain, such as a function, is described by its name alone where
    it equals the module that is made without arguments. A module that its arguments cannot make again, such as a
    trained network, is described by a digest of its arrays.
    """
    if isinstance(value, StaticFunction):
        return describe(value.function)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        if isinstance(value, eqx.Module) and not is_traced(value) and not _of_arguments(value):
            return {OPAQUE: f"{type_name(kind)}, {_digest(value)}"}
        fields = {name: describe(getattr(value, name)) for name in arguments_of(kind)}
        # such as a controller of diffrax, whose fields are functions
        if any(_opaque(part) for part in fields.values()) and _is_default(value):
            fields = {}
        return {TYPE: type_name(kind), **fields}
    if hasattr(value, "to_base_units"):  # a quantity of pint
        return describe(value.to_base_units().magnitude)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, jax.core.Tracer):
        return {OPAQUE: "a traced value"}
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        return np.asarray(value).tolist()
    if isinstance(value, tuple | list):
        return [describe(part) for part in value]
    if isinstance(value, dict):
        return {name: describe(part) for name, part in value.items()}
    for name, norm in NORMS.items():
        if norm is value:
            return name
    if callable(value) and hasattr(value, "__qualname__"):  # functions of JAX, too, which are no Python functions
        return {OPAQUE: f"{value.__module__}.{value.__qualname__}, {code_digest(value)}"}
    return {OPAQUE: brief(value)}


def _of_arguments(module: eqx.Module) -> bool:
    """Return whether a module can be made again from the arguments of its class; modules of this package can."""
    kind = type(module)
    names = arguments_of(kind)
    others = [getattr(module, field.name) for field in dataclasses.fields(kind) if field.name not in names]
    own = kind.__module__.split(".")[0] == __name__.split(".")[0]
    if own or not any(map(eqx.is_array, jax.tree.leaves(others))):
        return True
    try:
        return bool(eqx.tree_equal(module, kind(**{name: getattr(module, name) for name in names})))
    except (TypeError, ValueError):
        return False


def _digest(module: eqx.Module) -> str:
    """Return a digest of a module's structure and numbers."""
    leaves, structure = jax.tree.flatten(module)
    texts = [str(np.asarray(leaf).tolist()) for leaf in leaves if eqx.is_array_like(leaf)]
    return hashlib.sha256("\n".join([str(structure), *texts]).encode()).hexdigest()[:12]


@functools.cache
def arguments_of(kind: type) -> dict[str, object]:
    """Return the fields of a class that its `__init__` takes, with their defaults: these fields describe it."""
    # an `__init__` may take fewer arguments than there are fields, or more
    names = {field.name for field in dataclasses.fields(kind)}
    parameters = inspect.signature(kind.__init__).parameters
    return {name: parameter.default for name, parameter in parameters.items() if name in names}


def _opaque(description: object) -> bool:
    """Return whether plain data cannot hold some value in a description."""
    if isinstance(description, dict):
        return OPAQUE in description or any(_opaque(part) for part in description.values())
    return isinstance(description, list) and any(_opaque(part) for part in description)


def _is_default(module: eqx.Module) -> bool:
    try:
        return bool(eqx.tree_equal(module, type(module)()))
    except TypeError:
        return False


def build(description: object, bases: tuple[type, ...], where: str = "") -> Any:
    """Return the module of a description.

    **Arguments:** `bases`: only these classes and their subclasses can be built, if defined in this process;
    `where`: what is described, for errors.

    **Raises:** `ValueError` for an unknown class, fields that it does not have, or values that it refuses.
    """
    if isinstance(description, Mapping):
        if OPAQUE in description:
            raise ValueError(f"Argument `{where}` cannot be rebuilt: it was {description[OPAQUE]}.")
        if TYPE not in description:
            names = ", ".join(description) or "nothing"
            raise ValueError(f"Argument `{where}` must have a `{TYPE}`, but has {names}.")
        kind = known_type(str(description[TYPE]), bases, where)
        taken = arguments_of(kind)
        fields = {name: part for name, part in description.items() if name != TYPE}
        for name in fields:
            if name not in taken:
                raise ValueError(
                    f"Argument `{where}` must have only {', '.join(taken)}, but has `{name}`.{hint(name, taken)}"
                )
        # fields with a default may be left out, as in files of older versions
        for name, default in taken.items():
            if default is inspect.Parameter.empty and name not in fields:
                given = f"only {', '.join(fields)}" if fields else "nothing"
                raise ValueError(f"Argument `{where}` must have `{name}`, but has {given}.")
        within = f"{where}." if where else ""
        return kind(**{name: build(part, bases, within + name) for name, part in fields.items()})
    if isinstance(description, list):
        return tuple(build(part, bases, where) for part in description)
    return NORMS.get(description, description) if isinstance(description, str) else description


def known_types(bases: Iterable[type]) -> dict[str, type]:
    """Return the concrete classes among `bases` and their subclasses, by name."""
    classes = {}
    # a class that is defined again, as in a notebook, replaces the earlier class of the same name
    for base in bases:
        for kind in (base, *subclasses(base)):
            if not kind.__name__.startswith(("Abstract", "_")) and not getattr(kind, "__abstractmethods__", None):
                classes[type_name(kind)] = kind
    return classes


def known_type(name: str, bases: tuple[type, ...], where: str) -> type:
    """Return the class of a name in descriptions, with or without its package: the one defined last.

    **Raises:** `ValueError` where no concrete subclass of `bases` has this name.
    """
    classes = known_types(bases)
    # the bare name is enough for a class of a user's module, unless another class has it
    fitting = [full for full in classes if full == name or full.endswith(f".{name}")]
    if len(fitting) == 1:
        name = fitting[0]
    if name not in classes:
        own = ", ".join(sorted(k for k in classes if "." not in k))
        raise ValueError(
            f"Argument `{where}.{TYPE}` must be one of {own}, but is {brief(name)}.{hint(name, classes)} A class of "
            f"your own must be imported before, on the command line by --import."
        )
    return classes[name]
