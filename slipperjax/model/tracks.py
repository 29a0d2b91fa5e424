"""Tracks: the rail's irregularity as functions of distance, Eqs. (9)-(11) and (24)-(26) of Dang et al. 2024."""

import abc
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..tools.checks import finite, instance, not_negative, one_of, positive, require, shown_number
from ..tools.compile import as_argument, at_once
from ..tools.fields import ShapeChecked, field
from ..tools.forms import circle
from ..tools.tracing import is_traced
from ..tools.types import Real

DEFAULT_WAVELENGTH = 8.0
"""Length of travel that counts as a forcing period on tracks without waves [m]."""


class Irregularity(NamedTuple):
    """Displacement of the rail's axis at some distances, or its slope there (per metre of travel)."""

    lateral: Array
    """Along y, positive to the left [m]; slope [m/m]."""
    vertical: Array
    """Along z, positive upwards [m]; slope [m/m]."""
    roll: Array | None
    """About x [rad]; slope [rad/m]. None where the track does not roll, which saves operations."""


class AbstractTrack(ShapeChecked):
    """A track whose irregularity is a function of distance alone. Subclasses define `irregularity`."""

    @property
    def wavelength(self) -> Float[Array, ""]:
        """The length that defines the forcing period [m], period = wavelength / speed: the first wavelength. By
        default 8 m, for tracks without waves; see `Scene.window`."""
        with jax.ensure_compile_time_eval():  # known inside jit, too
            return jnp.asarray(DEFAULT_WAVELENGTH)

    @abc.abstractmethod
    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        """Return the rail's displacements at `distance` [m]; differentiable, precise after any number of periods."""

    @at_once
    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        """Return displacements at `distance` [m], and their slopes per metre of travel."""
        # the slope is the derivative along one metre of travel
        here, slope = jax.jvp(self.irregularity, (distance,), (jnp.ones_like(distance),))
        return instance("irregularity", here, Irregularity, "a slipperjax.model.Irregularity"), slope

    def prepared(self) -> "AbstractTrack":
        """Return the track in the form that runs evaluate, with all work done that is the same at all distances."""
        return self

    @property
    def is_rough(self) -> bool:
        """Whether contacts on this track last and are pressed in again, as on surveyed and random rails and over
        joints; by default False. This decides the default memory of contacts, see `Scene.contact_memory`."""
        return False

    chosen_by: ClassVar[str] = ""
    """Name of the field that chooses one of many rails, see `chosen`; empty for a single track."""

    @property
    def rails(self) -> dict[str, "AbstractTrack"]:
        """The rails by name; empty for a track that serves as every rail."""
        return {}

    @property
    def gauge(self) -> Float[Array, ""] | None:
        """Distance between the axes of the undisturbed rails [m]; None: each rail is where its mounts are."""
        return None

    @property
    def begin(self) -> Real:
        """Distance from which the rail is described [m]; -inf without a limit."""
        return -np.inf

    @property
    def origin(self) -> Real:
        """Distance at which runs begin by default [m]: the beginning of the rail, or else zero."""
        begin = self.begin
        return begin if is_traced(begin) or np.isfinite(begin) else 0.0

    @property
    def extent(self) -> Real:
        """Distance up to which the rail is described [m]; inf without a limit."""
        return np.inf

    @property
    def end(self) -> Real:
        """Distance up to which runs may travel [m]."""
        return np.inf

    @property
    def recurrence(self) -> Float[Array, ""]:
        """Length of travel after which the irregularity recurs [m]; 0 where it is constant, infinite where it never
        recurs.

        By default one wavelength or infinite, from samples that are one and a thousand wavelengths apart.
        """
        # places within one wavelength
        shares = jnp.arange(64) / 64

        def heights(shift: float) -> Array:
            displacements, _ = self.motion(self.wavelength * (shares + shift))
            return jnp.stack([h for h in displacements if h is not None])

        here = heights(0.0)
        within = 1e-6 * jnp.max(jnp.abs(here), axis=1, keepdims=True)
        next_is_equal = jnp.abs(heights(1.0) - here) <= within
        far_is_equal = jnp.abs(heights(1000.0) - here) <= within
        return jnp.where(jnp.all(next_is_equal & far_is_equal), self.wavelength, jnp.inf)

    def _places(self) -> Float[Array, " places"]:
        """Return the distances at which slopes are sampled [m]: of sixteen first wavelengths."""
        # 512 places a wavelength
        return self.wavelength * jnp.arange(16 * 512) / 512

    @property
    @at_once
    def steepest_slope(self) -> Float[Array, ""]:
        """Greatest lateral or vertical slope [1], by default sampled over sixteen first wavelengths."""
        _, slope = self.motion(self._places())
        return jnp.maximum(jnp.max(jnp.abs(slope.lateral)), jnp.max(jnp.abs(slope.vertical)))

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        """Shortest wavelength of the irregularity [m], by default the first wavelength."""
        return self.wavelength

    def approach_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Return a typical speed at which the rail approaches the slipper at `speed` [m/s], for step sizes."""
        return speed * self.steepest_slope


def chosen(track: AbstractTrack) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """Return the number that chooses one of many rails, as an index, and whether a rail has this number.

    The index is 0 where no rail has the number. A traced number is not checked; a wrong one gives a rail of NaN.
    """
    number = getattr(track, track.chosen_by)
    check = track.check_of(track.chosen_by)
    assert check is not None  # of each such track
    known = check.is_good(number)
    return jnp.where(known, number, 0).astype(int), known


def greatest(values: Sequence[Real]) -> Real:
    """Return the greatest of some numbers, which may be traced."""
    # Python's `max` compiles nothing
    return jnp.max(jnp.stack(values)) if is_traced(values) else max(values)


def least(values: Sequence[Real]) -> Real:
    """Return the least of some numbers, which may be traced."""
    return -greatest([-value for value in values])


PLAUSIBLE_LENGTHS = 0.02, 2000.0
"""Wavelengths beyond these [m] are allowed with a warning."""
PLAUSIBLE_GAUGES = 0.1, 10.0
"""Distances between two rails beyond these [m] are allowed with a warning."""


def least_common_count(unit: Array, lengths: Array) -> Float[Array, ""]:
    """Return the least count, up to 100, for which count * `unit` is a whole multiple of each of `lengths`.

    Infinite where there is no such count. A length of zero fits to each count.
    """
    # on the host where nothing is traced, so that nothing is compiled
    traced = is_traced((unit, lengths))
    xp = jnp if traced else np
    counts = xp.arange(1.0, 101.0)
    # a count fits where count * unit is a whole multiple of all lengths
    each = xp.ravel(xp.asarray(lengths))
    times = xp.outer(counts, xp.asarray(unit) / xp.where(each > 0, each, 1.0))
    nearest = xp.round(times)
    whole = (xp.abs(times - nearest) <= 1e-9 * xp.maximum(times, 1)) & (nearest > 0) | (each == 0)[None]
    return as_argument(xp.min(xp.where(xp.all(whole, axis=1), counts, xp.inf)))


def on_host(values: Array | np.ndarray) -> Array | np.ndarray:
    """Return an array as one of NumPy, so that nothing is compiled; a traced array as it is."""
    return values if is_traced(values) else np.asarray(values)


class _Waves(AbstractTrack):
    """A sum of sines; the first sine defines the forcing period."""

    wavelengths: eqx.AbstractVar[Float[Array, " waves"]]

    @property
    def wavelength(self):
        return as_argument(on_host(self.wavelengths)[0])

    @property
    def recurrence(self):
        return self.wavelength * least_common_count(self.wavelength, self.wavelengths)

    @property
    def shortest_wavelength(self):
        return as_argument(on_host(self.wavelengths).min())


class HarmonicTrack(_Waves):
    """A sum of sines of one or more wavelengths with equal amplitudes, in phase laterally, vertically and in roll.

    `FourierTrack` has different amplitudes and phases.

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
        need = "be a sequence of one or more lengths"
        require(len(shape) == 1 and shape[0] > 0, "wavelengths", need, shown=f"of shape {shape}")

    @at_once
    def irregularity(self, distance):
        shape = jnp.zeros_like(distance)
        for k in range(self.wavelengths.shape[0]):
            cycles = distance / self.wavelengths[k]
            # whole cycles are subtracted before the sine, which keeps its precision after any number of periods
            shape = shape + circle(2 * jnp.pi * (cycles - jnp.floor(cycles)))[1]
        offset = self.amplitude * shape
        return Irregularity(offset, offset, None if self.roll_amplitude is None else self.roll_amplitude * shape)

    @property
    def steepest_slope(self):
        """An upper bound [1], reached where the slopes of all waves are greatest at one place, as at the start."""
        return jnp.sum(2 * jnp.pi * jnp.abs(self.amplitude) / self.wavelengths)


