"""Worker processes on one machine, each with cores of its own."""

import contextlib
import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import jax

from ...tools.cache import compile_cache, keep_programs
from ...tools.checks import whole
from ...tools.limits import cores


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
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, groups[number % len(groups)])
    if folder is None:
        compile_cache()
    else:
        keep_programs(Path(folder))
