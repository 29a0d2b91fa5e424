"""Objectives of grids by simulation, and trade-offs between two of them."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.maps import objective_sweep
from slipperjax.design.pareto import pareto_front
from slipperjax.sweeps.attractors import attractors

GRID = {"speed": [1250.0, 1500.0], "length": [0.13, 0.2]}


@pytest.mark.slow
def test_a_grid_has_the_loads_and_the_regimes_of_a_sweep():
    how = dict(transient=200, steps_per_period=50)
    ds = objective_sweep(sj.paper_scene(), ["peak_force", "contact_load"], GRID, periods=64, **how)
    other = sj.sweep(sj.paper_scene(), GRID, periods=64, **how)
    # the same run, but for chaos, where rounding grows
    regular = ds["kind"].values == "period"
    assert regular.tolist() == [[False, True], [False, True]]
    peaks = other["peak_force"].max(["end", "point"]).values
    np.testing.assert_allclose(ds["peak_force"].values[regular], peaks[regular], rtol=1e-6)
    np.testing.assert_array_equal(ds["kind"].values[regular], attractors(other, last=64).kind[regular])
    assert ds["peak_force"].attrs["units"] == "N"
    assert np.all(ds["status"] == 0)


@pytest.mark.slow
def test_a_front_goes_from_the_one_optimum_to_the_other():
    """A long slipper has less pitch, a short one less roll."""
    box, over = {"length": (0.18, 0.4)}, {"speed": [1300.0]}
    ds = pareto_front(
        sj.paper_scene(),
        ("excursion_roll", "excursion_pitch"),
        box,
        over=over,
        points=4,
        starts=1,
        steps_per_period=50,
    )
    assert ds.sizes["point"] == 4
    assert np.all(np.diff(ds["excursion_pitch"]) >= -1e-9)
    assert np.all(np.diff(ds["excursion_roll"])[ds["ideal"].values[1:]] <= 1e-9)
    assert ds["ideal"].values.sum() >= 2
