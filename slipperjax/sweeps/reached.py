"""Periodic orbits that motions of a batch have reached, and their exact exponents."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..analysis.attractor import recurrence
from ..flow.status import FASTEST_GROWTH, Status
from ..model.dynamics import State
from ..model.layout import coordinates
from ..model.quantities import COORDINATE_SCALES
from ..model.scene import Scene
from ..orbits.motions import recurs
from ..orbits.periodic import DIVISOR, TOLERANCE
from ..tools.batching import Batched
from ..tools.compile import jit
from .attractors import FLOOR
from .orbits import Maps, Orbits, find_orbits, rows_of

NEAR = 0.05
"""Greatest distance from its orbit of a motion that has reached it, in multiples of `COORDINATE_SCALES`."""


class ReachedOrbits(NamedTuple):
    """Periodic orbits that cases have reached, and their exponents."""

    # Forcing periods after which the orbit recurs; 0 where it is not certain that one was reached.
    period: Int[np.ndarray, " cases"]
    # ln |multiplier| of the orbit per forcing period, the largest first [1/period]; NaN without an orbit.
    exponents: Float[np.ndarray, "cases count"]
    # The largest exponent with half the step [1/period]; NaN where it was not requested.
    half_step: Float[np.ndarray, " cases"]
    state: State  # at the start of a forcing period; without an orbit, the motion's own state


def reached_orbits(
    maps: Maps,
    states: State,
    strobe: Float[np.ndarray, "cases periods coordinates"],
    *,
    count: int,
    half_step: bool,
) -> ReachedOrbits:
    """Return the orbits that motions have certainly reached.

    It is certain where the motion recurs, Newton's method finds an orbit, all its multipliers are inside the unit
    circle, and the motion is near the orbit and does not move away. With `half_step`, a stable orbit must also be
    found nearby with half the step.

    **Arguments:** `maps`: over one period, or zero for cases that are left out; `states`: at the end of the record
    `strobe`, which has 20 periods or more; `count`: number of exponents.
    """
    period = np.where(maps.periods > 0, likely_periods(strobe), 0)
    if period.any():
        period = np.where(_recurs(maps.scenes, states), period, 0)
    # if all cases are chaotic, none of the programs below is compiled
    if not period.any():
        unknown = np.full((len(period), count + 1), np.nan)
        return ReachedOrbits(period, unknown[:, 1:], unknown[:, 0], states)
    # from so near, three to eight iterations are typical
    options = dict(tolerance=TOLERANCE, max_iterations=20)
    orbits = find_orbits(maps._replace(periods=period), states, **options)
    exponents = _exponents(orbits, period, count)
    # multipliers with a smaller modulus per forcing period are lost in rounding errors
    period = np.where(_sound(orbits) & np.all(exponents > np.log(1e-5), axis=1), period, 0)
    along = _along(maps._replace(periods=period.copy()), orbits.state)
    for k in np.flatnonzero(period):
        path = along[k, : period[k]]
        period[k] = least_period(path) if is_near(strobe[k], path) else 0
    half = np.full(len(period), np.nan)
    if half_step and period.any():
        finer_maps = maps._replace(periods=period, steps=2 * maps.steps)
        finer = find_orbits(finer_maps, orbits.state, **options)
        there = _along(finer_maps, finer.state)
        apart = np.max(np.abs(there[:, 0] - along[:, 0]) / COORDINATE_SCALES, axis=1)
        half = _exponents(finer, period, 1)[:, 0]
        period = np.where(_sound(finer) & (apart <= NEAR), period, 0)
    on_orbit = period > 0
    at = np.where(on_orbit[:, None], rows_of(orbits.state), rows_of(states))
    exponents = np.where(on_orbit[:, None], exponents, np.nan)
    return ReachedOrbits(period, exponents, np.where(on_orbit, half, np.nan), maps.states(at))


def likely_periods(strobe: Float[np.ndarray, "cases periods coordinates"]) -> Int[np.ndarray, " cases"]:
    """Return the forcing periods after which motions seem to recur, 0 where they do not.

    This is the smallest lag after which they recur within three times the best distance. A motion that approaches an
    orbit of period 1 with a multiplier near -1 changes sides, and recurs after 2 periods.
    """
    periods = strobe.shape[1]
    lags = min(16, periods // 4)
    finite = np.where(np.all(np.isfinite(strobe), axis=(1, 2), keepdims=True), strobe, np.nan)
    series = recurrence(finite / COORDINATE_SCALES, lags)
    missed = np.stack(
        [apart[:, -max(n, periods // 10) :].max(axis=1) for n, apart in series.items()],
        axis=1,
    )
    missed = np.where(np.isfinite(missed), missed, np.inf)
    best = missed.min(axis=1, keepdims=True)
    close = missed <= np.maximum(3 * best, FLOOR)
    return np.where(best[:, 0] <= 0.02, np.argmax(close, axis=1) + 1, 0)


def least_period(path: Float[np.ndarray, "periods coordinates"]) -> int:
    """Return the smallest divisor of the path's length after which it recurs, or the length itself."""
    n = len(path)
    missed = lambda m: np.max(np.abs(path[m] - path[0]) / COORDINATE_SCALES)
    return next((m for m in range(1, n) if n % m == 0 and missed(m) < DIVISOR), n)


def is_near(
    strobe: Float[np.ndarray, "periods coordinates"],
    path: Float[np.ndarray, "period coordinates"],
) -> bool:
    """Return whether a motion that ends at the path's start is near the path, and was no nearer before."""
    # from the last state backwards, together with the orbit, which begins where the record ends
    back = -np.arange(len(strobe))
    apart = np.max(np.abs(strobe[back - 1] - path[back % len(path)]) / COORDINATE_SCALES, axis=1)
    # a motion that leaves an orbit is further from it in the last quarter than in the quarter before
    quarter = len(strobe) // 4
    late = apart[:quarter].max()
    early = apart[quarter : 2 * quarter].max()
    return bool(apart[: max(len(path), quarter // 4)].max() <= NEAR and late <= max(early, FLOOR))


def _exponents(orbits: Orbits, period: np.ndarray, count: int) -> np.ndarray:
    """Return ln |multiplier| per forcing period, (cases, count), the largest first [1/period]."""
    with np.errstate(divide="ignore"):
        return np.log(np.abs(orbits.multipliers[:, :count])) / np.maximum(period, 1)[:, None]


def _sound(orbits: Orbits) -> np.ndarray:
    """Return whether each orbit was found, is stable, and has steps short enough for the growth along it."""
    return (orbits.status == Status.FINITE) & orbits.stable & (orbits.growth <= FASTEST_GROWTH)


def _along(maps: Maps, states: State) -> np.ndarray:
    """Return coordinates at the start of each forcing period, (cases, periods, coordinates), of orbits."""
    index = np.flatnonzero(maps.periods)
    path, _ = maps.path(index, rows_of(states)[index])
    # all cases at once, so that one program serves for any number of cases
    every = np.zeros((path.shape[1], len(maps.periods), path.shape[-1]))
    every[:, index] = np.moveaxis(path, 1, 0)
    return np.stack([coordinates(maps.states(rows)) for rows in every], axis=1)


@jit
def _recurs(scenes: Batched[Scene], states: State) -> jnp.ndarray:
    return scenes.map(lambda scene, _: recurs(scene), states)
