"""Code as a value: digests that tell whether a function or a class is still what it was, in any process."""

import dataclasses
import functools
import hashlib
import inspect
import sys
import types
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .compile import is_transformed

OWN = __name__.split(".")[0]
LIBRARIES = {"jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "jaxtyping", "beartype", "numpy", "scipy"}
"""Packages whose code counts by name: their versions tell it."""
SHOWING = ("bench", "cli", "plots", "studies")
"""Folders of this package that compute no numbers of a sweep."""
_SEEN: weakref.WeakKeyDictionary[type, tuple[int, list[tuple[Mapping[str, Any], str, Any]]]] = (
    weakref.WeakKeyDictionary()
)
"""Of each class the number of its members, and the names by which it reached code when it was used last."""


def _source_digest() -> str:
    """Gives a digest of this package's own source, as far as numbers depend on it."""
    root = Path(__file__).parents[1]
    files = {path.relative_to(root): path for path in root.rglob("*.py")}
    total = hashlib.sha256()
    for name in sorted(files, key=str):
        if name.parts[0] not in SHOWING:
            total.update(str(name).encode() + hashlib.sha256(files[name].read_bytes()).digest())
    return total.hexdigest()[:12]


IMPORTED = _source_digest()
"""That of the source when it was imported."""


def package_digest() -> str:
    """Gives the digest of this package's own source when it was imported.

    **Raises:** `RuntimeError` where it was edited since: this process has the old code, or some of both.
    """
    if _source_digest() != IMPORTED:
        raise RuntimeError("the source of slipperjax was edited after this process imported it: begin a new process")
    return IMPORTED


def code_digest(thing: Any) -> str:
    """Gives a digest of a function or class with the functions, classes and constants that it uses.

    Functions of this package that it calls are left to `package_digest`.
    """
    return hashlib.sha256("\n".join(_texts(thing, set())).encode()).hexdigest()[:12]


def classes_of(value: Any) -> Iterator[type]:
    """The classes of modules and dataclasses inside a value, those of libraries left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        if not _of_library(type(value)):
            yield type(value)
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    elif isinstance(value, Mapping):
        value = list(value.values())
    for part in value if isinstance(value, tuple | list) else ():
        yield from classes_of(part)


def heed_new_code(value: Any) -> None:
    """Drops all compiled programs where code that a class in `value` uses was replaced since the last call.

    JAX knows programs by shapes and classes, so that it would go on with a function that is gone.
    """
    if is_transformed():
        return
    for kind in classes_of(value):
        known, members = _SEEN.get(kind), sum(len(vars(of)) for of in kind.__mro__)
        if known is None or known[0] != members or any(names.get(name) is not part for names, name, part in known[1]):
            if known is not None:
                jax.clear_caches()
            _SEEN[kind] = members, list(_names_in(kind, set()))


def _names_in(thing: Any, seen: set[int]) -> Iterator[tuple[Mapping[str, Any], str, Any]]:
    """The names by which a class or function reaches code, as a namespace, a name and what it means there now."""
    if id(thing) in seen or _of_library(thing):
        return
    seen.add(id(thing))
    thing = inspect.unwrap(thing)
    if isinstance(thing, type):
        found = [(vars(kind), name) for kind in thing.__mro__ if not _of_library(kind) for name in vars(kind)]
    elif isinstance(thing, types.FunctionType) and not str(thing.__module__).startswith(OWN):
        codes = [thing.__code__]
        for code in codes:
            codes += [part for part in code.co_consts if isinstance(part, types.CodeType)]
        found = [(thing.__globals__, name) for code in codes for name in code.co_names if name in thing.__globals__]
    else:
        return
    for names, name in found:
        part = names[name]
        yield names, name, part
        yield from _names_in(part.fget if isinstance(part, property) else part, seen)


def _of_library(thing: Any) -> bool:
    name = thing.__name__ if isinstance(thing, types.ModuleType) else getattr(thing, "__module__", None)
    top = str(name).split(".")[0]
    return top in LIBRARIES or top in sys.stdlib_module_names


def _texts(thing: Any, seen: set[int]) -> Iterator[str]:
    """Texts that make up a value's digest, the same in any process."""
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes):
        yield repr(thing)
    elif isinstance(thing, np.ndarray | np.generic | jax.Array) and not isinstance(thing, jax.core.Tracer):
        array = np.asarray(thing)
        yield f"{array.dtype} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
    elif isinstance(thing, set | frozenset):
        yield from sorted(" ".join(_texts(part, seen)) for part in thing)  # in no order of their own
    elif isinstance(thing, tuple | list | Mapping):
        for part in thing.items() if isinstance(thing, Mapping) else thing:
            yield from _texts(part, seen)
    elif isinstance(thing, functools.partial):
        yield from _texts([thing.func, thing.args, thing.keywords], seen)
    elif isinstance(thing, property | functools.cached_property):
        yield from _texts(thing.fget if isinstance(thing, property) else thing.func, seen)
    elif _of_library(thing):
        yield f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', type(thing).__qualname__)}"
    elif id(thing) not in seen:
        seen.add(id(thing))
        yield from _texts_of_code(thing, seen)


def _texts_of_code(thing: Any, seen: set[int]) -> Iterator[str]:
    thing = inspect.unwrap(thing)  # of jax.jit and the like
    if isinstance(thing, types.FunctionType):
        yield f"{thing.__module__}.{thing.__qualname__}"
        yield from _texts([thing.__defaults__, thing.__kwdefaults__], seen)
        yield from _texts([cell.cell_contents for cell in thing.__closure__ or ()], seen)
        yield from _texts_of_body(thing.__code__, thing.__globals__, seen)
    elif isinstance(thing, type):
        yield f"{thing.__module__}.{thing.__qualname__}"
        for kind in thing.__mro__:
            for name, member in () if _of_library(kind) else sorted(vars(kind).items()):
                if name == "__call__" or not name.startswith(("__", "_abc_")):
                    yield name
                    yield from _texts(member, seen)
    elif dataclasses.is_dataclass(thing):
        yield from _texts([type(thing), *(getattr(thing, f.name) for f in dataclasses.fields(thing))], seen)
    else:
        yield type(thing).__qualname__


def _texts_of_body(code: types.CodeType, known: Mapping[str, Any], seen: set[int]) -> Iterator[str]:
    """Texts of a function's instructions, without its file and lines, and of the global names in them."""
    yield code.co_code.hex()
    for part in code.co_consts:
        yield from _texts_of_body(part, known, seen) if isinstance(part, types.CodeType) else _texts(part, seen)
    for name in code.co_names:
        yield name
        value = known.get(name)
        if isinstance(value, types.ModuleType):
            # parts of a user's module that may be meant
            used = [vars(value)[part] for part in code.co_names if part in vars(value)]
            yield from () if _of_library(value) or value.__name__.startswith(OWN) else _texts(used, seen)
        elif not str(getattr(value, "__module__", "")).startswith(OWN):
            yield from _texts(value, seen)
