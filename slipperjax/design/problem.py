"""The problem of a search: objective, variables, cases and constraints, checked before anything is compiled."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.stats.qmc
from jaxtyping import Float

from ..flow.simulate import first_of
from ..model.parameters import check_no_overlap, parameter
from ..model.scene import Scene, check_scene
from ..model.step_size import given_steps
from ..solvers.named import resolve_solver
from ..sweeps.grid import Cases
from ..tools.checks import in_unit, known, one_of, require, whole, yes_or_no
from .judge import judge
from .methods import CaseValues
from .objectives import Evaluation, EvaluationPlan, Objective, RailEnsemble, ensemble_for, objective_named

SCREENED = 4
"""Designs judged for each start of a search, besides the corners of the box."""
APART = 0.3, 0.15
"""Distances between starts [unit box]: the first where enough designs lie that far apart, else the second, or any."""


@dataclasses.dataclass(frozen=True)
class Problem(EvaluationPlan):
    """The problem of a search for a design: what is evaluated, and what is sought."""

    objective: Objective
    bounds: dict[str, tuple[float, float]]
    """Of each variable [its SI unit]."""
    over: dict[str, np.ndarray]
    """Values of other parameters that the design must serve, every combination."""
    robust: str
    """How the cases are joined, "worst" or "mean"."""
    constraints: tuple[tuple[Objective, float, float], ...]
    """Objectives that must lie between two values in every case."""
    periodic: bool

    @property
    def cases(self) -> dict[str, np.ndarray]:
        """The combinations of `over` as lists of one length."""
        mesh = np.meshgrid(*self.over.values(), indexing="ij")
        return {name: m.ravel() for name, m in zip(self.over, mesh, strict=True)}

    @property
    def count(self) -> int:
        """Number of cases of one design."""
        return math.prod(len(values) for values in self.over.values())

    @property
    def low(self) -> np.ndarray:
        """Lower bounds [SI units]."""
        return np.array([low for low, _ in self.bounds.values()])

    @property
    def width(self) -> np.ndarray:
        """Widths of the box [SI units]."""
        return np.array([high - low for low, high in self.bounds.values()])

    def limits(self, name):
        return self.bounds[name]

    def index(self, objective: Objective) -> int:
        """Returns the index of an objective in evaluations."""
        return self.objectives.index(objective)

    def joined(self, values: Float[np.ndarray, " cases"]) -> float:
        """Returns the worst or the mean of the cases' values."""
        return float(np.max(values) if self.robust == "worst" else np.mean(values))

    def in_units(self, at: Float[np.ndarray, "*designs parameters"]) -> Float[np.ndarray, "*designs parameters"]:
        """Returns designs of the unit box in SI units."""
        return self.low + at * self.width

    def evaluate(self, designs: Float[np.ndarray, "designs parameters"], warm_start: Evaluation | None) -> Evaluation:
        """Evaluates all cases of some designs of the unit box, design by design."""
        values = np.repeat(self.in_units(designs), self.count, axis=0)
        grid = {name: values[:, k] for k, name in enumerate(self.names)}
        grid |= {name: np.tile(v, len(designs)) for name, v in self.cases.items()}
        return judge(self, grid, warm_start)

    def case_values(self, evaluation: Evaluation) -> CaseValues:
        """Returns objective and constraints of one design from the evaluation of its cases."""
        slope, at = evaluation.gradient * self.width, self.index(self.objective.smooth)
        excess, excess_slope = [np.empty(0)], [np.empty((0, len(self.names)))]
        for objective, low, high in self.constraints:
            k, limits = self.index(objective), [(s, v) for s, v in ((1.0, high), (-1.0, low)) if math.isfinite(v)]
            scale = max(abs(limit) for _, limit in limits) or 1.0
            excess += [sign * (evaluation.value[:, k] - limit) / scale for sign, limit in limits]
            excess_slope += [sign * slope[:, k] / scale for sign, _ in limits]
        if self.periodic:
            excess.append(np.where(evaluation.period == 0, 1.0, -1.0))
            excess_slope.append(np.zeros((self.count, len(self.names))))
        weight = None if self.robust == "worst" else np.full(self.count, 1 / self.count)
        value = evaluation.value[:, at]
        return CaseValues(value, slope[:, at], np.concatenate(excess), np.concatenate(excess_slope), weight)


