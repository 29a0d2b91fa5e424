"""Cost of orbits and branches: against transients that come as close, side by side in one run.

`pytest -m benchmark -s tests/benchmarks/test_orbits.py`
"""

import numpy as np
import pytest

import slipperjax as sj

from .timing import in_turns, median

SCENE = sj.paper_scene()
STEPS = 200
PERIODS = 500
"""Forcing periods after which the transient at 1250 m/s is down to exp(-0.0467 * 500) = 7e-11."""
pytestmark = pytest.mark.benchmark


def test_one_orbit_against_a_transient():
    of = dict(steps_per_period=STEPS)
    transient = median(lambda: sj.simulate(SCENE, PERIODS, loads=False, saves_per_period=1, **of), 7)
    orbit = sj.periodic_orbit(SCENE, **of)
    near = SCENE.replace(speed=1251.0)
    print(f"\n{PERIODS} periods of one case: {transient * 1e3:.0f} ms")
    for words, options in (
        ("after 60 periods", dict(transient=60)),
        ("after 20 periods", dict(transient=20)),
        ("from an orbit near it", dict(start=orbit.state)),
    ):
        taken = median(lambda options=options: sj.periodic_orbit(near, **of, **options), 7)
        print(f"orbit with multipliers {words}: {taken * 1e3:.1f} ms, {taken / transient:.2f} of it")


def test_a_batch_of_orbits_against_transients():
    grid, of = {"speed": np.linspace(1100.0, 1800.0, 241)}, dict(steps_per_period=STEPS)
    options = dict(record="strobe", transient=PERIODS - 10, periods=10)
    transient = median(lambda: sj.sweep(SCENE, grid, **options, **of), 3)
    print(f"\n{PERIODS} periods of 241 cases: {transient:.2f} s")
    for periods in (20, 60):
        orbits = lambda periods=periods: sj.orbit_sweep(SCENE, grid, transient=periods, **of)
        timed = in_turns({"orbits": orbits}, 3)["orbits"]
        taken, good = timed.median, int((timed.result["status"] == 0).sum())
        print(f"241 orbits after {periods} periods: {taken:.2f} s, {taken / transient:.2f} of it; {good} found")


def test_a_branch():
    follow = lambda: sj.continue_orbit(SCENE, "speed", (900.0, 2300.0), steps_per_period=STEPS)
    timed = in_turns({"branch": follow}, 3)["branch"]
    count, events, taken = timed.result.points.sizes["point"], len(timed.result.events), timed.median
    print(
        f"\nbranch over the speed: {count} points and {events} events in {taken:.1f} s, {taken / count * 1e3:.0f} ms"
    )
