"""Loads that size parts: greatest net loads of slippers, greatest means over time, and loads inside a sled."""

import json
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from scipy.integrate import cumulative_trapezoid

from ..flow.datasets import load_base
from ..flow.status import is_lost
from ..model.scene import Scene
from ..results.result import Result
from ..tools.checks import finite, not_negative, positive, require, tuple_of
from ..tools.columns import column
from ..tools.description import describe
from ..tools.fields import ShapeChecked, field
from ..tools.types import Numbers
from .environment import accelerations_at, sample_times
from .windows import AccelerationHistory, LoadHistory, begins

HISTORY = LoadHistory.quantity.name
MOTION = AccelerationHistory.quantity.name
AXES = ("y", "z")
"""Axes of forces."""
ABOUT = ("x", "y", "z")
"""Axes of moments."""


class Cut(ShapeChecked):
    """A plane across a sled, with the mass in front of it, for the loads between both parts of the sled."""

    x: Float[Array, ""] = field("m", finite)
    """Place of the plane along the track, from the sled's centre of mass [m]."""
    mass: Float[Array, ""] = field("kg", positive)
    """Mass in front of the plane, slippers included [kg]."""
    centre: Float[Array, "3"] = field("m", finite)
    """Centre of this mass, from the sled's centre of mass [m]."""
    inertia: Float[Array, "3"] = field("kg m^2", positive)
    """Moments of inertia of this mass about axes along x, y and z through its centre [kg m^2]."""
    name: str = eqx.field(static=True, default="")
    """Name in results; empty: "cut1", "cut2" and so on."""


class Peaks(NamedTuple):
    """Values of greatest magnitude, with their signs and places; NaN for a lost run."""

    value: Float[np.ndarray, "*of means loads"]
    """[N] or [N m]"""
    distance: Float[np.ndarray, "*of means loads"]
    """Distance travelled [m]."""
    speed: Float[np.ndarray, "*of means loads"]
    """Speed along the track [m/s]."""


def loads(runs: Result | xr.Dataset, means: Numbers = (), cuts: Sequence[Cut] = ()) -> Result:
    """Return the loads that size slippers, their bolts and a sled: the greatest of each run, and where it occurs.

    ```python
    runs = sj.run(scene, {"track.seed": range(32)}, length=400.0, record=["slipper_peak", "slipper_load"])
    report = sj.loads(runs, means=[1e-3, 5e-3])
    ```

    A bolt does not follow the shortest peaks. Therefore loads are also averaged over intervals of time. The result
    for an interval of 1 ms is the mean load of greatest magnitude of all intervals of 1 ms within a run. The result
    for an interval of 0 s is the peak itself.

    **Arguments:**

    - `runs`: of `slipperjax.run`, over any parameters, with the records "slipper_peak" and "slipper_load"; with
        `cuts` also "body_acceleration".
    - `means`: lengths of the intervals of time [s].
    - `cuts`: planes across a rigid sled. The loads at a cut are those of the rear part on the front part: forces
        along y and z, and moments about the point of the plane with y = z = 0. They follow from the net loads of the
        slippers in front, and from inertia and weight of the mass in front. Forces along x and a load of the scene
        are left out.

    **Returns:** a `Result` over the parameters of the runs and the interval `mean` [s] with

    - `slipper_force` [N] over `axis` (y, z) and `slipper_moment` [N m] about the slipper's middle over `about` (x, y,
      z), for a sled over `slipper`: net loads of the contacts, which a mount carries;
    - `cut_force` [N] and `cut_moment` [N m] over `cut`;
    - for each of these the distance travelled, such as `slipper_force_distance` [m], and the speed,
      `slipper_force_speed` [m/s]. For a moment of an interval of 0 s this is the middle of the window.

    Lost runs are NaN. Samples of a window limit how short an interval may be, and how exact peaks at cuts are, see
    `LoadHistory`.

    **Raises:** `ValueError` for runs without the records, and for cuts of an elastic sled.
    """
    ds = getattr(runs, "ds", runs)
    need = f'a result of slipperjax.run with the records "slipper_peak" and "{HISTORY}"'
    records = {HISTORY, "peak_slipper_force", "peak_slipper_moment"}
    require(isinstance(ds, xr.Dataset) and records <= set(ds), "runs", f"be {need}", shown="another")
    scene, _ = load_base(ds)
    durations, cuts = check_loads(scene, means, cuts)
    require(not cuts or MOTION in ds, "runs", f'have the record "{MOTION}" for `cuts`', shown="none")
    status = ds["status"]
    each = [
        _of_run(ds.isel(dict(zip(status.dims, at, strict=True))), scene, durations, cuts)
        for at in np.ndindex(status.shape)
    ]
    slippers = {"slipper": list(scene.slipper.names)} if scene.slipper.names else {}
    of_cuts = {"cut": [cut.name or f"cut{k}" for k, cut in enumerate(cuts, 1)]}
    data = {}
    for name, of, unit, along, text in (
        ("slipper_force", slippers, "N", "axis", "net force of a slipper"),
        ("slipper_moment", slippers, "N m", "about", "net moment of a slipper about its middle"),
        ("cut_force", of_cuts, "N", "axis", "force of the part behind a cut on the part in front"),
        ("cut_moment", of_cuts, "N m", "about", "moment of the part behind a cut on the part in front"),
    ):
        if name not in each[0]:
            continue
        dims = (*status.dims, *of, "mean", along)
        peaks = Peaks(*(np.stack(values) for values in zip(*(one[name] for one in each), strict=True)))
        shown = lambda a: a.reshape(*status.shape, *a.shape[1:])
        data[name] = column(dims, shown(peaks.value), unit, f"greatest mean {text}")
        data[f"{name}_distance"] = column(dims, shown(peaks.distance), "m", "distance travelled")
        data[f"{name}_speed"] = column(dims, shown(peaks.speed), "m/s", "speed")
    coords = {
        **{name: values for name, values in ds.coords.items() if set(values.dims) <= set(status.dims)},
        **slippers,
        **(of_cuts if cuts else {}),
        "mean": column("mean", durations, "s", "length of the interval of time"),
        "axis": list(AXES),
        "about": list(ABOUT),
    }
    known = {name: value for name, value in ds.attrs.items() if not name.startswith("status")}
    call = dict(function="loads", means=durations, cuts=list(cuts))
    made = xr.Dataset(data | {"status": status}, coords, known | {"call": json.dumps(describe(call))})
    return Result(made)


