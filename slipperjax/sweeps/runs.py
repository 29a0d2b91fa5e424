"""Runs as they happen: one or many over a length of rail, at a speed that may change, with records of each window."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Int

from ..flow.datasets import run_attributes, scene_attributes
from ..flow.period_map import advance, initial_states
from ..flow.record import AbstractRecord, RecordedSpan, RecordSet
from ..flow.records import AbstractNumber, ContactChecks, judged_by_contacts
from ..flow.simulate import Trajectory, beginning, warn_beyond
from ..flow.status import MEANINGS, first_problem, most_stability_number, with_accuracy
from ..flow.stepping import ConstantSteps, capacity_for
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import StateLayout
from ..model.scene import Scene, at_speed
from ..model.step_size import given_steps, rounded_steps, steps_needed
from ..model.travel import SpeedProgramme
from ..solvers.latching import solver_name
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.checks import number, positive, require, whole
from ..tools.compile import as_argument, jit
from .call import refined
from .estimate import Estimate
from .grid import Cases, Grid, filled, with_tracks
from .records import OF_LOADS
from .run import (
    Calls,
    ChunkInputs,
    Plan,
    half_step_change,
    initial_carry,
    run_cases,
    shared_capacity,
)
from .store import Store, run_or_store
from .windows import (
    DEFAULT,
    FRICTION_WORK,
    PEAKS,
    PER_STRETCH,
    SPRING_FORCE,
    STRETCH,
    WINDOW_RECORDS,
    PerWindow,
    ThirdOctaves,
    Wearing,
    WindowedTrack,
    run_record,
    stretch_ends,
)

LEAST_STEPS_PER_WINDOW = 4
"""Fewest integration steps in a window, from which its curves are made."""
PERCENTILES = (50.0, 90.0, 99.0)
"""Percentiles of the windows' highest forces that are kept of each stretch [%]."""


@dataclass(frozen=True)
class RunCall:
    """What `run` was asked besides its scene, cases and start."""

    length: float
    begin: float
    window: float
    record: str | AbstractNumber | Sequence[str | AbstractNumber] | None
    steps_per_period: int | None
    refine: int
    solver: diffrax.AbstractSolver | str | None
    probe: int
    product: bool
    only: bool
    """Whether it is one run, without a grid."""
    worn: np.ndarray | None
    """Play that earlier work has opened at each face [m]; None where slippers do not wear."""
    function: str = "run"


