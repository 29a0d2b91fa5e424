"""The torus of a slipper beside a long simulation."""

import equinox as eqx
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


def test_torus_over_play():
    """With 200 steps the curve is not resolved: touchdowns pass from step to step along it."""
    branch = sj.continue_orbit(sj.paper_scene(speed=1250.0, clearance=3.1e-3), "clearance", (3.05e-3, 3.3e-3))
    (birth,) = [event for event in branch.branch.events if event.label == "NS"]
    motions = eqx.tree_at(lambda m: m.family.stepping.steps, branch.branch.equations, jnp.asarray(800.0))
    options = dict(points=31, most=31, accuracy=3e-6, tolerance=1e-9, count=1, pace=Pace(first=0.006))
    tori = analysis.continue_torus(motions, birth, (3.19e-3, 3.2e-3), **options)
    # period 1 is unstable above 3.19627 mm, and the torus attracts
    k = int(np.argmin(np.abs(tori.values - 3.1966456e-3)))
    assert tori.values[k] > 3.1963e-3
    rotation, found, (begin, end) = beside_a_simulation(tori, k)
    # measured 1.5e-6
    np.testing.assert_allclose(found, rotation, rtol=0, atol=1e-5)
    # measured 6e-5
    np.testing.assert_allclose(end, begin, rtol=1e-2)
