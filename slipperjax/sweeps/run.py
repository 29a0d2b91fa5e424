"""The one way in which many cases are run: planned, cut into chunks, and computed on threads with progress."""

import abc
import functools
import math
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Bool, Float, Int

from ..flow.period_map import advance
from ..flow.record import AbstractOutput, History, Labelled, RecordedSpan, RecordSet, Samples, Strobe, Unlabelled
from ..flow.simulate import beginning_of, check_rail, step_plan
from ..flow.status import Interrupted, Status, Stop, blank, first_problem, with_accuracy
from ..flow.stepping import ConstantSteps, capacity_for
from ..model.dynamics import State
from ..model.kinematics import Motion, accuracy_scales, scaled_size
from ..model.scene import Scene
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.checks import TOLD, require, whole
from ..tools.compile import ahead, as_argument, jit
from ..tools.limits import cores
from ..tools.progress import bar as progress_bar
from ..tools.progress import is_live
from .call import Call
from .estimate import Estimate
from .grid import VECTOR_LANES, Cases, Grid, batch_size, filled

LARGEST_CHUNK = 128
"""Cases in one call: enough for vectors to pay, few enough to stay in a core's cache. A step of a case takes 0.43 us
of one core with 8 cases, 0.35 with 32, 0.34 with 128, 0.36 with 256 and 0.45 with 1024."""
CHUNK_OF_DEVICE = 131_072
"""The same on other devices than a CPU, where each kernel is a launch, and one call uses the whole device."""
PERIODS_PER_CALL = 10
"""Forcing periods in one call of a search; transients above it are rounded up to its multiples."""
TICK = 0.25
"""Seconds between two looks at a run's threads."""

OnProgress = Callable[[float], Any]
"""Report progress in forcing periods; raise to stop."""


# --- plans ----------------------------------------------------------------------------------------------------------


def shared_capacity(most: int, steps: int) -> int:
    """Return the steps for which a recording program is compiled that takes `steps`, where others take up to `most`.

    At most 8 times `steps`: one program serves all unless their steps differ more than that.
    """
    while most // 8 >= steps:
        most //= 8
    return most


