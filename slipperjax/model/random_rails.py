"""Random rails from spectra of their displacement, for which each seed is one rail.

All spectra here are one-sided densities by wavenumber in cycles per metre: the variance between two wavenumbers is
the integral of the density between them. Published ones in rad/m are converted: S(cycles/m) = 2 pi S(rad/m).
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import converted, fraction, instance, not_negative, one_of, positive, require, warn, whole_number
from ..tools.compile import at_once, with_standard_promotion
from ..tools.deviates import keys_of, normal
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.types import Numbers, Real
from .rails import DEFAULT_RAMP, ENDS, AbstractRail, SplineTrack, mean_wave, ramps
from .tracks import Irregularity, chosen


class AbstractSpectrum(ShapeChecked):
    """A one-sided spectral density of a rail's displacement."""

    @abc.abstractmethod
    def density(self, wavenumber: Float[Array, "*places"]) -> Float[Array, "*places"]:
        """Return the one-sided density [m^2 per cycle/m], of roll [rad^2 per cycle/m].

        **Arguments:** `wavenumber` [cycles/m].
        """

    def rms(self, band: tuple[float, float], power: int = 0) -> Float[Array, ""]:
        """Return the root mean square over a band of wavelengths [m]: of the displacement [m], or with a `power` of
        its derivative of that order by distance [m^(1 - power)]."""
        k = jnp.geomspace(1 / band[1], 1 / band[0], 4001)
        values = self.density(k) * (2 * jnp.pi * k) ** (2 * power)
        # over the logarithm of k, in which spectra change slowly
        return jnp.sqrt(jnp.trapezoid(values * k, jnp.log(k)))


class PowerLawSpectrum(AbstractSpectrum):
    """A k^-n, with k in cycles per metre."""

    amplitude: Float[Array, ""] = field("m^2 per cycle/m", not_negative)
    """Density at 1 cycle per metre [m^2 per cycle/m]."""
    exponent: Float[Array, ""] = field("", positive)
    """n [1]."""

    def density(self, wavenumber):
        return self.amplitude * wavenumber**-self.exponent


