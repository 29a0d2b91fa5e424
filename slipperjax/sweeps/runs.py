"""Runs over a length of rail, one or many, at a speed that may change, with records of each window of distance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Int

from ..flow.numbers import ALIASES, RECORDS, AbstractNumber, ContactChecks
from ..flow.record import AbstractRecord, RecordSet
from ..flow.status import MEANINGS, Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import highest_of_points
from ..model.scene import Scene, at_speed
from ..model.step_size import given_steps, rounded_steps, rounded_up, steps_needed
from ..model.tracks import DEFAULT_WAVELENGTH
from ..model.travel import SpeedProgramme
from ..orbits.simulate import Trajectory, beginning, longer_rails, warn_beyond
from ..results.result import Result
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.checks import known, number, positive, require, whole
from ..tools.columns import column
from ..tools.compile import as_argument, jit
from ..tools.types import Numbers, Real
from .call import AbstractCall
from .engine import PartRun
from .grid import Cases
from .plan import AbstractStage, Plan
from .records import OF_LOADS
from .schedule import Schedule, joint_profiles
from .store import Store, run_or_store
from .windows import (
    PER_STRETCH,
    STRETCH,
    WINDOW_RECORDS,
    PerWindow,
    StateNumbers,
    ThirdOctaves,
    Wearing,
    default_records,
    play_added,
    run_record,
    stretch_ends,
    with_more_play,
)

LEAST_STEPS_PER_WINDOW = 4
"""Fewest integration steps in a window; the curves of a window are made from its steps."""
PERCENTILES = (50.0, 90.0, 99.0)
"""Percentiles of the windows' highest forces in each stretch [%]."""


def run(
    scene: Scene,
    grid: Mapping[str, object] | None = None,
    *,
    length: float,
    speed: SpeedProgramme | float | None = None,
    begin: float | None = None,
    window: float = 1.0,
    record: str | AbstractNumber | Sequence[str | AbstractNumber] | None = None,
    start: Motion | State | Trajectory | Result | xr.Dataset | str | None = None,
    steps_per_period: int | None = None,
    refine: int = 1,
    solver: diffrax.AbstractSolver | str | None = None,
    probe: int = 0,
    product: bool = True,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    store: Store | str | Path | None = None,
    executor: object = None,
) -> Result:
    """Simulate runs over a length of rail, at a speed that may change along it, and record each window of distance.

    ```python
    fast = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0), sj.Stage(-100.0, speed=100.0)], start=50.0)
    ds = sj.run(scene, length=5000.0, speed=fast)
    ds["peak_force"].max(("end", "point")).plot()
    ```

    **Arguments:**

    - `grid`: values by parameter name, as for `sweep`, such as `{"track.seed": range(200)}`; the scale of a speed
        programme is "speed.scale". None for one run.
    - `length`: distance to travel [m], rounded up to whole windows; `begin`: distance at which the run begins [m], by
        default the beginning of the rail.
    - `speed`: a programme, or a constant speed [m/s]; by default the speed of the scene.
    - `window`: length of rail for which a record gives one value [m].
    - `record`: records of numbers, or their names in `slipperjax.flow.RECORDS` and
        `slipperjax.sweeps.windows.WINDOW_RECORDS`, kept for each window. By default the values that reports of track
        tests show, see below.
    - `start`: as for `simulate`, at `begin`, but by default "rest" on the rail, see `AtRest`. Without a store, also
        an earlier run: the new run continues from the earlier run's state at `begin`, by default from its end.
    - `steps_per_period`: integration steps per wavelength of the track (per 8 m on a track without waves), constant
        along the run, but 4 or more in each window; by default the steps that the least speed of each window needs,
        times `refine`. Cases that need nearly the same number of steps share the larger number, in one batch.
    - `probe`: number of stretches at whose start half the step measures the error, over a wavelength of the track or
        8 m: `probe_error`, in multiples of `slipperjax.model.accuracy_scales` [1]; the status reports an error above
        a tenth.
    - `solver`, `product`, `chunk`, `workers`, `progress`, `store`, `executor`: as for `sweep`.

    **Returns:** a `Result` over the grid with `status`, which is 0 where nothing is wrong, and

    - over `distance`, the travel at the end of each window [m], by default:
      net loads of each slipper, the signed values of greatest magnitude: `peak_slipper_force` [N], its place
      `peak_slipper_distance` [m], `peak_slipper_moment` [N m], and with gravity or a load `static_ratio` [1];
      for each point `peak_force` [N], its place `peak_distance` [m], `contact_fraction` [1], the number of touchdowns
      `impacts`, and `impulse` [N s]; `drive_force` [N]; greatest accelerations, `peak_a_y` and others; with friction
      `friction_work` [J]; with a sled `spring_force` [N]. Coordinates are `speed` in the middle of the window [m/s]
      and `seconds` from the beginning to the end of the window [s]. For a programme that gives times,
      `window_status` is `Status.TOO_SLOW` where the sled is at rest or too slow;
    - over `stretch`, the travel at the end of each `STRETCH` windows [m]: root mean squares of accelerations,
      `rms_a_y` and others, and in third octaves `band_a_y` and `band_a_z` [m/s^2]; `impact_rate` [1/s]; percentiles
      of the windows' highest forces, `peak_slipper_force_percentile` and `peak_force_percentile` [N]; `state`, from
      which a run can continue; with wear `play` [m].

    **Raises:** `ValueError` that names the wrong argument, before anything is compiled; `Interrupted` after Ctrl-C,
    with the finished runs.
    """
    scene = at_speed(scene, speed)
    origin, first = beginning(scene, known("begin", begin), "rest" if start is None else start)
    call = RunCall(
        number(positive, "length", length, "m"),
        origin,
        number(positive, "window", window, "m"),
        whole("probe", probe, 0),
        grid is None,
        _worn(scene, start, origin),
        record=record,
        steps_per_period=steps_per_period,
        refine=refine,
        solver=solver,
        product=product,
        function="run",
    )
    how: dict[str, object] = dict(chunk=chunk, workers=workers, progress=progress)
    if grid is not None:
        return run_or_store(call, scene, grid, first, store=store, executor=executor, **how)
    for name, value in (("store", store), ("executor", executor)):
        require(value is None, name, "come with a grid", value)
    # a grid of one case, whose dimension the dataset drops
    return call.compute(scene, {"length": [float(scene.slipper.length)]}, first, **how)


