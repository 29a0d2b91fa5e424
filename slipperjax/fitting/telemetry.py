"""Telemetry over the model: a measured acceleration beside that of a run at the same sensor, or beside those of runs
over many rails."""

import json
import math
import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..analysis.environment import (
    band_edges,
    band_rms,
    check_quality,
    resample_reliably,
    shock_response_spectrum,
    window_densities,
    window_size,
    window_starts,
)
from ..flow.datasets import load_base
from ..flow.status import MEANINGS
from ..model.scene import Scene
from ..model.sensors import Sensor
from ..orbits.simulate import beginning_of
from ..results.result import Result
from ..sweeps.environment import LEAST_RATE, RELIABLE, accelerations_at, histories_of, with_histories
from ..tools.checks import instance, number, positive, require
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.description import describe
from ..tools.types import Real
from .accelerations import OVERSAMPLED, Record, read_record

BAND = (0.05, 0.5, 0.95)
"""Shares of rails with lower values: the ends and the middle of the model's band [1]."""
LEAST_RAILS = math.ceil(1 / BAND[0]) - 1
"""Least number of rails of a band: a record of one more rail is below the lowest of n rails with a probability of
1 / (n + 1)."""
CUTOFF = OVERSAMPLED / 2
"""Cutoff of the low-pass filter of both sides over the highest frequency [1]: all records reach it."""


class Side(NamedTuple):
    """One side of the comparison at equal times: the record, or the model on each rail."""

    time: Float[np.ndarray, " samples"]
    """[s]"""
    values: Float[np.ndarray, "rails samples"]
    """Readings [m/s^2]."""
    highest: Float[np.ndarray, " samples"]
    """Frequency up to which each sample is reliable [Hz]."""


def telemetry(
    runs: Result | xr.Dataset | Sequence[Result | xr.Dataset],
    measured: str | os.PathLike[str] | xr.Dataset,
    sensor: Sensor,
    *,
    low: Real = 20.0,
    high: Real = 2000.0,
    quality: Real = 10.0,
    window: Real | None = None,
) -> Result:
    """Lay a measured acceleration over that of the model at the same sensor: density, shock response, RMS.

    ```python
    scene, rails = sj.sweeps.on_rails(scene, 32)
    runs = sj.run(scene, rails, product=False, length=400.0, record="body_acceleration")
    report = telemetry(runs, "record.csv", sensor)
    ```

    The model's side passes `Sensor.reading`. Then both sides pass the same functions: a cubic spline to 20 times
    `high` samples a second; a Butterworth low-pass of eighth order at twice `high`, forwards and backwards;
    subtraction of the straight line of least squares; Hann windows of one length, whose middles are at the same
    places. Bands that one side does not resolve are NaN on both sides.

    **Arguments:**

    - `runs`: of `slipperjax.run` with the record "body_acceleration", as of `slipperjax.environment`: one run, or 19
        rails or more, which make a band.
    - `measured`: a CSV or netCDF file with columns `time`, the acceleration, which has the sensor's name or
        `acceleration`, and perhaps `distance` along the rail or `speed`; or a dataset with the sensor's signal. Time
        is zero where the run begins. With neither distance nor speed the record was where the run is at each time.
        Samples may be missing.
    - `sensor`: an accelerometer on the body.
    - `low`, `high`, `quality`, `window`: as of `slipperjax.environment`.

    **Returns:** a `Result`. Variables such as `measured_density` are the record's; `density` is the model's over
    `quantile` of the rails, which is 0.5 for one run; `density_ratio` is the record over the model's median [dB].

    - over `frequency`, the middles of bands: `density` [(m/s^2)^2/Hz];
    - over `natural_frequency`: `shock_response` [m/s^2];
    - over `distance`, the middles of windows [m]: `rms` in the bands up to `known_to` [Hz], in m/s^2;
    - `total_rms` of all windows [m/s^2];
    - over `rail` the `status` of each run that is not lost, and may be doubtful.

    With rails `density_inside`, `shock_response_inside` and `rms_inside` are the shares of bands, frequencies and
    windows in which the record is inside the 5-95 % band [1]; for one more rail of the same kind 90 % on average.

    **Raises:** `ValueError` for another sensor, faults of the file, a record that is sampled too slowly or does not
    overlap with the runs, and for 2 to 18 rails.
    """
    given = with_histories(runs)
    histories, seconds, steps, status = histories_of(given)
    rails = len(histories)
    edges = _check(sensor, rails, low, high, quality, window)
    first = given[0]
    scene, _ = load_base(first)
    # samples are at equal distances
    share = np.arange(len(seconds)) / len(seconds)
    ends = first["distance"].values[[0, -1]] - [first.attrs["window [m]"], 0.0]
    travel = ends[0] + share * np.ptp(ends)
    record = read_record(measured, sensor, edges[-1], json.loads(first.attrs["call"])["begin"])
    along = seconds if record.travel is None else travel
    record = record.within(along[0], along[-1])
    theirs, _ = record.along
    both = (along >= theirs[0]) & (along <= theirs[-1])
    model = _of_model(scene, sensor, histories[:, both], seconds[both], RELIABLE * steps[both], edges[-1])
    # the record's time where the run is at a time
    when = lambda time: np.interp(np.interp(time, seconds, along), theirs, record.time)
    sides = _of_record(record, edges[-1]), model
    rate = LEAST_RATE * edges[-1]
    size = window_size(min(len(side.time) for side in sides), rate, edges, window)
    densities, middles = _densities(*sides, when, edges, size)
    need = f"overlap with the run for longer, because windows of {size / rate:.3g} s resolve no band"
    require(np.isfinite(densities[0]).any(), "measured", need, shown=f"there for {np.ptp(model.time):.3g} s")
    shock = np.concatenate([shock_response_spectrum(side.values, rate, edges, quality=quality) for side in sides])
    data = _variables(densities, shock, edges)
    data["status"] = column("rail", status, "", "status of each run", meaning=MEANINGS)
    coords = {
        "frequency": column("frequency", np.sqrt(edges[1:] * edges[:-1]), "Hz", "middle of a band"),
        "low": ("frequency", edges[:-1]),
        "high": ("frequency", edges[1:]),
        "natural_frequency": column("natural_frequency", edges, "Hz", "natural frequency"),
        "distance": column("distance", np.interp(middles, seconds, travel), "m", "distance travelled"),
        "quantile": column("quantile", list(_shares(rails)), "1", "share of the rails below"),
    }
    # the comparison has a status of each run
    kept = {name: value for name, value in first.attrs.items() if not name.startswith("status")}
    file = None if isinstance(measured, xr.Dataset) else str(measured)
    asked = dict(measured=file, sensor=sensor, low=low, high=high, quality=quality, window=window)
    call = json.dumps(describe(dict(function="telemetry", **asked)))
    done = {"rate [Hz]": rate, "cutoff [Hz]": CUTOFF * edges[-1], "window of densities [s]": size / rate}
    return Result(xr.Dataset(data, coords, kept | done | {"rails": rails, "call": call}))


