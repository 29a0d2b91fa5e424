"""The command `run`: what it reads, computes, writes and prints."""

import dataclasses
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.model.surveys import SurveyedTrack
from slipperjax.plots.report import static_load, summary
from slipperjax.plots.runs import RunView, peak_of
from slipperjax.tools.units import STANDARD_GRAVITY

from ..pages import EXAMPLES, ROOT
from ..plots.test_runs import made
from .commands import call, dataset, error_of, names, picture

FILE = """base = "paper"
gravity = "9.81 m/s^2"

[speed]
start = "300 m/s"
stages = [{ acceleration = "200 m/s^2", speed = "400 m/s" }]

[load]
type = "AppliedLoad"
force = { values = [0, 0, -500], unit = "N" }
force_by_square = { values = [-0.02, 0, 0.004], unit = "N s^2/m^2" }

[friction]
type = "Coulomb"
coefficient = 0.1

[run]
length = "80 m"
window = "8 m"
steps_per_period = 60
"""
DOCS = (ROOT / "docs" / "how_to" / "runs.md").read_text()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sled.toml"
    path.write_text(FILE)
    return path


def numbers(text, pattern):
    """Gives the numbers that stand where a pattern has (..)."""
    found = re.search(pattern.replace("(..)", r"([-+.\de]+)"), text)
    assert found, text
    return [float(group) for group in found.groups()]


@pytest.mark.full
def test_a_run_is_written_drawn_and_told(file, tmp_path, capsys):
    text, error = call(["run", file, "--mass", 15, "--out", tmp_path / "sled"], capsys)
    ds = dataset(tmp_path / "sled")
    assert text.startswith(f"wrote {tmp_path / 'sled'}.nc and {tmp_path / 'sled'}.png\n")
    assert "1 of 1 cases" in error
    assert ds["distance"].values.tolist() == [8.0 * k for k in range(1, 11)]
    assert set(ds["steps_per_window"].values.tolist()) == {60}
    scene = sj.load_scene(ds)
    assert float(scene.slipper.mass) == 15.0
    picture(tmp_path / "sled", 7.2, 9.8)

    duration = float(ds["seconds"][-1])
    # the status comes before all numbers of the run
    assert "from rest on the rail\nstatus: finite\n0 to 80 m in" in text
    assert numbers(text, r"\n0 to 80 m in (..) s, speed (..) to (..) m/s\n") == pytest.approx(
        [duration, float(ds["speed"][0]), float(ds["speed"][-1])], rel=1e-3
    )
    # net loads come first
    for axis, name in (("z", "vertical"), ("y", "lateral")):
        net = ds["peak_slipper_force"].sel(axis=axis)
        window = int(np.abs(net.values).argmax())
        place = ds["peak_slipper_distance"].sel(axis=axis)[window]
        words = rf"greatest net {name} force of a slipper (..) kN at (..) m and (..) m/s"
        wanted = [float(value) for value in (net[window] / 1e3, place, ds["speed"][window])]
        assert numbers(text, words) == pytest.approx(wanted, rel=1e-3)
        assert text.index(f"net {name} force") < text.index("highest single contact point")
    vertical = np.abs(ds["peak_slipper_force"].sel(axis="z"))
    place = float(ds["peak_slipper_distance"].sel(axis="z")[int(vertical.values.argmax())])
    static = abs(15 * 9.81 + 500 - 0.004 * float(scene.speed.at(place)) ** 2)
    times, load = numbers(text, "m/s: (..) times its static load of (..) kN\n")
    assert [times, load] == pytest.approx([float(vertical.max()) / static, static / 1e3], rel=1e-2)
    middle = abs(15 * 9.81 + 500 - 0.004 * ds["speed"] ** 2)
    np.testing.assert_allclose(ds["static_ratio"], vertical / middle, rtol=1e-9)
    moment = np.abs(ds["peak_slipper_moment"]).max("distance")
    words = "moments of a slipper about its middle: x (..) N m, y (..) N m, z (..) N m\n"
    assert numbers(text, words) == pytest.approx(moment.values.tolist(), rel=1e-3)
    at = peak_of(ds)
    peak, there = float(at["peak_force"]), float(at["speed"])
    assert peak == float(ds["peak_force"].max())
    assert f"kN at {at['contact'].item()} ({at['end'].item()}), {round(float(at['peak_distance']), 2):g} m" in text
    high, speed = numbers(text, r"highest single contact point (..) kN at .* and (..) m/s\n")
    assert [high, speed] == pytest.approx([peak / 1e3, there], rel=1e-3)
    impacts = float(ds["impacts"].sum())
    assert impacts > 100
    assert numbers(text, "(..) impacts, (..) per second") == pytest.approx([impacts, impacts / duration], rel=1e-3)
    most = float(ds["peak_a_z"].max())
    assert numbers(text, r"a_z (..) m/s\^2 \((..) g\), alpha_x (..) rad/s\^2,") == pytest.approx(
        [most, most / 9.80665, float(ds["peak_alpha_x"].max())], rel=1e-2
    )
    assert numbers(text, "friction work (..) kJ") == pytest.approx([float(ds["friction_work"].sum()) / 1e3], rel=1e-3)
    net = np.abs(ds["peak_slipper_force"]).max("axis")
    worst = float(net.quantile(0.99))
    assert float(ds["peak_slipper_force_percentile"].sel(percentile=99).max()) == pytest.approx(worst, rel=1e-9)
    assert numbers(text, "greatest net force of a slipper: (..) kN from 0 to 80 m") == pytest.approx(
        [worst / 1e3], rel=1e-3
    )
    rms = float(ds["rms_a_z"].max())
    assert numbers(text, r"RMS of a_z: (..) m/s\^2 \((..) g\) from 0 to 80 m") == pytest.approx(
        [rms, rms / 9.80665], rel=1e-2
    )
    error = float(ds["probe_error"].max())
    assert numbers(text, "half the step changes the motion by (..) per 8 m \\(unit: 1 mm") == pytest.approx(
        [error], rel=0.1
    )

    assert [name for name in ds.variables if not re.search(rf"\b{name}\b", DOCS)] == []

    # in Python the same, and other commands read such a file
    again = sj.run(sj.load_scene(file).replace(mass=15.0), start=sj.load_start(file), **sj.load_run(file))
    np.testing.assert_array_equal(again["peak_force"].values, ds["peak_force"].values)
    assert sj.load_run(file) == dict(length=80.0, window=8.0, steps_per_period=60)

    # of a lost run nothing but its status is told
    for code in (1, 2, 3, 4):
        assert summary(RunView.of(ds.assign(status=((), code)))) == [f"status: {sj.Status(code)}"]
    doubtful = summary(RunView.of(ds.assign(status=((), 6))))
    assert doubtful[0] == f"status: {sj.Status.INACCURATE}"
    assert doubtful[1:] == summary(RunView.of(ds))[1:]


