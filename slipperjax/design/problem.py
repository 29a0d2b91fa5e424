"""What is asked of a design: objective, variables, cases, constraints; checked before anything is compiled."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.stats.qmc
from jaxtyping import Float

from ..model.dang2024 import table_2_start
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.paths import parameter, refuse_undone
from ..model.scene import Scene, check_scene
from ..orbits.motions import check_forcing
from ..solvers.named import resolve_solver
from ..sweeps.grid import Cases
from ..tools.checks import brief, instance, one_of, require, whole, yes_or_no
from .ensembles import Spread
from .judge import Judged, Memory, Question, judge
from .methods import Faced
from .objectives import Objective, objective_named

REACH = 0.005
"""How far ensembles' parameters are from a design [unit box]."""


class Limits(NamedTuple):
    """A constraint: an objective that must lie between two values."""

    objective: Objective
    low: float
    high: float

    @property
    def scale(self) -> float:
        """What counts as a violation of one [unit]."""
        return max(abs(v) for v in (self.low, self.high) if math.isfinite(v)) or 1.0


@dataclasses.dataclass(frozen=True)
class Problem:
    """What is asked of a design."""

    scene: Scene
    objective: Objective
    bounds: dict[str, tuple[float, float]]
    """Of each variable [its SI unit]."""
    over: dict[str, np.ndarray]
    """Values of other parameters that the design must serve, every combination."""
    robust: str
    constraints: tuple[Limits, ...]
    periodic: bool
    question: Question
    spread: Spread
    start: Motion | State | None

    @property
    def names(self) -> tuple[str, ...]:
        """The variables."""
        return tuple(self.bounds)

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

    def values(self, at: Float[np.ndarray, "... parameters"]) -> Float[np.ndarray, "... parameters"]:
        """Designs of the unit box in SI units."""
        return self.low + at * self.width

    def judged(self, designs: Float[np.ndarray, "designs parameters"], memory: Memory | None) -> Judged:
        """All cases of some designs of the unit box, design by design."""
        values = np.repeat(self.values(designs), self.count, axis=0)
        grid = {name: values[:, k] for k, name in enumerate(self.names)}
        grid |= {name: np.tile(v, len(designs)) for name, v in self.cases.items()}
        reach = dict(zip(self.names, REACH * self.width, strict=True))
        return judge(
            self.scene, grid, self.question, reach=reach, spread=self.spread, start=self.start, memory=memory
        )

    def faced(self, judged: Judged) -> Faced:
        """What one design faces, from its cases."""
        slope = judged.gradient * self.width
        places = {objective: k for k, objective in enumerate(self.question.objectives)}
        at = places[self.objective.smooth]
        excess, excess_slope = [], []
        for limits in self.constraints:
            k = places[limits.objective]
            for sign, limit in ((1.0, limits.high), (-1.0, limits.low)):
                if math.isfinite(limit):
                    excess.append(sign * (judged.value[:, k] - limit) / limits.scale)
                    excess_slope.append(sign * slope[:, k] / limits.scale)
        if self.periodic:
            excess.append(np.where(judged.period == 0, 1.0, -1.0))
            excess_slope.append(np.zeros((len(judged.status), len(self.names))))
        size = len(self.names)
        return Faced(
            judged.value[:, at],
            slope[:, at],
            np.concatenate(excess) if excess else np.empty(0),
            np.concatenate(excess_slope) if excess else np.empty((0, size)),
            None if self.robust == "worst" else np.full(self.count, 1 / self.count),
        )


