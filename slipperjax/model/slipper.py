"""The slipper, a rigid body; and the methods that a scene needs of bodies with slippers."""

import abc
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

    def reach(self, section: Section) -> Array:
        """Return the greatest distance of contact points from the x axis, along y or z [m]."""
        return _greatest([_farthest(slipper) for slipper in self.mounted(section)])

    def half_length(self, section: Section) -> Array:
        """Return the greatest distance of contact points from the centre of mass along x [m]."""
        ends = []
        for slipper in self.mounted(section):
            x = slipper.place[0]
            ends.append(slipper.length / 2 if x is None else jnp.abs(x) + slipper.length / 2)
        return _greatest(ends)


def _farthest(slipper: Mounted) -> Array:
    """Return the greatest lateral or vertical distance of a slipper's points from the body's x axis [m]."""
    _, y, z = slipper.place
    points = slipper.section.points
    if y is not None or z is not None:
        points = points + jnp.stack([jnp.zeros(()) if v is None else v for v in (y, z)])[None]
    return jnp.max(jnp.abs(points))


def _greatest(values: list[Array]) -> Array:
    return values[0] if len(values) == 1 else jnp.max(jnp.stack(values))


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
