"""Orbits of a plane of parameters found from one another, and runs that begin at a state of their own."""

from collections.abc import Mapping
from typing import Any

import diffrax
import jax
import numpy as np
import xarray as xr

from ..flow.period_map import initial_states
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import MOTION_SCALES
from ..model.scene import Scene
from ..orbits.motions import check_forcing
from ..orbits.periodic import TOLERANCE, PeriodicOrbit
from ..tools.checks import number, positive, whole
from .executors import records_in_order, run_chunk, run_chunks
from .grid import Cases
from .maps import rows_of, states_of
from .orbits import Orbits, find_orbits
from .plan import make_plan
from .sweep import CaseRuns, case_attributes, case_variables, sweep_dataset

LEAP = 1.0
"""Distance from where its neighbours lead at which an orbit counts as another one, in multiples of
`MOTION_SCALES`."""
TRIES = 3
"""Neighbours from which an orbit of a case is looked for before there counts as none."""
BATCH = 32
"""Orbits that are looked for together: always as many, because each number of cases needs compiled programs."""
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))


def spread_orbits(
    scene: Scene,
    grid: Mapping[str, Any],
    orbit: PeriodicOrbit,
    *,
    leap: float = LEAP,
    tolerance: float = TOLERANCE,
    max_iterations: int = 20,
) -> xr.Dataset:
    """One family of periodic orbits over a grid of two parameters, stable or not.

    From the case nearest to a known orbit on, each is found by Newton's method from that of a neighbour, or from
    where a straight line through two neighbours leads. So the orbits belong together, which those of `orbit_sweep`
    need not do where motions coexist.

    **Arguments:**

    - `scene`, `grid`: as for `sweep`, with two parameters. `orbit`: one of the family, whose period and number of
        steps all have.
    - `leap`: greatest distance of an orbit's state at the start of a period from where it is looked for, in
        multiples of `slipperjax.model.MOTION_SCALES`; farther ones count as of another family.
    - `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's method.

    **Returns:** an `xarray.Dataset` over the grid with `state`, all numbers of the state; `multiplier_real`,
    `multiplier_imag` [1]; `stable`; and `status`, which is `Status.NO_ORBIT` where there is no orbit near those of
    the neighbours. The `state` there is where these lead, and NaN with `Status.NOT_RUN` where none has any.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    check_forcing(scene)
    cases = Cases(scene, grid, orbit.state)
    if len(cases.shape) != 2:
        raise ValueError(f"Argument `grid` must name two parameters, but names {', '.join(cases.axes)}.")
    how: dict[str, Any] = dict(solver=orbit.solver, period=orbit.period)
    how |= dict(
        tolerance=number(positive, "tolerance", tolerance), max_iterations=whole("max_iterations", max_iterations, 1)
    )
    steps = int(orbit.steps_per_period)
    plan = make_plan(
        scene, cases, record="strobe", transient=0, periods=1, steps_per_period=steps, solver=orbit.solver
    )
    leap, found = number(positive, "leap", leap), _Found(cases, orbit)
    while (tried := found.front()) is not None:
        for at in range(0, len(tried[0]), BATCH):
            places, begins = (a[at : at + BATCH] for a in tried)
            # batches are filled up with an orbit that is known, and so costs nothing
            lanes = np.append(places, np.full(BATCH - len(places), found.first))
            rows = np.concatenate([begins, np.repeat(found.row[None], BATCH - len(places), axis=0)])
            got = find_orbits(
                cases.take(lanes)[0], found.states(rows), steps, on_progress=lambda periods: None, **how
            )
            found.add(places, begins, got, leap)
    call = dict(function="spread_orbits", leap=leap, tolerance=tolerance, max_iterations=max_iterations)
    attrs = case_attributes(plan, cases, call) | {"orbit_period": orbit.period}
    return found.dataset(steps, attrs)


class _Found:
    """The orbits that are found until now, as rows of all cases."""

    def __init__(self, cases: Cases, orbit: PeriodicOrbit):
        self.cases, self.like = cases, orbit.state
        at = [float(orbit.scene.value(name)) for name in cases.axes]
        near = [int(np.argmin(np.abs(v - a))) for v, a in zip(cases.axes.values(), at, strict=True)]
        self.first = int(np.ravel_multi_index(near, cases.shape))
        self.row = rows_of(jax.tree.map(lambda a: np.asarray(a)[None], orbit.state))[0]
        """The orbit at `first`, as soon as that is found."""
        size = self.row.size
        self.rows = np.full((cases.count, size), np.nan)
        self.multipliers = np.full((cases.count, size), np.nan, complex)
        self.status = np.full(cases.count, int(Status.NOT_RUN))
        self.tried: set[tuple[int, int, int | None]] = set()
        self.tries = np.zeros(cases.count, int)
        self.begun = False

    def front(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Cases that are tried next, and the rows from which; None where there is nothing left."""
        if not self.begun:
            self.begun = True
            return np.array([self.first]), self.row[None]
        chosen = {}
        good = self.status == Status.FINITE
        for k in np.flatnonzero(~good & (self.tries < TRIES)).tolist():
            ways = [way for way in self.beside(k) if good[way[0]] and (k, *way) not in self.tried]
            ways = [way for way in ways if way[1] is None or good[way[1]]]
            if ways:
                chosen[k] = min(ways, key=lambda way: way[1] is None)
                self.tried.add((k, *chosen[k]))
                self.tries[k] += 1
        if not chosen:
            return None
        return np.array(list(chosen)), np.array([self.led(*way) for way in chosen.values()])

    def beside(self, k: int) -> list[tuple[int, int | None]]:
        """The neighbours of a case, alone, and each with the one behind it."""
        i, j = (int(a) for a in np.unravel_index(k, self.cases.shape))
        number = lambda a, b: a * self.cases.shape[1] + b if self.holds(a, b) else None
        ways = [(number(i + a, j + b), number(i + 2 * a, j + 2 * b)) for a, b in SIDES]
        return [(one, other) for one, behind in ways if one is not None for other in {behind, None}]

    def holds(self, i: int, j: int) -> bool:
        """Whether there is such a case."""
        return 0 <= i < self.cases.shape[0] and 0 <= j < self.cases.shape[1]

    def led(self, one: int, other: int | None) -> np.ndarray:
        """Where the motions of one or two neighbours lead; the memory is the nearer one's."""
        row = self.rows[one].copy()
        if other is not None:
            motion = np.s_[: len(jax.tree.leaves(MOTION_SCALES))]
            row[motion] += row[motion] - self.rows[other][motion]
        return row

    def add(self, places: np.ndarray, before: np.ndarray, got: Orbits, leap: float) -> None:
        """Takes what Newton's method found from the rows `before`, where it is no other family."""
        rows = rows_of(got.state)[: len(places)]
        scales = np.array(jax.tree.leaves(MOTION_SCALES))
        moved = np.max(np.abs(rows - before)[:, : len(scales)] / scales, axis=1)
        good = (got.status[: len(places)] == Status.FINITE) & (moved < leap)
        self.rows[places] = np.where(good[:, None], rows, before)
        self.status[places] = np.where(good, int(Status.FINITE), int(Status.NO_ORBIT))
        self.multipliers[places[good]] = got.multipliers[: len(places)][good]
        if self.status[self.first] == Status.FINITE:
            self.row = self.rows[self.first]

    def states(self, rows: np.ndarray) -> State:
        """Rows of numbers as states."""
        return states_of(rows, self.like)

    def dataset(self, steps: int, attrs: Mapping[str, Any]) -> xr.Dataset:
        """What is found, labelled."""
        dims, shape, mu = self.cases.dims, self.cases.shape, self.multipliers
        stable = np.all(np.abs(mu) < 1, axis=1)
        flat = {
            "state": (self.rows, ("number",), "all numbers of the state, as in slipperjax.State"),
            "multiplier_real": (mu.real, ("multiplier",), "Floquet multipliers, real parts"),
            "multiplier_imag": (mu.imag, ("multiplier",), "Floquet multipliers, imaginary parts"),
            "stable": (stable, (), "whether all multipliers lie inside the unit circle"),
        }
        ds = xr.Dataset(coords=self.cases.coordinates(), attrs=attrs)
        for name, (values, more, words) in flat.items():
            unit = {"units": "1"} if name.startswith("multiplier") else {}
            ds[name] = ((*dims, *more), values.reshape(shape + values.shape[1:]), unit | {"long_name": words})
        return ds.assign(case_variables(dims, self.status.reshape(shape), np.full(shape, steps)))


