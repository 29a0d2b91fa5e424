"""Designs by gradient: parameters that keep an objective lowest over a range of cases."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import numpy as np
import scipy.optimize
import xarray as xr

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.status import Interrupted
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.paths import parameter
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..tools.checks import instance, whole, yes_or_no
from ..tools.files import write_whole
from .evaluation import EnsembleSettings, Evaluation
from .methods import AbstractMethod, AbstractMove, CaseValues, TrustRegion, inside
from .objectives import Objective
from .problem import Problem, checked_problem, first_designs

SAME_DESIGN = 0.02
"""Distance within which two optima are one [unit box]."""
SAME_VALUE = 0.005
"""Relative difference of objectives within which two optima are equally good [1]."""
ACTIVE_CASE = 1e-3
"""Relative distance from the worst case within which cases count as worst [1]."""
VIOLATED = 1e-6
"""Violation from which a design counts as infeasible, in multiples of the limit."""


@dataclasses.dataclass(frozen=True)
class Design:
    """An optimal design, as far as the search went, and the trials on the way."""

    problem: Problem
    design: dict[str, float]
    """The best design: values by name [their SI units]."""
    objective: float
    """The objective there [its unit], in the worst case or the mean."""
    smooth: float
    """Its smooth form, which was minimised [its unit]."""
    stderr: float
    """Standard error of `smooth` [its unit]: 0 on orbits."""
    gradient_norm: float
    """Relative change of `smooth` across the unit box, along the variables that are not at a bound [1]; for a worst
    case, of the best combination of the derivatives of the cases within 0.1 % of the worst."""
    cases: xr.Dataset
    """Over the cases: `objective`, `smooth`, their standard errors `objective_stderr` and `stderr`, `gradient` of
    `smooth` by variable and `gradient_stderr`, `regime`, `multiplier`, `status`, `constraint`."""
    starts: xr.Dataset
    """Over the starts: first and last design, and objective, violation and convergence of the last."""
    history: xr.Dataset
    """Along `trial`: start, design, smooth objective, violation, whether it was taken, objective and regime in each
    case, and forcing periods simulated until then."""
    status: str
    """One of "converged", "not converged", "infeasible" and "no motion"."""

    @property
    def regime(self) -> np.ndarray:
        """The kind of motion in each case, in words: "period n", another one of `slipperjax.analysis.KINDS`, or
        "lost"."""
        return self.cases["regime"].values

    @property
    def simulated(self) -> float:
        """Simulated forcing periods in all, derivatives counted by their cost."""
        return float(self.history["simulated"].values[-1])

    @property
    def several(self) -> bool:
        """Whether starts ended at different designs that are about equally good."""
        ends, values = self.starts["end_unit"].values, self.starts["smooth"].values
        with np.errstate(invalid="ignore"):
            good = values <= np.nanmin(values) * (1 + SAME_VALUE) if np.any(np.isfinite(values)) else values > 0
        return bool(np.any(np.ptp(ends[good], axis=0) > SAME_DESIGN)) if np.any(good) else False

    def __repr__(self) -> str:
        problem, q = self.problem, self.problem.objective.quantity
        variables = [(parameter(name, problem.scene), value) for name, value in self.design.items()]
        at = ", ".join(f"{one.name} {one.shown(value):.5g} {one.display_unit}" for one, value in variables)
        words, counts = np.unique(self.regime, return_counts=True)
        cases = f"{problem.robust} of {problem.count} cases" if problem.count > 1 else "one case"
        return (
            f"Design({at},\n  {q.name} {q.shown(self.objective):.5g} {q.display_unit}, {cases}, "
            f"status: {self.status},\n"
            f"  regimes: {', '.join(f'{n} x {w}' for w, n in zip(words, counts, strict=True))},\n"
            f"  {self.history.sizes['trial']} trials from {self.starts.sizes['start']} starts, "
            f"{self.simulated:.3g} forcing periods)"
        )

    @property
    def scene(self) -> Scene:
        """The scene with the best design."""
        return self.problem.scene.replace(**self.design)

    def to_xarray(self, margins: xr.Dataset | None = None) -> xr.Dataset:
        """Returns one dataset for files and pictures: `cases` as they are, `starts` and `history` with the prefixes
        start_ and trial_, `design` with its bounds `low` and `high`, and scene, call and outcome as attributes.

        **Arguments:** `margins`: of `event_margins`, kept with the prefix margin_.
        """
        problem, plan, names = self.problem, self.problem.plan, self.problem.names
        tables = {"start": self.starts, "trial": self.history} | ({} if margins is None else {"margin": margins})
        renamed = [ds.rename({name: f"{prefix}_{name}" for name in ds.data_vars}) for prefix, ds in tables.items()]
        words = lambda text: {"long_name": f"{text}, in the unit of each variable"}
        units = [parameter(name, problem.scene).unit for name in names]
        variables = xr.Dataset(
            {
                "design": ("variable", [self.design[name] for name in names], words("best design")),
                "low": ("variable", problem.low, words("lower bound")),
                "high": ("variable", problem.low + problem.width, words("upper bound")),
            },
            {"variable": list(names), "variable_unit": ("variable", units)},
        )
        finite = lambda v: v if math.isfinite(v) else None
        call = {
            "function": "optimise_design",
            "objective": problem.objective.name,
            "variables": [[name, *bounds] for name, bounds in problem.bounds.items()],
            "over": [[name, values] for name, values in problem.over.items()],
            "robust": problem.robust,
            "constraints": [[c.objective.name, finite(c.low), finite(c.high)] for c in problem.constraints],
            "periodic": problem.periodic,
            "transient": plan.transient,
            "steps_per_period": plan.steps,
            "solver": plan.solver,
            "ensemble": list(plan.ensemble),
        }
        attrs = scene_attributes(self.scene, without=(*problem.over, *names))
        attrs |= run_attributes(self.scene, plan.start, call, tuple(problem.over)) | {"robust": problem.robust}
        attrs |= {name: getattr(self, name) for name in ("objective", "smooth", "stderr", "gradient_norm", "status")}
        ds = xr.merge([variables, self.cases, *renamed], join="exact", compat="equals")
        return ds.assign_attrs(attrs | {"several": np.int8(self.several)})

    def to_netcdf(self, path: Any) -> None:
        """Writes `to_xarray()`, whole or not at all; `load_scene` reads the best design's scene from it."""
        write_whole(Path(path), self.to_xarray().to_netcdf(engine="h5netcdf"))


