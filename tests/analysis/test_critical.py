"""Folds, flips and Neimark-Sackers by extended equations: closed forms, derivatives, curves in two parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.continuation import continue_motion
from slipperjax.analysis.critical import ConditionedMotions, CriticalMotions, continue_critical, critical_motion
from slipperjax.analysis.curves import Pace
from slipperjax.analysis.floquet import multipliers
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import rk4


def henon_at(a, b):
    return lambda s, k: jnp.stack([a - s[0] ** 2 + b * s[1], s[0]])


class Henon(eqx.Module):
    """Over a; b is a number of the system."""

    b: jax.Array

    def __call__(self, a):
        return henon_at(a, self.b)


def delayed(r, c):
    """x' = r x (1 - c x - y), y' = x: at c = 0 the delayed logistic map."""
    return lambda s, k: jnp.stack([r * s[0] * (1 - c * s[0] - s[1]), s[0]])


def motions(family, size=2, reach=1.0, **options):
    return PeriodicMotions(family, jnp.zeros(size), jnp.asarray(reach), **options)


HENON = {"LP": lambda b: -((1 - b) ** 2) / 4, "PD": lambda b: 3 * (1 - b) ** 2 / 4}
"""The values of a."""
STATES = {"LP": -0.3, "PD": 0.3}


def henon_value(b, label):
    start = jnp.full(2, STATES[label])
    return critical_motion(motions(Henon(b)), label, start, HENON[label](0.3) + 0.03)


@pytest.mark.parametrize("label", ["LP", "PD"])
def test_fold_and_flip_of_henons_map(label):
    found = henon_value(jnp.asarray(0.3), label)
    assert float(found.residual) < 1e-10
    assert int(found.iterations) <= 6
    assert abs(float(found.value) - HENON[label](0.3)) < 1e-10  # measured: 4e-14
    x = {"LP": -0.35, "PD": 0.35}[label]
    np.testing.assert_allclose(found.state, [x, x], rtol=0, atol=1e-10)  # measured: 1e-14
    mu = {"LP": 1.0, "PD": -1.0}[label]
    assert float(found.multiplier) == mu
    exact = np.array([mu, -0.3 / mu])  # the determinant is -b
    spectrum = np.sort(multipliers(np.asarray(found.matrices)).real)
    np.testing.assert_allclose(spectrum, np.sort(exact), rtol=0, atol=1e-10)  # measured: 2e-14


@pytest.mark.parametrize("label", ["LP", "PD"])
@pytest.mark.parametrize("differentiate", [jax.jacrev, jax.jacfwd])
def test_derivatives_are_those_of_the_closed_form(label, differentiate):
    def both(b):
        found = henon_value(b, label)
        return jnp.append(found.state, found.value)

    # x = y = (b - 1) / 2 at the fold, and (1 - b) / 2 at the flip
    of_state = {"LP": 0.5, "PD": -0.5}[label]
    exact = [of_state, of_state, jax.grad(HENON[label])(0.3)]
    np.testing.assert_allclose(differentiate(both)(0.3), exact, rtol=0, atol=1e-9)  # measured: 2e-14


def test_derivatives_under_jit_and_vmap():
    several = jax.jit(jax.vmap(jax.grad(lambda b: henon_value(b, "PD").value)))(jnp.array([0.2, 0.3, 0.35]))
    np.testing.assert_allclose(several, -1.5 * (1 - np.array([0.2, 0.3, 0.35])), rtol=0, atol=1e-9)  # measured: 2e-12


class Delayed(eqx.Module):
    c: jax.Array

    def __call__(self, r):
        return delayed(r, self.c)


def delayed_value(c, angle=1.0):
    """With x = (1 - 1/r) / (1 + c) the determinant r x is 1 at r = 2 + c, and the trace 1 - r c x is 2 cos(angle)."""
    return critical_motion(motions(Delayed(c)), "NS", jnp.array([0.45, 0.45]), 2.1, angle=angle)


@pytest.mark.parametrize("c", [0.0, 0.2])
def test_a_neimark_sacker(c):
    found = delayed_value(jnp.asarray(c))
    assert float(found.residual) < 1e-10
    assert abs(float(found.value) - (2 + c)) < 1e-10  # measured: 2e-15
    assert abs(complex(found.multiplier) - np.exp(1j * np.arccos((1 - c) / 2))) < 1e-10  # measured: 2e-16
    np.testing.assert_allclose(found.state, 1 / (2 + c), rtol=0, atol=1e-10)  # measured: 3e-16


@pytest.mark.parametrize("differentiate", [jax.jacrev, jax.jacfwd])
def test_derivatives_of_a_neimark_sacker(differentiate):
    def both(c):
        found = delayed_value(c)
        return jnp.stack([found.value, jnp.angle(found.multiplier)])

    # of 2 + c and arccos((1 - c) / 2)
    exact = [1.0, 0.5 / np.sqrt(1 - 0.4**2)]
    np.testing.assert_allclose(differentiate(both)(0.2), exact, rtol=0, atol=1e-9)  # measured: 2e-15


class Logistic(eqx.Module):
    """r x (1 - x) + shift."""

    shift: jax.Array

    def __call__(self, r):
        return lambda x, k: r * x * (1 - x) + self.shift


def test_a_flip_of_a_longer_period():
    """The second flip of the logistic map is at 1 + 6^(1/2), from the motion of period two."""
    value = lambda shift: critical_motion(motions(Logistic(shift), 1, intervals=2), "PD", jnp.array([0.85]), 3.44)
    found = value(jnp.asarray(0.0))
    assert abs(float(found.value) - 1 - np.sqrt(6)) < 1e-10  # measured: 0
    assert found.matrices.shape == (2, 1, 1)
    # y = r / 2 - r x has y' = y^2 + c with c = r / 2 - r^2 / 4 - r shift, and its second flip at c = -5 / 4
    r = 1 + np.sqrt(6)
    exact = r / (0.5 - r / 2)
    assert abs(float(jax.grad(lambda shift: value(shift).value)(0.0)) - exact) < 1e-9  # measured: 4e-16


def shifted_well(damping):
    def family(force):
        field = lambda s, t: jnp.stack([s[1], force * jnp.cos(1.2 * t) - damping * s[1] + s[0] - s[0] ** 3])
        return lambda s, k: rk4(field, s, 2 * jnp.pi / 1.2, 120)

    return family


class Well(eqx.Module):
    damping: jax.Array

    def __call__(self, force):
        return shifted_well(self.damping)(force)


@pytest.mark.slow
def test_duffings_flip_and_its_derivative_by_differences():
    """The branch's event and the extended equations are two ways to one flip."""
    state, period = jnp.array([1.0, 0.0]), jax.jit(shifted_well(0.3)(0.25))
    for _ in range(60):
        state = period(state, 0.0)
    branch = continue_motion(motions(Well(jnp.asarray(0.3))), (state, 0.25), (0.24, 0.28))
    (event,) = [event for event in branch.events if event.label == "PD"]
    start = jnp.asarray(event.node.spot.z[:2])
    value = lambda damping: critical_motion(motions(Well(damping)), "PD", start, 0.266, tolerance=1e-12).value
    assert abs(float(value(jnp.asarray(0.3))) - event.node.spot.z[2]) < 1e-9  # measured: 1e-15
    differences = (float(value(jnp.asarray(0.3 + 1e-4))) - float(value(jnp.asarray(0.3 - 1e-4)))) / 2e-4
    slope = float(jax.grad(value)(jnp.asarray(0.3)))
    assert abs(slope / differences - 1) < 1e-6  # measured: 1e-8


