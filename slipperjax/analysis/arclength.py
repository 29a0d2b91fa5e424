"""Pseudo-arclength continuation: curves of solutions of n equations for n + 1 unknowns, followed through folds.

`AbstractEquations` gives the curve. `Walk` predicts the next point along the tangent, corrects it by Newton's
method in the plane across the tangent, and adapts its step to the number of iterations (Keller 1977; Allgower and
Georg, Introduction to Numerical Continuation Methods, doi:10.1137/1.9780898719154).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from ..tools.checks import require, shown_number
from ..tools.compile import as_argument, call_compiled
from ..tools.types import Numbers, Real
from .floquet import CONSERVED, is_conservative, solve
from .newton import AbstractEquations, Linearisation, NullVectors, newton

LEAST_TURN = 0.9
"""Least cosine of the angle between the tangents at both ends of a step."""
CRITICAL_DISTANCE = 1e-6
"""Greatest distance of a critical multiplier's modulus from 1."""


class _OnPlane(AbstractEquations):
    """Equations of a curve, completed by the equation of a plane across it: row @ z = target."""

    equations: AbstractEquations
    row: Array
    target: Array

    def evaluate(self, z: Array) -> Linearisation:
        now = self.equations.evaluate(z)
        residual = jnp.append(now.residual, self.row @ z - self.target)
        return now._replace(residual=residual, jacobian=jnp.concatenate([now.jacobian, self.row[None]]))

    def weights(self, z: Array) -> tuple[Array, Array]:
        rows, columns = self.equations.weights(z)
        return jnp.append(rows, 0.0), columns

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        return self.equations.project(z, before, residual[:-1])


class Observation(NamedTuple):
    """Properties of a point that the caller of a continuation observes; they show grazings."""

    counts: tuple[int, ...] = ()
    """Numbers of events in a period, by kind, such as touchdowns of each contact point; one changes at a grazing."""
    margins: tuple[float, ...] = ()
    """For each kind, a distance from such a change: zero at the change, and continuous near it."""
    data: Any = None
    """Any other data of the caller."""


class Node(NamedTuple):
    """A point of a curve from Newton's method, with the tangent there.

    On branches of motions `slipperjax.analysis.events.observed` fills in `multipliers`, `errors` and `view`.
    """

    z: Float[Array | np.ndarray, " more"]
    tangent: Float[Array | np.ndarray, " more"]
    """Of weighted length one."""
    weights: Float[Array | np.ndarray, " more"]
    """Weights of the unknowns in lengths along the curve."""
    residual: Float[Array | np.ndarray, ""]
    """Greatest weighted component of the residual; infinite where it is not finite."""
    iterations: Int[Array | np.ndarray, ""]
    matrices: Float[Array | np.ndarray, "intervals size size"] | None
    """Jacobians of the successive intervals of a motion, see `Linearisation`."""
    null_vectors: NullVectors
    multipliers: Complex[np.ndarray, " size"] = np.empty(0, complex)
    """Floquet multipliers, the largest modulus first."""
    errors: Float[np.ndarray, " size"] = np.empty(0)
    """Rounding errors of the multipliers."""
    view: Observation = Observation()
    label: str = ""
    """Label of the event at this point; empty where there is no event."""

    @property
    def row(self) -> Float[Array | np.ndarray, " more"]:
        """Weighted tangent: `row @ (z' - z)` is the length from this point to a near point z' along the curve."""
        return self.weights**2 * self.tangent

    def length(self, way: np.ndarray) -> float:
        """Return the weighted length of a difference between points."""
        return float(np.linalg.norm(self.weights * way))

    @property
    def conserved(self) -> bool:
        """Whether the map is conservative, so that multipliers on the unit circle do not destabilise."""
        return bool(is_conservative(self.multipliers))

    def margins(self, conserved: bool) -> Float[np.ndarray, " size"]:
        """Return the distances from the unit circle within which multipliers count as on it."""
        return np.maximum(self.errors, max(CONSERVED * conserved, CRITICAL_DISTANCE * self.critical))

    @property
    def critical(self) -> bool:
        """Whether the point is a bifurcation, where rounding errors decide the side of the critical multiplier."""
        return self.label in ("LP", "PD", "NS", "BP")

    @property
    def outside(self) -> int:
        """Number of multipliers outside the unit circle by more than their errors, without a critical multiplier."""
        return self.beyond(self.conserved)

    def beyond(self, conserved: bool, sign: int = 0) -> int:
        """Return the number of multipliers outside the unit circle, by more than their errors.

        **Arguments:** `sign`: with 1 or -1 only real multipliers above 1 or below -1 count.
        """
        mu = self.multipliers
        sizes = np.where(mu.imag == 0, sign * mu.real, 0.0) if sign else np.abs(mu)
        return int(np.sum(sizes > 1 + self.margins(conserved)))


