"""Rails of samples, such as surveys: cubic splines with continuous second derivatives."""

import abc
import dataclasses
import functools
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import (
    Check,
    finite,
    known,
    not_negative,
    number,
    one_of,
    require,
    tuple_of,
    warn,
    whole_number,
)
from ..tools.compile import at_once
from ..tools.fields import field
from ..tools.files import listed
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from ..tools.units import in_unit
from .tracks import (
    AbstractTrack,
    AbstractTwoRails,
    Irregularity,
    TwoRails,
    chosen,
    greatest,
    least,
    on_host,
    smooth_step,
)

ENDS = ("straight", "repeat", "error")
"""How a rail continues beyond its ends. "straight": at zero; "repeat": periodic; "error": NaN after its end, with an
error before a run where this is known, and level before its start, where the rear of a slipper begins."""
DEFAULT_RAMP = 8.0
"""Length of the ramps at the ends of a rail that continues straight [m]; a quarter of the rail if that is less."""
Displacement = Real | Numbers
"""One number for the whole rail, or one for each sample."""
Channels = dict[str, Array | np.ndarray]
"""Lateral and vertical displacement [m], and roll [rad] if any, of each sample, by name."""
EQUAL_SPACING = 1e-3
"""Greatest difference from equal spacing that counts as equal, divided by the spacing."""


class SplineTrack(AbstractTrack):
    """A uniform cubic spline as runs evaluate it, see `SampledTrack.prepared`."""

    first: Float[Array, ""]
    """Distance of the first knot [m]."""
    spacing: Float[Array, ""]
    """Distance between knots [m]."""
    intervals: Float[Array, ""]
    """Number of intervals between knots [1]; further coefficients do not count."""
    coefficients: Float[Array, "knots channels"]
    """Coefficients of the B-splines: lateral and vertical [m], and roll [rad] if any."""
    forcing_length: Float[Array, ""]
    """Length of travel that counts as one period [m]."""
    ends: str = eqx.field(static=True)

    @property
    def wavelength(self):
        return self.forcing_length

    @property
    def is_rough(self):
        return True

    def irregularity(self, distance):
        return self.motion(distance)[0]

    @at_once
    def motion(self, distance):
        # the four cubic B-splines that reach into an interval, and their derivatives
        (a, b, c, d), u, s = self._interval(distance)
        value = ((1 - u) ** 3 * a + (3 * u**3 - 6 * u**2 + 4) * b + (1 + 3 * u * (1 + u - u**2)) * c + u**3 * d) / 6
        slope = (u**2 * d - (1 - u) ** 2 * a + (3 * u - 4) * u * b + (1 + 2 * u - 3 * u**2) * c) / 2 / self.spacing
        if self.ends == "error":
            # level before the rail's start
            slope = jnp.where(s < 0, 0.0, slope)
        return self._of(value, s), self._of(slope, s)

    def _interval(self, distance: Array) -> tuple[list[Array], Array, Array]:
        """Return the four coefficients at a distance, the place within its interval (0 to 1), and the place on the
        rail, in intervals."""
        s = (distance - self.first) / self.spacing
        count = self.intervals
        if self.ends == "repeat":
            s = s - count * jnp.floor(s / count)
        # places beyond the ends belong to the first or the last interval
        at = jnp.clip(jnp.floor(s), 0, count - 1)
        index = at.astype(int)
        # four neighbours as one slice, so that a batch of rails reads one piece of memory
        four = lambda i: jax.lax.dynamic_slice_in_dim(self.coefficients, i, 4)
        rows = jnp.moveaxis(jax.vmap(four)(index.ravel()), 1, 0).reshape(4, *index.shape, -1)
        place = jnp.where(s < 0, 0.0, s) if self.ends == "error" else s
        return list(rows), (place - at)[..., None], s[..., None]

    def _of(self, rows: Array, s: Array) -> Irregularity:
        """Return rows of channels as displacements, also beyond the ends."""
        if self.ends == "straight":
            rows = jnp.where((s >= 0) & (s <= self.intervals), rows, 0.0)
        elif self.ends == "error":
            rows = jnp.where(s <= self.intervals, rows, jnp.nan)
        # a rail without roll has two channels
        channels = [rows[..., k] for k in range(rows.shape[-1])]
        return Irregularity(*channels, *[None] * (3 - len(channels)))


