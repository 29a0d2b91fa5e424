"""Designs by gradients: parameters that minimise an objective over some cases."""

import dataclasses
import functools
import math
from collections.abc import Generator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import numpy as np
import xarray as xr

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.status import Interrupted, Status, with_accuracy
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import parameter
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..results.result import AbstractResult
from ..tools.checks import instance, warn, whole
from ..tools.columns import column
from ..tools.progress import bar as progress_bar
from ..tools.types import Numbers
from .ensembles import AbstractEnsemble
from .methods import AbstractMethod, CaseValues, TrustRegion
from .objectives import Evaluation, ObjectiveLike
from .problem import SMOOTH, Limits, Problem, checked_problem, first_designs, spread_designs

if TYPE_CHECKING:
    from tqdm import tqdm

VIOLATED = 1e-6
"""Violation, in multiples of the limit, from which a design is infeasible."""


@dataclasses.dataclass(frozen=True, repr=False)
class Design(AbstractResult):
    """The best design that a search found, and the trials of the search."""

    problem: Problem
    design: dict[str, float]
    """The best design: values by name [their SI units]."""
    objective: float
    """The objective of the best design [its unit], in the worst case or the mean."""
    smooth: float
    """Smooth form of the objective, which was minimised [its unit]."""
    stderr: float
    """Standard error of `smooth` [its unit]; on orbits the change by half the step."""
    cases: xr.Dataset
    """Over the cases: `objective`, `smooth`, their errors `objective_stderr` and `stderr`, `gradient` of `smooth` by
    variable and `gradient_stderr`, on orbits the change by half the step; `step_change` [1] of `smooth` by half the
    step, on orbits and over rails; `regime`, `multiplier`, `status`, `constraint`."""
    starts: xr.Dataset
    """Over the starts: the last accepted design, and its objective, violation and convergence."""
    history: xr.Dataset
    """Along `trial`: start, design, smooth objective, violation, whether it was accepted, objective and regime in
    each case, and forcing periods simulated so far."""
    status: str
    """One of "converged", "not converged", "infeasible" and "no motion"."""
    judged: str
    """Text that says along which rails the objective was computed, and how many runs were lost; empty on a rail that
    recurs, without a lost run."""
    around: xr.Dataset | None = None
    """Result of `surroundings`; None where no neighbours were simulated."""
    margins: xr.Dataset | None = None
    """Result of `event_margins`; None where no events were searched."""

    @property
    def regime(self) -> np.ndarray:
        """The kind of motion in each case, as a text: "period n", another one of `slipperjax.analysis.KINDS`, or
        "lost"."""
        return self.cases["regime"].values

    @property
    def at_bounds(self) -> dict[str, str]:
        """Variables that ended at one of their bounds, "lower" or "upper"."""
        found = {}
        for name, (low, high) in self.problem.bounds.items():
            for bound, word in ((low, "lower"), (high, "upper")):
                if abs(self.design[name] - bound) <= 1e-6 * (high - low):
                    found[name] = word
        return found

    @property
    def cost_periods(self) -> float:
        """Total number of simulated forcing periods; derivatives count by their cost."""
        return float(self.history["simulated"].values[-1] + self.cases["simulated"].sum())

    @property
    def has_equal_optima(self) -> bool:
        """Whether starts ended at different designs that are about equally good."""
        values = self.starts["smooth"].values
        # starts without a motion have no value, and are not near the lowest value
        lowest = float(self.starts["smooth"].min())
        # within 0.5 % of the objective, and further apart than 2 % of the box
        ends = self.starts["end"].values[values <= lowest + 0.005 * abs(lowest)]
        return bool(np.any(np.ptp(ends, axis=0) > 0.02 * self.problem.width))

    @property
    def scene(self) -> Scene:
        """The scene with the best design."""
        return self.problem.scene.replace(**self.design)

    @functools.cached_property
    def ds(self) -> xr.Dataset:
        """One dataset for files and pictures: `cases` unchanged; `starts`, `history` and `margins` with the prefixes
        start_, trial_ and margin_; `design` with its bounds `low` and `high`; the objective nearby as `around_total`;
        and scene, call and outcome as attributes.
        """
        problem = self.problem
        names = problem.names
        units = [parameter(name, problem.scene).unit for name in names]
        each = "in the unit of each variable"
        variables = xr.Dataset(
            {
                "design": column("variable", list(self.design.values()), "", f"best design, {each}"),
                "low": column("variable", problem.low, "", f"lower bound, {each}"),
                "high": column("variable", problem.low + problem.width, "", f"upper bound, {each}"),
            },
            {"variable": list(names), "variable_unit": ("variable", units)},
        )
        parts = [variables, self.cases]
        # prefixes, because several tables have variables of the same names
        for prefix, table in (("start", self.starts), ("trial", self.history), ("margin", self.margins)):
            if table is not None:
                parts.append(table.rename({name: f"{prefix}_{name}" for name in table.data_vars}))
        if self.around is not None:
            parts.append(self.around[["total"]].rename(total="around_total").drop_attrs(deep=False))
        # chosen or varied parameters have no single value
        attrs = scene_attributes(self.scene, without=(*problem.over, *names))
        attrs |= run_attributes(self.scene, problem.start, _call(problem), problem.over)
        attrs |= dict(
            objective=self.objective,
            smooth=self.smooth,
            stderr=self.stderr,
            status=self.status,
            robust=problem.robust,
            judged=self.judged,
            has_equal_optima=np.int8(self.has_equal_optima),
            cost_periods=self.cost_periods,
        )
        return xr.merge(parts, join="exact", compat="equals").assign_attrs(attrs)


