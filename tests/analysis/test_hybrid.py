"""Maps with impacts and sections beside closed forms."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.floquet import floquet, jacobians, multipliers
from slipperjax.analysis.hybrid import impact_step, return_step
from slipperjax.analysis.shooting import shoot

from .systems import Stopped

DAMPING, FREQUENCY, GAP, RESTITUTION = 0.1, 2.2, 0.15, 0.8
PERIOD = 2 * np.pi / FREQUENCY


def swinging(t, s):
    return jnp.stack([s[1], jnp.cos(FREQUENCY * t) - 2 * DAMPING * s[1] - s[0]])


def stopped(restitution=RESTITUTION, steps=400):
    """An oscillator below a rigid stop, over a period."""
    rebound = lambda t, s: jnp.stack([s[0], -restitution * s[1]])
    return impact_step(swinging, lambda t, s: GAP - s[0], rebound, dt=PERIOD / steps, steps=steps)


EXACT = Stopped(*map(jnp.asarray, (DAMPING, FREQUENCY, 1.0, GAP, np.inf, RESTITUTION)))


def test_impacts_and_their_jacobians_are_those_of_the_closed_form():
    state = jnp.array([0.1, 0.3])
    slopes, (end, touches, _) = jax.jit(jax.jacfwd(lambda s: 2 * (EXACT.followed(s),), has_aux=True))(state)
    assert touches >= 1
    step = stopped()
    np.testing.assert_allclose(eqx.filter_jit(step)(state, 0.0), end, atol=1e-9)  # measured 5e-11
    np.testing.assert_allclose(jacobians(step, state, 1)[0], slopes[0], atol=5e-9)  # measured 3e-10
    reverse = jax.jit(jax.jacrev(lambda s: stopped(steps=40)(s, 0.0)))(state)
    np.testing.assert_allclose(reverse, jacobians(stopped(steps=40), state, 1)[0], atol=1e-13)  # measured 1e-15


def test_derivatives_by_what_a_step_closes_over_are_those_of_its_loop():
    state = jnp.array([0.1, 0.3])
    # the second without the rule for both modes, in the forward mode that loops have
    through = lambda e: stopped(e, steps=40)(state, 0.0)[0]
    plain = lambda e: stopped(e, steps=40)._interval(state, 0.0)[0]
    e = jnp.asarray(RESTITUTION)
    expected = jax.jit(jax.jacfwd(plain))(e)
    assert abs(expected) > 0.1
    for mode in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(mode(through))(e), expected, rtol=1e-12)  # measured 2e-16


def test_an_orbit_with_an_impact_contracts_areas_by_damping_and_restitution():
    orbit = shoot(stopped(), jnp.array([0.1, 0.3]), tolerance=1e-12)
    assert orbit.residual < 1e-12
    np.testing.assert_allclose(eqx.filter_jit(EXACT)(orbit.state, 0.0), orbit.state, atol=2e-9)  # measured 1e-10
    touches = int(EXACT.followed(orbit.state)[1])
    assert touches == 1
    area = RESTITUTION ** (2 * touches) * np.exp(-2 * DAMPING * PERIOD)
    found = floquet(stopped(), orbit.state)
    np.testing.assert_allclose(np.prod(found), area, rtol=2e-9)  # measured 1e-10


def test_returns_to_a_section_are_those_of_a_focus():
    decay, turn = 0.1, 3.0
    field = lambda t, s: jnp.stack([-decay * s[0] - turn * s[1], turn * s[0] - decay * s[1]])
    step = return_step(field, lambda t, s: -s[1], dt=0.01)  # from y rising through zero
    factor = np.exp(-decay * 2 * np.pi / turn)
    ends = jax.jit(jax.vmap(lambda x: step(jnp.stack([x, 0 * x]), 0.0)))(jnp.array([0.5, 2.0]))
    np.testing.assert_allclose(ends, np.array([[0.5, 0.0], [2.0, 0.0]]) * factor, atol=3e-8)  # measured 7e-9, of RK4
    found = floquet(step, jnp.array([0.0, 0.0]) + jnp.array([1e-3, 0.0]))
    np.testing.assert_allclose(found, [factor, 0.0], atol=2e-8)  # measured 4e-9
    lost = return_step(field, lambda t, s: -s[1], dt=0.01, most=100)  # a turn takes 209 steps
    assert np.all(np.isnan(lost(jnp.array([1.0, 0.0]), 0.0)))


def test_flights_of_a_ball_from_impact_to_impact():
    ball = lambda t, s: jnp.stack([s[1], -9.81 * jnp.ones_like(t), jnp.ones_like(t)])
    step = return_step(ball, lambda t, s: s[0], lambda t, s: s * jnp.array([1.0, -0.8, 1.0]), dt=0.01)
    state = step(jnp.array([0.0, -3.0, 0.0]), 0.0)
    np.testing.assert_allclose(state, [0.0, -2.4, 2 * 2.4 / 9.81], atol=1e-13)


def test_wrong_arguments_are_named():
    field, gap = lambda t, s: s, lambda t, s: s[0]
    for make, words in (
        (lambda: impact_step(field, gap, None, dt=0.1, steps=1), "`reset` must be a function, but is None"),
        (lambda: return_step(field, 3, dt=0.1), "`surface` must be a function, but is 3"),
        (lambda: return_step(field, gap, dt=-0.1), "`dt` must be positive"),
        (lambda: return_step(field, gap, dt=0.1, most=0), "`most` must be a whole number of 1 or more"),
        (lambda: impact_step(field, gap, gap, dt=0.1, steps=0.5), "`steps` must be a whole number"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


@pytest.mark.slow
def test_the_page_s_oscillator_doubles_its_period_where_the_closed_form_does():
    page = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text()
    names = {}
    exec(page.split("```python\n")[1].split("```")[0], names)
    (flip,) = [event for event in names["branch"].events if event.label == "PD"]
    x, v, frequency = flip.node.spot.z
    assert abs(frequency - 2.3583) < 1e-4
    exact = Stopped(*map(jnp.asarray, (DAMPING, frequency, 1.0, GAP, np.inf, RESTITUTION)))
    orbit = shoot(lambda s, k: exact(s, k), jnp.array([x, v]))
    np.testing.assert_allclose(orbit.state, [x, v], atol=1e-8)
    np.testing.assert_allclose(multipliers(orbit.matrices)[0], -1.0, atol=1e-7)
    assert np.all(names["spectrum"].per_period < 0)
