"""Derivatives on periodic orbits over a grid, as a record of a sweep."""

from dataclasses import dataclass

import numpy as np

from ..flow.status import Status
from ..model.parameters import checked_parameters
from ..sweeps.orbits import NearestOrbit
from ..tools.checks import tuple_of
from ..tools.columns import column
from .gradients import OrbitObjectives
from .objectives import ObjectiveLike, objective_named


@dataclass(frozen=True)
class OrbitSensitivities(NearestOrbit):
    """The periodic orbit near the end of each motion, with exact derivatives of objectives on it, and of its state.

    ```python
    record = OrbitSensitivities(objectives=("peak_force",), parameters=("speed", "clearance"))
    ds = sj.sweep(scene, {"speed": np.linspace(1250.0, 1500.0, 11)}, record=record)
    ds["orbit_peak_force_slope"].sel(parameter="clearance")
    ```

    The errors of the steps are those of `sensitivities`, which states them; more steps make them smaller.
    """

    objectives: tuple[ObjectiveLike, ...] = ()
    """Names in `OBJECTIVES`, objectives, or functions of a course."""
    parameters: tuple[str, ...] = ("speed", "clearance", "length")
    """Names or paths of the parameters."""

    def __post_init__(self):
        super().__post_init__()
        # equal ones share programs: objectives by name are those objectives
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
