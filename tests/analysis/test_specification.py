"""Straight-line specifications: above the spectrum, with few breakpoints, and with the exact root mean square."""

import numpy as np
import pytest

from slipperjax.analysis.specification import rms_of_lines, straight_lines

BANDS = np.geomspace(20.0, 2000.0, 41)
TRAPEZOID = np.interp(np.log(BANDS), np.log([20.0, 80.0, 350.0, 2000.0]), np.log([0.01, 0.04, 0.04, 0.007]))


def test_a_trapezoid_is_found_with_its_margin():
    f, level = straight_lines(BANDS, np.exp(TRAPEZOID), margin=3.0)
    between = np.exp(np.interp(np.log(BANDS), np.log(f), np.log(level)))
    ratio = between / (10**0.3 * np.exp(TRAPEZOID))
    assert ratio.min() >= 1 - 1e-9
    assert np.mean(10 * np.log10(ratio)) < 0.5  # [dB], the default's own aim
    assert len(f) <= 6
    assert f[[0, -1]] == pytest.approx([20.0, 2000.0])


def test_lines_are_nowhere_below_a_rough_spectrum():
    rough = np.exp(TRAPEZOID + np.random.default_rng(0).normal(0.0, 0.5, len(BANDS)))
    before = np.inf
    for count in (2, 4, 8):
        f, level = straight_lines(BANDS, rough, breakpoints=count)
        above = np.interp(np.log(BANDS), np.log(f), np.log(level)) - np.log(rough)
        assert above.min() > -1e-9
        assert len(f) <= count
        assert above.mean() <= before
        before = above.mean()


def test_root_mean_square_is_that_of_the_power_laws():
    # a common random vibration test: 3 dB per octave, flat, -3 dB per octave
    f = np.array([20.0, 80.0, 350.0, 2000.0])
    level = np.array([0.01, 0.04, 0.04, 0.04 * 350 / 2000])
    fine = np.geomspace(20.0, 2000.0, 200_001)
    density = np.exp(np.interp(np.log(fine), np.log(f), np.log(level)))
    assert rms_of_lines(f, level) == pytest.approx(np.sqrt(np.trapezoid(density, fine)), rel=1e-7)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (dict(density=BANDS[1:]), "`density` must have a value for each frequency"),
        (dict(density=0 * BANDS), "`frequency` must increase, with positive densities"),
        (dict(frequency=BANDS[::-1]), "`frequency` must increase"),
        (dict(breakpoints=1), "`breakpoints` must be"),
    ],
)
def test_wrong_arguments_are_named(given, words):
    arguments = dict(frequency=BANDS, density=BANDS) | given
    with pytest.raises(ValueError, match=words):
        straight_lines(arguments.pop("frequency"), arguments.pop("density"), **arguments)
