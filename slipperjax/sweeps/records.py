"""Records that classify motions or measure exponents after the recorded span, and the values of `record`."""

from dataclasses import dataclass

from ..analysis.attractor import MIN_TEST
from ..analysis.kinds import Regime
from ..analysis.lyapunov import one_motion_standard_error
from ..flow.numbers import ALIASES, RECORDS, ContactChecks, OnePoint
from ..flow.record import (
    AbstractOutput,
    AbstractRecord,
    History,
    Labelled,
    PoincareSections,
    RecordedSpan,
    RecordSet,
    Strobe,
)
from ..flow.status import first_problem
from ..model.dynamics import State
from ..model.layout import coordinates
from ..model.quantities import COORDINATE_SCALES, LOADS, SLIPPER_LOADS, Quantity
from ..tools.checks import require, warn, whole, yes_or_no
from ..tools.columns import column
from .attractors import LAST, Motions, classify_motions
from .exponents import LyapunovExponents, counted_periods, measure
from .orbits import NearestOrbit
from .plan import AbstractStage, LastStrobes

UNCHECKED = "without certificates: long transients look chaotic, see lyapunov_sweep"
"""Comment of quick labels."""
LEAST_PERIODS = 16
"""Least number of recorded periods for a classification, see `slipperjax.analysis.classify`."""


@dataclass(frozen=True)
class MotionKind(AbstractRecord):
    """The kind of each motion by recurrence of the recorded strobe states, as by `slipperjax.sweeps.attractors`: a
    quick label without a check. Long transients look chaotic; `slipperjax.lyapunov_sweep` has certificates.

    The variables `kind` and `period` are those of `slipperjax.analysis.classify`. With fewer than `MIN_TEST` (200)
    periods, a motion is periodic or unresolved: 16 periods show period 4 at most, and 64 show period 16. Cases with a
    status other than 0 are "unresolved".
    """

    latest: int = LAST
    """Most periods that are used, at the end of the record. A number below `MIN_TEST` asks only for periodic motions,
    and gives no warning that other motions need more."""

    def __post_init__(self):
        whole("latest", self.latest, LEAST_PERIODS)

    name = "motion"
    inside = False  # ends of periods are enough

    @property
    def variables(self):
        return "kind", "period"

    def last(self, periods):
        return min(self.latest, periods)

    def values(self, scene, periods):
        return len(COORDINATE_SCALES) * self.last(periods)

    def sample(self, course):
        return course.end.motion

    def check(self, scene, periods, steps):
        need = f"be {LEAST_PERIODS} or more to classify motions, {MIN_TEST} or more to tell tori from chaos"
        require(periods >= LEAST_PERIODS, "periods", need, periods)
        # a user who gives a smaller number asks only for periodic motions
        if periods < MIN_TEST <= self.latest:
            warn(
                f"Argument `periods` is {periods}: motions that are not periodic, chaos too, stay unresolved with "
                f"fewer than {MIN_TEST} recorded periods."
            )

    def finish(self, carried, samples, span: RecordedSpan) -> Motions:
        return classify_motions(coordinates(State(samples, None)), span.status)

    def label(self, scene, dims, values: Motions) -> Labelled:
        words = Regime.kind_names(values.kind)
        return {
            "kind": column(dims, words, "", "kind of motion by recurrence, a quick label", comment=UNCHECKED),
            "period": column(
                dims,
                values.period,
                "1",
                "forcing periods of a periodic motion, 0 for others",
            ),
        }, {}