def checked_problem(
    scene, objective, variables, *, over, robust, constraints, periodic, transient, ensemble, steps, solver, start
) -> Problem:
    """Returns the problem that a user's arguments state, see `optimise_design`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    known("scene", check_scene(scene))
    ensemble = ensemble_for(scene, ensemble)
    need = "be False where the rail does not recur"
    require(not (yes_or_no("periodic", periodic) and isinstance(ensemble, RailEnsemble)), "periodic", need, periodic)
    objective = objective_named(objective)
    bounds = _checked_bounds(scene, variables)
    over = {} if over is None else over
    require(isinstance(over, Mapping), "over", "name parameters with their values", over)
    both = [name for name in over if name in bounds]
    if both:
        raise ValueError(f"Argument `over` must name other parameters than `variables`, but has {both[0]}.")
    check_no_overlap([parameter(name, scene) for name in (*bounds, *over)], scene)
    over = {name: np.atleast_1d(np.asarray(parameter(name, scene).check(v), float)) for name, v in over.items()}
    limits = _checked_limits(constraints)
    one_of("robust", robust, ("worst", "mean"))
    solver, start = resolve_solver(scene, solver), first_of(start)
    if steps is None:
        corners = {name: list(pair) for name, pair in bounds.items()} | over
        steps = int(Cases(scene, corners, start).default_steps().max())
    return Problem(
        scene,
        tuple(bounds),
        tuple(dict.fromkeys([objective.smooth, objective, *(one for one, _, _ in limits)])),
        solver,
        given_steps(steps),
        2 * steps,
        start,
        {name: ensemble.box_reach * (high - low) for name, (low, high) in bounds.items()},
        whole("transient", transient, 0),
        ensemble,
        objective,
        bounds,
        over,
        robust,
        limits,
        periodic,
    )


def _checked_bounds(scene: Scene, variables: Any) -> dict[str, tuple[float, float]]:
    require(isinstance(variables, Mapping) and variables, "variables", "name parameters with their bounds", variables)
    bounds = {}
    for name, pair in variables.items():
        variable = parameter(name, scene)
        variable.check_exists(scene)
        variable.check_varies()
        require(np.shape(pair) == (2,), name, "be a lower and an upper bound", pair)
        low, high = (float(v) for v in np.asarray(variable.check(pair)))
        if not low < high:
            raise ValueError(
                f"Argument `{name}` must have a lower bound below the upper one, but is {low:g} to {high:g} "
                f"{variable.unit}."
            )
        bounds[name] = low, high
    return bounds


def _checked_limits(constraints: Any) -> tuple[tuple[Objective, float, float], ...]:
    constraints = {} if constraints is None else constraints
    require(isinstance(constraints, Mapping), "constraints", "map objectives to limits", constraints)
    limits = []
    for name, pair in constraints.items():
        objective = objective_named(name)
        ends = pair if isinstance(pair, Sequence) else (None, pair)
        try:
            ends = in_unit(ends, objective.quantity.unit)
            low, high = (
                default if v is None else float(v) for v, default in zip(ends, (-np.inf, np.inf), strict=True)
            )
        except (TypeError, ValueError):
            low, high = np.nan, np.nan
        need = f"have a highest value or (low, high) for {objective.name} [{objective.quantity.unit}]"
        require(low < high and not (math.isinf(low) and math.isinf(high)), "constraints", need, pair)
        limits.append((objective, low, high))
    return tuple(limits)


def first_designs(
    problem: Problem, starts: Any, seed: int
) -> tuple[Float[np.ndarray, "designs parameters"], int, int]:
    """Returns designs of the unit box to judge first; how many of them a search begins from; and of these how many
    are the first ones, whatever the others are like. See `optimise_design`."""
    names = problem.names
    if isinstance(starts, Sequence) and not isinstance(starts, str):
        designs = starts and all(isinstance(one, Mapping) and set(one) == set(names) for one in starts)
        require(designs, "starts", f"be designs that give {', '.join(names)}", starts)
        values = np.array([[float(one[name]) for name in names] for one in starts])
        designs = (values - problem.low) / problem.width
        require(np.all((designs >= 0) & (designs <= 1)), "starts", "lie within the bounds", starts)
        return designs, len(designs), len(designs)
    count = whole("starts", starts, 1)
    own = (np.array([float(problem.scene.value(name)) for name in names]) - problem.low) / problem.width
    inside = np.all((own >= 0) & (own <= 1))
    if inside and count == 1:
        return own[None], 1, 1
    designs = scipy.stats.qmc.LatinHypercube(len(names), rng=seed).random(SCREENED * count)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=len(names)))) if len(names) <= 3 else designs[:0]
    return np.concatenate([own[None] if inside else designs[:0], corners, designs]), count, int(inside)


def spread_designs(
    at: Float[np.ndarray, "designs parameters"], order: np.ndarray, count: int, fixed: int
) -> list[int]:
    """Returns the indices of `count` designs: the first `fixed`, and of the others the best ones that lie apart.

    **Arguments:** `order`: indices of all designs, the best one first.
    """
    chosen = list(range(fixed)) or [int(order[0])]
    for apart in (*APART, -1.0):
        for k in map(int, order):
            distance = np.min(np.max(np.abs(at[chosen] - at[k]), axis=1))
            if len(chosen) < count and k not in chosen and distance > apart:
                chosen.append(k)
    return chosen
