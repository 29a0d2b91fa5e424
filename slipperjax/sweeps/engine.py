"""The engine of all sweeps and runs: batches of cases through their periods, on threads, with progress and Ctrl-C."""

import functools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from ..flow.period_map import advance
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
from ..tools.checks import told_once, warn
from ..tools.compile import ahead, jit
from ..tools.progress import bar as progress_bar, is_live
from ..tools.types import Real
from .plan import LastStrobes, Part, Plan
from .schedule import probed

TICK = 0.25
"""Seconds between two checks of a run's threads and of Ctrl-C."""
PATIENCE = 1.0
"""Seconds of waiting for threads after Ctrl-C: most calls are shorter, unless they compile."""


class PartRun(NamedTuple):
    """A part of the cases after its run."""

    state: State  # the states at the end, with a leading axis of lanes
    status: Int[np.ndarray, " lanes"]  # `slipperjax.Status` codes
    # arrays of the plan's outputs, with a leading axis of lanes
    record: tuple[PyTree, ...]
    probe: Float[np.ndarray, "lanes probes"]  # errors, measured with half the step [1]

    def over(self, shape: tuple[int, ...]) -> "PartRun":
        """Return the results of all cases over a grid, without the numbers of lost cases."""
        known = without_lost(self._replace(state=None), self.status)
        return jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), known)


def run_part(part: Part, states: State, epoch: float = 0.0, *, first: bool = False) -> PartRun:
    """Run a part through its schedule and the stages of its plan.

    **Arguments:** `states`: at the start; `epoch`: forcing periods from the plan's beginning to the beginning of this
    run, from which times in records count; `first`: whether it is the first part of its run; its programs are
    compiled at the same time.
    """
    plan = part.plan
    schedule = part.schedule
    period = plan.epoch + epoch  # forcing periods from distance zero
    if first:
        _compile_ahead(part, states, period)
    status = judged = np.zeros(len(part.index), int)
    records = RecordSet()
    carry: tuple[PyTree, ...] = ()
    # changes by half the step, at each place where the error is measured [1]
    errors: list[Float[np.ndarray, " lanes"]] = []
    made = []
    coming = schedule.spans
    for stretch in schedule.stretches:
        recorded = sum(span.periods for span in stretch if span.recorded)
        samples = Samples(plan.records, recorded)
        begin = period
        for span in stretch:
            if plan.seen(span) != records:
                # these records begin here; other records sampled the spans before
                records = plan.seen(span)
                carry = initial_carry(records, part.scenes, states)
            part.on_progress(0)  # stops here after Ctrl-C
            if span.probed:
                errors.append(_change(part, states, period, records, carry, probed(coming)))
            coming = coming[1:]
            stepping = plan.stepping(span.steps, records)
            # progress counts equal steps
            share = span.steps / schedule.mean_steps
            for used in calls_of(span.periods):
                part.on_progress(0)
                program = plan.program(records, carry, used)
                states, sampled, code, _, carry = advance(part.scenes, states, period, stepping, **program)
                status = first_problem(status, code)
                # samples of unused periods are cut off, by a copy that does not keep them in memory
                samples.add(records, jax.tree.map(lambda a, used=used: np.array(a[:, :used]), sampled))
                part.on_progress(used * share)
                period += used
        judged = records.judge(carry, status, part.scenes, plan.solver)
        if errors:
            judged = with_accuracy(judged, np.max(errors, axis=0))
        steps = max(span.steps for span in stretch)
        passed = RecordedSpan(recorded, steps, begin, judged, part.scenes, states)
        made.append(records.finish(carry, samples.joined(), passed))
        carry = records.renewed(carry, initial_carry(records, part.scenes, states))
    values = plan.joined(made)
    strobe = next((a for r, a in zip(plan.records.records, values, strict=True) if isinstance(r, LastStrobes)), None)
    # each stage begins from the same states, and adds its findings to the status
    for stage in plan.stages:
        measured, judged = stage.of_chunk(part, states, period, judged, strobe)
        values.append(measured)
    probe = np.stack(errors, axis=1) if errors else np.empty((len(judged), 0))
    return PartRun(states, judged, tuple(values), probe)


def _compile_ahead(part: Part, states: State, period: float) -> None:
    """Compile all programs of a part except the first at the same time, by calls of zero periods."""
    plan = part.plan
    # LAPACK must not be called from two threads
    if calls_lapack(plan.solver):
        return
    programs: dict[tuple[RecordSet, int | None], ConstantSteps] = {}
    for span in part.schedule.spans:
        if span.periods:
            if span.probed:
                programs.setdefault((plan.early, None), dynamic_steps(span.steps))
            seen = plan.seen(span)
            stepping = plan.stepping(span.steps, seen)
            programs.setdefault((seen, stepping.most), stepping)
    for (records, _), stepping in list(programs.items())[1:]:
        program = plan.program(records, initial_carry(records, part.scenes, states), 0)
        ahead(functools.partial(advance, part.scenes, states, period, stepping, **program))


