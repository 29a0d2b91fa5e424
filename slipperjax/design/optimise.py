"""Designs by gradient: parameters that keep an objective lowest over some cases, and fronts of two objectives."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import diffrax
import numpy as np
import scipy.optimize
import xarray as xr

from ..analysis.step_error import with_step_error
from ..flow.datasets import run_attributes, scene_attributes
from ..flow.status import Interrupted, Status, with_accuracy
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import parameter
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..tools.checks import instance, require, warn, whole
from ..tools.files import user_path, write_whole
from ..tools.html import repr_html
from ..tools.progress import bar as progress_bar
from .methods import AbstractMethod, AbstractMove, CaseValues, TrustRegion, inside
from .objectives import EnsembleSettings, Evaluation, Objective, RailEnsemble, objective_named
from .problem import Problem, checked_problem, first_designs, spread_designs

AT_BOUND = 1e-6
"""Distance from a bound up to which a variable counts as being there [unit box]."""
SAME_DESIGN = 0.02
"""Distance within which two optima are one [unit box]."""
SAME_VALUE = 0.005
"""Relative difference of objectives within which two optima are equally good [1]."""
ACTIVE_CASE = 1e-3
"""Relative distance from the worst case within which cases count as worst [1]."""
PROGRAMS = 6
"""Programs that most searches compile."""
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
    """Standard error of `smooth` [its unit]; on orbits what half the step changes."""
    gradient_norm: float
    """Relative change of `smooth` across the unit box, along the variables that are not at a bound [1]; for a worst
    case, of the best combination of the derivatives of the cases within 0.1 % of the worst."""
    cases: xr.Dataset
    """Over the cases: `objective`, `smooth`, their errors `objective_stderr` and `stderr`, `gradient` of `smooth` by
    variable and `gradient_stderr`, on orbits what half the step changes; `step_change` [1] of `smooth` by half the
    step, on orbits and over rails; `regime`, `multiplier`, `status`, `constraint`."""
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
    def at_bounds(self) -> dict[str, str]:
        """Variables that ended on one of their bounds, "lower" or "upper"."""
        ends = {name: self.problem.bounds[name] for name in self.design}
        near = lambda name, k: abs(self.design[name] - ends[name][k]) <= AT_BOUND * (ends[name][1] - ends[name][0])
        return {name: bound for name in ends for k, bound in enumerate(("lower", "upper")) if near(name, k)}

    @property
    def simulated(self) -> float:
        """Simulated forcing periods in all, derivatives counted by their cost."""
        return float(self.history["simulated"].values[-1] + self.cases["simulated"].sum())

    @property
    def several(self) -> bool:
        """Whether starts ended at different designs that are about equally good."""
        values, lowest = self.starts["smooth"].values, float(self.starts["smooth"].min())
        ends = self.starts["end_unit"].values[values <= lowest + SAME_VALUE * abs(lowest)]
        return bool(np.any(np.ptp(ends, axis=0) > SAME_DESIGN))

    _repr_html_ = repr_html

    def __repr__(self) -> str:
        problem, regimes = self.problem, Counter(sorted(self.regime.tolist()))
        shown = lambda q, value: f"{q.name} {q.shown(value):.5g} {q.display_unit}"
        ends = {name: f" (its {bound} bound)" for name, bound in self.at_bounds.items()}
        numbers = {name: shown(parameter(name, problem.scene), value) for name, value in self.design.items()}
        at = ", ".join(number + ends.get(name, "") for name, number in numbers.items())
        cases = f"{problem.robust} of {problem.count} cases" if problem.count > 1 else "one case"
        return (
            f"Design({at},\n"
            f"  {shown(problem.objective.quantity, self.objective)}, {cases}, status: {self.status},\n"
            f"  regimes: {', '.join(f'{count} x {word}' for word, count in regimes.items())},\n"
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
        problem, names = self.problem, self.problem.names
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
            "constraints": [[one.name, finite(low), finite(high)] for one, low, high in problem.constraints],
            "periodic": problem.periodic,
            "transient": problem.transient,
            "steps_per_period": problem.steps,
            "solver": problem.solver,
            "ensemble": list(dataclasses.astuple(problem.ensemble)),
        }
        attrs = scene_attributes(self.scene, without=(*problem.over, *names))
        attrs |= run_attributes(self.scene, problem.start, call, tuple(problem.over)) | {"robust": problem.robust}
        attrs |= {name: getattr(self, name) for name in ("objective", "smooth", "stderr", "gradient_norm", "status")}
        ds = xr.merge([variables, self.cases, *renamed], join="exact", compat="equals")
        return ds.assign_attrs(attrs | {"several": np.int8(self.several)})

    def to_netcdf(self, path: Any) -> None:
        """Writes `to_xarray()`, whole or not at all; `load_scene` reads the best design's scene from it."""
        write_whole(user_path(path), self.to_xarray().to_netcdf(engine="h5netcdf"))


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
    ensemble: EnsembleSettings | None = None,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | None = None,
    seed: int = 0,
    progress: bool | None = None,
) -> Design:
    """Finds parameters within bounds that keep an objective lowest, in the worst of some cases or in their mean.

    Each case of each trial is judged on the stable periodic orbit that it settles to, which is followed from trial to
    trial, with exact derivatives. Where there is none, an ensemble of runs gives value and slope with their standard
    errors. On rails that do not recur, all trials are judged by runs along many of them, see `RailEnsemble`, and the
    last designs once more along rails that the search has not seen.

    **Arguments:**

    - `objective`: a name of `slipperjax.design.OBJECTIVES`, an objective, or a function of a course.
    - `variables`: lower and upper bound of each parameter by name or path [its SI unit].
    - `over`: values of other parameters that the design must serve, such as `{"speed": [...]}`; every combination.
    - `robust`: "worst" minimises the worst case, "mean" the mean of the cases.
    - `constraints`: by objective, the highest value, or `(low, high)` with None for no limit; in every case.
    - `periodic`: whether only periodic motions are allowed.
    - `starts`: how many designs to begin from: the scene's own if it lies within the bounds, and the best that lie
        apart of the box's corners and of four times as many designs in a Latin hypercube of `seed`; or the designs
        themselves, as mappings.
    - `method`: how designs move, default `TrustRegion()`; `Descent(...)` takes an optimiser of optax. `max_trials`:
        of each start.
    - `transient`: forcing periods before an orbit is looked for; `start`: as for `simulate`; `ensemble`: sizes of
        ensembles, by default those that the track needs.
    - `steps_per_period`: the same for all, by default the most that a corner of the box needs; `solver`: as for
        `simulate`.
    - `progress`: whether a bar is shown, by default on terminals and in notebooks.

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
    designs, count, fixed = first_designs(problem, starts, whole("seed", seed, 0))
    with progress_bar(
        progress, programs=PROGRAMS, desc=f"design for {problem.objective.name}", unit=" trials"
    ) as bar:
        search = _Search(problem, method, bar)
        try:
            search.run(designs, count, fixed, limit)
        except KeyboardInterrupt:
            best = search.result(checked=False) if search.trials else None
            raise Interrupted(best, len(search.trials), unit="trials") from None
        return search.result()


class Trial(NamedTuple):
    """A design [unit box] that one of the starts tried, with the forcing periods simulated by all until then."""

    start: int
    at: np.ndarray
    values: CaseValues
    evaluation: Evaluation
    taken: bool
    simulated: float


class _Search:
    """Several starts on their way, judged together."""

    def __init__(self, problem: Problem, method: AbstractMethod, bar: Any):
        self.problem, self.method = problem, method
        self.moves: list[AbstractMove] = []
        self.trials: list[Trial] = []
        self.latest: dict[int, Trial] = {}  # the last one that each start accepted
        self.rounds = 0
        self.simulated = 0.0
        self.bar = bar

    def run(self, designs: np.ndarray, count: int, fixed: int, rounds: int) -> None:
        """Judges designs, begins from `count` of them, the first `fixed` included, and judges at most `rounds` trials
        of each start, those of a round together."""
        judged = self._judge(designs, None)
        total, violation = (np.array([getattr(v, name) for _, v, _ in judged]) for name in ("total", "violation"))
        order = np.lexsort((total, violation > VIOLATED))  # infinite totals come last
        for start, k in enumerate(spread_designs(designs, order, count, fixed)):
            at, values, evaluation = judged[k]
            move = self.method.start(at, values)
            move.finished = not np.isfinite(values.total)
            self.moves.append(move)
            self._add(Trial(start, at, values, evaluation, True, self.simulated))
        for _ in range(rounds):
            proposed = {k: move.propose() for k, move in enumerate(self.moves) if not move.finished}
            # a move may find that it has ended while it proposes
            proposed = {k: at for k, at in proposed.items() if not self.moves[k].finished}
            if not proposed:
                break
            latest = [self.latest[k].evaluation for k in proposed]
            warm_start = Evaluation(*(np.concatenate(arrays) for arrays in zip(*latest, strict=True)))
            judged = self._judge(np.stack(list(proposed.values())), warm_start)
            for k, (at, values, evaluation) in zip(proposed, judged, strict=True):
                accepted = self.moves[k].update(at, values)
                self._add(Trial(k, at, values, evaluation, accepted, self.simulated))

    def _judge(
        self, designs: np.ndarray, warm_start: Evaluation | None
    ) -> list[tuple[np.ndarray, CaseValues, Evaluation]]:
        """Returns each design with its values and its evaluation."""
        evaluation = (self._unseen() if self.method.fresh else self.problem).evaluate(designs, warm_start)
        self.rounds += 1
        self.simulated += float(np.sum(evaluation.simulated))
        index = np.arange(len(evaluation.status)).reshape(len(designs), -1)
        of_designs = [evaluation.take(cases) for cases in index]
        return [(at, self.problem.case_values(one), one) for at, one in zip(designs, of_designs, strict=True)]

    def _unseen(self) -> Problem:
        """The problem with ensembles that no earlier round has had."""
        ensemble = self.problem.ensemble
        return dataclasses.replace(
            self.problem, ensemble=dataclasses.replace(ensemble, seed=ensemble.seed + self.rounds)
        )

    def _judged_anew(self, trials: list[Trial]) -> list[Trial]:
        """Returns trials on rails that the search has not seen, where they were judged on rails."""
        if not isinstance(self.problem.ensemble, RailEnsemble):
            return trials
        evaluation = self._unseen().evaluate(np.stack([trial.at for trial in trials]), None)
        cases = np.arange(len(evaluation.status)).reshape(len(trials), -1)
        of_trials = [(trial, evaluation.take(index)) for trial, index in zip(trials, cases, strict=True)]
        return [trial._replace(values=self.problem.case_values(one), evaluation=one) for trial, one in of_trials]

    def _with_half_step(self, trial: Trial) -> tuple[Evaluation, np.ndarray]:
        """Returns the evaluation of a trial with what half the step changes as the errors of cases on orbits.

        And that change of the smooth objective in each case [1]; NaN where motions from disturbed starts are
        averaged.
        """
        evaluation, steps = trial.evaluation, self.problem.steps
        on_rails = isinstance(self.problem.ensemble, RailEnsemble)
        if not on_rails and not np.any(evaluation.period):
            return evaluation, np.full(len(evaluation.period), np.nan)
        # a trial on rails was judged anew on those that the search has not seen
        problem = dataclasses.replace(self._unseen() if on_rails else self.problem, steps=2 * steps)
        half = problem.evaluate(trial.at[None], None if on_rails else evaluation)
        if on_rails:
            return evaluation._replace(simulated=2 * half.simulated), _relative_change(self.problem, evaluation, half)
        on_orbit = (evaluation.period > 0) & (half.period == evaluation.period)
        numbers = lambda of: {"stderr": of.value, "gradient_stderr": of.gradient}
        _, errors = with_step_error(lambda n: numbers(evaluation if n == steps else half), steps, (1, 2))
        rows = lambda error: on_orbit.reshape(-1, *[1] * (error.ndim - 1))
        errors = {name: np.where(rows(error), error, getattr(evaluation, name)) for name, error in errors.items()}
        change = _relative_change(self.problem, evaluation, half, on_orbit)
        return evaluation._replace(simulated=2 * half.simulated, **errors), change

    def _add(self, trial: Trial) -> None:
        """Adds a trial and shows it."""
        self.trials.append(trial)
        if trial.taken:
            self.latest[trial.start] = trial
        q, moving = self.problem.objective.quantity, sum(not move.finished for move in self.moves)
        feasible = [one.values.total for one in self.trials if one.taken and one.values.violation <= 0]
        best = q.shown(min(feasible, default=np.nan))
        self.bar.set_postfix_str(f"{moving} starts move, lowest {best:.5g} {q.display_unit}", refresh=False)
        self.bar.update()

    def result(self, checked: bool = True) -> Design:
        """Returns the best design until now: the lowest objective among those that violate least.

        **Arguments:** `checked`: whether it is judged again with steps half as long, for its errors on orbits.
        """
        problem, ends = self.problem, list(self.latest.values())
        ends = self._judged_anew(ends) if checked else ends
        best = min(ends, key=lambda trial: (trial.values.violation > VIOLATED, trial.values.total))
        values, evaluation = best.values, best.evaluation._replace(simulated=0 * best.evaluation.simulated)
        change = np.full(len(evaluation.period), np.nan)
        if checked:
            evaluation, change = self._with_half_step(best)
        errors = evaluation.stderr[:, problem.index(problem.objective.smooth)]
        worst = int(np.argmax(np.where(np.isfinite(values.value), values.value, -np.inf)))
        if not np.isfinite(values.total):
            status = "no motion"
        elif values.violation > VIOLATED:
            status = "infeasible"
        else:
            status = "converged" if self.moves[best.start].finished else "not converged"
        history = _history(problem, self.trials)
        return Design(
            problem,
            dict(zip(problem.names, map(float, problem.in_units(best.at)), strict=True)),
            problem.joined(evaluation.value[:, problem.index(problem.objective)]),
            values.total,
            float(errors[worst] if problem.robust == "worst" else np.sqrt(np.sum(errors**2)) / len(errors)),
            _gradient_norm(best),
            _cases(problem, evaluation, change),
            _starts(history, np.stack([end.at for end in ends]), [self.moves[end.start].finished for end in ends]),
            history,
            status,
        )


def _relative_change(problem: Problem, evaluation: Evaluation, half: Evaluation, compared: Any = True) -> np.ndarray:
    """Returns by how much half the step changes the smooth objective of each case [1]; NaN where not `compared`.

    Gives a warning where that is more than a tenth, and more than can be the chance of rails: twice its error.
    """
    at = problem.index(problem.objective.smooth)
    value, other = evaluation.value[:, at], half.value[:, at]
    compared = compared & np.isfinite(other / value)
    change = np.where(compared, other / value - 1, np.nan)
    chance = np.hypot(evaluation.stderr[:, at], half.stderr[:, at]) / np.abs(value)
    status = with_accuracy(evaluation.status[compared], np.abs(change[compared]), np.nan_to_num(chance[compared]))
    if np.any(status == Status.INACCURATE):
        worst = float(change[np.nanargmax(np.abs(change))])
        warn(
            f"Argument `steps_per_period` should be more: half the step changes the objective by {100 * worst:.2g} %."
        )
    return change


def _cases(problem: Problem, evaluation: Evaluation, change: np.ndarray) -> xr.Dataset:
    """Returns the dataset of the cases of a design."""
    q, of_smooth = problem.objective.quantity, problem.objective.smooth.quantity
    hard, smooth = problem.index(problem.objective), problem.index(problem.objective.smooth)
    words = lambda text, unit=q.unit: {"units": unit, "long_name": text}
    slope, per = ("case", "variable"), f"{q.unit} per SI unit of the variable"
    data = {
        "objective": ("case", evaluation.value[:, hard], _labels(q)),
        "smooth": ("case", evaluation.value[:, smooth], _labels(of_smooth)),
        "stderr": ("case", evaluation.stderr[:, smooth], words("standard error of smooth")),
        "step_change": ("case", change, words("relative change of smooth by half the step", "1")),
        "objective_stderr": ("case", evaluation.stderr[:, hard], words("standard error of objective")),
        "gradient": (slope, evaluation.gradient[:, smooth], words("derivative of smooth", per)),
        "gradient_stderr": (slope, evaluation.gradient_stderr[:, smooth], words("standard error of gradient", per)),
        "regime": ("case", evaluation.regime, {"long_name": "kind of motion"}),
        "multiplier": ("case", evaluation.multiplier, words("largest multiplier's modulus", "1")),
        "period": ("case", evaluation.period, words("forcing periods to recur, or 0", "1")),
        "state": (("case", "number"), evaluation.state, {"long_name": "all numbers of the state"}),
        "status": ("case", evaluation.status, {"long_name": "status"}),
        "simulated": ("case", evaluation.simulated, words("simulated for the errors", "forcing periods")),
    }
    for one, _, _ in problem.constraints:
        data[f"constraint_{one.name}"] = ("case", evaluation.value[:, problem.index(one)], _labels(one.quantity))
    coords = {name: ("case", v, parameter(name, problem.scene).attributes) for name, v in problem.cases.items()}
    return xr.Dataset(data, coords | {"variable": list(problem.names)})


def _history(problem: Problem, trials: list[Trial]) -> xr.Dataset:
    """Returns the dataset of trials, a row each."""
    q, of_smooth = problem.objective.quantity, problem.objective.smooth.quantity
    hard, each = problem.index(problem.objective), ("trial", "case")
    objective = np.stack([trial.evaluation.value[:, hard] for trial in trials])
    data = {
        "start": ("trial", [trial.start for trial in trials]),
        "design": (("trial", "variable"), problem.in_units(np.stack([trial.at for trial in trials]))),
        "smooth": ("trial", [trial.values.total for trial in trials], _labels(of_smooth)),
        "violation": ("trial", [trial.values.violation for trial in trials], {"units": "1"}),
        "taken": ("trial", [trial.taken for trial in trials]),
        "objective": (each, objective, _labels(q)),
        "regime": (each, np.stack([trial.evaluation.regime for trial in trials])),
        "simulated": ("trial", [trial.simulated for trial in trials], {"units": "forcing periods"}),
    }
    return xr.Dataset(data, {"variable": list(problem.names)})


def _starts(history: xr.Dataset, end_unit: np.ndarray, finished: list[bool]) -> xr.Dataset:
    """Returns the dataset of the starts, from the first and the last trial that each accepted."""
    start, taken = history["start"].values, history["taken"].values
    first, end = ([np.flatnonzero((start == k) & taken)[at] for k in range(len(finished))] for at in (0, -1))
    each = ("start", "variable")
    ends = history[["design", "smooth", "violation"]].isel(trial=end).rename(trial="start", design="end")
    ends["first"], ends["end_unit"] = (each, history["design"].values[first]), (each, end_unit)
    return ends.assign(converged=("start", finished))


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


def pareto_front(
    scene: Scene,
    objectives: tuple[Any, Any],
    variables: Mapping[str, tuple[float, float]],
    *,
    points: int = 9,
    starts: int = 5,
    constraints: Mapping[Any, Any] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Follows the front of two objectives from the best design of the second to that of the first.

    Between, the first objective is minimised while the second stays below limits that rise evenly, each search
    beginning from the last design (Haimes, Lasdon and Wismer 1971, doi:10.1109/TSMC.1971.4308298).

    **Arguments:** `objectives`: two, by name or as objects; `points`: designs on the front; `starts`: of both ends;
    `constraints`, `options`: of `optimise_design`.

    **Returns:** an `xarray.Dataset` along `point`: each objective by name, worst case or mean, the variables by name,
    `periodic`, the share of cases on orbits, `status`, and `simulated` forcing periods; `ideal` is true of designs
    that no other one of the front beats in both.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    pair = isinstance(objectives, tuple | list) and len(objectives) == 2
    require(pair, "objectives", "be two objectives", objectives)
    first, second = map(objective_named, objectives)
    count, limits = whole("points", points, 3), {} if constraints is None else dict(constraints)
    # the other objective is evaluated, too, as a limit that nothing exceeds
    lowest_second, lowest_first = (
        optimise_design(scene, one, variables, starts=starts, constraints=limits | {other: _NO_LIMIT}, **options)
        for one, other in ((second, first), (first, second))
    )
    designs = [lowest_second]
    for limit in np.linspace(_value(lowest_second, second), _value(lowest_first, second), count)[1:-1]:
        near = dict(method=TrustRegion(radius=0.05), starts=[designs[-1].design])
        limited = limits | {second: limit}
        designs.append(optimise_design(scene, first, variables, constraints=limited, **(options | near)))
    designs.append(lowest_first)
    values = {one: np.array([_value(design, one) for design in designs]) for one in (first, second)}
    # row k, column j: whether design j beats design k in both
    beaten = np.all([v[None, :] < v[:, None] for v in values.values()], axis=0).any(axis=1)
    data = {one.name: ("point", v, one.quantity.attributes) for one, v in values.items()}
    for name in variables:
        data[name] = ("point", [one.design[name] for one in designs], parameter(name, scene).attributes)
    data["periodic"] = ("point", [float(np.mean(one.cases["period"] > 0)) for one in designs], {"units": "1"})
    data["status"] = ("point", [one.status for one in designs])
    data["ideal"] = ("point", ~beaten)
    data["simulated"] = ("point", [one.simulated for one in designs], {"units": "forcing periods"})
    return xr.Dataset(data, attrs={"objectives": [first.name, second.name], "robust": lowest_first.problem.robust})


_NO_LIMIT = (None, np.finfo(float).max)
"""Limit of a constraint that is only observed."""


def _value(design: Design, objective: Objective) -> float:
    """Returns an objective at a design, in the worst of the cases or their mean."""
    name = "objective" if objective == design.problem.objective else f"constraint_{objective.name}"
    return design.problem.joined(design.cases[name].values)
