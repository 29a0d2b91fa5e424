"""Loads that size parts: means over time, loads at mounts and within a sled, over runs and over rails."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model import Cut
from slipperjax.sweeps import loads
from slipperjax.sweeps.loads import _greatest_mean

from ..common import sled_on

RECORDS = ["slipper_peak", "slipper_load", "body_acceleration"]
SLED = sj.Scene(
    speed=300.0,
    slipper=sled_on(),
    section=sj.model.paper_section(1e-3),
    track=sj.model.TwoRails(sj.HarmonicTrack((8.0,), 1e-3), sj.HarmonicTrack((8.0,), 0.7e-3)),
    contact=sj.model.Flores(1e8, 0.6),
    gravity=9.81,
)
HALF = Cut(x=0.0, mass=200.0, centre=(0.6, 0.0, 0.0), inertia=(75.0, 80.0, 90.0), name="middle")
WHOLE = Cut(x=-3.0, mass=400.0, centre=(0.0, 0.0, 0.0), inertia=(150.0, 300.0, 350.0))


@pytest.fixture(scope="module")
def runs():
    """Eight runs of 6 m over speed."""
    speeds = np.linspace(280.0, 320.0, 8)
    return sj.run(SLED, {"speed": speeds}, length=6.0, record=RECORDS, start="rest")


@pytest.fixture(scope="module")
def report(runs):
    return loads(runs, means=[1e-3, 5e-3], cuts=[HALF, WHOLE], over="speed", quantiles=[0.5, 0.95])


def test_greatest_means_of_a_pulse_follow_the_closed_form():
    length, duration, height = 2e-3, 1e-3, -7.0
    time = np.linspace(0.0, 20e-3, 2001)
    inside = (time > 4e-3) & (time < 4e-3 + length)
    pulse = np.where(inside, height * np.sin(np.pi * (time - 4e-3) / length), 0.0)
    mean, at = _greatest_mean(pulse[:, None, None], time, duration)
    closed = height * 2 * length / (np.pi * duration) * np.sin(np.pi * duration / (2 * length))
    assert mean.item() == pytest.approx(closed, rel=1e-4)  # measured 2e-5
    assert at.item() == pytest.approx(5e-3, abs=1e-5)


@pytest.mark.full
def test_loads_of_all_mounts_and_inertia_of_the_whole_sled_balance(report):
    # a cut behind the sled carries nothing
    greatest = abs(report["slipper_force"]).max()
    assert abs(report["cut_force"].sel(cut="cut2")).max() < 1e-6 * greatest
    # forces are along the track's axes, moments along the body's, which lean by milliradians: measured 4e-4 m
    assert abs(report["cut_moment"].sel(cut="cut2")).max() < 1e-3 * greatest
    assert abs(report["cut_moment"].sel(cut="middle")).max() > 0.1 * greatest


@pytest.mark.full
def test_peaks_are_those_of_the_run_and_means_are_smaller(runs, report):
    peaks = runs["peak_slipper_force"]
    np.testing.assert_array_equal(abs(report["slipper_force"].sel(mean=0.0)), abs(peaks).max("distance"))
    sizes = abs(report["slipper_force"])
    assert (sizes.diff("mean") < 0).all()
    place = report["slipper_force_distance"].sel(mean=1e-3)
    assert ((place > 0) & (place < 6)).all()
    np.testing.assert_array_equal(report["slipper_force_speed"].sel(mean=0.0).isel(speed=0), 280.0)


@pytest.mark.full
def test_at_rest_a_mount_carries_its_static_share_and_the_middle_bends_as_a_beam():
    still = dataclasses.replace(SLED, track=sj.model.TwoRails(sj.model.StraightTrack(), sj.model.StraightTrack()))
    found = loads(sj.run(still, length=2.0, record=RECORDS, start="rest"), means=[1e-3], cuts=[HALF])
    share = found["slipper_force"].sel(axis="z")
    np.testing.assert_allclose(share, 400.0 * 9.81 / 4, rtol=1e-6)  # measured below 1e-9
    # 981 N at each of two slippers 1.2 m before the middle, and 1962 N of weight 0.6 m before it
    np.testing.assert_allclose(found["cut_moment"].sel(about="y", mean=1e-3), 1177.2, rtol=1e-6)
    np.testing.assert_allclose(found["cut_force"].sel(axis="z"), 0.0, atol=1e-3)


@pytest.mark.full
def test_quantiles_over_independent_runs_have_errors(report):
    median = report["slipper_force_value"].sel(quantile=0.5)
    sizes = abs(report["slipper_force"])
    assert ((median > sizes.min("speed")) & (median < sizes.max("speed"))).all()
    assert (report["slipper_force_stderr"].sel(quantile=0.5) > 0).all()
    assert (report["slipper_force_low"] <= report["slipper_force_value"]).sel(quantile=0.5).all()
    # 0.95 needs 80 runs
    assert report["slipper_force_value"].sel(quantile=0.95).isnull().all()


@pytest.mark.full
def test_a_lost_run_is_left_out(runs):
    flagged = runs.ds.copy()
    codes = flagged["status"].values.copy()
    codes[0] = int(sj.Status.NOT_RUN)
    flagged["status"] = flagged["status"].copy(data=codes)
    found = loads(flagged, means=[1e-3])
    assert found["slipper_force"].isel(speed=0).isnull().all()
    assert found["slipper_force"].isel(speed=slice(1, None)).notnull().all()


@pytest.mark.full
@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (lambda ds: ds.drop_vars("peak_slipper_force"), {}, '`runs` must be .*"slipper_peak"'),
        (lambda ds: ds.drop_vars("slipper_load"), {"means": [1e-3]}, '`runs` must have the record "slipper_load"'),
        (lambda ds: ds.drop_vars("body_acceleration"), {"cuts": [HALF]}, '`runs` must have .*"body_acceleration"'),
        (lambda ds: ds, {"means": [-1.0]}, "`means` must be"),
        (lambda ds: ds, {"means": [10.0]}, "`means` must be shorter than the run"),
        (lambda ds: ds, {"cuts": [1.0]}, "`cuts` must be a list of"),
        (lambda ds: ds, {"over": "rail"}, "`over` must be one of speed"),
    ],
)
def test_wrong_arguments_are_named(runs, change, options, words):
    with pytest.raises(ValueError, match=words):
        loads(change(runs.ds), **options)
