"""Reports of runs: words, tables and files, of datasets made by hand."""

import re

import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr

import slipperjax as sj
from slipperjax import plots
from slipperjax.plots.runs import RunView
from slipperjax.results.run_tables import lines_of, of_stretches, of_windows, of_worst
from slipperjax.results.runs import report, summary, tables
from slipperjax.results.writing import WIDTH

from ..plots.shown import legend
from ..plots.test_runs import BEGIN, WINDOWS, heights, made

FEET = ("ft", "lbf", "g")
SCENE = sj.paper_scene()


def run(status=0, scene=SCENE, **variables):
    """Gives the run of `made`, with impacts, friction and a number of each direction, of 0 to 249 in its windows."""
    ds, count = made(status, scene=scene), np.arange(float(WINDOWS))
    each = np.broadcast_to(count[:, None, None], (WINDOWS, 2, 3))
    more = {name: (("distance", "end", "point"), each) for name in ("impacts", "friction_work", "contact_fraction")}
    kilonewtons = {"units": "N", "shown_unit": "kN"}
    more["spring_force"] = ("distance", "direction"), count[:, None] * [1.0, 2.0], kilonewtons
    more["peak_a_z"] = ("distance", count, {"units": "m/s^2"})
    more["rms_a_z"] = ("stretch", [1.0, 9.80665, 3.0], {"units": "m/s^2"})
    ds = ds.assign(more | variables).assign_coords(direction=["lateral", "vertical"])
    ds["friction_work"].attrs["units"] = "J"
    return ds


def with_net_loads(ds):
    """Adds net forces of 1 kN along z and 0.5 along y, but -6 kN along y at 222.25 m."""
    force, place = np.tile([0.5e3, 1e3], (WINDOWS, 1)), np.full((WINDOWS, 2), 222.0)
    force[122, 0], place[122, 0] = -6e3, 222.25
    over = ("distance", "axis")
    net = {"peak_slipper_force": (over, force), "peak_slipper_distance": (over, place)}
    net["peak_slipper_moment"] = (("distance", "about"), np.tile([10.0, -30.0, 20.0], (WINDOWS, 1)))
    net["peak_slipper_force_percentile"] = 10 * ds["peak_force_percentile"]
    return ds.assign(net).assign_coords(axis=["y", "z"], about=["x", "y", "z"])


def test_net_loads_come_first_in_words_tables_and_pictures():
    ds = with_net_loads(run(scene=SCENE.replace(gravity=10.0)))
    lines = summary(ds)
    assert lines[2:6] == [
        "greatest net vertical force of a slipper 1 kN at 222 m and 100 m/s: 7.14 times its static load of 0.14 kN",
        "greatest net lateral force of a slipper -6 kN at 222.25 m and 100 m/s",
        "greatest net moments of a slipper about its middle: x 10 N m, y 30 N m, z 20 N m",
        "highest single contact point 5 kN at C2 (rear), 222.5 m and 100 m/s",
    ]
    assert any("greatest net force of a slipper: 80 kN from 300 to 350 m" in line for line in lines)
    windows = of_windows(RunView.of(ds))
    net = windows[["peak_slipper_force", "slipper_load", "peak_slipper_distance"]]
    assert net.iloc[[122, 0]].values.tolist() == [[-6e3, "lateral", 222.25], [1e3, "vertical", 222.0]]
    hundreds = of_stretches(windows)
    assert hundreds["peak_slipper_force"].tolist() == [1e3, -6e3, 1e3]
    assert hundreds["peak_slipper_moment y"].tolist() == [-30.0] * 3
    assert of_worst(windows).iloc[0].tolist() == [222.25, 100.0, "lateral", -6e3, "C2", 5e3]
    net = plots.run_overview(ds)[3]
    assert legend(net)[-1] == "-6 kN: lateral, 222.25 m"
    assert net.patches[0].get_data()[0][122] == 6.0
    # each stretch has its percentiles, times ten
    assert net.patches[1].get_data()[0].tolist() == [0.0, 30.0, 60.0]


