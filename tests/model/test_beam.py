"""A rail that bends, alone: closed forms of a beam on an elastic bed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import slipperjax as sj

STIFFNESS = 6.3e6
"""Bending stiffness [N m^2]."""
MASS = 85.0
"""Mass per length [kg/m]."""
BED = 1e8
"""Stiffness of the bed per length [N/m^2]."""
DAMPING = 2 * 0.02 * np.sqrt(MASS * BED)
"""Damping of the bed per length [N s/m^2]."""
CRITICAL = (4 * BED * STIFFNESS / MASS**2) ** 0.25
"""Speed at which waves travel with a load [m/s]."""
AT_REST = (BED / (4 * STIFFNESS)) ** 0.25 / (2 * BED)
"""Deflection by a load at rest [m/N]."""


def beam(damping=DAMPING, **settings):
    return sj.Beam((STIFFNESS,) * 2, MASS, (BED,) * 2, (damping,) * 2, **settings)


def deflections(rail, speed, seconds, forces):
    """Vertical deflection [m], rate [m/s] and energy [J] after each step under forces [N] that are constant in it."""
    step = rail.step(np.ones((1, 1)), jnp.zeros(1), speed, seconds)

    def one(state, force):
        state = step.end(step.free(state.waves), *(share * force * jnp.ones((2, 1)) for share in (1.0, 0.5)))
        return state, (state.deflection[1, 0], state.rate[1, 0], rail.energy(state.waves, speed)[0])

    return map(np.asarray, jax.jit(lambda: jax.lax.scan(one, rail.at_rest(1, 1), jnp.asarray(forces)))()[1])


@pytest.mark.full
@pytest.mark.parametrize("ratio", [1e-3, 0.5, 0.8, 1.5, 2.0])
def test_moving_load(ratio):
    """A load that travels below or above the critical speed; compared with Fourier's integral."""
    speed = ratio * CRITICAL
    value = lambda k: (1 / (STIFFNESS * k**4 - MASS * (k * speed) ** 2 - 1j * DAMPING * k * speed + BED)).real / np.pi
    roots = np.roots([STIFFNESS, -MASS * speed**2, BED])
    peaks = sorted(np.sqrt(root.real) for root in roots if root.real > 0)
    exact = quad(value, 0, 200, limit=5000, points=peaks, epsabs=0)[0]
    if ratio == 1e-3:
        assert exact == pytest.approx(AT_REST, rel=1e-4)
    found, _, _ = deflections(beam(ring=512.0), speed, 2e-3, np.ones(500))
    # 8e-4 of the deflection at rest, of which waves below 0.4 m have 6e-4
    assert abs(found[-1] - exact) < 1e-3 * AT_REST


@pytest.mark.full
def test_impulse():
    """For short times the bed does not matter, and the deflection grows with the root of time."""
    seconds = 5e-7
    found, _, _ = deflections(beam(ring=256.0, shortest=0.05), 1.0, seconds, np.eye(1, 100)[0] / seconds)
    times = (np.arange(100) + 0.5) * seconds
    exact = np.sqrt(times / (2 * np.pi)) / (STIFFNESS * MASS**3) ** 0.25
    # 0.2 to 0.6 %, by the damping of the ring
    np.testing.assert_allclose(found[20:], exact[20:], rtol=1e-2)
    # the rate is the derivative of the deflection; central differences are wrong by 2e-6
    found, rates, _ = deflections(beam(), 1000.0, 1e-7, np.ones(300))
    np.testing.assert_allclose(np.gradient(found, 1e-7)[100:-1], rates[100:-1], rtol=1e-4)


@pytest.mark.full
def test_energy_of_a_load_at_rest():
    """Half the force times the deflection."""
    rail = beam()
    step = rail.step(np.ones((1, 1)), jnp.zeros(1), 1e-3, 10.0)
    load = jnp.array([[0.0], [1.0]])
    state = step.end(step.free(rail.at_rest(1, 1).waves), load, load / 2)
    deflection = float(state.deflection[1, 0])
    # 6e-4 by waves below 0.4 m
    assert deflection == pytest.approx(AT_REST, rel=1e-3)
    assert float(rail.energy(state.waves, 1e-3)[0]) == pytest.approx(deflection / 2, rel=1e-6)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: beam(ring=3.0), "ring"),
        (lambda: beam(damping=2 * np.sqrt(MASS * BED)), "damping"),
        (lambda: sj.Beam.crane_rail(100), "pounds_per_yard"),
        (lambda: dataclasses.replace(sj.paper_scene(), beam=1.0), "beam"),
    ],
)
def test_wrong_beams(call, named):
    with pytest.raises(ValueError, match=named):
        call()


def test_refusals():
    """Solvers that do not know the rails, and orbits, refuse before anything is compiled."""
    scene = dataclasses.replace(sj.paper_scene(), beam=sj.Beam.crane_rail())
    with pytest.raises(ValueError, match="`solver` must be ImpulseRK4"):
        sj.simulate(scene, solver="RK4", periods=1)
    with pytest.raises(ValueError, match="rigid rails"):
        sj.periodic_orbit(scene)


def test_scene_file(tmp_path):
    """A file gives the same beam back."""
    scene = dataclasses.replace(sj.paper_scene(), beam=sj.Beam.crane_rail())
    scene.to_toml(tmp_path / "scene.toml")
    again = sj.load(tmp_path / "scene.toml")
    assert repr(again.scene.beam) == repr(scene.beam)
