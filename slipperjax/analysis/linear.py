"""Small dense linear systems without LAPACK, whose calls from several threads may wait for each other for good."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Inexact


def solve(matrix: Inexact[Array, "n n"], rhs: Inexact[Array, "n ..."]) -> Inexact[Array, "n ..."]:
    """The solution of `matrix @ x = rhs`, by Gauss and Jordan's elimination with partial pivoting. Pure.

    NaN or infinite where the matrix is singular to rounding.
    """
    size = matrix.shape[0]
    columns = rhs if rhs.ndim == 2 else rhs[:, None]
    rows = jnp.arange(size)

    def eliminate(k: Any, both: Array) -> Array:
        pivot = jnp.argmax(jnp.where(rows >= k, jnp.abs(both[:, k]), -1.0))
        both = both.at[jnp.stack([k, pivot])].set(both[jnp.stack([pivot, k])])
        row = both[k] / both[k, k]
        return (both - both[:, k][:, None] * row[None]).at[k].set(row)

    both = jax.lax.fori_loop(0, size, eliminate, jnp.concatenate([matrix, columns], axis=1))
    return both[:, size:].reshape(rhs.shape)
