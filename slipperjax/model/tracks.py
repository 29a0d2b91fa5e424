"""Tracks: the rail's irregularity as functions of distance, Eqs. (9)-(11) and (24)-(26) of Dang et al. 2024."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..tools.checks import instance, not_negative, positive
from ..tools.compile import as_argument, at_once, is_traced
from ..tools.fields import ShapeChecked, field
from ..tools.fused import circle

SLOPE_SAMPLES, SLOPE_WAVELENGTHS = 512, 16
"""Points per first wavelength at which the slope of a track is sampled, and how many of these are sampled."""
HEIGHT_SAMPLES = 64
"""Points per first wavelength at which displacements are compared, a number of first wavelengths apart."""
MANY_WAVELENGTHS = 1000
"""First wavelengths over which a track must recur."""
MOST_RECURRENCE = 100
"""First wavelengths up to which the recurrence of several wavelengths is looked for."""


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
        """Returns the rail's displacements at `distance` [m]; differentiable, precise after any number of periods."""

    @at_once
    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        """Returns displacements at `distance` [m], and their slopes per metre of travel."""
        here, slope = jax.jvp(self.irregularity, (distance,), (jnp.ones_like(distance),))
        return instance("irregularity", here, Irregularity, "a slipperjax.Irregularity"), slope

    def prepared(self) -> "AbstractTrack":
        """Returns the track as runs evaluate it, with all work done that is the same at all distances."""
        return self

    chosen_by: ClassVar[str] = ""
    """Name of the number that chooses one of many rails, for tracks that are such, see `chosen`."""

    @property
    def begin(self) -> Any:
        """Distance from which on the rail is described [m]; -inf where it is everywhere."""
        return -np.inf

    @property
    def origin(self) -> Any:
        """Distance at which runs begin unless told otherwise [m]: where the rail does, or else zero."""
        begin = self.begin
        if is_traced(begin):
            return jnp.where(jnp.isfinite(begin), begin, 0.0)
        return float(begin) if np.isfinite(begin) else 0.0

    @property
    def extent(self) -> Any:
        """Distance up to which the rail is described [m]; inf where it is everywhere."""
        return np.inf

    @property
    def end(self) -> float:
        """Distance up to which runs may travel [m]."""
        return np.inf

    @property
    def recurrence(self) -> Float[Array, ""]:
        """Number of first wavelengths after which the irregularity recurs [1]; infinite where it does not.

        By default 1 or infinite, from samples one and `MANY_WAVELENGTHS` wavelengths apart.
        """
        shares = jnp.arange(HEIGHT_SAMPLES) / HEIGHT_SAMPLES
        there = lambda shift: self.motion(self.wavelength * (shares + shift))[0]
        heights = lambda shift: jnp.stack([h for h in there(shift) if h is not None])
        here = heights(0.0)
        within = 1e-6 * jnp.max(jnp.abs(here), axis=1, keepdims=True)
        equal = [jnp.abs(heights(shift) - here) <= within for shift in (1.0, float(MANY_WAVELENGTHS))]
        return jnp.where(jnp.all(equal[0] & equal[1]), 1.0, jnp.inf)

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """Greatest lateral or vertical slope [1], by default sampled over `SLOPE_WAVELENGTHS` first wavelengths."""
        _, slope = self.motion(self.wavelength * jnp.arange(SLOPE_SAMPLES * SLOPE_WAVELENGTHS) / SLOPE_SAMPLES)
        return jnp.maximum(jnp.max(jnp.abs(slope.lateral)), jnp.max(jnp.abs(slope.vertical)))

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        """Shortest wavelength of the irregularity [m], by default the first."""
        return self.wavelength

    def approach_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Returns a typical speed at which the rail approaches the slipper at `speed` [m/s], for step sizes."""
        return speed * self.steepest_slope


def chosen(track: AbstractTrack) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """Returns the number that chooses one of many rails as an index, and whether there is such a rail; 0 where there
    is none. Traced numbers may be any, and the rail of such a one is NaN."""
    number, check = getattr(track, track.chosen_by), track.check_of(track.chosen_by)
    assert check is not None  # of each such track
    known = ~check.is_bad(number)
    return jnp.where(known, number, 0).astype(int), known


def greatest(values: Sequence[Any]) -> Any:
    """Returns the greatest of some numbers, which may be traced."""
    return jnp.max(jnp.stack(values)) if is_traced(values) else max(values)


WHOLE_WITHIN = 1e-9
"""Distance from a whole number up to which a ratio of wavelengths counts as one [1]."""
PLAUSIBLE_LENGTHS = 0.02, 2000.0
"""Wavelengths beyond these [m] are allowed with a warning."""


def least_common_count(unit: Any, lengths: Any) -> Float[Array, ""]:
    """Returns the least number of lengths `unit` that make whole numbers of each of `lengths`; infinite where there
    is none up to `MOST_RECURRENCE`."""
    # on the host where nothing is traced, which compiles nothing
    xp, convert = (jnp, jnp.asarray) if is_traced((unit, lengths)) else (np, np.asarray)
    counts = xp.arange(1.0, MOST_RECURRENCE + 1)
    times = xp.outer(counts, convert(unit) / convert(lengths))
    whole = (xp.abs(times - xp.round(times)) <= WHOLE_WITHIN * xp.maximum(times, 1)) & (xp.round(times) > 0)
    return as_argument(xp.min(xp.where(xp.all(whole, axis=1), counts, xp.inf)))


def on_host(values: Array) -> Any:
    """Gives an array as NumPy has it, with which nothing is compiled; as it is where it is traced."""
    return values if is_traced(values) else np.asarray(values)


class HarmonicTrack(AbstractTrack):
    """A sum of sines of one or more wavelengths with equal amplitudes, in phase laterally, vertically and in roll.

    `FourierTrack` has amplitudes and phases of their own.

    Dang et al. 2024, Eq. (10) for one wavelength and Eq. (25) for two.
    """

    wavelengths: Float[Array, " waves"] = field("m", positive, plausible=PLAUSIBLE_LENGTHS)
    """Wavelengths L_X [m]. The first defines the forcing period."""
    amplitude: Float[Array, ""] = field(
        "m", not_negative, plausible=(0.0, 0.1), text="irregularity amplitude", symbol="A", shown_unit="mm"
    )
    """Amplitude of the lateral and of the vertical displacement [m]."""
    roll_amplitude: Float[Array, ""] | None = field(
        "rad",
        not_negative,
        plausible=(0.0, 0.1),
        text="irregularity roll amplitude",
        symbol="A_R",
        shown_unit="degrees",
        default=None,
    )
    """Amplitude of the roll angle [rad]. None: the track does not roll."""

    def __check_init__(self):
        shape = self.wavelengths.shape
        if len(shape) != 1 or shape[0] == 0:
            raise ValueError(
                f"Argument `wavelengths` must be a sequence of one or more lengths, but has shape {shape}."
            )

    @property
    def wavelength(self) -> Float[Array, ""]:
        return as_argument(on_host(self.wavelengths)[0])

    @at_once
    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        shape = jnp.zeros_like(distance)
        for k in range(self.wavelengths.shape[0]):
            cycles = distance / self.wavelengths[k]
            # whole cycles are subtracted before the sine, which keeps its precision after any number of periods
            shape = shape + circle(2 * jnp.pi * (cycles - jnp.floor(cycles)))[1]
        offset = self.amplitude * shape
        return Irregularity(offset, offset, None if self.roll_amplitude is None else self.roll_amplitude * shape)

    @property
    def recurrence(self) -> Float[Array, ""]:
        lengths = on_host(self.wavelengths)
        return least_common_count(lengths[0], lengths)

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """An upper bound, attained where the slopes of all waves are greatest at one place, as at the start [1]."""
        return jnp.sum(2 * jnp.pi * jnp.abs(self.amplitude) / self.wavelengths)

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        return as_argument(on_host(self.wavelengths).min())


class StraightTrack(AbstractTrack):
    """A track without irregularity. `reference_length` only sets the unit of time, the forcing period."""

    reference_length: Float[Array, ""] = field("m", positive, plausible=PLAUSIBLE_LENGTHS, default=8.0)
    """Length of travel that counts as one period [m]."""

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        zero = jnp.zeros_like(distance)
        return Irregularity(zero, zero, None)

    @property
    def recurrence(self) -> Float[Array, ""]:
        return jnp.ones(())

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        return jnp.zeros(())