def checked_problem(
    scene: Any,
    objective: Any,
    variables: Any,
    *,
    over: Any,
    robust: Any,
    constraints: Any,
    periodic: Any,
    transient: Any,
    spread: Any,
    steps: Any,
    solver: Any,
    start: Any,
) -> Problem:
    """The problem that a user's arguments state, see `optimise_design`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    check_scene(scene)
    check_forcing(scene)
    objective = objective_named(objective)
    bounds = _checked_bounds(scene, variables)
    over = {} if over is None else over
    require(isinstance(over, Mapping), "over", "name parameters with their values", over)
    both = [name for name in over if name in bounds]
    if both:
        raise ValueError(f"Argument `over` must name other parameters than `variables`, but has {both[0]}.")
    known = [parameter(name, scene) for name in (*bounds, *over)]
    refuse_undone(known, scene)
    values = {name: np.atleast_1d(np.asarray(parameter(name, scene).checked(v), float)) for name, v in over.items()}
    limits = _checked_limits(constraints)
    one_of("robust", robust, ("worst", "mean"))
    objectives = tuple(dict.fromkeys([objective.smooth, objective, *(one.objective for one in limits)]))
    solver = resolve_solver(scene, solver)
    corners = {**{name: list(pair) for name, pair in bounds.items()}, **values}
    if steps is None:
        steps = int(Cases(scene, corners, table_2_start() if start is None else start).default_steps().max())
    question = Question(
        tuple(bounds), objectives, solver, whole("steps_per_period", steps, 1), whole("transient", transient, 0)
    )
    instance("spread", spread, Spread, "a slipperjax.design.Spread")
    return Problem(
        scene, objective, bounds, values, robust, limits, yes_or_no("periodic", periodic), question, spread, start
    )


def _checked_bounds(scene: Scene, variables: Any) -> dict[str, tuple[float, float]]:
    require(isinstance(variables, Mapping) and variables, "variables", "name parameters with their bounds", variables)
    found = {}
    for name, pair in variables.items():
        known = parameter(name, scene)
        known.check_exists(scene)
        require(np.shape(pair) == (2,), name, "be a lower and an upper bound", pair)
        low, high = (float(v) for v in np.asarray(known.checked(pair)))
        if not low < high:
            raise ValueError(
                f"Argument `{name}` must have a lower bound below the upper one, but is {low:g} to {high:g} "
                f"{known.unit}."
            )
        found[name] = low, high
    return found


def _checked_limits(constraints: Any) -> tuple[Limits, ...]:
    if constraints is None:
        return ()
    require(isinstance(constraints, Mapping), "constraints", "map objectives to limits", constraints)
    found = []
    for name, given in constraints.items():
        objective = objective_named(name)
        pair = given if isinstance(given, Sequence) else (None, given)
        try:
            low, high = (
                default if v is None else float(v) for v, default in zip(pair, (-np.inf, np.inf), strict=True)
            )
        except (TypeError, ValueError):
            low, high = np.nan, np.nan
        if not low < high or (math.isinf(low) and math.isinf(high)):
            raise ValueError(
                f"Argument `constraints` must have a highest value or (low, high) for {objective.name} "
                f"[{objective.quantity.unit}], but has {brief(given)}."
            )
        found.append(Limits(objective, low, high))
    return tuple(found)


def first_designs(problem: Problem, starts: Any, seed: int) -> Float[np.ndarray, "starts parameters"]:
    """Where a search begins, designs of the unit box; see `optimise_design`."""
    names = problem.names
    if isinstance(starts, Sequence) and not isinstance(starts, str):
        if not starts or any(not isinstance(one, Mapping) or set(one) != set(names) for one in starts):
            raise ValueError(
                f"Argument `starts` must be designs that give {', '.join(names)}, but is {brief(starts)}."
            )
        given = np.array([[float(one[name]) for name in names] for one in starts])
        found = (given - problem.low) / problem.width
        require(not np.any((found < 0) | (found > 1) | np.isnan(found)), "starts", "lie within the bounds", starts)
        return found
    count = whole("starts", starts, 1)
    own = (np.array([float(problem.scene.value(name)) for name in names]) - problem.low) / problem.width
    spread = scipy.stats.qmc.LatinHypercube(len(names), rng=seed).random(count)
    if np.all((own >= 0) & (own <= 1)):
        spread[0] = own
    return spread
