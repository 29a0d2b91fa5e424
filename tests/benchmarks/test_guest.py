"""Loops of other people's JAX programs, with and without the import of slipperjax, each in a process of its own.

    pytest -m benchmark -s tests/benchmarks/test_guest.py

Prints the times of ten loops in 32 bits, and the ratio with the import; asserts no time.
"""

import json
import statistics
import subprocess
import sys

import pytest

pytestmark = pytest.mark.benchmark
ROUNDS = 3
PROGRAM = """
import json, statistics, sys, time
import jax, jax.numpy as jnp
from jax import lax
jax.config.update("jax_enable_compilation_cache", False)
if sys.argv[1] == "with":
    import slipperjax
f32 = jnp.float32
key = jax.random.key(0)
normal = lambda *shape: jax.random.normal(key, shape, f32)
w1, w2, big, batch = normal(64, 256), normal(256, 64), normal(256, 256) / 16, normal(128, 64)
mlp = lambda x: jnp.tanh(jnp.tanh(x @ w1) @ w2)
many = lambda x, count: lax.scan(lambda x, _: (mlp(x), None), x, None, length=count)[0]
normed = lambda c: (c[0] / jnp.linalg.norm(c[0]) + big, c[1] + 1)
kernel, channels = jnp.ones((3, 3, 8, 8), f32) / 72, dict(dimension_numbers=("NHWC", "HWIO", "NHWC"))
convolved = lambda k, a: lax.conv_general_dilated(a, kernel, (1, 1), "SAME", **channels)
flow = lambda x: lax.fori_loop(0, 500, lambda k, x: x + f32(0.01) * jnp.sin(x), x)
summed = lambda k, a: a + jnp.sum(a) * f32(1e-9)
loops = {
    "scan of an MLP": lambda: many(batch, 200),
    "its gradient": lambda: jax.grad(lambda x: jnp.sum(many(x, 50)))(batch),
    "products of 256 x 256": lambda: lax.fori_loop(0, 50, lambda k, a: jnp.tanh(a @ big), big),
    "while with a norm": lambda: lax.while_loop(lambda c: c[1] < 100, normed, (big, 0))[0],
    "convolutions": lambda: lax.fori_loop(0, 20, convolved, jnp.ones((4, 32, 32, 8), f32)),
    "sorts": lambda: lax.fori_loop(0, 50, lambda k, a: jnp.sort(a + k.astype(f32)), normal(10_000)),
    "sums of a large array": lambda: lax.fori_loop(0, 100, summed, normal(1_000_000)),
    "an ODE, batch of 1000": lambda: jax.vmap(flow)(normal(1000, 3)),
    "lax.map": lambda: lax.map(lambda row: jnp.sum(jnp.outer(row, row) @ row[:, None]), normal(500, 64)),
    "cumulative maxima": lambda: lax.associative_scan(jnp.maximum, normal(500_000)),
}
times = {}
for name, loop in loops.items():
    run = jax.jit(loop)
    jax.block_until_ready(run())
    took = []
    for _ in range(5):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        took.append(time.perf_counter() - begin)
    times[name] = statistics.median(took)
print(json.dumps(times))
"""


def test_loops_of_others():
    times = {"without": [], "with": []}
    for _ in range(ROUNDS):
        for which, found in times.items():
            done = subprocess.run([sys.executable, "-c", PROGRAM, which], capture_output=True, text=True, check=True)
            found.append(json.loads(done.stdout))
    print()
    for name in times["with"][0]:
        without, beside = (statistics.median(one[name] for one in times[which]) for which in ("without", "with"))
        print(f"{name}: {1e3 * without:.2f} ms, with the import {1e3 * beside:.2f} ms, {beside / without:.2f} times")
