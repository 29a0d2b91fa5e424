"""Objectives, and their values and derivatives in cases."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import diffrax
import jax
import numpy as np
from jaxtyping import Float, Int

from ..analysis.kinds import Regime
from ..flow.numbers import RECORDS, AbstractNumber, OnePoint, Record
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..sweeps.records import LargestExponent
from ..tools.checks import require
from .ensembles import AbstractEnsemble
from .gradients import Objective, OrbitObjectives

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
    """Inverse of I - P_x, with P_x the orbit's Jacobian; NaN without an orbit."""
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
            inverse=nan(size, size),
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
