"""Time, memory and disk of a sweep before it begins, measured on a few of its cases."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..model.scene import Scene, at_speed
from ..tools.checks import require, whole
from ..tools.limits import cores, shown_time
from .estimate import Estimate
from .grid import Grid, Tiling
from .plan import LARGEST_CHUNK
from .store import Store


def explain(
    function: Callable[..., xr.Dataset],
    scene: Scene,
    grid: Mapping[str, object],
    *,
    store: object = None,
    workers: int | None = None,
    **options: Any,
) -> Estimate:
    """Estimate time, memory and disk of a sweep, from a chunk of its cases.

    `LARGEST_CHUNK` cases spread over the grid are run once to compile and once to be timed.

    ```python
    print(sj.explain(sj.sweep, scene, grid, transient=300, store="map.zarr"))
    ```

    **Arguments:** `function`: `sweep`, `lyapunov_sweep` or another one that can be stored; `workers`: cores that will
    compute, by default those of this process; if they are more than this process has, an executor's are assumed, each
    with a tile of its own; `store` and `options`: as for the function.

    **Returns:** an `Estimate`, to be printed.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    require(callable(function), "function", "be a function such as slipperjax.sweep", function)
    target = None if store is None else Store.of(store)
    scene = at_speed(scene, options.pop("speed", None))
    cases = Grid(scene, grid, product=options.get("product", True))
    workers = cores() if workers is None else whole("workers", workers, 1)
    index = cases.spread(LARGEST_CHUNK)
    steps = options.get("steps_per_period")
    cases.check_steps(steps)
    if np.ndim(steps):
        options["steps_per_period"] = np.asarray(steps)[index]
    options |= dict(workers=1, progress=False, product=False)
    # the first run compiles, so the second one alone is the time
    seconds = []
    ds = xr.Dataset()
    for _ in range(2):
        begin = time.perf_counter()
        ds = function(scene, grid=cases.part(index), **options)
        seconds.append(time.perf_counter() - begin)
    of_store = {}
    if target is not None:
        of_store = dict(tiles=Tiling.of(cases.shape, target.tile), free=target.free_bytes, shared=workers > cores())
    # runs have steps of their own in each window
    unit = "window" if "steps_per_window" in ds else "period"
    used = ds[f"steps_per_{unit}"].values
    compiling = shown_time(max(seconds[0] - seconds[1], 0.0))
    return Estimate(
        cases=cases.count,
        per_case=seconds[1] / LARGEST_CHUNK,
        bytes_per_case=ds.nbytes / LARGEST_CHUNK,
        workers=workers,
        **of_store,
        stored_per_case=_compressed(ds),
        facts=f"steps per {unit}: {used.min()} to {used.max()}\ncompiling: {compiling}",
    )


def _compressed(ds: xr.Dataset) -> float:
    """Return the bytes on disk of one of the probe's cases, compressed together as in a tile."""
    from numcodecs import Zstd

    total = 0
    for variable in ds.variables.values():
        if "case" in variable.dims:
            # texts as bytes, which is about what zarr writes
            is_text = variable.dtype.kind in "UO"
            values = variable.values.astype("S") if is_text else variable.values
            total += len(Zstd(level=3).encode(values.tobytes()))
    return total / ds.sizes["case"]
