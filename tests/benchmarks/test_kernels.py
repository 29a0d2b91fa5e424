"""Loops as one kernel against kernels of their own, alternating in one process: the table of docs/lab/speed.md.

pytest -m benchmark -s tests/benchmarks/test_kernels.py
"""

import time
from concurrent.futures import ThreadPoolExecutor

import jax
import pytest

import slipperjax as sj
from slipperjax.tools import fast, forms, one_kernel, plain

from ..bench import rates
from .timing import in_turns

pytestmark = pytest.mark.benchmark
RUNS = 30
STEPS = rates.NOMINAL_STEPS * rates.CALL_PERIODS


def least(calls, at_once):
    """The least time of each call [s], of runs that alternate, so many of one call at once."""
    with ThreadPoolExecutor(at_once) as pool:
        runs = {
            name: lambda call=call: list(pool.map(lambda _: jax.block_until_ready(call()), range(at_once)))
            for name, call in calls.items()
        }
        return {name: min(run.later) for name, run in in_turns(runs, RUNS).items()}


@pytest.mark.parametrize(
    ("engine", "batches"),
    [("RK4", (1, 8, 32, 128, 256, 512, 1024)), ("Lyapunov", (1, 8, 32, 160)), ("Rodas4", (32,))],
)
def test_one_kernel(engine, batches, monkeypatch):
    print(f"\n{engine}: one core's time of a step and case [us]; compiling [s of a core]")
    for lanes in batches:
        calls, compiling = {}, {}
        for name, fits in (("kernels of their own", lambda *_: False), ("one kernel", one_kernel._fits)):
            monkeypatch.setattr(one_kernel, "_fits", fits)
            begin = time.process_time()
            calls[name] = rates.program(engine, lanes)
            compiling[name] = time.process_time() - begin
            jax.block_until_ready(calls[name]())
        monkeypatch.undo()
        for at_once in (1, 2):
            for name, seconds in least(calls, at_once).items():
                time_of_core = 1e6 * seconds / (STEPS * lanes)
                print(f"  {lanes:5d} cases, {at_once} at once, {name}: {time_of_core:.2f} ({compiling[name]:.1f})")


@pytest.mark.parametrize(("engine", "batches"), [("ImpulseRK4", (1, 8, 128)), ("Lyapunov", (1, 32))])
def test_plain_form(engine, batches, monkeypatch):
    """All tricks against their plain form, as with SLIPPERJAX_PLAIN=1."""
    monkeypatch.setitem(rates.ENGINES, "ImpulseRK4", sj.solvers.ImpulseRK4())
    print(f"\n{engine}, JAX {jax.__version__}: one core's time of a step and case [us]; compiling [s of a core]")
    for lanes in batches:
        calls, compiling = {}, {}
        for form in (fast, plain):
            monkeypatch.setattr(forms._Choice, "form", form)
            begin = time.process_time()
            calls[form] = rates.program(engine, lanes)
            compiling[form] = time.process_time() - begin
        found = least(calls, 1)
        ours, others = (1e6 * found[form] / (STEPS * lanes) for form in (fast, plain))
        seconds = "{:.1f} and {:.1f}".format(*compiling.values())
        print(f"  {lanes:5d} cases: {ours:.2f}, plain {others:.2f}: {others / ours:.2f} times; compiling {seconds}")
