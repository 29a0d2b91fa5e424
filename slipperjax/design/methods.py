"""How a design moves through its box: from values and derivatives in every case to the next trial.

Designs are points of the unit box. Each start moves on its own; their trials are judged as one batch.
"""

import abc
import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Bool, Float
from scipy.optimize import linprog

SLACK = 30.0
"""Price of a violated constraint, in multiples of the objective's size."""


class Faced(NamedTuple):
    """What a design faces: objective and constraints in its cases, and their derivatives by the unit box."""

    value: Float[np.ndarray, " cases"]
    slope: Float[np.ndarray, "cases parameters"]
    excess: Float[np.ndarray, " constraints"]
    """By how much each constraint is violated in each case, in multiples of its limit; negative where it is kept."""
    excess_slope: Float[np.ndarray, "constraints parameters"]
    weight: Float[np.ndarray, " cases"] | None
    """Weights of the cases in a mean; None for the worst case."""

    @property
    def total(self) -> float:
        """The objective over all cases; infinite where one has none."""
        if not np.all(np.isfinite(self.value)):
            return np.inf
        return float(np.max(self.value) if self.weight is None else self.weight @ self.value)

    @property
    def total_slope(self) -> np.ndarray:
        """A derivative of the total: that of the worst case, or the mean."""
        weight = self.weight
        return self.slope[int(np.nanargmax(self.value))] if weight is None else weight @ self.slope

    @property
    def violation(self) -> float:
        """The greatest violation of a constraint, 0 without."""
        worst = np.max(self.excess, initial=0.0)
        return float(worst) if np.isfinite(worst) else np.inf

    def merit(self, size: float) -> float:
        """Total and price of violations together."""
        return self.total + SLACK * size * self.violation


class Step(NamedTuple):
    """A proposed design."""

    to: Float[np.ndarray, " parameters"]
    predicted: float
    """By how much the merit should fall; NaN where nothing is predicted."""


@dataclasses.dataclass
class AbstractMove(abc.ABC):
    """One start on its way. `finished` says whether it stays where it is."""

    at: Float[np.ndarray, " parameters"]
    faced: Faced
    finished: bool = False

    @abc.abstractmethod
    def propose(self) -> Step:
        """The next trial."""

    @abc.abstractmethod
    def hear(self, step: Step, faced: Faced) -> bool:
        """Told what a trial faces; whether it is taken."""


class AbstractMethod(abc.ABC):
    """A way to move designs."""

    @abc.abstractmethod
    def start(self, at: np.ndarray, faced: Faced) -> AbstractMove:
        """A start on its way."""


@dataclasses.dataclass
class _TrustRegionMove(AbstractMove):
    radius: float = 0.1
    least: float = 1e-3
    size: float = 1.0
    bent: tuple[np.ndarray, np.ndarray] | None = None
    """By how much objective and constraints of a refused trial missed their linear predictions."""

    def propose(self):
        step = _linear_step(self.at, self.faced, self.radius, self.size, self.bent)
        if self.bent is None and not step.predicted > 1e-9 * self.size:
            self.finished = True
        return step

    def hear(self, step, faced):
        fell = self.faced.merit(self.size) - faced.merit(self.size)
        share = fell / step.predicted if np.isfinite(fell) and step.predicted > 0 else -np.inf
        taken = share > 0.1
        if not taken and self.bent is None and np.all(np.isfinite(faced.value)) and np.all(np.isfinite(faced.excess)):
            # a second trial of the same size that allows for the curvature which the first one met
            move = step.to - self.at
            bent = faced.value - self.faced.value - self.faced.slope @ move
            excess = faced.excess - self.faced.excess - self.faced.excess_slope @ move
            self.bent = np.nan_to_num(bent), np.nan_to_num(excess)
            return False
        self.bent = None
        if taken:
            self.at, self.faced = step.to, faced
        self.radius *= 2.0 if share > 0.75 else 1.0 if share > 0.25 else 0.4
        self.radius = min(self.radius, 0.3)
        self.finished |= self.radius < self.least
        return taken


