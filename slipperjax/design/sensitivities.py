"""Derivatives of objectives by parameters of a scene, with what they rest on: regime, method, error and domain."""

from collections.abc import Sequence
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.flatten_util import ravel_pytree

from ..analysis.attractor import classify
from ..flow.datasets import scene_attributes
from ..flow.simulate import Trajectory, default_steps, dynamic_steps, first_of, simulate
from ..flow.status import Status
from ..flow.stepping import ConstantSteps
from ..model.dang2024 import table_2_start
from ..model.dynamics import State, initial_state
from ..model.kinematics import MOTION_SCALES, Motion
from ..model.layout import coordinates
from ..model.paths import parameter, refuse_undone
from ..model.quantities import COORDINATE_SCALES, Parameter
from ..model.scene import Scene, check_scene
from ..orbits.motions import check_forcing
from ..solvers.named import resolve_solver
from ..sweeps.attractors import FLOOR
from ..tools.batching import Batched
from ..tools.checks import brief, one_of, whole, yes_or_no
from .ensembles import Spread, averages
from .gradients import pulled_gradient, push_period, total_slopes
from .judge import PUSH, Judged, Question, judge_on_orbits
from .objectives import OBJECTIVES, Objective, objective_named

METHODS = ("orbit", "ensemble", "run")
"""Ways to differentiate an objective."""
RELATIVE_REACH = 0.002
"""How far ensembles' parameters are from the scene's, over their values [1]."""
FASTEST = 1e4
"""Growth of a run's derivatives, over that of the first periods, from which on they say nothing of averages."""


def sensitivities(
    scene: Scene,
    objectives: Any,
    names: Sequence[str] = ("speed", "clearance", "length"),
    *,
    method: str | None = None,
    periods: int = 5,
    reverse: bool = False,
    spread: Spread = Spread(),
    reach: float = RELATIVE_REACH,
    transient: int = 200,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
) -> xr.Dataset:
    """Derivatives of objectives by parameters of a scene.

    **Arguments:**

    - `objectives`: one or several, by name or as objects, see `slipperjax.design.OBJECTIVES`.
    - `names`: of parameters, or paths such as "section.play.2".
    - `method`: "orbit" differentiates on the stable periodic orbit that the motion settles to, by the theorem of
        implicit functions; "ensemble" fits a plane to the averages of many runs, which is what an attractor that is
        not periodic needs; "run" differentiates a run of `periods` forcing periods from a fixed start in forward
        mode. Default "orbit" where there is one, and "ensemble" otherwise.
    - `reverse`: on orbits, reverse mode: its cost does not depend on the number of parameters.
    - `spread`, `reach`: how ensembles are made, and how far their parameters are from the scene's, over their values.
    - `transient`: forcing periods to pass before, but not for "run"; others as for `simulate`.

    **Returns:** an `xarray.Dataset` with `value` [the objective's unit] along `objective`, and along `parameter`,
    too, `gradient` and `gradient_stderr` [objective's unit per parameter's unit], and `relative`, the relative change
    of the objective per relative change of the parameter [1]. `domain` is how far the parameter may change: on orbits
    to where a linear estimate has them graze, for ensembles the reach. Attributes: `method`, `regime`, `period`,
    `multiplier`, `simulated`. A parameter of which another one is a part changes what is left: the clearance, beside
    section.play.2, all other faces.

    **Raises:** `ValueError` that names the argument which is wrong, also for an orbit that is not there, and for a
    run whose derivatives grow without bound.
    """
    check_scene(scene)
    check_forcing(scene)
    several = objectives if isinstance(objectives, Sequence) and not isinstance(objectives, str) else [objectives]
    asked = tuple(map(objective_named, several))
    known = _checked_names(scene, names)
    names = tuple(one.name for one in known)
    if method is not None:
        one_of("method", method, METHODS)
    steps, solver = int(default_steps(scene, steps_per_period)), resolve_solver(scene, solver)
    begin = first_of(start)
    values = {one.name: np.array([float(one.of(scene))]) for one in known}
    question = Question(names, asked, solver, steps, whole("transient", transient, 0))
    if method == "run":
        return _of_run(scene, known, question, begin, whole("periods", periods, 1))
    if method == "ensemble":
        return _by_ensemble(scene, known, question, begin, spread, float(reach))
    by_grazing = question._replace(objectives=tuple(dict.fromkeys([*asked, OBJECTIVES["grazing_distance"]])))
    if yes_or_no("reverse", reverse) and question.places(True):
        raise ValueError("Argument `reverse` must be False for exponents, but is True.")
    found = judge_on_orbits(scene, values, by_grazing._replace(names=()) if reverse else by_grazing, start=begin)
    if found.period[0] == 0 and method == "orbit":
        raise ValueError(
            f"Argument `method` must be 'ensemble' here, but is 'orbit': after {transient} periods the motion is "
            f"{found.regime[0]}, not on a stable periodic orbit."
        )
    if found.period[0] == 0:
        if found.regime[0] == "lost":
            raise ValueError(f"Argument `scene` must stay on the rail, but: {Status(int(found.status[0]))}.")
        return _by_ensemble(scene, known, question, begin, spread, float(reach))
    if reverse:
        value, gradient = _pulled(scene, found, by_grazing)
        found = found._replace(value=value, gradient=gradient, gradient_stderr=np.zeros_like(gradient))
    slopes = found.gradient[0, by_grazing.objectives.index(OBJECTIVES["grazing_distance"])]
    with np.errstate(divide="ignore"):
        domain = found.value[0, by_grazing.objectives.index(OBJECTIVES["grazing_distance"])] / np.abs(slopes)
    facts = dict(method="orbit", regime=str(found.regime[0]), period=int(found.period[0]))
    facts |= dict(multiplier=float(found.multiplier[0]), simulated=float(found.simulated[0]))
    count = len(asked)
    parts = found.value[0, :count], found.gradient[0, :count], found.gradient_stderr[0, :count]
    return _dataset(scene, known, asked, *parts, domain, facts)


