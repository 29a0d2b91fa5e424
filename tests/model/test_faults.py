"""Faults of rails: dips, steps and joints in a scene's file, and their numbers as parameters."""

import dataclasses
import re

import equinox as eqx
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.sweep import make_grid
from slipperjax.flow.datasets import scene_attributes
from slipperjax.model import scene_from_json, scene_from_toml, scene_to_json
from slipperjax.model.quantities import ShownUnits
from slipperjax.plots.style import shown
from slipperjax.sweeps.compare import on_rails

FAULTS = """
base = "paper"
[[mounts]]
rail = "left"
y = "0.6 m"
[[mounts]]
rail = "right"
y = "-0.6 m"
[track]
type = "TwoRails"
[track.right]
type = "StraightTrack"
[track.left]
type = "StraightTrack"
[[track.left.faults]]
at = "8 m"
kind = "step"
height = "0.030 in"
length = "0.5 m"
[[track.left.faults]]
at = "20 m"
height = "-1 mm"
length = "2 m"
name = "weld 7"
[[track.faults]]
at = "30 m"
kind = "joint"
height = "-2 mm"
length = "1 m"
direction = "lateral"
"""


def test_faults_are_added_to_their_rails():
    track = scene_from_toml(FAULTS).scene.track
    places = np.array([0.0, 8.0, 12.0, 20.0, 30.0])
    left, right = (track.rails[side].irregularity(places) for side in ("left", "right"))
    step = 0.030 * 25.4e-3
    np.testing.assert_allclose(left.vertical, [0.0, step / 2, step, step - 1e-3, step], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(right.vertical, 0.0)
    np.testing.assert_allclose(right.lateral, [0.0, 0.0, 0.0, 0.0, -2e-3], rtol=0, atol=1e-15)


def test_numbers_of_faults_are_parameters_by_the_names_of_the_file():
    scene = scene_from_toml(FAULTS).scene
    # the second fault of the left rail has a name, and keeps its number
    assert (
        float(scene.value("track.left.faults.weld 7.height"))
        == float(scene.value("track.left.faults.1.height"))
        == -1e-3
    )
    moved = scene.replace(**{"track.left.faults.weld 7.height": -3e-3, "track.faults.0.at": 40.0})
    left = moved.track.rails["left"].irregularity(np.array([20.0, 30.0, 40.0]))
    step = 0.030 * 25.4e-3
    np.testing.assert_allclose(left.vertical, [step - 3e-3, step, step], rtol=0, atol=1e-15)
    np.testing.assert_allclose(left.lateral, [0.0, 0.0, -2e-3], rtol=0, atol=1e-15)
    for text in (scene.to_toml(), moved.to_toml()):
        assert scene_from_toml(text).scene.to_toml() == text
    assert eqx.tree_equal(scene, scene_from_json(scene_to_json(scene)))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("track.left.faults.2.height", "a number of 0 to 1 or one of 0, weld 7 in place of '2'"),
        ("track.left.faults.weld 8.height", "a number of 0 to 1 or one of 0, weld 7 in place of 'weld 8'"),
        ("track.faults.1.height", "a number of 0 to 0 in place of '1'"),
        ("track.faults.0.heigth", "Fault has at, height, length, but not 'heigth'. Did you mean height?"),
        ("track.right.faults.0.height", "track.right is absent from the scene"),
        ("track.fault.0.height", "FaultyTrack has one, faults, left, right, but not 'fault'. Did you mean faults?"),
    ],
)
def test_wrong_names_of_faults_are_told_with_those_that_exist(path, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        sj.model.parameter(path, scene_from_toml(FAULTS).scene)


def test_names_of_faults_are_words_of_paths():
    make = lambda name: sj.model.Fault(1.0, 1e-3, 1.0, name=name)
    with pytest.raises(ValueError, match="`name` must have no points"):
        make("weld 7.5")
    with pytest.raises(ValueError, match="`faults` must have different names"):
        sj.model.FaultyTrack(sj.model.StraightTrack(), [make("weld"), make("weld")])


def test_other_rails_keep_the_faults_of_a_rail():
    fault = sj.model.Fault(at=20.0, height=1e-3, length=1.0)
    track = sj.model.FaultyTrack(sj.RandomTrack.sled(length=200.0, seed=3), [fault])
    scene, rails = on_rails(dataclasses.replace(sj.paper_scene(), track=track), 2)
    assert list(rails) == ["track.one.seed"]
    assert rails["track.one.seed"].tolist() == [3.0, 4.0]
    assert scene.track.faults == track.faults


def test_results_over_pairs_of_rails_with_faults_state_no_rail():
    rail = sj.model.SampledTrack(np.arange(400) / 4, 0.0, 1e-3 * np.random.default_rng(0).normal(size=400))
    track = sj.model.FaultyTrack(sj.model.TwoRails(rail, rail), [sj.model.Fault(20.0, 1e-3, 1.0, kind="joint")])
    scene = dataclasses.replace(scene_from_toml(FAULTS).scene, track=track)
    many, rails = on_rails(scene, 2)
    # numbers of rails become NaN, with which the track must still answer
    stated = scene_attributes(many, list(rails))
    assert stated["contact_memory"] == "PeakRateLatch"
    assert stated["wavelength [m]"] == scene_attributes(scene)["wavelength [m]"]


def test_a_fault_on_a_survey_is_at_a_station(tmp_path):
    x = np.arange(0.0, 1000.0, 0.5)
    rows = [f"{at // 100:.0f}+{at % 100:04.1f},0,0" for at in x]
    (tmp_path / "survey.csv").write_text("\n".join(["chainage [ft],lateral [mm],vertical [mm]", *rows]))
    fault = ["[[track.faults]]", 'at = "8+00"', 'height = "1 mm"', 'length = "1 m"']
    text = "\n".join(['base = "paper"', "[track]", 'file = "survey.csv"', *fault])
    track = scene_from_toml(text, str(tmp_path / "sled.toml")).scene.track
    assert float(track.irregularity(np.array([800 * 0.3048])).vertical[0]) == pytest.approx(1e-3)
    assert track.distance_unit == "ft"
    moved = dataclasses.replace(sj.paper_scene(), track=track).replace(**{"track.faults.0.height": 2e-3})
    assert float(moved.track.irregularity(np.array([800 * 0.3048])).vertical[0]) == pytest.approx(2e-3)
    for wrong in ("8+0000", "8 + 00"):
        with pytest.raises(ValueError, match=r"sled\.toml, line 5: .*`at` must be a station in ft"):
            scene_from_toml(text.replace("8+00", wrong), str(tmp_path / "sled.toml"))


@pytest.mark.full
def test_every_place_along_the_rail_may_be_a_station(tmp_path):
    rows = "\n".join(f"{at},0,0" for at in range(0, 1000, 5))
    (tmp_path / "survey.csv").write_text(f"chainage [ft],lateral [mm],vertical [mm]\n{rows}")
    read = lambda *lines: scene_from_toml("\n".join(['base = "paper"', *lines]), str(tmp_path / "sled.toml"))
    survey = ["[track]", 'file = "survey.csv"']
    # the run comes before the survey, whose unit its stations have
    run = ["[run]", 'length = "30 m"', 'begin = "4+00"']
    assert read(*run, *survey).run["begin"] == pytest.approx(400 * 0.3048, rel=1e-15)
    way = read("[speed]", 'distance = ["1+00", "5+00.5"]', 'speed = ["300 m/s", "200 m/s"]', *survey).scene.speed
    np.testing.assert_allclose(way.distance, 0.3048 * np.array([100.0, 500.5]), rtol=1e-15)
    stages = [
        "[speed]",
        'start = "9 m/s"',
        'begin = "2+00"',
        'stages = [{ acceleration = "1 m/s^2", length = "9 m" }]',
    ]
    assert float(read(*stages, *survey).scene.speed.distance[0]) == pytest.approx(200 * 0.3048, rel=1e-15)
    # without a survey stations are in metres, and a number with an exponent is none
    assert read("[run]", 'length = "30 m"', 'begin = "1+250"').run["begin"] == 1250.0
    assert read("[run]", 'length = "30 m"', 'begin = "1e+2 m"').run["begin"] == 100.0
    with pytest.raises(ValueError, match=r"sled\.toml, line 4: .*`begin` must be a station in m.*'4\+00'"):
        read(*run)
    # a length is no place
    with pytest.raises(ValueError, match="`length` must be a number with a unit"):
        read("[run]", 'length = "1+250"')


def test_heights_of_faults_have_the_unit_of_small_lengths():
    height = sj.model.parameter("track.left.faults.weld 7.height", scene_from_toml(FAULTS).scene)
    assert height.named(-0.001) == "track.left.faults.weld 7.height -1 mm"
    assert ShownUnits(("ft", "lbf")).of(height).named(0.030 * 0.0254).endswith("height 0.03 in")
    # in a result, which knows the path by its attributes alone
    ds = xr.Dataset(coords={height.name: (height.name, [0.0, 0.0254], height.attributes)})
    drawn = shown(ds, height.name, ShownUnits(("ft",)))
    assert drawn.units == "in"
    np.testing.assert_allclose(drawn, [0.0, 1.0], rtol=1e-15)
    # a number of the command line is in the SI unit at a path, in the display unit by a name
    grid = make_grid(scene_from_toml(FAULTS).scene, (height.name, 0.0, 2e-3, 2), ("clearance", "1 mm", 2.0, 2))
    np.testing.assert_allclose([grid[height.name], grid["clearance"]], [[0.0, 2e-3], [1e-3, 2e-3]], rtol=1e-15)
