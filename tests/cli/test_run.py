"""The command `run`: what it reads, computes, writes and prints."""

import collections
import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.fitting import telemetry
from slipperjax.flow.datasets import run_attributes
from slipperjax.model.surveys import SurveyedTrack
from slipperjax.plots.runs import peak_of
from slipperjax.results.runs import static_load, summary
from slipperjax.tools.units import STANDARD_GRAVITY

from ..pages import EXAMPLES, ROOT
from ..plots.test_runs import made
from .commands import call, dataset, error_of, names

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


def result(**options):
    return sj.Result(made(**options).assign_attrs(call='{"function": "run"}'))


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
    scene = sj.load(ds).scene
    assert float(scene.slipper.mass) == 15.0
    # the status comes before all numbers of the run
    assert "from rest on the rail\nstatus: finite\n0 to 80 m in" in text
    speed, duration = ds["speed"].values, float(ds["seconds"][-1])
    net = np.abs(ds["peak_slipper_force"].sel(axis="z"))
    window = int(net.values.argmax())
    place = float(ds["peak_slipper_distance"].sel(axis="z")[window])
    static = abs(15 * 9.81 + 500 - 0.004 * float(scene.speed.at(place)) ** 2)
    at = peak_of(ds)
    assert f"kN at {at['contact'].item()} ({at['end'].item()}), {round(float(at['peak_distance']), 2):g} m" in text
    worst = np.abs(ds["peak_slipper_force"]).max("axis").quantile(0.99)
    most, rms, impacts = ds["peak_a_z"].max(), ds["rms_a_z"].max(), ds["impacts"].sum()
    moment = np.abs(ds["peak_slipper_moment"]).max("distance").values
    for pattern, wanted in {
        r"\n0 to 80 m in (..) s, speed (..) to (..) m/s\n": [duration, speed[0], speed[-1]],
        "greatest net vertical force of a slipper (..) kN at (..) m and": [net[window] / 1e3, place],
        "m/s: (..) times its static load of (..) kN\n": [net.max() / static, static / 1e3],
        "moments of a slipper about its middle: x (..) N m, y (..) N m, z (..) N m\n": moment,
        r"highest single contact point (..) kN at .* and (..) m/s\n": [at["peak_force"] / 1e3, at["speed"]],
        "(..) impacts, (..) per second": [impacts, impacts / duration],
        r"a_z (..) m/s\^2 \((..) g\), alpha_x": [most, most / STANDARD_GRAVITY],
        "friction work (..) kJ": [ds["friction_work"].sum() / 1e3],
        "greatest net force of a slipper: (..) kN from 0 to 80 m": [worst / 1e3],
        r"RMS of a_z: (..) m/s\^2 \((..) g\) from 0 to 80 m": [rms, rms / STANDARD_GRAVITY],
        "half the step changes the motion by (..) per 8 m": [ds["probe_error"].max()],
    }.items():
        # three digits, of errors fewer
        rel = 0.1 if "half" in pattern else 1e-2
        assert numbers(text, pattern) == pytest.approx([float(value) for value in wanted], rel=rel), pattern
    assert [name for name in ds.variables if not re.search(rf"\b{name}\b", DOCS)] == []
    # in Python the same, and other commands read such a file
    again = sj.run(sj.load(file).scene.replace(mass=15.0), start=sj.load(file).start, **sj.load(file).run)
    np.testing.assert_array_equal(again["peak_force"].values, ds["peak_force"].values)
    assert sj.load(file).run == dict(length=80.0, window=8.0, steps_per_period=60)


@pytest.mark.full
def test_the_ending_decides_what_is_written(file, tmp_path, capsys, replaced):
    ran = replaced("sweeps.runs.run", return_value=result())
    file.write_text(FILE + 'units = ["ft", "lbf"]\n')
    out = tmp_path / "sled"
    text, _ = call(["run", file, *(f"--out={out}{end}" for end in (".csv", ".pdf", ".xlsx", ".nc", "_2.5"))], capsys)
    written = ["sled.csv", "sled.nc", "sled.pdf", "sled.toml", "sled.xlsx", "sled_100m.csv", "sled_2.5.nc"]
    assert names(tmp_path) == sorted([*written, "sled_2.5.png", "sled_worstplaces.csv"])
    # units are not of the simulation, but of what is told and written, then and later
    assert "units" not in ran.call_args[1]
    assert numbers(text, r"highest single contact point (..) lbf at .*, (..) ft and") == [1124.0, 729.99]
    sj.load(f"{out}.nc").write(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "sled.csv").read_text()


