"""The vibration environment of places on a sled, from its runs: the numbers in a test report on a payload."""

import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.environment import Envelope, VibrationEnvironment, band_edges, check_quality, vibration_environment
from ..analysis.specification import rms_of_lines, straight_lines
from ..flow.datasets import load_base
from ..flow.status import MEANINGS, is_lost, texts_of_status
from ..model.scene import Scene
from ..results.result import Result
from ..tools.checks import finite, number, positive, require, tuple_of, warn
from ..tools.columns import column
from ..tools.description import describe
from ..tools.files import listed
from ..tools.types import Numbers, Real
from .windows import AccelerationHistory, begins, speeds_along

HISTORY = AccelerationHistory.quantity.name
DIRECTIONS = ("x", "y", "z")
LEAST_RATE = 20.0
"""Least sampling rate over the highest frequency [1]; with it the error of the shock response is within 2 %."""
RELIABLE = 0.25
"""Highest frequency of a density over the rate of integration steps [1]: cubics lose higher ones, see the docs."""


def environment(
    runs: Result | xr.Dataset | Sequence[Result | xr.Dataset],
    places: Numbers,
    *,
    low: Real = 20.0,
    high: Real = 2000.0,
    quality: Real = 10.0,
    window: Real | None = None,
    margin: Real = 0.0,
) -> Result:
    """Return the vibration environment of places on a slipper or a sled, over the rails of some runs.

    ```python
    runs = sj.run(scene, {"track.seed": range(200)}, length=400.0, record=["peak_force", "body_acceleration"])
    report = sj.environment(runs, places=[(0.5, 0.0, 0.4)])
    ```

    **Arguments:**

    - `runs`: of `slipperjax.run` with the record "body_acceleration", over one parameter such as the rail's seed; or
        one run, or several runs of one speed. Lost runs are left out, and doubtful runs count, with a warning.
    - `places`: x, y and z from the centre of mass, (places, 3) [m]; on an elastic sled, places of its modes.
    - `low`, `high`: least and highest frequency [Hz], in sixth octaves; `quality`: Q of the oscillators of the shock
        response [1]; `window`: length of the windows of time of a density [s], by default the least length that
        resolves the lowest band; `margin`: of the specification over the greatest density [dB].

    **Returns:** a `Result` over `rail`, `place` and `direction` (x, y, z of the body) with

    - over `rail` the `status` of each run that is not lost, and may be doubtful;
    - over `frequency`, the middles of bands: `density`, the power spectral density by Welch's method, and
      `maximax_density`, the greatest of all windows [(m/s^2)^2/Hz];
    - over `natural_frequency`: `shock_response`, the greatest acceleration of oscillators [m/s^2];
    - of the whole record, also while the sled is at rest: `rms` of all frequencies and `band_rms` of the bands;
      `maximax_rms`, the greatest of a density's windows, in the bands [m/s^2]; `duration` for which the running
      `level` [m/s^2] over `seconds` is within 6 dB of its greatest value [s];
    - of densities and shock response over `summary`, their `maximum`, mean and 95/50 tolerance `limit`, without
      `rail`: `density_envelope`, `maximax_envelope` and `shock_envelope`;
    - over `breakpoint` the straight-line specification, `margin` above the greatest `maximax_density` of all rails,
      without `rail`: `specification_frequency` [Hz] and `specification_density` [(m/s^2)^2/Hz], NaN after the last
      breakpoint; `specification_rms` is the root mean square under these lines [m/s^2], see
      `slipperjax.analysis.straight_lines`. It is NaN where fewer than two densities are known, and zero where nothing
      moves.

    Windows at the beginning or the end of runs may be removed before, as by `runs.isel(distance=slice(50, None))`.
    Directions do not include the attitude's angle, some milliradians. Densities above a quarter of the rate of
    integration steps, or of samples, are NaN, with a warning: their error is 4 % there, and more at higher
    frequencies.

    **Raises:** `ValueError` for runs without the record, places that the modes do not have, runs of different
    speeds, and if all runs are lost.
    """
    given = with_histories(runs)
    scene, _ = load_base(given[0])
    at, edges = check_environment(scene, places, low=low, high=high, quality=quality, window=window, margin=margin)
    histories, seconds, steps, status = histories_of(given)
    intervals = np.diff(seconds)
    least = LEAST_RATE * edges[-1]
    rate = max(1 / float(np.median(intervals)), least)
    # at constant speed samples are at equal times, and are used directly where they are dense enough
    equal = np.ptp(intervals) < 1e-9 * intervals.sum() and rate > least
    found = vibration_environment(
        accelerations_at(scene, histories, at),
        rate,
        time=None if equal else seconds,
        highest=RELIABLE * steps,
        edges=edges,
        quality=quality,
        window=window,
    )
    shortest = float(intervals.min()) * histories.shape[1] / given[0].sizes["distance"]
    _warn_of_unknown(found, shortest)
    # the environment has a status of each run
    known = {name: value for name, value in given[0].attrs.items() if not name.startswith("status")}
    call = dict(function="environment", places=at, low=low, high=high, quality=quality, window=window, margin=margin)
    speeds = speeds_along(given[0]).values
    ends = {"lowest speed [m/s]": float(speeds.min()), "highest speed [m/s]": float(speeds.max())}
    averaged = {"window of densities [s]": 2 * float(found.time[0]), "windows of densities": len(found.time)}
    made = _dataset(found, at).assign(status=column("rail", status, "", "status of each run", meaning=MEANINGS))
    made = made.assign(_specification(made, float(margin)))
    return Result(made.assign_attrs(known, **ends, **averaged, call=json.dumps(describe(call))))


