"""Plans: steps, records and stages of a list of cases, and the division of the list into chunks."""

import abc
import functools
import itertools
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
import xarray as xr
from diffrax import AbstractSolver
from jaxtyping import Bool, Int, PyTree

from ..flow.datasets import result_dataset, run_attributes, scene_attributes
from ..flow.period_map import initial_states
from ..flow.record import AbstractOutput, Labelled, RecordSet, Strobe, Unlabelled
from ..flow.status import Status, heed_interrupts
from ..flow.stepping import ROOM, ConstantSteps
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..orbits.simulate import dynamic_steps
from ..solvers.latching import calls_lapack, solver_name
from ..tools.batching import Batched
from ..tools.checks import whole
from ..tools.compile import as_argument
from ..tools.limits import cores
from .estimate import Estimate
from .grid import VECTOR_LANES, Cases, batch_size, filled
from .schedule import FEW, STEP_IN_LANES, Schedule, Span, shared_capacity

LARGEST_CHUNK = 128
"""Most cases in one call by default: enough to use vectors well, few enough for a core's cache. A step of a case
takes 0.80 us of one core with 8 cases, 0.59 with 32, 0.54 with 124, 0.55 with 256 and 0.57 with 1024."""
LARGEST_BENDING = 32
"""The same number on rails that bend, whose waves fill the cache. A step of a case takes 1.5 us of one core with 24
speeds, 1.6 with 32, 2.5 with 64 and 3.2 with 124."""
CHUNK_OF_DEVICE = 131_072
"""The same number on devices other than CPUs, where kernels cost a launch and one call uses the whole device."""
CAPACITY_OF_A_PROGRAM = 100_000
"""Number of steps, of all periods of a program together, below which programs share the next larger capacity, because
compilation takes longer than the steps."""
OnProgress = Callable[[float], Any]
"""Reports progress in forcing periods; raises to stop."""


def largest_chunk(scene: Scene) -> int:
    """Return the most cases in one call by default."""
    return LARGEST_CHUNK if scene.beam is None else LARGEST_BENDING


