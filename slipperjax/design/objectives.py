"""Objectives: numbers that a design is judged by, with one definition on orbits, runs and ensembles.

They can be differentiated in both modes. Greatest values jump between points and instants where several attain them,
so that each objective names a smooth one to descend on.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..flow.course import Course
from ..model.quantities import ACCELERATIONS, COORDINATES, Quantity
from ..tools.checks import brief, number, one_of, positive, require

ORDER = 32
"""Default order of the power means that stand for greatest values [1]."""
KN: dict[str, Any] = dict(shown_unit="kN", per_shown=1e3)


@dataclasses.dataclass(frozen=True)
class AbstractObjective(abc.ABC):
    """A number that a motion is judged by. Equal ones share compiled programs."""

    @property
    @abc.abstractmethod
    def quantity(self) -> Quantity:
        """Name, unit and description of the number."""

    @property
    def name(self) -> str:
        """The name in datasets, and for the command line where `objective` knows it."""
        return self.quantity.name

    @property
    def unit(self) -> str:
        """SI unit."""
        return self.quantity.unit

    @property
    def smooth(self) -> "AbstractObjective":
        """What stands for it in descents: itself, or a power mean near a greatest value."""
        return self


class AbstractCourseObjective(AbstractObjective):
    """An objective that is made of the courses of forcing periods."""

    @abc.abstractmethod
    def of_course(self, course: Course) -> Any:
        """What is kept of one forcing period: a pytree of arrays."""

    @abc.abstractmethod
    def total(self, kept: Any) -> Float[Array, ""]:
        """The number [`unit`] from what was kept, with a leading axis of forcing periods."""


class Mean(AbstractCourseObjective):
    """An objective that is the mean over the forcing periods of one number of each."""

    def total(self, kept):
        return jnp.mean(kept)


class Greatest(AbstractCourseObjective):
    """An objective that is the greatest of the forcing periods' numbers."""

    def total(self, kept):
        return jnp.max(kept)


class PowerMean(AbstractCourseObjective):
    """A power mean of magnitudes over time, summed over their places: near the greatest, and smooth."""

    @property
    @abc.abstractmethod
    def order(self) -> float:
        """Its order p [1]: (mean over time of sum x^p)^(1/p)."""

    def logarithm(self, course: Course, samples: Float[Array, "samples ..."]) -> Float[Array, ""]:
        """ln of the mean over time of the sum of |samples|^order, without overflow; minus infinity for zeros."""
        size = jnp.abs(samples).reshape(len(samples), -1)
        size = jnp.where(course.weights[:, None] > 0, size, 0.0)
        most = jax.lax.stop_gradient(jnp.max(size))  # a scale alone: the result does not depend on it
        there = most > 0
        scale = jnp.where(there, most, 1.0)
        mean = jnp.sum(course.mean((size / scale) ** self.order))
        return jnp.where(there, jnp.log(jnp.where(there, mean, 1.0)) + self.order * jnp.log(scale), -jnp.inf)

    def total(self, kept):
        most = jax.lax.stop_gradient(jnp.max(kept))
        there = jnp.isfinite(most)
        rest = jnp.where(there, kept - jnp.where(there, most, 0.0), 0.0)
        found = jnp.exp((jnp.log(jnp.mean(jnp.exp(rest))) + jnp.where(there, most, 0.0)) / self.order)
        return jnp.where(there, found, jnp.where(jnp.isnan(most), jnp.nan, 0.0))


def check_order(objective: Any) -> None:
    number(positive, "order", objective.order)


def at_point(name: str, unit: str, text: str, symbol: str, point: str | None, shown: Any = None) -> Quantity:
    more = {} if shown is None else shown
    if point is None:
        return Quantity(name, unit, text, symbol, **more)
    return Quantity(f"{name}_{point}", unit, f"{text} at {point}", symbol, **more)


def of_point(course: Course, values: Float[Array, "*first 2 points"], point: str | None) -> Any:
    """Values of one point, or of all."""
    if point is None:
        return values
    names = course.scene.section.names
    places = {f"{name}{end + 1}": (end, k) for end in range(2) for k, name in enumerate(names)}
    require(point in places, "point", f"be one of {', '.join(places)}", point)
    return values[..., *places[point]]


def impulses(course: Course, point: str | None) -> Any:
    return of_point(course, course.mean(course.force.samples), point) * course.scene.period


