"""Reports of runs: words, tables and files, of datasets made by hand."""

import io
import re

import numpy as np
import pandas as pd
import pytest

import slipperjax as sj
from slipperjax import plots
from slipperjax.flow.datasets import dataset_of
from slipperjax.plots.report import MAKERS, _of_run, described, pages_of, summary
from slipperjax.plots.runs import RunView
from slipperjax.plots.tables import of_hundreds, of_windows, of_worst, tables

from .shown import legend
from .test_runs import BEGIN, WINDOWS, made

FEET = ("ft", "lbf", "g")


def run(status=0, **variables):
    """Gives the run of `made`, with impacts, friction and a number of each direction, of 0 to 249 in its windows."""
    ds, count = made(status), np.arange(float(WINDOWS))
    each = np.broadcast_to(count[:, None, None], (WINDOWS, 2, 3))
    more = {name: (("distance", "end", "point"), each) for name in ("impacts", "friction_work", "contact_fraction")}
    more["spring_force"] = (
        ("distance", "direction"),
        count[:, None] * [1.0, 2.0],
        {"units": "N", "shown_unit": "kN"},
    )
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
    scene = sj.paper_scene().replace(gravity=10.0)
    view = RunView.of(with_net_loads(run()), scene)
    lines = summary(view)
    assert lines[2:6] == [
        "greatest net vertical force of a slipper 1 kN at 222 m and 100 m/s: 7.14 times its static load of 0.14 kN",
        "greatest net lateral force of a slipper -6 kN at 222.25 m and 100 m/s",
        "greatest net moments of a slipper about its middle: x 10 N m, y 30 N m, z 20 N m",
        "highest single contact point 5 kN at C2 (rear), 222.5 m and 100 m/s",
    ]
    assert any("greatest net force of a slipper: 80 kN from 300 to 350 m" in line for line in lines)
    windows = of_windows(view)
    assert windows.columns[5:11].tolist() == [
        *("peak_slipper_force", "slipper_load", "peak_slipper_distance"),
        *("peak_force", "point", "peak_distance"),
    ]
    assert windows.iloc[122, 5:8].tolist() == [-6e3, "lateral", 222.25]
    assert windows.iloc[0, 5:7].tolist() == [1e3, "vertical"]
    hundreds = of_hundreds(windows)
    assert hundreds["peak_slipper_force"].tolist() == [1e3, -6e3, 1e3]
    assert hundreds["peak_slipper_force y"].tolist() == [0.5e3, -6e3, 0.5e3]
    assert hundreds["peak_slipper_moment y"].tolist() == [-30.0] * 3
    worst = of_worst(windows).iloc[0]
    assert worst.tolist() == [222.25, 100.0, "lateral", -6e3, "C2", 5e3]
    _, along, _ = pages_of(_of_run(view))
    net, single = along.axes[3:5]
    assert [ax.get_ylabel() for ax in (net, single)] == [
        "net force\nof a slipper [kN]",
        "highest single\ncontact point [kN]",
    ]
    assert legend(net) == ["lateral, 6 kN", "vertical, 1 kN"]
    overview = plots.run_overview(view.ds, scene)
    assert [ax.get_ylabel() for ax in overview[3:5]] == [net.get_ylabel(), single.get_ylabel()]
    assert legend(overview[3])[-1] == "-6 kN: lateral, 222.25 m"
    assert overview[3].patches[0].get_data()[0][122] == 6.0
    # each stretch has its percentiles, times ten
    assert overview[3].patches[1].get_data()[0].tolist() == [0.0, 30.0, 60.0]


