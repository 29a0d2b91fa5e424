"""Curves of solutions by pseudo-arclength: n equations for n + 1 numbers, followed through folds.

A curve is given by `AbstractEquations`: a residual and its derivative. `Walk` predicts along the
tangent, corrects by Newton's method in the plane across it, and adapts its step to what the correction took (Keller
1977; Allgower and Georg, Introduction to Numerical Continuation Methods, doi:10.1137/1.9780898719154).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..tools.checks import require, shown_number
from ..tools.compile import as_argument, call_compiled
from .floquet import CONSERVED, is_conservative, solve
from .newton import AbstractEquations, Linearisation, newton

LEAST_TURN = 0.9
"""Least cosine of the angle between the tangents at both ends of a step."""
CRITICAL_DISTANCE = 1e-6
"""Greatest distance of a critical multiplier's modulus from 1."""


class _OnPlane(AbstractEquations):
    """Equations of a curve, completed by the plane across it in which its point is looked for."""

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
    """A user's view of a point, by which grazings are detected."""

    counts: tuple[int, ...] = ()
    """Numbers of events in a period, by kind, such as the touchdowns of each point. Where one changes, there is a
    grazing."""
    margins: tuple[float, ...] = ()
    """Distance of the orbit from such a change, for each kind: zero there, and continuous in its neighbourhood."""
    data: Any = None
    """Anything else to keep."""


class Node(NamedTuple):
    """A point of a curve, as far as Newton's method came, with the tangent there.

    A branch of motions adds what follows the null vectors, see `slipperjax.analysis.events.observed`.
    """

    z: Float[Array | np.ndarray, " more"]
    tangent: Float[Array | np.ndarray, " more"]
    """Of weighted length one."""
    weights: Float[Array | np.ndarray, " more"]
    """Of the unknowns in the measure of length."""
    residual: Float[Array | np.ndarray, ""]
    """Greatest weighted component of the residual; infinite where that is not finite."""
    iterations: Int[Array | np.ndarray, ""]
    matrices: Any = None
    """As `null_vectors`, those of the `Linearisation` there."""
    null_vectors: Any = None
    multipliers: Any = None
    """The largest modulus first, of shape (size,)."""
    errors: Any = 0.0
    """Of the multipliers by rounding, see `rounding_errors`."""
    view: Observation = Observation()
    label: str = ""
    """Of the event that it is, empty for others."""

    @property
    def row(self) -> Float[Array | np.ndarray, " more"]:
        """Weighted tangent: `row @ (z' - z)` is the length from this point to z' along the curve."""
        return self.weights**2 * self.tangent

    def length(self, way: np.ndarray) -> float:
        """Return the weighted length of a difference of unknowns."""
        return float(np.linalg.norm(self.weights * way))

    @property
    def conserved(self) -> bool:
        """Whether the map is conservative here, so that multipliers on the unit circle are neutral."""
        return bool(is_conservative(self.multipliers))

    def margins(self, conserved: bool) -> Any:
        """Return the distances from the unit circle within which multipliers are neutral."""
        return np.maximum(self.errors, CONSERVED * conserved)

    @property
    def critical(self) -> bool:
        """Whether it is a bifurcation, at which rounding decides on which side the critical multiplier lies."""
        return self.label in ("LP", "PD", "NS", "BP")

    @property
    def outside(self) -> int:
        """Number of multipliers outside the unit circle, without neutral and critical ones."""
        near = np.maximum(self.margins(self.conserved), CRITICAL_DISTANCE * self.critical)
        return int(np.sum(np.abs(self.multipliers) > 1 + near))

    def beyond(self, conserved: bool, sign: int = 0) -> int:
        """Return the number of multipliers outside the unit circle, without neutral ones.

        **Arguments:** `sign`: 1 or -1 for the real ones beyond that number only.
        """
        mu = self.multipliers
        sizes = np.where(mu.imag == 0, sign * mu.real, 0.0) if sign else np.abs(mu)
        return int(np.sum(sizes > 1 + self.margins(conserved)))


