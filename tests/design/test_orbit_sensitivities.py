"""Derivatives on orbits over a grid, against single orbits and their sensitivities."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design import OrbitSensitivities
from slipperjax.model.quantities import MOTION_NUMBERS

STEPS = 50
NAMES = ("clearance", "length")


@pytest.fixture(scope="module")
def grid():
    record = OrbitSensitivities(objectives=("peak_force",), parameters=NAMES)
    options = dict(record=record, steps_per_period=STEPS, transient=60, periods=1, progress=False)
    return sj.sweep(sj.paper_scene(), {"speed": [1250.0, 1500.0]}, **options)


@pytest.mark.full
def test_slopes_over_a_grid_are_those_of_orbits_found_anew(grid):
    case = grid.sel(speed=1500.0)
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
        slope = np.subtract(*ends[::-1]) / (2e-5 * value)
        found = case.sel(parameter=name)
        ours = [found["orbit_peak_force_slope"], found["orbit_state_slope"].values[at_z]]
        np.testing.assert_allclose(ours, slope, rtol=1e-5)


@pytest.mark.full
def test_every_case_is_that_of_its_own_scene(grid):
    assert grid["orbit_peak_force_slope"].dims == ("speed", "parameter")
    assert grid["parameter_unit"].values.tolist() == ["m", "m"]
    assert np.isfinite(grid["orbit_state_slope"]).all()
    assert not np.allclose(grid["orbit_peak_force_slope"][0], grid["orbit_peak_force_slope"][1])


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="`objectives` must be one of"):
        OrbitSensitivities(objectives=("peak_farce",))
    record = OrbitSensitivities(parameters=("speeed",))
    with pytest.raises(ValueError, match="`speeed` is no parameter"):
        sj.sweep(sj.paper_scene(), {"speed": [1250.0]}, record=record)
