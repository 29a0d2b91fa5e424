"""Time, memory and disk of a sweep before it is begun, from a probe of a few of its cases."""

import math
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ..flow.simulate import first_of
from ..model.scene import Scene
from ..model.step_size import LEAST_STEPS
from ..tools.checks import whole
from ..tools.limits import LONGEST, available_memory, cores, shown_bytes, shown_time
from .grid import Grid
from .run import LARGEST_CHUNK, SAMPLED_CASES
from .store import COPIES, Store, Tiling


@dataclass(frozen=True)
class Estimate:
    """Time, memory and disk of a sweep."""

    function: str
    cases: int
    tiles: Tiling
    steps_per_period: tuple[int, int]
    """The fewest and the most of the cases that were looked at."""
    compile: float
    """Time [s] in which a process makes its programs, or takes them from the cache."""
    per_case: float
    """Time [s] of a case on one core, when all cores are busy alike."""
    workers: int
    """Cores."""
    memory: float
    """Bytes that a worker needs."""
    per_case_stored: float
    """Bytes on disk of a case, compressed."""
    files: int
    """On disk."""
    free: float | None
    """Bytes that are free on the disk of the store."""

    @property
    def seconds(self) -> float:
        """Time in all [s]."""
        return self.compile + self.cases * self.per_case / self.workers

    @property
    def stored(self) -> float:
        """Bytes on disk in all."""
        return self.cases * self.per_case_stored

    @property
    def problems(self) -> list[str]:
        """Why it cannot be done like that, with advice; nothing where it can."""
        problems, memory = [], available_memory()
        if memory is not None and self.memory > memory:
            problems.append(
                f"a worker needs {shown_bytes(self.memory)} of memory, of which {shown_bytes(float(memory))} are "
                "available: take smaller tiles, sj.Store(path, tile=...), or keep less of each case"
            )
        if self.free is not None and self.stored > self.free:
            problems.append(
                f"the store needs {shown_bytes(self.stored)}, of which its disk has {shown_bytes(self.free)}: "
                "keep less of each case, such as record=['peak_force'], or take another disk"
            )
        if self.seconds > LONGEST:
            problems.append(
                f"it takes {shown_time(self.seconds)} on {self.workers} cores: "
                f"{math.ceil(self.workers * self.seconds / (7 * 86400)):.3g} cores would be done in a week, see "
                "`executor` and shares"
            )
        return problems

    def __str__(self) -> str:
        low, high = self.steps_per_period
        size = math.prod(self.tiles.tile)
        lines = [
            f"{self.function}: {self.cases} cases in {self.tiles.count} tiles of {size} "
            f"({' x '.join(map(str, self.tiles.tile))})",
            f"steps per period: {low if low == high else f'{low} to {high}'}",
            f"time: {shown_time(self.seconds)} on {self.workers} cores ({self.per_case * 1e3:.3g} ms per case and "
            f"core, {size * self.per_case:.2g} s per tile; compiling {shown_time(self.compile)})",
            f"memory: {shown_bytes(self.memory)} per worker",
            f"disk: {shown_bytes(self.stored)} in {self.files} files ({shown_bytes(self.per_case_stored)} per case)"
            + (f", {shown_bytes(self.free)} free" if self.free is not None else ""),
        ]
        return "\n".join([*lines, *(f"impossible: {text}" for text in self.problems)])


def explain(
    function: Callable[..., xr.Dataset],
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    store: Any = None,
    workers: int | None = None,
    **options: Any,
) -> Estimate:
    """Estimates cases, tiles, time, memory and disk of a sweep, from a probe of some of its cases.

    The probe runs `LARGEST_CHUNK` cases spread over the grid, once to compile and once to be timed.

    ```python
    print(sj.explain(sj.sweep, scene, grid, transient=300, store="map.zarr"))
    ```

    **Arguments:** `function`: `sweep`, `lyapunov_sweep` or another one that can be stored; `workers`: cores that will
    be at work, default those of this process; `store` and `options`: as for the function.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    known = Grid(scene, grid, product=options.get("product", True))
    target = None if store is None else Store.of(store)
    tiles = Tiling.of(known.shape, None if target is None else target.tile)
    workers = cores() if workers is None else whole("workers", workers, 1)
    how = {
        **options,
        "workers": 1,
        "progress": False,
        "chunk": options.get("chunk") or LARGEST_CHUNK,
        "product": False,
    }
    steps = _steps(known, options)
    used = -(-int(np.ceil(steps.mean())) // LEAST_STEPS) * LEAST_STEPS if np.ptp(steps) else int(steps[0])
    how["steps_per_period"] = used  # the same for all, so that the probe is one batch
    some = known.spread(LARGEST_CHUNK)
    run = lambda: function(scene, grid=some, **how)
    first, _ = _timed(run)
    second, ds = _timed(run)
    per_case = second / LARGEST_CHUNK * float(steps.mean()) / used
    bytes_of_case = ds.nbytes / ds.sizes["case"]
    free = None if target is None else float(shutil.disk_usage(_existing(target.path)).free)
    arrays = [name for name in ds.variables if "case" in ds[name].dims and name not in known.coordinates()]
    return Estimate(
        function.__name__,
        known.count,
        tiles,
        (int(steps.min()), int(steps.max())),
        max(first - second, 0.0),
        per_case,
        workers,
        _resident() + COPIES * bytes_of_case * math.prod(tiles.tile),
        _compressed(ds),
        len(arrays) * tiles.count + 2 * len(ds.variables),
        free,
    )


def _steps(grid: Grid, options: Mapping[str, Any]) -> np.ndarray:
    """Steps per period of some cases, as many as there are at most."""
    given = options.get("steps_per_period")
    if given is not None:
        return np.atleast_1d(np.asarray(given)).ravel()
    return grid.sample(first_of(options.get("start")), SAMPLED_CASES).default_steps()


def _timed(call: Callable[[], xr.Dataset]) -> tuple[float, xr.Dataset]:
    begin = time.perf_counter()
    result = call()
    return time.perf_counter() - begin, result


def _existing(path: Any) -> Any:
    """The nearest folder above that exists."""
    path = path.absolute()
    while not path.exists():
        path = path.parent
    return path


def _resident() -> float:
    """Bytes of memory that this process has needed at most: programs and libraries, mostly."""
    try:
        import resource
    except ImportError:  # not on Windows
        return 1e9
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)


def _compressed(ds: xr.Dataset) -> float:
    """Bytes on disk of a case, of the probe's cases together."""
    from numcodecs import Zstd

    codec, total = Zstd(level=3), 0
    for name in ds.variables:
        variable = ds.variables[name]
        if "case" in variable.dims:
            values = variable.values
            raw = (
                values.astype("S").tobytes() if values.dtype.kind in "UO" else np.ascontiguousarray(values).tobytes()
            )
            total += len(codec.encode(raw))
    return total / ds.sizes["case"]
