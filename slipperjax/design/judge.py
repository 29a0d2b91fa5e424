"""Judging designs: objectives and their derivatives on the motion that each case settles to, as one batch.

A case whose motion is a stable periodic orbit is judged on the orbit, by exact derivatives.

Any other motion that stays on the rail is judged by an ensemble. In chaos the derivative of one motion grows without
bound, while an average over the attractor may change smoothly with a parameter. Many runs with parameters at the
corners of a small box, and disturbed starts, are one batch; each gives the objective over its periods, and a plane
through them gives the average and its derivatives with standard errors. All corners have the same disturbances.
"""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from ..analysis.attractor import classify
from ..analysis.kinds import Regime
from ..flow.period_map import initial_states, states_and_penetrations
from ..flow.record import RecordSet
from ..flow.simulate import dynamic_steps
from ..flow.status import Status
from ..model.dynamics import State, initial_state
from ..model.kinematics import MOTION_SCALES
from ..model.quantities import COORDINATE_SCALES, MOTION_NUMBERS
from ..model.scene import Scene
from ..orbits.periodic import TOLERANCE
from ..solvers.latching import calls_lapack
from ..sweeps.attractors import FLOOR, LAST
from ..sweeps.grid import VECTOR_LANES, Cases, Grid, filled
from ..sweeps.orbits import JACOBIAN, Maps, Orbits, find_orbits, rows_of
from ..sweeps.reached import reached_orbits
from ..sweeps.run import Chunk, ChunkInputs, OnProgress, Plan, RunOptions, make_plan, run_cases, run_chunk, run_chunks
from ..tools.batching import Batched
from ..tools.compile import ahead
from ..tools.limits import cores
from .gradients import PeriodDerivatives, PeriodValues, matrix_slopes, push_period, total_slopes, totals
from .objectives import Evaluation, EvaluationPlan, RailEnsemble

LANES_PER_CALL = VECTOR_LANES
"""Cases in one call, however many there are: a search asks for many cases first and for few later on, of which each
number would be programs of its own."""
SLOPES_COST = 8.0
"""Cost of a period with its derivatives by two parameters, in unrecorded periods: measured."""
SAME_ORBIT = 1.0
"""Greatest distance of an orbit from a neighbour's to be its continuation, in multiples of the scales."""
SHORTEST_TRANSIENT = 20
"""Fewest forcing periods from which it can be told that an orbit was reached."""
NEWTON_ITERATIONS = 20
"""Most iterations of Newton's method."""
LARGEST_GROWTH = 1e4
"""Growth of a run's derivatives, over that of the first period, from which on they say nothing of averages."""
DISTURBANCE = 0.1
"""Standard deviation of the disturbances of the starts' velocities, in multiples of
`slipperjax.model.MOTION_SCALES`. Displacements are left as they are: they could lie outside the play."""


def judge(plan: EvaluationPlan, grid: Mapping[str, Any], warm_start: Evaluation | None = None) -> Evaluation:
    """Evaluates cases, on orbits or by ensembles. Arguments as for `judge_on_orbits`."""
    if isinstance(plan.ensemble, RailEnsemble):
        return ensemble_averages(plan, grid, at_starts(plan, grid))
    evaluation = judge_on_orbits(plan, grid, warm_start)
    index = np.flatnonzero((evaluation.period == 0) & (evaluation.status == Status.FINITE))
    if len(index):
        of_cases = {name: np.asarray(values)[index] for name, values in grid.items()}
        averages = ensemble_averages(plan, of_cases, evaluation.take(index))
        for array, rows in zip(evaluation, averages, strict=True):
            array[index] = rows
    return evaluation


def judge_on_orbits(
    plan: EvaluationPlan, grid: Mapping[str, Any], warm_start: Evaluation | None = None
) -> Evaluation:
    """Evaluates cases on the stable periodic orbits that they settle to; values of the others are NaN.

    **Arguments:** `grid`: values by name, one for each case; `warm_start`: an evaluation of the same cases with
    parameters near these. Its orbits are followed where they are still stable; elsewhere the motion settles anew
    from its states.
    """
    options = RunOptions(0, 1, plan.steps, None, plan.solver)
    transient = make_plan(Grid(plan.scene, grid, product=False), plan.start, options)
    transient, cases = transient.strobes(max(plan.transient, SHORTEST_TRANSIENT)), transient.cases
    parts = np.split(np.arange(cases.count), range(LANES_PER_CALL, cases.count, LANES_PER_CALL))
    chunks = [Chunk(filled(index, LANES_PER_CALL), len(index), plan.steps) for index in parts]

    def work(chunk: Chunk, on_progress: OnProgress) -> Evaluation:
        scenes, starts = cases.take(chunk.index)
        batch = _Batch(plan, scenes, initial_states(scenes, starts, transient.epoch), on_progress)
        if warm_start is None and chunk is chunks[0]:
            batch.compile_ahead()
        return batch.evaluated(transient, None if warm_start is None else warm_start.take(chunk.index))

    cost = (transient.cost if warm_start is None else 0) + 2 * JACOBIAN + 2 * SLOPES_COST
    run = run_chunks(chunks, min(cores(), len(chunks)), work, cost=cost, progress=False)
    return run.checked(lambda: run.results)


