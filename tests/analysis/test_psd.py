"""Spectra and lines of known signals."""

import numpy as np
import pytest

from slipperjax.analysis.spectra import Spectrum, find_line, power_spectral_density

F1, F2, RATE, COUNT = 150.0, 125.0, 8000.0, 16384
LOOKED_FOR = {
    "f1": (1, 0), "f2": (0, 1), "2f1": (2, 0), "3f2": (0, 3), "4f2": (0, 4), "2f2-f1": (-1, 2), "2f1-f2": (2, -1),
    "f1+f2": (1, 1), "3f1-f2": (3, -1), "4f2-f1": (-1, 4), "f1+2f2": (1, 2), "2f1+f2": (2, 1), "4f1-f2": (4, -1),
}  # fmt: skip
AMPLITUDES = {"f1": 1.0, "f2": 0.8, "2f1": 0.1, "f1+f2": 0.2, "2f2-f1": 0.05, "2f1-f2": 0.02, "4f1-f2": 1e-3}


def two_frequencies(noise=0.0):
    t = np.arange(COUNT) / RATE
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(AMPLITUDES))
    pairs = ((LOOKED_FOR[name], a, phase) for (name, a), phase in zip(AMPLITUDES.items(), phases, strict=True))
    signal = sum(a * np.cos(2 * np.pi * (m * F1 + n * F2) * t + phase) for (m, n), a, phase in pairs)
    return signal + noise * np.random.default_rng(4).standard_normal(COUNT)


@pytest.mark.parametrize("count", [1000, 1001])
def test_parseval(count):
    x = np.random.default_rng(0).standard_normal((2, count)) + 3.0
    spectrum = power_spectral_density(x, 250.0)
    assert spectrum.density.shape == (2, count // 2 + 1)
    total = spectrum.density.sum(-1) * 250.0 / count
    w = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count) / count)
    y = x - x.mean(-1, keepdims=True)
    # found: 4e-16
    np.testing.assert_allclose(total, ((w * y) ** 2).sum(-1) / (w**2).sum(), rtol=1e-10)


@pytest.mark.parametrize(("noise", "accuracy"), [(0.0, 1e-3), (1e-3, 2e-2)])
def test_lines_of_two_frequencies(noise, accuracy):
    spectrum = power_spectral_density(two_frequencies(noise), RATE)
    for name, (m, n) in LOOKED_FOR.items():
        place = m * F1 + n * F2
        line = find_line(spectrum, place)
        assert line.present == (name in AMPLITUDES), name
        if not line.present:
            assert line.power < 1e-8  # found: 1.8e-9, from the noise
            continue
        assert line.prominence >= 15
        assert abs(line.frequency - place) < 0.02 * RATE / COUNT  # found: 0.0139 bins
        # found: 3.8e-4 without noise, 4.0e-3 with noise as strong as the weakest line
        assert line.power == pytest.approx(AMPLITUDES[name] ** 2 / 2, rel=accuracy)
    # on the skirt of the strongest line the density is high, but there is no line
    skirt = find_line(spectrum, F1 + 5 * RATE / COUNT)
    assert not skirt.present
    # with a wide tolerance the search finds f1 nearby
    assert find_line(spectrum, F1 + 4.0, tolerance=5.0).frequency == pytest.approx(F1, abs=0.01)


def test_noise_and_silence_have_no_lines():
    frequency = np.fft.rfftfreq(COUNT, 1 / RATE)
    x = np.random.default_rng(1).standard_normal((4, COUNT))
    for density in power_spectral_density(x, RATE).density:
        # within the tolerance lies the whole spectrum
        assert not find_line(Spectrum(frequency, density), RATE / 4, tolerance=RATE).present
    line = find_line(power_spectral_density(np.zeros(100), RATE), F1)
    assert (line.power, line.prominence, line.present) == (0.0, 0.0, False)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: power_spectral_density(np.zeros(4), 1.0), "`signal` must be 8 or more samples"),
        (lambda s: power_spectral_density(np.full(9, np.nan), 1.0), "`signal` must be finite, but is"),
        (lambda s: find_line(Spectrum(s.frequency, s.density[None]), 3.0), "`spectrum` must be of one signal"),
        (lambda s: find_line(s, 5e3), "`frequency` must be at most 4000 Hz, but is 5000 Hz"),
    ],
)
def test_bad_input(call, message):
    spectrum = power_spectral_density(np.sin(np.arange(64.0)), RATE)
    with pytest.raises(ValueError, match=message):
        call(spectrum)
