"""Derivatives of objectives by parameters of a scene, with regime, method, standard error and domain."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import diffrax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..analysis.step_error import FINER, with_step_error
from ..flow.datasets import scene_attributes
from ..flow.simulate import Trajectory, default_steps, first_of
from ..flow.status import Status
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import StateLayout
from ..model.parameters import checked_parameters, parameter
from ..model.scene import Scene, check_scene
from ..orbits.motions import check_forcing
from ..solvers.named import resolve_solver
from ..tools.checks import known, number, one_of, positive, require, whole, yes_or_no
from .gradients import pulled_gradient
from .judge import at_starts, ensemble_averages, judge_on_orbits, judge_run
from .objectives import (
    OBJECTIVES,
    EnsembleSettings,
    Evaluation,
    EvaluationPlan,
    RailEnsemble,
    ensemble_for,
    objective_named,
)

METHODS = ("orbit", "ensemble", "run")
"""Ways to differentiate an objective."""


def sensitivities(
    scene: Scene,
    objectives: Any,
    names: Sequence[str] = ("speed", "clearance", "length"),
    *,
    method: str | None = None,
    periods: int = 5,
    reverse: bool = False,
    ensemble: EnsembleSettings | None = None,
    reach: float | None = None,
    transient: int = 200,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
) -> xr.Dataset:
    """Differentiates objectives by parameters of a scene.

    **Arguments:**

    - `objectives`: one or several, by name or as objects, see `slipperjax.design.OBJECTIVES`.
    - `names`: of parameters, or paths such as "section.play.2".
    - `method`: "orbit" differentiates on the stable periodic orbit that the motion settles to, by the theorem of
        implicit functions; "ensemble" fits a plane to the averages of many runs, which is what an attractor that is
        not periodic needs; "run" differentiates a run of `periods` forcing periods from a fixed start in forward
        mode. Default "orbit" where there is one, and "ensemble" otherwise.
    - `reverse`: on orbits, reverse mode: its cost does not depend on the number of parameters.
    - `ensemble`, `reach`: sizes of ensembles, and the distance of their parameters from the scene's, over the value;
        by default those that the track needs, see `RailEnsemble` for rails that do not recur.
    - `transient`: forcing periods before, but not for "run"; others as for `simulate`.

    **Returns:** an `xarray.Dataset` with `value` [the objective's unit] along `objective`, and along `parameter`,
    too, `gradient` and `gradient_stderr` [objective's unit per parameter's unit], and `relative`, the relative change
    of the objective per relative change of the parameter [1]. `domain` is how far the parameter may change: on orbits
    until a linear estimate has them graze, for ensembles the reach. On orbits all of it is taken with twelve times
    the steps of the motion, and the errors follow from the differences to three and six times: 99 % of true errors
    of derivatives lie within three of `gradient_stderr`. Attributes: `method`, `regime`, `period`,
    `multiplier`, `simulated`. A parameter that contains another one changes the remaining parts: the clearance, where
    section.play.2 is named too, all other faces.

    **Raises:** `ValueError` that names the argument which is wrong, also where there is no orbit, and for a run whose
    derivatives grow without bound.
    """
    known("scene", check_scene(scene))
    ensemble = ensemble_for(scene, ensemble)
    on_rails = isinstance(ensemble, RailEnsemble)
    reach = number(positive, "reach", ensemble.relative_reach if reach is None else reach)
    several = objectives if isinstance(objectives, Sequence) and not isinstance(objectives, str) else [objectives]
    grid = {one.name: np.array([float(one.of(scene))]) for one in checked_parameters(names, scene)}
    steps = int(default_steps(scene, steps_per_period))
    plan = EvaluationPlan(
        scene,
        tuple(grid),
        tuple(dict.fromkeys(map(objective_named, several))),
        resolve_solver(scene, solver),
        steps,
        (1 if method == "run" else FINER[-1]) * steps,
        first_of(start),
        {name: abs(float(value[0])) * reach for name, value in grid.items()},
        whole("transient", transient, 0),
        ensemble,
    )
    if method is not None:
        one_of("method", method, METHODS)
        if method == "orbit":
            check_forcing(scene)
    exponents, reverse = plan.indices(exponents=True), yes_or_no("reverse", reverse) and method != "ensemble"
    if method == "run":
        require(not exponents, "method", "be 'orbit' or 'ensemble' for exponents", method)
        evaluation, growth = judge_run(plan, whole("periods", periods, 1))
        facts = dict(method="run", regime="run", growth=growth, periods=periods)
        return _dataset(plan, evaluation, np.full(len(grid), np.nan), facts)
    require(not (reverse and exponents), "reverse", "be False for exponents", reverse)
    # the distance from grazing bounds the domain of derivatives on orbits
    grazing = OBJECTIVES["grazing_distance"]
    on_orbit = dataclasses.replace(plan, objectives=tuple(dict.fromkeys([*plan.objectives, grazing])))
    evaluation = (at_starts if on_rails else judge_on_orbits)(dataclasses.replace(on_orbit, names=()), grid)
    facts = dict(method="orbit", regime=str(evaluation.regime[0]))
    if evaluation.period[0] == 0 and method == "orbit":
        raise ValueError(
            f"Argument `method` must be 'ensemble' here, but is 'orbit': after {transient} periods the motion is "
            f"{facts['regime']}, not on a stable periodic orbit."
        )
    if evaluation.period[0] == 0 or method == "ensemble":
        zero = [name for name, distance in plan.reach.items() if not distance > 0]
        if zero:
            raise ValueError(
                f"Argument `names` must be of parameters that are not 0 for ensembles, but {zero[0]} is."
            )
        if evaluation.status[0] == Status.FINITE:
            evaluation = ensemble_averages(plan, grid, evaluation)
        if evaluation.status[0] != Status.FINITE:
            raise ValueError(f"Argument `scene` must stay on the rail, but: {Status(int(evaluation.status[0]))}.")
        facts |= dict(method="ensemble", members=ensemble.members, periods=ensemble.periods)
        return _dataset(plan, evaluation, np.array(list(plan.reach.values())), facts)
    evaluation = _on_finer_steps(on_orbit, grid, evaluation, reverse)
    at = on_orbit.objectives.index(grazing)
    with np.errstate(divide="ignore"):
        domain = evaluation.value[0, at] / np.abs(evaluation.gradient[0, at])
    return _dataset(plan, evaluation, domain, facts)


def _on_finer_steps(
    plan: EvaluationPlan, grid: dict[str, np.ndarray], evaluation: Evaluation, reverse: bool
) -> Evaluation:
    """Evaluates an orbit with derivatives on shorter steps, with their errors, see `with_step_error`."""
    judged = [evaluation]

    def results(steps: int) -> dict[str, np.ndarray]:
        fine = dataclasses.replace(plan, steps=steps)
        one = judge_on_orbits(dataclasses.replace(fine, names=()) if reverse else fine, grid, evaluation)
        if one.period[0] != evaluation.period[0]:
            raise ValueError(
                f"Argument `steps_per_period` must be larger here, but is {plan.steps}: with {steps} the motion is "
                f"{one.regime[0]}, and {evaluation.regime[0]} with {plan.steps}."
            )
        one = _pulled(fine, one) if reverse else one
        judged.append(one._replace(simulated=judged[-1].simulated + steps / plan.steps * one.simulated))
        return {"value": one.value, "gradient": one.gradient}

    _, errors = with_step_error(results, plan.steps)
    return judged[-1]._replace(stderr=errors["value"], gradient_stderr=errors["gradient"])


def _pulled(plan: EvaluationPlan, evaluation: Evaluation) -> Evaluation:
    """Returns the evaluation of an orbit with values and derivatives by reverse mode."""
    value, gradient = pulled_gradient(
        plan.scene,
        StateLayout.of(plan.scene).unpack(jnp.asarray(evaluation.state[0])),
        jnp.asarray(evaluation.inverse[0]),
        ConstantSteps(plan.steps),
        names=plan.names,
        objectives=plan.of_courses,
        solver=plan.solver,
        periods=int(evaluation.period[0]),
    )
    value, gradient = np.asarray(value)[None], np.asarray(gradient)[None]
    return evaluation._replace(value=value, gradient=gradient)


def _dataset(plan: EvaluationPlan, evaluation: Evaluation, domain: np.ndarray, facts: dict[str, Any]) -> xr.Dataset:
    """Returns the dataset of an evaluation of one case, which may have further objectives, with `facts`."""
    parameters = [parameter(name, plan.scene) for name in plan.names]
    value, stderr, gradient, gradient_stderr = (
        array[0, : len(plan.objectives)]
        for array in (evaluation.value, evaluation.stderr, evaluation.gradient, evaluation.gradient_stderr)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = gradient * np.array([float(one.of(plan.scene)) for one in parameters]) / value[:, None]
    both, unit = ("objective", "parameter"), "objective's unit per parameter's unit"
    label = lambda unit, text: {"units": unit, "long_name": text}
    data = {
        "value": ("objective", value, label("objective's unit", "objective")),
        "stderr": ("objective", stderr, {"long_name": "standard error"}),
        "gradient": (both, gradient, label(unit, "derivative by the parameter")),
        "gradient_stderr": (both, gradient_stderr, label(unit, "its standard error")),
        "relative": (both, relative, label("1", "relative change per relative change")),
        "domain": ("parameter", domain, label("parameter's unit", "change up to which it holds")),
    }
    coords = {
        "objective": [one.name for one in plan.objectives],
        "objective_unit": ("objective", [one.quantity.unit for one in plan.objectives]),
        "parameter": [one.name for one in parameters],
        "parameter_unit": ("parameter", [one.unit for one in parameters]),
    }
    facts |= dict(period=int(evaluation.period[0]), multiplier=float(evaluation.multiplier[0]))
    facts |= dict(simulated=float(evaluation.simulated[0]))
    return xr.Dataset(data, coords, scene_attributes(plan.scene) | facts)
