"""Telemetry over the model: a measured acceleration beside that of a run at the same sensor, or beside those of runs
over many rails."""

import json
import math
import os
from collections.abc import Sequence
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
from ..model.scene import Scene
from ..model.sensors import Rig, Sensor
from ..model.surveys import ALIASES
from ..results.result import Result
from ..sweeps.environment import LEAST_RATE, RELIABLE, accelerations_at, histories_of
from ..sweeps.windows import AccelerationHistory
from ..tools.checks import check_no_clock, instance, number, positive, require
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.description import describe
from ..tools.files import content_of, user_path
from ..tools.tables import Table
from ..tools.types import Real
from .measured import FEWEST, signals_of

BAND = (0.05, 0.5, 0.95)
"""Shares of rails with lower values: the ends and the middle of the model's band [1]."""
LEAST_RAILS = math.ceil(1 / BAND[0]) - 1
"""Least number of rails of a band: of fewer rails, more than a share 0.05 is expected below the lowest."""
OVERSAMPLED = 4.0
"""Least sampling rate of a record over the highest frequency [1]: a cubic spline lacks 3 % of the power there."""
CUTOFF = OVERSAMPLED / 2
"""Cutoff of the low-pass filter of both sides over the highest frequency [1]: what every record can have."""


class Record(NamedTuple):
    """A measured acceleration, without missing samples."""

    time: Float[np.ndarray, " samples"]
    """Times since the sled passed the beginning of the run [s]."""
    value: Float[np.ndarray, " samples"]
    """Readings of the sensor [m/s^2]."""
    travel: Float[np.ndarray, " samples"] | None
    """Distances along the rail [m]; None where they follow from the run's speed."""


