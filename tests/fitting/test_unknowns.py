"""Priors as levels, and what is refused."""

import numpy as np
import pytest
import scipy.stats

import slipperjax as sj
from slipperjax.fitting.method import spread, unknowns_of
from slipperjax.model.sensors import Rig

SCENE = sj.paper_scene()
RIG = Rig.of([sj.model.Sensor("az"), sj.model.Sensor("fz", "force")])
FAR = {"stiffness": (1e7, 1e9)}
SOME = {"restitution": (0.5, 0.95), "mass": scipy.stats.norm(14.0, 1.0)}
PRIORS = FAR | SOME | {"sensors.az.gain": (0.9, 1.1), "sensors.fz.bias": (-10.0, 10.0)}


def test_levels_are_standard_normal_deviates():
    found = unknowns_of(SCENE, RIG, PRIORS)
    assert [one.name for one in found] == list(PRIORS)
    assert [one.parameter.unit for one in found] == ["N/m^1.5", "1", "kg", "1", "N"]
    level = np.array([-7.0, -2.0, 0.0, 1.0, 7.0])
    for one in found:
        value = one.value(level)
        assert np.all(np.diff(value) > 0)
        # beyond 6 values round to the bounds
        np.testing.assert_allclose(one.level(value[1:4]), level[1:4], rtol=0, atol=1e-8)
        slope = (one.value(level + 1e-6) - one.value(level - 1e-6)) / 2e-6
        np.testing.assert_allclose(one.slope(level[1:4]), slope[1:4], rtol=1e-6)
    # far bounds by their logarithms, near ones evenly, distributions as they are
    middles = [one.value(np.zeros(())) for one in found]
    # measured 2e-15
    np.testing.assert_allclose(middles, [1e8, 0.725, 14.0, 1.0, 0.0], rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(found[2].value(np.ones(())), 15.0)
    levels = spread(found, 256, 1)
    np.testing.assert_allclose(levels.mean(axis=0), np.zeros(5), atol=0.02)
    # without the farthest tails
    assert np.abs(levels).max() < 2.06


def test_some_are_frozen_and_a_part_after_the_whole_is_found():
    names = lambda *given: [one.name for one in unknowns_of(SCENE, RIG, *given)]
    assert names(PRIORS, ["mass", "stiffness"]) == ["restitution", "sensors.az.gain", "sensors.fz.bias"]
    assert len(names({"clearance": (5e-4, 2e-3), "section.play.0": (1e-4, 1e-3)})) == 2


BOUNDS = "`stiffness` must have a low and a high bound"
BAD = [
    ({}, (), "`unknowns` must be bounds by name"),
    ({"stiffnes": (1e8, 1e9)}, (), "`stiffnes` is no parameter.*stiffness"),
    ({"stiffness": (1e9, 1e8)}, (), BOUNDS),
    ({"stiffness": scipy.stats.norm}, (), f"{BOUNDS}, or a frozen distribution"),
    ({"stiffness": (2e8, 1e9)}, (), "`stiffness` must have bounds on both sides of the scene's own value, 1e.08"),
    ({"sensors.front.gain": (0.5, 1.5)}, (), "must have a number of 0 to 1 or one of az, fz in place of 'front'"),
    ({"sensors.az.cutoff": (10.0, 500.0)}, (), "`sensors.az.cutoff` must be a number that the sensor has"),
    (FAR, ("stiffness",), "`unknowns` must leave something to find"),
    (FAR, ("mass",), "`frozen` must be some of stiffness"),
    ({"section.play.0": (1e-4, 1e-3), "clearance": (5e-4, 2e-3)}, (), "`section.play.0` must not be given with"),
]


@pytest.mark.parametrize(("priors", "frozen", "text"), BAD)
def test_bad_unknowns_are_refused(priors, frozen, text):
    with pytest.raises(ValueError, match=text):
        unknowns_of(SCENE, RIG, priors, frozen)
