"""Trade-offs: designs of which no other one is better in both of two objectives."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..model.paths import parameter
from ..model.scene import Scene
from ..tools.checks import whole
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
    """The front of two objectives, followed from the best design of the second to that of the first.

    Between, the first objective is minimised while the second stays below limits that rise evenly, each search
    beginning from the last design (Haimes, Lasdon and Wismer 1971, doi:10.1109/TSMC.1971.4308298).

    **Arguments:** `objectives`: two, by name or as objects; `points`: designs on the front; `starts`: of both ends;
    `constraints`, `options`: of `optimise_design`.

    **Returns:** an `xarray.Dataset` along `point`: each objective by name, worst case or mean, the variables by name,
    `periodic`, the share of cases on orbits, `status`, and `simulated` forcing periods; `ideal` is true of designs
    that no other one of the front beats in both.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    if not isinstance(objectives, tuple | list) or len(objectives) != 2:
        raise ValueError(f"Argument `objectives` must be two objectives, but is {objectives!r}.")
    first, second = map(objective_named, objectives)
    count, limits = whole("points", points, 3), {} if constraints is None else dict(constraints)
    # what is not minimised is only looked at: a limit that nothing meets
    seen = lambda one: {one: (None, np.finfo(float).max)}
    least_second = optimise_design(
        scene, second, variables, starts=starts, constraints=limits | seen(first), **options
    )
    least_first = optimise_design(
        scene, first, variables, starts=starts, constraints=limits | seen(second), **options
    )
    found = [least_second]
    low, high = _value(least_second, second), _value(least_first, second)
    short = TrustRegion(radius=0.05)
    for limit in np.linspace(low, high, count)[1:-1]:
        near = dict(method=short, starts=[found[-1].design])
        found.append(
            optimise_design(scene, first, variables, constraints=limits | {second: limit}, **(options | near))
        )
    found.append(least_first)
    return _front(scene, found, first, second)


def _value(design: Design, objective: Objective) -> float:
    """An objective at a design, in the worst of the cases or their mean."""
    ds = design.cases
    own = design.problem.objective
    values = ds["objective"].values if objective == own else ds[f"constraint_{objective.name}"].values
    return float(np.max(values) if design.problem.robust == "worst" else np.mean(values))


def _front(scene: Scene, found: list[Design], first: Objective, second: Objective) -> xr.Dataset:
    values = {one: np.array([_value(design, one) for design in found]) for one in (first, second)}
    beaten = [
        any(values[first][j] < values[first][k] and values[second][j] < values[second][k] for j in range(len(found)))
        for k in range(len(found))
    ]
    names = found[0].problem.names
    data = {one.name: ("point", v, one.quantity.attributes) for one, v in values.items()}
    for name in names:
        data[name] = ("point", [one.design[name] for one in found], parameter(name, scene).attributes)
    return xr.Dataset(
        data
        | {
            "periodic": ("point", [float(np.mean(one.cases["period"] > 0)) for one in found], {"units": "1"}),
            "status": ("point", [one.status for one in found]),
            "ideal": ("point", np.logical_not(beaten)),
            "simulated": ("point", [one.simulated for one in found], {"units": "forcing periods"}),
        },
        attrs={"objectives": [first.name, second.name], "robust": found[0].problem.robust},
    )
