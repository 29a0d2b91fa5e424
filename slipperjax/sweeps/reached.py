"""Periodic orbits that motions of a batch have reached: their exact exponents, and periods confirmed by them."""

from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..analysis.attractor import Attractors, recurrence
from ..flow.load import load_base, load_call, varied_names
from ..flow.period_map import initial_states
from ..flow.status import FASTEST_GROWTH, Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import COORDINATE_SCALES, COORDINATES
from ..model.scene import Scene
from ..orbits.motions import check_forcing, recurs
from ..orbits.periodic import DIVISOR, TOLERANCE
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.compile import jit
from .attractors import FLOOR, attractors, strobe_states
from .grid import Cases, filled
from .maps import Maps, rows_of
from .orbits import Orbits, find_orbits
from .plan import OnProgress
from .records import LONGEST

RECURS = 0.02
"""Distance of states a period apart, in multiples of `COORDINATE_SCALES`, below which an orbit is looked for."""
NEAR = 0.05
"""Greatest distance of a motion from an orbit that it has reached, in multiples of `COORDINATE_SCALES`."""
FAINTEST = 1e-5
"""Modulus per forcing period below which a multiplier is not told from rounding errors well enough."""
ITERATIONS = 20
"""Of Newton's method; from so near, three to eight are typical."""


class Reached(NamedTuple):
    """Orbits that cases have reached."""

    period: Int[np.ndarray, " cases"]
    """Forcing periods after which the orbit recurs; 0 where none was reached for certain."""
    exponents: Float[np.ndarray, "cases count"]
    """Of the orbit, ln |multiplier| per forcing period, the largest first [1/period]; NaN without an orbit."""
    half_step: Float[np.ndarray, " cases"]
    """The largest with steps half as long [1/period]; NaN where it was not asked for."""
    state: State
    """At the start of a forcing period; without an orbit, where the motion is."""


def nothing_reached(states: State, count: int) -> Reached:
    """Of cases for which no orbit was looked for."""
    cases = len(states.motion.y)
    return Reached(np.zeros(cases, int), np.full((cases, count), np.nan), np.full(cases, np.nan), states)


def reached_orbits(
    scenes: Batched[Scene],
    states: State,
    strobe: Float[np.ndarray, "cases periods coordinates"],
    steps: int,
    *,
    solver: diffrax.AbstractSolver,
    count: int,
    half_step: bool,
    wanted: Bool[np.ndarray, " cases"],
    on_progress: OnProgress,
) -> Reached:
    """The orbits that motions have reached, of the cases for which that is certain.

    It is where the motion recurs within `RECURS`, Newton's method finds an orbit, all its multipliers lie inside the
    unit circle, none that is asked for is fainter than `FAINTEST`, and the motion is within `NEAR` of the orbit and
    does not move away; with `half_step` an orbit with steps half as long must be found, stable and as near, too.

    **Arguments:** `states`: at the end of the record `strobe`, which has 20 periods or more; `count`: number of
    exponents; `wanted`: cases that are looked at.
    """
    found = nothing_reached(states, count)
    period = np.where(wanted & np.asarray(_recurs(scenes, states)), likely_periods(strobe), 0)
    if not period.any():
        return found
    options = dict(solver=solver, tolerance=TOLERANCE, max_iterations=ITERATIONS)
    orbits = find_orbits(scenes, states, steps, period=period, on_progress=on_progress, **options)
    exponents = _exponents(orbits, period, count)
    period = np.where(_sound(orbits) & np.all(exponents > np.log(FAINTEST), axis=1), period, 0)
    along = _along(Maps(scenes, states, steps, solver, period, on_progress), orbits.state)
    for k in np.flatnonzero(period):
        path = along[k, : period[k]]
        period[k] = least_period(path) if is_near(strobe[k], path) else 0
    half = found.half_step
    if half_step and period.any():
        twice = lambda periods: on_progress(2 * periods)
        finer = find_orbits(scenes, orbits.state, 2 * steps, period=period, on_progress=twice, **options)
        there = _along(Maps(scenes, states, 2 * steps, solver, period, twice), finer.state)
        apart = np.max(np.abs(there[:, 0] - along[:, 0]) / COORDINATE_SCALES, axis=1)
        half = _exponents(finer, period, 1)[:, 0]
        period = np.where(_sound(finer) & (apart <= NEAR), period, 0)
    taken = period > 0
    at = np.where(taken[:, None], rows_of(orbits.state), rows_of(states))
    return Reached(
        period,
        np.where(taken[:, None], exponents, np.nan),
        np.where(taken, half, np.nan),
        Maps(scenes, states, steps, solver, period, on_progress).states(at),
    )


