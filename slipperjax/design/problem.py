"""The problem of a search: objective, variables, cases and constraints, checked before anything is compiled."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
import scipy.stats.qmc
from jaxtyping import Float

from ..model.parameters import check_no_overlap, parameter
from ..model.scene import Scene, check_scene
from ..model.step_size import given_steps
from ..orbits.simulate import first_of
from ..solvers.named import resolve_solver
from ..sweeps.grid import Cases, Grid
from ..tools.checks import known, one_of, require, whole
from ..tools.types import Numbers
from ..tools.units import in_unit
from .ensembles import ensemble_for
from .judge import judge
from .methods import CaseValues
from .objectives import Evaluation, EvaluationPlan, Objective, objective_named

SMOOTH = 0
"""Place of the smooth form of the objective among the objectives of a problem."""
Limits = float | tuple[float | None, float | None]
"""Highest value of a constraint, or lowest and highest value; None means no limit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Problem(EvaluationPlan):
    """The problem of a search for a design: what is evaluated, and what is searched.

    The variables are the parameters that have `bounds`.
    """

    objective: Objective
    over: dict[str, np.ndarray]
    """Values of other parameters that the design must serve, every combination."""
    robust: str
    """How the cases are combined, "worst" or "mean"."""
    constraints: tuple[tuple[Objective, float, float], ...]
    """Objectives that must be between two values in every case."""

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
        return np.min(list(self.bounds.values()), axis=1)

    @property
    def width(self) -> np.ndarray:
        """Widths of the box [SI units]."""
        return np.ptp(list(self.bounds.values()), axis=1)

    def index(self, objective: Objective) -> int:
        """Return the index of an objective in evaluations."""
        return self.objectives.index(objective)

    def in_units(self, at: Float[np.ndarray, "*designs parameters"]) -> Float[np.ndarray, "*designs parameters"]:
        """Return designs of the unit box in SI units."""
        return self.low + at * self.width

    def in_box(self, designs: Sequence[Mapping[str, float]]) -> Float[np.ndarray, "designs parameters"]:
        """Return designs as points of the unit box."""
        values = np.array([[float(one[name]) for name in self.names] for one in designs])
        return (values - self.low) / self.width

    def with_seed(self, seed: int) -> "Problem":
        """Return the problem with other disturbances, or other rails."""
        return dataclasses.replace(self, ensemble=dataclasses.replace(self.ensemble, seed=seed))

    @property
    def unseen(self) -> "Problem":
        """The problem along rails that a search along these does not use; unchanged if the rail recurs."""
        return self.with_seed(self.ensemble.seed + 1) if self.on_rails else self

    def evaluate(
        self,
        designs: Float[np.ndarray, "designs parameters"],
        warm_start: Evaluation | None,
    ) -> Evaluation:
        """Evaluate all cases of some designs of the unit box, design by design."""
        # each design has every case
        values = np.repeat(self.in_units(designs), self.count, axis=0)
        grid = {name: values[:, k] for k, name in enumerate(self.names)}
        grid |= {name: np.tile(v, len(designs)) for name, v in self.cases.items()}
        return judge(self, grid, warm_start)

    def case_values(self, evaluation: Evaluation) -> CaseValues:
        """Return objective and constraints of one design from the evaluation of its cases."""
        value = evaluation.value
        # derivatives with respect to variables become derivatives with respect to coordinates of the unit box
        slope = evaluation.gradient * self.width
        excess = [np.empty(0)]
        excess_slope = [np.empty((0, len(self.names)))]
        for objective, low, high in self.constraints:
            k = self.index(objective)
            # violations of different constraints are compared in multiples of their limits
            scale = max(abs(limit) for limit in (low, high) if math.isfinite(limit)) or 1.0
            # distance above the upper and below the lower limit
            for sign, limit in ((1.0, high), (-1.0, low)):
                if math.isfinite(limit):
                    excess.append(sign * (value[:, k] - limit) / scale)
                    excess_slope.append(sign * slope[:, k] / scale)
        # a power mean replaces a peak, because the derivative of a peak jumps
        return CaseValues(
            value=value[:, SMOOTH],
            slope=slope[:, SMOOTH],
            excess=np.concatenate(excess),
            excess_slope=np.concatenate(excess_slope),
            weight=None if self.robust == "worst" else np.full(self.count, 1 / self.count),
        )