@dataclass(frozen=True)
class RunCall(AbstractCall):
    """Arguments of `run` other than scene, grid and start."""

    length: float
    begin: float
    window: float
    probe: int
    only: bool
    """Whether there is only one run, without a grid."""
    worn: np.ndarray | None
    """Play that earlier wear has opened at each face [m]; None where slippers do not wear."""

    def plan(self, cases: Cases, *outputs: RecordSet | tuple[AbstractStage, ...]) -> Plan:
        scene = cases.scene
        windows = _windows(scene, self.length, self.begin, self.window)
        records = _records(scene, self.record)
        profiles, which = _step_profiles(cases, self, windows)
        # errors grow over a wavelength of the track
        length = max(1, round(_probed_length(scene) / self.window))
        stretches = len(stretch_ends(windows))
        probed = np.linspace(0, stretches - 1, min(self.probe, stretches)).astype(int)
        schedules = tuple(Schedule.of_profile(profile, STRETCH, probed, length) for profile in profiles)
        solver = resolve_solver(scene, self.solver)
        epoch = self.begin / self.window
        return RunPlan(cases, solver, records, schedules, which, epoch=epoch, window=self.window, worn=self.worn)

    def dataset(self, plan: Plan, results: PartRun) -> xr.Dataset:
        cases = plan.cases
        results = results.over(cases.shape)
        dims = cases.dims
        of_grid = lambda a: a.reshape(*cases.shape, *a.shape[1:])
        travelled = lambda dim, values: column(dim, values, "m", "distance travelled")
        ends = self.begin + self.window * np.arange(1, plan.periods + 1)
        data, coords = plan.label(dims, results.record)
        coords["distance"] = travelled("distance", ends)
        coords["stretch"] = travelled("stretch", ends[stretch_ends(plan.periods)])
        steps = np.array([one.profile for one in plan.schedules])[plan.which]
        text = "integration steps per window"
        data["steps_per_window"] = column((*dims, "distance"), of_grid(steps), "1", text)
        probed = np.flatnonzero([stretch[0].probed for stretch in plan.schedules[0].stretches])
        if len(probed):
            text = "what half the step changes over a reference length, in scales"
            over_length = f"{_probed_length(cases.scene):g} m"
            data["probe_error"] = column((*dims, "probe"), results.probe, "1", text, over=over_length)
            coords["probe"] = travelled("probe", self.begin + probed * STRETCH * self.window)
        data["status"] = column(dims, results.status, "", "status", meaning=MEANINGS)
        speed, seconds, stands = cases.of_each(_times, jnp.asarray(np.append(self.begin, ends)), self.window)
        # by names and not by values, so that each part of a store has the same dimensions
        differ = any(name.partition(".")[0] == "speed" for name in cases.axes)
        over = (*dims, "distance") if differ else "distance"
        joined = lambda a: of_grid(a) if differ else a[0]
        name = "speed_along" if "speed" in cases.axes else "speed"  # `speed` may be an axis of the grid
        coords[name] = column(over, joined(speed), "m/s", "travelling speed")
        coords["seconds"] = column(over, joined(seconds), "s", "time")
        if stands is not None:
            codes = np.where(joined(stands), Status.TOO_SLOW, Status.FINITE)
            data["window_status"] = column(over, codes, "", "status of each window", meaning=MEANINGS)
        varied = () if self.only else cases.axes
        ds = _with_rates(plan.dataset(data, coords, vars(self), {"window [m]": self.window}, varied))
        return ds.isel({dims[0]: 0}, drop=True) if self.only else ds