def test_tables_join_windows_as_their_numbers_want():
    windows = of_windows(RunView.of(run(), sj.paper_scene()))
    assert len(windows) == WINDOWS
    assert windows[["from", "to"]].iloc[[0, -1]].values.tolist() == [[100.0, 101.0], [349.0, 350.0]]
    assert windows["impacts"].tolist() == (6.0 * np.arange(WINDOWS)).tolist()  # of six points
    assert windows["contact_fraction"].tolist() == np.arange(WINDOWS).tolist()
    assert windows["spring_force vertical"].tolist() == (2.0 * np.arange(WINDOWS)).tolist()
    row = windows.iloc[122]
    assert (row["peak_force"], row["point"], row["peak_distance"], row["status"]) == (5e3, "C2", 222.5, "finite")
    assert windows["rms_a_z"].value_counts().to_dict() == {1.0: 100, 9.80665: 100, 3.0: 50}
    hundreds = of_hundreds(windows)
    assert hundreds[["from", "to"]].values.tolist() == [[100, 200], [200, 300], [300, 350]]
    assert hundreds["impacts"].tolist() == [6.0 * sum(range(a, b)) for a, b in ((0, 100), (100, 200), (200, 250))]
    assert hundreds["contact_fraction"].tolist() == [49.5, 149.5, 224.5]
    assert hundreds["peak_a_z"].tolist() == [99, 199, 249]
    assert hundreds["rms_a_z"].tolist() == [1.0, 9.80665, 3.0]
    assert hundreds["time"].tolist() == pytest.approx([1.0, 2.0, 2.5])
    assert hundreds["point"].tolist() == ["A1", "C2", "A1"]
    assert hundreds["peak_force"].tolist() == [1e3, 5e3, 1e3]


@pytest.mark.parametrize(("window", "rows"), [(8.0, [13, 12, 6]), (0.5, [124])], ids=["8 m", "0.5 m"])
def test_hundreds_of_metres_are_not_hundreds_of_windows(window, rows):
    count = sum(rows)
    ds = run().isel(distance=slice(0, count))
    ds = ds.assign_coords(distance=BEGIN + window * np.arange(1, count + 1)).assign_attrs({"window [m]": window})
    ds = ds.drop_dims("stretch")
    hundreds = of_hundreds(of_windows(RunView.of(ds)))
    # by the middles of windows: of 8 m the 13th lies at 96 to 104 m, its middle on the edge
    lengths = (hundreds["to"] - hundreds["from"]) / window
    assert lengths.sum() == count
    assert len(hundreds) == len(rows)
    assert (abs(lengths - np.array(rows)) <= 1).all()
    assert hundreds["from"].tolist()[1:] == hundreds["to"].tolist()[:-1]


def test_worst_places_lie_apart():
    high = np.full((WINDOWS, 2, 3), 1e3)
    high[[20, 21, 25, 31, 200], 0, 1] = [9e3, 8e3, 7e3, 6e3, 5e3]
    ds = run().assign(peak_force=(("distance", "end", "point"), high)).drop_vars("peak_distance")
    worst = of_worst(of_windows(RunView.of(ds)))
    # without places within windows those are at the windows' ends
    assert worst["peak_distance"].tolist()[:3] == [121.0, 132.0, 301.0]
    assert worst["peak_force"].tolist()[:4] == [9e3, 6e3, 5e3, 1e3]
    assert worst["point"].tolist()[:3] == ["B1"] * 3
    assert len(worst) == 10
    apart = np.abs(np.subtract.outer(worst["peak_distance"].values, worst["peak_distance"].values))
    assert np.min(apart + 1e3 * np.eye(10)) >= 10.0
    empty = of_worst(of_windows(RunView.of(ds.assign(peak_force=0 * ds["peak_force"]))))
    assert not len(empty)


def test_headers_have_the_units_of_their_numbers():
    plain, feet = (tables(RunView.of(run(), units=units))["windows"] for units in (None, FEET))
    names = ["from [m]", "to [m]", "time [s]", "speed [m/s]", "status", "peak_force [kN]", "point"]
    names += ["peak_distance [m]", "impacts", "friction_work [J]", "contact_fraction", "spring_force lateral [kN]"]
    names += ["spring_force vertical [kN]", "peak_a_z [m/s^2]", "rms_a_z [m/s^2]"]
    assert list(plain) == names
    changed = {"[m]": "[ft]", "[kN]": "[lbf]", "[m/s^2]": "[g]"}
    for name, values in plain.items():
        unit = name[name.index("[") :] if "[" in name else ""
        factor = {"[m]": 0.3048, "[kN]": 4.4482216152605e-3, "[m/s^2]": 9.80665}.get(unit)
        other = feet[name.replace(unit, changed.get(unit, unit)) if unit else name]
        if factor:
            # the pound-force has a rounded value in no unit system: 0.45359237 kg times standard gravity
            np.testing.assert_allclose(other * factor, values, rtol=1e-12)
        else:
            assert other.tolist() == values.tolist()


