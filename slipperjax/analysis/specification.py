"""Straight-line specifications of a vibration: few lines on logarithmic axes, above a spectrum."""

import numpy as np
from jaxtyping import Float

from ..tools.checks import finite, number, numbers, require, whole
from ..tools.types import Numbers

ENOUGH = 0.5
"""Mean height of lines above a spectrum at which further breakpoints are not worth it [dB]."""


def straight_lines(
    frequency: Numbers,
    density: Numbers,
    *,
    margin: float = 0.0,
    breakpoints: int = 8,
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Return straight lines on logarithmic axes that are nowhere below a spectrum, as test specifications have them.

    Of all lines between some frequencies, those with the least mean height above the spectrum are found by a linear
    program. Frequencies are added one after the other, each where it lowers the mean height most, until the mean
    height is below 0.5 dB or there are as many as allowed.

    **Arguments:** `frequency`: increasing [Hz]; `density`: positive, in any unit; `margin`: added to the spectrum
    first [dB]; `breakpoints`: greatest number of frequencies, at least two.

    **Returns:** frequencies of the breakpoints [Hz], and the densities there.

    **Raises:** `ValueError` that names the wrong argument.
    """
    bands = numbers("frequency", frequency, 1, "Hz")
    spectrum = numbers("density", density, 1)
    alike = bands.shape == spectrum.shape and len(bands) >= 2
    require(alike, "density", f"have a value for each frequency, {len(bands)}", shown=f"shape {spectrum.shape}")
    rising = bands[0] > 0 and np.all(np.diff(bands) > 0)
    require(rising and np.all(spectrum > 0), "frequency", "increase, with positive densities", shown="others")
    places = np.log(bands)
    levels = 10 * np.log10(spectrum) + number(finite, "margin", margin, "dB")
    most = whole("breakpoints", breakpoints, 2)
    # neighbouring bands stand for the width between their middles
    widths = np.gradient(places)
    chosen = [0, len(places) - 1]
    excess, heights = _least_above(places, levels, widths, chosen)
    while excess > ENOUGH and len(chosen) < most:
        tried = [sorted([*chosen, k]) for k in range(len(places)) if k not in chosen]
        found = [_least_above(places, levels, widths, each) for each in tried]
        best = int(np.argmin([mean for mean, _ in found]))
        if found[best][0] >= excess:
            break
        chosen = tried[best]
        excess, heights = found[best]
    return np.exp(places[chosen]), 10 ** (heights / 10)


def _least_above(
    places: np.ndarray, levels: np.ndarray, widths: np.ndarray, at: list[int]
) -> tuple[float, np.ndarray]:
    """Return the mean height [dB] of the lowest lines between some places that are not below the levels, and the
    levels of the lines at these places [dB]."""
    from scipy.optimize import linprog  # here, because importing it takes time

    # shares of the two neighbouring breakpoints in the line's level at each place
    shares = np.stack([np.interp(places, places[at], row) for row in np.eye(len(at))], axis=1)
    found = linprog(widths @ shares, A_ub=-shares, b_ub=-levels, bounds=(None, None), method="highs")
    return float(widths @ (shares @ found.x - levels) / widths.sum()), found.x


def rms_of_lines(frequency: Numbers, density: Numbers) -> float:
    """Return the root mean square under straight lines on logarithmic axes, the integral of their power laws.

    **Arguments:** `frequency` [Hz] and `density` [unit^2/Hz] of the breakpoints.
    """
    f = numbers("frequency", frequency, 1, "Hz")
    level = numbers("density", density, 1)
    slope = np.diff(np.log(level)) / np.diff(np.log(f))
    # a density that falls with 1/f has a logarithm as its integral
    is_log = np.abs(slope + 1) < 1e-9
    power = np.where(is_log, 1.0, slope + 1)
    areas = np.where(
        is_log,
        level[:-1] * f[:-1] * np.log(f[1:] / f[:-1]),
        level[:-1] * f[:-1] / power * ((f[1:] / f[:-1]) ** power - 1),
    )
    return float(np.sqrt(areas.sum()))
