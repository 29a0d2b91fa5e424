"""Periodic orbits of a grid as one batch."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.sweeps.maps import rows_of, states_of

SCENE = sj.paper_scene()
GRID = {"speed": [1150.0, 1250.0, 1500.0, 2300.0]}


@pytest.fixture(scope="module")
def found():
    return sj.orbit_sweep(SCENE, GRID, steps_per_period=100, max_iterations=25)


def test_cases_have_the_orbits_of_single_scenes(found):
    for speed in GRID["speed"][:3]:
        case = found.sel(speed=speed)
        single = sj.periodic_orbit(SCENE.replace(speed=speed), steps_per_period=100)
        assert int(case["status"]) == Status.FINITE
        assert float(case["residual"]) < 1e-10
        np.testing.assert_allclose(case["strobe"].sel(coordinate="v_y"), float(single.state.motion.v_y), atol=1e-8)
        # measured: 3e-9
        np.testing.assert_allclose(float(case["exponent"]), float(single.exponent), atol=1e-7)
        assert bool(case["stable"]) == single.stable


def test_a_case_without_an_orbit_is_marked(found):
    case = found.sel(speed=2300.0)
    single = sj.periodic_orbit(SCENE.replace(speed=2300.0), steps_per_period=100, transient=60)
    if int(case["status"]) == Status.FINITE:  # an unstable one, found from a chaotic motion
        assert not bool(case["stable"])
    else:
        assert int(case["status"]) == Status.NO_ORBIT
        assert np.isnan(case["exponent"])
    assert int(single.status) in (Status.FINITE, Status.NO_ORBIT)


def test_few_iterations_are_not_enough():
    ds = sj.orbit_sweep(SCENE, {"speed": [1250.0]}, steps_per_period=100, max_iterations=1)
    assert int(ds["status"][0]) == Status.NO_ORBIT
    assert np.isnan(ds["multiplier_real"]).all()
    assert not bool(ds["stable"][0])


def test_a_result_is_computed_again_to_the_same_bits(found):
    again = sj.repeat(found)
    np.testing.assert_array_equal(again["state"], found["state"])


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="`period` must be a whole number of 1 or more, but is 0"):
        sj.orbit_sweep(SCENE, GRID, period=0)
    with pytest.raises(ValueError, match="must have a track that recurs"):
        sj.orbit_sweep(sj.paper_scene(wavelengths=(8.0, 3.0)), GRID)


def test_rows_are_states():
    start = sj.initial_state(SCENE, sj.Motion())
    both = jax.tree.map(lambda a: np.stack([np.asarray(a), np.asarray(a) + 1]), start)
    rows = rows_of(both)
    assert rows.shape == (2, 30)
    for a, b in zip(jax.tree.leaves(states_of(rows, start)), jax.tree.leaves(both), strict=True):
        np.testing.assert_array_equal(a, b)
