"""Points of codimension two along curves: exact places, and the curves that begin there."""

import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.arclength import Pace
from slipperjax.analysis.critical import CriticalMotions, continue_critical
from slipperjax.analysis.leaving import switch_critical
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import TABLE_BOUNDS, TABLE_START, Companion, Generalised, on_table, table_flip

WIDE = ((-20.0, 20.0), (-4.0, 4.0))


def curve(family, label, state, values, bounds=WIDE, **options):
    motions = PeriodicMotions(family, jnp.zeros(len(state)), jnp.ones(2))
    critical = CriticalMotions.of(motions, label)
    return continue_critical(critical, jnp.asarray(state), values, bounds, pace=Pace(most=0.3), **options)


def of_henon(r, s, label, y):
    """The curve of the generalised Hénon map through a fixed point y, and the map."""
    family = Generalised(jnp.asarray(r), jnp.asarray(s))
    trace = family.trace(y)
    determinant = {"LP": trace - 1, "PD": -trace - 1, "NS": 1.0}[label]
    angle = np.arccos(trace / 2) if label == "NS" else 0.0
    return curve(family, label, [y, y], family.at(y, determinant), angle=angle), family


def points(found):
    return {event.label: event for event in found.events}


PLACES = [
    ("NS", 0.1, 0.0, 0.8, {"R1": (-20 / 19, 1), "R2": (20 / 19, 1), "R3": (10 / 19, 1), "R4": (0, 1)}),
    ("PD", 0.1, 0.0, 0.1, {"R2": (20 / 19, 1), "LPPD": (0, -1)}),
    ("LP", 0.1, 0.0, 0.1, {"R1": (-20 / 19, 1), "LPPD": (0, -1)}),
    ("LP", 0.1, 0.2, 1.0, {"CP": (1.5, -2.5)}),
    ("NS", 0.1, 0.2, 1.4, {"CH": (1.5, 1)}),
    ("PD", -0.1, 0.1, 1.0, {"R2": (1.1370921868749, 1)}),
]


@pytest.mark.full
@pytest.mark.parametrize(("label", "r", "s", "y", "places"), PLACES)
def test_points_of_the_generalised_henon_map(label, r, s, y, places):
    found, family = of_henon(r, s, label, y)
    for name, (at, determinant) in places.items():
        event = points(found)[name]
        exact = family.at(at, determinant)
        # measured: 1e-12 for R1 and R2 at ends of curves, 3e-14 elsewhere
        np.testing.assert_allclose(event.values, exact, rtol=0, atol=1e-10)
        np.testing.assert_allclose(event.state, at, rtol=0, atol=1e-10)
        assert event.converged
        assert event.coefficients
    assert found.parameters.shape == (len(found.nodes), 2)
    if label == "LP" and s:
        # through the cusp, where both parameters turn back, to the bounds
        assert found.ended == ("bound", "bound")
        assert points(found)["CP"].coefficients["c"] == pytest.approx(1 / 35, abs=1e-10)  # measured: 7e-17


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "label", "multipliers"),
    [
        ("PDNS", "PD", [-1, 0.29]),
        ("PDNS", "NS", [-1, 0.29]),
        ("LPNS", "LP", [1, 0.29]),
        ("LPNS", "NS", [1, 0.29]),
        ("NSNS", "NS", [0.11, 0.29]),
    ],
)
def test_points_of_companion_maps(name, label, multipliers):
    """Multipliers and angles [turns] of complex pairs are prescribed."""
    spectrum = []
    for mu in multipliers:
        pair = np.exp(2j * np.pi * np.array([mu, -mu]))
        spectrum += [mu] if abs(mu) == 1 else list(pair)
    y = 0.3
    family, exact = Companion.of(spectrum, y)
    state = [y] * len(spectrum)
    angle = 2 * np.pi * multipliers[-1] if label == "NS" else 0.0
    away = (exact[0], exact[1] + 0.02)
    bounds = [(value - 0.5, value + 0.5) for value in exact]
    found = curve(family, label, state, away, bounds, angle=angle)
    near = [e for e in found.events if e.label == name and np.allclose(e.values, exact, rtol=0, atol=1e-10)]
    # measured: 2e-14
    assert len(near) == 1, found
    assert near[0].coefficients


@pytest.mark.full
def test_curves_of_twice_the_period_leave_a_generalised_flip():
    """x' = a + b x - x^2 - x^3/4 has the fixed point -2/3 with the fifth-order flip -x - x^5/8."""
    family = lambda a, b: lambda x, k: a + b * x - x**2 - x**3 / 4
    found = curve(family, "PD", [-0.5], (-1.5, -1.9), ((-3.0, 5.0), (-5.0, 5.0)))
    event = points(found)["GPD"]
    np.testing.assert_allclose(event.values, [-44 / 27, -2], rtol=0, atol=1e-10)  # measured: 3e-16
    assert event.coefficients["e"] == pytest.approx(-1 / 8, abs=1e-10)  # measured: 4e-16
    equations, first = switch_critical(found, event, "LP2")
    folds = continue_critical(equations, first, None, ((-5.0, 5.0), (-5.0, 5.0)), ways=(1,), points=12)
    assert equations.motions.intervals == 2
    for node in folds.nodes:
        x, a, b = node.z
        other = a + b * x - x**2 - x**3 / 4
        slope = (b - 2 * x - 0.75 * x**2) * (b - 2 * other - 0.75 * other**2)
        assert abs(slope - 1) < 1e-8  # measured: 3e-11
        assert abs(other - x) > 0.05


@pytest.mark.full
def test_curves_leave_strong_resonances():
    flips, _ = of_henon(0.1, 0.0, "PD", 0.1)
    event = points(flips)["R2"]
    found = continue_critical(*switch_critical(flips, event, "NS"), None, WIDE, ways=(1,))
    assert found.ended == ("", "strong resonance 1:1")
    doubled = continue_critical(*switch_critical(flips, event, "NS2"), None, WIDE, ways=(1,), points=10)
    for node in doubled.nodes:
        u, v, _, b, _ = node.z
        # of u, v, u, ... the sum is 1 + b, and the determinants have the product one
        assert abs(u + v - 1 - b) < 1e-9  # measured: 1e-12
        assert abs((b - 0.1 * u) * (b - 0.1 * v) - 1) < 1e-9  # measured: 1e-12
    folds, _ = of_henon(0.1, 0.0, "LP", 0.1)
    event = points(folds)["R1"]
    found = continue_critical(*switch_critical(folds, event, "NS"), None, WIDE, ways=(1,))
    assert found.ended == ("", "strong resonance 1:2")
    with pytest.raises(ValueError, match="`label` must be one of NS, but is 'LP2'"):
        switch_critical(folds, event, "LP2")
    with pytest.raises(ValueError, match="`event` must be one of GPD, R1, R2, but is 'LPPD'"):
        switch_critical(folds, points(folds)["LPPD"], "NS")


@pytest.mark.full
def test_flips_of_a_ball_on_a_table():
    """Flips of period 1 over the table's acceleration and the restitution."""
    found = curve(on_table, "PD", TABLE_START, (1.53, 0.5), TABLE_BOUNDS)
    amplitude, restitution = found.parameters.T
    np.testing.assert_allclose(amplitude, table_flip(restitution), rtol=0, atol=1e-10)  # measured: 1.3e-11
    assert table_flip(0.5) == pytest.approx(1.5268237005191, abs=1e-12)
    np.testing.assert_allclose(sorted(restitution[[0, -1]]), [0.3, 0.8], rtol=0, atol=1e-12)
