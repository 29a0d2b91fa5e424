"""From typing a command to its picture, with an empty and with a filled cache of programs.

pytest -m benchmark -s tests/benchmarks/test_first_picture.py
"""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMMANDS = {
    "simulate": ["simulate"],
    "bifurcation of 241": ["bifurcation", "--over", "speed", "100", "2500", "241"],
    "lyapunov of 31": ["lyapunov", "--over", "speed", "1000", "1600", "31"],
}
REPEATS = 5
# as after an installation, which compiles modules once
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def run(arguments: list[str], cache: Path, folder: Path) -> dict[str, float]:
    """The parts of a command's time, from typing it to the end of its process."""
    script = Path(__file__).with_name("first_picture.py")
    out = ["--out", str(folder / "picture")]
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, str(script), *arguments, *out],
        env={**ENVIRONMENT, "SLIPPERJAX_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    everything = time.perf_counter() - begin
    parts = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("PARTS "))[6:])
    return parts | {"run and the rest": parts["run and the rest"] + everything - parts["all"], "all": everything}


def seconds(code: str) -> float:
    """Of a process that runs some code."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=ENVIRONMENT)
    return time.perf_counter() - begin


@pytest.mark.benchmark
def test_time_to_first_picture(tmp_path):
    seconds("import slipperjax")
    pairs = [(seconds("import jax, diffrax"), seconds("import slipperjax")) for _ in range(5)]
    stock, own = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(f"\nimport jax, diffrax: {stock:.2f} s; import slipperjax: {own:.2f} s, {own / stock:.2f} times that")
    for name, arguments in COMMANDS.items():
        cold = run(arguments, tmp_path / name, tmp_path)
        warm = [run(arguments, tmp_path / name, tmp_path) for _ in range(REPEATS)]
        middle = {part: statistics.median(one[part] for one in warm) for part in cold}
        for state, parts in (("cold", cold), ("warm", middle)):
            shown = ", ".join(f"{part} {value:.2f}" for part, value in parts.items() if part != "programs")
            ratio = parts["all"] / stock
            print(f"{name}, {state}: {shown} s; {parts['programs']:.0f} programs; {ratio:.1f} times the import")
        assert middle["compile"] < cold["compile"]
