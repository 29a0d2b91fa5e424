"""Slippers on rails that bend, against an integral equation, a sum of energies and finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.optimize import brentq

import slipperjax as sj
from slipperjax.model.kinematics import bent, contacts, rail_frame

from ..model.test_beam import MASS, STIFFNESS, beam

SLIPPER = 14.0
"""Mass of the slipper [kg]."""
pytestmark = [pytest.mark.full, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]


class FarRail(sj.Beam):
    """A rail whose ring hardly damps, for runs that end before waves come round, also short ones."""

    absorbed = 0.5
    even = 100.0


def dropped(stiffness, seconds, rail, length):
    """A slipper that falls on a straight rail at 1 m/s, without damping; its four points act as one spring."""
    scene = sj.paper_scene(length=length)
    law = sj.model.HertzSpring(stiffness / 4)
    scene = dataclasses.replace(
        scene, track=sj.model.StraightTrack(), contact=law, beam=rail, speed=1.0, window=seconds
    )
    start = sj.Motion(z=-scene.section.play[0], v_z=-1.0)
    steps = dict(steps_per_period=200, saves_per_period=200)
    return scene, sj.simulate(scene, start=start, periods=1, probe=0, **steps)


def by_volterra(stiffness, seconds, count):
    """Highest force [N] and last speed [m/s] of a mass that falls at 1 m/s through a spring on a free beam.

    The force is piecewise linear in time, and the kernels of mass and beam are integrated exactly.
    """
    step = seconds / count
    k = np.arange(count)
    power = lambda p: ((k + 1) ** p - k**p) / p
    older = lambda p: step ** (p + 1) * (power(p + 2) - k * power(p + 1))
    newer = lambda p: step ** (p + 1) * ((k + 1) * power(p + 1) - power(p + 2))
    beams = 1 / np.sqrt(2 * np.pi) / (STIFFNESS * MASS**3) ** 0.25
    before, now = (beams * weight(0.5) + weight(1) / SLIPPER for weight in (older, newer))
    force = np.zeros(count + 1)
    for i in range(1, count + 1):
        depth = i * step - np.dot(before[i - 1 :: -1], force[:i]) - np.dot(now[i - 1 : 0 : -1], force[1:i])
        law = lambda f, depth=depth: stiffness * max(depth - now[0] * f, 0.0) ** 1.5
        if depth > 0:
            force[i] = brentq(lambda f, law=law: law(f) - f, 0.0, law(0.0), xtol=1e-9)
    return force.max(), np.trapezoid(force, dx=step) / SLIPPER - 1.0


FREE = dict(bending_stiffness=(STIFFNESS,) * 2, mass=MASS, bed=(1.0, 1.0))
"""A rail with next to no bed."""
# Errors of force and rebound by the ring's damping. Measured at most 3.4e-4 and 3.5e-4, 1.1e-3 and 4.0e-3, 5.2e-3 and
# 1.5e-2.
ERRORS = [
    (FarRail(**FREE, ring=256.0, shortest=0.2), (6e-4, 6e-4)),
    (sj.Beam(**FREE, ring=256.0, shortest=0.2), (2e-3, 6e-3)),
    (sj.Beam(**FREE), (8e-3, 2.5e-2)),
]


@pytest.mark.parametrize(("stiffness", "seconds"), [(1e9, 3e-3), (1e10, 1.2e-3), (5e10, 6e-4)])
def test_impact_against_volterra(stiffness, seconds):
    """Highest force and rebound of an impact on a free beam, by the integral equation of its impulse response."""
    highest, rebound = by_volterra(stiffness, seconds, 2000)
    for rail, allowed in ERRORS:
        _, run = dropped(stiffness, seconds, rail, 0.005)
        # two points at each end
        force = 2 * np.asarray(run.loads.peak_force).sum(axis=(0, 1)).max()
        errors = np.array([force / highest - 1, float(run.end.motion.v_z) / rebound - 1])
        name = f"{type(rail).__name__}, ring of {rail.ring:g} m"
        print("\n{}: force and rebound have errors of {:.1e} and {:.1e}".format(name, *errors))
        assert np.all(np.abs(errors) < allowed)


@pytest.mark.parametrize(("stiffness", "seconds"), [(1e8, 8e-3), (5e10, 6e-4)])
def test_energy_of_an_impact(stiffness, seconds):
    """Energies of slipper, contacts, rail and what the bed takes sum to the slipper's at the start."""
    rail = beam()
    scene, run = dropped(stiffness, seconds, rail, 0.2)

    @jax.vmap
    def energies(state):
        m = state.motion
        gap = contacts(bent(rail_frame(scene, 0.0), state.rail), m).gap
        sprung = 0.4 * scene.contact.stiffness * jnp.sum(jnp.maximum(-gap, 0) ** 2.5)
        # without forces the energy of the rail falls by what the bed takes
        real, imag = state.rail.waves
        exponents, _ = rail.exponents(scene.speed)
        change = exponents[None] * (real + 1j * imag)
        energy = lambda waves: rail.energy(waves, scene.speed)[0]
        stored, loss = jax.jvp(energy, (state.rail.waves,), ((change.real, change.imag),))
        return SLIPPER * (m.v_y**2 + m.v_z**2) / 2 + sprung + stored, -loss

    held, loss = map(np.asarray, energies(run.state))
    lost = cumulative_simpson(loss, x=np.asarray(run.time), initial=0)
    print(f"\nenergy: error of {np.abs(2 / SLIPPER * (held + lost) - 1).max():.1e}")
    # 3e-7
    np.testing.assert_allclose(held + lost, SLIPPER / 2, rtol=3e-6)
    # much goes into the rail, or all parts but the slipper's would not be tested
    assert float(run.end.motion.v_z) < 0.9


