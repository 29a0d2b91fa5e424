"""Records that make numbers of a motion: each is one row, for sweeps, stores, designs and sensitivities alike.

They can be differentiated in both modes. Greatest values jump between points and instants where several attain them,
so that such a record has a smooth twin, `smooth`, for descents.
"""

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model.dang2024 import table_2_start
from ..model.dynamics import Args, state_and_penetration
from ..model.kinematics import contact_points
from ..model.quantities import ACCELERATIONS, COORDINATES, LOADS, Quantity
from ..model.scene import Scene
from ..tools.batching import Batched
from ..tools.checks import brief, instance, number, one_of, positive, require
from ..tools.compile import jit
from .course import GAUSS_PLACES, Course
from .record import AbstractRecord, RecordedSpan, Unlabelled, attributes, point_labels
from .status import Status, most_stability_number, with_loads

POWER_ORDER = 32
"""Default order of the power means that stand for greatest values [1]."""
POINTS = ("end", "point")
"""Dimensions of values at each contact point."""


class Join(NamedTuple):
    """A way in which the values of forcing periods become one number."""

    empty: float  # the value of no period
    reduce: Callable[..., Any]
    """Joins values along axis 0; what it gives can be joined with others again."""
    value: Callable[[Any, Any], Any] = lambda joined, periods: joined
    """The number, from values joined over so many periods."""


def _root_mean(joined: Any, periods: Any) -> Any:
    square = joined / periods
    xp = np if isinstance(square, np.ndarray) else jnp  # on the host nothing is compiled
    # the square root has no derivative at zero
    return xp.where(square == 0, 0.0, xp.sqrt(xp.where(square == 0, 1.0, square)))


def _log_sum(values: Array, axis: int = 0) -> Array:
    """Return ln of the sum of exp(values), which may be minus infinity."""
    most = jax.lax.stop_gradient(jnp.max(values, axis=axis))
    scale = jnp.where(jnp.isfinite(most), most, 0.0)
    total = jnp.sum(jnp.exp(values - scale), axis=axis)
    return jnp.where(jnp.isneginf(most), -jnp.inf, jnp.log(jnp.where(jnp.isneginf(most), 1.0, total)) + scale)


JOINS: dict[str, Join] = {
    "max": Join(-np.inf, jnp.max),
    "min": Join(np.inf, jnp.min),
    "sum": Join(0.0, jnp.sum),
    "mean": Join(0.0, jnp.sum, lambda joined, periods: joined / periods),
    "rms": Join(0.0, jnp.sum, _root_mean),
}
"""Ways in which periods join, by name."""