def _call(problem: Problem) -> dict[str, object]:
    """Return the arguments of `optimise_design` that state a problem, as `load_call` gives them."""
    # JSON has no infinity
    finite = lambda v: v if math.isfinite(v) else None
    limits = [[one.name, finite(low), finite(high)] for one, low, high in problem.constraints]
    return {
        "function": "optimise_design",
        "objective": problem.objective.name,
        "variables": [[name, *bounds] for name, bounds in problem.bounds.items()],
        "over": [[name, values] for name, values in problem.over.items()],
        "robust": problem.robust,
        "constraints": limits,
        "transient": problem.transient,
        "steps_per_period": problem.steps,
        "solver": problem.solver,
        "ensemble": list(dataclasses.astuple(problem.ensemble)),
    }


def optimise_design(
    scene: Scene,
    objective: ObjectiveLike,
    variables: Mapping[str, tuple[float, float]],
    *,
    over: Mapping[str, float | Numbers] | None = None,
    robust: str = "worst",
    constraints: Mapping[Any, Limits] | None = None,
    starts: int | Sequence[Mapping[str, float]] = 5,
    method: AbstractMethod | None = None,
    max_trials: int = 60,
    transient: int = 200,
    ensemble: AbstractEnsemble | None = None,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | None = None,
    seed: int = 0,
    progress: bool | None = None,
) -> Design:
    """Find parameters within bounds that minimise an objective, in the worst of some cases or in their mean.

    Each case of each trial is judged on the stable periodic orbit to which it settles; the orbit is followed from
    trial to trial, with exact derivatives. Where there is no such orbit, an ensemble of runs gives value and slope
    with standard errors. On rails that do not recur, all trials are judged by runs along many rails, see
    `RailEnsemble`. The last designs are judged once more along rails that the search has not used, or from other
    starts on a single rail; `judged` says which.

    **Arguments:**

    - `objective`: a name of `slipperjax.design.OBJECTIVES`, an objective, or a function of a course.
    - `variables`: lower and upper bound of each parameter by name or path [its SI unit].
    - `over`: values of other parameters that the design must serve, such as `{"speed": [...]}`; every combination.
    - `robust`: "worst" minimises the worst case, "mean" the mean of the cases.
    - `constraints`: by objective, the highest value, or `(low, high)` with None for no limit; in every case.
    - `starts`: number of designs to begin from, or these designs as mappings. With a number, the first design is the
        scene's own if it is within the bounds. The others are the best, at a distance from each other, among the
        box's corners and a Latin hypercube of `seed` with four times as many designs.
    - `method`: how designs move, default `TrustRegion()`; `Descent(...)` takes an optimiser of optax. `max_trials`:
        of each start.
    - `transient`: forcing periods before the search for an orbit; `start`: as for `simulate`; `ensemble`: sizes of
        ensembles, by default suited to the track.
    - `steps_per_period`: the same for all, by default the most that a corner of the box needs; `solver`: as for
        `simulate`.
    - `progress`: whether a bar is shown, by default on terminals and in notebooks.

    **Returns:** a `Design`; check its `status`.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C, with the best design so far as
    its `result`.
    """
    problem = checked_problem(
        scene,
        objective,
        variables,
        over=over,
        robust=robust,
        constraints=constraints,
        transient=transient,
        ensemble=ensemble,
        steps=steps_per_period,
        solver=solver,
        start=start,
    )
    method = TrustRegion() if method is None else method
    instance("method", method, AbstractMethod, "a slipperjax.design method")
    limit = whole("max_trials", max_trials, 1)
    designs, count, fixed = first_designs(problem, starts, whole("seed", seed, 0))
    # most searches compile six programs
    name = f"design for {problem.objective.name}"
    with progress_bar(progress, programs=6, desc=name, unit=" trials") as bar:
        search = _Search(problem, bar)
        try:
            search.run(method, designs, count, fixed, limit)
        except KeyboardInterrupt:
            best = search.result(checked=False) if search.trials else None
            raise Interrupted(best, len(search.trials), unit="trials") from None
        return search.result()


