"""The compiled right-hand side against plain NumPy, written from the paper's equations with Euler angles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.dynamics import Args

Y = np.array([0.03, 0.048, 0.048, 0.0445, 0.029, -0.029, -0.0445, -0.048, -0.048, -0.03])
Z = np.array([0.013, 0.0055, -0.0145, -0.0249, -0.029, -0.029, -0.0249, -0.0145, 0.0055, 0.013])
PARTNER = dict(zip("ABCDEFGHIJ", "JCBEDGFIHA", strict=True))  # the other corner of each point's face
NAMES = "ABCDEFGHIJ"


def rotations(roll, pitch, yaw):
    c, s = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    return rz @ ry @ rx


def plain(t, angles, m, memory, speed, clearance, length):
    """Accelerations, shape (5,), contact forces [N], shape (20,), and their total, shape (3,), point by point."""
    amplitude, roll_amplitude, wave = 1e-3, np.radians(0.2), 8.0
    mass, inertia, stiffness = 14.0, np.array([0.051, 0.060, 0.086]), 1e8
    factor = 8 * 0.1 / (5 * 0.9)
    f = speed / wave
    rot = rotations(*angles)
    spin = np.array([m["w_x"], m["w_y"], m["w_z"]])
    centre, velocity = np.array([0.0, m["y"], m["z"]]), np.array([0.0, m["v_y"], m["v_z"]])

    def node(end):
        time = t / f - (length / speed if end else 0.0)
        s, rate = np.sin(2 * np.pi * f * time), 2 * np.pi * f * np.cos(2 * np.pi * f * time)
        place = np.array([(0.5 - end) * length, amplitude * s, amplitude * s])
        return place, amplitude * rate, rotations(roll_amplitude * s, 0, 0), roll_amplitude * rate

    def face_normal(k):  # in the section, out of the rail head
        other = NAMES.index(PARTNER[NAMES[k]])
        dy, dz = Y[other] - Y[k], Z[other] - Z[k]
        n = np.array([0.0, -dz, dy]) / np.hypot(dy, dz)
        outside = n[1] * (Y[k] + Y[other]) + n[2] * (Z[k] + Z[other] + 0.01)
        return n if outside > 0 else -n

    def rail_point(k, end):
        place, _, turn, _ = node(end)
        return place + turn @ (np.array([0.0, Y[k], Z[k]]) - clearance / 2 * face_normal(k))

    total, moment, forces = np.zeros(3), np.zeros(3), []
    for end in (0, 1):
        place, rate, _, roll_rate = node(end)
        for k in range(10):
            other = NAMES.index(PARTNER[NAMES[k]])
            n = np.cross(rail_point(other, end) - rail_point(k, end), rail_point(k, 1) - rail_point(k, 0))
            n /= np.linalg.norm(n)
            outward = node(end)[2] @ face_normal(k)
            n = n if n @ outward > 0 else -n
            arm = rot @ np.array([(0.5 - end) * length, Y[k], Z[k]])
            rail = rail_point(k, end)
            gap = n @ (centre + arm - rail)
            rail_velocity = np.array([0.0, rate, rate]) + np.cross([roll_rate, 0, 0], rail - place)
            gap_rate = n @ (velocity + np.cross(rot @ spin, arm) - rail_velocity)
            force = 0.0
            if gap < 0:
                ratio = gap_rate * memory[10 * end + k] if memory[10 * end + k] < 0 else 1.0
                force = max(stiffness * (-gap) ** 1.5 * (1 + factor * ratio), 0.0)
            forces.append(force)
            total += force * n
            moment += np.cross(arm, force * n)
    spin_rate = (rot.T @ moment - np.cross(spin, inertia * spin)) / inertia
    return np.concatenate([total[1:] / mass, spin_rate]), np.array(forces), total


@sj.jit
def compiled(t, scene, state):
    return sj.model.reactions(t, state, Args(scene)), sj.model.vector_field(scene).evaluate(
        t, state, Args(scene)
    ).motion


@pytest.mark.parametrize("seed", range(4))
def test_compiled_right_hand_side_is_the_papers(seed):
    rng = np.random.default_rng(seed)
    speed, clearance, length = rng.uniform(100, 2500), rng.uniform(0, 3e-3), rng.uniform(0.1, 0.5)
    angles = rng.normal(size=3) * 0.02
    m = dict(zip(("y", "z", "v_y", "v_z", "w_x", "w_y", "w_z"), rng.normal(size=7), strict=True))
    m["y"], m["z"] = m["y"] * 2e-3, m["z"] * 2e-3
    memory = np.where(rng.random(20) < 0.7, -rng.uniform(0.3, 3, 20), 0.0)
    t = rng.uniform(0, 5)
    scene = sj.paper_scene(speed, clearance, length)
    motion = sj.Motion.from_euler(roll=angles[0], pitch=angles[1], yaw=angles[2], **m)
    state = sj.State(jax.tree.map(jnp.asarray, motion), jnp.asarray(memory))
    got, rates = compiled(t, scene, state)
    acceleration, forces, total = plain(t, angles, m, memory, speed, clearance, length)
    assert np.sum(forces > 0) >= 2
    # measured: 2e-13 of the largest entry and less
    np.testing.assert_allclose(got.contact_force.ravel(), forces, rtol=1e-12, atol=1e-12 * forces.max())
    np.testing.assert_allclose(got.acceleration, acceleration, rtol=1e-12, atol=1e-12 * np.abs(acceleration).max())
    # the DAE's residual, Eq. (13) with (A4)-(A6): constraint reactions balance contact forces
    np.testing.assert_allclose(got.drive_force, -total[0], rtol=0, atol=1e-12 * forces.max())
    np.testing.assert_allclose(jnp.sum(got.node_force, 0), -total, rtol=0, atol=1e-12 * forces.max())
    found = np.array([getattr(rates, name) for name in ("v_y", "v_z", "w_x", "w_y", "w_z")]) / scene.period
    np.testing.assert_allclose(found, acceleration, rtol=1e-12, atol=1e-12 * np.abs(acceleration).max())
