"""Digests of code and values, which show whether a function, class or value is the same as in another process."""

import dataclasses
import enum
import functools
import hashlib
import inspect
import sys
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import Any

import jax
import numpy as np

COMPUTE_NOTHING = ("bench", "cli", "plots", "studies")
"""Rooms of the package that compute no numbers of a sweep: their source is not part of `IMPORTED`."""
LIBRARIES = {"slipperjax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "jaxtyping", "beartype"}
LIBRARIES |= {"numpy", "scipy"} | sys.stdlib_module_names
"""Packages whose version identifies their code."""
PLAIN = (type(None), bool, int, float, complex, str, bytes, range, slice, type(...), type(NotImplemented))
"""Classes whose values are identified by their text."""
BUILTIN: tuple[Any, ...] = (tuple, list, dict, int, float, complex, str, bytes)
"""Classes that are identified together with all classes that inherit from them."""
MADE_BY_PYTHON = {"__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__replace__"}
"""Methods that Python adds to dataclasses."""


def _source_digest() -> str:
    """Return a digest of those parts of this package's source on which numbers depend."""
    root = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root)
        if name.parts[0] not in COMPUTE_NOTHING:
            total.update(str(name).encode() + path.read_bytes())
    return total.hexdigest()[:12]


IMPORTED = _source_digest()
"""Digest of the package's source when it was imported."""


def code_digest(thing: object) -> str:
    """Return a digest of a function, a class or a value, with the functions, classes and constants that it uses.

    Code of libraries and of this package counts by its name only: stores keep its versions and `IMPORTED`
    separately. A thing whose content cannot be read, such as a lock, has another digest in each process.
    """
    return _digest(_texts(thing, {}, {}))[:12]


def stable_digest(thing: object) -> str | None:
    """Return the digest of `code_digest` at full length; None where it would differ in another process."""
    try:
        texts = list(_texts(thing, {}, {}))
    except (RecursionError, jax.errors.JAXTypeError):
        return None
    return None if any(" at 0x" in text for text in texts) else _digest(texts)


def classes_of(value: object) -> Iterator[type]:
    """Yield the user's own classes, of dataclasses and modules, in a value and its parts."""
    parts = value if isinstance(value, tuple | list) else ()
    if isinstance(value, Mapping):
        parts = value.values()
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
        if not _of_library(type(value)):
            yield type(value)
    for part in parts:
        yield from classes_of(part)


