"""Spectra, correlation and lines of a surveyed rail: what random rails like it are made of."""

from typing import NamedTuple

import numpy as np

SEGMENTS = 8
"""Lengths of a segment in a survey: the longest wave of the spectra is one of them."""
SHORTEST = 4
"""Samples in the shortest wave of the spectra."""
SHORTEST_LINE = 3
"""Samples in the shortest wave that may be a line."""
PER_OCTAVE = 6
"""Values of a spectrum per octave."""
LINE = 15.0
"""Height of a line over the medians beside it [dB], which noise reaches in one of 3e9 waves."""


class RailStatistics(NamedTuple):
    """Statistics of a survey, whose distances count from its first sample; channels as they were given."""

    wavenumber: np.ndarray
    """Of the spectra [cycles/m]."""
    density: np.ndarray
    """One-sided densities without the lines, (channels, wavenumbers) [m^2 per cycle/m]."""
    correlation: np.ndarray
    """Mean real coherence of each channel with each, with its sign [1]; 0 of a channel that is zero."""
    fundamental: np.ndarray
    """Of each line the least wavenumber of its comb [cycles/m]."""
    multiple: np.ndarray
    """Of each line its wavenumber over the least of its comb [1]."""
    sine: np.ndarray
    """Amplitudes of the lines' sines, (channels, lines) [m]."""
    cosine: np.ndarray
    """Amplitudes of the lines' cosines."""


def statistics_of(samples: np.ndarray, spacing: float) -> RailStatistics:
    """Return the statistics of equally spaced samples, (channels, samples).

    Spectra are Welch's (1967, doi:10.1109/TAU.1967.1161901) with Hann windows over half overlapping segments, of the
    slopes: these are nearly white, so that long waves do not leak into short ones.

    **Arguments:** `spacing` [m].
    """
    import scipy.signal  # here, because importing it takes time

    slopes = np.diff(samples) / spacing
    slopes = slopes - slopes.mean(axis=1, keepdims=True)
    size = slopes.shape[1] // SEGMENTS
    last = size // SHORTEST
    combs = _combs(slopes, spacing, 1 / (size * spacing), 1 / (SHORTEST_LINE * spacing))
    fundamental = np.concatenate([np.full(count, k) for k, count in combs] or [np.zeros(0)])
    multiple = np.concatenate([np.arange(1.0, count + 1) for _, count in combs] or [np.zeros(0)])
    sine, cosine, rest = _without(slopes, spacing, fundamental * multiple)
    # spectra of each channel with each
    pairs = rest[:, None], rest[None]
    k, density = map(np.asarray, scipy.signal.csd(*pairs, 1 / spacing, "hann", nperseg=size, detrend=False))
    bins = np.arange(1, last + 1)
    _, of_bin = np.unique(np.round(PER_OCTAVE * np.log2(bins)), return_inverse=True)
    count = np.bincount(of_bin)
    mean = lambda values: np.bincount(of_bin, values) / count
    slope_density = np.stack([mean(np.real(density[i, i, bins])) for i in range(len(rest))])
    wavenumber = np.exp(mean(np.log(k[bins])))
    # of all bins together, which are more where bands are wide
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
    """Return the slope between two samples of a sine, over its amplitude [1/m]."""
    return 2 * np.sin(np.pi * wavenumber * spacing) / spacing


def _combs(slopes: np.ndarray, spacing: float, low: float, high: float) -> list[tuple[float, int]]:
    """Return the combs of lines between two wavenumbers: the least wavenumber of each [cycles/m], and how many of its
    multiples there are."""
    lines = _lines(slopes, spacing, low, high)
    width = 1 / (slopes.shape[1] * spacing)
    combs = []
    while lines:
        fundamental, *others = lines
        # multiples in rising order, each of which makes the least wavenumber more precise
        found = [(1, fundamental)]
        lines = []
        for k in others:
            multiple = round(k / fundamental)
            if abs(k - multiple * fundamental) > width / 2:
                lines.append(k)
                continue
            found.append((multiple, k))
            fundamental = sum(m * one for m, one in found) / sum(m * m for m, _ in found)
        most, _ = found[-1]
        combs.append((_refined(slopes, spacing, fundamental, most, width), most))
    return combs


def _lines(slopes: np.ndarray, spacing: float, low: float, high: float) -> list[float]:
    """Return the wavenumbers of peaks far above the spectra around them, rising [cycles/m]."""
    import scipy.ndimage
    import scipy.signal

    k, density = scipy.signal.periodogram(slopes, 1 / spacing, window="hann")
    # a channel of zeros is all floor
    top = density.max(axis=1, keepdims=True)
    level = 10 * np.log10(np.fmax(density, np.where(top > 0, 1e-12 * top, 1.0)))
    # above the medians on both sides, because where a spectrum breaks off one of them is nothing
    sides = [scipy.ndimage.median_filter(level, size=(1, 33), mode="reflect", origin=(0, by)) for by in (-16, 16)]
    height = (level - np.maximum(*sides)).max(axis=0)
    peaks, _ = scipy.signal.find_peaks(height, height=LINE, prominence=6.0, wlen=65, distance=2)
    peaks = peaks[(k[peaks] >= low) & (k[peaks] <= high)]
    # the vertex of the parabola through three bins
    left, middle, right = height[peaks - 1], height[peaks], height[peaks + 1]
    return list(k[1] * (peaks + 0.5 * (left - right) / (left - 2 * middle + right)))


def _refined(slopes: np.ndarray, spacing: float, fundamental: float, count: int, width: float) -> float:
    """Return the least wavenumber of a comb for which its multiples have most power [cycles/m]."""
    import scipy.optimize

    size = slopes.shape[1]
    place = spacing * np.arange(size)
    windowed = slopes * np.hanning(size)

    def power(k: float) -> float:
        # one multiple after the other takes no memory
        return -sum(np.sum(np.abs(windowed @ np.exp(-2j * np.pi * k * m * place)) ** 2) for m in range(1, count + 1))

    near = width / 4 / count
    # wavenumbers are known far better than to a bin
    options = {"xatol": 1e-4 * near}
    bounds = (fundamental - near, fundamental + near)
    return float(scipy.optimize.minimize_scalar(power, bounds=bounds, method="bounded", options=options).x)


def _without(slopes: np.ndarray, spacing: float, wavenumber: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the amplitudes of sines and cosines at some wavenumbers by least squares, and the slopes without
    them."""
    # slopes are those in the middle between samples
    place = spacing * (np.arange(slopes.shape[1]) + 0.5)
    angle = 2 * np.pi * np.outer(place, wavenumber)
    waves = np.concatenate([np.cos(angle), -np.sin(angle)], axis=1) * np.tile(_gain(wavenumber, spacing), 2)
    amplitudes, *_ = np.linalg.lstsq(waves, slopes.T)
    sine, cosine = np.split(amplitudes.T, 2, axis=1)
    return sine, cosine, slopes - (waves @ amplitudes).T
