"""Compiling: `jax.jit` with compiler options, at the top level and inside other transformations."""

import functools
import threading
from collections.abc import Callable
from contextlib import suppress
from contextvars import copy_context
from weakref import WeakKeyDictionary

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, PyTree

from .forms import compiler_options, fall_back, is_plain
from .kept import Programs, own_name
from .notices import NOTICES
from .tracing import is_traced, is_transformed


def ahead(call: Callable[[], object]) -> threading.Thread:
    """Call a function on a thread of its own, so that its program compiles while other work continues.

    Errors are ignored here, because the call that needs the program raises them again.

    **Returns:** the thread, which is running.
    """

    def compiled() -> None:
        with suppress(Exception):
            call()

    # the thread gets the context variables of this thread, such as the notices
    thread = threading.Thread(target=copy_context().run, args=(compiled,))
    thread.start()
    return thread


def jit(fun: Callable, **kwargs: object) -> Callable:
    """Return `jax.jit` of a function, with `compiler_options` of the backend in use; its programs are kept on disk.

    JAX accepts compiler options for the outermost program only. Inside another transformation (jit, grad, vmap, ...)
    this is a plain `jax.jit`.

    **Arguments:** `fun`, `kwargs`: as for `jax.jit`. Programs are kept where `kwargs` name static arguments alone.

    **Raises:** `ValueError` at a call, if JAX runs with 32-bit numbers.
    """
    traced = with_standard_promotion(fun)
    inner = jax.jit(traced, **kwargs)

    # Made at the first call, because asking for the backend at import would fix the backend. One for each form,
    # because options and name differ.
    @functools.cache
    def outermost(backend: str, plain: bool, name: str) -> Callable:
        named = with_standard_promotion(fun)
        named.__name__ = name
        return jax.jit(named, compiler_options=compiler_options(backend), **kwargs)

    can_keep = not set(kwargs) - {"static_argnums", "static_argnames"}

    @functools.wraps(fun)
    def call(*args: object, **options: object) -> PyTree:
        need_64_bits()
        if is_transformed():
            return inner(*args, **options)

        def compiled() -> PyTree:
            plain = is_plain()
            jitted = lambda: outermost(jax.default_backend(), plain, own_name(traced.__name__))
            if not can_keep:
                return jitted()(*args, **options)
            programs = PROGRAMS.get(call)
            if programs is None:
                programs = PROGRAMS.setdefault(call, Programs(fun, **kwargs))
            return programs("plain" if plain else "fast", jitted, args, options)

        try:
            return compiled()
        except (jax.errors.JaxRuntimeError, NotImplementedError) as error:
            # other errors of XLA, such as too little memory, do not depend on the form
            has_no_code = isinstance(error, NotImplementedError) or str(error).startswith("UNIMPLEMENTED")
            if not has_no_code or not fall_back(error):
                raise
            return compiled()
        finally:
            if (notices := NOTICES.get()) is not None:
                notices.end()

    return call


PROGRAMS: WeakKeyDictionary[Callable, Programs] = WeakKeyDictionary()
"""Programs of each function that `jit` returned. They are kept here, and not as its variables, because variables are
part of a function's digest."""


at_once = functools.partial(jax.jit, inline=True)
"""`jax.jit` of a function of a few operations. A call of its own is one small program, not one program per
operation; inside another program the operations are a part of it."""


def with_standard_promotion(fun: Callable) -> Callable:
    """Return a function inside which JAX promotes types as by default, even where the user has made JAX strict."""

    @functools.wraps(fun)
    def call(*args: object, **options: object) -> PyTree:
        with jax.numpy_dtype_promotion("standard"):
            return fun(*args, **options)

    return call


def as_argument(value: ArrayLike) -> jax.Array:
    """Return an array of 64-bit numbers; NumPy makes it unless the value is traced, so that nothing compiles."""
    return jnp.asarray(value, float) if is_traced(value) else jnp.asarray(np.asarray(value, float))


def need_64_bits() -> None:
    """Raise `ValueError` if JAX runs with 32-bit numbers.

    32 bits are too few for the phase epoch + t, and for penetrations of micrometres in coordinates of metres.
    """
    if not jax.config.jax_enable_x64:
        raise ValueError("Option `jax_enable_x64` must be on, as slipperjax sets it on import, but is off.")


def call_compiled(fun: Callable, functions: PyTree, static: tuple, *arrays: PyTree) -> PyTree:
    """Call `fun(functions, static, *arrays)`, compiled; inside another transformation the call is a part of it.

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
