"""Many cases at work: chunks through their periods, on threads, with progress and Ctrl-C."""

import functools
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PyTree

from ..flow.period_map import advance
from ..flow.record import RecordedSpan, RecordSet, Samples
from ..flow.status import Interrupted, Stop, blank, first_problem, with_accuracy
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.kinematics import Motion, accuracy_scales, scaled_size
from ..model.scene import Scene
from ..solvers.latching import calls_lapack
from ..tools.batching import Batched
from ..tools.checks import TOLD, warn
from ..tools.compile import ahead, as_argument, jit
from ..tools.progress import bar as progress_bar, is_live
from .plan import Calls, Chunk, LastStrobes, OnProgress, Part, Plan

TICK = 0.25
"""Seconds between two checks of a run's threads, and for Ctrl-C."""
PATIENCE = 1.0
"""Seconds for which running threads are waited for after Ctrl-C: most calls are shorter, except where they compile."""


class ChunkRun(NamedTuple):
    """A chunk of cases after its run."""

    state: State  # the states at the end, with a leading axis of lanes
    status: Int[np.ndarray, " lanes"]  # `slipperjax.Status` codes
    record: tuple[PyTree, ...]  # arrays of the plan's outputs, with a leading axis of lanes
    probe: Float[np.ndarray, " lanes"] | None = None  # errors by half the step [1]; None where not measured


def heed_interrupts(periods: float = 0.0) -> None:
    """Raise `KeyboardInterrupt` where this run is asked to end. Serves as `OnProgress` of runs that show none."""
    if Stop.here().is_set():
        raise KeyboardInterrupt


def run_chunk(part: Part, states: State, epoch: float = 0.0, *, first: bool = False) -> ChunkRun:
    """Run a chunk of cases through its plan: transient, recorded span, stages.

    **Arguments:** `states`: at the start; `epoch`: forcing periods from the place where the plan begins to where this
    run does, from where the times in records count; `first`: whether it is the first chunk of its run, whose two
    programs, of the transient and of the recorded span, are compiled at the same time.
    """
    plan = part.plan
    scenes = part.scenes
    records = plan.records
    at = Passing(states, plan.epoch + epoch, np.zeros(len(states.motion.y), int))
    samples = Samples(records, plan.recorded.periods)
    number = as_argument(part.steps)  # an array, so that one compiled program serves every number of steps
    stepping = recording = ConstantSteps(steps=number)
    # the ends of steps inside a period are arrays, whose length a program must know: the most steps that it serves
    if records.inside:
        alike = bool(np.all(plan.steps == part.steps))
        recording = ConstantSteps(part.steps) if alike else ConstantSteps(part.capacity, number)
    early = records.from_start
    carry = initial_carry(early, scenes, states)
    # LAPACK must not be called from two threads
    if first and plan.transient.count and not calls_lapack(plan.solver):
        # a call of no periods: it compiles the recording program, and costs no steps
        none = dict(used=as_argument(0), earlier=initial_carry(records, scenes, states))
        of_record = dict(solver=plan.solver, periods=plan.recorded.capacity, records=records)
        ahead(lambda: advance(scenes, states, plan.epoch, recording, **none, **of_record))
    at, _ = run_span(part, scenes, at, plan.transient, stepping, early, carry, samples)
    probe = None
    if plan.probed:
        # the program of the transient, which is there already, serves this one period, too
        probe = half_step_change(
            scenes,
            at.states,
            at.period,
            [(part.steps, 1)],
            earlier=carry,
            solver=plan.solver,
            periods=plan.transient.capacity,
            records=early,
        )
    # what was carried through the transient is dropped: only samples are kept from the start on
    carry = initial_carry(records, scenes, at.states)
    at, carry = run_span(part, scenes, at, plan.recorded, recording, records, carry, samples)
    states = at.states
    status = records.judge(carry, at.status, scenes, plan.solver)
    if probe is not None:
        status = with_accuracy(status, probe)
    span = RecordedSpan(plan.recorded.periods, part.steps, plan.epoch + epoch, status)
    values = list(records.finish(carry, samples.joined(), span))
    strobe = next((a for r, a in zip(records.records, values, strict=True) if isinstance(r, LastStrobes)), None)
    # each stage begins from the same states, and adds to the status what it finds
    for stage in plan.stages:
        measured, status = stage.of_chunk(part, states, at.period, status, strobe)
        values.append(measured)
    return ChunkRun(states, status, tuple(values), probe)


