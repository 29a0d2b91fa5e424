"""Non-intrusive least-squares shadowing of a forced map (Ni and Wang 2017, doi:10.1016/j.jcp.2017.06.033).

The derivative of an average over a chaotic attractor by a parameter, from one trajectory and its tangents. A forced
map has no neutral direction, so that the shadowing tangent needs no dilation of time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg


class Segments(NamedTuple):
    """Tangents along segments of a trajectory, arrays with a leading axis of segments."""

    average: np.ndarray
    """Mean of the output over each segment, (segments, outputs)."""
    inside: np.ndarray
    """Mean derivatives along the homogeneous tangents, (segments, count, outputs)."""
    forced: np.ndarray
    """Mean derivatives along the inhomogeneous tangent, (segments, outputs)."""
    gram: np.ndarray
    """Mean inner products of homogeneous tangents, (segments, count, count)."""
    mixed: np.ndarray
    """Mean inner products of homogeneous tangents with the inhomogeneous one, (segments, count)."""
    factor: np.ndarray
    """R of the tangents' QR at the end of each segment, (segments, count, count)."""
    shift: np.ndarray
    """Component of the inhomogeneous tangent along Q there, (segments, count)."""


def segments_of(
    step: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
    x: jax.Array,
    parameter: Any,
    weights: Any,
    *,
    count: int,
    segments: int,
    length: int,
    align: int = 0,
) -> Segments:
    """Pure; the same under vmap.

    **Arguments:** `step(x, p)`: the flat state one period later, and the outputs of the period; `weights`: of the
    state's components in norms; `count`: homogeneous tangents; `length`: periods in a segment; `align`: segments
    that pass first.
    """
    p = jnp.asarray(parameter, float)
    w = jnp.asarray(np.random.default_rng(0).standard_normal((count, x.size))) / weights[None]

    def period(carry, _):
        x, w, v = carry
        push = lambda dx, dp: jax.jvp(step, (x, p), (dx, dp))
        starts = jnp.concatenate([w, v[None]])
        drives = jnp.zeros(count + 1).at[-1].set(1.0)
        (end, out), (ends, slopes) = jax.vmap(push, out_axes=((None, None), 0))(starts, drives)
        scaled = ends * weights[None]
        products = scaled[:count] @ scaled.T
        return (end, ends[:count], ends[count]), (out, slopes[:count], slopes[count], products)

    def segment(carry, _):
        carry, kept = jax.lax.scan(period, carry, None, length=length)
        x, w, v = carry
        out, inside, forced, products = jax.tree.map(lambda a: jnp.mean(a, axis=0), kept)
        q, r = jnp.linalg.qr((w * weights[None]).T)
        b = q.T @ (v * weights)
        w, v = q.T / weights[None], v - (q @ b) / weights
        return (x, w, v), Segments(out, inside, forced, products[:, :count], products[:, count], r, b)

    q, _ = jnp.linalg.qr((w * weights[None]).T)
    begin = x, q.T / weights[None], jnp.zeros_like(x)
    _, tangents = jax.lax.scan(segment, begin, None, length=align + segments)
    return jax.tree.map(lambda a: a[align:], tangents)


def slope_of(tangents: Segments) -> np.ndarray:
    """The derivative of the outputs' averages: the combination of tangents, continuous between segments, that is
    least in the mean square."""
    segments, count = tangents.mixed.shape
    # a_{i+1} = R_i a_i + b_i, with the mean of a_i C_i a_i + 2 a_i d_i least: (C B^T; B 0) (a; l) = (-d; b)
    gram = scipy.sparse.block_diag(list(tangents.gram))
    rows = scipy.sparse.lil_matrix((count * (segments - 1), count * segments))
    for k in range(segments - 1):
        at = slice(k * count, (k + 1) * count)
        rows[at, at] = -tangents.factor[k]
        rows[at, (k + 1) * count : (k + 2) * count] = np.eye(count)
    system = scipy.sparse.bmat([[gram, rows.T], [rows, None]], format="csc")
    right = np.concatenate([-tangents.mixed.ravel(), tangents.shift[:-1].ravel()])
    a = scipy.sparse.linalg.spsolve(system, right)[: count * segments].reshape(segments, count)
    return np.mean(tangents.forced + np.einsum("sk,sko->so", a, tangents.inside), axis=0)
