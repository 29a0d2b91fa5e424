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
from slipperjax.flow.record import RecordSet
from slipperjax.flow.status import Status
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.orbits import periodic
from slipperjax.orbits.signature import Gaps, signature
from slipperjax.orbits.simulate import dynamic_steps, run_eagerly

from ..common import SCALES
from .nominal import SCENE, STEPS


def test_the_nominal_orbit_recurs_and_has_its_multipliers(nominal):
    assert int(nominal.status) == Status.FINITE
    assert float(nominal.residual) < 1e-12  # measured: 2e-15
    assert nominal.period == 1
    assert nominal.stable
    # the prototype's ln |largest multiplier|, to its digits: measured -0.04667, and -0.04668 with 200 steps
    np.testing.assert_allclose(float(nominal.exponent), -0.0467, atol=5e-5)


@pytest.mark.full
def test_a_start_that_never_touches_has_the_status_of_its_motion():
    orbit = sj.periodic_orbit(sj.paper_scene(1250.0, 4e-3), start=sj.Motion(), steps_per_period=STEPS)
    assert orbit.status == Status.NO_CONTACT


def leading(found):
    found = np.asarray(found)
    return np.sort_complex(found[np.argsort(-np.abs(found))][:6])


def multipliers_by_differences(scene, orbit):
    """Of runs from states beside the orbit's, by the program that Newton's method begins with."""
    flat, unravel = ravel_pytree(orbit.state)
    step, none = PeriodMap(scene, dynamic_steps(STEPS), orbit.solver), RecordSet()
    end = lambda x: ravel_pytree(run_eagerly(step, unravel(x), 1, none).state)[0]
    np.testing.assert_allclose(end(flat), flat, rtol=0, atol=1e-12)
    matrix = np.zeros((flat.size, flat.size))
    for k in np.flatnonzero((np.arange(flat.size) < 10) | (flat < 0)):  # an open contact has no memory
        h = 1e-5 * np.append(SCALES, [1.0] * 20)[k]
        ends = [end(flat.at[k].add(side * h)) for side in (-2, -1, 1, 2)]
        matrix[:, k] = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
    return leading(np.linalg.eigvals(matrix))


@pytest.mark.full
def test_multipliers_are_those_of_differences(nominal):
    expected = multipliers_by_differences(SCENE, nominal)
    np.testing.assert_allclose(leading(nominal.multipliers), expected, rtol=0, atol=1e-8)  # measured: 2e-10


@pytest.mark.slow
def test_an_orbit_whose_contacts_are_pressed_again_remembers_the_peak_rate():
    """With restitution 0.5 contacts last, so that both memories have orbits of their own."""
    scene = sj.paper_scene(1250.0, restitution=0.5, memory=sj.model.PeakRateLatch())
    orbit = sj.periodic_orbit(scene, steps_per_period=STEPS)
    assert orbit.status == Status.FINITE
    assert float(orbit.residual) < 1e-11  # measured 9e-14
    expected = multipliers_by_differences(scene, orbit)
    np.testing.assert_allclose(leading(orbit.multipliers), expected, rtol=0, atol=1e-8)  # measured 2e-10


@pytest.mark.full
def test_a_long_simulation_ends_on_the_orbit(nominal):
    end = None
    for _ in range(6):  # Newton's method begins with this program
        end = sj.simulate(SCENE, 100, start=end, steps_per_period=STEPS, loads=False, saves_per_period=1)
    # exp(-0.0467 * 600) = 7e-13; measured: 2e-11
    close = lambda found, exact: np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)
    jax.tree.map(close, end.end.motion, nominal.state.motion)


def test_unstable_orbits_are_found_and_left_by_simulations():
    stable = sj.periodic_orbit(SCENE.replace(speed=1110.0), steps_per_period=STEPS)
    found = sj.periodic_orbit(SCENE.replace(speed=1060.0), start=stable.state, steps_per_period=STEPS)
    assert int(found.status) == Status.FINITE
    assert not found.stable
    # below the flip between 1075 and 1110 m/s a real multiplier is beyond -1
    assert found.multipliers[0].real < -1


@pytest.mark.full
def test_a_multiple_of_the_period_is_recognised(nominal, monkeypatch):
    """Here four periods are one whose Jacobian is repeated; a slow test has Newton's method over four."""
    shoot = periodic.shoot

    def once(*args, intervals, **options):
        found = shoot(*args, intervals=1, **options)
        return eqx.tree_at(lambda one: one.matrices, found, jnp.repeat(found.matrices, intervals, axis=0))

    monkeypatch.setattr(periodic, "shoot", once)
    four = sj.periodic_orbit(SCENE, period=4, steps_per_period=STEPS)
    assert four.period == 1
    np.testing.assert_allclose(four.multipliers, nominal.multipliers, rtol=0, atol=1e-12)


