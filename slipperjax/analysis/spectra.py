"""Power spectral density, and its lines: their frequencies, their power, and the combinations of the forcing
frequencies that match them.

A motion forced at f1 and f2 that is not chaotic has lines at m f1 + n f2 only; lines at fractions of a forcing
frequency are sub-harmonics, which come with period doubling; a chaotic motion raises the floor between the lines.
"""

from typing import NamedTuple

import numpy as np

from ..tools.checks import instance, number, one_of, positive, whole

THRESHOLD = 15.0
"""Least height of a line above the local floor [dB]. Each bin of white noise exceeds its median by 15 dB with a
chance of 2^-31.6 (3e-10): its periodogram is exponentially distributed."""
DYNAMIC_RANGE = 120.0
"""Densities this far below the maximum [dB] count as floor, because the rounding errors of a periodic signal are
periodic, too, and have lines."""
DIP = 6.0
"""Least fall of the density on both sides of a line before it rises higher again [dB]."""
MAX_DENOMINATOR = 8
"""Greatest denominator of named sub-harmonics."""


class Spectrum(NamedTuple):
    """One-sided power spectral density."""

    frequency: np.ndarray
    """Frequencies [Hz], shape (bins,), from 0 to half the sampling rate."""
    density: np.ndarray
    """Density [unit^2/Hz], shape (*cases, bins); the axis of the samples becomes the last."""


class Lines(NamedTuple):
    """Lines of a spectrum, by rising frequency; arrays of shape (lines,)."""

    frequency: np.ndarray
    """Refined frequency [Hz]."""
    power: np.ndarray
    """Mean square of the line [unit^2]; a sine of amplitude a has a^2 / 2."""
    prominence: np.ndarray
    """Height of the peak above the local floor [dB]."""
    resolution: float
    """Width of the spectrum's bins [Hz]."""


class Line(NamedTuple):
    """The spectrum at one frequency."""

    frequency: float
    """Refined frequency of the peak, or of the strongest bin where there is no peak [Hz]."""
    power: float
    """Mean square in the bins of the main lobe [unit^2], with or without a line."""
    prominence: float
    """Height above the local floor [dB], with or without a line."""
    present: bool
    """True where there is a line, as defined by `spectral_lines`."""


def power_spectral_density(signal, sampling_rate, *, axis=-1, window="hann", detrend="constant") -> Spectrum:
    """Computes the one-sided power spectral density of evenly spaced samples, by one periodogram of the record.

    With w the window and x the detrended signal, the density at f_k is 2 |sum_j w_j x_j exp(-2 pi i j k / N)|^2 /
    (sampling_rate sum_j w_j^2), without the 2 at zero and at the Nyquist frequency (`scipy.signal.periodogram`,
    scaling "density"). So the sum of the density times the width of the bins is sum (w x)^2 / sum w^2, the
    mean square of the windowed signal: exactly the variance for `window="boxcar"`.

    **Arguments:** `signal`: real samples [unit] along `axis`, 8 or more; `sampling_rate` [Hz]; `window`: an
    argument of `scipy.signal.get_window`, in periodic form; "hann" keeps weak lines visible beside strong ones,
    "boxcar" is for records of whole periods; `detrend`: "constant" (subtract the mean), "linear" or `False`.

    **Raises:** `ValueError` for too few or non-finite samples, a bad rate or window.
    """
    import scipy.signal  # here, because importing it takes longer than a small simulation

    x = np.asarray(signal, dtype=float)
    if x.ndim == 0 or not -x.ndim <= axis < x.ndim or x.shape[axis] < 8:
        raise ValueError(f"Argument `signal` must be 8 or more samples along axis {axis}, but is of shape {x.shape}.")
    if not np.isfinite(x).all():
        raise ValueError(f"Argument `signal` must be finite, but is {x[~np.isfinite(x)][0]:g}.")
    rate = number(positive, "sampling_rate", sampling_rate)
    if detrend is not False:
        one_of("detrend", detrend, ("constant", "linear"))
    x = np.moveaxis(x, axis, -1)
    try:
        weights = scipy.signal.get_window(window, x.shape[-1])
    except ValueError as error:
        raise ValueError(f"Argument `window` must be a window of scipy.signal, but is {window!r}.") from error
    return Spectrum(*scipy.signal.periodogram(x, rate, window=weights, detrend=detrend, scaling="density"))