def run(
    scene: Scene,
    grid: Mapping[str, Any] | None = None,
    *,
    length: float,
    speed: SpeedProgramme | float | None = None,
    begin: float | None = None,
    window: float = 1.0,
    record: str | AbstractNumber | Sequence[str | AbstractNumber] | None = None,
    start: Motion | State | Trajectory | xr.Dataset | None = None,
    steps_per_period: int | None = None,
    refine: int = 1,
    solver: diffrax.AbstractSolver | str | None = None,
    probe: int = 0,
    product: bool = True,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    store: Store | str | Path | None = None,
    executor: Any = None,
) -> xr.Dataset:
    """Simulates runs over a length of rail, at a speed that may change along it.

    ```python
    fast = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0), sj.Stage(-100.0, speed=100.0)], start=50.0)
    ds = sj.run(scene, length=5000.0, speed=fast)
    ds["peak_force"].max(("end", "point")).plot()
    ```

    **Arguments:**

    - `grid`: values by parameter name as for `sweep`, such as `{"track.seed": range(200)}`, "speed.scale" of a
        programme, or none for one run.
    - `length`: how far to travel [m], rounded up to whole windows; `begin`: the place from which on [m], by default
        where the rail begins.
    - `speed`: a programme, or a constant speed [m/s]; default that of the scene.
    - `window`: length over which records are joined [m].
    - `record`: names or records of numbers, which are kept of each window: those of `slipperjax.flow.RECORDS` and
        `slipperjax.sweeps.windows.WINDOW_RECORDS`. Default what tests of tracks report, see below.
    - `start`: as for `simulate`, at the place where the run begins; or, without a store, an earlier run, from whose
        state at `begin` this one goes on, by default at its end.
    - `steps_per_period`: integration steps per wavelength of the track, or reference length, the same all the way;
        by default those that the least speed of each `STRETCH` windows needs, times `refine`.
    - `probe`: at the start of how many stretches the error is measured by half the step, over a wavelength of the
        track or its reference length: `probe_error`, in multiples of `slipperjax.model.accuracy_scales` [1]; above
        a tenth the status says so.
    - `solver`, `product`, `chunk`, `workers`, `progress`, `store`, `executor`: as for `sweep`.

    **Returns:** an `xarray.Dataset` over the grid and `distance`, the travel at the end of each window [m], with
    `speed` [m/s] in its middle and `seconds` at its end as coordinates. By default `peak_force` [N] of each point,
    `peak_distance` where it was [m], `contact_fraction`, `impacts`, the number of touchdowns, `impulse` [N s],
    `drive_force` [N], and `peak_a_y` and the others, the greatest accelerations; with friction `friction_work` [J],
    and with a sled `spring_force` [N]. Over `stretch`, the travel at the end of each `STRETCH` windows: `rms_a_y` and
    others, `band_a_y` and `band_a_z`, root mean squares in third octaves [m/s^2], `impact_rate` [1/s],
    `peak_force_percentile` of the windows' highest forces, `state`, from which a run goes on, and with wear `play`
    [m]. `status` of each run is 0 where nothing is wrong.

    **Raises:** `ValueError`, before anything is compiled, that names the argument which is wrong; `Interrupted`,
    which has the finished runs, after Ctrl-C.
    """
    scene = at_speed(scene, speed)
    origin, first = beginning(scene, begin, start)
    call = RunCall(
        number(positive, "length", length, "m"),
        origin,
        number(positive, "window", window, "m"),
        record,
        steps_per_period,
        refined(refine, steps_per_period),
        solver,
        whole("probe", probe, 0),
        product,
        grid is None,
        _worn(scene, start, origin),
    )
    how: dict[str, Any] = dict(chunk=chunk, workers=workers, progress=progress)
    if grid is None:
        require(store is None, "store", "come with a grid", store)
        return _computed(call, scene, {"length": [float(scene.slipper.length)]}, first, **how)
    return run_or_store(_computed, _estimated, call, scene, grid, first, store=store, executor=executor, **how)


def _planned(call: RunCall, cases: Cases) -> tuple[Plan, np.ndarray]:
    """Return the plan of some runs, and the integration steps in a window of each case and stretch."""
    scene = cases.scene
    windows = _windows(scene, call.length, call.begin, call.window)
    records = RecordSet((*_records(scene, call.record), ThirdOctaves()))
    profiles = _step_profiles(cases, call, windows)
    steps, _ = _keys(profiles, windows)
    records.check(scene, windows, LEAST_STEPS_PER_WINDOW, (*cases.dims, "status", "state"))
    return Plan(cases, resolve_solver(scene, call.solver), records, steps, Calls(1, 0), Calls(windows, 1)), profiles


def _estimated(call: RunCall, grid: Grid, start: Motion | State) -> Estimate:
    """Return the estimate of runs, before anything is compiled."""
    return _estimate(_planned(call, grid.sample(start))[0], grid.count)


def _estimate(plan: Plan, count: int) -> Estimate:
    """Return the estimate of `count` runs such as these."""
    windows = plan.recorded.periods
    values = plan.records.values(plan.cases.scene, 0, windows)
    return Estimate.counted(count, float(np.mean(plan.steps)), values, f" of {windows} windows")