class Passing(NamedTuple):
    """A chunk of cases on its way: states, place and statuses so far."""

    states: State
    period: float  # forcing periods from distance zero
    status: Int[np.ndarray, " lanes"]  # `slipperjax.Status` codes so far


def run_span(
    part: Part,
    scenes: Batched[Scene],
    at: Passing,
    calls: Calls,
    stepping: ConstantSteps,
    records: RecordSet,
    carry: tuple[PyTree, ...],
    samples: Samples,
) -> tuple[Passing, tuple[PyTree, ...]]:
    """Run a chunk over a span with equal steps, call by call.

    **Arguments:** `part`: the chunk; `scenes`: its cases, which wear may have changed; `at`: where the span begins;
    `calls`: its forcing periods; `stepping`: how each is integrated; `carry`: of the records before it; `samples`:
    to which those of the span are added.

    **Returns:** where the span ended, and the records' carry.
    """
    states, period, status = at
    for used in calls.lengths:
        part.on_progress(0)  # stops here after Ctrl-C
        passed = advance(
            scenes,
            states,
            period,
            stepping,
            used=as_argument(used),
            earlier=carry,
            solver=part.plan.solver,
            periods=calls.capacity,
            records=records,
        )
        states = passed.state
        carry = passed.carried
        status = first_problem(status, passed.status)
        # a program serves several numbers of periods: samples of periods beyond its use are cut off
        samples.add(records, jax.tree.map(lambda a, used=used: np.asarray(a)[:, :used], passed.samples))
        part.on_progress(used)
        period += used
    return Passing(states, period, status), carry


def half_step_change(
    scenes: Batched[Scene], states: State, epoch: float, spans: Sequence[tuple[int, int]], **options: object
) -> Float[np.ndarray, " lanes"]:
    """Return what half the step changes over some periods, in multiples of `slipperjax.model.accuracy_scales` [1].

    **Arguments:** `spans`: steps in each period, and number of periods, one after the other; `options`: of `advance`.
    """
    ends = []
    for finer in (1, 2):
        now, period = states, epoch
        for steps, used in spans:
            # numbers of steps are arguments of one program
            stepping = ConstantSteps(steps=as_argument(finer * steps))
            now = advance(scenes, now, period, stepping, used=as_argument(used), **options).state
            period += used
        ends.append(now.motion)
    return np.asarray(_distances(scenes, *ends))


@jit
def _distances(scenes: Batched[Scene], one: Motion, other: Motion) -> jax.Array:
    """Return distances of two motions of each case in the scales by which errors are judged [1]."""
    size = lambda scene, a, b: scaled_size(jax.tree.map(jnp.subtract, a, b), accuracy_scales(scene))
    return scenes.map(size, one, other)


def initial_carry(records: RecordSet, scenes: Batched[Scene], states: State) -> PyTree:
    """Return the carries of records that have seen no period, with a leading axis of lanes."""

    def first(tree):
        # on the host, where an entry of another shape needs no compilation
        return jax.tree.map(lambda a: np.asarray(a)[0], tree)

    lanes = len(states.motion.y)
    # shapes count and numbers do not, so one case stands for all
    one = records.begin(eqx.combine(first(scenes.varied), scenes.shared), first(states))
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), one)


