"""Speed side by side with a scalar C++ program of the same model and method (peer.cpp), in one run.

    pytest -m benchmark -s tests/benchmarks

Reports medians and best of alternating runs; asserts no time.
"""

import math
import re
import resource
import shutil
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import slipperjax as sj

pytestmark = pytest.mark.benchmark
STEPS = 50
REPEATS = 60
LIMIT_NS = 58.0  # flops, roots and divisions of one right-hand side at full rate, per core


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed, so the C++ peer cannot be built")
    program = tmp_path_factory.mktemp("peer") / "peer"
    subprocess.run(
        ["g++", "-O3", "-march=native", str(Path(__file__).with_name("peer.cpp")), "-o", str(program)],
        check=True,
    )

    def microseconds_per_step(speed, periods=100):
        arguments = [speed, 1e-3, 0.2, 1e8, 0.9, 1e-3, math.radians(0.2), 8, 0, periods, STEPS]
        out = subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True, check=True).stdout
        return float(re.findall(r"([\d.]+) us per step", out)[-1])

    return microseconds_per_step


# short runs, so that on a busy machine some of them pass undisturbed
@pytest.mark.parametrize(("lanes", "periods"), [(241, 4), (2048, 1)])
def test_sweep_against_scalar_cpp(peer, lanes, periods):
    speeds = np.linspace(100, 2500, lanes)
    run = lambda: sj.sweep(
        sj.paper_scene(),
        {"speed": speeds},
        record="strobe",
        transient=0,
        periods=periods,
        steps_per_period=STEPS,
    )
    begin = time.perf_counter()
    run()
    first = time.perf_counter() - begin
    ours, theirs = [], []
    for k in range(REPEATS):
        theirs.append(peer(float(speeds[(k * lanes) // REPEATS])))
        begin = time.perf_counter()
        run()
        ours.append((time.perf_counter() - begin) / (lanes * periods * STEPS) * 1e6)
    ratio = statistics.median(theirs) / statistics.median(ours)
    best = min(theirs) / min(ours)
    print(
        f"\n{lanes} speeds, {STEPS} steps per period: "
        f"{statistics.median(ours):.3f} us per step (best {min(ours):.3f}); "
        f"C++ peer, one core: {statistics.median(theirs):.3f} (best {min(theirs):.3f}); "
        f"{ratio:.1f} times faster by medians, {best:.1f} by the best; "
        f"first call with compiling {first:.1f} s; "
        f"{4 * LIMIT_NS / 1000 / 2 / min(ours):.0%} of the limit of 4 right-hand sides on 2 cores"
    )
    print(f"peak memory so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")
    assert ratio > 0
