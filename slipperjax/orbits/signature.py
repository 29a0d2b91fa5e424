"""The contact signature of an orbit: which points touch down, in which order and how fast, found and not given.

Gaps are cubics through both ends of every step, so that touchdowns and extremes between the ends are seen, too. An
orbit grazes where an extreme of a gap is zero: a touch that begins or ends to be, or an opening.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..flow.record import Unlabelled
from ..model.scene import Scene

HALVINGS = 60
"""Bisections by which touchdowns are located in their step, down to rounding."""


class Touchdown(NamedTuple):
    """One touchdown of an orbit."""

    period: float
    """When [forcing periods since the start]."""
    point: str
    """The point, with 1 at the front or 2 at the rear."""
    rate: float
    """The gap's rate there [m/s], negative."""


class Signature(NamedTuple):
    """What an orbit's contacts do."""

    touchdowns: tuple[Touchdown, ...]
    """In the order of time."""
    closed: tuple[str, ...]
    """Points in contact throughout."""
    slowest: float
    """Least magnitude of a touchdown's rate [m/s]; infinite without touchdowns."""
    nearest: float
    """Least magnitude of a local extreme of a gap [m]: zero where the orbit grazes."""

    @property
    def points(self) -> tuple[str, ...]:
        """The points in the order of their touchdowns."""
        return tuple(touchdown.point for touchdown in self.touchdowns)

    def __repr__(self) -> str:
        order = " ".join(self.points) or "none"
        closed = f", closed throughout: {' '.join(self.closed)}" if self.closed else ""
        speed = f"slowest touchdown {self.slowest:.3g} m/s"
        return f"Signature({order}; {speed}, grazing within {self.nearest:.3g} m{closed})"


@dataclass(frozen=True)
class GapSamples(Unlabelled):
    """Gaps [m] and their rates [m/s] at both ends of every step, of all points, the front ones first."""

    def values(self, periods):
        return 0  # kept for one case only, of which no sweep asks how much memory it takes

    def sample(self, course):
        return tuple(a.reshape(len(a), -1) for a in (course.gap.values, course.gap_rate))


class Gaps(NamedTuple):
    """The gaps of an orbit over its period, as cubics on all its steps; points: the front ones first."""

    start: Float[np.ndarray, "steps points"]
    """Gap at the step's start [m], its rise over the step, and the other two coefficients."""
    slope: Float[np.ndarray, "steps points"]
    square: Float[np.ndarray, "steps points"]
    cube: Float[np.ndarray, "steps points"]
    step: float
    """Length of a step [s]."""
    per_period: int
    """Steps in a forcing period."""

    @classmethod
    def of(cls, gap: Array | np.ndarray, rate: Array | np.ndarray, steps: int, period: float) -> "Gaps":
        """From `gap` [m] and `rate` [m/s] at both ends of every step, (periods, steps + 1 or more, points)."""
        g0, g1 = (np.concatenate(np.asarray(gap)[:, k : k + steps]) for k in (0, 1))
        d0, d1 = (np.concatenate(period / steps * np.asarray(rate)[:, k : k + steps]) for k in (0, 1))
        return cls(g0, d0, 3 * (g1 - g0) - 2 * d0 - d1, 2 * (g0 - g1) + d0 + d1, period / steps, steps)

    def value(self, x: Any) -> np.ndarray:
        """The gap at shares x of the steps [m]."""
        return ((self.cube * x + self.square) * x + self.slope) * x + self.start

    def extremes(self) -> Float[np.ndarray, "2 steps points"]:
        """Shares of the steps at which gaps have local extremes, in their order; NaN where there is none."""
        a, b, c = 3 * self.cube, 2 * self.square, self.slope
        with np.errstate(all="ignore"):
            q = -(b + np.where(b >= 0, 1, -1) * np.sqrt(b * b - 4 * a * c)) / 2
            both = np.stack([q / a, c / q])
            return np.sort(np.where((both > 0) & (both < 1), both, np.nan), axis=0)

    def of_points(self, points: Any) -> "Gaps":
        """Those of some points."""
        return self._replace(**{name: getattr(self, name)[:, points] for name in self._fields[:4]})


class Grazing(NamedTuple):
    """How near each point is to a grazing; arrays (points,)."""

    touchdowns: Int[np.ndarray, " points"]
    """Touchdowns within the period."""
    margin: Float[np.ndarray, " points"]
    """Least magnitude of a local extreme of the gap [m], infinite where there is none."""
    opening: Bool[np.ndarray, " points"]
    """Whether that is a greatest gap, which a contact opens by, and not a least one, by which it touches."""
    time: Float[np.ndarray, " points"]
    """When [forcing periods]."""


def grazing(gaps: Gaps) -> Grazing:
    """How near each point of an orbit is to a grazing."""
    extremes = gaps.extremes()
    values = gaps.value(extremes)
    size = np.where(np.isnan(values), np.inf, np.abs(values))
    flat = size.reshape(-1, size.shape[-1])
    at = np.argmin(flat, axis=0)
    points = np.arange(flat.shape[1])
    curvature = (6 * gaps.cube * extremes + 2 * gaps.square).reshape(flat.shape)
    time = (np.arange(size.shape[1])[None, :, None] + extremes).reshape(flat.shape) / gaps.per_period
    counts = np.sum(_touching(gaps)[0], axis=(0, 1))
    return Grazing(counts, flat[at, points], curvature[at, points] < 0, time[at, points])


def _touching(gaps: Gaps) -> tuple[Bool[np.ndarray, "3 steps points"], np.ndarray, np.ndarray]:
    """Where gaps fall below zero in the up to three parts of a step between extremes, and the ends of these."""
    inner = gaps.extremes()
    inner = np.where(np.isnan(inner), 1.0, inner)
    starts = np.concatenate([np.zeros((1, *inner.shape[1:])), inner])
    ends = np.concatenate([inner, np.ones((1, *inner.shape[1:]))])
    # the end of a step has the sign of the next one's start, also where rounding makes the cubic differ
    following = np.roll(gaps.start, -1, axis=0)
    at_end = np.where(ends == 1.0, following, gaps.value(ends))
    return (gaps.value(starts) >= 0) & (at_end < 0) & (starts < ends), starts, ends


def signature(scene: Scene, gaps: Gaps) -> Signature:
    """The signature of an orbit."""
    names = [f"{name}{end}" for end in (1, 2) for name in scene.section.names]
    falls, low, high = _touching(gaps)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        open_ = gaps.value(middle) >= 0
        low, high = np.where(open_, middle, low), np.where(open_, high, middle)
    rates = ((3 * gaps.cube * low + 2 * gaps.square) * low + gaps.slope) / gaps.step
    found = [
        Touchdown(float(k + low[part, k, p]) / gaps.per_period, names[p], float(rates[part, k, p]))
        for part, k, p in zip(*np.nonzero(falls), strict=True)
    ]
    most = np.fmax(np.fmax.reduce(gaps.value(gaps.extremes()), axis=(0, 1)), gaps.start.max(axis=0))
    return Signature(
        tuple(sorted(found)),
        tuple(name for name, highest in zip(names, most, strict=True) if highest < 0),
        min((abs(t.rate) for t in found), default=float("inf")),
        float(np.min(grazing(gaps).margin)),
    )
