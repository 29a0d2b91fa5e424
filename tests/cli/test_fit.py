"""The command that finds parameters from measured signals."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj

from ..fitting.linear import linear_model, linear_record
from ..fitting.records import record
from ..fitting.test_trajectories import SENSORS, TRUTH
from .commands import call, dataset, error_of, names

SCENE = """\
base = "paper"
speed = "1250 m/s"
contact = { stiffness = "6e7 N/m^1.5", restitution = 0.7 }
section = { clearance = "1.5 mm" }

[sensors.az]
noise = "40 g"

[sensors.ay]
direction = "y"
place = { values = [50, 0, 0], unit = "mm" }
"""


@pytest.fixture
def files(tmp_path):
    scene = tmp_path / "sled.toml"
    scene.write_text(SCENE)
    ds = record(TRUTH, SENSORS, 4, noise=0.05)
    rows = np.column_stack([1e3 * ds["time"], ds["az"] / 9.80665, ds["ay"]])
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    measured = tmp_path / "measured.csv"
    measured.write_text("time [ms],az [g],ay [m/s^2]\n" + "\n".join(lines))
    return ["fit", scene, measured]


@pytest.mark.full
def test_a_record_tells_the_parameters_of_a_scene(files, tmp_path, capsys):
    bounds = ["--fit", "stiffness", 3e7, 3e8, "--fit", "restitution", 0.5, 0.99, "--fit", "clearance", 0.5, 2]
    out = tmp_path / "found"
    text, _ = call([*files, *bounds, "--starts", 4, "--out", out], capsys)
    assert "status: converged\n90 % intervals:\n" in text
    assert "speed 1250 m/s, length 0.2 m, from Table 2's start" in text
    assert {"found.nc", "found.png"} <= set(names(tmp_path))
    ds = dataset(out)
    error = ds["stderr"].values
    # 0.2 to 1.3 standard errors
    assert np.all(np.abs(ds["estimate"].values - [1e8, 0.9, 1e-3]) < 3 * error)


def test_on_a_rail_that_does_not_recur_it_says_that_runs_begin_at_rest(tmp_path, capsys, monkeypatch):
    linear_model(monkeypatch)
    track = sj.RandomTrack.sled(length=200.0)
    rough = dataclasses.replace(sj.paper_scene(300.0), track=track, gravity=9.81)
    scene, measured = tmp_path / "sled.toml", tmp_path / "measured.nc"
    scene.write_text(rough.to_toml() + "\n[sensors.az]\n")
    linear_record(rough).to_netcdf(measured, engine="h5netcdf")
    bounds = ["--fit", "stiffness", 1e7, 1e9, "--starts", 2]
    text, _ = call(["fit", scene, measured, *bounds, "--out", tmp_path / "found"], capsys)
    assert "status: converged" in text
    assert "length 0.2 m, from rest on the rail\n" in text


@pytest.mark.full
def test_wrong_input_is_one_line(files, tmp_path, capsys):
    bounds = ["--fit", "stiffness", 3e7, 3e8]
    for more, text in (
        ([], "Option --fit must be given for one parameter or more, but is missing."),
        ([*bounds, *bounds], "Option --fit must name each parameter once, but is 'stiffness'."),
        (["--fit", "stifness", 1, 2], "`stifness` is no parameter"),
        (["--fit", "stiffness", 1e9, 1e8], "Option --fit must have two bounds, the smaller first"),
        (["--fit", "stiffness", 1e8, 1e9], "`stiffness` must have bounds on both sides of the scene's own value"),
        (["--fit-sensor", "az.gian", 0.5, 2], "`sensors.az.gian` leads to no number"),
        ([*bounds, "--by", "features"], "`noise` must be given of the sensor ay for features"),
    ):
        assert text in error_of([*files, *more, "--out", tmp_path / "x"], capsys), more
    files[1].write_text(SCENE.split("[sensors")[0])
    words = f"must be a TOML file with tables [sensors.NAME], but is {files[1]}, which has none."
    assert words in error_of([*files, *bounds], capsys)
