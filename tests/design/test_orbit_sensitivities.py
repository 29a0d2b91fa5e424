"""Derivatives on orbits over a grid, against orbits found anew."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design import OrbitSensitivities
from slipperjax.model.quantities import MOTION_NUMBERS

STEPS = 50
NAMES = ("clearance", "length")


@pytest.mark.full
def test_slopes_over_a_grid_are_those_of_orbits_found_anew():
    record = OrbitSensitivities(objectives=("peak_force",), parameters=NAMES)
    options = dict(record=record, steps_per_period=STEPS, transient=60, periods=1, progress=False)
    grid = sj.sweep(sj.paper_scene(), {"speed": [1250.0, 1500.0]}, **options)
    assert grid["orbit_peak_force_slope"].dims == ("speed", "parameter")
    assert grid["parameter_unit"].values.tolist() == ["m", "m"]
    assert np.isfinite(grid["orbit_state_slope"]).all()
    scene = sj.paper_scene(1500.0)
    start = sj.periodic_orbit(scene, steps_per_period=STEPS)
    at_z = list(MOTION_NUMBERS).index("z")
    for name in NAMES:
        value = float(scene.value(name))
        ends = []
        for side in (-1, 1):
            near = scene.replace(**{name: value * (1 + side * 1e-5)})
            orbit = sj.periodic_orbit(near, start=start.state, steps_per_period=STEPS)
            peaks = orbit.trajectory(loads=True).loads.peak_force
            ends.append([float(np.max(peaks)), float(orbit.state.motion.z)])
        found = grid.sel(speed=1500.0, parameter=name)
        ours = [found["orbit_peak_force_slope"], found["orbit_state_slope"].values[at_z]]
        np.testing.assert_allclose(ours, np.subtract(*ends[::-1]) / (2e-5 * value), rtol=1e-5)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="`objectives` must be one of"):
        OrbitSensitivities(objectives=("peak_farce",))
    record = OrbitSensitivities(parameters=("speeed",))
    with pytest.raises(ValueError, match="`speeed` is no parameter"):
        sj.sweep(sj.paper_scene(), {"speed": [1250.0]}, record=record)
