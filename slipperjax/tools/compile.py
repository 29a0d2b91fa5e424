"""Compiling: `jax.jit` with compiler options, at the top level and inside other transformations."""

import functools
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar, copy_context

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state
from jaxtyping import ArrayLike, PyTree

# A new thread is outside of all transformations, even where this module is imported inside one.
with ThreadPoolExecutor(1) as _pool:
    _TOP_LEVEL = _pool.submit(get_opaque_trace_state).result()


class CompileNotices:
    """Notices, for the progress bar of a run, that programs which step through time are being compiled."""

    def __init__(self, expected: int, show: Callable[[str], None]):
        """**Arguments:** `expected`: number of programs; `show`: is called with each text, and at the end with ""."""
        self.expected = expected
        self.show = show
        self.begun = 0
        self.threads: set[int] = set()
        self.lock = threading.Lock()

    def begin(self) -> None:
        """Show that this thread compiles a program; further calls before its `end` change nothing."""
        thread = threading.get_ident()
        # several threads compile at once
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
    """Show on the run's progress bar that a program which steps through time is being traced."""
    notices = NOTICES.get()
    if notices is not None and is_transformed():
        notices.begin()


def ahead(call: Callable[[], object]) -> None:
    """Call a function on a thread of its own, so that its program is compiled while other work goes on.

    Errors are ignored here: the call that needs the program meets them again.
    """

    def compiled() -> None:
        with suppress(Exception):
            call()

    # with the context variables of this thread, such as the notices
    threading.Thread(target=copy_context().run, args=(compiled,)).start()


def compiler_options(backend: str | None = None) -> dict[str, bool]:
    """Return XLA's options for a backend, by default the one in use: some for CPUs, none for others."""
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


def jit(fun: Callable, **kwargs: object) -> Callable:
    """Return `jax.jit` of a function with `compiler_options` of the backend in use.

    JAX accepts compiler options for the outermost program only. Inside another transformation (jit, grad, vmap, ...)
    this is a plain `jax.jit`.

    **Arguments:** `fun`, `kwargs`: as for `jax.jit`.

    **Raises:** `ValueError` at a call, if JAX runs with 32-bit numbers.
    """
    traced = with_standard_promotion(fun)
    inner = jax.jit(traced, **kwargs)

    # made at the first call, because asking for the backend at import would fix which one is used
    @functools.cache
    def outermost(backend: str) -> Callable:
        return jax.jit(traced, compiler_options=compiler_options(backend), **kwargs)

    @functools.wraps(fun)
    def call(*args: object, **options: object) -> PyTree:
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
"""`jax.jit` of a function of a few operations: called on its own, these are one small program, not one each; inside
another program they are a part of it."""


def with_standard_promotion(fun: Callable) -> Callable:
    """Return a function inside which JAX promotes types as by default, even where the user asks it to be strict."""

    @functools.wraps(fun)
    def call(*args: object, **options: object) -> PyTree:
        with jax.numpy_dtype_promotion("standard"):
            return fun(*args, **options)

    return call


def as_argument(value: ArrayLike) -> jax.Array:
    """Return an array of 64-bit numbers; one that is not traced is made by NumPy, without compiling a program."""
    return jnp.asarray(value, float) if is_traced(value) else jnp.asarray(np.asarray(value, float))


def need_64_bits() -> None:
    """Raise `ValueError` if JAX runs with 32-bit numbers.

    They are too few for the phase epoch + t, and for penetrations of micrometres beside metres.
    """
    if not jax.config.jax_enable_x64:
        raise ValueError("Option `jax_enable_x64` must be on, as slipperjax sets it on import, but is off.")


def is_transformed() -> bool:
    """Tell whether the call is inside a JAX transformation, even if none of its arguments is a tracer."""
    return get_opaque_trace_state() != _TOP_LEVEL


def is_traced(tree: PyTree) -> bool:
    """Tell whether any leaf is a tracer: a value that is not known before the program runs."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def split_arrays(fun: Callable, args: tuple) -> tuple[Callable[[PyTree], PyTree], PyTree]:
    """Split `fun(*args)` into a function of arrays alone, and the pytree of the arrays in `fun` and `args`."""
    arrays, others = eqx.partition((fun, args), eqx.is_array)

    def call(arrays: PyTree) -> PyTree:
        fun, args = eqx.combine(arrays, others)
        return fun(*args)

    return call, arrays


def call_compiled(fun: Callable, functions: PyTree, static: tuple, *arrays: PyTree) -> PyTree:
    """Call `fun(functions, static, *arrays)`, compiled; inside another transformation it is a part of that program.

    **Arguments:** `functions`: a pytree of callables, such as `equinox.Module`s, whose array leaves become arguments
    of the compiled program, so that new values need no compilation. `static`: hashable; each new value is compiled
    anew. `arrays`: pytrees of arrays.
    """
    numbers, others = eqx.partition(functions, lambda leaf: isinstance(leaf, jax.Array | np.ndarray))
    leaves, structure = jax.tree.flatten(others)
    return _call(fun, tuple(leaves), structure, static, numbers, arrays)


@functools.partial(jit, static_argnums=(0, 1, 2, 3))
def _call(fun, leaves, structure, static, numbers, arrays):
    functions = eqx.combine(numbers, jax.tree.unflatten(structure, leaves))
    return fun(functions, static, *arrays)