@pytest.mark.full
def test_the_signature_is_that_of_a_fine_trajectory(nominal):
    found = nominal.signature
    gap = np.asarray(nominal.trajectory().reactions.gap).reshape(STEPS + 1, -1)
    names = [f"{n}{e}" for e in (1, 2) for n in SCENE.section.names]
    opened = np.argwhere((gap[:-1] >= 0) & (gap[1:] < 0))
    assert sorted(found.points) == sorted(names[point] for _, point in opened)
    rates = []
    for k, point in opened:  # the slope of the parabola through three saved gaps, where it is zero
        a, b, c = gap[k - 1 : k + 2, point]
        slope = -np.sqrt((c - a) ** 2 / 4 - 2 * b * (a + c - 2 * b))
        rates.append((names[point], slope * STEPS / float(SCENE.period)))
    measured = sorted((one.point, one.rate) for one in found.touchdowns)
    np.testing.assert_allclose([rate for _, rate in measured], [rate for _, rate in sorted(rates)], rtol=0.02)
    # with 800 steps 0.827 m/s; measured: 0.2 % of it
    np.testing.assert_allclose(found.slowest, 0.827, rtol=0.02)


def test_a_signature_names_the_points_in_the_order_of_their_touchdowns():
    """Of gaps -size sin(2 pi (t - when)), some of which fall in one step; another is closed, the rest are open."""
    when = {"J1": 0.111, "A2": 0.1115, "C1": 0.112, "B2": 0.52, "A1": 0.9, "B1": 0.9001}
    names = [*(f"{name}1" for name in "ABCDEFGHIJ"), *(f"{name}2" for name in "ABCDEFGHIJ")]
    t, steps, period = np.arange(65) / 64, 64, 6.4e-3
    gap, rate = np.ones((65, 20)), np.zeros((65, 20))
    gap[:, names.index("D2")] = -1.0
    for k, name in enumerate(when):
        turn = 2 * np.pi * (t - when[name])
        gap[:, names.index(name)] = -(k + 1) * 1e-3 * np.sin(turn)
        rate[:, names.index(name)] = -(k + 1) * 1e-3 * np.cos(turn) * 2 * np.pi / period
    found = signature(SCENE, Gaps.of(gap[None], rate[None], steps, period))
    assert found.points == tuple(when)
    assert found.closed == ("D2",)
    # the cubics miss a sine by 1e-7
    np.testing.assert_allclose([one.period for one in found.touchdowns], list(when.values()), rtol=1e-6)
    rates = -np.arange(1, 7) * 1e-3 * 2 * np.pi / period
    np.testing.assert_allclose([one.rate for one in found.touchdowns], rates, rtol=1e-4)
    assert found.slowest == -found.touchdowns[0].rate
    np.testing.assert_allclose(found.nearest, 1e-3, rtol=1e-6)


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


@pytest.mark.full
def test_a_dataset_holds_one_period_and_the_multipliers(nominal):
    ds = nominal.ds
    np.testing.assert_allclose(ds["v_y"][-1], ds["v_y"][0], rtol=1e-9)
    np.testing.assert_allclose(ds["multiplier_real"] + 1j * ds["multiplier_imag"], nominal.multipliers)
    assert (ds.attrs["stable"], ds.attrs["orbit_period"]) == (1, 1)
    assert "H1" in ds.attrs["signature"]
    assert eqx.tree_equal(sj.load(ds).scene, SCENE)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_failures_say_what_happened(nominal):
    # no residual is as small as this one
    missed = sj.periodic_orbit(SCENE, start=nominal.state, steps_per_period=STEPS, tolerance=1e-200)
    assert int(missed.status) == Status.NO_ORBIT
    assert repr(missed) == f"PeriodicOrbit(period 1 at 1250 m/s, status 8: {Status.NO_ORBIT})"
    assert "m/s, status 0: finite, stable,\n  multipliers" in repr(nominal)
    lost = sj.periodic_orbit(SCENE.replace(speed=1e-3), steps_per_period=STEPS)
    assert int(lost.status) == Status.NOT_FINITE
    assert np.all(np.isnan(lost.multipliers))
    with pytest.raises(ValueError, match="must have a track that recurs with the forcing period"):
        sj.periodic_orbit(sj.paper_scene(wavelengths=(8.0, 3.0)))
    with pytest.raises(ValueError, match="`period` must be a whole number of 1 or more, but is 0"):
        sj.periodic_orbit(SCENE, period=0)


@pytest.mark.slow
def test_smooth_memory_has_orbits_too():
    smooth = eqx.tree_at(lambda s: s.memory, SCENE, sj.model.SmoothSwitch())
    begin = sj.simulate(smooth, 60, steps_per_period=2000, loads=False, saves_per_period=1)
    found = sj.periodic_orbit(smooth, start=begin, steps_per_period=2000)
    np.testing.assert_allclose(float(found.exponent), -0.0467, atol=2e-3)


@pytest.mark.slow
def test_newtons_method_over_several_periods_finds_the_least(nominal):
    several = sj.periodic_orbit(SCENE, period=4, start=nominal.state, steps_per_period=STEPS)
    assert several.period == 1
    # one segment of four periods; measured: 2e-13 of the fourth power
    four = np.asarray(jacobians(PeriodMap(SCENE, ConstantSteps(STEPS), periods=4), nominal.state, 1))
    exact = np.sort(np.abs(nominal.multipliers))[:-9:-1] ** 4
    np.testing.assert_allclose(np.abs(multipliers(four))[:8], exact, rtol=1e-4, atol=1e-9)
