"""Methods of search: from values and derivatives in every case to the next trial.

Designs are points of the unit box. Each start moves separately; the trials of all starts are judged as one batch.
"""

import abc
import dataclasses
from collections.abc import Generator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float
from scipy.optimize import linprog

from ..tools.checks import number, positive, require, whole

VIOLATION_PRICE = 30.0
"""Price of a violated constraint, in multiples of the objective's size."""


class CaseValues(NamedTuple):
    """Objective and constraints of a design in its cases, and their derivatives with respect to the unit box."""

    value: Float[np.ndarray, " cases"]
    slope: Float[np.ndarray, "cases parameters"]
    excess: Float[np.ndarray, " constraints"]
    """Violation of each constraint in each case, in multiples of its limit; negative where the constraint is met."""
    excess_slope: Float[np.ndarray, "constraints parameters"]
    weight: Float[np.ndarray, " cases"] | None
    """Weights of the cases in a mean; None for the worst case."""

    @property
    def total(self) -> float:
        """The objective over all cases; infinite where a case has none."""
        if not np.all(np.isfinite(self.value)):
            return np.inf
        # both the mean and the worst case need all cases
        return float(np.max(self.value) if self.weight is None else self.weight @ self.value)

    @property
    def size(self) -> float:
        """The magnitude of the total; 1 where it is infinite."""
        return max(abs(self.total), 1e-300) if np.isfinite(self.total) else 1.0

    @property
    def violation(self) -> float:
        """The greatest violation of a constraint, in multiples of its limit; 0 without a violation."""
        worst = np.max(self.excess, initial=0.0)
        return float(worst) if np.isfinite(worst) else np.inf

    def merit(self, size: float) -> float:
        """Return the total plus the price of violations; `size`: of the objective."""
        return self.total + VIOLATION_PRICE * size * self.violation


class AbstractMethod(abc.ABC):
    """Method by which a start moves from design to design."""

    @abc.abstractmethod
    def moves(
        self,
        at: Float[np.ndarray, " parameters"],
        values: CaseValues,
    ) -> Generator[Any, CaseValues, None]:
        """Yield a design to try; after its `CaseValues` were sent, yield whether the design is accepted; and so on.

        **Arguments:** `at`: the first design, with its `values`.
        """


@dataclasses.dataclass(frozen=True)
class TrustRegion(AbstractMethod):
    """Linear programs in a region that shrinks where they mislead.

    The objective in every case and the constraints are linearised, and the worst case (or the mean) is minimised in a
    box around the design. The error of the last prediction decides the size of the box. At corners where several
    worst cases meet, this converges like Newton's method. Along curved ridges and limits, a rejected trial is
    followed by a trial that includes its curvature. (Madsen 1975, doi:10.1093/imamat/16.3.321)
    """

    radius: float = 0.1
    """First half width of the region [unit box]."""
    least: float = 1e-3
    """Half width at which a start ends [unit box]."""

    def __post_init__(self):
        number(positive, "radius", self.radius)
        number(positive, "least", self.least)

    def moves(self, at, values):
        size = values.size
        radius = self.radius
        while radius >= self.least:
            curved = values
            # a second trial of the same size includes the curvature of the first
            for second in (False, True):
                trial, predicted = _linear_step(at, values, curved, radius, size)
                # the linear model predicts no further improvement
                if not (second or predicted > 1e-9 * size):
                    return
                found = yield trial
                # true share of the predicted fall of the merit
                fall = values.merit(size) - found.merit(size)
                share = fall / predicted if np.isfinite(fall) and predicted > 0 else -np.inf
                known = np.all(np.isfinite(found.value)) and np.all(np.isfinite(found.excess))
                if second or share > 0.1 or not known:
                    break
                yield False
                curved = _with_curvature(values, found, trial - at)
            yield share > 0.1
            # a trial with a worse result than this is ignored
            if share > 0.1:
                at = trial
                values = found
            # the region grows after good predictions, and shrinks after bad ones
            radius *= 2.0 if share > 0.75 else 1.0 if share > 0.25 else 0.4
            radius = min(radius, 0.3)


