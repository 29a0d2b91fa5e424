"""Lyapunov exponents: cost relative to the plain trajectory, and Lorenz compared with lyapax (extra `peers`).

pytest -m benchmark -s tests/benchmarks/test_lyapunov.py
"""

import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.analysis.lyapunov import map_spectrum
from slipperjax.flow.period_map import advance, advance_tangents, initial_states, initial_tangents
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.sweeps.grid import Cases

from ..analysis.test_lyapunov import Rk4, lorenz

pytestmark = pytest.mark.benchmark
TRUE = np.array([0.9056, 0.0, -14.5723])


def seconds(run, times=5):
    run()  # compiles
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken)


def test_lorenz_beside_lyapax():
    lyapax = pytest.importorskip("lyapax")
    dt, every, intervals = 0.01, 10, 20_000
    problem = lyapax.ode_problem(lambda y: lorenz(0.0, y), state0=jnp.array([1.0, 1.0, 20.0]), dt=dt)
    step, period = Rk4(lorenz, dt, every), dt * every
    ours = lambda: map_spectrum(step, jnp.array([1.0, 1.0, 20.0]), intervals, transient=200, align=100, period=period)
    theirs = lambda: lyapax.lyapunov_spectrum(
        problem, n_steps=every * intervals, renorm_every=every, t_transient=200 * period
    )
    print(f"\nLorenz, RK4 of step {dt}, {intervals} orthonormalisations, errors of the three exponents:")
    taken = {}
    for name, run, value in (("slipperjax", ours, lambda r: r.per_second), ("lyapax", theirs, lambda r: r.exponents)):
        error = np.abs(np.asarray(value(run())) - TRUE)
        taken[name] = seconds(lambda run=run: jax.tree.leaves(run().history))
        print(f"  {name:10} {error[0]:.1e} {error[1]:.1e} {error[2]:.1e}   {taken[name]:.2f} s")
    print(f"  lyapax takes {taken['lyapax'] / taken['slipperjax']:.2f} times as long")


@pytest.mark.parametrize("count", [1, 10])
def test_cost_against_the_trajectory(count):
    """One period at a time on one core: some of such short runs are undisturbed even under other load."""
    cases = Cases(sj.paper_scene(), {"speed": np.linspace(100.0, 2500.0, 121)}, sj.table_2_start())
    scenes, starts = cases.take(np.arange(121))
    states = initial_states(scenes, starts)
    tangents = initial_tangents(scenes, states, count)
    options, steps = dict(solver=sj.RK4(), periods=1), ConstantSteps(steps=jnp.asarray(50.0))
    runs = {
        "plain": lambda: advance(scenes, states, 0.0, steps, **options).state,
        "full": lambda: advance_tangents(scenes, states, tangents, 0.0, steps, **options).history,
    }
    taken = {name: [] for name in runs}
    for _ in range(101):  # alternating; the first run compiles
        for name, run in runs.items():
            begin = time.perf_counter()
            jax.block_until_ready(run())
            taken[name].append(time.perf_counter() - begin)
    for name, of in (("best", min), ("median", statistics.median)):
        one, many = (of(taken[name][1:]) for name in runs)
        print(
            f"\n{count} exponents, 121 cases, 50 steps, {name} of 100: {many / one:.1f} times the trajectory "
            f"({many / 121 * 1e6:.0f} us per case and period); "
            f"241 speeds, 200 + 500 periods on two cores: {200 * one + 520 * many:.0f} s"
        )
