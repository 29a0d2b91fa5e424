"""Judging designs: objectives and their derivatives on the motion that each case settles to, as one batch.

A case whose motion is a stable periodic orbit is judged on the orbit, by exact derivatives. Any other motion that
stays on the rail is judged by an ensemble of runs, see `slipperjax.design.ensembles`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Int

from ..flow.period_map import initial_states
from ..flow.records import AbstractNumber
from ..flow.simulate import dynamic_steps
from ..flow.status import Status
from ..model.dang2024 import table_2_start
from ..model.dynamics import State, initial_state
from ..model.kinematics import Motion
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene
from ..orbits.periodic import TOLERANCE
from ..sweeps.grid import Grid, filled
from ..sweeps.maps import JACOBIAN, Maps, rows_of
from ..sweeps.orbits import find_orbits
from ..sweeps.reached import reached_orbits
from ..sweeps.records import LargestExponent
from ..sweeps.run import Chunk, OnProgress, RunOptions, make_plan, run_chunk, run_chunks
from ..tools.batching import Batched
from ..tools.limits import cores
from .ensembles import Spread, averages
from .gradients import matrix_slopes, push_period, total_slopes
from .objectives import Objective

LANES = 32
"""Most cases in one call."""
PUSH = 8.0
"""What a period with its derivatives by two parameters costs, in plain ones: measured."""
SAME = 1.0
"""Greatest distance of an orbit from the last known one to be its continuation, in multiples of the scales."""
SHORTEST = 20
"""Fewest forcing periods from which it can be told that an orbit was reached."""
ITERATIONS = 20
"""Of Newton's method from a neighbour."""


class Judged(NamedTuple):
    """Cases and their objectives, arrays with a leading axis of cases."""

    status: Int[np.ndarray, " cases"]
    """`Status` codes."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods after which the motion recurs; 0 for motions that are not on a stable periodic orbit."""
    multiplier: Float[np.ndarray, " cases"]
    """Modulus of the orbit's largest Floquet multiplier over its period [1]; NaN without an orbit."""
    state: Float[np.ndarray, "cases size"]
    """All numbers of the state at the start of a forcing period."""
    value: Float[np.ndarray, "cases objectives"]
    """NaN for cases that left the rail or the finite numbers."""
    gradient: Float[np.ndarray, "cases objectives parameters"]
    stderr: Float[np.ndarray, "cases objectives"]
    """Standard errors of the values: 0 on orbits."""
    gradient_stderr: Float[np.ndarray, "cases objectives parameters"]
    inverse: Float[np.ndarray, "cases size size"]
    """Of I - P_x over the orbit; NaN without one."""
    simulated: Float[np.ndarray, " cases"]
    """Forcing periods that were simulated, derivatives counted by what they cost."""

    @property
    def regime(self) -> np.ndarray:
        """In words: "period n", "irregular" or "lost"."""
        words = [
            "lost" if code != Status.FINITE else f"period {n}" if n else "irregular"
            for code, n in zip(self.status, self.period, strict=True)
        ]
        return np.array(words)


class Question(NamedTuple):
    """What cases are judged by, and how."""

    names: tuple[str, ...]
    """Parameters by which objectives are differentiated."""
    objectives: tuple[Objective, ...]
    solver: diffrax.AbstractSolver
    steps: int
    """Per forcing period, the same for all cases, so that objectives have no jumps where it would change."""
    transient: int = 200
    """Forcing periods to pass from a start before an orbit is looked for."""

    @property
    def of_courses(self) -> tuple[AbstractNumber, ...]:
        """The objectives that are made of courses."""
        return tuple(one for one in self.objectives if isinstance(one, AbstractNumber))

    def places(self, exponents: bool) -> list[int]:
        """The places of exponents among the objectives, or of all others."""
        return [k for k, one in enumerate(self.objectives) if isinstance(one, LargestExponent) == exponents]


class Memory(NamedTuple):
    """Where cases were when they were judged last."""

    state: Float[np.ndarray, "cases size"]
    period: Int[np.ndarray, " cases"]
    inverse: Float[np.ndarray, "cases size size"]
    """As of `Judged`."""


