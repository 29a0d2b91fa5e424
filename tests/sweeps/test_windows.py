"""Numbers of whole runs from those of their windows."""

import json

import numpy as np
import pytest
import xarray as xr

from slipperjax.sweeps import whole_run
from slipperjax.sweeps.windows import lasting

LOADS = np.array([[8.0, 1.0], [4.0, 2.0], [2.0, 4.0], [1.0, 8.0]])
"""Of two cases in four windows of 2 m, at 1, 2, 4 and 8 m/s."""
SECONDS = np.array([2.0, 1.0, 0.5, 0.25])


def made(name="contact_load", values=LOADS):
    coords = {"distance": 10 + 2.0 * np.arange(1, 5), "seconds": ("distance", np.cumsum(SECONDS))}
    coords |= {"speed": ("distance", [1.0, 2.0, 4.0, 8.0])}
    attrs = {"window [m]": 2.0, "call": json.dumps({"begin": 10.0})}
    return xr.Dataset({name: (("distance", "case"), values)}, coords, attrs)


@pytest.mark.parametrize(
    ("name", "over", "wanted"),
    [
        ("contact_load", "distance", LOADS.mean(axis=0)),
        ("contact_load", "time", SECONDS @ LOADS / 3.75),
        ("rms_a_z", "distance", np.sqrt(np.mean(LOADS**2, axis=0))),
        ("rms_a_z", "time", np.sqrt(SECONDS @ LOADS**2 / 3.75)),
        # how long a window lasts is nothing to greatest values and sums
        ("peak_a_z", "time", [8.0, 8.0]),
        ("impacts", "time", [15.0, 15.0]),
    ],
)
def test_a_mean_over_time_is_none_over_distance(name, over, wanted):
    found = whole_run(made(name), name, over)
    assert found.dims == ("case",)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_a_part_of_a_run_begins_with_its_first_window():
    ds = made()
    np.testing.assert_allclose(lasting(ds), SECONDS, rtol=1e-12)
    np.testing.assert_allclose(lasting(ds.isel(distance=slice(2, None))), SECONDS[2:], rtol=1e-12)


def test_wrong_questions_are_one_line():
    for arguments, words in (
        (("peak_force",), "Argument `record` must be a number of the run's windows, but is 'peak_force'"),
        (("contact_load", "speed"), "Argument `over` must be one of distance, time"),
    ):
        with pytest.raises(ValueError, match=words):
            whole_run(made(), *arguments)
