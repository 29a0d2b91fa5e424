"""Batches: equal to one by one, whatever the chunks; failing cases apart; labelled results."""

import numpy as np
import pytest

import slipperjax as sj

from .common import columns

SPEEDS = np.array([900.0, 1100.0, 1250.0, 1500.0, 2000.0])
OPTIONS = dict(transient=2, periods=3, steps_per_period=100)


@pytest.fixture(scope="module")
def strobe():
    return sj.sweep(sj.paper_scene(), {"speed": SPEEDS}, record="strobe", chunk=2, **OPTIONS)


def test_batch_equals_one_by_one(strobe):
    for k in (0, 3):
        one = sj.simulate(sj.paper_scene(SPEEDS[k]), 6, steps_per_period=100, saves_per_period=1)
        many = np.stack(
            [strobe[n].values[k] for n in ("y", "z", "roll", "pitch", "yaw", "v_y", "v_z", "w_x", "w_y", "w_z")]
        )
        # measured 1e-13; sums are reassociated differently in a batch. The transient is rounded up to 3 periods.
        np.testing.assert_allclose(many.T, columns(one)[4:7], rtol=1e-9, atol=1e-11)
    assert strobe.attrs["transient"] == 3
    assert strobe["v_y"].dims == ("speed", "period")
    assert strobe["w_x"].attrs["units"] == "rad/s"


def test_chunks_and_threads_change_no_bit(strobe):
    other = sj.sweep(sj.paper_scene(), {"speed": SPEEDS}, record="strobe", chunk=4, workers=1, **OPTIONS)
    for name in strobe.data_vars:
        np.testing.assert_array_equal(strobe[name].values, other[name].values)


def test_a_failing_case_is_flagged_and_leaves_the_others_untouched(strobe):
    speeds = SPEEDS.copy()
    speeds[1] = 1e-3  # a period of hours in 100 steps: the first contact throws it out of the finite numbers
    with_failure = sj.sweep(sj.paper_scene(), {"speed": speeds}, record="strobe", chunk=2, **OPTIONS)
    assert with_failure["status"].values.tolist() == [0, 1, 0, 0, 0]
    good = [0, 2, 3, 4]
    np.testing.assert_array_equal(with_failure["v_y"].values[good], strobe["v_y"].values[good])
    assert "raise steps_per_period" in with_failure["status"].attrs["meaning"]


def test_sections_of_a_product_grid():
    grid = {"speed": [1250.0, 1500.0], "clearance": [0.5e-3, 1e-3, 2e-3]}
    ds = sj.sweep(sj.paper_scene(), grid, transient=4, periods=2, steps_per_period=100)
    assert ds["v_y"].dims == ("speed", "clearance", "crossing")
    assert ds["v_y"].shape[:2] == (2, 3)
    assert np.all(ds["status"].values == 0)
    # the crossings are those of a finely saved trajectory
    case = ds.sel(speed=1250.0, clearance=1e-3)
    fine = sj.simulate(sj.paper_scene(), 6, steps_per_period=100, saves_per_period=100)
    y, v = np.asarray(fine.state.motion.y)[400:], np.asarray(fine.state.motion.v_y)[400:]
    at = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    found = case["v_y"].values[~np.isnan(case["v_y"].values)]
    assert len(found) == len(at) >= 2
    low, high = np.minimum(v[at], v[at + 1]), np.maximum(v[at], v[at + 1])
    assert np.all((found > low - 1e-3) & (found < high + 1e-3))


def test_history_matches_simulate():
    options = dict(transient=0, periods=2, steps_per_period=100, saves_per_period=10)
    ds = sj.sweep(sj.paper_scene(), {"length": [0.2, 0.3]}, record="history", **options)
    one = sj.simulate(sj.paper_scene(), 2, steps_per_period=100, saves_per_period=10).to_xarray()
    np.testing.assert_allclose(ds["y"].values[0], one["y"].values[1:], atol=1e-12)
    np.testing.assert_allclose(ds["contact_force"].values[0], one["contact_force"].values[1:], atol=1e-6)
    np.testing.assert_allclose(ds["period"].values, one["period"].values[1:], atol=1e-12)
    assert one["contact_force"].dims == ("time", "end", "point")
    assert one["time"].attrs["units"] == "s"
