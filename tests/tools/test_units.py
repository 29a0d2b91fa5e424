"""Units of whatever brings its own: texts, pint, xarray, pandas, durations; and numbers that are masked.

tests/test_silent_inputs.py has them in the arguments of the package.
"""

import datetime
import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.tools.checks import finite, numbers
from slipperjax.tools.units import in_unit, parsed

SCENE = sj.paper_scene()
Q = pint.Quantity
of_unit = lambda values, units: xr.DataArray(values, attrs={"units": units})


@pytest.mark.parametrize(
    ("given", "unit", "exact"),
    [
        ("125.66370614359172 rad/s", "Hz", 20.0),
        ("1200 rpm", "Hz", 20.0),
        ("20 rev/s", "Hz", 20.0),
        ("7200 deg/s", "Hz", 20.0),
        ("20 1/s", "Hz", 20.0),
        ("0.02 kHz", "Hz", 20.0),
        ("10 Hz", "rad/s", 20 * math.pi),
        ("600 rpm", "rad/s", 20 * math.pi),
        ("10 1/s", "rad/s", 10.0),
        ("10 Hz/s", "rad/s^2", 20 * math.pi),
        ("10 cycle/s^2", "rad/s^2", 20 * math.pi),
        ("3 (rad/s^2)^2/Hz", "(rad/s^2)^2/Hz", 3.0),
        ("3 m^2/(rad/m)", "m^2 per cycle/m", 6 * math.pi),
        ("2 rad/m", "cycles/m", 1 / math.pi),
        # which may count cycles or radians
        ("2 1/m", "cycles/m", None),
        ("3 m^3", "m^2 per cycle/m", None),
        ("3 rad^2/s", "Hz", None),
        # a speed of wavelength and frequency, and one of radius and angular rate
        ("5 m Hz", "m/s", 5.0),
        ("5 m rad/s", "m/s", 5.0),
    ],
)
def test_cycles_are_no_radians(given, unit, exact):
    value, _, written = given.partition(" ")
    ways = [lambda: parsed("low", given, unit)]
    if written != "rev/s" and exact is not None:  # which pint does not know
        ways += [
            lambda: in_unit(Q(float(value), written), unit),
            lambda: in_unit(of_unit(float(value), written), unit),
        ]
    for way in ways:
        if exact is None:
            with pytest.raises(ValueError, match="`low` must be"):
                way()
        else:
            # rounding alone: 4e-16
            assert way() == pytest.approx(exact, rel=1e-14)


@pytest.mark.parametrize(
    ("given", "unit", "exact"),
    [
        (of_unit(900.0, "km/h"), "m/s", 250.0),
        (of_unit([1, 2], "mm"), "m", [1e-3, 2e-3]),
        (of_unit(1.0, "g"), "m/s^2", 9.80665),
        (of_unit(0.5, "1"), "", 0.5),
        (xr.DataArray(3.0), "m", 3.0),
        (xr.DataArray(Q([1.0, 2.0], "mm")), "m", [1e-3, 2e-3]),
        ([of_unit(1.0, "mm"), Q(1.0, "cm"), 1.0], "m", [1e-3, 1e-2, 1.0]),
        (SimpleNamespace(value=np.array([36.0]), unit="km / h"), "m/s", [10.0]),
        (np.timedelta64(1500, "ms"), "s", 1.5),
        (datetime.timedelta(minutes=1), "s", 60.0),
        (pd.Timedelta("3 ms"), "s", 3e-3),
        (pd.Series(pd.to_timedelta([0, 1], unit="s")), "s", [0.0, 1.0]),
        ("900 km/h", "m/s", 250.0),
        (["1/16 in", "1 mm"], "m", [1.5875e-3, 1e-3]),
        # whose own unit counts
        (of_unit(np.array([1, 2], "timedelta64[s]"), "ns"), "s", [1.0, 2.0]),
    ],
)
def test_what_has_a_unit_is_converted(given, unit, exact):
    np.testing.assert_allclose(np.asarray(finite("x", unit)(given)), exact, rtol=1e-14)


@pytest.mark.parametrize(
    ("given", "unit"),
    [
        (of_unit(900.0, "kg"), "m/s"),
        (of_unit(900.0, "kg"), ""),
        ("900 kg", "m/s"),
        ("900", "m/s"),
        (of_unit(1.0, "seconds since 2026-01-01"), "s"),
        (np.timedelta64(1, "s"), "m"),
        (np.array(["2026-01-01"], "datetime64[s]"), "s"),
        (datetime.datetime(2026, 1, 1), "s"),
        (np.timedelta64("NaT", "s"), "s"),
    ],
)
def test_other_units_and_dates_are_refused(given, unit):
    with pytest.raises(ValueError, match="`x` must be finite, but is"):
        finite("x", unit)(given)


HIDDEN = np.ma.masked_equal([1.0, 2.0, -9999.0, 4.0, 5.0], -9999.0)


def test_histories_have_no_number_under_a_mask():
    np.testing.assert_array_equal(numbers("series", HIDDEN), [1.0, 2.0, np.nan, 4.0, 5.0])
    with pytest.raises(ValueError, match=r"`series` must be numbers, but is <?Quantity"):
        numbers("series", Q([1.0, 2.0], "mm"))


@pytest.mark.parametrize(
    ("unit", "si", "meant"), [("G", "m/s^2", "g"), ("g0", "m/s^2", "g"), ("mils", "m", "thou"), ("lb", "N", "lbf")]
)
def test_units_that_are_written_for_others_are_told(unit, si, meant):
    with pytest.raises(ValueError, match=rf"`x` must be .*Did you mean {meant}\?"):
        parsed("x", f"3 {unit}", si)
    assert parsed("x", f"3 {meant}", si) > 0
