"""Shares of basins from a few hundred random starts, beside 20,000 starts: docs/how_to/orbits.md.

pytest -m benchmark -s tests/benchmarks/test_basins.py
"""

import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis

pytestmark = pytest.mark.benchmark
FEW, MANY = 300, 20_000


def compared(name, few, many):
    """Prints shares, and returns their differences in standard errors."""
    apart = (few[0] - many[0]) / few[1]
    print(f"\n{name}")
    for k, (share, stderr, exact, errors) in enumerate(zip(*few, many[0], apart, strict=True)):
        print(f"attractor {k}: {share:.4f} +- {stderr:.4f}, of {MANY} starts {exact:.4f}, {errors:+.2f} errors apart")
    # measured 1.3 at most
    assert np.abs(apart).max() < 3


def test_shares_of_a_map():
    holmes = lambda c: lambda s, k: jnp.stack([s[1], -0.2 * s[0] + 2.2 * s[1] - s[1] ** 3 + c])

    def shares(seed, count):
        starts = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 2))
        found = analysis.map_basins(holmes, starts, [0.05])
        return found.share[0], found.stderr[0]

    compared("Holmes's map, c = 0.05", shares(0, FEW), shares(1, MANY))


def test_shares_of_a_slipper():
    scene = sj.paper_scene(speed=1850.0)
    box = {"start_y": (-1e-3, 1e-3), "start_v_y": (-0.5, 0.5)}

    def shares(seed, count):
        found = sj.basins(scene, box, count=count, seed=seed, transient=200, steps_per_period=50)
        return found.ds["share"].values, found.ds["share_stderr"].values

    compared("slipper at 1850 m/s", shares(0, FEW), shares(1, MANY))
