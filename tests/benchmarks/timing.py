"""Times of calls in turns, and what programs in processes of their own tell."""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.tools.compile import jit
from slipperjax.tools.files import table_lines

LANES, STEPS, PERIODS = 64, 50, 20
"""Cases, steps per period and periods of `batch`."""


class Timed(NamedTuple):
    """A call's result, and the seconds of its first call, which compiles, and of later ones."""

    result: Any
    first: float
    later: list[float]

    @property
    def median(self) -> float:
        """Median of the later calls [s]."""
        return statistics.median(self.later)


def seconds(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return what a call gives, and how long it takes [s]."""
    begin = time.perf_counter()
    result = jax.block_until_ready(call())
    return result, time.perf_counter() - begin


def in_turns(calls: Mapping[str, Callable[[], Any]], times: int) -> dict[str, Timed]:
    """Return times of calls by name: of a first one of each, and of more that alternate."""
    found = {name: [seconds(call)] for name, call in calls.items()}
    for _ in range(times):
        for name, call in calls.items():
            found[name].append(seconds(call))
    timed = {}
    for name, pairs in found.items():
        results, (first, *later) = zip(*pairs, strict=True)
        timed[name] = Timed(results[-1], first, later)
    return timed


def median(call: Callable[[], Any], times: int) -> float:
    """Return the median time of a call [s], without a first one, which compiles."""
    return in_turns({"": call}, times)[""].median


def told(*words: Any, **variables: str) -> dict[str, Any]:
    """Return what a Python program in a process of its own prints as JSON behind "ROW "."""
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables)
    assert done.returncode == 0, done.stderr
    return json.loads(next(line for line in done.stdout.splitlines() if line.startswith("ROW "))[4:])


def show(rows: Iterable[Mapping[str, Any]]) -> None:
    """Print rows as a table in Markdown."""
    print("\n" + "\n".join(table_lines(list(rows))), flush=True)


def shown(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Print and return rows, each when it is there, and all as a table."""
    found = []
    for row in rows:
        found.append(row)
        print(row, flush=True)
    show(found)
    return found


def batch(solver: Any, tangent: bool = False, **scene: Any) -> Callable[[], Any]:
    """Return a call of a compiled motion over a batch of speeds, with its derivative by the speed if `tangent`."""

    def motion(speed):
        own = sj.paper_scene(**scene).replace(speed=speed)
        return PeriodMap(own, STEPS, solver, PERIODS)(sj.initial_state(own, sj.table_2_start())).motion

    one = (lambda v: jax.jvp(motion, (v,), (jnp.ones(()),))) if tangent else motion
    run = jit(jax.vmap(one))
    return lambda: run(jnp.linspace(1000.0, 2500.0, LANES))


def micros(seconds: float) -> float:
    """Return the microseconds of a step and case of `batch`."""
    return 1e6 * seconds / (LANES * STEPS * PERIODS)