def likely_periods(strobe: Float[np.ndarray, "cases periods coordinates"]) -> Int[np.ndarray, " cases"]:
    """Forcing periods after which motions seem to recur, 0 where they do not within `RECURS`.

    The least after which they recur about as closely as after any: a motion that approaches an orbit of period 1
    with a multiplier near -1 recurs after 2 periods.
    """
    periods = strobe.shape[1]
    lags = min(LONGEST, periods // 4)
    finite = np.where(np.all(np.isfinite(strobe), axis=(1, 2), keepdims=True), strobe, np.nan)
    series = recurrence(finite, scales=COORDINATE_SCALES, max_period=lags)
    missed = np.stack([series[:, n - 1, -max(n, periods // 10) :].max(axis=1) for n in range(1, lags + 1)], axis=1)
    missed = np.where(np.isfinite(missed), missed, np.inf)
    best = missed.min(axis=1, keepdims=True)
    close = missed <= np.maximum(3 * best, FLOOR)
    return np.where(best[:, 0] <= RECURS, np.argmax(close, axis=1) + 1, 0)


def least_period(path: Float[np.ndarray, "periods coordinates"]) -> int:
    """The divisor of the path's length after which it recurs already, or the length."""
    n = len(path)
    missed = lambda m: np.max(np.abs(path[m] - path[0]) / COORDINATE_SCALES)
    return next((m for m in range(1, n) if n % m == 0 and missed(m) < DIVISOR), n)


def is_near(strobe: Float[np.ndarray, "periods coordinates"], path: Float[np.ndarray, "period coordinates"]) -> bool:
    """Whether a motion that ends at the path's start is within `NEAR` of it, and was no nearer before."""
    back = -np.arange(len(strobe))
    apart = np.max(np.abs(strobe[back - 1] - path[back % len(path)]) / COORDINATE_SCALES, axis=1)
    quarter = len(strobe) // 4
    late, early = apart[:quarter].max(), apart[quarter : 2 * quarter].max()
    return bool(apart[: max(len(path), quarter // 4)].max() <= NEAR and late <= max(early, FLOOR))


def _exponents(orbits: Orbits, period: np.ndarray, count: int) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(np.abs(orbits.multipliers[:, :count])) / np.maximum(period, 1)[:, None]


def _sound(orbits: Orbits) -> np.ndarray:
    return (orbits.status == Status.FINITE) & orbits.stable & (orbits.growth <= FASTEST_GROWTH)


def _along(maps: Maps, states: State) -> np.ndarray:
    """Coordinates at the start of each forcing period, (cases, periods, coordinates); 0 without a period."""
    index = np.flatnonzero(maps.periods)
    rows = rows_of(states)[index]
    found = np.zeros((maps.count, max(int(maps.periods.max(initial=1)), 1), len(COORDINATES)))
    if len(index):
        path = maps.path(index, rows)[0]
        for k in range(path.shape[1]):
            found[index, k] = maps.coordinates(index, path[:, k])
    return found


@jit
def _recurs(scenes: Batched[Scene], states: State) -> jnp.ndarray:
    return scenes.map(lambda scene, _: recurs(scene), states)


class Confirmations(NamedTuple):
    """What Newton's method finds from motions that seem periodic; arrays over the cases."""

    confirmed: Bool[np.ndarray, "*cases"]
    """Whether the motion is on a stable orbit whose least period is the one that was named."""
    distance: Float[np.ndarray, "*cases"]
    """Of the motion's end from the orbit, in multiples of `slipperjax.model.COORDINATE_SCALES`; NaN without one."""
    residual: Float[np.ndarray, "*cases"]
    """What the orbit misses after its period, scaled [1]; NaN for motions that were not tried."""
    multiplier: Float[np.ndarray, "*cases"]
    """Modulus of the orbit's largest Floquet multiplier over its period [1]; NaN without an orbit."""
    stable: Bool[np.ndarray, "*cases"]
    """Whether it is below one."""
    status: Int[np.ndarray, "*cases"]
    """`Status` codes, `Status.NO_ORBIT` where no orbit was found, or none looked for."""


def confirm_periods(ds: xr.Dataset, found: Attractors | None = None) -> Confirmations:
    """Looks for the periodic orbits of a sweep's cases that recurrence calls periodic, by Newton's method.

    A recurrence is seen to within a tolerance; an orbit is exact, and its multipliers say whether it attracts. From
    the last state of each case one period is run, in which the contacts get their memory, and Newton's method begins.

    **Arguments:** `ds`: of `sweep` or `follow` with record "sections" or "strobe"; `found`: what
    `slipperjax.sweeps.attractors` says of it, which is found here where it is not given.

    **Returns:** `Confirmations`. A motion is confirmed where the orbit is stable, within `NEAR` of its last state,
    and has no shorter period.

    **Raises:** `ValueError` for other datasets, and for a track of several wavelengths that does not recur with the
    first.
    """
    found = attractors(ds) if found is None else found
    ends = strobe_states(ds, 1)[..., 0, :]
    shape = ends.shape[:-1]
    if np.shape(found.period) != shape:
        raise ValueError(
            f"Argument `found` must be of the cases of `ds`, {shape}, but has shape {np.shape(found.period)}."
        )
    cases = _cases(ds, ends)
    check_forcing(cases.scene)
    steps = _by_case(ds, "steps_per_period")
    solver = resolve_solver(cases.scene, load_call(ds)["solver"])
    period, ends = np.asarray(found.period).ravel(), ends.reshape(-1, len(COORDINATES))
    period = np.where(np.all(np.isfinite(ends), axis=1), period, 0)
    count = len(period)
    nan = lambda: np.full(count, np.nan)
    no = lambda: np.zeros(count, bool)
    out = Confirmations(no(), nan(), nan(), nan(), no(), np.full(count, int(Status.NO_ORBIT)))
    for number in np.unique(steps[period > 0]):
        some = np.flatnonzero((steps == number) & (period > 0))
        index = filled(some, len(some))
        scenes, starts = cases.take(index)
        states = initial_states(scenes, starts)
        maps = Maps(scenes, states, int(number), solver, period[index], lambda _: None)
        lanes = np.arange(len(some))
        begin = rows_of(states)
        begin[lanes] = maps.mapped(lanes, begin[lanes])
        asked = np.where(np.arange(len(index)) < len(some), period[index], 0)
        orbits = find_orbits(
            scenes,
            maps.states(begin),
            int(number),
            solver=solver,
            period=asked,
            tolerance=TOLERANCE,
            max_iterations=ITERATIONS,
            on_progress=lambda _: None,
        )
        _put(out, some, orbits, maps, ends[some])
    return Confirmations(*(part.reshape(shape) for part in out))


def _put(out: Confirmations, some: np.ndarray, orbits, maps: Maps, ends: np.ndarray) -> None:
    """Fills in what was found of some cases, the first lanes of a batch."""
    good = np.flatnonzero(orbits.status[: len(some)] == Status.FINITE)
    out.status[some] = orbits.status[: len(some)]
    out.residual[some] = orbits.residual[: len(some)]
    out.multiplier[some] = np.abs(orbits.multipliers[: len(some), 0])
    out.stable[some] = orbits.stable[: len(some)]
    path = maps.path(good, rows_of(orbits.state)[good])[0]
    along = [maps.coordinates(good, path[:, k]) for k in range(path.shape[1])]
    for k, lane in enumerate(good):
        own, n = some[lane], int(maps.periods[lane])
        out.distance[own] = np.max(np.abs(along[0][k] - ends[lane]) / COORDINATE_SCALES)
        least = least_period(np.array([states[k] for states in along[:n]])) == n
        out.confirmed[own] = out.stable[own] and least and out.distance[own] <= NEAR


def _by_case(ds: xr.Dataset, name: str) -> np.ndarray:
    """Values of a coordinate or variable for each of the cases, in the order of their statuses."""
    return ds[name].broadcast_like(ds["status"]).transpose(*ds["status"].dims).values.ravel()


def _cases(ds: xr.Dataset, ends: np.ndarray) -> Cases:
    """The cases of a dataset as a flat list, each starting from its last state."""
    scene, start = load_base(ds)
    names = [name for name in varied_names(ds) if not name.startswith("start_")]
    grid = {name: _by_case(ds, name) for name in names}
    if not grid:  # the start alone was varied
        grid = {"speed": np.full(ds["status"].size, float(scene.speed))}
    cases = Cases(scene, grid, start.motion if isinstance(start, State) else start, product=False)
    turned = jax.vmap(lambda *row: Motion.from_euler(**dict(zip(COORDINATES, row, strict=True))))
    finite = np.where(np.isfinite(ends.reshape(-1, len(COORDINATES))), ends.reshape(-1, len(COORDINATES)), 0.0)
    cases.starts = jax.tree.map(np.asarray, turned(*finite.T))
    return cases