def correct(
    equations: AbstractEquations,
    z: Numbers,
    row: Numbers,
    near: Numbers | None = None,
    *,
    tolerance: float,
    iterations: int = 8,
) -> Node:
    """Find the curve's point on the plane through `z` across `row` by Newton's method; return it in NumPy arrays.

    **Arguments:** `z`, `row`: of shape (more,); the tangent of the result points to the side of `row`.
    `near`: the point of the curve from which `z` was predicted, if any. `tolerance`: residual at which the iteration
    ends; `iterations`: most iterations.
    """
    arrays = (jnp.asarray(a) for a in (z, row, z if near is None else near))
    limits = as_argument(tolerance), jnp.asarray(np.asarray(iterations))
    return Node(*jax.device_get(call_compiled(_correct, equations, (), *arrays, limits)))


def _correct(
    equations: AbstractEquations,
    static: tuple,
    z: Array,
    row: Array,
    near: Array,
    limits: tuple,
) -> tuple:
    """Return the first fields of a `Node`, up to its null vectors."""
    tolerance, most = limits
    row = row / jnp.sqrt(jnp.sum(row**2))
    # the guess must be consistent before the first iteration
    first = equations.project(z, near, jnp.zeros(z.size - 1))
    root = newton(_OnPlane(equations, row, row @ z), first, tolerance=tolerance, iterations=most)
    now = root.linearisation
    # the direction in which no equation changes; its component along `row` is one
    tangent = solve(now.jacobian, jnp.zeros(z.size).at[-1].set(1.0))
    weights = equations.weights(root.z)[1]
    tangent = tangent / jnp.sqrt(jnp.sum((weights * tangent) ** 2))
    return root.z, tangent, weights, root.residual, root.iterations, now.matrices, now.null_vectors


def evaluated(equations: AbstractEquations, z: Numbers) -> Linearisation:
    """Return `equations.evaluate(z)`, compiled, in NumPy arrays."""
    return jax.device_get(call_compiled(_evaluated, equations, (), jnp.asarray(z)))


def _evaluated(equations: AbstractEquations, static: tuple, z: Array) -> Linearisation:
    return equations.evaluate(z)


@dataclass(frozen=True)
class Pace:
    """First, least and greatest step along a curve, as weighted lengths."""

    first: float = 0.02
    least: float = 1e-6
    most: float = 0.1


