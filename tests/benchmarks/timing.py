"""Times of calls in turns, and what programs in processes of their own tell."""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax


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
