"""Objectives, and their values and derivatives in cases."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import diffrax
import jax
import numpy as np
from jaxtyping import Float, Int

from ..analysis.kinds import Regime
from ..analysis.quantiles import bootstrap, check_quantile, mean_plane, quantile_plane
from ..flow.records import POINTS, RECORDS, AbstractNumber, OnePoint, Record
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import Quantity
from ..model.rails import TrackSet
from ..model.scene import Scene
from ..model.tracks import AbstractTrack
from ..orbits.motions import recurs
from ..sweeps.records import LargestExponent
from ..tools.checks import instance, require, whole

LEAST_SHARE = 0.5
"""Share of the runs of an ensemble that must stay on the rail for a mean."""

Objective = AbstractNumber | LargestExponent
"""A number that a motion is judged by. Equal ones share compiled programs."""


def _scalar(record: AbstractNumber) -> AbstractNumber:
    """Returns a record as one number: the greatest or least of all points."""
    of_points = isinstance(record, Record) and record.dims == POINTS and record.over in ("max", "min")
    return OnePoint(record) if of_points else record


_NAMES = (
    "peak_force",
    *(name for name in RECORDS if name.startswith("rms_")),
    *("impact_impulse", "contact_load", "contact_work", "drive_force"),
    *(f"excursion_{name}" for name in ("y", "z", "roll", "pitch", "yaw")),
    "grazing_distance",
)
OBJECTIVES: dict[str, Objective] = {name: _scalar(RECORDS[name]) for name in _NAMES} | {"exponent": LargestExponent()}
"""Objectives by name; with a point behind, such as peak_force_A1, of one contact point."""


def objective_named(objective: Any) -> Objective:
    """Returns the objective of a name, a record, or a function of a course, averaged over periods.

    **Raises:** `ValueError` for anything else, with the names.
    """
    if isinstance(objective, LargestExponent):
        return objective
    if isinstance(objective, AbstractNumber) and not _scalar(objective).dims:
        return _scalar(objective)
    if isinstance(objective, str):
        if objective in OBJECTIVES:
            return OBJECTIVES[objective]
        for name in _NAMES:
            if RECORDS[name].dims == POINTS and objective.startswith(f"{name}_"):
                return OnePoint(RECORDS[name], objective.removeprefix(f"{name}_"))
    need = f"be one of {', '.join(OBJECTIVES)}, a record of one number, or a function of a course"
    require(callable(objective) and not isinstance(objective, type), "objective", need, objective)
    name = getattr(objective, "__name__", "functional").strip("<>")
    return Record(Quantity(name, "1", name), objective, "mean")


@dataclass(frozen=True)
class EnsembleSettings:
    """Ensembles of runs from disturbed starts, of whose values the mean is taken.

    The defaults give slopes to some 10 % where averages change by as much.
    """

    box_reach: ClassVar[float] = 0.005
    """Distance of the runs' parameters from a design's [unit box]."""
    relative_reach: ClassVar[float] = 0.002
    """Likewise in `sensitivities`, over the parameters' values [1]."""
    members: int = 32
    """Runs of each case."""
    transient: int = 60
    """Forcing periods before recording, in which disturbances grow to the attractor's size."""
    periods: int = 100
    """Recorded forcing periods of each run."""
    seed: int = 0

    def __post_init__(self):
        for name, least in (("members", 4), ("transient", 0), ("periods", 1), ("seed", 0)):
            whole(name, getattr(self, name), least)

    def rails(self, track: AbstractTrack, count: int) -> dict[str, np.ndarray]:
        """Returns the numbers that choose `count` rails, by their paths in the scene. Here none: all share one."""
        del track, count
        return {}

    def enough(self, share: float) -> bool:
        """Tells whether the share of the runs that stayed on the rail [1] is enough for a value."""
        return share >= LEAST_SHARE

    def fit(self, corners: np.ndarray, values: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, ...]:
        """Fits planes to runs at the corners of a box around a design.

        **Arguments:** `corners`: shape (corners, parameters), from the design in multiples of the reach; `values`:
        shape (corners, runs, objectives); `kept`: whether each run stayed on the rail, shape (corners, runs).

        **Returns:** values at the design, shape (objectives,), and their standard errors; slopes per reach, shape
        (objectives, parameters), and theirs; NaN where the runs are too few.
        """
        signs = np.repeat(corners, values.shape[1], axis=0)
        return fit_plane(signs, values.reshape(len(signs), -1), kept.ravel())