@pytest.mark.full
def test_the_ending_decides_what_is_written(file, tmp_path, capsys, replaced):
    ran = replaced("sweeps.runs.run", return_value=made())
    file.write_text(FILE + 'units = ["ft", "lbf"]\n')
    out = tmp_path / "sled"
    words = ["run", file, *(f"--out={out}{end}" for end in (".csv", ".pdf", ".xlsx", ".nc", "_2.5"))]
    text, _ = call(words, capsys)
    written = ["sled.csv", "sled.nc", "sled.pdf", "sled.toml", "sled.xlsx", "sled_100m.csv", "sled_2.5.nc"]
    assert names(tmp_path) == [*written, "sled_2.5.png"]
    assert f"wrote {out}.csv and {out}_100m.csv\nwrote {out}.pdf\n" in text
    # units are not of the simulation, but of what is told and written, then and later
    assert "units" not in ran.call_args[1]
    force, place = numbers(text, r"highest single contact point (..) lbf at .*, (..) ft and 100 m/s")
    highest = peak_of(dataset(out))
    assert [force, place] == pytest.approx(
        [float(highest["peak_force"]) / 4.4482216, float(highest["peak_distance"]) / 0.3048], rel=1e-3
    )
    again = sj.plots.report(dataset(out), tmp_path / "again.csv")
    assert again == f"wrote {tmp_path / 'again'}.csv and {tmp_path / 'again'}_100m.csv"
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "sled.csv").read_text()


def test_of_a_lost_run_nothing_is_told_but_its_status(file, tmp_path, capsys, replaced):
    replaced("sweeps.runs.run", return_value=made(status=1))
    text, _ = call(["run", file, "--out", tmp_path / "run.csv"], capsys, 1)
    _, case, *told = text.splitlines()
    assert case == "clearance 1 mm, length 0.2 m, from rest on the rail"
    assert told == [f"status: {sj.Status.NOT_FINITE}"]
    assert (tmp_path / "run.csv").read_text().splitlines()[1] == "100,101,0.01,100,not finite,,,"
    assert not (tmp_path / "run.nc").exists()