def _change(
    part: Part,
    states: State,
    period: float,
    records: RecordSet,
    carry: PyTree,
    periods: Sequence[tuple[int, int]],
) -> Float[np.ndarray, " lanes"]:
    """Return the change by half the step over some periods, in multiples of `accuracy_scales` [1].

    **Arguments:** `periods`: steps in each period, and number of periods, one after the other.
    """
    scenes = part.scenes
    if records.feeds_back:
        scenes = _fed_back(scenes, carry, period, records=records)
    # with the program of a transient, which may already exist
    early = part.plan.early
    carry = initial_carry(early, scenes, states)
    ends = []
    for finer in (1, 2):
        end = states
        at = period
        for steps, number in periods:
            for used in calls_of(number):
                program = part.plan.program(early, carry, used)
                end = advance(scenes, end, at, dynamic_steps(finer * steps), **program).state
                at += used
        ends.append(end.motion)
    return np.asarray(_distances(scenes, *ends))


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
        """Return `make()`, made of the results; raise `Interrupted` with it where the run was interrupted."""
        made = None if self.results is None else make()
        if self.interrupted:
            raise Interrupted(made, self.finished, self.cases)
        return made


def run_plan(plan: Plan, how: Mapping[str, Any]) -> Run:
    """Run all cases of a plan from their starts, with the measurements of its stages over all cases.

    **Arguments:** `how`: options of `run_cases`.
    """
    # the first part compiles the programs that most other parts also use
    work = lambda part: run_part(part, part.states, first=bool(part.row[0] == 0))
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

    **Arguments:** as for `run_parts` and `Plan.chunks`.
    """
    parts, threads = plan.chunks(chunk, workers, index=index, tangents=tangents)
    return run_parts(parts, threads, work, periods=periods, progress=progress, name=name)


def run_parts(
    parts: Sequence[Part],
    workers: int,
    work: Callable[[Part], PyTree],
    *,
    periods: float,
    progress: bool | None,
    name: str = "",
) -> Run:
    """Call `work(part)` for each part on `workers` threads, the first parts first.

    After Ctrl-C it returns the results of the finished parts.

    **Arguments:**

    - `work`: returns a named tuple of arrays with a leading axis of cases, one of them `status`. It calls
      `part.on_progress(n)` after n forcing periods. This call raises where another part failed or the user
      interrupted, so that this part also stops.
    - `periods`: forcing periods of one case in all.
    - `progress`, `name`: of `progress_shown`.
    """
    results: list[PyTree] = [None] * len(parts)
    cases = sum(part.cases for part in parts)
    # the bar counts steps, because time is proportional to steps
    total = periods * sum(part.schedule.mean_steps * part.cases for part in parts)
    interrupted = False

    def one(k: int) -> None:
        part = parts[k]

        def on_progress(passed: float) -> None:
            heed_interrupts()
            shown(part.schedule.mean_steps * part.cases * passed)

        results[k] = work(replace(part, on_progress=on_progress))
        shown(0.0, part.cases)

    with progress_shown(total, cases, name, progress) as shown:
        try:
            gather([functools.partial(one, k) for k in range(len(parts))], workers)
        except KeyboardInterrupt:
            interrupted = True
    # a copy, because threads that still run may add to the list
    return _in_order(parts, list(results), interrupted)


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
    futures: dict[Future, int] = {}
    try:
        # threads of this process get its context variables and its stop; tasks of an executor may be pickled
        with told_once():
            for k, task in enumerate(tasks):
                future = stop.submit(pool, task) if executor is None else pool.submit(task)
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


def _in_order(parts: Sequence[Part], results: Sequence[PyTree], interrupted: bool) -> Run:
    """Return results in the order of the cases, without the copies that fill up batches.

    **Arguments:** `results`: of each part; None for an unfinished part, whose cases become blank.
    """
    cases = sum(part.cases for part in parts)
    like = next((result for result in results if result is not None), None)
    if like is None:
        return Run(None, cases, interrupted)

    def joined(*arrays: np.ndarray) -> np.ndarray:
        ordered = np.empty((cases, *arrays[0].shape[1:]), arrays[0].dtype)
        for part, array in zip(parts, arrays, strict=True):
            ordered[part.row[: part.cases]] = np.asarray(array)[: part.cases]
        return ordered

    whole = (blank(like, len(p.row)) if found is None else found for p, found in zip(parts, results, strict=True))
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
