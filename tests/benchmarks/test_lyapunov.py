"""Lyapunov exponents: cost against the plain trajectory, and Lorenz side by side with lyapax (extra `peers`).

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

from ..test_lyapunov import Rk4, lorenz

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
    grid = {"speed": np.linspace(100, 2500, 241)}
    scene, steps = sj.paper_scene(), dict(steps_per_period=50)
    plain = lambda: sj.sweep(scene, grid, record="strobe", transient=0, periods=20, **steps)
    full = lambda: sj.lyapunov_sweep(scene, grid, count=count, transient=20, periods=20, certify=False, **steps)
    taken = {plain: [], full: []}
    for _ in range(12):  # in turns; the first is compiling
        for run, times in taken.items():
            begin = time.perf_counter()
            run()
            times.append(time.perf_counter() - begin)
    for name, of in (("best", min), ("median", statistics.median)):
        trajectory, whole = (of(times[1:]) for times in taken.values())
        exponents = (whole - trajectory) / 2  # after the transient, 20 periods to align and 20 that count
        print(
            f"\n241 speeds, {count} exponents, {name} of 11: {exponents / trajectory:.1f} times the trajectory "
            f"({exponents / 20 / 241 * 1e3:.3f} ms per case and period); "
            f"200 + 500 periods: {trajectory * 10 + exponents * 25:.0f} s"
        )