def check_loads(
    scene: Scene, means: Numbers = (), cuts: Sequence[Cut] = ()
) -> tuple[Float[np.ndarray, " means"], tuple[Cut, ...]]:
    """Return the lengths of intervals [s], with zero first, and cuts; check the arguments of `loads`, also before a
    long run."""
    durations = np.unique(np.append(0.0, np.asarray(not_negative("means", "s")(np.atleast_1d(means)), float)))
    checked = tuple_of("cuts", cuts, Cut, "a list of slipperjax.sweeps.Cut(...)")
    if checked:
        rigid = scene.slipper.modes is None and scene.payload is None
        require(rigid, "cuts", "come with a rigid sled without a payload", shown="given for another one")
    return durations, checked


def _of_run(ds: xr.Dataset, scene: Scene, durations: np.ndarray, cuts: Sequence[Cut]) -> dict[str, Peaks]:
    """Return the greatest loads of one run by name."""
    history = ds[HISTORY].transpose("distance", "sample", ..., "load").values
    samples = history.shape[1]
    # loads of slippers along one axis, also of a single slipper
    of_slippers = history.reshape(len(history) * samples, -1, history.shape[-1])
    ends = np.append(begins(ds).values, ds["seconds"].values)
    time = sample_times(ends, samples)
    window = ds.attrs["window [m]"]
    first = float(ds["distance"][0]) - window
    places = first + np.arange(len(time)) * window / samples
    speeds = ds["speed_along" if "speed_along" in ds.coords else "speed"].values
    lost = bool(is_lost(int(ds["status"])))

    def greatest(values: np.ndarray) -> Peaks:
        """Return the greatest means of loads (samples, parts, loads) over intervals of time."""
        rows = [_greatest_mean(values, time, duration) for duration in durations]
        value, at = (np.stack(of_each, axis=1) for of_each in zip(*rows, strict=True))
        place = np.interp(at, time, places)
        speed = speeds[np.clip(((place - first) / window).astype(int), 0, len(speeds) - 1)]
        return Peaks(*(np.where(lost, np.nan, a) for a in (value, place, speed)))

    # peaks between samples are known from the steps
    force = _with_peaks(greatest(of_slippers[..., :2]), ds, "peak_slipper_force", "axis", speeds)
    moment = _with_peaks(greatest(of_slippers[..., 2:]), ds, "peak_slipper_moment", "about", speeds)
    single = not scene.slipper.names
    found = {
        "slipper_force": Peaks(*(a[0] for a in force)) if single else force,
        "slipper_moment": Peaks(*(a[0] for a in moment)) if single else moment,
    }
    if cuts:
        motion = ds[MOTION].transpose("distance", "sample", "component").values
        need = f"have as many samples of {MOTION} as of {HISTORY}"
        require(motion.shape[1] == samples, "runs", need, shown=f"{motion.shape[1]} and {samples}")
        motion = motion.reshape(len(time), -1)
        inside = np.stack([_at_cut(scene, cut, of_slippers, motion) for cut in cuts], axis=1)
        found |= {"cut_force": greatest(inside[..., :2]), "cut_moment": greatest(inside[..., 2:])}
    return found


