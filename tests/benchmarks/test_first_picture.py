"""From typing a command to its picture, with an empty and with a filled cache of programs; other codes beside it.

pytest -m benchmark -s tests/benchmarks/test_first_picture.py

Draws the bars of docs/lab/speed.md, too.
"""

import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slipperjax.plots.style import png

from .bars import bars
from .peers import CppProgram, SciPyPeer, plain_numbers
from .test_derivatives import timed
from .test_peers import NOMINAL
from .timing import seconds, told

COMMANDS = {
    "simulate": ["simulate"],
    "bifurcation of 241": ["bifurcation", "--over", "speed", "100", "2500", "241"],
    "lyapunov of 31": ["lyapunov", "--over", "speed", "1000", "1600", "31"],
}
TITLES = {
    "simulate": "One trajectory of 60 forcing periods",
    "bifurcation of 241": "Bifurcation diagram of 241 speeds",
    "lyapunov of 31": "Lyapunov exponents of 31 speeds",
    "first derivative": "Derivative of a state after three periods by the speed",
}
BIFURCATION_PERIODS = 310
"""Those of the command: 300 before and 10 recorded."""
WHEN = {"cold": "first time", "warm": "later"}
REPEATS = 5


def run(arguments: list[str], cache: Path, folder: Path) -> dict[str, float]:
    """The parts of a command's time, from typing it to the end of its process."""
    words = [Path(__file__).with_name("first_picture.py"), *arguments, "--out", folder / "picture"]
    parts, everything = seconds(lambda: told(*words, SLIPPERJAX_CACHE=str(cache)))
    return parts | {"run and the rest": parts["run and the rest"] + everything - parts["all"], "all": everything}


def of_code(code: str) -> float:
    """Seconds of a process that runs some code."""
    return seconds(lambda: subprocess.run([sys.executable, "-c", code], check=True))[1]


def other_codes(folder: Path) -> dict[str, dict[str, dict[str, float]]]:
    """The parts of the time of other codes, by command: C++ at 50 steps per period, SciPy at an rtol of 1e-3."""
    program, compiled = seconds(lambda: CppProgram(folder))
    numbers = plain_numbers(NOMINAL)
    assert numbers is not None

    def cpp(speeds, periods):
        _, run = seconds(lambda: [program(speed, numbers, periods, 50) for speed in speeds])
        return {"compile": compiled, "run and write": run}

    imported = of_code("import numpy, scipy.integrate")
    _, run = seconds(lambda: SciPyPeer("DOP853").integrate(1250.0, numbers, 60, 1e-3))
    scipy = {"import": imported, "run and write": run}
    return {
        "simulate": {"C++, first time": cpp([1250.0], 60), "SciPy with events": scipy},
        "bifurcation of 241": {"C++, first time": cpp(np.linspace(100.0, 2500.0, 241), BIFURCATION_PERIODS)},
    }


@pytest.mark.benchmark
def test_time_to_first_picture(tmp_path, monkeypatch):
    # as after an installation, which compiles modules once
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    of_code("import slipperjax")
    pairs = [(of_code("import jax, diffrax"), of_code("import slipperjax")) for _ in range(5)]
    stock, own = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(f"\nimport jax, diffrax: {stock:.2f} s; import slipperjax: {own:.2f} s, {own / stock:.2f} times that")
    groups = {title: {} for title in (*COMMANDS, "first derivative")}
    for name, arguments in COMMANDS.items():
        cold = run(arguments, tmp_path / name, tmp_path)
        warm = [run(arguments, tmp_path / name, tmp_path) for _ in range(REPEATS)]
        middle = {part: statistics.median(one[part] for one in warm) for part in cold}
        for state, parts in (("cold", cold), ("warm", middle)):
            shown = ", ".join(f"{part} {value:.2f}" for part, value in parts.items() if part != "programs")
            ratio = parts["all"] / stock
            print(f"{name}, {state}: {shown} s; {parts['programs']:.0f} programs; {ratio:.1f} times the import")
            run_and_write = parts["run and the rest"] + parts["write"]
            groups[name][f"slipperjax, {WHEN[state]}"] = parts | {"run and write": run_and_write}
        assert middle["compile"] < cold["compile"]
    for name, rows in other_codes(tmp_path).items():
        groups[name] |= rows
    kept = dict(JAX_COMPILATION_CACHE_DIR=str(tmp_path / "kept"), JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0")
    for solver in ("ImpulseRK4", "RK4"):
        for state in WHEN:
            parts, everything = seconds(lambda solver=solver: timed(solver, "jacfwd", **kept))
            traced = parts["first"] - parts["compile"] - parts["again"]
            start = everything - parts["first"] - parts["again"]
            parts |= {"import": start, "trace": traced, "run and write": parts["again"]}
            groups["first derivative"][f"{solver}, {WHEN[state]}"] = parts
    (tmp_path / "first.png").write_bytes(png(bars({TITLES[name]: rows for name, rows in groups.items()}), 150))
    print(tmp_path / "first.png")
