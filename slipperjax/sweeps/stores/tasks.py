"""Tiles as tasks: computed on threads or by the workers of an executor, such as processes with their own cores."""

import importlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

from ...flow.status import ASKED
from ...model.scene import Scene
from ...tools.cache import compile_cache, keep_programs
from ...tools.checks import whole
from ...tools.limits import cores
from ..executors import all_stopped
from ..progress import Tally, display
from .archive import open_archive

TICK = 0.05
"""Seconds between two looks at the tasks."""
AHEAD = 3
"""Tasks that are given to an executor for each of its workers, so that none waits for another."""
LEAST_AHEAD = 16
QUEUED = 1000
"""Tasks that are given to dask at once, which shares them among workers that come and go."""
RETRIES = 3
"""How often dask tries a task again that failed."""
_ALONE = threading.Lock()
PATIENCE = 10.0
"""Seconds after Ctrl-C that threads have to end the call that they are in."""


@dataclass(frozen=True)
class Job:
    """What workers need to compute any tile of a store; it can be pickled if its options can."""

    path: Path
    function: str
    """Module and name, as in "slipperjax.sweeps.sweep:sweep"."""
    scene: Scene
    names: tuple[str, ...]
    """What the grid varies; the values are in the store."""
    options: Mapping[str, Any]
    """Arguments of the function; `steps_per_period` may be an array over the grid."""
    alone: bool
    """Whether a process may compute one tile at a time only."""

    def __call__(self, number: int) -> None:
        """Computes a tile and writes it. Calling it again is harmless: it writes the same bytes."""
        archive = open_archive(self.path)
        with _ALONE if self.alone else nullcontext():
            ds = self.part(archive.values(self.names, number), archive.tiles.region(number))
        try:
            archive.write(number, ds)
        except OSError as error:
            kept = f"{archive.finished()} of {prod(archive.tiles.shape)} cases are stored"
            raise OSError(
                error.errno, f"cannot write to {self.path}: {error.strerror or error}; {kept}, call again to go on"
            ) from None

    def part(self, values: Mapping[str, np.ndarray], region: tuple[slice, ...]) -> xr.Dataset:
        """Results for the values of a part of the grid, whose place in it is `region`."""
        module, _, name = self.function.partition(":")
        function, options = getattr(importlib.import_module(module), name), dict(self.options)
        if np.ndim(options.get("steps_per_period")):
            options["steps_per_period"] = np.asarray(options["steps_per_period"])[region]
        return function(self.scene, grid=dict(values), **options)


class WorkerLost(OSError):
    """A worker process ended, and its executor with it. What was finished is stored."""


class _Count(Tally):
    """Progress by finished tiles: those of a run are alike."""

    def duration(self, work: float) -> float | None:
        return work * self.spent / self.done if self.done else None

    @property
    def state(self) -> str:
        return "computing" if self.done else "starting"

    def count(self, cases: int) -> None:
        """A tile of so many cases is done."""
        self.done += cases
        self.finished += cases


def run_tasks(job: Job, todo: Sequence[int], executor: Any, workers: int | None, progress: bool, before: int) -> None:
    """Computes tiles, in any order.

    **Arguments:** `executor`: a `concurrent.futures.Executor`, a `dask.distributed.Client`, or None for `workers`
    threads of this process; `before`: cases that were finished before.

    **Raises:** `KeyboardInterrupt` after Ctrl-C; `WorkerLost`; what a task raised.
    """
    if not todo:
        return
    tiles = open_archive(job.path).tiles
    wanted = sum(tiles.cases(number) for number in todo)
    tally = _Count(wanted, wanted, 1, name=f"{before} cases stored before" if before else "")
    with _submitting(executor, workers) as (submit, at_once), display(tally, progress) as shown:
        left, waiting = iter(todo), {}
        try:
            while True:
                for number in left:
                    waiting[submit(job, number)] = number
                    if len(waiting) >= at_once:
                        break
                for future in [future for future in waiting if future.done()]:
                    future.result()
                    tally.count(tiles.cases(waiting.pop(future)))
                if not waiting and tally.finished >= wanted:
                    return
                if ASKED.is_set():
                    raise KeyboardInterrupt
                shown.show()
                time.sleep(TICK)
        except BaseException as error:
            for future in waiting:
                future.cancel()
            if isinstance(error, BrokenExecutor):
                kept = f"{before + tally.finished} cases or more are stored, call again to go on"
                raise WorkerLost(f"a worker process ended abruptly, for want of memory perhaps; {kept}") from error
            raise


@contextmanager
def _submitting(executor: Any, workers: int | None) -> Iterator[tuple[Callable[..., Any], int]]:
    """How a task is given to an executor, and how many are at once."""
    if executor is None:
        with _threads(cores() if workers is None else workers) as pool:
            yield pool.submit, workers or cores()
    elif type(executor).__module__.split(".")[0] == "distributed":
        # tasks of one function and argument are the same to dask unless they are said to be impure; workers may come
        # and go
        yield lambda job, number: executor.submit(job, number, pure=False, retries=RETRIES), QUEUED
    else:
        yield executor.submit, max(LEAST_AHEAD, AHEAD * getattr(executor, "_max_workers", 1))


@contextmanager
def _threads(count: int) -> Iterator[Executor]:
    """Threads of this process, which end soon after an error or Ctrl-C."""
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    except BaseException:
        with all_stopped():
            pool.shutdown(wait=False, cancel_futures=True)
            _wait_until_idle(pool)
        raise
    pool.shutdown()


def _wait_until_idle(pool: ThreadPoolExecutor) -> None:
    until = time.monotonic() + PATIENCE
    threads: set[threading.Thread] = set(getattr(pool, "_threads", ()))
    while any(thread.is_alive() for thread in threads) and time.monotonic() < until:
        time.sleep(TICK)


def processes(count: int | None = None) -> ProcessPoolExecutor:
    """An executor of spawned processes for `store`, one for each group of cores; default one per core.

    Programs that are kept on disk, see `slipperjax.compile_cache`, are kept for them, too. In a script it belongs
    under `if __name__ == "__main__":`, because new processes import the script.

    ```python
    with sj.processes(2) as pool:
        ds = sj.sweep(scene, grid, store="map.zarr", executor=pool)
    ```

    **Raises:** `ValueError` for fewer than one.
    """
    count = cores() if count is None else whole("count", count, 1)
    context = multiprocessing.get_context("spawn")
    folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    begun = (context.Value("i", 0), _groups(count), None if folder is None else str(folder))
    return ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=begun)


def _groups(count: int) -> list[list[int]]:
    """Cores for each process, as equal as they can be; processes above the number of cores share them."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    own = sorted(os.sched_getaffinity(0))
    return [own[k * len(own) // count : (k + 1) * len(own) // count] or [own[k % len(own)]] for k in range(count)]


def _begin(counter, groups: list[list[int]], folder: str | None) -> None:
    """Prepares a new process, before JAX starts its threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the business of who waits for the results
    with counter.get_lock():
        number = counter.value
        counter.value += 1
    if groups:
        with suppress(OSError):
            os.sched_setaffinity(0, groups[number % len(groups)])
    if folder is None:
        compile_cache()
    else:
        keep_programs(Path(folder))