class CornerSpectrum(AbstractSpectrum):
    """A Wc^2 / ((W^2 + Wr^2) (W^2 + Wc^2)), with W in radians per metre: the railways' form."""

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
    """One-sided densities there [m^2 per cycle/m]."""

    def __check_init__(self):
        check_table(self, "wavenumber", "values", least=2)

    def density(self, wavenumber):
        # zero has no logarithm, and is outside of the table
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

    With one length and band, a seed gives the same deviates for every roughness and spectrum, so that designs are
    compared on the same rails.
    """

    chosen_by: ClassVar = "seed"
    lateral: AbstractSpectrum | None
    """Spectrum of the lateral displacement; None for none."""
    vertical: AbstractSpectrum | None
    """Spectrum of the vertical displacement; None for none."""
    roll: AbstractSpectrum | None = None
    """Spectrum of the roll angle [rad^2 per cycle/m]; None: the track does not roll."""
    band: tuple[float, float] = eqx.field(
        static=True, converter=converted("band", "m"), default=(0.4, 100.0), metadata={"unit": "m"}
    )
    """Shortest and longest wavelength [m], by default those of a sled track's published spectrum."""
    length: float = eqx.field(static=True, converter=converted("length", "m"), default=1000.0, metadata={"unit": "m"})
    """Length of the rail [m]."""
    seed: Float[Array, ""] = field("", whole_number, default=0)
    """Number of the rail, a whole number of 0 or more [1]; a traced one that is not gives NaN."""
    roughness: Float[Array, ""] = field("", not_negative, default=1.0)
    """Factor of all displacements [1]."""
    coherence: Float[Array, ""] | None = field("", fraction, default=None)
    """Correlation of the lateral with the vertical displacement [1]; None for none."""
    ends: str = eqx.field(static=True, default="straight")
    """How the rail goes on beyond its ends, see `SampledTrack`."""
    ramp: Float[Array, ""] = field("m", not_negative, default=DEFAULT_RAMP)
    """Length of the ramps at the ends of a rail that goes on straight [m]."""

    @classmethod
    def german(cls, disturbance: str = "low", **options: object) -> "RandomTrack":
        """Return a rail of the German railways' spectra, of "low" or "high" disturbance; wavelengths of 3 to 25 m."""
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
        """Return a rail of a sled track's published spectrum, the same in both directions; wavelengths of 0.4 to
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
        """Return a rail of a table in both directions, its band that of the table.

        **Arguments:** `wavenumber` [cycles/m]; `density`: one-sided [m^2 per cycle/m].
        """
        spectrum = TableSpectrum(wavenumber, density)
        # the highest wavenumber is that of the shortest wave
        band = tuple(1 / float(k) for k in (spectrum.wavenumber[-1], spectrum.wavenumber[0]))
        return cls(**{"band": band, "vertical": spectrum, "lateral": spectrum, **options})

    def __check_init__(self):
        for name in ("lateral", "vertical", "roll"):
            spectrum = getattr(self, name)
            if spectrum is not None:
                instance(name, spectrum, AbstractSpectrum, "a spectrum such as PowerLawSpectrum(...)")
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
        if self.band[0] >= 1.5:
            warn(f"Argument `band` has no waves below {self.band[0]:g} m, of which slippers feel most.")

    @property
    def bounds(self):
        return 0.0, self.length

    @with_standard_promotion
    def prepared(self):
        """Return this seed's rail as a spline, by one Fourier transform for each direction."""
        # eight samples in the shortest wave: the spline changes that wave by a thousandth
        count = 2 * int(np.ceil(8 * self.length / self.band[0] / 2))
        wavenumbers = np.arange(count // 2 + 1) / self.length
        inside = (wavenumbers >= 1 / self.band[1]) & (wavenumbers <= 1 / self.band[0])
        first, last = np.flatnonzero(inside)[[0, -1]]
        k = jnp.asarray(wavenumbers[first : last + 1])
        spacing = self.length / count
        # a spline with coefficients that are a wave is that wave, times this
        share = (2 + jnp.cos(2 * jnp.pi * spacing * k)) / 3

        def coefficients(spectrum: AbstractSpectrum | None, deviates: Array) -> Array:
            """Return the coefficients of one direction, with one at each end that belongs to the neighbours."""
            if spectrum is None:
                return jnp.zeros(count + 3)
            # amplitudes of the variance in each wavenumber's share of the band
            waves = jnp.sqrt(spectrum.density(k) / self.length) / share * (deviates[0] - 1j * deviates[1])
            every = jnp.zeros(count // 2 + 1, complex).at[first : last + 1].set(waves)
            around = jnp.fft.irfft(every, n=count) * count / 2
            return jnp.concatenate([around[-1:], around, around[:2]])

        seed, known = chosen(self)
        # a key for each direction, so that none depends on which others there are
        vertical, lateral, roll = (normal(key, (2, k.size)) for key in keys_of(seed, 4)[:3])
        # the lateral deviates share a part with the vertical ones
        if self.coherence is not None:
            lateral = self.coherence * vertical + jnp.sqrt(1 - self.coherence**2) * lateral
        rows = [coefficients(self.lateral, lateral), coefficients(self.vertical, vertical)]
        if self.roll is not None:
            rows.append(coefficients(self.roll, roll))
        # a number that chooses no rail gives NaN
        rail = jnp.where(known, self.roughness, jnp.nan) * jnp.stack(rows, axis=1)
        # distances to the nearer end of the rail, also of the coefficients beyond it
        if self.ends == "straight":
            away = spacing * jnp.asarray(np.minimum(np.arange(-1, count + 2), np.arange(count + 1, -2, -1)))
            rail = ramps(away, self.ramp)[:, None] * rail
        intervals = jnp.asarray(float(count))
        return SplineTrack(jnp.zeros(()), jnp.asarray(spacing), intervals, rail, self.wavelength, self.ends)

    def rms(self, power: int = 0) -> Irregularity:
        """Return the root mean squares of the displacements [m] and the roll [rad] that the spectra have, or of
        their derivatives of the order `power`."""
        of = lambda spectrum: jnp.zeros(()) if spectrum is None else self.roughness * spectrum.rms(self.band, power)
        return Irregularity(of(self.lateral), of(self.vertical), None if self.roll is None else of(self.roll))

    @property
    def steepest_slope(self):
        """Four times the greater root mean square slope [1], the same for all seeds: of normal deviates one in 30,000
        is greater."""
        slope = self.rms(1)
        return 4.0 * jnp.maximum(slope.lateral, slope.vertical)

    @property
    @at_once
    def shortest_wavelength(self):
        """The wavelength of a sine with the same root mean squares of slope and curvature, see `SampledTrack` [m]."""
        size = lambda of: jnp.sqrt(of.lateral**2 + of.vertical**2)
        return mean_wave(size(self.rms(1)), size(self.rms(2)), self.wavelength)