def _checked_names(scene: Scene, names: Any) -> list[Parameter]:
    if isinstance(names, str) or not isinstance(names, Sequence) or not names:
        raise ValueError(f"Argument `names` must be a list of parameters, but is {brief(names)}.")
    known = [parameter(name, scene) for name in names]
    for one in known:
        one.check_exists(scene)
        if one.of(scene) is None:
            raise ValueError(f"Argument `names` must be of numbers that the scene has, but it has no {one.name}.")
    refuse_undone(known, scene)
    return known


def _pulled(scene: Scene, found: Judged, question: Question) -> tuple[np.ndarray, np.ndarray]:
    """Objectives on an orbit and their derivatives in reverse mode."""
    _, unravel = ravel_pytree(initial_state(scene, table_2_start()))
    how: dict[str, Any] = dict(names=question.names, objectives=question.of_courses, solver=question.solver)
    state, inverse = unravel(jnp.asarray(found.state[0])), jnp.asarray(found.inverse[0])
    value, gradient = pulled_gradient(
        scene, state, inverse, ConstantSteps(question.steps), periods=int(found.period[0]), **how
    )
    return np.asarray(value)[None], np.asarray(gradient)[None]


def _by_ensemble(
    scene: Scene, known: list[Parameter], question: Question, begin: Any, spread: Spread, reach: float
) -> xr.Dataset:
    values = {one.name: np.array([float(one.of(scene))]) for one in known}
    far = {name: abs(float(v[0])) * reach for name, v in values.items()}
    zero = [name for name, v in far.items() if not v > 0]
    if zero:
        raise ValueError(f"Argument `names` must be of parameters that are not 0 for ensembles, but {zero[0]} is.")
    how: dict[str, Any] = dict(steps_per_period=question.steps, solver=question.solver)
    passed = simulate(scene, max(question.transient, 64), saves_per_period=1, loads=False, start=begin, **how)
    kind = classify(coordinates(passed.state)[-200:], scales=COORDINATE_SCALES, floor=FLOOR)
    starts = jax.tree.map(lambda a: np.asarray(a)[None], passed.end.motion)
    options: dict[str, Any] = dict(steps=question.steps, solver=question.solver)
    found = averages(scene, values, question.names, far, question.objectives, starts, spread, **options)
    if found.status[0] != Status.FINITE:
        raise ValueError(f"Argument `scene` must stay on the rail, but: {Status(int(found.status[0]))}.")
    regime = f"{kind.kind} {kind.period}" if int(kind.period) else str(kind.kind)
    facts = dict(method="ensemble", regime=regime, period=int(kind.period), multiplier=np.nan)
    facts |= dict(simulated=float(found.simulated[0]), members=spread.members, periods=spread.periods)
    domain = np.array([far[name] for name in question.names])
    parts = found.value[0], found.gradient[0], found.gradient_stderr[0]
    return _dataset(scene, known, question.objectives, *parts, domain, facts, found.stderr[0])


