"""Lines through the points of a branch: which values of neighbouring points belong together, and what is stable."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

VELOCITY_JUMP = 0.8
"""Change of a crossing's velocity between neighbouring points, over the larger one, beyond which no line is drawn."""
SMALL_JUMP = 0.05
"""Change over the range of all velocities that is no jump, however small the velocities are."""
TIME_JUMP = 0.1
"""Change of a crossing's time [forcing periods] beyond which no line is drawn."""
POOR = 1e6
"""Cost of a match that is not to be made."""


class Thread(NamedTuple):
    """One value, such as the velocity of one crossing, on consecutive points of a branch."""

    first: int
    """The first of the points."""
    values: list[float]


def crossing_threads(velocity: np.ndarray, time: np.ndarray, period: int) -> list[Thread]:
    """The crossings of a section as lines.

    The number of crossings changes from point to point, and their order where one appears or passes the start of the
    period. Those of neighbouring points are matched by velocity and time; where the match is poor, a line ends and
    another begins.

    **Arguments:** `velocity` (points, crossings), NaN where there are fewer; `time` [forcing periods], likewise;
    `period`: after which the orbits recur [forcing periods].
    """
    finite = velocity[np.isfinite(velocity)]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    done: list[Thread] = []
    open_: list[Thread] = []
    was = np.zeros(0), np.zeros(0)
    for point, (values, times) in enumerate(zip(velocity, time, strict=True)):
        there = np.isfinite(values)
        now = values[there], times[there]
        following: list[Thread | None] = [None] * len(now[0])
        for k, n in _matches(was, now, period, span):
            open_[k].values.append(float(now[0][n]))
            following[n] = open_[k]
        done += [Thread(point, [float(v)]) for v, one in zip(now[0], following, strict=True) if one is None]
        begun = iter(done[len(done) - following.count(None) :])
        open_ = [next(begun) if one is None else one for one in following]
        was = now
    return done


def _matches(was: tuple, now: tuple, period: int, span: float) -> Iterator[tuple[int, int]]:
    """Pairs of crossings, velocities and times, of two neighbouring points."""
    (v0, t0), (v1, t1) = ((v[:, None], t[:, None]) for v, t in (was, now))
    v1, t1 = v1.T, t1.T
    larger = np.maximum(np.abs(v0), np.abs(v1))
    jump = np.abs(v1 - v0) / np.maximum(np.maximum(VELOCITY_JUMP * larger, SMALL_JUMP * span), 1e-300)
    shift = np.abs((t1 - t0 + period / 2) % period - period / 2) / TIME_JUMP
    cost = np.hypot(jump, shift)
    cost = np.where(cost <= 1, cost, POOR)
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    for k, n in zip(*linear_sum_assignment(cost), strict=True):
        if cost[k, n] < POOR:
            yield int(k), int(n)


def scalar_threads(values: np.ndarray, breaks: np.ndarray) -> list[Thread]:
    """Values (points,) as lines, which end where they are not finite, and between points k and k + 1 at `breaks`."""
    found: list[Thread] = []
    apart = True
    for point, value in enumerate(values):
        if np.isfinite(value):
            if apart or breaks[point - 1]:
                found.append(Thread(point, []))
            found[-1].values.append(float(value))
        apart = not np.isfinite(value)
    return found


def stable_parts(ds: xr.Dataset) -> np.ndarray:
    """Whether a branch is stable between its points, of shape (points - 1,).

    An event has multipliers on the unit circle, or those of one side of a grazing: its other neighbour decides.
    """
    stable, event = ds["stable"].values.astype(bool), ds["label"].values.astype(str) != ""
    ahead, behind = stable[1:], stable[:-1]
    return np.where(event[:-1] & ~event[1:], ahead, np.where(event[1:] & ~event[:-1], behind, ahead & behind))


def pieces(thread: Thread, chosen: np.ndarray) -> Iterator[tuple[slice, list[float]]]:
    """The parts of a line in which the parts `chosen` (points - 1,) of the branch follow one another."""
    start = None
    last = thread.first + len(thread.values) - 1
    for point in range(thread.first, last + 1):
        inside = point < last and bool(chosen[point])
        if inside and start is None:
            start = point
        if not inside and start is not None:
            yield slice(start, point + 1), thread.values[start - thread.first : point + 1 - thread.first]
            start = None


def joined(x: np.ndarray, threads: list[Thread], chosen: np.ndarray) -> tuple[Any, Any]:
    """One curve of all chosen parts of lines, with NaN between them."""
    xs, ys = [], []
    for thread in threads:
        for where, values in pieces(thread, chosen):
            xs += [*x[where], np.nan]
            ys += [*values, np.nan]
    return np.array(xs), np.array(ys)