class Run(NamedTuple):
    """Cases after a run, or after an interrupt."""

    # A named tuple of arrays with a leading axis of cases; unfinished cases have what `blank` gives.
    # None where no case was finished.
    results: PyTree
    finished: Bool[np.ndarray, " cases"]
    interrupted: bool

    def checked(self, make: Callable[[], object]) -> PyTree:
        """Return `make()`, a dataset of the results; raise `Interrupted` with it where the run was interrupted."""
        made = None if self.results is None else make()
        if self.interrupted:
            raise Interrupted(made, int(self.finished.sum()), len(self.finished))
        return made


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

    **Arguments:** `index`: indices of cases, of which one may come several times; others as for `run_chunks` and
    `Plan.chunks`.
    """
    listed = np.arange(plan.cases.count) if index is None else index
    chunks, threads = replace(plan, steps=plan.steps[listed]).chunks(chunk, workers, tangents=tangents)

    def of_chunk(chunk: Chunk, on_progress: OnProgress) -> PyTree:
        lanes = listed[chunk.index]  # chunks count within `index`, and parts in the list of all cases
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

    After Ctrl-C it returns with the chunks that are finished.

    **Arguments:**

    - `work`: returns a named tuple of arrays with a leading axis of lanes, one of them `status`. It calls
      `on_progress(n)` after n forcing periods, which raises where another chunk failed or the user interrupted, so
      that this chunk stops, too.
    - `periods`: forcing periods of one case in all.
    - `progress`, `name`: of `progress_shown`.
    """
    parts: list[PyTree] = [None] * len(chunks)
    cases = sum(chunk.cases for chunk in chunks)
    # the bar counts steps, to which time is proportional
    total = periods * sum(chunk.steps * chunk.cases for chunk in chunks)
    interrupted = False

    def one(k: int) -> None:
        chunk = chunks[k]

        def on_progress(passed: float) -> None:
            heed_interrupts()
            shown(chunk.steps * chunk.cases * passed)

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
    """Run tasks on threads of this process, or by an executor, the first ones first.

    After Ctrl-C, or an error of a task, the others are cancelled; those that run end after the call that they are in,
    where `heed_interrupts` raises. A warning says where they last longer than `patience`.

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
    except BrokenExecutor:  # which ends all tasks itself, and fails where it finds a cancelled one
        raise
    except BaseException:
        running = [future for future in futures if not future.cancel()]
        stop.set()
        if executor is None:
            wait(running, patience)
            _warn_of_running(sum(not future.done() for future in running))
        raise
    finally:
        if executor is None:
            pool.shutdown(wait=False)  # an executor belongs to the caller


def _warn_of_running(threads: int) -> None:
    """Warn where threads go on after their run."""
    if threads:
        warn(f"The run has ended, but {threads} of its threads will go on to the end of the call that they are in.")


def _in_order(chunks: Sequence[Chunk], parts: Sequence[PyTree], interrupted: bool) -> Run:
    """Return the chunks' results in the order of the cases, without the lanes that fill chunks up.

    **Arguments:** `parts`: the chunks' results; None for an unfinished one, whose cases become blank.
    """
    cases = sum(chunk.cases for chunk in chunks)
    finished = np.zeros(cases, bool)
    for chunk, part in zip(chunks, parts, strict=True):
        finished[chunk.index[: chunk.cases]] = part is not None
    like = next((part for part in parts if part is not None), None)
    if like is None:
        return Run(None, finished, interrupted)

    def joined(*arrays: np.ndarray) -> np.ndarray:
        ordered = np.empty((cases, *arrays[0].shape[1:]), arrays[0].dtype)
        for chunk, array in zip(chunks, arrays, strict=True):
            ordered[chunk.index[: chunk.cases]] = np.asarray(array)[: chunk.cases]
        return ordered

    whole = (blank(like, len(c.index)) if part is None else part for c, part in zip(chunks, parts, strict=True))
    return Run(jax.tree.map(joined, *whole), finished, interrupted)


@contextmanager
def progress_shown(
    total: float, cases: int, name: str, wanted: bool | None, **options: Any
) -> Iterator[Callable[..., None]]:
    """Show how far a run is: a bar on terminals and in notebooks, now and then a line in files and pipes.

    **Arguments:** `total`: all work, in any unit to which its time is proportional; `cases`: their number; `wanted`
    and `options`: of `slipperjax.tools.progress.bar`.

    **Yields:** `add(work, done)`, which threads call with the work just done and the number of cases just finished.
    """
    layout = "{desc}{percentage:3.0f}%" + ("|{bar}|" if is_live() else ",") + " {elapsed}, {remaining} left{postfix}"
    lock = threading.Lock()
    finished = 0
    # most runs compile two programs: of the transient, and of what is recorded
    with progress_bar(wanted, programs=2, total=total, desc=name, bar_format=layout, **options) as bar:

        def add(work: float, done: int = 0) -> None:
            nonlocal finished
            with lock:
                finished += done
                bar.set_postfix_str(f"{finished} of {cases} cases", refresh=False)
                # rounding may bring the sum above the total, which tqdm warns of
                bar.update(min(work, total - bar.n))

        yield add
