"""Rails of samples, such as surveys, and sums of tracks: cubic splines with continuous second derivatives."""

import abc
import functools
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import (
    Check,
    finite,
    in_unit,
    instance,
    not_negative,
    number,
    one_of,
    positive,
    require,
    shown_number,
    warn,
    whole_number,
)
from ..tools.compile import at_once, is_traced
from ..tools.fields import field
from .tracks import AbstractTrack, Irregularity, chosen, greatest, least_common_count

ENDS = ("straight", "repeat", "error")
"""How a rail of samples goes on beyond its ends: straight at zero; as itself again; or not at all, which is an error:
NaN after its end, refused where known, and level before its start, where the rear of a slipper begins."""
DEFAULT_RAMP = 8.0
"""Length of the ramps at the ends of a rail that goes on straight [m], or a quarter of the rail if that is less."""
EQUAL_SPACING = 1e-3
"""Greatest difference of distances from equal spacing that counts as none, over the spacing."""
MOST_RESAMPLED = 8
"""Most samples of an unevenly sampled rail after resampling, over those given."""


class SplineTrack(AbstractTrack):
    """A uniform cubic spline as runs evaluate it, see `SampledTrack.prepared`."""

    first: Float[Array, ""]
    """Distance of the first knot [m]."""
    spacing: Float[Array, ""]
    """Distance between knots [m]."""
    intervals: Float[Array, ""]
    """Number of intervals between knots [1]; there may be coefficients beyond, which do not count."""
    coefficients: Float[Array, "knots channels"]
    """Those of the B-splines of each interval and its neighbours: lateral and vertical [m], and roll [rad] if any."""
    reference_length: Float[Array, ""]
    """Length of travel that counts as one period [m]."""
    ends: str = eqx.field(static=True)

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        return self.motion(distance)[0]

    @at_once
    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        (a, b, c, d), u, s = self._interval(distance)
        value = ((1 - u) ** 3 * a + (3 * u**3 - 6 * u**2 + 4) * b + (1 + 3 * u * (1 + u - u**2)) * c + u**3 * d) / 6
        slope = (u**2 * d - (1 - u) ** 2 * a + (3 * u - 4) * u * b + (1 + 2 * u - 3 * u**2) * c) / 2 / self.spacing
        if self.ends == "error":
            slope = jnp.where(s < 0, 0.0, slope)
        return self._of(value, s), self._of(slope, s)

    @at_once
    def curvature(self, distance: Float[Array, "*places"]) -> Irregularity:
        """Returns second derivatives [1/m], of roll [rad/m^2]."""
        (a, b, c, d), u, s = self._interval(distance)
        return self._of(((1 - u) * a + (3 * u - 2) * b + (1 - 3 * u) * c + u * d) / self.spacing**2, s)

    def _interval(self, distance: Array) -> tuple[list[Array], Array, Array]:
        """Returns the four coefficients at a distance, the place in its interval [0, 1], and that on the rail, in
        intervals."""
        s, count = (distance - self.first) / self.spacing, self.intervals
        if self.ends == "repeat":
            s = s - count * jnp.floor(s / count)
        at = jnp.clip(jnp.floor(s), 0, count - 1)
        # four neighbours as one slice, which a batch of rails reads as one piece
        index, four = at.astype(int), lambda i: jax.lax.dynamic_slice_in_dim(self.coefficients, i, 4)
        rows = jnp.moveaxis(jax.vmap(four)(index.ravel()), 1, 0).reshape(4, *index.shape, -1)
        place = jnp.where(s < 0, 0.0, s) if self.ends == "error" else s
        return list(rows), (place - at)[..., None], s[..., None]

    def _of(self, rows: Array, s: Array) -> Irregularity:
        if self.ends == "straight":
            rows = jnp.where((s >= 0) & (s <= self.intervals), rows, 0.0)
        elif self.ends == "error":
            rows = jnp.where(s <= self.intervals, rows, jnp.nan)
        channels = [rows[..., k] for k in range(rows.shape[-1])]
        return Irregularity(*channels, *[None] * (3 - len(channels)))


