"""Periodic orbits of a grid as one batch."""

import equinox as eqx
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.model.layout import StateLayout

from ..common import columns

SCENE, STEPS = sj.paper_scene(), 50
GRID = {"speed": [1150.0, 1250.0, 1500.0, 2300.0]}


@pytest.fixture(scope="module")
def found():
    return sj.orbit_sweep(SCENE, GRID, steps_per_period=STEPS, max_iterations=25)


def strobe(scene, state, calls):
    """Coordinates once per period, by calls of the program of test_sweep."""
    rows = []
    for _ in range(calls):
        run = sj.simulate(scene, 20, steps_per_period=STEPS, start=state)
        rows, state = [*rows, columns(run)[STEPS::STEPS]], run.end
    return np.concatenate(rows)


@pytest.mark.full
@pytest.mark.parametrize("speed", GRID["speed"][:3])
def test_orbits_recur_and_neighbours_approach_as_their_multipliers_say(found, speed):
    case, scene = found.sel(speed=speed), SCENE.replace(speed=speed)
    assert (int(case["status"]), bool(case["stable"])) == (Status.FINITE, True)
    assert float(case["residual"]) < 1e-10
    state = StateLayout.of(scene).unpack(case["orbit_state"].values)
    orbit = case["orbit"].values
    # measured: 1e-13
    np.testing.assert_allclose(strobe(scene, state, 1), np.tile(orbit, (20, 1)), rtol=0, atol=1e-10)
    near = lambda shift: eqx.tree_at(lambda s: s.motion.v_y, state, state.motion.v_y + shift)
    # on both sides, so that second orders cancel and the shift may be well above rounding
    apart = (strobe(scene, near(1e-3), 5) - strobe(scene, near(-1e-3), 5))[80:98]
    # with a complex pair of multipliers mu, x'' = 2 Re(mu) x' - |mu|^2 x; others have died out
    pair = np.stack([apart[1:-1].ravel(), apart[:-2].ravel()], axis=1)
    size = -np.linalg.lstsq(pair, apart[2:].ravel(), rcond=None)[0][1]
    # measured: 5e-8
    np.testing.assert_allclose(float(case["orbit_exponent"]), np.log(size) / 2, rtol=0, atol=1e-7)


@pytest.mark.full
def test_cases_without_a_stable_orbit_are_marked(found):
    unstable = found.sel(speed=2300.0)  # found from a chaotic motion
    assert (int(unstable["status"]), bool(unstable["stable"])) == (Status.FINITE, False)
    assert float(unstable["orbit_exponent"]) > 0
    few = sj.orbit_sweep(SCENE, {"speed": [1250.0]}, steps_per_period=STEPS, max_iterations=1)
    assert (int(few["status"][0]), bool(few["stable"][0])) == (Status.NO_ORBIT, False)
    assert np.isnan(few["multiplier_real"]).all()
    assert np.isnan(few["orbit_exponent"]).all()


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="`period` must be a whole number of 1 or more, but is 0"):
        sj.orbit_sweep(SCENE, GRID, period=0)
    with pytest.raises(ValueError, match="must have a track that recurs"):
        sj.orbit_sweep(sj.paper_scene(wavelengths=(8.0, 3.0)), GRID)