def at_starts(plan: EvaluationPlan, grid: Mapping[str, Any]) -> Evaluation:
    """Returns an evaluation of cases at their starts, without values. Arguments as for `judge_on_orbits`."""
    cases = Cases(plan.scene, grid, plan.start, product=False)
    return Evaluation.of_states(plan, rows_of(initial_states(*cases.take(np.arange(cases.count)), plan.epoch)))


def judge_run(plan: EvaluationPlan, periods: int) -> tuple[Evaluation, float]:
    """Evaluates the plan's scene along a run of some forcing periods from the start, by forward mode.

    **Returns:** the evaluation, and the growth of the derivatives from the first period to the last [1].

    **Raises:** `ValueError` where they grow by `LARGEST_GROWTH` or more.
    """
    states = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], initial_state(plan.scene, plan.start))
    batch, index = _Batch(plan, Batched(None, plan.scene), states, lambda _: None), np.zeros(1, int)
    run, spans, sizes, scales = batch.cases, [], [], np.array(jax.tree.leaves(MOTION_SCALES))
    run.period[:], run.simulated[:], run.stderr[:], run.gradient_stderr[:] = periods, periods * SLOPES_COST, 0.0, 0.0
    for span in batch.pushed(index, np.zeros((1, len(plan.names), run.state.shape[1]))):
        spans.append(span)
        sizes.append(np.max(np.abs(span.end_slopes[0, :, : len(scales)] / scales), axis=1))
        growth = float(np.max(sizes[-1] / np.maximum(sizes[0], 1e-300)))
        if not growth < LARGEST_GROWTH:
            raise ValueError(
                f"Argument `periods` must be fewer here, but is {periods}: after {len(spans)} the derivatives along "
                f"the run have grown {growth:.1g}-fold, and say nothing of averages; method='ensemble' does."
            )
    value, gradient = batch.totals(index, spans)
    return run._replace(period=np.zeros(1, int), state=spans[-1].end, value=value, gradient=gradient), growth