def test_a_file_and_its_survey_are_read_once(file, tmp_path, capsys, replaced, monkeypatch):
    replaced("sweeps.runs.run", return_value=result())
    survey = tmp_path / "survey.csv"
    survey.write_text(
        "\n".join(["distance [m],vertical [mm]", *(f"{k / 4},{np.sin(k / 40):.4f}" for k in range(800))])
    )
    file.write_text(FILE + '[track]\nfile = "survey.csv"\n')
    counts = collections.Counter()
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: counts.update([path.name]) or read(path))
    call(["run", file, "--out", tmp_path / "run.csv"], capsys)
    assert (counts["sled.toml"], counts["survey.csv"]) == (1, 1)


def test_other_endings_are_refused_before_the_run(file, tmp_path, capsys, replaced):
    ran = replaced("sweeps.runs.run")
    words = "Option --out must end in one of .nc, .png, .svg, .pdf, .csv, .xlsx, .mat, but is"
    assert words in error_of(["run", file, "--out", f"{tmp_path / 'sled'}.docx"], capsys)
    replaced("results.writing.importlib.util.find_spec", return_value=None)
    words = "error: A workbook such as sled.xlsx needs openpyxl: pip install 'slipperjax[report]'.\n"
    assert error_of(["run", file, "--out", tmp_path / "sled.xlsx"], capsys) == words
    assert not ran.called


def test_a_lost_or_interrupted_run_is_no_result(file, tmp_path, capsys, replaced):
    ran = replaced("sweeps.runs.run", return_value=result(status=1))
    text, _ = call(["run", file, "--out", tmp_path / "run.csv"], capsys, 1)
    assert text.splitlines()[2:] == [f"status: {sj.Status.NOT_FINITE}"]
    assert (tmp_path / "run.csv").read_text().splitlines()[1] == "100,101,0.01,100,not finite,,,"
    ran.side_effect = sj.Interrupted(None, 0, 1)
    _, error = call(["run", file, "--out", tmp_path / "other"], capsys, 130)
    assert error == "0 of 1 cases were finished: nothing is written\ninterrupted\n"
    assert names(tmp_path) == ["run.csv", "run_100m.csv", "run_worstplaces.csv", "sled.toml"]


def test_options_come_before_the_table(file, tmp_path, capsys, replaced):
    over_rail = replaced("sweeps.runs.run", side_effect=ValueError("seen"))
    words = ["run", file, "--out", tmp_path / "run"]
    assert error_of(words, capsys) == "error: seen\n"
    options = over_rail.call_args[1]
    wanted = dict(length=80.0, window=8.0, steps_per_period=60, start=None)
    assert {name: options[name] for name in wanted} == wanted
    assert isinstance(options["solver"], sj.solvers.ImpulseRK4)
    file.write_text(f'{FILE}solver = "Rodas4"\nbegin = "10 m"\n[start]\nv_y = "1 m/s"\n')
    error_of([*words, "--steps-per-period", 70], capsys)
    options = over_rail.call_args[1]
    assert (options["solver"], options["begin"], options["steps_per_period"]) == ("Rodas4", 10.0, 70)
    assert options["start"].v_y == 1.0
    # the length of the slipper, not of the run
    error_of([*words, "--length", 0.3], capsys)
    (scene,), options = over_rail.call_args
    assert (options["length"], float(scene.slipper.length)) == (80.0, 0.3)
    rail = tmp_path / "rail.csv"
    rail.write_text("\n".join(["chainage [m],vertical [mm]", *(f"{k / 4},0" for k in range(400))]))
    error_of([*words, "--solver", "RK4", "--rail", rail], capsys)
    (scene,), options = over_rail.call_args
    assert isinstance(options["solver"], sj.solvers.RK4)
    assert isinstance(scene.track, SurveyedTrack)


RUN = '[run]\nlength = "5 m"\n'


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "must be a TOML file with a table [run], or a run, but is"),
        ("run = 5", "sled.toml, line 2: `run` must be a table, [run], but is 5."),
        ("[run]", "sled.toml, line 2: Argument `run` must have `length`, but has nothing."),
        ('[run]\nlength = "5 kg"', "sled.toml, line 3: `length` must be in a unit like m, but is in 'kg'"),
        ('[run]\nlength = ["5 m"]', "sled.toml, line 3: Argument `length` must be of shape ()"),
        (RUN + 'window = "0 m"', "sled.toml, line 4: Argument `window` must be positive, but is 0 m"),
        (RUN + 'units = ["bananas"]', "line 4: Argument `units` must be units of acceleration, length, speed, force"),
        (RUN + 'units = "ft"', "line 4: Argument `units` must be a list of units"),
        (RUN + "steps_per_period = 0.5", "sled.toml, line 4: Argument `steps_per_period` must be a"),
        (RUN + 'solver = "foo"', "Argument `solver` must be one of RK4,"),
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
        scene, table = sj.load(file).scene, sj.load(file).run
    assert table == dict(length=100.0, window=1.0)
    place = float(scene.speed.distance[1])  # where the speed is 900 m/s
    assert static_load(scene, "", place) == pytest.approx(14 * 9.81 + 800 - 324)
    with_payload = dataclasses.replace(
        sj.paper_scene().replace(gravity=10.0), payload=sj.model.Payload(50.0, [1e6, 1e6])
    )
    assert static_load(with_payload, "", 300.0) == pytest.approx(640.0)


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


