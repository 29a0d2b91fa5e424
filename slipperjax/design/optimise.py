"""Designs by gradient: parameters that keep an objective lowest over a range of cases."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import diffrax
import numpy as np
import scipy.optimize
import xarray as xr

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.status import Interrupted
from ..model.dang2024 import table_2_start
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.paths import parameter
from ..model.quantities import Quantity
from ..model.scene import Scene
from ..tools.checks import instance, whole, yes_or_no
from ..tools.files import write_whole
from .ensembles import Spread
from .judge import Judged, Memory
from .methods import AbstractMethod, AbstractMove, Step, TrustRegion, inside
from .objectives import Objective
from .problem import Problem, checked_problem, first_designs

SAME_DESIGN = 0.02
"""Distance within which two optima are one [unit box]."""
SAME_VALUE = 0.005
"""Relative difference of objectives within which two optima are equally good [1]."""
ACTIVE = 1e-3
"""Relative distance from the worst case within which cases count as worst [1]."""


@dataclasses.dataclass(frozen=True)
class Design:
    """An optimal design, as far as it was found, with what was tried on the way."""

    problem: Problem
    design: dict[str, float]
    """The best design: values by name [their SI units]."""
    objective: float
    """The objective there [its unit], worst case or mean; hard, where its smooth form was descended on."""
    smooth: float
    """Its smooth form, which was minimised."""
    stderr: float
    """Standard error of `smooth` [its unit]: 0 on orbits."""
    gradient_norm: float
    """Relative change of the objective across the unit box, of the coordinates that are not at a bound [1]; for
    worst cases, of the best combination of the cases' derivatives that are within 0.1 % of the worst."""
    cases: xr.Dataset
    """Over the cases: `objective`, `smooth`, their standard errors `objective_stderr` and `stderr`, `gradient` of
    `smooth` by variable and `gradient_stderr`, `regime`, `multiplier`, `status`, `constraint`."""
    starts: xr.Dataset
    """Over the starts: where each began and ended, and its objective."""
    history: xr.Dataset
    """Along `trial`: start, design, smooth objective, violation, whether it was taken, objective and regime in each
    case, and forcing periods simulated until then."""
    status: str
    """What became of it: "converged", "not converged", "infeasible" or "no motion"."""

    @property
    def regime(self) -> np.ndarray:
        """The regime in each case, in words."""
        return self.cases["regime"].values

    @property
    def simulated(self) -> float:
        """Forcing periods that were simulated in all, derivatives counted by what they cost."""
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
        known = {name: parameter(name, problem.scene) for name in problem.names}
        at = ", ".join(
            f"{name} {known[name].shown(v):.5g} {known[name].display_unit}" for name, v in self.design.items()
        )
        words, counts = np.unique(self.regime, return_counts=True)
        many = "worst" if problem.robust == "worst" else "mean"
        of = f"{many} of {problem.count} cases" if problem.count > 1 else "one case"
        return (
            f"Design({at},\n  {q.name} {q.shown(self.objective):.5g} {q.display_unit}, {of}, status: {self.status},\n"
            f"  regimes: {', '.join(f'{n} x {w}' for w, n in zip(words, counts, strict=True))},\n"
            f"  {self.history.sizes['trial']} trials from {self.starts.sizes['start']} starts, "
            f"{self.simulated:.3g} forcing periods)"
        )

    @property
    def scene(self) -> Scene:
        """The scene with the best design."""
        return self.problem.scene.replace(**self.design)

    def to_xarray(self, margins: xr.Dataset | None = None) -> xr.Dataset:
        """One dataset for files and pictures: `cases` as they are, `starts` and `history` with the prefixes start_
        and trial_, `design` with its bounds `low` and `high`, and scene, call and outcome as attributes.

        **Arguments:** `margins`: of `event_margins`, kept with the prefix margin_.
        """
        outcome = ("objective", "smooth", "stderr", "gradient_norm", "status", "several")
        summary = {name: getattr(self, name) for name in outcome}
        tables = {"": self.cases, "start": self.starts, "trial": self.history}
        if margins is not None:
            tables["margin"] = margins
        return _merged(self.problem, self.scene, self.design, tables, summary)

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
    spread: Spread = Spread(),
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Design:
    """Finds parameters within bounds that keep an objective lowest, in the worst of some cases or in their mean.

    Each case of each trial is judged on the stable periodic orbit that it settles to, which is followed from trial to
    trial, with exact derivatives. Where there is none, an ensemble of runs gives value and slope with their standard
    errors. So a trial costs some hundred forcing periods a case, whatever the number of variables.

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
    - `transient`: forcing periods to pass before an orbit is looked for; `start`: as for `simulate`; `spread`: how
        ensembles are made.
    - `steps_per_period`: the same for all, by default the most that a corner of the box needs; `solver`: as for
        `simulate`.
    - `progress`: shows where the search is.

    **Returns:** a `Design`; look at its `status`.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C,
    with the best design until then as its `result`.
    """
    problem = checked_problem(
        scene,
        objective,
        variables,
        over=over,
        robust=robust,
        constraints=constraints,
        periodic=periodic,
        transient=transient,
        spread=spread,
        steps=steps_per_period,
        solver=solver,
        start=start,
    )
    method = (
        TrustRegion() if method is None else instance("method", method, AbstractMethod, "a slipperjax.design method")
    )
    limit = whole("max_trials", max_trials, 1)
    first = first_designs(problem, starts, whole("seed", seed, 0))
    search = _Search(problem, method, first, yes_or_no("progress", progress))
    try:
        search.begin()
        while search.moving and search.trials < limit:
            search.go_on()
    except KeyboardInterrupt:
        best = search.result() if search.moves else None
        raise Interrupted(best, len(search.rows), unit="trials") from None
    finally:
        search.close()
    return search.result()


