"""Linear operations on all operands at once, and values that are stored."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from slipperjax.tools.fused import spread, store, store_cotangent, store_if_differentiated, sums

A, B = jnp.asarray([0.3, -1.2, 2.5]), jnp.asarray([1.1, 0.4, -0.7])


def chained(a, b):
    """All operations, one behind the other."""
    u, v = store((jnp.sin(a), a * b))
    first, second = sums(store_cotangent(u * v), v)
    x, y = spread(4, first, second)
    return jnp.sum(store_if_differentiated(x * jnp.arange(4.0)) * y)


def plain(a, b):
    """The same by JAX's own operations."""
    u, v = jnp.sin(a), a * b
    return jnp.sum(jnp.sum(u * v) * jnp.arange(4.0) * jnp.sum(v))


@pytest.mark.full
@pytest.mark.parametrize("changed", [lambda f: f, jax.jit, jax.grad, jax.hessian, lambda f: jax.jit(jax.jacfwd(f))])
def test_they_are_jax_operations_in_both_modes(changed):
    np.testing.assert_allclose(changed(chained)(A, B), changed(plain)(A, B), rtol=1e-12)


def test_derivatives_are_those_of_differences():
    check_grads(jax.jit(chained), (A, B), order=2)


def test_a_batch_may_vary_some_operands_only():
    found = jax.vmap(chained, (0, None))(np.stack([A, 2 * A]), B)
    right = jax.jit(plain)
    np.testing.assert_allclose(found, [right(A, B), right(2 * A, B)], rtol=1e-12)


def test_operands_without_tangent_stay_so():
    program = str(jax.make_jaxpr(lambda t: jax.jvp(lambda a: store((a, B)), (A,), (t,))[1])(A))
    # one for the values, and one of a single operand for the tangents
    assert program.count("slipperjax_stored") == 2
    moved = jax.jvp(lambda a: sums(a * A, B), (A,), (A,))[1]
    np.testing.assert_allclose(moved, [jnp.sum(A * A), 0.0])


@pytest.mark.parametrize(("keep", "sines"), [(store, 8), (lambda values: values, 20)])
def test_stored_values_are_not_computed_again(keep, sines):
    def steps(_, values):
        x, y = values
        for _ in range(4):
            x, y = keep((jnp.tanh(x) * jnp.sin(y), jnp.tanh(y) * jnp.sin(x)))
        return x, y

    program = jax.jit(lambda x: jax.lax.fori_loop(0, 10, steps, (x, 2 * x))).lower(0.3).compile().as_text()
    assert program.count(" sine(") == sines