@dataclass(frozen=True)
class Plan:
    """Plan for running a list of cases."""

    cases: Cases
    solver: AbstractSolver
    records: RecordSet
    schedules: tuple[Schedule, ...]
    which: Int[np.ndarray, " cases"]  # the schedule of each case
    stages: "tuple[AbstractStage, ...]" = ()  # measurements after the recorded periods
    epoch: float = 0.0  # forcing periods from distance zero to the beginning of the run

    @property
    def outputs(self) -> tuple[AbstractOutput, ...]:
        """All outputs that become variables of a dataset."""
        return (*self.records.records, *self.stages)

    @functools.cached_property
    def early(self) -> RecordSet:
        """The records that also sample the transient."""
        return self.records.from_start

    @property
    def steps(self) -> Int[np.ndarray, " cases"]:
        """The greatest number of integration steps in a forcing period, for each case."""
        return np.array([one.steps for one in self.schedules])[self.which]

    @property
    def settled(self) -> int:
        """Forcing periods before the recorded periods of one case."""
        return self.schedules[0].settled

    @property
    def recorded(self) -> int:
        """Recorded forcing periods of one case."""
        return self.schedules[0].recorded

    @property
    def periods(self) -> int:
        """Forcing periods of one case."""
        return self.settled + self.recorded

    @property
    def periods_after(self) -> int:
        """Forcing periods for which motions continue after the recorded periods, for the stages."""
        return max((one.periods_after(self.recorded) for one in self.stages), default=0)

    def seen(self, span: Span) -> RecordSet:
        """Return the records that sample a span."""
        return self.records if span.recorded else self.early

    def room(self, records: RecordSet) -> int:
        """Return the forcing periods for which programs with these records are compiled."""
        # where states inside periods are recorded, unused periods need memory
        longest = max(span.periods for one in self.schedules for span in one.spans if span.recorded)
        return FEW if records.inside and longest <= FEW else ROOM

    def program(self, records: RecordSet, carry: PyTree, used: int) -> dict[str, Any]:
        """Return the options of `advance` for a call of `used` periods.

        **Arguments:** `carry`: of the records, from the periods before.
        """
        options = dict(solver=self.solver, periods=self.room(records), records=records)
        return options | dict(used=as_argument(used), earlier=carry)

    def stepping(self, steps: int, records: RecordSet) -> ConstantSteps:
        """Return the stepping of periods with `steps` steps; few steppings, because each program must be compiled."""
        if not records.inside:
            return dynamic_steps(steps)
        # the ends of steps are arrays of a fixed length in a program: the most steps that it serves
        one = len(self.capacities) == 1
        return ConstantSteps(steps) if one else ConstantSteps(self.capacities[steps], as_argument(steps))

    @functools.cached_property
    def capacities(self) -> dict[int, int]:
        """Capacities for steps of the programs of recorded periods, by the steps in a period."""
        cases = np.bincount(self.which, minlength=len(self.schedules))
        periods: Counter[int] = Counter()
        for one, count in zip(self.schedules, cases.tolist(), strict=True):
            for span in one.spans:
                periods[span.steps] += span.recorded * span.periods * count
        most = max(periods)
        own = {steps: shared_capacity(most, steps) for steps in periods}
        # short runs use a larger capacity than they need
        for size, larger in itertools.pairwise(sorted(set(own.values()))):
            members = [steps for steps in own if own[steps] == size]
            if larger * sum(periods[steps] for steps in members) < CAPACITY_OF_A_PROGRAM:
                own |= dict.fromkeys(members, larger)
        return own

    def estimate(self, count: int) -> Estimate:
        """Return the estimate of `count` cases like these."""
        periods = self.periods + self.periods_after
        each = np.array([one.mean_steps for one in self.schedules])[self.which]
        steps = periods * float(np.mean(each))
        values = 0
        for one in self.outputs:
            kept = self.periods if one in self.early.records else self.recorded
            values += one.values(self.cases.scene, kept)
        # each thread has a batch
        rails = min(count, largest_chunk(self.cases.scene) * cores()) * self.cases.bytes_of_rail
        return Estimate.counted(count, steps, values, f" of {periods} forcing periods", rails)

    @property
    def record(self) -> str:
        """The attribute `record` of datasets."""
        return ", ".join(one.name for one in self.outputs if one.name)

    def check(self) -> None:
        """Raise `ValueError` where outputs do not fit to the run, or to each other."""
        existing = ("status", "steps_per_period", *self.cases.dims, *self.cases.axes)
        for name, count in Counter(name for one in self.outputs for name in one.variables).items():
            if count > 1:
                raise ValueError(f"Argument `record` must give each variable once, but gives `{name}` {count} times.")
            if name in existing:
                raise ValueError(f"Argument `record` must not give `{name}`, a name which the dataset has already.")
        for one in self.outputs:
            one.check(self.cases.scene, self.recorded, int(self.steps.min()))

    def label(self, dims: tuple[str, ...], values: tuple[PyTree, ...]) -> Labelled:
        """Return variables and coordinates of a dataset from the values of all outputs, (*dims, ...)."""
        data = {}
        coords = {}
        for one, mine in zip(self.outputs, values, strict=True):
            more, along = one.label(self.cases.scene, (*dims, *self.axis(one)), mine)
            data |= more
            coords |= along
        return data, coords

    def dataset(
        self,
        data: Mapping[str, object],
        coords: Mapping[str, object],
        call: Mapping[str, object],
        facts: Mapping[str, object],
        varied: Collection[str] | None = None,
    ) -> xr.Dataset:
        """Return a dataset over the cases, with attributes from which they can be run again.

        **Arguments:** `call`: arguments by name; `facts`: further attributes; `varied`: names of its axes, by default
        all.
        """
        cases = self.cases
        varied = cases.axes if varied is None else varied
        attrs = scene_attributes(cases.scene, without=varied)
        attrs |= run_attributes(cases.scene, cases.start, {**call, "solver": self.solver}, varied)
        attrs |= {**facts, "solver": solver_name(self.solver), "record": self.record}
        return result_dataset(data, {**coords, **cases.coordinates()}, attrs)

    def begun(self, index: Int[np.ndarray, " lanes"]) -> tuple[Batched[Scene], Motion | State]:
        """Return the scenes and the starts with which some cases run."""
        return self.cases.take(index)

    def axis(self, output: AbstractOutput) -> tuple[str, ...]:
        """Return the dimension along which the values of several stretches follow each other."""
        return ()

    def joined(self, made: Sequence[tuple[PyTree, ...]]) -> list[PyTree]:
        """Return the values of each record, (lanes, ...), from the values of each stretch."""
        (values,) = made
        return list(values)

    def strobes(self, settled: int, periods: int) -> "Plan":
        """Return the same cases with another transient, for which strobes of `periods` are kept."""
        schedules = tuple(Schedule.of(settled, periods, one.steps) for one in self.schedules)
        return replace(self, records=RecordSet((Strobe(),)), schedules=schedules, stages=())

    def chunks(
        self,
        chunk: int | None = None,
        workers: int | None = None,
        *,
        index: Int[np.ndarray, " some"] | None = None,
        tangents: bool = False,
    ) -> tuple[list["Part"], int]:
        """Cut the cases into chunks of equal steps, and choose the number of threads. Both do not change results.

        **Arguments:** `chunk`: cases per call, rounded up as by `batch_size`; by default the number with the shortest
        run. `workers`: threads, by default one per core. `index`: indices of cases, which may repeat; by default all.
        `tangents`: whether the calls compute derivatives.

        **Returns:** the chunks, those with most steps first, and the number of threads.
        """
        workers = cores() if workers is None else whole("workers", workers, 1)
        tangents = tangents or bool(self.stages)
        on_device = jax.default_backend() != "cpu"
        if on_device or calls_lapack(self.solver, tangents):
            workers = 1
        # cases of one batch have the same schedule; the longest chunk must not begin last
        index = np.arange(self.cases.count) if index is None else index
        which = self.which[index]
        present, sizes = np.unique(which, return_counts=True)
        counts = np.array([self.schedules[k].work for k in present])
        if chunk is None and on_device:
            chunk = min(int(sizes.max()), CHUNK_OF_DEVICE)
        elif chunk is None:
            chunk = _best_chunk(counts, sizes, workers, largest_chunk(self.cases.scene))
        # eight cases round differently from more cases, so that eight are used only in runs without more cases
        least = 1 if len(index) <= VECTOR_LANES else VECTOR_LANES + 1
        chunk = batch_size(max(whole("chunk", chunk, 1), least))
        parts = []
        for k in present[np.argsort(-counts, kind="stable")]:
            members = np.flatnonzero(which == k)
            for first in range(0, len(members), chunk):
                some = members[first : first + chunk]
                row = filled(some, chunk)
                parts.append(Part(self, index[row], row, len(some), self.schedules[k]))
        return parts, min(workers, len(parts))


