"""Whether chaos lasts: several longer motions from a chaotic one, which may become regular, and their exponents.

A chaotic transient cannot be told from chaos by what happens while it lasts, whatever is measured. Therefore some
motions are begun beside its last state. They forget each other within tens of periods, so each is one more trial of
how long the transient may last; and because their records are independent, the scatter of their exponents shows
correlations that are longer than a record.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from ..analysis.attractor import classify
from ..flow.status import Status, first_problem
from ..model.dynamics import State
from ..model.quantities import COORDINATE_SCALES
from .attractors import FLOOR
from .measure import LAST, Measure, measured_periods, tangents_cost
from .run import PERIODS_PER_CALL, ChunkInputs, Plan, run_cases, run_chunk

MOTIONS = 4
"""Motions for each case."""
HOLD = 2000
"""Forcing periods for which they run before their exponents are measured."""
CALM = 0.01
"""Exponents of the second half of a motion's record [1/period] that are no longer those of chaos."""
APART = 1e-6
"""Differences of their lateral velocities at the start [m/s]."""


class _LongMotions(NamedTuple):
    """Strobes and local exponents of a chunk of longer motions."""

    status: Int[np.ndarray, " lanes"]
    strobe: Float[np.ndarray, "lanes last 10"]
    history: Float[np.ndarray, "lanes periods count"]


class LongerMotions(NamedTuple):
    """Longer motions of some cases."""

    chosen: Int[np.ndarray, " cases"]
    """Indices of the cases into the list of all."""
    history: Float[np.ndarray, "cases motions periods count"]
    """Their local exponents [1/period]."""
    escapes: Int[np.ndarray, " cases"]
    """How many became regular: periodic, or without a positive exponent."""
    status: Int[np.ndarray, " cases"]
    """`Status` code of the first motion that went wrong, `NOT_RUN` where one was not finished."""

    def of(self, index: Int[np.ndarray, " some"]) -> "LongerMotions":
        """The longer at some places of `chosen`."""
        return LongerMotions(*(values[index] for values in self))


def run_longer_motions(
    plan: Plan,
    chosen: Int[np.ndarray, " cases"],
    states: State,
    epoch: int,
    blocks: int,
    count: int,
    options: Mapping[str, Any],
) -> tuple[LongerMotions, bool]:
    """Runs `MOTIONS` motions of each chosen case, for `HOLD` periods and a measurement.

    **Arguments:** `plan`: of the sweep; `chosen`: indices of the cases; `states`: of all cases at the start of the
    period `epoch`; `blocks`, `count`: of the measurement, see `Measure`; `options`: for `run_cases`.

    **Returns:** the longer, and whether the run was interrupted.
    """
    plan = plan.strobes(HOLD)
    calls = plan.recorded
    before, during = (
        calls._replace(count=(HOLD - LAST) // PERIODS_PER_CALL),
        calls._replace(count=LAST // PERIODS_PER_CALL),
    )
    plan = replace(plan, transient=before, recorded=during)

    def work(part: ChunkInputs) -> _LongMotions:
        begin = jax.tree.map(lambda a: a[part.index], states)
        # the motions of a case follow one another in the list
        apart = APART * (part.place % MOTIONS)
        begin = eqx.tree_at(lambda s: s.motion.v_y, begin, begin.motion.v_y + apart)
        run = run_chunk(plan, part.scenes, begin, part.steps, part.on_progress, epoch=epoch)
        end = float(epoch + plan.periods)
        measure = Measure(plan.solver, part.scenes, run.state, end, blocks, part.steps, part.on_progress)
        local = measure(part.steps, count)
        return _LongMotions(first_problem(run.status, local.status), run.record[0], local.history)

    cost, name = (
        HOLD + tangents_cost(count) * measured_periods(blocks),
        f"longer motions of {len(chosen)} chaotic cases",
    )
    run = run_cases(plan, work, cost=cost, index=np.repeat(chosen, MOTIONS), name=name, **options)
    if run.results is None:
        nothing = np.full(len(chosen), int(Status.NOT_RUN))
        return LongerMotions(chosen, np.full((len(chosen), MOTIONS, 1, count), np.nan), 0 * nothing, nothing), True
    status, strobe, history = run.results
    finite = (status == Status.FINITE)[:, None, None]
    motions = classify(np.where(finite, strobe, np.nan), scales=COORDINATE_SCALES, floor=FLOOR)
    by_case = lambda a: a.reshape(len(chosen), MOTIONS, *a.shape[1:])
    codes = by_case(status)
    first = np.take_along_axis(codes, np.argmax(codes != Status.FINITE, axis=1)[:, None], axis=1)[:, 0]
    first = np.where(np.any(codes == Status.NOT_RUN, axis=1), int(Status.NOT_RUN), first)
    # a motion may escape while it is measured, and what it escapes to may be a torus
    late = history[:, history.shape[1] // 2 :, 0].mean(axis=1)
    regular = (motions.kind == "period") | (late <= CALM)
    return LongerMotions(chosen, by_case(history), np.sum(by_case(regular), axis=1), first), run.interrupted
