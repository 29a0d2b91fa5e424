"""First answers of processes: with nothing kept, with JAX's cache, and with programs that are kept whole.

pytest -m benchmark -s tests/benchmarks/test_kept_programs.py

Seconds of whole processes in units of `import jax, diffrax`, which is measured in turns with them.
"""

import os
import re
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from .timing import seconds

PYTHON = "import numpy as np, slipperjax as sj\nscene = sj.paper_scene(speed=1250.0)\n"
FIT = """
from slipperjax.fitting import synthetic_record
sensors = [sj.model.Sensor("az"), sj.model.Sensor("ay", direction="y", place=(0.05, 0.0, 0.0))]
run = sj.simulate(scene, 120, steps_per_period=160, saves_per_period=160)
record = synthetic_record(run, sensors, rate=50 / float(scene.period), periods=20, noise=0.05)
guess = scene.replace(stiffness=6e7, restitution=0.7, clearance=1.5e-3)
unknowns = {"stiffness": (3e7, 3e8), "restitution": (0.5, 0.99), "clearance": (0.5e-3, 2e-3)}
print(sj.fit(guess, record, unknowns, sensors))
"""
README = """
ds = sj.sweep(scene, {"speed": [1000.0, 1250.0, 2300.0]}, record=["motion", "peak_force"], periods=200)
orbit = sj.periodic_orbit(scene)
print(ds["kind"].values, ds["peak_force"].max(("end", "point")).values, orbit)
"""
DESIGN = """
box = {"clearance": (0.2e-3, 3e-3), "length": (0.12, 0.5)}
print(sj.optimise_design(scene, "peak_force", box, over={"speed": [1300.0, 1600.0]}, starts=1, steps_per_period=50))
"""
RUN = """
print(sj.run(scene.replace(speed=900.0), length=300.0))
"""
CLICK = """
from slipperjax.explorer.session import Case, Session
session = Session.of(scene, {"speed": np.linspace(1000.0, 1500.0, 8)})
print(next(session.look(Case(scene))))
"""
COMMAND = ["-c", "from slipperjax.cli import main; main()"]
TASKS = {
    "slipperjax --help": [*COMMAND, "--help"],
    "simulate in Python": ["-c", f"{PYTHON}print(sj.simulate(scene, 60))"],
    "simulate": [*COMMAND, *["simulate", "--out", "{folder}/run"]],
    "bifurcation of 241": [
        *COMMAND,
        *["bifurcation", "--over", "speed", "100", "2500", "241", "--out", "{folder}/fig"],
    ],
    "README's five lines": ["-c", PYTHON + README],
    "periodic_orbit": ["-c", f"{PYTHON}print(sj.periodic_orbit(scene))"],
    "continue_orbit over 100 m/s": ["-c", f"{PYTHON}print(sj.continue_orbit(scene, 'speed', (1200.0, 1300.0)))"],
    "optimise_design": ["-c", PYTHON + DESIGN],
    "fit": ["-c", PYTHON + FIT],
    "run of 300 m": ["-c", PYTHON + RUN],
    "explorer, first click": ["-c", PYTHON + CLICK],
}
"""Arguments of Python, by what is asked."""
REPEATS = 3


def process(arguments: list[str], folder: Path, **variables: str) -> tuple[float, str]:
    """Seconds of a process, and what it prints without times."""
    words = [word.replace("{folder}", str(folder)) for word in arguments]
    env = os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"} | variables
    call = lambda: subprocess.run([sys.executable, *words], capture_output=True, text=True, env=env, check=False)
    done, time = seconds(call)
    assert not done.returncode, done.stderr
    return time, re.sub(r"[\d.]+ (ms|s|min)\b", "", done.stdout)


@pytest.mark.benchmark
def test_first_answers(tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    stock = lambda: process(["-c", "import jax, diffrax"], tmp_path)[0]
    process(["-c", "import slipperjax as sj; sj.sweep, sj.fit, sj.continue_orbit, sj.optimise_design"], tmp_path)
    for name, arguments in TASKS.items():
        # as before programs were kept whole, and as now
        jax_alone = {"SLIPPERJAX_CACHE": "off", "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax" / name)}
        jax_alone |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        whole = {"SLIPPERJAX_CACHE": str(tmp_path / "whole" / name)}
        cold, printed = process(arguments, tmp_path, **whole)
        process(arguments, tmp_path, **jax_alone)
        units = []
        times = {"JAX's cache": [], "kept whole": []}
        for _ in range(REPEATS):
            units.append(stock())
            for kind, variables in (("JAX's cache", jax_alone), ("kept whole", whole)):
                time, again = process(arguments, tmp_path, **variables)
                times[kind].append(time)
                assert again == printed
        unit = statistics.median(units)
        warm = ", ".join(f"{kind} {statistics.median(each) / unit:.2f}" for kind, each in times.items())
        kept = list((tmp_path / "whole" / name).rglob("*-whole"))
        size = sum(path.stat().st_size for path in kept) / 1e6
        print(f"\n{name}: first {cold / unit:.1f}, later {warm} imports; {len(kept)} programs, {size:.1f} MB", end="")
    print(f"\none import: {unit:.2f} s")
