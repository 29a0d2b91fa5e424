"""Least squares from many starts at once, by the method of Levenberg and Marquardt as optimistix has it.

The residuals come from programs of their own, which are asked for the points that the method wants to see. Of each
point it sees the residuals and their exact derivatives, as a function that is linear there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..sweeps.grid import VECTOR_LANES, filled
from ..tools.types import AnyArray

DAMPING = 1e-2
"""Of the first step, over the squares of the slopes [1]."""
MOST_STEPS = 40
"""Points that a search tries from each start."""
NEAR = 0.2
"""Distance from the least squares, in standard errors, at which a search has converged."""
STALLED = 0.5
"""The same where no more is gained: impacts that come or go leave kinks in a sum of squares."""
GAIN = 0.02
"""Change of the sum of squares that is none, that of a seventh of a standard error [1]."""
PATIENCE = 4
"""Points without any gain after which a search stops; of a rough one half as many."""
APART = 4.0
"""Distance from which on two minima are different ones [standard errors]."""
LOST = 1e24
"""Sum of squares of a motion that is lost."""
HOPELESS = 2.0
"""Sum of squares over the least of all at which a search is given up once another one has converged."""


class Expansion(NamedTuple):
    """Residuals near a point, up to a rotation that changes no sum of squares."""

    at: Float[Array, " unknowns"]
    residual: Float[Array, " rows"]
    slope: Float[Array, "rows unknowns"]

    def __call__(self, point: Float[Array, " unknowns"]) -> Float[Array, " rows"]:
        return self.residual + self.slope @ (point - self.at)


class Found(NamedTuple):
    """The best points of searches."""

    point: Float[np.ndarray, "starts unknowns"]
    slope: Float[np.ndarray, "starts rows unknowns"]
    """Compressed to one row more than unknowns, see `compressed`."""
    cost: Float[np.ndarray, " starts"]
    """Sum of squares."""
    distance: Float[np.ndarray, " starts"]
    """From the least squares, as far as the slopes tell [standard errors]."""
    still: Int[np.ndarray, " starts"]
    """Points since anything was gained."""
    patience: int = PATIENCE
    """Of these, after which it stops."""

    @classmethod
    def none(cls, points: Float[np.ndarray, "starts unknowns"], patience: int = PATIENCE) -> "Found":
        """Return searches that have seen nothing."""
        count, size = points.shape
        far = np.full(count, np.inf)
        slope = np.zeros((count, size + 1, size))
        return cls(points.copy(), slope, far, far.copy(), np.zeros(count, int), patience)

    @property
    def converged(self) -> Bool[np.ndarray, " starts"]:
        return (self.distance < NEAR) | ((self.distance < STALLED) & (self.still >= self.patience))

    @property
    def lead(self) -> int:
        """Index of the best."""
        return int(np.argmin(self.cost))

    def apart(self, point: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " starts"]:
        """Return the distance of each point from another one, in standard errors of the best."""
        return np.linalg.norm((self.point - point) @ self.slope[self.lead].T, axis=1)

    @property
    def active(self) -> Bool[np.ndarray, " starts"]:
        """Whether each search goes on: not those that stand still, have come to the best or are hopeless."""
        on = ~self.converged & (self.still < self.patience)
        if on[self.lead]:
            return on
        return on & (self.cost < HOPELESS * self.cost[self.lead]) & (self.apart(self.point[self.lead]) > 1.0)

    def nearest(self, more: float, most: int) -> Int[np.ndarray, " some"]:
        """Return the indices of up to `most` points whose sum of squares is at most `more` above the least, the best
        first."""
        order = np.argsort(self.cost)[:most]
        return order[self.cost[order] <= self.cost[self.lead] + more]

    def distinct(self, more: float, count: int) -> Int[np.ndarray, " minima"]:
        """Return the indices of ends whose first `count` unknowns are apart, and whose sum of squares is at most
        `more` above the least, the best first."""
        slope = self.slope[self.lead]
        # of these unknowns, whatever the others are
        weight = np.linalg.inv(covariance(slope)[:count, :count])
        kept: list[int] = []
        for k in map(int, np.argsort(self.cost)):
            away = [self.point[k, :count] - self.point[other, :count] for other in kept]
            likely = self.cost[k] <= self.cost[self.lead] + more and (self.converged[k] or k == self.lead)
            if likely and all(x @ weight @ x > APART**2 for x in away):
                kept.append(k)
        return np.array(kept)


Evaluate = Callable[
    [Float[np.ndarray, "some unknowns"], Int[np.ndarray, " some"]],
    tuple[Float[np.ndarray, "some rows"], Float[np.ndarray, "some rows unknowns"]],
]
"""Returns residuals and slopes at points of some starts, whose indices it is told."""


def covariance(slope: Float[np.ndarray, "rows unknowns"]) -> Float[np.ndarray, "unknowns unknowns"]:
    """Return the covariance of unknowns whose residuals are independent with a variance of one.

    By a root, so that none is negative where slopes in chaos are of any size.
    """
    root = np.linalg.inv(np.asarray(np.linalg.qr(slope, mode="r")))
    return root @ root.T


def compressed(
    residual: Float[np.ndarray, "*starts rows"], slope: Float[np.ndarray, "*starts rows unknowns"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals and slopes with one row more than unknowns at most, and the same sums of squares.

    Those of a lost motion, some of which are not finite, become as bad as can be.
    """
    good = np.isfinite(residual).all(axis=-1) & np.isfinite(slope).all(axis=(-1, -2))
    if slope.shape[-2] > slope.shape[-1] + 1:
        both = np.concatenate([slope, residual[..., None]], axis=-1)
        both[~good] = 0.0
        few = np.asarray(np.linalg.qr(both, mode="r"))
        residual, slope = few[..., -1].copy(), few[..., :-1].copy()
    if not good.all():
        residual, slope = residual.copy(), slope.copy()
        residual[~good], slope[~good] = 0.0, 0.0
        residual[~good, -1] = np.sqrt(LOST)
    return residual, slope