class Trial(NamedTuple):
    """A design [unit box] that one of the starts tried, with the forcing periods simulated so far by all starts."""

    start: int
    at: np.ndarray
    values: CaseValues
    evaluation: Evaluation
    taken: bool
    simulated: float

    @property
    def order(self) -> tuple[bool, float]:
        """Key that sorts trials, the best first: trials that break no constraint, and among these the lowest."""
        return self.values.violation > VIOLATED, self.values.total


class _Search:
    """Several moving starts, judged together."""

    def __init__(self, problem: Problem, bar: "tqdm"):
        self.problem = problem
        self.bar = bar
        self.moves: dict[int, Generator] = {}  # generators of the starts that still move
        self.trials: list[Trial] = []
        self.simulated = 0.0

    def run(
        self,
        method: AbstractMethod,
        designs: np.ndarray,
        count: int,
        fixed: int,
        rounds: int,
    ) -> None:
        """Judge designs; begin from `count` of them, including the first `fixed`; and judge at most `rounds` trials
        of each start, with the trials of a round together."""
        judged = self._judge(self.problem, dict(enumerate(designs)))
        order = sorted(range(len(judged)), key=lambda k: judged[k].order)
        for start, k in enumerate(spread_designs(designs, order, count, fixed)):
            # a start without a motion cannot move
            if np.isfinite(judged[k].values.total):
                self.moves[start] = method.moves(designs[k], judged[k].values)
            self._add(judged[k]._replace(start=start, taken=True))
        for left in reversed(range(rounds + 1)):
            proposed = {k: at for k, move in self.moves.items() if (at := next(move, None)) is not None}
            # the other starts have ended
            self.moves = {k: self.moves[k] for k in proposed}
            if not (left and proposed):
                break
            # orbits are followed from the last accepted trials
            latest = self._latest()
            evaluations = [self.trials[latest[k]].evaluation for k in proposed]
            warm_start = Evaluation(*map(np.concatenate, zip(*evaluations, strict=True)))
            for trial in self._judge(self.problem, proposed, warm_start):
                taken = self.moves[trial.start].send(trial.values)
                self._add(trial._replace(taken=taken))

    def _judge(
        self,
        problem: Problem,
        designs: Mapping[int, np.ndarray],
        warm_start: Evaluation | None = None,
    ) -> list[Trial]:
        """Return trials of designs by their starts; none is accepted yet."""
        evaluation = problem.evaluate(np.stack(list(designs.values())), warm_start)
        self.simulated += float(np.sum(evaluation.simulated))
        # the cases of a design follow each other
        index = np.arange(len(evaluation.status)).reshape(len(designs), -1)
        trials = []
        for (start, at), cases in zip(designs.items(), index, strict=True):
            one = evaluation.take(cases)
            trials.append(Trial(start, at, problem.case_values(one), one, False, self.simulated))
        return trials

    def _add(self, trial: Trial) -> None:
        """Add a trial and show it."""
        self.trials.append(trial)
        q = self.problem.objective.quantity
        # the bar shows the lowest objective of designs that meet all constraints
        feasible = [one.values.total for one in self.trials if one.taken and one.values.violation <= 0]
        best = q.shown(min(feasible, default=np.nan))
        text = f"{len(self.moves)} starts move, lowest {best:.5g} {q.display_unit}"
        self.bar.set_postfix_str(text, refresh=False)
        self.bar.update()

    def _latest(self) -> dict[int, int]:
        """Return the number of the last trial that each start accepted."""
        return {trial.start: k for k, trial in enumerate(self.trials) if trial.taken}

    def _with_half_step(self, trial: Trial) -> tuple[Evaluation, np.ndarray]:
        """Return the evaluation of a trial, with changes by half the step as the errors of cases on orbits, and the
        relative change of the smooth objective in each case [1]. The change is NaN where motions from disturbed
        starts are averaged, because these change by chance.

        Only the check counts as simulated. Gives a warning where the change is more than a tenth, and more than twice
        its error, so that it cannot come from the chance of rails.
        """
        problem = self.problem
        evaluation = trial.evaluation
        on_orbit = evaluation.period > 0
        finer = dataclasses.replace(problem.unseen, steps=2 * problem.steps)
        half = finer.evaluate(trial.at[None], None if problem.on_rails else evaluation)
        value = evaluation.value[:, SMOOTH]
        change = half.value[:, SMOOTH] / value - 1
        # a change to another orbit is not an error of this orbit
        compared = (on_orbit | problem.on_rails) & (half.period == evaluation.period)
        known = compared & np.isfinite(change)
        change = np.where(known, change, np.nan)
        chance = np.nan_to_num(np.hypot(evaluation.stderr[:, SMOOTH], half.stderr[:, SMOOTH]) / np.abs(value))
        status = with_accuracy(evaluation.status[known], np.abs(change[known]), chance[known])
        if np.any(status == Status.INACCURATE):
            worst = float(change[np.nanargmax(np.abs(change))])
            text = f"half the step changes the objective by {100 * worst:.2g} %."
            warn(f"Argument `steps_per_period` should be more: {text}")
        # errors over rails come from chance
        rows = (compared & on_orbit)[:, None]
        value_error = np.abs(half.value - evaluation.value)
        slope_error = np.abs(half.gradient - evaluation.gradient)
        with_errors = evaluation._replace(
            simulated=2 * half.simulated,
            stderr=np.where(rows, value_error, evaluation.stderr),
            gradient_stderr=np.where(rows[..., None], slope_error, evaluation.gradient_stderr),
        )
        return with_errors, change

    def result(self, checked: bool = True) -> Design:
        """Return the best design so far: the lowest objective among the designs with the least violation.

        **Arguments:** `checked`: whether it is judged again: on orbits with half the step, for its errors, and on
        rails along rails that the search has not used.
        """
        problem = self.problem
        last = self._latest()
        ends = [self.trials[k] for k in last.values()]
        if checked and problem.on_rails:
            ends = self._judge(problem.unseen, {end.start: end.at for end in ends})
        best = min(ends, key=lambda trial: trial.order)
        values = best.values
        evaluation = best.evaluation._replace(simulated=np.zeros(problem.count))
        change = np.full(problem.count, np.nan)
        if checked and (problem.on_rails or evaluation.period.any()):
            evaluation, change = self._with_half_step(best)
        objective = evaluation.value[:, problem.index(problem.objective)]
        errors = evaluation.stderr[:, SMOOTH]
        # the error of the worst case, or of the mean of independent cases
        if problem.robust == "worst":
            total = objective.max()
            known = np.where(np.isfinite(values.value), values.value, -np.inf)
            stderr = errors[np.argmax(known)]
        else:
            total = objective.mean()
            stderr = np.linalg.norm(errors) / len(errors)
        if not np.isfinite(values.total):
            status = "no motion"
        elif values.violation > VIOLATED:
            status = "infeasible"
        else:
            status = "not converged" if best.start in self.moves else "converged"
        judged = []
        if problem.on_rails:
            unseen = problem.ensemble.unseen(problem.scene.track)
            judged.append(unseen if checked else "along the rails of the search")
        if lost := evaluation.lost.sum():
            judged.append(f"{lost} runs lost and left out")
        history = _history(problem, self.trials)
        # the last trial that each start accepted
        starts = history[["design", "smooth", "violation"]].isel(trial=list(last.values()))
        starts = starts.rename(trial="start", design="end")
        starts["converged"] = ("start", [start not in self.moves for start in last])
        return Design(
            problem=problem,
            design=dict(zip(problem.names, problem.in_units(best.at).tolist(), strict=True)),
            objective=float(total),
            smooth=values.total,
            stderr=float(stderr),
            cases=_cases(problem, evaluation, change),
            starts=starts,
            history=history,
            status=status,
            judged=", ".join(judged),
        )