@dataclass(frozen=True)
class RunPlan(Plan):
    """A plan whose forcing periods are windows of distance."""

    window: float = field(kw_only=True)
    worn: np.ndarray | None = field(kw_only=True)
    """As of `RunCall`."""

    def begun(self, index):
        scenes, starts = super().begun(index)
        # the window is shared; `is_leaf` finds its place, where there was None
        shared = eqx.tree_at(
            lambda s: s.window, scenes.shared, as_argument(self.window), is_leaf=lambda leaf: leaf is None
        )
        scenes = Batched(scenes.varied, shared)
        if self.worn is not None:
            scenes = _opened(scenes, np.broadcast_to(self.worn, (len(index), *self.worn.shape)))
        return scenes, starts

    def axis(self, output):
        return ("distance" if output.each_period else "stretch",)

    def joined(self, made):
        found = []
        for record, *parts in zip(self.records.records, *made, strict=True):
            join = np.concatenate if record.each_period else np.stack
            found.append(jax.tree.map(lambda *of_each, join=join: join(of_each, axis=1), *parts))
        return found


def _windows(scene: Scene, length: float, begin: float, window: float) -> int:
    """Return the number of windows of a run.

    **Raises:** `ValueError` where the rail ends before the run. A warning says where the rail is not known further.
    """
    # rounding must not add a window, nor end the rail too early
    windows = int(np.ceil(length / window * (1 - 1e-12)))
    # the foremost slipper must not leave the rail
    travelled = begin + windows * window + float(np.max(np.asarray(scene.ahead)))
    far = scene.track.end + 1e-9 * abs(scene.track.end)
    shown = f"{travelled:g}; {longer_rails(scene.track, travelled)}"
    require(travelled <= far, "length", f"end before the rail does at {scene.track.end:g} m", shown=shown)
    warn_beyond(scene.track, "length", travelled)
    return windows


def _records(scene: Scene, record: object) -> RecordSet:
    """Return the records that a user chose for each window, and the records of each stretch and of the whole run."""
    if record is None:
        record = default_records(scene)
    chosen = [record] if isinstance(record, str) or not isinstance(record, Sequence) else record
    need = f"be one of {', '.join(WINDOW_RECORDS)}, peak_force, rms_a_z, and others of slipperjax.flow.RECORDS"
    known = []
    for name in chosen:
        # a name may mean several records
        for one in ALIASES.get(name, (name,)) if isinstance(name, str) else (name,):
            known.append(run_record(one))
            ok = known[-1] is not None
            require(ok, "record", f"{need}, or a record of numbers", one, names=(*WINDOW_RECORDS, *RECORDS))
    records: list[AbstractRecord] = list(map(PerWindow, known))
    names = {one.name for one in records}
    # each variable once, for windows where the user asks for this
    records += [RECORDS[name] for name in PER_STRETCH if name not in names]
    records += [ThirdOctaves(), StateNumbers()]
    if scene.wear is not None:
        records.append(Wearing())
    # statuses that follow from loads come with any load
    if OF_LOADS.intersection(known):
        records.append(ContactChecks())
    return RecordSet(tuple(records))


def _step_profiles(
    cases: Cases, call: RunCall, windows: int
) -> tuple[Int[np.ndarray, "profiles windows"], Int[np.ndarray, " cases"]]:
    """Return profiles of integration steps in each window, and the profile of each case."""
    window = call.window
    if call.steps_per_period is None:
        edges = call.begin + window * np.arange(windows + 1)
        needed = cases.of_each(_steps_along, jnp.asarray(edges))
        # slow places of a run may take many steps, but not the fastest place
        rounded_steps(needed.min(axis=1), cases.wavelengths())
        steps = call.refine * rounded_up(needed)
    else:
        steps = np.full((cases.count, windows), given_steps(call.steps_per_period))
    # from steps per wavelength to steps per window; rounding must not add a step
    per_window = np.ceil(steps * (window / cases.wavelengths()[:, None]) * (1 - 1e-12)).astype(int)
    profiles = np.maximum(per_window, LEAST_STEPS_PER_WINDOW)
    different, which = np.unique(profiles, axis=0, return_inverse=True)
    which = np.ravel(which)
    # given steps are not changed
    return joint_profiles(different, which) if call.steps_per_period is None else (different, which)


