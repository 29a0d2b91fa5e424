"""How cases are run: which compiled program, with how many steps, in which chunks. One way for all sweeps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
from jaxtyping import Int

from ..flow.record import RecordSet
from ..flow.series import Strobe
from ..flow.simulate import step_plan
from ..flow.stepping import capacity_for
from ..model.scene import Scene
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.checks import whole
from ..tools.limits import cores
from .grid import LANES, Cases, batch_size, filled, refuse_run

LARGEST_CHUNK = 128
"""Cases in one call: enough for vectors to pay, few enough to stay in a core's cache. A step of a case takes 0.43 us
of one core with 8 cases, 0.35 with 32, 0.34 with 128, 0.36 with 256 and 0.45 with 1024."""
CHUNK_OF_DEVICE = 131_072
"""The same on other devices than a CPU, where each kernel is a launch, and one call uses the whole device."""
START_OF_STEP = 2
"""Cost of a step that does not depend on the lanes, in lanes: measured at 8 to 128 lanes."""
PAUSE = 10
"""Periods in one call of a search; transients above it are rounded up to its multiples."""


class Calls(NamedTuple):
    """A stretch of a run as calls of one compiled program."""

    length: int
    """Forcing periods in one call. Progress and Ctrl-C are polled between calls."""
    count: int

    @property
    def periods(self) -> int:
        """Forcing periods in all."""
        return self.length * self.count

    @property
    def room(self) -> int:
        """Forcing periods that the program has room for, `PAUSE` or as by `slipperjax.flow.stepping.capacity_for`."""
        return PAUSE if self.length == PAUSE else capacity_for(self.length)


class Chunk(NamedTuple):
    """Cases that run as one batch."""

    index: Int[np.ndarray, " lanes"]
    """Places of the cases in the list of all; the last is repeated to fill the batch."""
    cases: int
    """How many of them count."""
    steps: int
    """Integration steps per forcing period, the same for all."""

    @property
    def cost(self) -> float:
        """What a forcing period costs, in steps of one lane."""
        return float(self.steps * (START_OF_STEP + len(self.index)))


@dataclass(frozen=True)
class Plan:
    """How a list of cases is run."""

    solver: diffrax.AbstractSolver
    records: RecordSet
    steps: Int[np.ndarray, " cases"]
    """Integration steps per forcing period of each case."""
    transient: Calls
    """What passes before anything is recorded."""
    recorded: Calls

    @property
    def most_steps(self) -> int:
        """The most steps of any case."""
        return int(self.steps.max())

    def room(self, steps: int) -> int:
        """Number of steps that a recording program has room for, so that it serves `steps` and other numbers.

        At most 8 times `steps`: one program serves all cases of a sweep unless their steps differ more than that.
        """
        most = self.most_steps
        while most // 8 >= steps:
            most //= 8
        return most

    @property
    def periods(self) -> int:
        """Forcing periods of one case."""
        return self.transient.periods + self.recorded.periods

    @property
    def values(self) -> int:
        """About how many numbers are kept of one case."""
        return self.records.values(self.transient.periods, self.recorded.periods)

    @property
    def work(self) -> float:
        """Cost of one case, in unrecorded forcing periods."""
        recorded = self.recorded.periods
        return self.transient.periods + self.records.cost * recorded + self.records.cost_after(recorded)

    def chunks(self, chunk: int | None, workers: int | None, *, tangents: bool = False) -> tuple[list[Chunk], int]:
        """The chunks, the most expensive first, and the number of threads to run them on. Neither changes any result.

        **Arguments:** `chunk`: cases per call, rounded up as by `batch_size`; by default what makes the run shortest.
        `workers`: threads, by default one per core. `tangents`: whether the calls take derivatives.
        """
        workers = cores() if workers is None else whole("workers", workers, 1)
        tangents = tangents or self.records.tangents
        on_device = jax.default_backend() != "cpu"
        if on_device or calls_lapack(self.solver, tangents):
            workers = 1
        counts, sizes = np.unique(self.steps, return_counts=True)
        if chunk is None:
            chunk = min(int(sizes.max()), CHUNK_OF_DEVICE) if on_device else _best_chunk(counts, sizes, workers)
        # eight lanes round differently from more, so that they are for runs that have no more cases
        least = 1 if len(self.steps) <= LANES else LANES + 1
        chunk = batch_size(max(whole("chunk", chunk, 1), least))
        found = []
        for steps in counts[::-1]:
            members = np.flatnonzero(self.steps == steps)
            for at in range(0, len(members), chunk):
                some = members[at : at + chunk]
                found.append(Chunk(filled(some, chunk), len(some), int(steps)))
        return found, min(workers, len(found))


def _best_chunk(counts: np.ndarray, sizes: np.ndarray, workers: int) -> int:
    """The chunk size with which groups of `sizes` cases of `counts` steps are done soonest."""
    shares = {min(-(-int(n) // (workers * k)), LARGEST_CHUNK) for n in sizes for k in range(1, 7)}

    def duration(lanes):
        costs = counts * (START_OF_STEP + lanes)
        total = float(np.sum(-(-sizes // lanes) * costs))
        # a run is not over before its longest chunk
        return max(total / workers, float(costs.max())), lanes

    return min((batch_size(share) for share in shares), key=duration)


def make_plan(
    scene: Scene,
    cases: Cases,
    *,
    records: RecordSet = RecordSet(),
    transient: int,
    periods: int,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
) -> Plan:
    """The plan of a run from a user's arguments, see `slipperjax.sweep`, and records.

    **Raises:** `ValueError` that names the argument which is wrong, or memory and time of an impossible run.
    """
    transient, periods = whole("transient", transient, 0), whole("periods", periods, 1)
    if np.ndim(steps_per_period) and (shape := np.asarray(steps_per_period).shape) != cases.shape:
        raise ValueError(
            f"Argument `steps_per_period` must be one number or one for each case, {cases.shape}, "
            f"but has shape {shape}."
        )
    steps, saves = step_plan(cases.default_steps, steps_per_period, saves_per_period)
    steps = np.full(cases.count, steps)
    records = records.with_saves(saves)
    taken = ("status", "steps_per_period", *cases.dims, *map(cases.label, cases.axes))
    records.check(scene, periods, int(steps.min()), taken)
    if transient > PAUSE:
        transient = math.ceil(transient / PAUSE) * PAUSE
    pause, block = _call_length(max(transient, 1)), _call_length(periods)
    plan = Plan(
        resolve_solver(scene, solver),
        records,
        steps,
        Calls(pause, transient // pause),
        Calls(block, periods // block),
    )
    refuse_run(cases.count, plan.work, plan.values, float(steps.sum()))
    return plan


def strobe_plan(plan: Plan, periods: int) -> Plan:
    """The same with nothing but strobes for at least `periods`, in calls of `PAUSE`."""
    return Plan(
        plan.solver, RecordSet((Strobe(),)), plan.steps, Calls(1, 0), Calls(PAUSE, math.ceil(periods / PAUSE))
    )


def _call_length(periods: int) -> int:
    """Forcing periods in one call of a stretch: a divisor of `periods`, 50 at most if it has one."""
    if periods <= 50:
        return periods
    return next((k for k in range(50, 9, -1) if periods % k == 0), periods)


OnProgress = Callable[[float], Any]
"""Called when work is done that takes as long as a number of forcing periods; raises where the run is to stop."""
