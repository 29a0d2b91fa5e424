"""Speed compared with a scalar C++ program of the same model and method (peer.cpp), in one run.

    pytest -m benchmark -s tests/benchmarks

Reports medians and best of alternating runs; asserts no time.
"""

import functools
import math
import resource
import statistics

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.sweeps.attractors import strobe_states

from ..common import SCALES
from .peers import CppProgram
from .timing import in_turns, seconds

pytestmark = pytest.mark.benchmark
STEPS = 50


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    program = CppProgram(tmp_path_factory.mktemp("peer"))
    scene = dict(clearance=1e-3, length=0.2, stiffness=1e8, restitution=0.9, amplitude=1e-3)
    scene |= dict(roll_amplitude=math.radians(0.2), wave=8.0, wave2=0.0)
    return lambda speed, periods=100: program(speed, scene, periods, STEPS)


# short runs, some of which are undisturbed even under other load, though what does not depend on the periods counts;
# and runs as long as those of sweeps
@pytest.mark.parametrize(
    ("lanes", "periods", "repeats"), [(241, 4, 60), (2048, 1, 60), (241, 200, 12), (2048, 50, 12)]
)
@pytest.mark.parametrize("solver", ["RK4", "ImpulseRK4"])
def test_sweep_against_scalar_cpp(peer, solver, lanes, periods, repeats):
    speeds = np.linspace(100, 2500, lanes)
    options = dict(record="strobe", transient=0, periods=periods, steps_per_period=STEPS, solver=solver)
    run = lambda: sj.sweep(sj.paper_scene(), {"speed": speeds}, **options)
    found, first = seconds(run)
    ours, theirs = [], []
    for k in range(repeats):
        theirs.append(peer(float(speeds[(k * lanes) // repeats]))[1])
        ours.append(seconds(run)[1] / (lanes * periods * STEPS) * 1e6)
    ratio = statistics.median(theirs) / statistics.median(ours)
    best = min(theirs) / min(ours)
    print(
        f"\n{solver}, {lanes} speeds, {periods} periods, {STEPS} steps per period: "
        f"{statistics.median(ours):.3f} us per step (best {min(ours):.3f}); "
        f"C++ peer, one core: {statistics.median(theirs):.3f} (best {min(theirs):.3f}); "
        f"{ratio:.1f} times faster by medians, {best:.1f} by the best; "
        f"first call with compiling {first:.1f} s"
    )
    print(f"peak memory so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")
    # After a period the states differ by the errors of both programs at 50 steps. Only speeds above 750 m/s are
    # compared, at which 50 steps resolve an impact; measured 1.2e-4 and 1.8e-4 in the median.
    picked = np.linspace(int(0.3 * lanes), lanes - 1, 15).astype(int)
    ours_end = strobe_states(found)[picked, 0]
    theirs_end = np.array([peer(float(speeds[k]), 1)[0][0] for k in picked])
    difference = np.max(np.abs(ours_end - theirs_end) / SCALES, axis=1)
    print(
        f"states after a period differ by {np.median(difference):.1e} in the median, {difference.max():.1e} at most"
    )
    assert np.median(difference) < 1e-2


def test_cost_of_contact_loads():
    """Sections of ten periods after 200, with and without peak forces and their like."""
    grid = {"speed": np.linspace(100, 2500, 241)}
    run = lambda loads: sj.sweep(sj.paper_scene(), grid, steps_per_period=200, loads=loads)
    timed = in_turns({loads: functools.partial(run, loads) for loads in (True, False)}, 9)
    with_loads, without = (timed[loads].median / (241 * 210 * 200) * 1e6 for loads in (True, False))
    print(
        f"\n200 + 10 periods, 200 steps: {with_loads:.4f} us per step and case with loads, {without:.4f} without "
        f"(medians): {with_loads / without:.3f}"
    )