def test_derivatives():
    """Derivatives by the rail's numbers, against central differences of the same run."""
    scene = dataclasses.replace(sj.paper_scene(stiffness=1e9), beam=beam(ring=16.0))
    names = ("beam.bending_stiffness.1", "beam.bed.1", "beam.mass")

    @jax.jit
    def highest(relative):
        changed = scene.replace(**{name: scene.value(name) * x for name, x in zip(names, relative, strict=True)})
        run = sj.simulate(changed, start=sj.table_2_start(), periods=1, steps_per_period=200, probe=0)
        return jnp.max(run.loads.peak_force)

    slopes = jax.jacfwd(highest)(np.ones(3))
    small = 1e-6 * np.eye(3)
    differences = [(highest(1 + d) - highest(1 - d)) / 2e-6 for d in small]
    np.testing.assert_allclose(slopes, differences, rtol=1e-4)
    assert np.all(np.abs(slopes) > 0)


def test_records_and_resuming():
    """Deflection and energy of a sweep; a run in two parts is the run in one."""
    scene = dataclasses.replace(sj.paper_scene(), beam=beam(ring=16.0))
    grid = {"speed": [1200.0, 1250.0]}
    options = dict(transient=1, periods=2, steps_per_period=50, probe=False)
    ds = sj.sweep(scene, grid, record=("rail_deflection", "rail_energy"), **options).ds
    rigid = sj.sweep(dataclasses.replace(scene, beam=None), grid, record="rail_deflection", **options).ds
    assert np.all(rigid.rail_deflection == 0)
    assert np.all(ds.rail_energy > 0)
    # a few times the deflection of a load at rest, of which the force is 10 to 100 kN
    assert np.all((ds.rail_deflection[..., 1] > 2e-5) & (ds.rail_deflection[..., 1] < 2e-3))
    whole = sj.simulate(scene, periods=2, steps_per_period=50, probe=0)
    first = sj.simulate(scene, periods=1, steps_per_period=50, probe=0)
    second = sj.simulate(scene, periods=1, steps_per_period=50, probe=0, start=first.end)
    for a, b in zip(jax.tree.leaves(whole.end), jax.tree.leaves(second.end), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_rails_of_a_sled():
    """Rails bend each under its own slippers: a level sled that falls on two rails stays level, with equal bends."""
    mounts = [sj.Mount(x, y, rail=rail) for x in (0.5, -0.5) for y, rail in ((0.9, "left"), (-0.9, "right"))]
    sled = sj.Sled(mass=60.0, inertia=(20.0, 20.0, 30.0), mounts=mounts)
    level = sj.model.TwoRails(sj.model.StraightTrack(), sj.model.StraightTrack())
    scene = dataclasses.replace(
        sj.paper_scene(), slipper=sled, track=level, beam=beam(ring=16.0), speed=1.0, window=4e-3
    )
    run = sj.simulate(scene, start=sj.Motion(z=-5e-4, v_z=-1.0), periods=1, steps_per_period=50, probe=0)
    rail = run.end.rail
    deflection = np.asarray(rail.deflection[1]).reshape(2, 2, 2)
    np.testing.assert_allclose(deflection[:, 0], deflection[:, 1], rtol=1e-9)
    assert np.all(deflection != 0)
    left, right = np.asarray(scene.beam.energy(rail.waves, 1.0))
    assert left == pytest.approx(right, rel=1e-9)


def test_order():
    """Errors fall with the steps as on a rigid rail, also where the rail rolls and its normals turn."""
    scene, speeds = dataclasses.replace(sj.paper_scene(), beam=sj.Beam.crane_rail()), np.linspace(900.0, 1500.0, 8)
    options = dict(start=sj.table_2_start(), transient=0, periods=1, record="strobe", probe=False)

    def ends(steps):
        return sj.sweep(scene, {"speed": speeds}, steps_per_period=steps, **options)["strobe"].values[:, -1]

    exact = ends(3200)
    scales = np.array([1e-3] * 2 + [1e-2] * 3 + [1.0] * 2 + [10.0] * 3)
    error = lambda steps: np.median(np.max(np.abs(ends(steps) - exact) / scales, axis=-1))
    # 1.7e-6 and 6.5e-8; 1.5e-6 with four times the steps if the turning of deflections is left out
    assert error(100) < 5e-6
    assert error(400) < 2e-7
