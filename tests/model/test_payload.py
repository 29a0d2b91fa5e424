"""A sled on the slipper: closed forms of two masses on a spring, files, derivatives and runs."""

import dataclasses

import diffrax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import run_attributes
from slipperjax.sweeps.grid import Cases

SLED = sj.model.Payload(100.0, [2e6, 8e6], [0.0, 0.0])
FREE = dataclasses.replace(sj.paper_scene(clearance=30e-3), track=sj.model.StraightTrack(), payload=SLED)
IMPLICIT = sj.solvers.Latching(diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-10, atol=1e-12)))


def two_masses(seconds):
    """Displacements of slipper and sled along z, from a push of the slipper of 1 m/s: centre of mass and spring."""
    m, sled = 14.0, 100.0
    rate = np.sqrt(8e6 * (1 / m + 1 / sled))
    centre, apart = m / (m + sled) * seconds, -np.sin(rate * seconds) / rate
    return centre - sled / (m + sled) * apart, centre + m / (m + sled) * apart


@pytest.mark.full
@pytest.mark.parametrize("solver", ["RK4", "ImpulseRK4", IMPLICIT])
def test_two_masses_swing_as_in_closed_form(solver):
    run = sj.simulate(
        FREE, 2, start=sj.Motion(v_z=1.0, payload=sj.model.PayloadMotion()), steps_per_period=400, solver=solver
    )
    slipper, sled = two_masses(float(run.time[-1]))
    # measured 3e-9 with RK4 of the 4 mm that they move
    np.testing.assert_allclose([run.end.motion.z, run.end.motion.payload.z], [slipper, sled], rtol=1e-6, atol=1e-12)
    with pytest.raises(ValueError, match="Argument `solver` must be an explicit one for a scene with a sled"):
        sj.simulate(FREE, 1, solver="Rodas4", steps_per_period=10)


def test_dampers_and_stops_add_their_forces():
    sled = sj.model.Payload(100.0, [1e6, 2e6], [1e3, 2e3], [1e-3, 2e-3], [1e8, 1e8])
    force = sled.force(jnp.array([0.5e-3, -2.5e-3]), jnp.array([0.1, -0.2]))
    np.testing.assert_allclose(force, [500.0 + 100.0, -5000.0 - 400.0 - 5e4])
    np.testing.assert_allclose(sled.force(jnp.zeros(2), jnp.zeros(2)), 0.0)
    for travel in ([1.0, 1.0], [1e-4, 1e-4]):  # with and without the stops
        sled = sj.model.Payload(100.0, [1e6, 2e6], [0.0, 0.0], travel, [1e8, 1e8])
        rest = sled.force(jnp.array([0.0, float(sled.sag(9.81))]), jnp.zeros(2))
        np.testing.assert_allclose(rest, [0.0, -981.0], rtol=1e-12)
    with pytest.raises(ValueError, match="`travel` and `stop_stiffness` must be given together"):
        sj.model.Payload(100.0, [1e6, 2e6], travel=[1e-3, 1e-3])


def test_a_sled_begins_at_rest_on_its_spring():
    scene = dataclasses.replace(FREE, gravity=9.81)
    state = sj.initial_state(scene, sj.Motion(y=1e-3, v_y=0.5))
    rates = sj.model.vector_field(scene).evaluate(0.0, state, sj.model.Args(scene)).motion
    period = float(scene.period)
    np.testing.assert_allclose([rates.payload.v_y / period, rates.payload.v_z / period], 0.0, atol=1e-9)
    assert float(rates.v_z) / period == pytest.approx(-9.81 * 114 / 14)  # the whole weight
    assert float(sj.model.reactions(0.0, state, sj.model.Args(scene)).drive_force) == 0.0
    fast = dataclasses.replace(scene, speed=sj.SpeedProgramme([0.0, 100.0], [100.0, np.sqrt(100.0**2 + 2000.0)]))
    drive = sj.model.reactions(0.5, state, sj.model.Args(fast)).drive_force
    assert float(drive) == pytest.approx(114 * 10.0)


def test_a_sled_goes_on_from_its_state(tmp_path):
    state = sj.initial_state(FREE, sj.Motion(v_z=1.0, payload=sj.model.PayloadMotion(z=1e-3)))
    starts = Cases(FREE, {"clearance": [30e-3, 31e-3], "start_y": [1e-4]}, state).starts
    np.testing.assert_array_equal(starts.motion.payload.z, [1e-3, 1e-3])
    np.testing.assert_array_equal(starts.motion.y, [1e-4, 1e-4])
    ds = xr.Dataset(attrs=run_attributes(FREE, state, {"function": "run"}))
    assert float(sj.load(ds).start.motion.payload.z) == 1e-3
    # a scene without a sled leaves it aside
    assert sj.initial_state(sj.paper_scene(), state.motion).motion.payload is None


@pytest.mark.full
def test_runs_with_a_sled_record_its_springs_and_go_on():
    scene = dataclasses.replace(sj.paper_scene(), track=sj.RandomTrack.sled(length=300.0), payload=SLED, gravity=9.81)
    of = lambda length, **options: sj.run(scene, length=length, window=8.0, record="spring_force", **options)
    ds = of(48.0)
    assert ds["state"].sizes["number"] == 34
    # the weight of the sled at rest, and what the rail adds: measured 0.98 to 4.4 kN
    assert bool(np.all(ds["spring_force"].sel(direction="vertical") > 900.0))
    first = of(16.0)
    rest = of(32.0, start=first)
    np.testing.assert_allclose(rest["spring_force"], ds["spring_force"][2:], rtol=1e-9)
    with pytest.raises(ValueError, match="Argument `record` must be another one where the scene has no sled"):
        sj.run(dataclasses.replace(scene, payload=None), length=8.0, window=8.0, record="spring_force")