def _computed(call: RunCall, scene: Scene, grid: Mapping[str, Any], start: Motion | State, **how: Any) -> xr.Dataset:
    """Return the results of runs. Arguments as for `run_cases`."""
    plan, profiles = _planned(call, Cases(scene, grid, start, product=call.product))
    _estimate(plan, plan.cases.count).check()
    windows, window = plan.recorded.periods, call.window
    _, profile_of = _keys(profiles, windows)
    epoch = call.begin / window
    stretches = profiles.shape[1]
    probed = np.unique(np.linspace(0, stretches - 1, min(call.probe, stretches)).astype(int))
    around = max(1, round(float(np.max(np.asarray(scene.track.wavelength))) / window))

    def work(part: ChunkInputs) -> _Results:
        scenes = _windowed(part.scenes, window)
        scenes = scenes if call.worn is None else _opened(scenes, call.worn[None])
        states = initial_states(scenes, part.starts, epoch)
        probes = _Probes(probed.tolist(), around)
        return _run_windows(plan, scenes, states, profile_of[part.steps], epoch, part, probes)

    done = run_cases(plan, work, periods=1.0, **how)
    frame = _Frame(call.begin, window, windows, call.only, call.begin + probed * STRETCH * window)
    return done.checked(lambda: _dataset(plan, done.results, profiles, frame, call))


class _Probes(NamedTuple):
    """Where errors are measured by half the step."""

    stretches: list[int]
    windows: int  # over which errors grow


class _Results(NamedTuple):
    """A chunk of cases after its run."""

    state: State  # at the end, with a leading axis of lanes
    status: Int[np.ndarray, " lanes"]
    record: tuple[Any, ...]  # arrays of the plan's records, (cases, windows or stretches, ...)
    marks: np.ndarray  # states at the end of each stretch, (cases, stretches, numbers)
    play: np.ndarray | None  # of the faces at the end of each stretch, (cases, stretches, faces) [m]; None unworn
    probe: np.ndarray  # errors, (cases, probes)


class _Frame(NamedTuple):
    """Where a run is."""

    begin: float  # [m]
    window: float  # [m]
    windows: int
    only: bool  # whether it is one run, without a grid
    probes: np.ndarray  # where errors are measured [m]

    @property
    def ends(self) -> np.ndarray:
        """Travel at the end of each window [m]."""
        return self.begin + self.window * np.arange(1, self.windows + 1)

    @property
    def stretches(self) -> np.ndarray:
        """Travel at the end of each stretch [m]."""
        return self.ends[stretch_ends(self.windows)]


def _windows(scene: Scene, length: float, begin: float, window: float) -> int:
    """Returns how many windows a run has.

    **Raises:** `ValueError` where the rail ends before. A warning says where one is known no further.
    """
    windows = int(np.ceil(length / window * (1 - 1e-12)))
    travelled = begin + windows * window
    far = scene.track.end + 1e-9 * abs(scene.track.end)
    require(travelled <= far, "length", f"end before the rail does at {scene.track.end:g} m", travelled)
    warn_beyond(scene.track, "length", travelled)
    return windows


def _records(scene: Scene, record: Any) -> list[AbstractRecord]:
    """Returns the records of a user's choice, of each window and of each stretch."""
    chosen = [*DEFAULT, *PEAKS] if record is None else record
    chosen = [chosen] if isinstance(chosen, str) or not isinstance(chosen, Sequence) else chosen
    records = []
    for one in chosen:
        known = one if isinstance(one, AbstractNumber) else run_record(one)
        need = f"be one of {', '.join(WINDOW_RECORDS)}, peak_force, rms_a_z, and others of slipperjax.flow.RECORDS"
        require(known is not None, "record", f"{need}, or a record of numbers", one)
        records.append(PerWindow(known))  # type: ignore[arg-type]
    if record is None and scene.friction is not None:
        records.append(PerWindow(FRICTION_WORK))
    if record is None and scene.sled is not None:
        records.append(PerWindow(SPRING_FORCE))
    names = {one.name for one in records}
    stretches = [run_record(name) for name in PER_STRETCH if name not in names]
    return [*records, *(one for one in stretches if one is not None)]


