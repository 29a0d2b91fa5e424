"""Grids of parameters as one batch to xarray: each case from the same start."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Int

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.period_map import initial_states
from ..flow.record import AbstractRecord
from ..flow.simulate import Trajectory, first_of
from ..flow.status import MEANINGS
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..solvers.latching import solver_name
from .grid import Grid
from .records import resolved_record
from .run import Part, Plan, RunOptions, call_of, make_plan, run_cases, run_chunk
from .store import Store, storable


@storable
def sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    product: bool = True,
    record: str | AbstractRecord | Sequence[str | AbstractRecord] = "sections",
    transient: int = 200,
    periods: int = 10,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    loads: bool | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
    store: Store | str | Path | None = None,
    executor: Any = None,
) -> xr.Dataset:
    """Simulates a scene for every combination of parameter values, as one batch.

    **Arguments:**

    - `scene`: the case whose parameters are varied.
    - `grid`: values by parameter name (see `PARAMETERS` for names and units); several names make a product.
        Coordinates of the start (y, z, v_y, v_z, w_x, w_y, w_z) are allowed too, which gives pictures of basins.
    - `product`: False reads the lists of values side by side, one case each, along the dimension `case`.
    - `record`: what to keep of the last `periods` periods: a name, a record, or a list of both. "sections":
        velocities at the upward zero crossings of each coordinate, as in the paper's bifurcation diagrams, and
        `strobe`, the state once per period from the start on; "strobe": the state once per recorded period;
        "history": states and contact forces `saves_per_period` times per period. All others make a few numbers per
        case while the periods are integrated, so that long records of many cases take no memory: "motion" (`kind`
        and `period` by recurrence), "loads" or one of them ("peak_force", "peak_period", "impulse",
        "contact_fraction", "penetration"), "rms" (of accelerations), "extremes" (of coordinates), "contact_load" and
        others of `slipperjax.flow.RECORDS`, "exponent" (the largest, uncertified, by a tangent afterwards); and from
        `slipperjax.flow` `ForcePercentile`, `SpectrumLines`, and `Record` of any function of a period's course.
    - `transient`: forcing periods to pass before; above ten rounded up to tens, see the attribute `transient`.
    - `steps_per_period`: one number for all cases, or an array of the grid's shape with one for each; default what
        `default_steps_per_period` gives for each. Cases with the same number run together.
    - `solver`, `start`, `saves_per_period`: as for `simulate`.
    - `loads`: whether peak forces, impulses, times in contact and penetrations of the recorded periods come with
        the others, default with sections and histories. With any load come the statuses that follow from loads: no
        contact, pressed in, and unresolved for damping that is too fast for the steps.
    - `chunk`: cases per call, rounded up to 16, 24, 32, 40, 48, 56, 64, 80, ..., or 8 where there are no more;
        `workers`: threads, default one per core, and never more than one where `solver` is one of diffrax's implicit
        ones, see `solvers.calls_lapack`. Neither changes any result.
    - `progress`: show how far it is and how long it will take, as a bar, or a line now and then in files and pipes.
    - `store`: path of a zarr store, or a `Store`, which is written while the sweep runs; the same call goes on where
        the last one ended. `executor`: a `dask.distributed.Client` or `concurrent.futures.Executor` that computes it.

    **Returns:** an `xarray.Dataset` with the grid's names as first dimensions, then `crossing`, `period` or
    `time`. For each case, `status` is 0 where nothing is wrong and tells what happened otherwise, and
    `steps_per_period` how many steps it took. A case that left the finite numbers leaves the others untouched. A
    start coordinate x that is varied makes the dimension `start_x`. With `store` it is what the store holds, read
    from disk when values are asked for.

    **Raises:** `ValueError`, before anything is compiled, that names the argument which is wrong, or memory and time
    where the run is impossible; `Interrupted`, which has the finished cases, after Ctrl-C.
    """
    call = call_of("sweep", locals())
    cases, start = Grid(scene, grid, product=product), first_of(start)
    options = RunOptions(transient, periods, steps_per_period, saves_per_period, solver)
    plan = make_plan(cases, start, options, resolved_record(record, loads))

    def work(part: Part) -> CaseResults:
        states = initial_states(part.scenes, part.starts)
        run = run_chunk(plan, part.scenes, states, part.steps, part.on_progress)
        return CaseResults(run.status, run.record)

    run = run_cases(plan, work, cost=plan.cost, chunk=chunk, workers=workers, progress=progress)
    return run.checked(lambda: sweep_dataset(plan, run.results, plan.steps, call))


class CaseResults(NamedTuple):
    """Results of cases, with a leading axis of cases."""

    status: Int[np.ndarray, " cases"]
    """`slipperjax.Status` codes."""
    record: tuple[Any, ...]
    """Arrays of the plan's records."""


