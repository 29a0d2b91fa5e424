"""Classification of attractors from states once per forcing period (stroboscopic states): motions of period n, tori
and chaos.

A motion gets a class only if it meets all criteria of the class; otherwise it is "unresolved".
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..tools.checks import finite, number, numbers, positive, require, whole
from ..tools.types import Numbers
from .kinds import Regime
from .lyapunov import check_real, weighted_mean

MIN_TEST = 200
"""Least number of periods to distinguish tori from chaos. With this number K of some tori is up to 0.9, which gives
"unresolved"."""
ENOUGH = 1000
"""Number of periods that is enough to recognise tori."""
ROUND = 8
"""Most binary digits of a round number."""
AT_ONCE = 10
"""Most binary digits that a map loses in a step, as x -> 1024 x mod 1 does; a greater loss has another cause."""
LEAST_LOST = 16
"""Least number of binary digits that a map loses in successive steps; records of instruments have no more digits."""
LOST_DIGITS = "as where a map loses a binary digit in each step"
SCATTER = 0.1
"""Greatest mean distance of neighbours on a closed curve, as a share of its extent."""


class Attractors(NamedTuple):
    """Attractors of motions, as arrays over the cases, of shape () for a single case."""

    kind: np.ndarray
    """One of `KINDS`."""
    period: np.ndarray
    """n for a motion of period n [forcing periods], 0 for all other motions."""
    residual: np.ndarray
    """Greatest change of a state over `period` at the end of the record [scales]; for period 0 the least such change
    over all lags."""
    k: np.ndarray
    """K of the 0-1 test, with the best periodic part subtracted: near 0 for regular, near 1 for chaotic motions; 0 if
    nothing remains, NaN for records shorter than `MIN_TEST`."""
    evidence: np.ndarray
    """Criterion that decided, as a text."""


def recurrence(
    states: Float[np.ndarray, "*cases periods states"],
    most: int,
) -> dict[int, np.ndarray]:
    """Return the greatest change of a state over each lag of n periods up to `most`, (*cases, periods - n), by n."""
    return {n: np.abs(states[..., n:, :] - states[..., :-n, :]).max(-1) for n in range(1, most + 1)}


def zero_one_test(
    series: Numbers,
    *,
    samples: int = 100,
    seed: int = 0,
) -> Float[np.ndarray, "*cases"]:
    """Return K of the 0-1 test for chaos: near 0 for regular, near 1 for chaotic series.

    The correlation method with the oscillation term subtracted: the median over random c in (pi/5, 4 pi/5) of the
    correlation of n with D_c(n) = M_c(n) - (mean phi)^2 (1 - cos n c) / (1 - cos c), where M_c is the mean square
    displacement of sum_j phi_j exp(i j c) over n <= periods / 10 steps. Gottwald and Melbourne 2009,
    doi:10.1137/080718851. A constant series has K = 0. Noise has K near 1.

    **Arguments:** `series`: phi, shape (*cases, periods), one scalar per forcing period, not an oversampled record;
    `samples`: number of values of c; `seed`: of the random c.

    **Returns:** shape (*cases,), NaN for series that are not finite.

    **Raises:** `ValueError` for fewer than 40 periods and settings out of range.
    """
    x = check_real("series", numbers("series", series)).astype(float)
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


def mean_turn(angle: Numbers) -> Float[np.ndarray, "*cases"]:
    """Return the mean turn of an angle from one period to the next, as a share of a turn, 0 to 1.

    It is a weighted mean, whose error on a torus falls faster than any power of the number of periods
    (doi:10.1088/1361-6544/aa84c2).

    **Arguments:** `angle`: once per forcing period [rad], (*cases, periods): of states, seen from a point inside the
    closed curve on which they lie. The turns may differ from each other by less than half a turn.

    **Raises:** `ValueError` for fewer than three periods.
    """
    angle = numbers("angle", angle, 1)
    require(angle.shape[-1] >= 3, "angle", "be of three periods or more", shown=f"of shape {angle.shape}")
    turn = np.exp(1j * np.diff(angle))
    # relative to their mean direction no turn is ambiguous
    middle = np.angle(turn.sum(axis=-1, keepdims=True))
    away = np.angle(turn * np.exp(-1j * middle))
    turns = (middle[..., 0] + weighted_mean(away[..., None])[..., 0]) / (2 * np.pi)
    return np.asarray(np.mod(turns, 1.0))


def rotation_number(states: Numbers) -> Float[np.ndarray, "*cases"]:
    """Return the mean turn of states on a closed curve from one period to the next, as a share of a turn, 0 to 1/2.

    On a torus this is the frequency of the second motion over the forcing frequency, up to whole turns and the sign;
    it is a rational number where both are locked. The states are seen from their mean, in the plane of their greatest
    variation, see `mean_turn`.

    **Arguments:** `states`: once per forcing period, (*cases, periods, numbers), after the transient, in units of
    like size.

    **Returns:** shape (*cases,); NaN where the states do not lie on a closed curve around their mean in this order.

    **Raises:** `ValueError` for fewer than three periods, and for states of one number.
    """
    states = numbers("states", states, 2)
    need = "be of three periods or more and of two numbers or more"
    require(states.shape[-2] >= 3 and states.shape[-1] >= 2, "states", need, shown=f"of shape {states.shape}")
    found = [_rotation(one) for one in states.reshape(-1, *states.shape[-2:])]
    return np.reshape(found, states.shape[:-2])


def _rotation(states):
    """Return the rotation number of one motion."""
    if not np.isfinite(states).all():
        return np.nan
    away = states - weighted_mean(states)
    plane = away @ np.linalg.svd(away, full_matrices=False)[2][:2].T
    turn = float(mean_turn(np.arctan2(plane[:, 1], plane[:, 0])))
    # neighbours on the curve, if the rotation number is right
    order = np.argsort(np.mod(turn * np.arange(len(plane)), 1.0))
    apart = np.linalg.norm(np.diff(plane[order], axis=0), axis=1).mean()
    return min(turn, 1 - turn) if apart < SCATTER * np.ptp(plane, axis=0).max() else np.nan


def classify(
    strobe: Numbers,
    *,
    scales: Numbers | None = None,
    max_period: int = 16,
    tolerance: float = 1e-3,
    floor: float = 1e-6,
) -> Attractors:
    """Return the attractor of each motion.

    - "period": the states recur after n periods and over a quarter of the record, within `tolerance` of the
      attractor's extent or within `floor`. Or, in a slow transient, their distance over n periods decays
      geometrically to zero. n is the smallest possible.
    - "chaotic": K of the 0-1 test is above 0.8, and neighbours diverge.
    - "torus": K is below 0.2, neighbours stay close, the states fill the section evenly, their mean and spread
      do not drift, and the residuals over all lags do not decay together.
    - "unresolved": all other motions. Records of less than `MIN_TEST` periods can only be periodic or unresolved;
      many tori need `ENOUGH` periods, 1000.

    In floating point, maps that lose a binary digit in each step, such as x -> 2 x mod 1, stay at zero after 53 steps
    (use 1.999999 for 2), and so does everything that they drive. A motion is "unresolved" if one of its numbers loses
    digits step by step until it is round. Where a record has only round numbers, as for a motion at rest, its
    evidence says so.

    These pairs look alike: splittings and chaotic bands narrower than the tolerance, and periodic motions; transients
    that drift by less than the tolerance in a quarter of the record, and settled motions; long chaotic transients,
    and chaos. Noise, and chaos of so many dimensions that the record has no near neighbours, are "unresolved".

    **Arguments:**

    - `strobe`: states once per forcing period without the transient, shape (*cases, periods, states) or (periods,
        states), 16 periods or more; for an angle that turns around, give sine and cosine instead.
    - `scales`: divisors of the states, in their units, shape (states,). The default is the greatest magnitude over
        all cases and periods. It is 1 where this is below 1e-12, so that rounding errors of a state that is zero by
        symmetry are not amplified. Explicit scales are better, such as clearance and clearance times frequency.
    - `max_period`: greatest n, at most a quarter of the record.
    - `tolerance`: as a fraction of the attractor's extent, which is the greatest peak-to-peak value of a scaled state
        in the last quarter of the record. The default is above the error of an integration accurate to 1e-4.
    - `floor`: smaller distances count as zero [scales].

    **Returns:** `Attractors`; cases that are not finite are "unresolved".

    **Raises:** `ValueError` for arrays of other shapes, too few periods and settings out of range.
    """
    x, scales = _scaled(strobe, scales)
    most = whole("max_period", max_period, 1)
    for name, value in (("tolerance", tolerance), ("floor", floor)):
        require(0 < number(finite, name, value) < 1, name, "be above 0 and below 1", value)
    cases = [_classified(states, scales, most, tolerance, floor) for states in x.reshape(-1, *x.shape[-2:])]
    return Attractors(*(np.reshape(column, x.shape[:-2]) for column in zip(*cases, strict=True)))


def _scaled(strobe, scales):
    """Return checked states, and their scales."""
    x = check_real("strobe", numbers("strobe", strobe)).astype(float)
    enough = x.ndim >= 2 and x.shape[-2] >= 16 and x.size
    need = "be of shape (*cases, periods, states) with 16 periods or more"
    require(enough, "strobe", need, shown=f"of shape {x.shape}")
    if scales is None:
        every = x.reshape(-1, x.shape[-1])
        scales = np.max(np.abs(every), axis=0, initial=0.0, where=np.isfinite(every))
        scales = np.where(scales < 1e-12, 1.0, scales)
    scales = positive("scales")(scales)
    require(scales.shape in ((), x.shape[-1:]), "scales", f"be of shape {x.shape[-1:]}", scales.shape)
    return x, np.asarray(scales)


def _classified(states, scales, most, tolerance, floor):
    """Return the entries of `Attractors` for one case."""
    # one number that is not finite makes a case unresolved
    lost = ~np.isfinite(states).all(-1)
    if lost.any():
        text = f"non-finite states from period {int(np.argmax(lost))} on"
        return Regime.UNRESOLVED.kind_name, 0, np.nan, np.nan, text
    motion = _Recurrence(states / scales, _is_round(states), most, tolerance, floor)
    if (lost_digits := max(map(_lost_digits, _digits(states).T))) > 0:
        text = f"a number has lost its last {lost_digits} binary digits step by step, {LOST_DIGITS}"
        return motion.result(Regime.UNRESOLVED, motion.best, text)
    return motion.recurrent() or motion.decaying() or motion.irregular()


class _Recurrence:
    """Scaled states of one motion, with the changes over all lags, called residuals."""

    def __init__(self, states, rounded, most, tolerance, floor):
        self.states = states
        self.rounded = rounded
        """Which states are round numbers before scaling."""
        self.tolerance = tolerance
        self.floor = floor
        self.periods = len(states)
        self.quarter = self.periods // 4
        self.extent = np.ptp(states[-self.quarter :], axis=0).max()
        self.near = max(tolerance * self.extent, floor)
        """Distance up to which states count as equal."""
        self.lags = range(1, min(most, self.quarter) + 1)
        self.residuals = recurrence(states, self.lags[-1])
        self.at_end = {n: residual[-self.tail(n) :].max() for n, residual in self.residuals.items()}
        self.best = min(self.lags, key=lambda n: self.at_end[n])
        self.k = self.chaos()

    def result(self, regime, lag, evidence):
        """Return the entries of `Attractors` for a regime, with the residual over `lag` periods."""
        period = lag if regime == Regime.PERIODIC else 0
        return regime.kind_name, period, self.at_end[lag], self.k, evidence

    def tail(self, n):
        """Return the number of periods at the end over which the residual of lag n is judged."""
        return max(n, self.periods // 10)

    def fit(self, n, floor):
        """Return the decay of the residual of lag n; NaN where the record is too short."""
        residual = self.residuals[n]
        windows = len(residual) // max(n, 4)
        return _decay(residual, min(12, windows), floor) if windows >= 6 else _Decay()

    def chaos(self):
        """Return K of the 0-1 test after the best periodic part is subtracted; NaN for short records."""
        if self.periods < MIN_TEST:
            return np.nan
        part = _irregular_part(self.states, self.best)
        # below the tolerance only rounding and integration errors remain, whose K is meaningless
        return float(zero_one_test(part)) if np.ptp(part) > self.near else 0.0

    def recurrent(self):
        """Return the entries of a recurring motion with its shortest period, or None."""
        for n in self.lags:
            shorter = [self.at_end[m] for m in _divisors(n)]
            # near the floor, a decay that rotates by a third of a turn per period looks like period 3
            if self.at_end[n] > self.near or any(residual < 10 * self.floor for residual in shorter):
                continue
            # A slow drift near a resonance or a bifurcation shows only over many periods. Therefore the states must
            # also recur over a quarter of the record. The bound is lower for short records, which show only the
            # beginning of a drift, and where period n differs little from its divisors.
            far = n * max(2, self.quarter // n)
            before = self.states[-self.tail(n) - far : self.periods - far]
            drift = np.abs(self.states[-self.tail(n) :] - before).max()
            split = min(shorter, default=self.extent)
            if drift > max(min(self.near * min(1, far / 100), 3 * self.tolerance * split), self.floor):
                continue
            # the motion may be unstable, and depart after rounding errors
            growing = self.fit(n, 1e-14)
            if growing.fall < -math.log(10) and growing.fit > 0.95:
                text = f"recurs after {n} periods, but the residual grows by {-growing.rate:.2g} per period"
                return self.result(Regime.UNRESOLVED, n, text)
            text = f"recurs after {n} periods within {self.at_end[n]:.1e}, of an extent of {self.extent:.1e}"
            if self.stays(n):
                text += f", at round numbers, as at rest, or {LOST_DIGITS}"
            return self.result(Regime.PERIODIC, n, text)
        return None

    def stays(self, n):
        """Return whether all numbers of the state are round at the end, and recur exactly after n periods."""
        there = slice(-self.tail(n), None)
        exact = np.all(self.states[n:][there] == self.states[:-n][there])
        return bool(exact and np.all(self.rounded[there]))

    def decaying(self):
        """Return the entries of a motion whose residual over some period decays to zero, or None."""
        for n in self.lags:
            decay = self.fit(n, self.floor)
            # the period is n, and not a divisor of n, only if the residuals over the divisors do not decay
            falls = [self.fit(m, self.floor).fall for m in _divisors(n)]
            # a geometric decay to zero: by half or more, with R^2 >= 0.95 and a steady rate
            convincing = decay.fall >= math.log(2) and decay.fit >= 0.95 and 0.85 <= decay.steadiness <= 1.5
            if convincing and all(abs(fall) < 0.3 * decay.fall for fall in falls):
                speed = f"{decay.rate:.2g} per period, to {self.at_end[n]:.1e} so far"
                return self.result(Regime.PERIODIC, n, f"residual over {n} periods decays by {speed}")
        return None

    def irregular(self):
        """Return the entries of any other motion: torus, chaos or unresolved."""
        more = f"; a torus may need {ENOUGH} periods" if self.periods < ENOUGH else ""
        unresolved = lambda text: self.result(Regime.UNRESOLVED, self.best, text + more)
        if self.periods < MIN_TEST:
            few = f"{self.periods} periods are too few to tell a torus from chaos ({MIN_TEST} at least)"
            return unresolved(f"no recurrence, and {few}")
        if self.extent < 100 * self.floor:
            small = f"the extent of {self.extent:.1e} is near the floor of {self.floor:.0e}"
            return unresolved(f"no recurrence, but {small}")
        first, growth, gap, mixing = _neighbours(self.states)
        facts = f"K = {self.k:.2f}, ln growth of neighbours {first:.2f} in one period, then {growth:.2f}"
        # the first period counts only in their sum, because in noise neighbours also part in the first period
        if self.k > 0.8 and growth > 0.12 and first + growth > 0.7:
            return self.result(Regime.CHAOTIC, self.best, facts)
        if self.k >= 0.2 or growth >= 0.12:
            return unresolved(f"{facts}: neither regular nor chaotic")
        if gap < 0.05 * self.extent / self.periods:
            bunch = f"the states bunch: a period above {self.lags[-1]}, or one not reached yet"
            return unresolved(f"{facts}, but {bunch}")
        fits = [self.fit(n, self.floor) for n in self.lags]
        rates = np.array([fit.rate for fit in fits])
        # On a slow spiral into a fixed point, residuals over all lags decay together. Those of a rigid rotation stay
        # as they are, and their rates are rounding errors.
        together = np.std(rates) < 0.3 * abs(np.mean(rates))
        falls = abs(np.mean([fit.fall for fit in fits]))
        halves = f"{mixing:.2g} times as far from those of the first half as from each other"
        reasons = {
            "the states still drift": _drift(self.states) > 0.01,
            f"states of the second half are {halves}: a slow drift, or a torus near a long period": mixing > 3,
            "the states still spiral: residuals over all lags change together": together and falls > self.tolerance,
        }
        if any(reasons.values()):
            return unresolved(f"{facts}, but {', and '.join(text for text, holds in reasons.items() if holds)}")
        text = f"{facts}, no recurrence up to {self.lags[-1]} periods, no decay, no drift"
        return self.result(Regime.REGULAR, self.best, text)


def _is_round(values):
    """Return which numbers have at most `ROUND` binary digits."""
    digits = np.ldexp(np.frexp(values)[0], ROUND)
    return digits == np.round(digits)


def _digits(states):
    """Return the binary digits of the numbers of states, from the first digit of the greatest number to the last
    digit that is not zero."""
    mantissa, exponent = np.frexp(states)
    whole = np.ldexp(mantissa, 53).astype(np.int64)
    last = exponent - 53 + np.frexp(1.0 * (whole & -whole))[1] - 1
    first = np.frexp(np.abs(states).max(axis=0))[1]
    return np.where(states == 0, 0, first - last)


def _lost_digits(digits):
    """Return how many binary digits a number loses, some in each step, until it stays round. 0 where it does not do
    so, as where a round number attracts it or where it comes to rest there."""
    if digits[-1] > ROUND:
        return 0
    # near the first of the round numbers at the end
    begin = end = int(np.max(np.flatnonzero(digits > ROUND), initial=-1)) + 1
    loss = -np.diff(digits)
    steady = (loss > 0) & (loss <= AT_ONCE)
    while begin > 0 and steady[begin - 1]:
        begin -= 1
    while end < len(steady) and steady[end]:
        end += 1
    lost = int(digits[begin] - digits[end])
    return lost if lost >= LEAST_LOST else 0


def _divisors(n):
    """Return the divisors of n below n."""
    return [m for m in range(1, n) if n % m == 0]


def _irregular_part(x, n):
    """Return a series for the 0-1 test: the states along the direction of greatest variation, without their periodic
    part of period n.

    With the periodic part, chaos in n bands that are visited in turn would look regular.
    """
    y = x - x.mean(0)
    series = y @ np.linalg.svd(y, full_matrices=False)[2][0]
    for phase in range(n):
        series[phase::n] -= series[phase::n].mean()
    return series


class _Decay(NamedTuple):
    """Fit of exp(-rate k) to the envelope of a residual; NaN where there is nothing to fit."""

    rate: float = np.nan
    """Decay rate [1/period]; negative where the envelope grows."""
    fall: float = np.nan
    """ln of the ratio of first to last value of the fit."""
    fit: float = np.nan
    """Coefficient of determination R^2 of the fit to ln of the envelope."""
    steadiness: float = np.nan
    """Rate in the second half over rate in the first half: 1 for a geometric decay to zero, less for an algebraic
    decay or for a limit above zero."""


def _decay(residual, windows, floor):
    """Return the fit of exp(-rate k) to the maxima of a residual over windows of equal length.

    Maxima are fitted because spiral decays oscillate below their envelope. Maxima at or below `floor` are left out,
    because rounding and integration errors dominate there.
    """
    length = len(residual) // windows
    envelope = residual[len(residual) - windows * length :].reshape(windows, length).max(1)
    k = np.flatnonzero(envelope > floor)
    if len(k) < 6:
        return _Decay()
    y = np.log(envelope[k])
    slope = np.polyfit(k, y, 1)[0]
    fit = np.corrcoef(k, y)[0, 1] ** 2 if np.ptp(y) > 0 else 0.0
    # a decay to zero has the same rate in both halves
    half = len(k) // 2
    first = np.polyfit(k[:half], y[:half], 1)[0]
    second = np.polyfit(k[half:], y[half:], 1)[0]
    return _Decay(-slope / length, -slope * (k[-1] - k[0]), fit, second / first if first else np.nan)


def _growth_of_displacement(series, c):
    """Return K of the 0-1 test for one series: the median over c of the correlation of n with D_c(n)."""
    if not np.isfinite(series).all():
        return np.nan
    # a constant series varies only by rounding errors
    if np.ptp(series) <= 1e-12 * np.abs(series).max():
        return 0.0
    series = series / np.abs(series).max()
    most = len(series) // 10
    steps = np.arange(1, most + 1)
    a = steps - steps.mean()
    correlation = []
    # a few values of c at a time, so that long records need no more memory than short ones
    for angle in np.split(c[:, None], range(8, len(c), 8)):
        z = np.cumsum(series * np.exp(1j * angle * np.arange(len(series))), axis=-1)
        displacement = _mean_square_displacement(z, steps)
        displacement -= series.mean() ** 2 * (1 - np.cos(steps * angle)) / (1 - np.cos(angle))
        b = displacement - displacement.mean(1, keepdims=True)
        spread = np.sqrt(np.sum(a**2) * np.sum(b**2, axis=1))
        correlation.append(b @ a / np.where(spread > 0, spread, 1.0))
    return float(np.median(np.concatenate(correlation)))


def _mean_square_displacement(z, steps):
    """Return the mean over j of |z_{j+n} - z_j|^2, for each n in `steps`; z: (samples, periods)."""
    length = z.shape[1]
    count = length - steps[-1]
    # expanded: running sums give the sums of squares, an FFT gives the correlation of the products
    square = np.cumsum(np.abs(z) ** 2, axis=-1)
    moved = square[:, steps + count - 1] - square[:, steps - 1]
    size = 1 << int(length + count).bit_length()
    product = np.fft.ifft(np.fft.fft(z, size) * np.conj(np.fft.fft(z[:, :count], size)))[:, steps].real
    return (moved + square[:, [count - 1]] - 2 * product) / count


def _neighbours(x):
    """Return how fast neighbouring states diverge, and how evenly the states fill the section.

    **Returns:** four numbers. The mean growth of the logarithm of the distance of nearest neighbours in the first
    period, and its further growth over later periods (Rosenstein, Collins and De Luca 1993,
    doi:10.1016/0167-2789(93)90009-P). The median distance of nearest neighbours. For states of the second half, the
    median distance to the nearest state of the first half, divided by that to the nearest state of the second half.
    """
    periods = len(x)
    tiny = 1e-12 * np.ptp(x, axis=0).max()
    ahead = min(30, periods // 5)
    # nearest neighbours of states with a known future: near in space, but ten periods apart in time (Theiler)
    count = periods - ahead
    _, other = _nearest(x[:count], x[:count], 10)
    index = np.arange(count)
    distance = [np.abs(x[index + k] - x[other + k]).max(axis=1) for k in range(ahead + 1)]
    mean = np.log(np.maximum(distance, tiny)).mean(axis=1)
    # without the first period: the nearest distance is a minimum, which grows at once, also in noise
    growth = mean[ahead // 2 :].mean() - mean[1]
    half = periods // 2
    own, _ = _nearest(x[half:], x[half:], 1)
    before, _ = _nearest(x[half:], x[:half], 0)
    apart, _ = _nearest(x, x, 10)
    mixing = np.median(before) / max(np.median(own), tiny)
    return float(mean[1] - mean[0]), float(growth), float(np.median(apart)), float(mixing)


def _nearest(of: np.ndarray, among: np.ndarray, apart: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances of states from their nearest states, by the greatest difference, and the indices of these.

    **Arguments:** `apart`: least difference of both indices.
    """
    import scipy.spatial  # here, because importing it takes time

    # so many that one of them is far enough in time; a tree needs less memory than all pairs
    count = max(2 * apart, 1)
    distance, index = scipy.spatial.cKDTree(among).query(of, k=[*range(1, count + 1)], p=np.inf)
    near = np.abs(index - np.arange(len(of))[:, None]) < apart
    first = np.argmin(near, axis=1)[:, None]
    return np.take_along_axis(distance, first, 1)[:, 0], np.take_along_axis(index, first, 1)[:, 0]


def _drift(x):
    """Return the greatest change of a state's mean or spread from the first half to the second, over the spread.

    Means are weighted by a Hann window, so that incomplete turns of a torus in either half do not count as drift.
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
