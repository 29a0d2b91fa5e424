"""Records that make a number of a run, such as a highest force, for sweeps, stores, designs and sensitivities.

The numbers can be differentiated in both modes. The derivative of a greatest value jumps where another point or
instant becomes the greatest. Therefore a descent follows the smooth form of the record, `smooth`.
"""

import abc
import dataclasses
import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..model.dynamics import static_loads
from ..model.parameters import DIRECTIONS
from ..model.quantities import ACCELERATIONS, COORDINATES, LOADS, SLIPPER_LOADS, Quantity
from ..model.scene import Scene
from ..tools.batching import Batched
from ..tools.checks import instance, number, one_of, positive, require
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.types import AnyArray, Real, Whole
from .course import Course
from .record import AbstractRecord, Unlabelled
from .status import most_stability_number, with_loads

POINTS = ("end", "point")
"""Dimensions of values at each contact point."""
OF_SLIPPERS = ("slipper", ("axis", ("y", "z")))
"""Dimensions of the net forces of slippers."""


class Join(NamedTuple):
    """A way to make one number of the values of all forcing periods: reduce each value, then finish the result."""

    empty: float  # the reduced value of zero periods
    reduce: Callable[..., Array]
    """Reduces values along axis 0; the result can be reduced with further values."""
    value: Callable[[AnyArray, Whole], AnyArray] = lambda joined, periods: joined
    """Returns the number from the reduced value and the number of periods."""
    size: Callable[[AnyArray], AnyArray] = lambda values: values
    """Returns the value by which the greatest of several values is chosen, such as the values of all points."""
    reduced: Callable[[AnyArray], AnyArray] = lambda values: values
    """Inverse of `value` for one period: returns the value from which `value` made a number."""
    weighted: Callable[[AnyArray, AnyArray], AnyArray] | None = None
    """Only for means: multiplies the values of periods by factors whose mean is 1."""

    def whole(self, values: AnyArray, weights: AnyArray | None = None) -> np.ndarray:
        """Return the number of several periods from the numbers of each, along axis 0; `weights`: for means, such as
        the duration of each period, with the shape of `values`."""
        reduced = self.reduced(values)
        if weights is not None and self.weighted is not None:
            reduced = self.weighted(reduced, weights / np.mean(weights, axis=0))
        return np.asarray(self.value(np.asarray(self.reduce(reduced, axis=0)), len(values)))


def _root_mean(joined: AnyArray, periods: Whole) -> AnyArray:
    square = joined / periods
    xp = np if isinstance(square, np.ndarray) else jnp  # on the host, so that nothing is compiled
    # the slope of a square root is infinite at zero, and would make the derivative NaN even in an unused branch
    return xp.where(square == 0, 0.0, xp.sqrt(xp.where(square == 0, 1.0, square)))


def _farthest(values: AnyArray, axis: int = 0) -> Array:
    """Return the value of greatest magnitude, with its sign."""
    highest = jnp.max(values, axis=axis)
    lowest = jnp.min(values, axis=axis)
    return jnp.where(highest >= -lowest, highest, lowest)


def _log_sum(values: Array, axis: int = 0) -> Array:
    """Return ln of the sum of exp(values), which may be minus infinity."""
    # the greatest value is taken out of the sum, so that nothing overflows
    most = jax.lax.stop_gradient(jnp.max(values, axis=axis))
    scale = jnp.where(jnp.isfinite(most), most, 0.0)
    total = jnp.sum(jnp.exp(values - jnp.expand_dims(scale, axis)), axis=axis)
    return jnp.where(
        jnp.isneginf(most),
        -jnp.inf,
        jnp.log(jnp.where(jnp.isneginf(most), 1.0, total)) + scale,
    )


JOINS: dict[str, Join] = {
    "max": Join(-np.inf, jnp.max),
    "min": Join(np.inf, jnp.min),
    "extreme": Join(0.0, _farthest, size=abs),
    "sum": Join(0.0, jnp.sum),
    "mean": Join(0.0, jnp.sum, lambda joined, periods: joined / periods, weighted=operator.mul),
    "rms": Join(0.0, jnp.sum, _root_mean, reduced=jnp.square, weighted=operator.mul),
}
"""Ways to make one number of all periods, by name."""


