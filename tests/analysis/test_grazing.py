"""Curves of grazings, and the folds and flips that leave them, of an oscillator whose motions are known exactly."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import slipperjax as sj
from slipperjax import analysis

from ..plots.shown import legend

pytestmark = pytest.mark.full
RESONANCE = 2 * np.sqrt(1 - 0.1**2)
"""Frequency at which half the damped motion's period fits the forcing: the point of codimension two for n = 1."""


def oscillator(frequency, gap, force, steps=1600):
    field = lambda t, s: jnp.stack([s[1], force * jnp.cos(frequency * t) - 0.2 * s[1] - s[0]])
    surface = lambda t, s: gap - s[0]
    rebound = lambda t, s: jnp.stack([s[0], -0.8 * s[1]])
    return analysis.impact_step(field, surface, rebound, dt=2 * jnp.pi / frequency / steps, steps=steps)


def amplitude(frequency):
    """Return the force for a steady motion without impacts of amplitude 1."""
    return jnp.sqrt((1 - frequency**2) ** 2 + (0.2 * frequency) ** 2)


def scaled(frequency, a):
    return oscillator(frequency, 1.0, a * amplitude(frequency))


@pytest.fixture(scope="module")
def grazings():
    motions = analysis.PeriodicMotions(scaled, jnp.zeros(2), jnp.ones(2))
    return analysis.continue_grazing(motions, jnp.array([0.1, 0.3]), (1.8, 1.0), ((0.6, 2.3), (0.5, 2.0)))


def of(curve, name):
    return curve.parameters[:, curve.names.index(name)]


def points(grazings, label):
    return [event for event in grazings.events if event.label == label]


def test_points_of_codimension_two(grazings):
    # measured 1.5e-11, with the error of RK4
    np.testing.assert_allclose(of(grazings, "a"), 1.0, rtol=1e-10)
    for label in ("GRLP", "GRPD"):
        found = [point.values[0] for point in points(grazings, label)]
        # measured 9.4e-12
        np.testing.assert_allclose(found, RESONANCE / np.array([3, 2, 1]), rtol=1e-10)


def exact_folds(frequency):
    """Return a of the folds, in closed form."""
    z, r, wd = 0.1, 0.8, RESONANCE / 2
    period = 2 * np.pi / frequency
    decay, c, s = np.exp(-z * period), np.cos(wd * period), np.sin(wd * period)
    k = (1 / decay - c) / s
    p = wd * k - z
    q = decay * (p * c - (z * k + wd) * s)
    g = (p + r * q) / ((1 + r) * frequency)
    return np.abs(g) / np.sqrt(1 + g**2)


@pytest.mark.parametrize(("frequency", "a"), [(1.95, 0.975736608287625656), (1.9, 0.898332987982049545)])
def test_folds(grazings, frequency, a):
    (point,) = points(grazings, "GRLP")[2:]
    folds = analysis.leave_grazing(grazings, point, ((frequency, 2.3), (0.5, 2.0)))
    assert folds.ended == ("", "bound")
    # measured 1.3e-12
    np.testing.assert_allclose(of(folds, "a")[-1], a, rtol=1e-10)
    # measured 1.7e-12 and 9.7e-10
    np.testing.assert_allclose(of(folds, "a"), exact_folds(of(folds, "frequency")), rtol=1e-10)
    np.testing.assert_allclose([node.multipliers[0] for node in folds.nodes[1:]], 1.0, rtol=1e-8)


FLIPS = {0.3: 1.263783813251998, 0.2: 1.103442492009275, 0.1: 1.024188165117093, 0.05: 1.005953904420572}


@pytest.mark.parametrize("away", FLIPS)
def test_flips(grazings, away):
    (point,) = points(grazings, "GRPD")[2:]
    flips = analysis.leave_grazing(grazings, point, ((0.6, RESONANCE + away), (0.5, 2.0)))
    assert flips.ended == ("", "bound")
    # measured 1.7e-12
    np.testing.assert_allclose(of(flips, "a")[-1], FLIPS[away], rtol=1e-10)


def test_flip_beside_scipy(grazings):
    (point,) = points(grazings, "GRPD")[2:]
    frequency = RESONANCE + 0.1
    node = analysis.leave_grazing(grazings, point, ((0.6, frequency), (0.5, 2.0))).nodes[-1]
    a, begin, rate = node.z[3:6]
    force = a * float(amplitude(frequency))

    def touch(t, y):
        return 1 - y[0]

    touch.terminal, touch.direction = True, -1

    # from just before an impact to just before the next
    def next_impact(t, rate):
        field = lambda t, y: [y[1], force * np.cos(frequency * t) - 0.2 * y[1] - y[0]]
        options = dict(method="DOP853", rtol=1e-13, atol=1e-14, events=touch, first_step=1e-3)
        run = scipy.integrate.solve_ivp(field, (t, t + 10), [1.0, -0.8 * rate], **options)
        return np.array([run.t_events[0][0], run.y_events[0][0][1]])

    # measured 2e-11
    np.testing.assert_allclose(
        next_impact(begin, rate) - [begin, rate], [2 * np.pi / frequency, 0], rtol=0, atol=1e-10
    )
    h = 1e-5
    slopes = [
        next_impact(begin + h * x, rate + h * y) - next_impact(begin - h * x, rate - h * y) for x, y in np.eye(2)
    ]
    # measured 2e-8, by central differences
    assert np.linalg.eigvals(np.transpose(slopes) / (2 * h)).min() == pytest.approx(-1, abs=1e-6)