def _with_peaks(found: Peaks, ds: xr.Dataset, name: str, along: str, speeds: np.ndarray) -> Peaks:
    """Return greatest means with the peaks of a run's windows in place of the means over 0 s."""
    values = ds[name].transpose("distance", ..., along).values
    values = values.reshape(len(values), -1, values.shape[-1])
    which = np.argmax(np.abs(values), axis=0)
    pick = lambda a: np.take_along_axis(a, which[None], axis=0)[0]
    middle = ds["distance"].values - ds.attrs["window [m]"] / 2
    place = np.broadcast_to(middle[:, None, None], values.shape)
    if name == "peak_slipper_force":
        place = ds["peak_slipper_distance"].transpose("distance", ..., along).values.reshape(values.shape)
    lost = np.isnan(found.value[:, 0]).all()
    of_peak = (pick(values), pick(place), speeds[which])
    for mean, peak in zip(found, of_peak, strict=True):
        mean[:, 0] = np.where(lost, np.nan, peak)
    return found


def _greatest_mean(
    values: Float[np.ndarray, "samples parts loads"], time: Float[np.ndarray, " samples"], duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of greatest magnitude over all intervals of a length, and the time in the middle [s], of each
    load; NaN where a run is shorter.

    Between samples loads are linear, and their integrals quadratic. Intervals begin or end at samples.
    """
    if duration == 0:
        means, middles = values, time
    else:
        integral = cumulative_trapezoid(values, time, axis=0, initial=0.0)
        begins_at = np.concatenate([time, time - duration])
        begins_at = begins_at[(begins_at >= time[0]) & (begins_at + duration <= time[-1])]
        if not len(begins_at):
            unknown = np.full(values.shape[1:], np.nan)
            return unknown, unknown
        between = lambda at: _integral_until(at, time, values, integral)
        means = (between(begins_at + duration) - between(begins_at)) / duration
        middles = begins_at + duration / 2
    which = np.argmax(np.abs(means), axis=0)
    return np.take_along_axis(means, which[None], axis=0)[0], middles[which]


def _integral_until(at: np.ndarray, time: np.ndarray, values: np.ndarray, integral: np.ndarray) -> np.ndarray:
    """Return integrals from the first sample until the times `at`, of values that are linear between samples."""
    k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    inside = (at - time[k])[:, None, None]
    slope = (values[k + 1] - values[k]) / (time[k + 1] - time[k])[:, None, None]
    return integral[k] + values[k] * inside + slope * inside**2 / 2


def _at_cut(
    scene: Scene,
    cut: Cut,
    of_slippers: Float[np.ndarray, "samples slippers 5"],
    motion: Float[np.ndarray, "samples components"],
) -> Float[np.ndarray, "samples 5"]:
    """Return forces along y and z [N], and moments [N m], of the part behind a cut on the part in front of it.

    Balance of momentum and angular momentum of the part in front, about the point (x, 0, 0) of the plane.
    """
    centre = np.asarray(cut.centre)
    arm = centre - [float(cut.x), 0.0, 0.0]
    acceleration = accelerations_at(scene, motion[None], centre[None])[0, 0].T
    # along x the speed is prescribed, and forces are left out
    acceleration[:, 0] = 0.0
    if scene.gravity is not None:
        acceleration[:, 2] += float(scene.gravity)
    angular = motion[:, 2:5]
    spin = motion[:, 5:8]
    inertia = np.asarray(cut.inertia)
    force = float(cut.mass) * acceleration
    moment = inertia * angular + np.cross(spin, inertia * spin) + np.cross(arm, force)
    for k, slipper in enumerate(scene.mounted):
        place = np.array([0.0 if v is None else float(v) for v in slipper.place])
        if place[0] < float(cut.x):
            continue
        contact = np.insert(of_slippers[:, k, :2], 0, 0.0, axis=1)
        force = force - contact
        moment = moment - of_slippers[:, k, 2:] - np.cross(place - [float(cut.x), 0.0, 0.0], contact)
    return np.concatenate([force[:, 1:], moment], axis=1)