class Calls(NamedTuple):
    """A stretch of a run as calls of one compiled program."""

    length: int  # forcing periods in one call. Progress and Ctrl-C are polled between calls.
    count: int

    @classmethod
    def of(cls, periods: int) -> "Calls":
        """Return calls of 50 periods at most, or of all where `periods` has no divisor from 10 to 50."""
        length = max(periods, 1)
        if periods > 50:
            length = next((k for k in range(50, 9, -1) if periods % k == 0), periods)
        return cls(length, periods // length)

    @property
    def periods(self) -> int:
        """Forcing periods in all."""
        return self.length * self.count

    @property
    def capacity(self) -> int:
        """Forcing periods for which the program of one call is compiled; it serves shorter calls, too."""
        return PERIODS_PER_CALL if self.length == PERIODS_PER_CALL else capacity_for(self.length)


class Chunk(NamedTuple):
    """Cases that run as one batch."""

    index: Int[np.ndarray, " lanes"]  # indices into the list of all cases; the last is repeated to fill the batch
    cases: int  # how many of them count
    steps: int  # integration steps per forcing period, the same for all


@dataclass(frozen=True)
class Plan:
    """How a list of cases is run."""

    cases: Cases
    solver: AbstractSolver
    records: RecordSet
    steps: Int[np.ndarray, " cases"]  # integration steps per forcing period of each case
    transient: Calls  # periods that pass before anything is recorded
    recorded: Calls
    stages: "tuple[AbstractStage, ...]" = ()  # what is measured after the recorded periods
    probed: bool = False  # whether the first recorded period is repeated with half the step, for its error
    epoch: float = 0.0  # forcing periods from distance zero to where the run begins

    @property
    def outputs(self) -> tuple[AbstractOutput, ...]:
        """All that becomes variables of a dataset."""
        return (*self.records.records, *self.stages)

    @property
    def most_steps(self) -> int:
        """The most steps of any case."""
        return int(self.steps.max())

    def capacity(self, steps: int) -> int:
        """Return the steps per period for which a recording program is compiled that takes `steps`."""
        return shared_capacity(self.most_steps, steps)

    @property
    def periods(self) -> int:
        """Forcing periods of one case."""
        return self.transient.periods + self.recorded.periods

    def estimate(self, count: int) -> Estimate:
        """Return the estimate of `count` cases such as these."""
        periods = self.periods + periods_after(self.stages, self.recorded.periods)
        steps = periods * float(np.mean(self.steps))
        early = self.records.from_start.records
        values = 0
        for one in self.outputs:
            kept = self.periods if one in early else self.recorded.periods
            values += one.values(self.cases.scene, kept)
        return Estimate.counted(count, steps, values, f" of {periods} forcing periods")

    @property
    def record(self) -> str:
        """The attribute `record` of datasets."""
        return ", ".join(one.name for one in self.outputs if one.name)

    def check(self) -> None:
        """Raise `ValueError` where outputs do not suit the run, or each other."""
        labels = map(self.cases.label, self.cases.axes)
        check_variables(self.outputs, ("status", "steps_per_period", *self.cases.dims, *labels))
        for one in self.outputs:
            one.check(self.cases.scene, self.recorded.periods, int(self.steps.min()))

    def label(self, dims: tuple[str, ...], values: tuple[Any, ...]) -> Labelled:
        """Return variables and coordinates of a dataset from the values of all outputs, (*dims, ...)."""
        data = {}
        coords = {}
        for one, mine in zip(self.outputs, values, strict=True):
            more, along = one.label(self.cases.scene, dims, mine)
            data |= more
            coords |= along
        return data, coords

    def strobes(self, periods: int) -> "Plan":
        """Return the same with nothing but strobes for at least `periods`, in calls of `PERIODS_PER_CALL`."""
        recorded = Calls(PERIODS_PER_CALL, math.ceil(periods / PERIODS_PER_CALL))
        records = RecordSet((Strobe(),))
        return replace(self, records=records, stages=(), transient=Calls(1, 0), recorded=recorded)

    def chunks(self, chunk: int | None, workers: int | None, *, tangents: bool = False) -> tuple[list[Chunk], int]:
        """Cut the cases into chunks, those of most steps first; return them and the number of their threads.

        Neither changes any result.

        **Arguments:** `chunk`: cases per call, rounded up as by `batch_size`; by default what makes the run shortest.
        `workers`: threads, by default one per core. `tangents`: whether the calls take derivatives.
        """
        workers = cores() if workers is None else whole("workers", workers, 1)
        tangents = tangents or bool(self.stages)
        on_device = jax.default_backend() != "cpu"
        if on_device or calls_lapack(self.solver, tangents):
            workers = 1
        counts, sizes = np.unique(self.steps, return_counts=True)
        if chunk is None:
            chunk = min(int(sizes.max()), CHUNK_OF_DEVICE) if on_device else _best_chunk(counts, sizes, workers)
        # eight lanes round differently from more, so that they are for runs that have no more cases
        least = 1 if len(self.steps) <= VECTOR_LANES else VECTOR_LANES + 1
        chunk = batch_size(max(whole("chunk", chunk, 1), least))
        chunks = []
        for steps in counts[::-1]:
            members = np.flatnonzero(self.steps == steps)
            for first in range(0, len(members), chunk):
                index = members[first : first + chunk]
                chunks.append(Chunk(filled(index, chunk), len(index), int(steps)))
        return chunks, min(workers, len(chunks))


def _best_chunk(counts: np.ndarray, sizes: np.ndarray, workers: int) -> int:
    """Return the chunk size with which groups of `sizes` cases of `counts` steps are done soonest."""
    shares = {min(-(-int(n) // (workers * k)), LARGEST_CHUNK) for n in sizes for k in range(1, 7)}

    def duration(lanes):
        # whatever the lanes, a step takes as long as two of them: measured at 8 to 128 lanes
        costs = counts * (2 + lanes)
        total = float(np.sum(-(-sizes // lanes) * costs))
        # a run is not over before its longest chunk
        return max(total / workers, float(costs.max())), lanes

    return min((batch_size(share) for share in shares), key=duration)


class AbstractStage(AbstractOutput):
    """Something that is measured of the motions after the recorded span, for which derivatives are taken there.

    Subclasses are frozen dataclasses.
    """

    def periods_after(self, periods: int) -> int:
        """Return for how many forcing periods motions run on after so many recorded ones."""
        return 0

    @abc.abstractmethod
    def of_chunk(
        self,
        part: "Part",
        states: State,
        epoch: float,
        status: Int[np.ndarray, " lanes"],
        strobe: Float[np.ndarray, "lanes periods coordinates"] | None,
    ) -> tuple[Any, Int[np.ndarray, " lanes"]]:
        """Return arrays (lanes, ...) and `Status` codes of a chunk.

        **Arguments:** `states`: at the end of the recorded span, `epoch` forcing periods after distance zero;
        `strobe`: states once per period before, with `LastStrobes` among the records.
        """

    def of_all(
        self, values: Any, status: np.ndarray, plan: Plan, how: Any, interrupted: bool
    ) -> tuple[Any, np.ndarray, bool]:
        """Continue from what `of_chunk` gave of all cases; return values, `Status` codes, and whether it was
        interrupted. Cases that were not finished have `Status.NOT_RUN`.

        **Arguments:** `how`: of `run_cases`; `interrupted`: whether the run was, so that nothing is simulated.
        """
        return values, status, interrupted


def periods_after(stages: Sequence[AbstractStage], periods: int) -> int:
    """Return for how many forcing periods motions run on after so many recorded ones."""
    return max((one.periods_after(periods) for one in stages), default=0)


@dataclass(frozen=True)
class LastStrobes(Unlabelled):
    """States once per period at the end of the recorded span, for stages."""

    periods: int

    inside = False

    def last(self, periods):
        return min(self.periods, periods)

    def values(self, scene, periods):
        return 10 * self.last(periods)

    def sample(self, course):
        return course.end.motion


def check_variables(outputs: Sequence[AbstractOutput], existing: Collection[str]) -> None:
    """Raise `ValueError` where two outputs, or an output and a dataset that has `existing`, share a variable."""
    for name, count in Counter(name for one in outputs for name in one.variables).items():
        if count > 1:
            raise ValueError(f"Argument `record` must give each variable once, but gives `{name}` {count} times.")
        if name in existing:
            raise ValueError(f"Argument `record` must not give `{name}`, a name which the dataset has already.")


def sampled_plan(
    grid: Grid,
    start: Motion | State,
    call: Call,
    records: RecordSet = RecordSet(),
    stages: tuple[AbstractStage, ...] = (),
) -> Plan:
    """Return the plan of some thousand cases spread over a grid, which tells what all of them need.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    cases = grid.sample(start)  # first of all, so that implausible values are told
    grid.check_steps(call.steps_per_period)
    transient = call.settled
    if transient > PERIODS_PER_CALL:
        transient = math.ceil(transient / PERIODS_PER_CALL) * PERIODS_PER_CALL
    steps, saves = _steps_and_saves(cases, call)
    solver = resolve_solver(grid.scene, call.solver)
    # histories leave their saves to the run
    kept = (History(saves) if one == History() else one for one in records.records)
    lengths = Calls.of(transient), Calls.of(call.measured)
    plan = Plan(cases, solver, RecordSet(tuple(kept)), np.atleast_1d(steps), *lengths, stages)
    begin = beginning_of(grid.scene, call.begin)
    check_rail(grid.scene, plan.periods, begin, transient, periods_after(stages, call.measured))
    return plan


def make_plan(grid: Grid, start: Motion | State, call: Call, *outputs: Any) -> Plan:
    """Return the plan of a run from a user's arguments, records and stages.

    **Raises:** `ValueError` that names the argument which is wrong, or memory and time of an impossible run.
    """
    plan = sampled_plan(grid, start, call, *outputs)
    plan.estimate(grid.count).check()  # before all cases are made, which may not fit into memory
    cases = plan.cases
    steps = plan.steps
    if cases.count < grid.count:
        cases = grid.sample(start, grid.count)
        steps, _ = _steps_and_saves(cases, call)
    epoch = _epoch(cases, beginning_of(grid.scene, call.begin))
    plan = replace(plan, cases=cases, steps=np.broadcast_to(steps, cases.count), epoch=epoch)
    plan.check()
    return plan


def _steps_and_saves(cases: Cases, call: Call) -> tuple[Any, int]:
    """Return steps per period, one number or one for each case, and saves per period."""
    return step_plan(
        lambda: call.refine * cases.default_steps(),
        call.steps_per_period,
        call.saves_per_period,
    )


def _epoch(cases: Cases, begin: float) -> float:
    """Return the forcing periods from distance zero to where a run begins [m].

    **Raises:** `ValueError` where these differ between cases, which run as one batch.
    """
    if not begin:
        return 0.0
    lengths = np.unique(cases.wavelengths())
    need = "be zero where cases differ in the length of their forcing periods"
    require(len(lengths) == 1, "begin", need, begin)
    return begin / float(lengths[0])


# --- one chunk ------------------------------------------------------------------------------------------------------


class Part(NamedTuple):
    """A chunk of cases at work."""

    plan: Plan
    scenes: Batched[Scene]
    starts: Motion | State
    index: Int[np.ndarray, " lanes"]  # indices into the list of all cases
    # Indices into the list of those that this run takes, in whose order the results are.
    row: Int[np.ndarray, " lanes"]
    cases: int  # how many lanes count; the others fill the batch up
    steps: int  # integration steps per forcing period
    on_progress: OnProgress

    @property
    def capacity(self) -> int:
        """Steps per period that its recording programs have capacity for."""
        return self.plan.capacity(self.steps)

    def good(self, status: Int[np.ndarray, " lanes"]) -> Bool[np.ndarray, " lanes"]:
        """Return whether each lane counts, and nothing is wrong with it."""
        return (status == Status.FINITE) & (np.arange(len(status)) < self.cases)


class ChunkRun(NamedTuple):
    """A chunk of cases after its run."""

    state: State  # the states at the end, with a leading axis of lanes
    status: Int[np.ndarray, " lanes"]  # `slipperjax.Status` codes
    record: tuple[Any, ...]  # arrays of the plan's outputs, with a leading axis of lanes
    probe: Float[np.ndarray, " lanes"] | None = None  # errors by half the step [1]; None where not measured


def heed_interrupts(periods: float = 0.0) -> None:
    """Raise `KeyboardInterrupt` where this run is asked to end: an `OnProgress` for runs that show none."""
    if Stop.here().is_set():
        raise KeyboardInterrupt


def run_chunk(part: Part, states: State, epoch: float = 0.0, *, first: bool = False) -> ChunkRun:
    """Run a chunk of cases through its plan, from `epoch` forcing periods behind the place where the plan begins.

    Times in records count from there.

    **Arguments:** `first`: whether it is the first chunk of its run, of which the program that records is compiled
    while that of the transient is.
    """
    plan = part.plan
    scenes = part.scenes
    records = plan.records
    period = plan.epoch + epoch
    status = np.zeros(len(states.motion.y), int)
    samples = Samples(records, plan.recorded.periods)
    number = as_argument(part.steps)  # an array, so that one compiled program serves every number of steps
    stepping = recording = ConstantSteps(steps=number)
    if records.inside:
        alike = bool(np.all(plan.steps == part.steps))
        recording = ConstantSteps(part.steps) if alike else ConstantSteps(part.capacity, number)
    early = records.from_start
    probe = None

    def options_of(calls: Calls, kept: RecordSet) -> dict[str, Any]:
        return dict(solver=plan.solver, periods=calls.capacity, records=kept)

    def compile_recording() -> None:
        none = dict(used=as_argument(0), earlier=initial_carry(records, scenes, states))
        advance(scenes, states, period, recording, **none, **options_of(plan.recorded, records))

    if first and plan.transient.count and not calls_lapack(plan.solver):
        ahead(compile_recording)
    for calls, kept, chosen in ((plan.transient, early, stepping), (plan.recorded, records, recording)):
        options = options_of(calls, kept)
        if kept is records and plan.probed:
            # the program of the transient, which is there already, serves this one period, too
            once = dict(used=as_argument(1), earlier=initial_carry(early, scenes, states))
            once |= options_of(plan.transient, early)
            probe = half_step_change(scenes, states, period, part.steps, **once)
        carry = initial_carry(kept, scenes, states)
        used = as_argument(calls.length)
        for _ in range(calls.count):
            part.on_progress(0)
            passed = advance(scenes, states, period, chosen, used=used, earlier=carry, **options)
            states = passed.state
            carry = passed.carried
            status = first_problem(status, passed.status)
            # a program serves several numbers of periods: samples of periods beyond its use are cut off
            cut = jax.tree.map(lambda a, n=calls.length: np.asarray(a)[:, :n], passed.samples)
            samples.add(kept, cut)
            part.on_progress(calls.length)
            period += calls.length
    status = records.judge(carry, status, scenes, plan.solver)
    if probe is not None:
        status = with_accuracy(status, probe)
    span = RecordedSpan(plan.recorded.periods, part.steps, plan.epoch + epoch, status)
    values = list(records.finish(carry, samples.joined(), span))
    strobe = next((a for r, a in zip(records.records, values, strict=True) if isinstance(r, LastStrobes)), None)
    for stage in plan.stages:
        measured, status = stage.of_chunk(part, states, period, status, strobe)
        values.append(measured)
    return ChunkRun(states, status, tuple(values), probe)


def half_step_change(
    scenes: Batched[Scene], states: State, epoch: float, steps: int, **options: Any
) -> Float[np.ndarray, " lanes"]:
    """Return what half the step changes over some periods, in multiples of `slipperjax.model.accuracy_scales` [1].

    **Arguments:** `options`: of `advance`, with the number of periods.
    """
    numbers = [ConstantSteps(steps=as_argument(number)) for number in (steps, 2 * steps)]
    ends = (advance(scenes, states, epoch, number, **options).state.motion for number in numbers)
    return np.asarray(_distances(scenes, *ends))


@jit
def _distances(scenes: Batched[Scene], one: Motion, other: Motion) -> jax.Array:
    """Return distances of two motions of each case in the scales by which errors are judged [1]."""
    size = lambda scene, a, b: scaled_size(jax.tree.map(jnp.subtract, a, b), accuracy_scales(scene))
    return scenes.map(size, one, other)


def initial_carry(records: RecordSet, scenes: Batched[Scene], states: State) -> Any:
    """Return the carries of records that have seen no period, with a leading axis of lanes."""

    def first(tree):
        # on the host, where an entry of another shape needs no compilation
        return jax.tree.map(lambda a: np.asarray(a)[0], tree)

    lanes = len(states.motion.y)
    one = records.begin(eqx.combine(first(scenes.varied), scenes.shared), first(states))
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), one)


# --- all chunks -----------------------------------------------------------------------------------------------------


class Run(NamedTuple):
    """Cases after a run, or after an interrupt."""

    # A named tuple of arrays with a leading axis of cases; of cases that were not finished as `blank` makes them.
    # None where no case was finished.
    results: Any
    finished: Bool[np.ndarray, " cases"]
    interrupted: bool

    def checked(self, make: Callable[[], Any]) -> Any:
        """Return what `make()` makes of the results; raise `Interrupted` with it where the run was interrupted."""
        made = None if self.results is None else make()
        if self.interrupted:
            raise Interrupted(made, int(self.finished.sum()), len(self.finished))
        return made


def run_cases(
    plan: Plan,
    work: Callable[[Part], Any],
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

    **Arguments:** as for `run_chunks` and `Plan.chunks`.
    """
    listed = np.arange(plan.cases.count) if index is None else index
    chunks, threads = replace(plan, steps=plan.steps[listed]).chunks(chunk, workers, tangents=tangents)

    def of_chunk(chunk: Chunk, on_progress: OnProgress) -> Any:
        lanes = listed[chunk.index]
        cases = plan.cases.take(lanes)
        return work(Part(plan, *cases, lanes, *chunk, on_progress))

    return run_chunks(chunks, threads, of_chunk, periods=periods, progress=progress, name=name)


def run_chunks(
    chunks: Sequence[Chunk],
    workers: int,
    work: Callable[[Chunk, OnProgress], Any],
    *,
    periods: float,
    progress: bool | None,
    name: str = "",
) -> Run:
    """Call `work(chunk, on_progress)` for each chunk on `workers` threads, the first chunks first.

    After Ctrl-C what is finished is returned at once; a thread that is inside a call ends after it.

    **Arguments:** `work`: gives a named tuple of arrays with a leading axis of lanes and a field `status`; it calls
    `on_progress(n)` after n forcing periods. That raises where another chunk failed or the user interrupted, so that
    a chunk stops at its next call. `periods`: of one case in all. `progress`, `name`: of `progress_shown`.
    """
    parts: list[Any] = [None] * len(chunks)
    cases = sum(chunk.cases for chunk in chunks)
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
    return _in_order(chunks, list(parts), interrupted)


def gather(
    tasks: Sequence[Callable[[], Any]],
    threads: int,
    executor: Executor | None = None,
    done: Callable[[int], Any] = lambda k: None,
    patience: float = 0.0,
) -> None:
    """Run tasks on threads of this process, or by an executor, the first ones first.

    After Ctrl-C, or an error of a task, the others are cancelled; in those that run `heed_interrupts` raises.

    **Arguments:** `done`: called with the number of each task that has ended; `patience`: how long the end of running
    threads is waited for after Ctrl-C or an error [s].

    **Raises:** `KeyboardInterrupt` after Ctrl-C; the error of a task, or of the executor.
    """
    stop = Stop(Stop.here())
    pool = ThreadPoolExecutor(threads) if executor is None else executor
    context = copy_context()
    if TOLD.get() is None:
        context.run(TOLD.set, set())  # each kind of warning once
    futures: dict[Future, int] = {}
    try:
        for k, task in enumerate(tasks):
            future = context.run(stop.submit, pool, task) if executor is None else pool.submit(task)
            futures[future] = k
        while futures:
            for future in wait(futures, TICK, "FIRST_COMPLETED").done:
                future.result()
                done(futures.pop(future))
            heed_interrupts()
    except BrokenExecutor:  # which ends all tasks itself, and fails where it finds a cancelled one
        raise
    except BaseException:
        running = [future for future in futures if not future.cancel()]
        stop.set()
        if executor is None:
            wait(running, patience)
        raise
    finally:
        if executor is None:
            pool.shutdown(wait=False)


def _in_order(chunks: Sequence[Chunk], parts: Sequence[Any], interrupted: bool) -> Run:
    """Return the chunks' results in the order of the cases, without lanes that fill chunks up; None becomes blank."""
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
def progress_shown(total: float, cases: int, name: str, wanted: bool | None) -> Iterator[Callable[..., None]]:
    """Show how far a run is: a bar on terminals and in notebooks, now and then a line in files and pipes.

    **Arguments:** `total`: all work, in any unit to which its time is proportional; `cases`: how many; `wanted`: of
    `slipperjax.tools.progress.bar`.

    **Gives:** a function that threads call with work that is done, and the number of cases that are finished by it.
    """
    layout = "{desc}{percentage:3.0f}%" + ("|{bar}|" if is_live() else ",") + " {elapsed}, {remaining} left{postfix}"
    lock = threading.Lock()
    finished = 0
    # most runs compile two programs: of the transient, and of what is recorded
    with progress_bar(wanted, programs=2, total=total, desc=name, bar_format=layout) as bar:

        def add(work: float, done: int = 0) -> None:
            nonlocal finished
            with lock:
                finished += done
                bar.set_postfix_str(f"{finished} of {cases} cases", refresh=False)
                # rounding may bring the sum above the total, which tqdm warns of
                bar.update(min(work, total - bar.n))

        yield add
