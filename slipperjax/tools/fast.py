"""Fast forms of the functions in `forms`, on private ground of JAX."""

from .fused import circle, spread, store, store_cotangent, store_if_differentiated, sums
from .jacobian import by_jacobian
from .one_kernel import in_one_kernel

__all__ = [
    "by_jacobian",
    "circle",
    "in_one_kernel",
    "spread",
    "store",
    "store_cotangent",
    "store_if_differentiated",
    "sums",
]