def test_where_there_is_none_the_residual_says_so():
    straight = motions(lambda p: lambda x, k: 0.5 * x + p, 1)  # its multiplier is 1/2
    found = critical_motion(straight, "PD", jnp.array([0.1]), 0.2)
    assert not float(found.residual) < 1e-6
    with pytest.raises(ValueError, match="`label` must be one of LP, PD, NS, but is 'BP'"):
        critical_motion(straight, "BP", jnp.array([0.1]), 0.2)


def curve(label, state, values, bounds, family=henon_at, **options):
    equations = CriticalMotions.of(motions(family, len(state), (1.0, 1.0)), label)
    return continue_critical(equations, jnp.asarray(state, float), values, bounds, **options)


@pytest.mark.parametrize("label", ["LP", "PD"])
def test_curves_of_henons_map(label):
    bounds = (-1.0, 2.0), (-0.9, 0.9)
    found = curve(label, [STATES[label]] * 2, (HENON[label](0.3) + 0.02, 0.3), bounds)
    a, b = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3))
    np.testing.assert_allclose(a, HENON[label](b), rtol=0, atol=1e-9)  # measured: 4e-11
    assert found.ended == ("bound", "bound")
    # the fold's curve crosses all b, the flip's leaves at a = 2
    low = {"LP": -0.9, "PD": 1 - np.sqrt(8 / 3)}[label]
    np.testing.assert_allclose(sorted([b[0], b[-1]]), [low, 0.9], rtol=0, atol=1e-9)  # measured: 0
    for spot in found.spots[::5]:
        mu = multipliers(np.asarray(spot.extra.matrices))
        assert np.abs(mu - {"LP": 1.0, "PD": -1.0}[label]).min() < 1e-8  # measured: 2e-14


