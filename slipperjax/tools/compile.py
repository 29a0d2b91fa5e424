"""Compiling: `jax.jit` with compiler options, at the top level and inside other transformations."""

import functools
import os
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar, copy_context
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state

with ThreadPoolExecutor(1) as _pool:  # whose state is that outside of transformations, wherever the import is
    _TOP_LEVEL = _pool.submit(get_opaque_trace_state).result()
_CPU_OPTIONS = {
    # Lets LLVM reassociate the sum over the contact points, which vectorises it. The other four options preserve
    # NaN, infinity, division and square root.
    "xla_cpu_enable_fast_math": True,
    "xla_cpu_fast_math_honor_nans": True,
    "xla_cpu_fast_math_honor_infs": True,
    "xla_cpu_fast_math_honor_division": True,
    "xla_cpu_fast_math_honor_functions": True,
    # Batches are too small for one kernel to gain from several threads; chunks of the batch use the cores instead.
    "xla_cpu_multi_thread_eigen": False,
}
COMPILER_OPTIONS: dict[str, dict[str, Any]] = {"cpu": _CPU_OPTIONS}
"""XLA options by backend; a backend that is not listed gets XLA's defaults."""


EFFORTS: dict[str, dict[str, Any]] = {"many": {}, "few": {"xla_backend_optimization_level": 0}}
"""XLA options by the calls that a program is made for."""


def ahead(call: Callable[[], Any]) -> None:
    """Calls a function on a thread of its own, for the program that it compiles, while other work goes on.

    What goes wrong there is met by the call that needs the program.
    """

    def compiled() -> None:
        with suppress(Exception):
            call()

    threading.Thread(target=copy_context().run, args=(compiled,)).start()


class Programs:
    """The programs that step through time which a run compiles, and a function that is told which one it is at."""

    def __init__(self, expected: int, tell: Callable[[str], None]):
        """**Arguments:** `expected`: how many there will be; `tell`: gets a text, empty where none is compiled."""
        self.expected, self.tell = expected, tell
        self.begun = 0
        self.open: set[object] = set()  # the calls that compile one now
        self.lock = threading.Lock()

    def begin(self, call: object) -> None:
        """Notes that a call compiles a program; also where it says so twice."""
        with self.lock:
            if call not in self.open:
                self.open.add(call)
                self.begun += 1
                self.tell(f"compiling {self.begun} of {max(self.begun, self.expected)}")

    def end(self, call: object) -> None:
        """Notes that a call has returned."""
        with self.lock:
            if call in self.open:
                self.open.remove(call)
                if not self.open:
                    self.tell("")


PROGRAMS: ContextVar[Programs | None] = ContextVar("PROGRAMS", default=None)
"""The programs of this run, where somebody is told of them."""
_CALL: ContextVar[object] = ContextVar("_CALL", default=None)


def say_compiling() -> None:
    """Says that the program which is traced now is one that steps through time."""
    programs, call = PROGRAMS.get(), _CALL.get()
    if programs is not None and call is not None:
        programs.begin(call)


def _told(compiled: Callable, args: tuple, options: dict[str, Any], programs: Programs) -> Any:
    """Calls a compiled function, during which `programs` learns what is compiled."""
    call = object()
    token = _CALL.set(call)
    try:
        return compiled(*args, **options)
    finally:
        _CALL.reset(token)
        programs.end(call)


def compiler_options(backend: str | None = None, effort: str = "many") -> dict[str, Any]:
    """Gives the XLA options for a backend, by default the one that JAX uses now, and for an effort, see `jit`."""
    _check_effort(effort)
    options = COMPILER_OPTIONS.get(jax.default_backend() if backend is None else backend, {})
    return options | EFFORTS[effort] if options else {}


def _check_effort(effort: Any) -> None:
    if effort not in EFFORTS:
        raise ValueError(f"Argument `effort` must be one of {', '.join(EFFORTS)}, but is {effort!r}.")


