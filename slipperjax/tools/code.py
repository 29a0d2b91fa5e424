"""Digests of code, which tell whether a function or a class is still what it was, in any process."""

import dataclasses
import functools
import hashlib
import inspect
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np


def _source_digest() -> str:
    """Return a digest of this package's own source, as far as numbers depend on it."""
    root = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root)
        # these rooms compute no numbers of a sweep
        if name.parts[0] not in ("bench", "cli", "plots", "studies"):
            total.update(str(name).encode() + path.read_bytes())
    return total.hexdigest()[:12]


IMPORTED = _source_digest()
"""Digest of the package's source when it was imported."""


def code_digest(thing: Any) -> str:
    """Return a digest of a user's function or class with the functions, classes and constants that it uses.

    Code of libraries and of this package counts by name: their versions and `IMPORTED` tell it.
    """
    return hashlib.sha256("\n".join(_texts(thing, set())).encode()).hexdigest()[:12]


def classes_of(value: Any) -> Iterator[type]:
    """Yield the classes of a user's modules and dataclasses inside a value."""
    if _is_dataclass(value) and not _of_library(type(value)):
        yield type(value)
    for part in _parts(value):
        yield from classes_of(part)


def _is_dataclass(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _parts(value: Any) -> list[Any]:
    """Return what a dataclass or a container holds; nothing for other values."""
    if _is_dataclass(value):
        return [getattr(value, field.name) for field in dataclasses.fields(value)]
    if isinstance(value, Mapping):
        return list(value.items())
    return list(value) if isinstance(value, tuple | list) else []


def _of_library(thing: Any) -> bool:
    """Tell whether a module, class or function belongs to this package, or to one whose version tells its code."""
    known = {"slipperjax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax"}
    known |= {"jaxtyping", "beartype", "numpy", "scipy"}
    module = thing.__name__ if isinstance(thing, types.ModuleType) else getattr(thing, "__module__", None)
    package = str(module).partition(".")[0]
    return package in known or package in sys.stdlib_module_names


def _texts(thing: Any, seen: set[int]) -> Iterator[str]:
    """Yield the texts that make up a value's digest, the same in any process; each piece of code once."""
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes):
        yield repr(thing)
    elif isinstance(thing, np.ndarray | np.generic | jax.Array) and not isinstance(thing, jax.core.Tracer):
        array = np.asarray(thing)
        yield f"{array.dtype} {array.shape} {array.tobytes().hex()}"
    elif isinstance(thing, set | frozenset):
        yield from sorted(" ".join(_texts(part, seen)) for part in thing)  # in no order of their own
    elif _is_dataclass(thing) or isinstance(thing, Mapping | tuple | list):
        yield type(thing).__qualname__
        for part in _parts(thing):
            yield from _texts(part, seen)
    elif isinstance(thing, functools.partial):
        yield from _texts([thing.func, thing.args, thing.keywords], seen)
    elif isinstance(thing, property):
        yield from _texts(thing.fget, seen)
    elif _of_library(thing):
        yield f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', type(thing).__qualname__)}"
    elif id(thing) not in seen:
        seen.add(id(thing))
        for part in _content(inspect.unwrap(thing)):  # of jax.jit and the like
            yield from _texts(part, seen)


def _content(thing: Any) -> Iterator[Any]:
    """Yield what a function or class of a user consists of, and what it uses by name."""
    yield getattr(thing, "__qualname__", type(thing).__qualname__)
    if isinstance(thing, types.FunctionType):
        yield from (thing.__defaults__, thing.__kwdefaults__)
        yield from (cell.cell_contents for cell in thing.__closure__ or ())
        yield from _content_of_body(thing.__code__, thing.__globals__)
    elif isinstance(thing, type):
        # the class and those of the user that it inherits from
        for kind in thing.__mro__:
            for name, member in () if _of_library(kind) else sorted(vars(kind).items()):
                if name == "__call__" or not name.startswith(("__", "_abc_")):
                    yield name, member


def _content_of_body(code: types.CodeType, known: Mapping[str, Any]) -> Iterator[Any]:
    """Yield a function's instructions, without its file and lines, and the global values that they name."""
    yield from (code.co_code, code.co_names)
    # functions inside this one are among its constants
    for part in code.co_consts:
        yield from _content_of_body(part, known) if isinstance(part, types.CodeType) else [part]
    for name in code.co_names:
        value = known.get(name)
        if isinstance(value, types.ModuleType):
            # parts of a user's module that may be meant
            value = None if _of_library(value) else [vars(value).get(part) for part in code.co_names]
        yield value
