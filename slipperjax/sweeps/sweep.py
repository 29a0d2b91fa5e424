"""Grids of parameters as one batch to xarray: each case from the same start."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Int

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.period_map import initial_states
from ..flow.record import AbstractOutput, RecordSet
from ..flow.simulate import Trajectory, first_of
from ..flow.status import MEANINGS, Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene, check_scene
from ..orbits.exponents import check_count
from ..orbits.periodic import TOLERANCE
from ..solvers.latching import solver_name
from ..tools.checks import whole, yes_or_no
from ..tools.columns import column
from .call import Call
from .estimate import Estimate
from .exponents import LyapunovExponents
from .grid import Grid
from .orbits import NearestOrbit
from .plan import PERIODS_PER_CALL, AbstractStage, Part, Plan, make_plan, sampled_plan
from .records import resolved_record
from .run import ChunkRun, run_cases, run_chunk
from .store import Store, run_or_store


def sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    product: bool = True,
    record: str | AbstractOutput | Sequence[str | AbstractOutput] = "sections",
    transient: int = 200,
    periods: int = 10,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    refine: int = 1,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    begin: float | None = None,
    probe: bool | None = None,
    loads: bool | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    store: Store | str | Path | None = None,
    executor: object = None,
) -> xr.Dataset:
    """Simulate a scene for every combination of parameter values, as one batch.

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
        others of `slipperjax.flow.RECORDS`; "exponent" (the largest, uncertified, by a tangent afterwards),
        "exponents" and "orbits", see `lyapunov_sweep` and `orbit_sweep`; and
        `slipperjax.flow.Record` of any function of a period's course.
    - `transient`: forcing periods to pass before; above ten rounded up to tens, see the attribute `settled`. For
        "exponents" and "orbits" alone the same: they are measured over `periods` after it.
    - `steps_per_period`: one number for all cases, or an array of the grid's shape with one for each; default what
        `default_steps_per_period` gives for each, times `refine`. Cases with the same number run together.
    - `probe`: whether the error of the first recorded period is measured in every case, by half the step:
        `probe_error`, in multiples of `slipperjax.model.accuracy_scales` [1]; above a tenth the status says so.
        Default where that takes less than a tenth of the time and compiles nothing more.
    - `solver`, `start`, `begin`, `saves_per_period`: as for `simulate`.
    - `loads`: whether peak forces, impulses, times in contact and penetrations of the recorded periods come with
        the others, default with sections and histories. With any load come the statuses that follow from loads: no
        contact, pressed in, and too few steps where damping is too fast for them.
    - `chunk`: cases per call, rounded up to 16, 24, 32, 40, 48, 56, 64, 80, ..., or 8 where there are no more;
        `workers`: threads, default one per core, and never more than one where `solver` is one of diffrax's implicit
        ones, see `solvers.calls_lapack`. Neither changes any result.
    - `progress`: whether to show how far it is and how long it will take: True for a bar, or a line now and then in
        files and pipes; by default a bar on terminals and in notebooks, which goes when the run has ended.
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
    call = Call(
        transient,
        periods,
        saves_per_period,
        begin,
        loads,
        probe,
        record=record,
        steps_per_period=steps_per_period,
        refine=refine,
        solver=solver,
        product=product,
    )
    return run_or_store(
        _computed,
        _estimated,
        call,
        scene,
        grid,
        first_of(start),
        store=store,
        executor=executor,
        chunk=chunk,
        workers=workers,
        progress=progress,
    )


