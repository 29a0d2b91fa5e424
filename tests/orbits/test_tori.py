"""Tori of slippers beside long simulations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis
from slipperjax.analysis.arclength import Pace
from slipperjax.tools.compile import call_compiled

pytestmark = pytest.mark.slow


def simulated(motions, static, state, value):
    advance = lambda s, _: (motions.mapped(jnp.append(s, value)), s)
    return jax.lax.scan(advance, state, None, 3000)[1]


def beside_a_simulation(tori, k):
    """Rotation number of a torus, and of a simulation that begins on it; its sizes, at the begin and at the end."""
    motions = tori.equations.motions
    node, value = tori.nodes[k], tori.values[k]
    first = jnp.asarray(tori.at(node).states(node.z)[0])
    states = call_compiled(simulated, motions, (), first, jnp.asarray(value))
    # of the motion, without the memory
    motion = (np.asarray(states) * np.asarray(motions.weights(jnp.append(first, value))[0]))[:, :10]
    sizes = [np.ptp(part, axis=0).max() / 2 for part in (motion[:1000], motion[-1000:])]
    print(tori, value, tori.rotation[k], analysis.rotation_number(motion) - tori.rotation[k], sizes)
    return tori.rotation[k], analysis.rotation_number(motion), sizes


def born(branch, bounds, **options):
    (birth,) = [event for event in branch.branch.events if event.label == "NS"]
    return birth.value, analysis.continue_torus(branch.branch.equations, birth, bounds, tolerance=1e-9, **options)


def test_torus_over_length():
    branch = sj.continue_orbit(sj.paper_scene(speed=1250.0, length=0.147), "length", (0.145, 0.147))
    _, tori = born(branch, (0.1445, 0.147), points=15, most=31, accuracy=1e-5, count=3)
    rotation, found, _ = beside_a_simulation(tori, 0)
    # measured 3.2e-8
    np.testing.assert_allclose(found, rotation, rtol=0, atol=1e-6)


def test_torus_over_play():
    """With 200 steps the curve is not resolved: touchdowns pass from step to step along it."""
    scene = sj.paper_scene(speed=1250.0, clearance=3.19e-3)
    branch = sj.continue_orbit(scene, "clearance", (3.18e-3, 3.2e-3), steps_per_period=800)
    options = dict(points=31, most=31, accuracy=3e-6, count=1, pace=Pace(first=0.006))
    place, tori = born(branch, (3.19e-3, 3.2e-3), **options)
    # period 1 is unstable there, and the torus attracts
    assert tori.values[-1] > place
    rotation, found, (begin, end) = beside_a_simulation(tori, -1)
    # measured 1.2e-7
    np.testing.assert_allclose(found, rotation, rtol=0, atol=1e-5)
    # measured 1e-3
    np.testing.assert_allclose(end, begin, rtol=1e-2)