def _variables(densities: np.ndarray, shock: np.ndarray, edges: np.ndarray) -> dict[str, object]:
    """Return the variables of `telemetry`; arguments: densities and shock responses, the record's first."""
    known_to = np.max(np.where(np.isfinite(densities[0]), edges[1:], 0.0), axis=-1)
    shock = np.where(edges <= known_to.max(), shock, np.nan)
    density = np.ma.masked_invalid(densities).mean(axis=1).filled(np.nan)
    unit, natural = "m/s^2", ("natural_frequency",)
    return {
        **compared("density", ("frequency",), density, "m^2/s^4/Hz", 10, "power spectral density"),
        **compared("shock_response", natural, shock, unit, 20, "greatest acceleration of an oscillator"),
        **compared("rms", ("distance",), band_rms(densities, edges), unit, 20, "RMS in the bands"),
        **compared("total_rms", (), band_rms(density, edges), unit, 20, "RMS in the bands of all windows"),
        "known_to": column("distance", known_to, "Hz", "highest frequency of the bands"),
    }


def check_telemetry(
    scene: Scene,
    measured: str | os.PathLike[str] | xr.Dataset,
    sensor: Sensor,
    *,
    length: Real,
    begin: Real | None = None,
    rails: int = 1,
    low: Real = 20.0,
    high: Real = 2000.0,
    quality: Real = 10.0,
    window: Real | None = None,
) -> None:
    """Check the arguments of `telemetry` before long runs over `length` [m] from `begin` [m] on `rails`."""
    edges = _check(sensor, rails, low, high, quality, window)
    origin = float(beginning_of(scene, begin))
    record = read_record(measured, sensor, edges[-1], origin)
    ends = origin + np.array([0.0, length])
    if record.travel is None:
        ends = np.asarray(scene.seconds(ends / scene.wavelength))
        ends = ends - ends[0]
    lasts = np.ptp(record.within(*ends.tolist()).time)
    least = 1 / np.diff(edges).max()
    require(
        lasts >= least,
        "measured",
        f"overlap with the run for {least:.3g} s or more",
        shown=f"there for {lasts:.3g} s",
    )


def _check(
    sensor: Sensor, rails: int, low: Real, high: Real, quality: Real, window: Real | None
) -> Float[np.ndarray, " edges"]:
    """Return the edges of bands [Hz]; check other arguments of `telemetry`."""
    instance("sensor", sensor, Sensor, "a slipperjax.model.Sensor")
    require(sensor.measures == "acceleration", "sensor", "measure acceleration", sensor.measures)
    require(rails == 1 or rails >= LEAST_RAILS, "rails", f"be 1, or {LEAST_RAILS} or more for a band", rails)
    check_quality(quality)
    if window is not None:
        number(positive, "window", window, "s")
    return band_edges(low, high)