def test_tables_join_windows_as_their_numbers_want():
    windows = of_windows(RunView.of(run()))
    assert windows[["from", "to"]].iloc[[0, -1]].values.tolist() == [[100.0, 101.0], [349.0, 350.0]]
    assert windows["impacts"].tolist() == (6.0 * np.arange(WINDOWS)).tolist()  # of six points
    row = windows.iloc[122]
    assert (row["peak_force"], row["point"], row["peak_distance"], row["status"]) == (5e3, "C2", 222.5, "finite")
    hundreds = of_stretches(windows)
    wanted = {
        "from": [100, 200, 300],
        "to": [200, 300, 350],
        "impacts": [6.0 * sum(range(a, b)) for a, b in ((0, 100), (100, 200), (200, 250))],
        "contact_fraction": [49.5, 149.5, 224.5],
        "peak_a_z": [99, 199, 249],
        "rms_a_z": [1.0, 9.80665, 3.0],
        "point": ["A1", "C2", "A1"],
        "peak_force": [1e3, 5e3, 1e3],
    }
    assert {name: hundreds[name].tolist() for name in wanted} == wanted
    assert hundreds["time"].tolist() == pytest.approx([1.0, 2.0, 2.5])


@pytest.mark.parametrize(("window", "rows"), [(8.0, [13, 12, 6]), (0.5, [124])], ids=["8 m", "0.5 m"])
def test_hundreds_of_metres_are_not_hundreds_of_windows(window, rows):
    count = sum(rows)
    ds = run().isel(distance=slice(0, count)).drop_dims("stretch")
    ds = ds.assign_coords(distance=BEGIN + window * np.arange(1, count + 1)).assign_attrs({"window [m]": window})
    hundreds = of_stretches(of_windows(RunView.of(ds)))
    # by the middles of windows: of 8 m the 13th lies at 96 to 104 m, its middle on the edge
    np.testing.assert_allclose((hundreds["to"] - hundreds["from"]) / window, rows, atol=1)
    assert hundreds["from"].tolist()[1:] == hundreds["to"].tolist()[:-1]


def test_worst_places_lie_apart():
    high = np.full((WINDOWS, 2, 3), 1e3)
    high[[20, 21, 25, 31, 200], 0, 1] = [9e3, 8e3, 7e3, 6e3, 5e3]
    ds = run().assign(peak_force=(("distance", "end", "point"), high)).drop_vars("peak_distance")
    worst = of_worst(of_windows(RunView.of(ds)))
    # without places within windows those are at the windows' ends
    assert worst["peak_distance"].tolist()[:3] == [121.0, 132.0, 301.0]
    assert worst["peak_force"].tolist()[:4] == [9e3, 6e3, 5e3, 1e3]
    assert len(worst) == 10
    assert np.min(np.diff(np.sort(worst["peak_distance"]))) >= 10.0
    assert not len(of_worst(of_windows(RunView.of(ds.assign(peak_force=0 * ds["peak_force"])))))


def test_headers_have_the_units_of_their_numbers():
    plain, feet = (tables(run(), units)["windows"] for units in (None, FEET))
    for name, other, factor in (
        ("from [m]", "from [ft]", 0.3048),
        # the pound-force has a rounded value in no unit system: 0.45359237 kg times standard gravity
        ("peak_force [kN]", "peak_force [lbf]", 4.4482216152605e-3),
        ("rms_a_z [m/s^2]", "rms_a_z [g]", 9.80665),
        ("time [s]", "time [s]", 1.0),
        ("friction_work [J]", "friction_work [ft lbf]", 0.3048 * 4.4482216152605),
        ("impacts", "impacts", 1.0),
    ):
        np.testing.assert_allclose(feet[other] * factor, plain[name], rtol=1e-12)