@functools.partial(at_once, static_argnums=1)
def spline_coefficients(samples: Float[Array, " samples"], ends: str) -> Float[Array, " knots"]:
    """Return the coefficients of cubic B-splines through equally spaced samples. Pure.

    A rail that repeats has a periodic spline, whose last sample equals the first. Otherwise the second derivatives
    are zero at the ends: the line through both ends is subtracted, and the samples are continued as an odd function,
    so that they are also periodic. The spline of periodic samples is a division of their Fourier coefficients.
    """
    count = samples.shape[0] - 1
    if ends == "repeat":
        # each interval needs its neighbours: one row before and two rows behind, around the circle
        rows = _periodic_coefficients(samples[:-1])
        return jnp.concatenate([rows[-1:], rows, rows[:2]])
    # the spline of a line is the line
    line = samples[0] + (samples[-1] - samples[0]) * jnp.arange(-1, count + 2) / count
    odd = samples - line[1:-1]
    rows = _periodic_coefficients(jnp.concatenate([odd[:-1], -odd[:0:-1]]))
    return line + jnp.concatenate([rows[-1:], rows[: count + 2]])


def _periodic_coefficients(samples: Float[Array, " samples"]) -> Float[Array, " samples"]:
    """Return the c with (c_before + 4 c + c_after) / 6 = samples around a circle."""
    count = samples.shape[0]
    # factor by which the average changes each wave
    share = (2 + np.cos(2 * np.pi * np.arange(count // 2 + 1) / count)) / 3
    return jnp.fft.irfft(jnp.fft.rfft(samples) / share, n=count)


class AbstractRail(AbstractTrack):
    """A rail of samples or of a spectrum, which runs evaluate as a spline."""

    ends: eqx.AbstractVar[str]

    @property
    def is_rough(self):
        return True

    @abc.abstractmethod
    def prepared(self) -> SplineTrack:
        """Return the rail's spline."""

    @property
    @abc.abstractmethod
    def bounds(self) -> Sequence[Real] | Array | np.ndarray:
        """Distances between which the rail is given [m], known before a program runs unless they are traced."""

    @property
    def recurrence(self):
        if self.ends != "repeat":
            return jnp.asarray(jnp.inf)
        begin, end = self.bounds
        return jnp.asarray(end - begin)

    @property
    def begin(self):
        return -np.inf if self.ends == "repeat" else self.bounds[0]

    @property
    def extent(self):
        return np.inf if self.ends == "repeat" else self.bounds[1]

    @property
    def end(self):
        return self.extent if self.ends == "error" else np.inf

    def irregularity(self, distance):
        return self.prepared().irregularity(distance)

    def motion(self, distance):
        return self.prepared().motion(distance)


def mean_wave(slope: Array, curvature: Array, most: Array) -> Float[Array, ""]:
    """Return the wavelength of a sine [m] with these root mean squares of slope [1] and curvature [1/m]; at most
    `most`, also where there is no curvature."""
    wave = 2 * jnp.pi * slope / jnp.where(curvature > 0, curvature, 1.0)
    return jnp.where(curvature > 0, jnp.minimum(wave, most), most)


class SampledTrack(AbstractRail):
    """A track through samples, such as a survey, by a cubic spline with continuous second derivatives.

    ```python
    track = sj.model.SampledTrack(distance, lateral, vertical)  # arrays [m]
    ```
    """

    distance: Float[Array, "2"] = field("m", finite)
    """Distances of the first and the last sample [m]; the other samples are at equal distances between them."""
    lateral: Float[Array, " samples"] = field("m", finite, plausible=(-1.0, 1.0))
    """Displacement of the rail's axis along y at the samples [m]."""
    vertical: Float[Array, " samples"] = field("m", finite, plausible=(-1.0, 1.0))
    """Displacement along z [m]."""
    roll: Float[Array, " samples"] | None = field("rad", finite, plausible=(-0.5, 0.5), optional=True)
    """Roll angle [rad]. None: the track does not roll."""
    ends: str = eqx.field(static=True)
    """One of `ENDS`."""
    ramp: Float[Array, ""] = field("m", not_negative)
    """Length [m] over which a straight rail rises from zero at its ends, or over which a repeating rail was closed.
    """

    def __init__(
        self,
        distance: Numbers,
        lateral: Displacement,
        vertical: Displacement,
        roll: Displacement | None = None,
        *,
        ends: str = "straight",
        ramp: Real | None = None,
    ):
        """**Arguments:**

        - `distance`: of the samples [m], increasing; or of the first and the last of equally spaced samples. Other
            samples are resampled at equal distances; a warning says by how much this changes the rail at the samples.
        - `lateral`, `vertical`, `roll`: displacements [m] and angle [rad] there; a single number holds everywhere.
        - `ends`: the rail beyond its ends: "straight", with ramps within the rail; "repeat", where the last sample
            must equal the first, or is made equal over the length `ramp`; or "error", where longer runs raise an
            error.
        - `ramp`: length of the ramps [m], default `DEFAULT_RAMP` where the rail continues straight, otherwise zero.
            For a rail that repeats, the length at its end over which a smooth step leads to its beginning; a warning
            says by how much this changes the rail.

        **Raises:** `ValueError` that names the wrong argument.
        """
        self.ends = one_of("ends", ends, ENDS)
        places = _places(distance)
        channels = _channels(places, lateral, vertical, roll)
        if len(places) > 2:
            channels = _evenly_spaced(places, channels)
        length = float(places[-1] - places[0])
        usual = min(DEFAULT_RAMP, length / 4)
        if ramp is None:
            ramp = usual if ends == "straight" else 0.0
        if not is_traced(ramp):
            ramp = number(not_negative, "ramp", ramp, "m")
            require(ramp <= length / 2, "ramp", f"be at most {length / 2:g} m", ramp)
        if ends == "repeat":
            away = length * np.linspace(1.0, 0.0, len(channels["lateral"]))
            channels = _closed(channels, away, known("ramp", ramp), usual)
        self.distance = jnp.asarray(places[[0, -1]])
        self.lateral = channels["lateral"]
        self.vertical = channels["vertical"]
        self.roll = channels.get("roll")
        self.ramp = ramp

    @property
    def wavelength(self):
        """Forcing period [m]: the length of a rail that repeats, so that it has periodic orbits; else the default."""
        return self.length if self.ends == "repeat" else super().wavelength

    @property
    def spacing(self) -> Float[Array, ""]:
        """Distance between samples [m]."""
        return self.length / (self.lateral.shape[0] - 1)

    @property
    def length(self) -> Float[Array, ""]:
        """Length of the rail [m]."""
        return self.distance[1] - self.distance[0]

    @at_once
    def prepared(self):
        """Return the spline through the samples, with ramps from zero at the ends."""
        samples = jnp.stack([c for c in (self.lateral, self.vertical, self.roll) if c is not None], axis=1)
        if self.ends == "straight":
            away = jnp.arange(samples.shape[0]) * self.spacing
            samples = ramps(jnp.minimum(away, self.length - away), self.ramp)[:, None] * samples
        coefficients = jax.vmap(lambda channel: spline_coefficients(channel, self.ends), 1, 1)(samples)
        intervals = jnp.asarray(samples.shape[0] - 1.0)
        return SplineTrack(self.distance[0], self.spacing, intervals, coefficients, self.wavelength, self.ends)

    @property
    def bounds(self):
        return on_host(self.distance)

    def _places(self):
        # a spline is steepest at samples or in the middles between them
        count = 2 * (self.lateral.shape[0] - 1)
        return self.distance[0] + self.length * jnp.arange(count) / count

    @property
    @at_once
    def shortest_wavelength(self):
        """Wavelength of a sine with the same root mean squares of slope and curvature [m]; short waves shorten it
        only as far as they matter; at most `wavelength`."""
        places = self._places()
        slope, curvature = jax.jvp(lambda x: self.motion(x)[1], (places,), (jnp.ones_like(places),))
        rms = lambda of: jnp.sqrt(jnp.mean(of.lateral**2 + of.vertical**2))
        return mean_wave(rms(slope), rms(curvature), self.wavelength)


@at_once
def ramps(away: Array, ramp: Array) -> Array:
    """Return factors from 0 at a rail's ends to 1 at the distance `ramp`; `away`: distance from the ends [m]."""
    return jnp.where(ramp > 0, smooth_step(away / jnp.where(ramp > 0, ramp, 1.0)), 1.0)


def _places(distance: Numbers) -> np.ndarray:
    """Return the distances of samples [m], or of the first and the last; raise `ValueError` for other values."""
    require(not is_traced(distance), "distance", "be known while programs are made", shown="traced")
    # only for its errors
    finite("distance", "m")(distance)
    places = np.asarray(in_unit(distance, "m"), float)  # inside jit, too
    require(places.ndim == 1 and len(places) > 1, "distance", "be a list of distances", distance)
    back = np.flatnonzero(np.diff(places) <= 0)
    if len(back):
        k = int(back[0]) + 1
        shown = f"{places[k]:g} m after {places[k - 1]:g} m at sample {k}"
        require(False, "distance", "increase from sample to sample", shown=shown)
    return places


def _channels(
    places: np.ndarray, lateral: Displacement, vertical: Displacement, roll: Displacement | None
) -> Channels:
    """Return displacements [m] and roll [rad] of each sample by name; raise `ValueError` for other shapes."""
    channels = {"lateral": finite("lateral", "m")(lateral), "vertical": finite("vertical", "m")(vertical)}
    if roll is not None:
        channels["roll"] = finite("roll", "rad")(roll)
    # single numbers hold everywhere, and two distances do not give the number of samples
    lengths = {len(array) for array in channels.values() if array.ndim == 1}
    if len(places) > 2 or not lengths:
        lengths.add(len(places))
    if len(lengths) > 1 or any(array.ndim > 1 for array in channels.values()):
        found = ", ".join(map(str, sorted(lengths)))
        raise ValueError(
            "Arguments `distance`, `lateral`, `vertical` and `roll` must be of equal length, "
            f"but have {found} samples."
        )
    (count,) = lengths
    require(count >= 4, "distance", "be of four or more samples", count)
    # on the host where they are known, so that nothing is compiled
    return {name: on_host(array) + np.zeros(count) for name, array in channels.items()}


def _evenly_spaced(places: np.ndarray, channels: Channels) -> Channels:
    """Return channels at equal distances, resampled where they are not; a warning says by how much this changes the
    channels."""
    gaps = np.diff(places)
    length = float(places[-1] - places[0])
    even = length / len(gaps)
    if np.max(np.abs(places - places[0] - even * np.arange(len(places)))) <= EQUAL_SPACING * even:
        return channels
    from scipy.interpolate import CubicSpline  # here, because importing it takes time

    # as close as the closest samples, but at most eight times as many samples
    count = int(min(np.ceil(length / np.min(gaps)), 8 * len(gaps))) + 1
    at = np.linspace(places[0], places[-1], count)
    if is_traced(channels):
        weights = CubicSpline(places, np.eye(len(places)))(at)  # a spline is linear in its samples
        return {name: weights @ array for name, array in channels.items()}
    resampled = {name: CubicSpline(places, array)(at) for name, array in channels.items()}
    changes = [CubicSpline(at, resampled[name])(places) - channels[name] for name in ("lateral", "vertical")]
    warn(
        f"Argument `distance` is not equally spaced: the rail is resampled every {length / (count - 1):.4g} m, which "
        f"changes it by {np.max(np.abs(changes)):.1g} m at most."
    )
    return resampled


def _closed(channels: Channels, away: np.ndarray, ramp: float, usual: float) -> Channels:
    """Return channels that end as they begin: over the length `ramp` [m] a smooth step removes the difference.

    A warning says how large the difference is. Traced channels cannot be compared; they count as closed without a
    ramp.

    **Arguments:** `away`: distances of the samples from the end [m]; `usual`: a ramp that an error may propose [m].

    **Raises:** `ValueError` where there is a difference and no ramp.
    """
    with jax.ensure_compile_time_eval():  # known inside jit, too
        share = on_host(smooth_step(jnp.asarray(1 - away / ramp))) if ramp > 0 else None
    closed = dict(channels)
    changed = []
    for name, array in channels.items():
        if not is_traced(array):
            missing = abs(array[0] - array[-1])
            if missing <= 1e-9 * (np.max(np.abs(array)) or 1.0):
                continue
            si, shown_unit = ("rad", "mrad") if name == "roll" else ("m", "mm")
            shown = f"{array[-1]:g} {si} at the end and {array[0]:g} {si} at the start"
            remedy = f'; ramp={usual:g}, or ramp = "{usual:g} m" in a file, closes it'
            require(share is not None, name, "end as it begins, because the rail repeats", shown=shown + remedy)
            changed.append(f"{name} by up to {1e3 * missing:.2g} {shown_unit}")
        if share is not None:
            closed[name] = array + share * (array[0] - array[-1])
    if changed:
        warn(f"Argument `ramp`: closing the last {ramp:g} m of the rail changes {listed(changed)}.")
    return closed


class TrackSet(AbstractRail):
    """Several rails, such as surveys of one track, or several pairs of rails, of which a number chooses one.

    ```python
    ds = sj.sweep(dataclasses.replace(scene, track=sj.model.TrackSet(rails)), {"track.number": range(len(rails))})
    ```
    """

    tracks: tuple[AbstractRail | AbstractTwoRails, ...] = eqx.field(
        converter=lambda tracks: tuple_of(
            "tracks", tracks, (AbstractRail, AbstractTwoRails), "rails such as slipperjax.model.SampledTrack"
        )
    )
    """Rails of samples, surveys or random rails, with the same `ends` and kinds of displacement; or pairs of such
    rails, with one gauge."""
    chosen_by: ClassVar = "number"
    number: Float[Array, ""] = field("", finite, default=0)
    """Number of the rail that is the track, from 0 [1]; a traced number without a rail gives NaN."""

    def __check_init__(self):
        require(self.tracks, "tracks", "be one or more rails", self.tracks)
        pairs = {bool(track.rails) for track in self.tracks}
        require(len(pairs) == 1, "tracks", "be single rails or pairs of rails", shown="some of each")
        if pairs == {True}:
            # each side is a set of its own, which checks its rails
            _ = self.rails
        else:
            alike = {(track.ends, getattr(track, "roll", None) is None) for track in self.tracks}
            need = "have the same ends, and all roll or none"
            require(len(alike) == 1, "tracks", need, shown=f"{len(alike)} kinds")
        gauges = [track.gauge for track in self.tracks]
        if not is_traced(gauges):
            require(len({g if g is None else float(g) for g in gauges}) == 1, "tracks", "have one gauge", gauges)
        if not is_traced(self.number):
            self._whole()(self.number)

    def check_of(self, name: str) -> Check | None:
        return self._whole() if name == "number" else super().check_of(name)

    def _whole(self) -> Check:
        return whole_number("number", most=len(self.tracks) - 1)

    @property
    def rails(self):
        names = self.tracks[0].rails
        sets = {
            name: TrackSet([track.rails[name] for track in self.tracks])  # pyright: ignore[reportCallIssue] - `ends` is a property
            for name in names
        }
        # without the check, because the number is NaN where results state no number that varies
        return {name: eqx.tree_at(lambda side: side.number, side, self.number) for name, side in sets.items()}

    @property
    def gauge(self):
        return self.tracks[0].gauge

    @property
    def ends(self):
        first = self.tracks[0]
        return first.left.ends if first.rails else first.ends

    @property
    def wavelength(self):
        return self._most("wavelength")

    def prepared(self):
        """Return the chosen rail's spline, with as many coefficients as the longest; for pairs both splines."""
        if self.rails:
            return TwoRails(**{name: rail.prepared() for name, rail in self.rails.items()}, gauge=self.gauge)
        splines = [track.prepared() for track in self.tracks]
        index, known = chosen(self)
        most = max(len(spline.coefficients) for spline in splines)
        # further coefficients of shorter rails are never used
        longer = lambda rows: jnp.pad(rows, ((0, most - len(rows)), (0, 0)))
        splines = [dataclasses.replace(s, coefficients=longer(s.coefficients)) for s in splines]
        spline = jax.tree.map(lambda *values: jnp.stack(values)[index], *splines)
        rows = jnp.where(known, spline.coefficients, jnp.nan)
        return dataclasses.replace(spline, coefficients=rows, forcing_length=self.wavelength)

    @property
    def bounds(self):
        """Distances between which all rails are given [m]."""
        return greatest([track.begin for track in self.tracks]), least([track.extent for track in self.tracks])

    @property
    def recurrence(self):
        return self._most("recurrence")

    @property
    def steepest_slope(self):
        """Slope of the steepest rail [1], so that all rails take the same steps."""
        return self._most("steepest_slope")

    @property
    def shortest_wavelength(self):
        return jnp.min(jnp.stack([track.shortest_wavelength for track in self.tracks]))

    def _most(self, name: str) -> Float[Array, ""]:
        return jnp.max(jnp.stack([getattr(track, name) for track in self.tracks]))
