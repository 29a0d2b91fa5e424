"""Adaptive Kvaerno5 with a smooth switch: `SimplifiedNewton` against optimistix's Newton method, which calls LAPACK.

pytest -m benchmark -s tests/benchmarks/test_newton.py
"""

import diffrax
import numpy as np
import optimistix
import pytest

from slipperjax.bench.measure import batch_speeds, run
from slipperjax.bench.methods import Method, all_cases
from slipperjax.model.contact import SmoothSwitch
from slipperjax.solvers.simplified_newton import with_root_finder

LANES = 241


@pytest.mark.benchmark
@pytest.mark.parametrize("tolerance", [1e-4, 1e-5])
def test_adaptive_steps_with_a_smooth_switch(tolerance):
    """One period of 241 cases; with Newton's method of every sixteenth, because its cost per case is the same."""
    case = all_cases()[0]._replace(periods=1)
    speeds = batch_speeds(case, LANES)
    newton = diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-9))
    ends, cost = {}, {}
    for name, solver, batch in (
        ("SimplifiedNewton", with_root_finder(diffrax.Kvaerno5()), speeds),
        ("Newton", newton, speeds[::16]),
    ):
        method = Method(name, solver, SmoothSwitch(), (tolerance,), adaptive=True)
        run(case, method, tolerance, batch, None)  # compiles
        ends[name], seconds = run(case, method, tolerance, batch, None)
        cost[name] = seconds.sum() / len(batch) * 1e6
        done = f"{cost[name]:.0f} us per case and period ({len(batch)} cases)"
        print(f"\n{name}, tolerance {tolerance:.0e}: {done}", end="")
    print(f"; {cost['Newton'] / cost['SimplifiedNewton']:.0f} times")
    # both are as far from the truth as the tolerance lets them; measured in SI units: 5.9e-3 and 1.4e-3
    assert np.abs(ends["Newton"] - ends["SimplifiedNewton"][::16]).max() < 2e-2