def with_histories(runs: Result | xr.Dataset | Sequence[Result | xr.Dataset]) -> tuple[xr.Dataset, ...]:
    """Return the datasets of one run or several, which must have accelerations."""
    need = f'results of slipperjax.run with the record "{HISTORY}"'
    several = (runs,) if isinstance(runs, Result | xr.Dataset) else tuple_of("runs", runs, (Result, xr.Dataset), need)
    given = tuple(one.ds if isinstance(one, Result) else one for one in several)
    require(given, "runs", "be one run or more", runs)
    for one in given:
        require(HISTORY in one, "runs", f"be {need}", shown="others")
    return given


def _warn_of_unknown(found: VibrationEnvironment, shortest: float) -> None:
    """Warn where densities are unknown from a frequency on, or in all bands, and say what they need.

    **Arguments:** `shortest`: the least time in a window of distance [s].
    """
    known = np.asarray(np.isfinite(found.density).any(axis=(0, 1, 2)))
    if known[-1]:
        return
    lasts, needed = 2 * float(found.time[0]), 1 / float(np.diff(found.edges).max())
    if known.any():
        begin = f"Densities end at {found.edges[1:][known].max():.4g} Hz: more need"
    else:
        begin = f"No density is known from {found.edges[0]:.4g} to {found.edges[-1]:.4g} Hz: bands need"
    # the widest band is the last to be resolved by windows that are too short
    if lasts < needed:
        need = f"windows of {needed:.3g} s or more, but have {lasts:.3g} s; give a longer run or another `window`"
    else:
        steps = math.ceil(found.edges[-1] / RELIABLE * shortest)
        more = "give more `steps_per_period` or `refine` and an `AccelerationHistory`"
        need = f"{steps} steps and samples a window or more, {more}"
    warn(f"{begin} {need}.")


