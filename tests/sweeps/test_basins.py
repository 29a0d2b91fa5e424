"""Basins of a scene: random starts and maps, over a parameter."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.sweeps.attractors import groups

pytestmark = pytest.mark.full
SCENE = sj.paper_scene(speed=1250.0)
BOX = {"start_y": (-3e-4, 3e-4), "start_v_y": (-0.1, 0.1)}
SHORT = dict(transient=150, last=8, steps_per_period=100)


def test_random_starts_over_a_parameter(tmp_path):
    found = sj.basins(SCENE, BOX, {"clearance": [1e-3, 3e-3]}, count=6, seed=3, **SHORT)
    assert found.ds["basin"].dims == ("clearance", "start")
    assert found.ds["share"].dims == ("clearance", "attractor")
    # the same starts as lists of cases
    generator = np.random.default_rng(3)
    lists = {name: generator.uniform(*bounds, 6) for name, bounds in BOX.items()}
    np.testing.assert_array_equal(found.ds["start_y"], lists["start_y"])
    plain = sj.sweep(
        SCENE.replace(clearance=3e-3), lists, product=False, record="strobe", transient=150, periods=8,
        steps_per_period=100,
    )  # fmt: skip
    alone = groups(plain.ds, 8)["share"].values
    # of one value there are fewer attractors, in the order of their own shares
    assert sorted(found.ds["share"].values[1][found.ds["share"].values[1] > 0]) == pytest.approx(sorted(alone))
    # where all six starts lead to one attractor
    error = np.sqrt(7 * 1 / (8**2 * 9))
    one = found.ds["share"].values == 1
    assert found.ds["share_stderr"].values[one] == pytest.approx(np.full(one.sum(), error))
    found.write(tmp_path / "basins.nc", tmp_path / "basins.csv", tmp_path / "basins.png")
    again = sj.load(tmp_path / "basins.nc")
    assert again.summary() == found.summary()
    assert again.call["count"] == 6
    assert list(found.tables()["basins"].columns[:2]) == ["attractor", "period"]


def test_map_of_starts():
    starts = {"start_y": [-2e-4, 0.0], "start_v_y": [-0.1, 0.0, 0.1]}
    found = sj.basins(SCENE, starts, **SHORT)
    assert found.ds["basin"].dims == ("start_y", "start_v_y")
    assert found.ds["share"].sum() == pytest.approx(1.0)
    assert found.plot().get_xlabel().startswith("start")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({"speed": [1.0]},), "`starts` must name some of start_y"),
        (({},), "`starts` must name some of start_y"),
        ((BOX, {"start_z": [0.0]}), "`over` must name parameters, not coordinates of the start"),
    ],
)
def test_wrong_inputs(arguments, message):
    with pytest.raises(ValueError, match=message):
        sj.basins(SCENE, *arguments)
