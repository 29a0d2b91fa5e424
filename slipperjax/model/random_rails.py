"""Random rails from spectra of their displacement; each seed is one rail.

All spectra here are one-sided densities by wavenumber in cycles per metre: the variance between two wavenumbers is
the integral of the density between them. Published spectra in rad/m are converted: S(cycles/m) = 2 pi S(rad/m).
"""

import abc
from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..tools.checks import (
    Check,
    converted,
    instance,
    known,
    not_negative,
    one_of,
    positive,
    require,
    warn,
    whole_number,
)
from ..tools.compile import at_once, with_standard_promotion
from ..tools.deviates import keys_of, normal
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from ..tools.units import in_unit
from .rails import DEFAULT_RAMP, ENDS, AbstractRail, SampledTrack, SplineTrack, mean_wave, ramps
from .survey_spectra import RailStatistics, statistics_of
from .tracks import PLAUSIBLE_GAUGES, AbstractTwoRails, FourierTrack, Irregularity, chosen

correlation = partial(Check, need="from -1 to 1", is_good=lambda x: abs(x) <= 1)
"""Check of a correlation [1]."""
share = partial(Check, need="from 0 to 1", is_good=lambda x: (x >= 0) & (x <= 1))
"""Check of a coherence, the square of a correlation [1]."""


class AbstractSpectrum(ShapeChecked):
    """A one-sided spectral density of a rail's displacement."""

    @abc.abstractmethod
    def density(self, wavenumber: Float[Array, "*places"]) -> Float[Array, "*places"]:
        """Return the one-sided density [m^2 per cycle/m], of roll [rad^2 per cycle/m].

        **Arguments:** `wavenumber` [cycles/m].
        """

    def rms(self, band: tuple[float, float], power: int = 0) -> Float[Array, ""]:
        """Return the root mean square over a band of wavelengths [m]: of the displacement [m], or with a `power` of
        the displacement's derivative of that order by distance [m^(1 - power)]."""
        k = jnp.geomspace(1 / band[1], 1 / band[0], 4001)
        values = self.density(k) * (2 * jnp.pi * k) ** (2 * power)
        # over the logarithm of k, because spectra change slowly with it
        return jnp.sqrt(jnp.trapezoid(values * k, jnp.log(k)))


class PowerLawSpectrum(AbstractSpectrum):
    """A k^-n, with k in cycles per metre."""

    amplitude: Float[Array, ""] = field("m^2 per cycle/m", not_negative)
    """Density at 1 cycle per metre [m^2 per cycle/m]."""
    exponent: Float[Array, ""] = field("", positive)
    """Exponent n [1]."""

    def density(self, wavenumber):
        return self.amplitude * wavenumber**-self.exponent


class CornerSpectrum(AbstractSpectrum):
    """A Wc^2 / ((W^2 + Wr^2) (W^2 + Wc^2)), with W in radians per metre: the form that railways use."""

    amplitude: Float[Array, ""] = field("m^2 rad/m", not_negative)
    """A [m^2 rad/m], for a one-sided density per rad/m."""
    low: Float[Array, ""] = field("rad/m", not_negative)
    """Wr [rad/m]."""
    high: Float[Array, ""] = field("rad/m", positive)
    """Wc [rad/m]."""

    def density(self, wavenumber):
        square = (2 * jnp.pi * wavenumber) ** 2
        return 2 * jnp.pi * self.amplitude * self.high**2 / ((square + self.low**2) * (square + self.high**2))


class TableSpectrum(AbstractSpectrum):
    """A table, interpolated between logarithms, and zero beyond its ends."""

    wavenumber: Float[Array, " rows"] = field("cycles/m", positive)
    """Wavenumbers, rising [cycles/m]."""
    values: Float[Array, " rows"] = field("m^2 per cycle/m", positive)
    """One-sided densities at these wavenumbers [m^2 per cycle/m]."""

    def __check_init__(self):
        check_table(self, "wavenumber", "values", least=2)

    def density(self, wavenumber):
        # zero has no logarithm; it is outside of the table
        k = jnp.where(wavenumber > 0, wavenumber, self.wavenumber[0])
        value = jnp.exp(jnp.interp(jnp.log(k), jnp.log(self.wavenumber), jnp.log(self.values)))
        inside = (wavenumber >= self.wavenumber[0]) & (wavenumber <= self.wavenumber[-1])
        return jnp.where(inside, value, 0.0)