class Side(NamedTuple):
    """One side of the comparison at equal times: the record, or the model on each rail."""

    time: Float[np.ndarray, " samples"]
    """[s]"""
    values: Float[np.ndarray, "rails samples"]
    """Readings, filtered and without a straight line [m/s^2]."""
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

    Both sides pass the same functions: `Sensor.reading` on the model's side, a cubic spline to 20 times `high` samples
    a second, a Butterworth low-pass of eighth order at twice `high`, forwards and backwards, subtraction of the
    straight line of least squares, and Hann windows of one length, whose middles are at the same places. Bands that
    one side does not resolve are NaN on both.

    **Arguments:**

    - `runs`: of `slipperjax.run` with the record "body_acceleration", as of `slipperjax.environment`: one run, or 19
        or more rails, which make a band.
    - `measured`: a CSV or netCDF file with columns `time`, the acceleration, which has the sensor's name or
        `acceleration`, and perhaps `distance` along the rail or `speed`; or a dataset with the sensor's signal. Time
        is zero, and the integral of `speed` begins, where the run does. Without both the record was where the run was
        at that time. Samples may be missing.
    - `sensor`: an accelerometer on the body.
    - `low`, `high`, `quality`, `window`: as of `slipperjax.environment`.

    **Returns:** a `Result`, with the record's numbers as `measured_density` and so on, with the model's over
    `quantile` (of rails; 0.5 for one run), and with the record over the model's middle in dB as `density_ratio`:

    - over `frequency`: `density` [(m/s^2)^2/Hz];
    - over `natural_frequency`: `shock_response` [m/s^2];
    - over `distance`, the middles of windows [m]: `rms`, the RMS in the bands up to `known_to` [Hz];
    - `total_rms` in the bands of all windows.

    With rails, `density_inside`, `shock_response_inside` and `rms_inside` are the shares of bands, frequencies and
    windows with the record inside the 5-95 % band [1]. A record of one more rail is inside with a probability of 90 %.

    **Raises:** `ValueError` for another sensor, faults of the file, a record that is sampled too slowly or does not
    overlap with the runs, and for 2 to 18 rails.
    """
    edges = check_telemetry(sensor, low=low, high=high, quality=quality, window=window)
    several = [runs] if isinstance(runs, Result | xr.Dataset) else runs
    given = [getattr(one, "ds", one) for one in several]
    name = AccelerationHistory.quantity.name
    require(all(name in ds for ds in given), "runs", f'have the record "{name}"', shown="none")
    histories, seconds, steps = histories_of(given, name)
    count = len(histories)
    require(count == 1 or count >= LEAST_RAILS, "runs", f"be one run, or {LEAST_RAILS} rails or more", count)
    first = given[0]
    scene, _ = load_base(first)
    begin = json.loads(first.attrs["call"])["begin"]
    # samples are at equal distances
    travel = float(first["distance"][0]) + first.attrs["window [m]"] * (
        np.arange(len(seconds)) / histories.shape[1] * first.sizes["distance"] - 1
    )
    record = read_record(measured, sensor, edges[-1], begin)
    # what both sides have, by which places are found: distance, or without it time
    along, ours, unit = (seconds, record.time, "s") if record.travel is None else (travel, record.travel, "m")
    inside = (ours >= along[0]) & (ours <= along[-1])
    need = f"have {FEWEST} samples or more between {along[0]:.4g} and {along[-1]:.4g} {unit} of the run"
    require(inside.sum() >= FEWEST, "measured", need, shown=f"{ours[0]:.4g} to {ours[-1]:.4g} {unit}")
    record = Record(*(None if part is None else part[inside] for part in record))
    ours = ours[inside]
    common = (along >= ours[0]) & (along <= ours[-1])
    model = _read_model(scene, sensor, histories[:, common], seconds[common], RELIABLE * steps[common], edges[-1])
    theirs = _of_record(record, edges[-1])
    place = lambda time: np.interp(time, seconds, along)
    # the record's time at places of the run
    when = lambda time: np.interp(place(time), ours, record.time)
    rate = LEAST_RATE * edges[-1]
    size = window_size(min(len(model.time), len(theirs.time)), rate, edges, window)
    densities, middles = _densities(theirs, model, when, edges, size)
    known = np.isfinite(densities[0])
    need = f"overlap the run by windows of {size / rate:.3g} s that resolve a band"
    require(known.any(), "measured", need, shown=f"{model.time[-1] - model.time[0]:.3g} s of overlap")
    known_to = np.max(np.where(known, edges[1:], 0.0), axis=-1)
    shock = np.concatenate(
        [shock_response_spectrum(side.values, rate, edges, quality=quality) for side in (theirs, model)]
    )
    density = np.ma.masked_invalid(densities).mean(axis=1).filled(np.nan)
    data = {
        **_compared("density", "frequency", density, "m^2/s^4/Hz", 10, "power spectral density"),
        **_compared(
            "shock_response",
            "natural_frequency",
            np.where(edges <= known_to.max(), shock, np.nan),
            "m/s^2",
            20,
            "greatest acceleration of an oscillator",
        ),
        **_compared("rms", "distance", band_rms(densities, edges), "m/s^2", 20, "root mean square in the bands"),
        **_compared("total_rms", "", band_rms(density, edges), "m/s^2", 20, "root mean square of all windows"),
        "known_to": column("distance", known_to, "Hz", "highest frequency of the bands"),
    }
    coords = {
        "frequency": column("frequency", np.sqrt(edges[1:] * edges[:-1]), "Hz", "middle of a band"),
        "low": ("frequency", edges[:-1]),
        "high": ("frequency", edges[1:]),
        "natural_frequency": column("natural_frequency", edges, "Hz", "natural frequency"),
        "distance": column("distance", np.interp(middles, seconds, travel), "m", "distance travelled"),
        "quantile": column("quantile", list(_shares(count)), "1", "share of the rails below"),
    }
    # the status of a run is not the status of a comparison
    kept = {name: value for name, value in first.attrs.items() if not name.startswith("status")}
    file = None if isinstance(measured, xr.Dataset) else str(measured)
    call = dict(function="telemetry", measured=file, sensor=sensor, low=low, high=high, quality=quality, window=window)
    done = {"rails": count, "rate [Hz]": rate, "cutoff [Hz]": CUTOFF * edges[-1], "window of densities [s]": size / rate}
    return Result(xr.Dataset(data, coords, kept | done | {"call": json.dumps(describe(call))}))


def check_telemetry(
    sensor: Sensor, *, low: Real = 20.0, high: Real = 2000.0, quality: Real = 10.0, window: Real | None = None
) -> Float[np.ndarray, " edges"]:
    """Return the edges of bands [Hz]; check the arguments of `telemetry`, also before a long run."""
    instance("sensor", sensor, Sensor, "a slipperjax.model.Sensor")
    require(sensor.measures == "acceleration", "sensor", "measure acceleration", sensor.measures)
    check_quality(quality)
    if window is not None:
        number(positive, "window", window, "s")
    return band_edges(low, high)


def read_record(
    measured: str | os.PathLike[str] | xr.Dataset, sensor: Sensor, high: float, begin: float = 0.0
) -> Record:
    """Return a measured acceleration, see `telemetry`.

    **Arguments:** `high`: highest frequency that the record must have [Hz]; `begin`: of the run along the rail [m].

    **Raises:** `ValueError` with all faults of a file, and for a record that is sampled too slowly.
    """
    if isinstance(measured, xr.Dataset):
        found = signals_of(measured, Rig((sensor,)))[0]
        require(found, "measured", f"have a signal of {sensor.name}", shown="none")
        columns = dict(zip(("time", "acceleration"), found[sensor.name], strict=True))
    else:
        columns = _columns(measured, sensor)
    good = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    require(good.sum() >= FEWEST, "measured", f"have {FEWEST} samples or more", shown=str(good.sum()))
    columns = {key: values[good] for key, values in columns.items()}
    time = columns["time"]
    check_no_clock("measured", time)
    rate = 1 / np.median(np.diff(time))
    need = f"have {OVERSAMPLED * high:g} samples a second or more for bands up to {high:g} Hz"
    require(rate >= OVERSAMPLED * high * (1 - 1e-6), "measured", need, shown=f"{rate:.6g}")
    travel = columns.get("distance")
    if travel is None and "speed" in columns:
        from scipy.integrate import cumulative_trapezoid  # here, because importing it takes time

        travel = cumulative_trapezoid(columns["speed"], time, initial=0.0)
        # the record may begin before or after the run
        travel += begin - np.interp(0.0, time, travel) + columns["speed"][0] * max(time[0], 0.0)
    back = travel is not None and bool(np.any(np.diff(travel) < 0))
    require(not back, "measured", "have a distance that never falls, or a speed that is never below zero", shown="one")
    return Record(time, columns["acceleration"], travel)


def _columns(file: str | os.PathLike[str], sensor: Sensor) -> dict[str, np.ndarray]:
    """Return the columns of a file in SI units, time and the sensor's acceleration among them."""
    path = user_path(file, "measured")
    wanted = {"time": "s", "acceleration": sensor.unit, "distance": "m", "speed": "m/s"}
    others = {"t": "time", "seconds": "time", "velocity": "speed", "v": "speed"}
    others |= dict.fromkeys(("a", sensor.name.lower()), "acceleration")
    table = Table(path, content_of(path), wanted, ALIASES | others, holes=True)
    if "acceleration" not in table.columns:
        table.fault(f"must have a column `{sensor.name}` or `acceleration`")
    if "time" in table.columns:
        table.check_rising("time")
    else:
        table.fault("must have a column `time`")
    return table.si()


