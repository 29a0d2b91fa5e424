"""Shares of basins from a few hundred random starts, beside 20,000 starts: docs/how_to/own_system.md.

pytest -m benchmark -s tests/benchmarks/test_basins.py
"""

import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax import analysis

pytestmark = pytest.mark.benchmark
FEW, MANY = 300, 20_000


def test_shares_of_a_map():
    holmes = lambda c: lambda s, k: jnp.stack([s[1], -0.2 * s[0] + 2.2 * s[1] - s[1] ** 3 + c])

    def shares(seed, count):
        starts = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 2))
        return analysis.map_basins(holmes, starts, [0.05])

    few, many = shares(0, FEW), shares(1, MANY)
    apart = (few.share - many.share)[0] / few.stderr[0]
    print("\nHolmes's map, c = 0.05")
    for k, errors in enumerate(apart):
        print(f"attractor {k}: {few.share[0, k]:.4f} +- {few.stderr[0, k]:.4f}", end=", ")
        print(f"of {MANY} starts {many.share[0, k]:.4f}, {errors:+.2f} errors apart")
    # measured 0.54
    assert np.abs(apart).max() < 3
