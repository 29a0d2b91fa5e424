"""Checks of a design: simulations of its neighbours, and distances to the nearest events."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..flow.status import Status
from ..model.layout import StateLayout
from ..model.parameters import parameter
from ..orbits.branches import OrbitBranch, continue_orbit
from ..orbits.periodic import periodic_orbit
from ..sweeps.attractors import LAST
from ..sweeps.records import LEAST_PERIODS, MotionKind
from ..sweeps.sweep import sweep
from ..tools.checks import number, positive, require, whole
from .objectives import RailEnsemble
from .optimise import Design
from .problem import Problem

EVENTS = ("LP", "PD", "NS", "BP", "GR")
"""Labels of events to keep away from."""
OTHER_RAILS = 1_000_000
"""Added to the number of a search's batch of rails for checks."""


def surroundings(
    design: Design, *, points: int = 5, width: float = 0.1, transient: int = 300, periods: int = 64, **options: Any
) -> xr.Dataset:
    """Computes the objective around a design by simulation alone, as one batch: an independent check.

    Designs over rails are judged by ensembles on other rails, with their errors.

    **Arguments:** `points`: designs along each variable, rounded up to an odd number so that the design itself is
    one; `width`: their greatest distance on both sides, as a share of the box; those beyond a bound are moved to it.
    `transient`, `periods`, `options`: of `sweep`; the steps are those of the search.

    **Returns:** the dataset of `sweep` over variables and cases, with the objective and its smooth form,
    and `total`, the worst or the mean of the cases, over the variables. Attribute `lower`: difference of the lowest
    total from the design's own, over it [1].

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    problem = design.problem
    count, far = whole("points", points, 1) | 1, number(positive, "width", width)
    grid: dict[str, Any] = {}
    for name, (low, high) in problem.bounds.items():
        own = design.design[name]
        around = own + far * (high - low) * np.linspace(-1, 1, count)
        ends = [end for end in (low, high) if around[0] <= end <= around[-1]]
        grid[name] = np.unique([*around[(around > low) & (around < high)], *ends, own])
    smooth = problem.objective.smooth
    if isinstance(problem.ensemble, RailEnsemble):
        return _with_total(design, _on_other_rails(problem, grid))
    objectives = list(dict.fromkeys([problem.objective, smooth]))
    call: dict[str, Any] = dict(steps_per_period=problem.steps, solver=problem.solver, start=problem.start)
    kinds = MotionKind(min(max(whole("periods", periods, 1), LEAST_PERIODS), LAST))
    call |= dict(transient=transient, periods=periods, record=[*objectives, kinds])
    ds = sweep(problem.scene, grid | problem.over, **(call | options))
    for objective in objectives:
        ds[objective.name] = ds[objective.name].where(ds["status"] == Status.FINITE)
    return _with_total(design, ds)


def _with_total(design: Design, ds: xr.Dataset) -> xr.Dataset:
    """Adds the total of the cases, and by how much the lowest one lies below the design's own."""
    problem, smooth = design.problem, design.problem.objective.smooth
    values, of_cases = ds[smooth.name], list(problem.over)
    total = values.max(of_cases, skipna=False) if problem.robust == "worst" else values.mean(of_cases, skipna=False)
    total = total.assign_attrs(values.attrs | {"long_name": f"{problem.robust} {smooth.name}"})
    own = float(total.sel(design.design, method="nearest"))
    return ds.assign(total=total).assign_attrs(lower=float((own - np.nanmin(total.values)) / abs(own)))


def _on_other_rails(problem: Problem, grid: dict[str, np.ndarray]) -> xr.Dataset:
    """Judges designs of a grid by ensembles on rails of another seed."""
    other = replace(problem, ensemble=replace(problem.ensemble, seed=problem.ensemble.seed + OTHER_RAILS))
    mesh = np.stack([m.ravel() for m in np.meshgrid(*grid.values(), indexing="ij")], axis=1)
    evaluation = other.evaluate((mesh - problem.low) / problem.width, None)
    dims, shape = (*grid, *problem.over), [len(v) for v in (*grid.values(), *problem.over.values())]
    data: dict[str, Any] = {"status": (dims, evaluation.status.reshape(shape))}
    for one in dict.fromkeys([problem.objective, problem.objective.smooth]):
        value, error = (
            array[:, problem.index(one)].reshape(shape) for array in (evaluation.value, evaluation.stderr)
        )
        data[one.name] = (dims, value, one.quantity.attributes)
        words = {"units": one.quantity.unit, "long_name": f"standard error of {one.name}"}
        data[f"{one.name}_stderr"] = (dims, error, words)
    coords = {name: (name, v, parameter(name, problem.scene).attributes) for name, v in (grid | problem.over).items()}
    return xr.Dataset(data, coords)