class _Search:
    """Several starts on their way, judged together."""

    def __init__(self, problem: Problem, method: AbstractMethod, first: np.ndarray, shown: bool):
        self.problem, self.method, self.first = problem, method, first
        self.moves: list[AbstractMove] = []
        self.judged: list[Judged] = []
        self.rows: list[dict[str, Any]] = []
        self.trials, self.simulated, self.bar = 0, 0.0, None
        if shown:
            from tqdm.auto import tqdm

            self.bar = tqdm(desc=f"design for {problem.objective.name}", unit=" trials")

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()

    @property
    def moving(self) -> list[int]:
        """The starts that still move."""
        return [k for k, move in enumerate(self.moves) if not move.finished]

    def begin(self) -> None:
        """Judges where each start begins."""
        for k, judged in enumerate(self._judge(self.first, None)):
            faced = self.problem.faced(judged)
            self.moves.append(self.method.start(self.first[k], faced))
            self.judged.append(judged)
            self._note(k, self.first[k], judged, True)
            if not np.isfinite(faced.total):
                self.moves[k].finished = True

    def go_on(self) -> None:
        """One trial of each start that still moves."""
        steps: dict[int, Step] = {k: self.moves[k].propose() for k in self.moving}
        steps = {k: step for k, step in steps.items() if not self.moves[k].finished}
        if not steps:
            return
        known = [self.judged[k] for k in steps]
        memory = Memory(*(np.concatenate([getattr(j, name) for j in known]) for name in Memory._fields))
        found = self._judge(np.stack([step.to for step in steps.values()]), memory)
        self.trials += 1
        for (k, step), judged in zip(steps.items(), found, strict=True):
            taken = self.moves[k].hear(step, self.problem.faced(judged))
            if taken:
                self.judged[k] = judged
            self._note(k, step.to, judged, taken)

    def _judge(self, designs: np.ndarray, memory: Memory | None) -> list[Judged]:
        found = self.problem.judged(designs, memory)
        self.simulated += float(np.sum(found.simulated))
        count = self.problem.count
        parts = [Judged(*(a[k * count : (k + 1) * count] for a in found)) for k in range(len(designs))]
        return parts

    def _note(self, start: int, at: np.ndarray, judged: Judged, taken: bool) -> None:
        faced = self.problem.faced(judged)
        hard = self.problem.question.objectives.index(self.problem.objective)
        row = dict(start=start, design=self.problem.values(at), smooth=faced.total, violation=faced.violation)
        row |= dict(taken=taken, regime=judged.regime, objective=judged.value[:, hard], simulated=self.simulated)
        self.rows.append(row)
        if self.bar is not None:
            q = self.problem.objective.quantity
            best = min((r["smooth"] for r in self.rows if r["taken"] and r["violation"] <= 0), default=np.nan)
            words = f"{len(self.moving)} starts move, lowest {q.shown(best):.5g} {q.display_unit}"
            self.bar.set_postfix_str(words, refresh=False)
            self.bar.update()

    def best(self) -> int:
        """The start with the lowest objective among those that violate least."""
        merit = [(max(m.faced.violation, 0.0) > 1e-6, m.faced.total) for m in self.moves]
        return min(range(len(merit)), key=lambda k: merit[k])

    def result(self) -> Design:
        """What was found so far."""
        problem, best = self.problem, self.best()
        move, judged = self.moves[best], self.judged[best]
        q = problem.objective.quantity
        places = {objective: k for k, objective in enumerate(problem.question.objectives)}
        hard, soft = judged.value[:, places[problem.objective]], move.faced.value
        worst = problem.robust == "worst"
        total = float(np.max(hard) if worst else np.mean(hard))
        errors = judged.stderr[:, places[problem.objective.smooth]]
        at = int(np.argmax(np.where(np.isfinite(soft), soft, -np.inf)))
        stderr = float(errors[at] if worst else np.sqrt(np.sum(errors**2)) / len(errors))
        if not np.isfinite(move.faced.total):
            status = "no motion"
        elif move.faced.violation > 1e-6:
            status = "infeasible"
        else:
            status = "converged" if move.finished else "not converged"
        label, of_smooth = _labels(q), _labels(problem.objective.smooth.quantity)
        error = lambda text: {"units": q.unit, "long_name": f"standard error of {text}"}
        of_cases = {name: ("case", v, parameter(name, problem.scene).attributes) for name, v in problem.cases.items()}
        variables = {"variable": list(problem.names)}
        cases = xr.Dataset(
            {
                "objective": ("case", hard, label),
                "smooth": ("case", soft, of_smooth),
                "stderr": ("case", errors, error("smooth")),
                "objective_stderr": ("case", judged.stderr[:, places[problem.objective]], error("objective")),
                "gradient": (
                    ("case", "variable"),
                    judged.gradient[:, places[problem.objective.smooth]],
                    {"units": f"{q.unit} per SI unit of the variable", "long_name": "derivative of smooth"},
                ),
                "gradient_stderr": (
                    ("case", "variable"),
                    judged.gradient_stderr[:, places[problem.objective.smooth]],
                    {"units": f"{q.unit} per SI unit of the variable", "long_name": "standard error of gradient"},
                ),
                "regime": ("case", judged.regime, {"long_name": "kind of motion"}),
                "multiplier": (
                    "case",
                    judged.multiplier,
                    {"units": "1", "long_name": "largest multiplier's modulus"},
                ),
                "period": ("case", judged.period, {"units": "1", "long_name": "forcing periods to recur, or 0"}),
                "state": (("case", "number"), judged.state, {"long_name": "all numbers of the state"}),
                "status": ("case", judged.status, {"long_name": "status"}),
            }
            | {
                f"constraint_{one.objective.name}": (
                    "case",
                    judged.value[:, places[one.objective]],
                    _labels(one.objective.quantity),
                )
                for one in problem.constraints
            },
            of_cases | variables,
        )
        ends = np.stack([m.at for m in self.moves])
        each = lambda values: (("start", "variable"), values)
        starts = xr.Dataset(
            {
                "first": each(problem.values(self.first)),
                "end": each(problem.values(ends)),
                "end_unit": each(ends),
                "smooth": ("start", [m.faced.total for m in self.moves], of_smooth),
                "violation": ("start", [m.faced.violation for m in self.moves], {"units": "1"}),
                "converged": ("start", [m.finished for m in self.moves]),
            },
            variables,
        )
        history = xr.Dataset(
            {
                "start": ("trial", [r["start"] for r in self.rows]),
                "design": (("trial", "variable"), np.stack([r["design"] for r in self.rows])),
                "smooth": ("trial", [r["smooth"] for r in self.rows], of_smooth),
                "violation": ("trial", [r["violation"] for r in self.rows], {"units": "1"}),
                "taken": ("trial", [r["taken"] for r in self.rows]),
                "objective": (("trial", "case"), np.stack([r["objective"] for r in self.rows]), label),
                "regime": (("trial", "case"), np.stack([r["regime"] for r in self.rows])),
                "simulated": ("trial", [r["simulated"] for r in self.rows], {"units": "forcing periods"}),
            },
            variables,
        )
        design = dict(zip(problem.names, map(float, problem.values(move.at)), strict=True))
        return Design(
            problem, design, total, move.faced.total, stderr, _gradient_norm(move), cases, starts, history, status
        )