def checked_problem(
    scene, objective, variables, *, over, robust, constraints, transient, ensemble, steps, solver, start
) -> Problem:
    """Return the problem of a user's arguments, see `optimise_design`.

    **Raises:** `ValueError` that names the wrong argument.
    """
    scene = known("scene", check_scene(scene))
    ensemble = ensemble_for(scene, ensemble)
    objective = objective_named(objective)
    bounds = _checked_bounds(scene, variables)
    over = {} if over is None else over
    require(isinstance(over, Mapping), "over", "name parameters with their values", over)
    for name in over:
        require(name not in bounds, "over", "name other parameters than `variables`", name)
    values = Grid(scene, over).axes if over else {}
    check_no_overlap([parameter(name, scene) for name in (*bounds, *over)], scene)
    constraints = _checked_limits(constraints)
    limited = [one for one, _, _ in constraints]
    # a trajectory means its end, None means Table 2's start
    start = first_of(start)
    # all use the steps of the corner that needs most steps
    if steps is None:
        corners = {name: list(pair) for name, pair in bounds.items()}
        steps = int(Cases(scene, corners | values, start).default_steps().max())
    reach = {name: ensemble.box_reach * (high - low) for name, (low, high) in bounds.items()}
    return Problem(
        scene=scene,
        names=tuple(bounds),
        objectives=tuple(dict.fromkeys([objective.smooth, objective, *limited])),
        solver=resolve_solver(scene, solver),
        steps=given_steps(steps),
        most_steps=2 * steps,
        start=start,
        reach=reach,
        transient=whole("transient", transient, 0),
        ensemble=ensemble,
        bounds=bounds,
        objective=objective,
        over=values,
        robust=one_of("robust", robust, ("worst", "mean")),
        constraints=constraints,
    )


def _checked_bounds(scene: Scene, variables: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    require(isinstance(variables, Mapping) and variables, "variables", "name parameters with their bounds", variables)
    bounds = {}
    for name, pair in variables.items():
        variable = parameter(name, scene)
        variable.check_exists(scene)
        # not all parameters have derivatives
        variable.check_varies()
        require(np.shape(pair) == (2,), name, "be a lower and an upper bound", pair)
        low, high = np.asarray(variable.check(pair)).tolist()
        shown = f"{low:g} to {high:g} {variable.unit}"
        require(low < high, name, "have a lower bound below the upper one", shown=shown)
        bounds[name] = (low, high)
    return bounds


def _checked_limits(constraints: Mapping | None) -> tuple[tuple[Objective, float, float], ...]:
    constraints = {} if constraints is None else constraints
    require(isinstance(constraints, Mapping), "constraints", "map objectives to limits", constraints)
    limits = []
    for name, given in constraints.items():
        objective = objective_named(name)
        # a single number is the highest value
        pair = given if isinstance(given, Sequence) else (None, given)
        try:
            ends = zip(in_unit(pair, objective.quantity.unit), (-np.inf, np.inf), strict=True)
            low, high = (none if end is None else float(end) for end, none in ends)
        except (TypeError, ValueError):
            low = high = np.nan
        need = f"have a highest value or (low, high) for {objective.name} [{objective.quantity.unit}]"
        require(low < high and np.isfinite([low, high]).any(), "constraints", need, given)
        limits.append((objective, low, high))
    return tuple(limits)


def first_designs(
    problem: Problem, starts: int | Sequence[Mapping[str, float]], seed: int
) -> tuple[Float[np.ndarray, "designs parameters"], int, int]:
    """Return the beginning of a search, see `optimise_design`.

    **Returns:** designs of the unit box to judge first; the number of designs to begin from; and how many of these
    are always the first designs, not the best.
    """
    names = problem.names
    if isinstance(starts, Sequence) and not isinstance(starts, str):
        need = f"be designs that give {', '.join(names)}"
        require(starts, "starts", need, starts)
        for one in starts:
            require(isinstance(one, Mapping) and set(one) == set(names), "starts", need, starts)
        designs = problem.in_box(starts)
        require(np.all((designs >= 0) & (designs <= 1)), "starts", "lie within the bounds", starts)
        return designs, len(designs), len(designs)
    count = whole("starts", starts, 1)
    own = problem.in_box([{name: problem.scene.value(name) for name in names}])
    # a scene outside of the bounds is no design
    inside = bool(np.all((own >= 0) & (own <= 1)))
    if inside and count == 1:
        return own, 1, 1
    # the scene's own design, the corners where they are few, and others spread over the box
    screened: list[Numbers] = list(own) if inside else []
    if len(names) <= 3:
        screened += itertools.product((0.0, 1.0), repeat=len(names))
    hypercube = scipy.stats.qmc.LatinHypercube(len(names), rng=seed)
    screened += list(hypercube.random(4 * count))
    return np.array(screened), count, int(inside)


def spread_designs(
    at: Float[np.ndarray, "designs parameters"],
    order: Sequence[int],
    count: int,
    fixed: int,
) -> list[int]:
    """Return the indices of `count` designs: the first `fixed`, and the best others at a distance from each other.

    **Arguments:** `order`: indices of all designs, the best design first.
    """
    chosen = list(range(fixed)) or [order[0]]
    # at smaller distances if too few designs are far apart [unit box]
    for apart in (0.3, 0.15, -1.0):
        for k in order:
            # distance to the nearest chosen design
            distance = np.min(np.max(np.abs(at[chosen] - at[k]), axis=1))
            if len(chosen) < count and k not in chosen and distance > apart:
                chosen.append(k)
    return chosen
