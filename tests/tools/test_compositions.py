"""The tricks for speed under compositions of JAX's transformations: the values of a loop without tricks."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.tools import fast, plain
from slipperjax.tools.jacobian import by_jacobian

from ..common import among

SCALES = np.array([1.0, 1.1])
WEIGHTS = jnp.linspace(0.5, 1.5, 4)


def loop_in(form):
    """A number after two periods of two steps: loops, kernels and sums nested as in the period map."""

    def step(carry, k):
        x, rate = carry
        cosine, sine = form.circle(x[0] * rate + k)
        a, b = form.spread(WEIGHTS.size, *form.store_if_differentiated((cosine, sine * x[1])))
        total, other = form.sums(a * WEIGHTS, b * b * WEIGHTS)
        return (0.3 * jnp.stack([total, form.store_cotangent(form.store(other))]), rate), None

    def run(first, rate):
        steps = lambda carry: jax.lax.scan(step, carry, jnp.arange(2.0))[0]
        period = lambda carry, _: (form.in_one_kernel(steps, carry), None)
        (x, _), _ = jax.lax.scan(period, (first, rate), None, 2)
        return {"end": x, "count": jnp.asarray(2)}

    def number(rate):
        first = rate * jnp.array([0.3, 0.5])
        # with a value that the function closes over, besides the argument
        end = by_jacobian(lambda first: run(first, rate), first) if form is fast else run(first, rate)
        return jnp.sum(end["end"])

    return number


def of_batch(f):
    return lambda x: jnp.mean(jax.vmap(lambda s: f(s * x))(jnp.asarray(SCALES)))


def scanned(f):
    return lambda x: jax.lax.scan(lambda total, s: (total + f(s * x) / SCALES.size, None), 0.0, jnp.asarray(SCALES))[
        0
    ]


def in_branch(f):
    return lambda x: jax.lax.cond(x > 0, f, lambda x: 0.0 * x, x)


def linearized(f):
    return lambda x: jax.linearize(f, x)[1](1.0)


def derivative(f):
    return lambda x: jax.jvp(f, (x,), (jnp.ones_like(x),))[1]


def looped(f):
    return lambda x: sum(f(s * x) for s in SCALES) / SCALES.size


def same(f):
    return f


# what JAX does, what a loop does in its place, and how often it differentiates
TRANSFORMATIONS = {
    "jit": (jax.jit, same, 0),
    "vmap": (of_batch, looped, 0),
    "scan": (scanned, looped, 0),
    "cond": (in_branch, same, 0),
    "checkpoint": (jax.checkpoint, same, 0),
    "jvp": (derivative, derivative, 1),
    "linearize": (linearized, derivative, 1),
    "grad": (jax.grad, derivative, 1),
    "hessian": (jax.hessian, lambda f: derivative(derivative(f)), 2),
}
MOST_DERIVATIVES = 2


def chains(depth):
    """All compositions of so many transformations, by name, which differentiate at most twice."""
    for names in itertools.product(TRANSFORMATIONS, repeat=depth):
        if sum(TRANSFORMATIONS[name][2] for name in names) <= MOST_DERIVATIVES:
            yield names


def composed(names, form, which):
    """The loop in a form under what JAX does, the first entry of `TRANSFORMATIONS`, or what a loop does."""
    found = loop_in(form)
    for name in reversed(names):
        found = TRANSFORMATIONS[name][which](found)
    return found


def check(compositions, program=same):
    x = jnp.asarray(0.8)
    # all in one program
    right = jax.jit(lambda x: [composed(names, plain, 1)(x) for names in compositions])(x)
    for names, exact in zip(compositions, right, strict=True):
        # measured over all chains: 2e-15
        found = program(composed(names, fast, 0))(x)
        np.testing.assert_allclose(found, exact, rtol=1e-12, err_msg=" of ".join(names))


# whatever is inside of a gradient is differentiated
@pytest.mark.parametrize("outer", among({name: name for name in TRANSFORMATIONS}, "grad"))
def test_two_transformations_compose(outer):
    check([(outer,)])
    check([names for names in chains(2) if names[0] == outer], program=jax.jit)


@pytest.mark.slow
@pytest.mark.parametrize("outer", TRANSFORMATIONS)
def test_three_transformations_compose(outer):
    check([names for names in chains(3) if names[0] == outer])
