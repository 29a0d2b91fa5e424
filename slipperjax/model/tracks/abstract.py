"""The interface of tracks: irregularity as functions of distance, Eq. (9) of Dang et al. 2024."""

import abc
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...tools import ShapeChecked, instance

SAMPLES = 512
"""Points per wavelength at which `AbstractTrack.approach_speed` samples the slope."""


class Irregularity(NamedTuple):
    """Displacement of the rail's axis at some distances, or its slope there (per metre of travel)."""

    lateral: Any
    """Along y, positive to the left [m]; slope [m/m]."""
    vertical: Any
    """Along z, positive upwards [m]; slope [m/m]."""
    roll: Any
    """About x [rad]; slope [rad/m]. None where the track does not roll, which omits its operations."""


class AbstractTrack(ShapeChecked):
    """A track whose irregularity is a function of distance alone. Subclasses define the two abstract members."""

    @property
    @abc.abstractmethod
    def wavelength(self) -> Float[Array, ""]:
        """The length that defines the forcing period [m]: period = wavelength / speed."""

    @abc.abstractmethod
    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        """Displacements of the rail at `distance` [m]; differentiable, and precise after any number of periods."""

    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        """Displacements at `distance` [m], and their slopes per metre of travel."""
        found, slope = jax.jvp(self.irregularity, (distance,), (jnp.ones_like(distance),))
        return instance("irregularity", found, Irregularity, "a slipperjax.Irregularity"), slope

    def approach_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Typical speed at which the rail approaches the slipper [m/s], used to choose step sizes.

        By default the steepest lateral or vertical slope in the first wavelength times the travelling `speed` [m/s].
        """
        _, slope = self.motion(self.wavelength * jnp.arange(SAMPLES) / SAMPLES)
        steepest = lambda s: jnp.max(jnp.abs(s))
        return speed * jnp.maximum(steepest(slope.lateral), steepest(slope.vertical))
