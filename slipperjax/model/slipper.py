"""The slipper, a rigid body; and the methods that a scene needs of bodies with slippers."""

import abc
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import positive, warn
from ..tools.fields import ShapeChecked, field
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Real
from .modes import Modes
from .section import Section


class Mounted(NamedTuple):
    """One slipper at its place on the body."""

    place: tuple[Real | None, Real | None, Real | None]
    """x, y and z of its middle from the body's centre of mass [m]; None for zero, which adds no operations."""
    length: Float[Array, ""]
    """Distance between its front and its rear section [m]."""
    section: Section
    """Its section, whose origin is its middle."""
    rail: str
    """Name of the slipper's rail; empty for the only rail."""
    ahead: Real | None
    """How far the slipper's front end is ahead of the counted distance [m]; None for zero."""

    @property
    def arms(self) -> list[Float[Array, " both_ends"]]:
        """x, y and z of the points of its front, then of its rear end, in the body's frame [m]."""
        # A constant array: an index computed inside the loop over cases and points would prevent vectorisation.
        x = self.length * np.repeat([0.5, -0.5], self.section.points.shape[0])
        # the rear end has the section of the front one
        own = (x, *jnp.tile(self.section.points, (2, 1)).T)
        return [v if place is None else v + place for v, place in zip(own, self.place, strict=True)]


class AbstractBody(ShapeChecked):
    """A body that rides the rail on one slipper or more."""

    mass: eqx.AbstractVar[Float[Array, ""]]
    inertia: eqx.AbstractVar[Float[Array, "3"]]
    length: eqx.AbstractVar[Float[Array, ""]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the slippers; empty for a body that is a slipper."""
        return ()

    @property
    def modes(self) -> Modes | None:
        """Elastic modes; None for a rigid body."""
        return None

    @property
    def static_shares(self) -> Float[AnyArray, " slippers"]:
        """Shares of the weight that the slippers carry [1]."""
        return np.ones(1)

    @abc.abstractmethod
    def mounted(self, section: Section) -> tuple[Mounted, ...]:
        """Return the slippers; `section`: for slippers without their own section."""


def side_by_side(parts: Sequence[AnyArray]) -> AnyArray:
    """Return arrays joined along their last axis; a single array unchanged."""
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts, axis=-1)


def stacked(numbers: Iterable[Real | None]) -> Array:
    """Return numbers, one for each slipper, as an array; None is zero."""
    return jnp.stack([jnp.zeros(()) if number is None else number for number in numbers])


class Slipper(AbstractBody):
    """A rigid slipper."""

    mass: Float[Array, ""] = field("kg", positive, plausible=(0.1, 1e4), symbol="m")
    """Mass [kg]."""
    inertia: Float[Array, "3"] = field("kg m^2", positive, plausible=(1e-9, 1e4), symbol="J")
    """Principal moments of inertia about x, y and z of the slipper's frame [kg m^2]."""
    length: Float[Array, ""] = field("m", positive, plausible=(0.005, 20.0), symbol="L")
    """Distance between the front and the rear section [m]."""

    def __check_init__(self):
        check_inertia(self, self.length, "slipper lengths")

    def mounted(self, section):
        return (Mounted((None, None, None), self.length, section, "", None),)


def check_inertia(body: AbstractBody, length: Real, unit: str) -> None:
    """Warn of moments of inertia that no body of a length [m] can have; `unit`: name of the length, plural."""
    if is_traced((body.mass, body.inertia, length)) or body.inertia.shape != (3,):
        return
    inertia = np.asarray(body.inertia)
    # radii of gyration over the length; wrong units make these implausible
    radii = np.sqrt(inertia / np.asarray(body.mass)) / np.asarray(length)
    if np.min(radii) < 0.01 or np.max(radii) > 2:
        worst = radii[np.argmax(np.abs(np.log(radii)))]
        warn(f"Argument `inertia` has a radius of gyration of {worst:.3g} {unit}. Are the units right?")
    # for a plate both sides are equal, up to rounding
    if 2 * np.max(inertia) > np.sum(inertia) * (1 + 1e-9):
        warn("Argument `inertia` has a moment greater than the sum of the others, which no body has.")
