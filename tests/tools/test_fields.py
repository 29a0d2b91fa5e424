"""Fields of modules: functions among them are static."""

import equinox as eqx
import jax
import jax.numpy as jnp

from slipperjax.tools.fields import ShapeChecked


class Holder(ShapeChecked):
    """A user's part with a network and functions."""

    net: eqx.nn.MLP
    shapes: tuple
    static: object = eqx.field(static=True, default=jnp.sin)


def test_functions_in_fields_are_no_leaves():
    net = eqx.nn.MLP(1, 1, 2, 1, activation=jnp.tanh, key=jax.random.key(0))
    made = Holder(net, (jnp.cos, 2.0))
    assert all(eqx.is_array_like(leaf) for leaf in jax.tree.leaves(made))
    x = jnp.array([0.3])
    assert jax.jit(lambda holder: holder.net(x))(made) == net(x)
    assert made.shapes[0](0.0) == 1.0
    assert made.static is jnp.sin  # as it was given
    # an equal module is known to programs that are compiled
    assert jax.tree.structure(made) == jax.tree.structure(Holder(net, (jnp.cos, 2.0)))
