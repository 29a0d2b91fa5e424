"""Programs that are kept whole: a call finds its program on disk by the call's arguments, before JAX traces.

JAX's own cache of compiled programs saves only the work of XLA, because JAX must trace and lower a program first.
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
"""Beginnings of the names of those options of JAX that change only messages and files."""
NEED_TRACING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks", "jax_no_tracing")
"""Options of JAX under which JAX handles a call without kept programs."""


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
        numbers = (static_argnums,) if isinstance(static_argnums, int) else static_argnums
        names = (static_argnames,) if isinstance(static_argnames, str) else static_argnames
        parameters = enumerate(inspect.signature(fun).parameters) if numbers or names else ()
        # as in JAX, an argument that is static by its number is also static by its name
        self.static = {key for both in parameters if both[0] in numbers or both[1] in names for key in both}
        """Numbers and names of the static arguments."""
        self.found: dict[object, _Program] = {}
        _ALL.add(self)

    def __call__(self, form: str, jitted: Callable[[], Callable], args: tuple, options: dict[str, object]) -> PyTree:
        """Return the function's result, from a kept program where there can be one.

        **Arguments:** `form`: what a program depends on in addition to its signature; `jitted`: makes the function as
        `jax.jit` returns it.
        """
        folder = kept_folder()
        if folder is None:
            return jitted()(*args, **options)
        static, dynamic, named = self._split(args, options)
        leaves, tree = jax.tree.flatten((dynamic, named))
        try:
            signature = (form, static, tree, tuple(map(_kind, leaves)), _reader()(jax.config))
            program = self.found.get(signature) or self.found.setdefault(signature, _Program())
        except (TypeError, AttributeError):
            # static arguments without a hash, for which JAX raises an error; or a JAX without the names used here
            return jitted()(*args, **options)
        # the lock is free after the first call
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
        if not self.static:
            return (), args, options
        given = (*enumerate(args), *sorted(options.items()))
        # 1, 1.0 and True are equal
        static = tuple((key, type(value), value) for key, value in given if key in self.static)
        dynamic = tuple(value for k, value in enumerate(args) if k not in self.static)
        return static, dynamic, {name: value for name, value in options.items() if name not in self.static}

    def _path(self, folder: Path, parts: tuple, leaves: list) -> Path | None:
        """Return the file of a program; None where the program cannot be identified, or where JAX must trace it.

        **Arguments:** `parts`: parts of the signature other than its arrays.
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
            # values that JAX does not take, for which JAX raises its own error
            return None
        texts = {name: repr(value) for name, value in options.items()}
        digest = stable_digest((_environment(), self.fun, *parts, kinds, texts))
        return None if digest is None else folder / f"{digest[:32]}{WHOLE}"


_ALL: weakref.WeakSet[Programs] = weakref.WeakSet()


def forget() -> None:
    """Forget the programs of this process, as `jax.clear_caches` does; programs on disk stay."""
    for programs in list(_ALL):
        programs.found.clear()


def own_name(name: str) -> str:
    """Return the name under which a program goes to XLA, and by which JAX's cache finds it.

    A program from JAX's cache cannot be kept whole. Therefore, where this package switched the cache on, the name
    depends on the package's source, so that a changed source finds no program of the former source there.
    """
    folder = kept_folder()
    is_ours = folder is not None and jax.config.jax_compilation_cache_dir == str(folder)  # type: ignore[attr-defined]
    return f"{name}_{IMPORTED}" if is_ours else name


def _first(
    path: Path, tree: Any, lowered: Callable[[], jax.stages.Lowered], call: Callable[[Callable], PyTree]
) -> tuple[Callable, PyTree]:
    """Return a program and its first result: a program from disk, or else one that is compiled and kept.

    A program is kept only after it was read back and has run, and a program from disk that does not run is replaced.
    For example, a program from JAX's cache cannot be written again, and fails only when it runs.
    """
    found = _tried(_read(path), tree, call)
    if found is not None:
        with suppress(OSError):
            os.utime(path)  # pruning deletes the programs that were unused for longest
        return found
    compiled = lowered().compile()
    content = _written(compiled)
    found = _tried(content, tree, call)
    if found is None:
        return compiled, call(compiled)
    # such as a full disk
    with suppress(OSError):
        write_whole(path, hashlib.sha256(content).digest() + content)
    return found


def _tried(content: bytes, tree: Any, call: Callable[[Callable], PyTree]) -> tuple[Callable, PyTree] | None:
    """Return the program of some bytes, and its result; None where there is no program, or it does not run."""
    if content:
        with suppress(Exception):
            from jax.experimental.serialize_executable import deserialize_and_load  # here, because it may vanish

            silence_loader()
            program, example, calls_lapack = pickle.loads(content)
            if calls_lapack:
                from jaxlib import lapack

                # JAX loads LAPACK when it lowers a program; without this, a program that is read calls the address 0
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
    """Return a program as bytes; no bytes for a program that cannot be written.

    Examples: a program that calls Python, and a program whose results have classes that nobody can import.
    """
    with suppress(Exception):
        from jax.experimental.serialize_executable import serialize

        program, _, out = serialize(compiled)
        # a tree of modules is kept by an example, which pickle stores by the names of its classes
        example = jax.tree.unflatten(out, [0] * out.num_leaves)
        return pickle.dumps((program, example, "lapack" in (compiled.as_text() or "")))
    return b""


def _read(path: Path) -> bytes:
    """Return the bytes of a file; none where there is no file, and where it is damaged or belongs to another user."""
    with suppress(OSError), open(path, "rb") as file:
        if hasattr(os, "getuid") and os.fstat(file.fileno()).st_uid != os.getuid():
            return b""
        digest = file.read(32)
        content = file.read()
        if hashlib.sha256(content).digest() == digest:
            return content
    return b""


def _kind(leaf: object) -> object:
    """Return the kind of argument that a program takes this argument for, in this process."""
    if isinstance(leaf, jax.Array):
        return leaf.aval, leaf.sharding
    return type(leaf), getattr(leaf, "shape", None), getattr(leaf, "dtype", None)


@cache
def _reader() -> attrgetter:
    """Return a function that reads, in one call, the options of JAX that may change a program and that a context may
    change, because each call of a program reads them."""
    return attrgetter(*(name for name in _options() if hasattr(jax.config, name)))


def _options() -> dict[str, object]:
    """Return this thread's values of all options of JAX that may change a program."""
    # options that no context may change are no attributes
    options = {name: getattr(jax.config, name, value) for name, value in jax.config.values.items()}
    return {name: value for name, value in options.items() if not name.startswith(CHANGE_NO_PROGRAM)}


@cache
def _environment() -> tuple[str, ...]:
    """Return values on which programs depend and that are constant while a process runs."""
    versions = [importlib.metadata.version(name) for name in COMPUTING]
    device = _device()
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "LIBTPU_INIT_ARGS")]
    kind = (device.platform, device.device_kind, str(jax.device_count()), str(device.id))
    return (sys.version, *versions, IMPORTED, np.dtype(np.intp).str, *kind, *flags)


def _device() -> Any:
    """Return the device on which JAX computes by default."""
    chosen = jax.config.jax_default_device  # type: ignore[attr-defined]
    return chosen if isinstance(chosen, jax.Device) else jax.devices(chosen)[0]


def _is_simple(leaf: object) -> bool:
    """Return whether an argument is where JAX computes: on one device, and there in the usual memory."""
    if not isinstance(leaf, jax.Array):
        return True
    usual = jax.sharding.SingleDeviceSharding(_device())
    return isinstance(leaf.sharding, jax.sharding.SingleDeviceSharding) and leaf.sharding == usual
