"""Exact periodic motions of slippers: against the period map, simulations and exponents."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import slipperjax as sj
from slipperjax.analysis.floquet import jacobians, multipliers
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.status import Status
from slipperjax.flow.stepping import ConstantSteps

SCENE = sj.paper_scene()
STEPS = 200


@pytest.fixture(scope="module")
def nominal():
    return sj.periodic_orbit(SCENE, steps_per_period=STEPS)


def test_the_nominal_orbit_recurs_and_has_its_multipliers(nominal):
    assert int(nominal.status) == Status.FINITE
    assert float(nominal.residual) < 1e-12  # measured: 2e-15
    assert nominal.period == 1
    assert nominal.stable
    end = sj.period_map(SCENE, nominal.state, steps_per_period=STEPS)
    np.testing.assert_allclose(ravel_pytree(end)[0], ravel_pytree(nominal.state)[0], atol=1e-12)
    # the prototype's ln |largest multiplier|
    np.testing.assert_allclose(float(nominal.exponent), -0.0467, atol=5e-5)


def test_multipliers_are_those_of_the_period_map(nominal):
    flat, unravel = ravel_pytree(nominal.state)
    flow = lambda x: ravel_pytree(sj.period_map(SCENE, unravel(x), steps_per_period=STEPS))[0]
    matrix = np.asarray(jax.jacfwd(flow)(flat))
    exact = np.linalg.eigvals(matrix)
    leading = lambda found: np.sort_complex(found[np.argsort(-np.abs(found))][:6])
    np.testing.assert_allclose(leading(np.asarray(nominal.multipliers)), leading(exact), atol=1e-8)


def test_a_long_simulation_ends_on_the_orbit(nominal):
    run = sj.simulate(SCENE, 600, steps_per_period=STEPS, loads=False, saves_per_period=1)
    # exp(-0.0467 * 600) = 7e-13; measured: 2e-11
    for found, exact in zip(jax.tree.leaves(run.end.motion), jax.tree.leaves(nominal.state.motion), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-9)


def test_unstable_orbits_are_found_and_left_by_simulations():
    stable = sj.periodic_orbit(SCENE.replace(speed=1110.0), steps_per_period=STEPS)
    found = sj.periodic_orbit(SCENE.replace(speed=1060.0), start=stable.state, steps_per_period=STEPS)
    assert int(found.status) == Status.FINITE
    assert not found.stable
    # below the flip between 1075 and 1110 m/s a real multiplier is beyond -1
    assert found.multipliers[0].real < -1
    assert abs(found.multipliers[0].imag) < 1e-8


def test_a_multiple_of_the_period_is_recognised(nominal):
    four = sj.periodic_orbit(SCENE, period=4, steps_per_period=STEPS)
    assert four.period == 1
    leading = lambda orbit: np.sort_complex(np.asarray(orbit.multipliers)[:4])
    np.testing.assert_allclose(leading(four), leading(nominal), atol=1e-8)


def test_the_signature_is_that_of_a_fine_trajectory(nominal):
    found = nominal.signature
    gap = np.asarray(nominal.trajectory(saves_per_period=STEPS).reactions.gap)
    opened = (gap[:-1] >= 0) & (gap[1:] < 0)
    counts = {p: found.points.count(p) for p in set(found.points)}
    names = np.array([[f"{n}{e}" for n in SCENE.section.names] for e in (1, 2)])
    assert counts == {str(n): int(c) for n, c in zip(names.ravel(), opened.sum(axis=0).ravel(), strict=True) if c}
    assert [t.period for t in found.touchdowns] == sorted(t.period for t in found.touchdowns)
    fine = sj.periodic_orbit(SCENE, start=nominal.state, steps_per_period=4 * STEPS).signature
    assert fine.points == found.points
    # measured: 0.827 m/s and 0.2 % of it
    np.testing.assert_allclose(found.slowest, fine.slowest, rtol=0.02)
    assert all(t.rate < 0 for t in found.touchdowns)


@pytest.mark.slow
def test_derivatives_in_both_modes_and_batches(nominal):
    of_speed = lambda v: (
        sj.periodic_orbit(SCENE.replace(speed=v), start=nominal.state, steps_per_period=STEPS).state.motion.v_y
    )
    slope = (of_speed(1250.01) - of_speed(1249.99)) / 0.02
    # measured: 2e-10 of it
    np.testing.assert_allclose(jax.grad(of_speed)(1250.0), slope, rtol=1e-7)
    np.testing.assert_allclose(jax.jacfwd(of_speed)(1250.0), slope, rtol=1e-7)
    several = jax.jit(jax.vmap(of_speed))(jnp.array([1250.0, 1260.0]))
    np.testing.assert_allclose(several, [of_speed(1250.0), of_speed(1260.0)], rtol=1e-9)


@pytest.mark.slow
def test_the_state_has_the_exact_orbit_s_derivative(nominal):
    of_speed = lambda v: (
        sj.periodic_orbit(SCENE.replace(speed=v), start=nominal.state, steps_per_period=STEPS).state.motion.v_y
    )
    # the central difference of orbits at 1249.99 and 1250.01 m/s
    np.testing.assert_allclose(jax.jacfwd(of_speed)(1250.0), 0.0076698298558, rtol=1e-8)


def test_a_dataset_holds_one_period_and_the_multipliers(nominal):
    ds = nominal.to_xarray()
    np.testing.assert_allclose(ds["v_y"][-1], ds["v_y"][0], rtol=1e-9)
    np.testing.assert_allclose(ds["multiplier_real"] + 1j * ds["multiplier_imag"], nominal.multipliers)
    assert ds.attrs["stable"] == 1
    assert ds.attrs["orbit_period"] == 1
    assert "H1" in ds.attrs["signature"]
    assert eqx.tree_equal(sj.load_scene(ds), SCENE)


def test_failures_say_what_happened(nominal):
    chaotic = sj.periodic_orbit(SCENE.replace(speed=2300.0), steps_per_period=STEPS, max_iterations=2)
    assert int(chaotic.status) == Status.NO_ORBIT
    assert "no orbit" in repr(chaotic)
    with pytest.raises(ValueError, match="must have a track that recurs with its first wavelength"):
        sj.periodic_orbit(sj.paper_scene(wavelengths=(8.0, 3.0)))
    with pytest.raises(ValueError, match="`period` must be a whole number of 1 or more, but is 0"):
        sj.periodic_orbit(SCENE, period=0)


@pytest.mark.slow
def test_smooth_memory_has_orbits_too():
    smooth = eqx.tree_at(lambda s: s.memory, SCENE, sj.SmoothSwitch())
    begin = sj.simulate(smooth, 60, steps_per_period=2000, loads=False, saves_per_period=1)
    found = sj.periodic_orbit(smooth, start=begin, steps_per_period=2000)
    assert int(found.status) == Status.FINITE
    np.testing.assert_allclose(float(found.exponent), -0.0467, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1110.0, 1150.0, 1200.0, 1250.0, 1300.0, 1400.0, 1500.0, 1600.0, 1700.0, 1800.0])
def test_the_exponent_is_that_of_long_tangents(speed):
    orbit = sj.periodic_orbit(SCENE.replace(speed=speed), steps_per_period=STEPS)
    tangents = sj.lyapunov_spectrum(
        SCENE.replace(speed=speed), start=orbit.state, steps_per_period=STEPS, transient=0
    )
    # measured: at most 8e-6, where a complex pair leads and the mean of 500 periods is of its turning
    np.testing.assert_allclose(tangents.weighted[0], float(orbit.exponent), atol=1e-4)


def test_multipliers_do_not_depend_on_the_number_of_segments(nominal):
    several = sj.periodic_orbit(SCENE, period=4, start=nominal.state, steps_per_period=STEPS)
    four = PeriodMap(SCENE, ConstantSteps(STEPS), periods=4)
    matrices = np.asarray(jacobians(four, nominal.state, 1))
    one = np.sort(np.abs(nominal.multipliers))[::-1]
    # one segment of four periods, and four segments of one; measured: 2e-13 and 3e-9 of the fourth power
    np.testing.assert_allclose(np.abs(multipliers(matrices))[:8], one[:8] ** 4, rtol=1e-4, atol=1e-9)
    assert several.period == 1
    chain = np.asarray(jacobians(PeriodMap(SCENE, ConstantSteps(STEPS)), nominal.state, 4))
    np.testing.assert_allclose(np.abs(multipliers(chain))[:8], one[:8] ** 4, rtol=1e-6)
