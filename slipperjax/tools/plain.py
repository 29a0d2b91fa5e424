"""Plain forms, of public JAX alone, of the functions in `fast`: the same results, slower.

See `slipperjax.tools.forms`, which describes each function and chooses the form.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .notices import note_compiling


def compiler_options(backend: str | None = None) -> dict[str, bool]:
    return {}


def in_one_kernel(fun: Callable, *args: PyTree) -> PyTree:
    note_compiling()
    return fun(*args)


def sums(*operands):
    return [jnp.sum(x, axis=-1) for x in operands]


def spread(n, *scalars):
    values = jnp.broadcast_arrays(*(jnp.asarray(x, float) for x in scalars))
    return [jnp.broadcast_to(x[..., None], (*x.shape, n)) for x in values]


def store(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


store_cotangent = store
store_if_differentiated = store


def circle(angle):
    return jnp.cos(angle), jnp.sin(angle)
