"""JAX's transformations around public functions, nested in any order.

All are slow; what is fast is in `test_derivatives`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap

pytestmark = pytest.mark.slow
STEPS = 50


def scene_at(speed):
    return sj.paper_scene().replace(speed=speed)


def last_velocity(speed):
    run = sj.simulate(scene_at(speed), 1, steps_per_period=STEPS, saves_per_period=10)
    return run.state.motion.v_y[-1]


def mapped(speed):
    scene = scene_at(speed)
    return sj.period_map(scene, sj.initial_state(scene, sj.table_2_start()), steps_per_period=STEPS).motion.v_y


def peak_force(speed):
    return sj.simulate(scene_at(speed), 1, steps_per_period=STEPS).peak.force


def highest_saved_force(speed):
    return jnp.max(sj.simulate(scene_at(speed), 1, steps_per_period=STEPS).reactions.contact_force)


def exponent(speed):
    options = dict(transient=1, align=0, periods=1, steps_per_period=20)
    return sj.lyapunov_spectrum(scene_at(speed), **options).per_period[0]


def difference(function, x, h=1e-4):
    return (function(x + h) - function(x - h)) / (2 * h)


@pytest.mark.parametrize(
    "function",
    [last_velocity, mapped, peak_force, highest_saved_force, exponent],
    ids=lambda f: f.__name__,
)
def test_transformations_nest(function):
    x = 1250.0
    plain = function(x)
    slope = difference(function, x)
    scale = abs(float(plain)) / x
    ways = {
        "jit": jax.jit(function)(x) - plain,
        "vmap": jax.vmap(function)(jnp.array([x, x]))[1] - plain,
        "jit of vmap": jax.jit(jax.vmap(function))(jnp.array([x, x]))[1] - plain,
        "checkpoint": jax.checkpoint(function)(x) - plain,
        "map": jax.lax.map(function, jnp.array([x, x]))[1] - plain,
    }
    for name, rest in ways.items():
        assert abs(float(rest)) < 1e-9 * abs(float(plain)), (function.__name__, name)  # measured 1e-13
    slopes = {
        "jacfwd": jax.jacfwd(function)(x),
        "jvp": jax.jvp(function, (x,), (1.0,))[1],
        "jit of jacfwd": jax.jit(jax.jacfwd(function))(x),
        "vmap of jacfwd": jax.vmap(jax.jacfwd(function))(jnp.array([x, x]))[0],
        "grad": jax.grad(function)(x),
        "vjp": jax.vjp(function, x)[1](jnp.ones(()))[0],
        "jit of grad": jax.jit(jax.grad(function))(x),
        "jacrev of jit": jax.jacrev(jax.jit(function))(x),
    }
    for name, found in slopes.items():
        np.testing.assert_allclose(found, slope, atol=1e-4 * max(abs(float(slope)), scale), err_msg=name)


def test_second_derivatives_in_all_orders():
    def end(speed):
        scene = scene_at(speed)
        state = sj.initial_state(scene, sj.Motion(v_y=0.5))
        return PeriodMap(scene, 20)(state).motion.v_y

    orders = (jax.jacfwd(jax.jacfwd(end)), jax.jacfwd(jax.jacrev(end)), jax.jacrev(jax.jacfwd(end)), jax.hessian(end))
    found = [float(order(1250.0)) for order in orders]
    expected = difference(jax.jacfwd(end), 1250.0)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
