"""Lyapunov exponents of many cases as a record that runs on, with a certificate for each case.

After the recorded periods, periodic cases take the exponents of their orbits; the others are measured; chaotic ones
run for longer. Each stage has chunks of its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from ..analysis.attractor import classify
from ..analysis.floquet import largest_exponent
from ..analysis.kinds import Regime
from ..analysis.lyapunov import is_chaotic, standard_error
from ..flow.record import Labelled
from ..flow.status import Status, first_problem
from ..model.dynamics import State
from ..model.layout import coordinates
from ..model.quantities import COORDINATE_SCALES
from ..orbits.exponents import check_count
from ..tools.checks import whole, yes_or_no
from .attractors import FLOOR
from .certificate import CaseExponents, Checks, exponent_variables, labels_of
from .maps import JACOBIAN, LOOK, Maps, rows_of
from .measure import BLOCK, LAST, Measure, measured_periods, tangents_cost
from .reached import ReachedOrbits, nothing_reached, reached_orbits
from .run import PERIODS_PER_CALL, ChunkInputs, ContinuedRecord, Plan, RecordedChunk, run_cases
from .transience import run_longer_motions

SEARCH = 4
"""Jacobians that the search for an orbit takes, about; as many again with steps half as long."""
LEAST_MEASURED = 8
"""Periods without which an exponent has no standard error, see `slipperjax.analysis.standard_error`."""


class CasesAfterRecord(NamedTuple):
    """Cases after the recorded periods."""

    status: Int[np.ndarray, " cases"]
    state: State
    reached: ReachedOrbits


@dataclass(frozen=True)
class LyapunovExponents(ContinuedRecord):
    """The largest Lyapunov exponents of each case, each with its certificate, see `slipperjax.lyapunov_sweep`.

    They are those of the orbit that a case has reached, or measured after the recorded periods.
    """

    count: int = 1
    """How many, the largest first."""
    periods: int | None = None
    """Forcing periods over which they are measured, rounded up to multiples of `BLOCK`; None for as many as are
    recorded."""
    certify: bool = True
    """Whether each case is checked."""
    orbits: bool = True
    """Whether exponents are taken from orbits; without it all are measured."""

    def __post_init__(self):
        whole("count", self.count, 1)
        if self.periods is not None:
            whole("periods", self.periods, 1)
        yes_or_no("certify", self.certify)
        yes_or_no("orbits", self.orbits)

    @property
    def name(self):
        return "exponents"

    @property
    def variables(self):
        return tuple(labels_of(self.count, self.certify))

    @property
    def continues(self):
        return True

    def last(self, periods):
        return min(LAST, periods)

    def values(self, periods):
        return 10 * self.last(periods) + measured_periods(self.blocks(periods)) * (self.count + self.certify)

    def blocks(self, periods: int) -> int:
        """Blocks of `BLOCK` periods that count."""
        return -(-(periods if self.periods is None else self.periods) // BLOCK)

    def check(self, scene, periods, steps):
        check_count(scene, self.count)
        whole("periods", periods, BLOCK)

    def sample(self, course):
        return course.end.motion

    def cost_after(self, periods):
        search = SEARCH * JACOBIAN * (3 if self.certify else 1) + LOOK * PERIODS_PER_CALL
        return search if self.orbits else 0.0

    def cost_continuing(self, periods):
        half_step = 2 * tangents_cost(1) if self.certify else 0.0
        measured = (tangents_cost(self.count) + half_step) * measured_periods(self.blocks(periods))
        return measured + LOOK * PERIODS_PER_CALL

    def after(self, carried, samples, status, run: RecordedChunk):
        """Looks for the orbits that cases have reached."""
        states, plan, scenes, steps = jax.tree.map(np.asarray, run.states), run.plan, run.scenes, run.steps
        if not self.orbits:
            return CasesAfterRecord(status, states, nothing_reached(states, self.count)), status
        reached = reached_orbits(
            scenes,
            states,
            coordinates(State(samples, None)),
            steps,
            solver=plan.solver,
            count=self.count,
            half_step=self.certify,
            wanted=run.good(status),
            on_progress=run.on_progress,
        )
        periodic = np.flatnonzero(reached.period)
        if len(periodic):
            maps = Maps(scenes, steps, plan.solver, reached.period, run.on_progress, run.epoch)
            codes = maps.look(periodic, rows_of(reached.state)[periodic], plan.capacity(steps))
            # the measurement says what is wrong with a case
            reached.period[periodic[codes != Status.FINITE]] = 0
        return CasesAfterRecord(status, states, reached), status

    def finish(self, carried, samples, span) -> CasesAfterRecord:
        return carried

    def continue_cases(self, values: CasesAfterRecord, status, plan: Plan, options: Mapping[str, Any], interrupted):
        """Measures the cases that have not reached an orbit; with `certify`, runs chaotic ones for longer."""
        no_orbit = status == Status.NO_ORBIT  # the orbit's record found none; the motion itself may be good
        values = values._replace(status=np.where(no_orbit, int(Status.FINITE), status))
        by_orbit = (values.reached.period > 0) & (values.status == Status.FINITE)
        blocks, longer = self.blocks(plan.recorded.periods), None
        measured = self._of_orbits(values, by_orbit, BLOCK * blocks)
        index = np.flatnonzero(~by_orbit)
        if len(index) and not interrupted:
            interrupted = self._put_measured(measured, index, plan, values, options)
        if self.certify and not interrupted:
            exponent, error = measured.history.mean(axis=1)[:, 0], standard_error(measured.history)[:, 0]
            chosen = np.flatnonzero(is_chaotic(exponent, error) & (measured.status == Status.FINITE))
            if len(chosen):
                epoch = plan.periods + measured_periods(blocks)
                longer, interrupted = run_longer_motions(
                    plan, chosen, measured.state, epoch, blocks, self.count, options
                )
                unfinished = longer.status == Status.NOT_RUN
                measured.status[chosen[unfinished]] = Status.NOT_RUN
                longer = longer.of(np.flatnonzero(~unfinished))
        good = measured.status == Status.FINITE
        status = np.where(good & no_orbit, int(Status.NO_ORBIT), measured.status)
        return exponent_variables(plan.periods, measured, by_orbit, longer), status, interrupted

    def _put_measured(
        self,
        measured: CaseExponents,
        index: np.ndarray,
        plan: Plan,
        settled: CasesAfterRecord,
        options: Mapping[str, Any],
    ) -> bool:
        """Measures the cases at `index`, and fills them in; gives whether the run was interrupted."""
        work = lambda part: self._measure(plan, part, jax.tree.map(lambda a: a[part.index], settled))
        name = f"exponents of {len(index)} cases"
        cost = self.cost_continuing(plan.recorded.periods)
        run = run_cases(plan, work, cost=cost, index=index, tangents=True, name=name, **options)
        if run.results is not None:
            for of_all, of_index in zip(jax.tree.leaves(measured), jax.tree.leaves(run.results), strict=True):
                of_all[index] = of_index
        return run.interrupted

    def _of_orbits(self, settled: CasesAfterRecord, by_orbit: np.ndarray, periods: int) -> CaseExponents:
        """Exponents of the cases that have reached an orbit; the others are not measured yet."""
        exponents, half_step = (
            np.where(by_orbit[:, None], rows.reshape(len(by_orbit), -1), np.nan)
            for rows in (settled.reached.exponents, settled.reached.half_step)
        )
        alike = lambda rows: np.repeat(rows[:, None], periods, axis=1)
        status = np.where(by_orbit, int(Status.FINITE), int(Status.NOT_RUN))
        checks = Checks(alike(half_step), status.copy(), exponents[:, 0].copy()) if self.certify else None
        kind = np.where(by_orbit, int(Regime.PERIODIC), int(Regime.UNRESOLVED))
        period = np.where(by_orbit, settled.reached.period, 0)
        return CaseExponents(status, kind, period, alike(exponents), settled.state, checks)

    def _measure(self, plan: Plan, part: ChunkInputs, settled: CasesAfterRecord) -> CaseExponents:
        """Measures a chunk of cases after the recorded periods."""
        steps, epoch, blocks = part.steps, float(plan.periods), self.blocks(plan.recorded.periods)
        measure = Measure(plan.solver, part.scenes, settled.state, epoch, blocks, steps, part.on_progress)
        local = measure(steps, self.count)
        states = jax.tree.map(np.asarray, local.state)
        everyone, rows = np.arange(len(settled.status)), rows_of(states)
        end = epoch + measure.periods
        maps = Maps(part.scenes, steps, plan.solver, 0 * everyone, part.on_progress, end)
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
        return CaseExponents(status, Regime.codes(motion.kind), motion.period, local.history, states, checks)

    def label(self, scene, dims, values: dict[str, np.ndarray]) -> Labelled:
        data = {}
        for name, (over, unit, text) in labels_of(self.count, self.certify).items():
            label = {"units": unit, "long_name": text} if unit else {"long_name": text}
            data[name] = ((*dims, *over), values[name], label)
        return data, {}
