"""Trade-offs between two objectives."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design import pareto_front


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
