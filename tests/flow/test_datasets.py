"""Datasets and their scenes."""

import pytest

import slipperjax as sj
from slipperjax.flow.datasets import scene_attributes


@pytest.mark.parametrize(
    ("varied", "gone"),
    [
        ("speed", {"speed [m/s]"}),
        ("v_y", set()),
        ("slipper.mass", {"mass [kg]"}),
        ("inertia_y", {"inertia_y [kg m^2]"}),
        ("slipper.inertia.1", {"inertia_y [kg m^2]"}),
        ("section.play.2", {"clearance [m]"}),
        ("track.wavelengths.0", {"wavelengths [m]"}),
        ("gravity", set()),
    ],
)
def test_what_depends_on_a_varied_number_is_no_attribute(varied, gone):
    scene = sj.paper_scene()
    assert set(scene_attributes(scene)) - set(scene_attributes(scene, without=[varied])) == gone