def _cases(
    problem: Problem,
    evaluation: Evaluation,
    change: np.ndarray,
) -> xr.Dataset:
    """Return the dataset of the cases of a design."""
    q = problem.objective.quantity
    hard = problem.index(problem.objective)
    value = evaluation.value
    stderr = evaluation.stderr
    slope = ("case", "variable")
    per = f"{q.unit} per SI unit of the variable"
    data = {
        "objective": ("case", value[:, hard], _labels(q)),
        "smooth": ("case", value[:, SMOOTH], _labels(problem.objective.smooth.quantity)),
        "stderr": column("case", stderr[:, SMOOTH], q.unit, "standard error of smooth"),
        "step_change": column("case", change, "1", "relative change of smooth by half the step"),
        "objective_stderr": column("case", stderr[:, hard], q.unit, "standard error of objective"),
        "gradient": column(slope, evaluation.gradient[:, SMOOTH], per, "derivative of smooth"),
        "gradient_stderr": column(slope, evaluation.gradient_stderr[:, SMOOTH], per, "standard error of gradient"),
        "regime": column("case", evaluation.regime, "", "kind of motion"),
        "multiplier": column("case", evaluation.multiplier, "1", "largest multiplier's modulus"),
        "period": column("case", evaluation.period, "1", "forcing periods to recur, or 0"),
        "state": column(("case", "number"), evaluation.state, "", "all numbers of the state"),
        "status": column("case", evaluation.status, "", "status"),
        "simulated": column("case", evaluation.simulated, "forcing periods", "simulated for the errors"),
        "lost": column("case", evaluation.lost, "1", "runs of the ensemble that were lost"),
    }
    for one, _, _ in problem.constraints:
        data[f"constraint_{one.name}"] = ("case", value[:, problem.index(one)], _labels(one.quantity))
    coords: dict[str, object] = {"variable": list(problem.names)}
    for name, values in problem.cases.items():
        coords[name] = ("case", values, parameter(name, problem.scene).attributes)
    return xr.Dataset(data, coords)


def _history(problem: Problem, trials: list[Trial]) -> xr.Dataset:
    """Return the dataset of trials, with one row for each."""
    start, at, values, evaluations, taken, simulated = map(list, zip(*trials, strict=True))
    hard = problem.index(problem.objective)
    over = ("trial", "case")
    data = {
        "start": ("trial", start),
        "design": (("trial", "variable"), problem.in_units(np.stack(at))),
        "smooth": ("trial", [one.total for one in values], _labels(problem.objective.smooth.quantity)),
        "violation": ("trial", [one.violation for one in values], {"units": "1"}),
        "taken": ("trial", taken),
        "objective": (over, [one.value[:, hard] for one in evaluations], _labels(problem.objective.quantity)),
        "regime": (over, [one.regime for one in evaluations]),
        "simulated": ("trial", simulated, {"units": "forcing periods"}),
    }
    return xr.Dataset(data, {"variable": list(problem.names)})


def _labels(q: Quantity) -> dict[str, str]:
    """Return attributes with which pictures label and scale a variable of any name."""
    return q.attributes | {"quantity": q.name, "symbol": q.symbol, "shown_unit": q.display_unit}
