"""Curves of solutions by pseudo-arclength: n equations for n + 1 numbers, followed through folds.

A curve is given by `AbstractEquations`: a residual and its derivative. `Walk` predicts along the
tangent, corrects by Newton's method in the plane across it, and adapts its step to what the correction took (Keller
1977; Allgower and Georg, Introduction to Numerical Continuation Methods, doi:10.1137/1.9780898719154).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..tools.checks import require, shown_number
from ..tools.compile import as_argument, call_compiled
from .floquet import solve
from .newton import AbstractEquations, Linearisation, newton

CORRECTOR_ITERATIONS = 8
"""Newton iterations after which a correction counts as failed."""
EASY_ITERATIONS, HARD_ITERATIONS = 3, 5
"""Newton iterations up to which the step grows, and from which it shrinks."""
STEP_FACTOR = 1.5
"""Factor by which the step grows or shrinks."""
LEAST_TURN = 0.9
"""Least cosine of the angle between the tangents at both ends of a step."""
LEAST_ARCH = 0.995
"""Least cosine of the angle between a step and the mean of the tangents at its ends, which is 1 on a circle, and less
where a step ends on a branch point, whose tangent is undetermined."""
RETURN_DISTANCE = 0.1
"""Greatest distance from the start at which a curve counts as closed, over the step."""
MOST_RELAXED = 8
"""Points in a row that may solve relaxed equations only, see `AbstractEquations.relax`."""
STRAY_SHARE = 0.5
"""Greatest distance of a corrected point from the predicted one, over the step."""
CORNER_SHARE = 10.0
"""Likewise for the least step: a curve may have corners, but no gaps."""


class _OnPlane(AbstractEquations):
    """Equations of a curve, completed by the plane across it in which its point is looked for."""

    equations: AbstractEquations
    row: Array
    target: Array

    def evaluate(self, z: Array) -> Linearisation:
        now = self.equations.evaluate(z)
        jacobian = jnp.concatenate([now.jacobian, self.row[None]])
        return now._replace(residual=jnp.append(now.residual, self.row @ z - self.target), jacobian=jacobian)

    def weights(self, z: Array) -> tuple[Array, Array]:
        rows, columns = self.equations.weights(z)
        return jnp.append(rows, 0.0), columns

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        return self.equations.project(z, before, residual[:-1])


class Spot(NamedTuple):
    """A point of a curve, as far as Newton's method came, with the tangent there."""

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

    @property
    def row(self) -> Float[Array | np.ndarray, " more"]:
        """Weighted tangent: `row @ (z' - z)` is the length from this point to z' along the curve."""
        return self.weights**2 * self.tangent


def correct(
    equations: AbstractEquations,
    z: Any,
    row: Any,
    near: Any = None,
    *,
    tolerance: float = 1e-10,
    iterations: int = CORRECTOR_ITERATIONS,
) -> Spot:
    """Finds the curve's point on the plane through `z` across `row`, by Newton's method; in arrays of NumPy.

    **Arguments:** `z`, `row`: of shape (more,); the tangent of the result points to the side that `row` points to.
    `near`: a point of the curve that `z` was predicted from, if any. `tolerance`: residual at which the iteration
    ends; `iterations`: it ends then in any case.
    """
    arrays = (jnp.asarray(a) for a in (z, row, z if near is None else near))
    limits = as_argument(tolerance), jnp.asarray(np.asarray(iterations))
    return jax.device_get(call_compiled(_correct, equations, (), *arrays, limits))


def _correct(equations: AbstractEquations, static: tuple, z: Array, row: Array, near: Array, limits: tuple) -> Spot:
    tolerance, most = limits
    row = row / jnp.sqrt(jnp.sum(row**2))
    first = equations.project(z, near, jnp.zeros(z.size - 1))
    root = newton(_OnPlane(equations, row, row @ z), first, tolerance=tolerance, iterations=most)
    now = root.linearisation
    tangent = solve(now.jacobian, jnp.zeros(z.size).at[-1].set(1.0))
    weights = equations.weights(root.z)[1]
    tangent = tangent / jnp.sqrt(jnp.sum((weights * tangent) ** 2))
    return Spot(root.z, tangent, weights, root.residual, root.iterations, now.matrices, now.null_vectors)


def evaluated(equations: AbstractEquations, z: Any) -> Linearisation:
    """Gives `equations.evaluate(z)`, compiled, in arrays of NumPy."""
    return jax.device_get(call_compiled(_evaluated, equations, (), jnp.asarray(z)))


