"""The table of docs/lab/accuracy.md: worst scaled errors over six periods, by steps per period.

pytest -m benchmark -s tests/benchmarks/test_accuracy.py
"""

import numpy as np
import pytest

import slipperjax as sj

from ..common import cases, scaled_errors, scene_of

pytestmark = pytest.mark.benchmark
STEPS = (25, 50, 100, 200, 400)


def test_accuracy_by_steps():
    table = []
    print("\n" + " ".join(f"{n:>8}" for n in STEPS) + "  steps per period")
    for case in cases("reference_states"):
        if case["stiffness"] > 1e9:
            continue
        runs = [sj.simulate(scene_of(case), 6, steps_per_period=n, saves_per_period=1) for n in STEPS]
        row = [scaled_errors(run, case, 1).max() for run in runs]
        name = f"V = {case['speed']:.0f} m/s, C = {case['clearance'] * 1e3:.0f} mm, L = {case['length']} m"
        print(" ".join(f"{e:8.1e}" for e in row) + f"  {name}" + (", two waves" if case["wavelength2"] else ""))
        table.append(row)
    orders = np.log2(np.array(table)[:, 1:-1] / np.array(table)[:, 2:])
    print(f"order from {STEPS[1]} steps on, in the median: {np.median(orders):.2f}")
    assert np.median(orders) > 1.9  # measured 2.35
