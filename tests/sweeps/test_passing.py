"""A fold passed at a rate, and branches followed by slow ramps: runs of which the speed is the parameter.

pytest -m slow -s tests/sweeps/test_passing.py
"""

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj

pytestmark = pytest.mark.slow
STEPS, FOLD = 100, 2234.7236
"""Steps per forcing period, and the fold of the paper's branch with them [m/s]."""
OPTIONS = dict(window=8.0, steps_per_period=STEPS, record=["rms_a_z"])


def ramp(start, first, last, periods):
    """A run over some forcing periods, in which the speed rises from `first` to `last`."""
    begin = float(start["distance"][-1])
    speed = sj.SpeedProgramme.over_distance([begin, begin + 8.0 * periods], [first, last])
    return sj.run(sj.paper_scene(), length=8.0 * periods, speed=speed, start=start, **OPTIONS)


@pytest.fixture(scope="module")
def risen():
    """The motion at 1250 m/s, and the run that has risen from there to 2225 m/s."""
    settled = sj.run(sj.paper_scene(1250.0), length=3200.0, start=sj.table_2_start(), **OPTIONS)
    return ramp(settled, 1250.0, 2225.0, 1000)


def test_slow_ramps_follow_the_branch_up_and_down(risen):
    speeds = [1300.0, 1500.0, 1700.0, 1900.0, 2100.0]
    options = dict(steps_per_period=STEPS, record="rms_a_z", transient=200, periods=10)
    branch = sj.follow(sj.paper_scene(), {"speed": np.arange(1250.0, 2101.0, 50.0)}, **options)["rms_a_z"]
    fallen = ramp(risen, 2225.0, 1250.0, 1000)
    for way, run in (("up", risen), ("down", fallen)):
        on_ramp = xr.DataArray(run["rms_a_z"].values, {"speed": run["speed"].values}, ["speed"]).sortby("speed")
        off = on_ramp.interp(speed=speeds) / branch.sel(direction="up", speed=speeds) - 1
        print(f"\nRMS of the ramp {way} over that of the branch, less 1:", off.values)
        # measured 5e-4 at most
        assert np.all(np.abs(off) < 5e-3)


def test_the_delay_at_a_fold_is_the_two_thirds_power_of_the_rate(risen):
    """The motion leaves the place of the fold where it changes by 2 % from one period to the next."""
    rates, delays = [0.01, 0.02, 0.05, 0.1, 0.2], []
    for rate in rates:
        ds = ramp(risen, 2225.0, 2255.0, round(30 / rate))
        size, speed = ds["rms_a_z"].values, ds["speed"].values
        before = np.interp(FOLD - 1.0, speed, size)
        left = np.flatnonzero((np.abs(size - before) > 0.02 * before) & (speed > FOLD))
        delays.append(speed[left[0]] - FOLD)
    exponent = np.polyfit(np.log(rates), np.log(delays), 1)[0]
    print(f"\nm/s per period {rates}: left {np.round(delays, 2)} m/s after the fold; exponent {exponent:.3f}")
    # the theory of a fold passed slowly has 2/3 (Haberman 1979, doi:10.1137/0137006)
    assert abs(exponent - 2 / 3) < 0.05
