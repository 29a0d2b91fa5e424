"""The contact signature of an orbit: which points touch down, in which order and how fast, found and not given."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..flow import AbstractRecorder
from ..model import Args, Scene, State, contacts


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
    """Least gap of points that never touch [m]; infinite where all do. Grazing is where this or `slowest` is zero."""

    @property
    def points(self) -> tuple[str, ...]:
        """The points in the order of their touchdowns."""
        return tuple(touchdown.point for touchdown in self.touchdowns)

    def __repr__(self) -> str:
        order = " ".join(self.points) or "none"
        closed = f", closed throughout: {' '.join(self.closed)}" if self.closed else ""
        return (
            f"Signature({order}; slowest touchdown {self.slowest:.3g} m/s, nearest gap {self.nearest:.3g} m{closed})"
        )


@dataclass(frozen=True)
class Gaps(AbstractRecorder):
    """Gaps and their rates at both ends of every step."""

    def __call__(self, states: State, args: Args, steps: Any) -> Any:
        places = jnp.arange(states.motion.y.shape[0])
        return jax.vmap(lambda k, s: contacts(args.frame(k / steps), s.motion)[:2])(places, states)

    @property
    def values(self) -> int:
        return 0  # kept for one case only, of which no sweep asks how much memory it takes

    def collect(self, kept: Any) -> tuple[np.ndarray, np.ndarray]:
        gap, rate = kept
        return np.asarray(gap), np.asarray(rate)

    def label(self, scene: Scene, dims: tuple[str, ...], record: Any) -> Any:
        raise NotImplementedError("Gaps of steps have no labels.")


def signature(scene: Scene, gap: np.ndarray, rate: np.ndarray) -> Signature:
    """The signature of an orbit.

    **Arguments:** `gap` [m], `rate` [m/s]: at both ends of every step, (periods, steps + 1, 2 points), in which the
    front comes first. Touchdowns and their rates are interpolated as the latch does.
    """
    steps = gap.shape[1] - 1
    names = [f"{name}{end}" for end in (1, 2) for name in scene.section.names]
    step = float(scene.period) / steps
    found = []
    for k, n, p in zip(*np.nonzero((gap[:, :-1] >= 0) & (gap[:, 1:] < 0)), strict=True):
        share, speed = _crossing(gap[k, n : n + 2, p], step * rate[k, n : n + 2, p])
        found.append(Touchdown(float(k + (n + share) / steps), names[p], float(speed / step)))
    open_ones = np.min(gap, axis=(0, 1)) >= 0
    closed = np.max(gap, axis=(0, 1)) < 0
    lowest = _lowest(gap[..., open_ones], step * rate[..., open_ones])
    return Signature(
        tuple(sorted(found)),
        tuple(name for name, yes in zip(names, closed, strict=True) if yes),
        min((abs(t.rate) for t in found), default=float("inf")),
        float(lowest),
    )


def _crossing(gap: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """Where the cubic with these ends and slopes per step is zero, in [0, 1], and its slope there."""
    (g0, g1), (d0, d1) = gap, slope
    cubic = np.polynomial.Polynomial([g0, d0, 3 * (g1 - g0) - 2 * d0 - d1, 2 * (g0 - g1) + d0 + d1])
    x = g0 / (g0 - g1)
    for _ in range(4):
        x = float(np.clip(x - cubic(x) / min(cubic.deriv()(x), -1e-300), 0, 1))
    return x, float(cubic.deriv()(x))


def _lowest(gap: np.ndarray, slope: np.ndarray) -> float:
    """The least value of the cubics through gaps and slopes per step at the ends of steps."""
    if gap.size == 0:
        return float("inf")
    g0, g1, d0, d1 = gap[:, :-1], gap[:, 1:], slope[:, :-1], slope[:, 1:]
    x = np.linspace(0, 1, 9)[:, None, None, None]
    a, b = 2 * (g0 - g1) + d0 + d1, 3 * (g1 - g0) - 2 * d0 - d1
    return float(np.min(((a * x + b) * x + d0) * x + g0))