def _step_profiles(cases: Cases, call: RunCall, windows: int) -> Int[np.ndarray, "cases stretches"]:
    """Return the integration steps in a window of each case and stretch."""
    stretches = -(-windows // STRETCH)
    window = call.window
    if call.steps_per_period is None:
        batch = cases.unprepared(filled(np.arange(cases.count), cases.count))
        edges = call.begin + window * STRETCH * np.arange(stretches)
        # the least speed of a stretch is looked for at nine places
        places = edges[:, None] + window * STRETCH * np.linspace(0, 1, 9)[None]
        needed = np.asarray(_steps_along(*batch, jnp.asarray(places)))[: cases.count]
        steps = call.refine * rounded_steps(needed)
    else:
        steps = np.full((cases.count, stretches), given_steps(call.steps_per_period))
    per_window = np.ceil(steps * (window / cases.wavelengths()[:, None]) * (1 - 1e-12)).astype(int)
    return np.maximum(np.broadcast_to(per_window, (cases.count, stretches)), LEAST_STEPS_PER_WINDOW)


@jit
def _steps_along(scenes: Batched[Scene], starts: Any, places: jax.Array) -> jax.Array:
    """Steps per reference length of each stretch, at its least speed, (cases, stretches)."""

    def one(scene: Scene, start: Any) -> jax.Array:
        if not isinstance(scene.speed, SpeedProgramme):
            return jnp.broadcast_to(steps_needed(scene), places.shape[:1])
        least = jnp.min(scene.speed.at(places), axis=1)
        return jax.vmap(lambda v: steps_needed(eqx.tree_at(lambda s: s.speed, scene, v)))(least)

    return scenes.map(one, starts)


def _keys(profiles: np.ndarray, windows: int) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Returns a number for each case that tells its profile of steps, about those of its run, and the profiles."""
    lengths = np.full(profiles.shape[1], STRETCH)
    lengths[-1] = windows - STRETCH * (profiles.shape[1] - 1)
    different, which = np.unique(profiles, axis=0, return_inverse=True)
    keys: list[int] = []
    for profile in different:
        key = int(profile @ lengths)
        while key in keys:
            key += 1
        keys.append(key)
    return np.array(keys)[np.ravel(which)], dict(zip(keys, different, strict=True))


@jit
def _windowed(scenes: Batched[Scene], window: Any) -> Batched[Scene]:
    """The same scenes with windows as their unit of travel."""
    return with_tracks(scenes, lambda track: WindowedTrack(track, window))


def _worn(scene: Scene, earlier: Any, begin: float) -> np.ndarray | None:
    """Returns the play that work before `begin` [m] has opened at each face [m]; None where slippers do not wear."""
    if scene.wear is None:
        return None
    works = scene.friction is not None or not scene.wear.by_friction
    require(works, "scene", "have friction, by whose work slippers wear", shown="none")
    nothing, section = np.zeros(len(scene.section.faces)), scene.section
    if not (isinstance(earlier, xr.Dataset) and "play" in earlier):
        return nothing
    by_distance = scene.wear.added(section, scene.slipper.length, begin, jnp.asarray(nothing))
    return earlier["play"].sel(stretch=begin).values - np.asarray(section.play) - np.asarray(by_distance)


@jit
def _opened(scenes: Batched[Scene], play: Any) -> Batched[Scene]:
    """The same scenes with this play more at each face, (1 or cases, faces) [m]."""
    plays = scenes.map(lambda scene: scene.section.play) + play
    at, is_none = lambda scene: scene.section.play, lambda leaf: leaf is None
    opened = eqx.tree_at(at, scenes.varied, plays, is_leaf=is_none)
    return Batched(opened, eqx.tree_at(at, scenes.shared, None, is_leaf=is_none))


def _run_windows(
    plan: Plan,
    scenes: Batched[Scene],
    states: State,
    profile: np.ndarray,
    epoch: float,
    part: ChunkInputs,
    probes: _Probes,
) -> _Results:
    """Runs a chunk of cases stretch by stretch."""
    status, wears = np.zeros(len(states.motion.y), int), plan.cases.scene.wear is not None
    records, windows = plan.records, plan.recorded.periods
    # statuses that follow from loads come with any load
    judged = any(isinstance(r, PerWindow) and r.record in OF_LOADS for r in records.records)
    whole_run = [*([Wearing()] if wears else []), *([ContactChecks()] if judged else [])]
    looked_at, count, cases = RecordSet((*records.records, *whole_run)), len(records.records), part.cases
    empty = initial_carry(looked_at, scenes, states)
    carry, most = empty, int(profile.max())
    # filled stretch by stretch, so that nothing but the result grows with the distance
    arrays: list[np.ndarray] = []
    marks, plays, errors = [], [], []
    total = float(profile.sum())
    for k, steps in enumerate(profile.tolist()):
        part.on_progress(0.0)
        used = min(STRETCH, windows - k * STRETCH)
        alike = bool(np.all(profile == steps))
        varied = ConstantSteps(shared_capacity(most, steps), as_argument(steps))
        stepping = ConstantSteps(steps) if alike else varied
        if k in probes.stretches:
            now = _opened(scenes, carry[count].play) if wears else scenes
            over = dict(used=as_argument(probes.windows), periods=capacity_for(probes.windows))
            errors.append(half_step_change(now, states, epoch + k * STRETCH, steps, solver=plan.solver, **over))
        options: dict[str, Any] = dict(solver=plan.solver, periods=STRETCH, records=looked_at, earlier=carry)
        passed = advance(scenes, states, epoch + k * STRETCH, stepping, used=as_argument(used), **options)
        # records of a stretch begin anew with the next one, and those of the whole run go on
        states, carry = passed.state, (*empty[:count], *passed.carried[count:])
        status = first_problem(status, passed.status)
        kept = jax.tree.map(lambda a, n=used: np.asarray(a)[:cases, :n], passed.samples[:count])
        joined = jax.tree.map(lambda a: np.asarray(a)[:cases], passed.carried[:count])
        made = records.finish(joined, kept, RecordedSpan(used, steps, epoch + k * STRETCH, status))
        made = [a if isinstance(r, PerWindow) else a[:, None] for r, a in zip(records.records, made, strict=True)]
        starts = [k * STRETCH if isinstance(r, PerWindow) else k for r in records.records]
        if not arrays:
            rows = [windows if isinstance(r, PerWindow) else len(profile) for r in records.records]
            arrays = [np.empty((cases, n, *a.shape[2:])) for n, a in zip(rows, made, strict=True)]
        for array, first, values in zip(arrays, starts, made, strict=True):
            array[:, first : first + values.shape[1]] = values
        marks.append(StateLayout.pack(states)[:cases])
        if wears:
            plays.append(np.asarray(scenes.varied.section.play + carry[count].play)[:cases])
        part.on_progress(steps / total)
    if judged:
        limit = most_stability_number(plan.solver)
        status = np.asarray(judged_by_contacts(scenes, jnp.asarray(status), carry[-1], limit))
    probe = np.stack(errors, axis=1) if errors else np.empty((len(status), 0))
    if errors:
        status = with_accuracy(status, probe.max(axis=1))
    play = np.stack(plays, axis=1) if plays else None
    return _Results(states, status, tuple(arrays), np.stack(marks, axis=1), play, probe[:cases])


def _dataset(plan: Plan, results: _Results, profiles: np.ndarray, frame: _Frame, call: RunCall) -> xr.Dataset:
    """Labels the results of a run."""
    cases = plan.cases
    dims, shape = cases.dims, cases.shape
    of_grid = lambda a: np.asarray(a).reshape(*shape, *a.shape[1:])
    record, play = jax.tree.map(of_grid, (results.record, results.play))
    data, coords = {}, {}
    for one, values in zip(plan.records.records, record, strict=True):
        more, along = one.label(cases.scene, (*dims, "distance" if isinstance(one, PerWindow) else "stretch"), values)
        data, coords = data | more, coords | along
    words = {"units": "", "long_name": "all numbers of the state at the end of each stretch"}
    data["state"] = ((*dims, "stretch", "number"), of_grid(results.marks), words)
    coords["number"] = ("number", [q.name for q in StateLayout.of(cases.scene).numbers])
    if play is not None:
        words = {"units": "m", "long_name": "play of each face at the end of each stretch"}
        data["play"] = ((*dims, "stretch", "face"), play, words)
        coords["face"] = ("face", ["".join(face) for face in cases.scene.section.faces])
    data["status"] = (dims, results.status.reshape(shape), {"long_name": "status", "meaning": MEANINGS})
    words = {"units": "1", "long_name": "integration steps per window"}
    data["steps_per_window"] = ((*dims, "stretch"), profiles.reshape(*shape, -1), words)
    if len(frame.probes):
        words = {"units": "1", "long_name": "what half the step changes over a reference length, in scales"}
        data["probe_error"] = ((*dims, "probe"), of_grid(results.probe), words)
        coords["probe"] = ("probe", frame.probes, {"units": "m", "long_name": "distance travelled"})
    coords["distance"] = ("distance", frame.ends, {"units": "m", "long_name": "distance travelled"})
    coords["stretch"] = ("stretch", frame.stretches, {"units": "m", "long_name": "distance travelled"})
    batch = cases.unprepared(filled(np.arange(cases.count), cases.count))
    places = jnp.asarray(np.append(frame.begin, frame.ends))
    speed, seconds = (np.asarray(a)[: cases.count] for a in _times(*batch, places, frame.window))
    speed, seconds = speed[:, 1:], seconds[:, 1:] - seconds[:, :1]
    # by names and not by values, so that each part of a store has the same dimensions
    differ = any(name.partition(".")[0] == "speed" for name in cases.axes)
    along = (*dims, "distance") if differ else ("distance",)
    joined = lambda a: a.reshape(*shape, -1) if differ else a[0]
    coords["speed_along" if "speed" in cases.axes else "speed"] = (
        along,
        joined(speed),
        {"units": "m/s", "long_name": "travelling speed"},
    )
    coords["seconds"] = along, joined(seconds), {"units": "s", "long_name": "time"}
    attrs = scene_attributes(cases.scene, without=() if frame.only else cases.axes)
    whole_call = vars(replace(call, solver=plan.solver))
    varied = () if frame.only else map(cases.label, cases.axes)
    attrs |= run_attributes(cases.scene, cases.start, whole_call, varied)
    attrs |= {"solver": solver_name(plan.solver), "record": plan.records.name, "window [m]": frame.window}
    ds = xr.Dataset(data, {**coords, **cases.coordinates()}, attrs)
    ds = _with_rates(ds, frame)
    return ds.isel({dims[0]: 0}, drop=True) if frame.only else ds


@jit
def _times(scenes: Batched[Scene], starts: Any, ends: jax.Array, window: Any) -> tuple[jax.Array, jax.Array]:
    """Speeds in the middle of windows [m/s] and times at their ends [s], (cases, windows)."""

    def one(scene: Scene, start: Any) -> tuple[jax.Array, jax.Array]:
        length = scene.track.wavelength
        speed = jnp.asarray(scene.travel((ends - 0.5 * window) / length).speed)
        return jnp.broadcast_to(speed, ends.shape), jnp.asarray(scene.seconds(ends / length))

    return scenes.map(one, starts)


def _with_rates(ds: xr.Dataset, frame: _Frame) -> xr.Dataset:
    """Adds what follows from windows, stretch by stretch: rates of impacts, and percentiles of the highest forces."""
    starts = np.arange(0, frame.windows, STRETCH)
    added: dict[str, Any] = {}
    if "impacts" in ds:
        counts = ds["impacts"]
        axis = counts.dims.index("distance")
        total = np.add.reduceat(counts.values, starts, axis=axis)
        ends = ds["seconds"].values[..., np.append(starts[1:] - 1, frame.windows - 1)]
        seconds = np.diff(ends, axis=-1, prepend=0.0)
        seconds = seconds.reshape(*seconds.shape, *[1] * (counts.ndim - axis - 1))
        dims = tuple("stretch" if dim == "distance" else dim for dim in counts.dims)
        added["impact_rate"] = (dims, total / seconds, {"units": "1/s", "long_name": "rate of touchdowns"})
    if "peak_force" in ds:
        highest = ds["peak_force"].max(("end", "point"), skipna=False)
        axis = highest.dims.index("distance")
        rows = [np.percentile(part, PERCENTILES, axis=axis) for part in np.split(highest.values, starts[1:], axis)]
        values = np.moveaxis(np.stack(rows, axis=-1), 0, -1)
        words = ds["peak_force"].attrs | {"long_name": "percentile of the windows' highest forces"}
        added["peak_force_percentile"] = ((*highest.dims[:axis], "stretch", "percentile"), values, words)
        ds = ds.assign_coords(percentile=("percentile", list(PERCENTILES), {"units": "%"}))
    return ds.assign(added)
