"""Vibration environment of a payload: spectral density, RMS, shock response, level over time, and tolerance limits.

As in reports of tests: NASA-HDBK-7005 (*Dynamic environmental criteria*, 2001) and MIL-STD-810H, Method 514.
Accelerations are arrays (..., samples) in m/s^2; the leading axes are rails, places, directions. Densities are in
(m/s^2)^2/Hz, and divided by the square of `STANDARD_GRAVITY` in g^2/Hz.
"""

import math
from typing import NamedTuple

import numpy as np

from ..tools.checks import finite, number, numbers, positive, require, whole
from ..tools.types import Numbers
from .spectra import power_spectral_density

_ROUNDING = 1e-9
"""Share by which a band may be too narrow or too high because of rounding."""


class Envelope(NamedTuple):
    """Summary of an ensemble, over its first axis."""

    maximum: np.ndarray
    """Greatest value of the ensemble [unit]."""
    mean: np.ndarray
    """Arithmetic mean [unit]."""
    limit: np.ndarray
    """Normal tolerance limit of the logarithms [unit]; NaN for one sample, and where a value is zero."""


class VibrationEnvironment(NamedTuple):
    """All results of a report on vibration; `*cases` are the axes (rails, ...) of the accelerations."""

    edges: np.ndarray
    """Edges of the bands, and natural frequencies of the shock response [Hz], shape (bands + 1,)."""
    time: np.ndarray
    """Middle of each window from the first sample [s], shape (windows,)."""
    windows: np.ndarray
    """Density in each window [(m/s^2)^2/Hz], shape (*cases, windows, bands)."""
    density: np.ndarray
    """Mean density over the windows that have the band, as Welch's method [(m/s^2)^2/Hz], shape (*cases, bands)."""
    maximax: np.ndarray
    """Greatest density over the windows [(m/s^2)^2/Hz], shape (*cases, bands)."""
    rms: np.ndarray
    """RMS of the whole record about its mean, of all frequencies [m/s^2], shape (*cases,)."""
    band_rms: np.ndarray
    """RMS in the bands that have a density [m/s^2], shape (*cases,): at most `rms`. The RMS from `density` could be
    more, because `density` is a mean that leaves out windows without the band, and weights the ends of a record
    less."""
    maximax_rms: np.ndarray
    """Greatest RMS of a window in its bands [m/s^2], shape (*cases,)."""
    shock_response: np.ndarray
    """Maximax absolute acceleration at natural frequencies `edges` [m/s^2], shape (*cases, bands + 1)."""
    level_time: np.ndarray
    """Times of `level` from the first sample [s], shape (levels,)."""
    level: np.ndarray
    """Running RMS [m/s^2], shape (*cases, levels)."""
    duration: np.ndarray
    """Time for which the level is within 6 dB of its greatest [s], shape (*cases,)."""
    density_envelope: Envelope
    """Envelope of `density` over rails."""
    maximax_envelope: Envelope
    """Envelope of `maximax` over rails."""
    shock_envelope: Envelope
    """Envelope of `shock_response` over rails."""


def _histories(acceleration: Numbers, rate: float, axes: int = 1) -> tuple[np.ndarray, float]:
    """Return histories, in double precision for running sums and slow oscillators, and their rate [Hz]."""
    x = numbers("acceleration", acceleration, axes, "m/s^2").astype(float)
    require(x.shape[-1] >= 8, "acceleration", "have 8 or more samples along its last axis", shown=str(x.shape[-1]))
    return x, number(positive, "rate", rate, "Hz")


def _sums(values: np.ndarray) -> np.ndarray:
    """Return the sums of all values before each place along the last axis, (..., values + 1)."""
    return np.insert(np.cumsum(values, axis=-1), 0, 0.0, axis=-1)


def band_edges(low: float = 20.0, high: float = 2000.0, *, per_octave: float = 6.0) -> np.ndarray:
    """Return edges of equally wide bands from `low` to `high` [Hz] that are an octave / `per_octave` wide or less.

    From 20 to 2000 Hz there are 40 sixth octaves. **Raises:** `ValueError` unless 0 < low < high.
    """
    low, high = number(positive, "low", low, "Hz"), number(positive, "high", high, "Hz")
    require(low < high, "low", f"be below {high:g} Hz", shown=f"{low:g} Hz")
    octaves = math.log2(high / low)
    bands = math.ceil(octaves * number(positive, "per_octave", per_octave) - _ROUNDING)
    return np.geomspace(low, high, bands + 1)


