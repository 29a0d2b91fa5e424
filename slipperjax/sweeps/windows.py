"""Records of runs: each value belongs to a window of distance, not to a forcing period.

A run over a rail is the same loop as a run of forcing periods, with a window of distance as the period.
"""

import json
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Int

from ..flow.course import Course
from ..flow.numbers import (
    ONE_PERIOD,
    POINTS,
    RECORDS,
    AbstractNumber,
    AbstractQuantityRecord,
    PeakDistance,
    Record,
)
from ..flow.record import AbstractRecord
from ..model.layout import StateLayout
from ..model.quantities import ACCELERATIONS, COORDINATES, Quantity
from ..model.scene import Scene
from ..tools.checks import instance, one_of, require, whole
from ..tools.columns import column
from ..tools.forms import store
from ..tools.types import AnyArray, Real

STRETCH = 100
"""Windows in a stretch: spectra and rates are over one stretch, and states are kept at its end."""


def touchdowns(course: Course) -> Float[Array, "*slippers 2 points"]:
    """Return how often the gap of each contact point closed [1], from its sign at the ends of steps."""
    closed = course.gap.values < 0
    return jnp.sum(course.counted((closed[1:] & ~closed[:-1]).astype(float), 0.0), axis=0)


def _peak(k: int, q: Quantity) -> Record:
    """Return the record of the greatest magnitude of the k-th acceleration."""
    text = f"greatest magnitude of the {q.long_name}"
    size = lambda c: jnp.maximum(c.acceleration.greatest, -c.acceleration.least)[k]
    return Record(Quantity(f"peak_{q.name}", q.unit, text, rf"|{q.symbol}|_{{\max}}"), size, "max")


@dataclass(frozen=True)
class AbstractHistory(AbstractNumber):
    """Values at equal distances within each window."""

    samples: int = 64
    """Samples in each window of distance."""

    join = ONE_PERIOD

    def __post_init__(self):
        whole("samples", self.samples, 1, 100_000)

    @property
    def places(self) -> Float[np.ndarray, " samples"]:
        """Places of the samples, shares of the window from 0 on."""
        return np.arange(self.samples) / self.samples


@dataclass(frozen=True)
class AccelerationHistory(AbstractHistory):
    """Accelerations of the body at equal distances; `slipperjax.environment` computes those of any place."""

    quantity = Quantity(
        "body_acceleration", "", "accelerations, angular velocities and modal accelerations, SI units"
    )

    def labels(self, scene):
        modes = 0 if scene.slipper.modes is None else scene.slipper.modes.count
        of_modes = [f"mode_{k}" for k in range(1, modes + 1)]
        return {"sample": list(range(self.samples)), "component": [*ACCELERATIONS, *SPINS, *of_modes]}

    def of(self, course):
        spins = [list(COORDINATES).index(name) for name in SPINS]
        parts = course.acceleration.at(self.places), course.coordinates.at(self.places)[:, spins]
        return jnp.concatenate([*parts, course.modal_acceleration.at(self.places)], axis=-1)


SPINS = ("w_x", "w_y", "w_z")
"""The angular velocities."""


@dataclass(frozen=True)
class LoadHistory(AbstractHistory):
    """Net loads of slippers at equal distances; `slipperjax.sweeps.loads` makes loads that size parts from them."""

    quantity = Quantity(
        "slipper_load", "", "net force of a slipper [N] and its moment about the slipper's middle [N m]"
    )

    def labels(self, scene):
        slippers = {"slipper": list(scene.slipper.names)} if scene.slipper.names else {}
        return {"sample": list(range(self.samples)), **slippers, "load": list(NET_LOADS)}

    def of(self, course):
        return course.slipper_load.at(self.places)


