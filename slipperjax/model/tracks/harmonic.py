"""Harmonic and straight tracks, Eqs. (10)-(11) and (24)-(26) of Dang et al. 2024."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...tools import finite, optional, positive, warn_unless_within
from .abstract import AbstractTrack, Irregularity

PLAUSIBLE_LENGTHS = 0.02, 2000.0
"""Wavelengths beyond these [m] are allowed with a warning."""


class HarmonicTrack(AbstractTrack):
    """A sum of sines of one or more wavelengths with equal amplitudes, in phase laterally, vertically and in roll.

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
        warn_unless_within("wavelengths", self.wavelengths, *PLAUSIBLE_LENGTHS, "m")

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.wavelengths[0]

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        shape = jnp.zeros_like(distance)
        for k in range(self.wavelengths.shape[0]):
            cycles = distance / self.wavelengths[k]
            # whole cycles are subtracted before the sine, which keeps its precision after any number of periods
            shape = shape + jnp.sin(2 * jnp.pi * (cycles - jnp.floor(cycles)))
        offset = self.amplitude * shape
        return Irregularity(offset, offset, None if self.roll_amplitude is None else self.roll_amplitude * shape)

    def approach_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Peak lateral speed of the rail from the first wavelength alone [m/s]."""
        return 2 * jnp.pi * jnp.abs(self.amplitude) * speed / self.wavelength


class StraightTrack(AbstractTrack):
    """A track without irregularity. `reference_length` only sets the unit of time, the forcing period."""

    reference_length: Float[Array, ""] = eqx.field(converter=positive("reference_length", "m"), default=8.0)
    """Length of travel that counts as one period [m]."""

    def __check_init__(self):
        warn_unless_within("reference_length", self.reference_length, *PLAUSIBLE_LENGTHS, "m")

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        zero = jnp.zeros_like(distance)
        return Irregularity(zero, zero, None)

    def approach_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        return 0.0 * speed
