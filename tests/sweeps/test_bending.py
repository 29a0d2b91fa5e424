"""Rails that bend in other calls: each takes a beam, or refuses it in one line; rigid rails are as before."""

import dataclasses

import jax
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import start_of

from ..common import compilations
from ..model.test_beam import beam

RIGID = sj.paper_scene()
BENDS = dataclasses.replace(RIGID, beam=beam(ring=16.0))
STEPS = dict(steps_per_period=50)


def test_refusals():
    """Before any run is compiled."""
    signal = xr.Dataset({"front": ("time", np.zeros(9), {"units": "m/s^2"})}, {"time": np.linspace(0, 5e-3, 9)})
    signal["time"].attrs["units"] = "s"
    sensors = [sj.model.Sensor("front")]
    calls = [
        lambda: sj.orbit_sweep(BENDS, {"speed": [1200.0]}),
        lambda: sj.continue_orbit(BENDS, "speed", (1200.0, 1300.0)),
        lambda: sj.fit(BENDS, signal, {"restitution": (0.5, 0.95)}, sensors),
        # with a solver that can follow rails that bend
        lambda: sj.fit(BENDS, signal, {"restitution": (0.5, 0.95)}, sensors, solver="ImpulseRK4"),
    ]
    for call in calls:
        with (
            compilations() as compiled,
            pytest.raises(ValueError, match=r"`scene` must have rigid rails for .*, but has Beam"),
        ):
            call()
        # 0.05 s, of checks of the scene; programs of runs take seconds
        assert sum(compiled) < 1.0


@pytest.mark.full
def test_rigid_rails_are_the_same_program():
    """A scene whose beam is taken away again has the states and the program of one that never had a beam."""
    off = dataclasses.replace(BENDS, beam=None)
    state = sj.initial_state(RIGID)
    assert state.rail is None
    assert jax.tree.structure(off) == jax.tree.structure(RIGID)
    of_rigid, of_off = (
        str(jax.make_jaxpr(lambda s, scene=scene: sj.period_map(scene, s, **STEPS))(state)) for scene in (RIGID, off)
    )
    assert of_rigid == of_off
    of_beam = str(jax.make_jaxpr(lambda s: sj.period_map(BENDS, s, **STEPS))(sj.initial_state(BENDS)))
    # waves are numbers of 24 modes
    assert "2,24]" in of_beam
    assert "2,24]" not in of_rigid


@pytest.mark.full
def test_results_keep_the_waves_of_their_start():
    """A run continues from a dataset to the bit, and refuses the waves of another beam."""
    run = lambda start, scene=BENDS: sj.simulate(scene, 1, start=start, probe=0, **STEPS)
    first = run(sj.table_2_start())
    second = run(first.end)
    again = run(start_of(second.ds))
    for a, b in zip(jax.tree.leaves(again.end), jax.tree.leaves(second.end), strict=True):
        np.testing.assert_array_equal(a, b)
    # the waves matter
    assert float(run(dataclasses.replace(first.end, rail=None)).end.motion.v_z) != float(second.end.motion.v_z)
    with pytest.raises(ValueError, match=r"`start` must have waves of the scene's beam, of shape \(1, 2, 2, 48\)"):
        run(first.end, dataclasses.replace(RIGID, beam=beam(ring=32.0)))


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_runs_with_a_programme_and_their_environment():
    """A run that gains speed, and the vibration of a place on its slipper."""
    stages = [sj.Stage(100.0, length=16.0), sj.Stage(0.0, length=16.0)]
    speed = sj.SpeedProgramme.stages(stages, start=1000.0)
    records = ["peak_force", "rail_energy", "rail_deflection", "body_acceleration"]
    of = lambda scene: sj.run(scene, length=32.0, window=8.0, speed=speed, record=records, **STEPS)
    bends, rigid = of(BENDS), of(RIGID)
    assert np.all(bends.ds["rail_energy"] > 0)
    assert np.all(rigid.ds["rail_energy"] == 0)
    shocks = [sj.environment(run, [(0.05, 0.0, 0.02)], low=200.0).ds["shock_response"] for run in (bends, rigid)]
    assert np.all(np.isfinite(shocks))
    assert not np.allclose(*shocks, rtol=0.01)


@pytest.mark.full
def test_designs_compared():
    """Numbers of a comparison are those of separate runs; play matters."""
    scene = dataclasses.replace(BENDS, track=sj.RandomTrack.sled(length=250.0), speed=600.0)
    options = dict(length=16.0, window=8.0, start=sj.table_2_start(), **STEPS)
    plays = [0.8e-3, 1.5e-3]
    found = sj.compare(scene, {"clearance": plays}, rails=8, quantiles=[0.5], record="peak_force", **options)["runs"]
    for play, runs in zip(plays, found.values, strict=True):
        alone = sj.run(scene.replace(clearance=play), {"track.seed": range(8)}, record="peak_force", **options)
        highest = alone["peak_force"].values.reshape(8, -1).max(axis=1)
        # equal to the bit; another batch may round differently
        np.testing.assert_allclose(runs[:, 0], highest, rtol=1e-6)
    assert np.all(np.abs(np.diff(found, axis=0)) > 1.0)