def test_files_hold_what_the_tables_hold(tmp_path):
    base = tmp_path / "run"
    made = sj.Result(run())
    made.write(f"{base}.nc")
    read = sj.load(f"{base}.nc")
    xr.testing.assert_identical(read.ds, made.ds)
    wanted = made.tables(FEET)
    assert list(wanted) == ["windows", "100 m", "worst places"]
    files = [f"{base}.csv", f"{base}_100m.csv", f"{base}_worstplaces.csv"]
    assert read.write(files[0], units=FEET) == f"wrote {files[0]}, {files[1]} and {files[2]}"
    for table, file in zip(wanted.values(), files, strict=True):
        # nine digits are written
        pd.testing.assert_frame_equal(pd.read_csv(file), table, check_dtype=False, rtol=1e-8)
    read.write(f"{base}.xlsx", units=FEET)
    sheets = pd.read_excel(f"{base}.xlsx", sheet_name=None)
    assert list(sheets) == ["summary", *wanted]
    for name, table in wanted.items():
        pd.testing.assert_frame_equal(sheets[name], table, check_dtype=False, rtol=1e-12)
    words = sheets["summary"]["summary"].tolist()
    assert words == made.summary(FEET)
    assert "highest single contact point 1124 lbf at C2 (rear), 729.99 ft and 328.1 ft/s" in words
    read.write(f"{base}.mat")
    matlab = scipy.io.loadmat(f"{base}.mat", simplify_cells=True)
    np.testing.assert_array_equal(matlab["peak_force"], made["peak_force"])
    assert matlab["point"].tolist() == made["point"].values.tolist()
    assert matlab["attributes"]["window_m"] == 1.0


@pytest.mark.full
def test_a_report_has_whole_fonts_and_several_runs_have_their_picture(tmp_path):
    sj.Result(run()).write(tmp_path / "run.pdf")
    content = (tmp_path / "run.pdf").read_bytes()
    assert b"/Type3" not in content  # outlines, which cannot be searched
    assert len(re.findall(rb"/Type /Page\b", content)) == 2


def test_several_runs_have_a_row_each_and_a_row_for_each_window():
    one, lost = with_net_loads(run()), with_net_loads(run(2))
    both = xr.concat([one, lost], "mass", data_vars="all").assign_coords(mass=("mass", [1.0, 2.0], {"units": "kg"}))
    result = sj.Result(both)
    head, lost_ones = result.summary()
    assert head == "2 runs over mass"
    assert lost_ones.startswith("1 run: derailed")
    made = result.tables(FEET)
    assert list(made) == ["runs", "windows"]
    alone = tables(one, FEET)["windows"]
    windows = made["windows"]
    np.testing.assert_allclose(windows["mass [lb]"], np.repeat([1.0, 2.0], WINDOWS) / 0.45359237, rtol=1e-12)
    pd.testing.assert_frame_equal(windows[:WINDOWS][list(alone)], alone)
    assert windows["status"][WINDOWS:].unique().tolist() == ["derailed"]
    assert windows["peak_force [lbf]"][WINDOWS:].isna().all()
    runs = made["runs"]
    assert runs["status"].tolist() == [0, 2]
    ends = np.array([BEGIN, BEGIN + WINDOWS]) / 0.3048
    np.testing.assert_allclose(runs[["from [ft]", "to [ft]"]], [ends, ends], rtol=1e-12)
    assert runs["impacts"][0] == alone["impacts"].sum()
    k = alone["peak_slipper_force [lbf]"].abs().argmax()
    for name in ("peak_slipper_force [lbf]", "slipper_load", "peak_slipper_distance [ft]"):
        assert runs[name][0] == alone[name][k]
    assert np.isnan(runs["impacts"][1])
    # the greatest RMS of a stretch is not that of the run
    assert not any(name.startswith("rms_") for name in runs)


def test_reports_say_the_run_its_worst_places_and_its_scene_in_a_user_s_units():
    words = report(run(), [*FEET, "lb", "in"])
    assert words[:2] == ["status: finite", "328.08 to 1148.29 ft in 2.5 s, speed 328.1 ft/s"]
    assert "Worst places, 32.81 ft apart or more" in words
    assert any(re.search("clearance 0.03937 in, .* mass 30.865 lb", line) for line in words)
    assert "slipper: Slipper(mass=14 kg, inertia=[0.051, 0.06, 0.086] kg m^2, length=0.2 m)" in words


def test_long_headers_of_a_table_take_several_lines():
    table = pd.DataFrame({"part": ["left1", "cut"], "greatest moment [ft lbf]": [-1234.5678, np.nan], "run": [3, 12]})
    assert lines_of(table) == [
        " part  greatest  run",
        "         moment     ",
        "       [ft lbf]     ",
        "left1     -1235    3",
        "  cut             12",
    ]
    # the worst places of a sled fit a page
    assert max(map(len, lines_of(tables(with_net_loads(run()), FEET)["worst places"], "{:.2f}"))) <= WIDTH


