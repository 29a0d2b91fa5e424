"""Objectives, their values and derivatives in cases, and on periodic orbits by the implicit function theorem.

An orbit x recurs, P(x, p) = x. Therefore its derivative with respect to a parameter solves (I - P_x) dx/dp = P_p, and
Newton's method provides the inverse of I - P_x. Forward mode goes through the motion once along the parameters to
find P_p, and a second time along (dx/dp, dp).
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..analysis.floquet import linearise
from ..analysis.kinds import Regime
from ..flow.numbers import RECORDS, AbstractNumber, OnePoint, Record
from ..flow.period_map import PeriodMap, SlopePassage, advance_slopes
from ..flow.record import RecordSet, Unlabelled
from ..flow.status import Status
from ..flow.stepping import AbstractStepping
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import at_values, values_of
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..orbits.simulate import dynamic_steps
from ..sweeps.orbits import Maps, rows_of
from ..sweeps.records import LargestExponent
from ..tools.batching import Batched
from ..tools.checks import require
from ..tools.compile import jit
from ..tools.jacobian import slopes_along
from ..tools.types import Real
from .ensembles import AbstractEnsemble, RailEnsemble

Objective = AbstractNumber | LargestExponent
"""A number that judges a motion. Equal numbers share compiled programs."""


@dataclass(frozen=True)
class PeriodValues(Unlabelled):
    """The values of some numbers in each forcing period; their totals are differentiated."""

    numbers: tuple[AbstractNumber, ...]

    def values(self, scene, periods):
        return 10 * len(self.numbers) * periods

    def sample(self, course):
        return tuple(one.of(course) for one in self.numbers)


@dataclass(frozen=True)
class OrbitObjectives:
    """Objectives on orbits that are differentiated with respect to parameters."""

    objectives: tuple[Objective, ...]
    names: tuple[str, ...]
    """Names of the parameters."""
    most_steps: int
    """Steps per period for which its programs have capacity."""

    @property
    def numbers(self) -> tuple[AbstractNumber, ...]:
        """The objectives that are computed from courses of periods: all except exponents."""
        return tuple(one for one in self.objectives if isinstance(one, AbstractNumber))

    @property
    def exponents(self) -> tuple[LargestExponent, ...]:
        """The other objectives."""
        return tuple(one for one in self.objectives if isinstance(one, LargestExponent))

    def pushed(self, maps: Maps, index: np.ndarray, rows: np.ndarray, slopes: np.ndarray) -> SlopePassage:
        """Run cases over a forcing period, with derivatives."""
        stepping = dynamic_steps(maps.steps, most=self.most_steps)
        how = dict(names=self.names, records=RecordSet((PeriodValues(self.numbers),)), solver=maps.solver)
        call = lambda scenes, rows, slopes: advance_slopes(
            scenes, maps.states(rows), slopes, maps.epoch, stepping, **how
        )
        maps.on_progress(0)
        return maps.of_blocks(call, index, rows, slopes)

    def on(
        self, maps: Maps, rows: np.ndarray, inverse: np.ndarray
    ) -> tuple[
        Float[np.ndarray, "cases parameters size"],
        Float[np.ndarray, "cases objectives"],
        Float[np.ndarray, "cases objectives parameters"],
    ]:
        """Return the derivatives of states at the start of orbits, the objectives on these orbits, and the
        objectives' derivatives; NaN where the period of the map is 0.

        **Arguments:** `rows`: states at the start of the orbits; `inverse`: of I - P_x.
        """
        slopes = np.zeros((len(rows), len(self.names), rows.shape[1]))
        value = np.full((len(rows), len(self.objectives)), np.nan)
        gradient = np.full((*value.shape, len(self.names)), np.nan)
        is_number = np.array([isinstance(one, AbstractNumber) for one in self.objectives], bool)
        # all orbits of one period together
        for period in np.unique(maps.periods[maps.periods > 0]):
            index = np.flatnonzero(maps.periods == period)
            # P_p at the end of the period, with a fixed start
            end = self._periods(maps, index, rows[index], slopes[index])[-1][-1]
            # dx/dp = (I - P_x)^-1 P_p; the objectives are differentiated along it
            slopes[index] = np.einsum("cij,ckj->cki", inverse[index], end.slopes)
            periods = self._periods(maps, index, rows[index], slopes[index])
            for k in np.flatnonzero(~is_number):
                value[index, k], gradient[index, k] = self._exponents(maps, index, periods)
            if self.numbers:
                stacked = lambda axis, parts: jax.tree.map(lambda *of: np.stack(of, axis), *parts)
                kept = stacked(1, [passed.samples for *_, passed in periods])
                kept_slopes = stacked(2, [passed.sample_slopes for *_, passed in periods])
                totals = lambda scenes, *both: _total_slopes(self.numbers, *both)
                at = np.ix_(index, is_number)
                value[at], gradient[at] = maps.of_blocks(totals, index, *kept, *kept_slopes)
        slopes[maps.periods == 0] = np.nan
        return slopes, value, gradient

    def _periods(
        self, maps: Maps, index: np.ndarray, rows: np.ndarray, slopes: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray, SlopePassage]]:
        """Return states and derivatives at the start of each forcing period of orbits, and the period's result."""
        found = []
        for _ in range(maps.periods[index[0]]):
            passed = self.pushed(maps, index, rows, slopes)
            found.append((rows, slopes, passed))
            rows, slopes = rows_of(passed.state), np.asarray(passed.slopes)
        return found

    def _exponents(self, maps: Maps, index: np.ndarray, periods) -> tuple[np.ndarray, np.ndarray]:
        """Return ln |largest multiplier| per period on orbits (cases,), and derivatives (cases, parameters)."""
        how = dict(names=self.names, solver=maps.solver)
        call = lambda scenes, rows, slopes: _matrix_slopes(
            scenes, maps.states(rows), slopes, maps.epoch, dynamic_steps(maps.steps), **how
        )
        of_periods = [maps.of_blocks(call, index, rows, slopes) for rows, slopes, _ in periods]
        stacked = [np.stack(parts, axis=1) for parts in zip(*of_periods, strict=True)]
        found = [_exponent(*of_case) for of_case in zip(*stacked, strict=True)]
        value, gradient = zip(*found, strict=True)
        return np.array(value), np.array(gradient)