class StraightTrack(AbstractTrack):
    """A track without irregularity."""

    def irregularity(self, distance):
        zero = jnp.zeros_like(distance)
        return Irregularity(zero, zero, None)

    @property
    def recurrence(self):
        return jnp.zeros(())

    @property
    def steepest_slope(self):
        return jnp.zeros(())


def _row(values: Array, distance: Array) -> Array:
    """Return values with leading axes, as many as distances have."""
    # a user may make JAX refuse axes that are added silently
    return values.reshape((1,) * distance.ndim + (-1,))


class FourierTrack(_Waves):
    """A sum of sines, with an amplitude and a phase for each wavelength and direction."""

    wavelengths: Float[Array, " waves"] = field("m", positive)
    """Wavelengths [m]. The first defines the forcing period."""
    lateral: Float[Array, " waves"] = field("m", finite, shown_unit="mm")
    """Amplitudes of the lateral displacement [m]."""
    vertical: Float[Array, " waves"] = field("m", finite, shown_unit="mm")
    """Amplitudes of the vertical displacement [m]."""
    roll: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Amplitudes of the roll angle [rad]. None: the track does not roll."""
    lateral_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Phases of the lateral sines at distance zero [rad]; None: zero."""
    vertical_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Phases of the vertical sines at distance zero [rad]; None: zero."""
    roll_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Phases of the roll sines at distance zero [rad]; None: zero."""

    def __check_init__(self):
        for name, array in vars(self).items():
            if array is not None:
                need = f"have one value per wavelength, {self.wavelengths.shape}"
                require(array.shape == self.wavelengths.shape, name, need, shown=f"shape {array.shape}")

    @at_once
    def irregularity(self, distance):
        cycles = distance[..., None] / _row(self.wavelengths, distance)
        # whole cycles are subtracted before the sine, which keeps its precision after any number of periods
        angle = 2 * jnp.pi * (cycles - jnp.floor(cycles))

        def waves(amplitudes: Array, phase: Array | None) -> Array:
            shifted = angle if phase is None else angle + _row(phase, distance)
            return jnp.sum(_row(amplitudes, distance) * jnp.sin(shifted), axis=-1)

        lateral = waves(self.lateral, self.lateral_phase)
        vertical = waves(self.vertical, self.vertical_phase)
        return Irregularity(lateral, vertical, None if self.roll is None else waves(self.roll, self.roll_phase))

    @property
    def steepest_slope(self):
        """An upper bound: the sum of all slopes [1]."""
        sum_of = lambda size: jnp.sum(2 * jnp.pi * jnp.abs(size) / self.wavelengths)
        return jnp.maximum(sum_of(self.lateral), sum_of(self.vertical))