def optimise_design(
    scene: Scene,
    objective: Objective | str | Any,
    variables: Mapping[str, tuple[float, float]],
    *,
    over: Mapping[str, Any] | None = None,
    robust: str = "worst",
    constraints: Mapping[Any, Any] | None = None,
    periodic: bool = False,
    starts: int | Sequence[Mapping[str, float]] = 5,
    method: AbstractMethod | None = None,
    max_trials: int = 60,
    transient: int = 200,
    ensemble: EnsembleSettings = EnsembleSettings(),
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Design:
    """Finds parameters within bounds that keep an objective lowest, in the worst of some cases or in their mean.

    Each case of each trial is judged on the stable periodic orbit that it settles to, which is followed from trial to
    trial, with exact derivatives. Where there is none, an ensemble of runs gives value and slope with their standard
    errors.

    **Arguments:**

    - `objective`: a name of `slipperjax.design.OBJECTIVES`, an objective, or a function of a course.
    - `variables`: lower and upper bound of each parameter by name or path [its SI unit].
    - `over`: values of other parameters that the design must serve, such as `{"speed": [...]}`; every combination.
    - `robust`: "worst" minimises the worst case, "mean" the mean of the cases.
    - `constraints`: by objective, the highest value, or `(low, high)` with None for no limit; in every case.
    - `periodic`: whether only periodic motions are allowed.
    - `starts`: how many designs to begin from, the scene's own first if it lies within the bounds, the others
        spread by a Latin hypercube of `seed`; or the designs themselves, as mappings.
    - `method`: how designs move, default `TrustRegion()`; `Descent(...)` takes an optimiser of optax. `max_trials`:
        of each start.
    - `transient`: forcing periods before an orbit is looked for; `start`: as for `simulate`; `ensemble`: sizes of
        ensembles.
    - `steps_per_period`: the same for all, by default the most that a corner of the box needs; `solver`: as for
        `simulate`.
    - `progress`: shows a bar.

    **Returns:** a `Design`; look at its `status`.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C,
    with the best design until then as its `result`.
    """
    options = dict(over=over, robust=robust, constraints=constraints, periodic=periodic, transient=transient)
    options |= dict(ensemble=ensemble, steps=steps_per_period, solver=solver, start=start)
    problem = checked_problem(scene, objective, variables, **options)
    method = TrustRegion() if method is None else method
    instance("method", method, AbstractMethod, "a slipperjax.design method")
    limit = whole("max_trials", max_trials, 1)
    designs = first_designs(problem, starts, whole("seed", seed, 0))
    search = _Search(problem, method, designs, yes_or_no("progress", progress))
    try:
        search.begin()
        while search.moving and search.rounds < limit:
            search.go_on()
    except KeyboardInterrupt:
        best = search.result() if search.trials else None
        raise Interrupted(best, len(search.trials), unit="trials") from None
    finally:
        search.close()
    return search.result()


class Trial(NamedTuple):
    """A design that was tried: a row of `Design.history`."""

    start: int
    """Index of the start that it belongs to."""
    at: np.ndarray
    """The design [unit box]."""
    values: CaseValues
    evaluation: Evaluation
    taken: bool
    simulated: float
    """Forcing periods simulated by all trials until then."""


class _Search:
    """Several starts on their way, judged together."""

    def __init__(self, problem: Problem, method: AbstractMethod, designs: np.ndarray, shown: bool):
        self.problem, self.method, self.designs = problem, method, designs
        self.moves: list[AbstractMove] = []
        self.trials: list[Trial] = []
        self.rounds, self.simulated, self.bar = 0, 0.0, None
        if shown:
            from tqdm.auto import tqdm

            self.bar = tqdm(desc=f"design for {problem.objective.name}", unit=" trials")

    def close(self) -> None:
        """Closes the progress bar."""
        if self.bar is not None:
            self.bar.close()

    @property
    def moving(self) -> list[int]:
        """The starts that still move."""
        return [k for k, move in enumerate(self.moves) if not move.finished]

    def taken(self, start: int) -> list[Trial]:
        """Returns the trials of a start that were taken, the first design included."""
        return [trial for trial in self.trials if trial.start == start and trial.taken]

    def begin(self) -> None:
        """Judges the first design of each start."""
        for start, evaluation in enumerate(self._evaluate(self.designs, None)):
            values = self.problem.case_values(evaluation)
            self.moves.append(self.method.start(self.designs[start], values))
            self.moves[start].finished = not np.isfinite(values.total)
            self._add(start, self.designs[start], values, evaluation, True)

    def go_on(self) -> None:
        """Makes one trial of each start that still moves."""
        steps = {k: self.moves[k].propose() for k in self.moving}
        steps = {k: step for k, step in steps.items() if not self.moves[k].finished}
        if not steps:
            return
        before = [self.taken(k)[-1].evaluation for k in steps]
        warm_start = Evaluation(*(np.concatenate(arrays) for arrays in zip(*before, strict=True)))
        evaluations = self._evaluate(np.stack([step.to for step in steps.values()]), warm_start)
        self.rounds += 1
        for (k, step), evaluation in zip(steps.items(), evaluations, strict=True):
            values = self.problem.case_values(evaluation)
            self._add(k, step.to, values, evaluation, self.moves[k].update(step, values))

    def _evaluate(self, designs: np.ndarray, warm_start: Evaluation | None) -> list[Evaluation]:
        """Returns an evaluation for each design."""
        evaluation = self.problem.evaluate(designs, warm_start)
        self.simulated += float(np.sum(evaluation.simulated))
        return [evaluation.take(index) for index in np.arange(len(evaluation.status)).reshape(len(designs), -1)]

    def _add(self, start: int, at: np.ndarray, values: CaseValues, evaluation: Evaluation, taken: bool) -> None:
        """Adds a trial and shows it."""
        self.trials.append(Trial(start, at, values, evaluation, taken, self.simulated))
        if self.bar is not None:
            q = self.problem.objective.quantity
            feasible = [trial.values.total for trial in self.trials if trial.taken and trial.values.violation <= 0]
            best = q.shown(min(feasible, default=np.nan))
            words = f"{len(self.moving)} starts move, lowest {best:.5g} {q.display_unit}"
            self.bar.set_postfix_str(words, refresh=False)
            self.bar.update()

    def result(self) -> Design:
        """Returns the best design until now: the lowest objective among those that violate least."""
        problem, of_starts = self.problem, [self.taken(start) for start in range(len(self.moves))]
        rank = lambda k: (of_starts[k][-1].values.violation > VIOLATED, of_starts[k][-1].values.total)
        best = min(range(len(of_starts)), key=rank)
        trial, finished = of_starts[best][-1], self.moves[best].finished
        values, evaluation = trial.values, trial.evaluation
        errors = evaluation.stderr[:, problem.index(problem.objective.smooth)]
        worst = int(np.argmax(np.where(np.isfinite(values.value), values.value, -np.inf)))
        if not np.isfinite(values.total):
            status = "no motion"
        elif values.violation > VIOLATED:
            status = "infeasible"
        else:
            status = "converged" if finished else "not converged"
        return Design(
            problem,
            dict(zip(problem.names, map(float, problem.in_units(trial.at)), strict=True)),
            problem.joined(evaluation.value[:, problem.index(problem.objective)]),
            values.total,
            float(errors[worst] if problem.robust == "worst" else np.sqrt(np.sum(errors**2)) / len(errors)),
            _gradient_norm(trial),
            _cases(problem, evaluation),
            _starts(problem, of_starts, [move.finished for move in self.moves]),
            _history(problem, self.trials),
            status,
        )


def _cases(problem: Problem, evaluation: Evaluation) -> xr.Dataset:
    """Returns the dataset of the cases of a design."""
    q, of_smooth = problem.objective.quantity, problem.objective.smooth.quantity
    hard, smooth = problem.index(problem.objective), problem.index(problem.objective.smooth)
    words = lambda text, unit=q.unit: {"units": unit, "long_name": text}
    slope, per = ("case", "variable"), f"{q.unit} per SI unit of the variable"
    data = {
        "objective": ("case", evaluation.value[:, hard], _labels(q)),
        "smooth": ("case", evaluation.value[:, smooth], _labels(of_smooth)),
        "stderr": ("case", evaluation.stderr[:, smooth], words("standard error of smooth")),
        "objective_stderr": ("case", evaluation.stderr[:, hard], words("standard error of objective")),
        "gradient": (slope, evaluation.gradient[:, smooth], words("derivative of smooth", per)),
        "gradient_stderr": (slope, evaluation.gradient_stderr[:, smooth], words("standard error of gradient", per)),
        "regime": ("case", evaluation.regime, {"long_name": "kind of motion"}),
        "multiplier": ("case", evaluation.multiplier, words("largest multiplier's modulus", "1")),
        "period": ("case", evaluation.period, words("forcing periods to recur, or 0", "1")),
        "state": (("case", "number"), evaluation.state, {"long_name": "all numbers of the state"}),
        "status": ("case", evaluation.status, {"long_name": "status"}),
    }
    for one in problem.constraints:
        labels = _labels(one.objective.quantity)
        data[f"constraint_{one.objective.name}"] = ("case", evaluation.value[:, problem.index(one.objective)], labels)
    coords = {name: ("case", v, parameter(name, problem.scene).attributes) for name, v in problem.cases.items()}
    return xr.Dataset(data, coords | {"variable": list(problem.names)})


def _starts(problem: Problem, of_starts: list[list[Trial]], finished: list[bool]) -> xr.Dataset:
    """Returns the dataset of the starts from the trials that each took."""
    first, end = (np.stack([trials[k].at for trials in of_starts]) for k in (0, -1))
    values, each = [trials[-1].values for trials in of_starts], ("start", "variable")
    labels = _labels(problem.objective.smooth.quantity)
    data = {
        "first": (each, problem.in_units(first)),
        "end": (each, problem.in_units(end)),
        "end_unit": (each, end),
        "smooth": ("start", [one.total for one in values], labels),
        "violation": ("start", [one.violation for one in values], {"units": "1"}),
        "converged": ("start", finished),
    }
    return xr.Dataset(data, {"variable": list(problem.names)})


def _history(problem: Problem, trials: list[Trial]) -> xr.Dataset:
    """Returns the dataset of trials, a row each."""
    hard, of_smooth = problem.index(problem.objective), problem.objective.smooth.quantity
    objective = np.stack([trial.evaluation.value[:, hard] for trial in trials])
    data = {
        "start": ("trial", [trial.start for trial in trials]),
        "design": (("trial", "variable"), problem.in_units(np.stack([trial.at for trial in trials]))),
        "smooth": ("trial", [trial.values.total for trial in trials], _labels(of_smooth)),
        "violation": ("trial", [trial.values.violation for trial in trials], {"units": "1"}),
        "taken": ("trial", [trial.taken for trial in trials]),
        "objective": (("trial", "case"), objective, _labels(problem.objective.quantity)),
        "regime": (("trial", "case"), np.stack([trial.evaluation.regime for trial in trials])),
        "simulated": ("trial", [trial.simulated for trial in trials], {"units": "forcing periods"}),
    }
    return xr.Dataset(data, {"variable": list(problem.names)})


def _gradient_norm(trial: Trial) -> float:
    """Returns the relative slope that is left at a design, see `Design.gradient_norm`."""
    values, free = trial.values, inside(trial.at)
    if not np.isfinite(values.total):
        return np.nan
    if values.weight is not None:
        slope = values.total_slope[free]
    else:
        active = values.value >= values.total - ACTIVE_CASE * abs(values.total)
        rows = values.slope[active][:, free]
        # the point of least norm in the hull of the worst cases' derivatives: shares of sum one, by a large weight
        weight = 1e3 * np.abs(rows).max(initial=1e-300)
        system = np.vstack([rows.T, np.full(len(rows), weight)])
        share, _ = scipy.optimize.nnls(system, np.append(np.zeros(rows.shape[1]), weight))
        slope = rows.T @ share
    return float(np.linalg.norm(slope) / max(abs(values.total), 1e-300))


def _labels(q: Quantity) -> dict[str, Any]:
    """Returns attributes from which pictures label and scale a variable, whatever its name."""
    shown = {"symbol": q.symbol, "shown_unit": q.display_unit, "per_shown": q.per_shown}
    return {"units": q.unit, "long_name": q.long_name, "quantity": q.name} | shown
