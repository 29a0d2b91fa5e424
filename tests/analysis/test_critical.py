"""Folds, flips and Neimark-Sackers by extended equations: closed forms, derivatives, curves in two parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.arclength import Pace
from slipperjax.analysis.critical import ConditionedMotions, CriticalMotions, continue_critical, critical_motion
from slipperjax.analysis.floquet import multipliers
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import HENON_AT, Fixed, Polynomial, column, delayed, henon, motions

START = {"LP": -0.3, "PD": 0.3}
CRITICAL = {"LP": 1.0, "PD": -1.0}


def henon_motion(b, label):
    return critical_motion(motions(Fixed(henon, b), 2), label, jnp.full(2, START[label]), HENON_AT[label](0.3) + 0.03)


def with_derivative(found_at, numbers, at, mode=jax.jacrev):
    """The numbers of a critical motion and their derivative, and the motion itself."""

    def both(value):
        found = found_at(value)
        return numbers(found), (numbers(found), found)

    slope, (value, found) = mode(both, has_aux=True)(at)
    return value, slope, found


def point(found):
    return jnp.append(found.state, found.value)


@pytest.mark.full
@pytest.mark.parametrize("label", ["LP", "PD"])
def test_fold_and_flip_of_henons_map_and_their_derivatives(label):
    value, slope, found = with_derivative(lambda b: henon_motion(b, label), point, jnp.asarray(0.3))
    assert float(found.residual) < 1e-10
    assert int(found.iterations) <= 6
    # x = y = (b - 1) / 2 at the fold, and (1 - b) / 2 at the flip
    of_state = {"LP": 0.5, "PD": -0.5}[label]
    exact = [of_state * -0.7, of_state * -0.7, HENON_AT[label](0.3)]
    np.testing.assert_allclose(value, exact, rtol=0, atol=1e-10)  # measured: 4e-14
    np.testing.assert_allclose(slope, [of_state, of_state, jax.grad(HENON_AT[label])(0.3)], rtol=0, atol=1e-9)
    # measured: 2e-14
    mu = CRITICAL[label]
    assert float(found.multiplier) == mu
    spectrum = np.sort(multipliers(np.asarray(found.matrices)).real)
    np.testing.assert_allclose(spectrum, np.sort([mu, -0.3 / mu]), rtol=0, atol=1e-10)  # the determinant is -b


def test_derivatives_in_forward_mode_under_jit_and_vmap():
    at = np.array([0.2, 0.3, 0.35])
    several = jax.jit(jax.vmap(jax.jacfwd(lambda b: henon_motion(b, "PD").value)))(at)
    np.testing.assert_allclose(several, -1.5 * (1 - at), rtol=0, atol=1e-9)  # measured: 2e-12


def test_the_second_derivative_of_a_flip():
    second = jax.jit(jax.jacfwd(jax.jacfwd(lambda b: henon_motion(b, "PD").value)))(0.3)
    np.testing.assert_allclose(second, 1.5, rtol=0, atol=1e-9)  # measured: 1e-14


@pytest.mark.full
@pytest.mark.parametrize(("c", "mode"), [(0.0, jax.jacrev), (0.2, jax.jacfwd)])
def test_a_neimark_sacker_and_its_derivatives(c, mode):
    """With x = (1 - 1/r) / (1 + c) the determinant r x is 1 at r = 2 + c, and the trace 1 - r c x is 2 cos(angle)."""
    at = lambda c: critical_motion(motions(Fixed(delayed, c), 2), "NS", jnp.array([0.45, 0.45]), 2.1, angle=1.0)
    numbers = lambda found: jnp.stack([found.value, jnp.angle(found.multiplier)])
    value, slope, found = with_derivative(at, numbers, jnp.asarray(c), mode)
    assert float(found.residual) < 1e-10
    np.testing.assert_allclose(value, [2 + c, np.arccos((1 - c) / 2)], rtol=0, atol=1e-10)  # measured: 2e-15
    np.testing.assert_allclose(slope, [1.0, 0.5 / np.sqrt(1 - (1 - c) ** 2 / 4)], rtol=0, atol=1e-9)
    # measured: 2e-15
    assert abs(abs(complex(found.multiplier)) - 1) < 1e-10  # measured: 2e-16
    np.testing.assert_allclose(found.state, 1 / (2 + c), rtol=0, atol=1e-10)  # measured: 3e-16


def test_where_there_is_none_the_residual_says_so():
    straight = motions(Polynomial.of({(1, 0): 0.5, (0, 1): 1.0}), 1)  # its multiplier is 1/2
    found = critical_motion(straight, "PD", jnp.array([0.1]), 0.2)
    assert not float(found.residual) < 1e-6
    with pytest.raises(ValueError, match="`label` must be one of LP, PD, NS, but is 'BP'"):
        critical_motion(straight, "BP", jnp.array([0.1]), 0.2)


def plane(family):
    """Motions of two numbers over two parameters."""
    return PeriodicMotions(family, jnp.zeros(2), jnp.ones(2))


def curve(label, state, values, bounds, family=henon, **options):
    return continue_critical(CriticalMotions.of(plane(family), label), jnp.full(2, state), values, bounds, **options)


@pytest.mark.full
@pytest.mark.parametrize("label", ["LP", "PD"])
def test_curves_of_henons_map(label):
    found = curve(label, START[label], (HENON_AT[label](0.3) + 0.02, 0.3), ((-1.0, 2.0), (-0.9, 0.9)))
    a, b = (column(found.nodes, k) for k in (2, 3))
    np.testing.assert_allclose(a, HENON_AT[label](b), rtol=0, atol=1e-9)  # measured: 4e-11
    assert found.ended == ("bound", "bound")
    # the fold's curve crosses all b, the flip's leaves at a = 2
    low = {"LP": -0.9, "PD": 1 - np.sqrt(8 / 3)}[label]
    np.testing.assert_allclose(sorted(b[[0, -1]]), [low, 0.9], rtol=0, atol=1e-9)  # measured: 0
    for node in found.nodes[::5]:
        assert np.abs(node.multipliers - CRITICAL[label]).min() < 1e-8  # measured: 2e-14


def test_a_curve_of_neimark_sackers():
    found = curve("NS", 0.45, (2.1, 0.1), ((1.5, 3.5), (-0.5, 0.9)), delayed, angle=1.0)
    r, c, angle = (column(found.nodes, k) for k in (2, 3, 4))
    np.testing.assert_allclose(r, 2 + c, rtol=0, atol=1e-9)  # measured: 5e-12
    np.testing.assert_allclose(np.cos(angle), (1 - c) / 2, rtol=0, atol=1e-9)  # measured: 2e-12
    assert found.ended == ("bound", "bound")
    np.testing.assert_allclose(sorted(c[[0, -1]]), [-0.5, 0.9], rtol=0, atol=1e-9)
    # the last unknown is the angle, which is no parameter
    np.testing.assert_array_equal(found.values, c)
    assert found.names == ("r", "c")
    np.testing.assert_array_equal(found.parameters, np.column_stack([r, c]))
    assert sorted(event.value for event in found.events) == pytest.approx([-0.5, 0.9])
    assert repr(found).startswith(f"Branch({len(c)} points over r and c; EP at r = ")


@pytest.mark.full
def test_a_curve_of_neimark_sackers_does_not_go_on_as_one_of_folds_or_flips():
    """In a generalised Hénon map b is the product of both multipliers."""
    family = lambda a, b: lambda s, k: jnp.stack([s[1], a - b * s[0] - s[1] ** 2])
    x = np.sqrt(2) - 1
    found = curve("NS", x, (1.0, 1.0), ((-2.0, 5.0), (0.0, 2.0)), family, angle=np.arccos(-x))
    assert found.ended == ("strong resonance 1:1", "strong resonance 1:2")
    a, b, angle = (column(found.nodes, k) for k in (2, 3, 4))
    np.testing.assert_allclose(b, 1.0, rtol=0, atol=1e-8)  # measured: 4e-10
    np.testing.assert_allclose(a, np.cos(angle) ** 2 - 2 * np.cos(angle), rtol=0, atol=1e-8)  # measured: 5e-10
    np.testing.assert_allclose(a[[0, -1]], [-1.0, 3.0], rtol=0, atol=1e-5)  # measured: 2e-6


def test_a_curve_of_motions_with_a_condition():
    """Fixed points of Hénon's map x = y = 0.4 lie on a line: a = 0.4^2 + 0.4 (1 - b)."""
    equations = ConditionedMotions(plane(henon), lambda state, a, b: state[0] - 0.4, 1.0)
    found = continue_critical(equations, jnp.array([0.5, 0.5]), (0.5, 0.1), ((-1.0, 1.0), (-0.8, 0.8)))
    x, a, b = (column(found.nodes, k) for k in (0, 2, 3))
    np.testing.assert_allclose(a, 0.16 + 0.4 * (1 - b), rtol=0, atol=1e-9)  # measured: 3e-16
    np.testing.assert_allclose(x, 0.4, rtol=0, atol=1e-9)
    assert found.ended == ("bound", "bound")
    np.testing.assert_allclose(sorted(b[[0, -1]]), [-0.8, 0.8], rtol=0, atol=1e-12)


