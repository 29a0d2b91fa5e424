"""Compiling inside transformations, batches with shared leaves, and stored values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.tools.batching import Batched
from slipperjax.tools.compile import call_compiled, jit
from slipperjax.tools.description import describe
from slipperjax.tools.forms import compiler_options, is_plain


def test_jit_takes_compiler_options_at_the_top_and_nests_everywhere():
    cube = jit(lambda x, n: x**n, static_argnums=1)
    assert cube(2.0, 3) == 8.0
    assert jax.jit(lambda x: cube(x, 3))(2.0) == 8.0
    assert jax.grad(lambda x: cube(x, 3))(2.0) == 12.0
    assert jax.jit(jax.grad(lambda x: cube(x, 3)))(2.0) == 12.0
    np.testing.assert_array_equal(jax.vmap(lambda x: cube(x, 2))(jnp.arange(3.0)), [0, 1, 4])
    assert jax.jit(lambda: cube(jnp.asarray(2.0), 3))() == 8.0  # constants inside another program
    assert jax.hessian(lambda x: cube(x, 3))(2.0) == 12.0


@pytest.mark.skipif(is_plain(), reason="for the fast form")
def test_options_are_those_of_the_backend():
    assert compiler_options("cpu")["xla_cpu_enable_fast_math"] is True
    assert compiler_options("gpu") == {}


def test_a_batch_shares_what_does_not_differ():
    case = {"a": np.asarray(1.0), "b": np.asarray([2.0, 3.0])}
    batch = Batched.of({"a": np.arange(3.0), "b": case["b"]}, case)
    assert batch.varied["b"] is None
    assert batch.shared["a"] is None
    shapes = []

    def one(tree, x):
        shapes.append(tree["b"].shape)
        return tree["a"] * tree["b"].sum() + x

    np.testing.assert_array_equal(batch.map(one, jnp.ones(3)), [1, 6, 11])
    assert shapes == [(2,)]
    np.testing.assert_array_equal(batch.take(np.array([2, 2, 0])).varied["a"], [2, 2, 0])


def test_what_is_made_of_shared_leaves_is_shared():
    case = {"a": np.asarray(1.0), "b": np.asarray([2.0, 3.0])}
    batch = Batched.of({"a": np.arange(3.0), "b": case["b"]}, case)
    made = batch.apply(lambda tree: {"both": tree["a"] * tree["b"], "alone": 2 * tree["b"]})
    np.testing.assert_array_equal(made.varied["both"], [[0, 0], [2, 3], [4, 6]])
    np.testing.assert_array_equal(made.shared["alone"], [4, 6])
    assert (made.varied["alone"], made.shared["both"]) == (None, None)
    same = Batched({"a": None, "b": None}, case).apply(lambda tree: tree["a"] + tree["b"])
    assert (same.varied, same.shared.tolist()) == (None, [3, 4])


@pytest.mark.usefixtures("own_cache")
def test_calls_compile_once_for_other_numbers():
    traced = []

    def scaled(functions, static, x):
        traced.append(static)
        return functions(x) * static[0]

    for factor in (2.0, 3.0):
        power = jax.tree_util.Partial(jnp.multiply, jnp.asarray(factor))
        assert call_compiled(scaled, power, (10.0,), jnp.asarray(1.0)) == 10 * factor
    assert traced == [(10.0,)]
    assert jax.grad(lambda x: call_compiled(scaled, jnp.sin, (2.0,), x))(0.0) == 2.0


def test_functions_are_described_by_name_and_code_in_any_process():
    def scaled(k):
        return lambda x: k * x

    def text(function):
        return describe(function)["opaque"]

    assert text(scaled(2.0)) == text(scaled(2.0))
    assert text(scaled(2.0)) != text(scaled(3.0))  # of the same code
    assert text(lambda x: x + 1) != text(lambda x: x + 2)
    nested = lambda k: lambda x: [x + y for y in range(k)]
    assert text(nested(2)) == text(nested(2))
    assert " at 0x" not in text(nested(2))
