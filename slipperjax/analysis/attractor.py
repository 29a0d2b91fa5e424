"""Classification of attractors from states once per forcing period (stroboscopic states): a motion of period n, a
torus, chaos, or unresolved.

A motion is assigned to a class only if it meets all criteria of that class; otherwise it is "unresolved".
"""

import math
from typing import NamedTuple

import numpy as np

from ..tools.checks import finite, not_negative, number, numbers, real, require, whole
from .kinds import Regime

MIN_TEST = 200
"""Least number of periods for distinguishing tori from chaos. Near it, K of a torus scatters up to 0.9, and the
result is "unresolved"; 500 periods are enough."""
K_REGULAR, K_CHAOTIC = 0.2, 0.8
"""Bounds of the 0-1 test's K: below the first regular, above the second chaotic."""
LATER_GROWTH, WHOLE_GROWTH = 0.12, 0.7
"""Bounds of the growth of ln of the distance of neighbours. After the first period it is below `LATER_GROWTH` on a
torus and above it in chaos; including the first period, in which noise grows too, it is above `WHOLE_GROWTH` in
chaos."""
NEIGHBOUR_PERIODS = 30
"""Greatest number of periods over which neighbours are followed (a fifth of the record if that is shorter)."""
THEILER_WINDOW = 10
"""States fewer than this many periods apart in time do not count as neighbours."""


class Decay(NamedTuple):
    """Geometric fit to the envelope of a residual; arrays over the cases, NaN where there is nothing to fit."""

    rate: np.ndarray
    """Decay rate per forcing period: the envelope goes as exp(-rate k). Negative where it grows."""
    fall: np.ndarray
    """ln of the ratio of first to last value of the fit."""
    fit: np.ndarray
    """Coefficient of determination R^2 of the fit to ln of the envelope."""
    steadiness: np.ndarray
    """Rate in the second half over rate in the first: 1 for a geometric decay to zero, less for algebraic decays and
    for decays to other limits."""

    @property
    def convincing(self):
        """True for a geometric decay to zero: by half or more, with R^2 >= 0.95 and a steady rate."""
        steady = (self.steadiness >= 0.85) & (self.steadiness <= 1.5)
        return (self.fall >= math.log(2)) & (self.fit >= 0.95) & steady


class Attractors(NamedTuple):
    """Attractors of motions; arrays over the cases, of shape () for a single case."""

    kind: np.ndarray
    """One of `KINDS`."""
    period: np.ndarray
    """n for a motion of period n, 0 for all other motions."""
    residual: np.ndarray
    """Recurrence distance at the end of the record [scales]: over `period`, or the best over all lags."""
    decay: np.ndarray
    """Decay rate of that recurrence residual per forcing period; NaN where nothing could be fitted."""
    growth: np.ndarray
    """Mean growth of ln of neighbours' distance, from one period to `NEIGHBOUR_PERIODS`; NaN if an earlier criterion
    decided."""
    k: np.ndarray
    """K of the 0-1 test for the motion without its part of the best period: near 0 if regular, near 1 if chaotic, 0
    if nothing remains, NaN for records below `MIN_TEST`."""
    evidence: np.ndarray
    """The deciding criterion, in words."""

    def __repr__(self) -> str:
        kinds = np.where(
            np.asarray(self.kind) == "period", np.char.add("period ", np.char.mod("%d", self.period)), self.kind
        )
        if kinds.ndim == 0:
            return f"Attractors({kinds}: {self.evidence})"
        counts = [f"{name}: {count}" for name, count in zip(*np.unique(kinds, return_counts=True), strict=True)]
        return f"Attractors({kinds.size} cases: {', '.join(counts)})"


def recurrence(strobe, *, scales=None, turns=None, max_period=16) -> np.ndarray:
    """Computes recurrence residuals |x_k - x_{k-n}|, in the maximum norm over scaled states.

    **Arguments:** `strobe`: shape (*cases, periods, states); `scales`, shape (states,): divisors of the
    states, in their units, by default as in `classify`; `turns`: as there; `max_period`: greatest lag n.

    **Returns:** shape (*cases, max_period, periods), [scales]; entry (n - 1, k) is for lag n, NaN for k < n.

    **Raises:** `ValueError` for arrays of other shapes, and scales that are not positive.
    """
    x = _scaled(strobe, scales, turns)
    most = whole("max_period", max_period, 1)
    periods = x.shape[-2]
    out = np.full((*x.shape[:-2], most, periods), np.nan)
    for n in range(1, min(most, periods - 1) + 1):
        out[..., n - 1, n:] = np.abs(x[..., n:, :] - x[..., :-n, :]).max(-1)
    return out


