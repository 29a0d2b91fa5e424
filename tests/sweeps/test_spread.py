"""Orbits of a plane found from one another, and runs from states of their own."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.recorders import coordinates
from slipperjax.flow.status import Status
from slipperjax.orbits.periodic import PeriodicOrbit
from slipperjax.solvers.named import resolve_solver
from slipperjax.sweeps.attractors import strobe_states
from slipperjax.sweeps.maps import rows_of, states_of
from slipperjax.sweeps.spread import spread_orbits, sweep_from

SCENE = sj.paper_scene()
SOLVER = resolve_solver(SCENE, None)
GRID = {"speed": np.array([1200.0, 1250.0, 1300.0]), "clearance": np.array([0.9e-3, 1e-3])}


@pytest.fixture(scope="module")
def orbit():
    return sj.periodic_orbit(SCENE, steps_per_period=50)


def test_rows_are_states():
    start = sj.initial_state(SCENE, sj.Motion())
    both = jax.tree.map(lambda a: np.stack([np.asarray(a), np.asarray(a) + 1]), start)
    rows = rows_of(both)
    assert rows.shape == (2, 30)
    for a, b in zip(jax.tree.leaves(states_of(rows, start)), jax.tree.leaves(both), strict=True):
        np.testing.assert_array_equal(a, b)


def test_wrong_arguments_are_named():
    number = jax.numpy.asarray
    rest = number(0.0), number(0), number(0), 1, 50, SOLVER
    orbit = PeriodicOrbit(SCENE, sj.initial_state(SCENE, sj.Motion()), number(np.zeros(30, complex)), *rest)
    with pytest.raises(ValueError, match="Argument `grid` must name two parameters, but names speed"):
        spread_orbits(SCENE, {"speed": [1250.0]}, orbit)
    with pytest.raises(ValueError, match="Argument `leap` must be positive"):
        spread_orbits(SCENE, GRID, orbit, leap=0.0)
    states = jax.tree.map(lambda a: np.asarray(a)[None], orbit.state)
    with pytest.raises(ValueError, match="Argument `states` must have 6 rows"):
        sweep_from(SCENE, GRID, states)


@pytest.mark.slow
def test_orbits_of_a_plane_are_those_of_single_searches(orbit):
    ds = spread_orbits(SCENE, GRID, orbit)
    assert (ds["status"] == Status.FINITE).all()
    assert ds["stable"].all()
    for speed, clearance in ((1200.0, 0.9e-3), (1300.0, 1e-3)):
        one = ds.sel(speed=speed, clearance=clearance)
        alone = sj.periodic_orbit(sj.paper_scene(speed, clearance), start=orbit.state, steps_per_period=50)
        np.testing.assert_allclose(one["state"].values[:10], jax.tree.leaves(alone.state.motion), atol=1e-8)
        largest = np.hypot(one["multiplier_real"], one["multiplier_imag"]).max()
        np.testing.assert_allclose(largest, np.abs(alone.multipliers).max(), rtol=1e-6)
    # a run that begins on an orbit stays there
    states = states_of(ds["state"].values.reshape(6, 30), orbit.state)
    run = sweep_from(SCENE, GRID, states, transient=0, periods=5, steps_per_period=50)
    last, places = strobe_states(run)[..., -1, :], coordinates(states).reshape(3, 2, 10)
    np.testing.assert_allclose(last, places, atol=1e-7)
    # orbits too far apart count as of another family
    alone = spread_orbits(SCENE, GRID, orbit, leap=1e-6)
    assert int((alone["status"] == Status.FINITE).sum()) == 1
    assert int((alone["status"] == Status.NOT_RUN).sum()) >= 2