def _evaluated(equations: AbstractEquations, static: tuple, z: Array) -> Linearisation:
    return equations.evaluate(z)


@dataclass(frozen=True)
class Pace:
    """Lengths of steps along a curve, in its weighted length."""

    first: float = 0.02
    least: float = 1e-6
    most: float = 0.1


class Walk:
    """Walk along a curve, point by point, with steps that adapt.

    `spot` is its last point, `step` what is to be tried next, and `ended` says why there is no next point: "bound" or
    "no convergence"; it is empty while there may be one.
    """

    def __init__(
        self,
        equations: AbstractEquations,
        start: Spot,
        low: Any,
        high: Any,
        pace: Pace = Pace(),
        tolerance: float = 1e-10,
        *,
        step: float | None = None,
        secant: bool = False,
    ):
        """**Arguments:** `start`: where the way begins, its tangent pointing ahead; `low`, `high`: bounds of all
        unknowns, infinite where there are none, of shape (more,); `step`: the first, by default that of `pace`;
        `secant`: whether to go on along the last chord and not along the tangent, for equations whose derivatives
        are rough."""
        self.equations, self.pace, self.tolerance = equations, pace, tolerance
        self.low, self.high = np.asarray(low, float), np.asarray(high, float)
        self.spot, self.step, self.ended, self.secant = start, step or self.pace.first, "", secant
        # the equations proper, while relaxed ones are tried, and points in a row that were found by these
        self.strict: AbstractEquations | None = None
        self.relaxed = 0

    def follow(self, most: int, add: Callable[[Spot], str]) -> str:
        """Walks on for up to `most` points, and gives the reason why it ends, see `Curve`.

        **Arguments:** `add`: takes each point, and gives a reason why the walk is to end there, or an empty text.
        """
        try:
            for _ in range(most):
                if (spot := self.advance()) is None:
                    return self.ended
                if reason := add(spot):
                    return reason
        except KeyboardInterrupt:
            return "interrupted"
        return self.ended or "count"

    def advance(self) -> Spot | None:
        """Gives the next point, or None where the walk has ended. The last one lies on the bound that it meets."""
        while not self.ended:
            before, step = self.spot, self.step
            guess = before.z + step * before.tangent
            spot = correct(self.equations, guess, before.row, before.z, tolerance=self.tolerance)
            if not self._good(spot, guess, step):
                self.step = step / 2
                if self.step < self.pace.least:
                    self._relax()
                continue
            self.relaxed = 0 if self.strict is None else self.relaxed + 1
            if self.strict is not None:  # one point of relaxed equations is enough to pass an obstacle
                self.equations, self.strict = self.strict, None
            if spot.iterations <= EASY_ITERATIONS:
                self.step = min(step * STEP_FACTOR, self.pace.most)
            elif spot.iterations >= HARD_ITERATIONS:
                self.step = max(step / STEP_FACTOR, self.pace.least)
            return self._within(spot)
        return None

    def _within(self, spot: Spot) -> Spot | None:
        """Takes a new point, or instead of one beyond a bound that on the bound."""
        before = self.spot
        beyond = (spot.z < self.low) | (spot.z > self.high)
        if np.any(beyond & ((before.z == self.low) | (before.z == self.high))):  # the step began on the bound
            self.ended = "bound"
            return None
        if np.any(beyond):
            spot = self._at_bound(spot)
            if not spot.residual <= self.tolerance:
                self.ended = "no convergence"
                return None
            self.ended = "bound"
        if self.secant:
            chord = spot.z - before.z
            spot = spot._replace(tangent=chord / np.linalg.norm(spot.weights * chord))
        self.spot, self.equations = spot, self.equations.update(spot.z, spot.null_vectors)
        return spot

    def _relax(self) -> None:
        """Tries the equations that accept more, if there are any, and ends the way otherwise."""
        relaxed = None if self.strict is not None or self.relaxed >= MOST_RELAXED else self.equations.relax()
        if relaxed is None:
            self.ended = "no convergence"
        else:
            self.equations, self.strict, self.step = relaxed, self.equations, self.pace.first

    def _good(self, spot: Spot, guess: np.ndarray, step: float) -> bool:
        """Tells whether a corrected point is the next one of the curve, and not one of another part of it."""
        if not spot.residual <= self.tolerance:
            return False
        strayed = np.linalg.norm(spot.weights * (spot.z - guess))
        if step < 2 * self.pace.least:
            return bool(strayed < CORNER_SHARE * step)
        if self.secant:
            # relaxed equations end beside the curve, and the next point is on it again
            return bool(strayed < max(STRAY_SHARE * step, self.pace.first if self.relaxed else 0.0))
        chord, mean = (spot.weights * a for a in (spot.z - self.spot.z, spot.tangent + self.spot.tangent))
        arched = chord @ mean > LEAST_ARCH * np.linalg.norm(chord) * np.linalg.norm(mean)
        return bool(spot.row @ self.spot.tangent > LEAST_TURN and strayed < STRAY_SHARE * step and arched)

    def _at_bound(self, beyond: Spot) -> Spot:
        """Finds the curve's point on the first bound before a point beyond; look at its `residual`."""
        edges, chord = np.clip(beyond.z, self.low, self.high), beyond.z - self.spot.z
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(edges == beyond.z, np.inf, (edges - self.spot.z) / chord)
        k = int(np.argmin(shares))  # the bound that is met first
        row = np.zeros_like(beyond.z)
        row[k] = np.sign(chord[k])
        guess = self.spot.z + shares[k] * chord
        guess[k] = edges[k]
        return correct(self.equations, guess, row, beyond.z, tolerance=self.tolerance)