def test_other_endings_are_refused_before_the_run(file, tmp_path, capsys, replaced):
    ran = replaced("sweeps.runs.run")
    for ending, words in ((".docx", "Option --out must end in one of .nc, .png, .svg, .pdf, .csv, .xlsx, but is"),):
        assert words in error_of(["run", file, "--out", f"{tmp_path / 'sled'}{ending}"], capsys)
    replaced_spec = replaced("plots.report.importlib.util.find_spec", return_value=None)
    error = error_of(["run", file, "--out", tmp_path / "sled.xlsx"], capsys)
    assert error == "error: A workbook such as sled.xlsx needs openpyxl: pip install 'slipperjax[report]'.\n"
    assert replaced_spec.call_args[0] == ("openpyxl",)
    assert not ran.called


def test_options_come_before_the_table(file, tmp_path, capsys, replaced):
    over_rail = replaced("sweeps.runs.run", side_effect=ValueError("seen"))
    words = ["run", file, "--out", tmp_path / "run"]
    assert error_of(words, capsys) == "error: seen\n"
    options = over_rail.call_args[1]
    assert {name: options[name] for name in ("length", "window", "steps_per_period", "start")} == dict(
        length=80.0, window=8.0, steps_per_period=60, start=None
    )
    assert isinstance(options["solver"], sj.ImpulseRK4)
    file.write_text(f'{FILE}solver = "Rodas4"\nbegin = "10 m"\n[start]\nv_y = "1 m/s"\n')
    error_of([*words, "--steps-per-period", 70], capsys)
    options = over_rail.call_args[1]
    assert (options["solver"], options["begin"], options["steps_per_period"]) == ("Rodas4", 10.0, 70)
    assert options["start"].v_y == 1.0
    rail = tmp_path / "rail.csv"
    rail.write_text("chainage [m],lateral [mm],vertical [mm]\n" + "".join(f"{k / 4},0,0\n" for k in range(400)))
    error_of([*words, "--solver", "RK4", "--rail", rail], capsys)
    (scene,), options = over_rail.call_args
    assert isinstance(options["solver"], sj.RK4)
    assert isinstance(scene.track, SurveyedTrack)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "must be a TOML file with a table [run], but is"),
        ("run = 5", "sled.toml, line 2: `run` must be a table, [run], but is 5."),
        ("[run]", "sled.toml, line 2: Argument `run` must have `length`"),
        ("[run]\nlength = 5", 'sled.toml, line 3: `length` must be a number with a unit, as in "1.5 m", but is 5.'),
        ('[run]\nlength = "5 kg"', "sled.toml, line 3: `length` must be in a unit like m, but is in 'kg'"),
        ('[run]\nlength = ["5 m"]', "sled.toml, line 3: Argument `length` must be of shape ()"),
        (
            '[run]\nlength = "5 m"\nwindow = "0 m"',
            "sled.toml, line 4: Argument `window` must be positive, but is 0 m",
        ),
        (
            '[run]\nlength = "5 m"\nbegin = "1 s"',
            "sled.toml, line 4: `begin` must be in a unit like m, but is in 's'",
        ),
        (
            '[run]\nlenght = "5 m"',
            "sled.toml, line 3: Argument `run` must have only length, begin, window, steps_per_period",
        ),
        (
            '[run]\nlength = "5 m"\nunits = ["ft", "bananas"]',
            "line 4: Argument `units` must be units of acceleration, length, speed, force, impulse, energy, mass, "
            "time, such as ft, lbf and g, but has 'bananas'",
        ),
        ('[run]\nlength = "5 m"\nunits = "ft"', "line 4: Argument `units` must be a list of units"),
        ('[run]\nlength = "5 m"\nsteps_per_period = 0.5', "sled.toml, line 4: Argument `steps_per_period` must be a"),
        ('[run]\nlength = "5 m"\nsolver = "foo"', "Argument `solver` must be one of RK4,"),
    ],
)
def test_errors_are_one_line(table, words, tmp_path, capsys):
    file = tmp_path / "sled.toml"
    file.write_text(f'base = "paper"\n{table}\n')
    assert words in error_of(["run", file, "--out", tmp_path / "run"], capsys)
    assert names(tmp_path) == ["sled.toml"]


