"""The slipper around the rail head: geometry as the model has it, magnified, with forces to scale."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.animation import PillowWriter
from matplotlib.colors import to_hex
from PIL import Image
from scipy.spatial.transform import Rotation

import slipperjax as sj
from slipperjax import plots
from slipperjax.model.kinematics import contacts, face_offsets, rail_frame
from slipperjax.plots.sections import contour, default_magnification

from .shown import labels

SCENE = sj.paper_scene(speed=1750.0)
NORMALS, RAIL = np.asarray(SCENE.section.normals), np.asarray(SCENE.section.track_points)


@pytest.fixture(scope="module")
def run():
    return sj.simulate(SCENE, 3, steps_per_period=50)


def points_of(ax):
    """Gives the slipper's points as drawn [mm]."""
    return np.asarray(ax.collections[0].get_offsets())


def arrows_of(ax):
    """Gives the arrows [mm]."""
    quiver = ax.collections[1]
    return np.stack([quiver.U, quiver.V], axis=1)


def drawn_gaps(ax, rail=RAIL):
    """Gives distances of the drawn points from the drawn rail head along the normals [m]."""
    return 1e-3 * np.sum((points_of(ax) - 1e3 * rail) * NORMALS, axis=1)


def test_offsets_along_the_faces_are_those_of_the_vectors():
    angles = dict(roll=0.03, pitch=-0.004, yaw=0.006)
    motion = sj.Motion.from_euler(y=2e-3, z=-1e-3, **angles)
    turn = Rotation.from_euler("ZYX", [angles["yaw"], angles["pitch"], angles["roll"]]).as_matrix()

    @jax.jit
    def found(motion):
        rails = [SCENE.track.irregularity(jnp.asarray(0.3 * 8.0 - 0.2 * k)) for k in range(2)]
        return face_offsets(SCENE, 0.3, motion), contacts(rail_frame(SCENE, 0.3), motion).gap, rails

    offset, gap, rails = found(motion)
    for k, (x, rail) in enumerate(zip((0.1, -0.1), rails, strict=True)):
        c, s = np.cos(rail.roll), np.sin(rail.roll)
        rolled = np.array([[c, -s], [s, c]])
        points = np.column_stack([np.full(10, x), SCENE.section.points])
        apart = (points @ turn.T)[:, 1:] + [2e-3, -1e-3] - [rail.lateral, rail.vertical] - RAIL @ rolled.T
        along = np.column_stack([NORMALS[:, 1], -NORMALS[:, 0]]) @ rolled.T
        here = slice(10 * k, 10 * k + 10)
        np.testing.assert_allclose(offset[here], np.sum(apart * along, axis=1), rtol=0, atol=1e-12)
        # what is left is the normal's tilt along x, Eq. (4)
        np.testing.assert_allclose(gap[here], np.sum(apart * (NORMALS @ rolled.T), axis=1), atol=2e-5)
        assert np.abs(offset[here]).max() > 1e-3


@pytest.mark.full
def test_each_frame_has_magnified_gaps_forces_at_one_scale_and_its_time(run, tmp_path):
    animation = plots.animate(run, magnify=2.5, last=1.0, every=5, fps=10)
    gap, force = (np.asarray(a)[101:] for a in (run.reactions.gap, run.reactions.contact_force))
    most = int(np.unravel_index(np.argmax(force), force.shape)[0])
    front, rear, history = animation._fig.axes[:3]
    for k in (0, 17, most):
        animation._draw_frame(k)
        for end, ax in enumerate((front, rear)):
            np.testing.assert_allclose(drawn_gaps(ax), 2.5 * gap[k, end], rtol=0, atol=1e-9)
            # half of the section's height of 42 mm for the highest force
            expected = 0.5 * 42.0 * force[k, end][:, None] / force.max() * NORMALS
            np.testing.assert_allclose(arrows_of(ax), expected, rtol=0, atol=1e-9)
            filled = [to_hex(c) != "#ffffff" for c in ax.collections[0].get_facecolors()]
            assert filled == (force[k, end] > 0).tolist()
        period = float(run.period[101 + k])
        assert history.lines[-1].get_xdata() == [period, period]
        assert front.texts[10].get_text() == f"forcing period {period:.2f}"
    assert np.min(gap) < 0 < np.max(gap)  # both open and penetrating
    assert f"longest arrow {force.max() / 1e3:.3g} kN" in animation._fig.get_suptitle()
    # of each fifth saved state
    assert list(animation.new_frame_seq()) == list(range(0, 50, 5))
    assert animation._interval == pytest.approx(100.0)
    animation.save(tmp_path / "slipper.gif", PillowWriter(fps=10), dpi=40)
    with Image.open(tmp_path / "slipper.gif") as picture:
        assert picture.n_frames == 10


@pytest.mark.full
def test_wrong_arguments_of_an_animation_are_named(run):
    ds = run.ds
    for arguments, words in (
        (dict(run=ds.drop_attrs(), scene=None), "no attribute `scene`"),
        (dict(run=ds.drop_vars("contact_force")), "`run` must be .*, with `contact_force`, but has"),
        (dict(run=xr.concat([ds, ds], "case")), "`run` must be one case over time, but is over case"),
        (dict(run=ds.assign(y=np.nan * ds["y"])), "`run` must have finite motions"),
    ):
        with pytest.raises(ValueError, match=words):
            plots.animate(**dict(run=ds, scene=SCENE, last=1.0) | arguments)
    assert not plt.get_fignums()


@pytest.mark.full
def test_datasets_are_shown_with_their_scene(run):
    ds = run.ds.assign_coords(clearance=3e-3)
    front = plots.instant(ds, SCENE, at=2.4, magnify=1.0, last=1.0).axes[0]
    wide = SCENE.replace(clearance=3e-3)
    motion = sj.Motion.from_euler(**{name: float(ds[name][120]) for name in ("y", "z", "roll", "pitch", "yaw")})
    gap = contacts(rail_frame(wide, 2.4), motion).gap[:10]
    np.testing.assert_allclose(drawn_gaps(front, np.asarray(wide.section.track_points)), gap, rtol=0, atol=1e-9)


def test_a_section_shows_where_the_points_are():
    """In an order that leaves the slipper open where the rail has its web, with its play visible."""
    assert "".join(np.array(SCENE.section.names)[contour(SCENE.section)]) == "FGHIJABCDE"
    ax = plots.section(SCENE)
    positions = {t.get_text(): np.array(t.get_position()) for t in ax.texts}
    for name, point in zip(SCENE.section.names, np.asarray(SCENE.section.points), strict=True):
        assert np.linalg.norm(positions[name] - 1e3 * point) < 8
    assert points_of(ax) - 1e3 * RAIL == pytest.approx(default_magnification(SCENE.section) * 0.5 * NORMALS)
    arrows = arrows_of(ax)
    assert arrows / np.linalg.norm(arrows, axis=1, keepdims=True) == pytest.approx(NORMALS)
    assert labels(ax) == ("$y$ [mm]", "$z$ [mm]")
    # also of one face
    flat = sj.Section([[-0.03, 0.01], [0.03, 0.01]], [1e-3], ("P", "Q"), (("P", "Q"),))
    ax = plots.section(sj.Scene(SCENE.speed, SCENE.slipper, flat, SCENE.track, SCENE.contact))
    assert np.all(arrows_of(ax)[:, 1] > 0)  # upwards
    assert ax.patches[0].get_xy()[:, 1].min() < 0  # the web is below
