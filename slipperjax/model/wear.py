"""Clearance that opens along a run, by a law of wear or by a table."""

import abc
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.checks import not_negative
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.types import Real
from .section import Section


class AbstractWear(ShapeChecked):
    """A law by which the play of a slipper's faces opens along a run; only `slipperjax.run` uses it."""

    by_friction: ClassVar[bool] = False
    """Whether the law needs a scene with friction."""

    @abc.abstractmethod
    def added(
        self, section: Section, length: Real, distance: Real, work: Float[Array, " faces"]
    ) -> Float[Array, " faces"]:
        """Return the play that has been added to each face [m].

        **Arguments:** `length`: of the slipper [m]; `distance`: travelled [m]; `work`: heat of friction at each face,
        front and rear together, since the start [J].
        """


class Wear(AbstractWear):
    """Wear in proportion to the work of friction, spread evenly over a face.

    Archard's law (1953, doi:10.1063/1.1721448): the worn volume is proportional to normal force times sliding
    distance, here with a coefficient of friction.
    """

    by_friction: ClassVar = True
    volume_per_work: Float[Array, ""] = field("m^3/J", not_negative)
    """Volume worn off per work of friction [m^3/J]."""

    def added(self, section, length, distance, work):
        # the worn volume, spread over the area of each face
        return self.volume_per_work * work / (section.widths * length)


class WearTable(AbstractWear):
    """Play that is added to all faces as a function of distance, linear between the rows of a table."""

    distance: Float[Array, " rows"] = field("m", not_negative)
    """Distances, increasing [m]."""
    play: Float[Array, " rows"] = field("m", not_negative)
    """Play added to each face at these distances [m]: half of the added clearance."""

    def __check_init__(self):
        check_table(self, "distance", "play")

    def added(self, section, length, distance, work):
        # the same for all faces
        return jnp.broadcast_to(jnp.interp(distance, self.distance, self.play), work.shape)
