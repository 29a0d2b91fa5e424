"""Compiled programs in a folder, found by what they are made from: a process that needs one again traces nothing.

JAX's own cache finds a program by the operations it consists of, so that each process traces and lowers it first,
which takes longer than the rest of a short run. Here it is found by the function, the structures and types of its
arguments, the source code of this package, and the versions of those below it. What is made from anything else, such
as a user's own classes or functions, is left to JAX.
"""

import dataclasses
import functools
import hashlib
import inspect
import os
import pickle
import re
import sys
import threading
import zlib
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

ENDING, PART = "-program", ".part"
"""Endings of whole files, and of those that are being written."""
LOADING = "/slipperjax/loading"
"""Event of `jax.monitoring`: a program is taken from the folder."""
BELOW = ("jax", "jaxlib", "numpy", "diffrax", "equinox", "optimistix", "lineax")
"""Packages whose classes and functions may be part of a program: their versions stand for them."""
PACKAGE = __name__.partition(".")[0]
_NAMED = {PACKAGE, "builtins", *BELOW}
_PLAIN = {bool, int, float, complex, str, bytes}
_DIGEST = hashlib.sha256().digest_size


class NotNamed(Exception):
    """Something that has no name which would mean the same in another process."""


class Program(NamedTuple):
    """A compiled function of arrays."""

    compiled: Callable
    """Takes the leaves of its arguments, and gives those of the results."""
    structure: Any
    """Of the results."""

    def __call__(self, leaves: Sequence[Any]) -> Any:
        return jax.tree.unflatten(self.structure, self.compiled(*leaves))


class _Place:
    """Stands for a leaf in a structure."""


def named(value: Any) -> str:
    """A text by which equal values, structures, functions and classes have equal names in all processes.

    **Raises:** `NotNamed` for what has none, such as a function inside another one, or a class of a user.
    """
    if value is None or type(value) in _PLAIN:
        return repr(value)
    if isinstance(value, _Place):
        return "*"
    if isinstance(value, jax.tree_util.PyTreeDef):
        return named(jax.tree.unflatten(value, [_Place()] * value.num_leaves))
    if isinstance(value, type) or hasattr(value, "__qualname__"):
        return _address(value)
    if isinstance(value, np.dtype) and not value.hasobject:
        return f"dtype {value.descr}"
    if isinstance(value, np.ndarray | np.generic):
        return f"{named(value.dtype)}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    of_kind = _address(type(value))
    if isinstance(value, Enum):
        return f"{of_kind}.{value.name}"
    if isinstance(value, tuple | list):
        return f"{of_kind}({','.join(map(named, value))})"
    if type(value) is dict:
        return f"{of_kind}({','.join(f'{named(k)}:{named(v)}' for k, v in value.items())})"
    if dataclasses.is_dataclass(value):
        return f"{of_kind}({','.join(f'{k}={named(v)}' for k, v in sorted(vars(value).items()))})"
    raise NotNamed(value)


def _address(of: Any) -> str:
    """Module and name of a class or function of this package or one below it, which can be found there."""
    module, name = getattr(of, "__module__", None) or "", of.__qualname__
    try:
        found = functools.reduce(getattr, name.split("."), sys.modules[module])
    except (AttributeError, KeyError):  # it was made inside a function
        raise NotNamed(of) from None
    if inspect.unwrap(found) is not inspect.unwrap(of) or module.partition(".")[0] not in _NAMED:
        raise NotNamed(of)
    return f"{module}:{name}"


def kind_of(leaf: Any) -> Hashable:
    """What a program depends on of an array or number: shape, type, and whether the type gives way to others.

    **Raises:** `NotNamed` for anything else.
    """
    if isinstance(leaf, jax.Array):
        return leaf.shape, leaf.dtype, leaf.weak_type
    if isinstance(leaf, np.ndarray | np.generic):
        return leaf.shape, leaf.dtype, False
    if type(leaf) in (bool, int, float, complex):
        return (), type(leaf), True
    raise NotNamed(leaf)


class Folder:
    """A folder of programs, and those that this process has made or loaded."""

    def __init__(self, place: Path):
        self.place = place
        self._context = _context()
        self._made_from = _made_from() if self._context is not None else None
        self._programs: dict[Hashable, Future] = {}
        self._lock = threading.Lock()

    @property
    def usable(self) -> bool:
        """Whether programs can be taken from here now: on one CPU device, with JAX's settings as they were."""
        return self._made_from is not None and _context() == self._context

    def program(
        self,
        fun: Callable,
        statics: Hashable,
        structure: Any,
        leaves: Sequence[Any],
        lower: Callable[[str], tuple[Any, Any]],
        run: Callable[[Callable[[], None]], Any] = lambda task: task(),
    ) -> Future:
        """The program of a function for arguments like these, or None where JAX has to look after it, as a future.

        **Arguments:** `statics`, `structure`, `leaves`: the arguments that the program is made for, and the structure
        and leaves of the others; `lower`: traces it where it is not there, with a mark for its name: gives a
        `jax.stages.Lowered` of the leaves, and the structure of the results; `run`: calls what loads or compiles it,
        perhaps on another thread.

        **Raises:** what tracing raises; what compiling raises is in the future.
        """
        try:
            key = (fun, statics, structure, tuple(map(kind_of, leaves)))
        except NotNamed:
            return _of(None)
        with self._lock:
            known = self._programs.get(key)
            if known is None:
                mine = self._programs[key] = Future()
        if known is not None:
            return known  # another thread may be making it

        def failed(error: BaseException) -> None:
            with self._lock:
                del self._programs[key]
            mine.set_exception(error)

        def finish() -> None:
            try:
                found = _load(path) if lowered is None else None
                mine.set_result(found or _compiled(path, mark, *(lowered or lower(mark))))
            except BaseException as error:
                failed(error)

        try:
            path = self._path(*key)
            mark = f"_{path.name[:16]}"
            # traced at once, because tracing several programs side by side only delays the first
            lowered = None if path.exists() else lower(mark)
        except NotNamed:
            mine.set_result(None)
            return mine
        except BaseException as error:
            failed(error)
            raise
        run(finish)
        return mine

    def _path(self, fun: Callable, statics: Hashable, structure: Any, kinds: tuple) -> Path:
        """Where a program is kept. **Raises:** `NotNamed`."""
        text = f"{self._made_from}\n{_address(fun)}\n{named(statics)}\n{named(structure)}\n{kinds}"
        return self.place / f"{hashlib.sha256(text.encode()).hexdigest()}{ENDING}"