def test_quadratic_coefficients(grazings):
    fold, flip = (points(grazings, label)[2] for label in ("GRLP", "GRPD"))
    # measured 7e-13
    np.testing.assert_allclose(fold.coefficients["quadratic"], -16.5490366783, rtol=1e-8)
    # the value has five digits
    np.testing.assert_allclose(flip.coefficients["quadratic"], 2.3705, rtol=1e-5)
    # folds exist below the resonance, flips above it
    assert fold.coefficients["rate"] < 0 < flip.coefficients["rate"]


def test_both_curves_say_write_and_draw_themselves(grazings, tmp_path):
    (point,) = points(grazings, "GRLP")[2:]
    folds = analysis.leave_grazing(grazings, point, ((1.9, 2.3), (0.5, 2.0)))
    found = [sj.orbits.branch_result(curve) for curve in (grazings, folds)]
    head, *lines = found[0].summary()
    assert head.startswith("GR of period 1 over frequency and a: ")
    assert sorted(line.split()[0] for line in lines) == ["GRLP"] * 3 + ["GRPD"] * 3
    assert any("GRLP at (1.98997, 1): quadratic = -16.549, rate = " in line for line in lines)
    # the motion beside the stop is stable, and so is the other multiplier of the fold
    assert not any(one["outside"].values.any() for one in found)
    assert np.isnan(found[1]["multiplier_real"].values[0]).all()
    ax = sj.plots.plane(found)
    assert legend(ax) == ["GR grazing", "LP fold"]
    assert [text.get_text() for text in ax.texts] == ["GRLP, GRPD"] * 3
    found[0].write(tmp_path / "grazings.nc")
    assert sj.load(tmp_path / "grazings.nc").summary() == found[0].summary()


def test_flips_over_frequency_and_gap():
    family = lambda frequency, gap: oscillator(frequency, gap, 1.0)
    motions = analysis.PeriodicMotions(family, jnp.zeros(2), jnp.ones(2))
    bounds = (1.9, 2.5), (0.15, 0.4)
    # at gaps near the amplitude of the motion without impacts
    curve = analysis.continue_grazing(motions, jnp.array([0.1, 0.3]), (2.1, 0.3), bounds)
    (point,) = points(curve, "GRPD")
    flips = analysis.leave_grazing(curve, point, bounds)
    assert of(flips, "gap")[-1] == 0.15
    # measured 2.5e-13; the flip of `continue_motion` in docs/how_to/own_system.md
    np.testing.assert_allclose(of(flips, "frequency")[-1], 2.358343181556296050, rtol=1e-10)


def test_second_touch_ends_the_curve():
    # Two cosines whose maxima are equal at a = 0: beyond that the other maximum is above the stop.
    def family(a, gap):
        field = lambda t, s: jnp.stack([s[1], jnp.cos(2 * t) + a * jnp.cos(t) - s[1] - 3 * s[0]])
        rebound = lambda t, s: jnp.stack([s[0], -0.8 * s[1]])
        return analysis.impact_step(field, lambda t, s: gap - s[0], rebound, dt=2 * jnp.pi / 200, steps=200)

    motions = analysis.PeriodicMotions(family, jnp.zeros(2), jnp.ones(2))
    curve = analysis.continue_grazing(motions, jnp.array([0.1, 0.3]), (0.5, 0.6), ((-0.6, 0.8), (0.0, 2.0)))
    assert set(curve.ended) == {"bound", "second touch"}
    assert of(curve, "a").min() == pytest.approx(0, abs=0.1)


def test_wrong_inputs():
    motions = analysis.PeriodicMotions(lambda a, b: lambda s, k: a * s + b, jnp.zeros(1), jnp.ones(2))
    with pytest.raises(ValueError, match=r"Argument `motions` must be a family of maps of `impact_step`"):
        analysis.continue_grazing(motions, jnp.zeros(1), (1.0, 1.0), ((0, 2), (0, 2)))


def test_only_points_are_left(grazings):
    end = grazings.events[0]
    with pytest.raises(ValueError, match="`event` must be one of GRLP, GRPD, but is 'EP'"):
        analysis.leave_grazing(grazings, end, ((0.6, 2.3), (0.5, 2.0)))
    point = next(event for event in grazings.events if event.label == "GRLP")
    other = dataclasses.replace(grazings, equations=grazings.equations.motions)
    with pytest.raises(ValueError, match=r"`curve` must be a curve of slipperjax\.analysis\.continue_grazing"):
        analysis.leave_grazing(other, point, ((0.6, 2.3), (0.5, 2.0)))
