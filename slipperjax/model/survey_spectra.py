"""Spectra, correlation and lines of a surveyed rail, from which similar random rails are made."""

from typing import NamedTuple

import numpy as np

SEGMENTS = 8
"""Number of segments in a survey; one segment is the longest wave of the spectra."""
SHORTEST = 3
"""Samples in the shortest wave of the spectra."""
PER_OCTAVE = 6
"""Values of a spectrum per octave."""
LINE = 15.0
"""Least height of a line over the medians on both sides [dB]; noise reaches this height in one of 3e9 waves."""
HIDDEN = 6
"""Greatest multiple of a comb's wavenumber that may be the comb's lowest visible line."""


class RailStatistics(NamedTuple):
    """Statistics of a survey, with distances from its first sample; channels in the given order."""

    wavenumber: np.ndarray
    """Wavenumbers of the spectra [cycles/m]."""
    density: np.ndarray
    """One-sided densities without the lines, (channels, wavenumbers) [m^2 per cycle/m]."""
    correlation: np.ndarray
    """Mean real coherence of each two channels, with its sign [1]; 0 for a channel of zeros."""
    fundamental: np.ndarray
    """Wavenumber of which each line is a multiple [cycles/m]: one over the distance of joints."""
    multiple: np.ndarray
    """Multiple of `fundamental` that each line is [1]."""
    sine: np.ndarray
    """Amplitudes of the lines' sines, (channels, lines) [m]."""
    cosine: np.ndarray
    """Amplitudes of the lines' cosines, (channels, lines) [m]."""


def statistics_of(samples: np.ndarray, spacing: float) -> RailStatistics:
    """Return the statistics of equally spaced samples, (channels, samples).

    Welch's method (1967, doi:10.1109/TAU.1967.1161901), with Hann windows over half overlapping segments, gives the
    spectra of the slopes. Slopes are nearly white, so that long waves do not leak into short waves.

    **Arguments:** `spacing` [m].
    """
    import scipy.signal  # here, because importing it takes time

    slopes = np.diff(samples) / spacing
    slopes = slopes - slopes.mean(axis=1, keepdims=True)
    size = slopes.shape[1] // SEGMENTS
    last = size // SHORTEST
    fundamental, multiple = _lines(slopes, spacing, 1 / (size * spacing), last / (size * spacing))
    sine, cosine, rest = _without(slopes, spacing, fundamental * multiple)
    # spectra of each two channels
    pairs = rest[:, None], rest[None]
    k, density = map(np.asarray, scipy.signal.csd(*pairs, 1 / spacing, "hann", nperseg=size, detrend=False))
    bins = np.arange(1, last + 1)
    _, of_bin = np.unique(np.round(PER_OCTAVE * np.log2(bins)), return_inverse=True)
    count = np.bincount(of_bin)
    mean = lambda values: np.bincount(of_bin, values) / count
    slope_density = np.stack([mean(np.real(density[i, i, bins])) for i in range(len(rest))])
    wavenumber = np.exp(mean(np.log(k[bins])))
    # over all bins: a wide band has more bins
    root = np.sqrt(slope_density * count)
    product = root @ root.T
    real = np.real(density[..., bins]).sum(axis=-1)
    correlation = np.where(product > 0, real / np.where(product > 0, product, 1.0), 0.0)
    return RailStatistics(
        wavenumber,
        slope_density / _gain(wavenumber, spacing) ** 2,
        np.clip(correlation, -1.0, 1.0),
        fundamental,
        multiple,
        sine,
        cosine,
    )


def _gain(wavenumber: np.ndarray, spacing: float) -> np.ndarray:
    """Return the greatest slope between two samples of a sine, divided by the sine's amplitude [1/m]."""
    return 2 * np.sin(np.pi * wavenumber * spacing) / spacing


