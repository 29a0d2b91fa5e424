"""Whether chaos lasts: several longer motions from a chaotic one, which may become regular, and their exponents.

A chaotic transient cannot be told from chaos by what happens while it lasts, whatever is measured. Therefore some
motions are begun beside its last state. They forget each other within tens of periods, so each is one more trial of
how long the transient may last; and because their records are independent, the scatter of their exponents shows
correlations that are longer than a record.
"""

import dataclasses
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
from .executors import in_order, run_chunk, run_chunks
from .grid import Cases
from .plan import PAUSE, Plan, strobe_plan
from .records import LAST, Measure, measured_periods, tangents_cost

MOTIONS = 4
"""Motions for each case."""
HOLD = 2000
"""Forcing periods for which they run before their exponents are measured."""
CALM = 0.01
"""Exponents of the second half of a motion's record [1/period] that are no longer those of chaos."""
APART = 1e-6
"""Differences of their lateral velocities at the start [m/s]."""


class _Motions(NamedTuple):
    """What a chunk of motions showed."""

    strobe: Float[np.ndarray, "lanes last coordinates"]
    history: Float[np.ndarray, "lanes periods count"]
    status: Int[np.ndarray, " lanes"]


class Votes(NamedTuple):
    """What several longer motions of some cases showed."""

    history: Float[np.ndarray, "cases motions periods count"]
    """Their local exponents."""
    escapes: Int[np.ndarray, " cases"]
    """How many became regular: periodic, or without a positive exponent."""
    status: Int[np.ndarray, " cases"]
    """`Status` code of the first motion that went wrong, `NOT_RUN` where one was not finished."""


def work_of_votes(blocks: int, count: int) -> float:
    """What the motions of one case cost, in plain forcing periods of one lane; arguments as for `take_votes`."""
    return MOTIONS * (HOLD + tangents_cost(count) * measured_periods(blocks))


def take_votes(
    plan: Plan,
    cases: Cases,
    chosen: Int[np.ndarray, " cases"],
    states: State,
    epoch: int,
    blocks: int,
    count: int,
    chunk: int | None,
    workers: int | None,
    progress: bool,
) -> tuple[Votes, bool]:
    """Runs `MOTIONS` motions of each chosen case, for `HOLD` periods and a measurement.

    **Arguments:** `plan`, `cases`: of the sweep; `chosen`: places of the cases; `states`: theirs at the start of the
    period `epoch`; `blocks`, `count`: of the measurement, see `Measure`; others as for `lyapunov_sweep`.

    **Returns:** the votes, and whether the run was interrupted.

    **Raises:** `Interrupted` where no motion was finished before an interrupt.
    """
    of_lane = np.repeat(np.arange(len(chosen)), MOTIONS)
    apart = APART * np.tile(np.arange(MOTIONS), len(chosen))
    plan = dataclasses.replace(strobe_plan(plan, HOLD), steps=plan.steps[chosen][of_lane])
    plan = dataclasses.replace(
        plan,
        transient=plan.recorded._replace(count=(HOLD - LAST) // PAUSE),
        recorded=plan.recorded._replace(count=LAST // PAUSE),
    )
    chunks, workers = plan.chunks(chunk, workers)

    def work(part: Any, on_progress: Any) -> _Motions:
        lanes = of_lane[part.index]
        scenes, _ = cases.take(chosen[lanes])
        begin = jax.tree.map(lambda a: a[lanes], states)
        begin = eqx.tree_at(lambda s: s.motion.v_y, begin, begin.motion.v_y + apart[part.index])
        held = run_chunk(plan, scenes, begin, part.steps, on_progress, epoch=epoch)
        measure = Measure(plan, scenes, held.state, float(epoch + plan.periods), blocks, part.steps, on_progress)
        found = measure(part.steps, count)
        return _Motions(held.record[0], found.history, first_problem(held.status, found.status))

    each, name = work_of_votes(blocks, count) / MOTIONS, f"longer motions of {len(chosen)} chaotic cases"
    runs = run_chunks(chunks, workers, work, periods=each, progress=progress, name=name)
    strobe, history, status = (in_order(chunks, parts) for parts in zip(*runs.results, strict=True))
    kinds = classify(
        np.where((status == Status.FINITE)[:, None, None], strobe, np.nan), scales=COORDINATE_SCALES, floor=FLOOR
    )
    by_case = lambda a: a.reshape(len(chosen), MOTIONS, *a.shape[1:])
    codes = by_case(status)
    worst = np.take_along_axis(codes, np.argmax(codes != Status.FINITE, axis=1)[:, None], axis=1)[:, 0]
    worst = np.where(np.any(codes == Status.NOT_RUN, axis=1), int(Status.NOT_RUN), worst)
    # a motion may escape while it is measured, and what it escapes to may be a torus
    later = history[:, history.shape[1] // 2 :, 0].mean(axis=1)
    calm = (kinds.kind == "period") | (later <= CALM)
    return Votes(by_case(history), np.sum(by_case(calm), axis=1), worst), runs.interrupted
