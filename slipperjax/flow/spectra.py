"""Lines of spectra at multiples of the forcing frequency, summed while periods are integrated."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ..model.quantities import ACCELERATIONS, COORDINATES
from ..tools.checks import brief, one_of
from .recorders import Labelled, attributes
from .reducing import AbstractReducer, PeriodView, Stretch

PARTS = {"real": "cosine", "imag": "minus sine"}
"""Parts of an amplitude A, and what they multiply in the real part of A exp(2 pi i f t)."""


@dataclass(frozen=True)
class SpectrumLines(AbstractReducer):
    """Complex amplitudes of a coordinate or an acceleration at some multiples of the forcing frequency.

    Of the signal x at the ends of all N steps of the recorded periods, at t forcing periods after their start, the
    amplitude at f is A = (2/N) sum x exp(-2 pi i f t), for f = 0 the mean: x has the part Re(A exp(2 pi i f t)). All
    steps have one weight, without a window. Where f times the number of recorded periods is whole, other such lines
    add nothing to A, and it is a line of the discrete Fourier transform; a frequency between them leaks into A, about
    as the reciprocal of its distance from f in multiples of 1/periods.
    """

    coordinate: str
    """One of `slipperjax.model.COORDINATES` or `ACCELERATIONS`."""
    frequencies: tuple[float, ...]
    """Multiples of the forcing frequency [1/period]: 1 for the forcing, 0.5 for what recurs after two periods."""

    def __post_init__(self):
        one_of("coordinate", self.coordinate, (*COORDINATES, *ACCELERATIONS))
        given = self.frequencies
        found = np.atleast_1d(np.asarray(given if np.size(given) else None, dtype=object))
        good = [isinstance(f, int | float | np.number) and not isinstance(f, bool) and 0 <= f < np.inf for f in found]
        if found.ndim != 1 or not all(good) or len(set(found.tolist())) < len(found):
            raise ValueError(
                f"Argument `frequencies` must be numbers of zero or more, each once, but is {brief(given)}."
            )
        object.__setattr__(self, "frequencies", tuple(float(f) for f in found))

    @property
    def name(self):
        return f"spectrum of {self.coordinate}"

    @property
    def variables(self):
        return tuple(f"spectrum_{self.coordinate}_{part}" for part in PARTS)

    @property
    def cost(self):
        return 0.02 * len(self.frequencies)

    def values(self, periods):
        return 2 * len(self.frequencies)

    def check(self, scene, periods, steps):
        if max(self.frequencies) >= steps / 2:
            raise ValueError(
                f"Argument `frequencies` must be below half of the {steps} steps per period, but is "
                f"{max(self.frequencies):g} [1/period]."
            )

    def begin(self, scene, state):
        return np.zeros((2, len(self.frequencies)))

    def add(self, carried, period: PeriodView):
        if self.coordinate in COORDINATES:
            signal = period.coordinates[:, list(COORDINATES).index(self.coordinate)]
        else:
            signal = period.acceleration[:, list(ACCELERATIONS).index(self.coordinate)]
        frequencies = jnp.array(self.frequencies)
        # turns before the period are told apart, so that they are rounded once and not in each step
        before = (frequencies * period.args.epoch % 1)[:, None]
        angle = 2 * jnp.pi * (frequencies[:, None] * period.times[None] + before)
        signal = period.over_steps(signal, 0.0)
        return carried + jnp.stack([jnp.cos(angle) @ signal, -jnp.sin(angle) @ signal])

    def finish(self, carried, stretch: Stretch):
        frequencies, sums = np.array(self.frequencies), np.asarray(carried)
        turned = (sums[:, 0] + 1j * sums[:, 1]) * np.exp(2j * np.pi * (frequencies * stretch.begin % 1))
        amplitude = turned * np.where(frequencies > 0, 2, 1) / stretch.samples
        return np.stack([amplitude.real, amplitude.imag], axis=1)

    def label(self, scene, dims, found) -> Labelled:
        q, axis = (COORDINATES | ACCELERATIONS)[self.coordinate], f"frequency_{self.coordinate}"
        data = {}
        for k, (part, wave) in enumerate(PARTS.items()):
            text = f"amplitude of the {q.long_name}, {part} part: of the {wave} since the start of the record"
            data[f"spectrum_{self.coordinate}_{part}"] = ((*dims, axis), found[..., k, :], attributes(q.unit, text))
        return data, {axis: (axis, np.array(self.frequencies), attributes("1/period", "multiples of the forcing"))}