@dataclasses.dataclass(frozen=True)
class TrustRegion(AbstractMethod):
    """Linear programs in a region that shrinks where they mislead.

    The objective in every case and the constraints are linearised, and the worst case (or the mean) is minimised in a
    box around the design; its size follows from how well the last prediction did. At the corners where worst cases
    meet, this converges like Newton's method; along curved ridges and limits a refused trial is followed by one that
    allows for the curvature it met. (Madsen 1975, doi:10.1093/imamat/16.3.321)
    """

    radius: float = 0.1
    """First half width of the region [unit box]."""
    least: float = 1e-3
    """Half width at which a start ends [unit box]."""

    def start(self, at, faced):
        size = max(abs(faced.total), 1e-300) if np.isfinite(faced.total) else 1.0
        return _TrustRegionMove(at, faced, False, self.radius, self.least, size)


def _linear_step(at: np.ndarray, faced: Faced, radius: float, size: float, bent: Any = None) -> Step:
    """The best step of the linearised problem. Unknowns: the step, the objective's bound, and one slack.

    **Arguments:** `bent`: what is added to objective and constraints for their curvature.
    """
    curved, excess_curved = (0 * faced.value, 0 * faced.excess) if bent is None else bent
    count = len(at)
    known = np.isfinite(faced.value) & np.all(np.isfinite(faced.slope), axis=1)
    rows, bounds = [], []
    if faced.weight is None:
        for value, slope in zip((faced.value + curved)[known] / size, faced.slope[known] / size, strict=True):
            rows.append([*slope, -1.0, 0.0])
            bounds.append(-value)
        aim = [*np.zeros(count), 1.0, SLACK]
    else:
        aim = [*(faced.weight[known] @ faced.slope[known] / size), 0.0, SLACK]
    usable = np.isfinite(faced.excess) & np.all(np.isfinite(faced.excess_slope), axis=1)
    for excess, slope in zip((faced.excess + excess_curved)[usable], faced.excess_slope[usable], strict=True):
        rows.append([*slope, 0.0, -1.0])
        bounds.append(-excess)
    box = [(max(-radius, -x), min(radius, 1 - x)) for x in at]
    box += [(None, None) if faced.weight is None and rows else (0.0, 0.0), (0.0, None)]
    found = linprog(aim, np.array(rows) if rows else None, bounds if rows else None, bounds=box, method="highs")
    if found.x is None:
        return Step(at, 0.0)
    move, slack = found.x[:count], found.x[-1]
    now = faced.total if np.isfinite(faced.total) else np.nanmax(faced.value, initial=-np.inf)
    then = size * found.x[count] if faced.weight is None else now + faced.weight[known] @ faced.slope[known] @ move
    violated = faced.violation if np.isfinite(faced.violation) else 0.0
    return Step(np.clip(at + move, 0.0, 1.0), float(now - then + SLACK * size * (violated - slack)))


@dataclasses.dataclass
class _DescentMove(AbstractMove):
    optimiser: Any = None
    state: Any = None
    size: float = 1.0
    left: int = 0

    def propose(self):
        slope = self.faced.total_slope / self.size
        if self.faced.violation > 0 and len(self.faced.excess):
            slope = slope + SLACK * self.faced.excess_slope[int(np.argmax(self.faced.excess))]
        update, self.state = self.optimiser.update(jnp.asarray(slope), self.state, jnp.asarray(self.at))
        to = optax.projections.projection_box(optax.apply_updates(jnp.asarray(self.at), update), 0.0, 1.0)
        return Step(np.asarray(to), np.nan)

    def hear(self, step, faced):
        self.left -= 1
        if np.all(np.isfinite(faced.total_slope)) and np.isfinite(faced.total):
            self.at, self.faced = step.to, faced
        else:
            self.finished = True
        self.finished |= self.left <= 0
        return True


@dataclasses.dataclass(frozen=True)
class Descent(AbstractMethod):
    """An optimiser of optax on the worst case's derivative or the mean's, projected to the box."""

    optimiser: Any = None
    """An `optax.GradientTransformation`; default Adam with a rate that falls from 0.05 to 0.001 [unit box]."""
    steps: int = 60

    def start(self, at, faced):
        optimiser = self.optimiser
        if optimiser is None:
            optimiser = optax.adam(optax.exponential_decay(0.05, self.steps, 0.02))
        size = max(abs(faced.total), 1e-300) if np.isfinite(faced.total) else 1.0
        return _DescentMove(at, faced, False, optimiser, optimiser.init(jnp.asarray(at)), size, self.steps)


def inside(at: Float[np.ndarray, " parameters"]) -> Bool[np.ndarray, " parameters"]:
    """Which coordinates of a design are not at a bound."""
    return (at > 1e-9) & (at < 1 - 1e-9)