def _gradient_norm(move: AbstractMove) -> float:
    """The relative slope that is left at a design, see `Design.gradient_norm`."""
    faced, free = move.faced, inside(move.at)
    if not np.isfinite(faced.total):
        return np.nan
    if faced.weight is not None:
        left = faced.total_slope[free]
    else:
        active = faced.value >= faced.total - ACTIVE * abs(faced.total)
        rows = faced.slope[active][:, free]
        # the point of least norm in the hull of the worst cases' derivatives
        count = len(rows)
        system = np.vstack([rows.T, 1e3 * np.abs(rows).max(initial=1e-300) * np.ones((1, count))])
        goal = np.append(np.zeros(rows.shape[1]), 1e3 * np.abs(rows).max(initial=1e-300))
        share, _ = scipy.optimize.nnls(system, goal)
        left = rows.T @ share
    return float(np.linalg.norm(left) / max(abs(faced.total), 1e-300))


def _labels(q: Quantity) -> dict[str, Any]:
    """Attributes of a variable of a dataset from which pictures label and scale it, whatever its name."""
    return {
        "units": q.unit,
        "long_name": q.long_name,
        "quantity": q.name,
        "symbol": q.symbol,
        "shown_unit": q.display_unit,
        "per_shown": q.per_shown,
    }


