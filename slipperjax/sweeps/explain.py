"""Time, memory and disk of a sweep before it begins, measured on a few of its cases."""

import inspect
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..model.scene import Scene, at_speed
from ..model.step_size import LEAST_STEPS
from ..orbits.simulate import first_of
from ..tools.checks import require, whole
from ..tools.limits import cores, shown_time
from .call import refined
from .estimate import Estimate
from .grid import Grid, Tiling
from .plan import largest_chunk
from .runs import run
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

    128 cases, or 32 on rails that bend, spread over the grid, run twice: once to compile, and once to be timed.

    ```python
    print(sj.explain(sj.sweep, scene, grid, transient=300, store="map.zarr"))
    ```

    **Arguments:** `function`: `sweep`, `lyapunov_sweep` or another function with a store; `workers`: number of cores
    that will compute, by default the cores of this process. If this process has fewer cores, the workers of an
    executor are assumed, each with its own tile. `store` and `options`: as for the function.

    **Returns:** an `Estimate`, to be printed.

    **Raises:** `ValueError` that names the wrong argument.
    """
    need = "be a function of a grid, such as slipperjax.sweep or slipperjax.run"
    require(callable(function) and "grid" in inspect.signature(function).parameters, "function", need, function)
    target = None if store is None else Store.of(store)
    scene = at_speed(scene, options.pop("speed", None))
    cases = Grid(scene, grid, product=options.get("product", True))
    workers = cores() if workers is None else whole("workers", workers, 1)
    # work of all cases over the work of the measured cases
    share = 1.0
    # a run has other steps in each window, by the speed there, where the sled may be at rest
    if function is not run:
        steps = options.get("steps_per_period")
        refine = refined(options.pop("refine", 1), steps)
        if steps is None:
            steps = refine * cases.sample(first_of(options.get("start"))).default_steps()
        steps = np.ravel(steps)
        used = int(steps[0])
        if np.ptp(steps):
            # the same for all, so that the measured cases are one batch
            used = -(-int(np.ceil(steps.mean())) // LEAST_STEPS) * LEAST_STEPS
        options["steps_per_period"] = used
        share = float(steps.mean()) / used
        facts = f"steps per period: {steps.min()} to {steps.max()}"
    measured = largest_chunk(scene)
    options |= dict(
        workers=1,
        progress=False,
        product=False,
        chunk=options.get("chunk") or measured,
    )
    # the first run compiles, so that the second run gives the time
    seconds = []
    ds = xr.Dataset()
    for _ in range(2):
        begin = time.perf_counter()
        ds = function(scene, grid=cases.part(cases.spread(measured)), **options).ds
        seconds.append(time.perf_counter() - begin)
    of_store: dict[str, object] = {}
    if target is not None:
        of_store["tiles"] = Tiling.of(cases.shape, target.tile)
        of_store["free"] = target.free_bytes
        of_store["shared"] = workers > cores()
    if function is run:
        windows = ds["steps_per_window"].values
        facts = f"steps per window: {windows.min()} to {windows.max()}"
    compiling = shown_time(max(seconds[0] - seconds[1], 0.0))
    return Estimate(
        cases=cases.count,
        # by the mean steps of all cases, because the steps of the measured cases are rounded
        per_case=seconds[1] / measured * share,
        bytes_per_case=ds.nbytes / measured,
        workers=workers,
        **of_store,
        stored_per_case=_compressed(ds),
        facts=f"{facts}\ncompiling: {compiling}",
    )


def _compressed(ds: xr.Dataset) -> float:
    """Return the bytes of one measured case on disk, compressed together with the others as in a tile."""
    from numcodecs import Zstd

    total = 0
    for variable in ds.variables.values():
        if "case" in variable.dims:
            # texts as bytes, which is about the form that zarr writes
            is_text = variable.dtype.kind in "UO"
            values = variable.values.astype("S") if is_text else variable.values
            total += len(Zstd(level=3).encode(values.tobytes()))
    return total / ds.sizes["case"]
