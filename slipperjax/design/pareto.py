"""Fronts of two objectives."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..model.parameters import parameter
from ..model.scene import Scene
from ..tools.checks import require, whole
from .methods import TrustRegion
from .objectives import Objective, objective_named
from .optimise import Design, optimise_design


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
    """Follow the front of two objectives from the best design of the second to that of the first.

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
    count = whole("points", points, 3)
    limits = dict(constraints or {})

    def best(one: Objective, limited: dict, **more: Any) -> Design:
        return optimise_design(scene, one, variables, constraints=limits | limited, **(options | more))

    # the other objective is evaluated, too, by a limit that nothing exceeds
    no_limit = (None, np.finfo(float).max)
    lowest_second = best(second, {first: no_limit}, starts=starts)
    lowest_first = best(first, {second: no_limit}, starts=starts)
    designs = [lowest_second]
    between = np.linspace(_value(lowest_second, second), _value(lowest_first, second), count)
    for limit in between[1:-1]:
        # short steps from the last design
        near = dict(method=TrustRegion(radius=0.05), starts=[designs[-1].design])
        designs.append(best(first, {second: limit}, **near))
    designs.append(lowest_first)
    data = {}
    values = []
    for one in (first, second):
        values.append(np.array([_value(design, one) for design in designs]))
        data[one.name] = ("point", values[-1], one.quantity.attributes)
    for name in variables:
        chosen = [one.design[name] for one in designs]
        data[name] = ("point", chosen, parameter(name, scene).attributes)
    # row k, column j: whether design j beats design k in both
    beaten = np.all([v[None, :] < v[:, None] for v in values], axis=0).any(axis=1)
    periodic = [float(np.mean(one.cases["period"] > 0)) for one in designs]
    data["periodic"] = ("point", periodic, {"units": "1"})
    data["status"] = ("point", [one.status for one in designs])
    data["ideal"] = ("point", ~beaten)
    data["simulated"] = ("point", [one.simulated for one in designs], {"units": "forcing periods"})
    attrs = {"objectives": [first.name, second.name], "robust": lowest_first.problem.robust}
    return xr.Dataset(data, attrs=attrs)


def _value(design: Design, objective: Objective) -> float:
    """Return an objective at a design, in the worst of the cases or their mean."""
    name = "objective" if objective == design.problem.objective else f"constraint_{objective.name}"
    return design.problem.joined(design.cases[name].values)
