"""Programs that are kept whole: a call finds its program on disk by what it is called with, before JAX traces it.

JAX's own cache of compiled programs saves the work of XLA; tracing and lowering come before it can be asked.
"""

import hashlib
import importlib.metadata
import inspect
import os
import pickle
import sys
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from .cache import WHOLE, kept_folder, silence_loader
from .code import IMPORTED, stable_digest
from .files import write_whole

COMPUTING = ("jax", "jaxlib", "numpy", "scipy", "equinox", "diffrax", "lineax", "optimistix", "jaxtyping")
"""Packages whose version is part of a program's key."""
CHANGE_NO_PROGRAM = (
    "jax_log",
    "jax_compilation_cache",
    "jax_enable_compilation_cache",
    "jax_persistent_cache",
    "jax_raise_persistent_cache",
    "jax_traceback",
    "jax_include_full_tracebacks",
    "jax_debug_log",
    "jax_pprint",
    "jax_explain",
)
"""Beginnings of the names of JAX's options that change messages and files alone."""
NEED_TRACING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks", "jax_no_tracing")
"""JAX's options under which a call goes the way that JAX goes."""


class _Program:
    """The program of one signature, which one thread finds or compiles while others wait."""

    def __init__(self):
        self.lock = threading.RLock()
        self.run: Callable | None = None
        self.is_known = False


class Programs:
    """The programs of one function, by the signature of the call."""

    def __init__(self, fun: Callable, static_argnums: int | tuple = (), static_argnames: str | tuple = ()):
        """**Arguments:** as of `jax.jit`."""
        self.fun = fun
        names = [] if not (static_argnums or static_argnames) else list(inspect.signature(fun).parameters)
        numbers = (static_argnums,) if isinstance(static_argnums, int) else tuple(static_argnums)
        by_name = {static_argnames} if isinstance(static_argnames, str) else set(static_argnames)
        # as in JAX, an argument that is static by number is static by name, too
        self.static_names = by_name | {names[number] for number in numbers}
        self.static_numbers = set(numbers) | {k for k, name in enumerate(names) if name in by_name}
        self.found: dict[object, _Program] = {}
        _ALL.add(self)

    def __call__(self, form: str, jitted: Callable[[], Callable], args: tuple, options: dict[str, object]) -> PyTree:
        """Return the function's result, by a program that is kept where it can be.

        **Arguments:** `form`: what a program depends on besides its signature; `jitted`: makes the function as
        `jax.jit` returns it.
        """
        folder = kept_folder()
        if folder is None:
            return jitted()(*args, **options)
        static, dynamic, named = self._split(args, options)
        leaves, tree = jax.tree.flatten((dynamic, named))
        try:
            signature = (form, static, tree, tuple(map(_kind, leaves)), _context())
            program = self.found.get(signature) or self.found.setdefault(signature, _Program())
        except (TypeError, AttributeError):
            # static arguments that have no hash, of which JAX tells; or a JAX without the names used here
            return jitted()(*args, **options)
        # which is free but at the first call
        with program.lock:
            if not program.is_known:
                path = self._path(folder, (form, static, tree), leaves)
                if path is not None:
                    call = lambda run: jax.block_until_ready(run(*dynamic, **named))
                    lowered = lambda: jitted().lower(*args, **options)
                    program.run, result = _first(path, tree, lowered, call)
                    program.is_known = True
                    return result
                program.is_known = True
        return jitted()(*args, **options) if program.run is None else program.run(*dynamic, **named)

    def _split(self, args: tuple, options: dict[str, object]) -> tuple[tuple, tuple, dict[str, object]]:
        """Return static arguments by place and by name, and the others."""
        if not self.static_numbers and not self.static_names:
            return (), args, options
        static = tuple(
            # 1, 1.0 and True are equal
            [(k, type(value), value) for k, value in enumerate(args) if k in self.static_numbers]
            + [(name, type(value), value) for name, value in sorted(options.items()) if name in self.static_names]
        )
        dynamic = tuple(value for k, value in enumerate(args) if k not in self.static_numbers)
        return static, dynamic, {name: value for name, value in options.items() if name not in self.static_names}

    def _path(self, folder: Path, parts: tuple, leaves: list) -> Path | None:
        """Return the file of a program; None where it cannot be told from others, or where JAX must trace it.

        **Arguments:** `parts`: of the signature besides its arrays.
        """
        if not all(_is_simple(leaf) for leaf in leaves) or jax.process_count() > 1:
            return None
        options = _options()
        if any(options.get(name) for name in NEED_TRACING):
            return None
        try:
            # such as ~float64[3], where ~ is a weak type
            kinds = [str(jax.typeof(leaf)) for leaf in leaves]
        except TypeError:
            # what JAX does not take, of which it tells in its own words
            return None
        texts = {name: repr(value) for name, value in options.items()}
        digest = stable_digest((_environment(), self.fun, *parts, kinds, texts))
        return None if digest is None else folder / f"{digest[:32]}{WHOLE}"


_ALL: weakref.WeakSet[Programs] = weakref.WeakSet()


def forget() -> None:
    """Let the programs of this process go, as `jax.clear_caches` does; those on disk stay."""
    for programs in list(_ALL):
        programs.found.clear()


