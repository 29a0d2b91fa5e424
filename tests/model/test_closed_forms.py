"""Motions with solutions in closed form: flight and impact."""

import numpy as np
import pytest

import slipperjax as sj

from ..common import FINEST, STEPS, among, fine, finest
from ..systems.fields import depth, rebound


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_free_flight_keeps_momentum_and_energy():
    scene = sj.paper_scene(clearance=0.5)
    start = sj.Motion.from_euler(v_y=0.3, v_z=-0.7, w_x=9.0, w_y=4.0, w_z=-6.0, roll=0.1)
    m = fine(scene, start).state.motion
    time = np.arange(len(m.y)) / STEPS * float(scene.period)
    np.testing.assert_allclose(m.y, 0.3 * time, atol=1e-14)
    np.testing.assert_allclose(m.z, -0.7 * time, atol=1e-14)
    spin = np.stack([m.w_x, m.w_y, m.w_z]) * np.array([[0.051], [0.060], [0.086]])
    magnitude = np.linalg.norm(spin, axis=0)  # of the angular momentum; the spin varies, as its axis is not principal
    np.testing.assert_allclose(magnitude, magnitude[0], rtol=1e-12)
    assert np.ptp(m.w_x) > 0.01


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