@jit
def _steps_along(scenes: Batched[Scene], starts: Motion | State, edges: jax.Array) -> jax.Array:
    """Return steps per reference length that each window needs, at its least speed, (cases, windows).

    **Arguments:** `starts`: unused, but with an axis of cases even where all scenes are the same; `edges`: places
    between the windows [m].
    """

    def one(scene: Scene, start: Motion | State) -> jax.Array:
        if not isinstance(scene.speed, SpeedProgramme):
            return jnp.broadcast_to(steps_needed(scene), edges[1:].shape)
        least = jax.vmap(scene.speed.least)(edges[:-1], edges[1:])
        return jax.vmap(lambda v: steps_needed(eqx.tree_at(lambda s: s.speed, scene, v)))(least)

    return scenes.map(one, starts)


def _worn(scene: Scene, earlier: object, begin: float) -> np.ndarray | None:
    """Return the play that wear before `begin` [m] has opened at each face [m]; None where slippers do not wear."""
    if scene.wear is None:
        return None
    works = scene.friction is not None or not scene.wear.by_friction
    require(works, "scene", "have friction, by whose work slippers wear", shown="none")
    nothing = np.zeros_like(np.asarray(scene.play))
    ds = getattr(earlier, "ds", earlier)
    if not (isinstance(ds, xr.Dataset) and "play" in ds):
        return nothing
    # wear by distance follows from the place of the run, so that only the rest is carried over
    by_distance = play_added(scene, jnp.asarray(nothing), begin)
    return ds["play"].sel(stretch=begin).values - np.asarray(scene.play) - np.asarray(by_distance)


@jit
def _opened(scenes: Batched[Scene], play: Numbers) -> Batched[Scene]:
    """Return the same scenes with this additional play at each face, (cases, *slippers, faces) [m]."""
    plays = scenes.map(with_more_play, play)
    # shared values have no play, because it differs from case to case
    return Batched(scenes.varied.with_play(plays), scenes.shared.with_play(None))


def _probed_length(scene: Scene) -> float:
    """Return the length of travel over which errors are measured [m]: a wavelength of the track. At most 8 m on rails
    without waves, because these may be one long wave that repeats."""
    wavelength = float(np.max(scene.wavelength))
    return wavelength if hasattr(scene.track, "wavelengths") else min(wavelength, DEFAULT_WAVELENGTH)


@jit
def _times(
    scenes: Batched[Scene], starts: Motion | State, ends: jax.Array, window: Real
) -> tuple[jax.Array, jax.Array, jax.Array | None]:
    """Return speeds in the middle of windows [m/s], times at their ends [s], and whether the sled is at rest or too
    slow in them; (cases, windows). The last is None where the programme has no times, because only times show this.

    **Arguments:** `ends`: the place where the run begins, and the end of each window [m].
    """

    def one(scene: Scene, start: Motion | State) -> tuple[jax.Array, jax.Array, jax.Array | None]:
        length = scene.wavelength
        speed = jnp.asarray(scene.travel((ends[1:] - 0.5 * window) / length).speed)
        seconds = jnp.asarray(scene.seconds(ends / length))
        stands = None
        if isinstance(scene.speed, SpeedProgramme) and scene.speed.time is not None:
            stands = scene.speed.stands(ends[:-1], ends[1:])
        return jnp.broadcast_to(speed, ends[1:].shape), seconds[1:] - seconds[0], stands

    return scenes.map(one, starts)


def _with_rates(ds: xr.Dataset) -> xr.Dataset:
    """Add values that follow from windows, for each stretch: rates of impacts, percentiles of highest forces."""
    which = np.arange(ds.sizes["distance"]) // STRETCH
    stretch = ds["distance"].copy(data=ds["stretch"].values[which]).rename("stretch")
    if "impacts" in ds:
        ends = ds["seconds"].groupby(stretch).last(skipna=False)
        seconds = ends - ends.shift(stretch=1, fill_value=0.0)
        rate = ds["impacts"].groupby(stretch).sum(skipna=False) / seconds
        ds["impact_rate"] = rate.assign_attrs(units="1/s", long_name="rate of touchdowns")
    for name in ("peak_slipper_force", "peak_force"):
        if name not in ds:
            continue
        values = highest_of_points(ds[name]).groupby(stretch).quantile(np.array(PERCENTILES) / 100, skipna=False)
        values = values.rename(quantile="percentile").assign_coords(percentile=list(PERCENTILES))
        values["percentile"].attrs["units"] = "%"
        words = ds[name].attrs | {"long_name": f"percentile of a window's {ds[name].attrs['long_name']}"}
        ds[f"{name}_percentile"] = values.transpose(..., "stretch", "percentile").assign_attrs(words)
    return ds
