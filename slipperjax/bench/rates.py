"""Trajectory-periods per second over the batch, on whatever JAX runs on: a CPU's cores, or a GPU.

The same programs as in sweeps are timed: a period map of a batch, and the same with a tangent, as Lyapunov exponents
need it. The kernels of a program are counted in its optimised text: each fusion, reduction, copy or call in the
body of the loop over steps is one kernel there, on a GPU one launch.
"""

import functools
import itertools
import json
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..analysis.lyapunov import first_tangents
from ..flow.period_map import advance, advance_tangents, initial_states, tangent_weights
from ..flow.stepping import ConstantSteps
from ..model.dang2024 import paper_scene, table_2_start
from ..solvers.explicit import RK4
from ..solvers.rosenbrock import Rodas4
from ..sweeps.grid import Cases
from ..sweeps.run import CHUNK_OF_DEVICE, LARGEST_CHUNK
from ..tools.checks import one_of, require, whole
from ..tools.compile import compiler_options
from ..tools.files import table_lines
from ..tools.limits import cores

BATCHES = (100, 1_000, 10_000, 100_000, 1_000_000)
"""Default batches."""
NOMINAL_STEPS = 50
"""Steps per forcing period: the default of the nominal scene."""
CALL_PERIODS = 4
"""Forcing periods in a call."""
ENGINES = ("RK4", "Rodas4", "Lyapunov")
"""Programs to time: two solvers, and RK4 with one tangent that is orthonormalised after each period."""
EVALUATIONS = {"RK4": 4, "Rodas4": 7, "Lyapunov": 4}
"""Right-hand sides in a step: of Rodas4 its six stages and the one at the end."""
LIMIT = 58e-9
"""Seconds of a right-hand side on one core of the machine of docs/speed.md, every operation running at full rate."""
TIMING_SECONDS = 1.0
"""Least time of a timing: calls are repeated until then, at least twice [s]."""
KERNEL = re.compile(
    r"= (?:\(.*?\)|\S+) (fusion|reduce|copy|custom-call|call|dynamic-update-slice|gather|scatter|sort|while)\("
)
"""Instructions of an optimised program that run by themselves."""


class Rate(NamedTuple):
    """Speed of one engine with one batch."""

    device: str
    """Device that JAX ran on, and the number of its cores."""
    engine: str
    batch: int
    rate: float
    """Trajectory-periods per second, the median of the calls [1/s]."""
    kernels: int | None
    """In the loop over steps; None where the program's text does not show it."""
    share: float | None
    """Share of the arithmetic limit [1], for a CPU and a right-hand side without tangents."""


def throughput(
    batches: Sequence[int] | None = None,
    engines: Sequence[str] | None = None,
    *,
    beside_cpu: bool = True,
    report: Callable[[Rate], Any] | None = None,
) -> list[Rate]:
    """Times `ENGINES` over batches of the nominal scene, speeds within 2 %.

    **Arguments:** `batches`: default `BATCHES`; `engines`: default `ENGINES`; `beside_cpu`: where JAX runs on
    another device, the same on all CPU cores of the machine, in a process of its own; `report`: is called with each
    `Rate`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    sizes = [whole("batches", batch, 1) for batch in (BATCHES if batches is None else batches)]
    names = [one_of("engines", name, ENGINES) for name in (ENGINES if engines is None else engines)]
    rates: list[Rate] = []
    report = report or (lambda rate: None)
    for engine, batch in itertools.product(names, sizes):
        rates.append(_timed(engine, batch))
        report(rates[-1])
    if beside_cpu and jax.default_backend() != "cpu":
        options = json.dumps(dict(batches=sizes, engines=names))
        code = f"from slipperjax.bench.rates import print_rates; print_rates({options!r})"
        env = {**os.environ, "JAX_PLATFORMS": "cpu"}
        process = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
        for line in process.stdout.splitlines():
            rates.append(Rate(*json.loads(line)))
            report(rates[-1])
    return rates


def print_rates(options: str) -> None:
    """Prints the rates of this process as JSON, one per line, for `throughput` in another one."""
    throughput(**json.loads(options), report=lambda rate: print(json.dumps(rate), flush=True))


def _timed(engine: str, batch: int) -> Rate:
    backend = jax.default_backend()
    threads = cores() if backend == "cpu" else 1
    largest = LARGEST_CHUNK if backend == "cpu" else CHUNK_OF_DEVICE
    lanes = min(-(-batch // threads), largest)
    chunks = -(-batch // lanes)
    run = _program(engine, lanes)
    with ThreadPoolExecutor(threads) as pool:
        call = lambda: list(pool.map(lambda k: jax.block_until_ready(run()), range(chunks)))
        call()
        times: list[float] = []
        while len(times) < 2 or sum(times) < TIMING_SECONDS:
            begin = time.perf_counter()
            call()
            times.append(time.perf_counter() - begin)
    rate = lanes * chunks * CALL_PERIODS / statistics.median(times)
    share = None
    if backend == "cpu" and engine != "Lyapunov":
        share = rate * NOMINAL_STEPS * EVALUATIONS[engine] * LIMIT / threads
    name = f"{jax.devices()[0].device_kind}, {threads} cores" if backend == "cpu" else jax.devices()[0].device_kind
    return Rate(name, engine, batch, rate, kernels_per_step(run.func.as_text() or ""), share)


def _program(engine: str, lanes: int) -> functools.partial:
    """Compiles a call of an engine on a batch; gives it with its inputs."""
    scene = paper_scene()
    speeds = float(scene.speed) * np.linspace(0.98, 1.02, lanes)
    scenes, starts = Cases(scene, {"speed": speeds}, table_2_start()).take(np.arange(lanes))
    states = initial_states(scenes, starts)
    solver, stepping = (Rodas4() if engine == "Rodas4" else RK4()), ConstantSteps(NOMINAL_STEPS)
    options: dict[str, Any] = dict(stepping=stepping, solver=solver, periods=CALL_PERIODS)
    arguments = (scenes, states)
    run = lambda scenes, states: advance.__wrapped__(scenes, states, 0.0, **options).state
    if engine == "Lyapunov":
        first = lambda state: first_tangents(state, 1, tangent_weights(scene))
        arguments = (scenes, states, jax.vmap(first)(states))
        run = lambda *batch: advance_tangents.__wrapped__(*batch, jnp.asarray(0.0), **options).history
    compiled = jax.jit(run).lower(*arguments).compile(compiler_options(jax.default_backend()))
    return functools.partial(compiled, *arguments)


def kernels_per_step(text: str) -> int | None:
    """Counts the kernels of the innermost loop with most of them in an optimised program; None without a loop."""
    bodies = set(re.findall(r"body=%?([\w.\-]+)", text))
    parts = re.split(r"\n(?=(?:ENTRY )?%?[\w.\-]+ [({])", text)
    counts = []
    for part in parts:
        name = re.match(r"(?:ENTRY )?%?([\w.\-]+)", part)
        kernels = KERNEL.findall(part)
        if name and name[1] in bodies and "while" not in kernels:
            counts.append(len(kernels))
    return max(counts, default=None)


def rows(rates: Sequence[Rate]) -> list[str]:
    """Gives the rates as lines of a table in Markdown."""
    require(rates, "rates", "hold a rate", rates)
    return table_lines(
        [
            {
                "device": rate.device,
                "engine": rate.engine,
                "batch": rate.batch,
                "trajectory-periods per second": f"{rate.rate:.3g}",
                "kernels per step": "" if rate.kernels is None else rate.kernels,
                "of the limit": "" if rate.share is None else f"{100 * rate.share:.0f} %",
            }
            for rate in rates
        ]
    )
