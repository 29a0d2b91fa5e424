"""Loads that size parts: greatest net loads of slippers, greatest means over time, and loads inside a sled."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..analysis.quantiles import Estimates, estimate, least_rails
from ..flow.datasets import load_base
from ..flow.status import is_lost
from ..model.scene import Scene
from ..model.sled import Cut
from ..results.result import Result
from ..tools.checks import not_negative, one_of, require, tuple_of
from ..tools.columns import column
from ..tools.description import describe
from ..tools.types import Numbers
from .compare import estimated_columns
from .environment import accelerations_at, sample_times
from .windows import AccelerationHistory, LoadHistory, begins, speeds_along

HISTORY = LoadHistory.quantity.name
MOTION = AccelerationHistory.quantity.name
AXES = ("y", "z")
"""Axes of forces."""
ABOUT = ("x", "y", "z")
"""Axes of moments."""
LABELS = {
    "slipper_force": ("slipper", "N", "axis", "net force of a slipper"),
    "slipper_moment": ("slipper", "N m", "about", "net moment of a slipper about its middle"),
    "cut_force": ("cut", "N", "axis", "force of the part behind a cut on the part in front"),
    "cut_moment": ("cut", "N m", "about", "moment of the part behind a cut on the part in front"),
}
"""Dimension, unit, axes and description of loads by name."""


class Peaks(NamedTuple):
    """Values of greatest magnitude, with their signs and places; NaN for a lost run."""

    value: Float[np.ndarray, "*of means loads"]
    """[N] or [N m]"""
    distance: Float[np.ndarray, "*of means loads"]
    """Distance travelled [m]."""
    speed: Float[np.ndarray, "*of means loads"]
    """Speed along the track [m/s]."""


def loads(
    runs: Result | xr.Dataset,
    means: Numbers = (),
    cuts: Sequence[Cut] = (),
    *,
    over: str | None = None,
    quantiles: Sequence[float] = (0.5, 0.95),
    seed: int = 0,
) -> Result:
    """Return the loads that size slippers, their bolts and a sled: the greatest of each run, and where it occurs.

    ```python
    scene, rails = sj.sweeps.on_rails(scene, 80)
    record = ["slipper_peak", "slipper_load"]
    runs = sj.run(scene, rails, product=False, length=400.0, record=record)
    report = sj.sweeps.loads(runs, means=[1e-3, 5e-3], over="case")
    ```

    A bolt does not follow the shortest peaks. Therefore loads are also averaged over intervals of time. The result
    for an interval of 1 ms is the mean load of greatest magnitude of all intervals of 1 ms within a run. The result
    for an interval of 0 s is the peak itself.

    **Arguments:**

    - `runs`: of `slipperjax.run`, over any parameters, with the record "slipper_peak"; with `means` or `cuts` also
        with "slipper_load", and with `cuts` also with "body_acceleration".
    - `means`: lengths of the intervals of time [s].
    - `cuts`: planes across a rigid sled. The loads at a cut are those of the rear part on the front part: forces
        along y and z, and moments about the point of the plane with y = z = 0. They follow from the net loads of the
        slippers in front, and from inertia and weight of the mass in front. Forces along x and a load of the scene
        are left out.
    - `over`: dimension of the runs whose members are independent, such as rails; then loads also have quantiles.
    - `quantiles`: shares of the independent runs with lower loads [1]; `seed`: of the bootstrap of their errors.

    **Returns:** a `Result` over the parameters of the runs and the interval `mean` [s] with

    - `slipper_force` [N] over `axis` (y, z) and `slipper_moment` [N m] about the slipper's middle over `about` (x, y,
      z), for a sled over `slipper`: net loads of the contacts, which a mount carries;
    - `cut_force` [N] and `cut_moment` [N m] over `cut`;
    - for each of these the distance travelled, such as `slipper_force_distance` [m], and the speed,
      `slipper_force_speed` [m/s]. For a moment of an interval of 0 s this is the middle of the window;
    - with `over` the magnitude that a share of the runs does not exceed, over `quantile`, such as
      `slipper_force_value`, its standard error `slipper_force_stderr`, and its 95 % interval, `slipper_force_low` and
      `slipper_force_high`. A share that needs more runs is NaN.

    Lost runs are NaN, and do not count for quantiles. Samples of a window limit how short an interval may be, and how
    exact peaks at cuts are, see `LoadHistory`.

    **Raises:** `ValueError` for runs without the records, and for cuts of an elastic sled.
    """
    ds = getattr(runs, "ds", runs)
    known = isinstance(ds, xr.Dataset) and {"peak_slipper_force", "peak_slipper_moment"} <= set(ds)
    require(known, "runs", 'be a result of slipperjax.run with the record "slipper_peak"', shown="another")
    scene, _ = load_base(ds)
    durations, cuts = check_loads(scene, means, cuts)
    for needed, name in ((cuts or len(durations) > 1, HISTORY), (cuts, MOTION)):
        require(not needed or name in ds, "runs", f'have the record "{name}" for `means` or `cuts`', shown="none")
    status = ds["status"]
    if over is not None:
        one_of("over", over, [str(name) for name in status.dims])
    each = [
        _of_run(ds.isel(dict(zip(status.dims, at, strict=True))), scene, durations, cuts)
        for at in np.ndindex(status.shape)
    ]
    slippers = {"slipper": list(scene.slipper.names)} if scene.slipper.names else {}
    of_cuts = {"cut": [cut.name or f"cut{k}" for k, cut in enumerate(cuts, 1)]} if cuts else {}
    data: dict[str, Any] = {}
    for name, (of, unit, along, text) in LABELS.items():
        if name not in each[0]:
            continue
        dims = (*status.dims, *(slippers if of == "slipper" else of_cuts), "mean", along)
        peaks = Peaks(*(np.stack(values) for values in zip(*(one[name] for one in each), strict=True)))
        value, distance, speed = (a.reshape(*status.shape, *a.shape[1:]) for a in peaks)
        data[name] = column(dims, value, unit, f"greatest {text}")
        data[f"{name}_distance"] = column(dims, distance, "m", "distance travelled")
        data[f"{name}_speed"] = column(dims, speed, "m/s", "speed")
        if over is not None:
            magnitude = np.moveaxis(np.abs(value), dims.index(over), 0)
            rest = [dim for dim in dims if dim != over]
            data |= _quantiles(name, magnitude, rest, quantiles, unit, text, seed)
    coords = {
        **{name: values for name, values in ds.coords.items() if set(values.dims) <= set(status.dims)},
        **slippers,
        **of_cuts,
        "mean": column("mean", durations, "s", "length of the interval of time"),
        "axis": list(AXES),
        "about": list(ABOUT),
    }
    if over is not None:
        coords["quantile"] = column("quantile", list(quantiles), "1", "share of the runs below")
    kept = {name: value for name, value in ds.attrs.items() if not name.startswith("status")}
    call = dict(function="loads", means=durations, cuts=list(cuts), over=over, quantiles=list(quantiles), seed=seed)
    return Result(xr.Dataset(data | {"status": status}, coords, kept | {"call": json.dumps(describe(call))}))


def _quantiles(
    name: str,
    magnitude: Float[np.ndarray, "runs ..."],
    dims: Sequence[str],
    quantiles: Sequence[float],
    unit: str,
    text: str,
    seed: int,
) -> dict[str, Any]:
    """Return variables with the quantiles over independent runs, and their errors; the first axis is of the runs."""
    flat = magnitude.reshape(len(magnitude), 1, -1)
    of_shares = [_estimated(flat, share, seed) for share in quantiles]
    found = Estimates(*(np.stack(parts, axis=-1) for parts in zip(*of_shares, strict=True)))
    shape = (*magnitude.shape[1:], len(quantiles))
    columns = estimated_columns((*dims, "quantile"), shape, found, unit, f"quantile of the {text}")
    # there are no cases to compare
    return {f"{name}_{part}": values for part, values in columns.items() if not part.startswith("difference")}


def _estimated(flat: Float[np.ndarray, "runs 1 loads"], share: float, seed: int) -> Estimates:
    """Return quantiles of loads; NaN where there are too few runs."""
    if len(flat) < least_rails(share):
        return Estimates(*(np.full(flat.shape[-1], np.nan) for _ in Estimates._fields))
    return estimate(flat, share, 0, seed=seed)


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
    window = float(ds.attrs["window [m]"])
    speeds = speeds_along(ds).values
    peaks = {"slipper_force": _peaks(ds, "peak_slipper_force", "axis", speeds)}
    peaks["slipper_moment"] = _peaks(ds, "peak_slipper_moment", "about", speeds)
    found = {name: [peak] for name, peak in peaks.items()}
    if HISTORY in ds:
        history = ds[HISTORY].transpose("distance", "sample", ..., "load").values
        samples = history.shape[1]
        # with an axis of slippers also for a single slipper
        of_slippers = history.reshape(len(history) * samples, -1, history.shape[-1])
        time = sample_times(np.append(begins(ds).values, ds["seconds"].values), samples)
        first = float(ds["distance"][0]) - window
        places = first + np.arange(len(time)) * window / samples
        inside = {"slipper_force": of_slippers[..., :2], "slipper_moment": of_slippers[..., 2:]}
        if cuts:
            motion = ds[MOTION].transpose("distance", "sample", "component").values
            need = f"have as many samples of {MOTION} as of {HISTORY}"
            require(motion.shape[1] == samples, "runs", need, shown=f"{motion.shape[1]} and {samples}")
            at_cuts = [_at_cut(scene, cut, of_slippers, motion.reshape(len(time), -1)) for cut in cuts]
            joined = np.stack(at_cuts, axis=1)
            inside |= {"cut_force": joined[..., :2], "cut_moment": joined[..., 2:]}
        for name, values in inside.items():
            # peaks of slippers are known from the steps, others from samples
            for duration in durations[len(found.get(name, [])) :]:
                value, at = _greatest_mean(values, time, duration)
                place = np.interp(at, time, places)
                k = np.clip(((place - first) / window).astype(int), 0, len(speeds) - 1)
                found.setdefault(name, []).append(Peaks(value, place, speeds[k]))
    lost = bool(is_lost(int(ds["status"])))
    joined = {
        name: (np.stack(of_each, axis=1) for of_each in zip(*rows, strict=True)) for name, rows in found.items()
    }
    single = not scene.slipper.names
    made = {}
    for name, arrays in joined.items():
        of_parts = Peaks(*(np.where(lost, np.nan, a) for a in arrays))
        made[name] = Peaks(*(a[0] for a in of_parts)) if single and name.startswith("slipper") else of_parts
    return made


def _peaks(ds: xr.Dataset, name: str, along: str, speeds: np.ndarray) -> Peaks:
    """Return the peaks of a run from those of its windows, (slippers, loads)."""
    values = ds[name].transpose("distance", ..., along).values
    values = values.reshape(len(values), -1, values.shape[-1])
    if name == "peak_slipper_force":
        places = ds["peak_slipper_distance"].transpose("distance", ..., along).values.reshape(values.shape)
    else:
        middles = ds["distance"].values - ds.attrs["window [m]"] / 2
        places = np.broadcast_to(middles[:, None, None], values.shape)
    which = np.argmax(np.abs(values), axis=0)
    at_peak = lambda a: np.take_along_axis(a, which[None], axis=0)[0]
    return Peaks(at_peak(values), at_peak(places), speeds[which])


def _greatest_mean(
    values: Float[np.ndarray, "samples parts loads"], time: Float[np.ndarray, " samples"], duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of greatest magnitude over all intervals of a length, and the time in the middle [s], of each
    load.

    Between samples loads are linear, and their integrals quadratic. Intervals begin or end at samples.
    """
    if duration == 0:
        means, middles = values, time
    else:
        from scipy.integrate import cumulative_trapezoid  # here, because importing it takes time

        integral = cumulative_trapezoid(values, time, axis=0, initial=0.0)
        begins_at = np.concatenate([time, time - duration])
        begins_at = begins_at[(begins_at >= time[0]) & (begins_at + duration <= time[-1])]
        longest = f"be shorter than the run, {time[-1] - time[0]:g} s"
        require(len(begins_at), "means", longest, shown=f"{duration:g} s")
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
