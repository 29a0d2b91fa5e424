"""Running many cases: chunks through their periods, on threads, with progress and Ctrl-C."""

import functools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from ..flow.period_map import Passage, advance, initial_states
from ..flow.record import RecordedSpan, RecordSet, Samples
from ..flow.status import (
    Interrupted,
    Status,
    Stop,
    blank,
    first_problem,
    heed_interrupts,
    with_accuracy,
    without_lost,
)
from ..flow.stepping import ConstantSteps, calls_of
from ..model.dynamics import State
from ..model.kinematics import Motion, accuracy_scales, scaled_size
from ..model.scene import Scene
from ..orbits.simulate import dynamic_steps
from ..solvers.latching import calls_lapack
from ..tools.batching import Batched
from ..tools.checks import TOLD, warn
from ..tools.compile import ahead, as_argument, jit
from ..tools.progress import bar as progress_bar, is_live
from ..tools.types import Real
from .plan import Chunk, LastStrobes, OnProgress, Part, Plan
from .schedule import Span

TICK = 0.25
"""Seconds between two checks of a run's threads and of Ctrl-C."""
PATIENCE = 1.0
"""Seconds of waiting for threads after Ctrl-C: most calls are shorter, unless they compile."""


class ChunkRun(NamedTuple):
    """A chunk of cases after its run."""

    state: State  # the states at the end, with a leading axis of lanes
    status: Int[np.ndarray, " lanes"]  # `slipperjax.Status` codes
    # arrays of the plan's outputs, with a leading axis of lanes
    record: tuple[PyTree, ...]
    probe: Float[np.ndarray, "lanes probes"]  # errors, measured with half the step [1]

    def over(self, shape: tuple[int, ...]) -> "ChunkRun":
        """Return the results of all cases over a grid, without the numbers of lost cases."""
        known = without_lost(self._replace(state=None), self.status)
        return jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), known)


def run_chunk(part: Part, states: State, epoch: float = 0.0, *, first: bool = False) -> ChunkRun:
    """Run a chunk of cases through its schedule and the stages of its plan.

    **Arguments:** `states`: at the start; `epoch`: forcing periods from the plan's beginning to the beginning of this
    run, from which times in records count; `first`: whether it is the first chunk of its run; its programs are
    compiled at the same time.
    """
    plan = part.plan
    records = plan.records
    ride = Ride(part, states, plan.epoch + epoch)
    if first:
        ride.compile_ahead()
    values = plan.joined([ride.stretch(k) for k in range(len(part.schedule.stretches))])
    states = ride.states
    status = ride.judged
    strobe = next((a for r, a in zip(records.records, values, strict=True) if isinstance(r, LastStrobes)), None)
    # each stage begins from the same states, and adds its findings to the status
    for stage in plan.stages:
        measured, status = stage.of_chunk(part, states, ride.period, status, strobe)
        values.append(measured)
    probe = np.stack(ride.errors, axis=1) if ride.errors else np.empty((len(status), 0))
    return ChunkRun(states, status, tuple(values), probe)