def _specification(ds: xr.Dataset, margin: float) -> dict[str, object]:
    """Return the variables of straight lines above the greatest densities of all rails and windows."""
    most = ds["maximax_envelope"].sel(summary="maximum", drop=True).transpose("place", "direction", "frequency")
    lines = {}
    rms = np.full(most.shape[:2], np.nan)
    for at in np.ndindex(most.shape[:2]):
        density = most.values[at]
        # along x nothing moves, and some bands may be unknown
        known = np.isfinite(density) & (density > 0)
        if (density == 0).any() and not known.any():
            rms[at] = 0.0
        if known.sum() >= 2:
            lines[at] = straight_lines(ds["frequency"].values[known], density[known], margin=margin)
    count = max((len(frequency) for frequency, _ in lines.values()), default=0)
    joined = np.full((2, *most.shape[:2], count), np.nan)
    for at, points in lines.items():
        joined[:, *at, : len(points[0])] = points
        rms[at] = rms_of_lines(*points)
    dims = ("place", "direction", "breakpoint")
    text = f"straight-line specification, {margin:g} dB above the greatest density of {ds.sizes['rail']} runs"
    return {
        "specification_frequency": column(dims, joined[0], "Hz", f"frequency of the {text}"),
        "specification_density": column(dims, joined[1], "m^2/s^4/Hz", f"density of the {text}"),
        "specification_rms": column(dims[:2], rms, "m/s^2", f"root mean square of the {text}"),
    }


def check_environment(
    scene: Scene,
    places: Numbers,
    *,
    low: Real = 20.0,
    high: Real = 2000.0,
    quality: Real = 10.0,
    window: Real | None = None,
    margin: Real = 0.0,
) -> tuple[Float[np.ndarray, "places 3"], Float[np.ndarray, " edges"]]:
    """Return places [m] and edges of bands [Hz]; check the arguments of `environment`, also before a long run."""
    at = np.asarray(finite("places", "m")(places), float)
    require(at.size and at.shape[-1] == 3, "places", "have x, y and z", shown=f"of shape {at.shape}")
    at = at.reshape(-1, 3)
    if scene.slipper.modes is not None:
        for place in at:
            scene.slipper.modes.check_place(place)
    check_quality(quality)
    if window is not None:
        number(positive, "window", window, "s")
    number(finite, "margin", margin, "dB")
    return at, band_edges(low, high)


class Histories(NamedTuple):
    """Histories of all runs that are not lost."""

    values: Float[np.ndarray, "rails samples components"]
    """Components of `AccelerationHistory` [their units]."""
    seconds: Float[np.ndarray, " samples"]
    """Times of samples [s]."""
    steps: Float[np.ndarray, " samples"]
    """Rate of integration steps at these times, the least of all runs [Hz]."""
    status: Int[np.ndarray, " rails"]
    """`Status` of each run, which may be doubtful."""


def histories_of(runs: Sequence[xr.Dataset]) -> Histories:
    """Return the histories of all runs that are not lost. Warnings name lost and doubtful runs."""
    rows = []
    codes = []
    steps = []
    for ds in runs:
        over = [str(name) for name in ds["status"].dims]
        require(len(over) <= 1, "runs", "be over one parameter at most", shown=f"over {', '.join(over)}")
        values = ds[HISTORY].transpose(..., "distance", "sample", "component").values
        status = np.atleast_1d(ds["status"].values)
        good = ~is_lost(status)
        codes += list(status[good])
        rows += list(values.reshape(-1, *values.shape[-3:])[good])
        steps.append(ds["steps_per_window"].min(ds["status"].dims).values)
        if not np.all(good):
            warn(f"{np.sum(~good)} of {len(good)} runs are lost, and left out.")
    require(rows, "runs", "have one that is not lost", shown="none")
    for text in texts_of_status(np.array(codes)):
        warn(f"Doubtful runs count: {text}.")
    first = runs[0]
    seconds = first["seconds"].values
    alike = seconds.ndim == 1 and all(np.array_equal(ds["seconds"].values, seconds) for ds in runs)
    require(alike, "runs", "have the same speeds", shown="different ones")
    shapes = {row.shape for row in rows}
    require(len(shapes) == 1, "runs", "have the same samples", shown=listed([str(shape) for shape in sorted(shapes)]))
    ends = np.append(begins(first).values, seconds)
    samples = rows[0].shape[1]
    rate = np.min(steps, axis=0) / np.diff(ends)
    joined = np.stack([row.reshape(-1, row.shape[-1]) for row in rows])
    return Histories(joined, sample_times(ends, samples), np.repeat(rate, samples), np.array(codes))