@dataclass(frozen=True)
class LargestExponent(AbstractStage):
    """The largest Lyapunov exponent [1/period] with its standard error, without a certificate.

    A tangent measures it after the recorded span, over as many further periods, rounded up to multiples of 20, after
    20 periods in which the tangent turns into the direction of fastest growth. `slipperjax.lyapunov_sweep` also
    checks the exponent.
    """

    periods: int | None = None
    """Forcing periods of the measurement; None for the number of recorded periods."""

    def __post_init__(self):
        if self.periods is not None:
            whole("periods", self.periods, 8)  # fewer periods give no standard error

    name = "exponent"
    quantity = Quantity("exponent", "1/period", "largest Lyapunov exponent", r"\lambda")

    @property
    def smooth(self) -> "LargestExponent":
        """The stage itself, for descents."""
        return self

    @property
    def variables(self):
        return "exponent", "exponent_stderr"

    def values(self, scene, periods):
        return 2

    def of_chunk(self, part, states, epoch, status, strobe):
        local = measure(part, states, epoch, counted_periods(self.periods, part.plan.recorded), 1)
        found = local.history.mean(axis=1)[:, 0], one_motion_standard_error(local.history)[:, 0]
        return found, first_problem(status, local.status)

    def label(self, scene, dims, values) -> Labelled:
        exponent, stderr = values
        text = "standard error of the largest Lyapunov exponent"
        return {
            "exponent": column(
                dims,
                exponent,
                "1/period",
                "largest Lyapunov exponent, uncertified",
            ),
            "exponent_stderr": column(dims, stderr, "1/period", text),
        }, {}


OTHERS: dict[str, tuple[AbstractOutput, ...]] = {
    "sections": (PoincareSections(), Strobe(from_start=True)),
    "strobe": (Strobe(),),
    "history": (History(),),
    "motion": (MotionKind(),),
    "exponent": (LargestExponent(),),
    "exponents": (LyapunovExponents(),),
    "orbits": (NearestOrbit(),),
}
"""Records by name that are not numbers of a period; `RECORDS` has the others."""
NAMES = (*OTHERS, *ALIASES, *RECORDS)
"""Names that `sweep(..., record=...)` knows."""


def resolved_record(record: object, loads: bool | None = None) -> tuple[RecordSet, tuple[AbstractStage, ...]]:
    """Return records and stages from a user's argument: a name, a record, or a list of both.

    **Arguments:** `loads`: whether contact loads are also recorded; None: only with sections and histories. Any load
    adds the record of the statuses that follow from loads.

    **Raises:** `ValueError` for any other value.
    """
    listed = list(record) if isinstance(record, list | tuple) else [record]
    require(listed, "record", f"name at least one of {', '.join(NAMES)}", record)
    outputs = [one for item in listed for one in _outputs(item)]
    series = any(isinstance(one, PoincareSections | History) for one in outputs)
    if yes_or_no("loads", series if loads is None else loads):
        outputs += [RECORDS[name] for name in LOADS]
    if any((one.record if isinstance(one, OnePoint) else one) in OF_LOADS for one in outputs):
        outputs.append(ContactChecks())
    # the strobes show whether a motion has reached an orbit
    if any(isinstance(one, LyapunovExponents) for one in outputs):
        outputs.append(LastStrobes(LAST))
    outputs = list(dict.fromkeys(outputs))  # each once, in order
    records = tuple(one for one in outputs if isinstance(one, AbstractRecord))
    return RecordSet(records), tuple(one for one in outputs if isinstance(one, AbstractStage))


OF_LOADS = {RECORDS[name] for name in (*LOADS, *SLIPPER_LOADS, "impact_impulse", "damping_ratio")}
"""Records that use contact loads."""


def _outputs(record: object) -> tuple[AbstractOutput, ...]:
    """Return the records and stages that a name means, or a record itself."""
    if isinstance(record, AbstractOutput):
        return (record,)
    short = ", ".join((*OTHERS, *ALIASES))
    need = f"be one of {short}, peak_force and others of slipperjax.flow.RECORDS, a record, or a list of these"
    require(record in NAMES, "record", need, record, names=NAMES)
    record = str(record)
    return OTHERS.get(record) or tuple(RECORDS[name] for name in ALIASES.get(record, (record,)))
