"""Exponents of slippers: certified in a batch, alone, resumed, and with either contact memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import slipperjax as sj
from slipperjax.analysis import extend_spectrum, largest_exponent, ode_spectrum, ode_step
from slipperjax.flow import ConstantSteps, PeriodMap, tangent_weights
from slipperjax.model import Args

SPEEDS = [1100.0, 1250.0, 1500.0, 1800.0, 2100.0, 2300.0]
STEPS = 50


def swept(**options):
    options |= dict(transient=300, steps_per_period=STEPS)
    return sj.lyapunov_sweep(sj.paper_scene(), {"speed": SPEEDS}, **options).isel(count=0)


def test_periodic_motions_contract_and_chaotic_ones_part():
    found = swept(periods=300, certify=False)
    calm, wild = found.sel(speed=slice(1000, 1900)), found.sel(speed=slice(2000, 2400))
    assert (calm["period"] == 1).all()
    assert (calm["weighted"] < -0.03).all()
    assert (wild["exponent"] > 5 * wild["stderr"]).all()
    assert not (wild["kind"] == "period").any()


def test_certificates_of_a_short_run():
    """A periodic motion agrees with its multiplier, and every case says what it is and how it went."""
    grid = {"speed": [1250.0, 1e-3]}
    found = sj.lyapunov_sweep(sj.paper_scene(), grid, transient=200, periods=60, steps_per_period=STEPS)
    good, bad = found.isel(speed=0), found.isel(speed=1)
    assert bool(good["resolved"])
    assert str(good["regime"].values) == "periodic"
    assert int(good["status"]) == 0
    # measured: floquet -0.0465, half the step -0.0479, two trajectories equal to the tangent within 1e-6
    np.testing.assert_allclose(good["weighted"], good["floquet"], atol=1e-3)
    np.testing.assert_allclose(good["two_trajectories"], good["exponent"][0], atol=1e-5)
    np.testing.assert_allclose(good["half_step"], good["exponent"][0], atol=1e-3)
    assert int(bad["status"]) == 1  # hours in 50 steps: thrown out of the finite numbers
    assert not bool(bad["resolved"])
    assert str(bad["regime"].values) == "unresolved"
    assert str(bad["kind"].values) == "unresolved"


@pytest.fixture(scope="module")
def certified():
    return swept(periods=500)


@pytest.mark.slow
def test_periodic_motions_have_the_exponents_of_their_multipliers(certified):
    calm = certified.sel(speed=slice(1000, 1900))
    np.testing.assert_allclose(calm["weighted"], calm["floquet"], atol=1e-3)
    assert certified["resolved"].all()


@pytest.mark.slow
def test_one_scene_alone_resumed_and_until_it_is_known(certified):
    scene = sj.paper_scene(speed=1250.0)
    options = dict(steps_per_period=STEPS, transient=300)
    whole = sj.lyapunov_spectrum(scene, periods=60, **options)
    part = sj.lyapunov_spectrum(scene, periods=30, **options)
    step = PeriodMap(scene, ConstantSteps(steps=jnp.asarray(float(STEPS))))
    rest = extend_spectrum(part, step, 30, scale=tangent_weights(scene))
    np.testing.assert_allclose(rest.history, whole.history, rtol=1e-9, atol=1e-12)
    known = sj.lyapunov_spectrum(scene, periods=30, until_stderr=5e-3, **options)
    assert known.reached
    assert known.stderr[0] <= 5e-3
    np.testing.assert_allclose(known.per_period, certified["floquet"].sel(speed=1250), atol=3 * 5e-3)


@pytest.mark.slow
def test_all_exponents_and_both_memories_agree():
    """On the same periodic motion both models have the same exponents, within the smooth one's bias."""
    for speed in (1250.0, 1500.0):
        latched = sj.lyapunov_spectrum(
            sj.paper_scene(speed=speed), 10, transient=200, periods=200, steps_per_period=200
        )
        scene = sj.paper_scene(speed=speed, memory=sj.SmoothSwitch())
        smooth = sj.lyapunov_spectrum(scene, 10, transient=200, periods=200, steps_per_period=200)
        np.testing.assert_allclose(latched.weighted[0], smooth.weighted[0], atol=3e-3)


@pytest.mark.slow
def test_sum_of_the_smooth_models_exponents_is_its_mean_divergence():
    """All 30, orthonormalised 20 times per period, as the open contacts' memory decays by up to e^60 in one."""
    scene = sj.paper_scene(speed=1250.0, memory=sj.SmoothSwitch())
    field, args = sj.vector_field(scene), Args(scene)
    start = sj.initial_state(scene, sj.table_2_start())
    common = dict(dt=1 / 400, steps=20, args=args, period=1.0)
    run = ode_spectrum(field, start, 200, scale=tangent_weights(scene), **common)

    def with_divergence(t, y, args):
        flat, unravel = ravel_pytree(y[0])
        jacobian = jax.jacfwd(lambda x: ravel_pytree(field(t, unravel(x), args))[0])(flat)
        return field(t, y[0], args), jnp.trace(jacobian)

    step = ode_step(with_divergence, dt=1 / 400, steps=400, args=args)
    end = jax.jit(lambda y: jax.lax.fori_loop(0, 10, lambda k, y: step(y, 1.0 * k), y))((start, jnp.zeros(())))
    np.testing.assert_allclose(np.sum(run.per_period), end[1] / 10, rtol=1e-4)


def test_multipliers_of_several_periods():
    first, second = np.diag([2.0, 0.1]), np.array([[0.0, 1.0], [0.5, 0.0]])
    assert largest_exponent([first, second, 9 * first], 1) == pytest.approx(np.log(2))
    assert largest_exponent([first, second, 9 * first], 2) == pytest.approx(np.log(np.sqrt(0.1)) / 2)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="Argument `count` must be a whole number of 1 or more, but is 0"):
        sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1250.0]}, count=0)
    with pytest.raises(ValueError, match="Argument `count` must be at most"):
        sj.lyapunov_spectrum(sj.paper_scene(), 99, transient=0, periods=1)
    for count in (11, 99):
        with pytest.raises(
            ValueError, match=f"`count` must be at most 10, the dimension of the motion, but is {count}"
        ):
            sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1250.0]}, count=count)
    smooth = sj.paper_scene(memory=sj.SmoothSwitch())
    with pytest.raises(ValueError, match="`count` must be at most 30"):
        sj.lyapunov_spectrum(smooth, 31)