def _computed(
    call: Call, scene: Scene, grid: Mapping[str, object], start: Motion | State, **how: object
) -> xr.Dataset:
    """Return the results of a sweep. Arguments as for `run_cases`."""
    cases = Grid(scene, grid, product=call.product)
    lengths, *outputs = _spans(call)
    plan = make_plan(cases, start, lengths, *outputs)
    if call.probe is None:
        # it takes as long as three periods without a record, and a record inside doubles a period's time
        lasts = plan.transient.periods + (2 if plan.records.inside else 1) * plan.recorded.periods
        probed = plan.transient.periods > 0 and lasts >= 30
    else:
        probed = yes_or_no("probe", call.probe)
    plan = replace(plan, probed=probed)

    def work(part: Part) -> ChunkRun:
        states = initial_states(part.scenes, part.starts, plan.epoch)
        # most chunks share their programs
        return run_chunk(part, states, first=bool(part.row[0] == 0))

    run = run_cases(plan, work, periods=plan.periods, **how)
    if run.results is not None:
        values = list(run.results.record)
        status = run.results.status
        interrupted = run.interrupted
        for k, stage in enumerate(plan.stages, len(plan.records.records)):
            values[k], status, interrupted = stage.of_all(values[k], status, plan, how, interrupted)
        results = run.results._replace(status=status, record=tuple(values))
        run = run._replace(results=results, finished=status != Status.NOT_RUN, interrupted=interrupted)
    return run.checked(lambda: sweep_dataset(plan, run.results, plan.steps, call))


def _estimated(call: Call, grid: Grid, start: Motion | State) -> Estimate:
    """Return the estimate of a sweep, before anything is compiled."""
    return sampled_plan(grid, start, *_spans(call)).estimate(grid.count)


def _spans(call: Call) -> tuple[Call, RecordSet, tuple[AbstractStage, ...]]:
    """Return a call with the lengths of its transient and its recorded span, its records and its stages.

    Exponents and orbits begin where a motion has settled: alone, they record the end of the settling.
    """
    records, stages = resolved_record(call.record, call.loads)
    if not _begin_settled(records, stages):
        return call, records, stages
    settled = whole("transient", call.settled, max(one.least_settled for one in stages))
    rounded = -(-settled // PERIODS_PER_CALL) * PERIODS_PER_CALL
    return replace(call, settled=0, measured=rounded), records, tuple(one.over(call.measured) for one in stages)


def _begin_settled(records: RecordSet, stages: tuple[AbstractStage, ...]) -> bool:
    """Return whether all that is measured begins after the recorded span."""
    alone = not any(one.variables for one in records.records)
    return alone and all(isinstance(one, LyapunovExponents | NearestOrbit) for one in stages)


def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    count: int = 1,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    orbits: bool = True,
    **options: object,
) -> xr.Dataset:
    """Measure Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    Where a case has reached a stable periodic orbit after the transient, its exponents are those of the orbit's
    Floquet multipliers, exact to about 1e-8, which costs about a seventh of a measurement.

    **Arguments:** `count`, `periods`: as for `lyapunov_spectrum`; `certify`: whether each case is checked, which
    costs about as much again, and five times as much for chaotic cases; `orbits`: whether exponents are taken from
    orbits, so that without it all are measured; `transient`: `BLOCK` periods at least, rounded up to tens; others as
    for `sweep`, whose record "exponents" this is. Periods are rounded up to whole blocks of `BLOCK`, after each of
    which the status is looked at.

    **Returns:** an `xarray.Dataset` over the grid with

    - `exponent` and `stderr` [1/period], with dimension `count`; `weighted_exponent`: the same by a smoothly weighted
      mean, sharper for regular motions (see `slipperjax.analysis.weighted_mean`); `by_orbit`: whether they are those
      of an orbit, with standard errors of zero; `kaplan_yorke` where count > 1; `kind` and `period` [forcing
      periods]: of the orbit, or what the motion is by recurrence in the last `LAST` counted periods, see
      `slipperjax.analysis.classify`; `regime`: see `slipperjax.analysis.regime`; `status` and `steps_per_period`: as
      `sweep` gives them;
    - with `certify`: `half_step`, the largest exponent with steps half as long, and its standard error
      `half_step_stderr`; `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all
      that applies agrees; `escapes`, how many of `MOTIONS` motions of a chaotic case became regular within `HOLD`
      periods more, `chaotic_for`, the forcing periods for which none did, and `least_mean_life`, the bound that this
      puts with 95 % confidence on the mean life of chaos that might end [forcing periods].

    A case is `resolved` where its status is 0, the exponent with steps half as long lies within three standard errors
    of the difference or 1e-3, the exponents of both halves of the record within three of theirs or 1e-2, and the
    weighted exponent of a periodic motion is that of its multiplier within 1e-3. A case on an orbit is resolved where
    the exponent of the orbit with steps half as long, which must be found and stable, too, differs by 1e-2 at most.

    A case takes the exponents of an orbit only where that is certain, see `slipperjax.sweeps.reached`: all others,
    with unstable, distant or missing orbits, forcings that do not recur, or anything wrong, are measured.

    The exponents of a certified chaotic case, and their standard errors, are those of its `MOTIONS` longer motions,
    see `slipperjax.analysis.pooled_standard_error`. Where some became regular, it is "transient chaos", with the
    exponents of the chaotic stretch.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C. Chaotic cases whose
    longer motions were not finished then have the exponents that were measured, and `Status.NOT_RUN`.
    """
    record = LyapunovExponents(check_count(check_scene(scene), count), None, certify, orbits)
    return sweep(scene, grid, record=record, transient=transient, periods=periods, **options)


