"""What runs on a GPU, as tables in Markdown: see gpu.sh.

Shares of limits are lower bounds of how busy the device is: operations and bytes are those that XLA counts in the
optimised program of one step, at the device's greatest rates without tensor cores (NVIDIA's data sheets).
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import slipperjax as sj
from slipperjax.flow.period_map import advance
from slipperjax.flow.stepping import ConstantSteps

from ..bench import rates
from .timing import seconds, show

LIMITS = {"H100": (33.5e12, 3.35e12), "H200": (33.5e12, 4.8e12), "A100": (9.7e12, 2.0e12)}
"""64-bit operations and bytes of memory per second by a part of the device's name."""
SCENE = sj.paper_scene()
ON_GPU = jax.default_backend() != "cpu"
SPEEDS = np.linspace(100.0, 2500.0, 20_000 if ON_GPU else 500)


def counted(lanes: int) -> dict[str, float]:
    """Operations and bytes of one step of RK4 with its start, of a case."""
    scenes, starts = sj.sweeps.grid.Cases(SCENE, {"speed": SPEEDS[:lanes]}, sj.table_2_start()).take(np.arange(lanes))
    states = sj.flow.period_map.initial_states(scenes, starts)
    one = lambda scenes, states: (
        advance.__wrapped__(scenes, states, 0.0, ConstantSteps(1), solver=sj.solvers.RK4(), periods=1).state
    )
    cost = jax.jit(one).lower(scenes, states).compile().cost_analysis()
    cost = cost[0] if isinstance(cost, list) else cost
    return {name: cost[name] / lanes for name in ("flops", "bytes accessed")}


def kernels_per_step(text: str) -> int:
    """Counts the kernels of the innermost loop with most of them in an optimised program."""
    kernel = re.compile(
        r"= (?:\(.*?\)|\S+) (fusion|reduce|copy|custom-call|call|dynamic-update-slice|gather|scatter|sort|while)\("
    )
    bodies = set(re.findall(r"body=%?([\w.\-]+)", text))
    counts = [0]
    for part in re.split(r"\n(?=(?:ENTRY )?%?[\w.\-]+ [({])", text):
        name = re.match(r"(?:ENTRY )?%?([\w.\-]+)", part)
        kernels = kernel.findall(part)
        if name and name[1] in bodies and "while" not in kernels:
            counts.append(len(kernels))
    return max(counts)


def throughput(sizes: list[int]) -> None:
    found = rates.throughput(sizes, ["RK4", "Lyapunov"])
    of_step = counted(100)
    kernels = {engine: kernels_per_step(rates.program(engine, 100).func.as_text()) for engine in ("RK4", "Lyapunov")}
    limits = next((limit for name, limit in LIMITS.items() if name in jax.devices()[0].device_kind), None)
    table = []
    for rate in found:
        row = {
            "device": rate.device,
            "engine": rate.engine,
            "batch": rate.batch,
            "periods per second": f"{rate.rate:.3g}",
        }
        row["kernels a step"] = kernels[rate.engine]
        if limits and rate.engine == "RK4":
            steps = rate.rate * rates.NOMINAL_STEPS
            for name, limit in zip(("flops", "bytes accessed"), limits, strict=True):
                row[f"of the limit of {name}"] = f"{100 * steps * of_step[name] / limit:.1f} %"
        table.append(row)
    show([{name: row.get(name, "") for name in {k: 0 for r in table for k in r}} for row in table])


def peaks() -> np.ndarray:
    return sj.sweep(SCENE, {"speed": SPEEDS}, record="peak_force", transient=10, periods=2)["peak_force"].values


def sweep_and_accuracy() -> None:
    """The highest forces of a sweep on this device, and on the CPU in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "peaks.npy")
        code = "import numpy as np; from tests.benchmarks import gpu"
        code += f"; gpu.SPEEDS = np.linspace(100.0, 2500.0, {len(SPEEDS)}); np.save({str(file)!r}, gpu.peaks())"
        beside = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "JAX_PLATFORMS": "cpu"})
        here, first = seconds(peaks)
        assert beside.wait() == 0
        again = seconds(peaks)[1]
        difference = np.abs(here - np.load(file)) / np.nanmax(here)
    row = {"cases": len(SPEEDS), "first [s]": f"{first:.1f}", "again [s]": f"{again:.1f}"}
    for share in (50, 90, 99, 100):
        row[f"difference from the CPU, {share} %"] = f"{np.nanpercentile(difference, share):.1g}"
    show([row])


def gradients() -> None:
    state = sj.initial_state(SCENE, sj.table_2_start())
    end = lambda speed: sj.period_map(SCENE.replace(speed=speed), state, periods=3, steps_per_period=100).motion.y
    table = []
    for name, derivative in {"value": end, "jacfwd": jax.jacfwd(end), "grad": jax.grad(end)}.items():
        compiled = sj.jit(derivative)
        value, first = seconds(lambda compiled=compiled: compiled(jnp.asarray(1250.0)))
        again = seconds(lambda compiled=compiled: compiled(jnp.asarray(1250.0)))[1]
        row = {
            "of": name,
            "value": f"{float(value):.6g}",
            "first [s]": f"{first:.1f}",
            "again [ms]": f"{1e3 * again:.1f}",
        }
        table.append(row)
    show(table)


def main() -> None:
    print(f"{jax.devices()[0].device_kind}, JAX {jax.__version__}")
    gradients()
    sweep_and_accuracy()
    throughput([int(size) for size in sys.argv[1:]])


if __name__ == "__main__":
    main()
