"""Digests of code, which tell whether a function or a class is still what it was, in any process."""

import dataclasses
import functools
import hashlib
import inspect
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path


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


def code_digest(thing: object) -> str:
    """Return a digest of a user's function or class with the functions, classes and constants that it uses.

    Code of libraries and of this package counts by its name alone: stores keep their versions and `IMPORTED` beside.
    """
    return hashlib.sha256("\n".join(_texts(thing, set(), {})).encode()).hexdigest()[:12]


def classes_of(value: object) -> Iterator[type]:
    """Yield the user's own classes of dataclasses, modules among them, in a value and its parts."""
    parts = value if isinstance(value, tuple | list) else ()
    if isinstance(value, Mapping):
        parts = value.values()
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
        if not _of_library(type(value)):
            yield type(value)
    for part in parts:
        yield from classes_of(part)


def _of_library(thing: object) -> bool:
    """Tell whether a module, class or function belongs to this package or a library, whose version tells its code."""
    known = {"slipperjax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax"}
    known |= {"jaxtyping", "beartype", "numpy", "scipy"}
    module = thing.__name__ if isinstance(thing, types.ModuleType) else getattr(thing, "__module__", None)
    package = str(module).partition(".")[0]
    return package in known or package in sys.stdlib_module_names


def _texts(thing: object, seen: set[int], known: Mapping[str, object]) -> Iterator[str]:
    """Yield the texts that make up a value's digest, the same in any process; each piece of code once.

    **Arguments:** `seen`: ids of the code that was met before; `known`: global values by name, as the function sees
    them that `thing` is a part of.
    """
    parts = []
    if isinstance(thing, tuple | list):
        parts = thing
    elif isinstance(thing, frozenset):
        parts = sorted(map(repr, thing))  # its order differs between processes
    elif isinstance(thing, types.CodeType):
        # The instructions, and the global values that they name. File and line numbers change no result.
        used = [known.get(name) for name in thing.co_names]
        parts = [thing.co_code, thing.co_names, thing.co_consts, used]
    elif isinstance(thing, types.ModuleType):
        yield thing.__name__
    elif isinstance(thing, functools.partial):
        parts = [thing.func, thing.args, *thing.keywords.items()]
    elif isinstance(thing, property):
        parts = [thing.fget]
    elif not callable(thing):
        yield repr(thing)
    elif _of_library(thing):
        yield getattr(thing, "__qualname__", repr(thing))
    elif id(thing) not in seen:
        seen.add(id(thing))
        thing = inspect.unwrap(thing)  # the function inside jax.jit and the like
        yield getattr(thing, "__qualname__", repr(thing))
        if isinstance(thing, types.FunctionType):
            known = thing.__globals__
            # variables of an enclosing function belong to it, too
            cells = [cell.cell_contents for cell in thing.__closure__ or ()]
            parts = [thing.__code__, thing.__defaults__, thing.__kwdefaults__, cells]
        elif isinstance(thing, type):
            # the class and the user's classes that it inherits from
            for kind in thing.__mro__:
                members = {} if _of_library(kind) else vars(kind)
                parts += [member for name, member in sorted(members.items()) if _is_own(name)]
    for part in parts:
        yield from _texts(part, seen, known)


def _is_own(name: str) -> bool:
    """Tell whether a member of a class was written by its author, not added by Python or `abc`."""
    return name == "__call__" or not name.startswith(("__", "_abc_"))
