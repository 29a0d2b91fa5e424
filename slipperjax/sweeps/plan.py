"""Plans: steps, records and stages of a list of cases, and how the list is cut into chunks."""

import abc
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Bool, Int, PyTree

from ..flow.record import AbstractOutput, History, Labelled, RecordSet, Strobe, Unlabelled
from ..flow.simulate import beginning_of, check_rail, step_plan
from ..flow.status import Status
from ..flow.stepping import capacity_for
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.checks import known, require, whole
from ..tools.limits import cores
from .call import Call
from .estimate import Estimate
from .grid import VECTOR_LANES, Cases, Grid, batch_size, filled

LARGEST_CHUNK = 128
"""Most cases in one call by default: enough for vectors to pay, few enough to stay in a core's cache. A step of a
case takes 0.43 us of one core with 8 cases, 0.35 with 32, 0.34 with 128, 0.36 with 256 and 0.45 with 1024."""
CHUNK_OF_DEVICE = 131_072
"""The same on devices other than CPUs, where each kernel costs a launch, and one call uses the whole device."""
PERIODS_PER_CALL = 10
"""Forcing periods in one call of strobes; transients above it are rounded up to its multiples."""
OnProgress = Callable[[float], Any]
"""Report progress in forcing periods; raise to stop."""


def shared_capacity(most: int, steps: int) -> int:
    """Return the steps that a recording program has capacity for: `most` / 8^k, the least that is not below `steps`.

    So cases share one program unless their steps differ by more than a factor of 8.
    """
    while most // 8 >= steps:
        most //= 8
    return most


