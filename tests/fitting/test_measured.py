"""Measured runs: units, gaps, unequal times, known parameters, and what is refused."""

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.fitting.measured import measured_runs
from slipperjax.model.sensors import Rig
from slipperjax.tools.units import STANDARD_GRAVITY

RIG = Rig.of([sj.model.Sensor("front"), sj.model.Sensor("lift", "displacement")])
TIME = np.arange(12) * 1e-3


def dataset(**more):
    data = {
        "front": ("time", np.arange(12.0), {"units": "m/s^2"}),
        "lift": ("time", np.arange(12.0), {"units": "mm"}),
    }
    return xr.Dataset(data | more, {"time": ("time", TIME, {"units": "s"})})


def test_a_table_with_units_and_missing_samples(tmp_path):
    rows = [f"{k},{'' if k == 3 else k},{k if k % 2 else '-9999'},900" for k in range(16)]
    path = tmp_path / "run.csv"
    path.write_text("time [ms], front [g], lift [mm], speed [m/s]\n" + "\n".join(rows))
    (run,) = measured_runs(path, RIG)
    front, lift = run.signals
    assert run.settings == {"speed": 900.0}
    np.testing.assert_allclose(front.time, 1e-3 * np.delete(np.arange(16), 3))
    np.testing.assert_allclose(front.value, STANDARD_GRAVITY * np.delete(np.arange(16), 3))
    # every second sample only
    np.testing.assert_allclose(lift.value, 1e-3 * np.arange(1, 16, 2))
    assert run.end == 0.015


def test_signals_may_have_times_of_their_own():
    ds = dataset().drop_vars("lift")
    late = xr.Dataset(
        {"lift": ("lift_time", np.arange(9.0), {"units": "m"})},
        {"lift_time": ("lift_time", 1.0 + np.arange(9.0), {"units": "ms"}), "speed": ((), 500.0, {"units": "ft/s"})},
    )
    (run,) = measured_runs(ds.merge(late), RIG)
    np.testing.assert_allclose(run.signals[1].time, 1e-3 * (1 + np.arange(9)))
    np.testing.assert_allclose(run.settings["speed"], 152.4)


def test_times_may_be_durations_and_no_dates():
    ds = dataset()
    for unit in ({}, {"units": "s"}):
        (run,) = measured_runs(ds.assign_coords(time=("time", np.arange(12).astype("timedelta64[ms]"), unit)), RIG)
        np.testing.assert_allclose(run.signals[0].time, TIME, rtol=1e-14)
    dates = np.datetime64("2026-01-01") + np.arange(12).astype("timedelta64[ms]")
    with pytest.raises(ValueError, match=r"`time` must be in s, but is .* dates have no beginning"):
        measured_runs(ds.assign_coords(time=("time", dates)), RIG)


def test_marks_of_overload_are_missing_with_a_word(tmp_path):
    values = np.append(9.9e37, np.arange(11.0))
    with pytest.warns(sj.ImplausibleWarning, match=r"front has marks of overload, such as 9\.9e\+37: 1 samples"):
        (run,) = measured_runs(dataset(front=("time", values, {"units": "m/s^2"})), RIG)
    np.testing.assert_array_equal(run.signals[0].value, np.arange(11.0))
    cells = ["1", "NaN", "OVL", "-9.97e36", "N/A", "-9999.00", *map(str, range(10))]
    path = tmp_path / "run.csv"
    path.write_text("# time [s], front [g], lift [mm]\n" + "\n".join(f"{k},{cell},1" for k, cell in enumerate(cells)))
    with pytest.warns(sj.ImplausibleWarning, match="`front` has marks of overload, such as inf: 2 samples"):
        (run,) = measured_runs(path, RIG)
    np.testing.assert_allclose(run.signals[0].time, [0, *range(6, 16)])


def test_samples_before_the_run_are_left_out():
    rig = Rig.of([sj.model.Sensor("front")])
    early = dataset().drop_vars("lift").assign_coords(time=("time", TIME - 0.002, {"units": "s"}))
    with pytest.warns(sj.ImplausibleWarning, match="has samples of front before zero seconds, which are left out"):
        (run,) = measured_runs(early, rig)
    np.testing.assert_array_equal(run.signals[0].value, np.arange(2.0, 12.0))


def test_several_runs_share_the_sensors():
    one, other = measured_runs([dataset().drop_vars("lift"), dataset().drop_vars("front")], RIG)
    assert one.signals[1].time.size == 0
    assert other.signals[0].time.size == 0


BAD = {
    "`measured` must have one run or more": [],
    "must have signals of the sensors front, lift alone, but has rear, too": dataset(rear=("time", TIME)),
    "`measured` must have the signal of each sensor, such as lift": dataset().drop_vars("lift"),
    "with a coordinate of times": dataset().drop_vars("time"),
    "`measured` must have an attribute `units` of lift, such as m": dataset(lift=("time", TIME)),
    "`lift` must be in m, but is .* Cannot convert": dataset(lift=("time", TIME, {"units": "s"})),
    "`measured` must have 8 samples or more of front": dataset().isel(time=slice(5)),
    "`measured` must have increasing times of front": dataset().isel(time=slice(None, None, -1)),
    "front from zero seconds on": dataset().assign_coords(time=("time", TIME - 1, {"units": "s"})),
    "and not be times of a clock": dataset().assign_coords(time=("time", TIME + 1.7e9, {"units": "s"})),
}


@pytest.mark.parametrize("text", BAD)
def test_bad_records_are_refused_in_one_line(text):
    with pytest.raises(ValueError, match=text) as error:
        measured_runs(BAD[text], RIG)
    assert "\n" not in str(error.value)


def test_a_table_without_times_or_with_other_units_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    rows = "".join(f"\n{k}, {k}, {k}" for k in range(9))
    for text, words in (
        ("front [g], lift [mm]\n1, 2\n", "must have a column `time`"),
        ("time [s], front [mm]\n1, 2\n", "`front` must be in a unit like m/s"),
        (f"time [s], front [g], speed [m/s]{rows}", "one value of speed, which a run keeps, but has 9 values"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            measured_runs(path, RIG)