def correct(
    equations: AbstractEquations,
    z: Any,
    row: Any,
    near: Any = None,
    *,
    tolerance: float,
    iterations: int = 8,
) -> Node:
    """Return the curve's point on the plane through `z` across `row`, by Newton's method; in arrays of NumPy.

    **Arguments:** `z`, `row`: of shape (more,); the tangent of the result points to the side that `row` points to.
    `near`: a point of the curve that `z` was predicted from, if any. `tolerance`: residual at which the iteration
    ends; `iterations`: it ends then in any case.
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
    """Return the numbers of a `Node`."""
    tolerance, most = limits
    row = row / jnp.sqrt(jnp.sum(row**2))
    # the guess must be consistent before the first iteration
    first = equations.project(z, near, jnp.zeros(z.size - 1))
    root = newton(_OnPlane(equations, row, row @ z), first, tolerance=tolerance, iterations=most)
    now = root.linearisation
    # across the equations' gradients, with a part along `row` of one
    tangent = solve(now.jacobian, jnp.zeros(z.size).at[-1].set(1.0))
    weights = equations.weights(root.z)[1]
    tangent = tangent / jnp.sqrt(jnp.sum((weights * tangent) ** 2))
    return root.z, tangent, weights, root.residual, root.iterations, now.matrices, now.null_vectors


def evaluated(equations: AbstractEquations, z: Any) -> Linearisation:
    """Return `equations.evaluate(z)`, compiled, in arrays of NumPy."""
    return jax.device_get(call_compiled(_evaluated, equations, (), jnp.asarray(z)))


def _evaluated(equations: AbstractEquations, static: tuple, z: Array) -> Linearisation:
    return equations.evaluate(z)


@dataclass(frozen=True)
class Pace:
    """Lengths of steps along a curve, in its weighted length."""

    first: float = 0.02
    least: float = 1e-6
    most: float = 0.1


@dataclass
class Walk:
    """Walk along a curve, point by point, with steps that adapt."""

    equations: AbstractEquations
    last: Node
    """Where the walk is, its tangent pointing ahead."""
    low: np.ndarray
    """Bounds of all unknowns, infinite where there are none, of shape (more,)."""
    high: np.ndarray
    pace: Pace
    tolerance: float
    step: float
    """What is to be tried next."""
    smooth: bool = True
    """False for equations whose derivatives are rough, so that the last chord tells more of the curve's direction
    than the tangent."""
    ended: str = ""
    """Why there is no next point: "bound" or "no convergence"; empty while there may be one."""

    def __iter__(self) -> Iterator[Node]:
        """Yield the next points until the walk has ended. The last one lies on the bound that it meets."""
        while not self.ended:
            before = self.last
            guess = before.z + self.step * before.tangent
            point = correct(self.equations, guess, before.row, before.z, tolerance=self.tolerance)
            if not self._good(point, guess):
                self.step /= 2
                if self.step < self.pace.least:
                    self.ended = "no convergence"
                continue
            # longer steps where Newton's method was fast, shorter ones where it was slow
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
                self.equations = self.equations.update(within.z, within.null_vectors)
                yield within

    def _within(self, point: Node) -> Node | None:
        """Return a new point, or that on the bound for one beyond it; None where the walk ends before."""
        beyond = (point.z < self.low) | (point.z > self.high)
        if not np.any(beyond):
            return point
        self.ended = "bound"
        on_bound = (self.last.z == self.low) | (self.last.z == self.high)
        if np.any(beyond & on_bound):  # the step began on the bound
            return None
        point = self._at_bound(point)
        if point.residual <= self.tolerance:
            return point
        self.ended = "no convergence"
        return None

    def _good(self, point: Node, guess: np.ndarray) -> bool:
        """Return whether a corrected point is the next one of the curve, and not one of another part of it."""
        if not point.residual <= self.tolerance:
            return False
        strayed = point.length(point.z - guess)
        if self.step < 2 * self.pace.least:
            # a curve may have corners, but no gaps
            return strayed < 10 * self.step
        near = strayed < 0.5 * self.step
        if not self.smooth:
            return near
        chord = point.weights * (point.z - self.last.z)
        mean = point.weights * (point.tangent + self.last.tangent)
        # On a circle a step has the direction of the mean of the tangents at its ends. It has not where it ends on a
        # branch point, whose tangent is undetermined.
        arched = chord @ mean > 0.995 * np.linalg.norm(chord) * np.linalg.norm(mean)
        return bool(point.row @ self.last.tangent > LEAST_TURN and near and arched)

    def _at_bound(self, beyond: Node) -> Node:
        """Return the curve's point on the first bound before a point beyond; look at its `residual`."""
        edges = np.clip(beyond.z, self.low, self.high)
        chord = beyond.z - self.last.z
        with np.errstate(divide="ignore", invalid="ignore"):
            # the part of the chord after which each bound is met
            shares = np.where(edges == beyond.z, np.inf, (edges - self.last.z) / chord)
        k = int(np.argmin(shares))  # the bound that is met first
        # the plane of that bound
        row = np.zeros_like(beyond.z)
        row[k] = np.sign(chord[k])
        guess = self.last.z + shares[k] * chord
        guess[k] = edges[k]
        return correct(self.equations, guess, row, beyond.z, tolerance=self.tolerance)


def checked_bounds(bounds: Any, text: str = "numbers") -> tuple[float, float]:
    """Return two numbers, the smaller first, infinite where there is no bound; raise `ValueError` otherwise."""
    try:
        low, high = (float(bound) for bound in bounds)
    except (TypeError, ValueError):
        low = high = np.nan
    require(low < high, "bounds", f"be two {text}, the smaller first", bounds)
    return low, high


def check_within(name: str, value: Any, bounds: tuple[float, float]) -> None:
    """Raise `ValueError` where the value of a parameter at the start lies outside its bounds."""
    low, high = (shown_number(bound) for bound in bounds)
    inside = bounds[0] <= value <= bounds[1]
    require(inside, name, f"lie within the bounds {low} and {high}", shown=shown_number(value))


def passes(start: Node, one: Node, other: Node) -> bool:
    """Return whether a curve comes back to its start between two points: to within a tenth of their distance."""
    chord = other.weights * (other.z - one.z)
    offset = other.weights * (start.z - one.z)
    share = chord @ offset / (chord @ chord)
    away = np.linalg.norm(offset - share * chord) / np.linalg.norm(chord)
    return bool(0 <= share <= 1 and away < 0.1 and start.row @ other.tangent > LEAST_TURN)
