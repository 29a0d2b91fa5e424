"""Track irregularity: where the rail is at a given place, Eqs. (9)-(11) and (24)-(26) of Dang et al. 2024."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import finite, optional, positive


class TrackMotion(NamedTuple):
    """Place of the rail's axis at some phases, and its rates per forcing period."""

    offset: Any
    """Lateral and vertical displacement, which are the same [m]."""
    offset_rate: Any
    """The same per forcing period [m]."""
    roll: Any
    """Roll angle [rad], or None where the track does not roll."""
    roll_rate: Any
    """The same per forcing period [rad], or None."""


class AbstractTrack(eqx.Module):
    """A track whose irregularity is a function of the place alone."""

    @property
    @abc.abstractmethod
    def wavelength(self) -> Float[Array, ""]:
        """The length that defines the forcing period [m]: period = wavelength / speed."""

    @abc.abstractmethod
    def motion(self, phase: Float[Array, "*s"]) -> TrackMotion:
        """Where the rail is after `phase` forcing periods of travel."""


class HarmonicTrack(AbstractTrack):
    """The sum of equal sines of one or more wavelengths, in lateral, vertical and roll direction alike.

    Dang et al. 2024, Eq. (10) for one wavelength and Eq. (25) for two.
    """

    wavelengths: Float[Array, " waves"] = eqx.field(converter=positive("wavelengths", "m"))
    """Wavelengths L_X [m]. The first defines the forcing period."""
    amplitude: Float[Array, ""] = eqx.field(converter=finite("amplitude", "m"))
    """Amplitude of the lateral and of the vertical displacement [m]."""
    roll_amplitude: Float[Array, ""] | None = eqx.field(
        converter=optional(finite("roll_amplitude", "rad")), default=None
    )
    """Amplitude of the roll angle [rad]. None: the track does not roll."""

    def __check_init__(self):
        if self.wavelengths.ndim != 1 or self.wavelengths.shape[0] == 0:
            raise ValueError(
                f"Argument `wavelengths` must be a sequence of one or more lengths, but has shape "
                f"{self.wavelengths.shape}."
            )

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.wavelengths[0]

    def motion(self, phase: Float[Array, "*s"]) -> TrackMotion:
        shape = rate = jnp.zeros_like(phase)
        for k in range(self.wavelengths.shape[0]):
            # The first ratio is one, and said so: then the phase stays a plain number for a whole sweep.
            ratio = self.wavelengths[0] / self.wavelengths[k] if k else 1.0
            cycles = phase * ratio
            angle = 2 * jnp.pi * (cycles - jnp.floor(cycles))  # keeps its precision after any number of periods
            shape = shape + jnp.sin(angle)
            rate = rate + 2 * jnp.pi * ratio * jnp.cos(angle)
        if self.roll_amplitude is None:
            roll = roll_rate = None
        else:
            roll, roll_rate = self.roll_amplitude * shape, self.roll_amplitude * rate
        return TrackMotion(self.amplitude * shape, self.amplitude * rate, roll, roll_rate)


class StraightTrack(AbstractTrack):
    """A track without irregularity. `reference_length` only sets the unit of time, the forcing period."""

    reference_length: Float[Array, ""] = eqx.field(converter=positive("reference_length", "m"), default=8.0)
    """Length of travel that counts as one period [m]."""

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    def motion(self, phase: Float[Array, "*s"]) -> TrackMotion:
        zero = jnp.zeros_like(phase)
        return TrackMotion(zero, zero, None, None)
