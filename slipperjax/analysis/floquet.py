"""Floquet multipliers of periodic motions, from the Jacobians of successive maps."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Complex, Float, Inexact, PyTree

from ..tools.checks import finite, numbers, whole
from ..tools.forms import in_one_kernel
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from .lyapunov import Step, checked_system


def solve(
    matrix: Inexact[Array, "n n"],
    rhs: Inexact[Array, "n ..."],
) -> Inexact[Array, "n ..."]:
    """Return x of `matrix @ x = rhs` by Gauss-Jordan elimination with partial pivoting. Pure.

    NaN or infinite where the matrix is singular to rounding.
    """
    size = matrix.shape[0]
    columns = rhs if rhs.ndim == 2 else rhs[:, None]
    rows = jnp.arange(size)

    # swap the row with the greatest pivot into place k, and subtract it from all others
    def eliminate(k, both: Array) -> Array:
        pivot = jnp.argmax(jnp.where(rows >= k, jnp.abs(both[:, k]), -1.0))
        both = both.at[jnp.stack([k, pivot])].set(both[jnp.stack([pivot, k])])
        row = both[k] / both[k, k]
        return (both - both[:, k][:, None] * row[None]).at[k].set(row)

    both = jax.lax.fori_loop(0, size, eliminate, jnp.concatenate([matrix, columns], axis=1))
    return both[:, size:].reshape(rhs.shape)


def jacobians(
    step: Step,
    state: PyTree,
    intervals: int,
    *,
    index: Real = 0.0,
) -> Float[Array, "intervals size size"]:
    """Return Jacobians of `intervals` successive applications of `step`, along the motion from `state`. Pure.

    **Arguments:** `step(state, k)`: the state one interval later, differentiable in forward mode; `state`: a pytree
    of floats with `size` values in all; `index`: index of the first interval.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    intervals = whole("intervals", intervals, 1)
    index = finite("index")(index)
    with checked_system(step, state, index=index) as first:
        return linearise(step, first, intervals, index=index)[1]


def linearise(
    step: Step, state: PyTree, intervals: int, *, index: Real = 0.0
) -> tuple[Float[Array, " size"], Float[Array, "intervals size size"]]:
    """Return the state after the last interval as one array, and the `jacobians`. Pure."""
    flat, unravel = ravel_pytree(state)

    def interval(x, k):
        # out_axes None: the state at the end is the same for all directions, and is computed once
        flow = lambda x: ravel_pytree(step(unravel(x), k))[0]
        return jax.vmap(lambda t: jax.jvp(flow, (x,), (t,)), out_axes=(None, 1))(jnp.eye(x.size))

    return in_one_kernel(lambda flat: jax.lax.scan(interval, flat, index + jnp.arange(float(intervals))), flat)


def product(
    matrices: Float[Array | np.ndarray, "intervals size size"],
) -> Float[Array | np.ndarray, "size size"]:
    """Return the product of successive matrices; the first matrix is applied first."""
    if is_traced(matrices):
        return jax.lax.scan(lambda total, m: (_after(total, m), None), jnp.eye(matrices.shape[1]), matrices)[0]
    return functools.reduce(_after, np.asarray(matrices))


def eigenvector(matrices: Float[np.ndarray, "intervals size size"], multiplier: complex) -> np.ndarray:
    """Return the right eigenvector of the product of successive Jacobians that belongs to the nearest multiplier."""
    values, vectors = np.linalg.eig(product(matrices))
    return vectors[:, np.argmin(np.abs(values - multiplier))]


def multipliers(
    matrices: Float[Array | np.ndarray, "intervals size size"],
) -> Complex[Array | np.ndarray, " size"]:
    """Return the eigenvalues of the product of successive Jacobians, the largest modulus first.

    The product is not formed, because its rounding errors would hide small multipliers. QR factors of the Jacobians
    are passed through the intervals until they separate the moduli (orthogonal iteration; Lust 2001,
    doi:10.1142/S0218127401003486). Inside `jax.jit` and other transformations the product is formed.
    """
    if is_traced(matrices):
        mu, _ = _eigenpairs(product(matrices))
        return mu[jnp.argsort(-jnp.abs(mu))]
    matrices = numbers("matrices", matrices, 3)
    # a single matrix needs no separation, and NaN cannot be separated
    blocks = [matrices] if len(matrices) == 1 or not np.all(np.isfinite(matrices)) else _blocks(matrices)
    mu = np.concatenate([_eigenvalues(product(block)) for block in blocks])
    return mu[np.argsort(-np.abs(mu), kind="stable")]


@jax.custom_jvp
def _eigenpairs(matrix):
    """Return eigenvalues and right eigenvectors; the derivatives of vectors are those of any scale of the vectors."""
    values, vectors = jnp.linalg.eig(matrix)
    return values.astype(complex), vectors.astype(complex)


