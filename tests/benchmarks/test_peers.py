"""Error against cost of other codes beside ours: the rows and the picture of docs/lab/solvers.md.

    pytest -m benchmark -s tests/benchmarks/test_peers.py

Takes minutes. The picture is drawn into a temporary folder, which is printed.
"""

import numpy as np
import pytest

from ..bench.measure import REFERENCE_STEPS, batch_speeds, bench, errors, run
from ..bench.methods import METHODS, all_cases
from ..bench.work_precision import SHOWN, Point, table, write
from .peers import PEERS, CppPeer

pytestmark = pytest.mark.benchmark
NOMINAL, LANES = all_cases()[0], 241


def peer_points(case, speeds, truth):
    """Cost and error of each of the other codes, one by one."""
    for peer in PEERS:
        for setting, states, taken, picked in peer.runs(case, speeds):
            error = float(np.median(errors(states, truth[picked])))
            best, median = (1e6 * seconds / case.periods for seconds in taken)
            yield Point(case.name, peer.name, setting, error, {1: (best, median)})


def test_other_codes_beside_ours(tmp_path):
    speeds = batch_speeds(NOMINAL, LANES)
    truth, _ = run(NOMINAL, METHODS[0], float(REFERENCE_STEPS), speeds, None)
    theirs = list(peer_points(NOMINAL, speeds, truth))
    methods = [method.name for method in METHODS if method.name in SHOWN]
    (ours,) = bench(cases=[NOMINAL.name], methods=methods, batches=(LANES, 1), repeats=3)
    print("\n" + table(theirs + ours))
    print(*write(theirs + ours, tmp_path / "bench"), sep="\n")
    # another program converges to the same motions; measured: 1.2e-6 at 1600 steps
    (cpp,) = (p for p in theirs if (p.method, p.setting) == (CppPeer.name, "1600 steps"))
    assert cpp.error < 1e-5
    assert min(p.error for p in theirs if p.method.startswith("SciPy")) < 1e-3