def decay_rate(residual, *, windows=12, floor=0.0) -> Decay:
    """Fits exp(-rate k) to the envelope of a residual: its maxima over `windows` windows of equal length.

    With maxima, spiral decays, which oscillate below their envelope, are fitted as well as monotone ones.

    **Arguments:** `residual`: shape (*cases, periods), not negative; leading NaN are skipped; `windows`: 6 or
    more; `floor`: windows with maxima at or below it are omitted, because rounding and integration errors dominate
    there.

    **Raises:** `ValueError` for settings out of range.
    """
    r = numbers("residual", residual).astype(float)
    windows = whole("windows", windows, 6)
    require(r.ndim != 0, "residual", "be of shape (*cases, periods)", r)
    floor = number(not_negative, "floor", floor)
    fits = [_geometric_fit(row, windows, floor) for row in r.reshape(-1, r.shape[-1])]
    return Decay(*np.reshape(np.array(fits, dtype=float).T, (4, *r.shape[:-1])))


def zero_one_test(series, *, samples=100, seed=0) -> np.ndarray:
    """Computes K of the 0-1 test for chaos: near 0 for regular, near 1 for chaotic series.

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
    if x.ndim == 0 or x.shape[-1] < 40:
        raise ValueError(f"Argument `series` must be of 40 periods or more, but is of shape {x.shape}.")
    count = whole("samples", samples, 1)
    c = np.random.default_rng(whole("seed", seed, 0)).uniform(math.pi / 5, 4 * math.pi / 5, count)
    rows = [_growth_of_displacement(row, c) for row in x.reshape(-1, x.shape[-1])]
    return np.reshape(rows, x.shape[:-1])


def classify(strobe, *, scales=None, turns=None, max_period=16, tolerance=1e-3, floor=1e-6, seed=0) -> Attractors:
    """Classifies the attractor of each motion.

    - "period": after n periods the states recur, within `tolerance` of the attractor's extent or within `floor`, from
      one period n to the next and over a quarter of the record; or the residual of recurrence decays geometrically
      to zero (`Decay.convincing`), in a slow transient. n is the smallest possible.
    - "chaotic": K of the 0-1 test above `K_CHAOTIC`, and neighbours diverge.
    - "torus": K below `K_REGULAR`, neighbours stay close, the states fill the section evenly, their mean and spread
      do not drift, and the residuals over all lags do not decay together.
    - "unresolved": everything else. Records below `MIN_TEST` periods can only be periodic or unresolved.

    These are not distinguished: splittings and chaotic bands narrower than the tolerance from periodic motions;
    transients that drift by less than the tolerance in a quarter of the record from settled motions; long chaotic
    transients from chaos. Noise, and chaos of so many dimensions that the record has no near neighbours, are
    "unresolved".

    **Arguments:** `strobe`: states once per forcing period without the transient, shape (*cases, periods, states)
    or (periods, states), 16 periods or more; `scales`, shape (states,): divisors of the states, in their units.
    The default is the greatest magnitude over all cases and periods (1 where that is below 1e-12, so that
    rounding errors of a state that is zero by symmetry are not amplified); explicit scales are better, such as
    clearance and clearance times frequency. `turns`, shape (states,): full turns of states that are wrapped, such as
    2 pi of an angle from -pi to pi, infinite for others; default none. Without it a motion at the cut seems to jump.
    `max_period`: greatest n (at most a quarter of the record is tried);
    `tolerance`: as a fraction of the attractor's extent, which is the greatest peak-to-peak value of a scaled
    state in the last quarter of the record, and above the error of an integration that is accurate to 1e-4;
    `floor` [scales]: smaller distances count as zero; `seed`: of the 0-1 test.

    **Returns:** `Attractors`; cases that are not finite are "unresolved".

    **Raises:** `ValueError` for arrays of other shapes, too few periods and settings out of range.
    """
    x = _scaled(strobe, scales, turns)
    most, seed = whole("max_period", max_period, 1), whole("seed", seed, 0)
    if x.shape[-2] < 16:
        raise ValueError(f"Argument `strobe` must be of 16 periods or more, but is of shape {x.shape}.")
    for name, value in (("tolerance", tolerance), ("floor", floor)):
        require(0 < number(finite, name, value) < 1, name, "be above 0 and below 1", value)
    cases = [_classified(states, most, tolerance, floor, seed) for states in x.reshape(-1, *x.shape[-2:])]
    return Attractors(*(np.reshape(np.array(column), x.shape[:-2]) for column in zip(*cases, strict=True)))


def _scaled(strobe, scales, turns):
    x = numbers("strobe", strobe).astype(float)
    if x.ndim < 2 or 0 in x.shape or x.shape[-2] < 2:
        raise ValueError(f"Argument `strobe` must be of shape (*cases, periods, states), but is {x.shape}.")
    default = scales is None
    if default:
        every = x.reshape(-1, x.shape[-1])
        scales = np.max(np.abs(every), axis=0, initial=0.0, where=np.isfinite(every))
        scales = np.where(scales < 1e-12, 1.0, scales)
    scales = real("scales", numbers("scales", scales)).astype(float)
    require(scales.shape in ((), x.shape[-1:]), "scales", f"be of shape {x.shape[-1:]}", scales.shape)
    require(np.all((scales > 0) & (scales < np.inf)), "scales", "be positive", scales)
    if turns is None:
        return x / scales
    turns = real("turns", numbers("turns", turns)).astype(float)
    require(turns.shape == x.shape[-1:], "turns", f"be of shape {x.shape[-1:]}", turns.shape)
    require(np.all(turns > 0), "turns", "be positive", turns)
    # a wrapped state is a point on a circle, with two coordinates
    wrapped = np.isfinite(turns)
    radius, scales = turns[wrapped] / (2 * np.pi), np.broadcast_to(scales, turns.shape)
    angle, size = x[..., wrapped] / radius, radius / (radius if default else scales[wrapped])
    return np.concatenate([(x / scales)[..., ~wrapped], size * np.cos(angle), size * np.sin(angle)], axis=-1)


def _classified(states, most, tolerance, floor, seed):
    """Gives the entries of `Attractors` for one case."""
    finite = np.isfinite(states).all(-1)
    if not finite.all():
        text = f"non-finite states from period {int(np.argmin(finite))} on"
        return Regime.UNRESOLVED.kind_name, 0, np.nan, np.nan, np.nan, np.nan, text
    case = _Case(states, most, tolerance, floor, seed)
    return case.recurrent() or case.decaying() or case.irregular()


class _Case:
    """The states of one motion, with the residuals of their recurrence over all lags."""

    def __init__(self, states, most, tolerance, floor, seed):
        self.states, self.tolerance, self.floor, self.periods = states, tolerance, floor, len(states)
        self.quarter = self.periods // 4
        self.extent = float(np.ptp(states[-self.quarter :], axis=0).max())
        self.near = max(tolerance * self.extent, floor)
        """Distance that counts as none."""
        self.lags = range(1, min(most, self.quarter) + 1)
        self.residuals = recurrence(states, scales=1.0, max_period=self.lags[-1])
        self.at_end = {n: float(self.residuals[n - 1, -self.tail(n) :].max()) for n in self.lags}
        self.best = min(self.lags, key=lambda n: self.at_end[n])
        self.k = self.chaos(seed)

    def result(self, regime, lag, evidence, decay=None, growth=np.nan):
        """Gives the entries of `Attractors`, with the residual over `lag` periods, by the criterion that decided."""
        decay = self.fit(lag) if decay is None else decay
        period = lag if regime == Regime.PERIODIC else 0
        return Attractors(regime.kind_name, period, self.at_end[lag], float(decay.rate), growth, self.k, evidence)

    def tail(self, n):
        """Gives the number of periods at the end over which a residual is judged."""
        return max(n, self.periods // 10)

    def fit(self, n, lowest=None, start=0):
        """Fits the decay of the residual over n periods, from `start` on; NaN where the record is too short."""
        windows = (self.periods - max(start, n)) // max(n, 4)
        if windows < 6:
            return Decay(*[np.array(np.nan)] * 4)
        lowest = self.floor if lowest is None else lowest
        return decay_rate(self.residuals[n - 1, start:], windows=min(12, windows), floor=lowest)

    def chaos(self, seed):
        """Gives K of the 0-1 test, without the part of the best period; NaN for short records."""
        if self.periods < MIN_TEST:
            return np.nan
        part = _irregular_part(self.states, self.best)
        # below the tolerance only rounding and integration errors remain, whose K is meaningless
        return float(zero_one_test(part, seed=seed)) if np.ptp(part) > self.near else 0.0

    def recurrent(self):
        """Gives a verdict where states recur, by the shortest period over which they do."""
        for n in self.lags:
            # near the floor, a decay that rotates by a third of a turn per period looks like period 3
            if self.at_end[n] > self.near or any(self.at_end[m] < 10 * self.floor for m in _divisors(n)):
                continue
            # Slow drifts near a resonance or a bifurcation are visible over many periods only, and in a short record
            # only at their onset; they must also be small against the difference of period n from its divisors.
            far = n * max(2, self.quarter // n)
            drift = np.abs(self.states[-self.tail(n) :] - self.states[-self.tail(n) - far : self.periods - far]).max()
            split = min((self.at_end[m] for m in _divisors(n)), default=self.extent)
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
        """Gives a verdict where the residual over some period decays to zero."""
        for n in self.lags:
            # the whole record, or its second half where the first had other transients
            for start in (0, self.periods // 2):
                decay = self.fit(n, start=start)
                # of period n, and not of a divisor of n, only if the residuals over the divisors do not decay
                lasting = (abs(self.fit(m, start=start).fall) < 0.3 * decay.fall for m in _divisors(n))
                if decay.convincing and all(lasting):
                    speed = f"{decay.rate:.2g} per period, to {self.at_end[n]:.1e} so far"
                    text = f"residual over {n} periods decays by {speed}"
                    return self.result(Regime.PERIODIC, n, text, decay)
        return None

    def irregular(self):
        """Gives the verdict where no residual vanishes or decays: torus, chaos or unresolved."""
        k, best = self.k, self.best
        unresolved = lambda text, growth=np.nan: self.result(Regime.UNRESOLVED, best, text, growth=growth)
        few = f"{self.periods} periods are too few to tell a torus from chaos ({MIN_TEST} needed)"
        if self.periods < MIN_TEST:
            return unresolved(f"no recurrence, and {few}")
        if self.extent < 100 * self.floor:
            small = f"the extent of {self.extent:.1e} is near the floor of {self.floor:.0e}"
            return unresolved(f"no recurrence, but {small}")
        first, growth, gap, mixing = _neighbours(self.states)
        facts = f"K = {k:.2f}, ln growth of neighbours {first:.2f} in one period, then {growth:.2f}"
        if k > K_CHAOTIC and first + growth > WHOLE_GROWTH and growth > LATER_GROWTH:
            return self.result(Regime.CHAOTIC, best, facts, growth=growth)
        if k >= K_REGULAR or growth >= LATER_GROWTH:
            return unresolved(f"{facts}: neither regular nor chaotic", growth)
        if gap < 0.05 * self.extent / self.periods:
            bunch = f"the states bunch: a period above {self.lags[-1]}, or one not reached yet"
            return unresolved(f"{facts}, but {bunch}", growth)
        rates = np.array([self.fit(n).rate for n in self.lags])
        spiral = np.std(rates) < 0.3 * abs(np.mean(rates))  # residuals over all lags decay alike
        if _drift(self.states) > 0.01 or mixing > 3 or spiral:
            return unresolved(f"{facts}, but the states still drift or spiral", growth)
        text = f"{facts}, no recurrence up to {self.lags[-1]} periods, no decay, no drift"
        return self.result(Regime.REGULAR, best, text, growth=growth)


def _divisors(n):
    """Gives the divisors of n below n."""
    return [m for m in range(1, n) if n % m == 0]


def _irregular_part(x, n):
    """Gives a series for the 0-1 test: the scaled states along the direction in which they vary most, without the
    part of period n, which would make chaos in n bands, visited in turn, look regular."""
    y = x - x.mean(0)
    series = y @ np.linalg.svd(y, full_matrices=False)[2][0]
    for phase in range(n):
        series[phase::n] -= series[phase::n].mean()
    return series


def _geometric_fit(row, windows, floor):
    """Gives the entries of `Decay` for one residual."""
    row = row[int(np.argmin(np.isnan(row))) :]
    length = len(row) // windows
    if length == 0 or not np.isfinite(row).all():
        return [np.nan] * 4
    envelope = row[len(row) - windows * length :].reshape(windows, length).max(1)
    k = np.flatnonzero(envelope > floor)
    if len(k) < 6:
        return [np.nan] * 4
    y = np.log(envelope[k])
    slope, offset = np.polyfit(k, y, 1)
    spread = np.sum((y - y.mean()) ** 2)
    fit = 1 - np.sum((y - offset - slope * k) ** 2) / spread if spread > 0 else 0.0
    half = len(k) // 2
    first, second = np.polyfit(k[:half], y[:half], 1)[0], np.polyfit(k[half:], y[half:], 1)[0]
    return [-slope / length, -slope * (k[-1] - k[0]), fit, second / first if first else np.nan]


def _growth_of_displacement(series, c):
    """Computes the median over c of the correlation of n with D_c(n)."""
    if not np.isfinite(series).all():
        return np.nan
    if np.ptp(series) <= 1e-12 * np.abs(series).max():
        return 0.0
    series = series / np.abs(series).max()
    most = len(series) // 10
    steps, count = np.arange(1, most + 1), len(series) - most
    z = np.cumsum(series * np.exp(1j * np.outer(c, np.arange(len(series)))), axis=-1)
    # sum over j < count of |z_{j+n} - z_j|^2: the squares by running sums, the products as a correlation by FFT
    square = np.cumsum(np.abs(z) ** 2, axis=-1)
    moved = square[:, steps + count - 1] - square[:, steps - 1]
    size = 1 << (len(series) + count).bit_length()
    product = np.fft.ifft(np.fft.fft(z, size) * np.conj(np.fft.fft(z[:, :count], size)))[:, steps].real
    displacement = (moved + square[:, [count - 1]] - 2 * product) / count
    angle = c[:, None]
    displacement -= series.mean() ** 2 * (1 - np.cos(steps * angle)) / (1 - np.cos(angle))
    a, b = steps - steps.mean(), displacement - displacement.mean(1, keepdims=True)
    spread = np.sqrt(np.sum(a**2) * np.sum(b**2, axis=1))
    return float(np.median(b @ a / np.where(spread > 0, spread, 1.0)))


def _neighbours(x):
    """Computes the divergence of neighbours on the section, and how evenly the states fill it.

    **Returns:** the mean growth of ln of the distance of nearest neighbours in one period, and from there on to
    `NEIGHBOUR_PERIODS` (Rosenstein, Collins and De Luca 1993, doi:10.1016/0167-2789(93)90009-P); the median distance
    of nearest neighbours; the median distance of states of the second half to their nearest state in the first half,
    over that to their nearest state in the second half.
    """
    periods = len(x)
    distance = np.zeros((periods, periods))
    for state in x.T:  # one state at a time, to save memory
        np.maximum(distance, np.abs(state[:, None] - state), out=distance)
    tiny = 1e-12 * distance.max()
    ahead, half = min(NEIGHBOUR_PERIODS, periods // 5), periods // 2
    # of states that can be followed ahead, pairs that are near in space and not in time
    index, count = np.arange(periods), periods - ahead
    apart = np.where(np.abs(index[:, None] - index) < THEILER_WINDOW, np.inf, distance)
    first, other = index[:count], np.argmin(apart[:count, :count], axis=1)
    steps = np.arange(ahead + 1)[:, None]
    mean = np.log(np.maximum(distance[first + steps, other + steps], tiny)).mean(1)
    # without the first period, in which the distance to the nearest neighbour, a minimum, grows in noise too
    growth = mean[ahead // 2 :].mean() - mean[1]
    own = np.where(index[half:, None] == index[half:], np.inf, distance[half:, half:]).min(1)
    mixing = np.median(distance[half:, :half].min(1)) / max(np.median(own), tiny)
    return float(mean[1] - mean[0]), float(growth), float(np.median(apart.min(1))), float(mixing)


def _drift(x):
    """Gives the greatest change of mean and spread of a state between both halves, over the greatest spread.

    Weighted by a Hann window, so that incomplete turns of a torus in either half do not count as drift.
    """
    half = len(x) // 2
    weight = np.sin(np.pi * (np.arange(half) + 0.5) / half) ** 2
    weight = weight / weight.sum()
    halves = x[:half], x[-half:]
    means = [weight @ part for part in halves]
    spreads = [np.sqrt(weight @ (part - mean) ** 2) for part, mean in zip(halves, means, strict=True)]
    change = np.maximum(np.abs(np.subtract(*means)), np.abs(np.subtract(*spreads)))
    return float(change.max() / max(np.max(spreads), 1e-300))
