"""What is traced: whether a call is inside a transformation of JAX, and which of its arguments JAX traces."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
from jax.extend.core import get_opaque_trace_state
from jaxtyping import PyTree

# A new thread is outside of all transformations, even where this module is imported inside one.
with ThreadPoolExecutor(1) as _pool:
    _TOP_LEVEL = _pool.submit(get_opaque_trace_state).result()


def is_transformed() -> bool:
    """Return whether the call is inside a JAX transformation, even if none of its arguments is a tracer."""
    return get_opaque_trace_state() != _TOP_LEVEL


def is_traced(tree: PyTree) -> bool:
    """Return whether any leaf is a tracer: a value that is not known before the program runs."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def split_arrays(fun: Callable, args: tuple) -> tuple[Callable[[PyTree], PyTree], PyTree]:
    """Split `fun(*args)` into a function of arrays only, and the pytree of the arrays in `fun` and `args`."""
    arrays, others = eqx.partition((fun, args), eqx.is_array)

    def call(arrays: PyTree) -> PyTree:
        fun, args = eqx.combine(arrays, others)
        return fun(*args)

    return call, arrays
