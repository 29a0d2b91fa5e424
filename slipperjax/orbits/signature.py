"""The contact signature of an orbit: which points touch down, in which order and how fast.

Gaps are cubics through both ends of every step, so that touchdowns and extremes between the ends are seen, too. An
orbit grazes where an extreme of a gap is zero: a touch that begins or ends to be, or an opening.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..flow.record import Unlabelled
from ..model.scene import Scene
from ..tools.hermite import Cubic


class Touchdown(NamedTuple):
    """One touchdown of an orbit."""

    period: float
    """Instant [forcing periods since the start]."""
    point: str
    """Name of the point, with 1 at the front or 2 at the rear."""
    rate: float
    """The gap's rate there [m/s], negative."""


class Signature(NamedTuple):
    """The touchdowns and openings of an orbit's contacts."""

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
        """Names of the points in the order of their touchdowns."""
        return tuple(touchdown.point for touchdown in self.touchdowns)

    def __repr__(self) -> str:
        order = " ".join(self.points) or "none"
        closed = f", closed throughout: {' '.join(self.closed)}" if self.closed else ""
        speed = f"slowest touchdown {self.slowest:.3g} m/s"
        return f"Signature({order}; {speed}, grazing within {self.nearest:.3g} m{closed})"


@dataclass(frozen=True)
class GapSamples(Unlabelled):
    """Gaps [m] and their rates [m/s] at both ends of every step, of all points, the front ones first."""

    def values(self, scene, periods):
        return 0  # kept for one case only, of which no sweep asks how much memory it takes

    def sample(self, course):
        return tuple(a.reshape(len(a), -1) for a in (course.gap.values, course.gap_rate))


class Gaps(NamedTuple):
    """The gaps of an orbit over its period."""

    cubic: Cubic
    """Of each step [m], of shape (steps, points), the front points first."""
    step: float
    """Length of a step [s]."""
    per_period: int
    """Steps in a forcing period."""

    @classmethod
    def of(
        cls,
        gap: Array | np.ndarray,
        rate: Array | np.ndarray,
        steps: int,
        period: float,
    ) -> "Gaps":
        """Return the gaps from `gap` [m] and `rate` [m/s] at both ends of every step, (periods, steps + 1 or more,
        points); `period` [s]."""
        ends = lambda values, k: np.concatenate(np.asarray(values)[:, k : k + steps])
        # ends of steps in the order of time, slopes per step
        begin, end = ((ends(gap, k), period / steps * ends(rate, k)) for k in (0, 1))
        return cls(Cubic.through(*begin, *end), period / steps, steps)


class Grazing(NamedTuple):
    """The distance of each point from a grazing; arrays (points,)."""

    touchdowns: Int[np.ndarray, " points"]
    """Touchdowns within the period."""
    margin: Float[np.ndarray, " points"]
    """Least magnitude of a local extreme of the gap [m], infinite where there is none."""
    opening: Bool[np.ndarray, " points"]
    """True for a greatest gap, by which a contact opens, False for a least one, by which it touches."""
    time: Float[np.ndarray, " points"]
    """Instant of that extreme [forcing periods]."""


def grazing(gaps: Gaps) -> Grazing:
    """Return how near each point of an orbit is to a grazing."""
    # both extremes of every cubic, NaN where there is none inside the step
    x = gaps.cubic.extremes()
    magnitude = np.abs(gaps.cubic.value(x))
    per_point = lambda values: values.reshape(-1, values.shape[-1])  # both extremes of all steps
    magnitude = per_point(np.where(np.isnan(magnitude), np.inf, magnitude))
    nearest = (np.argmin(magnitude, axis=0), np.arange(magnitude.shape[1]))
    opening = per_point(gaps.cubic.curvature(x)) < 0
    time = per_point(np.arange(x.shape[1])[None, :, None] + x) / gaps.per_period
    # over the parts of steps and the steps
    touchdowns = np.sum(_falls(gaps)[0], axis=(0, 1))
    return Grazing(touchdowns, magnitude[nearest], opening[nearest], time[nearest])


def _falls(gaps: Gaps) -> tuple[Bool[np.ndarray, "3 steps points"], np.ndarray, np.ndarray]:
    """Return whether gaps fall below zero in the up to three parts of a step between extremes, and return the ends of
    these parts."""
    inner = gaps.cubic.extremes()
    # parts behind a missing extreme have no length
    inner = np.where(np.isnan(inner), 1.0, inner)
    starts = np.concatenate([np.zeros((1, *inner.shape[1:])), inner])
    ends = np.concatenate([inner, np.ones((1, *inner.shape[1:]))])
    # the end of a step has the sign of the next one's start, also where rounding makes the cubic differ
    following = np.roll(gaps.cubic.start, -1, axis=0)
    at_end = np.where(ends == 1.0, following, gaps.cubic.value(ends))
    return (gaps.cubic.value(starts) >= 0) & (at_end < 0) & (starts < ends), starts, ends


def contact_names(scene: Scene) -> list[str]:
    """Return the names of all contact points, with 1 at the front and 2 at the rear."""
    return [f"{name}{end}" for end in (1, 2) for name in scene.section.names]


def signature(scene: Scene, gaps: Gaps) -> Signature:
    """Return the signature of an orbit."""
    names = contact_names(scene)
    cubic = gaps.cubic
    falls, low, high = _falls(gaps)
    # by bisection, down to rounding
    for _ in range(60):
        middle = (low + high) / 2
        is_open = cubic.value(middle) >= 0
        low = np.where(is_open, middle, low)
        high = np.where(is_open, high, middle)
    rates = cubic.slope_at(low) / gaps.step
    touchdowns = []
    for part, step, point in zip(*np.nonzero(falls), strict=True):
        place = (part, step, point)
        time = float(step + low[place]) / gaps.per_period
        touchdowns.append(Touchdown(time, names[point], float(rates[place])))
    # a point whose gap is never open is in contact throughout
    highest = np.fmax(np.fmax.reduce(cubic.value(cubic.extremes()), axis=(0, 1)), cubic.start.max(axis=0))
    return Signature(
        tuple(sorted(touchdowns)),
        tuple(name for name, gap in zip(names, highest, strict=True) if gap < 0),
        min((abs(touchdown.rate) for touchdown in touchdowns), default=float("inf")),
        float(np.min(grazing(gaps).margin)),
    )