def orbit_sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    period: int = 1,
    transient: int = 60,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
    **options: object,
) -> xr.Dataset:
    """Find a periodic orbit for every case of a grid, with its Floquet multipliers, after a transient.

    **Arguments:** `period`: forcing periods after which the orbits recur; `transient`: forcing periods simulated
    before, rounded up to tens; `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's
    method for each case; others as for `sweep`, whose record "orbits" this is.

    **Returns:** an `xarray.Dataset` over the grid with `orbit`, the state at the start of a period in the order
    of `slipperjax.model.COORDINATES`, and `orbit_state`, all its numbers; `multiplier_real` and `multiplier_imag` [1]
    over `period` forcing periods; `orbit_exponent` [1/period], ln |largest multiplier| per forcing period; `stable`;
    `residual` [1], `iterations`; `status`, which is `Status.NO_ORBIT` where the iterations ended elsewhere.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C.
    """
    record = NearestOrbit(period, tolerance, max_iterations)
    return sweep(scene, grid, record=record, transient=transient, periods=period, **options)


def sweep_dataset(
    plan: Plan,
    results: ChunkRun,
    steps: Int[np.ndarray, " cases"],
    call: Call,
    first: Mapping[str, list] | None = None,
    **more: object,
) -> xr.Dataset:
    """Return the results of a run as a dataset.

    **Arguments:** `steps`: per forcing period of each case; `first`: dimensions before those of the grid, with their
    coordinates; `more`: further facts of the call.
    """
    cases = plan.cases
    first = first or {}
    dims = (*first, *cases.dims)
    shape = (*(len(values) for values in first.values()), *cases.shape)
    record = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), results.record)
    data, coords = plan.label(dims, record)
    data["status"] = column(dims, results.status.reshape(shape), "", "status", meaning=MEANINGS)
    if results.probe is not None:
        text = "what half the step changes in a forcing period, in scales"
        data["probe_error"] = column(dims, results.probe.reshape(shape), "1", text)
    data["steps_per_period"] = column(
        dims,
        steps.reshape(shape),
        "1",
        "integration steps per forcing period",
    )
    if "time" in [dim for dim, *_ in coords.values()]:  # of histories
        seconds = cases.forcing_periods().reshape(*cases.shape, 1) * coords["period"][1]
        coords["seconds"] = column((*cases.dims, "time"), seconds, "s", "time")
    # the scene's parameters, and all that is needed to run it again
    attrs = scene_attributes(cases.scene, without=cases.axes)
    kept = {**call.kept(plan.solver), **more}
    attrs |= run_attributes(cases.scene, cases.start, kept, map(cases.label, cases.axes))
    attrs |= {"settled": plan.transient.periods, "measured": plan.recorded.periods}
    if _begin_settled(plan.records, plan.stages):
        measured = max(one.measured for one in plan.stages)
        attrs |= {"settled": plan.recorded.periods, "measured": measured}
    attrs |= {"solver": solver_name(plan.solver), "record": plan.record}
    return xr.Dataset(data, {**coords, **first, **cases.coordinates()}, attrs)