def own_name(name: str) -> str:
    """Return the name under which a program goes to XLA, by which JAX's cache finds it.

    What comes out of JAX's cache has lost what it takes to be kept whole. Where the cache was switched on by this
    package, another source of the package asks it for other programs.
    """
    folder = kept_folder()
    is_ours = folder is not None and jax.config.jax_compilation_cache_dir == str(folder)  # type: ignore[attr-defined]
    return f"{name}_{IMPORTED}" if is_ours else name


def _first(
    path: Path, tree: Any, lowered: Callable[[], jax.stages.Lowered], call: Callable[[Callable], PyTree]
) -> tuple[Callable, PyTree]:
    """Return a program and its first result: that of the disk, or else one that is compiled and kept.

    Only a program that has been read back and has run is kept, and one of the disk that does not run is replaced:
    what comes out of JAX's cache, for one, cannot be written again, which shows when it runs.
    """
    found = _tried(_read(path), tree, call)
    if found is not None:
        with suppress(OSError):
            os.utime(path)  # the longest unused ones go first
        return found
    compiled = lowered().compile()
    content = _written(compiled)
    found = _tried(content, tree, call)
    if found is None:
        return compiled, call(compiled)
    # a full disk, for one
    with suppress(OSError):
        write_whole(path, hashlib.sha256(content).digest() + content)
    return found


def _tried(content: bytes, tree: Any, call: Callable[[Callable], PyTree]) -> tuple[Callable, PyTree] | None:
    """Return the program that is made of some bytes, and its result; None where it is none, or does not run."""
    if content:
        with suppress(Exception):
            from jax.experimental.serialize_executable import deserialize_and_load  # here, because it may vanish

            silence_loader()
            program, example, calls_lapack = pickle.loads(content)
            if calls_lapack:
                from jaxlib import lapack

                # JAX fetches LAPACK where it lowers a program; without it, a program that is read calls an address 0
                lapack.prepare_lapack_call("getrf_ffi", np.float64)
            run = deserialize_and_load(
                program,
                tree,
                jax.tree.structure(example),
                execution_devices=[_device()],
            )
            return run, call(run)
    return None


def _written(compiled: jax.stages.Compiled) -> bytes:
    """Return a program as bytes; none of one that cannot be written.

    Such as one that calls back into Python, and one with results of classes that nobody can import.
    """
    with suppress(Exception):
        from jax.experimental.serialize_executable import serialize

        program, _, out = serialize(compiled)
        # a tree of modules is kept by an example, which is pickled by the names of its classes
        example = jax.tree.unflatten(out, [0] * out.num_leaves)
        return pickle.dumps((program, example, "lapack" in (compiled.as_text() or "")))
    return b""


def _read(path: Path) -> bytes:
    """Return the bytes of a file; none where there is no file, and where it is damaged or not the user's."""
    with suppress(OSError), open(path, "rb") as file:
        if hasattr(os, "getuid") and os.fstat(file.fileno()).st_uid != os.getuid():
            return b""
        digest = file.read(32)
        content = file.read()
        if hashlib.sha256(content).digest() == digest:
            return content
    return b""


def _kind(leaf: object) -> object:
    """Return what a program takes an argument for, in this process."""
    if isinstance(leaf, jax.Array):
        return leaf.aval, leaf.sharding
    return type(leaf), getattr(leaf, "shape", None), getattr(leaf, "dtype", None)


@cache
def _names() -> tuple[str, ...]:
    """Return the names of JAX's options that may change a program, and that a context may change."""
    return tuple(name for name in jax.config.values if _counts(name) and hasattr(jax.config, name))


@cache
def _reader() -> attrgetter:
    """Return what reads these options in one call: each call of a program reads them."""
    return attrgetter(*_names())


def _context() -> tuple:
    """Return what tells one state of JAX's options from another in this process."""
    return _reader()(jax.config)


def _options() -> dict[str, object]:
    """Return the values in this thread of all options of JAX that may change a program."""
    fixed = {name: value for name, value in jax.config.values.items() if _counts(name)}
    return fixed | dict(zip(_names(), _context(), strict=True))


def _counts(name: str) -> bool:
    return not name.startswith(CHANGE_NO_PROGRAM)


@cache
def _environment() -> tuple[str, ...]:
    """Return what programs depend on that does not change while a process runs."""
    versions = [importlib.metadata.version(name) for name in COMPUTING]
    device = _device()
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "LIBTPU_INIT_ARGS")]
    kind = (device.platform, device.device_kind, str(jax.device_count()), str(device.id))
    return (sys.version, *versions, IMPORTED, np.dtype(np.intp).str, *kind, *flags)


def _device() -> Any:
    """Return the device on which JAX computes where it is not told one."""
    chosen = jax.config.jax_default_device  # type: ignore[attr-defined]
    return chosen if isinstance(chosen, jax.Device) else jax.devices(chosen)[0]


def _is_simple(leaf: object) -> bool:
    """Tell whether an argument is where JAX computes: on one device, and there in its usual memory."""
    if not isinstance(leaf, jax.Array):
        return True
    usual = jax.sharding.SingleDeviceSharding(_device())
    return isinstance(leaf.sharding, jax.sharding.SingleDeviceSharding) and leaf.sharding == usual