def test_the_worst_stretch_is_named():
    over = ("distance", "end", "point")
    ends = 50.0 + 1.0 + np.arange(250)
    data = {f"peak_{name}": ("distance", np.ones(250)) for name in ("a_y", "a_z", "alpha_x", "alpha_y", "alpha_z")}
    data |= {"peak_force": (over, np.ones((250, 2, 1))), "impacts": (over, np.ones((250, 2, 1))), "status": ((), 0)}
    data["rms_a_z"] = ("stretch", [1.0, 2.0, 9.80665])
    data["peak_force_percentile"] = (("stretch", "percentile"), [[1e3], [4e3], [2e3]])
    coords = {"distance": ends, "stretch": [150.0, 250.0, 300.0], "percentile": [99.0], "end": ["front", "rear"]}
    coords |= {"point": ["A"], "speed": ("distance", 0 * ends + 25), "seconds": ("distance", (ends - 50) / 25)}
    attrs = run_attributes(sj.paper_scene(), sj.Motion(), {"function": "run"})
    text = "\n".join(summary(xr.Dataset(data, coords, attrs | {"window [m]": 1.0})))
    assert "50 to 300 m in 10 s, speed 25 m/s\n" in text
    assert "highest single contact point 0.001 kN at A1 (front), 51 m and 25 m/s\n" in text
    assert "\n500 impacts, 50 per second\n" in text
    assert "highest normal force of a contact point: 4 kN from 150 to 250 m\n" in text
    assert text.endswith("RMS of a_z: 9.807 m/s^2 (1 g) from 250 to 300 m")
    assert "friction" not in text


def test_modules_that_exit_and_names_that_begin_with_numbers_are_errors(file, tmp_path, monkeypatch, capsys):
    (tmp_path / "quits_at_once.py").write_text("import sys\nsys.exit(3)\n")
    monkeypatch.chdir(tmp_path)
    words = error_of(["--import", "quits_at_once", "run", file], capsys)
    assert "must be a Python module, but is quits_at_once, a program that exits with 3" in words
    named = file.rename(file.with_name("2024_sled.toml"))
    words = error_of(["run", "--over", "clearance", "0.8", named], capsys)
    assert "have a parameter and two or more values, but has 'clearance 0.8'" in words


@pytest.mark.full
def test_designs_are_compared_told_and_written(file, tmp_path, capsys):
    file.write_text(FILE.replace("80 m", "16 m") + 'units = ["lbf"]\n')
    out = tmp_path / "designs"
    words = ["run", file, "--over", "clearance", "0.8", "1/8 in", "--rails", "1", "--starts", "80"]
    text, _ = call([*words, f"--out={out}.nc", f"--out={out}.xlsx"], capsys)
    better, heading, *each = text.splitlines()[2:]
    assert " lbf in the 95 % quantile, " in better
    assert heading == "greatest net force of a slipper on 1 rail from 80 starts each:"
    assert [line.partition(":")[0] for line in each] == ["clearance 0.8 mm", "clearance 3.175 mm"]
    ds = dataset(out)
    assert ds["runs"].shape == (2, 1, 80)
    value = float(ds["value"].sel(quantile=0.5)[0]) / 4.4482216
    assert numbers(each[0], r"median (..) \+- ")[0] == pytest.approx(value, rel=1e-2)
    sheet = pd.read_excel(f"{out}.xlsx", sheet_name="designs")
    np.testing.assert_allclose(sheet["value [lbf]"][0], value, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--rails", "3", "--starts", "2"], "Option --starts must come with --over, but is 2"),
        (["--margin", "3"], "--margin must come with a table [environment]"),
        (["--margin", "3", "--rails", "2"], "--margin must come with a table [environment], but is 3"),
        (["--margin", "3", "--over", "clearance", "0.8", "1"], "--margin must not come with --over, which makes no"),
        (["--share", "1/2", "--rails", "8"], "--share must come with --store, but is '1/2'"),
        (["--sensor", "box"], "Option --sensor must come with --measured"),
        (["--measured", "none.csv"], "sled.toml, which has none."),
        (["--measured", "none.csv", "--over", "clearance", "0.8", "1"], "Option --measured must come without --over"),
        (["--over", "clearance", "0.8"], "have a parameter and two or more values"),
        (["--over", "clearence", "0.8", "1"], "Argument `clearence` is no parameter"),
        (
            ["--over", "clearance", "0.8", "1", "--rails", "32", "--starts", "4"],
            "`rails` must be 80 or more for the quantile 0.95, with 4 of them beyond it, but is 32",
        ),
    ],
)
def test_a_wrong_comparison_is_one_line(options, words, file, capsys):
    assert words in error_of(["run", file, *options], capsys)


