"""Compiling: `jax.jit` with compiler options, at the top level and inside other transformations."""

import functools
import threading
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

# a new thread is outside of transformations, also where the import is inside one
with ThreadPoolExecutor(1) as _pool:
    _TOP_LEVEL = _pool.submit(get_opaque_trace_state).result()


class CompileNotices:
    """Notices that a program which steps through time is compiled, for the progress bar of a run."""

    def __init__(self, expected: int, show: Callable[[str], None]):
        """**Arguments:** `expected`: how many programs there will be; `show`: gets the text, empty after the last."""
        self.expected = expected
        self.show = show
        self.begun = 0
        self.threads: set[int] = set()
        self.lock = threading.Lock()

    def begin(self) -> None:
        """Show that this thread compiles a program; calls after the first one change nothing until `end`."""
        thread = threading.get_ident()
        with self.lock:
            if thread not in self.threads:
                self.threads.add(thread)
                self.begun += 1
                self.show(f"compiling {self.begun} of {max(self.begun, self.expected)}")

    def end(self) -> None:
        """Note that this thread runs a program, or has failed to compile it."""
        thread = threading.get_ident()
        with self.lock:
            if thread in self.threads:
                self.threads.remove(thread)
                if not self.threads:
                    self.show("")


NOTICES: ContextVar[CompileNotices | None] = ContextVar("NOTICES", default=None)
"""Notices of the run in progress; None where no bar is shown."""


def note_compiling() -> None:
    """Note that the program which is traced now steps through time."""
    notices = NOTICES.get()
    if notices is not None and is_transformed():
        notices.begin()


def ahead(call: Callable[[], Any]) -> None:
    """Call a function on a thread of its own, for the program that it compiles, while other work goes on.

    The call that needs the program meets the errors.
    """

    def compiled() -> None:
        with suppress(Exception):
            call()

    threading.Thread(target=copy_context().run, args=(compiled,)).start()


def compiler_options(backend: str | None = None) -> dict[str, Any]:
    """Return XLA's options for a backend, by default the one in use; none but for CPUs."""
    if (backend or jax.default_backend()) != "cpu":
        return {}
    return {
        # Lets LLVM reassociate the sum over the contact points, which vectorises it. The other four options preserve
        # NaN, infinity, division and square root.
        "xla_cpu_enable_fast_math": True,
        "xla_cpu_fast_math_honor_nans": True,
        "xla_cpu_fast_math_honor_infs": True,
        "xla_cpu_fast_math_honor_division": True,
        "xla_cpu_fast_math_honor_functions": True,
        # Batches are too small for one kernel to gain from several threads; chunks of the batch use the cores.
        "xla_cpu_multi_thread_eigen": False,
    }


def jit(fun: Callable, **kwargs: Any) -> Callable:
    """Return `jax.jit` of a function with `compiler_options` of the backend in use.

    JAX accepts compiler options for the outermost program only. Inside another transformation (jit, grad, vmap, ...)
    this is a plain `jax.jit`.

    **Arguments:** `fun`, `kwargs`: as for `jax.jit`.

    **Raises:** `ValueError` at a call, if JAX runs with 32-bit numbers.
    """
    traced = with_standard_promotion(fun)
    inner = jax.jit(traced, **kwargs)

    # made at the first call: the import leaves the choice of a backend open
    @functools.cache
    def outermost(backend: str) -> Callable:
        return jax.jit(traced, compiler_options=compiler_options(backend), **kwargs)

    @functools.wraps(fun)
    def call(*args: Any, **options: Any) -> Any:
        need_64_bits()
        if is_transformed():
            return inner(*args, **options)
        try:
            return outermost(jax.default_backend())(*args, **options)
        finally:
            if (notices := NOTICES.get()) is not None:
                notices.end()

    return call


at_once = functools.partial(jax.jit, inline=True)
"""`jax.jit` of a function of some operations: called on its own it is one small program, instead of one for each of
them; elsewhere they are a part of the program that calls it."""


def with_standard_promotion(fun: Callable) -> Callable:
    """Return a function within which JAX promotes types as by default, where the user's own code is to be strict."""

    @functools.wraps(fun)
    def call(*args: Any, **options: Any) -> Any:
        with jax.numpy_dtype_promotion("standard"):
            return fun(*args, **options)

    return call


def as_argument(value: Any) -> jax.Array:
    """Return an array of a number, which may be traced; nothing is compiled for it."""
    return jnp.asarray(value, float) if is_traced(value) else jnp.asarray(np.asarray(value, float))


def need_64_bits() -> None:
    """Raise `ValueError` if JAX runs with 32-bit numbers.

    They are too few for the phase epoch + t, and for penetrations of micrometres beside metres.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise ValueError("Option `jax_enable_x64` must be on, as slipperjax sets it on import, but is off.")


def is_transformed() -> bool:
    """Tell whether the call is inside a JAX transformation, also one of which no argument is a tracer."""
    return get_opaque_trace_state() != _TOP_LEVEL


def is_traced(tree: Any) -> bool:
    """Tell whether any leaf is a tracer, that is, whether the call is inside a JAX transformation."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def split_arrays(fun: Callable, args: tuple) -> tuple[Callable[[Any], Any], Any]:
    """Return a function of the arrays in `fun` and `args` alone that calls `fun(*args)`, and these, a pytree."""
    arrays, others = eqx.partition((fun, args), eqx.is_array)

    def call(arrays: Any) -> Any:
        fun, args = eqx.combine(arrays, others)
        return fun(*args)

    return call, arrays


def call_compiled(fun: Callable, functions: Any, static: tuple, *arrays: Any) -> Any:
    """Call `fun(functions, static, *arrays)`, compiled; inside another transformation it is a part of that program.

    **Arguments:** `functions`: a pytree of callables, such as `equinox.Module`s, whose array leaves become arguments
    of the compiled program, so that new values need no compilation. `static`: hashable; a new value is compiled
    again. `arrays`: pytrees of arrays.
    """
    numbers, others = eqx.partition(functions, lambda leaf: isinstance(leaf, jax.Array | np.ndarray))
    leaves, structure = jax.tree.flatten(others)
    return _call(fun, tuple(leaves), structure, static, numbers, arrays)


@functools.partial(jit, static_argnums=(0, 1, 2, 3))
def _call(fun, leaves, structure, static, numbers, arrays):
    functions = eqx.combine(numbers, jax.tree.unflatten(structure, leaves))
    return fun(functions, static, *arrays)
