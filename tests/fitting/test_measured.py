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
VALUES = np.arange(12.0)


def dataset(time=TIME, **more):
    data = {"front": ("time", VALUES, {"units": "m/s^2"}), "lift": ("time", VALUES, {"units": "mm"})}
    return xr.Dataset(data | more, {"time": ("time", time, {"units": "s"})})


def run_of(measured, rig=RIG):
    (run,) = measured_runs(measured, rig)
    return run


@pytest.fixture
def table(tmp_path):
    """Writes a table, and returns its path."""

    def write(head, rows):
        path = tmp_path / "run.csv"
        path.write_text("\n".join([head, *rows]))
        return path

    return write


def test_a_table_with_units_and_missing_samples(table):
    rows = [f"{k},{'' if k == 3 else k},{k if k % 2 else '-9999'},900" for k in range(16)]
    run = run_of(table("# time [ms], front [g], lift [mm], speed [m/s]", rows))
    front, lift = run.signals
    assert run.settings == {"speed": 900.0}
    known = np.delete(np.arange(16), 3)
    np.testing.assert_allclose([front.time, front.value], np.outer([1e-3, STANDARD_GRAVITY], known))
    # every second sample only
    np.testing.assert_allclose(lift.value, 1e-3 * np.arange(1, 16, 2))


def test_signals_may_have_times_of_their_own_and_runs_some_of_them():
    late = xr.Dataset(
        {"lift": ("lift_time", np.arange(9.0), {"units": "m"})},
        {"lift_time": ("lift_time", 1.0 + np.arange(9.0), {"units": "ms"}), "speed": ((), 500.0, {"units": "ft/s"})},
    )
    run = run_of(dataset().drop_vars("lift").merge(late))
    np.testing.assert_allclose(run.signals[1].time, 1e-3 * (1 + np.arange(9)))
    np.testing.assert_allclose(run.settings["speed"], 152.4)
    one, other = measured_runs([dataset().drop_vars("lift"), dataset().drop_vars("front")], RIG)
    assert one.signals[1].time.size == other.signals[0].time.size == 0


def test_marks_of_overload_are_missing_with_a_word():
    values = np.append(9.9e37, np.arange(11.0))
    with pytest.warns(sj.ImplausibleWarning, match=r"front has marks of overload, such as 9\.9e\+37: 1 samples"):
        run = run_of(dataset(front=("time", values, {"units": "m/s^2"})))
    np.testing.assert_array_equal(run.signals[0].value, np.arange(11.0))


def test_samples_before_the_run_are_left_out():
    with pytest.warns(sj.ImplausibleWarning, match="has samples of front before zero seconds, which are left out"):
        run = run_of(dataset(TIME - 0.002).drop_vars("lift"), Rig.of([sj.model.Sensor("front")]))
    np.testing.assert_array_equal(run.signals[0].value, VALUES[2:])


BAD = {
    "`measured` must have one run or more": [],
    "`measured` must be a dataset or a file, or a list of them": [1.0],
    "must have signals of the sensors front, lift alone, but has rear, too": dataset(rear=("time", TIME)),
    "`measured` must have the signal of each sensor, such as lift": dataset().drop_vars("lift"),
    "with a coordinate of times": dataset().drop_vars("time"),
    "`measured` must have an attribute `units` of lift, such as m": dataset(lift=("time", TIME)),
    "`lift` must be in m, but is .* Cannot convert": dataset(lift=("time", TIME, {"units": "s"})),
    "`measured` must have 8 samples or more of front": dataset().isel(time=slice(5)),
    "`measured` must have increasing times of front": dataset().isel(time=slice(None, None, -1)),
    "front from zero seconds on": dataset(TIME - 1),
    "and not be times of a clock": dataset(TIME + 1.7e9),
}
BAD_TABLES = {
    "must have a column `time`": "front [g], lift [mm]",
    "`front` must be in a unit like m/s": "time [s], front [mm]",
    "one value of speed, which a run keeps, but has 9 values": "time [s], front [g], speed [m/s]",
}


@pytest.mark.parametrize("text", [*BAD, *BAD_TABLES])
def test_bad_records_are_refused(table, text):
    measured = BAD[text] if text in BAD else table(BAD_TABLES[text], [f"{k}, {k}, {k}" for k in range(9)])
    with pytest.raises(ValueError, match=text) as error:
        measured_runs(measured, RIG)
    assert text in BAD_TABLES or "\n" not in str(error.value)
