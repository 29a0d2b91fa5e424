"""Lyapunov exponents: cost relative to the plain trajectory. Beside other tools: `test_rivals.py`.

pytest -m benchmark -s tests/benchmarks/test_lyapunov.py
"""

import statistics

import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import advance, advance_tangents, initial_states, initial_tangents
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.sweeps.grid import Cases

from .timing import in_turns

pytestmark = pytest.mark.benchmark


@pytest.mark.parametrize("count", [1, 10])
def test_cost_against_the_trajectory(count):
    """One period at a time on one core: some of such short runs are undisturbed even under other load."""
    cases = Cases(sj.paper_scene(), {"speed": np.linspace(100.0, 2500.0, 121)}, sj.table_2_start())
    scenes, starts = cases.take(np.arange(121))
    states = initial_states(scenes, starts)
    tangents = initial_tangents(scenes, states, count)
    options, steps = dict(solver=sj.solvers.RK4(), periods=1), ConstantSteps(steps=jnp.asarray(50.0))
    runs = {
        "plain": lambda: advance(scenes, states, 0.0, steps, **options).state,
        "full": lambda: advance_tangents(scenes, states, tangents, 0.0, steps, **options).history,
    }
    taken = in_turns(runs, 100)
    for name, of in (("best", min), ("median", statistics.median)):
        one, many = (of(taken[name].later) for name in runs)
        print(
            f"\n{count} exponents, 121 cases, 50 steps, {name} of 100: {many / one:.1f} times the trajectory "
            f"({many / 121 * 1e6:.0f} us per case and period); "
            f"241 speeds, 200 + 500 periods on two cores: {200 * one + 520 * many:.0f} s"
        )
