"""Methods of search: from values and derivatives in every case to the next trial.

Designs are points of the unit box. Each start moves on its own; their trials are judged as one batch.
"""

import abc
import dataclasses
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
    """Objective and constraints of a design in its cases, and their derivatives by the unit box."""

    value: Float[np.ndarray, " cases"]
    slope: Float[np.ndarray, "cases parameters"]
    excess: Float[np.ndarray, " constraints"]
    """Violation of each constraint in each case, in multiples of its limit; negative where it is kept."""
    excess_slope: Float[np.ndarray, "constraints parameters"]
    weight: Float[np.ndarray, " cases"] | None
    """Weights of the cases in a mean; None for the worst case."""

    @property
    def total(self) -> float:
        """The objective over all cases; infinite where one has none."""
        if not np.all(np.isfinite(self.value)):
            return np.inf
        # a mean needs all cases, as the worst does
        return float(np.max(self.value) if self.weight is None else self.weight @ self.value)

    @property
    def size(self) -> float:
        """The magnitude of the total; 1 where it is infinite."""
        return max(abs(self.total), 1e-300) if np.isfinite(self.total) else 1.0

    @property
    def violation(self) -> float:
        """The greatest violation of a constraint, in multiples of its limit; 0 without."""
        worst = np.max(self.excess, initial=0.0)
        return float(worst) if np.isfinite(worst) else np.inf

    def merit(self, size: float) -> float:
        """Return the total plus the price of violations; `size`: of the objective."""
        return self.total + VIOLATION_PRICE * size * self.violation


@dataclasses.dataclass
class AbstractMove(abc.ABC):
    """A start on its way through the unit box."""

    at: Float[np.ndarray, " parameters"]
    values: CaseValues
    size: float
    """Magnitude of the objective at the first design."""
    finished: bool = dataclasses.field(default=False, kw_only=True)

    @abc.abstractmethod
    def propose(self) -> Float[np.ndarray, " parameters"]:
        """Return the design to try next."""

    @abc.abstractmethod
    def update(
        self,
        at: Float[np.ndarray, " parameters"],
        values: CaseValues,
    ) -> bool:
        """Accept or reject the design that was tried, and return whether it was accepted."""


class AbstractMethod(abc.ABC):
    """A way to move designs."""

    @abc.abstractmethod
    def start(self, at: np.ndarray, values: CaseValues) -> AbstractMove:
        """Return the move that begins at a design with its values."""


class _Curvature(NamedTuple):
    """Differences of a rejected trial from the linear predictions."""

    value: np.ndarray
    excess: np.ndarray


@dataclasses.dataclass
class _TrustRegionMove(AbstractMove):
    radius: float
    least: float
    predicted: float = 0.0
    """Predicted fall of the merit by the last trial."""
    curvature: _Curvature | None = None
    """Of the last trial, if it was the first of its size and rejected."""

    def propose(self):
        at, self.predicted = _linear_step(
            self.at,
            self.values,
            self.radius,
            self.size,
            self.curvature,
        )
        # nothing more to gain by first order
        if self.curvature is None and not self.predicted > 1e-9 * self.size:
            self.finished = True
        return at

    def update(self, at, values):
        # the share of the predicted fall that came true
        fall = self.values.merit(self.size) - values.merit(self.size)
        share = -np.inf
        if np.isfinite(fall) and self.predicted > 0:
            share = fall / self.predicted
        accepted = share > 0.1
        finite = np.all(np.isfinite(values.value)) and np.all(np.isfinite(values.excess))
        # a second trial of the same size allows for the curvature of the first
        if not accepted and self.curvature is None and finite:
            move = at - self.at
            value = values.value - self.values.value - self.values.slope @ move
            excess = values.excess - self.values.excess - self.values.excess_slope @ move
            self.curvature = _Curvature(np.nan_to_num(value), np.nan_to_num(excess))
            return False
        self.curvature = None
        if accepted:
            self.at = at
            self.values = values
        # the region grows where predictions were good, and shrinks where they were not
        self.radius *= 2.0 if share > 0.75 else 1.0 if share > 0.25 else 0.4
        self.radius = min(self.radius, 0.3)
        self.finished |= self.radius < self.least
        return accepted


@dataclasses.dataclass(frozen=True)
class TrustRegion(AbstractMethod):
    """Linear programs in a region that shrinks where they mislead.

    The objective in every case and the constraints are linearised, and the worst case (or the mean) is minimised in a
    box around the design; its size follows from the error of the last prediction. At the corners where worst cases
    meet, this converges like Newton's method; along curved ridges and limits a rejected trial is followed by one that
    allows for its curvature. (Madsen 1975, doi:10.1093/imamat/16.3.321)
    """

    radius: float = 0.1
    """First half width of the region [unit box]."""
    least: float = 1e-3
    """Half width at which a start ends [unit box]."""

    def __post_init__(self):
        number(positive, "radius", self.radius)
        number(positive, "least", self.least)

    def start(self, at, values):
        return _TrustRegionMove(at, values, values.size, self.radius, self.least)