def _of(value: Any) -> Future:
    """A future that is there."""
    found: Future = Future()
    found.set_result(value)
    return found


def _compiled(path: Path, mark: str, lowered: Any, structure: Any) -> Program:
    """The program of what was traced, kept in a file."""
    # The name is part of what JAX's own cache looks for. What it finds there XLA cannot write down again: some
    # kernels would be missing. So it finds nothing under this name, as a rule, and what it then keeps is deleted.
    before = _hits()
    found = Program(lowered.compile(), structure)
    if _hits() == before and _keep(path, found):
        for entry in path.parent.glob(f"jit_*{mark}-*"):
            entry.unlink(missing_ok=True)
    return found


_HITS = threading.local()


def _hits() -> int:
    """How many programs this thread took from JAX's own cache."""
    return getattr(_HITS, "count", 0)


def _hear(event: str, **_: Any) -> None:
    if event == "/jax/compilation_cache/cache_hits":
        _HITS.count = _hits() + 1


jax.monitoring.register_event_listener(_hear)


_KEPT: list[Folder] = []
"""The folder of this process, if it has one."""


def keep_in(place: Path) -> None:
    """Keeps programs in a folder, and takes those that are there, from here on."""
    _KEPT[:] = [Folder(place)]


def programs_kept() -> Folder | None:
    """The folder of programs, where there is one that can be used now."""
    return _KEPT[0] if _KEPT and _KEPT[0].usable else None


def _load(path: Path) -> Program | None:
    """The program in a file; None where there is none, or none that can be used."""
    from jax.experimental import serialize_executable

    try:
        content = path.read_bytes()
        if not whole_program(content):
            return None
        jax.monitoring.record_event(LOADING)
        os.utime(path)  # the longest unused ones are deleted first
        payload, results, count = pickle.loads(zlib.decompress(content[_DIGEST:]))
        arguments = jax.tree.structure(((0,) * count, {}))
        structure = jax.tree.structure(results)
        loaded = serialize_executable.deserialize_and_load(
            payload, arguments, jax.tree.structure([0] * structure.num_leaves)
        )
    except Exception:  # what cannot be loaded is compiled; pickle and XLA have errors of all kinds
        return None
    return Program(loaded, structure)


def _keep(path: Path, program: Program) -> bool:
    """Writes a program to a file, and says whether that was possible."""
    from jax.experimental import serialize_executable

    try:
        payload, arguments, _ = serialize_executable.serialize(program.compiled)
        results = jax.tree.unflatten(program.structure, [0] * program.structure.num_leaves)
        content = zlib.compress(pickle.dumps((payload, results, arguments.num_leaves)), 1)
        part = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}{PART}")
        part.write_bytes(hashlib.sha256(content).digest() + content)
        os.replace(part, path)
    except Exception:  # it is merely made again
        return False
    return True


def whole_program(content: bytes) -> bool:
    """Whether the content of a file is what was to be written."""
    return hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]


def _context() -> tuple | None:
    """JAX's settings that programs depend on; None where they cannot be known, or for several devices or none CPU.

    JAX has no public name for them.
    """
    try:
        from jax._src.config import trace_context

        # the last are named axes of transformations, in which nothing is looked up
        return (*trace_context()[:-1], jax.config.jax_debug_nans, jax.config.jax_debug_infs)  # type: ignore[attr-defined]
    except Exception:
        return None


def _made_from() -> str | None:
    """What all programs are made from: source code, versions, settings; None where that cannot be told."""
    if jax.default_backend() != "cpu" or jax.device_count() != 1:
        return None
    source = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        content = path.read_bytes()
        source.update(f"{path.relative_to(root)} {len(content)}\n".encode() + content)
    versions = []
    for name in BELOW:
        of = metadata.distribution(name)
        if "editable" in (of.read_text("direct_url.json") or ""):
            return None  # its version does not stand for its code
        versions.append(of.version)
    context = re.sub(r" at 0x[0-9a-f]+", "", repr(_context()))
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "LIBTPU_INIT_ARGS")]
    return "\n".join([sys.version, source.hexdigest(), *versions, context, *flags])