def test_files_hold_what_the_tables_hold(tmp_path):
    ds = run()
    ds.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    from_file = dataset_of(tmp_path / "run.nc")
    wanted = tables(RunView.of(ds, units=FEET))
    assert from_file.slipper.report(tmp_path / "run.csv", FEET) == (
        f"wrote {tmp_path / 'run'}.csv and {tmp_path / 'run'}_100m.csv"
    )
    for name, end in (("windows", ".csv"), ("100 m", "_100m.csv")):
        found = pd.read_csv(f"{tmp_path / 'run'}{end}")
        # nine digits are written
        pd.testing.assert_frame_equal(found, wanted[name], check_dtype=False, rtol=1e-8)
    assert plots.report(ds, tmp_path / "run.xlsx", FEET) == f"wrote {tmp_path / 'run.xlsx'}"
    sheets = pd.read_excel(tmp_path / "run.xlsx", sheet_name=None)
    assert list(sheets) == ["summary", *wanted]
    for name, table in wanted.items():
        pd.testing.assert_frame_equal(sheets[name], table, check_dtype=False, rtol=1e-12)
    assert sheets["summary"]["summary"][0] == "status: finite"
    assert (
        "highest single contact point 1124 lbf at C2 (rear), 729.99 ft and 100 m/s"
        in sheets["summary"]["summary"].values
    )


@pytest.mark.full
def test_pages_have_whole_fonts_and_lines_instead_of_pixels():
    content = MAKERS[".pdf"](_of_run(RunView.of(run(), sj.paper_scene())))
    assert content.startswith(b"%PDF")
    assert b"/Subtype /Type0" in content  # TrueType, which can be searched; Type3 would be outlines
    assert b"/Type3" not in content
    assert b"/Subtype /Image" not in content
    assert len(re.findall(rb"/Type /Page\b", content)) == 3


def test_pages_show_the_envelope_of_points_impacts_and_spectra():
    text, along, spectra = pages_of(_of_run(RunView.of(run(), sj.paper_scene(), FEET)))
    lines = text.texts[-1].get_text().splitlines()
    assert lines[0] == "status: finite"
    assert lines[1] == "328.08 to 1148.29 ft in 2.5 s, speed 100 m/s"
    header = ["peak_distance", "[ft]", "speed", "[m/s]", "point", "peak_force", "[lbf]"]
    assert header in [line.split() for line in lines]
    assert "slipper: Slipper(mass=14 kg, inertia=[0.051, 0.06, 0.086] kg m^2, length=0.2 m)" in lines
    force, impacts = along.axes[3:5]
    assert impacts.get_xlabel() == "distance [ft]"
    assert legend(force)[0] == "C2, 1124 lbf"
    assert len(legend(force)) == 5
    values, edges, _ = force.patches[0].get_data()
    # windows are joined by two, and the highest stays
    assert (len(values), np.nanmax(values)) == (125, pytest.approx(5e3 / 4.4482216152605))
    assert edges[[0, -1]] == pytest.approx([100 / 0.3048, 350 / 0.3048])
    (bars,) = impacts.patches
    per = [6.0 * sum(range(a, b)) * 100 / (b - a) for a, b in ((0, 100), (100, 200), (200, 250))]
    assert bars.get_data()[0] == pytest.approx(per)
    (ax,) = spectra.axes
    assert legend(ax) == ["mean of all stretches", "highest stretch"]
    mean, highest = (patch.get_data()[0] for patch in ax.patches)
    assert highest[1:3] == pytest.approx(np.array([3.0, 40.0]) / 9.80665)
    # a stretch without a band is no zero
    assert mean[1:3] == pytest.approx(np.sqrt([(1 + 9) / 2, (4 + 1600 + 36) / 3]) / 9.80665)