class Calls(NamedTuple):
    """A span of forcing periods as equal calls of one compiled program, the last of which may be shorter."""

    length: int  # forcing periods in one call. Progress and Ctrl-C are polled between calls.
    count: int  # of equal calls
    most: int = 0  # forcing periods in the longest call of the same program, where that is longer
    rest: int = 0  # forcing periods in one more, shorter call

    @classmethod
    def of(cls, periods: int) -> "Calls":
        """Return calls of 50 periods at most, of equal length where `periods` has a divisor from 10 to 50."""
        length = max(periods, 1)  # of no periods, none is called
        if periods > 50:
            length = next((k for k in range(50, 9, -1) if periods % k == 0), 50)
        return cls(length, periods // length, rest=periods % length)

    @property
    def periods(self) -> int:
        """Forcing periods in all."""
        return self.length * self.count + self.rest

    @property
    def lengths(self) -> list[int]:
        """Forcing periods in each call."""
        return [self.length] * self.count + [self.rest] * (self.rest > 0)

    @property
    def capacity(self) -> int:
        """Forcing periods for which the program of one call is compiled; it serves shorter calls, too."""
        # most transients and all searches have calls of this length, and a program of their own
        return PERIODS_PER_CALL if self.length == PERIODS_PER_CALL else capacity_for(max(self.length, self.most))


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

    @property
    def periods(self) -> int:
        """Forcing periods of one case."""
        return self.transient.periods + self.recorded.periods

    @property
    def periods_after(self) -> int:
        """Forcing periods for which motions run on after the recorded ones, for the stages."""
        return max((one.periods_after(self.recorded.periods) for one in self.stages), default=0)

    def estimate(self, count: int) -> Estimate:
        """Return the estimate of `count` cases such as these."""
        periods = self.periods + self.periods_after
        steps = periods * float(np.mean(self.steps))
        early = self.records.from_start.records  # which sample the transient, too
        values = 0
        for one in self.outputs:
            kept = self.periods if one in early else self.recorded.periods
            values += one.values(self.cases.scene, kept)
        # each thread has a batch
        rails = min(count, LARGEST_CHUNK * cores()) * self.cases.bytes_of_rail
        return Estimate.counted(count, steps, values, f" of {periods} forcing periods", rails)

    @property
    def record(self) -> str:
        """The attribute `record` of datasets."""
        return ", ".join(one.name for one in self.outputs if one.name)

    def check(self) -> None:
        """Raise `ValueError` where outputs do not suit the run, or each other."""
        check_variables(self.outputs, ("status", "steps_per_period", *self.cases.dims, *self.cases.axes))
        for one in self.outputs:
            one.check(self.cases.scene, self.recorded.periods, int(self.steps.min()))

    def label(self, dims: tuple[str, ...], values: tuple[PyTree, ...]) -> Labelled:
        """Return variables and coordinates of a dataset from the values of all outputs, (*dims, ...)."""
        data = {}
        coords = {}
        for one, mine in zip(self.outputs, values, strict=True):
            more, along = one.label(self.cases.scene, dims, mine)
            data |= more
            coords |= along
        return data, coords

    def strobes(self, periods: int) -> "Plan":
        """Return the same cases without a transient, of which strobes of `periods` or more are kept."""
        recorded = Calls(PERIODS_PER_CALL, math.ceil(periods / PERIODS_PER_CALL))
        records = RecordSet((Strobe(),))
        return replace(self, records=records, stages=(), transient=Calls(1, 0), recorded=recorded)

    def chunks(self, chunk: int | None, workers: int | None, *, tangents: bool = False) -> tuple[list[Chunk], int]:
        """Cut the cases into chunks of equal steps, and choose the number of threads. Neither changes any result.

        **Arguments:** `chunk`: cases per call, rounded up as by `batch_size`; by default what makes the run shortest.
        `workers`: threads, by default one per core. `tangents`: whether the calls take derivatives.

        **Returns:** the chunks, those of most steps first, and the number of threads.
        """
        workers = cores() if workers is None else whole("workers", workers, 1)
        tangents = tangents or bool(self.stages)
        on_device = jax.default_backend() != "cpu"
        if on_device or calls_lapack(self.solver, tangents):
            workers = 1
        # cases of one batch take the same steps
        counts, sizes = np.unique(self.steps, return_counts=True)
        if chunk is None:
            chunk = min(int(sizes.max()), CHUNK_OF_DEVICE) if on_device else _best_chunk(counts, sizes, workers)
        # eight lanes round differently from more, so that they are for runs that have no more cases
        least = 1 if len(self.steps) <= VECTOR_LANES else VECTOR_LANES + 1
        chunk = batch_size(max(whole("chunk", chunk, 1), least))
        chunks = []
        for steps in counts[::-1]:  # the longest chunk must not be the last to begin
            members = np.flatnonzero(self.steps == steps)
            for first in range(0, len(members), chunk):
                index = members[first : first + chunk]
                chunks.append(Chunk(filled(index, chunk), len(index), int(steps)))
        return chunks, min(workers, len(chunks))


def _best_chunk(counts: np.ndarray, sizes: np.ndarray, workers: int) -> int:
    """Return the chunk size with which groups of `sizes` cases of `counts` steps are done soonest."""
    # sizes that give each group one to six chunks for every worker
    shares = {min(-(-int(n) // (workers * k)), LARGEST_CHUNK) for n in sizes for k in range(1, 7)}

    def duration(lanes):
        # whatever the lanes, a step takes as long as two of them: measured at 8 to 128 lanes
        costs = counts * (2 + lanes)
        total = float(np.sum(-(-sizes // lanes) * costs))
        # a run is not over before its longest chunk
        return max(total / workers, float(costs.max())), lanes

    return min((batch_size(share) for share in shares), key=duration)


class AbstractStage(AbstractOutput):
    """A measurement of motions after the recorded periods, such as exponents, by derivatives of the period map.

    It is made in two steps: `of_chunk` of each chunk when its recorded span ends, then `of_all` of all cases.
    Subclasses are frozen dataclasses.
    """

    def periods_after(self, periods: int) -> int:
        """Return the forcing periods for which motions run on, after so many recorded ones."""
        return 0

    @abc.abstractmethod
    def of_chunk(
        self,
        part: "Part",
        states: State,
        epoch: float,
        status: Int[np.ndarray, " lanes"],
        strobe: Motion | None,
    ) -> tuple[PyTree, Int[np.ndarray, " lanes"]]:
        """Return values of a chunk, arrays (lanes, ...), and its `Status` codes.

        **Arguments:** `states`: at the end of the recorded span, `epoch` forcing periods after distance zero;
        `strobe`: motions at the ends of the periods before, (lanes, periods); None without the record `LastStrobes`.
        """

    def of_all(
        self, values: PyTree, status: np.ndarray, plan: Plan, how: Mapping[str, object], interrupted: bool
    ) -> tuple[PyTree, np.ndarray, bool]:
        """Return values from those of `of_chunk`, `Status` codes of all cases, and whether it was interrupted.

        Cases that were not finished have `Status.NOT_RUN`.

        **Arguments:** `how`: options of `run_cases`; `interrupted`: whether the run was, so that nothing more is
        simulated.
        """
        return values, status, interrupted


@dataclass(frozen=True)
class LastStrobes(Unlabelled):
    """Motions once per period at the end of the recorded span, for stages; no variable."""

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
    """Return the plan of at most 4096 cases spread over a grid, from which the cost of all is estimated.

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
    # stages travel further along the rail than the plan itself
    begin = beginning_of(grid.scene, known("begin", call.begin))
    check_rail(grid.scene, plan.periods, begin, transient, plan.periods_after)
    return plan


def make_plan(grid: Grid, start: Motion | State, call: Call, *outputs: RecordSet | tuple[AbstractStage, ...]) -> Plan:
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


def _steps_and_saves(cases: Cases, call: Call) -> tuple[int | np.ndarray, int]:
    """Return steps per period, one number or one for each case, and saves per period."""
    return step_plan(
        lambda: call.refine * cases.default_steps(),
        call.steps_per_period,
        call.saves_per_period,
    )


def _epoch(cases: Cases, begin: float) -> float:
    """Return the forcing periods from distance zero to where a run begins [m].

    **Raises:** `ValueError` where these differ between cases: calls of a batch begin at one number of periods.
    """
    if not begin:
        return 0.0
    lengths = np.unique(cases.wavelengths())
    need = "be zero where cases differ in the length of their forcing periods"
    require(len(lengths) == 1, "begin", need, begin)
    return begin / float(lengths[0])


class Part(NamedTuple):
    """A chunk of cases at work."""

    plan: Plan
    scenes: Batched[Scene]
    starts: Motion | State
    index: Int[np.ndarray, " lanes"]  # indices into the list of all cases
    # Indices into the list of the cases that this run takes; results are in its order.
    row: Int[np.ndarray, " lanes"]
    cases: int  # how many lanes count; the others fill the batch up
    steps: int  # integration steps per forcing period
    on_progress: OnProgress

    @property
    def capacity(self) -> int:
        """Steps per period that its recording programs have capacity for."""
        return shared_capacity(self.plan.most_steps, self.steps)

    def good(self, status: Int[np.ndarray, " lanes"]) -> Bool[np.ndarray, " lanes"]:
        """Return whether each lane is a case, with which nothing is wrong."""
        return (status == Status.FINITE) & (np.arange(len(status)) < self.cases)
