"""Checks of a design: simulations of its neighbours, and distances to the nearest events."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..flow.status import Status
from ..model.layout import StateLayout
from ..model.parameters import parameter
from ..orbits.branches import OrbitBranch, continue_orbit
from ..orbits.periodic import periodic_orbit
from ..sweeps.attractors import LAST
from ..sweeps.grid import Grid
from ..sweeps.records import LEAST_PERIODS, MotionKind
from ..sweeps.sweep import sweep
from ..tools.checks import instance, number, positive, require, whole
from ..tools.columns import column
from .optimise import Design
from .problem import Problem

EVENTS = ("LP", "PD", "NS", "BP", "GR")
"""Labels of events from which a design should keep a distance."""


def surroundings(
    design: Design,
    *,
    points: int = 5,
    width: float = 0.1,
    transient: int = 300,
    periods: int = 64,
    **options: object,
) -> xr.Dataset:
    """Compute the objective around a design by simulation only, as one batch: an independent check.

    Designs over rails that do not recur are judged by ensembles on other rails, with standard errors.

    **Arguments:** `points`: number of designs along each variable, rounded up to an odd number so that the design
    itself is included; `width`: their greatest distance to each side, as a share of the box; designs beyond a bound
    are moved to the bound. `transient`, `periods`, `options`: as for `sweep`; the steps are those of the search.

    **Returns:** the dataset of `sweep` over variables and cases, with the objective and its smooth form, and `total`,
    the worst or the mean of the cases, over the variables. Attribute `improvement_found`: difference between the
    lowest total and the design's own total, relative to the latter [1].

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C.
    """
    problem = instance("design", design, Design, "a result of optimise_design").problem
    count = whole("points", points, 1) | 1
    far = number(positive, "width", width)
    grid = {}
    # around each variable, its own value included
    for name, (low, high) in problem.bounds.items():
        around = design.design[name] + far * (high - low) * np.linspace(-1, 1, count)
        grid[name] = np.unique(np.clip(around, low, high))
    smooth = problem.objective.smooth
    objectives = list(dict.fromkeys([problem.objective, smooth]))
    if problem.on_rails:
        ds = _on_other_rails(problem, grid)
    else:
        kinds = MotionKind(min(max(whole("periods", periods, 1), LEAST_PERIODS), LAST))
        call = dict(
            steps_per_period=problem.steps,
            solver=problem.solver,
            start=problem.start,
            transient=transient,
            periods=periods,
            record=[*objectives, kinds],
        )
        ds = sweep(problem.scene, grid | problem.over, **(call | options)).ds
        # lost cases have no objective
        for one in objectives:
            ds[one.name] = ds[one.name].where(ds["status"] == Status.FINITE)
    values = ds[smooth.name]
    of_cases = list(problem.over)
    # a case without a value leaves its design without a value
    join = values.max if problem.robust == "worst" else values.mean
    total = join(of_cases, skipna=False)
    total = total.assign_attrs(values.attrs, long_name=f"{problem.robust} {smooth.name}")
    own = float(total.sel(design.design, method="nearest"))
    improvement = float((own - np.nanmin(total.values)) / abs(own))
    return ds.assign(total=total).assign_attrs(improvement_found=improvement)


def _on_other_rails(problem: Problem, grid: dict[str, np.ndarray]) -> xr.Dataset:
    """Judge designs of a grid by ensembles on rails that no search uses: seeds a million batches further; for a set
    of rails, the rails of the last judgement."""
    other = problem.with_seed(problem.ensemble.seed + 1_000_001)
    # every combination of the variables, design by design
    designs = np.stack(np.meshgrid(*grid.values(), indexing="ij"), axis=-1).reshape(-1, len(grid))
    evaluation = other.evaluate((designs - problem.low) / problem.width, None)
    cases = Grid(problem.scene, grid | problem.over)
    ds = xr.Dataset({"status": (cases.dims, evaluation.status.reshape(cases.shape))}, cases.coordinates())
    # the smooth form may be equal to the objective
    for one in (problem.objective, problem.objective.smooth):
        k = problem.index(one)
        value, stderr = (a[:, k].reshape(cases.shape) for a in (evaluation.value, evaluation.stderr))
        ds[one.name] = (cases.dims, value, one.quantity.attributes)
        ds[f"{one.name}_stderr"] = column(cases.dims, stderr, one.quantity.unit, f"standard error of {one.name}")
    return ds


def event_margins(
    design: Design,
    names: Sequence[str] | None = None,
    *,
    cases: Sequence[int] | None = None,
    width: float = 0.2,
    points: int = 60,
    progress: bool | None = None,
) -> xr.Dataset:
    """Find how far a parameter may change, in both directions, before the orbit of a case meets an event.

    `continue_orbit` follows each orbit from the design, one parameter at a time.

    **Arguments:** `names`: of the parameters, default the variables and the parameters of `over`; `cases`: by number,
    default the worst case, and the case with the largest multiplier; `width`: greatest change, relative to the
    magnitude of the parameter, or to the width of its bounds where a variable is zero [1]; `points`: most points of
    each branch.

    **Returns:** an `xarray.Dataset` along `margin`: `case`, `parameter`, `direction` (-1 or 1), `label` of the event
    (empty where no event was met), `value` of the parameter there, or where the branch ended, and `change` from the
    design, in SI units; `relative` change [1], as `width`.

    **Raises:** `ValueError` where a case has no orbit, or another parameter than a variable is zero.
    """
    problem = design.problem
    far = number(positive, "width", width)
    names = [*problem.names, *problem.over] if names is None else list(names)
    cases = _telling_cases(design) if cases is None else list(cases)
    # half the step, to resolve events
    steps = dict(steps_per_period=2 * problem.steps, solver=problem.solver)
    rows = []
    for case in cases:
        period = int(design.cases["period"][case])
        require(period, "cases", "be on orbits", shown=f"case {case} is {design.regime[case]}")
        scene = design.scene.replace(**{name: float(values[case]) for name, values in problem.cases.items()})
        start = StateLayout.of(scene).unpack(jnp.asarray(design.cases["state"].values[case]))
        orbit = periodic_orbit(scene, period, start=start, **steps)
        # one parameter at a time, in both directions
        for name in names:
            value = float(scene.value(name))
            size = size_of(problem, name, value)
            ends = (value - far * size, value + far * size)
            options = steps | dict(points=points, until=EVENTS, progress=progress)
            branch = continue_orbit(scene, name, ends, start=orbit, **options)
            unit = parameter(name, problem.scene).unit
            for direction, label, end in _first_events(branch, value):
                change = end - value
                rows.append((case, name, direction, label, end, change, change / size, unit))
    require(rows, "cases", "name cases on orbits", cases)
    fields = ("case", "parameter", "direction", "label", "value", "change", "relative", "unit")
    columns = zip(fields, zip(*rows, strict=True), strict=True)
    ds = xr.Dataset({name: ("margin", list(values)) for name, values in columns})
    ds["value"].attrs["long_name"] = "parameter at the event, in the unit of each row"
    ds["change"].attrs["long_name"] = "distance to the event, in the unit of each row"
    ds["relative"].attrs["long_name"] = "distance to the event over the parameter's value"
    ds["relative"].attrs["units"] = "1"
    return ds


def size_of(problem: Problem, name: str, value: float) -> float:
    """Return the size of a parameter, to which its changes are relative: its magnitude, or where a variable is zero
    the width of its box.

    **Raises:** `ValueError` for a parameter that is zero and no variable.
    """
    size = abs(value) or float(np.ptp(problem.bounds.get(name, 0.0)))
    require(size > 0, "names", "be of variables, or of parameters that are not zero", name)
    return size


def _telling_cases(design: Design) -> list[int]:
    """Return the worst case and the case nearest to instability, among cases on orbits."""
    period = design.cases["period"].values
    # multipliers per forcing period
    modulus = design.cases["multiplier"].values ** (1 / np.maximum(period, 1))
    found = []
    for values in (design.cases["smooth"].values, modulus):
        # cases without an orbit come last
        of_orbits = np.where(period > 0, values, -np.inf)
        found.append(int(np.argmax(of_orbits)))
    return list(dict.fromkeys(found))


def _first_events(branch: OrbitBranch, value: float) -> list[tuple[int, str, float]]:
    """Return direction, label and parameter of the first event on each side of the place where a branch began."""
    along = branch.ds[branch.parameter.name].values
    begin = int(np.argmin(np.abs(along - value)))
    events = []
    # branches may turn: the first step from the beginning gives the direction
    for side, last in ((-1, 0), (1, len(along) - 1)):
        neighbour = along[np.clip(begin + side, 0, len(along) - 1)]
        direction = int(np.sign(neighbour - value)) or side
        met = [event for event in branch.events if event.label in EVENTS and (event.point - begin) * side > 0]
        first = min(met, key=lambda event: abs(event.point - begin), default=None)
        # without an event, the end of the branch
        events.append((direction, first.label, first.value) if first else (direction, "", float(along[last])))
    return events