def sample_times(ends: np.ndarray, samples: int) -> np.ndarray:
    """Return the times of samples at equal distances within windows [s], from the times at the ends of windows."""
    from scipy.interpolate import PchipInterpolator

    places = np.arange((len(ends) - 1) * samples) / samples
    return PchipInterpolator(np.arange(len(ends)), ends)(places)


def accelerations_at(scene: Scene, histories: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return accelerations of places on the body along its axes [m/s^2], (rails, places, directions, samples)."""
    # in the order of `AccelerationHistory`: a_y and a_z, three alpha, three w, and the modes
    across, angular, spin, modal = np.split(histories[:, None], [2, 5, 8], axis=-1)
    # the speed along x is prescribed
    of_centre = np.insert(across, 0, 0.0, axis=-1)
    arms = places[:, None]
    total = of_centre + np.cross(angular, arms) + np.cross(spin, np.cross(spin, arms))
    modes = scene.slipper.modes
    if modes is not None:
        total = total + modal @ np.stack([np.asarray(modes.shape_at(place)) for place in places])
    return np.moveaxis(total, -1, 2)


def _dataset(found: VibrationEnvironment, places: np.ndarray) -> xr.Dataset:
    """Label the results of `vibration_environment`."""
    of_rails = ("rail", "place", "direction")
    of_all = ("summary", "place", "direction")
    natural = "natural_frequency"
    density, acceleration = "m^2/s^4/Hz", "m/s^2"
    middles = np.sqrt(found.edges[1:] * found.edges[:-1])
    text = "power spectral density"
    data = {
        "density": column((*of_rails, "frequency"), found.density, density, f"{text} of the acceleration"),
        "maximax_density": column(
            (*of_rails, "frequency"), found.maximax, density, f"greatest {text} of all windows of time"
        ),
        "shock_response": column(
            (*of_rails, natural), found.shock_response, acceleration, "greatest acceleration of an oscillator"
        ),
        "rms": column(of_rails, found.rms, acceleration, "root mean square of the acceleration"),
        "band_rms": column(of_rails, found.band_rms, acceleration, "root mean square in the bands"),
        "maximax_rms": column(of_rails, found.maximax_rms, acceleration, "greatest of a window in the bands"),
        "level": column((*of_rails, "seconds"), found.level, acceleration, "running root mean square"),
        "duration": column(of_rails, found.duration, "s", "time within 6 dB of the greatest level"),
        "density_envelope": column(
            (*of_all, "frequency"), np.stack(found.density_envelope), density, f"{text} over rails"
        ),
        "maximax_envelope": column(
            (*of_all, "frequency"), np.stack(found.maximax_envelope), density, f"greatest {text} of rails"
        ),
        "shock_envelope": column(
            (*of_all, natural), np.stack(found.shock_envelope), acceleration, "shock response over rails"
        ),
    }
    coords = {
        "frequency": column("frequency", middles, "Hz", "middle of a band"),
        natural: column(natural, found.edges, "Hz", "natural frequency"),
        "seconds": column("seconds", found.level_time, "s", "time"),
        "direction": list(DIRECTIONS),
        "summary": list(Envelope._fields),
        **{axis: column("place", places[:, k], "m", f"{axis} of the place") for k, axis in enumerate(DIRECTIONS)},
        "low": ("frequency", found.edges[:-1]),
        "high": ("frequency", found.edges[1:]),
    }
    return xr.Dataset(data, coords)