def smooth_step(x: Array) -> Array:
    """Return a function that rises from 0 at 0 to 1 at 1, with continuous second derivatives."""
    x = jnp.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def _joint(u: Array) -> Array:
    # the kink is rounded over a tenth of the length
    bend = lambda u: jnp.sqrt(u**2 + 0.01) - 0.1
    return jnp.maximum(1 - bend(u) / bend(1.0), 0.0) ** 3


SHAPES = {
    # third powers give continuous second derivatives at the ends
    "dip": lambda u: jnp.maximum(1 - u**2, 0.0) ** 3,
    "step": lambda u: smooth_step((u + 1) / 2),
    "joint": _joint,
}
"""Local shapes from -1 to 1: a smooth dip (or bump), a smooth step to another level, and a joint, where both rails
bend down."""


class AbstractLocalTrack(AbstractTrack):
    """Shapes of one length at some places of an otherwise straight rail."""

    place: eqx.AbstractVar[Float[Array, "*places"]]
    height: eqx.AbstractVar[Float[Array, "*places"]]
    length: eqx.AbstractVar[Float[Array, ""]]
    shape: eqx.AbstractVar[str]
    direction: eqx.AbstractVar[str]

    @property
    def every(self) -> Float[Array, ""] | None:
        """Distance after which the shapes repeat [m]; None: no repetition."""
        return None

    def __check_init__(self):
        one_of("direction", self.direction, ("lateral", "vertical"))

    @property
    def is_rough(self):
        return True

    @at_once
    def irregularity(self, distance):
        x = distance[..., None] - _row(self.place, distance)
        # the distance from the nearest repetition of a shape
        if self.every is not None:
            x = x - self.every * jnp.round(x / self.every)
        form = SHAPES[self.shape](2 * x / self.length)
        along = jnp.sum(_row(self.height, distance) * form, axis=-1)
        zero = jnp.zeros_like(along)
        return Irregularity(along, zero, None) if self.direction == "lateral" else Irregularity(zero, along, None)

    @property
    def recurrence(self):
        return jnp.asarray(jnp.inf) if self.every is None else self.every

    @property
    def steepest_slope(self):
        """Slope of the highest shape [1], from samples."""
        # only one shape, with the greatest height
        u = jnp.linspace(-0.5, 0.5, 401) * self.length
        own = LocalTrack(jnp.zeros(1), jnp.max(jnp.abs(self.height))[None], self.length, self.shape, "vertical")
        return jnp.max(jnp.abs(own.motion(u)[1].vertical))

    @property
    def shortest_wavelength(self):
        """The shapes' length [m]; 8 m at most."""
        return jnp.minimum(self.length, self.wavelength)


