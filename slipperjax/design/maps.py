"""Objectives of every case of a grid, by simulation alone: brute force, against which designs are checked."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..analysis.attractor import classify
from ..flow.course import Course, Courses
from ..flow.period_map import initial_states
from ..flow.simulate import Trajectory, first_of
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import COORDINATE_SCALES
from ..model.scene import Scene
from ..solvers.named import resolve_solver
from ..sweeps.attractors import FLOOR
from ..sweeps.executors import in_order, records_in_order, run_chunk, run_chunks
from ..sweeps.grid import Cases
from ..sweeps.plan import Calls, Plan
from ..sweeps.stores.stored import storable
from ..sweeps.stores.target import Store
from ..sweeps.sweep import case_attributes, case_variables
from ..tools.checks import whole
from .gradients import totals
from .objectives import AbstractCourseObjective, objective_named

BLOCK = 32
"""Recorded forcing periods in one call."""


@storable
def objective_sweep(
    scene: Scene,
    objectives: Any,
    grid: Mapping[str, Any],
    *,
    product: bool = True,
    transient: int = 200,
    periods: int = 64,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
    store: Store | str | Path | None = None,
    executor: Any = None,
) -> xr.Dataset:
    """Objectives of every case of a grid over the last forcing periods of a run, as one batch.

    **Arguments:** `objectives`: one or several, by name or as objects; `periods`: forcing periods that count,
    rounded up to a multiple of `BLOCK`; `steps_per_period`: the same for all cases, default what each needs; others
    as for `sweep`.

    **Returns:** an `xarray.Dataset` over the grid with a variable for each objective, `kind` and `period` of the
    motion as `slipperjax.analysis.classify` names them from its last states, and `status`.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    several = objectives if isinstance(objectives, Sequence) and not isinstance(objectives, str) else [objectives]
    asked = tuple(map(_of_course, several))
    begin = first_of(start)
    cases = Cases(scene, grid, begin, product=product)
    if steps_per_period is None:
        steps = cases.default_steps()
    else:
        steps = np.full(cases.count, whole("steps_per_period", steps_per_period, 1))
    recorder = Courses((*(one.of_course for one in asked), _end))
    passed, count = whole("transient", transient, 0), -(-whole("periods", periods, 1) // BLOCK)
    pause = max(1, min(passed, 10))
    plan = Plan(
        resolve_solver(scene, solver), recorder, steps, Calls(pause, -(-passed // pause)), Calls(BLOCK, count)
    )
    chunks, workers = plan.chunks(chunk, workers)

    def work(chunk, on_progress):
        scenes, starts = cases.take(chunk.index)
        return run_chunk(plan, scenes, initial_states(scenes, starts), chunk.steps, on_progress)

    runs = run_chunks(chunks, workers, work, periods=plan.work, progress=progress, name="objectives")
    status = in_order(chunks, [run.status for run in runs.results])
    *kept, strobe = records_in_order(chunks, [run.record for run in runs.results])
    values = np.array(totals(asked, jax.tree.map(jnp.asarray, tuple(kept))))
    values[status != Status.FINITE] = np.nan
    strobe = np.where((status == Status.FINITE)[:, None, None], strobe, np.nan)
    found = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
    shaped = lambda a: np.reshape(a, cases.shape)
    call = dict(function="objective_sweep", product=product, transient=transient, periods=periods)
    ds = xr.Dataset(coords=cases.coordinates(), attrs=case_attributes(plan, cases, call))
    for k, one in enumerate(asked):
        ds[one.name] = (cases.dims, shaped(values[:, k]), one.quantity.attributes)
    ds["kind"] = (cases.dims, shaped(found.kind), {"long_name": "kind of motion"})
    ds["period"] = (cases.dims, shaped(found.period), {"units": "1", "long_name": "forcing periods to recur, or 0"})
    return runs.checked(ds.assign(case_variables(cases.dims, shaped(status), shaped(plan.steps))))


def _of_course(given: Any) -> AbstractCourseObjective:
    found = objective_named(given)
    if not isinstance(found, AbstractCourseObjective):
        raise ValueError(
            f"Argument `objectives` must be made of courses, but has {found.name}: see `lyapunov_sweep`."
        )
    return found


def _end(course: Course) -> jax.Array:
    """The coordinates at the end of a period."""
    steps = course.steps
    return course.coordinates.values[steps if isinstance(steps, int) else jnp.asarray(steps, int)]
