"""Fast forms of the functions in `forms`, on private ground of JAX."""

import jax

from .fused import circle, spread, store, store_cotangent, store_if_differentiated, sums
from .one_kernel import in_one_kernel

__all__ = [
    "circle",
    "compiler_options",
    "in_one_kernel",
    "spread",
    "store",
    "store_cotangent",
    "store_if_differentiated",
    "sums",
]


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
        # Batches are too small for several threads in one kernel; the parts of a batch use the cores.
        "xla_cpu_multi_thread_eigen": False,
    }