@dataclasses.dataclass(frozen=True)
class PeakForce(Greatest):
    """The highest normal contact force [N] of one point or of all, over every integration step."""

    point: str | None = None
    """A point's name and 1 for the front or 2 for the rear, such as "A1"; None for all."""

    @property
    def quantity(self):
        return at_point("peak_force", "N", "highest normal contact force", r"F_{\max}", self.point, KN)

    @property
    def smooth(self):
        return SoftPeakForce(self.point)

    def of_course(self, course):
        return jnp.max(of_point(course, course.greatest(course.force), self.point))


@dataclasses.dataclass(frozen=True)
class SoftPeakForce(PowerMean):
    """A power mean of the normal contact force [N], over time and summed over points: below the peak, and smooth."""

    point: str | None = None
    """As of `PeakForce`."""
    order: float = ORDER  # pyright: ignore[reportIncompatibleMethodOverride]

    def __post_init__(self):
        check_order(self)

    @property
    def quantity(self):
        text = f"power mean of order {self.order:g} of the normal contact force"
        return at_point("soft_peak_force", "N", text, r"\|F\|", self.point, KN)

    def of_course(self, course):
        return self.logarithm(course, of_point(course, course.force.samples, self.point))


@dataclasses.dataclass(frozen=True)
class RMSAcceleration(Mean):
    """The root mean square of an acceleration of the slipper's centre [m/s^2] or of its spin [rad/s^2]."""

    direction: str = "a_z"
    """One of `slipperjax.model.ACCELERATIONS`."""

    def __post_init__(self):
        one_of("direction", self.direction, tuple(ACCELERATIONS))

    @property
    def quantity(self):
        q = ACCELERATIONS[self.direction]
        return Quantity(
            f"rms_{q.name}", q.unit, f"root mean square of the {q.long_name}", rf"\mathrm{{RMS}}\,{q.symbol}"
        )

    def of_course(self, course):
        return course.mean(course.acceleration.samples[:, list(ACCELERATIONS).index(self.direction)] ** 2)

    def total(self, kept):
        square = jnp.mean(kept)
        there = square > 0
        return jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), jnp.where(jnp.isnan(square), jnp.nan, 0.0))


@dataclasses.dataclass(frozen=True)
class ImpactImpulse(Greatest):
    """The greatest impulse of the normal force that one point receives in a forcing period [N s]."""

    point: str | None = None
    """As of `PeakForce`."""

    @property
    def quantity(self):
        return at_point("impact_impulse", "N s", "greatest impulse of a point in a forcing period", "I", self.point)

    @property
    def smooth(self):
        return SoftImpactImpulse(self.point)

    def of_course(self, course):
        return jnp.max(impulses(course, self.point))


@dataclasses.dataclass(frozen=True)
class SoftImpactImpulse(AbstractCourseObjective):
    """The power mean over forcing periods of the impulses of the points [N s], summed over them: smooth."""

    point: str | None = None
    """As of `PeakForce`."""
    order: float = ORDER

    def __post_init__(self):
        check_order(self)

    @property
    def quantity(self):
        text = f"power mean of order {self.order:g} of the points' impulses in a forcing period"
        return at_point("soft_impact_impulse", "N s", text, r"\|I\|", self.point)

    def of_course(self, course):
        return jnp.ravel(impulses(course, self.point))

    def total(self, kept):
        most = jnp.max(kept)
        scale = jnp.where(most > 0, most, 1.0)
        mean = jnp.mean(jnp.sum((kept / scale) ** self.order, axis=-1))
        return scale * jnp.where(mean > 0, mean, 1.0) ** (1 / self.order) * jnp.where(most > 0, 1.0, most)


@dataclasses.dataclass(frozen=True)
class ContactLoad(Mean):
    """The mean over time of the normal forces of all points together [N].

    By Archard's law (1953, doi:10.1063/1.1721448) the volume worn off in a metre of travel is proportional to it.
    """

    @property
    def quantity(self):
        return Quantity("contact_load", "N", "mean normal force of all points together", r"\sum\bar F", **KN)

    def of_course(self, course):
        return jnp.sum(course.mean(course.force.samples))


@dataclasses.dataclass(frozen=True)
class ContactWork(Mean):
    """The energy that the contacts take from the motion along their normals, per metre of travel [J/m]."""

    @property
    def quantity(self):
        return Quantity("contact_work", "J/m", "energy lost in contacts per metre of travel", "W")

    def of_course(self, course):
        return jnp.sum(course.mean(course.power.samples)) / course.scene.speed


@dataclasses.dataclass(frozen=True)
class DriveForce(Mean):
    """The mean force along x that keeps the speed constant [N]: its product with the speed is the power needed."""

    @property
    def quantity(self):
        return Quantity("drive_force", "N", "mean force along x that keeps the speed constant", r"\bar F_X")

    def of_course(self, course):
        return course.mean(course.drive_force.samples)