def test_a_curve_of_neimark_sackers():
    bounds = (1.5, 3.5), (-0.5, 0.9)
    found = curve("NS", [0.45, 0.45], (2.1, 0.1), bounds, delayed, angle=1.0)
    r, c, angle = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3, 4))
    np.testing.assert_allclose(r, 2 + c, rtol=0, atol=1e-9)  # measured: 5e-12
    np.testing.assert_allclose(np.cos(angle), (1 - c) / 2, rtol=0, atol=1e-9)  # measured: 2e-12
    assert found.ended == ("bound", "bound")
    np.testing.assert_allclose(sorted([c[0], c[-1]]), [-0.5, 0.9], rtol=0, atol=1e-9)


def test_a_curve_of_neimark_sackers_ends_at_a_strong_resonance():
    """At c = 3 both multipliers are -1, where pairs end and the extended equations are singular."""
    found = curve("NS", [0.25, 0.25], (4.5, 2.5), ((3.0, 8.0), (1.0, 6.0)), delayed, angle=2.4)
    r, c, angle = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3, 4))
    np.testing.assert_allclose(r, 2 + c, rtol=0, atol=1e-6)  # measured: 5e-8, at the end, where it is ill-conditioned
    assert found.ended == ("bound", "no convergence")
    assert abs(c[-1] - 3) < 1e-5  # measured: 6e-7
    assert abs(angle[-1] - np.pi) < 1e-2  # measured: 8e-4


def on_a_circle(state, a, b):
    return (a - 0.5) ** 2 + b**2 - 0.16


def second_fixed_point(state, a, b):
    return state[0] - 0.4


def test_a_curve_of_motions_with_a_condition():
    """Fixed points of Hénon's map x = y = 0.4 lie on a line: a = 0.4^2 + 0.4 (1 - b)."""
    equations = ConditionedMotions(motions(henon_at, 2, (1.0, 1.0)), second_fixed_point, 1.0)
    found = continue_critical(equations, jnp.array([0.5, 0.5]), (0.5, 0.1), ((-1.0, 1.0), (-0.8, 0.8)))
    a, b = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3))
    np.testing.assert_allclose(a, 0.16 + 0.4 * (1 - b), rtol=0, atol=1e-9)  # measured: 3e-16
    np.testing.assert_allclose([spot.z[0] for spot in found.spots], 0.4, rtol=0, atol=1e-9)
    assert found.ended == ("bound", "bound")
    np.testing.assert_allclose(sorted([b[0], b[-1]]), [-0.8, 0.8], rtol=0, atol=1e-12)


def test_a_closed_curve_of_motions_with_a_condition():
    equations = ConditionedMotions(motions(henon_at, 2, (1.0, 1.0)), on_a_circle, 0.1)
    found = continue_critical(equations, jnp.array([0.5, 0.5]), (0.9, 0.1), ((0.0, 1.0), (-0.8, 0.8)))
    a, b = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3))
    np.testing.assert_allclose((a - 0.5) ** 2 + b**2, 0.16, rtol=0, atol=1e-9)  # measured: 3e-12
    assert found.ended == ("", "closed")
    angles = np.unwrap(np.arctan2(b, a - 0.5))
    assert 1.8 * np.pi < abs(angles[-1] - angles[0]) < 2.2 * np.pi


