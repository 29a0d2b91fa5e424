"""The smallest shock that takes a slipper from its orbit, beside many random shocks."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj

STEPS = 64
SHOCKS = {"v_y": 0.1, "v_z": 0.1}
"""Velocities that count as a length of one [m/s]."""


@pytest.fixture(scope="module")
def orbit():
    """At 1850 m/s, where another orbit of period 1 swings sideways with 10 m/s."""
    start = dataclasses.replace(sj.table_2_start(), y=0.2e-3, v_y=0.1)
    scene = sj.paper_scene(speed=1850.0)
    return sj.periodic_orbit(scene, start=start, transient=200, steps_per_period=STEPS)


@pytest.mark.full
def test_wrong_inputs(orbit):
    with pytest.raises(ValueError, match="`shocks` must name some of y, z, q_x"):
        sj.orbits.orbit_shock(orbit, {"speed": 1.0})
    with pytest.raises(ValueError, match="`v_y` must be positive, but is -1 m/s"):
        sj.orbits.orbit_shock(orbit, {"v_y": -1.0})
    lost = dataclasses.replace(orbit, status=8)
    with pytest.raises(ValueError, match="`orbit` must be stable"):
        sj.orbits.orbit_shock(lost, SHOCKS)


@pytest.mark.slow
def test_shock_beside_10000_random_shocks(orbit):
    shock = sj.orbits.orbit_shock(orbit, SHOCKS, longest=10.0, transient=150)
    change = shock.change.motion
    print(f"v_y {float(change.v_y):.6f} m/s, v_z {float(change.v_z):.6f} m/s, length {shock.length:.8f}", end=", ")
    print(f"returns {shock.returns:.8f}, by {shock.found}, angle {shock.angle:.1e}, period {shock.period}")
    assert shock.found == "gradient"
    assert shock.period == 1
    # random shocks, evenly in a disc that ends just behind the boundary
    generator = np.random.default_rng(0)
    lengths = 1.05 * shock.length * np.sqrt(generator.uniform(size=10_000))
    angles = generator.uniform(0, 2 * np.pi, 10_000)
    starts = {
        "start_v_y": float(orbit.state.motion.v_y) + 0.1 * lengths * np.cos(angles),
        "start_v_z": float(orbit.state.motion.v_z) + 0.1 * lengths * np.sin(angles),
    }
    swept = sj.sweep(
        orbit.scene, starts, start=orbit.state.motion, product=False, record="strobe", transient=150, periods=4,
        steps_per_period=STEPS,
    )  # fmt: skip
    away = np.abs(swept.ds["strobe"].values[:, -1, 5] - float(orbit.state.motion.v_y)) > 0.01
    print(f"{away.sum()} of 10000 leave, the least length is {lengths[away].min():.4f};", end=" ")
    print(f"{np.sum(lengths < shock.length)} were smaller than the smallest shock")
    assert lengths[away].min() >= shock.returns
    assert lengths[away].min() < 1.02 * shock.length