class AbstractQuantityRecord(AbstractRecord):
    """A record of one variable: a quantity, which may have its own dimensions."""

    quantity: Quantity
    """Name, unit and description."""
    dims: tuple[PyTree, ...] = ()
    """Dimensions of a value: "slipper", "end", "point", or a pair of another name and its labels. For a sled, values
    at ends or points have first the dimension of slippers."""

    @property
    def name(self) -> str:
        return self.quantity.name

    def labels(self, scene: Scene) -> dict[str, list]:
        """Return the names of `dims`, each with the labels along it."""
        of_points = scene.point_labels
        found = {}
        for d in self.dims:
            if not isinstance(d, str):
                name, own = d
                found[name] = list(own)
                continue
            # a single slipper has no axis of slippers
            for name in ("slipper", d):
                if name in of_points:
                    found[name] = of_points[name]
        return found

    def shape(self, scene: Scene) -> tuple[int, ...]:
        """Return the shape of one value."""
        return tuple(map(len, self.labels(scene).values()))

    def values(self, scene, periods):
        return math.prod(self.shape(scene))

    def label(self, scene, dims, values):
        along = self.labels(scene)
        q = self.quantity
        return {self.name: column((*dims, *along), values, q.unit, q.long_name)}, along


class AbstractNumber(AbstractQuantityRecord):
    """A number, or an array of them, from values of each forcing period."""

    join: Join
    """How the values of all periods become one value."""
    samples: Callable[[Course], PyTree] | None = None
    """For a record of a greatest magnitude: returns the values whose magnitude counts, with samples along the first
    axis. None for other records."""

    @abc.abstractmethod
    def of(self, course: Course) -> PyTree:
        """Return the value of one forcing period, an array with axes `dims`; for "rms" the square of the value."""

    @property
    def smooth(self) -> "AbstractNumber":
        """A smooth record for a descent: a power mean for a greatest magnitude, otherwise the record itself."""
        return self if self.samples is None else PowerMean(self)

    def total(self, values: Array) -> AnyArray:
        """Return the number in the quantity's unit, from the values of periods along the first axis."""
        return self.join.value(self.join.reduce(values, axis=0), len(values))

    def begin(self, scene, state):
        # a value that does not change the first period's value when both are reduced
        return np.full(self.shape(scene), self.join.empty)

    def add(self, carried, course):
        return self.join.reduce(jnp.stack([carried, self.of(course)]), axis=0)

    def finish(self, carried, samples, span):
        return np.asarray(self.join.value(np.asarray(carried), span.periods))


@dataclass(frozen=True)
class Record(AbstractNumber):
    """A number that a JAX function computes from the course of a forcing period.

    ```python
    load = Record(Quantity("front_load", "N", "mean force at the front"), lambda c: c.force.mean[0].sum(), "mean")
    ```
    """

    quantity: Quantity
    """Name, unit and description."""
    function: Callable[[Course], PyTree]
    """Returns a real number, or an array with axes `dims`, from a `slipperjax.flow.Course`. Another function, even a
    new lambda with the same text, is compiled again."""
    over: str = "max"
    """How the values of forcing periods become one: by "max", "min", "sum" or "mean"; by "extreme", the value of
    greatest magnitude with its sign; or by "rms", for which `function` returns squares."""
    dims: tuple[str | tuple[str, tuple], ...] = ()
    samples: Callable[[Course], PyTree] | None = None
    """For a greatest magnitude, and for `smooth`: the values whose magnitude counts, samples along the first axis."""

    def __post_init__(self):
        require(callable(self.function), "function", "be a function of a course", self.function)
        instance("quantity", self.quantity, Quantity, "a slipperjax.model.Quantity")
        require(self.name.isidentifier(), "quantity", "have a name such as spring_force", self.name)
        one_of("over", self.over, tuple(JOINS))

    @property
    def join(self):
        return JOINS[self.over]

    @property
    def is_extreme(self) -> bool:
        """Whether the number is a greatest or least value for each of several points or slippers."""
        return bool(self.dims) and self.over in ("max", "min", "extreme")

    def of(self, course):
        value = jnp.asarray(self.function(course))
        shape = self.shape(course.scene)
        if value.dtype.kind not in "fiub" or value.shape != shape:
            need = f"of `{self.name}` must give real numbers of the shape of `dims`, {shape}"
            raise ValueError(f"Argument `function` {need}, but gives {jax.typeof(value)}.")
        return jnp.asarray(value, float)