def event_margins(
    design: Design,
    names: Sequence[str] | None = None,
    *,
    cases: Sequence[int] | None = None,
    width: float = 0.2,
    points: int = 60,
    progress: bool | None = None,
) -> xr.Dataset:
    """Finds how far a parameter may change, either way, before the orbit of a case meets an event.

    The orbits are followed by `continue_orbit` from the design, one parameter at a time.

    **Arguments:** `names`: of the parameters, default the variables and those of `over`; `cases`: by number,
    default the worst, and the one with the largest multiplier; `width`: greatest change, over the parameter's value
    [1]; `points`: most points of each branch.

    **Returns:** an `xarray.Dataset` along `margin`: `case`, `parameter`, `direction` (-1 or 1), `label` of the event
    (empty where none was met), `value` of the parameter there, or where the branch ended, and `change` from the
    design, in SI units; `relative` change [1].

    **Raises:** `ValueError` where a case has no orbit.
    """
    problem, far = design.problem, number(positive, "width", width)
    names = [*problem.names, *problem.over] if names is None else list(names)
    cases = _telling_cases(design) if cases is None else list(cases)
    rows = []
    for case in cases:
        period = int(design.cases["period"].values[case])
        if period == 0:
            raise ValueError(f"Argument `cases` must be on orbits, but case {case} is {design.regime[case]}.")
        scene = design.scene.replace(**{name: float(values[case]) for name, values in problem.cases.items()})
        # steps half as long, to resolve events
        options: dict[str, Any] = dict(steps_per_period=2 * problem.steps, solver=problem.solver)
        start = StateLayout.of(scene).unpack(jnp.asarray(design.cases["state"].values[case]))
        orbit = periodic_orbit(scene, period, start=start, **options)
        options |= dict(points=points, until=EVENTS, progress=progress)
        for name in names:
            value = float(scene.value(name))
            branch = continue_orbit(scene, name, (value * (1 - far), value * (1 + far)), start=orbit, **options)
            for direction, label, end in _first_events(branch, value):
                rows.append((case, name, direction, label, end, end - value, (end - value) / abs(value)))
    require(rows, "cases", "name cases on orbits", cases)
    fields = ("case", "parameter", "direction", "label", "value", "change", "relative")
    columns = {name: ("margin", list(column)) for name, column in zip(fields, zip(*rows, strict=True), strict=True)}
    ds = xr.Dataset(columns | {"unit": ("margin", [parameter(row[1], problem.scene).unit for row in rows])})
    ds["value"].attrs["long_name"] = "parameter at the event, in the unit of each row"
    ds["change"].attrs["long_name"] = "distance to the event, in the unit of each row"
    ds["relative"].attrs |= {"long_name": "distance to the event over the parameter's value", "units": "1"}
    return ds


def _telling_cases(design: Design) -> list[int]:
    """Returns the worst case and the one nearest to instability, of those on orbits."""
    ds = design.cases
    period = ds["period"].values
    if not period.any():
        return []
    greatest = lambda values: int(np.argmax(np.where(period > 0, values, -np.inf)))
    modulus = ds["multiplier"].values ** (1 / np.maximum(period, 1))
    return list(dict.fromkeys([greatest(ds["smooth"].values), greatest(modulus)]))


def _first_events(branch: OrbitBranch, value: float) -> list[tuple[int, str, float]]:
    """Returns direction, label and parameter of the first event on each side of where a branch began."""
    along = branch.points[branch.parameter.name].values
    begin = int(np.argmin(np.abs(along - value)))
    events = []
    for side in (-1, 1):
        neighbour = along[min(max(begin + side, 0), len(along) - 1)]
        direction = int(np.sign(neighbour - value)) or side
        met = [event for event in branch.events if event.label in EVENTS and (event.point - begin) * side > 0]
        first = min(met, key=lambda event: abs(event.point - begin), default=None)
        end = along[0 if side < 0 else -1] if first is None else first.value
        events.append((direction, "" if first is None else first.label, float(end)))
    return events