@pytest.mark.parametrize("low", [-0.1, -0.09])
def test_a_corner_of_the_bounds_is_not_passed(low):
    """A step passes a = -0.3, where b = 1 - 1.2^(1/2) = -0.0954, and the bound of b, before or behind."""
    bounds = (-0.3, 1.0), (low, 1.0)
    found = curve("LP", [-0.5, -0.5], (-0.2, 0.1), bounds, pace=Pace(first=0.3, most=0.5))
    a, b = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3))
    last = max(low, 1 - np.sqrt(1.2))
    assert abs(b.min() - last) < 1e-9  # measured: 8e-12
    assert a.min() >= -0.3 - 1e-12


@pytest.mark.parametrize(
    ("state", "values", "bounds", "words"),
    [
        ([-0.3, -0.3], (-0.1, 0.3), ((1.0, -1.0), (-1.0, 1.0)), r"`bounds` must be two numbers, .* is \(1.0, -1.0\)"),
        (
            [-0.3, -0.3],
            (-0.1, 0.3),
            ((-1.0, 1.0), (0.5, 1.0)),
            "`values` must lie within the bounds 0.5 and 1, but is 0.3",
        ),
        (
            [-0.3, -0.3],
            (-0.1, 0.3),
            ((0.0, 1.0), (-1.0, 1.0)),
            "`values` must lie within the bounds 0 and 1, but is -0.12",
        ),
        ([-0.3, np.nan], (-0.1, 0.3), ((-1.0, 1.0), (-1.0, 1.0)), "`state` must be near a motion of the curve"),
        ([-0.3], (-0.1, 0.3), ((-1.0, 1.0), (-1.0, 1.0)), "`state` must have 2 numbers as `like` has, but has 1"),
    ],
)
def test_wrong_arguments_are_named(state, values, bounds, words):
    equations = CriticalMotions.of(motions(henon_at, 2, (1.0, 1.0)), "LP")
    with pytest.raises(ValueError, match=words):
        continue_critical(equations, jnp.asarray(state), values, bounds)


def test_an_interruption_returns_what_was_found():
    seen = []

    def stop(spot):
        seen.append(spot)
        if len(seen) == 4:
            raise KeyboardInterrupt

    found = curve("LP", [-0.3, -0.3], (-0.1, 0.3), ((-1.0, 1.0), (-1.0, 1.0)), on_point=stop)
    assert found.ended == ("", "interrupted")
    assert len(found.spots) == 5


class Rough(eqx.Module):
    """Henon's map with a derivative that jumps down where x passes a line: at flips between, there is no multiplier
    -1."""

    jump: jax.Array

    def __call__(self, a, b):
        bent = lambda x: jnp.maximum(x - 0.5, 0.0)
        return lambda s, k: jnp.stack([a - s[0] ** 2 + b * s[1] + self.jump * bent(s[0]), s[0]])


def rough_curve(ease):
    """Flips lie at x = (1 - b) / 2 for b > 0, at 0.005 less for b < -0.01, and nowhere between."""
    equations = CriticalMotions.of(motions(Rough(jnp.asarray(-0.01)), 2, (1.0, 1.0)), "PD", 1e-6, ease)
    start, bounds = jnp.array([0.6, 0.6]), ((-1.0, 2.0), (-0.3, 0.3))
    return continue_critical(
        equations, start, (1.08, -0.2), bounds, pace=Pace(first=0.01, most=0.01, least=1e-4), secant=True
    )


def test_eased_equations_pass_a_jump_of_the_derivative():
    found = rough_curve(0.01)
    a, b = (np.array([spot.z[k] for spot in found.spots]) for k in (2, 3))
    assert found.ended == ("bound", "bound")
    np.testing.assert_allclose(np.sort(b[[0, -1]]), [-0.3, 0.3], atol=1e-12)
    np.testing.assert_allclose(a[b >= 0], HENON["PD"](b[b >= 0]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(a[b < 0], HENON["PD"](b[b < 0]), rtol=0, atol=0.1)
    inside = [spot for spot in found.spots if -0.01 < spot.z[3] < 0]
    assert inside
    # the motions are exact there, too
    assert max(abs(spot.z[2] - spot.z[0] ** 2 + (spot.z[3] - 1) * spot.z[0]) for spot in inside) < 2e-3
    assert "no convergence" in rough_curve(0.0).ended
