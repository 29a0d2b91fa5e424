"""The torus of a slipper beside a long simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis


@pytest.mark.slow
def test_torus_beside_a_simulation():
    branch = sj.continue_orbit(sj.paper_scene(speed=1250.0, length=0.147), "length", (0.145, 0.147))
    (birth,) = [event for event in branch.branch.events if event.label == "NS"]
    motions = branch.branch.equations
    options = dict(points=15, most=31, accuracy=1e-5, tolerance=1e-9, count=3)
    tori = analysis.continue_torus(motions, birth, (0.1445, 0.147), **options)
    print(tori, tori.rotation)
    lengths = tori.values
    node, length = tori.nodes[0], lengths[0]
    first = jnp.asarray(tori.at(node).states(node.z)[0])
    advance = lambda s, _: (motions.mapped(jnp.append(s, length)), s)
    states = np.asarray(jax.jit(lambda s: jax.lax.scan(advance, s, None, 1500)[1])(first))
    weights = np.asarray(motions.weights(jnp.append(first, length))[0])
    # of the motion, without the memory; measured 3.2e-8
    np.testing.assert_allclose(analysis.rotation_number((states * weights)[:, :10]), tori.rotation[0], atol=1e-6)