SENSORS = """
[sensors.box]
place = { values = [100, 0, 40], unit = "mm" }

[sensors.lid]

[environment]
places = { unit = "mm", values = [[100, 0, 40]] }
low = "40 Hz"
high = "200 Hz"
"""


@pytest.fixture
def record(tmp_path):
    """A record of 0.2 s, a sine of 5 g and 100 Hz."""
    path = tmp_path / "record.csv"
    time = np.arange(2000) / 10e3
    rows = np.column_stack([time, 5 * np.sin(2 * np.pi * 100 * time)])
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header="time [s], box [g]", comments="")
    return path


def test_a_wrong_record_is_one_line_before_the_run(file, record, capsys, replaced):
    file.write_text(FILE + SENSORS)
    over_rail = replaced("sweeps.runs.run")
    wrong = lambda *options, of=record: error_of(["run", file, "--measured", of, *options], capsys)
    assert "Option --sensor must be one of box, lid, but is missing" in wrong()
    assert "Option --sensor must be one of box, lid, but is 'bix'. Did you mean box?" in wrong("--sensor", "bix")
    assert "Argument `rails` must be 1, or 19 or more" in wrong("--sensor", "box", "--rails", "8")
    # its column has the name of the other sensor
    assert re.search("other names are .* lid,", wrong("--sensor", "lid"))
    late = record.with_name("late.csv")
    late.write_text(record.read_text().replace("time [s]", "time [min]"))
    assert "must have 800 samples a second or more for bands up to 200 Hz, but has 166.667" in wrong(
        "--sensor", "box", of=late
    )
    assert not over_rail.called


@pytest.mark.full
def test_a_record_is_laid_over_the_run(file, record, tmp_path, capsys):
    file.write_text(FILE.replace("steps_per_period = 60", "steps_per_period = 200") + SENSORS)
    out = ["--out", tmp_path / "a.nc", "--out", tmp_path / "a.csv"]
    text, _ = call(["run", file, "--measured", record, "--sensor", "box", *out], capsys)
    assert {f"a-telemetry{end}" for end in (".nc", ".csv", "_frequencies.csv", "_windows.csv")} <= set(
        names(tmp_path)
    )
    # a sine of 5 g
    assert numbers(text, r"\nRMS: record (..) g, model") == pytest.approx([5 / 2**0.5], rel=0.01)
    report = sj.load(tmp_path / "a-telemetry.nc")
    again = telemetry(sj.load(tmp_path / "a.nc"), record, report.call["sensor"], low=40.0, high=200.0)
    np.testing.assert_array_equal(report["density"], again["density"])


@pytest.mark.full
def test_a_table_of_places_is_an_environment_beside_the_run(file, tmp_path, capsys, replaced):
    table = '\n[environment]\nplaces = { unit = "mm", values = [[100, 0, 40]] }\nhigh = "200 Hz"\nlow = "40 Hz"\n'
    file.write_text(FILE.replace("steps_per_period = 60", "steps_per_period = 200") + table)
    text, _ = call(["run", file, "--out", tmp_path / "a.nc", "--out", tmp_path / "a.csv"], capsys)
    of_run = ["a.csv", "a.nc", "a_100m.csv", "a_worstplaces.csv"]
    of_environment = ["a-environment.csv", "a-environment.nc", "a-environment_specification.csv"]
    assert names(tmp_path) == [*of_environment, *of_run, "sled.toml"]
    ds = sj.load(tmp_path / "a.nc")
    assert ds["body_acceleration"].sizes["sample"] == 8 * 64  # of windows of 8 m
    report = dataset(tmp_path / "a-environment")
    again = sj.environment(ds, **sj.load(file).environment)
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