@pytest.mark.parametrize("low", [-0.1, -0.09])
def test_a_corner_of_the_bounds_is_not_passed(low):
    """A step passes a = -0.3, where b = 1 - 1.2^(1/2) = -0.0954, and the bound of b, before or behind."""
    found = curve("LP", -0.5, (-0.2, 0.1), ((-0.3, 1.0), (low, 1.0)), pace=Pace(first=0.3, most=0.5))
    assert abs(column(found.nodes, 3).min() - max(low, 1 - np.sqrt(1.2))) < 1e-9  # measured: 8e-12
    assert column(found.nodes, 2).min() >= -0.3 - 1e-12


WIDE, WITHIN = (-1.0, 1.0), "`values` must lie within the bounds"


@pytest.mark.parametrize(
    ("state", "bounds", "words"),
    [
        ([-0.3, -0.3], ((1.0, -1.0), WIDE), r"`bounds` must be two numbers, .* is \(1.0, -1.0\)"),
        ([-0.3, -0.3], (WIDE, (0.5, 1.0)), f"{WITHIN} 0.5 and 1, but is 0.3"),
        ([-0.3, -0.3], ((0.0, 1.0), WIDE), f"{WITHIN} 0 and 1, but is -0.12"),
        ([-0.3, np.nan], (WIDE, WIDE), "`state` must be near a motion of the curve"),
        ([-0.3], (WIDE, WIDE), "`state` must have 2 numbers as `like` has, but has 1"),
    ],
)
def test_wrong_arguments_are_named(state, bounds, words):
    equations = CriticalMotions.of(plane(henon), "LP")
    with pytest.raises(ValueError, match=words):
        continue_critical(equations, jnp.asarray(state), (-0.1, 0.3), bounds)