def sweep_dataset(
    plan: Plan,
    results: CaseResults,
    steps: Int[np.ndarray, " cases"],
    call: Mapping[str, Any],
    first: Mapping[str, list] | None = None,
) -> xr.Dataset:
    """Labels the results of a run.

    **Arguments:** `steps`: per forcing period of each case; `call`: of `call_of`; `first`: dimensions before those of
    the grid, with their coordinates.
    """
    cases, first = plan.cases, {} if first is None else first
    dims = (*first, *cases.dims)
    shape = (*(len(values) for values in first.values()), *cases.shape)
    record = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), results.record)
    data, coords = plan.records.label(cases.scene, dims, record)
    data |= case_variables(dims, results.status.reshape(shape), steps.reshape(shape))
    if "time" in [dim for dim, *_ in coords.values()]:  # of histories
        seconds = cases.forcing_periods().reshape(*cases.shape, 1) * coords["period"][1]
        coords["seconds"] = ((*cases.dims, "time"), seconds, {"units": "s", "long_name": "time"})
    attrs = case_attributes(plan, call) | {"record": plan.records.name}
    return xr.Dataset(data, {**coords, **first, **cases.coordinates()}, attrs)


def case_attributes(plan: Plan, call: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes that every dataset of cases has: the scene's parameters, and all that is needed to run it again."""
    cases, whole_call = plan.cases, {**call, "solver": plan.solver}
    attrs = scene_attributes(cases.scene, without=cases.axes)
    attrs |= run_attributes(cases.scene, cases.start, whole_call, map(cases.label, cases.axes))
    return attrs | {
        "transient": plan.transient.periods,
        "periods": plan.recorded.periods,
        "solver": solver_name(plan.solver),
    }


def case_variables(dims: tuple[str, ...], status: np.ndarray, steps: np.ndarray) -> dict[str, Any]:
    """Variables that every dataset of cases has: how each went, and how many steps it took."""
    return {
        "status": (dims, status, {"long_name": "status", "meaning": MEANINGS}),
        "steps_per_period": (dims, steps, {"units": "1", "long_name": "integration steps per forcing period"}),
    }


Column = tuple[np.ndarray, tuple[str, ...], str, str]
"""Values of cases, dimensions besides those of the grid, unit, description."""


def case_dataset(
    plan: Plan,
    status: Int[np.ndarray, " cases"],
    columns: Mapping[str, Column],
    attrs: Mapping[str, Any],
    coords: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Labels numbers of cases: columns by name, with their statuses and steps.

    **Arguments:** `attrs`: of `case_attributes`, and more; `coords`: besides those of the grid.
    """
    cases = plan.cases
    over = lambda values: values.reshape(cases.shape + values.shape[1:])
    ds = xr.Dataset(coords={**cases.coordinates(), **(coords or {})}, attrs=attrs)
    for name, (values, dims, unit, words) in columns.items():
        label = {"units": unit, "long_name": words} if unit else {"long_name": words}
        ds[name] = ((*cases.dims, *dims), over(values), label)
    return ds.assign(case_variables(cases.dims, over(status), over(plan.steps)))
