"""Records that classify motions or measure exponents after the recorded span, and the values of `record`."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..analysis.attractor import KINDS, MIN_TEST, classify
from ..analysis.lyapunov import standard_error
from ..flow.period_map import advance_tangents, initial_tangents
from ..flow.record import AbstractRecord, Labelled, RecordedSpan, RecordSet, attributes
from ..flow.records import ALIASES, RECORDS, ContactChecks, OnePoint
from ..flow.series import History, Sections, Strobe
from ..flow.status import Status, first_problem
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.layout import coordinates
from ..model.quantities import COORDINATE_SCALES, LOADS, Quantity
from ..model.scene import Scene
from ..tools.batching import Batched
from ..tools.checks import brief, require, whole, yes_or_no
from .attractors import FLOOR
from .plan import OnProgress, Plan

BLOCK = 20
"""Forcing periods in one call; the first such block turns the tangents into their directions and is not counted."""
LONGEST = 16
"""Longest period of a motion whose Floquet multipliers are computed, or whose orbit is looked for."""
LAST = 200
"""Forcing periods at the end of a record from which a motion is classified."""
PAIR, JACOBIAN, LOOK = 2.0, 35.0, 2.4
"""What a period of two trajectories, with its Jacobian, and with its loads costs, in plain ones: measured."""


def tangents_cost(count: int) -> float:
    """What a period with `count` tangents costs, in plain ones: measured 2.1 to 2.9 with one, 5.7 with three."""
    return 1.0 + 1.6 * count


def measured_periods(blocks: int) -> int:
    """Forcing periods of a measurement of which `blocks` count."""
    return BLOCK * (blocks + 1)


class Local(NamedTuple):
    """Local exponents of a chunk."""

    history: Float[np.ndarray, "cases periods count"]
    status: Int[np.ndarray, " cases"]
    strobe: Float[np.ndarray, "cases last coordinates"]
    """States once per period in the last `LAST` counted periods, or in all if they are fewer."""
    state: State
    """The states at the end."""


class Measure(NamedTuple):
    """Measures exponents of a chunk from its states at the start of the period `epoch`."""

    plan: Plan
    scenes: Batched[Scene]
    states: State
    epoch: float
    blocks: int
    """Blocks of `BLOCK` periods that count."""
    steps: int
    """Steps per period of those periods in which progress is counted."""
    on_progress: OnProgress

    @property
    def periods(self) -> int:
        """Forcing periods of one measurement, those in which tangents turn into their directions included."""
        return measured_periods(self.blocks)

    def __call__(self, steps: int, count: int, distance: float | None = None) -> Local:
        """Local exponents with `steps` per period; by differences to neighbours at `distance` if that is given."""
        states, tangents = self.states, initial_tangents(self.scenes, self.states, count)
        away = None if distance is None else jnp.asarray(distance)
        weight = (tangents_cost(count) if distance is None else PAIR) * steps / self.steps
        rows, strobes, status = [], [], np.zeros(len(states.motion.y), int)
        for k in range(self.blocks + 1):
            at = self.epoch + k * BLOCK
            states, tangents, history, strobe, codes = advance_tangents(
                self.scenes, states, tangents, at, _constant(steps), away, solver=self.plan.solver, periods=BLOCK
            )
            rows.append(np.asarray(history))
            strobes = [*strobes, np.asarray(strobe)][-LAST // BLOCK :] if k else []
            status = first_problem(status, codes)
            self.on_progress(weight * BLOCK)
        return Local(np.concatenate(rows[1:], axis=1), status, np.concatenate(strobes, axis=1), states)


def _constant(steps: int) -> ConstantSteps:
    """So many steps as an array: one compiled program serves every number."""
    return ConstantSteps(steps=jnp.asarray(float(steps)))


LEAST_PERIODS = 16
"""Recorded periods without which nothing is classified, see `slipperjax.analysis.classify`."""
LEAST_MEASURED = 8
"""Periods without which an exponent has no standard error, see `slipperjax.analysis.standard_error`."""


class RecordedChunk(NamedTuple):
    """A chunk of cases at the end of its recorded span."""

    plan: Plan
    scenes: Batched[Scene]
    states: State
    epoch: float
    """Forcing periods before."""
    steps: int
    """Integration steps per forcing period."""
    on_progress: OnProgress


class Motions(NamedTuple):
    """Kind code and period of motions."""

    kind: Int[Any, "*cases"]
    """0 for "unresolved", otherwise the place in `slipperjax.analysis.KINDS` and one more."""
    period: Int[Any, "*cases"]


@dataclass(frozen=True)
class MotionKind(AbstractRecord):
    """The kind of each motion by recurrence in the recorded strobe states, as `slipperjax.sweeps.attractors` says it.

    The variables `kind` and `period` are those of `slipperjax.analysis.classify`: records below `MIN_TEST` (200)
    periods can only be periodic or unresolved, with period 4 at most in 16 of them and period 16 in 64. Cases with a
    status other than 0 are "unresolved".
    """

    latest: int = LAST
    """How many periods at the end of the record are looked at, at most."""

    def __post_init__(self):
        whole("latest", self.latest, LEAST_PERIODS)

    @property
    def name(self):
        return "motion"

    @property
    def variables(self):
        return "kind", "period"

    @property
    def inside(self):
        return False

    def last(self, periods):
        return min(self.latest, periods)

    def values(self, periods):
        return len(COORDINATE_SCALES) * self.last(periods)

    def sample(self, course):
        return course.end.motion

    def check(self, scene, periods, steps):
        if periods < LEAST_PERIODS:
            raise ValueError(
                f"Argument `periods` must be {LEAST_PERIODS} or more to classify motions, {MIN_TEST} or more to tell "
                f"tori from chaos, but is {periods}."
            )

    def finish(self, carried, samples, span: RecordedSpan) -> Motions:
        states = coordinates(State(samples, None))
        states = np.where((span.status == Status.FINITE)[:, None, None], states, np.nan)
        found = classify(states, scales=COORDINATE_SCALES, floor=FLOOR)
        # zero, which stands for cases that were not run, is "unresolved"
        known = [0 if kind == "unresolved" else KINDS.index(kind) + 1 for kind in found.kind.tolist()]
        return Motions(np.array(known, int), np.asarray(found.period, int))

    def label(self, scene, dims, found: Motions) -> Labelled:
        words = np.array(("unresolved", *KINDS))[found.kind]
        return {
            "kind": (dims, words, {"long_name": "kind of motion, by recurrence"}),
            "period": (dims, found.period, attributes("1", "forcing periods of a periodic motion, 0 for others")),
        }, {}


class OneExponent(NamedTuple):
    """Largest Lyapunov exponents."""

    exponent: Float[Any, "*cases"]
    stderr: Float[Any, "*cases"]


@dataclass(frozen=True)
class LargestExponent(AbstractRecord):
    """The largest Lyapunov exponent [1/period] with its standard error, uncertified.

    It is measured by a tangent after the recorded span, over as many periods again and 20 more before, in which
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
    def quantity(self) -> Quantity:
        """Name, unit and description."""
        return Quantity("exponent", "1/period", "largest Lyapunov exponent", r"\lambda")

    @property
    def smooth(self) -> "LargestExponent":
        """Itself, for descents."""
        return self

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

    def cost_after(self, periods):
        return tangents_cost(1) * measured_periods(self.blocks(periods))

    def after(self, carried, status, run: RecordedChunk):
        blocks = self.blocks(run.plan.recorded.periods)
        found = Measure(run.plan, run.scenes, run.states, run.epoch, blocks, run.steps, run.on_progress)(run.steps, 1)
        return found.history, first_problem(status, found.status)

    def finish(self, carried, samples, span) -> OneExponent:
        history = np.asarray(carried)
        return OneExponent(history.mean(axis=1)[:, 0], standard_error(history)[:, 0])

    def label(self, scene, dims, found: OneExponent) -> Labelled:
        label = attributes("1/period", "largest Lyapunov exponent, uncertified")
        error = attributes("1/period", "standard error of the largest Lyapunov exponent")
        return {"exponent": (dims, found.exponent, label), "exponent_stderr": (dims, found.stderr, error)}, {}