@pytest.mark.parametrize("code", [1, 2, 3, 4])
def test_a_lost_run_has_no_numbers_anywhere(code):
    view = RunView.of(run(code), sj.paper_scene())
    assert summary(view) == [f"status: {sj.Status(code)}"]
    windows = tables(view)["windows"]
    assert (
        windows.drop(columns=["from [m]", "to [m]", "time [s]", "speed [m/s]", "status", "point"])
        .isna()
        .all(axis=None)
    )
    assert windows["status"].unique().tolist() == [sj.Status(code).name.lower().replace("_", " ")]
    assert (windows["point"] == "").all()
    text, along = pages_of(_of_run(view))
    assert "Worst places" not in text.texts[-1].get_text()
    assert [ax.get_ylabel() for ax in along.axes if ax.get_ylabel()][-2:] == ["speed $V$ [m/s]", "time [s]"]
    assert len(pd.read_excel(io.BytesIO(MAKERS[".xlsx"](_of_run(view))), "worst places")) == 0


def test_windows_that_are_lost_are_named_and_left_out():
    codes = np.zeros(WINDOWS, int)
    codes[120:130] = sj.Status.TOO_FEW_STEPS
    view = RunView.of(run(6).assign(window_status=("distance", codes)), sj.paper_scene())
    lines = summary(view)
    assert lines[0] == f"status: {sj.Status.INACCURATE}"
    assert lines[1:4] == [
        "220 to 230 m: too few steps",
        "100 to 350 m in 2.5 s, speed 100 m/s",
        "without the lengths that have no meaning:",
    ]
    assert lines[4].startswith("highest single contact point 1 kN at A1 (front), 222 m")
    kept = 6 * (sum(range(WINDOWS)) - sum(range(120, 130)))
    assert f"{kept} impacts, {kept / 2.4:.4g} per second" in lines
    hundreds = tables(view)["100 m"]
    assert hundreds["status"].tolist() == ["finite", "finite, too few steps", "finite"]
    assert hundreds["impacts"].isna().tolist() == hundreds["peak_force [kN]"].isna().tolist() == [False, True, False]
    # many lengths are counted
    codes[::10] = sj.Status.DERAILED
    lines = summary(RunView.of(run(6).assign(window_status=("distance", codes))))
    assert lines[8:10] == ["170 to 171 m: derailed", "and 18 further lengths with a status"]


def test_a_part_of_a_run_takes_its_own_time():
    whole, part = (RunView.of(run().isel(distance=slice(*ends))) for ends in ((0, 250), (100, 150)))
    assert whole.times[[0, -1]] == pytest.approx([0.0, 2.5])
    assert part.times[[0, -1]] == pytest.approx([1.0, 1.5])
    # uniformly accelerated from standstill: the first window takes 1.41 of its length over the speed in its middle
    ends = np.arange(1.0, WINDOWS + 1)
    at_rest = run().assign_coords(
        speed=("distance", np.sqrt(2 * (ends - 0.5))), seconds=("distance", np.sqrt(2 * ends))
    )
    assert RunView.of(at_rest).times[0] == 0.0


def test_scenes_are_told_in_a_user_s_units():
    numbers, *parts = described(RunView.of(run(), sj.paper_scene(), ["lb", "in"]))
    assert numbers.startswith("speed 1250 m/s, clearance 0.03937 in, length 0.2 m, mass 30.865 lb")
    assert [part.split(":")[0] for part in parts][:3] == ["slipper", "section", "track"]


def test_wrong_files_and_units_are_one_line(tmp_path):
    for wrong, words in (
        (dict(file=tmp_path / "run.docx"), "`file` must end in one of .pdf, .csv, .xlsx, but is 'run.docx'"),
        (dict(file=tmp_path / "run"), "`file` must end in one of"),
        (dict(file=tmp_path / "run.csv", units=["foo"]), "`units` must be units of .* but has 'foo'"),
    ):
        with pytest.raises(ValueError, match=words):
            plots.report(**{"ds": run()} | wrong)
    assert not list(tmp_path.iterdir())