def _linear_step(
    at: np.ndarray,
    values: CaseValues,
    radius: float,
    size: float,
    curvature: _Curvature | None,
) -> tuple[np.ndarray, float]:
    """Solve the linearised problem; return the design to try and the predicted fall of the merit.

    Unknowns are the step, the bound of the objective, and one slack of all constraints.

    **Arguments:** `curvature`: additions to each case of a worst-case objective, and to constraints.
    """
    value = values.value
    excess = values.excess
    if curvature is not None:
        value = value + curvature.value
        excess = excess + curvature.excess
    # cases and constraints without a value have no row
    finite = np.isfinite(values.value) & np.all(np.isfinite(values.slope), axis=1)
    usable = np.isfinite(values.excess) & np.all(np.isfinite(values.excess_slope), axis=1)
    value = value[finite]
    slope = values.slope[finite]
    excess = excess[usable]
    excess_slope = values.excess_slope[usable]
    if values.weight is not None:
        value = np.array([values.total])
        slope = values.weight[None, finite] @ slope
    # slope @ step + value <= bound for every case or the mean, and slope @ step + excess <= slack for constraints
    bound_rows = np.hstack([slope / size, np.tile([-1.0, 0.0], (len(slope), 1))])
    slack_rows = np.hstack([excess_slope, np.tile([0.0, -1.0], (len(excess_slope), 1))])
    rows = np.vstack([bound_rows, slack_rows])
    limits = -np.concatenate([value / size, excess])
    aim = [*np.zeros(len(at)), 1.0, VIOLATION_PRICE]
    # the region and the unit box; the bound is free, the slack positive
    box: list[Any] = [(max(-radius, -x), min(radius, 1 - x)) for x in at]
    box += [(None, None), (0.0, None)]
    solution = linprog(aim, rows, limits, bounds=box, method="highs").x
    # without a solution the design stays
    if solution is None:
        return at, 0.0
    *move, bound, slack = solution
    violation = values.violation if np.isfinite(values.violation) else 0.0
    fall = values.total - size * bound + VIOLATION_PRICE * size * (violation - slack)
    return np.clip(at + move, 0.0, 1.0), float(fall)


@dataclasses.dataclass
class _DescentMove(AbstractMove):
    optimiser: Any
    state: Any
    left: int

    def propose(self):
        values = self.values
        slope = _total_slope(values) / self.size
        # a violated constraint adds its own slope at its price
        if values.violation > 0 and len(values.excess):
            worst = int(np.argmax(values.excess))
            slope = slope + VIOLATION_PRICE * values.excess_slope[worst]
        at = jnp.asarray(self.at)
        update, self.state = self.optimiser.update(jnp.asarray(slope), self.state, at)
        moved = optax.apply_updates(at, update)
        return np.asarray(optax.projections.projection_box(moved, 0.0, 1.0))

    def update(self, at, values):
        self.left -= 1
        # a start that loses the motion ends
        finite = np.isfinite(values.total) and np.all(np.isfinite(_total_slope(values)))
        if finite:
            self.at = at
            self.values = values
        self.finished |= not finite or self.left <= 0
        return bool(finite)


def _total_slope(values: CaseValues) -> np.ndarray:
    """Return a derivative of the total: that of the worst case, or the mean."""
    if values.weight is None:
        return values.slope[int(np.nanargmax(values.value))]
    return values.weight @ values.slope


@dataclasses.dataclass(frozen=True)
class Descent(AbstractMethod):
    """An optimiser of optax on the derivative of the worst case or the mean, projected to the box."""

    optimiser: Any = None
    """An `optax.GradientTransformation`; default Adam with a rate that falls from 0.05 to 0.001 [unit box]."""
    steps: int = 60

    def __post_init__(self):
        good = self.optimiser is None or hasattr(self.optimiser, "update")
        require(good, "optimiser", "be an optax.GradientTransformation", self.optimiser)
        whole("steps", self.steps, 1)

    def start(self, at, values):
        rate = optax.exponential_decay(0.05, self.steps, 0.02)
        optimiser = self.optimiser or optax.adam(rate)
        state = optimiser.init(jnp.asarray(at))
        return _DescentMove(at, values, values.size, optimiser, state, self.steps)