def search(
    evaluate: Evaluate,
    points: Float[np.ndarray, "starts unknowns"],
    shown: Callable[[str], object] = lambda text: None,
    *,
    rough: float = 0.0,
) -> Found:
    """Search the least squares from some points.

    **Arguments:** `shown`: is told of the progress; `rough`: share of the sum of squares that is no gain [1].
    """
    best = Found.none(points, PATIENCE // 2 if rough else PATIENCE)
    # a batch of few sizes, for programs that are compiled already
    lanes = filled(np.arange(len(points)), VECTOR_LANES)
    local = Expansion(points.copy(), np.zeros(best.slope.shape[:2]), best.slope.copy())
    now = points
    scale = accepted = states = None
    for _ in range(MOST_STEPS):
        index = np.flatnonzero(best.active)
        seen = now[index], *compressed(*evaluate(now[index], index))
        for array, new in zip(local, seen, strict=True):
            array[index] = new
        _note(best, index, *seen, rough)
        shown(f"{best.active.sum()} of {len(points)} searches, chi-squared {best.cost.min():.5g}")
        if not best.active.any():
            break
        if scale is None:
            # the method damps all unknowns alike: they are counted by what they change, as Marquardt did
            scale = 1 / np.maximum(np.sqrt(DAMPING) * np.linalg.norm(local.slope, axis=1), 1e-12)
            accepted = (points / scale)[lanes]
            states = _begin(accepted)
        scaled = Expansion(local.at / scale, local.residual, local.slope * scale[:, None])
        accepted, states = _step(accepted, states, jax.tree.map(lambda a: a[lanes], scaled))
        now = np.asarray(states.y_eval)[: len(points)] * scale
    return best


def _note(
    best: Found, index: np.ndarray, point: np.ndarray, residual: np.ndarray, slope: np.ndarray, rough: float
) -> None:
    """Keep new points of the searches at `index` where they are better."""
    cost = np.sum(residual**2, axis=1)
    # the least squares are as far as the residuals reach along the slopes
    along, _ = np.linalg.qr(slope)
    distance = np.linalg.norm(np.einsum("sru,sr->su", along, residual), axis=1)
    gains = cost < best.cost[index] * (1 - rough) - GAIN
    best.still[index] = np.where(gains, 0, best.still[index] + 1)
    better = cost < best.cost[index]
    kept = best.point, best.slope, best.cost, best.distance
    for array, new in zip(kept, (point, slope, cost, distance), strict=True):
        array[index[better]] = new[better]


_SOLVER = optx.LevenbergMarquardt(rtol=0.0, atol=0.0, linear_solver=lx.QR())
_OPTIONS = {"jac": "bwd"}  # derivatives as an array, and not as a function


def _value(point: Array, local: Expansion) -> tuple[Array, None]:
    return local(point), None


@eqx.filter_jit
def _begin(points: Float[AnyArray, "starts unknowns"]) -> Any:
    """Return the method's states before it has seen any residuals."""

    def one(point: Array) -> Any:
        size = point.shape[0]
        local = Expansion(point, jnp.zeros(size + 1), jnp.zeros((size + 1, size)))
        return _SOLVER.init(_value, point, local, _OPTIONS, jax.eval_shape(local, point), None, frozenset())

    return eqx.filter_vmap(one)(points)


@eqx.filter_jit
def _step(points: Any, states: Any, local: Expansion) -> tuple[Array, Any]:
    """Return the accepted points, and the states, whose `y_eval` are the next points to see."""

    def one(point: Array, state: Any, local: Expansion) -> tuple[Array, Any]:
        point, state, _ = _SOLVER.step(_value, point, local, _OPTIONS, state, frozenset())
        return point, state

    return eqx.filter_vmap(one)(points, states, local)