class _Batch:
    """Cases of a chunk while they are evaluated."""

    def __init__(self, plan: EvaluationPlan, scenes: Batched[Scene], states: State, on_progress: OnProgress):
        self.plan, self.scenes, self.on_progress = plan, scenes, on_progress
        self.cases = Evaluation.of_states(plan, rows_of(states))
        self.count = len(self.cases.status)

    def compile_ahead(self) -> None:
        """Compiles the program of derivatives, the longest of all, while others are compiled and run."""
        plan, state = self.plan, self.cases.state
        if plan.names and not calls_lapack(plan.solver):
            slopes = np.zeros((self.count, len(plan.names), state.shape[1]))
            ahead(functools.partial(self._pushed, np.arange(1), state.copy(), slopes, plan.epoch))

    def evaluated(self, transient: Plan, warm_start: Evaluation | None) -> Evaluation:
        """Returns the evaluation, on the orbits of the cases that have one."""
        cases = self.cases
        if warm_start is not None:
            self._follow(warm_start)
        if not np.all(cases.period):
            self._settle(np.flatnonzero(cases.period == 0), transient)
        index = np.flatnonzero(cases.period)
        if len(index) and self.plan.names:
            cases.value[index], cases.gradient[index] = self._on_orbits(index)
        cases.stderr[index], cases.gradient_stderr[index] = 0.0, 0.0
        return cases

    def _maps(self, period: np.ndarray) -> Maps:
        return Maps(self.scenes, self.plan.steps, self.plan.solver, period, self.on_progress)

    def _orbits(self, period: np.ndarray, inverse: np.ndarray | None = None) -> Orbits:
        """Finds periodic orbits near the states, of cases whose `period` is not 0."""
        options: dict[str, Any] = dict(tolerance=TOLERANCE, max_iterations=NEWTON_ITERATIONS, inverse=inverse)
        maps = self._maps(period)
        orbits = find_orbits(maps, maps.states(self.cases.state), **options)
        self.cases.simulated[:] += period * (orbits.iterations + JACOBIAN * orbits.jacobians)
        return orbits

    def _adopt(self, orbits: Orbits, period: np.ndarray) -> None:
        """Takes the stable ones of the orbits of cases whose `period` is not 0 as their motions."""
        cases, stable = self.cases, (period > 0) & (orbits.status == Status.FINITE) & orbits.stable
        cases.period[stable], cases.kind[stable] = period[stable], Regime.PERIODIC
        cases.state[stable], cases.inverse[stable] = rows_of(orbits.state)[stable], orbits.inverse[stable]
        cases.multiplier[stable] = np.abs(orbits.multipliers[stable, 0])

    def _follow(self, warm_start: Evaluation) -> None:
        """Follows the orbits of a warm start to these parameters."""
        state, every = self.cases.state, np.arange(self.count)
        finite = np.all(np.isfinite(warm_start.state), axis=1)
        state[finite] = warm_start.state[finite]
        # gaps change with the parameters, so that the contacts' memory must be made to agree with them
        state[:] = self._maps(self.cases.period).settled(every, state, state)
        period = np.where(finite, warm_start.period, 0)
        orbits = self._orbits(period, warm_start.inverse)
        rows = rows_of(orbits.state)
        weights = self._maps(period).weights(every, rows)[:, : len(MOTION_NUMBERS)]
        near = np.max(np.abs(weights * (rows - state)[:, : len(MOTION_NUMBERS)]), axis=1) <= SAME_ORBIT
        self._adopt(orbits, np.where(near, period, 0))

    def _settle(self, index: np.ndarray, transient: Plan) -> None:
        """Simulates cases until they have settled, and finds the orbits that they have reached."""
        plan, cases, count = self.plan, self.cases, len(index)
        lanes = filled(index, min(LANES_PER_CALL, self.count))
        scenes, states = self.scenes.take(lanes), self._maps(cases.period).states(cases.state[lanes])
        run = run_chunk(transient, scenes, states, plan.steps, self.on_progress)
        strobe, ends = run.record[0][:, -LAST:], jax.tree.map(np.asarray, run.state)
        good = (run.status == Status.FINITE).astype(int)
        maps = Maps(scenes, plan.steps, plan.solver, good, self.on_progress)
        reached = reached_orbits(maps, ends, strobe, count=1, half_step=False)
        cases.simulated[index] += transient.cost + np.where(reached.period, JACOBIAN, 0)[:count]
        cases.state[index], cases.status[index] = rows_of(reached.state)[:count], run.status[:count]
        period = np.zeros(self.count, int)
        period[index] = reached.period[:count]
        if period.any():
            self._adopt(self._orbits(period), period)
        others = np.flatnonzero(cases.period[index] == 0)
        if len(others):
            kinds = classify(strobe[others], scales=COORDINATE_SCALES, floor=FLOOR).kind
            # recurrence without a stable orbit is a contradiction
            kinds = np.where(kinds == "period", "unresolved", kinds)
            cases.kind[index[others]] = Regime.codes(kinds)

    def _on_orbits(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes objectives on the orbits of the cases at `index`, and their derivatives."""
        plan, cases = self.plan, self.cases
        slopes = np.zeros((self.count, len(plan.names), cases.state.shape[1]))
        spans = list(self.pushed(index, slopes))
        for lane in index:
            slopes[lane] = spans[cases.period[lane] - 1].end_slopes[lane]
        slopes = np.einsum("cij,ckj->cki", cases.inverse, slopes)
        spans = list(self.pushed(index, slopes))
        value, gradient = self.totals(index, spans)
        exponents = plan.indices(exponents=True)
        if exponents:
            exponent, slope = self._exponents(index, slopes, spans)
            value[:, exponents], gradient[:, exponents] = exponent[:, None], slope[:, None]
        cases.simulated[index] += 2 * SLOPES_COST * cases.period[index]
        return value, gradient

    def pushed(self, index: np.ndarray, slopes: np.ndarray) -> Iterator[PeriodDerivatives]:
        """Yields the forcing periods of the cases at `index`, as many as their longest `period`.

        **Arguments:** `slopes`: derivatives of the states at the start, (lanes, parameters, size).
        """
        _, lanes = self._lanes(index)
        rows, slopes = self.cases.state[lanes], slopes[lanes]
        for epoch in self.plan.epoch + np.arange(float(self.cases.period[index].max())):
            span = self._pushed(index, rows, slopes, epoch)
            yield span
            rows, slopes = np.asarray(span.end), np.asarray(span.end_slopes)
            self.on_progress(SLOPES_COST)

    def _pushed(self, index: np.ndarray, rows: np.ndarray, slopes: np.ndarray, epoch: float) -> PeriodDerivatives:
        """Runs one forcing period of the cases at `index`, from states and their derivatives in all lanes."""
        plan, (scenes, _) = self.plan, self._lanes(index)
        stepping = dynamic_steps(plan.steps, most=plan.most_steps)
        options: dict[str, Any] = dict(names=plan.names, objectives=plan.of_courses, solver=plan.solver)
        states = self._maps(self.cases.period).states(rows)
        span = push_period(scenes, states, jnp.asarray(slopes), float(epoch), stepping, **options)
        return jax.tree.map(np.asarray, span)

    def _lanes(self, index: np.ndarray) -> tuple[Batched[Scene], np.ndarray]:
        """Scenes and indices of a batch in which the last case at `index` stands for the cases elsewhere."""
        lanes = np.full(self.count, index[-1])
        lanes[index] = index
        return self.scenes.take(lanes), lanes

    def totals(self, index: np.ndarray, spans: Sequence[PeriodDerivatives]) -> tuple[np.ndarray, np.ndarray]:
        """Computes objectives of the cases at `index` over their periods, and their derivatives; exponents are 0."""
        plan = self.plan
        value = np.zeros((len(index), len(plan.objectives)))
        gradient, courses = np.zeros((*value.shape, len(plan.names))), plan.indices(exponents=False)
        for row, lane in enumerate(index if courses else ()):
            own = spans[: int(self.cases.period[lane])]
            # periods lie along axis 0 of a case's values and axis 1 of their derivatives
            kept = jax.tree.map(functools.partial(_of_lane, lane, 0), *(span.kept for span in own))
            slopes = jax.tree.map(functools.partial(_of_lane, lane, 1), *(span.kept_slopes for span in own))
            of_case = total_slopes(plan.of_courses, kept, slopes)
            value[row, courses], gradient[row, courses] = (np.asarray(array)[0] for array in of_case)
        return value, gradient

    def _exponents(
        self, index: np.ndarray, slopes: np.ndarray, spans: Sequence[PeriodDerivatives]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Computes ln |largest multiplier| per period on the orbits of the cases at `index`, and its derivatives.

        **Arguments:** `slopes`: derivatives of the states at the start; `spans`: the periods from there on.
        """
        plan, period = self.plan, self.cases.period
        maps, stepping, (scenes, lanes) = self._maps(period), dynamic_steps(plan.steps), self._lanes(index)
        matrices = maps.jacobians(index, self.cases.state[index])
        begins = [(self.cases.state[lanes], slopes[lanes]), *((span.end, span.end_slopes) for span in spans[:-1])]
        changes = []
        for epoch, (rows, directions) in enumerate(begins):
            at = scenes, maps.states(rows), jnp.asarray(directions), float(epoch), stepping
            changes.append(np.asarray(matrix_slopes(*at, names=plan.names, solver=plan.solver)))
        self.cases.simulated[index] += (1 + 2 * len(plan.names)) * JACOBIAN * period[index]
        of_case = lambda lane: np.stack([of_period[lane] for of_period in changes[: int(period[lane])]])
        pairs = [_exponent(m, of_case(lane)) for lane, m in zip(index, matrices, strict=True)]
        return np.array([value for value, _ in pairs]), np.array([slope for _, slope in pairs])


def _of_lane(lane: int, axis: int, *arrays: np.ndarray) -> np.ndarray:
    """Returns the rows of one lane in the arrays of several periods, stacked along `axis`, as a batch of one."""
    return np.stack([array[lane] for array in arrays], axis=axis)[None]


def _exponent(matrices: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
    """Computes ln |largest multiplier| per period of successive Jacobians (periods, size, size), and its derivatives.

    **Arguments:** `slopes`: derivatives of the Jacobians (periods, parameters, size, size).
    """
    count, size = matrices.shape[:2]
    product, change = np.eye(size), np.zeros((slopes.shape[1], size, size))
    for matrix, slope in zip(matrices, slopes, strict=True):
        product, change = matrix @ product, matrix @ change + slope @ product
    mu, left, right = scipy.linalg.eig(product, left=True, right=True)  # pyright: ignore[reportAssignmentType]
    k = int(np.argmax(np.abs(mu)))
    w, v = left[:, k].conj(), right[:, k]
    mu_slope = np.einsum("i,pij,j->p", w, change, v) / (w @ v)
    return float(np.log(np.abs(mu[k])) / count), np.real(mu_slope / mu[k]) / count


def ensemble_averages(plan: EvaluationPlan, grid: Mapping[str, Any], evaluation: Evaluation) -> Evaluation:
    """Returns an evaluation with objectives and derivatives from ensembles in place of its own.

    Where too few of the runs stay on the rail, the status is that of a run that does not.

    **Arguments:** `grid`: values by name, one for each case; `evaluation`: of the same cases, with states near their
    attractors.
    """
    settings, names, cases = plan.ensemble, plan.names, len(evaluation.status)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=len(names)))).reshape(-1, len(names))
    repeats = max(1, -(-settings.members // len(corners)))
    members = len(corners) * repeats
    disturbances = np.random.default_rng(settings.seed).normal(size=(repeats, len(MOTION_NUMBERS))) * DISTURBANCE
    disturbances[:, :5] = 0.0
    # corner by corner for each case, and run by run for each corner
    offsets = np.tile(corners, (cases, 1, 1))  # in multiples of the reach
    for k, name in enumerate(names):
        here, reach = np.asarray(grid[name], float)[:, None], plan.reach[name]
        offsets[..., k] = (np.clip(here + corners[:, k] * reach, *plan.limits(name)) - here) / reach
    grid = {name: np.repeat(np.asarray(values, float), members) for name, values in grid.items()}
    for k, name in enumerate(names):
        grid[name] = grid[name] + np.repeat(offsets[..., k], repeats) * plan.reach[name]
    for path, numbers in settings.rails(plan.scene.track, repeats).items():
        grid[path] = np.tile(numbers, cases * len(corners))
    scales = np.array(jax.tree.leaves(MOTION_SCALES))
    motions = np.repeat(evaluation.state[:, : len(MOTION_NUMBERS)], members, axis=0)
    motions += np.tile(disturbances * scales, (cases * len(corners), 1))
    values, status = _run_members(plan, grid, motions)
    values, status = values.reshape(cases, len(corners), repeats, -1), status.reshape(cases, members)
    stayed = (status == Status.FINITE).reshape(cases, len(corners), repeats)
    fits = [settings.fit(*of_case) for of_case in zip(offsets, values, stayed, strict=True)]
    value, stderr, slope, slope_stderr = (np.stack(part) for part in zip(*fits, strict=True))
    good = np.array([settings.enough(float(np.mean(kept))) for kept in stayed])
    kept = lambda a: np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan)
    per = 1 / np.array([plan.reach[name] for name in names])
    return evaluation._replace(
        value=kept(value),
        stderr=kept(stderr),
        gradient=kept(slope * per),
        gradient_stderr=kept(slope_stderr * per),
        status=np.where(good, int(Status.FINITE), status.max(axis=1)),
        simulated=evaluation.simulated + members * (settings.transient + settings.periods),
    )


class _RunValues(NamedTuple):
    """Objectives (lanes, objectives) and statuses of the runs of a chunk."""

    value: np.ndarray
    status: np.ndarray


def _run_members(plan: EvaluationPlan, grid: Mapping[str, Any], motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the objectives (runs, objectives) and the statuses of runs from `motions` (runs, numbers)."""
    courses, exponents = plan.of_courses, plan.indices(exponents=True)
    records = RecordSet((*([PeriodValues(courses)] if courses else []), *(plan.objectives[k] for k in exponents)))
    options = RunOptions(plan.ensemble.transient, plan.ensemble.periods, plan.steps, plan.steps, plan.solver)
    runs = make_plan(Grid(plan.scene, grid, product=False), plan.start, options, records)
    runs.cases.starts = jax.tree.unflatten(jax.tree.structure(MOTION_SCALES), list(motions.T))

    def work(part: ChunkInputs) -> _RunValues:
        # starts of runs may be deep inside contacts, which is no oversight
        states = states_and_penetrations(part.scenes, part.starts)[0]
        run = run_chunk(runs, part.scenes, states, plan.steps, part.on_progress)
        values = np.empty((len(run.status), len(plan.objectives)))
        if courses:
            values[:, plan.indices(exponents=False)] = totals(courses, jax.tree.map(jnp.asarray, run.record[0]))
        for k, record in zip(exponents, run.record[bool(courses) :], strict=True):
            values[:, k] = record.exponent
        return _RunValues(values, run.status)

    run = run_cases(runs, work, cost=runs.cost)
    return run.checked(lambda: tuple(run.results))