@functools.partial(jit, static_argnames=("numbers",))
def _total_slopes(numbers: tuple[AbstractNumber, ...], kept: PyTree, slopes: PyTree) -> tuple[Array, Array]:
    """Return numbers (cases, numbers), and their derivatives (cases, numbers, directions).

    **Arguments:** `kept`: values in each period, arrays (cases, periods, ...); `slopes`: their derivatives, arrays
    (cases, directions, periods, ...).
    """
    totals = lambda kept: jnp.stack([one.total(rows) for one, rows in zip(numbers, kept, strict=True)])

    of_case = lambda kept, slopes: slopes_along(totals, (kept,), slopes, axis=1)
    return jax.vmap(of_case)(kept, slopes)


@functools.partial(jit, static_argnames=("names", "solver"))
def _matrix_slopes(
    scenes: Batched[Scene],
    states: State,
    slopes: Float[Array, "cases directions size"],
    epoch: Real,
    stepping: AbstractStepping,
    *,
    names: tuple[str, ...],
    solver: diffrax.AbstractSolver,
) -> tuple[Float[Array, "cases size size"], Float[Array, "cases directions size size"]]:
    """Return the Jacobian of one forcing period, and its derivatives by parameters.

    **Arguments:** `slopes`: derivatives of the states at the start.
    """

    def one(scene: Scene, state: State, slopes: Array) -> tuple[Array, Array]:
        flat, unravel = ravel_pytree(state)

        def matrix(x: Array, p: Array) -> Array:
            step = PeriodMap(at_values(scene, names, p), stepping, solver)
            return linearise(step, unravel(x), 1, index=epoch)[1][0]

        # along each parameter, with the change of the start
        p = values_of(scene, names)
        return slopes_along(matrix, (flat, p), slopes, jnp.eye(p.size))

    return scenes.map(one, states, slopes)