@dataclass(frozen=True)
class PowerMean(AbstractNumber):
    """A power mean in place of a greatest magnitude, for descents: it is smooth, and slightly below the greatest.

    For magnitudes x it is (mean over time of the sum over points of x^order)^(1/order).
    """

    record: AbstractNumber
    """The record of a greatest magnitude; it must have `samples`."""
    order: float = 32
    """Order of the mean; a higher order is nearer to the greatest magnitude, but less smooth."""

    def __post_init__(self):
        number(positive, "order", self.order)
        instance("record", self.record, AbstractNumber, "a record of one number")
        require(self.record.samples, "record", "have samples", shown=type(self.record).__name__)

    @property
    def quantity(self):
        q = self.record.quantity
        text = f"power mean of order {self.order:g}, for the {q.long_name}"
        return dataclasses.replace(q, name=f"soft_{q.name}", long_name=text, symbol="")

    @property
    def join(self):
        # on the host, so that nothing is compiled
        exp = lambda x: np.exp(x) if isinstance(x, np.ndarray) else jnp.exp(x)
        value = lambda joined, periods: exp((joined - np.log(periods)) / self.order)
        weighted = lambda logarithm, share: logarithm + np.log(share)
        return Join(-np.inf, _log_sum, value, reduced=lambda x: self.order * jnp.log(x), weighted=weighted)

    def of(self, course):
        """Return ln of the mean over time of the sum of x^order, because the power itself would overflow."""
        assert self.record.samples is not None
        size = jnp.abs(self.record.samples(course))
        size = size.reshape(len(size), -1)
        # samples of unused steps do not count for the scale
        counted = course.counted(size, 0.0)
        most = jax.lax.stop_gradient(jnp.max(counted))  # only a scale: the result does not depend on it
        scale = jnp.where(most > 0, most, 1.0)
        mean = jnp.sum(course.mean((counted / scale) ** self.order))
        logarithm = jnp.log(jnp.where(most > 0, mean, 1.0)) + self.order * jnp.log(scale)
        return jnp.where(most > 0, logarithm, jnp.where(jnp.isnan(most), jnp.nan, -jnp.inf))


@dataclass(frozen=True)
class OnePoint(AbstractNumber):
    """One number from a record of all contact points or slippers: that of one, or the greatest or least."""

    record: Record
    """A greatest or least value at each point or slipper, such as the highest force."""
    point: str | None = None
    """A point's name with 1 for the front or 2 for the rear, such as "A1", for a sled "left2_A1"; for slippers the
    labels, such as "left2_z", or "z" for a single slipper; None: all points or slippers."""

    def __post_init__(self):
        instance("record", self.record, Record, "a slipperjax.flow.Record")
        need = "be a point's name with 1 or 2, or None"
        require(self.point is None or isinstance(self.point, str), "point", need, self.point)
        if not self.record.is_extreme:
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
        return self.join.reduce(self.join.size(self._at_point(course, self.record.of(course))).ravel(), axis=0)

    def _at_point(self, course: Course, values: Float[Array, "..."]) -> Array:
        if self.point is None:
            return values
        scene = course.scene
        labels = self.record.labels(scene)
        names = scene.point_names if "point" in labels else list(map("_".join, itertools.product(*labels.values())))
        require(self.point in names, "point", f"be one of {', '.join(names)}", self.point)
        return values[..., *np.unravel_index(names.index(self.point), self.record.shape(scene))]


class AbstractAtPeak(AbstractQuantityRecord):
    """A number at the instant of each point's highest normal force; NaN where the point stays open throughout."""

    dims = POINTS

    def height(self, course: Course) -> Array:
        """Return the value that is highest at this instant, in one forcing period."""
        return course.loads.peak_force

    @abc.abstractmethod
    def of(self, course: Course) -> PyTree:
        """Return the number at the highest values of one forcing period, in the shape of `height`."""

    def begin(self, scene, state):
        # the highest forces so far, and the numbers at their instants
        none = np.zeros(self.shape(scene))
        return none, np.full_like(none, np.nan)

    def add(self, carried, course):
        highest, there = carried
        force = self.height(course)
        # an open point has no highest force yet, and stays NaN
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