def _digest(texts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _of_library(thing: object) -> bool:
    """Return whether a thing belongs to this package or a library, whose version identifies its code."""
    if isinstance(thing, types.ModuleType):
        module = thing.__name__
    elif isinstance(thing, types.FunctionType):
        # the `__module__` of a wrapper is that of the wrapped function, but its globals are its own
        module = thing.__globals__.get("__name__")
    else:
        module = getattr(thing, "__module__", None)
    package, *rooms = str(module).split(".")
    return package in LIBRARIES and not (package == "slipperjax" and rooms and rooms[0] in COMPUTE_NOTHING)


def _is_found_in_library(thing: object) -> bool:
    """Return whether a library has a function or class under its name, so that the name identifies its code."""
    if not callable(thing) or isinstance(thing, functools.partial):
        return False
    # such as the function inside jax.jit
    code = thing if isinstance(thing, types.FunctionType) else inspect.unwrap(thing)
    if not (_of_library(thing) and _of_library(code)):
        return False
    found = sys.modules.get(getattr(thing, "__module__", None) or "")
    for name in getattr(thing, "__qualname__", "<locals>").split("."):
        found = getattr(found, name, None)
    # or a decorated function, such as the function inside `jit`
    while found is not thing and hasattr(found, "__wrapped__"):
        found = getattr(found, "__wrapped__")  # noqa: B009
    return found is thing


def _texts(thing: object, seen: dict[int, object], known: Mapping[str, object]) -> Iterator[str]:
    """Yield the texts that make up a value's digest, the same in any process; each piece of code once.

    **Arguments:** `seen`: things met before, by id, kept so that no other thing gets the same id; `known`: global
    values by name, as seen by the function that `thing` is a part of.
    """
    kind = type(thing)
    if kind in PLAIN or isinstance(thing, np.dtype | PurePath):
        yield f"{kind.__name__} {thing!r}"
        return
    if isinstance(thing, np.ndarray | np.generic | jax.Array) and not _is_key(thing):
        yield _of_array(np.asarray(thing))
        return
    if isinstance(thing, types.ModuleType):
        yield thing.__name__
        return
    if id(thing) in seen:
        yield f"met before, {list(seen).index(id(thing))}"
        return
    seen[id(thing)] = thing
    if isinstance(thing, set | frozenset):
        # the order of a set differs between processes
        parts = sorted("\n".join(_texts(part, dict(seen), known)) for part in thing)
    else:
        # such as a vmapped function: its module is that of the function, its globals are those of JAX
        known = thing.__globals__ if isinstance(thing, types.FunctionType) else known
        parts = _parts(thing, known)
    yield f"{kind.__module__}.{kind.__qualname__} of {len(parts)}"
    for part in parts:
        yield from _texts(part, seen, known)


def _parts(thing: object, known: Mapping[str, object]) -> list:
    """Return the parts of a thing: names, code and values."""
    if _is_found_in_library(thing):
        return [thing.__module__, thing.__qualname__]
    if isinstance(thing, enum.Enum):
        return [type(thing), thing.name]
    for kind in BUILTIN:
        if isinstance(thing, kind):
            # the user may have added methods to a named tuple
            own = [] if type(thing) is kind else [type(thing), getattr(thing, "__dict__", None)]
            if isinstance(thing, dict):
                return own + [part for item in thing.items() for part in item]
            return own + (list(thing) if isinstance(thing, tuple | list) else [kind(thing)])
    if isinstance(thing, types.CodeType):
        # The instructions, and the global values that they name; file and line numbers change no result.
        return [thing.co_code, thing.co_names, thing.co_consts, _used(thing, known)]
    if isinstance(thing, functools.partial):
        return [thing.func, thing.args, thing.keywords]
    if isinstance(thing, property):
        return [thing.fget]
    if isinstance(thing, types.MethodType | classmethod | staticmethod):
        return [thing.__func__, getattr(thing, "__self__", None)]
    if isinstance(thing, jax.tree_util.PyTreeDef):
        return [thing.node_data(), thing.children(), thing.num_leaves]
    if isinstance(thing, type):
        return _of_class(thing)
    if isinstance(thing, types.FunctionType):
        return _of_function(thing)
    in_python = isinstance(type(thing).__init__, types.FunctionType)
    if hasattr(thing, "__wrapped__") and not in_python:
        # the function inside `jax.jit` or a similar wrapper
        return [thing.__wrapped__]
    if isinstance(thing, types.BuiltinFunctionType | np.ufunc):
        return [getattr(thing, "__module__", None), thing.__name__, _owner(thing)]
    if dataclasses.is_dataclass(thing):
        return [type(thing), {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}]
    if hasattr(thing, "__dict__"):
        return [type(thing), vars(thing)]
    name = _name_of_mark(thing) if type(thing) is object else None
    # otherwise with its address, which is different in another process
    return [object.__repr__(thing) if name is None else name]


def _of_function(thing: types.FunctionType) -> list:
    """Return the parts of a function: code, defaults, and variables of an enclosing function."""
    cells = [_content(cell) for cell in thing.__closure__ or ()]
    own = [thing.__defaults__, thing.__kwdefaults__, cells]
    if not _of_library(thing):
        return [thing.__qualname__, thing.__code__, vars(thing), *own]
    # functions of one name, such as lambdas, differ in their code; global values belong to the library
    code = thing.__code__
    inner = [part.co_code for part in code.co_consts if isinstance(part, types.CodeType)]
    numbers = [part for part in code.co_consts if not isinstance(part, types.CodeType)]
    return [thing.__globals__.get("__name__"), thing.__qualname__, code.co_code, code.co_names, numbers, inner, *own]


def _of_class(thing: type) -> list:
    """Return the parts of a class: its name, and the members of the user's classes that it inherits from."""
    parts = [thing.__module__, thing.__qualname__]
    for kind in thing.__mro__:
        members = {} if _of_library(kind) else vars(kind)
        parts.append({name: member for name, member in sorted(members.items()) if _is_own(name, member)})
    return parts


def _used(code: types.CodeType, known: Mapping[str, object]) -> list:
    """Return the values that code may use by its names: global values, and values of the user's modules."""
    found = {name: known[name] if name in known else sys.modules.get(name) for name in code.co_names}
    values = list(found.values())
    searched = []
    for value in values:  # the list grows in this loop
        if isinstance(value, types.ModuleType) and not _of_library(value) and value not in searched:
            searched.append(value)
            values += [vars(value).get(name) for name in code.co_names]
    return values


def _of_array(array: np.ndarray) -> str:
    content = repr(array.tolist()) if array.dtype.hasobject else hashlib.sha256(array.tobytes()).hexdigest()
    return f"array {array.dtype} {array.shape} {content}"


def _is_key(thing: object) -> bool:
    """Return whether a value is an array of JAX's random keys, which NumPy cannot hold."""
    return isinstance(thing, jax.Array) and jax.dtypes.issubdtype(thing.dtype, jax.dtypes.extended)


def _owner(thing: object) -> object:
    """Return the object that a method in C, such as `[].append`, belongs to; None for a function of a module."""
    owner = getattr(thing, "__self__", None)
    return None if isinstance(owner, types.ModuleType) else owner


@functools.cache
def _name_of_mark(thing: object) -> str | None:
    """Return the name of an `object()` by which a library marks a missing argument, such as an axis name."""
    for module in sorted(set(sys.modules) - {"__main__"}):
        if module.partition(".")[0] in LIBRARIES:
            for name, value in list(vars(sys.modules[module]).items()):
                if value is thing:
                    return f"{module}.{name}"
    return None


def _content(cell: types.CellType) -> object:
    try:
        return cell.cell_contents
    except ValueError:  # not yet assigned
        return "empty"


def _is_own(name: str, member: object) -> bool:
    """Return whether the author of a class wrote a member, and not Python, `abc` or dataclasses."""
    if name.startswith("__"):
        return isinstance(member, types.FunctionType) and name not in MADE_BY_PYTHON
    return not name.startswith("_abc_")
