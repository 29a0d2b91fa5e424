"""Greatest memory of a whole fit of many windows, each in a process of its own.

pytest -m benchmark -s tests/benchmarks/test_fit_memory.py

Derivatives are kept by windows, so that memory grows as the number of windows and starts. The greatest case takes a
quarter of an hour.
"""

import pytest

from .timing import shown, told

pytestmark = pytest.mark.benchmark
SCRIPT = """
import json, resource, sys, time
import slipperjax as sj
from slipperjax.fitting import Trajectories, synthetic_record
windows, starts = map(int, sys.argv[1:])
truth = sj.paper_scene(1250.0)
sensors = [sj.model.Sensor("az"), sj.model.Sensor("ay", direction="y", place=(0.05, 0.0, 0.0))]
run = sj.simulate(truth, 150 + windows, steps_per_period=160, saves_per_period=160, loads=False)
record = synthetic_record(run, sensors, rate=20 / float(truth.period), periods=windows, noise=0.05)
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
before, begin = peak(), time.perf_counter()
guess = truth.replace(stiffness=6e7, restitution=0.7, clearance=1.5e-3)
unknowns = {"stiffness": (3e7, 3e8), "restitution": (0.5, 0.99), "clearance": (5e-4, 2e-3)}
method = Trajectories(starts=starts, window=1)
found = sj.fit(guess, record, unknowns, sensors, method=method, progress=False)
print("ROW " + json.dumps({
    "windows": windows,
    "starts": starts,
    "status": found.status,
    "before [GB]": f"{1e-9 * before:.2f}",
    "peak [GB]": f"{1e-9 * peak():.2f}",
    "time [s]": f"{time.perf_counter() - begin:.0f}",
}))
"""


def test_memory_of_fits_of_many_windows():
    shown(told("-c", SCRIPT, windows, starts) for windows, starts in ((25, 4), (100, 4), (400, 16)))
