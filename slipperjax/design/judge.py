"""Judging designs: objectives and their derivatives on the motion that each case settles to, as one batch.

A case whose motion is a stable periodic orbit is judged on the orbit, by exact derivatives; any other motion that
stays on the rail by an ensemble.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np
import scipy.linalg

from ..analysis.attractor import classify
from ..analysis.kinds import Regime
from ..flow.period_map import initial_states
from ..flow.simulate import dynamic_steps
from ..flow.status import Status
from ..model.quantities import COORDINATE_SCALES, MOTION_NUMBERS
from ..model.scene import Scene
from ..orbits.periodic import TOLERANCE
from ..solvers.latching import calls_lapack
from ..sweeps.attractors import FLOOR, LAST
from ..sweeps.call import Call
from ..sweeps.grid import VECTOR_LANES, Cases, Grid, filled
from ..sweeps.orbits import Maps, find_orbits, rows_of
from ..sweeps.plan import Chunk, OnProgress, Part, Plan, make_plan
from ..sweeps.reached import reached_orbits
from ..sweeps.run import run_chunk, run_chunks
from ..tools.batching import Batched
from ..tools.compile import ahead
from ..tools.limits import cores
from .averages import ensemble_averages
from .ensembles import RailEnsemble
from .gradients import PeriodDerivatives, matrix_slopes, push_period, total_slopes
from .objectives import Evaluation, EvaluationPlan

LANES_PER_CALL = VECTOR_LANES
"""Cases in each call, filled with copies: a search asks for many cases first and for few later on, and each number of
cases would need programs of its own."""
JACOBIAN = 35.0
"""Cost of a period with its Jacobian, in unrecorded ones: measured."""
SLOPES_COST = 8.0
"""Cost of a period with its derivatives by two parameters, in unrecorded periods: measured."""


def judge(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    warm_start: Evaluation | None = None,
) -> Evaluation:
    """Evaluate cases, on orbits or by ensembles. Arguments as for `judge_on_orbits`."""
    if isinstance(plan.ensemble, RailEnsemble):
        return ensemble_averages(plan, grid, at_starts(plan, grid))
    evaluation = judge_on_orbits(plan, grid, warm_start)
    # motions that are not periodic, but stay on the rail
    index = np.flatnonzero((evaluation.period == 0) & (evaluation.status == Status.FINITE))
    if len(index):
        of_cases = {name: values[index] for name, values in grid.items()}
        averages = ensemble_averages(plan, of_cases, evaluation.take(index))
        for array, rows in zip(evaluation, averages, strict=True):
            array[index] = rows
    return evaluation


def judge_on_orbits(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    warm_start: Evaluation | None = None,
) -> Evaluation:
    """Evaluate cases on the stable periodic orbits that they settle to; values of the others are NaN.

    **Arguments:** `grid`: values by name, one for each case; `warm_start`: an evaluation of the same cases with
    parameters near these. Its orbits are followed where they are still stable; elsewhere the motion settles anew
    from its states.
    """
    options = Call(0, 1, steps_per_period=plan.steps, solver=plan.solver)
    settling = make_plan(Grid(plan.scene, grid, product=False), plan.start, options)
    # fewer periods do not show whether an orbit was reached
    transient = settling.strobes(0, max(plan.transient, 20))
    cases = transient.cases
    # the last chunk is filled with copies
    chunks = []
    for first in range(0, cases.count, LANES_PER_CALL):
        index = np.arange(first, min(first + LANES_PER_CALL, cases.count))
        chunks.append(Chunk(filled(index, LANES_PER_CALL), len(index), settling.schedules[0]))

    def work(chunk: Chunk, on_progress: OnProgress) -> Evaluation:
        scenes, starts = cases.take(chunk.index)
        rows = rows_of(initial_states(scenes, starts, transient.epoch))
        batch = _Batch(plan, scenes, Evaluation.of_states(plan, rows), on_progress)
        if warm_start is not None:
            batch.follow(warm_start.take(chunk.index))
        elif chunk is chunks[0]:
            batch.compile_ahead()
        return batch.evaluated(transient)

    run = run_chunks(chunks, min(cores(), len(chunks)), work, periods=1, progress=False)
    return run.checked(lambda: run.results)


def at_starts(plan: EvaluationPlan, grid: Mapping[str, np.ndarray]) -> Evaluation:
    """Return an evaluation of cases at their starts, without values. Arguments as for `judge_on_orbits`."""
    cases = Cases(plan.scene, grid, plan.start, product=False)
    scenes, starts = cases.take(np.arange(cases.count))
    return Evaluation.of_states(plan, rows_of(initial_states(scenes, starts, plan.epoch)))


@dataclass
class _Batch:
    """Cases of a chunk while they are evaluated."""

    plan: EvaluationPlan
    scenes: Batched[Scene]
    cases: Evaluation
    on_progress: OnProgress

    def no_slopes(self) -> np.ndarray:
        """Return zero derivatives of the states, (lanes, parameters, size): starts that no parameter moves."""
        lanes, size = self.cases.state.shape
        return np.zeros((lanes, len(self.plan.names), size))

    def compile_ahead(self) -> None:
        """Compile the program of derivatives, the longest of all, while others are compiled and run."""
        # programs that call LAPACK must run one at a time, see `calls_lapack`
        if self.plan.names and not calls_lapack(self.plan.solver):
            state = self.cases.state.copy()
            ahead(functools.partial(self.push, state, self.no_slopes(), self.plan.epoch))

    def evaluated(self, transient: Plan) -> Evaluation:
        """Return the evaluation, on the orbits of the cases that have one."""
        cases = self.cases
        if not np.all(cases.period):
            self.settle(np.flatnonzero(cases.period == 0), transient)
        index = np.flatnonzero(cases.period)
        if len(index) and self.plan.names:
            self.differentiate(index)
        # on orbits there is no chance, and so no standard error
        cases.stderr[index] = 0.0
        cases.gradient_stderr[index] = 0.0
        return cases

    def maps(self, period: np.ndarray) -> Maps:
        """Return the maps over each case's `period`."""
        return Maps(self.scenes, self.plan.steps, self.plan.solver, period, self.on_progress)

    def find_orbits(
        self,
        period: np.ndarray,
        inverse: np.ndarray | None = None,
    ) -> None:
        """Find periodic orbits near the states, of cases whose `period` is not 0; the stable ones are their motions.

        **Arguments:** `inverse`: of I - P_x, from a warm start, whose orbits must be near the states.
        """
        cases = self.cases
        maps = self.maps(period)
        states = maps.states(cases.state)
        orbits = find_orbits(maps, states, tolerance=TOLERANCE, max_iterations=20, inverse=inverse)
        cases.simulated[:] += period * (orbits.iterations + JACOBIAN * orbits.jacobians)
        rows = rows_of(orbits.state)
        found = (period > 0) & (orbits.status == Status.FINITE) & orbits.stable
        if inverse is not None:
            weights = maps.weights(np.arange(len(rows)), rows)
            moved = np.abs(weights * (rows - cases.state))[:, : len(MOTION_NUMBERS)]
            # an orbit further away than one unit of the scales is another one
            found &= np.max(moved, axis=1) <= 1.0
        # the other cases keep what they had
        cases.period[found] = period[found]
        cases.kind[found] = Regime.PERIODIC
        cases.state[found] = rows[found]
        cases.inverse[found] = orbits.inverse[found]
        cases.multiplier[found] = np.abs(orbits.multipliers[found, 0])

    def follow(self, warm_start: Evaluation) -> None:
        """Follow the orbits of a warm start to these parameters."""
        # lost cases keep their start
        state = self.cases.state
        finite = np.all(np.isfinite(warm_start.state), axis=1)
        state[finite] = warm_start.state[finite]
        # gaps change with the parameters, and the contacts' memory must agree with them
        state[:] = self.maps(self.cases.period).settled(np.arange(len(state)), state, state)
        self.find_orbits(np.where(finite, warm_start.period, 0), warm_start.inverse)

    def settle(self, index: np.ndarray, transient: Plan) -> None:
        """Simulate cases until they have settled, and find the orbits that they have reached."""
        plan = self.plan
        cases = self.cases
        count = len(index)
        # a program of the batch's size, whatever the number of cases
        lanes = filled(index, min(LANES_PER_CALL, len(cases.state)))
        scenes = self.scenes.take(lanes)
        # rows of numbers become states again
        states = self.maps(cases.period).states(cases.state[lanes])
        part = Part(transient, scenes, states, lanes, lanes, count, transient.schedules[0], self.on_progress)
        run = run_chunk(part, states)
        strobe = run.record[0][:, -LAST:]
        ends = jax.tree.map(np.asarray, run.state)
        # only motions that stay on the rail can have reached an orbit
        good = (run.status == Status.FINITE).astype(int)
        maps = Maps(scenes, plan.steps, plan.solver, good, self.on_progress)
        reached = reached_orbits(maps, ends, strobe, count=1, half_step=False)
        of_jacobians = np.where(reached.period, JACOBIAN, 0)
        cases.simulated[index] += transient.periods + of_jacobians[:count]
        cases.state[index] = rows_of(reached.state)[:count]
        cases.status[index] = run.status[:count]
        # cases that were not simulated here are not searched
        period = np.zeros(len(cases.state), int)
        period[index] = reached.period[:count]
        if period.any():
            self.find_orbits(period)
        # the others are only classified
        others = np.flatnonzero(cases.period[index] == 0)
        if len(others):
            kinds = classify(strobe[others], scales=COORDINATE_SCALES, floor=FLOOR).kind
            # recurrence without a stable orbit is a contradiction
            kinds = np.where(kinds == "period", "unresolved", kinds)
            cases.kind[index[others]] = Regime.codes(kinds)

    def differentiate(self, index: np.ndarray) -> None:
        """Set objectives and their derivatives on the orbits of the cases at `index`."""
        cases = self.cases
        # P_p at the end of each case's own period, with the start held
        slopes = self.no_slopes()
        spans = self.pushed(slopes)
        for lane in index:
            slopes[lane] = spans[cases.period[lane] - 1].end_slopes[lane]
        # dx/dp = (I - P_x)^-1 P_p, along which the objectives are differentiated
        slopes = np.einsum("cij,ckj->cki", cases.inverse, slopes)
        spans = self.pushed(slopes)
        self.set_totals(index, spans)
        if self.plan.exponents:
            self.set_exponents(index, slopes, spans)
        cases.simulated[index] += 2 * SLOPES_COST * cases.period[index]

    def pushed(self, slopes: np.ndarray | jax.Array) -> list[PeriodDerivatives]:
        """Run all cases on from their states, for as many forcing periods as the longest `period`.

        **Arguments:** `slopes`: derivatives of the states at the start, (lanes, parameters, size).
        """
        rows = self.cases.state
        spans = []
        for epoch in self.plan.epoch + np.arange(float(self.cases.period.max())):
            span = self.push(rows, slopes, epoch)
            spans.append(span)
            rows = span.end
            slopes = span.end_slopes
            self.on_progress(SLOPES_COST)
        return spans

    def push(
        self,
        rows: np.ndarray,
        slopes: np.ndarray | jax.Array,
        epoch: float,
    ) -> PeriodDerivatives:
        """Run one forcing period from states and their derivatives."""
        plan = self.plan
        span = push_period(
            self.scenes,
            self.maps(self.cases.period).states(rows),
            slopes,
            float(epoch),
            dynamic_steps(plan.steps, most=plan.most_steps),
            names=plan.names,
            objectives=plan.of_courses,
            solver=plan.solver,
        )
        return jax.tree.map(np.asarray, span)

    def set_totals(
        self,
        index: np.ndarray,
        spans: Sequence[PeriodDerivatives],
    ) -> None:
        """Set objectives of the cases at `index` over their periods, and their derivatives, but no exponents."""
        plan = self.plan
        cases = self.cases
        stacked = lambda axis, parts: jax.tree.map(lambda *of: np.stack(of, axis), *parts)
        # a case counts over its own periods, which others may exceed
        for period in np.unique(cases.period[index]) if plan.courses else ():
            own = spans[:period]
            kept = stacked(1, [span.kept for span in own])
            slopes = stacked(2, [span.kept_slopes for span in own])
            value, gradient = total_slopes(plan.of_courses, kept, slopes)
            lanes = index[cases.period[index] == period]
            cases.value[lanes[:, None], plan.courses] = value[lanes]
            cases.gradient[lanes[:, None], plan.courses] = gradient[lanes]

    def set_exponents(
        self,
        index: np.ndarray,
        slopes: np.ndarray | jax.Array,
        spans: Sequence[PeriodDerivatives],
    ) -> None:
        """Set ln |largest multiplier| per period on the orbits of the cases at `index`, and its derivatives.

        **Arguments:** `slopes`: derivatives of the states at the start; `spans`: the periods from there on.
        """
        plan = self.plan
        cases = self.cases
        maps = self.maps(cases.period)
        changes = []
        rows = cases.state
        # from states and derivatives at the beginning of each period
        for epoch, span in enumerate(spans):
            change = matrix_slopes(
                self.scenes,
                maps.states(rows),
                slopes,
                float(epoch),
                dynamic_steps(plan.steps),
                names=plan.names,
                solver=plan.solver,
            )
            changes.append(np.asarray(change))
            rows = span.end
            slopes = span.end_slopes
        # each Jacobian once for its value, and about twice more for each derivative
        cost = (1 + 2 * len(plan.names)) * JACOBIAN
        cases.simulated[index] += cost * cases.period[index]
        jacobians = maps.jacobians(index, cases.state[index])
        for lane, matrices in zip(index, jacobians, strict=True):
            of_case = np.stack([change[lane] for change in changes[: cases.period[lane]]])
            value, gradient = _exponent(matrices, of_case)
            cases.value[lane, plan.exponents] = value
            cases.gradient[lane, plan.exponents] = gradient


def _exponent(matrices: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
    """Return ln |largest multiplier| per period of successive Jacobians (periods, size, size), and its derivatives.

    **Arguments:** `slopes`: derivatives of the Jacobians (periods, parameters, size, size).
    """
    count, size = matrices.shape[:2]
    # the product of the Jacobians and its derivatives, period by period
    product = np.eye(size)
    change = np.zeros((slopes.shape[1], size, size))
    for matrix, slope in zip(matrices, slopes, strict=True):
        change = matrix @ change + slope @ product
        product = matrix @ product
    mu, left, right = scipy.linalg.eig(product, left=True, right=True)  # pyright: ignore[reportAssignmentType]
    # the derivative of an eigenvalue, by its left and right eigenvectors
    k = int(np.argmax(np.abs(mu)))
    w = left[:, k].conj()
    v = right[:, k]
    mu_slope = np.einsum("i,pij,j->p", w, change, v) / (w @ v)
    return float(np.log(np.abs(mu[k])) / count), np.real(mu_slope / mu[k]) / count
