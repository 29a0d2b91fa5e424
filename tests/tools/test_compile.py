"""The option of XLA that makes one kernel of each loop."""

import os

import jax
import jax.numpy as jnp
import pytest

from slipperjax.tools.compile import loops_in_one_kernel

EXTRA = "--xla_backend_extra_options"


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the option is for CPUs")
def test_a_loop_is_one_kernel():
    loop = lambda x, n: jax.lax.fori_loop(0, n, lambda k, x: jnp.sin(x) + jnp.cumsum(x), x)
    program = jax.jit(loop).lower(jnp.ones(1000), 5).compile().as_text()
    assert "xla_cpu_small_call" in program


def test_the_option_is_added_once(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=somewhere")
    for _ in range(2):
        loops_in_one_kernel()
        assert os.environ["XLA_FLAGS"].startswith("--xla_dump_to=somewhere --xla_backend_extra_options=")
        assert os.environ["XLA_FLAGS"].count(EXTRA) == 1

    # extra options that are there stay
    given = f"{EXTRA}=xla_cpu_small_while_loop_byte_threshold=1024"
    monkeypatch.setenv("XLA_FLAGS", given)
    loops_in_one_kernel()
    assert os.environ["XLA_FLAGS"] == given