@_eigenpairs.defjvp
def _(primals, tangents):
    values, vectors = _eigenpairs(*primals)
    change = solve(vectors, jnp.eye(len(values), dtype=complex)) @ tangents[0] @ vectors
    # equal eigenvalues have no derivatives of their vectors
    apart = values[None] - values[:, None]
    turn = jnp.where(apart == 0, 0.0, change / jnp.where(apart == 0, 1.0, apart))
    return (values, vectors), (jnp.diagonal(change), vectors @ turn)


def _after(earlier, later):
    return later @ earlier


def _eigenvalues(matrix: np.ndarray) -> np.ndarray:
    if not np.all(np.isfinite(matrix)):
        return np.full(len(matrix), np.nan + 0j)
    return np.linalg.eigvals(matrix).astype(complex)


def _blocks(matrices: np.ndarray) -> list[np.ndarray]:
    """Return the diagonal blocks (intervals, k, k) of matrices, in bases that make all of them block triangular."""
    size = matrices.shape[1]
    # orthogonal iteration: in 30 passes the bases converge to subspaces in the order of falling moduli
    basis = np.eye(size)
    for _ in range(30):
        bases = [basis]
        for matrix in matrices:
            bases.append(np.linalg.qr(matrix @ bases[-1])[0])
        basis = bases[-1]
    inside = []
    for k, matrix in enumerate(matrices):
        # the last interval ends in the basis in which the first interval begins
        then = bases[(k + 1) % len(matrices)]
        inside.append(then.T @ matrix @ bases[k])
    # Blocks are separate where the lower left entries, which couple them, are small in all matrices: 1e-12 of the
    # norm, to which rounding errors grow over many intervals. Larger blocks would cost more accuracy.
    cuts = [0]
    for k in range(1, size):
        if all(np.abs(m[k:, :k]).max() <= 1e-12 * max(np.linalg.norm(m[:k, :k], 2), 1e-300) for m in inside):
            cuts.append(k)
    blocks = []
    for begin, end in itertools.pairwise([*cuts, size]):
        blocks.append(np.stack([m[begin:end, begin:end] for m in inside]))
    return blocks


CONSERVED = 1e-6
"""Greatest |ln| of the product of all multipliers' moduli for a conservative map: the product is one up to the error
of the integration."""
ROUNDING = 100 * np.finfo(float).eps
"""Relative rounding error of the Jacobian over a period."""


def is_conservative(
    multipliers: Inexact[Array | np.ndarray, "*cases size"],
) -> Bool[Array | np.ndarray | np.bool_, "*cases"]:
    """Return whether multipliers belong to a conservative or reversible map: in pairs mu and 1/mu.

    Such pairs stay on the unit circle along whole stretches of a branch.
    """
    xp = jnp if is_traced(multipliers) else np
    with np.errstate(divide="ignore", invalid="ignore"):
        return xp.abs(xp.sum(xp.log(xp.abs(multipliers)), axis=-1)) <= CONSERVED


def circle_error(multipliers: Inexact[Array | np.ndarray, "*cases size"]) -> Float[Array | np.ndarray, "*cases"]:
    """Return the error of the largest multiplier's modulus; a modulus nearer to 1 than this does not decide about
    stability."""
    xp = jnp if is_traced(multipliers) else np
    return xp.where(is_conservative(multipliers), CONSERVED, ROUNDING)


def rounding_errors(
    multipliers: Inexact[np.ndarray, " size"],
    matrices: Float[np.ndarray, "intervals size size"],
) -> Float[np.ndarray, " size"]:
    """Return the rounding error of each multiplier, estimated from the successive Jacobians.

    The error is `ROUNDING` times the norm of the balanced product times the multiplier's condition, or the root of
    this where two multipliers nearly coincide (Wilkinson 1965, The Algebraic Eigenvalue Problem, chapter 2).
    """
    from scipy.linalg import eig, matrix_balance  # here, because importing takes time that most runs need not spend

    whole_period = product(matrices)
    if not np.all(np.isfinite(whole_period)):
        return np.full(np.shape(multipliers), ROUNDING)
    matrix = matrix_balance(whole_period)[0]
    values, left, right = eig(matrix, left=True)  # type: ignore[misc]
    cosines = np.abs(np.sum(left.conj() * right, axis=0))  # zero for a double multiplier
    norm = np.linalg.norm(matrix, 2)
    errors = np.minimum(ROUNDING * norm / np.maximum(cosines, ROUNDING), np.sqrt(ROUNDING) * norm)
    # each multiplier has the error of the product's nearest eigenvalue
    nearest = np.argmin(np.abs(np.asarray(multipliers)[:, None] - values), axis=1)
    return errors[nearest]


def largest_exponent(matrices: Numbers, period: int) -> float:
    """Return ln |largest Floquet multiplier| per interval of a motion that recurs after `period` intervals.

    **Arguments:** `matrices`: Jacobians of `period` or more successive intervals, (intervals, size, size).
    """
    largest = multipliers(numbers("matrices", matrices, 3)[:period])[0]
    return float(np.log(np.abs(largest)) / period)
