"""Contact memories of one's own: the methods that the abstract classes ask for are enough."""

import jax
import jax.numpy as jnp
import numpy as np

import slipperjax as sj
from slipperjax.model.layout import coordinates

from ..common import SCALES


class KeptRate(sj.AbstractMemory):
    """The gap rate at touchdown, of which `EventLatch` keeps the inverse."""

    unit = "m/s"

    def initial(self, gap, rate):
        return jnp.where(gap < 0, jnp.minimum(rate, -1e-3), 0.0)

    def rate_ratio(self, memory, rate):
        return jnp.where(memory < 0, rate / jnp.where(memory < 0, memory, -1.0), 1.0)


class LaggingRate(sj.AbstractIntegratedMemory):
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


def test_a_latched_memory_of_ones_own():
    np.testing.assert_allclose(end(KeptRate()), end(sj.EventLatch()), rtol=1e-10)
    slopes = [jax.jacfwd(lambda c, m=m: height(c, m, 100))(1e-3) for m in (KeptRate(), sj.EventLatch())]
    np.testing.assert_allclose(*slopes, rtol=1e-9)
    weights = [
        type(m).weights(m.initial(-jnp.ones(2), -jnp.array([0.5, 2.0]))) for m in (KeptRate(), sj.EventLatch())
    ]
    np.testing.assert_allclose(weights, [[2.0, 0.5], [0.5, 2.0]])  # relative to what is kept


def test_an_integrated_memory_of_ones_own():
    """By an explicit and by an implicit method, near the event latch."""
    explicit, implicit = (end(LaggingRate(), solver, 1600) for solver in ("RK4", "ROS34PW2"))
    assert np.max(np.abs(explicit - implicit) / SCALES) < 2e-3  # measured 5.7e-4
    assert np.max(np.abs(explicit - end(sj.EventLatch())) / SCALES) < 1e-3  # measured 1.3e-4
