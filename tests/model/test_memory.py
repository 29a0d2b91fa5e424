"""Contact memories of one's own: the methods that the abstract classes ask for are enough."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.contact import Rates
from slipperjax.model.layout import coordinates

from ..common import SCALES


class KeptRate(sj.model.AbstractMemory):
    """The gap rate at touchdown, of which `EventLatch` keeps the inverse."""

    unit = "m/s"

    def initial(self, gap, rate):
        return jnp.where(gap < 0, jnp.minimum(rate, -1e-3), 0.0)

    def rate_ratio(self, memory, rate):
        return jnp.where(memory < 0, rate / jnp.where(memory < 0, memory, -1.0), 1.0)


class LaggingRate(sj.model.AbstractIntegratedMemory):
    """A gap rate that follows that of open points within a microsecond."""

    unit = "m/s"

    def initial(self, gap, rate):
        return rate

    def rate_ratio(self, memory, rate):
        return rate / jnp.minimum(memory, -1e-3)

    def derivative(self, memory, gap, rate, acceleration):
        return -self.decay(gap) * (rate - memory) + jnp.where(gap > 0, acceleration, 0.0)

    def decay(self, gap):
        return jnp.where(gap > 0, -1e4, 0.0)


def end(memory, solver="RK4", steps=100):
    run = sj.simulate(sj.paper_scene(memory=memory), 2, steps_per_period=steps, solver=solver)
    assert int(run.status) == 0
    return coordinates(run.end)


def height(clearance, memory, steps):
    scene = sj.paper_scene(clearance=clearance, memory=memory)
    return sj.simulate(scene, 1, steps_per_period=steps, solver="RK4").end.motion.z


SURVEY = sj.model.SampledTrack(
    np.arange(0.0, 20.0, 0.5), 1e-4 * np.sin(np.arange(40.0)), 1e-4 * np.cos(np.arange(40.0))
)
JOINT = sj.model.LocalTrack([10.0], [-1e-4], 0.3)


@pytest.mark.parametrize(
    ("track", "memory"),
    [
        (sj.HarmonicTrack((8.0,), 1e-3, 0.0), sj.model.EventLatch),
        (sj.model.StraightTrack(), sj.model.EventLatch),
        (SURVEY, sj.model.PeakRateLatch),
        (SURVEY.prepared(), sj.model.PeakRateLatch),
        (sj.RandomTrack.sled(length=250.0), sj.model.PeakRateLatch),
        (sj.model.TrackSet([SURVEY, SURVEY]), sj.model.PeakRateLatch),
        (sj.model.SumTrack(sj.model.StraightTrack(), JOINT), sj.model.PeakRateLatch),
    ],
)
def test_a_scene_has_the_memory_of_its_track(track, memory):
    scene = dataclasses.replace(sj.paper_scene(), track=track)
    assert type(scene.contact_memory) is memory
    assert type(dataclasses.replace(scene, memory=sj.model.SmoothSwitch()).contact_memory) is sj.model.SmoothSwitch
    assert memory.__name__ in repr(scene)


def test_the_fastest_rate_of_a_step_is_kept():
    """At its end, inside it, and never that of a step in which the rate is slower, of an open point, or at rest."""
    memory = -1 / np.array([1.0, 1.0, 1.0, 1.0, np.inf]) - np.array([0, 0, 0, 0, np.finfo(float).tiny])
    rates = Rates(
        start=np.array([-0.9, -0.9, -0.9, 0.5, -0.1]),
        slope=np.array([-0.6, -1.6, 0.1, 0.1, -0.5]),
        bend=np.array([0.0, 1.6, 0.0, 0.0, 0.0]),
        end=np.array([-1.5, -0.9, -0.8, 0.6, -0.6]),
    )
    kept = jax.jit(sj.model.PeakRateLatch().kept)
    found = kept(memory, rates, np.zeros(5, bool))
    np.testing.assert_allclose(found[:4], [-1 / 1.5, -1 / 1.3, -1.0, -1.0], rtol=1e-14)
    assert found[4] == memory[4]
    np.testing.assert_array_equal(kept(memory, rates, np.ones(5, bool)), memory)
    of_rates = jax.jit(sj.model.PeakRateLatch().rate_ratio)
    ratio = of_rates(np.array([-1.0, -1.0, -1.0, 0.0]), np.array([-0.5, -2.0, 0.5, -3.0]))
    np.testing.assert_array_equal(ratio, [0.5, 1.0, -0.5, 1.0])


@pytest.mark.full
def test_a_latched_memory_of_ones_own():
    np.testing.assert_allclose(end(KeptRate()), end(sj.model.EventLatch()), rtol=1e-10)
    slopes = [jax.jacfwd(lambda c, m=m: height(c, m, 100))(1e-3) for m in (KeptRate(), sj.model.EventLatch())]
    np.testing.assert_allclose(*slopes, rtol=1e-9)
    weights = [
        type(m).weights(m.initial(-jnp.ones(2), -jnp.array([0.5, 2.0]))) for m in (KeptRate(), sj.model.EventLatch())
    ]
    np.testing.assert_allclose(weights, [[2.0, 0.5], [0.5, 2.0]])  # relative to what is kept


@pytest.mark.full
def test_an_integrated_memory_of_ones_own():
    """By an explicit and by an implicit method, near the event latch."""
    explicit, implicit = (end(LaggingRate(), solver, 1600) for solver in ("RK4", "ROS34PW2"))
    assert np.max(np.abs(explicit - implicit) / SCALES) < 2e-3  # measured 5.7e-4
    assert np.max(np.abs(explicit - end(sj.model.EventLatch())) / SCALES) < 1e-3  # measured 1.3e-4
