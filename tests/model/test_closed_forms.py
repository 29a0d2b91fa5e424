"""Motions with solutions in closed form: flight, impact, rest, energy, symmetry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.dynamics import Args, contact_forces
from slipperjax.model.kinematics import contacts, rail_frame

from ..common import FINEST, STEPS, among, elastic_energy, fine, finest
from ..systems.fields import depth, rebound


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_free_flight_keeps_momentum_and_energy():
    scene = sj.paper_scene(clearance=0.5)
    start = sj.Motion.from_euler(v_y=0.3, v_z=-0.7, w_x=9.0, w_y=4.0, w_z=-6.0, roll=0.1)
    m = fine(scene, start).state.motion
    time = np.arange(len(m.y)) / STEPS * float(scene.period)
    np.testing.assert_allclose(m.y, 0.3 * time, rtol=0, atol=1e-14)
    np.testing.assert_allclose(m.z, -0.7 * time, rtol=0, atol=1e-14)
    spin = np.stack([m.w_x, m.w_y, m.w_z]) * np.array([[0.051], [0.060], [0.086]])
    magnitude = np.linalg.norm(spin, axis=0)  # of the angular momentum; the spin varies, as its axis is not principal
    np.testing.assert_allclose(magnitude, magnitude[0], rtol=1e-12)
    assert np.ptp(m.w_x) > 0.01


def test_work_of_the_drive_is_stored_or_dissipated():
    scene = sj.paper_scene()
    trajectory = fine(scene)

    @sj.jit
    @jax.vmap
    def powers(phase, state):
        args, m = Args(scene, phase), state.motion
        frame = rail_frame(scene, phase)
        now = contacts(frame, m)
        force = contact_forces(scene, now, state.memory)
        elastic = contact_forces(scene, now, jnp.full(20, -1e-300))  # a ratio of zero: no damping
        rates = sj.model.vector_field(scene).evaluate(0.0, state, args).motion
        _, turning = jax.jvp(lambda p, m: contacts(rail_frame(scene, p), m).gap, (phase, m), (1.0, rates))
        inertia = scene.slipper.inertia
        kinetic = 0.5 * (14.0 * (m.v_y**2 + m.v_z**2) + inertia @ jnp.stack([m.w_x, m.w_y, m.w_z]) ** 2)
        stored = kinetic + jnp.sum(elastic_energy(scene, now.gap))
        # Eq. (8) omits the normal's rotation from the gap rate; its power is work of the track, too
        work = jnp.sum(force * frame.velocity) - jnp.sum(elastic * (turning / scene.period - now.rate))
        dissipated = -jnp.sum((force - elastic) * now.rate)
        return stored, work, dissipated

    stored, work, dissipated = powers(trajectory.period, trajectory.state)
    step = float(scene.period) / STEPS
    trapezoid = lambda p: np.concatenate([[0], np.cumsum((p[1:] + p[:-1]) / 2)]) * step
    drive, loss = trapezoid(np.asarray(work)), trapezoid(np.asarray(dissipated))
    residual = drive - loss - (np.asarray(stored) - stored[0])
    assert loss[-1] > 0.5 * abs(drive).max() > 1.0  # [J]: the terms of the balance are large
    assert np.abs(residual).max() < 2e-3 * abs(drive).max()  # a failure prints the measured value


@pytest.mark.parametrize("restitution", among({str(r): r for r in (0.2, 0.5, 0.9, 1.0)}, "0.2", "0.9"))
@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_impact_on_one_face_follows_the_laws_theory(restitution):
    """Vertical, on the top face: its four corners share the load, and nothing rotates."""
    gap, approach = 0.02, 1.0
    scene = sj.paper_scene(200.0, 2 * gap, amplitude=0.0, roll_amplitude=0.0, restitution=restitution)
    run = finest(scene, sj.Motion(z=-gap + 1e-4, v_z=-approach))
    factor = float(scene.contact.factor)
    expected = depth(factor, 14.0, approach, 4e8)
    np.testing.assert_allclose(float(np.max(run.loads.penetration[0])), expected, rtol=1e-5)
    np.testing.assert_allclose(float(run.state.motion.v_z[FINEST]), approach * rebound(factor), rtol=1e-5)


def test_factors_of_the_laws():
    c = 0.7
    assert sj.model.Flores(1e8, c).factor == pytest.approx(8 * (1 - c) / (5 * c))
    assert sj.model.HuntCrossley(1e8, c).factor == pytest.approx(1.5 * (1 - c))
    assert sj.model.LankaraniNikravesh(1e8, c).factor == pytest.approx(0.75 * (1 - c**2))
