"""Signals of a fit and the measured signals, as variables of a dataset, and the residuals between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from ..analysis.environment import band_edges, window_densities
from ..flow.record import Labelled
from ..model.sensors import Rig
from ..tools.columns import column
from .course import Windows
from .measured import FEWEST
from .method import Posterior

MOST_NOISE_RATIO = 1.2
"""Residual over the given noise above which a model does not explain a signal [1]."""
SIGNIFICANCE = 1e-3
"""Probability of residuals below which a model does not explain them."""


@dataclass(frozen=True, kw_only=True)
class SignalPosterior(Posterior):
    """What is known about the parameters, and the signals that follow from them."""

    noise: Float[np.ndarray, " sensors"]
    """Standard deviations that the fit assumed for noise [the sensors' units]."""
    windows: Windows
    reading: Float[np.ndarray, "windows sensors samples"]
    """The signals of the model."""
    draws: Float[np.ndarray, "draws windows sensors samples"]
    """Signals of other parameters and starts that are as likely."""

    @property
    def left(self) -> list[Float[np.ndarray, " samples"]]:
        """Residuals of each sensor's signals, one window after the other [its unit]."""
        left = np.moveaxis(self.windows.value - self.reading, 1, 0)
        known = np.moveaxis(self.windows.known > 0, 1, 0)
        return [left[k][known[k]] for k in range(len(left))]

    @property
    def noise_left(self) -> Float[np.ndarray, " sensors"]:
        """RMS of the residuals of each sensor's signals [its unit]."""
        return np.array([np.sqrt(np.mean(left**2)) for left in self.left])

    @property
    def whiteness(self) -> Float[np.ndarray, " sensors"]:
        """For each sensor the probability that white noise is as correlated as the residuals [1]."""
        return np.array([whiteness(left) for left in self.left])

    def misfit(self, rig: Rig) -> list[str]:
        texts = []
        for sensor, white, left in zip(rig.sensors, self.whiteness, self.noise_left, strict=True):
            parts = []
            if white < SIGNIFICANCE:
                parts.append(f"what is left is no white noise (p = {white:.1g})")
            if sensor.noise is not None and left > MOST_NOISE_RATIO * sensor.noise:
                parts.append(f"it is {left / sensor.noise:.2g} times the noise")
            if parts:
                texts.append(f"the model does not explain {sensor.name}: {' and '.join(parts)}")
        return texts

    def label(self, rig: Rig) -> Labelled:
        windows = self.windows
        known = windows.known > 0
        low, high = np.quantile(self.draws, [0.05, 0.95], axis=0)
        over = ("window", "sensor", "sample")
        signal = lambda values, unit, text: column(over, np.where(known, values, np.nan), unit, text)
        data = {
            "noise": column("sensor", self.noise_left, "", "RMS of what the model leaves, in the sensor's unit"),
            "whiteness": column("sensor", self.whiteness, "1", "probability that white noise is as correlated"),
            "seconds": signal(windows.time, "s", "time since the run began"),
            "measured": signal(windows.value, "", "measured signal, in the sensor's unit"),
            "fitted": signal(self.reading, "", "signal of the model, in the sensor's unit"),
            "fitted_low": signal(low, "", "5 % quantile of likely signals, in the sensor's unit"),
            "fitted_high": signal(high, "", "95 % quantile of likely signals, in the sensor's unit"),
        }
        # of the window with the most samples, with noise
        most = int(np.argmax(known.sum(axis=(1, 2))))
        draws = self.draws[:, most]
        likely = draws + self.noise[:, None] * np.random.default_rng(0).normal(size=draws.shape)
        rows, coords = densities(windows, most, likely)
        return data | rows, coords | {"run": ("window", windows.run)}


def whiteness(residual: Float[np.ndarray, " samples"]) -> float:
    """Return the probability that white noise is at least as correlated as some residuals, by Ljung and Box's test.

    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297, doi:10.1093/biomet/65.2.297.
    """
    count = len(residual)
    lags = np.arange(1, min(20, count // 5) + 1)
    x = residual - residual.mean()
    power = x @ x
    correlation = np.array([x[k:] @ x[:-k] for k in lags]) / power
    statistic = count * (count + 2) * np.sum(correlation**2 / (count - lags))
    return float(chi2.sf(statistic, len(lags)))


def densities(windows: Windows, number: int, likely: Float[np.ndarray, "signals sensors samples"]) -> Labelled:
    """Return power spectral densities of the signals measured in a window, and of likely ones, in third octaves.

    **Returns:** no frequencies where no sensor has eight samples, the least number for a density.
    """
    known = windows.known[number] > 0
    signals = np.array([windows.value[number], *likely])
    times = enumerate(windows.time[number])
    used = {k: time[known[k]] for k, time in times if known[k].sum() >= FEWEST}
    rates = {k: (len(at) - 1) / np.ptp(at) for k, at in used.items()}
    longest = max(map(np.ptp, used.values()), default=0.0)
    edges = np.ones(1)
    if used:
        top = max(rates.values()) / 2
        edges = band_edges(min(4.0 / longest, top / 4), top, per_octave=3)
    found = np.full((*signals.shape[:2], len(edges) - 1), np.nan)
    for k, at in used.items():
        # unequal samples become equal samples, in the same way for all signals
        grid = np.linspace(at[0], at[-1], len(at))
        equal = np.array([np.interp(grid, at, signal[k][known[k]]) for signal in signals])
        found[:, k] = window_densities(equal, rates[k], edges, window=longest)[1].mean(axis=-2)
    along = ("sensor", "frequency")
    text = "power spectral density, the square of the sensor's unit per Hz"
    data = {"measured_density": column(along, found[0], "", f"{text}, measured")}
    for name, share in (("density_low", 0.05), ("density", 0.5), ("density_high", 0.95)):
        data[name] = column(along, np.quantile(found[1:], share, axis=0), "", f"{text}, {share:.0%} of likely ones")
    middles = np.sqrt(edges[1:] * edges[:-1])
    return data, {"frequency": column("frequency", middles, "Hz", "middle of a band")}