def _of_run(scene: Scene, known: list[Parameter], question: Question, begin: Any, periods: int) -> xr.Dataset:
    """Objectives of a run from a fixed start, in forward mode."""
    if question.places(True):
        raise ValueError("Argument `method` must be 'orbit' or 'ensemble' for exponents, but is 'run'.")
    batch = Batched(None, scene)
    flat, unravel = ravel_pytree(initial_state(scene, begin))
    scales = np.array(jax.tree.leaves(MOTION_SCALES))
    rows, moved = np.asarray(flat)[None], np.zeros((1, len(known), flat.size))
    kept, slopes, sizes = [], [], []
    how: dict[str, Any] = dict(names=question.names, objectives=question.of_courses, solver=question.solver)
    for epoch in range(periods):
        states = jax.vmap(unravel)(jnp.asarray(rows))
        stepping = dynamic_steps(question.steps, inside=True)
        done = push_period(batch, states, jnp.asarray(moved), float(epoch), stepping, **how)
        rows, moved = np.asarray(done.end), np.asarray(done.moved)
        kept.append(done.kept)
        slopes.append(done.slopes)
        sizes.append(np.max(np.abs(moved[0, :, : len(scales)] / scales), axis=1))
        growth = float(np.max(sizes[-1] / np.maximum(sizes[0], 1e-300)))
        if not growth < FASTEST:
            raise ValueError(
                f"Argument `periods` must be fewer here, but is {periods}: after {epoch + 1} the derivatives along "
                f"the run have grown {growth:.1g}-fold, and say nothing of averages; method='ensemble' does."
            )
    joined = lambda axis, parts: jax.tree.map(lambda *a: jnp.stack(a, axis=axis), *parts)
    value, gradient = total_slopes(question.of_courses, joined(1, kept), joined(2, slopes))
    facts = dict(method="run", regime="run", period=0, multiplier=np.nan, growth=growth, periods=periods)
    facts |= dict(simulated=float(periods * PUSH))
    parts = np.asarray(value)[0], np.asarray(gradient)[0]
    nothing = np.full(len(known), np.nan)
    return _dataset(scene, known, question.objectives, *parts, np.zeros_like(parts[1]), nothing, facts)


def _dataset(
    scene: Scene,
    known: list[Parameter],
    asked: tuple[Objective, ...],
    value: np.ndarray,
    gradient: np.ndarray,
    gradient_stderr: np.ndarray,
    domain: np.ndarray,
    facts: dict[str, Any],
    stderr: np.ndarray | None = None,
) -> xr.Dataset:
    at = np.array([float(one.of(scene)) for one in known])
    both = ("objective", "parameter")
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = gradient * at / value[:, None]
    text = "objective's unit per parameter's unit"
    data = {
        "value": ("objective", value, {"units": "objective's unit", "long_name": "objective"}),
        "stderr": ("objective", np.zeros_like(value) if stderr is None else stderr, {"long_name": "standard error"}),
        "gradient": (both, gradient, {"units": text, "long_name": "derivative by the parameter"}),
        "gradient_stderr": (both, gradient_stderr, {"units": text, "long_name": "its standard error"}),
        "relative": (both, relative, {"units": "1", "long_name": "relative change per relative change"}),
        "domain": ("parameter", domain, {"units": "parameter's unit", "long_name": "change up to which it holds"}),
    }
    coords = {
        "objective": [one.name for one in asked],
        "objective_unit": ("objective", [one.quantity.unit for one in asked]),
        "parameter": [one.name for one in known],
        "parameter_unit": ("parameter", [one.unit for one in known]),
    }
    return xr.Dataset(data, coords, scene_attributes(scene) | facts)