@dataclass(frozen=True)
class RailEnsemble(EnsembleSettings):
    """Ensembles of runs along rails that do not recur, of whose values a quantile is taken.

    Each run has a rail of its own where the scene's track is one of many: the seeds of a `RandomTrack`, the numbers
    of a `TrackSet`. All designs run on the same rails, unless the search draws new ones. Runs that leave the rail
    count as greater than all others.
    """

    box_reach: ClassVar[float] = 0.05
    relative_reach: ClassVar[float] = 0.05
    members: int = 400
    """Runs of each case, at all corners of a box together."""
    transient: int = 5
    """Reference lengths of travel before recording."""
    periods: int = 100
    """Recorded reference lengths of travel."""
    seed: int = 0
    """Number of the batch of rails; batches have no rails in common."""
    quantile: float | None = 0.99
    """Share of rails on which the objective is lower [1]; None for the mean."""

    def __post_init__(self):
        super().__post_init__()
        check_quantile(self.quantile, self.members)

    def rails(self, track: AbstractTrack, count: int) -> dict[str, np.ndarray]:
        numbers = self.seed * count + np.arange(count, dtype=float)
        of = lambda part: numbers % len(part.tracks) if isinstance(part, TrackSet) else numbers
        return {path: of(part) for path, part in _of_many(track, "track")}

    def enough(self, share: float) -> bool:
        return share >= LEAST_SHARE if self.quantile is None else share > self.quantile

    def fit(self, corners: np.ndarray, values: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, ...]:
        count, objectives = values.shape[1:]
        signs = np.repeat(corners, count, axis=0)
        system = np.column_stack([np.ones(len(signs)), signs])
        used, rows = kept.ravel() & np.all(np.isfinite(values), axis=2).ravel(), values.reshape(len(signs), -1)
        if used.sum() <= system.shape[1]:
            return _no_plane(objectives, corners.shape[1])
        fits = []
        for column in rows.T:
            # only on which side of the plane a lost run lies counts
            column = np.where(used, column, 2 * np.max(np.abs(column[used]), initial=0.0))
            fits.append(bootstrap(lambda w, y=column: self._plane(system, y, np.tile(w, len(corners)), used), count))
        planes = np.stack([plane for plane, _ in fits])
        errors = np.stack([drawn.std(axis=0, ddof=1) for _, drawn in fits])
        return planes[:, 0], errors[:, 0], planes[:, 1:], errors[:, 1:]

    def _plane(self, system: np.ndarray, values: np.ndarray, weights: np.ndarray, used: np.ndarray) -> np.ndarray:
        if self.quantile is None:
            return mean_plane(system, values, weights * used)
        return quantile_plane(system, values, self.quantile, weights)


def _of_many(track: AbstractTrack, path: str) -> list[tuple[str, AbstractTrack]]:
    """Returns the parts of a track that are one of many rails, with the paths of the numbers that choose them."""
    own = [(f"{path}.{track.chosen_by}", track)] if track.chosen_by else []
    parts = [(name, part) for name, part in vars(track).items() if isinstance(part, AbstractTrack)]
    return own + [one for name, part in parts for one in _of_many(part, f"{path}.{name}")]


def ensemble_for(scene: Scene, ensemble: EnsembleSettings | None) -> EnsembleSettings:
    """Returns a user's ensemble, by default that which a scene's track needs.

    **Raises:** `ValueError` for one without rails where the track does not recur, or a rail that is too short.
    """
    on_rails = not bool(recurs(scene))
    if ensemble is None:
        ensemble = RailEnsemble() if on_rails else EnsembleSettings()
    kind = RailEnsemble if on_rails else EnsembleSettings
    instance("ensemble", ensemble, kind, f"a slipperjax.design.{kind.__name__}")
    if on_rails:
        known = scene.track.extent - scene.track.origin
        most = np.floor(known / float(scene.track.wavelength) * (1 + 1e-9))
        periods = ensemble.transient + ensemble.periods
        need = f"have at most {most:g} periods, transient included, because the rail is known up to that"
        require(periods <= most, "ensemble", need, shown=f"{periods}")
    return ensemble


def _no_plane(objectives: int, parameters: int) -> tuple[np.ndarray, ...]:
    """Returns a fit to too few runs: NaN for all that `EnsembleSettings.fit` gives."""
    value, slope = np.full(objectives, np.nan), np.full((objectives, parameters), np.nan)
    return value, value, slope, slope


