"""Cost of orbits and branches: against transients that come as close, side by side in one run.

`pytest -m benchmark -s tests/benchmarks/test_orbits.py`
"""

import time

import numpy as np
import pytest

import slipperjax as sj

SCENE = sj.paper_scene()
STEPS = 200
PERIODS = 500
"""Forcing periods after which the transient at 1250 m/s is down to exp(-0.0467 * 500) = 7e-11."""
pytestmark = pytest.mark.benchmark


def median(repeats, call, *args, **options) -> float:
    """Seconds of a call, the median of some after a first one that compiles."""
    call(*args, **options)
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call(*args, **options)
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))


def test_one_orbit_against_a_transient():
    of = dict(steps_per_period=STEPS)
    transient = median(7, sj.simulate, SCENE, PERIODS, loads=False, saves_per_period=1, **of)
    orbit = sj.periodic_orbit(SCENE, **of)
    print(f"\n{PERIODS} periods of one case: {transient * 1e3:.0f} ms")
    for words, options in (
        ("after 60 periods", dict(transient=60)),
        ("after 20 periods", dict(transient=20)),
        ("from an orbit near it", dict(start=orbit.state)),
    ):
        taken = median(7, sj.periodic_orbit, SCENE.replace(speed=1251.0), **of, **options)
        print(f"orbit with multipliers {words}: {taken * 1e3:.1f} ms, {taken / transient:.2f} of it")


def test_a_batch_of_orbits_against_transients():
    grid, of = {"speed": np.linspace(1100.0, 1800.0, 241)}, dict(steps_per_period=STEPS)
    transient = median(3, sj.sweep, SCENE, grid, record="strobe", transient=PERIODS - 10, periods=10, **of)
    print(f"\n{PERIODS} periods of 241 cases: {transient:.2f} s")
    for periods in (20, 60):
        taken = median(3, sj.orbit_sweep, SCENE, grid, transient=periods, **of)
        good = int((sj.orbit_sweep(SCENE, grid, transient=periods, **of)["status"] == 0).sum())
        print(f"241 orbits after {periods} periods: {taken:.2f} s, {taken / transient:.2f} of it; {good} found")


def test_a_branch():
    run = SCENE, "speed", (900.0, 2300.0)
    branch = sj.continue_orbit(*run, steps_per_period=STEPS)
    count, events = branch.points.sizes["point"], len(branch.events)
    taken = median(3, sj.continue_orbit, *run, steps_per_period=STEPS)
    print(
        f"\nbranch over the speed: {count} points and {events} events in {taken:.1f} s, {taken / count * 1e3:.0f} ms"
    )