def _lines(slopes: np.ndarray, spacing: float, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the fundamental wavenumber [cycles/m] and the multiple of each line from `low` to `high` [cycles/m]."""
    peaks, width = _peaks(slopes, spacing)
    peaks = peaks[(peaks >= low) & (peaks <= high)]
    fundamental = np.zeros(0)
    multiple = np.zeros(0)
    while peaks.size:
        combs = [_comb(peaks, hidden, width) for hidden in range(1, HIDDEN + 1)]
        # for each hidden line the comb must explain one more visible line
        most = max(range(HIDDEN), key=lambda k: np.count_nonzero(combs[k][1]) - k)
        least, multiples = combs[most]
        own = multiples[multiples > 0]
        least = _refined(slopes, spacing, least, own, width)
        fundamental = np.append(fundamental, np.full(own.size, least))
        multiple = np.append(multiple, own)
        peaks = peaks[multiples == 0]
    return fundamental, multiple


def _peaks(slopes: np.ndarray, spacing: float) -> tuple[np.ndarray, float]:
    """Return the rising wavenumbers of peaks far above the spectra around them, and the resolution, which is one over
    the survey's length [cycles/m]."""
    import scipy.ndimage
    import scipy.signal

    k, density = scipy.signal.periodogram(slopes, 1 / spacing, window="hann")
    # a channel of zeros gets a constant level
    top = density.max(axis=1, keepdims=True)
    level = 10 * np.log10(np.fmax(density, np.where(top > 0, 1e-12 * top, 1.0)))
    # above the medians on both sides, because one of the two is very low where a spectrum breaks off
    sides = [scipy.ndimage.median_filter(level, size=(1, 33), mode="reflect", origin=(0, by)) for by in (-16, 16)]
    height = (level - np.maximum(*sides)).max(axis=0)
    peaks, _ = scipy.signal.find_peaks(height, height=LINE, prominence=6.0, wlen=65, distance=2)
    # the vertex of the parabola through three values
    left, middle, right = height[peaks - 1], height[peaks], height[peaks + 1]
    return k[1] * (peaks + 0.5 * (left - right) / (left - 2 * middle + right)), float(k[1])


def _comb(peaks: np.ndarray, hidden: int, width: float) -> tuple[float, np.ndarray]:
    """Return the wavenumber of which the first peak is the multiple `hidden`, and the multiple of each peak; 0 for
    peaks that are no multiples."""
    multiples = np.zeros(len(peaks))
    multiples[0] = hidden
    least = peaks[0] / hidden
    for k, peak in enumerate(peaks[1:], 1):
        nearest = round(peak / least)
        if abs(peak - nearest * least) < 0.3 * width:
            multiples[k] = nearest
            # each multiple makes the wavenumber more precise
            least = multiples @ peaks / (multiples @ multiples)
    return float(least), multiples


def _refined(slopes: np.ndarray, spacing: float, least: float, multiples: np.ndarray, width: float) -> float:
    """Return the wavenumber near `least` whose multiples have the most power [cycles/m]."""
    import scipy.optimize

    size = slopes.shape[1]
    place = spacing * np.arange(size)
    windowed = slopes * np.hanning(size)

    def power(k: float) -> float:
        # one multiple after the other, to save memory
        return -sum(np.sum(np.abs(windowed @ np.exp(-2j * np.pi * k * m * place)) ** 2) for m in multiples)

    near = width / 4 / multiples[-1]
    # far more precise than the survey's resolution
    options = {"xatol": 1e-4 * near}
    bounds = (least - near, least + near)
    return float(scipy.optimize.minimize_scalar(power, bounds=bounds, method="bounded", options=options).x)


def _without(slopes: np.ndarray, spacing: float, wavenumber: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the amplitudes of sines and cosines at some wavenumbers by least squares, and the slopes without
    them."""
    # the slope between two samples belongs to their middle
    place = spacing * (np.arange(slopes.shape[1]) + 0.5)
    angle = 2 * np.pi * np.outer(place, wavenumber)
    waves = np.concatenate([np.cos(angle), -np.sin(angle)], axis=1) * np.tile(_gain(wavenumber, spacing), 2)
    amplitudes, *_ = np.linalg.lstsq(waves, slopes.T)
    sine, cosine = np.split(amplitudes.T, 2, axis=1)
    return sine, cosine, slopes - (waves @ amplitudes).T