def fit_plane(
    signs: Float[np.ndarray, "members parameters"], values: Float[np.ndarray, "members objectives"], kept: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Fits planes through `values` over `signs`, to the members that are `kept` and finite.

    **Returns:** intercepts (objectives,) and their standard errors, slopes (objectives, parameters) and theirs; NaN
    where the members are too few.
    """
    used = kept & np.all(np.isfinite(values), axis=1)
    freedom = used.sum() - signs.shape[1] - 1
    if freedom < 1:
        return _no_plane(values.shape[1], signs.shape[1])
    system = np.column_stack([np.ones(used.sum()), signs[used]])
    plane, *_ = np.linalg.lstsq(system, values[used], rcond=None)
    variance = np.sum((values[used] - system @ plane) ** 2, axis=0) / freedom
    stderr = np.sqrt(np.diag(np.linalg.pinv(system.T @ system))[:, None] * variance)
    return plane[0], stderr[0], plane[1:].T, stderr[1:].T


@dataclass(frozen=True)
class EvaluationPlan:
    """Objectives to evaluate, parameters to differentiate by, and how cases are simulated."""

    scene: Scene
    names: tuple[str, ...]
    """Parameters by which objectives are differentiated."""
    objectives: tuple[Objective, ...]
    solver: diffrax.AbstractSolver
    steps: int
    """Per forcing period, the same for all cases, so that objectives have no jumps where it would change."""
    most_steps: int
    """The most with which cases are judged again, for which programs have room."""
    start: Motion | State
    reach: Mapping[str, float]
    """Distance of ensembles' parameters from a case's, by name [their SI units]."""
    transient: int
    """Forcing periods from the start before an orbit is looked for."""
    ensemble: EnsembleSettings

    @property
    def of_courses(self) -> tuple[AbstractNumber, ...]:
        """The objectives that are computed from courses of periods: all but exponents."""
        return tuple(one for one in self.objectives if isinstance(one, AbstractNumber))

    @property
    def epoch(self) -> float:
        """Forcing periods from distance zero to where runs begin."""
        return float(self.scene.epoch_at(self.scene.track.origin))

    def limits(self, name: str) -> tuple[float, float]:
        """Lowest and highest value of a parameter in ensembles [its SI unit]."""
        del name
        return -np.inf, np.inf

    def indices(self, *, exponents: bool) -> list[int]:
        """Indices of the exponents among the objectives, or of all others."""
        return [k for k, one in enumerate(self.objectives) if isinstance(one, LargestExponent) == exponents]


class Evaluation(NamedTuple):
    """Objectives of cases and the motions that they belong to; arrays with a leading axis of cases."""

    status: Int[np.ndarray, " cases"]
    """`Status` codes."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods after which the motion recurs; 0 for motions that are not on a stable periodic orbit."""
    kind: Int[np.ndarray, " cases"]
    """Numbers of `slipperjax.analysis.Regime`, periodic on stable orbits only."""
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
    """Of I - P_x, P_x being the orbit's Jacobian; NaN without an orbit."""
    simulated: Float[np.ndarray, " cases"]
    """Simulated forcing periods, derivatives counted by their cost."""

    @classmethod
    def of_states(cls, plan: EvaluationPlan, state: Float[np.ndarray, "cases size"]) -> "Evaluation":
        """Returns an evaluation that has states, and no values yet."""
        count, size = state.shape
        nan = lambda *shape: np.full((count, *shape), np.nan)
        objectives, both = len(plan.objectives), (len(plan.objectives), len(plan.names))
        status, period, kind = np.zeros((3, count), int)
        kind[:] = Regime.UNRESOLVED
        values = nan(objectives), nan(*both), nan(objectives), nan(*both)
        return cls(status, period, kind, nan(), state.copy(), *values, nan(size, size), np.zeros(count))

    @property
    def regime(self) -> np.ndarray:
        """Kinds of motion in words: "period n", another one of `slipperjax.analysis.KINDS`, or "lost"."""
        rows = zip(self.status, self.period, Regime.kind_names(self.kind), strict=True)
        names = ["lost" if code != Status.FINITE else f"period {n}" if n else name for code, n, name in rows]
        return np.array(names)

    def take(self, index: np.ndarray) -> "Evaluation":
        """Returns the evaluation of the cases at `index`."""
        return jax.tree.map(lambda array: array[index], self)
