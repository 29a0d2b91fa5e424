"""Intervals hold as often as they say. `REPEATS=100` repeats the table of docs/how_to/fit.md."""

import os

import numpy as np
import pytest
from scipy.stats import binom

import slipperjax as sj
from slipperjax.fitting import synthetic_record

REPEATS = int(os.environ.get("REPEATS", "20"))
TRUTH = sj.paper_scene(1250.0)
FAR = TRUTH.replace(stiffness=6e7, restitution=0.7, clearance=1.5e-3)
SENSORS = [sj.model.Sensor("az"), sj.model.Sensor("ay", direction="y", place=(0.05, 0.0, 0.0))]
BOUNDS = {"stiffness": (3e7, 3e8), "restitution": (0.5, 0.99), "clearance": (5e-4, 2e-3)}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.05, 0.2])
def test_the_intervals_of_a_periodic_motion_hold(noise):
    run = sj.simulate(TRUTH, 220, steps_per_period=240, saves_per_period=240, loads=False)
    rate = 50 / float(TRUTH.period)
    away = []
    inside = []
    for seed in range(REPEATS):
        measured = synthetic_record(run, SENSORS, rate=rate, periods=20, noise=noise, seed=seed)
        found = sj.fit(FAR, measured, BOUNDS, SENSORS, seed=seed)
        truth = {name: float(TRUTH.value(name)) for name in BOUNDS}
        away.append([(found.estimate[name] - truth[name]) / found.stderr[name] for name in BOUNDS])
        inside.append([low < truth[name] < high for name, (low, high) in found.interval.items()])
    covered = np.sum(inside, axis=0)
    print(f"noise {noise}: covered {covered / REPEATS}, bias {np.mean(away, axis=0)}, spread {np.std(away, axis=0)}")
    # of 100, 91 to 93 with each of the noises
    assert np.all(covered >= binom.ppf(0.001, REPEATS, 0.9))
    # 0.23 at most
    assert np.all(np.abs(np.mean(away, axis=0)) < 1.0)
