"""Features of signals: numbers that describe a motion without its phase, and that disturbances hardly change.

All features are about normally distributed over chaotic records. Signals are arrays (records, samples) at equal
times.
"""

import abc
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import pdist

from ..tools.checks import fraction, numbers, require, whole

Signals = Float[np.ndarray, "records samples"]
Values = Float[np.ndarray, "records features"]
FEWEST = 0.5
"""Number of events that is counted where there is none [1]."""
_SHARES = fraction("shares")


@dataclass(frozen=True)
class AbstractFeature(abc.ABC):
    """A kind of features."""

    @abc.abstractmethod
    def of(self, record: Float[np.ndarray, " samples"]) -> tuple[list[str], Callable[[Signals], Values]]:
        """Return names of features, and a function of signals that computes them.

        **Arguments:** `record`: the measured signal, which gives thresholds.
        """


@dataclass(frozen=True)
class BandRms(AbstractFeature):
    """Logarithms of the RMS in bands of frequency, of equal width on a logarithmic scale."""

    bands: int = 6
    """Number of bands, up to half the sampling rate."""

    def __post_init__(self):
        whole("bands", self.bands, 1, 100)

    def of(self, record):
        def values(signals: Signals) -> Values:
            count = signals.shape[1]
            lines = np.abs(np.fft.rfft((signals - signals.mean(1, keepdims=True)) * np.hanning(count))) ** 2
            # from the fourth line on, at least one line in each band
            edges = np.unique(np.geomspace(4, count // 2 + 1, self.bands + 1).astype(int))
            power = [lines[:, low:high].sum(axis=1) for low, high in itertools.pairwise(edges)]
            return 0.5 * np.log(np.maximum(power, 1e-300)).T

        return [f"band {k + 1}" for k in range(values(record[None]).shape[1])], values


@dataclass(frozen=True)
class Peaks(AbstractFeature):
    """Logarithms of quantiles of a signal's magnitude about its mean."""

    shares: tuple[float, ...] = (0.5, 0.9, 0.99)

    def __post_init__(self):
        _SHARES(self.shares)

    def of(self, record):
        def values(signals: Signals) -> Values:
            size = np.abs(signals - signals.mean(1, keepdims=True))
            return np.log(np.maximum(np.quantile(size, self.shares, axis=1).T, 1e-300))

        return [f"{share:.3g} quantile" for share in self.shares], values


@dataclass(frozen=True)
class ImpactRate(AbstractFeature):
    """Logarithm of how often a signal rises beyond some multiples of the measured signal's RMS."""

    levels: tuple[float, ...] = (1.0, 2.0)

    def __post_init__(self):
        numbers("levels", self.levels, 1)

    def of(self, record):
        threshold = np.array(self.levels) * record.std()

        def values(signals: Signals) -> Values:
            beyond = (signals - signals.mean(1, keepdims=True))[:, None] > threshold[:, None]
            rises = np.sum(beyond[..., 1:] & ~beyond[..., :-1], axis=2)
            return np.log(rises + FEWEST)

        return [f"rises beyond {level:g} rms" for level in self.levels], values


@dataclass(frozen=True)
class ContactFraction(AbstractFeature):
    """Logarithms of the odds that a force is beyond some multiples of the measured force's RMS, on both sides."""

    levels: tuple[float, ...] = (0.2,)

    def __post_init__(self):
        numbers("levels", self.levels, 1)

    def of(self, record):
        threshold = np.array(self.levels) * np.sqrt(np.mean(record**2))

        def values(signals: Signals) -> Values:
            inside = np.sum(np.abs(signals)[:, None] > threshold[:, None], axis=2)
            return np.log((inside + FEWEST) / (signals.shape[1] - inside + FEWEST))

        return [f"contact beyond {level:g} rms" for level in self.levels], values


@dataclass(frozen=True)
class CorrelationIntegral(AbstractFeature):
    """Logarithms of the share of pairs of instants at which a signal and its past are closer than some radii.

    H. Haario, L. Kalachev, J. Hakkarainen, *Generalized correlation integral vectors: A distance concept for chaotic
    dynamical systems*, Chaos 25 (2015) 063102, doi:10.1063/1.4921939.
    """

    shares: tuple[float, ...] = (0.03, 0.1, 0.3)
    """Shares of pairs in the measured signal that choose the radii."""
    dimension: int = 4
    """Number of values of the signal in a point."""
    instants: int = 200
    """Number of points in each record, at equal intervals."""

    def __post_init__(self):
        _SHARES(self.shares)
        whole("dimension", self.dimension, 1, 20)
        whole("instants", self.instants, 10, 2000)

    def of(self, record):
        # the first zero of the autocorrelation is a good delay
        x = record - record.mean()
        power = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
        correlation = np.fft.irfft(power)[: len(x) // 4]
        delay = max(int(np.argmax(correlation < 0)), 1) // 2 + 1

        last = len(record) - (self.dimension - 1) * delay
        most = (len(record) - 2) // delay + 1
        need = f"be at most {most} for a record of {len(record)} samples, whose values are {delay} apart"
        require(last > 1, "dimension", need, self.dimension)
        at = np.linspace(0, last - 1, min(self.instants, last)).astype(int)
        points = at[:, None] + delay * np.arange(self.dimension)
        apart = lambda signal: pdist(signal[points], "chebyshev")
        radii = np.quantile(apart(record), self.shares)

        def values(signals: Signals) -> Values:
            return np.array([[np.log((np.sum(d < r) + FEWEST) / d.size) for r in radii] for d in map(apart, signals)])

        return [f"correlation integral {share:g}" for share in self.shares], values


DEFAULT = (BandRms(), Peaks(), ImpactRate(), CorrelationIntegral())