def _best_chunk(counts: np.ndarray, sizes: np.ndarray, workers: int, largest: int) -> int:
    """Return the chunk size, about `largest` at most, with which groups of `sizes` cases end first."""
    # sizes that give each group one to six chunks for every worker
    shares = {min(-(-int(n) // (workers * k)), largest) for n in sizes for k in range(1, 7)}

    def duration(lanes):
        costs = counts * (STEP_IN_LANES + lanes)
        total = float(np.sum(-(-sizes // lanes) * costs))
        # a run cannot end before its longest chunk
        return max(total / workers, float(costs.max())), lanes

    return min((batch_size(share) for share in shares), key=duration)


class AbstractStage(AbstractOutput):
    """A measurement of motions after the recorded periods, such as exponents, with derivatives of the period map.

    It has two parts: `of_chunk` for each chunk when its recorded span ends, then `of_all` for all cases.
    Subclasses are frozen dataclasses.
    """

    def periods_after(self, periods: int) -> int:
        """Return the forcing periods for which motions continue after `periods` recorded periods."""
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

        **Arguments:** `how`: options of `run_cases`; `interrupted`: whether the run was interrupted, so that no more
        is simulated.
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


@dataclass(frozen=True, eq=False)
class Part:
    """Cases of a plan that run as one batch."""

    plan: Plan
    index: Int[np.ndarray, " lanes"]
    """Indices into the plan's cases; the last is repeated to fill the batch."""
    row: Int[np.ndarray, " lanes"]
    """Places of the cases in the results of the run."""
    cases: int
    """Number of cases that count; the others fill the batch up."""
    schedule: Schedule
    on_progress: OnProgress = heed_interrupts

    @functools.cached_property
    def begun(self) -> tuple[Batched[Scene], Motion | State]:
        """Scenes and starts of the cases, made when they are first used."""
        return self.plan.begun(self.index)

    @property
    def scenes(self) -> Batched[Scene]:
        """The scenes with which the cases run."""
        return self.begun[0]

    @property
    def states(self) -> State:
        """The states with which the cases begin."""
        return initial_states(*self.begun, self.plan.epoch)

    @property
    def steps(self) -> int:
        """The greatest number of integration steps in a forcing period."""
        return self.schedule.steps

    @property
    def capacity(self) -> int:
        """Steps per period for which its recording programs have places."""
        return self.plan.capacities[self.steps]

    def good(self, status: Int[np.ndarray, " lanes"]) -> Bool[np.ndarray, " lanes"]:
        """Return whether each place of the batch is a case with which nothing is wrong."""
        return (status == Status.FINITE) & (np.arange(len(status)) < self.cases)
