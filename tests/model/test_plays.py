"""Vertical and lateral play apart: as parameters, in files, and in what results state."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.datasets import scene_attributes
from slipperjax.model.scene_files import scene_from_toml

from ..common import sled_on

FILE = """
base = "paper"
[section]
play = { vertical = "0.060 in", lateral = "0.125 in" }
"""
VERTICAL = 0.060 * 25.4e-3
LATERAL = 0.125 * 25.4e-3


def test_each_face_has_half_of_the_play_along_its_normal():
    scene = sj.paper_scene().replace(**{"play.vertical": VERTICAL, "play.lateral": LATERAL})
    across = abs(np.asarray(scene.section.normals)[:, 0]) > np.sqrt(0.5)
    of_points = np.asarray(scene.section.play)[scene.section.face_of_point]
    np.testing.assert_allclose(of_points, np.where(across, LATERAL, VERTICAL) / 2, rtol=1e-15)
    assert float(scene.value("play.vertical")) == pytest.approx(VERTICAL, rel=1e-15)


def test_a_file_takes_both_plays():
    scene = scene_from_toml(FILE).scene
    assert float(scene.value("play.vertical")) == pytest.approx(VERTICAL)
    assert float(scene.value("play.lateral")) == pytest.approx(LATERAL)
    with pytest.raises(ValueError, match="scene, line 4: `clearance` and `play` must not both be given"):
        scene_from_toml(FILE.replace("[section]", '[section]\nclearance = "1 mm"'))
    with pytest.raises(ValueError, match="`horizontal` is none of lateral, vertical"):
        scene_from_toml(FILE.replace("lateral", "horizontal"))


def test_results_state_the_plays_that_were_entered_and_never_a_mean():
    of_both = scene_attributes(sj.paper_scene(clearance=1e-3))
    assert of_both["clearance [m]"] == 1e-3
    assert not any(name.startswith("play") for name in of_both)
    apart = scene_attributes(scene_from_toml(FILE).scene)
    assert "clearance [m]" not in apart
    assert apart["play.vertical [m]"] == pytest.approx(VERTICAL)
    assert apart["play.lateral [m]"] == pytest.approx(LATERAL)
    # faces of one direction that differ have no common play
    uneven = scene_attributes(sj.paper_scene().replace(**{"section.play.0": 4e-4}))
    assert "clearance [m]" not in uneven
    assert len([name for name in uneven if name.startswith("play")]) == 1


@pytest.mark.full
def test_plays_vary_in_a_grid_and_have_derivatives():
    grid = {"play.vertical": [1e-3, 1.5e-3], "play.lateral": [2e-3, 3e-3]}
    ds = sj.sweep(sj.paper_scene(), grid, transient=0, periods=1, steps_per_period=20, record="peak_force")
    assert ds["peak_force"].dims == (*grid, "end", "point")
    scene = ds.isel({"play.vertical": 1, "play.lateral": 0}).scene
    plays = [float(scene.value(f"play.{name}")) for name in ("vertical", "lateral")]
    assert plays == pytest.approx([1.5e-3, 2e-3], rel=1e-15)


def test_a_play_that_no_slipper_uses_is_refused():
    sled = sled_on()
    mounts = [dataclasses.replace(mount, play=np.full(5, 4e-4)) for mount in sled.mounts]
    scene = dataclasses.replace(sj.paper_scene(), slipper=dataclasses.replace(sled, mounts=mounts))
    for name in ("clearance", "play.vertical"):
        with pytest.raises(ValueError, match=f"`{name}` must be set where slippers use the play of the section"):
            scene.replace(**{name: 1e-3})
