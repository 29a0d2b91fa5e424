"""Throughput in trajectory-periods per second over the size of the batch, on the cores of a CPU or on a GPU.

The programs are those of sweeps: the period map of a batch, and the same map with a tangent, for Lyapunov exponents.
"""

import functools
import itertools
import statistics
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slipperjax.analysis.lyapunov import first_tangents
from slipperjax.flow.period_map import advance, advance_tangents, initial_states, tangent_weights
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.dang2024 import paper_scene, table_2_start
from slipperjax.solvers.explicit import RK4
from slipperjax.solvers.rosenbrock import Rodas4
from slipperjax.sweeps.grid import Cases
from slipperjax.sweeps.plan import CHUNK_OF_DEVICE, LARGEST_CHUNK
from slipperjax.tools.checks import one_of, whole
from slipperjax.tools.files import table_lines
from slipperjax.tools.forms import compiler_options
from slipperjax.tools.limits import cores

NOMINAL_STEPS = 50
"""Steps per forcing period: the default of the nominal scene."""
CALL_PERIODS = 4
"""Forcing periods in a call."""
ENGINES = {"RK4": RK4(), "Rodas4": Rodas4(), "Lyapunov": RK4()}
"""Solvers of the timed programs, by name; "Lyapunov" adds a tangent, which is orthonormalised after each period."""


class Rate(NamedTuple):
    """Speed of one engine with one batch."""

    device: str
    """Name of the device, with the number of cores of a CPU."""
    engine: str
    batch: int
    rate: float
    """Trajectory-periods per second, the median of the calls [1/s]."""


def throughput(
    batches: Sequence[int] = (100, 1_000, 10_000, 100_000, 1_000_000), engines: Sequence[str] = tuple(ENGINES)
) -> Iterator[Rate]:
    """Time each of `ENGINES` with batches of the nominal scene, speeds within 2 %; yield one rate after another.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    sizes = [whole("batches", batch, 1) for batch in batches]
    names = [one_of("engines", name, tuple(ENGINES)) for name in engines]
    for engine, batch in itertools.product(names, sizes):
        yield timed(engine, batch)


def timed(engine: str, batch: int, least: float = 1.0) -> Rate:
    """Return the rate of one engine with one batch.

    **Arguments:** `least`: least total time of the timed calls [s], of which there are two or more.
    """
    device = jax.devices()[0].device_kind
    threads = 1
    largest = CHUNK_OF_DEVICE
    if jax.default_backend() == "cpu":
        threads = cores()
        largest = LARGEST_CHUNK
        device = f"{device}, {threads} cores"
    # as many chunks as threads, or more where chunks would be too large
    lanes = min(-(-batch // threads), largest)
    chunks = -(-batch // lanes)
    run = program(engine, lanes)
    times: list[float] = []
    with ThreadPoolExecutor(threads) as pool:
        call = lambda: list(pool.map(lambda _: jax.block_until_ready(run()), range(chunks)))
        call()  # the first call is slower than later ones
        while len(times) < 2 or sum(times) < least:
            begin = time.perf_counter()
            call()
            times.append(time.perf_counter() - begin)
    return Rate(device, engine, batch, lanes * chunks * CALL_PERIODS / statistics.median(times))


def program(engine: str, lanes: int) -> functools.partial:
    """Return a call of an engine on a batch, compiled, with its arguments."""
    scene = paper_scene()
    speeds = float(scene.speed) * np.linspace(0.98, 1.02, lanes)
    scenes, starts = Cases(scene, {"speed": speeds}, table_2_start()).take(np.arange(lanes))
    states = initial_states(scenes, starts)
    options = dict(stepping=ConstantSteps(NOMINAL_STEPS), solver=ENGINES[engine], periods=CALL_PERIODS)
    arguments = (scenes, states)
    # __wrapped__ is the function itself, which is compiled here once for its shapes
    run = lambda scenes, states: advance.__wrapped__(scenes, states, 0.0, **options).state
    # exponents need a tangent beside the state
    if engine == "Lyapunov":
        tangent = lambda state: first_tangents(state, 1, tangent_weights(scene))
        arguments = (scenes, states, jax.vmap(tangent)(states))
        run = lambda *batch: advance_tangents.__wrapped__(*batch, jnp.asarray(0.0), **options).history
    compiled = jax.jit(run).lower(*arguments).compile(compiler_options(jax.default_backend()))
    return functools.partial(compiled, *arguments)


def rows(rates: Sequence[Rate]) -> list[str]:
    """Return the rates as lines of a table in Markdown."""
    heading = "device", "engine", "batch", "trajectory-periods per second"
    return table_lines([dict(zip(heading, (*rate[:3], f"{rate.rate:.3g}"), strict=True)) for rate in rates])
