"""Error, time and memory of the default solver and its default steps, case by case: a table of docs/lab/solvers.md.

    pytest -m benchmark -s tests/benchmarks/test_hard_cases.py

Each case runs in a process of its own, without a cache of programs: 241 speeds within 2 %, every fourth of them
against RK4 with the event latch at many more steps, beside which ImpulseRK4 at as many steps stands.
"""

import dataclasses
import json
import resource
import sys

import numpy as np
import pytest

import slipperjax as sj

from ..bench.measure import REFERENCE_STEPS, batch_speeds, cost_of, errors, run
from ..bench.methods import METHODS, Case, all_cases
from .timing import seconds, shown, told

LANES, STRIDE = 241, 4
"""Cases in the batch, and the stride through those whose errors are measured."""


def hard_cases():
    """The hard scenes of the benchmark, and further ones."""
    paper, start = sj.paper_scene, sj.table_2_start()
    lies = dataclasses.replace(paper(), gravity=9.81)
    rough = dataclasses.replace(lies, track=sj.RandomTrack.sled(length=400.0, seed=3))
    sled = sj.model.Payload(mass=100.0, stiffness=[2e6, 8e6], damping=[2e3, 8e3])
    named = {case.name: case for case in all_cases()}
    return [
        *(named[name] for name in ("nominal", "K = 1e10", "C = 4 mm", "two waves")),
        Case("restitution 0.2", paper(restitution=0.2), 6, start),
        Case("V = 150 m/s", paper(150.0), 1, start),
        Case("V = 2500 m/s", paper(2500.0), 6, start),
        Case("friction 0.3", dataclasses.replace(lies, friction=sj.model.Coulomb(0.3)), 6, start),
        Case("a sled of 100 kg on top", dataclasses.replace(lies, payload=sled), 6, start),
        Case("rough rail, 48 m", rough, 6, start),
    ]


def main():
    """Prints the row of one case as JSON."""
    (case,) = (case for case in hard_cases() if case.name == sys.argv[1])
    steps = sj.model.default_steps_per_period(case.scene)
    plain, default = METHODS[:2]
    speeds = batch_speeds(case, LANES)
    (states, _), first = seconds(lambda: run(case, default, steps, speeds, None))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of the process so far, before the reference
    costs = {}
    for lanes in (LANES, 1):
        batch = batch_speeds(case, lanes)
        times = [run(case, default, steps, batch, None)[1] for _ in range(6)]
        costs[lanes] = cost_of(np.array(times[1:]), lanes)[0]  # the first of one alone compiles
    fine = float(max(REFERENCE_STEPS, 32 * steps))
    truth, other = (run(case, method, fine, speeds[::STRIDE], None)[0] for method in (plain, default))
    off = errors(states[::STRIDE], truth)
    row = {
        "case": case.name,
        "periods": case.periods,
        "steps": round(steps),
        "error, median": f"{np.median(off):.1e}",
        "90 %": f"{np.percentile(off, 90):.1e}",
        "worst": f"{np.max(off):.1e}",
        "references differ by (90 %)": f"{np.percentile(errors(other, truth), 90):.0e}",
        "µs, 241 at once": f"{costs[LANES]:.0f}",
        "µs, one": f"{costs[1]:.0f}",
        "first call [s]": f"{first:.1f}",
        "memory [MiB]": f"{memory:.0f}",
    }
    print("ROW " + json.dumps(row))


@pytest.mark.benchmark
def test_table_of_the_default():
    rows = shown(told("-m", __name__, case.name) for case in hard_cases())
    assert all(float(row["error, median"]) < 0.1 for row in rows)


if __name__ == "__main__":
    main()
