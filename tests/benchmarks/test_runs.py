"""What runs cost: beside sweeps of forcing periods, over 5 km for one and for 200 rails, and their memory.

pytest -m benchmark -s tests/benchmarks/test_runs.py
"""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj

from .timing import median, seconds, told

pytestmark = pytest.mark.benchmark
FAST = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0), sj.Stage(-160.0, speed=100.0)], start=50.0)
RAIL = dataclasses.replace(sj.paper_scene(), track=sj.RandomTrack.sled(length=5100.0), gravity=9.81)
MEMORY = """
import dataclasses, re, sys, slipperjax as sj
length = float(sys.argv[1])
scene = dataclasses.replace(sj.paper_scene(900.0), track=sj.RandomTrack.sled(length=5100.0, ends="repeat"))
ds = sj.run(scene, length=length)
# not that of getrusage, which a process inherits
print("ROW", int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024)
"""


def test_runs_beside_sweeps():
    grid, options = {"restitution": np.linspace(0.85, 0.95, 128)}, dict(steps_per_period=80, record="peak_force")
    of_sweep = lambda: sj.sweep(sj.paper_scene(), grid, transient=0, periods=100, **options)
    # as sweeps begin
    start = sj.table_2_start()
    of_run = lambda window: sj.run(sj.paper_scene(), grid, length=800.0, window=window, start=start, **options)
    base = median(of_sweep, 5)
    print(f"\n128 cases over 800 m, 80 steps per 8 m: sweep {base:.2f} s")
    for window in (8.0, 1.0):
        print(f"run with windows of {window:g} m: {median(lambda w=window: of_run(w), 5) / base:.2f} of that")
    default = median(lambda: sj.run(sj.paper_scene(), grid, length=800.0, start=start, steps_per_period=80), 5)
    print(f"with all records of a run, windows of 1 m: {default / base:.2f}")


def test_five_kilometres():
    payload = sj.model.Payload(100.0, [2e6, 8e6], [2e3, 8e3])
    for parts in ({}, dict(friction=sj.model.Coulomb(0.1)), dict(payload=payload)):
        scene = dataclasses.replace(RAIL, **parts)
        one = median(lambda scene=scene: sj.run(scene, length=5000.0, speed=FAST), 3)
        print(f"\n5 km, {'plain' if not parts else next(iter(parts))}: one run {one:.2f} s")
    grid = {"track.seed": np.arange(200.0)}
    (ds, first), (_, again) = (seconds(lambda: sj.run(RAIL, grid, length=5000.0, speed=FAST)) for _ in range(2))
    print(f"200 rails: {first:.1f} s with compiling, {ds.nbytes / 2**20:.0f} MB; again: {again:.1f} s")


def test_memory_over_the_distance():
    short, long = (told("-c", MEMORY, length) for length in (5e3, 50e3))
    print(f"\npeak memory of one run: {short:.0f} MB over 5 km, {long:.0f} over 50 km, {long / short:.2f}")