_BESIDE: dict[str, tuple[AbstractRecord, ...]] = {
    "sections": (Sections(), Strobe(from_start=True)),
    "strobe": (Strobe(),),
    "history": (History(),),
    "motion": (MotionKind(),),
    "exponent": (LargestExponent(),),
}
"""Records by name that are no numbers of a period."""
NAMES = ("sections", "strobe", "history", "motion", "exponent", *ALIASES, *RECORDS)
"""Names that `sweep(..., record=...)` knows."""


def resolved_record(record: Any, loads: bool | None = None) -> RecordSet:
    """Records from a user's argument: a name, a record, or a list of both.

    **Arguments:** `loads`: whether contact loads come with the others, None for with sections and histories. Statuses
    that follow from loads come with any load.

    **Raises:** `ValueError` for anything else.
    """
    asked = list(record) if isinstance(record, list | tuple) else [record]
    require(asked, "record", f"name at least one of {', '.join(NAMES)}", record)
    found = [one for given in asked for one in _records(given)]
    series = any(isinstance(one, Sections | History) for one in found)
    if yes_or_no("loads", series if loads is None else loads):
        found += [RECORDS[name] for name in LOADS]
    if any((one.record if isinstance(one, OnePoint) else one) in _OF_LOADS for one in found):
        found.append(ContactChecks())
    return RecordSet(tuple(dict.fromkeys(found)))


_OF_LOADS = {RECORDS[name] for name in (*LOADS, "impact_impulse")}
"""Records that look at contact loads."""


def _records(given: Any) -> tuple[AbstractRecord, ...]:
    """The records of a name, or a record as it is."""
    if isinstance(given, AbstractRecord):
        return (given,)
    if isinstance(given, str) and given in NAMES:
        names = ALIASES.get(given, (given,))
        return _BESIDE.get(given) or tuple(RECORDS[name] for name in names)
    raise ValueError(
        f"Argument `record` must be one of {', '.join(NAMES)}, a record, or a list of names and records, but is "
        f"{brief(given)}."
    )