NET_LOADS = ("F_y", "F_z", "M_x", "M_y", "M_z")
"""Net force of a slipper along y and z [N], and net moment about its middle along the body's axes [N m]."""
PEAK_DISTANCE = PeakDistance()
WINDOW_RECORDS: dict[str, AbstractNumber] = {
    record.name: record
    for record in (
        PEAK_DISTANCE,
        Record(Quantity("impacts", "1", "number of touchdowns", "n"), touchdowns, "sum", POINTS),
        Record(
            Quantity("friction_work", "J", "heat that friction makes", "Q"),
            lambda c: c.friction_power.integral,
            "sum",
            POINTS,
        ),
        Record(
            Quantity("spring_force", "N", "greatest force of the sled's springs", shown_unit="kN"),
            lambda c: jnp.maximum(c.spring_force.greatest, -c.spring_force.least),
            "max",
            (("direction", ("lateral", "vertical")),),
        ),
        Record(
            Quantity("slipper_force", "N", "mean force of a slipper's contacts", r"\bar F", shown_unit="kN"),
            lambda c: c.slipper_load.mean[..., :2],
            "mean",
            ("slipper", ("direction", ("lateral", "vertical"))),
        ),
        Record(
            Quantity("slipper_roll", "N m", "mean moment of a slipper's contacts about the x axis", r"\bar M_X"),
            lambda c: c.slipper_roll.mean,
            "mean",
            ("slipper",),
        ),
        AccelerationHistory(),
        LoadHistory(),
        *(_peak(k, q) for k, q in enumerate(ACCELERATIONS.values())),
    )
}
"""Records of numbers for runs, in addition to `RECORDS`."""
DEFAULT = (
    *("peak_slipper_force", "peak_slipper_moment", "peak_slipper_distance"),
    *("peak_force", "peak_distance", "contact_fraction", "impacts", "impulse", "drive_force"),
    *(f"peak_{name}" for name in ACCELERATIONS),
)
"""Records of each window by default; with gravity or a load also `static_ratio`, with friction `friction_work`, with
a mass on the slipper `spring_force`, and for a sled `slipper_force` and `slipper_roll`."""
PER_STRETCH = tuple(f"rms_{name}" for name in ACCELERATIONS)
"""Records of each stretch."""


def default_records(scene: Scene) -> list[str]:
    """Return the names of the records that a run keeps for each window by default."""
    names = list(DEFAULT)
    names += ["static_ratio"] * (scene.gravity is not None or scene.load is not None)
    names += ["friction_work"] * (scene.friction is not None)
    names += ["spring_force"] * (scene.payload is not None)
    names += ["rail_deflection", "rail_energy"] * (scene.beam is not None)
    names += ["slipper_force", "slipper_roll"] * bool(scene.slipper.names)
    return names


def run_record(name: Any) -> AbstractNumber | None:
    """Return the record of numbers with a name, or a given record; None for an unknown name."""
    found = WINDOW_RECORDS.get(name, RECORDS.get(name)) if isinstance(name, str) else name
    return found if isinstance(found, AbstractNumber) else None


@dataclass(frozen=True)
class PerWindow(AbstractQuantityRecord):
    """The values of a record in each window of distance."""

    record: AbstractNumber

    each_period = True

    @property
    def quantity(self):
        return self.record.quantity

    def labels(self, scene):
        return self.record.labels(scene)

    def values(self, scene, periods):
        return math.prod(self.shape(scene)) * periods

    def sample(self, course):
        return self.record.of(course)

    def finish(self, carried, samples, span):
        return np.asarray(self.record.join.value(np.asarray(samples), 1))


@dataclass(frozen=True)
class StateNumbers(AbstractRecord):
    """All numbers of the state at the end, from which a run can continue."""

    name = "state"
    inside = False

    def values(self, scene, periods):
        return len(StateLayout.of(scene).numbers)

    def finish(self, carried, samples, span):
        return StateLayout.pack(span.states)

    def label(self, scene, dims, values):
        text = "all numbers of the state at the end of each stretch"
        names = [q.name for q in StateLayout.of(scene).numbers]
        return {"state": column((*dims, "number"), values, "", text)}, {"number": names}


class Worn(NamedTuple):
    """Work of friction at each face since the start, and the play that it opened; for a sled at each slipper."""

    work: Float[AnyArray, "*cases faces"]  # [J]
    play: Float[AnyArray, "*cases faces"]  # play added by wear [m]


@dataclass(frozen=True)
class Wearing(AbstractRecord):
    """The play of each face, which wear opens: it changes the scene before each window."""

    name = "play"
    goes_on = True

    def values(self, scene, periods):
        return np.size(scene.play)

    def begin(self, scene, state):
        none = np.zeros(np.shape(scene.play))
        return Worn(none, none)

    def add(self, carried, course):
        work, scene = carried.work, course.scene
        # without friction, wear depends only on the distance
        if scene.friction is not None:
            faces = scene.section.face_of_point
            work = work.at[..., faces].add(jnp.sum(course.friction_power.integral, axis=-2))
        return Worn(work, play_added(scene, work, (course.args.epoch + 1) * scene.wavelength))

    def feed_back(self, scene, carried, epoch):
        return scene.with_play(scene.play + play_added(scene, carried.work, epoch * scene.wavelength))

    def finish(self, carried, samples, span):
        assert span.scenes is not None  # a chunk has scenes
        return np.asarray(span.scenes.map(with_more_play, carried.play))

    def label(self, scene, dims, values):
        slippers = {name: of for name, of in scene.point_labels.items() if name == "slipper"}
        text = "play of each face at the end of each stretch"
        labels = slippers | {"face": ["".join(face) for face in scene.section.faces]}
        return {"play": column((*dims, *labels), values, "m", text)}, labels


