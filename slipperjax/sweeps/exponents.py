"""Lyapunov exponents of a whole grid as one batch, with a certificate for each case.

Cases run in up to three stages, each with chunks of its own: all pass the transient, after which periodic ones take
the exponents of their orbits; those of the others are measured; chaotic ones run for longer.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from ..analysis.attractor import KINDS, classify
from ..analysis.floquet import largest_exponent
from ..analysis.lyapunov import is_chaotic, standard_error
from ..flow.period_map import initial_states
from ..flow.simulate import Trajectory, first_of
from ..flow.status import Interrupted, Status, first_problem
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.quantities import COORDINATE_SCALES
from ..model.scene import Scene
from ..orbits.exponents import check_count
from ..tools.checks import whole, yes_or_no
from .attractors import FLOOR
from .exponent_data import Checks, Measured, exponent_data
from .grid import Grid
from .maps import Maps, rows_of
from .reached import Reached, nothing_reached, reached_orbits
from .records import BLOCK, JACOBIAN, LAST, LOOK, Measure, measured_periods, tangents_cost
from .run import PERIODS_PER_CALL, Part, Plan, RunOptions, call_of, make_plan, run_cases, run_chunk
from .store import Store, storable
from .sweep import case_attributes
from .transience import take_votes

SEARCH = 4
"""Jacobians that the search for an orbit takes, about; as many again with steps half as long."""


@storable
def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    count: int = 1,
    product: bool = True,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    orbits: bool = True,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
    store: Store | str | Path | None = None,
    executor: Any = None,
) -> xr.Dataset:
    """Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    Where a case has reached a stable periodic orbit after the transient, its exponents are those of the orbit's
    Floquet multipliers, exact to about 1e-8, which costs about a seventh of a measurement.

    **Arguments:** `count`, `periods`: as for `lyapunov_spectrum`; `certify`: whether each case is checked, which
    costs about as much again, and five times as much for chaotic cases; `orbits`: whether exponents are taken
    from orbits, so that without it all are measured; `transient`: `BLOCK` periods at least; others as for `sweep`.
    Periods are rounded up to whole blocks of `BLOCK`, after each of which the status is looked at.

    **Returns:** an `xarray.Dataset` over the grid with

    - `exponent` and `stderr` [1/period], with dimension `count`; `weighted_exponent`: the same by a smoothly weighted
      mean, sharper for regular motions (see `slipperjax.analysis.weighted_mean`); `by_orbit`: whether they are those
      of an orbit, with standard errors of zero; `kaplan_yorke` where count > 1; `kind` and `period` [forcing
      periods]: of the orbit, or what the motion is by recurrence in the last `LAST` counted periods, see
      `slipperjax.analysis.classify`; `regime`: see `slipperjax.analysis.regime`; `status` and `steps_per_period`: as
      `sweep` gives them;
    - with `certify`: `half_step`, the largest exponent with steps half as long, and its standard error
      `half_step_stderr`;
      `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all that
      applies agrees;
      `escapes`, how many of `MOTIONS` motions of a chaotic case became regular within `HOLD` periods more, and
      `chaotic_for`, the forcing periods for which none did.

    A case is `resolved` where its status is 0, the exponent with steps half as long lies within three standard errors
    of the difference or 1e-3, the exponents of both halves of the record within three of theirs or 1e-2, and the
    weighted exponent of a periodic motion is that of its multiplier within 1e-3. A case on an orbit is resolved where
    the exponent of the orbit with steps half as long, which must be found and stable, too, differs by 1e-2 at most.

    A case takes the exponents of an orbit only where that is certain, see `slipperjax.sweeps.reached`: all others,
    with unstable, distant or missing orbits, forcings that do not recur, or anything wrong, are measured.

    The exponents of a certified chaotic case, and their standard errors, are those of its `MOTIONS` longer motions,
    see `slipperjax.analysis.pooled_standard_error`. Where some became regular, it is "transient chaos", with the
    exponents of the chaotic stretch.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C. Chaotic cases whose
    longer motions were not finished then have the exponents that were measured, and `Status.NOT_RUN`.
    """
    call = call_of("lyapunov_sweep", locals())
    start, passed = first_of(start), whole("transient", transient, BLOCK)
    count, counted = check_count(scene, count), -(-whole("periods", periods, 1) // BLOCK)
    settle = _Settle(count, certify, yes_or_no("orbits", orbits))
    measure = _Measurement(count, counted, certify)
    plan = make_plan(
        Grid(scene, grid, product=product),
        start,
        RunOptions(0, 1, steps_per_period, None, solver),
        cost_after=passed + settle.cost + measure.cost,
        values_after=10 * passed + measured_periods(counted) * (count + 2),
    ).strobes(passed)
    options: dict[str, Any] = dict(chunk=chunk, workers=workers, progress=progress)
    measured, by_orbit, interrupted = _measured(plan, settle, measure, options)
    votes = None
    if certify and not interrupted:
        exponent, error = measured.history.mean(axis=1)[:, 0], standard_error(measured.history)[:, 0]
        chosen = np.flatnonzero(is_chaotic(exponent, error) & (measured.status == Status.FINITE))
        if len(chosen):
            epoch = plan.periods + measured_periods(counted)
            votes, interrupted = take_votes(plan, chosen, measured.state, epoch, counted, count, options)
            unfinished = votes.status == Status.NOT_RUN
            measured.status[chosen[unfinished]] = Status.NOT_RUN
            votes = votes.of(np.flatnonzero(~unfinished))
    attrs = case_attributes(plan, call) | {"transient": plan.periods, "periods": counted * BLOCK}
    finished = int(np.sum(measured.status != Status.NOT_RUN))
    if interrupted and not finished:
        raise Interrupted(None, 0, plan.cases.count)
    ds = exponent_data(plan, measured, by_orbit, votes, attrs)
    if interrupted:
        raise Interrupted(ds, finished, plan.cases.count)
    return ds


def _measured(
    plan: Plan, settle: "_Settle", measure: "_Measurement", options: Mapping[str, Any]
) -> tuple[Measured, Bool[np.ndarray, " cases"], bool]:
    """Runs the transient, and measures the cases that have not reached an orbit.

    **Returns:** the exponents, whether they are those of an orbit, and whether a run was interrupted.
    """
    work = lambda part: settle(plan, part)
    run = run_cases(plan, work, cost=plan.cost + settle.cost, tangents=True, name="transient", **options)
    if run.results is None:
        raise Interrupted(None, 0, plan.cases.count)
    settled, by_orbit = run.results, run.results.reached.period > 0
    measured = measure.blank(settled)
    _put_orbits(measured, by_orbit, settled.reached)
    index = np.flatnonzero(~by_orbit)
    if run.interrupted or not len(index):
        return measured, by_orbit, run.interrupted
    work = lambda part: measure(plan, part, jax.tree.map(lambda a: a[part.index], settled))
    name = f"exponents of {len(index)} cases"
    run = run_cases(plan, work, cost=measure.cost, index=index, tangents=True, name=name, **options)
    if run.results is not None:
        for of_all, of_index in zip(jax.tree.leaves(measured), jax.tree.leaves(run.results), strict=True):
            of_all[index] = of_index
    return measured, by_orbit, run.interrupted


class _Settled(NamedTuple):
    """Cases after the transient."""

    status: Int[np.ndarray, " cases"]
    state: State
    reached: Reached


class _Settle(NamedTuple):
    """The transient of a chunk, with a search for the orbits that its cases have reached."""

    count: int
    certify: bool
    orbits: bool

    @property
    def cost(self) -> float:
        """Cost of the search for an orbit of period 1, as most are, in unrecorded forcing periods."""
        search = SEARCH * JACOBIAN * (3 if self.certify else 1) + LOOK * PERIODS_PER_CALL
        return search if self.orbits else 0.0

    def __call__(self, plan: Plan, part: Part) -> _Settled:
        scenes = part.scenes
        run = run_chunk(plan, scenes, initial_states(scenes, part.starts), part.steps, part.on_progress)
        states, status = jax.tree.map(np.asarray, run.state), np.asarray(run.status)
        if not self.orbits:
            return _Settled(status, states, nothing_reached(states, self.count))
        reached = reached_orbits(
            scenes,
            states,
            run.record[0][:, -LAST:],
            part.steps,
            solver=plan.solver,
            count=self.count,
            half_step=self.certify,
            wanted=(status == Status.FINITE) & (np.arange(len(status)) < part.cases),
            on_progress=part.on_progress,
        )
        periodic = np.flatnonzero(reached.period)
        if len(periodic):
            epoch = float(plan.periods)
            maps = Maps(scenes, states, part.steps, plan.solver, reached.period, part.on_progress, epoch)
            codes = maps.look(periodic, rows_of(reached.state)[periodic], plan.capacity(part.steps))
            # the measurement says what is wrong with a case
            reached.period[periodic[codes != Status.FINITE]] = 0
        return _Settled(status, states, reached)


class _Measurement(NamedTuple):
    """A measurement of the exponents of a chunk after the transient."""

    count: int
    blocks: int
    certify: bool

    @property
    def cost(self) -> float:
        """Cost in unrecorded forcing periods."""
        half_step = 2 * tangents_cost(1) if self.certify else 0.0
        return (tangents_cost(self.count) + half_step) * measured_periods(self.blocks) + LOOK * PERIODS_PER_CALL

    def blank(self, settled: _Settled) -> Measured:
        """Results of cases that were not measured."""
        cases, periods = len(settled.status), BLOCK * self.blocks
        rows = lambda count: np.full((cases, periods, count), np.nan)
        status = np.full(cases, int(Status.NOT_RUN))
        checks = Checks(rows(1), status.copy(), np.full(cases, np.nan)) if self.certify else None
        unresolved = np.full(cases, KINDS.index("unresolved"))
        return Measured(status, unresolved, np.zeros(cases, int), rows(self.count), settled.state, checks)

    def __call__(self, plan: Plan, part: Part, settled: _Settled) -> Measured:
        steps, epoch = part.steps, float(plan.periods)
        measure = Measure(plan.solver, part.scenes, settled.state, epoch, self.blocks, steps, part.on_progress)
        local = measure(steps, self.count)
        states = jax.tree.map(np.asarray, local.state)
        everyone, rows = np.arange(len(settled.status)), rows_of(states)
        end = epoch + measure.periods
        maps = Maps(part.scenes, states, steps, plan.solver, 0 * everyone, part.on_progress, end)
        status = first_problem(settled.status, local.status)
        status = np.asarray(first_problem(status, maps.look(everyone, rows, plan.capacity(steps))))
        strobe = np.where((status == Status.FINITE)[:, None, None], local.strobe, np.nan)
        motion = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
        checks = None
        if self.certify:
            half = measure(2 * steps, 1)
            floquet, periodic = np.full(len(rows), np.nan), np.flatnonzero(motion.period)
            matrices = maps._replace(periods=motion.period).jacobians(periodic, rows[periodic])
            floquet[periodic] = [largest_exponent(of_case, len(of_case)) for of_case in matrices]
            checks = Checks(half.history, half.status, floquet)
        kind = np.array([KINDS.index(name) for name in motion.kind])
        return Measured(status, kind, motion.period, local.history, states, checks)


def _put_orbits(measured: Measured, by_orbit: np.ndarray, reached: Reached) -> None:
    """Fills in the cases that have reached an orbit."""
    measured.status[by_orbit] = Status.FINITE
    measured.kind[by_orbit] = KINDS.index("period")
    measured.period[by_orbit] = reached.period[by_orbit]
    measured.history[by_orbit] = reached.exponents[by_orbit, None]
    if measured.checks is not None:
        measured.checks.half_step[by_orbit] = reached.half_step[by_orbit, None, None]
        measured.checks.half_step_status[by_orbit] = Status.FINITE
        measured.checks.floquet[by_orbit] = reached.exponents[by_orbit, 0]