def spectral_lines(spectrum: Spectrum, *, threshold=THRESHOLD, lobe=2, span=65, dynamic_range=DYNAMIC_RANGE) -> Lines:
    """Finds the lines of one spectrum.

    A line is a local maximum of the density that falls by `DIP` on both sides and stands `threshold` above the local
    floor, the running median over `span` bins. Lines must therefore be about 4 `lobe` bins apart or more. Frequencies
    are refined by a parabola through the logarithms of the three highest bins (within 0.02 bins for a Hann window).
    The power is the sum over the main lobe, which holds more than 99.9 % of a line's power for a Hann window; the
    floor's contribution to it is not subtracted. Lines within `lobe` bins of the ends cannot be distinguished from a
    trend, and are omitted.

    **Arguments:** `spectrum` with a density of shape (bins,); `threshold` and `dynamic_range` [dB]; `lobe`: half the
    width of the window's main lobe [bins], 2 for "hann", 1 for "boxcar", 4 for "blackmanharris"; `span` [bins].

    **Raises:** `ValueError` for a density of several cases and settings out of range.
    """
    bins = _Bins(spectrum, threshold, lobe, span, dynamic_range)
    frequency, power = ([of(k) for k in bins.peaks] for of in (bins.refined, bins.power))
    return Lines(np.array(frequency), np.array(power), bins.height[bins.peaks], bins.width)


def find_line(spectrum: Spectrum, frequency, *, tolerance=None, **options) -> Line:
    """Tells whether a spectrum shows a line at one frequency, and how strong it is.

    **Arguments:** `frequency` [Hz]; `tolerance`: greatest distance of the line from it [Hz], by default one bin;
    `options`: as for `spectral_lines`, which also defines a line.

    **Raises:** `ValueError` for a frequency outside the spectrum, and as `spectral_lines`.
    """
    bins, last = _Bins(spectrum, **options), float(spectrum.frequency[-1])
    frequency = number(positive, "frequency", frequency)
    if frequency > last:
        raise ValueError(f"Argument `frequency` must be at most {last:g} Hz, but is {frequency:g} Hz.")
    # half a bin more, because a line at the limit of the tolerance may have its peak in the next bin
    within = (bins.width if tolerance is None else number(positive, "tolerance", tolerance)) + bins.width / 2
    near = np.flatnonzero(abs(spectrum.frequency - frequency) <= within)
    peaks = np.intersect1d(bins.peaks, near)
    choice = peaks if peaks.size else near
    k = choice[np.argmax(bins.level[choice])]
    at = bins.refined(k) if peaks.size else float(spectrum.frequency[k])
    return Line(at, bins.power(k), float(bins.height[k]), bool(peaks.size))


def combination(m: int, n: int) -> str:
    """Gives the name of m f1 + n f2: "f1", "f1+2f2", "2f2-f1"; the positive term comes first."""
    terms = [(count, f) for count, f in ((m, "f1"), (n, "f2")) if count]
    terms.sort(key=lambda term: term[0] < 0)
    signed = (("-" if count < 0 else "+") + (str(abs(count)) if abs(count) > 1 else "") + f for count, f in terms)
    return "".join(signed).removeprefix("+")