def window_densities(
    acceleration: Numbers,
    rate: float,
    edges: np.ndarray,
    *,
    window: float | None = None,
    highest: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle of each window [s] and its power spectral density in bands, (..., windows, bands).

    Hann windows overlap by half, or by slightly more so that the last window ends with the record; the mean of each
    window is subtracted. The mean over the windows is Welch's estimate (doi:10.1109/TAU.1967.1161901). Lines of a
    periodogram count as constant over their width, so that the mean square of the windowed signal is conserved. A
    band of width B has about 2 B `window` / 1.94 degrees of freedom in each window.

    Bands narrower than the resolution 1 / `window`, or above half the sampling rate or `highest`, are NaN.

    **Arguments:** `rate` [Hz]; `edges` of bands [Hz], shape (bands + 1,); `window` [s]: by default the shortest that
    resolves every band, 0.41 s for `band_edges`, and at most the record; `highest`: frequency up to which each sample
    is reliable [Hz], shape (samples,).

    **Raises:** `ValueError` for fewer than 8 samples, or samples that are not finite.
    """
    x, rate = _histories(acceleration, rate)
    edges = numbers("edges", edges, 1, "Hz")
    widths = np.diff(edges)
    require(edges.size > 1 and (widths > 0).all(), "edges", "be two frequencies or more that increase", edges)
    if highest is not None:
        highest = numbers("highest", highest, 1, "Hz")
        require(highest.shape == x.shape[-1:], "highest", f"have shape {x.shape[-1:]}", shown=str(highest.shape))
    size = window_size(x.shape[-1], rate, edges, window)
    starts = window_starts(x.shape[-1], size)
    resolved = (widths >= rate / size * (1 - _ROUNDING)) & (edges[1:] <= rate / 2 * (1 + _ROUNDING))
    densities = []
    for start in starts:
        # one window at a time, because the spectra of all windows would need much memory
        part = slice(start, start + size)
        spectrum = power_spectral_density(x[..., part], rate)
        good = resolved if highest is None else resolved & (edges[1:] <= highest[part].min() * (1 + _ROUNDING))
        densities.append(np.where(good, _band_means(*spectrum, edges, rate), np.nan))
    return (starts + (size - 1) / 2) / rate, np.stack(densities, axis=-2)


def window_size(samples: int, rate: float, edges: np.ndarray, window: float | None = None) -> int:
    """Return the number of samples in a window of densities; arguments as of `window_densities`."""
    duration = 1 / np.diff(edges).min() if window is None else number(positive, "window", window, "s")
    return min(max(math.ceil(duration * rate * (1 - _ROUNDING)), 8), samples)


def window_starts(samples: int, size: int) -> np.ndarray:
    """Return the first sample of each window of `size` samples; windows overlap by half or slightly more."""
    hops = math.ceil((samples - size) / (size / 2))
    return np.rint(np.linspace(0, samples - size, hops + 1)).astype(int)


def _band_means(frequency: np.ndarray, density: np.ndarray, edges: np.ndarray, rate: float) -> np.ndarray:
    """Return means over bands of a density that is constant over the width of each line."""
    import scipy.interpolate

    width = frequency[1]
    # lines at zero and at half the sampling rate are half as wide, although their power is not doubled
    bounds = np.append(0.0, np.minimum(frequency + width / 2, rate / 2))
    power_below = scipy.interpolate.make_interp_spline(bounds, _sums(density * width), k=1, axis=-1)
    return np.diff(power_below(np.minimum(edges, rate / 2)), axis=-1) / np.diff(edges)


def band_rms(density: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the RMS [unit] of a density (..., bands) over the bands where it is known; NaN without any."""
    square = np.ma.masked_invalid(density * np.diff(edges)).sum(axis=-1)
    return np.sqrt(np.ma.filled(square, np.nan))


def check_quality(quality: float) -> float:
    """Return Q of an oscillator [1]; raises `ValueError` unless it is above 1/2."""
    quality = number(positive, "quality", quality)
    require(quality > 0.5, "quality", "be above 0.5, for an oscillator that oscillates", quality)
    return quality


def oscillator_response(
    acceleration: Numbers, rate: float, natural_frequency: float, *, quality: float = 10.0, rest: float | None = None
) -> np.ndarray:
    """Return the absolute acceleration of an oscillator on a base with a given acceleration, (..., samples).

    The ramp-invariant recursive filter is exact for accelerations that are linear between samples: D. O. Smallwood,
    *An improved recursive formula for calculating shock response spectra*, Shock and Vibration Bulletin 51(2), 1981,
    and ISO 18431-4:2007.

    A record may begin during a motion. The record does not show the motion of the oscillator before its first sample.
    Therefore the oscillator begins in the state in which a run backwards through the record, from its mean, ends.
    Then slow motion moves base and mass together, and fast motion leaves the mass at rest.

    **Arguments:** `acceleration` [m/s^2], shape (..., samples); `rate` [Hz]; `natural_frequency` [Hz]; `quality`:
    1 / (2 damping ratio), above 1/2; `rest`: steady acceleration before the first sample, in which base and
    oscillator rest against each other [m/s^2]: zero for a pulse; None for a record that begins in a motion.
    """
    import scipy.signal  # here, because importing it takes longer than a small simulation

    x, rate = _histories(acceleration, rate)
    quality = check_quality(quality)
    angle = 2 * np.pi * number(positive, "natural_frequency", natural_frequency, "Hz") / rate
    # free vibrations are exp(pole * sample)
    pole = angle * complex(-1 / (2 * quality), math.sqrt(1 - 1 / (4 * quality**2)))
    once = np.exp(pole)
    ramp = once.imag / pole.imag
    forward = [1 - ramp, 2 * (ramp - once.real), abs(once) ** 2 - ramp]
    steady = x.mean(axis=-1, keepdims=True) if rest is None else number(finite, "rest", rest, "m/s^2")
    base = x - steady
    filtered = scipy.signal.lfilter(forward, [1.0, -2 * once.real, abs(once) ** 2], base, axis=-1)
    response = steady + np.asarray(filtered)
    if rest is not None:
        return response
    vibration = np.exp(pole * np.arange(x.shape[-1]))
    # convolution integrals backwards, up to the first sample
    arrived = base @ vibration
    distance = -arrived.imag / pole.imag
    velocity = (pole * arrived).imag / pole.imag
    amplitude = distance + 1j * (pole.real * distance - velocity) / pole.imag
    return response + (pole**2 * amplitude[..., None] * vibration).real


def shock_response_spectrum(
    acceleration: Numbers,
    rate: float,
    natural_frequency: Numbers,
    *,
    quality: float = 10.0,
    rest: float | None = None,
) -> np.ndarray:
    """Return the greatest absolute acceleration of oscillators on a base, of both signs, (..., natural frequencies).

    A steady acceleration is no shock, see `oscillator_response`. Only responses at samples count: with ten samples a
    period true peaks are up to 5 % higher, and the linear curve between samples lacks 3 % of a sine. Natural
    frequencies above a tenth of the sampling rate are NaN. Slow oscillators have their peak after a pulse, so that
    zeros should follow the pulse.

    **Arguments:** `acceleration` [m/s^2], shape (..., samples); `rate` [Hz]; `natural_frequency` [Hz], shape
    (frequencies,); `quality`: 1 / (2 damping ratio), above 1/2; `rest`: as for `oscillator_response`, zero for a
    pulse from rest.
    """
    x, rate = _histories(acceleration, rate)
    # here, because it may be that no oscillator is slow enough to be computed
    quality = check_quality(quality)
    rest = None if rest is None else number(finite, "rest", rest, "m/s^2")
    frequencies = numbers("natural_frequency", natural_frequency, 1, "Hz")
    peaks = np.full((*x.shape[:-1], frequencies.size), np.nan)
    for k, frequency in enumerate(frequencies):
        if frequency <= rate / 10 * (1 + _ROUNDING):
            peaks[..., k] = abs(oscillator_response(x, rate, frequency, quality=quality, rest=rest)).max(axis=-1)
    return peaks


def running_level(acceleration: Numbers, rate: float, *, window: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and the RMS about the mean in a window around each [m/s^2], shape (..., times).

    Times are an eighth of a window apart or less, and each time represents an equal part of the record. Windows at
    the ends are shorter by the part outside of the record.

    **Arguments:** `acceleration` [m/s^2], shape (..., samples); `rate` [Hz]; `window` [s].
    """
    x, rate = _histories(acceleration, rate)
    half = number(positive, "window", window, "s") * rate / 2
    samples = x.shape[-1]
    parts = min(math.ceil(4 * samples / half), samples)
    middles = (np.arange(parts) + 0.5) * samples / parts
    # at least the sample that contains the middle
    begin = np.minimum(np.rint(np.maximum(middles - half, 0)), np.floor(middles)).astype(int)
    end = np.maximum(np.rint(np.minimum(middles + half, samples)), begin + 1).astype(int)
    # a mean that is large compared with the vibration would cost digits
    x = x - x.mean(axis=-1, keepdims=True)
    sums = map(_sums, (x, x**2))
    mean, square = ((below[..., end] - below[..., begin]) / (end - begin) for below in sums)
    variance = square - mean**2
    return (middles - 0.5) / rate, np.sqrt(np.maximum(variance, 0.0))


def _share(name: str, value: float) -> float:
    """Return a number above 0 and below 1; raises `ValueError` otherwise."""
    value = number(finite, name, value)
    require(0 < value < 1, name, "be above 0 and below 1", value)
    return value


def tolerance_factor(samples: int, *, share: float = 0.95, confidence: float = 0.5) -> float:
    """Return k such that mean + k times standard deviation of normal samples exceeds a share of all values.

    The probability of this is `confidence`: k = t / sqrt(n), with t the `confidence` quantile of the noncentral t
    distribution of n - 1 degrees of freedom and noncentrality sqrt(n) z, where z is the normal quantile of `share`.
    NaN for one sample.
    """
    import scipy.stats

    samples = whole("samples", samples, 1)
    share, confidence = _share("share", share), _share("confidence", confidence)
    if samples < 2:
        return math.nan
    shift = math.sqrt(samples) * scipy.stats.norm.ppf(share)
    return float(scipy.stats.nct.ppf(confidence, samples - 1, shift)) / math.sqrt(samples)


def envelope(ensemble: np.ndarray, *, share: float = 0.95, confidence: float = 0.5) -> Envelope:
    """Return maximum, mean and tolerance limit over the first axis of positive values, such as densities of rails.

    The limit is 10^(m + k s), with m and s the mean and standard deviation of log10 of the values, and k from
    `tolerance_factor`: P95/50 by default. The scatter of an estimated density is part of s, and raises it.
    """
    values = numbers("ensemble", ensemble, 1)
    samples = values.shape[0]
    require(samples > 0, "ensemble", "have a sample or more along its first axis", shown="none")
    logarithms = np.log10(np.where(values > 0, values, np.nan))
    # NaN for one sample
    factor = tolerance_factor(samples, share=share, confidence=confidence)
    limit = 10 ** (logarithms.mean(axis=0) + factor * logarithms.std(axis=0, ddof=min(1, samples - 1)))
    return Envelope(values.max(axis=0), values.mean(axis=0), limit)


def resample(time: Numbers, samples: Numbers, rate: float) -> np.ndarray:
    """Return samples at unequal times as samples at `rate` from the first time on, (..., new samples).

    A cubic spline joins the samples, at a multiple of the rate where they are closer than 1 / `rate` for a hundredth
    of the time or more; a linear-phase low-pass filter then removes what would be aliased. Frequencies above a
    quarter of the local sampling rate are not reliable, because a cubic spline lacks 3 % of a sine's power there.

    **Arguments:** `time` [s], shape (samples,), increasing; `samples`: [unit], shape (..., samples); `rate` [Hz].
    """
    import scipy.interpolate
    import scipy.signal

    time, samples = numbers("time", time, 1, "s"), numbers("samples", samples, 1)
    rate = number(positive, "rate", rate, "Hz")
    require(time.shape == samples.shape[-1:], "time", f"have shape {samples.shape[-1:]}", shown=str(time.shape))
    gaps = np.diff(time)
    require(time.size > 1 and (gaps > 0).all(), "time", "be two times or more that increase", time)
    count = math.floor((time[-1] - time[0]) * rate * (1 + _ROUNDING)) + 1
    # a few times that are close together, as of a clock that was reset, would need too much memory
    ranked = np.sort(gaps)
    closest = ranked[np.searchsorted(np.cumsum(ranked), 0.01 * ranked.sum())]
    multiple = math.ceil(1 / (closest * rate) * (1 - _ROUNDING))
    fine = time[0] + np.arange((count - 1) * multiple + 1) / (multiple * rate)
    course = scipy.interpolate.CubicSpline(time, samples, axis=-1)(np.minimum(fine, time[-1]))
    return course if multiple == 1 else scipy.signal.resample_poly(course, 1, multiple, axis=-1, padtype="line")


def resample_reliably(
    time: np.ndarray, samples: np.ndarray, rate: float, highest: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return samples at `rate`, as `resample`, and the frequency up to which each of them is reliable [Hz].

    This is a quarter of the local sampling rate, so that samples in a gap are reliable only at low frequencies.

    **Arguments:** as for `resample`; `highest`: frequency up to which each given sample is reliable otherwise [Hz].
    """
    x = resample(time, samples, rate)
    reliable = 0.25 / np.diff(time)
    if highest is not None:
        reliable = np.minimum(reliable, highest[:-1])
    # new samples are as reliable as the interval that contains them
    new = time[0] + np.arange(x.shape[-1]) / rate
    return x, reliable[np.searchsorted(time[1:-1], new, side="right")]


def vibration_environment(
    acceleration: Numbers,
    rate: float,
    *,
    time: Numbers | None = None,
    highest: Numbers | None = None,
    edges: np.ndarray | None = None,
    window: float | None = None,
    averaging: float = 0.1,
    quality: float = 10.0,
) -> VibrationEnvironment:
    """Return the vibration environment of an ensemble of histories.

    **Arguments:** `acceleration` [m/s^2], shape (rails, ..., samples); `rate` [Hz]: at least ten times the highest
    frequency, better twenty; `time`: of samples that are not at `rate` and are resampled [s], shape (samples,), such
    as samples at equal distances of a sled whose speed changes; `highest`: frequency up to which each given sample is
    reliable, above which densities are NaN [Hz], shape (samples,); `edges` of bands [Hz], by default `band_edges()`;
    `window` of densities [s], see `window_densities`; `averaging`: window of the level [s]; `quality` of the
    oscillators of the shock response.

    **Raises:** `ValueError` for fewer than 8 samples, or samples that are not finite.
    """
    import scipy.signal

    x, rate = _histories(acceleration, rate, 2)
    require(np.isfinite(x).all(), "acceleration", "be finite", shown="infinite or not a number")
    edges = band_edges() if edges is None else numbers("edges", edges, 1, "Hz").astype(float)
    highest = None if highest is None else numbers("highest", highest, 1, "Hz").astype(float)
    if time is not None:
        x, highest = resample_reliably(numbers("time", time, 1, "s").astype(float), x, rate, highest)
    middles, windows = window_densities(x, rate, edges, window=window, highest=highest)
    density = np.ma.masked_invalid(windows).mean(axis=-2).filled(np.nan)
    # the whole record as one window, without a taper
    whole = _band_means(*scipy.signal.periodogram(x, rate), edges, rate)
    maximax = np.fmax.reduce(windows, axis=-2)
    shock = shock_response_spectrum(x, rate, edges, quality=quality)
    level_time, level = running_level(x, rate, window=averaging)
    near = level >= 10 ** (-6 / 20) * level.max(axis=-1, keepdims=True)
    return VibrationEnvironment(
        edges=edges,
        time=middles,
        windows=windows,
        density=density,
        maximax=maximax,
        rms=x.std(axis=-1),
        band_rms=band_rms(np.where(np.isnan(density), np.nan, whole), edges),
        maximax_rms=np.fmax.reduce(band_rms(windows, edges), axis=-1),
        shock_response=shock,
        level_time=level_time,
        level=level,
        duration=near.mean(axis=-1) * x.shape[-1] / rate,
        density_envelope=envelope(density),
        maximax_envelope=envelope(maximax),
        shock_envelope=envelope(shock),
    )