def test_the_documented_file_is_read(tmp_path):
    file = tmp_path / "sled.toml"
    file.write_text(DOCS.split("```toml\n")[1].split("```")[0])
    shutil.copy(EXAMPLES / "survey.csv", tmp_path)
    with pytest.warns(sj.ImplausibleWarning, match="Remark"):
        scene, table = sj.load_scene(file), sj.load_run(file)
    assert table == dict(length=100.0, window=1.0)
    place = float(scene.speed.distance[1])  # where the speed is 900 m/s
    assert static_load(scene, "", place) == pytest.approx(14 * 9.81 + 800 - 324)


def test_an_interrupted_run_writes_nothing(file, tmp_path, capsys, replaced):
    replaced("sweeps.runs.run", side_effect=sj.Interrupted(None, 0, 1))
    _, error = call(["run", file, "--out", tmp_path / "run"], capsys, 130)
    assert error == "0 of 1 cases were finished: nothing is written\ninterrupted\n"
    assert names(tmp_path) == ["sled.toml"]


@pytest.mark.parametrize("there", [True, False])
def test_an_interrupted_comparison_says_what_is_kept(there, file, tmp_path, capsys, replaced):
    store = tmp_path / "runs.zarr"
    words = ["run", file, "--over", "clearance", 0.8, 1.5, "--out", tmp_path / "run"]
    compare = replaced("sweeps.compare.compare", side_effect=sj.Interrupted(made(), 3, 16))
    kept = f"kept in {store}; the same command goes on" if there else "nothing is written"
    if there:
        store.mkdir()
        words += ["--store", store]
    more = "" if there else "; with --store runs are kept, and the same command goes on"
    assert call(words, capsys, 130)[1] == f"3 of 16 cases were finished: {kept}{more}\ninterrupted\n"
    # while nothing of the first run is finished, and outside of runs
    compare.side_effect = sj.Interrupted(None, 0, 16)
    assert call(words, capsys, 130)[1] == f"0 of 16 cases were finished: {kept}\ninterrupted\n"
    compare.side_effect = KeyboardInterrupt
    assert call(words, capsys, 130)[1] == f"{kept}\ninterrupted\n"


def test_the_static_load_is_across_the_rail():
    scene = sj.paper_scene()
    assert np.isnan(static_load(scene, "", 300.0))
    heavy = scene.replace(gravity=10.0)
    assert static_load(heavy, "", 300.0) == pytest.approx(140.0)
    on_it = sj.SledMass(50.0, [1e6, 1e6])
    assert static_load(dataclasses.replace(heavy, sled=on_it), "", 300.0) == pytest.approx(640.0)


def test_the_worst_stretch_is_named():
    over = ("distance", "end", "point")
    ends = 50.0 + 1.0 + np.arange(250)
    data = {f"peak_{name}": ("distance", np.ones(250)) for name in ("a_y", "a_z", "alpha_x", "alpha_y", "alpha_z")}
    data |= {"peak_force": (over, np.ones((250, 2, 1))), "impacts": (over, np.ones((250, 2, 1))), "status": ((), 0)}
    data["rms_a_z"] = ("stretch", [1.0, 2.0, 9.80665])
    data["peak_force_percentile"] = (("stretch", "percentile"), [[1e3], [4e3], [2e3]])
    coords = {"distance": ends, "stretch": [150.0, 250.0, 300.0], "percentile": [99.0], "end": ["front", "rear"]}
    coords |= {"point": ["A"], "speed": ("distance", 0 * ends + 25), "seconds": ("distance", (ends - 50) / 25)}
    view = RunView.of(xr.Dataset(data, coords, {"window [m]": 1.0}), sj.paper_scene())
    text = "\n".join(summary(view))
    assert "50 to 300 m in 10 s, speed 25 m/s\n" in text
    assert "highest single contact point 0.001 kN at A1 (front), 51 m and 25 m/s\n" in text
    assert "\n500 impacts, 50 per second\n" in text
    assert "highest normal force of a contact point: 4 kN from 150 to 250 m\n" in text
    assert text.endswith("RMS of a_z: 9.807 m/s^2 (1 g) from 250 to 300 m")
    assert "friction" not in text


def test_a_file_whose_name_begins_with_a_number_is_no_value(file, capsys):
    named = file.with_name("2024_sled.toml")
    file.rename(named)
    words = error_of(["run", "--over", "clearance", "0.8", named], capsys)
    assert "have a parameter and two or more values, but has 'clearance 0.8'" in words