@functools.partial(at_once, static_argnums=1)
def spline_coefficients(samples: Float[Array, " samples"], ends: str) -> Float[Array, " knots"]:
    """Computes the coefficients of cubic B-splines through equally spaced samples. Pure.

    A rail that repeats has a periodic spline, of which the last sample is the first again. Otherwise the second
    derivatives vanish at the ends: less the line through both ends, the samples are continued oddly, which makes them
    periodic, too. The spline of periodic samples is a division of their Fourier coefficients.
    """
    count = samples.shape[0] - 1
    if ends == "repeat":
        rows = _periodic_coefficients(samples[:-1])
        return jnp.concatenate([rows[-1:], rows, rows[:2]])
    # a line is its own spline
    line = samples[0] + (samples[-1] - samples[0]) * jnp.arange(-1, count + 2) / count
    odd = samples - line[1:-1]
    rows = _periodic_coefficients(jnp.concatenate([odd[:-1], -odd[:0:-1]]))
    return line + jnp.concatenate([rows[-1:], rows[: count + 2]])


def _periodic_coefficients(samples: Float[Array, " samples"]) -> Float[Array, " samples"]:
    """Computes the c with (c_before + 4 c + c_after) / 6 = samples around a circle."""
    count = samples.shape[0]
    share = (2 + np.cos(2 * np.pi * np.arange(count // 2 + 1) / count)) / 3
    return jnp.fft.irfft(jnp.fft.rfft(samples) / share, n=count)


class AbstractRail(AbstractTrack):
    """A rail of samples or of a spectrum, which runs evaluate as a spline."""

    ends: eqx.AbstractVar[str]
    reference_length: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def prepared(self) -> SplineTrack:
        """Returns the rail's spline."""

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    @property
    def end(self) -> float:
        return self.extent if self.ends == "error" else np.inf

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        return self.prepared().irregularity(distance)

    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        return self.prepared().motion(distance)


def repeats_after(rail: AbstractRail, length: Any) -> Float[Array, ""]:
    """Returns the number of reference lengths after which a rail of some length [m] recurs; infinite where it does
    not repeat."""
    return least_common_count(rail.reference_length, length) if rail.ends == "repeat" else jnp.asarray(jnp.inf)


def mean_wave(slope: Array, curvature: Array, most: Array) -> Float[Array, ""]:
    """Returns the wavelength of a sine [m] with these root mean squares of slope [1] and curvature [1/m]; at most
    `most`, also where there is no curvature."""
    wave = 2 * jnp.pi * slope / jnp.where(curvature > 0, curvature, 1.0)
    return jnp.where(curvature > 0, jnp.minimum(wave, most), most)


class SampledTrack(AbstractRail):
    """A track through samples, such as a survey, by a cubic spline with continuous second derivatives.

    ```python
    track = sj.SampledTrack(distance, lateral, vertical)  # arrays [m]
    ```
    """

    distance: Float[Array, "2"] = field("m", finite)
    """Distances of the first and the last sample [m]; the others lie at equal distances between them."""
    lateral: Float[Array, " samples"] = field("m", finite, plausible=(-1.0, 1.0))
    """Displacement of the rail's axis along y at the samples [m]."""
    vertical: Float[Array, " samples"] = field("m", finite, plausible=(-1.0, 1.0))
    """Displacement along z [m]."""
    roll: Float[Array, " samples"] | None = field("rad", finite, plausible=(-0.5, 0.5), default=None)
    """Roll angle [rad]. None: the track does not roll."""
    ends: str = eqx.field(static=True)
    """One of `ENDS`."""
    ramp: Float[Array, ""] = field("m", not_negative)
    """Length over which a rail that goes on straight rises from zero at its ends [m]."""
    reference_length: Float[Array, ""] = field("m", positive)
    """Length of travel that counts as one period [m]: the window of records."""

    def __init__(
        self,
        distance: Any,
        lateral: Any,
        vertical: Any,
        roll: Any = None,
        *,
        ends: str = "straight",
        ramp: Any = None,
        reference_length: Any = None,
    ):
        """**Arguments:**

        - `distance`: of the samples [m], increasing; or of the first and the last of equally spaced ones. Others are
            resampled at equal distances, and a warning says by how much that changes the rail at the samples.
        - `lateral`, `vertical`, `roll`: displacements [m] and angle [rad] there; a single number holds everywhere.
        - `ends`: what the rail is beyond its ends: "straight", risen to by ramps within it; "repeat", where the last
            sample must be the first again; or "error", where runs that are longer are refused.
        - `ramp`: length of the ramps [m], default `DEFAULT_RAMP` where the rail goes on straight, otherwise zero.
        - `reference_length`: length of travel that counts as one period [m]; default 8 m, and the whole length of a
            rail that repeats, so that it has periodic orbits.

        **Raises:** `ValueError` that names the argument which is wrong.
        """
        self.ends = one_of("ends", ends, ENDS)
        require(not is_traced(distance), "distance", "be known while programs are made", shown="traced")
        finite("distance", "m")(distance)
        places = np.asarray(in_unit(distance, "m"), float)  # inside jit, too
        require(places.ndim == 1 and len(places) > 1, "distance", "be a list of distances", distance)
        given = {"lateral": lateral, "vertical": vertical, "roll": roll}
        checks = {
            "lateral": finite("lateral", "m"),
            "vertical": finite("vertical", "m"),
            "roll": finite("roll", "rad"),
        }
        channels = {name: checks[name](value) for name, value in given.items() if value is not None}
        require("lateral" in channels, "lateral", "be displacements", lateral)
        require("vertical" in channels, "vertical", "be displacements", vertical)
        lengths = {len(array) for array in channels.values() if array.ndim == 1}
        if len(places) > 2 or not lengths:
            lengths.add(len(places))
        need = f"be of equal length, but have {', '.join(map(str, sorted(lengths)))}"
        if len(lengths) > 1 or any(array.ndim > 1 for array in channels.values()):
            raise ValueError(f"Arguments `distance`, `lateral`, `vertical` and `roll` must {need} samples.")
        count = lengths.pop()
        require(count >= 4, "distance", "be of four or more samples", count)
        channels = {name: jnp.broadcast_to(array, (count,)) for name, array in channels.items()}
        _check_increasing(places)
        if len(places) > 2:
            channels = _evenly_spaced(places, channels)
        ends_of = places[[0, -1]]
        length = float(ends_of[1] - ends_of[0])
        for name, array in channels.items():
            if ends == "repeat" and not is_traced(array):
                ok = abs(float(array[-1] - array[0])) <= 1e-9 * float(np.max(np.abs(np.asarray(array))) or 1.0)
                shown = f"{float(array[-1]):g} at the end and {float(array[0]):g} at the start"
                require(ok, name, "end as it begins, because the rail repeats", shown=shown)
        if ramp is None:
            ramp = min(DEFAULT_RAMP, length / 4) if ends == "straight" else 0.0
        if reference_length is None:
            reference_length = length if ends == "repeat" else 8.0
        if not is_traced(ramp):
            limit = length / 2
            ramp = number(not_negative, "ramp", ramp, "m")
            require(ramp <= limit, "ramp", f"be at most {limit:g} m", ramp)
        self.distance = jnp.asarray(ends_of)
        self.lateral, self.vertical, self.roll = channels["lateral"], channels["vertical"], channels.get("roll")
        self.ramp, self.reference_length = ramp, reference_length

    @property
    def length(self) -> Float[Array, ""]:
        """Length of the rail [m]."""
        return self.distance[1] - self.distance[0]

    @property
    def spacing(self) -> Float[Array, ""]:
        """Distance between samples [m]."""
        return self.length / (self.lateral.shape[0] - 1)

    @at_once
    def prepared(self) -> SplineTrack:
        """Returns the spline through the samples, risen from zero by ramps at the ends."""
        samples = jnp.stack([c for c in (self.lateral, self.vertical, self.roll) if c is not None], axis=1)
        if self.ends == "straight":
            away = jnp.arange(samples.shape[0]) * self.spacing
            samples = ramps(jnp.minimum(away, self.length - away), self.ramp)[:, None] * samples
        coefficients = jax.vmap(lambda channel: spline_coefficients(channel, self.ends), 1, 1)(samples)
        intervals = jnp.asarray(samples.shape[0] - 1.0)
        return SplineTrack(self.distance[0], self.spacing, intervals, coefficients, self.reference_length, self.ends)

    @property
    def recurrence(self) -> Float[Array, ""]:
        return repeats_after(self, self.length)

    @property
    def begin(self) -> Any:
        return -np.inf if self.ends == "repeat" else self._described[0]

    @property
    def extent(self) -> Any:
        return np.inf if self.ends == "repeat" else self._described[1]

    @property
    def _described(self) -> Any:
        """Distances of the first and the last sample [m], known while programs are made unless they are traced."""
        return self.distance if is_traced(self.distance) else np.asarray(self.distance).tolist()

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """Greatest lateral or vertical slope at the samples and between them [1]."""
        return _steepest_slope(self)

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        """The wavelength of a sine with the same root mean squares of slope and curvature [m]: that of short waves as
        far as these matter; at most the reference length."""
        return _mean_wave(self)

    def _places(self) -> Float[Array, " places"]:
        """Distances of the samples, and of the middles between them, within the rail [m]."""
        count = 2 * (self.lateral.shape[0] - 1)
        return self.distance[0] + self.length * jnp.arange(count) / count


@at_once
def _steepest_slope(track: SampledTrack) -> Array:
    _, slope = track.prepared().motion(track._places())
    return jnp.maximum(jnp.max(jnp.abs(slope.lateral)), jnp.max(jnp.abs(slope.vertical)))


@at_once
def _mean_wave(track: SampledTrack) -> Array:
    spline, places = track.prepared(), track._places()
    rms = lambda of: jnp.sqrt(jnp.mean(of.lateral**2 + of.vertical**2))
    return mean_wave(rms(spline.motion(places)[1]), rms(spline.curvature(places)), track.reference_length)


def _smooth_step(x: Array) -> Array:
    """Rises from 0 at 0 to 1 at 1, with continuous second derivatives."""
    x = jnp.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


@at_once
def ramps(away: Array, ramp: Array) -> Array:
    """Returns factors that rise from 0 at the ends of a rail to 1 at the distance `ramp` `away` from them [m]."""
    return jnp.where(ramp > 0, _smooth_step(away / jnp.where(ramp > 0, ramp, 1.0)), 1.0)


def _check_increasing(places: np.ndarray) -> None:
    """Raises `ValueError` where a distance is not above the one before."""
    back = np.flatnonzero(np.diff(places) <= 0)
    if len(back):
        k = int(back[0]) + 1
        shown = f"{places[k]:g} m after {places[k - 1]:g} m at sample {k}"
        require(False, "distance", "increase from sample to sample", shown=shown)


def _evenly_spaced(places: np.ndarray, channels: dict[str, Array]) -> dict[str, Array]:
    """Returns channels at equal distances, resampled where they are not; a warning says by how much that changes
    them."""
    gaps = np.diff(places)
    even = (places[-1] - places[0]) / len(gaps)
    if np.max(np.abs(places - places[0] - even * np.arange(len(places)))) <= EQUAL_SPACING * even:
        return channels
    from scipy.interpolate import CubicSpline  # here, because importing it takes time

    length = float(places[-1] - places[0])
    count = int(min(np.ceil(length / np.min(gaps)), MOST_RESAMPLED * len(gaps))) + 1
    at = np.linspace(places[0], places[-1], count)
    if any(is_traced(array) for array in channels.values()):
        weights = CubicSpline(places, np.eye(len(places)))(at)  # a spline is linear in its samples
        return {name: weights @ array for name, array in channels.items()}
    even_channels = {name: CubicSpline(places, np.asarray(array))(at) for name, array in channels.items()}
    changes = {
        name: float(np.max(np.abs(CubicSpline(at, even_channels[name])(places) - np.asarray(array))))
        for name, array in channels.items()
    }
    worst = max((change for name, change in changes.items() if name != "roll"), default=0.0)
    warn(
        f"Argument `distance` is not equally spaced: the rail is resampled every {length / (count - 1):.4g} m, which "
        f"changes it by {worst:.1g} m at most."
    )
    return {name: jnp.asarray(array) for name, array in even_channels.items()}


class FourierTrack(AbstractTrack):
    """A sum of sines with an amplitude and a phase of its own for each wavelength and direction."""

    wavelengths: Float[Array, " waves"] = field("m", positive)
    """Wavelengths [m]. The first defines the forcing period."""
    lateral: Float[Array, " waves"] = field("m", finite)
    """Amplitudes of the lateral displacement [m]."""
    vertical: Float[Array, " waves"] = field("m", finite)
    """Amplitudes of the vertical displacement [m]."""
    roll: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Amplitudes of the roll angle [rad]. None: the track does not roll."""
    lateral_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Phases of the lateral sines at distance zero [rad]; None for zero."""
    vertical_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Likewise of the vertical ones [rad]."""
    roll_phase: Float[Array, " waves"] | None = field("rad", finite, default=None)
    """Likewise of roll [rad]."""

    def __check_init__(self):
        for name in ("lateral", "vertical", "roll", "lateral_phase", "vertical_phase", "roll_phase"):
            array, need = getattr(self, name), f"have one value per wavelength, {self.wavelengths.shape}"
            if array is not None:
                require(array.shape == self.wavelengths.shape, name, need, shown=f"shape {array.shape}")

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.wavelengths[0]

    @at_once
    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        row = lambda values: values.reshape((1,) * distance.ndim + (-1,))
        cycles = distance[..., None] / row(self.wavelengths)
        # whole cycles are subtracted before the sine, which keeps its precision after any number of periods
        angle = 2 * jnp.pi * (cycles - jnp.floor(cycles))
        shifted = lambda phase: angle if phase is None else angle + row(phase)
        of = lambda size, phase: jnp.sum(row(size) * jnp.sin(shifted(phase)), axis=-1)
        roll = None if self.roll is None else of(self.roll, self.roll_phase)
        return Irregularity(of(self.lateral, self.lateral_phase), of(self.vertical, self.vertical_phase), roll)

    @property
    def recurrence(self) -> Float[Array, ""]:
        return least_common_count(self.wavelengths[0], self.wavelengths)

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """An upper bound: the sum of all slopes [1]."""
        sum_of = lambda size: jnp.sum(2 * jnp.pi * jnp.abs(size) / self.wavelengths)
        return jnp.maximum(sum_of(self.lateral), sum_of(self.vertical))

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        return jnp.min(self.wavelengths)


SHAPES = ("dip", "step", "joint")
"""Local shapes: a smooth dip (or bump), a smooth step to another level, and a joint, where both rails bend down."""
DIRECTIONS = ("lateral", "vertical")
JOINT_WIDTH = 0.1
"""Half the length over which the kink of a joint is rounded, over half the joint's length."""


class LocalTrack(AbstractTrack):
    """Dips, steps or joints at some places of a rail that is straight otherwise, all of one length."""

    place: Float[Array, " places"] = field("m", finite)
    """Distances of their middles [m]."""
    height: Float[Array, " places"] = field("m", finite)
    """Displacement in the middle, of a step its height [m]; negative for dips."""
    length: Float[Array, ""] = field("m", positive)
    """Length of a shape from end to end [m]."""
    shape: str = eqx.field(static=True, default="dip")
    """One of `SHAPES`."""
    direction: str = eqx.field(static=True, default="vertical")
    """One of `DIRECTIONS`."""
    every: Float[Array, ""] | None = field("m", positive, default=None)
    """Distance after which all of them come again [m], such as 1.32 for supports; None for once. Not for steps."""
    reference_length: Float[Array, ""] = field("m", positive, default=8.0)
    """Length of travel that counts as one period [m]."""

    def __check_init__(self):
        one_of("shape", self.shape, SHAPES)
        one_of("direction", self.direction, DIRECTIONS)
        good = self.place.shape == self.height.shape
        require(good, "height", f"have one value per place, {self.place.shape}", shown=f"shape {self.height.shape}")
        require(self.every is None or self.shape != "step", "every", "be None for steps", self.every)

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.reference_length

    @at_once
    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        row = lambda values: values.reshape((1,) * distance.ndim + (-1,))
        x = distance[..., None] - row(self.place)
        if self.every is not None:
            x = x - self.every * jnp.round(x / self.every)
        u = 2 * x / self.length
        if self.shape == "step":
            form = _smooth_step((u + 1) / 2)
        elif self.shape == "dip":
            form = jnp.maximum(1 - u**2, 0.0) ** 3
        else:
            bend = lambda u: jnp.sqrt(u**2 + JOINT_WIDTH**2) - JOINT_WIDTH
            form = jnp.maximum(1 - bend(u) / bend(1.0), 0.0) ** 3
        along = jnp.sum(row(self.height) * form, axis=-1)
        zero = jnp.zeros_like(along)
        return Irregularity(along, zero, None) if self.direction == "lateral" else Irregularity(zero, along, None)

    @property
    def recurrence(self) -> Float[Array, ""]:
        return jnp.asarray(jnp.inf) if self.every is None else least_common_count(self.reference_length, self.every)

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """That of the highest shape [1], from samples."""
        u = jnp.linspace(-0.5, 0.5, 401) * self.length
        own = LocalTrack(jnp.zeros(1), jnp.max(jnp.abs(self.height))[None], self.length, self.shape, "vertical")
        return jnp.max(jnp.abs(own.motion(u)[1].vertical))

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        """The shapes' length, or the reference length if that is less [m]."""
        return jnp.minimum(self.length, self.reference_length)


class SumTrack(AbstractTrack):
    """The sum of two tracks, such as joints on a surveyed rail; sums can be summed again."""

    one: AbstractTrack
    """The first, which defines the forcing period."""
    other: AbstractTrack

    def __check_init__(self):
        for name in ("one", "other"):
            instance(name, getattr(self, name), AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)")

    def __repr__(self) -> str:
        return f"SumTrack({self.one!r}, {self.other!r})"

    @property
    def wavelength(self) -> Float[Array, ""]:
        return self.one.wavelength

    def prepared(self) -> "SumTrack":
        return SumTrack(self.one.prepared(), self.other.prepared())

    def irregularity(self, distance: Float[Array, "*places"]) -> Irregularity:
        return _sum(*(track.irregularity(distance) for track in (self.one, self.other)))

    def motion(self, distance: Float[Array, "*places"]) -> tuple[Irregularity, Irregularity]:
        (here, slope), (there, other_slope) = (track.motion(distance) for track in (self.one, self.other))
        return _sum(here, there), _sum(slope, other_slope)

    @property
    def recurrence(self) -> Float[Array, ""]:
        """The least number of first wavelengths after which both recur."""
        lengths = [track.recurrence * track.wavelength for track in (self.one, self.other)]
        return least_common_count(self.wavelength, jnp.stack(lengths))

    @property
    def begin(self) -> Any:
        return greatest((self.one.begin, self.other.begin))

    @property
    def extent(self) -> Any:
        return -greatest((-self.one.extent, -self.other.extent))

    @property
    def end(self) -> float:
        return min(self.one.end, self.other.end)

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """An upper bound: the sum of both [1]."""
        return self.one.steepest_slope + self.other.steepest_slope

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        return jnp.minimum(self.one.shortest_wavelength, self.other.shortest_wavelength)


def _sum(one: Irregularity, other: Irregularity) -> Irregularity:
    """Adds displacements, or slopes; a roll of None adds nothing."""
    roll = one.roll if other.roll is None else other.roll if one.roll is None else one.roll + other.roll
    return Irregularity(one.lateral + other.lateral, one.vertical + other.vertical, roll)


class TrackSet(AbstractRail):
    """Several rails, such as surveys of one track, of which a number chooses one.

    ```python
    ds = sj.sweep(dataclasses.replace(scene, track=sj.TrackSet(rails)), {"track.number": range(len(rails))})
    ```
    """

    tracks: tuple[AbstractRail, ...] = eqx.field(
        converter=lambda tracks: tuple(instance("tracks", tracks, Sequence, "one or more rails"))
    )
    """Rails of samples, surveys or random rails, with the same `ends`, reference length and kinds of displacement."""
    chosen_by: ClassVar = "number"
    number: Float[Array, ""] = field("", finite, default=0)
    """Which of them is the track, from 0 [1]; a traced number of which there is none gives NaN."""

    def __check_init__(self):
        require(self.tracks, "tracks", "be one or more rails", self.tracks)
        for track in self.tracks:
            require(isinstance(track, AbstractRail), "tracks", "be rails such as slipperjax.SampledTrack", track)
        alike = {(track.ends, getattr(track, "roll", None) is None) for track in self.tracks}
        require(len(alike) == 1, "tracks", "have the same ends, and all roll or none", shown=f"{len(alike)} kinds")
        if not is_traced(self.number):
            whole_number("number", most=len(self.tracks) - 1)(self.number)
        if not is_traced(self.tracks):
            lengths = {float(track.wavelength) for track in self.tracks}
            require(len(lengths) == 1, "tracks", "have one reference length", shown=f"{sorted(lengths)} m")

    def check_of(self, field: str) -> Check | None:
        return whole_number(field, most=len(self.tracks) - 1) if field == "number" else super().check_of(field)

    def __repr__(self) -> str:
        return f"TrackSet({len(self.tracks)} rails, number={shown_number(self.number)})"

    @property
    def ends(self) -> str:
        return self.tracks[0].ends

    @property
    def reference_length(self) -> Float[Array, ""]:
        return self.tracks[0].reference_length

    def prepared(self) -> SplineTrack:
        """Returns the chosen rail's spline, with coefficients for the longest."""
        splines = [track.prepared() for track in self.tracks]
        most = max(len(spline.coefficients) for spline in splines)
        longer = lambda rows: jnp.pad(rows, ((0, most - len(rows)), (0, 0)))
        index, known = chosen(self)
        of_index = lambda values: jnp.stack(values)[index]
        coefficients = jnp.where(known, of_index([longer(spline.coefficients) for spline in splines]), jnp.nan)
        first, spacing, count = (
            of_index([getattr(s, of) for s in splines]) for of in ("first", "spacing", "intervals")
        )
        return SplineTrack(first, spacing, count, coefficients, self.wavelength, self.ends)

    @property
    def begin(self) -> Any:
        """Where all of them are described [m]."""
        return greatest([track.begin for track in self.tracks])

    @property
    def extent(self) -> Any:
        """That of the shortest rail [m]."""
        return -greatest([-track.extent for track in self.tracks])

    @property
    def recurrence(self) -> Float[Array, ""]:
        return jnp.max(jnp.stack([track.recurrence for track in self.tracks]))

    @property
    def steepest_slope(self) -> Float[Array, ""]:
        """That of the steepest rail [1], so that all take the same steps."""
        return jnp.max(jnp.stack([track.steepest_slope for track in self.tracks]))

    @property
    def shortest_wavelength(self) -> Float[Array, ""]:
        return jnp.min(jnp.stack([track.shortest_wavelength for track in self.tracks]))