def judge(
    scene: Scene,
    grid: Mapping[str, Any],
    question: Question,
    *,
    reach: Mapping[str, float],
    spread: Spread | None = Spread(),
    start: Motion | State | None = None,
    memory: Memory | None = None,
    progress: bool = False,
) -> Judged:
    """Judges cases, on orbits or by ensembles.

    **Arguments:** `reach`: how far ensembles' parameters are from the cases' [their SI units]; `spread`: None leaves
    irregular cases without values; others as for `judge_on_orbits`.
    """
    found = judge_on_orbits(scene, grid, question, start=start, memory=memory, progress=progress)
    irregular = np.flatnonzero((found.period == 0) & (found.status == Status.FINITE))
    if spread is None or not len(irregular):
        return found
    some = {name: np.asarray(values)[irregular] for name, values in grid.items()}
    first = scene.replace(**{name: values[0] for name, values in some.items()})
    _, unravel = ravel_pytree(initial_state(first, table_2_start()))
    starts = jax.vmap(unravel)(jnp.asarray(found.state[irregular])).motion
    how: dict[str, Any] = dict(steps=question.steps, solver=question.solver, progress=progress)
    more = averages(scene, some, question.names, reach, question.objectives, starts, spread, **how)
    for name in ("value", "stderr", "gradient", "gradient_stderr"):
        getattr(found, name)[irregular] = getattr(more, name)
    found.status[irregular] = more.status
    found.simulated[irregular] += more.simulated
    return found