class Ride:
    """A chunk of cases on its way through its schedule."""

    def __init__(self, part: Part, states: State, period: float):
        """**Arguments:** `period`: forcing periods from distance zero."""
        self.part = part
        self.states = states
        self.period = period
        self.status = np.zeros(len(part.index), int)
        self.errors: list[Float[np.ndarray, " lanes"]] = []
        """Changes by half the step, at each place where the error is measured [1]."""
        self.judged = self.status
        """The `Status` codes, with those that records and errors of the last stretch give."""
        self._records = RecordSet()
        self._carry: tuple[PyTree, ...] = ()

    def stretch(self, number: int) -> tuple[PyTree, ...]:
        """Run through a stretch, and return the arrays of its records, (lanes, ...)."""
        part = self.part
        schedule = part.schedule
        spans = schedule.stretches[number]
        passed = sum(map(len, schedule.stretches[:number]))
        recorded = sum(span.periods for span in spans if span.recorded)
        samples = Samples(part.plan.records, recorded)
        begin = self.period
        for k, span in enumerate(spans, passed):
            seen = part.plan.seen(span)
            if seen != self._records:
                # these records begin here; other records sampled the spans before
                self._records = seen
                self._carry = self._begun()
            part.on_progress(0)  # stops here after Ctrl-C
            if span.probed:
                self.errors.append(self._change(schedule.following(k, span.probed)))
            self._pass(span, samples)
        self.judged = self._records.judge(self._carry, self.status, part.scenes, part.plan.solver)
        if self.errors:
            self.judged = with_accuracy(self.judged, np.max(self.errors, axis=0))
        steps = max(span.steps for span in spans)
        made = RecordedSpan(recorded, steps, begin, self.judged, part.scenes)
        values = self._records.finish(self._carry, samples.joined(), made)
        self._carry = self._records.renewed(self._carry, self._begun())
        return values

    def compile_ahead(self) -> None:
        """Compile all programs except the first at the same time, by calls of zero periods."""
        plan = self.part.plan
        # LAPACK must not be called from two threads
        if calls_lapack(plan.solver):
            return
        programs = {}
        for span in self.part.schedule.spans:
            if span.periods:
                seen = plan.seen(span)
                if span.probed:
                    programs.setdefault((plan.early, None), (plan.early, dynamic_steps(span.steps)))
                stepping = plan.stepping(span.steps, seen)
                programs.setdefault((seen, stepping.most), (seen, stepping))
        for records, stepping in list(programs.values())[1:]:
            carry = initial_carry(records, self.part.scenes, self.states)
            now = self.part.scenes, self.states, self.period
            ahead(functools.partial(self._advanced, *now, stepping, 0, records, carry))

    def _begun(self) -> tuple[PyTree, ...]:
        """Return the carries of records before any period."""
        return initial_carry(self._records, self.part.scenes, self.states)

    def _pass(self, span: Span, samples: Samples) -> None:
        """Run through a span, call by call."""
        part = self.part
        stepping = part.plan.stepping(span.steps, self._records)
        # progress counts equal steps
        share = span.steps / part.schedule.mean_steps
        for used in calls_of(span.periods):
            part.on_progress(0)
            passed = self._advanced(part.scenes, self.states, self.period, stepping, used, self._records, self._carry)
            self.states = passed.state
            self._carry = passed.carried
            self.status = first_problem(self.status, passed.status)
            # samples of unused periods are cut off, by a copy that does not keep them in memory
            samples.add(self._records, jax.tree.map(lambda a, used=used: np.array(a[:, :used]), passed.samples))
            part.on_progress(used * share)
            self.period += used

    def _change(self, spans: Sequence[tuple[int, int]]) -> Float[np.ndarray, " lanes"]:
        """Return the change by half the step over some periods, in multiples of `accuracy_scales` [1].

        **Arguments:** `spans`: steps in each period, and number of periods, one after the other.
        """
        part = self.part
        scenes = part.scenes
        if self._records.feeds_back:
            scenes = _fed_back(scenes, self._carry, self.period, records=self._records)
        # with the program of a transient, which may already exist
        early = part.plan.early
        seen = early, initial_carry(early, scenes, self.states)
        ends = []
        for finer in (1, 2):
            states, period = self.states, self.period
            for steps, periods in spans:
                for used in calls_of(periods):
                    states = self._advanced(scenes, states, period, dynamic_steps(finer * steps), used, *seen).state
                    period += used
            ends.append(states.motion)
        return np.asarray(_distances(scenes, *ends))

    def _advanced(
        self,
        scenes: Batched[Scene],
        states: State,
        period: float,
        stepping: ConstantSteps,
        used: int,
        records: RecordSet,
        carry: PyTree,
    ) -> Passage:
        """Return the cases after one call."""
        plan = self.part.plan
        return advance(
            scenes,
            states,
            period,
            stepping,
            used=as_argument(used),
            earlier=carry,
            solver=plan.solver,
            periods=plan.room(records),
            records=records,
        )


@functools.partial(jit, static_argnames=("records",))
def _fed_back(scenes: Batched[Scene], carry: PyTree, period: Real, *, records: RecordSet) -> Batched[Scene]:
    """Return the scenes of a period, changed by values that earlier periods left in the carries of records."""
    nothing = jax.tree.map(lambda _: None, carry)
    both = Batched((scenes.varied, carry), (scenes.shared, nothing))
    # so that unchanged values are shared
    return both.apply(lambda pair: records.feed_back(pair[0], pair[1], period))


@jit
def _distances(scenes: Batched[Scene], one: Motion, other: Motion) -> jax.Array:
    """Return distances of two motions of each case, in the scales by which errors are judged [1]."""
    size = lambda scene, a, b: scaled_size(jax.tree.map(jnp.subtract, a, b), accuracy_scales(scene))
    return scenes.map(size, one, other)