def jit(fun: Callable, *, effort: str = "many", **kwargs: Any) -> Callable:
    """Makes `jax.jit` of a function with `compiler_options` of the backend in use.

    JAX accepts compiler options for the outermost program only. Inside another transformation (jit, grad, vmap, ...)
    this is a plain `jax.jit`.

    **Arguments:** `fun`, `kwargs`: as for `jax.jit`; `effort`: how many calls the program is made for, "many", or
    "few", for which it is compiled in 0.6 of the time and runs six times as long.

    **Raises:** `ValueError` for an unknown effort; at a call, if JAX runs with 32-bit numbers.
    """
    _check_effort(effort)  # alone: the import leaves the choice of a backend open
    traced = with_standard_promotion(fun)
    inner = jax.jit(traced, **kwargs)

    @functools.cache
    def outermost(backend: str) -> Callable:
        return jax.jit(traced, compiler_options=compiler_options(backend, effort), **kwargs)

    @functools.wraps(fun)
    def call(*args: Any, **options: Any) -> Any:
        need_64_bits()
        if is_transformed():
            return inner(*args, **options)
        compiled, programs = outermost(jax.default_backend()), PROGRAMS.get()
        return compiled(*args, **options) if programs is None else _told(compiled, args, options, programs)

    return call


at_once = functools.partial(jax.jit, inline=True)
"""`jax.jit` of a function of some operations: called on its own it is one small program, instead of one for each of
them; elsewhere they are a part of the program that calls it."""


def with_standard_promotion(fun: Callable) -> Callable:
    """Makes a function within which JAX promotes types as by default, where the user's own code is to be strict."""

    @functools.wraps(fun)
    def call(*args: Any, **options: Any) -> Any:
        with jax.numpy_dtype_promotion("standard"):
            return fun(*args, **options)

    return call


def as_argument(value: Any) -> jax.Array:
    """Makes an array of a number, which may be traced; nothing is compiled for it."""
    return jnp.asarray(value, float) if is_traced(value) else jnp.asarray(np.asarray(value, float))


def warn_if_told_otherwise() -> None:
    """Gives a warning where the environment asks for 32-bit numbers, which no part of this package can do with."""
    asked = os.environ.get("JAX_ENABLE_X64")
    if asked is not None and asked.lower() in ("0", "f", "false", "n", "no", "off"):
        warnings.warn(
            f"JAX_ENABLE_X64={asked} has no effect: slipperjax needs 64-bit numbers and turns them on for the whole "
            "process, so that arrays of other code are of 64 bits, too, where it gives no type.",
            stacklevel=3,
        )


def need_64_bits() -> None:
    """Raises `ValueError` if JAX runs with 32-bit numbers.

    They are too few for the phase epoch + t, and for penetrations of micrometres beside metres.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise ValueError("Option `jax_enable_x64` must be on, as slipperjax sets it on import, but is off.")


def is_transformed() -> bool:
    """Tells whether the call is inside a JAX transformation, also one of which no argument is a tracer."""
    return get_opaque_trace_state() != _TOP_LEVEL


def is_traced(tree: Any) -> bool:
    """Tells whether any leaf is a tracer, that is, whether the call is inside a JAX transformation."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def split_arrays(fun: Callable, args: tuple) -> tuple[Callable[[Any], Any], Any]:
    """Gives a function of the arrays in `fun` and `args` alone that calls `fun(*args)`, and these, a pytree."""
    arrays, others = eqx.partition((fun, args), eqx.is_array)

    def call(arrays: Any) -> Any:
        fun, args = eqx.combine(arrays, others)
        return fun(*args)

    return call, arrays


def call_compiled(fun: Callable, functions: Any, static: tuple, *arrays: Any) -> Any:
    """Calls `fun(functions, static, *arrays)`, compiled; inside another transformation it is a part of that program.

    **Arguments:** `functions`: a pytree of callables, such as `equinox.Module`s, whose array leaves become arguments
    of the compiled program, so that new values need no compilation. `static`: hashable; a new value is compiled
    again. `arrays`: pytrees of arrays.
    """
    numbers, others = eqx.partition(functions, lambda leaf: isinstance(leaf, jax.Array | np.ndarray))
    leaves, structure = jax.tree.flatten(others)
    return _call(fun, tuple(leaves), structure, static, numbers, arrays)


def _call_uncompiled(fun, leaves, structure, static, numbers, arrays):
    return fun(eqx.combine(numbers, jax.tree.unflatten(structure, leaves)), static, *arrays)


_call = jit(_call_uncompiled, static_argnums=(0, 1, 2, 3))