@dataclasses.dataclass(frozen=True)
class Excursion(Greatest):
    """The greatest magnitude of a coordinate: a displacement [m], an angle [rad] or a velocity."""

    coordinate: str = "z"
    """One of `slipperjax.model.COORDINATES`."""

    def __post_init__(self):
        one_of("coordinate", self.coordinate, tuple(COORDINATES))

    @property
    def quantity(self):
        q = COORDINATES[self.coordinate]
        return Quantity(
            f"excursion_{q.name}",
            q.unit,
            f"greatest magnitude of the {q.long_name}",
            rf"|{q.symbol or q.name}|_{{\max}}",
            shown_unit=q.shown_unit,
            per_shown=q.per_shown,
        )

    @property
    def smooth(self):
        return SoftExcursion(self.coordinate)

    def of_course(self, course):
        curve, k = course.coordinates, list(COORDINATES).index(self.coordinate)
        return jnp.maximum(course.greatest(curve)[k], -course.least(curve)[k])


@dataclasses.dataclass(frozen=True)
class SoftExcursion(PowerMean):
    """The power mean over time of a coordinate's magnitude: below the greatest, and smooth."""

    coordinate: str = "z"
    """As of `Excursion`."""
    order: float = ORDER  # pyright: ignore[reportIncompatibleMethodOverride]

    def __post_init__(self):
        one_of("coordinate", self.coordinate, tuple(COORDINATES))
        check_order(self)

    @property
    def quantity(self):
        hard = Excursion(self.coordinate).quantity
        text = hard.long_name.replace("greatest", f"power mean of order {self.order:g} of the")
        return dataclasses.replace(hard, name=f"soft_{hard.name}", long_name=text)

    def of_course(self, course):
        return self.logarithm(course, course.coordinates.samples[:, list(COORDINATES).index(self.coordinate)])


@dataclasses.dataclass(frozen=True)
class GrazingDistance(AbstractCourseObjective):
    """The least magnitude of an extreme of any point's gap [m]: zero where a contact begins or ends with rate zero.

    A contact that the orbit almost makes, or almost loses, is as far from grazing as its gap's extreme is from zero.
    """

    @property
    def quantity(self):
        return Quantity("grazing_distance", "m", "least distance of a gap's extreme from zero", "d", 1e-3, "mm", 1e-3)

    def of_course(self, course):
        return jnp.min(course.shallowest_turn(course.gap))

    def total(self, kept):
        return jnp.min(kept)


@dataclasses.dataclass(frozen=True)
class Exponent(AbstractObjective):
    """The largest Lyapunov exponent [1/period]: on an orbit, ln |largest Floquet multiplier| per forcing period.

    Negative where disturbances die away; an orbit with a margin to its flip or fold has it below some limit.
    """

    @property
    def quantity(self):
        return Quantity("exponent", "1/period", "largest Lyapunov exponent", r"\lambda")


@dataclasses.dataclass(frozen=True)
class Functional(Mean):
    """The mean over forcing periods of any JAX function of a course."""

    function: Callable[[Course], Any]
    """Gives one number of a `slipperjax.flow.Course`, such as `lambda c: c.mean(c.drive_force.samples ** 2)`."""
    label: str = "functional"
    """Its name in datasets."""
    units: str = "1"
    text: str = ""
    """Description in a few words."""

    @property
    def quantity(self):
        return Quantity(self.label, self.units, self.text or self.label)

    def of_course(self, course):
        return self.function(course)


OBJECTIVES: dict[str, AbstractObjective] = {
    found.name: found
    for found in (
        PeakForce(),
        *map(RMSAcceleration, ACCELERATIONS),
        ImpactImpulse(),
        ContactLoad(),
        ContactWork(),
        DriveForce(),
        *map(Excursion, ("y", "z", "roll", "pitch", "yaw")),
        GrazingDistance(),
        Exponent(),
    )
}
"""Objectives by name."""


def objective_named(given: Any) -> AbstractObjective:
    """An objective as it is, by its name, or as a function of a course.

    **Raises:** `ValueError` for anything else, with the names.
    """
    if isinstance(given, AbstractObjective):
        return given
    if isinstance(given, str) and given in OBJECTIVES:
        return OBJECTIVES[given]
    if callable(given) and not isinstance(given, type):
        return Functional(given, getattr(given, "__name__", "functional").strip("<>"))
    raise ValueError(
        f"Argument `objective` must be one of {', '.join(OBJECTIVES)}, an objective of slipperjax.design, or a "
        f"function of a course, but is {brief(given)}."
    )
