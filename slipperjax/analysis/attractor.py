"""Classification of attractors from states once per forcing period (stroboscopic states): a motion of period n, a
torus, chaos, or unresolved.

A motion is assigned to a class only if it meets all criteria of that class; otherwise it is "unresolved".
"""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..tools.checks import finite, number, numbers, positive, require, whole
from .kinds import Regime

MIN_TEST = 200
"""Least number of periods for distinguishing tori from chaos. Near it, K of a torus scatters up to 0.9, and the
result is "unresolved"; 500 periods are enough."""


class Attractors(NamedTuple):
    """Attractors of motions; arrays over the cases, of shape () for a single case."""

    kind: np.ndarray
    """One of `KINDS`."""
    period: np.ndarray
    """n for a motion of period n, 0 for all other motions."""
    residual: np.ndarray
    """Recurrence distance at the end of the record [scales]: over `period`, or the best over all lags."""
    k: np.ndarray
    """K of the 0-1 test for the motion without its part of the best period: near 0 if regular, near 1 if chaotic, 0
    if nothing remains, NaN for records below `MIN_TEST`."""
    evidence: np.ndarray
    """The deciding criterion, in words."""


def recurrence(
    states: Float[np.ndarray, "*cases periods states"],
    most: int,
) -> dict[int, np.ndarray]:
    """Return by lag n, up to `most`, the greatest changes of a scaled state in n periods, (*cases, periods - n)."""
    return {n: np.abs(states[..., n:, :] - states[..., :-n, :]).max(-1) for n in range(1, most + 1)}


def zero_one_test(
    series: Any,
    *,
    samples: int = 100,
    seed: int = 0,
) -> Float[np.ndarray, "*cases"]:
    """Return K of the 0-1 test for chaos: near 0 for regular, near 1 for chaotic series.

    The correlation method with the oscillation term subtracted: the median over random c in (pi/5, 4 pi/5) of the
    correlation of n with D_c(n) = M_c(n) - (mean phi)^2 (1 - cos n c) / (1 - cos c), where M_c is the mean square
    displacement of sum_j phi_j exp(i j c) over n <= periods / 10 steps. Gottwald and Melbourne 2009,
    doi:10.1137/080718851. A constant series has K = 0. Noise has K near 1.

    **Arguments:** `series`: phi, shape (*cases, periods), one scalar per forcing period and not an oversampled
    record; `samples`: number of values of c; `seed`: of the random c.

    **Returns:** shape (*cases,), NaN for series that are not finite.

    **Raises:** `ValueError` for fewer than 40 periods and settings out of range.
    """
    x = numbers("series", series).astype(float)
    require(
        x.ndim > 0 and x.shape[-1] >= 40,
        "series",
        "be of 40 periods or more",
        shown=f"of shape {x.shape}",
    )
    count = whole("samples", samples, 1)
    generator = np.random.default_rng(whole("seed", seed, 0))
    c = generator.uniform(math.pi / 5, 4 * math.pi / 5, count)
    rows = [_growth_of_displacement(row, c) for row in x.reshape(-1, x.shape[-1])]
    return np.reshape(rows, x.shape[:-1])


def classify(
    strobe: Any,
    *,
    scales: Any = None,
    max_period: int = 16,
    tolerance: float = 1e-3,
    floor: float = 1e-6,
) -> Attractors:
    """Return the attractor of each motion.

    - "period": after n periods the states recur, within `tolerance` of the attractor's extent or within `floor`, from
      one period n to the next and over a quarter of the record; or the residual of recurrence decays geometrically
      to zero, in a slow transient. n is the smallest possible.
    - "chaotic": K of the 0-1 test above 0.8, and neighbours diverge.
    - "torus": K below 0.2, neighbours stay close, the states fill the section evenly, their mean and spread
      do not drift, and the residuals over all lags do not decay together.
    - "unresolved": everything else. Records below `MIN_TEST` periods can only be periodic or unresolved.

    These are not distinguished: splittings and chaotic bands narrower than the tolerance from periodic motions;
    transients that drift by less than the tolerance in a quarter of the record from settled motions; long chaotic
    transients from chaos. Noise, and chaos of so many dimensions that the record has no near neighbours, are
    "unresolved".

    **Arguments:** `strobe`: states once per forcing period without the transient, shape (*cases, periods, states)
    or (periods, states), 16 periods or more; of an angle that goes round, give sine and cosine. `scales`, shape
    (states,): divisors of the states, in their units. The default is the greatest magnitude over all cases and
    periods (1 where that is below 1e-12, so that rounding errors of a state that is zero by symmetry are not
    amplified); explicit scales are better, such as clearance and clearance times frequency.
    `max_period`: greatest n (at most a quarter of the record is tried);
    `tolerance`: as a fraction of the attractor's extent, which is the greatest peak-to-peak value of a scaled
    state in the last quarter of the record, and above the error of an integration that is accurate to 1e-4;
    `floor` [scales]: smaller distances count as zero.

    **Returns:** `Attractors`; cases that are not finite are "unresolved".

    **Raises:** `ValueError` for arrays of other shapes, too few periods and settings out of range.
    """
    x = _scaled(strobe, scales)
    most = whole("max_period", max_period, 1)
    for name, value in (("tolerance", tolerance), ("floor", floor)):
        require(0 < number(finite, name, value) < 1, name, "be above 0 and below 1", value)
    cases = [_classified(states, most, tolerance, floor) for states in x.reshape(-1, *x.shape[-2:])]
    return Attractors(*(np.reshape(column, x.shape[:-2]) for column in zip(*cases, strict=True)))


