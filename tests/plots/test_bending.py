"""How rails bend around a sled, as drawn."""

import dataclasses

import numpy as np
import pytest
from matplotlib.animation import PillowWriter
from PIL import Image

import slipperjax as sj
from slipperjax import plots

from ..model.test_beam import CRITICAL, beam

pytestmark = [pytest.mark.full, pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")]


@pytest.fixture(scope="module")
def run():
    """A slipper that falls on the rail, at half the critical speed."""
    speed = 0.5 * CRITICAL
    scene = sj.paper_scene(speed=speed, stiffness=5e10)
    parts = dict(track=sj.model.StraightTrack(), beam=beam(ring=32.0), window=2e-3 * speed)
    start = sj.Motion(z=-4.5e-4, v_z=-1.0)
    return sj.simulate(
        dataclasses.replace(scene, **parts), 1, start=start, steps_per_period=200, saves_per_period=20, probe=0
    )


def test_the_line_is_the_deflection_that_the_slipper_feels(run, tmp_path):
    animation = plots.animate_bending(run, run, every=5)
    upper, lower = animation._fig.axes
    for at in (0, 5, 20):
        animation._draw_frame(at)
        felt = 1e3 * np.asarray(run.state.rail.deflection[at, 1])
        for ax in (upper, lower):
            (line,) = ax.lines  # the vertical one alone
            dots = np.asarray(ax.collections[0].get_offsets())
            np.testing.assert_allclose(dots, np.column_stack([(0.1, -0.1), felt]), rtol=0, atol=1e-9)
            # between points 2 cm apart
            np.testing.assert_allclose(np.interp(dots[:, 0], *line.get_data()), felt, atol=1e-4)
            time = 1e3 * float(run.time[at])
            assert (
                ax.texts[0].get_text().startswith(f"{0.5 * CRITICAL:g} m/s, 0.5 of the critical speed; {time:.2f} ms")
            )
    assert np.abs(felt).max() > 0.02
    assert list(animation.new_frame_seq()) == [0, 5, 10, 15, 20]
    assert upper.get_ylim() == lower.get_ylim()
    animation.save(tmp_path / "bend.gif", PillowWriter(fps=10), dpi=40)
    with Image.open(tmp_path / "bend.gif") as picture:
        assert picture.n_frames == 5


def test_one_instant(run):
    ax = plots.bending(run, at=1e-3, reach=4.0)
    assert ax.get_xlim() == (-4.0, 4.0)
    assert "1.00 ms" in ax.texts[0].get_text()
    assert ax.get_ylabel() == "deflection [mm]"


def test_wrong_arguments_are_named(run):
    rigid = sj.simulate(sj.paper_scene(), 1, steps_per_period=50, probe=0)
    with pytest.raises(ValueError, match=r"`run` must be of slipperjax\.simulate, of a scene with a beam"):
        plots.bending(rigid)
    with pytest.raises(ValueError, match="`runs` must be one run or several"):
        plots.animate_bending()
    with pytest.raises(ValueError, match="`reach` must be positive"):
        plots.bending(run, reach=-1.0)
