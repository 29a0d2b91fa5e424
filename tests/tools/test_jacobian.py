"""Reverse mode by Jacobians: the same derivatives in every transformation, by programs without a backward pass."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.jacobian import MOST_FORWARD, by_jacobian

from ..common import among

X, RATE = jnp.array([0.3, 0.5]), jnp.asarray(1.3)


def run(x, rate):
    """Five steps, with a whole number beside the results."""
    step = lambda x, k: (jnp.sin(x) * rate + 0.1 * x[::-1] + 0 * k, jnp.sum(x))
    x, sums = jax.lax.scan(step, x, jnp.arange(5.0))
    return {"end": x, "sums": sums, "count": jnp.asarray(5)}


def cost(run):
    return lambda x, rate: jnp.sum(run(x, rate)["end"] ** 2) + jnp.sum(run(x, rate)["sums"])


def in_arguments(x, rate):
    return by_jacobian(run, x, rate)


def closed_over(x, rate):
    return by_jacobian(lambda x: run(x, rate), x)


TRANSFORMED = {
    "grad": lambda f: jax.grad(f, (0, 1)),
    "jacfwd": lambda f: jax.jacfwd(f, (0, 1)),
    "hessian": lambda f: jax.hessian(f, (0, 1)),
    "jacfwd of jacfwd": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "jacrev of jacfwd": lambda f: jax.jacrev(jax.jacfwd(f)),
    "jacrev of jacrev": lambda f: jax.jacrev(jax.jacrev(f, 1), 1),
    "jit of grad": lambda f: jax.jit(jax.grad(f)),
    "grad of a batch": lambda f: jax.grad(lambda x, r: jnp.sum(jax.vmap(f, (0, None))(jnp.stack([x, 2 * x]), r)), 1),
    "batch of grads": lambda f: lambda x, r: jax.vmap(jax.grad(f), (0, None))(jnp.stack([x, 2 * x]), r),
    "batch of rates": lambda f: lambda x, r: jax.vmap(jax.hessian(f, 1), (None, 0))(x, jnp.stack([r, 2 * r])),
    "checkpoint": lambda f: jax.grad(jax.checkpoint(f)),
}


def check(transform, form):
    right = jax.jit(transform(cost(run)))(X, RATE)
    for one, other in zip(*map(jax.tree.leaves, (transform(cost(form))(X, RATE), right)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)  # measured: 3e-15


@pytest.mark.parametrize("transform", among(TRANSFORMED, "grad", "jacfwd", "batch of grads"))
def test_derivatives_are_those_of_the_function(transform):
    check(transform, in_arguments)


@pytest.mark.parametrize("form", [closed_over, jax.jit(in_arguments)], ids=["closed over", "inside jit"])
def test_derivatives_are_the_same_by_what_is_closed_over_and_inside_jit(form):
    check(TRANSFORMED["batch of grads"], form)


def loops_backwards(fun, *args):
    return str(jax.make_jaxpr(fun)(*args)).count("reverse=True")


def test_few_numbers_have_no_backward_pass_and_many_have():
    few, many = jnp.linspace(0.1, 0.9, MOST_FORWARD - 1), jnp.linspace(0.1, 0.9, MOST_FORWARD)
    grad = jax.grad(cost(in_arguments), (0, 1))
    assert loops_backwards(grad, few, RATE) == 0
    assert loops_backwards(grad, many, RATE) > 0
    assert loops_backwards(jax.grad(cost(in_arguments), 1), many, RATE) == 0  # whose others are constants
    right = jax.jit(jax.grad(cost(run), (0, 1)))(many, RATE)
    for one, other in zip(jax.jit(grad)(many, RATE), right, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)  # measured: 2e-15


@pytest.mark.full
def test_gradients_of_runs_have_a_backward_pass_by_many_numbers_alone():
    scene = sj.paper_scene(speed=1250.0)
    state = sj.initial_state(scene, sj.table_2_start())
    end = lambda speed: sj.period_map(scene.replace(speed=speed), state, steps_per_period=4).motion.y
    assert loops_backwards(jax.grad(end), 1250.0) == 0
    start = lambda motion: sj.period_map(scene, sj.State(motion, state.memory), steps_per_period=4).motion.y
    assert loops_backwards(jax.grad(start), state.motion) > 0