def _read_model(
    scene: Scene, sensor: Sensor, histories: np.ndarray, seconds: np.ndarray, highest: np.ndarray, high: float
) -> Side:
    """Return what the sensor reads in runs; arguments as of `histories_of`, and as of `Side` for `highest`."""
    axis = np.asarray(sensor.direction / np.linalg.norm(sensor.direction))
    at = np.asarray(sensor.place)[None]
    signals = np.concatenate([axis @ accelerations_at(scene, one[None], at)[0] for one in histories])
    rate = LEAST_RATE * high
    equal, reliable = resample_reliably(seconds, signals, rate, highest)
    time = seconds[0] + np.arange(equal.shape[-1]) / rate
    return Side(time, _filtered(np.asarray(_readings(sensor, equal, time)), rate, high), reliable)


@jit
def _readings(sensor: Sensor, signals: jax.Array, time: jax.Array) -> jax.Array:
    return jax.vmap(lambda signal: sensor.reading(signal, time, time))(signals)


def _of_record(record: Record, high: float) -> Side:
    """Return a record at equal times, straight across gaps, where only low frequencies are reliable."""
    gaps = np.diff(record.time)
    typical = np.median(gaps)
    # a spline across a gap would swing far out
    parts = np.where(gaps > 2 * typical, np.ceil(gaps / typical), 1).astype(int)
    before = np.repeat(np.arange(len(gaps)), parts)
    within = np.arange(len(before)) - np.repeat(np.cumsum(parts) - parts, parts)
    time = np.append(record.time[before] + gaps[before] * within / parts[before], record.time[-1])
    highest = np.append(0.25 / gaps[before], np.inf)
    rate = LEAST_RATE * high
    equal, reliable = resample_reliably(time, np.interp(time, record.time, record.value), rate, highest)
    return Side(time[0] + np.arange(len(equal)) / rate, _filtered(equal[None], rate, high), reliable)


