"""Periodic motions by Newton's method: closed forms, their derivatives, and honest failures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.floquet import multipliers, solve
from slipperjax.analysis.shooting import minimal_period, shoot

from .systems import LOGISTIC, Arc


class Forced(eqx.Module):
    """x'' + 2 d x' + x = cos(w t) over one forcing period, by its exact flow; `segments` maps to a period."""

    damping: jax.Array
    frequency: jax.Array
    segments: int = eqx.field(static=True, default=1)

    @property
    def arc(self):
        return Arc(self.damping, 1.0, 0.0, 1.0, self.frequency)

    def __call__(self, state, k):
        step = 2 * jnp.pi / self.frequency / self.segments
        return jnp.stack(self.arc(state, k * step, step))


@pytest.mark.parametrize("segments", [1, 5])
def test_a_linear_oscillator_has_its_closed_form(segments):
    system = Forced(jnp.asarray(0.1), jnp.asarray(1.3), segments)
    found = shoot(system, jnp.array([5.0, -3.0]), intervals=segments)
    np.testing.assert_allclose(found.state, system.arc.steady(0.0), rtol=0, atol=1e-12)
    period, root = 2 * np.pi / 1.3, np.sqrt(1 - 0.01)
    exact = np.exp(-0.1 * period + 1j * root * period * np.array([1, -1]))
    # measured: 2e-14, whatever the number of segments
    found_multipliers = np.asarray(multipliers(np.asarray(found.matrices)))
    np.testing.assert_allclose(np.sort_complex(found_multipliers), np.sort_complex(exact), rtol=0, atol=1e-12)
    assert int(found.iterations) == 1  # Newton's method is exact for a linear map


@pytest.mark.full
def test_derivatives_are_those_of_the_exact_motion():
    first = lambda d: shoot(Forced(d, jnp.asarray(1.3)), jnp.zeros(2)).state[0]
    exact = lambda d: (1 / ((1 - 1.3**2) + 2j * d * 1.3)).real
    several = np.array([0.1, 0.2])
    values, reverse = jax.jit(jax.vmap(jax.value_and_grad(first)))(several)
    forward = jax.jit(jax.vmap(jax.jacfwd(first)))(several)
    np.testing.assert_allclose(values, [exact(d) for d in several], rtol=1e-12)
    for slopes in (reverse, forward):
        np.testing.assert_allclose(slopes, [jax.grad(exact)(d) for d in several], rtol=1e-12)


@pytest.mark.parametrize("modes", [(jax.jacfwd, jax.jacfwd), (jax.jacfwd, jax.grad), (jax.grad, jax.grad)])
def test_second_derivatives_are_those_of_the_exact_motion(modes):
    """The fixed point 1 - 1 / r of the logistic map, by a number of a module and by one that a function holds."""
    outer, inner = modes
    start = jnp.array([0.69])
    module = lambda r: shoot(LOGISTIC(r), start).state[0]
    function = lambda r: shoot(lambda s, k: r * s * (1 - s), start).state[0]
    both = jax.jit(lambda rate: [[inner(f)(rate), outer(inner(f))(rate)] for f in (module, function)])
    # measured: 2e-16 and 4e-16
    np.testing.assert_allclose(both(3.2), [[1 / 3.2**2, -2 / 3.2**3]] * 2, rtol=1e-12)


def test_logistic_orbits_and_multipliers():
    rate = 3.3
    found = shoot(LOGISTIC(jnp.asarray(rate)), jnp.asarray([0.4]), intervals=2)
    root = np.sqrt((rate - 3) * (rate + 1))
    np.testing.assert_allclose(float(found.state[0]), (rate + 1 - root) / (2 * rate), rtol=0, atol=1e-12)
    np.testing.assert_allclose(multipliers(np.asarray(found.matrices)), [4 + 2 * rate - rate**2], rtol=0, atol=1e-11)
    # the unstable fixed point, which no simulation finds
    fixed = shoot(LOGISTIC(jnp.asarray(rate)), jnp.asarray([0.6]))
    np.testing.assert_allclose(float(fixed.state[0]), 1 - 1 / rate, rtol=0, atol=1e-12)
    np.testing.assert_allclose(multipliers(np.asarray(fixed.matrices)), [2 - rate], rtol=0, atol=1e-12)


def test_minimal_periods_are_found_among_divisors():
    step = LOGISTIC(jnp.asarray(3.3))
    orbit = shoot(step, jnp.asarray([0.48]), intervals=4).state
    missed = {n: float(r) for n, r in minimal_period(step, orbit, 4).items()}
    assert set(missed) == {1, 2, 4}
    assert missed[1] > 0.1
    assert missed[2] < 1e-10
    assert missed[4] < 1e-10


def test_where_there_is_no_motion_the_residual_says_so():
    without = lambda x, k: x + 1 + x**2  # no real fixed point
    assert not float(shoot(without, jnp.asarray([0.3]), max_iterations=20).residual) < 1e-3
    bursts = lambda x, k: jnp.where(x > 0, jnp.nan, x)
    assert not np.isfinite(float(shoot(bursts, jnp.asarray([1.0])).residual))


def test_long_steps_are_halved():
    steep = lambda x, k: x - jnp.arctan(x)  # Newton's method diverges from 2 without
    found = shoot(steep, jnp.asarray([2.0]))
    assert float(found.residual) < 1e-10
    assert abs(float(found.state[0])) < 1e-9


def test_linear_systems():
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((30, 30)) * 10.0 ** rng.integers(-3, 3, 30)[:, None]
    matrix[0, 0] = 0.0  # needs a pivot
    for rhs in (rng.standard_normal(30), rng.standard_normal((30, 4))):
        found = jax.jit(solve)(matrix, rhs)
        np.testing.assert_allclose(matrix @ found, rhs, rtol=0, atol=1e-9 * np.abs(matrix).max())
        np.testing.assert_allclose(found, np.linalg.solve(matrix, rhs), rtol=1e-8)
    assert not np.all(np.isfinite(jax.jit(solve)(np.ones((2, 2)), np.ones(2))))
