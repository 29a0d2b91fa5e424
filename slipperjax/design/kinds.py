"""What objectives are: numbers made of the courses of forcing periods, as means, greatest values and power means."""

import abc
import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..flow import Course
from ..model import Quantity
from ..tools import brief, number, positive

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
        most = jnp.max(size)
        there = most > 0
        scale = jnp.where(there, most, 1.0)
        mean = jnp.sum(course.mean((size / scale) ** self.order))
        return jnp.where(there, jnp.log(jnp.where(there, mean, 1.0)) + self.order * jnp.log(scale), -jnp.inf)

    def total(self, kept):
        most = jnp.max(kept)
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
    if point not in places:
        raise ValueError(f"Argument `point` must be one of {', '.join(places)}, but is {brief(point)}.")
    return values[..., *places[point]]


def impulses(course: Course, point: str | None) -> Any:
    return of_point(course, course.mean(course.force.samples), point) * course.scene.period
