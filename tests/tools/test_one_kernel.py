"""Loops that are one kernel on a CPU: which are, in every transformation, and that nothing else is."""

import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.forms import is_plain
from slipperjax.tools.one_kernel import in_one_kernel

from ..common import among

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="for CPUs")
MARK = "xla_cpu_small_call"
PLACES = jnp.array([3, 1, 3, 0])


BODIES = {
    "sums": lambda x: jnp.sin(jnp.cumsum(x)),
    "products": lambda x: jnp.cos(jnp.outer(x, x) @ jnp.outer(x, x[::-1]))[0],
    # as records keep the states inside a period
    "a window set": lambda x: x.reshape(4, 2).at[jnp.argmax(x) // 2].set(x[:2]).ravel(),
    "a loop": lambda x: jax.lax.while_loop(lambda x: jnp.sum(x) > 3.0, lambda x: x / 2, x),
    "LAPACK": lambda x: jnp.linalg.solve(jnp.outer(x, x) + 3 * jnp.eye(x.size), x),
    "a scatter": lambda x: x.at[PLACES].add(x[:4]),
    "a callback": lambda x: jax.pure_callback(lambda x: x, x, x),
}
FIT = ("sums", "products", "a window set", "a loop")
"""Bodies of loops that fit a kernel: what solvers and records do."""
X = jnp.linspace(0.1, 0.9, 8)


def repeated(body):
    return lambda x: jax.lax.fori_loop(0, 5, lambda k, x: 0.9 * body(x), x)


def calls_of(fun, *args):
    """The program's calls with the mark."""
    return [line for line in jax.jit(fun).lower(*args).as_text().splitlines() if MARK in line]


@pytest.mark.full
@pytest.mark.parametrize("name", BODIES)
def test_what_is_in_a_kernel_or_not_has_the_same_numbers(name):
    loop = repeated(BODIES[name])
    marked = lambda x: in_one_kernel(loop, x)
    assert bool(calls_of(marked, X)) == (name in FIT)
    # measured: 0, and 2e-14 of products with JAX 0.12, which sums them in another order
    np.testing.assert_allclose(jax.jit(marked)(X), jax.jit(loop)(X), rtol=1e-13)


@pytest.mark.parametrize("place", ["alone", "in a branch", "in another kernel"])
def test_arguments_without_use_and_constants(place):
    """XLA finds out late that an argument has no use, or is a constant."""

    def part(x, unused, constant):
        loop = jax.lax.fori_loop(0, 5, lambda k, c: (jnp.sin(c[0]) + c[1], c[1]), (x, constant))
        return loop[0] + 0 * unused

    kernel = lambda x: in_one_kernel(part, x, 2 * x, jnp.zeros(x.shape))
    placed = {
        "alone": kernel,
        "in a branch": lambda x: jax.lax.cond(x[0] > 0, kernel, lambda x: x, x),
        "in another kernel": lambda x: in_one_kernel(kernel, x),
    }[place]
    np.testing.assert_allclose(jax.jit(placed)(X), part(X, X, 0 * X), rtol=1e-14)  # measured: 1e-16


@pytest.mark.full
@pytest.mark.parametrize(("reduce", "size"), [(jnp.sum, 128), (jnp.max, 8)])
def test_large_sums_and_extremes_are_in_a_kernel(reduce, size):
    """Since JAX 0.11 a library computes them elsewhere, in kernels not."""
    loop = repeated(lambda x: jnp.sin(x) + 1e-3 * reduce(x, axis=1)[:, None])
    marked = lambda x: in_one_kernel(loop, x)
    x = jnp.linspace(0.1, 0.9, size * 80).reshape(size, 80)
    assert calls_of(marked, x)
    right = jax.jit(loop)(x)
    np.testing.assert_allclose(jax.jit(marked)(x), right, rtol=1e-13)  # measured: 2e-15
    found = jax.jit(marked)(x.at[3, 4].set(jnp.nan))  # which the library's extremes leave out
    np.testing.assert_allclose(np.delete(found, 3, axis=0), np.delete(right, 3, axis=0), rtol=1e-13)
    assert np.all(np.isnan(found[3]))


@pytest.mark.full
def test_reverse_mode_through_the_steps_is_the_derivative_by_jacobians():
    """In a process of its own, which XLA ended where it folded constants into a kernel."""
    code = """
import jax, slipperjax as sj
from slipperjax.tools import jacobian
jacobian.MOST_FORWARD = 0
scene = sj.paper_scene(speed=1250.0)
state = sj.initial_state(scene, sj.table_2_start())
options = dict(periods=3, steps_per_period=40, solver=sj.solvers.RK4())
end = lambda speed: sj.period_map(scene.replace(speed=speed), state, **options).motion.y
print(*(float(jax.jit(derivative(end))(1250.0)) for derivative in (jax.grad, jax.jacfwd)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-300:]
    backward, forward = map(float, done.stdout.split())
    assert np.isfinite(backward)
    np.testing.assert_allclose(backward, forward, rtol=1e-9)


def loop(x, v, rate):
    """Twenty steps of coupled oscillators."""

    def body(carry, k):
        x, v = carry
        v = v - 0.1 * (jnp.sin(x) + rate * v + 0.01 * jnp.sum(x * x))
        return (x + 0.1 * v, v), None

    return jax.lax.scan(body, (x, v), None, length=20)[0]


def plain(x, v, rate):
    return jnp.sum(loop(x, v, rate)[0] ** 2)


def marked(x, v, rate):
    return jnp.sum(in_one_kernel(loop, x, v, rate)[0] ** 2)


def closed(x, v, rate):
    """With the rate closed over."""
    return jnp.sum(in_one_kernel(lambda x, v: loop(x, v, rate), x, v)[0] ** 2)


TRANSFORMED = {
    "itself": (lambda f: f, 1),
    "vmap": (lambda f: lambda *a: jax.vmap(f, in_axes=(0, None, None))(jnp.stack([a[0], 2 * a[0]]), *a[1:]), 1),
    "jvp": (lambda f: lambda *a: jax.jvp(f, a, a), 1),
    "grad": (lambda f: jax.grad(f, (0, 1, 2)), 2),
    "grad of the rate": (lambda f: jax.grad(f, 2), 2),
    "jacfwd of grad": (lambda f: jax.jacfwd(jax.grad(f)), 2),
    "grad of grad": (lambda f: jax.grad(lambda *a: jnp.sum(jax.grad(f)(*a) ** 2)), 3),
    "checkpoint": (lambda f: jax.grad(jax.checkpoint(f)), 2),
}


@pytest.mark.parametrize("fun", [marked, closed])
@pytest.mark.parametrize("transformed", among(TRANSFORMED, "itself", "vmap", "jvp", "grad"))
def test_all_loops_of_transformed_programs_are_kernels(fun, transformed):
    transform, least = transformed
    args = X, jnp.zeros(8), jnp.asarray(0.3)
    assert len(calls_of(transform(fun), *args)) >= least
    for found, right in zip(*(jax.tree.leaves(jax.jit(transform(f))(*args)) for f in (fun, plain)), strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-12)  # measured: 4e-15
    # and every loop is in one of them
    assert loops_outside(jax.jit(transform(fun)).lower(*args).as_text()) == 0


@pytest.mark.full
def test_other_programs_of_the_process_are_as_without_the_import():
    """The options of the process stay, and the texts of other people's programs."""
    code = """
import os, sys, jax, jax.numpy as jnp
jax.config.update("jax_enable_compilation_cache", False)
flags = os.environ.get("XLA_FLAGS")
if sys.argv[1] == "with":
    import slipperjax
    jax.config.update("jax_enable_x64", False)
assert os.environ.get("XLA_FLAGS") == flags
loop = lambda x: jax.lax.scan(lambda x, _: (jnp.tanh(x @ x), None), x, None, length=5)[0]
print(jax.jit(loop).lower(jnp.eye(64)).compile().as_text())
"""
    texts = {
        subprocess.run([sys.executable, "-c", code, which], check=True, capture_output=True, text=True).stdout
        for which in ("with", "without")
    }
    assert len(texts) == 1
    assert MARK not in texts.pop()


def loops_outside(program):
    """The number of functions of a program with loops that are reached by no marked call."""
    texts = {re.match(r'(?:public |private )?@("?[^( ]+)', text)[1]: text for text in program.split("func.func ")[1:]}
    reached, waiting = set(), ["main"]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            calls = re.findall(r'call @("?[^( ]+)\(([^\n]*)', texts[name])
            waiting += [called for called, rest in calls if MARK not in rest]
    return sum("stablehlo.while" in texts[name] for name in reached)


@pytest.mark.full
@pytest.mark.skipif(is_plain(), reason="for the fast form")
@pytest.mark.parametrize(
    ("transform", "forward", "most"), [(lambda f: f, 8, 0), (jax.jacfwd, 8, 0), (jax.grad, 8, 0), (jax.grad, 0, 1)]
)
def test_the_loops_of_the_period_map_are_kernels(transform, forward, most, monkeypatch):
    """But for the one over periods back, which has one pass; the steps of each period are kernels there, too."""
    monkeypatch.setattr("slipperjax.tools.jacobian.MOST_FORWARD", forward)
    scene = sj.paper_scene()
    state = sj.initial_state(scene, sj.table_2_start())
    steps = 40 + forward  # JAX keeps a program's derivative
    ahead = lambda speed: sj.period_map(scene.replace(speed=speed), state, steps_per_period=steps).motion.v_z
    assert loops_outside(jax.jit(transform(ahead)).lower(1000.0).as_text()) <= most