def _merged(
    problem: Problem,
    scene: Scene,
    values: dict[str, float],
    tables: dict[str, xr.Dataset],
    summary: dict[str, Any],
) -> xr.Dataset:
    """Several tables as one dataset, each variable with its table's prefix.

    **Arguments:** `scene` and `values`: of the best design; `tables`: datasets by prefix, such as "trial" for
    trial_smooth, or "" for none; `summary`: further attributes.
    """
    renamed = [
        ds.rename({name: f"{prefix}_{name}" for name in ds.data_vars}) if prefix else ds
        for prefix, ds in tables.items()
    ]
    names, over = problem.names, tuple(problem.over)
    known = [parameter(name, problem.scene) for name in names]
    words = lambda text: {"long_name": f"{text}, in the unit of each variable"}
    own = xr.Dataset(
        {
            "design": ("variable", [values[name] for name in names], words("best design")),
            "low": ("variable", problem.low, words("lower bound")),
            "high": ("variable", problem.low + problem.width, words("upper bound")),
        },
        {"variable": list(names), "variable_unit": ("variable", [q.unit for q in known])},
    )
    ds = xr.merge([own, *renamed], join="exact", compat="equals")
    question = problem.question
    finite = lambda v: v if math.isfinite(v) else None
    call = {
        "function": "optimise_design",
        "objective": problem.objective.name,
        "variables": [[name, *bounds] for name, bounds in problem.bounds.items()],
        "over": [[name, values] for name, values in problem.over.items()],
        "robust": problem.robust,
        "constraints": [[c.objective.name, finite(c.low), finite(c.high)] for c in problem.constraints],
        "periodic": problem.periodic,
        "transient": question.transient,
        "steps_per_period": question.steps,
        "solver": question.solver,
        "spread": list(problem.spread),
    }
    start = table_2_start() if problem.start is None else problem.start
    attrs = scene_attributes(scene, without=(*over, *names)) | run_attributes(scene, start, call, over)
    numbers = {name: np.int8(v) if isinstance(v, bool) else v for name, v in summary.items()}
    return ds.assign_attrs(attrs | {"robust": problem.robust} | numbers)
