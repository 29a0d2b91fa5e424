"""The layout of states: rows of numbers, with names, units and scales."""

import dataclasses

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model import MOTION_SCALES, StateLayout

SCENE = sj.paper_scene()
MEMORIES = {
    "latched": (SCENE, 30, 10, "s/m"),
    "smooth": (dataclasses.replace(SCENE, memory=sj.model.SmoothSwitch()), 30, 30, "m/s"),
    "none": (dataclasses.replace(SCENE, contact=sj.model.HertzSpring(1e8)), 10, 10, "rad/s"),
    "on springs": (
        dataclasses.replace(SCENE, payload=sj.model.Payload(100.0, [2e6, 8e6], [0.0, 0.0])),
        34,
        14,
        "s/m",
    ),
}


@pytest.mark.parametrize("name", MEMORIES)
def test_rows_are_states(name):
    scene, size, dimension, unit = MEMORIES[name]
    layout, start = StateLayout.of(scene), sj.initial_state(scene, sj.table_2_start())
    assert (layout.size, layout.dimension, layout.numbers[-1].unit) == (size, dimension, unit)
    np.testing.assert_array_equal(layout.scales[:10], jax.tree.leaves(MOTION_SCALES))
    both = jax.tree.map(lambda a: np.stack([np.asarray(a), np.asarray(a) + 1]), start)
    for state in (start, both):
        rows = layout.pack(state)
        assert rows.shape == (*np.shape(state.motion.y), size)
        for a, b in zip(jax.tree.leaves(layout.unpack(rows)), jax.tree.leaves(state), strict=True):
            np.testing.assert_array_equal(a, b)
    assert [q.name for q in layout.numbers][:10] == list(vars(sj.Motion()))[:10]
    # as JAX flattens states
    np.testing.assert_array_equal(layout.pack(start), jax.flatten_util.ravel_pytree(start)[0])
