"""From calling a derivative to its number: each in a process of its own, without a cache of programs.

pytest -m benchmark -s tests/benchmarks/test_derivatives.py
"""

import os
from pathlib import Path

import pytest

from .timing import show, told

ROWS = [
    *((solver, mode) for solver in ("RK4", "ImpulseRK4") for mode in ("value", "jacfwd", "grad", "jacfwd of jacfwd")),
    ("RK4", "hessian"),
    ("ImpulseRK4", "hessian"),
    ("start", "jacfwd"),
    ("scene and start", "grad"),
    ("peak force", "jacfwd"),
    ("peak force", "grad"),
    ("orbit", "jacfwd"),
    ("smooth switch", "jacfwd"),
    ("smooth switch", "grad"),
]


def timed(what: str, mode: str, **variables: str) -> dict[str, float]:
    """The parts of a derivative's time [s], in a process with these environment variables besides."""
    return told(Path(__file__).with_name("derivatives.py"), what, mode, **variables)


@pytest.mark.benchmark
def test_time_to_first_derivative():
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ
    rows = []
    for what, mode in ROWS:
        parts = timed(what, mode)
        traced = parts["first"] - parts["lower"] - parts["compile"]
        times = {"first [s]": parts["first"], "trace": traced, "lower": parts["lower"], "compile": parts["compile"]}
        shown = {name: f"{seconds:.1f}" for name, seconds in times.items()}
        rows.append({"of": what, "derivative": mode} | shown | {"again [ms]": f"{1e3 * parts['again']:.1f}"})
    show(rows)


@pytest.mark.benchmark
def test_second_process_takes_programs_from_the_cache(tmp_path):
    """Times the second of two processes that share JAX's cache."""
    kept = dict(JAX_COMPILATION_CACHE_DIR=str(tmp_path), JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0")
    rows = []
    for what, mode in (row for row in ROWS if row[1] in ("jacfwd", "grad", "hessian")):
        first, second = (timed(what, mode, **kept)["first"] for _ in range(2))
        rows.append({"of": what, "derivative": mode, "first [s]": f"{first:.1f}", "second [s]": f"{second:.1f}"})
    show(rows)