def test_a_module_that_exits_is_an_error(file, tmp_path, monkeypatch, capsys):
    (tmp_path / "quits_at_once.py").write_text("import sys\nsys.exit(3)\n")
    monkeypatch.chdir(tmp_path)
    words = error_of(["--import", "quits_at_once", "run", file], capsys)
    assert "must be a Python module, but is quits_at_once, a program that exits with 3" in words
    assert call(["run", "-h"], capsys) == call(["run", "--help"], capsys)


@pytest.mark.full
def test_designs_are_compared_told_and_written(file, tmp_path, capsys):
    file.write_text(FILE.replace("80 m", "16 m") + 'units = ["lbf"]\n')
    out = tmp_path / "designs"
    words = ["run", file, "--over", "clearance", "0.8", "1/8 in", "--rails", "1", "--starts", "80"]
    text, _ = call([*words, f"--out={out}.nc", f"--out={out}.xlsx"], capsys)
    assert text.startswith(f"wrote {out}.nc\nwrote {out}.xlsx\nlength 0.2 m, from rest on the rail\nclearance ")
    better, heading, *each = text.splitlines()[3:]
    assert " lbf in the 95 % quantile, " in better
    assert heading == "greatest net force of a slipper on 1 rail from 80 starts each:"
    assert [line.partition(":")[0] for line in each] == ["clearance 0.8 mm", "clearance 3.175 mm"]
    ds = dataset(out)
    assert ds["runs"].shape == (2, 1, 80)
    value = float(ds["value"].sel(quantile=0.5)[0]) / 4.4482216
    assert numbers(each[0], r"median (..) \+- ")[0] == pytest.approx(value, rel=1e-2)
    sheets = pd.read_excel(f"{out}.xlsx", sheet_name=None)
    assert list(sheets) == ["summary", "designs"]
    np.testing.assert_allclose(sheets["designs"]["value [lbf]"][0], value, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--rails", "3"], "Option --rails must come with --over, but is 3"),
        (["--over", "clearance", "0.8"], "have a parameter and two or more values"),
        (["--over", "clearence", "0.8", "1"], "Argument `clearence` is no parameter"),
        (["--over", "clearance", "0.8", "1 kg"], "`clearance` must be in a unit like m, but is in 'kg'"),
        (
            ["--over", "clearance", "0.8", "1", "--rails", "32", "--starts", "4"],
            "`quantile` must come with 80 or more rails",
        ),
    ],
)
def test_a_wrong_comparison_is_one_line(options, words, file, capsys):
    error = error_of(["run", file, *options], capsys)
    assert words in error


@pytest.mark.full
def test_a_table_of_places_is_an_environment_beside_the_run(file, tmp_path, capsys, replaced):
    table = '\n[environment]\nplaces = { unit = "mm", values = [[100, 0, 40]] }\nhigh = "200 Hz"\nlow = "40 Hz"\n'
    file.write_text(FILE.replace("steps_per_period = 60", "steps_per_period = 200") + table)
    text, _ = call(["run", file, "--out", tmp_path / "a.nc", "--out", tmp_path / "a.csv"], capsys)
    assert names(tmp_path) == ["a-environment.csv", "a-environment.nc", "a.csv", "a.nc", "a_100m.csv", "sled.toml"]
    ds = dataset(tmp_path / "a")
    assert ds["body_acceleration"].sizes["sample"] == 8 * 64  # of windows of 8 m
    report = dataset(tmp_path / "a-environment")
    again = sj.environment(ds, **sj.load_environment(file))
    np.testing.assert_array_equal(report["density"], again["density"])
    assert len(pd.read_csv(tmp_path / "a-environment.csv")) == report.sizes["frequency"]
    rms = report["rms"].sel(direction="z").item() / STANDARD_GRAVITY
    assert numbers(
        text, r"\nenvironment at \(0.1, 0, 0.04\) m: g-RMS of the whole record x .* z (..); of 40 to 200 Hz"
    ) == pytest.approx([rms], rel=5e-3)
    # an error comes before the run
    over_rail = replaced("sweeps.runs.run")
    file.write_text(FILE + table.replace("200 Hz", "30 Hz"))
    assert "`low` must be below" in error_of(["run", file, "--out", tmp_path / "b"], capsys)
    file.write_text(FILE + table.replace("40 Hz", "4 kHz").replace('high = "200 Hz"\n', ""))
    assert "`low` must be below" in error_of(["run", file, "--out", tmp_path / "b"], capsys)
    assert not over_rail.called
