"""The contact signature of an orbit: which points touch down, in which order and how fast.

Gaps are cubics in every step, so that touchdowns and extremes inside steps are found. An orbit grazes where an
extreme of a gap is zero: there a touchdown, or an opening during contact, appears or vanishes.
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
    """Name of the contact point, with 1 at the front or 2 at the rear."""
    rate: float
    """Rate of the gap [m/s], negative."""


class Signature(NamedTuple):
    """Touchdowns of an orbit's contact points, with its distance from a grazing."""

    touchdowns: tuple[Touchdown, ...]
    """Touchdowns in the order of time."""
    closed: tuple[str, ...]
    """Names of points that are always in contact."""
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
    """Gaps [m] of all points, front points first, and their rates [m/s], at both ends of every step."""

    def values(self, scene, periods):
        return 0  # no sweep uses this record, so that its memory is not estimated

    def sample(self, course):
        return tuple(a.reshape(len(a), -1) for a in (course.gap.values, course.gap_rate))


class Gaps(NamedTuple):
    """The gaps of an orbit over its period."""

    cubic: Cubic
    """Gap in each step [m], of shape (steps, points), the front points first."""
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
        """Return the gaps from samples at the ends of steps.

        **Arguments:** `gap` [m], `rate` [m/s]: of shape (periods, steps + 1 or more, points); `steps`: per forcing
        period; `period`: length of a forcing period [s].
        """
        # k = 0: at the starts of all steps, k = 1: at their ends; periods are joined
        ends = lambda values, k: np.concatenate(np.asarray(values)[:, k : k + steps])
        # a cubic takes slopes per step, not per second
        begin, end = ((ends(gap, k), period / steps * ends(rate, k)) for k in (0, 1))
        return cls(Cubic.through(*begin, *end), period / steps, steps)


class Grazing(NamedTuple):
    """Distance of each contact point from a grazing."""

    touchdowns: Int[np.ndarray, " points"]
    """Touchdowns within the period."""
    margin: Float[np.ndarray, " points"]
    """Least magnitude of a local extreme of the gap [m], infinite where there is none."""
    opening: Bool[np.ndarray, " points"]
    """Whether this extreme is a maximum, where a contact opens, and not a minimum, where it touches."""
    time: Float[np.ndarray, " points"]
    """Instant of the extreme [forcing periods]."""


def grazing(gaps: Gaps) -> Grazing:
    """Return the distance of each contact point of an orbit from a grazing."""
    # both extremes of every cubic, NaN where there is none inside the step
    x = gaps.cubic.extremes()
    magnitude = np.abs(gaps.cubic.value(x))
    per_point = lambda values: values.reshape(-1, values.shape[-1])  # from (2, steps, points)
    magnitude = per_point(np.where(np.isnan(magnitude), np.inf, magnitude))
    nearest = (np.argmin(magnitude, axis=0), np.arange(magnitude.shape[1]))
    opening = per_point(gaps.cubic.curvature(x)) < 0
    time = per_point(np.arange(x.shape[1])[None, :, None] + x) / gaps.per_period
    touchdowns = np.sum(_falls(gaps)[0], axis=(0, 1))
    return Grazing(touchdowns, magnitude[nearest], opening[nearest], time[nearest])


def _falls(gaps: Gaps) -> tuple[Bool[np.ndarray, "3 steps points"], np.ndarray, np.ndarray]:
    """Return in which parts of a step gaps fall below zero, and where these parts start and end.

    Extremes divide a step into up to three parts, in each of which a gap is monotone.
    """
    inner = gaps.cubic.extremes()
    # a part after a missing extreme has length zero
    inner = np.where(np.isnan(inner), 1.0, inner)
    starts = np.concatenate([np.zeros((1, *inner.shape[1:])), inner])
    ends = np.concatenate([inner, np.ones((1, *inner.shape[1:]))])
    # the sign at a step's end is that at the next step's start, because rounding may give the cubic another sign
    following = np.roll(gaps.cubic.start, -1, axis=0)
    at_end = np.where(ends == 1.0, following, gaps.cubic.value(ends))
    return (gaps.cubic.value(starts) >= 0) & (at_end < 0) & (starts < ends), starts, ends


def signature(scene: Scene, gaps: Gaps) -> Signature:
    """Return the contact signature of an orbit."""
    names = scene.point_names
    cubic = gaps.cubic
    falls, low, high = _falls(gaps)
    # bisect each part for the instant of the fall, down to rounding
    for _ in range(60):
        middle = (low + high) / 2
        is_open = cubic.value(middle) >= 0
        low = np.where(is_open, middle, low)
        high = np.where(is_open, high, middle)
    # slopes of the cubics are per step
    rates = cubic.slope_at(low) / gaps.step
    touchdowns = []
    for part, step, point in zip(*np.nonzero(falls), strict=True):
        place = (part, step, point)
        time = float(step + low[place]) / gaps.per_period
        touchdowns.append(Touchdown(time, names[point], float(rates[place])))
    # a point whose gap is never open is always in contact
    highest = np.fmax(np.fmax.reduce(cubic.value(cubic.extremes()), axis=(0, 1)), cubic.start.max(axis=0))
    return Signature(
        tuple(sorted(touchdowns)),
        tuple(name for name, gap in zip(names, highest, strict=True) if gap < 0),
        min((abs(touchdown.rate) for touchdown in touchdowns), default=float("inf")),
        float(np.min(grazing(gaps).margin)),
    )
