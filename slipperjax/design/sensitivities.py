"""Derivatives of objectives with respect to parameters of a scene, with regime, method, standard error and domain; on
periodic orbits over a grid also as a record of a sweep."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import diffrax
import numpy as np
import xarray as xr

from ..analysis.step_error import FINER, with_step_error
from ..flow.datasets import scene_attributes
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import checked_parameters, parameter
from ..model.scene import Scene, check_scene
from ..orbits.motions import check_forcing
from ..orbits.simulate import Trajectory, default_steps, first_of
from ..solvers.named import resolve_solver
from ..sweeps.orbits import NearestOrbit
from ..tools.checks import known, number, one_of, positive, require, tuple_of, whole
from ..tools.columns import column
from .ensembles import AbstractEnsemble, ensemble_for
from .judge import ensemble_averages, judge_on_orbits
from .objectives import OBJECTIVES, Evaluation, EvaluationPlan, ObjectiveLike, OrbitObjectives, objective_named


def sensitivities(
    scene: Scene,
    objectives: ObjectiveLike | Sequence[ObjectiveLike],
    names: Sequence[str] = ("speed", "clearance", "length"),
    *,
    method: str | None = None,
    ensemble: AbstractEnsemble | None = None,
    reach: float | None = None,
    transient: int = 200,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
) -> xr.Dataset:
    """Differentiate objectives with respect to parameters of a scene.

    **Arguments:**

    - `objectives`: one or several, by name or as objects, see `slipperjax.design.OBJECTIVES`.
    - `names`: of parameters, or paths such as "section.play.2".
    - `method`: "orbit" differentiates on the stable periodic orbit to which the motion settles, by the implicit
        function theorem. "ensemble" fits a plane to the averages of many runs, as needed for an attractor that is not
        periodic. Default "orbit" where there is an orbit, otherwise "ensemble".
    - `ensemble`, `reach`: sizes of ensembles, and the distance of their parameters from the scene's values, relative
        to the value; by default suited to the track, see `RailEnsemble` for rails that do not recur.
    - `transient`: forcing periods before; others as for `simulate`.

    **Returns:** an `xarray.Dataset` with `value` [the objective's unit] along `objective`, and also along `parameter`
    `gradient` and `gradient_stderr` [objective's unit per parameter's unit], and `relative`, the relative change of
    the objective per relative change of the parameter [1]. `domain` is how far the parameter may change: on orbits
    until a grazing, by a linear estimate; for ensembles the reach. On orbits all values use twelve times the steps of
    the motion, and the errors follow from the differences to three and six times: 99 % of true errors of derivatives
    are within three of `gradient_stderr`. Attributes: `method`, `regime`, `period`, `multiplier`, `simulated`; for
    ensembles the number of runs that are `lost`. A parameter that contains another named parameter changes only the
    remaining parts: the clearance changes all other faces where section.play.2 is also named.

    **Raises:** `ValueError` that names the wrong argument, also where there is no orbit.
    """
    scene = known("scene", check_scene(scene))
    ensemble = ensemble_for(scene, ensemble)
    reach = number(positive, "reach", ensemble.relative_reach if reach is None else reach)
    if isinstance(objectives, str) or not isinstance(objectives, Sequence):
        objectives = [objectives]
    # one case, with the scene's own values
    grid = {one.name: np.array([float(one.of(scene))]) for one in checked_parameters(names, scene)}
    steps = int(default_steps(scene, steps_per_period))
    plan = EvaluationPlan(
        scene=scene,
        names=tuple(grid),
        objectives=tuple(dict.fromkeys(map(objective_named, objectives))),
        solver=resolve_solver(scene, solver),
        steps=steps,
        most_steps=FINER[-1] * steps,
        start=first_of(start),
        reach={name: abs(float(value[0])) * reach for name, value in grid.items()},
        transient=whole("transient", transient, 0),
        ensemble=ensemble,
    )
    if method is not None:
        one_of("method", method, ("orbit", "ensemble"))
    if method == "orbit":
        check_forcing(scene)
    # the distance from a grazing bounds the domain of derivatives on orbits
    grazing = OBJECTIVES["grazing_distance"]
    on_orbit = replace(plan, objectives=tuple(dict.fromkeys([*plan.objectives, grazing])))
    # values and derivatives come from finer steps, or from ensembles
    motion = judge_on_orbits(replace(on_orbit, names=()), grid)
    regime = str(motion.regime[0])
    if motion.period[0] == 0 and method == "orbit":
        raise ValueError(
            f"Argument `method` must be 'ensemble' here, but is 'orbit': after {transient} periods the motion is "
            f"{regime}, not on a stable periodic orbit."
        )
    if motion.period[0] == 0 or method == "ensemble":
        for name, distance in plan.reach.items():
            require(distance > 0, "names", "be of parameters that are not 0 for ensembles", name)
        # runs around a lost motion would also be lost
        if motion.status[0] == Status.FINITE:
            motion = ensemble_averages(plan, grid, motion)
        if motion.status[0] != Status.FINITE:
            raise ValueError(f"Argument `scene` must stay on the rail, but: {Status(int(motion.status[0]))}.")
        facts = dict(method="ensemble", regime=regime, ensemble=str(ensemble), lost=int(motion.lost[0]))
        return _dataset(plan, motion, np.array(list(plan.reach.values())), facts)
    evaluation = _on_finer_steps(on_orbit, grid, motion)
    # the change to a grazing by a linear estimate:
    # the distance over its derivative with respect to each parameter
    at = on_orbit.objectives.index(grazing)
    with np.errstate(divide="ignore"):
        domain = evaluation.value[0, at] / np.abs(evaluation.gradient[0, at])
    return _dataset(plan, evaluation, domain, dict(method="orbit", regime=regime))


def _on_finer_steps(
    plan: EvaluationPlan,
    grid: dict[str, np.ndarray],
    motion: Evaluation,
) -> Evaluation:
    """Evaluate an orbit with derivatives on finer steps, with their errors, see `with_step_error`."""
    judged = [motion]

    # keeps each evaluation and adds its cost
    def results(steps: int) -> dict[str, np.ndarray]:
        one = judge_on_orbits(replace(plan, steps=steps), grid, motion)
        # differences to another orbit would be no error of the steps
        if one.period[0] != motion.period[0]:
            raise ValueError(
                f"Argument `steps_per_period` must be larger here, but is {plan.steps}: with {steps} the motion is "
                f"{one.regime[0]}, and {motion.regime[0]} with {plan.steps}."
            )
        cost = judged[-1].simulated + steps / plan.steps * one.simulated
        judged.append(one._replace(simulated=cost))
        return {"value": one.value, "gradient": one.gradient}

    _, errors = with_step_error(results, plan.steps)
    return judged[-1]._replace(stderr=errors["value"], gradient_stderr=errors["gradient"])


def _dataset(
    plan: EvaluationPlan,
    evaluation: Evaluation,
    domain: np.ndarray,
    facts: dict[str, object],
) -> xr.Dataset:
    """Return the dataset of an evaluation of one case, with `facts`; it may have further objectives."""
    parameters = [parameter(name, plan.scene) for name in plan.names]
    asked = slice(len(plan.objectives))
    value = evaluation.value[0, asked]
    gradient = evaluation.gradient[0, asked]
    sizes = np.array([float(one.of(plan.scene)) for one in parameters])
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = gradient * sizes / value[:, None]
    both = ("objective", "parameter")
    per = "objective's unit per parameter's unit"
    data = {
        "value": column("objective", value, "objective's unit", "objective"),
        "stderr": column("objective", evaluation.stderr[0, asked], "", "standard error"),
        "gradient": column(both, gradient, per, "derivative by the parameter"),
        "gradient_stderr": column(both, evaluation.gradient_stderr[0, asked], per, "its standard error"),
        "relative": column(both, relative, "1", "relative change per relative change"),
        "domain": column("parameter", domain, "parameter's unit", "change up to which it holds"),
    }
    coords = {
        "objective": [one.name for one in plan.objectives],
        "objective_unit": ("objective", [one.quantity.unit for one in plan.objectives]),
        "parameter": [one.name for one in parameters],
        "parameter_unit": ("parameter", [one.unit for one in parameters]),
    }
    facts |= dict(
        period=int(evaluation.period[0]),
        multiplier=float(evaluation.multiplier[0]),
        simulated=float(evaluation.simulated[0]),
    )
    return xr.Dataset(data, coords, scene_attributes(plan.scene) | facts)


@dataclass(frozen=True)
class OrbitSensitivities(NearestOrbit):
    """The periodic orbit near the end of each motion, with exact derivatives of objectives on it, and of its state.

    ```python
    record = OrbitSensitivities(objectives=("peak_force",), parameters=("speed", "clearance"))
    ds = sj.sweep(scene, {"speed": np.linspace(1250.0, 1500.0, 11)}, record=record)
    ds["orbit_peak_force_slope"].sel(parameter="clearance")
    ```

    Errors from the steps are as in `sensitivities`, which also gives them; more steps make the errors smaller.
    """

    objectives: tuple[ObjectiveLike, ...] = ()
    """Names in `OBJECTIVES`, objectives, or functions of a course."""
    parameters: tuple[str, ...] = ("speed", "clearance", "length")
    """Names or paths of the parameters."""

    def __post_init__(self):
        super().__post_init__()
        # equal records share programs: objectives by name become objects
        objectives = tuple_of("objectives", self.objectives, object, "a list of objectives")
        named = dict.fromkeys(objective_named(one, "objectives") for one in objectives)
        object.__setattr__(self, "objectives", tuple(named))
        parameters = tuple_of("parameters", self.parameters, str, "a list of names of parameters")
        object.__setattr__(self, "parameters", parameters)

    name = "orbit_sensitivities"

    @property
    def variables(self):
        of_objectives = [name for one in self.objectives for name in (f"orbit_{one.name}", f"orbit_{one.name}_slope")]
        return tuple(dict.fromkeys([*super().variables, "orbit_state_slope", *of_objectives]))

    def values(self, scene, periods):
        return super().values(scene, periods) + 50 * (len(self.parameters) + 1)

    def check(self, scene, periods, steps):
        super().check(scene, periods, steps)
        checked_parameters(self.parameters, scene)

    def kept(self, part, maps, orbits):
        found = maps._replace(periods=np.where(orbits.status == Status.FINITE, maps.periods, 0))
        of = OrbitObjectives(self.objectives, self.parameters, part.capacity)
        base = super().kept(part, maps, orbits)
        return *base, *of.on(found, base[1], orbits.inverse)

    def label(self, scene, dims, values):
        data, coords = super().label(scene, dims, values)
        state_slope, value, gradient = values[5:]
        over = (*dims, "parameter")
        text = "derivatives of all numbers of the orbit's state by the parameters"
        data["orbit_state_slope"] = column((*over, "number"), state_slope, "", text)
        for k, one in enumerate(self.objectives):
            name = f"orbit_{one.name}"
            q = one.quantity
            per = f"{q.unit} per SI unit of the parameter"
            data[name] = column(dims, value[..., k], q.unit, f"{q.long_name} on the orbit")
            data[f"{name}_slope"] = column(over, gradient[..., k, :], per, f"derivative of {name}")
        units = [one.unit for one in checked_parameters(self.parameters, scene)]
        return data, coords | {"parameter": list(self.parameters), "parameter_unit": ("parameter", units)}
