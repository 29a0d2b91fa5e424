"""Sweeps into stores: scaling over cores, memory over the number of cases, and what an executor costs.

pytest -m benchmark -s tests/benchmarks/test_stores.py
"""

import os
import statistics
import warnings

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.sweeps.store import store_status

from ..sweeps.made_up import a_grid, made_up
from . import timing

MEMORY = """
import sys, resource, numpy as np, slipperjax as sj
sj.compile_cache(sys.argv[1])
grid = {"speed": np.linspace(1000, 1600, int(sys.argv[3])), "clearance": np.linspace(0.5e-3, 2e-3, 128)}
store = sj.sweeps.Store(sys.argv[2], tile=1024, fresh=True)
sj.sweep(sj.paper_scene(), grid, transient=10, periods=5, steps_per_period=50, store=store)
print("ROW", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
pytestmark = pytest.mark.benchmark
HOW = dict(transient=100, periods=10, steps_per_period=100)


def grid(across: int, up: int) -> dict:
    return {"speed": np.linspace(1000, 1600, across), "clearance": np.linspace(0.5e-3, 2e-3, up)}


def seconds(path, cases: dict, **how) -> float:
    def run():
        made = sj.sweeps.Store(path, tile=256, fresh=True)
        return sj.sweep(sj.paper_scene(), cases, store=made, **(HOW | how))

    return timing.seconds(run)[1]


def test_two_cores_beside_one(tmp_path):
    sj.compile_cache(tmp_path / "cache")
    cases = grid(32, 128)
    for name, engines in (("threads", None), ("processes", sj.sweeps.processes)):
        times: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(4):  # the first of each compiles
            for count in (1, 2):
                if engines is None:
                    times[count].append(seconds(tmp_path / "map.zarr", cases, workers=count))
                else:
                    with engines(count) as pool:
                        seconds(tmp_path / "warm.zarr", grid(2 * count, 128), executor=pool)
                        times[count].append(seconds(tmp_path / "map.zarr", cases, executor=pool))
        one, two = (statistics.median(times[count][1:]) for count in (1, 2))
        print(
            f"\n{name}: {4096 / one:.0f} cases/s with one, {4096 / two:.0f} with two: {one / two:.2f} times as many"
        )


def test_memory_does_not_grow_with_the_cases(tmp_path):
    for across in (16, 128, 512):
        most = timing.told("-c", MEMORY, tmp_path / "cache", tmp_path / "map.zarr", across)
        size = store_status(tmp_path / "map.zarr").bytes / 1e6
        print(f"\n{128 * across} cases: {most:.0f} MB of memory at most, {size:.1f} MB on disk")


def test_executors_beside_tiles_of_a_second(tmp_path, monkeypatch):
    """Twelve tiles that only wait for a second, on two workers: what is above six seconds is the executor's."""
    monkeypatch.setenv("PAUSE", "1.0")
    distributed = pytest.importorskip("distributed")
    run = lambda pool, name: made_up(
        sj.paper_scene(), a_grid(), store=sj.sweeps.Store(tmp_path / name, tile=10), executor=pool
    )

    def timed(pool, name):
        run(pool, f"warm-{name}")  # processes import what they need
        _, lasts = timing.seconds(lambda: run(pool, name))
        # a second of it is the look at one case that tells what there is to store
        print(f"\n{name}: {(lasts - 1.0) / 6.0 - 1:.1%} above six seconds")

    with sj.sweeps.processes(2) as pool:
        timed(pool, "processes.zarr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        options = dict(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
            timed(client, "dask.zarr")


def test_a_map_of_40000_cases(tmp_path):
    """Motion and peak force over speed and clearance, as docs/how_to/clusters.md shows it."""
    sj.compile_cache(os.environ.get("SLIPPERJAX_CACHE"))
    axes = {"speed": np.linspace(100, 2500, 200), "clearance": np.linspace(0.2e-3, 3e-3, 200)}
    how = dict(record=["motion", "peak_force"], transient=300, periods=50, steps_per_period=100)
    print(f"\n{sj.explain(sj.sweep, sj.paper_scene(), axes, store=tmp_path / 'map.zarr', **how)}")
    ds, lasts = timing.seconds(lambda: sj.sweep(sj.paper_scene(), axes, store=tmp_path / "map.zarr", **how))
    print(f"{ds['status'].size} cases in {lasts:.0f} s, {ds['status'].size / lasts:.0f} cases/s: ", end="")
    print(store_status(tmp_path / "map.zarr"))