def initial_carry(records: RecordSet, scenes: Batched[Scene], states: State) -> PyTree:
    """Return the carries of records before any period, with a leading axis of cases."""

    def first(tree):
        # on the host, where an entry of another shape needs no compilation
        return jax.tree.map(lambda a: np.asarray(a)[0], tree)

    lanes = len(states.motion.y)
    # only shapes count, not numbers, so that one case is enough
    one = records.begin(eqx.combine(first(scenes.varied), scenes.shared), first(states))
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), one)


class Run(NamedTuple):
    """Cases after a run, or after an interrupt."""

    # A named tuple of arrays with a leading axis of cases; unfinished cases have the values of `blank`. None where no
    # case was finished.
    results: PyTree
    cases: int
    interrupted: bool

    @property
    def finished(self) -> int:
        """Number of finished cases."""
        return 0 if self.results is None else int(np.sum(self.results.status != Status.NOT_RUN))

    def checked(self, make: Callable[[], object]) -> PyTree:
        """Return `make()`, a dataset of the results; raise `Interrupted` with it where the run was interrupted."""
        made = None if self.results is None else make()
        if self.interrupted:
            raise Interrupted(made, self.finished, self.cases)
        return made


def run_plan(
    plan: Plan, how: Mapping[str, Any], prepared: Callable[[Part], Batched[Scene]] = lambda part: part.scenes
) -> Run:
    """Run all cases of a plan from their starts, with the measurements of its stages over all cases.

    **Arguments:** `how`: options of `run_cases`; `prepared`: returns the scenes with which a chunk runs.
    """

    def work(part: Part) -> ChunkRun:
        part = part._replace(scenes=prepared(part))
        states = initial_states(part.scenes, part.starts, plan.epoch)
        # the first chunk compiles the programs that most other chunks also use
        return run_chunk(part, states, first=bool(part.row[0] == 0))

    results, cases, interrupted = run_cases(plan, work, periods=plan.periods, **how)
    if results is not None:
        values = list(results.record)
        status = results.status
        # stages that measure only some cases divide these into other chunks; values of records come first
        for k, stage in enumerate(plan.stages, len(plan.records.records)):
            values[k], status, interrupted = stage.of_all(values[k], status, plan, how, interrupted)
        results = results._replace(status=status, record=tuple(values))
    return Run(results, cases, interrupted)


def run_cases(
    plan: Plan,
    work: Callable[[Part], PyTree],
    *,
    periods: float,
    index: Int[np.ndarray, " some"] | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    tangents: bool = False,
    progress: bool | None = None,
    name: str = "",
) -> Run:
    """Call `work(part)` for all cases of a plan, or those at `index`, chunk by chunk.

    **Arguments:** `index`: indices of cases, which may repeat; others as for `run_chunks` and
    `Plan.chunks`.
    """
    listed = np.arange(plan.cases.count) if index is None else index
    chunks, threads = replace(plan, which=plan.which[listed]).chunks(chunk, workers, tangents=tangents)

    def of_chunk(chunk: Chunk, on_progress: OnProgress) -> PyTree:
        lanes = listed[chunk.index]  # chunks have indices into `index`, and parts into the list of all cases
        cases = plan.cases.take(lanes)
        return work(Part(plan, *cases, lanes, *chunk, on_progress))

    return run_chunks(chunks, threads, of_chunk, periods=periods, progress=progress, name=name)


def run_chunks(
    chunks: Sequence[Chunk],
    workers: int,
    work: Callable[[Chunk, OnProgress], PyTree],
    *,
    periods: float,
    progress: bool | None,
    name: str = "",
) -> Run:
    """Call `work(chunk, on_progress)` for each chunk on `workers` threads, the first chunks first.

    After Ctrl-C it returns the finished chunks.

    **Arguments:**

    - `work`: returns a named tuple of arrays with a leading axis of cases, one of them `status`. It calls
      `on_progress(n)` after n forcing periods. This call raises where another chunk failed or the user interrupted,
      so that this chunk also stops.
    - `periods`: forcing periods of one case in all.
    - `progress`, `name`: of `progress_shown`.
    """
    parts: list[PyTree] = [None] * len(chunks)
    cases = sum(chunk.cases for chunk in chunks)
    # the bar counts steps, because time is proportional to steps
    total = periods * sum(chunk.schedule.mean_steps * chunk.cases for chunk in chunks)
    interrupted = False

    def one(k: int) -> None:
        chunk = chunks[k]

        def on_progress(passed: float) -> None:
            heed_interrupts()
            shown(chunk.schedule.mean_steps * chunk.cases * passed)

        parts[k] = work(chunk, on_progress)
        shown(0.0, chunk.cases)

    with progress_shown(total, cases, name, progress) as shown:
        try:
            gather([functools.partial(one, k) for k in range(len(chunks))], workers)
        except KeyboardInterrupt:
            interrupted = True
    # a copy, because threads that still run may add to the list
    return _in_order(chunks, list(parts), interrupted)


