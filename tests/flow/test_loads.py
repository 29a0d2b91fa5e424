"""Peak forces, impulses, contact fractions and penetrations: over every step, and refined inside it."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.loads import over_periods
from slipperjax.flow.status import Status

from ..common import compilations

PERIODS = 3


@pytest.mark.parametrize("stiffness", [1e9, 1e10, 1e11])
def test_the_peak_does_not_depend_on_the_saves_and_converges_in_the_step(stiffness):
    """The highest of 50 saves is 0.4, 6.9 and 6.2 % too low at these."""
    scene = sj.paper_scene(stiffness=stiffness)
    steps = sj.default_steps_per_period(scene)
    few, many, fine = (
        sj.simulate(scene, PERIODS, steps_per_period=n * steps, saves_per_period=saves).peak
        for n, saves in ((1, 50), (1, steps), (8, 50))
    )
    assert float(few.force) == float(many.force)
    # measured: 8e-5, 3e-4, 3e-5
    assert float(few.force) == pytest.approx(float(fine.force), rel=1e-3)
    assert float(few.period) == pytest.approx(float(fine.period), abs=1e-4)  # measured: 4e-5
    assert (int(few.end), int(few.point)) == (int(fine.end), int(fine.point))


def test_loads_are_those_of_a_very_fine_record():
    scene = sj.paper_scene()
    loads = over_periods(sj.simulate(scene, PERIODS, steps_per_period=100).loads)
    fine = sj.simulate(scene, PERIODS, steps_per_period=3200, saves_per_period=3200)
    force, gap = np.asarray(fine.reactions.contact_force), np.asarray(fine.reactions.gap)
    seconds = float(scene.period) / 3200
    trapezoid = lambda a: (a[1:] + a[:-1]).sum(axis=0) / 2
    # measured, in units of the greatest: 6e-5, 2e-4, 2e-4, 4e-5
    for found, expected in (
        (loads.peak_force, force.max(axis=0)),
        (loads.impulse, seconds * trapezoid(force)),
        (loads.contact_fraction, trapezoid((gap < 0) * 1.0) / (len(gap) - 1)),
        (loads.penetration, (-gap).max(axis=0)),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    at = np.argmax(force.max(axis=(1, 2)))
    when = float(np.ravel(loads.peak_period)[np.argmax(loads.peak_force)])
    assert float(fine.period[at]) == pytest.approx(when, abs=1e-3)  # measured: 4e-5


def test_impulses_are_the_change_of_momentum():
    """Of a slipper on a straight level rail; the force along z alone turns its velocity."""
    scene = sj.Scene(
        speed=1000.0,
        slipper=sj.Slipper(14.0, (0.051, 0.060, 0.086), 0.2),
        section=sj.paper_section(1e-3),
        track=sj.StraightTrack(),
        contact=sj.HertzSpring(1e8),
    )
    found = sj.simulate(scene, 1, steps_per_period=1600, start=sj.Motion(v_z=-0.5))
    impulse = np.asarray(found.loads.impulse[0]).sum(axis=0)  # over the ends
    normals = np.asarray(scene.section.normals)
    m = found.state.motion
    changes = 14.0 * (m.v_y[-1] - m.v_y[0]), 14.0 * (m.v_z[-1] - m.v_z[0])
    np.testing.assert_allclose(impulse @ normals, changes, atol=1e-5)  # measured: 2e-8 N s, of 13


def test_adaptive_runs_have_the_same_peak():
    adaptive = sj.simulate(
        sj.paper_scene(), PERIODS, solver=sj.Tsit5(), stepsize_controller=sj.AdaptiveSteps(1e-7), saves_per_period=1
    )
    fine = sj.simulate(sj.paper_scene(), PERIODS, steps_per_period=1600)
    assert float(adaptive.peak.force) == pytest.approx(float(fine.peak.force), rel=1e-3)


@pytest.mark.parametrize("record", ["sections", "history"])
def test_sweeps_have_the_loads_of_simulate(record):
    grid = {"speed": [1250.0, 1500.0]}
    ds = sj.sweep(sj.paper_scene(), grid, record=record, transient=0, periods=PERIODS, steps_per_period=100)
    assert ds["peak_force"].dims == ("speed", "end", "point")
    one = sj.simulate(sj.paper_scene(1500.0), PERIODS, steps_per_period=100).to_xarray()
    for name in ("peak_force", "peak_period", "impulse", "contact_fraction", "penetration"):
        np.testing.assert_allclose(ds[name].values[1], one[name].values, rtol=1e-9, err_msg=name)
        assert ds[name].attrs == one[name].attrs


def test_loads_can_be_switched_off():
    found = sj.simulate(sj.paper_scene(), 1, steps_per_period=50, loads=False)
    assert found.loads is None
    assert "peak_force" not in found.to_xarray()
    with pytest.raises(ValueError, match="`loads` must be True"):
        _ = found.peak


@pytest.mark.parametrize("record", ["sections", "history"])
def test_loads_of_sweeps_can_be_switched_off(record):
    grid, options = {"speed": [1250.0]}, dict(transient=0, periods=1, steps_per_period=50, record=record)
    with_loads = sj.sweep(sj.paper_scene(), grid, **options)
    without = sj.sweep(sj.paper_scene(), grid, loads=False, **options)
    names = {"peak_force", "peak_period", "impulse", "contact_fraction", "penetration"}
    assert set(with_loads) - set(without) == names
    np.testing.assert_allclose(without["v_y"], with_loads["v_y"], rtol=1e-12)


def test_gradients_of_the_peak_force_in_both_modes():
    names = ("speed", "clearance", "length", "stiffness", "restitution")

    @jax.jit
    def peak(values):
        scene = sj.paper_scene().replace(**dict(zip(names, values, strict=True)))
        return sj.simulate(scene, 2, steps_per_period=100).peak.force

    at = jnp.array([float(sj.paper_scene().value(name)) for name in names])
    forward, reverse = jax.jit(jax.jacfwd(peak))(at), jax.jit(jax.grad(peak))(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    for k, slope in enumerate(forward):
        h = at * 1e-5 * (jnp.arange(len(names)) == k)
        difference = (peak(at + h) - peak(at - h)) / (2 * h[k])
        np.testing.assert_allclose(slope, difference, rtol=1e-5)  # measured: 1e-8 to 4e-7


def test_an_error_probe_tells_good_steps_from_bad_solvers():
    good = sj.simulate(sj.paper_scene(), 4, probe=2)
    assert int(good.status) == Status.FINITE
    assert np.asarray(good.probe.period).tolist() == [0, 3]
    assert float(good.probe.error.max()) < 1e-3  # measured: 2.4e-4 at 50 steps
    assert float(good.probe.peak_error.max()) < 1e-3
    attrs = good.to_xarray().attrs
    assert attrs["probe_error [scales]"] == float(good.probe.error.max())
    bad = sj.simulate(sj.paper_scene(), 2, solver=diffrax.Euler(), steps_per_period=200, probe=2)
    assert int(bad.status) == Status.INACCURATE
    adaptive = dict(solver=sj.Tsit5(), stepsize_controller=sj.AdaptiveSteps(1e-5))
    assert float(sj.simulate(sj.paper_scene(), 2, probe=1, **adaptive).probe.error[0]) < 1e-2
    with pytest.raises(ValueError, match="`probe` must be 0 under jit"):
        jax.jit(lambda v: sj.simulate(sj.paper_scene(v), 1, probe=1).peak.force)(1250.0)


def test_other_speeds_and_numbers_of_steps_compile_nothing_more():
    run = lambda speed, steps: sj.simulate(
        sj.paper_scene(speed), 12, steps_per_period=steps, probe=2
    ).status.block_until_ready()
    run(1250.0, 150)
    run(1251.0, 150)
    with compilations() as compiled:
        run(1300.0, 150)
        run(1300.0, 200)
    assert not compiled


def test_touching_is_needed_and_deep_penetration_is_flagged():
    still = sj.Motion()
    apart = sj.simulate(sj.paper_scene(clearance=5e-3, amplitude=1e-4, roll_amplitude=0.0), 1, start=still)
    assert int(apart.status) == Status.NO_CONTACT
    assert float(apart.peak.force) == 0
    assert bool(jnp.isnan(apart.peak.period))
    soft = sj.simulate(sj.paper_scene(stiffness=1e5), 1, start=sj.Motion(v_z=5.0))
    assert int(soft.status) == Status.PRESSED_IN


def test_damping_that_the_steps_cannot_follow_is_flagged():
    """Restitution 0.2: the damping of a touchdown that is slow beside what presses it in."""
    scene = sj.paper_scene(400.0, 1e-3, 0.48, restitution=0.2, amplitude=3e-4)
    coarse = sj.simulate(scene, 2, steps_per_period=150)
    assert int(coarse.status) == Status.UNRESOLVED
    assert float(coarse.loads.stretch.max()) > 5
    chosen = sj.simulate(scene, 2, probe=2)
    assert int(chosen.status) == Status.FINITE
    fine = sj.simulate(scene, 2, steps_per_period=3200)
    assert float(chosen.peak.force) == pytest.approx(float(fine.peak.force), rel=0.01)