def name_lines(lines: Lines, f1, f2=None, max_order=6, tolerance=None) -> list[str | None]:
    """Names every line by the combination of the forcing frequencies that matches it.

    With two frequencies, the m f1 + n f2 of the least order |m| + |n| within `tolerance` ("f1", "2f2-f1"), and of
    equal orders the nearest. With one frequency, harmonics and sub-harmonics by the least denominator up to
    `MAX_DENOMINATOR` ("f", "2f", "f/3", "2f/3"), up to `max_order` f.

    **Arguments:** `lines`: what `spectral_lines` returns; `f1`, `f2` [Hz]; `max_order`: greatest |m| + |n|, or
    greatest multiple of a single frequency; `tolerance` [Hz], by default one bin of the spectrum.

    **Returns:** one name per line, `None` where nothing fits.

    **Raises:** `ValueError` for frequencies or a tolerance that are not positive, and a `max_order` below 1.
    """
    f1 = number(positive, "f1", f1)
    within = lines.resolution if tolerance is None else number(positive, "tolerance", tolerance)
    order = whole("max_order", max_order, 1)
    if f2 is None:
        return [_fraction(f, f1, order, within) for f in lines.frequency]
    f2 = number(positive, "f2", f2)
    pairs = [
        (m, n) for m in range(-order, order + 1) for n in range(-order, order + 1) if 0 < abs(m) + abs(n) <= order
    ]
    table = [(abs(m) + abs(n), m * f1 + n * f2, combination(m, n)) for m, n in pairs if m * f1 + n * f2 > 0]

    def name(f):
        fits = [(size, abs(at - f), text) for size, at, text in table if abs(at - f) <= within]
        return min(fits)[2] if fits else None

    return [name(f) for f in lines.frequency]


def _fraction(frequency: float, f: float, order: int, within: float) -> str | None:
    for q in range(1, MAX_DENOMINATOR + 1):
        p = round(frequency * q / f)
        if 1 <= p <= order * q and abs(p * f / q - frequency) <= within:
            return (str(p) if p > 1 else "") + "f" + (f"/{q}" if q > 1 else "")
    return None


class _Bins:
    """The bins of a spectrum of one signal, with their local floor and the lines that peak in some of them."""

    def __init__(self, spectrum, threshold=THRESHOLD, lobe=2, span=65, dynamic_range=DYNAMIC_RANGE):
        import scipy.ndimage
        import scipy.signal

        instance("spectrum", spectrum, Spectrum, "a slipperjax.analysis.Spectrum")
        self.frequency, self.density = (np.asarray(x, dtype=float) for x in spectrum)
        size, shape = self.density.size, self.density.shape
        if self.density.ndim != 1 or shape != self.frequency.shape or size < 5:
            raise ValueError(f"Argument `spectrum` must be of one signal, but its density is of shape {shape}.")
        threshold = number(positive, "threshold", threshold)
        dynamic_range = number(positive, "dynamic_range", dynamic_range)
        self.lobe = whole("lobe", lobe, 1)
        span = whole("span", span, 4 * self.lobe + 3) | 1  # odd, to be centred
        self.width = float(self.frequency[1] - self.frequency[0])  # [Hz]
        top = self.density.max()
        # density [dB], and its height above the local floor [dB]
        least = top * 10 ** (-dynamic_range / 10) if top > 0 else 1.0
        self.level = 10 * np.log10(np.fmax(self.density, least))
        self.height = self.level - scipy.ndimage.median_filter(self.level, size=span, mode="reflect")
        peaks, _ = scipy.signal.find_peaks(self.level, distance=self.lobe, prominence=DIP, wlen=span)
        inside = (peaks > self.lobe) & (peaks < size - 1 - self.lobe)
        self.peaks = peaks[inside & (self.height[peaks] >= threshold)]

    def refined(self, k) -> float:
        """Gives the frequency of the peak near a bin [Hz], by a parabola through the levels of three."""
        left, top, right = self.level[k - 1 : k + 2]
        bend = left - 2 * top + right
        shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
        return float(self.frequency[k] + shift * self.width)

    def power(self, k) -> float:
        """Gives the mean square in the main lobe around a bin [unit^2]."""
        return float(np.sum(self.density[max(k - self.lobe, 0) : k + self.lobe + 1]) * self.width)