def _of_model(
    scene: Scene, sensor: Sensor, histories: np.ndarray, seconds: np.ndarray, highest: np.ndarray, high: float
) -> Side:
    """Return what a sensor reads in runs; arguments as of `histories_of`, and `highest` as of `Side`."""
    axis = np.asarray(sensor.direction / np.linalg.norm(sensor.direction))
    place = np.asarray(sensor.place)[None]
    # one rail after the other, because the accelerations along all axes need much memory
    signals = np.concatenate([axis @ accelerations_at(scene, one[None], place)[0] for one in histories])
    time, values, highest = _at_equal_times(seconds, signals, high, highest)
    # a delayed reading needs the signal from before
    since = time - float(sensor.delay)
    known = (since >= time[0]) & (since <= time[-1])
    read = np.asarray(_readings(sensor, values, time, time[known]))
    return Side(time[known], _filtered(read), highest[known])


@jit
def _readings(sensor: Sensor, signals: jax.Array, time: jax.Array, at: jax.Array) -> jax.Array:
    return jax.vmap(lambda signal: sensor.reading(signal, time, at))(signals)


def _of_record(record: Record, high: float) -> Side:
    """Return a record, with its mean in its gaps, where only low frequencies are reliable."""
    gaps = np.diff(record.time)
    typical = np.median(gaps)
    # a spline across a gap would swing far out, and a line between two samples would be a pulse
    parts = np.where(gaps > 2 * typical, np.ceil(gaps / typical), 1).astype(int)
    before = np.repeat(np.arange(len(gaps)), parts)
    within = np.arange(len(before)) - np.repeat(np.cumsum(parts) - parts, parts)
    time = np.append(record.time[before] + gaps[before] * within / parts[before], record.time[-1])
    values = np.append(np.where(within, record.value.mean(), record.value[before]), record.value[-1])[None]
    time, values, highest = _at_equal_times(time, values, high, np.append(0.25 / gaps[before], np.inf))
    return Side(time, _filtered(values), highest)


def _at_equal_times(time: np.ndarray, values: np.ndarray, high: float, highest: np.ndarray) -> Side:
    rate = LEAST_RATE * high
    equal, reliable = resample_reliably(time, values, rate, highest)
    return Side(time[0] + np.arange(equal.shape[-1]) / rate, equal, reliable)


def _filtered(values: Float[np.ndarray, "rails samples"]) -> np.ndarray:
    """Return values at equal times without frequencies that a record may lack, and without a straight line."""
    from scipy.signal import butter, detrend, sosfiltfilt  # here, because importing it takes time

    low_pass = butter(8, 2 * CUTOFF / LEAST_RATE, output="sos")
    # before the filter, too, because it continues values beyond their ends
    return detrend(sosfiltfilt(low_pass, detrend(values)))


def _densities(
    record: Side, model: Side, when: Callable[[np.ndarray], np.ndarray], edges: np.ndarray, size: int
) -> tuple[Float[np.ndarray, "sides windows bands"], Float[np.ndarray, " windows"]]:
    """Return densities, the record's first, and the middles of windows in the run's time [s].

    **Arguments:** `when`: returns the record's time where the run is at some times [s]; `size`: samples in a window.
    """
    rate = LEAST_RATE * edges[-1]
    half = (size - 1) / 2 / rate
    of_model = window_starts(len(model.time), size)
    middles = model.time[of_model] + half
    of_record = np.rint((when(middles) - half - record.time[0]) * rate).astype(int)
    found = []
    for ours, theirs in zip(np.clip(of_record, 0, len(record.time) - size), of_model, strict=True):
        a, b = (slice(start, start + size) for start in (ours, theirs))
        # both sides are rows of one array, and pass the same function
        rows = np.concatenate([record.values[:, a], model.values[:, b]])
        highest = np.minimum(record.highest[a], model.highest[b])
        found.append(window_densities(rows, rate, edges, window=size / rate, highest=highest)[1][:, 0])
    return np.stack(found, axis=1), middles


def _shares(rails: int) -> tuple[float, ...]:
    """Return the quantiles of the model."""
    return BAND if rails > 1 else (0.5,)


def compared(
    name: str, dims: tuple[str, ...], values: np.ndarray, unit: str, decibels: int, text: str
) -> dict[str, object]:
    """Return variables that compare the record, in the first row of `values`, with the model, in a row for each rail.

    **Arguments:** `decibels`: of a factor of ten [dB].
    """
    record, *model = values
    shares = _shares(len(model))
    # by this method a share of one more rail is expected below each quantile
    found = np.quantile(model, shares, axis=0, method="weibull")
    # a model without any motion, such as that of the centre along x, gives no ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = decibels * np.log10(record / found[len(shares) // 2])
    data = {
        f"measured_{name}": column(dims, record, unit, f"{text}, record"),
        name: column(("quantile", *dims), found, unit, f"{text}, model"),
        f"{name}_ratio": column(dims, ratio, "dB", f"{text}, record over the model's median"),
    }
    if len(shares) > 1 and dims:
        inside = ((found[0] <= record) & (record <= found[-1]))[np.isfinite(ratio)]
        data[f"{name}_inside"] = column((), inside.mean(), "1", f"share inside the model's 5-95 % band: {text}")
    return data