@dataclass
class Walk:
    """Walk along a curve, point by point, with adaptive steps."""

    equations: AbstractEquations
    last: Node
    """Last point of the walk; its tangent points ahead."""
    low: np.ndarray
    """Lower bounds of all unknowns, of shape (more,), infinite where there are none; `high`: upper bounds."""
    high: np.ndarray
    pace: Pace
    tolerance: float
    step: float
    """Length of the step to try next."""
    smooth: bool = True
    """False for equations with rough derivatives: then the last chord, not the tangent, predicts the next point."""
    ended: str = ""
    """Reason why the walk has ended: "bound" or "no convergence"; empty before."""

    def __iter__(self) -> Iterator[Node]:
        """Yield the next points until the walk has ended; a point on a bound is the last one."""
        while not self.ended:
            before = self.last
            guess = before.z + self.step * before.tangent
            point = correct(self.equations, guess, before.row, before.z, tolerance=self.tolerance)
            if not self._good(point, guess):
                self.step /= 2
                if self.step < self.pace.least:
                    self.ended = "no convergence"
                continue
            # after a fast correction the curve is nearly straight, so that a longer step is possible
            if point.iterations <= 3:
                self.step = min(1.5 * self.step, self.pace.most)
            elif point.iterations >= 5:
                self.step = max(self.step / 1.5, self.pace.least)
            within = self._within(point)
            if within is not None:
                if not self.smooth:
                    chord = within.z - before.z
                    within = within._replace(tangent=chord / within.length(chord))
                self.last = within
                # borders of critical motions move along the curve
                self.equations = self.equations.update(within.z, within.null_vectors)
                yield within

    def _within(self, point: Node) -> Node | None:
        """Return the point, or the curve's point on a bound if the point is beyond it; None without either."""
        beyond = (point.z < self.low) | (point.z > self.high)
        if not np.any(beyond):
            return point
        self.ended = "bound"
        on_bound = (self.last.z == self.low) | (self.last.z == self.high)
        if np.any(beyond & on_bound):  # the step began on the bound
            return None
        edges = np.clip(point.z, self.low, self.high)
        chord = point.z - self.last.z
        # share of the chord at which it crosses each bound
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(beyond, (edges - self.last.z) / chord, np.inf)
        k = int(np.argmin(shares))
        # correct in the plane of the bound that is crossed first
        row = np.zeros_like(chord)
        row[k] = np.sign(chord[k])
        guess = self.last.z + shares[k] * chord
        guess[k] = edges[k]
        point = correct(self.equations, guess, row, point.z, tolerance=self.tolerance)
        if point.residual <= self.tolerance:
            return point
        self.ended = "no convergence"
        return None

    def _good(self, point: Node, guess: np.ndarray) -> bool:
        """Return whether a corrected point is the next point of the curve, not a point of another part of it."""
        if not point.residual <= self.tolerance:
            return False
        strayed = point.length(point.z - guess)
        if self.step < 2 * self.pace.least:
            # at a corner no step is short enough for the other tests, but a curve has no gaps
            return strayed < 10 * self.step
        near = strayed < 0.5 * self.step
        if not self.smooth:
            return near
        chord = point.weights * (point.z - self.last.z)
        mean = point.weights * (point.tangent + self.last.tangent)
        # On a circle a step has the direction of the mean of the tangents at its ends. This test fails where a step
        # ends on a branch point, whose tangent is undetermined.
        arched = chord @ mean > 0.995 * np.linalg.norm(chord) * np.linalg.norm(mean)
        return bool(point.row @ self.last.tangent > LEAST_TURN and near and arched)


def checked_bounds(bounds: object, text: str = "numbers") -> tuple[float, float]:
    """Return two bounds as floats, which may be infinite; raise `ValueError` unless the first is smaller."""
    try:
        low, high = map(float, bounds)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        low = high = np.nan
    require(low < high, "bounds", f"be two {text}, the smaller first", bounds)
    return low, high


def check_within(name: str, value: Real, bounds: tuple[float, float]) -> None:
    """Raise `ValueError` where the value of an argument lies outside the bounds."""
    low, high = (shown_number(bound) for bound in bounds)
    inside = bounds[0] <= value <= bounds[1]
    require(inside, name, f"lie within the bounds {low} and {high}", shown=shown_number(value))


def passes(start: Node, one: Node, other: Node) -> bool:
    """Return whether a curve passes its start between two points, within a tenth of their distance."""
    chord = other.weights * (other.z - one.z)
    offset = other.weights * (start.z - one.z)
    # foot of the perpendicular from the start to the chord, and its length
    share = chord @ offset / (chord @ chord)
    away = np.linalg.norm(offset - share * chord) / np.linalg.norm(chord)
    return bool(0 <= share <= 1 and away < 0.1 and start.row @ other.tangent > LEAST_TURN)