def _exponent(matrices: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
    """Return ln |largest multiplier| per period of successive Jacobians (periods, size, size), and its derivatives.

    **Arguments:** `slopes`: derivatives of the Jacobians (periods, parameters, size, size).
    """
    count, size = matrices.shape[:2]
    # the product of the Jacobians and its derivatives, period by period
    product = np.eye(size)
    change = np.zeros((slopes.shape[1], size, size))
    for matrix, slope in zip(matrices, slopes, strict=True):
        change = matrix @ change + slope @ product
        product = matrix @ product
    mu, left, right = scipy.linalg.eig(product, left=True, right=True)  # pyright: ignore[reportAssignmentType]
    # the derivative of an eigenvalue from its left and right eigenvectors
    k = int(np.argmax(np.abs(mu)))
    w = left[:, k].conj()
    v = right[:, k]
    mu_slope = np.einsum("i,pij,j->p", w, change, v) / (w @ v)
    return float(np.log(np.abs(mu[k])) / count), np.real(mu_slope / mu[k]) / count


ObjectiveLike = Objective | str | Callable
"""An objective, a name in `OBJECTIVES`, or a function of a course."""


def _scalar(record: AbstractNumber) -> AbstractNumber:
    """Return a record as one number: the greatest or least of all points or slippers."""
    return OnePoint(record) if isinstance(record, Record) and record.is_extreme else record


OBJECTIVES: dict[str, Objective] = {
    name: _scalar(RECORDS[name])
    for name in (
        *("peak_slipper_force", "peak_slipper_moment", "static_ratio", "peak_force"),
        *(name for name in RECORDS if name.startswith("rms_")),
        *("impact_impulse", "contact_load", "contact_work", "drive_force"),
        *(f"excursion_{name}" for name in ("y", "z", "roll", "pitch", "yaw")),
        "grazing_distance",
    )
}
OBJECTIVES["exponent"] = LargestExponent()
"""Objectives by name. A suffix chooses one contact point, as in peak_force_A1, or one net load by its slipper or
axis, as in peak_slipper_force_left1_z."""


def objective_named(objective: object, argument: str = "objective") -> Objective:
    """Return the objective of a name, a record, or a function of a course; a function is averaged over periods.

    **Raises:** `ValueError` for other values, which names the `argument` and the allowed values.
    """
    if isinstance(objective, LargestExponent):
        return objective
    if isinstance(objective, AbstractNumber) and not _scalar(objective).dims:
        return _scalar(objective)
    if isinstance(objective, str):
        if objective in OBJECTIVES:
            return OBJECTIVES[objective]
        # a name with the suffix of a point
        for name, one in OBJECTIVES.items():
            if isinstance(one, OnePoint) and objective.startswith(f"{name}_"):
                return OnePoint(one.record, objective.removeprefix(f"{name}_"))
    need = f"be one of {', '.join(OBJECTIVES)}, a record of one number, or a function of a course"
    require(callable(objective) and not isinstance(objective, type), argument, need, objective, names=OBJECTIVES)
    name = getattr(objective, "__name__", "functional").strip("<>")
    return Record(Quantity(name, "1", name), objective, "mean")


@dataclass(frozen=True, kw_only=True)
class EvaluationPlan(OrbitObjectives):
    """Objectives to evaluate, parameters for their derivatives, and settings of simulations."""

    scene: Scene
    solver: diffrax.AbstractSolver
    steps: int
    """Steps per forcing period, the same for all cases: objectives would jump where the number changes."""
    start: Motion | State
    reach: Mapping[str, float]
    """Distance of ensembles' parameters from a case's, by name [their SI units]."""
    transient: int
    """Forcing periods from the start before the search for an orbit."""
    ensemble: AbstractEnsemble
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest allowed values of parameters, by name [their SI units]."""

    @property
    def on_rails(self) -> bool:
        """Whether cases are judged along rails that do not recur."""
        return isinstance(self.ensemble, RailEnsemble)

    @property
    def on_orbits(self) -> bool:
        """Whether orbits of cases are searched: not on rails that bend, whose waves are too many numbers."""
        return not self.on_rails and self.scene.beam is None


class Evaluation(NamedTuple):
    """Objectives of cases and the motions to which they belong; arrays with a leading axis of cases."""

    status: Int[np.ndarray, " cases"]
    """`Status` codes."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods after which the motion recurs; 0 for motions that are not on a stable periodic orbit."""
    kind: Int[np.ndarray, " cases"]
    """Numbers of `slipperjax.analysis.Regime`; periodic only on stable orbits."""
    multiplier: Float[np.ndarray, " cases"]
    """Modulus of the orbit's largest Floquet multiplier over its period [1]; NaN without an orbit."""
    state: Float[np.ndarray, "cases size"]
    """All numbers of the state at the start of a forcing period."""
    value: Float[np.ndarray, "cases objectives"]
    """NaN for cases that left the rail or are not finite."""
    gradient: Float[np.ndarray, "cases objectives parameters"]
    stderr: Float[np.ndarray, "cases objectives"]
    """Standard errors of the values: 0 on orbits."""
    gradient_stderr: Float[np.ndarray, "cases objectives parameters"]
    inverse: Float[np.ndarray, "cases size size"]
    """Inverse of I - P_x, with P_x the orbit's Jacobian; NaN without an orbit, empty where none is searched."""
    simulated: Float[np.ndarray, " cases"]
    """Simulated forcing periods; derivatives count by their cost."""
    lost: Int[np.ndarray, " cases"]
    """Lost runs of the case's ensemble, which do not count; no run of their rails counts then."""

    @classmethod
    def of_states(
        cls,
        plan: EvaluationPlan,
        state: Float[np.ndarray, "cases size"],
    ) -> "Evaluation":
        """Return an evaluation that has states, but no values yet."""
        count, size = state.shape
        objectives = len(plan.objectives)
        parameters = len(plan.names)
        # NaN where nothing is known
        nan = lambda *shape: np.full((count, *shape), np.nan)
        of_orbits = size if plan.on_orbits else 0
        return cls(
            status=np.zeros(count, int),
            period=np.zeros(count, int),
            kind=np.full(count, int(Regime.UNRESOLVED)),
            multiplier=nan(),
            state=state.copy(),
            value=nan(objectives),
            gradient=nan(objectives, parameters),
            stderr=nan(objectives),
            gradient_stderr=nan(objectives, parameters),
            inverse=nan(of_orbits, of_orbits),
            simulated=np.zeros(count),
            lost=np.zeros(count, int),
        )

    @property
    def regime(self) -> np.ndarray:
        """Kinds of motion as texts: "period n", another one of `slipperjax.analysis.KINDS`, or "lost"."""
        periods = np.char.add("period ", self.period.astype(str))
        names = np.where(self.period > 0, periods, Regime.kind_names(self.kind))
        return np.where(self.status == Status.FINITE, names, "lost")

    def take(self, index: np.ndarray) -> "Evaluation":
        """Return the evaluation of the cases at `index`."""
        return jax.tree.map(lambda array: array[index], self)
