"""Pareto fronts: designs of which no other one is better in both of two objectives."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..model.paths import parameter
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
    """Follows the front of two objectives from the best design of the second to that of the first.

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
    count, limits = whole("points", points, 3), {} if constraints is None else dict(constraints)
    # the other objective is evaluated, too, as a limit that nothing exceeds
    observed = lambda one: {one: (None, np.finfo(float).max)}
    lowest_second, lowest_first = (
        optimise_design(scene, one, variables, starts=starts, constraints=limits | observed(other), **options)
        for one, other in ((second, first), (first, second))
    )
    designs = [lowest_second]
    for limit in np.linspace(_value(lowest_second, second), _value(lowest_first, second), count)[1:-1]:
        near = dict(method=TrustRegion(radius=0.05), starts=[designs[-1].design])
        limited = limits | {second: limit}
        designs.append(optimise_design(scene, first, variables, constraints=limited, **(options | near)))
    return _front(scene, [*designs, lowest_first], first, second)


def _value(design: Design, objective: Objective) -> float:
    """Returns an objective at a design, in the worst of the cases or their mean."""
    name = "objective" if objective == design.problem.objective else f"constraint_{objective.name}"
    return design.problem.joined(design.cases[name].values)


def _front(scene: Scene, designs: list[Design], first: Objective, second: Objective) -> xr.Dataset:
    """Returns the dataset of a front."""
    values = {one: np.array([_value(design, one) for design in designs]) for one in (first, second)}
    # row k, column j: whether design j beats design k in both
    beaten = np.all([v[None, :] < v[:, None] for v in values.values()], axis=0).any(axis=1)
    data = {one.name: ("point", v, one.quantity.attributes) for one, v in values.items()}
    for name in designs[0].problem.names:
        data[name] = ("point", [one.design[name] for one in designs], parameter(name, scene).attributes)
    data["periodic"] = ("point", [float(np.mean(one.cases["period"] > 0)) for one in designs], {"units": "1"})
    data["status"] = ("point", [one.status for one in designs])
    data["ideal"] = ("point", ~beaten)
    data["simulated"] = ("point", [one.simulated for one in designs], {"units": "forcing periods"})
    return xr.Dataset(data, attrs={"objectives": [first.name, second.name], "robust": designs[0].problem.robust})
