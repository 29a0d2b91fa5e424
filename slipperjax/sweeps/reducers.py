"""Reducers that classify motions or run on after the record, and what `record` may be."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..analysis import KINDS, MIN_TEST, classify, standard_error
from ..flow import RECORDERS, AbstractReducer, Combined, Labelled, Status, Stretch, attributes
from ..flow import REDUCERS as OF_FLOW
from ..model import COORDINATE_SCALES, Scene, State
from ..tools import Batched, brief, whole
from .attractors import FLOOR
from .measure import BLOCK, LAST, Measure, measured_periods, tangents_cost
from .plan import OnProgress, Plan

LEAST_PERIODS = 16
"""Recorded periods without which nothing is classified, see `slipperjax.analysis.classify`."""
LEAST_MEASURED = 8
"""Periods without which an exponent has no standard error, see `slipperjax.analysis.standard_error`."""


class Further(NamedTuple):
    """A chunk of cases after its recorded stretch, for reducers that run on from there."""

    plan: Plan
    scenes: Batched[Scene]
    states: State
    epoch: float
    """Forcing periods before."""
    steps: int
    """Integration steps per forcing period."""
    on_progress: OnProgress


class Motions(NamedTuple):
    """What motions are."""

    kind: Int[Any, "*cases"]
    """0 for "unresolved", otherwise the place in `slipperjax.analysis.KINDS` and one more."""
    period: Int[Any, "*cases"]


@dataclass(frozen=True)
class MotionKind(AbstractReducer):
    """What each motion is by recurrence in the recorded strobe states, as `slipperjax.sweeps.attractors` says it.

    The variables `kind` and `period` are those of `slipperjax.analysis.classify`: records below `MIN_TEST` (200)
    periods can only be periodic or unresolved, with period 4 at most in 16 of them and period 16 in 64. Cases with a
    status other than 0 are "unresolved".
    """

    last: int = LAST
    """How many periods at the end of the record are looked at, at most."""

    def __post_init__(self):
        whole("last", self.last, LEAST_PERIODS)

    @property
    def name(self):
        return "motion"

    @property
    def variables(self):
        return "kind", "period"

    @property
    def inside(self):
        return False

    def strobes(self, periods):
        return min(self.last, periods)

    def values(self, periods):
        return 2

    def check(self, scene, periods, steps):
        if periods < LEAST_PERIODS:
            raise ValueError(
                f"Argument `periods` must be {LEAST_PERIODS} or more to classify motions, {MIN_TEST} or more to tell "
                f"tori from chaos, but is {periods}."
            )

    def finish(self, carried, stretch: Stretch) -> Motions:
        assert stretch.strobe is not None  # it is asked for
        good = (stretch.status == Status.FINITE)[:, None, None]
        states = np.where(good, stretch.strobe[:, -self.strobes(stretch.periods) :], np.nan)
        found = classify(states, scales=COORDINATE_SCALES, floor=FLOOR)
        # zero, which stands for cases that were not run, is "unresolved"
        known = [0 if kind == "unresolved" else KINDS.index(kind) + 1 for kind in found.kind.tolist()]
        return Motions(np.array(known, int), np.asarray(found.period, int))

    def label(self, scene, dims, found: Motions) -> Labelled:
        return {
            "kind": (
                dims,
                np.array(("unresolved", *KINDS))[found.kind],
                {"long_name": "what the motion is by recurrence"},
            ),
            "period": (dims, found.period, attributes("1", "forcing periods of a periodic motion, 0 for others")),
        }, {}


class OneExponent(NamedTuple):
    """Largest Lyapunov exponents."""

    exponent: Float[Any, "*cases"]
    stderr: Float[Any, "*cases"]


@dataclass(frozen=True)
class LargestExponent(AbstractReducer):
    """The largest Lyapunov exponent [1/period] with its standard error, uncertified.

    It is measured by a tangent after the recorded stretch, over as many periods again and 20 more before, in which
    the tangent turns into its direction; both are rounded up to multiples of 20. Nothing checks it, as
    `slipperjax.lyapunov_sweep` does with steps half as long, a second trajectory and longer motions.
    """

    periods: int | None = None
    """Over how many periods; None for as many as are recorded."""

    def __post_init__(self):
        if self.periods is not None:
            whole("periods", self.periods, LEAST_MEASURED)

    @property
    def name(self):
        return "exponent"

    @property
    def variables(self):
        return "exponent", "exponent_stderr"

    @property
    def inside(self):
        return False

    @property
    def tangents(self):
        return True

    def values(self, periods):
        return 2

    def blocks(self, periods: int) -> int:
        """Blocks of `BLOCK` periods that count."""
        return -(-(periods if self.periods is None else self.periods) // BLOCK)

    def later(self, periods):
        return tangents_cost(1) * measured_periods(self.blocks(periods))

    def after(self, carried, run: Further):
        blocks = self.blocks(run.plan.recorded.periods)
        found = Measure(run.plan, run.scenes, run.states, run.epoch, blocks, run.steps, run.on_progress)(run.steps, 1)
        return found.history, found.status

    def finish(self, carried, stretch: Stretch) -> OneExponent:
        history = np.asarray(carried)
        return OneExponent(history.mean(axis=1)[:, 0], standard_error(history)[:, 0])

    def label(self, scene, dims, found: OneExponent) -> Labelled:
        label = attributes("1/period", "largest Lyapunov exponent, uncertified")
        error = attributes("1/period", "standard error of the largest Lyapunov exponent")
        return {"exponent": (dims, found.exponent, label), "exponent_stderr": (dims, found.stderr, error)}, {}


REDUCERS: dict[str, AbstractReducer] = {**OF_FLOW, "motion": MotionKind(), "exponent": LargestExponent()}
"""Reducers by the names that `sweep(..., record=...)` knows them by."""


def resolved_record(record: Any) -> Any:
    """One of `RECORDERS` as it is; a reducer, its name, or a list of them as one recorder.

    **Raises:** `ValueError` for anything else.
    """
    if isinstance(record, str) and record in RECORDERS:
        return record
    if not isinstance(record, list | tuple):
        return Combined((_reducer(record, (*RECORDERS, *(name for name in REDUCERS if name not in RECORDERS))),))
    if not record:
        raise ValueError(f"Argument `record` must name at least one of {', '.join(REDUCERS)}, but is empty.")
    return Combined(tuple(_reducer(one, tuple(REDUCERS)) for one in record))


def _reducer(given: Any, names: tuple[str, ...]) -> AbstractReducer:
    """A reducer as it is, or by its name; `names`: all that may be given in its place."""
    if isinstance(given, AbstractReducer):
        return given
    if isinstance(given, str) and given in REDUCERS:
        return REDUCERS[given]
    raise ValueError(
        f"Argument `record` must be one of {', '.join(names)}, a reducer, or a list of names of reducers and of "
        f"reducers, but is {brief(given)}."
    )
