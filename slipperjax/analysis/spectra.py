"""Power spectral density, and its lines: their frequencies and their power.

A motion forced at f1 and f2 that is not chaotic has lines at m f1 + n f2 only; lines at fractions of a forcing
frequency are sub-harmonics, which come with period doubling; a chaotic motion raises the floor between the lines.
"""

from typing import Any, NamedTuple

import numpy as np

from ..tools.checks import instance, number, one_of, positive, require, whole


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


def power_spectral_density(
    signal: Any,
    sampling_rate: float,
    *,
    axis: int = -1,
    window: str = "hann",
    detrend: str | bool = "constant",
) -> Spectrum:
    """Returns the one-sided power spectral density of evenly spaced samples, by one periodogram of the record.

    With w the window and x the detrended signal, the density at f_k is 2 |sum_j w_j x_j exp(-2 pi i j k / N)|^2 /
    (sampling_rate sum_j w_j^2), without the 2 at zero and at the Nyquist frequency (`scipy.signal.periodogram`,
    scaling "density"). So the sum of the density times the width of the bins is sum (w x)^2 / sum w^2, the
    mean square of the windowed signal: exactly the variance for `window="boxcar"`.

    **Arguments:** `signal`: real samples [unit] along `axis`, 8 or more; `sampling_rate` [Hz]; `window`: an
    argument of `scipy.signal.get_window`, in periodic form; "hann" keeps weak lines visible beside strong ones,
    "boxcar" is for records of whole periods; `detrend`: "constant" (subtract the mean), "linear" or `False`.

    **Raises:** `ValueError` for too few or non-finite samples, a bad rate, window or trend.
    """
    import scipy.signal  # here, because importing it takes longer than a small simulation

    x = np.asarray(signal, dtype=float)
    enough = x.ndim > 0 and -x.ndim <= axis < x.ndim and x.shape[axis] >= 8
    require(enough, "signal", f"be 8 or more samples along axis {axis}", shown=f"of shape {x.shape}")
    require(np.isfinite(x).all(), "signal", "be finite", shown="infinite or not a number")
    rate = number(positive, "sampling_rate", sampling_rate)
    if detrend is not False:
        one_of("detrend", detrend, ("constant", "linear"))
    try:
        weights = scipy.signal.get_window(window, x.shape[axis])
    except ValueError as error:
        raise ValueError(f"Argument `window` must be a window of scipy.signal, but is {window!r}.") from error
    x = np.moveaxis(x, axis, -1)
    return Spectrum(
        *scipy.signal.periodogram(
            x,
            rate,
            window=weights,
            detrend=detrend,
            scaling="density",
        )
    )


def spectral_lines(spectrum: Spectrum, **options: Any) -> Lines:
    """Returns the lines of one spectrum.

    A line is a local maximum of the density that falls by 6 dB on both sides and stands `threshold` above the local
    floor, the running median over `span` bins. Lines must therefore be about 4 `lobe` bins apart or more. Frequencies
    are refined by a parabola through the logarithms of the three highest bins (within 0.02 bins for a Hann window).
    The power is the sum over the main lobe, which holds more than 99.9 % of a line's power for a Hann window; the
    floor's contribution to it is not subtracted. Lines within `lobe` bins of the ends cannot be distinguished from a
    trend, and are omitted.

    **Arguments:** `spectrum` with a density of shape (bins,); `options`:

    - `threshold`: least height of a line above the local floor [dB], default 15. Each bin of white noise exceeds its
      median by 15 dB with a chance of 2^-31.6 (3e-10): its periodogram is exponentially distributed.
    - `dynamic_range`: densities this far below the maximum [dB] count as floor, default 120, because the rounding
      errors of a periodic signal are periodic, too, and have lines.
    - `lobe`: half the width of the window's main lobe [bins], 2 for "hann", 1 for "boxcar", 4 for "blackmanharris".
    - `span` of the running median [bins], default 65.

    **Raises:** `ValueError` for a density of several cases and settings out of range.
    """
    bins = _Bins(spectrum, **options)
    frequency = np.array([bins.refined(k) for k in bins.peaks])
    power = np.array([bins.power(k) for k in bins.peaks])
    return Lines(frequency, power, bins.height[bins.peaks], bins.width)


def find_line(
    spectrum: Spectrum,
    frequency: float,
    *,
    tolerance: float | None = None,
    **options: Any,
) -> Line:
    """Returns the line that a spectrum shows at one frequency, or how strong it is without one.

    **Arguments:** `frequency` [Hz]; `tolerance`: greatest distance of the line from it [Hz], by default one bin;
    `options`: as for `spectral_lines`, which also defines a line.

    **Raises:** `ValueError` for a frequency outside the spectrum, and as `spectral_lines`.
    """
    bins = _Bins(spectrum, **options)
    last = float(spectrum.frequency[-1])
    frequency = number(positive, "frequency", frequency)
    require(frequency <= last, "frequency", f"be at most {last:g} Hz", shown=f"{frequency:g} Hz")
    tolerance = bins.width if tolerance is None else number(positive, "tolerance", tolerance)
    # half a bin more, because a line at the limit of the tolerance may have its peak in the next bin
    near = np.flatnonzero(abs(spectrum.frequency - frequency) <= tolerance + bins.width / 2)
    peaks = np.intersect1d(bins.peaks, near)
    choice = peaks if peaks.size else near
    k = choice[np.argmax(bins.level[choice])]
    at = bins.refined(k) if peaks.size else float(spectrum.frequency[k])
    return Line(at, bins.power(k), float(bins.height[k]), bool(peaks.size))


class _Bins:
    """The bins of a spectrum of one signal, with their local floor and the lines that peak in some of them."""

    def __init__(self, spectrum, *, threshold=15.0, lobe=2, span=65, dynamic_range=120.0):
        import scipy.ndimage
        import scipy.signal

        instance("spectrum", spectrum, Spectrum, "a slipperjax.analysis.Spectrum")
        self.frequency, self.density = (np.asarray(x, dtype=float) for x in spectrum)
        size = self.density.size
        shape = self.density.shape
        good = self.density.ndim == 1 and shape == self.frequency.shape and size >= 5
        require(good, "spectrum", "be of one signal", shown=f"of shape {shape}")
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
        # between two lines the density must fall by 6 dB
        peaks, _ = scipy.signal.find_peaks(self.level, distance=self.lobe, prominence=6.0, wlen=span)
        inside = (peaks > self.lobe) & (peaks < size - 1 - self.lobe)
        self.peaks = peaks[inside & (self.height[peaks] >= threshold)]

    def refined(self, k):
        """Returns the frequency of the peak near a bin [Hz], by a parabola through the levels of three."""
        # the vertex of the parabola, in bins from the highest one
        left, top, right = self.level[k - 1 : k + 2]
        bend = left - 2 * top + right
        shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
        return float(self.frequency[k] + shift * self.width)

    def power(self, k):
        """Returns the mean square in the main lobe around a bin [unit^2]."""
        lobe = self.density[max(k - self.lobe, 0) : k + self.lobe + 1]
        return float(np.sum(lobe) * self.width)