def sweep_from(
    scene: Scene,
    grid: Mapping[str, Any],
    states: State,
    *,
    transient: int = 200,
    periods: int = 10,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """As `sweep` with record "strobe", each case from a state of its own.

    **Arguments:** `states`: with a leading axis of cases in the order of the grid, the last parameter fastest.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted`, with the finished cases, after
    Ctrl-C.
    """
    like = jax.tree.map(lambda a: np.asarray(a)[0], states)
    cases = Cases(scene, grid, like)
    lengths = {len(np.atleast_1d(leaf)) for leaf in jax.tree.leaves(states)}
    if lengths != {cases.count}:
        raise ValueError(f"Argument `states` must have {cases.count} rows, one for each case, but has {lengths}.")
    cases.starts = jax.tree.map(np.asarray, states)
    common: dict[str, Any] = dict(transient=transient, periods=periods)
    plan = make_plan(scene, cases, record="strobe", steps_per_period=steps_per_period, solver=solver, **common)
    chunks, workers = plan.chunks(chunk, workers)

    def work(chunk, on_progress):
        scenes, starts = cases.take(chunk.index)
        return run_chunk(plan, scenes, initial_states(scenes, starts), chunk.steps, on_progress)

    runs = run_chunks(chunks, workers, work, periods=plan.work, progress=progress)
    found = records_in_order(chunks, [(run.status, run.record) for run in runs.results])
    call = dict(function="sweep_from", record="strobe", **common)
    return runs.checked(sweep_dataset(plan, cases, CaseRuns(found[0], plan.steps, found[1]), call))