class RandomTrack(AbstractRail):
    """A random rail: normal deviates with given spectra, one rail for each seed.

    ```python
    track = sj.RandomTrack.sled(seed=3)
    ds = sj.sweep(scene, {"track.seed": range(200)})  # two hundred rails
    ```

    For one length and band, a seed gives the same deviates for every roughness and spectrum, so that designs are
    compared on the same rails.
    """

    chosen_by: ClassVar = "seed"
    lateral: AbstractSpectrum | None
    """Spectrum of the lateral displacement; None: no displacement."""
    vertical: AbstractSpectrum | None
    """Spectrum of the vertical displacement; None: no displacement."""
    roll: AbstractSpectrum | None = None
    """Spectrum of the roll angle [rad^2 per cycle/m]; None: the track does not roll."""
    band: tuple[float, float] = eqx.field(
        static=True, converter=converted("band", "m"), default=(0.4, 100.0), metadata={"unit": "m"}
    )
    """Shortest and longest wavelength [m], by default of the published spectrum of a sled track."""
    length: float = eqx.field(static=True, converter=converted("length", "m"), default=1000.0, metadata={"unit": "m"})
    """Length of the rail [m]."""
    seed: Float[Array, ""] = field("", whole_number, default=0)
    """Number of the rail, a whole number of 0 or more [1]; another number that is traced gives NaN."""
    roughness: Float[Array, ""] = field("", not_negative, default=1.0)
    """Factor of all displacements [1]."""
    coherence: Float[Array, ""] | None = field("", correlation, default=None)
    """Correlation of the lateral with the vertical displacement [1]; None: no correlation."""
    ends: str = eqx.field(static=True, default="straight")
    """How the rail continues beyond its ends, see `SampledTrack`."""
    ramp: Float[Array, ""] = field("m", not_negative, default=DEFAULT_RAMP)
    """Length of the ramps at the ends of a rail that continues straight [m]."""
    lines: FourierTrack | None = None
    """Sines that all seeds have, by the distance from the rail's beginning, such as joints; None: no sines."""
    first: float = eqx.field(static=True, converter=converted("first", "m"), default=0.0, metadata={"unit": "m"})
    """Distance at which the rail begins [m]."""

    @classmethod
    def german(cls, disturbance: str = "low", **options: object) -> "RandomTrack":
        """Return a rail with the German railways' spectra, "low" or "high" disturbance; wavelengths of 3 to 25 m."""
        # A of the vertical and of the lateral alignment [m^2 rad/m]
        amplitudes = {"low": (4.032e-7, 2.119e-7), "high": (1.08e-6, 6.125e-7)}
        vertical, lateral = amplitudes[one_of("disturbance", disturbance, tuple(amplitudes))]
        return cls(
            **{
                "band": (3.0, 25.0),
                "vertical": CornerSpectrum(vertical, 0.0206, 0.8246),
                "lateral": CornerSpectrum(lateral, 0.0206, 0.8246),
                **options,
            }
        )

    @classmethod
    def fra(cls, track_class: int, **options: object) -> "RandomTrack":
        """Return a rail of a track class of the Federal Railroad Administration, 1 to 6; wavelengths of 1.5 to
        50 m."""
        require(track_class in range(1, 7), "track_class", "be a class of 1 to 6", track_class)
        # A of the vertical profile and of the lateral alignment by class, as commonly reprinted [cm^2 rad/m]
        vertical = (1.2107, 1.0181, 0.6816, 0.5376, 0.2095, 0.0339)
        lateral = (3.3634, 1.2107, 0.4128, 0.3027, 0.0762, 0.0339)
        of = lambda table: CornerSpectrum(0.25 * table[track_class - 1] * 1e-4, 0.0, 0.8245)
        return cls(**{"band": (1.5, 50.0), "vertical": of(vertical), "lateral": of(lateral), **options})

    @classmethod
    def sled(cls, **options: object) -> "RandomTrack":
        """Return a rail with a sled track's published spectrum, the same in both directions; wavelengths of 0.4 to
        100 m.

        A fit to 10 mm^2 m at 0.01 and 1e-4 mm^2 m at 2.5 cycles/m, doi:10.3969/j.issn.0258-2724.2015.06.028.
        """
        exponent = 2.085
        return cls.power_law(10e-6 * 0.01**exponent, exponent, **options)

    @classmethod
    def power_law(cls, amplitude: Real, exponent: Real, **options: object) -> "RandomTrack":
        """Return a rail of the one-sided density `amplitude` k^-`exponent` in both directions.

        **Arguments:** `amplitude`: at k = 1 cycle per metre [m^2 per cycle/m]; `options`: fields of `RandomTrack`.
        """
        spectrum = PowerLawSpectrum(amplitude, exponent)
        return cls(**{"vertical": spectrum, "lateral": spectrum, **options})

    @classmethod
    def spectrum(cls, wavenumber: Numbers, density: Numbers, **options: object) -> "RandomTrack":
        """Return a rail with a tabulated spectrum in both directions, in the band of the table.

        **Arguments:** `wavenumber` [cycles/m]; `density`: one-sided [m^2 per cycle/m].
        """
        spectrum = TableSpectrum(wavenumber, density)
        # the highest wavenumber belongs to the shortest wave
        band = tuple(1 / float(k) for k in (spectrum.wavenumber[-1], spectrum.wavenumber[0]))
        return cls(**{"band": band, "vertical": spectrum, "lateral": spectrum, **options})

    @classmethod
    def like(cls, survey: SampledTrack, **options: object) -> "RandomTrack":
        """Return a rail with a survey's coherence and spectra, from an eighth of its length to three samples.

        ```python
        survey = sj.load_rail("survey.csv")
        alike = sj.RandomTrack.like(survey)
        track = sj.model.TrackSet([survey, *(dataclasses.replace(alike, seed=seed) for seed in range(1, 200))])
        ```

        Narrow peaks of the spectra, such as those of recurring joints, are not random. They become the `lines`, with
        the survey's amplitudes and phases, so that all seeds have joints of one shape at the survey's places. A rail
        that repeats has a whole number of these waves; another `length` of such a rail needs another call.

        **Arguments:** `survey`: a rail of samples; `options`: fields of `RandomTrack`, by default with the survey's
        beginning, length and ends.

        **Raises:** `ValueError` for a rail without samples, or with fewer than 256.
        """
        instance("survey", survey, SampledTrack, "a rail of samples such as slipperjax.load_rail returns")
        known("survey", survey)
        channels = _sizes(survey)
        count = survey.lateral.shape[0]
        require(count >= 256, "survey", "have 256 samples or more, which show a spectrum", shown=str(count))
        begin, end = survey.bounds
        length = float(end - begin)
        found = statistics_of(np.stack([np.asarray(samples) for samples in channels.values()]), length / (count - 1))
        # a channel of zeros has no logarithm
        spectra = [TableSpectrum(found.wavenumber, np.fmax(density, 1e-40)) for density in found.density]
        band = (1 / float(found.wavenumber[-1]), 1 / float(found.wavenumber[0]))
        own = {"band": band, "length": length, "first": float(begin), "ends": survey.ends}
        own |= {"coherence": found.correlation[0, 1], **dict(zip(channels, spectra, strict=True))}
        if survey.ends == "straight":
            own["ramp"] = survey.ramp
        own |= options
        if found.multiple.size:
            # a rail that repeats has a whole number of each wave
            length = in_unit(own["length"], "m") if own["ends"] == "repeat" else np.inf
            own.setdefault("lines", _lines(found, tuple(channels), length))
        return cls(**own)

    def __check_init__(self):
        for name in Irregularity._fields:
            kinds = (AbstractSpectrum, type(None))
            instance(name, getattr(self, name), kinds, "a spectrum such as PowerLawSpectrum(...)")
        require(
            isinstance(self.band, tuple) and len(self.band) == 2 and 0 < self.band[0] < self.band[1],
            "band",
            "be a tuple of the shortest and the longest wavelength [m]",
            self.band,
        )
        require(
            isinstance(self.length, int | float | np.number) and self.length >= 2 * self.band[1],
            "length",
            f"be at least twice the longest wave, {self.band[1]:g} m",
            self.length,
        )
        one_of("ends", self.ends, ENDS)
        if self.lines is not None:
            instance("lines", self.lines, FourierTrack, "a slipperjax.model.FourierTrack")
        if self.band[0] >= 1.5:
            warn(f"Argument `band` has no waves below {self.band[0]:g} m, of which slippers feel most.")

    @property
    def bounds(self):
        return self.first, self.first + self.length

    def prepared(self):
        """Return this seed's rail as a spline, by one Fourier transform for each direction."""
        return self.spline()

    @property
    def _wave_numbers(self) -> Int[np.ndarray, " waves"]:
        """Numbers of the random waves in the rail's length: of all whole numbers, those in the band."""
        numbers = np.arange(2 + int(self.length / self.band[0]))
        wavenumbers = numbers / self.length
        return numbers[(wavenumbers >= 1 / self.band[1]) & (wavenumbers <= 1 / self.band[0])]

    @with_standard_promotion
    def spline(self, correlation: Float[Array, ""] | None = None) -> SplineTrack:
        """Return this seed's rail as a spline, or with a `correlation` [1] a second rail.

        Random numbers of the second rail: `correlation` times the numbers of this rail, plus a share of further
        numbers of the same seed.
        """
        # with eight samples in the shortest wave, the spline changes this wave by a thousandth
        count = 2 * int(np.ceil(8 * self.length / self.band[0] / 2))
        numbers = self._wave_numbers
        k = jnp.asarray(numbers / self.length)
        spacing = self.length / count
        # a spline whose coefficients are a wave of amplitude 1 is the same wave with this amplitude
        share = (2 + jnp.cos(2 * jnp.pi * spacing * k)) / 3

        def coefficients(spectrum: AbstractSpectrum | None, deviates: Array) -> Array:
            """Return the coefficients of one direction, with further ones beyond both ends: those of a repetition."""
            if spectrum is None:
                return jnp.zeros(count + 3)
            # amplitudes from the variance in each wavenumber's share of the band
            waves = jnp.sqrt(spectrum.density(k) / self.length) / share * (deviates[0] - 1j * deviates[1])
            every = jnp.zeros(count // 2 + 1, complex).at[numbers[0] : numbers[-1] + 1].set(waves)
            around = jnp.fft.irfft(every, n=count) * count / 2
            return jnp.concatenate([around[-1:], around, around[:2]])

        seed, is_rail = chosen(self)
        # each direction has its own key, so that it does not depend on which other directions there are
        deviates = [normal(key, (2, k.size)) for key in keys_of(seed, 4)[:3]]
        if correlation is not None:
            # further keys of the seed, which do not change the first keys
            others = [normal(key, (2, k.size)) for key in keys_of(seed, 6)[3:]]
            apart = jnp.sqrt(1 - correlation**2)
            deviates = [correlation * one + apart * other for one, other in zip(deviates, others, strict=True)]
        vertical, lateral, roll = deviates
        # lateral and vertical deviates have a common part
        if self.coherence is not None:
            lateral = self.coherence * vertical + jnp.sqrt(1 - self.coherence**2) * lateral
        rows = [coefficients(self.lateral, lateral), coefficients(self.vertical, vertical)]
        if self.roll is not None:
            rows.append(coefficients(self.roll, roll))
        if self.lines is not None:
            rows = [row + line for row, line in zip(rows, self._line_coefficients(spacing, count), strict=True)]
        # a number that chooses no rail gives NaN
        rail = jnp.where(is_rail, self.roughness, jnp.nan) * jnp.stack(rows, axis=1)
        # distance of each coefficient, also of those beyond the rail, to the nearer end of the rail
        if self.ends == "straight":
            away = spacing * jnp.asarray(np.minimum(np.arange(-1, count + 2), np.arange(count + 1, -2, -1)))
            rail = ramps(away, self.ramp)[:, None] * rail
        grid = (jnp.full((), self.first), jnp.asarray(spacing), jnp.asarray(float(count)))
        return SplineTrack(*grid, rail, self.wavelength, self.ends)

    def _line_coefficients(self, spacing: float, count: int) -> list[Array]:
        """Return the spline coefficients of the lines, for each direction that the rail has."""
        lines = self.lines
        assert lines is not None  # where this is called
        # as in `spline` for the random waves
        share = (2 + jnp.cos(2 * jnp.pi * spacing / lines.wavelengths)) / 3
        larger = {name: size / share for name, size in _sizes(lines).items()}
        waves = replace(lines, **larger).irregularity(spacing * jnp.arange(-1.0, count + 2))
        roll = [] if self.roll is None else [jnp.zeros(()) if waves.roll is None else waves.roll]
        return [waves.lateral, waves.vertical, *roll]

    def rms(self, power: int = 0) -> Irregularity:
        """Return the root mean squares of displacements [m] and roll [rad], of spectra and lines together, or of the
        derivatives of the order `power`, over all seeds.

        They are those of the rail's own random waves, of which a whole number is in its length. On a short rail they
        exceed the integral of the spectrum over the band, because the longest wave has its whole share of the
        spectrum.
        """
        k = jnp.asarray(self._wave_numbers / self.length)

        def of(spectrum: AbstractSpectrum | None) -> Array:
            if spectrum is None:
                return jnp.zeros(())
            squares = spectrum.density(k) / self.length * (2 * jnp.pi * k) ** (2 * power)
            return self.roughness * jnp.sqrt(jnp.sum(squares))

        roll = None if self.roll is None else of(self.roll)
        return self._with_lines(Irregularity(of(self.lateral), of(self.vertical), roll), power)

    def _with_lines(self, random: Irregularity, power: int) -> Irregularity:
        """Return root mean squares of random waves and lines together from those of the random waves, see `rms`."""
        lines = self.lines
        if lines is None:
            return random
        of_wave = self.roughness * (2 * jnp.pi / lines.wavelengths) ** power
        squares = {name: jnp.sum((size * of_wave) ** 2) / 2 for name, size in _sizes(lines).items()}
        rms = random._asdict()
        return Irregularity(**rms | {k: jnp.sqrt(rms[k] ** 2 + v) for k, v in squares.items() if rms[k] is not None})

    def _spectral_rms(self, power: int) -> Irregularity:
        """Return the root mean squares of the spectra over the band, without lines: of rails of any length, so that
        scales of slopes and waves do not depend on the length. Arguments as of `rms`."""
        of = lambda spectrum: jnp.zeros(()) if spectrum is None else self.roughness * spectrum.rms(self.band, power)
        return Irregularity(of(self.lateral), of(self.vertical), None if self.roll is None else of(self.roll))

    @property
    def steepest_slope(self):
        """Four times the greater root mean square slope [1], the same for all seeds: one normal deviate in 30,000 is
        greater. The steepest slope of the lines is added, because joints have all their lines at once."""
        slope = self._spectral_rms(1)
        steepest = 4.0 * jnp.maximum(slope.lateral, slope.vertical)
        return steepest if self.lines is None else steepest + self.roughness * self.lines.steepest_slope

    @property
    @at_once
    def shortest_wavelength(self):
        """Wavelength of a sine with the same root mean squares of slope and curvature [m], see `SampledTrack`."""
        both = [self._with_lines(self._spectral_rms(power), power) for power in (1, 2)]
        slope, curvature = (jnp.sqrt(of.lateral**2 + of.vertical**2) for of in both)
        return mean_wave(slope, curvature, self.wavelength)


class _Beside(AbstractRail):
    """The second of two random rails of one seed, whose displacements are correlated with those of the first."""

    rail: RandomTrack
    """Spectra of this rail, with the seed of the pair."""
    correlation: Float[Array, ""]
    """Correlation of each wave with the same wave of the first rail [1]."""

    @property
    def ends(self):
        return self.rail.ends

    @property
    def roll(self):
        return self.rail.roll

    @property
    def bounds(self):
        return self.rail.bounds

    def prepared(self):
        return self.rail.spline(self.correlation)

    @property
    def steepest_slope(self):
        return self.rail.steepest_slope

    @property
    def shortest_wavelength(self):
        return self.rail.shortest_wavelength


class RandomRails(AbstractTwoRails):
    """Two random rails side by side with a coherence, one pair for each seed.

    ```python
    track = sj.model.RandomRails(sj.RandomTrack.sled(), coherence=0.5, gauge=1.2, seed=3)
    ds = sj.sweep(scene, {"track.seed": range(200)})  # two hundred pairs of rails
    ```

    The left rail is the `RandomTrack` of the same seed. Within each rail `RandomTrack.coherence` correlates lateral
    and vertical. Left and right are in phase, with the same coherence for lateral, vertical and roll.
    """

    chosen_by: ClassVar = "seed"
    rail: RandomTrack
    """Spectra, length and ends of both rails, or of the left rail; the seed of this track must be 0."""
    coherence: Float[Array, ""] = field("", share)
    """Magnitude squared coherence of left and right at all wavelengths of the band, |S_LR|^2 / (S_L S_R) [1]: the
    square of the correlation of their waves. 0 for independent rails, 1 for equal rails."""
    gauge: Float[Array, ""] | None = field("m", positive, plausible=PLAUSIBLE_GAUGES, default=None)
    """Distance between the axes of the undisturbed rails [m]; None: each rail is where its mounts are."""
    seed: Float[Array, ""] = field("", whole_number, default=0)
    """Number of the pair, a whole number of 0 or more [1]; another number that is traced gives NaN."""
    right_rail: RandomTrack | None = None
    """Spectra, length and ends of the right rail where its spectra differ; None: the right rail is like the left."""

    @classmethod
    def like(cls, survey: AbstractTwoRails, *, seed: int = 0, **options: object) -> "RandomRails":
        """Return rails with the spectra, lines and coherence of both rails of a survey, see `RandomTrack.like`.

        ```python
        survey = sj.load_rail("both.csv")
        scene = dataclasses.replace(scene, track=sj.model.RandomRails.like(survey))
        ds = sj.sweep(scene, {"track.seed": range(200)})
        ```

        The coherence is one number: the square of the mean real coherence of lateral and of vertical, over the waves
        of the spectra without lines; zero where this mean is negative, as for left and right in opposite phase.

        **Arguments:** `survey`: two rails of samples at the same distances; `seed`: number of the pair; `options`:
        fields of `RandomTrack` for both rails.

        **Raises:** `ValueError` as `RandomTrack.like`, and for rails whose samples are at different distances.
        """
        instance("survey", survey, AbstractTwoRails, "two rails such as slipperjax.load_rail returns")
        left, right = (RandomTrack.like(rail, **options) for rail in survey.rails.values())
        both = (survey.left, survey.right)
        grids = {(*map(float, rail.bounds), len(rail.lateral)) for rail in both}
        require(len(grids) == 1, "survey", "have samples at the same distances on both rails", shown="not")
        ((begin, end, count),) = grids
        # lateral and vertical of both rails
        channels = np.stack([np.asarray(x) for rail in both for x in (rail.lateral, rail.vertical)])
        found = statistics_of(channels, (end - begin) / (count - 1)).correlation
        directions = [found[k, k + 2] for k in (0, 1) if channels[k].any() and channels[k + 2].any()]
        correlation = max(0.0, float(np.mean(directions))) if directions else 0.0
        return cls(left, correlation**2, survey.gauge, seed, right)

    def __check_init__(self):
        rails = {"rail": self.rail, "right_rail": self.right_rail or self.rail}
        for name, rail in rails.items():
            instance(name, rail, RandomTrack, "a slipperjax.RandomTrack")
            own = is_traced(rail.seed) or np.all(np.asarray(rail.seed) == 0)
            require(own, name, "have the seed 0, because that of the pair counts", rail.seed)
        alike = {(rail.band, rail.length, rail.first, rail.ends, rail.roll is None) for rail in rails.values()}
        need = "have the band, length, beginning and ends of `rail`, and roll or not as that does"
        require(len(alike) == 1, "right_rail", need, shown="another rail")

    @property
    def left(self):
        return self._of_pair(self.rail)

    @property
    def right(self):
        rail = self._of_pair(self.right_rail or self.rail)
        return _Beside(rail, jnp.sqrt(self.coherence))  # pyright: ignore[reportCallIssue] - `ends` is a property

    def _of_pair(self, rail: RandomTrack) -> RandomTrack:
        """Return a rail with the seed of the pair; the seed is NaN where the rail's own seed is not 0."""
        return eqx.tree_at(lambda track: track.seed, rail, jnp.where(rail.seed == 0, self.seed, jnp.nan))


def _sizes(rail: FourierTrack | SampledTrack) -> dict[str, Array]:
    """Return the amplitudes, or samples, of each direction that a rail has, by name."""
    sizes = {name: getattr(rail, name) for name in Irregularity._fields}
    return {name: size for name, size in sizes.items() if size is not None}


def _lines(found: RailStatistics, channels: tuple[str, ...], length: float) -> FourierTrack:
    """Return the lines of a survey as sines that recur after a length [m], unless the length is infinite."""
    least = found.fundamental
    if length < np.inf:
        least = np.round(least * length) / length
    sines = {}
    for name, sine, cosine in zip(channels, found.sine, found.cosine, strict=True):
        sines[name] = np.hypot(sine, cosine)
        sines[f"{name}_phase"] = np.arctan2(cosine, sine)
    return FourierTrack(1 / (least * found.multiple), **sines)