def _filtered(values: Float[np.ndarray, "rails samples"], rate: float, high: float) -> np.ndarray:
    """Return values at `rate` [Hz] without frequencies that a record may lack, and without a straight line."""
    from scipy.signal import butter, detrend, sosfiltfilt  # here, because importing it takes time

    # the line first, because the filter continues values beyond their ends
    return detrend(sosfiltfilt(butter(8, CUTOFF * high, fs=rate, output="sos"), detrend(values)))


def _densities(record: Side, model: Side, when, edges: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return densities (sides, windows, bands), the record's first, and the middles of windows [s].

    **Arguments:** `when`: the record's time at the places of the model at some times [s].
    """
    rate = LEAST_RATE * edges[-1]
    half = (size - 1) / 2 / rate
    starts = window_starts(len(model.time), size)
    middles = model.time[starts] + half
    first = np.rint((when(middles) - half - record.time[0]) * rate).astype(int)
    first = np.clip(first, 0, len(record.time) - size)
    found = []
    for ours, theirs in zip(first, starts, strict=True):
        a, b = (slice(start, start + size) for start in (ours, theirs))
        # both sides as rows of one array
        rows = np.concatenate([record.values[:, a], model.values[:, b]])
        highest = np.minimum(record.highest[a], model.highest[b])
        found.append(window_densities(rows, rate, edges, window=size / rate, highest=highest)[1][:, 0])
    return np.stack(found, axis=1), middles


def _shares(rails: int) -> tuple[float, ...]:
    return BAND if rails > 1 else (0.5,)


def _compared(name: str, dim: str, values: np.ndarray, unit: str, decibels: float, text: str) -> dict[str, object]:
    """Return variables that compare the record, in the first row of `values`, with the model on each rail.

    **Arguments:** `dim`: dimension of the columns of `values`, empty for none; `decibels`: of a factor of ten.
    """
    over = (dim,) if dim else ()
    record, *model = values
    # quantiles that a further rail does not exceed with just their probabilities
    shares = _shares(len(model))
    found = np.quantile(model, shares, axis=0, method="weibull")
    ratio = decibels * np.log10(record / found[len(shares) // 2])
    data = {
        f"measured_{name}": column(over, record, unit, f"{text}, of the record"),
        name: column(("quantile", *over), found, unit, f"{text}, of the model"),
        f"{name}_ratio": column(over, ratio, "dB", f"{text}, record over the model's median"),
    }
    if len(shares) > 1 and dim:
        known = np.isfinite(record) & np.isfinite(found[1])
        within = np.mean(((found[0] <= record) & (record <= found[-1]))[known])
        data[f"{name}_inside"] = column((), within, "1", f"share inside the model's 5-95 % band: {text}")
    return data
