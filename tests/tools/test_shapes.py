"""Shapes in annotations are enforced: always for fields, and in the tests also for functions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

import slipperjax as sj
from slipperjax.analysis.floquet import jacobians, largest_exponent, multipliers
from slipperjax.tools.batching import Batched


def test_scenes_are_made_one_by_one_under_vmap():
    periods = jax.vmap(lambda v: sj.paper_scene(speed=v).period)(jnp.array([900.0, 1000.0]))
    np.testing.assert_allclose(periods, [8 / 900, 8 / 1000])


def test_a_wrong_shape_put_in_by_hand_is_found():
    scene = sj.paper_scene()
    with pytest.raises(TypeCheckError):
        multipliers(np.eye(3))  # one Jacobian instead of a sequence
    with pytest.raises(TypeCheckError):
        scene.track.approach_speed(jnp.ones(2))
    batched = scene.replace(speed=np.array([900.0, 1000.0]))
    with pytest.raises(TypeCheckError):
        sj.model.contact_duration(batched)  # functions take one case, batches need Batched.map
    each = eqx.filter_jit(lambda scenes: Batched.of(scenes, scene).map(sj.model.contact_duration))(batched)
    assert each.shape == (2,)
    halved = jax.jit(lambda state: multipliers(jacobians(lambda s, k: 0.5 * s, state, 1)))
    assert halved(jnp.ones(2)).tolist() == [0.5, 0.5]
    assert largest_exponent([0.5 * np.eye(2)] * 2, 2) == pytest.approx(np.log(0.5))