class AbstractQuantityRecord(AbstractRecord):
    """A record of one variable: a quantity with dimensions of its own."""

    quantity: Quantity
    """Name, unit and description."""
    dims: tuple[Any, ...] = ()
    """Dimensions: "end", "point", or a name of one's own with its labels, and attributes if there are any."""

    @property
    def name(self) -> str:
        return self.quantity.name

    @property
    def unit(self) -> str:
        """SI unit."""
        return self.quantity.unit

    def shape(self, scene: Scene) -> tuple[int, ...]:
        """Return the shape of one value."""
        of_points = {"end": 2, "point": scene.points // 2}
        return tuple(of_points[d] if isinstance(d, str) else len(d[1]) for d in self.dims)

    def values(self, scene, periods):
        return math.prod(self.shape(scene))

    def label(self, scene, dims, values):
        names = [d if isinstance(d, str) else d[0] for d in self.dims]
        own = {d[0]: (d[0], np.array(d[1]), *d[2:]) for d in self.dims if not isinstance(d, str)}
        along = {name: labels for name, labels in point_labels(scene).items() if name in names}
        return {self.name: ((*dims, *names), values, self.quantity.attributes)}, along | own


class AbstractNumber(AbstractQuantityRecord):
    """A number, or an array of them, of each forcing period, joined over the periods."""

    join: Join
    """How periods join."""
    samples: Callable[[Course], Any] | None = None
    """Gives values whose greatest magnitude the number is, along the first axis in time; None where it is none."""

    @abc.abstractmethod
    def of(self, course: Course) -> Any:
        """Return the value of one forcing period, an array with axes `dims`; for "rms" its square."""

    @property
    def smooth(self) -> "AbstractNumber":
        """Its stand-in for descents: a power mean near a greatest magnitude, or itself."""
        return self if self.samples is None else PowerMean(self)

    def total(self, values: Array) -> Array:
        """Return the number [`unit`] from the values of periods, along the first axis."""
        return self.join.value(self.join.reduce(values, axis=0), len(values))

    def begin(self, scene, state):
        return np.full(self.shape(scene), self.join.empty)

    def add(self, carried, course):
        return self.join.reduce(jnp.stack([carried, self.of(course)]), axis=0)

    def finish(self, carried, samples, span):
        return np.asarray(self.join.value(np.asarray(carried), span.periods))


@dataclass(frozen=True)
class Record(AbstractNumber):
    """A number from any JAX function of the course of a forcing period.

    ```python
    load = Record(Quantity("front_load", "N", "mean force at the front"), lambda c: c.force.mean[0].sum(), "mean")
    ```
    """

    quantity: Quantity
    """Name, unit and description."""
    function: Callable[[Course], Any]
    """Gives a real number, or an array with axes `dims`, of a `slipperjax.flow.Course`. Another function, or the same
    text in another lambda, is compiled anew."""
    over: str = "max"
    """How the values of forcing periods join: "max", "min", "sum", "mean", or "rms", to which squares are given."""
    dims: tuple[str | tuple[str, tuple], ...] = ()
    samples: Callable[[Course], Any] | None = None
    """Values whose greatest magnitude the number is, along the first axis in time; for `smooth`."""

    def __post_init__(self):
        require(callable(self.function), "function", "be a function of a course", self.function)
        instance("quantity", self.quantity, Quantity, "a slipperjax.model.Quantity")
        try:
            hash(self.function)
        except TypeError:
            raise ValueError(f"Argument `function` must be hashable, but is {brief(self.function)}.") from None
        require(self.name.isidentifier(), "quantity", "have a name such as spring_force", self.name)
        one_of("over", self.over, tuple(JOINS))

    @property
    def join(self):
        return JOINS[self.over]

    def of(self, course):
        return jnp.asarray(self.function(course), float)

    def check(self, scene, periods, steps):
        if RECORDS.get(self.name) is self:
            return

        def value():
            """Return the value of some period, to look at its shape."""
            state, _ = state_and_penetration(scene, table_2_start())
            inside = jax.tree.map(lambda a: jnp.broadcast_to(a, (5, *jnp.shape(a))), state)
            return self.function(Course(state, inside, Args(scene, 0.0, contact_points(scene)), 4))

        must = f"Argument `function` of `{self.name}` must"
        try:
            made = jax.eval_shape(value)
        except Exception as error:
            reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
            raise ValueError(f"{must} take a course, but raised {reason}") from error
        if not (isinstance(made, jax.ShapeDtypeStruct) and made.dtype.kind in "fiub"):
            raise ValueError(f"{must} give real numbers, but gives {brief(made)}.")
        if made.shape != (shape := self.shape(scene)):
            raise ValueError(f"{must} give numbers of the shape of `dims`, {shape}, but gives {made.shape}.")


@dataclass(frozen=True)
class PowerMean(AbstractNumber):
    """A power mean that stands for a greatest value in descents, because it is smooth: below the greatest, near it.

    Of magnitudes x it is (mean over time of the sum over points of x^order)^(1/order).
    """

    record: AbstractNumber
    order: float = POWER_ORDER

    def __post_init__(self):
        number(positive, "order", self.order)
        instance("record", self.record, AbstractNumber, "a record of one number")
        samples = getattr(self.record, "samples", None)
        require(samples, "record", "have samples", shown=type(self.record).__name__)

    @property
    def quantity(self):
        q = self.record.quantity
        text = f"power mean of order {self.order:g}, for the {q.long_name}"
        return dataclasses.replace(q, name=f"soft_{q.name}", long_name=text, symbol="")

    @property
    def join(self):
        exp = lambda x: np.exp(x) if isinstance(x, np.ndarray) else jnp.exp(x)
        value = lambda joined, periods: exp((joined - np.log(periods)) / self.order)
        return Join(-np.inf, _log_sum, value)

    def of(self, course):
        """Return ln of the mean over time of the sum of x^order, without overflow."""
        assert self.record.samples is not None
        size = jnp.abs(self.record.samples(course))
        size = size.reshape(len(size), -1)
        # samples of unused steps are no part of the scale
        counted = course.counted(size, 0.0)
        most = jax.lax.stop_gradient(jnp.max(counted))  # a scale alone: the result does not depend on it
        scale = jnp.where(most > 0, most, 1.0)
        mean = jnp.sum(course.mean((counted / scale) ** self.order))
        logarithm = jnp.log(jnp.where(most > 0, mean, 1.0)) + self.order * jnp.log(scale)
        return jnp.where(most > 0, logarithm, jnp.where(jnp.isnan(most), jnp.nan, -jnp.inf))


@dataclass(frozen=True)
class OnePoint(AbstractNumber):
    """A record of contact points as one number: of one point, or the greatest or least of all."""

    record: Record
    point: str | None = None
    """A point's name and 1 for the front or 2 for the rear, such as "A1"; None for all."""

    def __post_init__(self):
        instance("record", self.record, Record, "a slipperjax.flow.Record")
        need = "be a point's name with 1 or 2, or None"
        require(self.point is None or isinstance(self.point, str), "point", need, self.point)
        if self.record.dims != POINTS or self.record.over not in ("max", "min"):
            raise ValueError(f"Argument `record` must be a greatest or least of points, but is {self.record.name}.")

    @property
    def quantity(self):
        q = self.record.quantity
        if self.point is None:
            return q
        return dataclasses.replace(q, name=f"{q.name}_{self.point}", long_name=f"{q.long_name} at {self.point}")

    @property
    def join(self):
        return self.record.join

    @property
    def samples(self):
        of_points = self.record.samples
        return None if of_points is None else lambda course: self._at_point(course, of_points(course))

    def of(self, course):
        return self.join.reduce(self._at_point(course, self.record.of(course)).ravel(), axis=0)

    def _at_point(self, course: Course, values: Float[Array, "*first 2 points"]) -> Array:
        if self.point is None:
            return values
        names = course.scene.section.names
        indices = {f"{name}{end + 1}": (end, k) for end in range(2) for k, name in enumerate(names)}
        require(self.point in indices, "point", f"be one of {', '.join(indices)}", self.point)
        return values[..., *indices[self.point]]


class AbstractAtPeak(AbstractQuantityRecord):
    """A number at the highest normal force of each point in all periods; NaN where it is open throughout."""

    dims = POINTS

    @abc.abstractmethod
    def of(self, course: Course) -> Any:
        """Return the number at the highest force of one forcing period, (2, points)."""

    def begin(self, scene, state):
        none = np.zeros(self.shape(scene))
        return none, np.full_like(none, np.nan)

    def add(self, carried, course):
        highest, there = carried
        force = course.loads.peak_force
        higher = force > highest
        return jnp.where(higher, force, highest), jnp.where(higher, self.of(course), there)


@dataclass(frozen=True)
class PeakPeriod(AbstractAtPeak):
    """The instant of the highest normal force of each point; NaN where it is open throughout."""

    quantity = LOADS["peak_period"]

    def of(self, course):
        return course.loads.peak_period

    def finish(self, carried, samples, span):
        return np.asarray(carried[1]) - span.start


@jit
def judged_by_contacts(scenes: Batched[Scene], codes: Any, carried: Any, limit: Any) -> Int[Array, " cases"]:
    """Judges a batch by `with_loads`, from a carry of `ContactChecks` and the greatest stability number."""
    return scenes.map(lambda scene, code, loads: with_loads(code, *loads, scene=scene, most=limit), codes, carried)


@dataclass(frozen=True)
class ContactChecks(Unlabelled):
    """No variable, but the statuses that follow from loads: no contact, pressed in, and unresolved damping."""

    def values(self, scene, periods):
        return 3

    def begin(self, scene, state):
        return np.zeros(()), np.full((), -np.inf), np.zeros(())

    def add(self, carried, course):
        closed, deepest, stability_number = carried
        new = course.loads
        closed = closed + jnp.sum(new.contact_fraction)
        deepest = jnp.maximum(deepest, jnp.max(new.penetration))
        return closed, deepest, jnp.maximum(stability_number, new.stability_number)

    def after(self, carried, samples, status, run):
        limit = most_stability_number(run.plan.solver)
        return carried, np.asarray(judged_by_contacts(run.scenes, jnp.asarray(status), carried, limit))


FRACTION_BITS = 5
"""A class is told by so many leading bits of a force's fraction: its width is 1/64 to 1/32 of the force."""
_SHIFT = 52 - FRACTION_BITS
# between these forces [N] percentiles are resolved: smaller ones count as zero, larger ones as infinite
_LEAST_CLASS, _MOST_CLASS = (np.array([1.0, 2.0**28]).view(np.int64) >> _SHIFT).tolist()
FORCE_CLASSES = _MOST_CLASS - _LEAST_CLASS + 2
"""Number of classes, the first for zero and the last for infinite forces."""


LARGEST = float(np.finfo(float).max)
"""Largest number in double precision."""


def _each_once(name: str, values: Any, good: Callable[[Any], bool], need: str) -> tuple[float, ...]:
    """Return one or several numbers as a tuple; raises `ValueError` where one is not good, or given twice."""
    try:
        numbers = np.atleast_1d(np.asarray(values if np.size(values) else None, dtype=object))
    except (TypeError, ValueError):  # of datasets, and of rows of several lengths
        numbers = np.array([None])
    is_number = lambda x: isinstance(x, int | float | np.number) and not isinstance(x, bool) and abs(x) <= LARGEST
    fits = [is_number(x) and good(x) for x in numbers]
    require(numbers.ndim == 1 and all(fits) and len(set(numbers.tolist())) == len(numbers), name, need, values)
    return tuple(float(x) for x in numbers)


@dataclass(frozen=True)
class ForcePercentile(AbstractQuantityRecord):
    """Percentiles of the normal contact force over time, at each contact point [N].

    Forces at the two Gauss points of each step are counted in classes of their leading digits, and each is placed
    evenly in its class: a percentile is accurate to 1/32 of itself at worst, mostly to 0.5 %, and is 0 where a point
    is open for a larger share of the time. Between two forces it is interpolated as by `numpy.percentile`. While a
    case runs, its counts take 72 kB.
    """

    percentiles: tuple[float, ...] = (99.0,)
    """One or several [%], 0 to 100."""

    def __post_init__(self):
        need = "be numbers from 0 to 100, each once"
        percentiles = _each_once("percentiles", self.percentiles, lambda q: 0 <= q <= 100, need)
        object.__setattr__(self, "percentiles", percentiles)

    quantity = Quantity("contact_force_percentile", "N", "percentile over time of the normal contact force")

    @property
    def dims(self):
        return ("percentile", self.percentiles, attributes("percent", "percentile")), *POINTS

    def begin(self, scene, state):
        return np.zeros((2, scene.points // 2, FORCE_CLASSES), np.int32)

    def add(self, carried: Int[Array, "2 points classes"], course):
        bits = jax.lax.bitcast_convert_type(course.force.samples, jnp.int64)
        index = jnp.clip((bits >> _SHIFT) - (_LEAST_CLASS - 1), 0, FORCE_CLASSES - 1)
        ends, points = (jnp.arange(n) for n in carried.shape[:2])
        one = course.counted(jnp.ones_like(index, jnp.int32), 0)
        return carried.at[ends[None, :, None], points[None, None, :], index].add(one)

    def finish(self, carried, samples, span: RecordedSpan):
        count = span.periods * span.steps * len(GAUSS_PLACES)
        place = np.array(self.percentiles) / 100 * (count - 1)
        below = np.floor(place).astype(int)
        lower, upper = (_ranked(np.asarray(carried), np.minimum(k, count - 1)) for k in (below, below + 1))
        with np.errstate(invalid="ignore"):
            forces = np.where(lower == upper, lower, lower + (upper - lower) * (place - below))
        # a force that is no number is in the last class
        forces[span.status == Status.NOT_FINITE] = np.nan
        return np.moveaxis(forces, -1, 1)


def _ranked(counts: Int[np.ndarray, "*cases 2 points classes"], ranks: Int[np.ndarray, " percentiles"]) -> np.ndarray:
    """Return the forces of some ranks, 0 for the smallest [N], of shape (*cases, 2, points, percentiles)."""
    edges = ((np.arange(FORCE_CLASSES - 1) + _LEAST_CLASS) << _SHIFT).view(np.float64)
    low, width = np.array([0.0, *edges[:-1], np.inf]), np.array([0.0, *np.diff(edges), 0.0])
    total = np.cumsum(counts, axis=-1)
    at = np.stack([np.sum(total <= rank, axis=-1) for rank in ranks], axis=-1)
    count, upto = np.take_along_axis(counts, at, axis=-1), np.take_along_axis(total, at, axis=-1)
    return low[at] + width[at] * (ranks - upto + count + 0.5) / count


@dataclass(frozen=True)
class SpectrumLines(AbstractNumber):
    """Complex amplitudes of a coordinate or an acceleration at some multiples of the forcing frequency.

    Of the signal x over the recorded time T, the amplitude at f is A = (2/T) integral of x exp(-2 pi i f t) dt, for
    f = 0 the mean: x has the part Re(A exp(2 pi i f t)), with t the forcing periods since time zero of the track. The
    integral is taken by Gauss's formula in each step, without a window. Where f times the number of recorded periods
    is whole, other such lines add nothing to A; a frequency between them leaks into A, about as the reciprocal of its
    distance from f in multiples of 1/periods.
    """

    coordinate: str
    """One of `slipperjax.model.COORDINATES` or `ACCELERATIONS`."""
    frequencies: tuple[float, ...]
    """Multiples of the forcing frequency [1/period]: 1 for the forcing, 0.5 for what recurs after two periods."""

    join = JOINS["mean"]

    def __post_init__(self):
        one_of("coordinate", self.coordinate, (*COORDINATES, *ACCELERATIONS))
        need = "be numbers of zero or more, each once"
        frequencies = _each_once("frequencies", self.frequencies, lambda f: 0 <= f < np.inf, need)
        object.__setattr__(self, "frequencies", frequencies)

    @property
    def quantity(self):
        q = (COORDINATES | ACCELERATIONS)[self.coordinate]
        text = f"amplitude of the {q.long_name}: its real part is of the cosine, the imaginary one of minus the sine"
        return Quantity(f"spectrum_{self.coordinate}", q.unit, text)

    @property
    def dims(self):
        return ("part", ("real", "imag")), (f"frequency_{self.coordinate}", self.frequencies)

    def check(self, scene, periods, steps):
        if max(self.frequencies) >= steps / 2:
            raise ValueError(
                f"Argument `frequencies` must be below half of the {steps} steps per period, but is "
                f"{max(self.frequencies):g} [1/period]."
            )

    def of(self, course):
        is_acceleration = self.coordinate in ACCELERATIONS
        curve, names = (course.acceleration, ACCELERATIONS) if is_acceleration else (course.coordinates, COORDINATES)
        signal = course.counted(curve.samples[:, list(names).index(self.coordinate)], 0.0)
        frequencies = jnp.array(self.frequencies)
        # turns before the period are told apart, so that they are rounded once and not in each sample
        before = (frequencies * course.args.epoch % 1)[:, None]
        angle = 2 * jnp.pi * (frequencies[:, None] * course.times[None] + before)
        sums = jnp.stack([jnp.cos(angle) @ signal, -jnp.sin(angle) @ signal])
        return sums * jnp.where(frequencies > 0, 2, 1)[None] / (course.steps * len(GAUSS_PLACES))


def _of_coordinate(k: int, q: Quantity) -> tuple[Record, ...]:
    """Return the records of one of `COORDINATES`."""

    def about(prefix: str, text: str, symbol: str = "") -> Quantity:
        return dataclasses.replace(q, name=f"{prefix}_{q.name}", long_name=f"{text} {q.long_name}", symbol=symbol)

    size = lambda c: jnp.maximum(c.coordinates.greatest, -c.coordinates.least)[k]
    excursion = about("excursion", "greatest magnitude of the", rf"|{q.symbol or q.name}|_{{\max}}")
    return (
        Record(about("largest", "largest"), lambda c: c.coordinates.greatest[k], "max"),
        Record(about("smallest", "smallest"), lambda c: c.coordinates.least[k], "min"),
        Record(excursion, size, "max", samples=lambda c: c.coordinates.samples[:, k]),
    )


def _impulse_samples(c: Course) -> Array:
    return jnp.broadcast_to(c.loads.impulse, (len(c.times), *c.loads.impulse.shape))


def _rms(k: int, q: Quantity) -> Record:
    text, symbol = f"root mean square of the {q.long_name}", rf"\mathrm{{RMS}}\,{q.symbol}"
    return Record(Quantity(f"rms_{q.name}", q.unit, text, symbol), lambda c: c.acceleration.mean_square[k], "rms")


_IMPACT_IMPULSE = Quantity("impact_impulse", "N s", "greatest impulse of a point in a forcing period", "I")
_CONTACT_LOAD = Quantity(
    "contact_load", "N", "mean normal force of all points together", r"\sum\bar F", shown_unit="kN"
)
_CONTACT_WORK = Quantity("contact_work", "J/m", "energy lost in contacts per metre of travel", "W")
_DRIVE_FORCE = Quantity("drive_force", "N", "mean force along x that keeps the speed constant", r"\bar F_X")
_GRAZING = Quantity("grazing_distance", "m", "least distance of a gap's extreme from zero", "d", 1e-3, "mm")
_TABLE = (
    Record(LOADS["peak_force"], lambda c: c.loads.peak_force, "max", POINTS, lambda c: c.force.samples),
    PeakPeriod(),
    Record(LOADS["impulse"], lambda c: c.loads.impulse, "sum", POINTS),
    Record(LOADS["contact_fraction"], lambda c: c.loads.contact_fraction, "mean", POINTS),
    Record(LOADS["penetration"], lambda c: c.loads.penetration, "max", POINTS),
    Record(_IMPACT_IMPULSE, lambda c: c.loads.impulse, "max", POINTS, _impulse_samples),
    # by Archard's law (1953, doi:10.1063/1.1721448) the volume worn off in a metre of travel is proportional to it
    Record(_CONTACT_LOAD, lambda c: jnp.sum(c.force.mean), "mean"),
    Record(_CONTACT_WORK, lambda c: jnp.sum(c.power.integral) / c.travel.wavelength, "mean"),
    Record(_DRIVE_FORCE, lambda c: c.drive_force.mean, "mean"),
    # a contact that the motion almost makes, or almost loses, is as far from grazing as its gap's extreme from zero
    Record(_GRAZING, lambda c: jnp.min(c.gap.shallowest_turn), "min"),
    *(_rms(k, q) for k, q in enumerate(ACCELERATIONS.values())),
    *(record for k, q in enumerate(COORDINATES.values()) for record in _of_coordinate(k, q)),
)
RECORDS: Mapping[str, Any] = {record.name: record for record in _TABLE}
"""Records of numbers by name."""
ALIASES: Mapping[str, tuple[str, ...]] = {
    "loads": tuple(LOADS),
    "rms": tuple(f"rms_{name}" for name in ACCELERATIONS),
    "extremes": tuple(f"{which}_{name}" for which in ("largest", "smallest") for name in COORDINATES),
}
"""Names of several records."""