def checked_bounds(bounds: Any, text: str = "numbers") -> tuple[float, float]:
    """Gives two numbers, the smaller first, infinite where there is no bound; raises `ValueError` otherwise."""
    try:
        low, high = (float(bound) for bound in bounds)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    require(low < high, "bounds", f"be two {text}, the smaller first", bounds)
    return low, high


def check_within(name: str, value: Any, bounds: tuple[float, float]) -> None:
    """Raises `ValueError` where the value of a parameter at the start lies outside its bounds."""
    if not bounds[0] <= value <= bounds[1]:
        raise ValueError(
            f"Argument `{name}` must lie within the bounds {shown_number(bounds[0])} and {shown_number(bounds[1])}, "
            f"but is {shown_number(value)}."
        )


def bounds_of_unknowns(size: int, *bounds: Any) -> tuple[np.ndarray, np.ndarray]:
    """Gives lower and upper bounds of all unknowns: those of parameters, checked, after `size` without bounds."""
    low, high = zip(*[(-np.inf, np.inf)] * size, *map(checked_bounds, bounds), strict=True)
    return np.array(low), np.array(high)


def passes(start: Spot, one: Spot, other: Spot) -> bool:
    """Tells whether a curve comes back to its start between two points."""
    chord, offset = other.weights * (other.z - one.z), other.weights * (start.z - one.z)
    share = chord @ offset / (chord @ chord)
    away = np.linalg.norm(offset - share * chord) / np.linalg.norm(chord)
    return bool(0 <= share <= 1 and away < RETURN_DISTANCE and start.row @ other.tangent > LEAST_TURN)


class Curve(NamedTuple):
    """Points of a curve in their order, and the reasons why it ends at the first and the last: "bound", "closed",
    "no convergence", "count", "interrupted" or that of `continue_critical`; empty where it begins there."""

    spots: tuple[Spot, ...]
    ended: tuple[str, str]


def follow_curve(
    equations: AbstractEquations,
    start: Spot,
    low: Any,
    high: Any,
    *,
    points: int = 400,
    on_point: Callable[[Spot], Any] | None = None,
    **options: Any,
) -> Curve:
    """Follows the curve through a point both ways, first that of its tangent.

    **Arguments:** `low`, `high`: see `Walk`; `points`: most points of each way; `on_point`: is called with each
    point, for progress; `options`: `pace`, `tolerance` and `secant` of `Walk`.

    **Returns:** a `Curve`; after Ctrl-C its part until then.
    """
    spots, ends = [start], ["", ""]

    def add(spot: Spot) -> str:
        spots.append(spot)
        if on_point is not None:
            on_point(spot)
        return "closed" if len(spots) > 3 and passes(spots[0], *spots[-2:]) else ""

    # ahead from the last point, then turned around and ahead once more
    for way in (1, 0):
        ends[way] = Walk(equations, spots[-1], low, high, **options).follow(points, add)
        if way and ends[way] in ("closed", "interrupted"):
            break
        spots[:] = [spot._replace(tangent=-spot.tangent) for spot in reversed(spots)]
    return Curve(tuple(spots), (ends[0], ends[1]))