def with_more_play(scene: Scene, more: Array) -> Array:
    """Return the play of each face including the play added by wear [m]."""
    return jnp.asarray(scene.play) + more


def play_added(scene: Scene, work: Array, distance: Real) -> Array:
    """Return the play that wear has added to each face [m], after a distance [m] and friction's `work` [J], as
    `Scene.play`."""
    wear = scene.wear
    assert wear is not None  # checked before
    slippers = scene.mounted
    each = zip(slippers, work.reshape(len(slippers), -1), strict=True)
    return jnp.stack([wear.added(s.section, s.length, distance, own) for s, own in each]).reshape(work.shape)


def whole_run(ds: xr.Dataset, record: AbstractNumber | str, over: str = "distance") -> xr.DataArray:
    """Return a number of whole runs from the numbers of their windows.

    ```python
    whole_run(ds, "contact_load", over="time")
    ```

    Greatest values, least values and sums are those of all windows together. Where the speed changes, a mean or a
    root mean square is over the distance, to which each window contributes equally, or over time, to which slow
    windows contribute more.

    **Arguments:** `ds`: of `run`, with the record of each window, or a part of it along the distance; `record`: the
    record or its name; `over`: "distance" or "time".

    **Raises:** `ValueError` that names the wrong argument.
    """
    ds = instance("ds", getattr(ds, "ds", ds), xr.Dataset, "a result of slipperjax.run")
    known = run_record(record)
    require(known is not None and known.name in ds, "record", "be a number of the run's windows", record)
    assert known is not None
    one_of("over", over, ("distance", "time"))
    values = ds[known.name].transpose("distance", ...)
    weights = None if over == "distance" else lasting(ds).broadcast_like(values).transpose(*values.dims).values
    return values.isel(distance=0, drop=True).copy(data=known.join.whole(values.values, weights))


def lasting(ds: xr.Dataset) -> xr.DataArray:
    """Return the duration of each window of a run [s], also for a part of a run."""
    seconds = ds["seconds"]
    return seconds - seconds.shift(distance=1).fillna(begins(ds))


def begins(ds: xr.Dataset) -> xr.DataArray:
    """Return the time at which the first window begins [s]: zero, unless earlier windows were left out."""
    window = float(ds.attrs["window [m]"])
    seconds = ds["seconds"].isel(distance=0, drop=True)
    if float(ds["distance"][0]) - window <= json.loads(ds.attrs["call"])["begin"] + 1e-6 * window:
        return xr.zeros_like(seconds)
    return seconds - window / speeds_along(ds).isel(distance=0, drop=True)


def speeds_along(ds: xr.Dataset) -> xr.DataArray:
    """Return the speed in the middle of each window [m/s]: under another name where "speed" is a varied parameter."""
    return ds["speed_along" if "speed_along" in ds.coords else "speed"]


def stretch_ends(windows: int) -> Int[np.ndarray, " stretches"]:
    """Return the number of the last window of each stretch."""
    return np.append(np.arange(STRETCH - 1, windows - 1, STRETCH), windows - 1)


SAMPLES_PER_WINDOW = 16
"""Filtered accelerations in each window, from which spectra are made."""
BANDS = 1000.0 * 10 ** (np.arange(-20, 11) / 10)
"""Middles of third octaves [Hz], 10 Hz to 10 kHz, IEC 61260-1."""


def _cubic_spline(x: np.ndarray) -> np.ndarray:
    """Return the cubic B-spline of unit spacing, area and knots at -2 to 2. Its Fourier transform is sinc(f)^4."""
    far = np.abs(x)
    return np.where(far < 1, 2 / 3 - far**2 + far**3 / 2, np.maximum(2 - far, 0.0) ** 3 / 6)


