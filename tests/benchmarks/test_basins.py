"""Shares of basins from a few hundred random starts, beside 20,000: docs/how_to/own_system.md, docs/how_to/orbits.md.

pytest -m benchmark -s tests/benchmarks/test_basins.py
"""

import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis

pytestmark = pytest.mark.benchmark
FEW, MANY = 300, 20_000


def compared(name, few, many, stderr):
    """The greatest difference of shares, in standard errors of the few."""
    apart = (few - many) / stderr
    print(f"\n{name}")
    for k, errors in enumerate(apart):
        print(f"attractor {k}: {few[k]:.4f} +- {stderr[k]:.4f}", end=", ")
        print(f"of {MANY} starts {many[k]:.4f}, {errors:+.2f} errors apart")
    return np.abs(apart).max()


def test_shares_of_a_map():
    holmes = lambda c: lambda s, k: jnp.stack([s[1], -0.2 * s[0] + 2.2 * s[1] - s[1] ** 3 + c])

    def shares(seed, count):
        starts = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 2))
        return analysis.map_basins(holmes, starts, [0.05])

    few, many = shares(0, FEW), shares(1, MANY)
    # measured 0.54
    assert compared("Holmes's map, c = 0.05", few.share[0], many.share[0], few.stderr[0]) < 3


def test_shares_of_a_slipper():
    starts = {"start_y": (-0.4e-3, 0.4e-3), "start_v_y": (-0.5, 0.5)}

    def shares(seed, count):
        scene = sj.paper_scene(speed=1850.0)
        return sj.basins(scene, starts, count=count, seed=seed, transient=200, steps_per_period=64).ds

    few, many = shares(0, FEW), shares(1, MANY)
    assert np.array_equal(few["basin_period"], many["basin_period"])
    columns = few["share"].values, many["share"].values, few["share_stderr"].values
    # measured 0.22
    assert compared("the paper's slipper at 1850 m/s", *columns) < 3