def _only(values: Array, axis: int = 0) -> Array:
    """Return the only one of some values along the first axis; NaN for several values."""
    return values[0] if len(values) == 1 else jnp.full_like(values[0], jnp.nan)


ONE_PERIOD = Join(np.nan, _only)
"""A join for values that have no common number over several periods."""


@dataclass(frozen=True)
class PeakDistance(AbstractAtPeak, AbstractNumber):
    """The distance travelled at the highest normal force of each point; NaN where it is open throughout."""

    quantity = Quantity("peak_distance", "m", "distance travelled at the highest force of a contact point")
    # distances alone do not show in which of several windows the highest force was
    join = ONE_PERIOD

    def of(self, course):
        return course.loads.peak_period * course.travel.wavelength

    def finish(self, carried, samples, span):
        return np.asarray(carried[1])


@dataclass(frozen=True)
class SlipperPeakDistance(PeakDistance):
    """The distance travelled at the greatest net force of each slipper along each axis; NaN without contact."""

    quantity = SLIPPER_LOADS["peak_slipper_distance"]
    dims = OF_SLIPPERS

    def height(self, course):
        return jnp.abs(course.slipper_load.extreme[..., :2])

    def of(self, course):
        return (course.slipper_load.extreme_place[..., :2] + course.args.epoch) * course.travel.wavelength


@jit
def judged_by_contacts(
    scenes: Batched[Scene],
    codes: np.ndarray,
    carried: PyTree,
    limit: Real,
) -> Int[Array, " cases"]:
    """Return `Status` codes of `with_loads`, from carries of `ContactChecks`; `limit`: `most` of `with_loads`."""
    return scenes.map(lambda scene, code, loads: with_loads(code, *loads, scene=scene, most=limit), codes, carried)


@dataclass(frozen=True)
class ContactChecks(Unlabelled):
    """A record without a variable, for statuses from loads: no contact, pressed in, too few steps, damped."""

    def values(self, scene, periods):
        return 4

    def begin(self, scene, state):
        # sum of the contact fractions, greatest penetration, stability number and damping ratio
        return np.zeros(()), np.full((), -np.inf), np.zeros(()), np.zeros(())

    def add(self, carried, course):
        closed, deepest, stability_number, damping_ratio = carried
        new = course.loads
        closed = closed + jnp.sum(new.contact_fraction)
        deepest = jnp.maximum(deepest, jnp.max(new.penetration))
        stability_number = jnp.maximum(stability_number, new.stability_number)
        return closed, deepest, stability_number, jnp.maximum(damping_ratio, new.damping_ratio)

    def judge(self, carried, status, scenes, solver):
        limit = most_stability_number(solver)
        return np.asarray(judged_by_contacts(scenes, jnp.asarray(status), carried, limit))


def _of_coordinate(k: int, q: Quantity) -> tuple[Record, ...]:
    """Return the records of the coordinate with index `k` in `COORDINATES`: largest, smallest, greatest magnitude."""

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
    """Return the points' impulses once for each sample, so that their power mean is a mean over points only."""
    return jnp.broadcast_to(c.loads.impulse, (len(c.times), *c.loads.impulse.shape))


def _rms(k: int, q: Quantity) -> Record:
    """Return the record of the root mean square of one of `ACCELERATIONS`."""
    text = f"root mean square of the {q.long_name}"
    symbol = rf"\mathrm{{RMS}}\,{q.symbol}"
    # one function for each record, so that each lambda keeps its own k
    return Record(Quantity(f"rms_{q.name}", q.unit, text, symbol), lambda c: c.acceleration.mean_square[k], "rms")