def gather(
    tasks: Sequence[Callable[[], object]],
    threads: int,
    executor: Executor | None = None,
    done: Callable[[int], object] = lambda k: None,
    patience: float = PATIENCE,
) -> None:
    """Run tasks on threads of this process, or by an executor, the first tasks first.

    After Ctrl-C, or an error of a task, the others are cancelled. Running tasks end after their present call, where
    `heed_interrupts` raises. A warning says where they last longer than `patience`.

    **Arguments:** `done`: called with the number of each task that has ended; `patience`: how long to wait for
    running threads after Ctrl-C or an error [s].

    **Raises:** `KeyboardInterrupt` after Ctrl-C; the error of a task, or of the executor.
    """
    stop = Stop(Stop.here())
    pool = ThreadPoolExecutor(threads) if executor is None else executor
    context = copy_context()
    if TOLD.get() is None:
        context.run(TOLD.set, set())  # each kind of warning once
    futures: dict[Future, int] = {}
    try:
        # threads of this process get its context variables and its stop; tasks of an executor may be pickled
        for k, task in enumerate(tasks):
            future = context.run(stop.submit, pool, task) if executor is None else pool.submit(task)
            futures[future] = k
        while futures:
            for future in wait(futures, TICK, "FIRST_COMPLETED").done:
                future.result()  # raises the task's error
                done(futures.pop(future))
            heed_interrupts()
    except BrokenExecutor:  # it ends all tasks itself, and fails where it finds a cancelled one
        raise
    except BaseException:
        running = [future for future in futures if not future.cancel()]
        stop.set()
        if executor is None:
            wait(running, patience)
            left = sum(not future.done() for future in running)
            if left:
                text = f"The run has ended, but {left} of its threads will go on"
                warn(f"{text} to the end of the call that they are in.")
        raise
    finally:
        if executor is None:
            pool.shutdown(wait=False)  # an executor belongs to the caller


def _in_order(chunks: Sequence[Chunk], parts: Sequence[PyTree], interrupted: bool) -> Run:
    """Return the chunks' results in the order of the cases, without the copies that fill up chunks.

    **Arguments:** `parts`: the chunks' results; None for an unfinished chunk, whose cases become blank.
    """
    cases = sum(chunk.cases for chunk in chunks)
    like = next((part for part in parts if part is not None), None)
    if like is None:
        return Run(None, cases, interrupted)

    def joined(*arrays: np.ndarray) -> np.ndarray:
        ordered = np.empty((cases, *arrays[0].shape[1:]), arrays[0].dtype)
        for chunk, array in zip(chunks, arrays, strict=True):
            ordered[chunk.index[: chunk.cases]] = np.asarray(array)[: chunk.cases]
        return ordered

    whole = (blank(like, len(c.index)) if part is None else part for c, part in zip(chunks, parts, strict=True))
    return Run(jax.tree.map(joined, *whole), cases, interrupted)


@contextmanager
def progress_shown(
    total: float, cases: int, name: str, wanted: bool | None, **options: Any
) -> Iterator[Callable[..., None]]:
    """Show the progress of a run: a bar on terminals and in notebooks, from time to time a line in files and pipes.

    **Arguments:** `total`: all work, in a unit to which time is proportional; `cases`: their number; `wanted` and
    `options`: of `slipperjax.tools.progress.bar`.

    **Yields:** `add(work, done)`, which threads call with the finished work and the number of finished cases.
    """
    layout = "{desc}{percentage:3.0f}%" + ("|{bar}|" if is_live() else ",") + " {elapsed}, {remaining} left{postfix}"
    lock = threading.Lock()
    finished = 0
    # most runs compile two programs: for the transient, and for the recorded periods
    with progress_bar(wanted, programs=2, total=total, desc=name, bar_format=layout, **options) as bar:

        def add(work: float, done: int = 0) -> None:
            nonlocal finished
            with lock:
                finished += done
                bar.set_postfix_str(f"{finished} of {cases} cases", refresh=False)
                # rounding may bring the sum above the total, of which tqdm would warn
                bar.update(min(work, total - bar.n))

        yield add