@dataclass(frozen=True)
class ThirdOctaves(AbstractRecord):
    """Root mean squares of the lateral and the vertical acceleration in third octaves, for a stretch.

    They come from a periodogram with Hann's window. Each window of distance gives `SAMPLES_PER_WINDOW` equidistant
    samples, which are means of the acceleration weighted by a cubic B-spline. This filter suppresses aliases of
    frequencies that are too high for the samples; its own effect is divided out (doi:10.1109/79.799930).

    Bands narrower than the resolution are NaN, and so are bands above a quarter of the sampling frequency. At this
    frequency aliases have 1.5e-4 of the power of a white spectrum, and less below it.
    """

    name = "third_octaves"

    @property
    def variables(self):
        return "band_a_y", "band_a_z"

    def values(self, scene, periods):
        return 2 * (SAMPLES_PER_WINDOW + 3) * periods

    def sample(self, course):
        # two places in each step, for the greatest number of steps in a window
        each = -(-max(2 * course.capacity, 4 * SAMPLES_PER_WINDOW) // SAMPLES_PER_WINDOW)
        places = (np.arange(SAMPLES_PER_WINDOW * each) + 0.5) / each
        # stored, so that the curve is computed once at each place, and not once for each sample
        values = store(course.acceleration.at(places / SAMPLES_PER_WINDOW)[:, :2])
        between = values.reshape(SAMPLES_PER_WINDOW, each, 2)
        # the window's share of each sample: neighbours have the rest of the first three and the last three samples;
        # the values between two samples are in the means of these two and of the next one on either side
        shares = jnp.zeros((SAMPLES_PER_WINDOW + 3, 2))
        for k in range(4):
            weights = _cubic_spline(places[:each] + 1 - k) / each
            share = sum(weight * between[:, place] for place, weight in enumerate(weights))
            shares += jnp.pad(share, ((k, 3 - k), (0, 0)))
        return shares, jnp.asarray(course.travel.period)

    def finish(self, carried, samples, span):
        return _bands(*map(np.asarray, samples))

    def label(self, scene, dims, values):
        data = {}
        for k, name in enumerate(self.variables):
            data[name] = column(
                (*dims, "band"),
                values[..., k],
                "m/s^2",
                "root mean square in a third octave",
            )
        return data, {"band": column("band", BANDS, "Hz", "middle of a third octave")}


def _joined(shares: Float[np.ndarray, "cases windows shares 2"]) -> Float[np.ndarray, "cases samples 2"]:
    """Return the samples of a stretch from their shares in each window, without incomplete samples at its ends."""
    cases, windows, count, _ = shares.shape
    each = count - 3
    signal = np.zeros((cases, windows * each + 3, 2))
    # the first three and the last three samples of a window are added to those of its neighbours
    for k in range(count):
        signal[:, k : k + windows * each : each] += shares[:, :, k]
    return signal[:, 3:-3]


def _bands(
    shares: Float[np.ndarray, "cases windows shares 2"], seconds: Float[np.ndarray, "cases windows"]
) -> Float[np.ndarray, "cases bands 2"]:
    """Return root mean squares in third octaves of a stretch, at its mean sampling frequency."""
    import scipy.signal  # here, because importing it takes time

    signal = _joined(shares)
    rate = SAMPLES_PER_WINDOW / seconds.mean(axis=1)  # [Hz], of each case
    count = signal.shape[1]
    # in cycles per sample; densities per cycle per sample
    frequency, density = scipy.signal.periodogram(
        signal,
        1.0,
        window="hann",
        detrend="constant",
        axis=1,
    )
    # the filter's gain is sinc(f)^4, and a density has its square
    density = density / np.sinc(frequency)[:, None] ** 8
    result = np.full((len(signal), len(BANDS), 2), np.nan)
    for k, middle in enumerate(BANDS):
        low, high = (middle * 10 ** (sign / 20) / rate for sign in (-1, 1))
        # only frequencies that are in this band for some case
        near = slice(*np.searchsorted(frequency, (low.min(), high.max())))
        inside = (frequency[near] >= low[:, None]) & (frequency[near] < high[:, None])
        # in cycles per sample: below a quarter, and wider than the resolution
        known = (high <= 0.25) & ((high - low) * count >= 1)
        square = np.sum(np.where(inside[..., None], density[:, near], 0.0), axis=1) / count
        result[:, k] = np.where(known[:, None], np.sqrt(square), np.nan)
    return result
