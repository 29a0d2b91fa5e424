"""Periods named by recurrence, confirmed by Newton's method."""

from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..analysis.attractor import Attractors
from ..flow.load import load_base, load_call, varied_names
from ..flow.period_map import initial_states
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import COORDINATE_SCALES, COORDINATES
from ..orbits.motions import check_forcing
from ..orbits.periodic import TOLERANCE
from ..solvers.named import resolve_solver
from .attractors import attractors, strobe_states
from .grid import Cases, filled
from .maps import Maps, rows_of
from .orbits import find_orbits
from .reached import ITERATIONS, NEAR, least_period


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
    period, ends = np.asarray(found.period).ravel(), ends.reshape(-1, 10)
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
    finite = np.where(np.isfinite(ends.reshape(-1, 10)), ends.reshape(-1, 10), 0.0)
    cases.starts = jax.tree.map(np.asarray, turned(*finite.T))
    return cases