class LocalTrack(AbstractLocalTrack):
    """Dips, steps or joints of one length, at some places of an otherwise straight rail."""

    place: Float[Array, " places"] = field("m", finite)
    """Distances of their middles [m]."""
    height: Float[Array, " places"] = field("m", finite, shown_unit="mm")
    """Displacement in the middle, for a step its height [m]; negative for dips."""
    length: Float[Array, ""] = field("m", positive)
    """Length of a shape from end to end [m]."""
    shape: str = eqx.field(static=True, default="dip")
    """One of `SHAPES`."""
    direction: str = eqx.field(static=True, default="vertical")
    """"lateral" or "vertical"."""
    every: Float[Array, ""] | None = field("m", positive, default=None)
    """Distance after which the shapes repeat [m], such as 1.32 for supports; None: no repetition. Not for steps."""

    def __check_init__(self):
        one_of("shape", self.shape, tuple(SHAPES))
        places = self.place.shape
        heights = self.height.shape
        require(heights == places, "height", f"have one value per place, {places}", shown=f"shape {heights}")
        require(self.every is None or self.shape != "step", "every", "be None for steps", self.every)


class _OfTwo(AbstractTrack):
    """A track of two tracks; the first defines the forcing period; it recurs, begins and ends where both do."""

    @property
    @abc.abstractmethod
    def _both(self) -> tuple[AbstractTrack, AbstractTrack]:
        """Both tracks."""

    @abc.abstractmethod
    def _joined(self, one: Irregularity, other: Irregularity) -> Irregularity:
        """Return the displacements, or slopes, of this track from those of both tracks."""

    def irregularity(self, distance):
        return self._joined(*(track.irregularity(distance) for track in self._both))

    def motion(self, distance):
        (here, slope), (there, other_slope) = (track.motion(distance) for track in self._both)
        return self._joined(here, there), self._joined(slope, other_slope)

    @property
    def wavelength(self):
        return self._both[0].wavelength

    @property
    def recurrence(self):
        """The least multiple of the first wavelength after which both tracks recur [m]."""
        lengths = jnp.stack([track.recurrence for track in self._both])
        return self.wavelength * least_common_count(self.wavelength, lengths)

    @property
    def is_rough(self):
        return any(track.is_rough for track in self._both)

    @property
    def begin(self):
        return greatest([track.begin for track in self._both])

    @property
    def extent(self):
        return least([track.extent for track in self._both])

    @property
    def end(self):
        return least([track.end for track in self._both])

    @property
    def shortest_wavelength(self):
        return jnp.minimum(*(track.shortest_wavelength for track in self._both))