def _of_slippers() -> Iterator[AbstractQuantityRecord]:
    """Yield the records of slippers' net loads."""
    force = SLIPPER_LOADS["peak_slipper_force"]
    load = lambda c: c.slipper_load
    yield Record(
        force, lambda c: load(c).extreme[..., :2], "extreme", OF_SLIPPERS, lambda c: load(c).samples[..., :2]
    )
    moment = SLIPPER_LOADS["peak_slipper_moment"]
    # not the dimension of forces, because these have no x
    about = ("slipper", ("about", ("x", "y", "z")))
    yield Record(moment, lambda c: load(c).extreme[..., 2:], "extreme", about, lambda c: load(c).samples[..., 2:])
    yield SlipperPeakDistance()
    ratio = lambda c, load: jnp.abs(load[..., 1]) / static_loads(c.scene, c.travel)
    yield Record(
        SLIPPER_LOADS["static_ratio"],
        lambda c: ratio(c, load(c).extreme),
        dims=("slipper",),
        samples=lambda c: jax.vmap(functools.partial(ratio, c))(load(c).samples),
    )


def _records() -> Iterator[AbstractQuantityRecord]:
    """Yield all records of numbers that have a name."""
    points = functools.partial(Record, dims=POINTS)
    yield points(LOADS["peak_force"], lambda c: c.loads.peak_force, samples=lambda c: c.force.samples)
    yield PeakPeriod()
    yield points(LOADS["impulse"], lambda c: c.loads.impulse, "sum")
    yield points(LOADS["contact_fraction"], lambda c: c.loads.contact_fraction, "mean")
    yield points(LOADS["penetration"], lambda c: c.loads.penetration)
    yield from _of_slippers()
    greatest = Quantity("impact_impulse", "N s", "greatest impulse of a point in a forcing period", "I")
    yield points(greatest, lambda c: c.loads.impulse, samples=_impulse_samples)
    # by Archard's law (1953, doi:10.1063/1.1721448) the volume worn off in a metre of travel is proportional to this
    text = "mean normal force of all points together"
    load = Quantity("contact_load", "N", text, r"\sum\bar F", shown_unit="kN")
    yield Record(load, lambda c: jnp.sum(c.force.mean), "mean")
    work = Quantity("contact_work", "J/m", "energy lost in contacts per metre of travel", "W")
    yield Record(work, lambda c: jnp.sum(c.power.integral) / c.travel.wavelength, "mean")
    drive = Quantity("drive_force", "N", "mean force along x that keeps the speed constant", r"\bar F_X")
    yield Record(drive, lambda c: c.drive_force.mean, "mean")
    text = "highest damping force over elastic force of a point in contact"
    damping = Quantity("damping_ratio", "1", text, r"F_D/F_E")
    yield points(damping, lambda c: jnp.max(c.damping_ratio, axis=0))
    # distance of a contact that nearly closes or nearly opens from grazing: the extreme of its gap nearest to zero
    distance = Quantity("grazing_distance", "m", "least distance of a gap's extreme from zero", "d", 1e-3, "mm")
    yield Record(distance, lambda c: jnp.min(c.gap.shallowest_turn), "min")
    bends = Quantity("rail_deflection", "m", "greatest deflection of the rails under the slippers", "w", 1e-3, "mm")
    of_nodes = lambda c: c.rail_deflection.extreme
    yield Record(bends, lambda c: jnp.max(jnp.abs(of_nodes(c)), axis=1), "max", (("direction", DIRECTIONS),))
    stored = Quantity("rail_energy", "J", "greatest energy of the rails at the end of a forcing period", "E")
    yield Record(stored, lambda c: c.rail_energy)
    for k, q in enumerate(ACCELERATIONS.values()):
        yield _rms(k, q)
    for k, q in enumerate(COORDINATES.values()):
        yield from _of_coordinate(k, q)


RECORDS: Mapping[str, AbstractQuantityRecord] = {record.name: record for record in _records()}
"""Records of numbers by name."""
ALIASES: Mapping[str, tuple[str, ...]] = {
    "loads": tuple(LOADS),
    "slipper_peak": tuple(SLIPPER_LOADS),
    "rms": tuple(f"rms_{name}" for name in ACCELERATIONS),
    "extremes": tuple(f"{which}_{name}" for which in ("largest", "smallest") for name in COORDINATES),
}
"""Names of several records."""
