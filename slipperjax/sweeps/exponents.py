"""Lyapunov exponents of a whole grid as one batch, with a certificate for each case.

Cases run in up to three stages, each with chunks of its own: all pass the transient, after which periodic ones take
the exponents of their orbits; those of the others are measured; chaotic ones run for longer.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Int

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
from .executors import Runs, records_in_order, run_chunk, run_chunks
from .exponent_data import Checks, Measured, Voted, exponent_data
from .grid import Cases, refuse_run
from .maps import Maps, rows_of
from .plan import PAUSE, Chunk, OnProgress, Plan, make_plan, strobe_plan
from .progress import Later
from .reached import Reached, nothing_reached, reached_orbits
from .records import BLOCK, JACOBIAN, LAST, LOOK, PAIR, Measure, measured_periods, tangents_cost
from .stores.stored import storable
from .stores.target import Store
from .sweep import case_attributes
from .transience import take_votes, work_of_votes

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
    costs about twice as much again, and six times as much for chaotic cases; `orbits`: whether exponents are taken
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
      `half_step_stderr`; `two_trajectories`, an estimate without tangents, and `two_trajectories_stderr`, NaN where
      exponents are those of an orbit;
      `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all that applies agrees;
      `escapes`, how many of `MOTIONS` motions of a chaotic case became regular within `HOLD` periods more, and
      `chaotic_for`, the forcing periods for which none did.

    A case is `resolved` where its status is 0, the two other estimates lie within three standard errors of their
    difference or 1e-3, the exponents of both halves of the record within three of theirs or 1e-2, and the weighted
    exponent of a periodic motion is that of its multiplier within 1e-3. A case on an orbit is resolved where the
    exponent of the orbit with steps half as long, which must be found and stable, too, differs by 1e-2 at most.

    A case takes the exponents of an orbit only where that is certain, see `slipperjax.sweeps.reached`: all others,
    with unstable, distant or missing orbits, forcings that do not recur, or anything wrong, are measured.

    The exponents of a certified chaotic case, and their standard errors, are those of its `MOTIONS` longer motions,
    see `slipperjax.analysis.pooled_standard_error`. Where some became regular, it is "transient chaos", with the
    exponents of the chaotic stretch.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C. Chaotic cases whose
    longer motions were not finished then have the exponents that were measured, and `Status.NOT_RUN`.
    """
    start = first_of(start)
    cases = Cases(scene, grid, start, product=product)
    options: dict[str, Any] = dict(steps_per_period=steps_per_period, solver=solver)
    plan = make_plan(scene, cases, transient=0, periods=1, **options)
    plan = strobe_plan(plan, whole("transient", transient, BLOCK))
    count, counted = check_count(scene, count), -(-whole("periods", periods, 1) // BLOCK)
    settle = _Settle(plan, cases, count, certify, yes_or_no("orbits", orbits))
    measure = _Measurement(plan, cases, count, counted, certify)
    values = plan.values + measured_periods(counted) * (count + 2)
    refuse_run(cases.count, settle.work + measure.work, values, float(plan.steps.sum()))
    found, reached, runs = _stages(settle, measure, chunk, workers, progress)
    votes = None
    if certify and not runs.interrupted:
        exponent, error = found.history.mean(axis=1)[:, 0], standard_error(found.history)[:, 0]
        chosen = np.flatnonzero(is_chaotic(exponent, error) & (found.status == Status.FINITE))
        if len(chosen):
            states = jax.tree.map(lambda a: a[chosen], found.state)
            epoch = plan.periods + measured_periods(counted)
            run = (counted, count, chunk, workers, progress)
            votes, unfinished = _votes(chosen, lambda: take_votes(plan, cases, chosen, states, epoch, *run))
            if unfinished is not None:
                found.status[unfinished] = Status.NOT_RUN
                runs = runs._replace(finished=runs.finished - len(unfinished), interrupted=True)
    call = dict(
        function="lyapunov_sweep",
        count=count,
        product=product,
        transient=transient,
        periods=periods,
        certify=certify,
        orbits=orbits,
    )
    attrs = case_attributes(plan, cases, call) | {"transient": plan.periods, "periods": counted * BLOCK}
    return runs.checked(exponent_data(cases, plan, found, reached, votes, attrs))


class _Settled(NamedTuple):
    """Cases after the transient."""

    status: Int[np.ndarray, " cases"]
    state: State
    reached: Reached


class _Settle(NamedTuple):
    """Runs the transient of a chunk, and looks for the orbits that its cases have reached."""

    plan: Plan
    cases: Cases
    count: int
    certify: bool
    orbits: bool

    @property
    def work(self) -> float:
        """What it costs, in plain forcing periods: an orbit of period 1, as most are."""
        search = SEARCH * JACOBIAN * (3 if self.certify else 1) + LOOK * PAUSE
        return self.plan.work + (search if self.orbits else 0.0)

    def __call__(self, chunk: Chunk, on_progress: OnProgress) -> _Settled:
        plan, (scenes, starts) = self.plan, self.cases.take(chunk.index)
        begin = initial_states(scenes, starts)
        passed = run_chunk(plan, scenes, begin, chunk.steps, on_progress)
        states, status = jax.tree.map(np.asarray, passed.state), np.asarray(passed.status)
        if not self.orbits:
            return _Settled(status, states, nothing_reached(states, self.count))
        wanted = (status == Status.FINITE) & (np.arange(len(status)) < chunk.cases)
        found = reached_orbits(
            scenes,
            states,
            passed.record[0][:, -LAST:],
            chunk.steps,
            solver=plan.solver,
            count=self.count,
            half_step=self.certify,
            wanted=wanted,
            on_progress=on_progress,
        )
        some = np.flatnonzero(found.period)
        maps = Maps(scenes, states, chunk.steps, plan.solver, found.period, on_progress, float(plan.periods))
        if len(some):
            looked = maps.look(some, rows_of(found.state)[some], plan.room(chunk.steps))
            # what is wrong with a case is said by its measurement
            found.period[some[looked != Status.FINITE]] = 0
        return _Settled(status, states, found)


class _Measurement(NamedTuple):
    """Measures the exponents of cases after the transient."""

    plan: Plan
    cases: Cases
    count: int
    blocks: int
    certify: bool

    @property
    def work(self) -> float:
        """What it costs, in plain forcing periods."""
        checks = 2 * tangents_cost(1) + PAIR if self.certify else 0.0
        return (tangents_cost(self.count) + checks) * measured_periods(self.blocks) + LOOK * PAUSE

    def blank(self, settled: _Settled) -> Measured:
        """Of cases that were not measured."""
        cases, periods = len(settled.status), BLOCK * self.blocks
        rows = lambda count: np.full((cases, periods, count), np.nan)
        no = np.full(cases, int(Status.NOT_RUN))
        checks = Checks(rows(1), no.copy(), rows(1), no.copy(), np.full(cases, np.nan)) if self.certify else None
        unresolved = np.full(cases, KINDS.index("unresolved"))
        return Measured(no, unresolved, np.zeros(cases, int), rows(self.count), settled.state, checks)

    def __call__(self, scenes: Any, settled: _Settled, steps: int, on_progress: OnProgress) -> Measured:
        plan, epoch = self.plan, float(self.plan.periods)
        measure = Measure(plan, scenes, settled.state, epoch, self.blocks, steps, on_progress)
        plain = measure(steps, self.count)
        states = jax.tree.map(np.asarray, plain.state)
        everyone, rows = np.arange(len(settled.status)), rows_of(states)
        maps = Maps(scenes, states, steps, plan.solver, 0 * everyone, on_progress, epoch + measure.periods)
        status = first_problem(settled.status, plain.status)
        status = np.asarray(first_problem(status, maps.look(everyone, rows, plan.room(steps))))
        strobe = np.where((status == Status.FINITE)[:, None, None], plain.strobe, np.nan)
        motion = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
        checks = None
        if self.certify:
            half, pair = measure(2 * steps, 1), measure(steps, 1, 1e-7)
            floquet, periodic = np.full(len(rows), np.nan), np.flatnonzero(motion.period)
            matrices = maps._replace(periods=motion.period).jacobians(periodic, rows[periodic])
            floquet[periodic] = [largest_exponent(of_case, len(of_case)) for of_case in matrices]
            checks = Checks(half.history, half.status, pair.history, pair.status, floquet)
        kind = np.array([KINDS.index(name) for name in motion.kind])
        return Measured(status, kind, motion.period, plain.history, states, checks)


def _stages(
    settle: _Settle, measure: _Measurement, chunk: int | None, workers: int | None, progress: bool
) -> tuple[Measured, np.ndarray, Runs]:
    """The transient and the measurement of what has not reached an orbit; which cases have, and the last run."""
    plan, cases = settle.plan, settle.cases
    chunks, threads = plan.chunks(chunk, workers, tangents=True)
    each = sum(part.cost for part in chunks)
    later = Later(
        each * (measure.work + (work_of_votes(measure.blocks, measure.count) if measure.certify else 0)),
        "for cases without a stable orbit",
    )
    runs = run_chunks(chunks, threads, settle, periods=settle.work, progress=progress, name="transient", later=later)
    settled = records_in_order(chunks, runs.results)
    found, by_orbit = measure.blank(settled), settled.reached.period > 0
    _put_orbits(found, by_orbit, settled.reached)
    rest = np.flatnonzero(~by_orbit)
    finished = int(by_orbit.sum())
    if len(rest) and not runs.interrupted:
        chunks, threads = dataclasses.replace(plan, steps=plan.steps[rest]).chunks(chunk, workers, tangents=True)

        def work(part: Chunk, on_progress: OnProgress) -> Measured:
            index = rest[part.index]
            of_chunk = jax.tree.map(lambda a: a[index], settled)
            return measure(cases.take(index)[0], of_chunk, part.steps, on_progress)

        later = Later(
            sum(part.cost for part in chunks) * work_of_votes(measure.blocks, measure.count), "for chaotic cases"
        )
        options: dict[str, Any] = dict(progress=progress, name=f"exponents of {len(rest)} cases")
        options |= dict(later=later if measure.certify else None)
        try:
            runs = run_chunks(chunks, threads, work, periods=measure.work, **options)
        except Interrupted:
            runs = Runs([], 0, len(rest), True)
        else:
            for part, of_all in zip(
                jax.tree.leaves(records_in_order(chunks, runs.results)), jax.tree.leaves(found), strict=True
            ):
                of_all[rest] = part
        finished += runs.finished
    runs = runs._replace(finished=finished, cases=cases.count)
    if runs.interrupted and not finished:
        raise Interrupted(None, 0, cases.count)
    return found, by_orbit, runs


def _put_orbits(found: Measured, by_orbit: np.ndarray, reached: Reached) -> None:
    """Fills in what is known of the cases that have reached an orbit."""
    found.status[by_orbit] = Status.FINITE
    found.kind[by_orbit] = KINDS.index("period")
    found.period[by_orbit] = reached.period[by_orbit]
    found.history[by_orbit] = reached.exponents[by_orbit, None]
    if found.checks is not None:
        found.checks.half_step[by_orbit] = reached.half_step[by_orbit, None, None]
        found.checks.half_step_status[by_orbit] = found.checks.two_trajectories_status[by_orbit] = Status.FINITE
        found.checks.floquet[by_orbit] = reached.exponents[by_orbit, 0]


def _votes(chosen: np.ndarray, take: Callable) -> tuple[Voted | None, np.ndarray | None]:
    """The votes of the chosen cases, and which cases have none because of an interrupt; None without one."""
    try:
        votes, interrupted = take()
    except Interrupted:
        return None, chosen
    if not interrupted:
        return Voted(chosen, votes), None
    done = votes.status != Status.NOT_RUN
    return Voted(chosen[done], jax.tree.map(lambda a: a[done], votes)), chosen[~done]