def test_a_lost_run_has_no_numbers_anywhere():
    for code in (1, 2, 3, 4):
        assert summary(run(code)) == [f"status: {sj.Status(code)}"]
    windows = tables(run(2))["windows"].drop(columns=["from [m]", "to [m]", "time [s]", "speed [m/s]"])
    assert windows.pop("status").unique().tolist() == ["derailed"]
    assert (windows.pop("point") == "").all()
    assert windows.isna().all(axis=None)
    assert not any("Worst places" in line for line in report(run(2)))


def test_windows_that_are_lost_are_named_and_left_out():
    codes = np.zeros(WINDOWS, int)
    codes[120:130] = sj.Status.TOO_FEW_STEPS
    ds = run(6).assign(window_status=("distance", codes))
    lines = summary(ds)
    assert lines[:2] == [f"status: {sj.Status.INACCURATE}", "220 to 230 m: too few steps"]
    assert lines[4].startswith("highest single contact point 1 kN at A1 (front), 222 m")
    kept = 6 * (sum(range(WINDOWS)) - sum(range(120, 130)))
    assert f"{kept} impacts, {kept / 2.4:.4g} per second" in lines
    hundreds = tables(ds)["100 m"]
    # other windows have the status of the run
    assert hundreds["status"].tolist() == ["inaccurate", "inaccurate, too few steps", "inaccurate"]
    assert hundreds["impacts"].isna().tolist() == hundreds["peak_force [kN]"].isna().tolist() == [False, True, False]
    # many lengths are counted
    codes[::10] = sj.Status.DERAILED
    assert summary(ds)[9] == "and 18 further lengths with a status"


@pytest.mark.parametrize("name", ["NOT_FINITE", "NOT_RUN", "INACCURATE"])
def test_windows_that_are_not_too_slow_have_the_status_of_their_run(name):
    """As of a speed over time, whose windows know only whether the sled is too slow there."""
    code, said = sj.Status[name], name.lower().replace("_", " ")
    own = np.zeros(WINDOWS, int)
    own[:10] = sj.Status.TOO_SLOW
    ds = run(int(code)).assign(window_status=("distance", own))
    view = RunView.of(ds)
    assert view.codes.tolist() == 10 * [sj.Status.TOO_SLOW] + (WINDOWS - 10) * [code]
    # the status of the run is not repeated for lengths of rail
    assert view.flagged == [(100.0, 110.0, sj.Status.TOO_SLOW)]
    made = tables(ds)
    assert made["windows"]["status"].tolist() == 10 * ["too slow"] + (WINDOWS - 10) * [said]
    assert made["100 m"]["status"].tolist() == [f"too slow, {said}", said, said]
    # no window of a lost run has numbers, also where the sled is too slow
    lost = code != sj.Status.INACCURATE
    assert made["windows"]["peak_force [kN]"].isna().tolist() == WINDOWS * [lost]
    drawn, _ = heights(plots.run_overview(ds)[3])[0]
    assert np.isnan(drawn).tolist() == WINDOWS * [lost]


def test_wrong_files_and_units_are_one_line(tmp_path):
    for wrong, words in (
        (dict(path="run.docx"), "`paths` must end in one of .nc, .png, .svg, .pdf, .csv, .xlsx, .mat, but is"),
        (dict(path="run.csv", units=["foo"]), "`units` must be units of .* but has 'foo'"),
    ):
        with pytest.raises(ValueError, match=words):
            sj.Result(run()).write(tmp_path / wrong.pop("path"), **wrong)
    assert not list(tmp_path.iterdir())


def test_a_run_from_standstill_begins_at_time_zero():
    """The first window takes 1.41 of its length over the speed in its middle."""
    ends = np.arange(1.0, WINDOWS + 1)
    along = dict(speed=("distance", np.sqrt(2 * (ends - 0.5))), seconds=("distance", np.sqrt(2 * ends)))
    assert RunView.of(run().assign_coords(along)).times[0] == 0.0
