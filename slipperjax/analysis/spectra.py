"""Power spectral density, and the frequency and power of its lines.

A regular motion forced at f1 and f2 has lines only at m f1 + n f2. Lines at fractions of a forcing frequency are
sub-harmonics, which come with period doubling. A chaotic motion raises the floor between the lines.
"""

from typing import NamedTuple

import numpy as np

from ..tools.checks import instance, number, numbers, positive, require
from ..tools.types import Numbers


class Spectrum(NamedTuple):
    """One-sided power spectral density."""

    frequency: np.ndarray
    """Frequencies [Hz], shape (bins,), from 0 to half the sampling rate."""
    density: np.ndarray
    """Density [unit^2/Hz], shape (*cases, bins)."""


class Line(NamedTuple):
    """The spectrum at one frequency."""

    frequency: float
    """Frequency of the peak, refined between bins; of the strongest bin where there is no peak [Hz]."""
    power: float
    """Mean square in the bins of the main lobe [unit^2]; a sine of amplitude a has a^2 / 2."""
    prominence: float
    """Height above the local floor [dB]."""
    present: bool
    """Whether there is a line, as defined by `find_line`; the other numbers exist without a line, too."""


def power_spectral_density(signal: Numbers, sampling_rate: float) -> Spectrum:
    """Return the one-sided power spectral density of evenly spaced samples, by one periodogram of all of them.

    The mean is subtracted, and a Hann window w keeps weak lines visible next to strong lines. The density at f_k is
    2 |sum_j w_j x_j exp(-2 pi i j k / N)|^2 / (sampling_rate sum_j w_j^2), without the 2 at zero and at the Nyquist
    frequency. Thus the sum of the density times the width of the bins is the mean square of the windowed signal,
    sum (w x)^2 / sum w^2.

    **Arguments:** `signal`: real samples [unit] along the last axis, 8 or more; `sampling_rate` [Hz].

    **Raises:** `ValueError` for too few or non-finite samples and a bad rate.
    """
    import scipy.signal  # here, because importing it takes longer than a small simulation

    x = numbers("signal", signal).astype(float)
    enough = x.ndim > 0 and x.shape[-1] >= 8
    require(enough, "signal", "be 8 or more samples along its last axis", shown=f"of shape {x.shape}")
    require(np.isfinite(x).all(), "signal", "be finite", shown="infinite or not a number")
    rate = number(positive, "sampling_rate", sampling_rate, "Hz")
    return Spectrum(*scipy.signal.periodogram(x, rate, window="hann"))


def find_line(
    spectrum: Spectrum,
    frequency: float,
    *,
    tolerance: float | None = None,
) -> Line:
    """Return the line of a spectrum at one frequency, or the strength of the spectrum there if it has no line.

    A line is a local maximum of the density that falls by 6 dB on both sides and is 15 dB above the local floor, the
    running median over 65 bins. Each bin of white noise is such a maximum with a chance of 2^-31.6 (3e-10). Lines
    must be about 8 bins apart or more. A parabola through the logarithms of the three highest bins refines
    frequencies, within 0.02 bins. The power is the sum over the main lobe, which has more than 99.9 % of a line's
    power; the floor's part is not subtracted. Densities 120 dB below the maximum count as floor, because the rounding
    errors of a periodic signal are also periodic, and have lines. Lines within two bins of the ends cannot be
    distinguished from a trend, and are omitted.

    **Arguments:** `frequency` [Hz]; `tolerance`: greatest distance of the line from `frequency` [Hz], by default one
    bin.

    **Raises:** `ValueError` for a density of several cases and a frequency outside the spectrum.
    """
    import scipy.ndimage
    import scipy.signal

    instance("spectrum", spectrum, Spectrum, "a slipperjax.analysis.Spectrum")
    frequencies, density = (np.asarray(x, dtype=float) for x in spectrum)
    size = density.size
    require(density.ndim == 1 and size >= 5, "spectrum", "be of one signal", shown=f"of shape {density.shape}")
    frequency = number(positive, "frequency", frequency, "Hz")
    last = frequencies[-1]
    require(frequency <= last, "frequency", f"be at most {last:g} Hz", shown=f"{frequency:g} Hz")
    width = float(frequencies[1])
    tolerance = width if tolerance is None else number(positive, "tolerance", tolerance, "Hz")
    # density [dB], and its height above the local floor [dB]; a spectrum of zeros is all floor
    top = density.max()
    level = 10 * np.log10(np.fmax(density, 1e-12 * top if top > 0 else 1.0))
    height = level - scipy.ndimage.median_filter(level, size=65, mode="reflect")
    # half the width of the main lobe of a Hann window [bins]
    lobe = 2
    peaks, _ = scipy.signal.find_peaks(level, distance=lobe, prominence=6.0, wlen=65)
    # peaks near the ends have no complete main lobe
    inside = (peaks > lobe) & (peaks < size - 1 - lobe)
    peaks = peaks[inside & (height[peaks] >= 15.0)]
    # half a bin more, because a line at the limit of the tolerance may have its peak in the next bin
    near = np.flatnonzero(abs(frequencies - frequency) <= tolerance + width / 2)
    lines = np.intersect1d(peaks, near)
    choice = lines if lines.size else near
    k = choice[np.argmax(level[choice])]
    shift = 0.0
    if lines.size:
        # the vertex of the parabola, in bins from the highest bin
        left, middle, right = level[k - 1 : k + 2]
        bend = left - 2 * middle + right
        shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    power = np.sum(density[max(k - lobe, 0) : k + lobe + 1]) * width
    return Line(float(frequencies[k] + shift * width), float(power), float(height[k]), bool(lines.size))
