"""What surrounds a design: brute force next to it, and how far the nearest events are."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.flatten_util import ravel_pytree

from ..flow.status import Status
from ..model.dang2024 import table_2_start
from ..model.dynamics import initial_state
from ..model.paths import parameter
from ..orbits.branches import OrbitBranch, continue_orbit
from ..orbits.periodic import periodic_orbit
from ..sweeps.sweep import sweep
from ..tools.checks import number, positive, require, whole
from .optimise import Design

EVENTS = ("LP", "PD", "NS", "BP", "GR")
"""Labels of events to keep away from."""


def surroundings(
    design: Design, *, points: int = 5, width: float = 0.1, transient: int = 300, periods: int = 64, **options: Any
) -> xr.Dataset:
    """The objective around a design by simulation alone, as one batch: a check by another way.

    **Arguments:** `points`: designs along each variable, rounded up to an odd number so that the design itself is
    one; `width`: how far they reach on both sides, as a share of the box; those beyond a bound are moved to it.
    `transient`, `periods`, `options`: of `sweep`; the steps are those of the search.

    **Returns:** the dataset of `sweep` over variables and cases, with the objective and its smooth form,
    and `total`, the worst or the mean of the cases, over the variables. Attribute `lower`: by how much the lowest
    total there is below that of the design's own place, over it [1].

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    problem = design.problem
    count, far = whole("points", points, 1) | 1, number(positive, "width", width)
    grid: dict[str, Any] = {}
    for name, (low, high) in problem.bounds.items():
        around = design.design[name] + far * (high - low) * np.linspace(-1, 1, count)
        inside = around[(around > low) & (around < high)]
        ends = [end for end in (low, high) if around[0] <= end <= around[-1]]
        grid[name] = np.unique(np.concatenate([inside, ends, [design.design[name]]]))
    asked: list[Any] = [*dict.fromkeys([problem.objective, problem.objective.smooth]), "motion"]
    how: dict[str, Any] = dict(steps_per_period=problem.question.steps, solver=problem.question.solver)
    how |= dict(start=problem.start, transient=transient, periods=periods)
    ds = sweep(problem.scene, grid | problem.over, record=asked, **(how | options))
    for one in asked[:-1]:
        ds[one.name] = ds[one.name].where(ds["status"] == Status.FINITE)
    of_cases = list(problem.over)
    values = ds[problem.objective.smooth.name]
    total = values.max(of_cases, skipna=False) if problem.robust == "worst" else values.mean(of_cases, skipna=False)
    total = total.assign_attrs(values.attrs | {"long_name": f"{problem.robust} {problem.objective.smooth.name}"})
    own = float(total.sel(design.design, method="nearest"))
    return ds.assign(total=total).assign_attrs(lower=float((own - np.nanmin(total.values)) / abs(own)))


def event_margins(
    design: Design,
    names: Sequence[str] | None = None,
    *,
    cases: Sequence[int] | None = None,
    width: float = 0.2,
    points: int = 60,
    progress: bool = False,
) -> xr.Dataset:
    """How far a parameter may change, either way, before the orbit of a case meets an event.

    The orbits are followed by `continue_orbit` from the design, one parameter at a time.

    **Arguments:** `names`: of the parameters, default the variables and those of `over`; `cases`: by number,
    default the worst, and the one with the largest multiplier; `width`: how far is looked, over the parameter's value
    [1]; `points`: most points of each way.

    **Returns:** an `xarray.Dataset` along `margin`: `case`, `parameter`, `direction` (-1 or 1), `label` of the event
    (empty where none was met), `value` of the parameter there, or where the branch ended, and `change` from the
    design, in SI units; `relative` change [1].

    **Raises:** `ValueError` where a case has no orbit.
    """
    problem, far = design.problem, number(positive, "width", width)
    chosen = [*problem.names, *problem.over] if names is None else list(names)
    places = _telling_cases(design) if cases is None else list(cases)
    rows = []
    for case in places:
        period = int(design.cases["period"].values[case])
        if period == 0:
            raise ValueError(f"Argument `cases` must be on orbits, but case {case} is {design.regime[case]}.")
        of_case = {name: float(values[case]) for name, values in problem.cases.items()}
        scene = design.scene.replace(**of_case)
        _, unravel = ravel_pytree(initial_state(scene, table_2_start()))
        how: dict[str, Any] = dict(steps_per_period=2 * problem.question.steps, solver=problem.question.solver)
        start = unravel(jnp.asarray(design.cases["state"].values[case]))
        orbit = periodic_orbit(scene, period, start=start, **how)
        for name in chosen:
            value = float(scene.value(name))
            bounds = value * (1 - far), value * (1 + far)
            how_far: dict[str, Any] = dict(points=points, until=EVENTS, progress=progress)
            branch = continue_orbit(scene, name, bounds, start=orbit, **how_far, **how)
            for direction, label, met in _first_events(branch, value):
                rows.append((case, name, direction, label, met, met - value, (met - value) / abs(value)))
    require(rows, "cases", "name cases on orbits", cases)
    fields = ("case", "parameter", "direction", "label", "value", "change", "relative")
    columns = {name: ("margin", list(column)) for name, column in zip(fields, zip(*rows, strict=True), strict=True)}
    units = [parameter(row[1], problem.scene).unit for row in rows]
    ds = xr.Dataset(columns | {"unit": ("margin", units)})
    words = {"value": "parameter at the event", "change": "distance to the event"}
    for name, text in words.items():
        ds[name].attrs["long_name"] = f"{text}, in the unit of each row"
    ds["relative"].attrs |= {"long_name": "distance to the event over the parameter's value", "units": "1"}
    return ds


def _telling_cases(design: Design) -> list[int]:
    """The worst case and the one nearest to instability, of those on orbits."""
    ds = design.cases
    on_orbit = ds["period"].values > 0
    if not on_orbit.any():
        return []
    worst = int(np.argmax(np.where(on_orbit, ds["smooth"].values, -np.inf)))
    least = int(np.argmax(np.where(on_orbit, ds["multiplier"].values ** (1 / np.maximum(ds["period"], 1)), -np.inf)))
    return list(dict.fromkeys([worst, least]))


def _first_events(branch: OrbitBranch, value: float) -> list[tuple[int, str, float]]:
    """Direction, label and parameter of the first event on each side of where a branch began."""
    ds = branch.points
    along = ds[branch.parameter.name].values
    begin = int(np.argmin(np.abs(along - value)))
    found = []
    for side in (-1, 1):
        rows = [event for event in branch.events if event.label in EVENTS and (event.point - begin) * side > 0]
        last = 0 if side < 0 else len(along) - 1
        direction = int(np.sign(along[min(max(begin + side, 0), len(along) - 1)] - value)) or side
        if rows:
            first = min(rows, key=lambda event: abs(event.point - begin))
            found.append((direction, first.label, first.value))
        else:
            found.append((direction, "", float(along[last])))
    return found