class AbstractSum(_OfTwo):
    """The sum of two tracks."""

    one: eqx.AbstractVar[AbstractTrack]
    other: eqx.AbstractVar[AbstractTrack]

    @property
    def _both(self):
        return self.one, self.other

    @property
    def distance_unit(self) -> str:
        """Unit of distances in the survey of the first track, if it is a survey; otherwise m."""
        return getattr(self.one, "distance_unit", "m")

    @property
    def rails(self):
        one, other = self.one.rails, self.other.rails
        # a single track is added to both rails of the other track
        return {name: SumTrack(one.get(name, self.one), other.get(name, self.other)) for name in one or other}

    @property
    def gauge(self):
        return self.other.gauge if self.one.gauge is None else self.one.gauge

    def prepared(self):
        return SumTrack(self.one.prepared(), self.other.prepared())

    def _joined(self, one, other):
        return _sum(one, other)

    @property
    def steepest_slope(self):
        """An upper bound: the sum of both tracks' slopes [1]."""
        return self.one.steepest_slope + self.other.steepest_slope


class SumTrack(AbstractSum):
    """The sum of two tracks, such as joints on a surveyed rail; sums can be summed again."""

    one: AbstractTrack
    """The first track, which defines the forcing period."""
    other: AbstractTrack

    def __check_init__(self):
        for name in ("one", "other"):
            instance(name, getattr(self, name), AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)")

    def __repr__(self) -> str:
        return f"SumTrack({self.one!r}, {self.other!r})"


class AbstractTwoRails(_OfTwo):
    """A track of a left and a right rail, for a `slipperjax.Sled` whose mounts are on them.

    The left rail is on the side of positive y. Distances along both rails are the same. As a single track, it is the
    line in the middle between its rails.
    """

    left: eqx.AbstractVar[AbstractTrack]
    right: eqx.AbstractVar[AbstractTrack]

    @property
    def _both(self):
        return self.left, self.right

    @property
    def rails(self):
        return {"left": self.left, "right": self.right}

    def prepared(self):
        return TwoRails(self.left.prepared(), self.right.prepared(), self.gauge)

    def _joined(self, one, other):
        return jax.tree.map(lambda displacement: 0.5 * displacement, _sum(one, other))

    @property
    def steepest_slope(self):
        return jnp.maximum(self.left.steepest_slope, self.right.steepest_slope)


class TwoRails(AbstractTwoRails):
    """Any two rails side by side.

    ```python
    track = sj.model.TwoRails(sj.load_rail("left.csv"), sj.load_rail("right.csv"), gauge=1.435)
    ```
    """

    left: AbstractTrack
    """The rail on the side of positive y, which defines the forcing period."""
    right: AbstractTrack
    """The rail on the side of negative y."""
    gauge: Float[Array, ""] | None = field("m", positive, plausible=PLAUSIBLE_GAUGES, default=None)
    """Distance between the axes of the undisturbed rails [m]; None: each rail is where its mounts are."""

    def __check_init__(self):
        for name, rail in self.rails.items():
            instance(name, rail, AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)")
            require(not rail.rails, name, "be one rail", rail)

    def __repr__(self) -> str:
        gauge = "" if self.gauge is None else f", gauge={shown_number(self.gauge)} m"
        return f"TwoRails({self.left!r}, {self.right!r}{gauge})"

    @property
    def distance_unit(self) -> str:
        """Unit of distances in the survey of the left rail, if it is a survey; otherwise m."""
        return getattr(self.left, "distance_unit", "m")


def _sum(one: Irregularity, other: Irregularity) -> Irregularity:
    """Add displacements, or slopes; a roll of None adds nothing."""
    roll = one.roll if other.roll is None else other.roll if one.roll is None else one.roll + other.roll
    return Irregularity(one.lateral + other.lateral, one.vertical + other.vertical, roll)