def judge_on_orbits(
    scene: Scene,
    grid: Mapping[str, Any],
    question: Question,
    *,
    start: Motion | State | None = None,
    memory: Memory | None = None,
    progress: bool = False,
) -> Judged:
    """Judges cases on the stable periodic orbits that they settle to; irregular ones have values of NaN so far.

    **Arguments:** `grid`: values by name, read side by side, one case each; `memory`: where the cases were
    with parameters near these: an orbit is followed from there if it is still stable, and otherwise the motion
    settles anew from there.
    """
    options = RunOptions(0, 1, question.steps, None, question.solver)
    plan = make_plan(Grid(scene, grid, product=False), table_2_start() if start is None else start, options)
    plan, cases = plan.strobes(max(question.transient, SHORTEST)), plan.cases
    size = min(LANES, -(-cases.count // cores()))
    places = [np.arange(at, min(at + size, cases.count)) for at in range(0, cases.count, size)]
    chunks = [Chunk(filled(some, size), len(some), question.steps) for some in places]

    def work(chunk: Chunk, on_progress: OnProgress) -> Judged:
        scenes, starts = cases.take(chunk.index)
        states = initial_states(scenes, starts)
        known = None if memory is None else Memory(*(of_cases[chunk.index] for of_cases in memory))
        return _Batch(scenes, states, question, on_progress).judged(plan, known)

    periods = (0 if memory is not None else plan.cost) + 2 * JACOBIAN + 2 * PUSH
    run = run_chunks(chunks, min(cores(), len(chunks)), work, cost=periods, progress=progress, name="orbits")
    return run.checked(lambda: run.results)


class _Batch:
    """Cases of a chunk while they are judged."""

    def __init__(self, scenes: Batched[Scene], states: State, question: Question, on_progress: OnProgress):
        self.scenes, self.states, self.question, self.on_progress = scenes, states, question, on_progress
        self.rows = rows_of(states)
        self.count = len(self.rows)
        self.simulated = np.zeros(self.count)

    def maps(self, period: np.ndarray) -> Maps:
        q = self.question
        return Maps(self.scenes, self.states, q.steps, q.solver, period, self._hear)

    def _hear(self, periods: float) -> None:
        self.on_progress(periods)

    def judged(self, plan: Any, known: Memory | None) -> Judged:
        period, orbits = np.zeros(self.count, int), None
        if known is not None:
            there = np.all(np.isfinite(known.state), axis=1)
            self.rows[there] = known.state[there]
            # the gaps have changed with the parameters: a memory that agrees with them
            self.rows = self.maps(period).settled(np.arange(self.count), self.rows, self.rows)
            orbits, period = self._followed(np.where(there, known.period, 0), known.inverse)
        left = np.flatnonzero(period == 0)
        status = np.zeros(self.count, int)
        if len(left):
            status[left], period[left] = self._settled(plan, left)
            again = np.where(np.isin(np.arange(self.count), left), period, 0)
            found = self._orbits(again)
            ok = (found.status == Status.FINITE) & found.stable
            period[left] = np.where(ok[left], period[left], 0)
            orbits = found if orbits is None else _merged(orbits, found, left)
        assert orbits is not None
        taken = period > 0
        self.rows[taken] = rows_of(orbits.state)[taken]
        shape = self.count, len(self.question.objectives)
        value, gradient = np.full(shape, np.nan), np.full((*shape, len(self.question.names)), np.nan)
        if taken.any() and self.question.names:
            value[taken], gradient[taken] = self._gradients(np.flatnonzero(taken), period, orbits.inverse)
        return Judged(
            status,
            period,
            np.where(taken, np.abs(orbits.multipliers[:, 0]), np.nan),
            self.rows,
            value,
            gradient,
            np.where(taken[:, None], 0.0, np.nan) * np.ones(shape),
            np.where(taken[:, None, None], 0.0, np.nan) * np.ones_like(gradient),
            np.where(taken[:, None, None], orbits.inverse, np.nan),
            self.simulated,
        )

    def _orbits(self, period: np.ndarray, inverse: np.ndarray | None = None) -> Any:
        q = self.question
        options: dict[str, Any] = dict(solver=q.solver, tolerance=TOLERANCE, max_iterations=ITERATIONS)
        states = self.maps(period).states(self.rows)
        options |= dict(period=period, inverse=inverse, on_progress=self._hear)
        found = find_orbits(self.scenes, states, q.steps, **options)
        self.simulated += period * (found.iterations + JACOBIAN * found.jacobians)
        return found

    def _followed(self, period: np.ndarray, inverse: np.ndarray) -> tuple[Any, np.ndarray]:
        """Orbits near the last known ones, and their periods, 0 where there is none that is stable."""
        found = self._orbits(period, inverse)
        rows = rows_of(found.state)
        weights = self.maps(period).weights(np.arange(self.count), rows)[:, : len(MOTION_NUMBERS)]
        near = np.max(np.abs(weights * (rows - self.rows)[:, : len(MOTION_NUMBERS)]), axis=1) <= SAME
        ok = (found.status == Status.FINITE) & found.stable & near
        return found, np.where(ok, period, 0)

    def _settled(self, plan: Any, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulates cases until they have settled: their statuses, and the periods of orbits that they reached."""
        index = filled(left, min(LANES, self.count))
        scenes, states = self.scenes.take(index), self.maps(np.zeros(self.count, int)).states(self.rows[index])
        run = run_chunk(plan, scenes, states, self.question.steps, self.on_progress)
        found = reached_orbits(
            scenes,
            jax.tree.map(np.asarray, run.state),
            run.record[0][:, -200:],
            self.question.steps,
            solver=self.question.solver,
            count=1,
            half_step=False,
            wanted=run.status == Status.FINITE,
            on_progress=self.on_progress,
        )
        self.simulated[left] += plan.cost + np.where(found.period, JACOBIAN, 0)[: len(left)]
        self.rows[left] = rows_of(found.state)[: len(left)]
        return run.status[: len(left)], found.period[: len(left)]

    def _gradients(self, index: np.ndarray, period: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objectives on the orbits of some cases, and their derivatives."""
        q = self.question
        by_p = self._pushed(index, period, np.zeros((self.count, len(q.names), self.rows.shape[1])))[-1].moved
        moved = np.einsum("cij,ckj->cki", inverse, by_p)
        stretches = self._pushed(index, period, moved)
        shape = len(index), len(q.objectives)
        value, gradient = np.zeros(shape), np.zeros((*shape, len(q.names)))
        for row, k in enumerate(index):
            own = stretches[: period[k]]
            kept = jax.tree.map(lambda *a, k=k: np.stack([x[k] for x in a])[None], *(s.kept for s in own))
            slopes = jax.tree.map(lambda *a, k=k: np.stack([x[k] for x in a], axis=1)[None], *(s.slopes for s in own))
            if not q.of_courses:
                continue
            found = total_slopes(q.of_courses, kept, slopes)
            value[row, q.places(False)], gradient[row, q.places(False)] = (
                np.asarray(found[0])[0],
                np.asarray(found[1])[0],
            )
        if q.places(True):
            exponent, slope = self._exponents(index, period, stretches)
            value[:, q.places(True)], gradient[:, q.places(True)] = exponent[:, None], slope[:, None]
        self.simulated[index] += 2 * PUSH * period[index]
        return value, gradient

    def _pushed(self, index: np.ndarray, period: np.ndarray, moved: np.ndarray) -> list["_Stretch"]:
        """The forcing periods along the orbits of some cases, while their starts move."""
        q, rows = self.question, self.rows
        stepping = dynamic_steps(q.steps, inside=True)
        options: dict[str, Any] = dict(names=q.names, objectives=q.of_courses, solver=q.solver)
        maps, found = self.maps(period), []
        for epoch in range(int(period[index].max())):
            going = index[period[index] > epoch]
            more = filled(going, self.count)
            at = self.scenes.take(more), maps.states(rows[more]), jnp.asarray(moved[more])
            pushed = push_period(*at, float(epoch), stepping, **options)
            ends, then = rows.copy(), moved.copy()
            ends[going], then[going] = (np.asarray(a)[: len(going)] for a in (pushed.end, pushed.moved))
            of_cases = lambda a, going=going: _spread_out(np.asarray(a)[: len(going)], going, self.count)
            kept, slopes = jax.tree.map(of_cases, (pushed.kept, pushed.slopes))
            found.append(_Stretch(rows, moved, then, kept, slopes))
            rows, moved = ends, then
            self.on_progress(PUSH * len(going) / self.count)
        return found

    def _exponents(
        self, index: np.ndarray, period: np.ndarray, stretches: list["_Stretch"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """ln |largest multiplier| per period on the orbits of some cases, and its derivatives."""
        q, maps = self.question, self.maps(period)
        matrices = maps.jacobians(index, self.rows[index])
        slopes: dict[int, list] = {int(k): [] for k in index}
        for epoch, stretch in enumerate(stretches):
            going = index[period[index] > epoch]
            more = filled(going, self.count)
            at = self.scenes.take(more), maps.states(stretch.begin[more]), jnp.asarray(stretch.begins[more])
            options: dict[str, Any] = dict(names=q.names, solver=q.solver)
            found = np.asarray(matrix_slopes(*at, float(epoch), dynamic_steps(q.steps), **options))
            for place, k in enumerate(going):
                slopes[int(k)].append(found[place])
        self.simulated[index] += (1 + 2 * len(q.names)) * JACOBIAN * period[index]
        pairs = [_exponent(m, np.stack(slopes[int(k)])) for k, m in zip(index, matrices, strict=True)]
        return np.array([value for value, _ in pairs]), np.array([slope for _, slope in pairs])


class _Stretch(NamedTuple):
    """A forcing period of a batch, arrays with a leading axis of cases."""

    begin: np.ndarray
    """All numbers of the states at its start."""
    begins: np.ndarray
    """Their derivatives by the parameters."""
    moved: np.ndarray
    """Those at its end."""
    kept: Any
    slopes: Any


def _spread_out(some: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    found = np.full((count, *some.shape[1:]), np.nan)
    found[index] = some
    return found


def _exponent(matrices: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
    """ln |largest multiplier| per period of successive Jacobians (periods, size, size), and its derivatives.

    **Arguments:** `slopes`: derivatives of the Jacobians (periods, parameters, size, size).
    """
    count, size = matrices.shape[:2]
    whole, moved = np.eye(size), np.zeros((slopes.shape[1], size, size))
    for matrix, slope in zip(matrices, slopes, strict=True):
        whole, moved = matrix @ whole, matrix @ moved + slope @ whole
    mu, left, right = scipy.linalg.eig(whole, left=True, right=True)  # pyright: ignore[reportAssignmentType]
    k = int(np.argmax(np.abs(mu)))
    w, v = left[:, k].conj(), right[:, k]
    change = np.einsum("i,pij,j->p", w, moved, v) / (w @ v)
    return float(np.log(np.abs(mu[k])) / count), np.real(change / mu[k]) / count


def _merged(first: Any, second: Any, index: np.ndarray) -> Any:
    """Orbits, those of some cases replaced by others."""

    def put(a: Any, b: Any) -> np.ndarray:
        found = np.array(a)
        found[index] = np.asarray(b)[index]
        return found

    return jax.tree.map(put, first, second)