def _with_curvature(values: CaseValues, found: CaseValues, move: np.ndarray) -> CaseValues:
    """Return values at a design plus what a trial there had in addition to the linear prediction."""
    # a case without a value adds nothing
    value = found.value - values.value - values.slope @ move
    excess = found.excess - values.excess - values.excess_slope @ move
    return values._replace(value=values.value + np.nan_to_num(value), excess=values.excess + np.nan_to_num(excess))


def _linear_step(
    at: np.ndarray,
    values: CaseValues,
    curved: CaseValues,
    radius: float,
    size: float,
) -> tuple[np.ndarray, float]:
    """Solve the linearised problem; return the design to try and the predicted fall of the merit.

    Unknowns are the step, the bound of the objective, and one slack of all constraints.

    **Arguments:** `curved`: values that include curvature, in each case of a worst-case objective and in
    constraints.
    """
    # cases and constraints without a value have no row
    finite = np.isfinite(values.value) & np.all(np.isfinite(values.slope), axis=1)
    usable = np.isfinite(values.excess) & np.all(np.isfinite(values.excess_slope), axis=1)
    value = curved.value[finite]
    slope = values.slope[finite]
    excess = curved.excess[usable]
    excess_slope = values.excess_slope[usable]
    if values.weight is not None:
        value = np.array([values.total])
        slope = values.weight[None, finite] @ slope
    # slope @ step + value <= bound for every case or the mean, and slope @ step + excess <= slack for constraints
    # columns: the step, the bound, the slack
    bound_rows = np.hstack([slope / size, np.tile([-1.0, 0.0], (len(slope), 1))])
    slack_rows = np.hstack([excess_slope, np.tile([0.0, -1.0], (len(excess_slope), 1))])
    rows = np.vstack([bound_rows, slack_rows])
    limits = -np.concatenate([value / size, excess])
    # least bound, and the slack at the price of a violation
    aim = [*np.zeros(len(at)), 1.0, VIOLATION_PRICE]
    # the region and the unit box; the bound is free, the slack is positive
    box: list[tuple[float | None, float | None]] = [(max(-radius, -x), min(radius, 1 - x)) for x in at]
    box += [(None, None), (0.0, None)]
    solution = linprog(aim, rows, limits, bounds=box, method="highs").x
    # without a solution the design stays
    if solution is None:
        return at, 0.0
    *move, bound, slack = solution
    violation = values.violation if np.isfinite(values.violation) else 0.0
    fall = values.total - size * bound + VIOLATION_PRICE * size * (violation - slack)
    return np.clip(at + move, 0.0, 1.0), float(fall)


def _total_slope(values: CaseValues) -> np.ndarray:
    """Return a derivative of the total: of the worst case, or of the mean."""
    if values.weight is None:
        return values.slope[int(np.nanargmax(values.value))]
    return values.weight @ values.slope


@dataclasses.dataclass(frozen=True)
class Descent(AbstractMethod):
    """An optimiser of optax that uses the derivative of the worst case or the mean, projected to the box."""

    optimiser: optax.GradientTransformation | None = None
    """An `optax.GradientTransformation`; default Adam with a rate that falls from 0.05 to 0.001 [unit box]."""
    steps: int = 60

    def __post_init__(self):
        good = self.optimiser is None or hasattr(self.optimiser, "update")
        require(good, "optimiser", "be an optax.GradientTransformation", self.optimiser)
        whole("steps", self.steps, 1)

    def moves(self, at, values):
        size = values.size
        rate = optax.exponential_decay(0.05, self.steps, 0.02)
        optimiser = self.optimiser or optax.adam(rate)
        state = optimiser.init(jnp.asarray(at))
        for _ in range(self.steps):
            slope = _total_slope(values) / size
            # a violated constraint adds its own slope, times its price
            if values.violation > 0 and len(values.excess):
                worst = int(np.argmax(values.excess))
                slope = slope + VIOLATION_PRICE * values.excess_slope[worst]
            update, state = optimiser.update(jnp.asarray(slope), state, jnp.asarray(at))
            moved = optax.apply_updates(jnp.asarray(at), update)
            at = np.asarray(optax.projections.projection_box(moved, 0.0, 1.0))
            values = yield at
            # a start that loses the motion ends
            finite = bool(np.isfinite(values.total) and np.all(np.isfinite(_total_slope(values))))
            yield finite
            if not finite:
                return
