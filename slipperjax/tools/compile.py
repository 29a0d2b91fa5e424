"""Compiler options for the hot path."""

from collections.abc import Callable
from typing import Any

import jax

COMPILER_OPTIONS = {
    # Lets LLVM reassociate the sum over the contact points, which vectorises it. The rest keeps the meaning of NaN,
    # infinity, division and square root.
    "xla_cpu_enable_fast_math": True,
    "xla_cpu_fast_math_honor_nans": True,
    "xla_cpu_fast_math_honor_infs": True,
    "xla_cpu_fast_math_honor_division": True,
    "xla_cpu_fast_math_honor_functions": True,
    # Our batches are too small for one kernel to gain from several threads; chunks of the batch are what gets them.
    "xla_cpu_multi_thread_eigen": False,
}


def jit(fun: Callable, **kwargs: Any) -> Callable:
    """`jax.jit` with the compiler options that make simulations fast; for the outermost function only."""
    return jax.jit(fun, compiler_options=COMPILER_OPTIONS, **kwargs)


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, that is, whether some outer transformation is at work."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))