def _scaled(strobe, scales):
    """Return checked states over their scales."""
    x = numbers("strobe", strobe).astype(float)
    enough = x.ndim >= 2 and x.shape[-2] >= 16 and x.size
    need = "be of shape (*cases, periods, states) with 16 periods or more"
    require(enough, "strobe", need, shown=f"of shape {x.shape}")
    if scales is None:
        every = x.reshape(-1, x.shape[-1])
        scales = np.max(np.abs(every), axis=0, initial=0.0, where=np.isfinite(every))
        scales = np.where(scales < 1e-12, 1.0, scales)
    scales = positive("scales")(scales)
    require(scales.shape in ((), x.shape[-1:]), "scales", f"be of shape {x.shape[-1:]}", scales.shape)
    return x / np.asarray(scales)


def _classified(states, most, tolerance, floor):
    """Return the entries of `Attractors` for one case."""
    lost = ~np.isfinite(states).all(-1)
    if lost.any():
        text = f"non-finite states from period {int(np.argmax(lost))} on"
        return Regime.UNRESOLVED.kind_name, 0, np.nan, np.nan, text
    case = _Case(states, most, tolerance, floor)
    return case.recurrent() or case.decaying() or case.irregular()


class _Case:
    """The states of one motion, with the residuals of their recurrence over all lags."""

    def __init__(self, states, most, tolerance, floor):
        self.states = states
        self.tolerance = tolerance
        self.floor = floor
        self.periods = len(states)
        self.quarter = self.periods // 4
        self.extent = np.ptp(states[-self.quarter :], axis=0).max()
        self.near = max(tolerance * self.extent, floor)
        """Distance that counts as none."""
        self.lags = range(1, min(most, self.quarter) + 1)
        self.residuals = recurrence(states, self.lags[-1])
        self.at_end = {n: residual[-self.tail(n) :].max() for n, residual in self.residuals.items()}
        self.best = min(self.lags, key=lambda n: self.at_end[n])
        self.k = self.chaos()

    def result(self, regime, lag, evidence):
        """Return the entries of `Attractors`, with the residual over `lag` periods, by the deciding criterion."""
        period = lag if regime == Regime.PERIODIC else 0
        return regime.kind_name, period, self.at_end[lag], self.k, evidence

    def tail(self, n):
        """Return the number of periods at the end over which a residual is judged."""
        return max(n, self.periods // 10)

    def fit(self, n, floor):
        """Return the decay of the residual over n periods; NaN where the record is too short."""
        residual = self.residuals[n]
        windows = len(residual) // max(n, 4)
        return _decay(residual, min(12, windows), floor) if windows >= 6 else _Decay()

    def chaos(self):
        """Return K of the 0-1 test, without the part of the best period; NaN for short records."""
        if self.periods < MIN_TEST:
            return np.nan
        part = _irregular_part(self.states, self.best)
        # below the tolerance only rounding and integration errors remain, whose K is meaningless
        return float(zero_one_test(part)) if np.ptp(part) > self.near else 0.0

    def recurrent(self):
        """Return a verdict where states recur, by the shortest period over which they do."""
        for n in self.lags:
            shorter = [self.at_end[m] for m in _divisors(n)]
            # near the floor, a decay that rotates by a third of a turn per period looks like period 3
            if self.at_end[n] > self.near or any(residual < 10 * self.floor for residual in shorter):
                continue
            # Slow drifts near a resonance or a bifurcation are visible over many periods only, and in a short record
            # only at their onset; they must also be small against the difference of period n from its divisors.
            far = n * max(2, self.quarter // n)
            before = self.states[-self.tail(n) - far : self.periods - far]
            drift = np.abs(self.states[-self.tail(n) :] - before).max()
            split = min(shorter, default=self.extent)
            if drift > max(min(self.near * min(1, far / 100), 3 * self.tolerance * split), self.floor):
                continue
            growing = self.fit(n, 1e-14)  # departure from an unstable motion, from rounding errors on
            if growing.fall < -math.log(10) and growing.fit > 0.95:
                text = f"recurs after {n} periods, but the residual grows by {-growing.rate:.2g} per period"
                return self.result(Regime.UNRESOLVED, n, text)
            text = f"recurs after {n} periods within {self.at_end[n]:.1e}, of an extent of {self.extent:.1e}"
            return self.result(Regime.PERIODIC, n, text)
        return None

    def decaying(self):
        """Return a verdict where the residual over some period decays to zero."""
        for n in self.lags:
            decay = self.fit(n, self.floor)
            # of period n, and not of a divisor of n, only if the residuals over the divisors do not decay
            falls = [self.fit(m, self.floor).fall for m in _divisors(n)]
            if decay.convincing and all(abs(fall) < 0.3 * decay.fall for fall in falls):
                speed = f"{decay.rate:.2g} per period, to {self.at_end[n]:.1e} so far"
                return self.result(Regime.PERIODIC, n, f"residual over {n} periods decays by {speed}")
        return None

    def irregular(self):
        """Return the verdict where no residual vanishes or decays: torus, chaos or unresolved."""
        unresolved = lambda text: self.result(Regime.UNRESOLVED, self.best, text)
        if self.periods < MIN_TEST:
            few = f"{self.periods} periods are too few to tell a torus from chaos ({MIN_TEST} needed)"
            return unresolved(f"no recurrence, and {few}")
        if self.extent < 100 * self.floor:
            small = f"the extent of {self.extent:.1e} is near the floor of {self.floor:.0e}"
            return unresolved(f"no recurrence, but {small}")
        first, growth, gap, mixing = _neighbours(self.states)
        facts = f"K = {self.k:.2f}, ln growth of neighbours {first:.2f} in one period, then {growth:.2f}"
        # the first period counts in their sum only, because in noise neighbours part in it, too
        if self.k > 0.8 and growth > 0.12 and first + growth > 0.7:
            return self.result(Regime.CHAOTIC, self.best, facts)
        if self.k >= 0.2 or growth >= 0.12:
            return unresolved(f"{facts}: neither regular nor chaotic")
        if gap < 0.05 * self.extent / self.periods:
            bunch = f"the states bunch: a period above {self.lags[-1]}, or one not reached yet"
            return unresolved(f"{facts}, but {bunch}")
        rates = np.array([self.fit(n, self.floor).rate for n in self.lags])
        spiral = np.std(rates) < 0.3 * abs(np.mean(rates))  # residuals over all lags decay alike
        if _drift(self.states) > 0.01 or mixing > 3 or spiral:
            return unresolved(f"{facts}, but the states still drift or spiral")
        text = f"{facts}, no recurrence up to {self.lags[-1]} periods, no decay, no drift"
        return self.result(Regime.REGULAR, self.best, text)


def _divisors(n):
    """Return the divisors of n below n."""
    return [m for m in range(1, n) if n % m == 0]


def _irregular_part(x, n):
    """Return a series for the 0-1 test: the scaled states along the direction in which they vary most, without the
    part of period n, which would make chaos in n bands, visited in turn, look regular."""
    y = x - x.mean(0)
    series = y @ np.linalg.svd(y, full_matrices=False)[2][0]
    for phase in range(n):
        series[phase::n] -= series[phase::n].mean()
    return series


class _Decay(NamedTuple):
    """Geometric fit to the envelope of a residual; NaN where there is nothing to fit."""

    rate: float = np.nan
    """Decay rate per forcing period: the envelope goes as exp(-rate k). Negative where it grows."""
    fall: float = np.nan
    """ln of the ratio of first to last value of the fit."""
    fit: float = np.nan
    """Coefficient of determination R^2 of the fit to ln of the envelope."""
    steadiness: float = np.nan
    """Rate in the second half over rate in the first: 1 for a geometric decay to zero, less for algebraic decays and
    for decays to other limits."""

    @property
    def convincing(self):
        """True for a geometric decay to zero: by half or more, with R^2 >= 0.95 and a steady rate."""
        return self.fall >= math.log(2) and self.fit >= 0.95 and 0.85 <= self.steadiness <= 1.5


def _decay(residual, windows, floor):
    """Return the fit of exp(-rate k) to the maxima of a residual over windows of equal length.

    With maxima, spiral decays, which oscillate below their envelope, are fitted as well as monotone ones. Maxima at
    or below `floor` are omitted, because rounding and integration errors dominate there.
    """
    length = len(residual) // windows
    envelope = residual[len(residual) - windows * length :].reshape(windows, length).max(1)
    k = np.flatnonzero(envelope > floor)
    if len(k) < 6:
        return _Decay()
    y = np.log(envelope[k])
    slope, offset = np.polyfit(k, y, 1)
    spread = np.sum((y - y.mean()) ** 2)
    fit = 1 - np.sum((y - offset - slope * k) ** 2) / spread if spread > 0 else 0.0
    half = len(k) // 2
    first = np.polyfit(k[:half], y[:half], 1)[0]
    second = np.polyfit(k[half:], y[half:], 1)[0]
    return _Decay(-slope / length, -slope * (k[-1] - k[0]), fit, second / first if first else np.nan)


def _growth_of_displacement(series, c):
    """Return the median over c of the correlation of n with D_c(n)."""
    if not np.isfinite(series).all():
        return np.nan
    if np.ptp(series) <= 1e-12 * np.abs(series).max():
        return 0.0
    series = series / np.abs(series).max()
    most = len(series) // 10
    steps = np.arange(1, most + 1)
    angle = c[:, None]
    z = np.cumsum(series * np.exp(1j * angle * np.arange(len(series))), axis=-1)
    displacement = _mean_square_displacement(z, steps)
    displacement -= series.mean() ** 2 * (1 - np.cos(steps * angle)) / (1 - np.cos(angle))
    a = steps - steps.mean()
    b = displacement - displacement.mean(1, keepdims=True)
    spread = np.sqrt(np.sum(a**2) * np.sum(b**2, axis=1))
    return float(np.median(b @ a / np.where(spread > 0, spread, 1.0)))


def _mean_square_displacement(z, steps):
    """Return the mean of |z_{j+n} - z_j|^2 over j for each of `steps` n; z: (samples, periods)."""
    length = z.shape[1]
    count = length - steps[-1]
    # the squares by running sums, the products as a correlation by FFT
    square = np.cumsum(np.abs(z) ** 2, axis=-1)
    moved = square[:, steps + count - 1] - square[:, steps - 1]
    size = 1 << int(length + count).bit_length()
    product = np.fft.ifft(np.fft.fft(z, size) * np.conj(np.fft.fft(z[:, :count], size)))[:, steps].real
    return (moved + square[:, [count - 1]] - 2 * product) / count


def _neighbours(x, most=30, window=10):
    """Return measures of the divergence of neighbours on the section, and of how evenly the states fill it.

    **Arguments:** `most`: greatest number of periods over which neighbours are followed, a fifth of the record if
    that is shorter; `window`: states fewer than this many periods apart in time do not count as neighbours (Theiler).

    **Returns:** the mean growth of ln of the distance of nearest neighbours in one period, and from there on to
    `most` (Rosenstein, Collins and De Luca 1993, doi:10.1016/0167-2789(93)90009-P); the median distance
    of nearest neighbours; the median distance of states of the second half to their nearest state in the first half,
    over that to their nearest state in the second half.
    """
    periods = len(x)
    distance = np.zeros((periods, periods))
    for state in x.T:  # one state at a time, to save memory
        np.maximum(distance, np.abs(state[:, None] - state), out=distance)
    tiny = 1e-12 * distance.max()
    ahead = min(most, periods // 5)
    # of states that can be followed ahead, pairs that are near in space and not in time
    index = np.arange(periods)
    lag = np.abs(index[:, None] - index)
    apart = np.where(lag < window, np.inf, distance)
    count = periods - ahead
    other = np.argmin(apart[:count, :count], axis=1)
    steps = np.arange(ahead + 1)[:, None]
    mean = np.log(np.maximum(distance[index[:count] + steps, other + steps], tiny)).mean(1)
    # without the first period, in which the distance to the nearest neighbour, a minimum, grows in noise too
    growth = mean[ahead // 2 :].mean() - mean[1]
    half = periods // 2
    own = np.where(lag == 0, np.inf, distance)[half:, half:].min(1)
    mixing = np.median(distance[half:, :half].min(1)) / max(np.median(own), tiny)
    return float(mean[1] - mean[0]), float(growth), float(np.median(apart.min(1))), float(mixing)


def _drift(x):
    """Return the greatest change of mean and spread of a state between both halves, over the greatest spread.

    Weighted by a Hann window, so that incomplete turns of a torus in either half do not count as drift.
    """
    half = len(x) // 2
    weight = np.sin(np.pi * (np.arange(half) + 0.5) / half) ** 2
    weight = weight / weight.sum()
    means, spreads = [], []
    for part in (x[:half], x[-half:]):
        means.append(weight @ part)
        spreads.append(np.sqrt(weight @ (part - means[-1]) ** 2))
    change = np.maximum(np.abs(means[0] - means[1]), np.abs(spreads[0] - spreads[1]))
    return float(change.max() / max(np.max(spreads), 1e-300))
