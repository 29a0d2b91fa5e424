"""Time, memory and disk of a sweep before it is begun, measured on a few of its cases."""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ..flow.simulate import first_of
from ..model.scene import Scene, at_speed
from ..model.step_size import LEAST_STEPS
from ..tools.checks import whole
from ..tools.limits import cores, shown_bytes, shown_time
from .estimate import CountedEstimate
from .grid import Grid, Tiling
from .run import LARGEST_CHUNK, SAMPLED_CASES, refined
from .store import Store, bytes_of_case

SECONDS_PER_FILE = 5e-3
"""Time in which a file of a tile is written [s]: measured 3 to 7 ms."""


@dataclass(frozen=True, kw_only=True)
class Estimate(CountedEstimate):
    """Time, memory and disk of a sweep, measured on a few of its cases."""

    function: str
    steps_per_period: tuple[int, int]
    """The fewest and the most of the cases that were looked at."""
    compile: float
    """Time [s] in which a process makes its programs, or takes them from the cache."""
    resident: float
    """Bytes of programs and libraries in a process."""
    per_case_stored: float
    """Bytes on disk of a case, compressed."""
    files_per_tile: int
    """On disk."""

    @property
    def seconds(self):
        return self.compile + super().seconds + self.writing

    @property
    def writing(self) -> float:
        """Time in which the tiles of a store are written [s], one after another in each process."""
        processes = self.workers if self.shared else 1
        return self.files * SECONDS_PER_FILE / processes

    @property
    def stored(self):
        return self.cases * self.per_case_stored

    @property
    def stored_text(self):
        return shown_bytes(self.stored)

    @property
    def files(self) -> int:
        """Files of a store in all."""
        return 0 if self.tiles is None else self.files_per_tile * self.tiles.count

    def __str__(self) -> str:
        low, high = self.steps_per_period
        text = f"{self.function}: {self.cases} cases"
        tile, memory = "", f"memory: {shown_bytes(self.resident + self.memory / self.at_once)} per worker"
        if self.tiles is not None:
            shape, size = " x ".join(map(str, self.tiles.tile)), self.tiles.size
            text += f" in {self.tiles.count} tiles of {size} ({shape})"
            tile = f", {size * self.per_case:.2g} s per tile"
            memory += (
                f"\ndisk: {shown_bytes(self.stored)} in {self.files} files ({shown_bytes(self.per_case_stored)} per "
                f"case), {shown_bytes(self.free)} free"
            )
        lines = [
            text,
            f"steps per period: {low if low == high else f'{low} to {high}'}",
            f"time: {shown_time(self.seconds)} on {self.workers} cores ({self.per_case * 1e3:.3g} ms per case and "
            f"core{tile}; compiling {shown_time(self.compile)}"
            f"{'' if self.tiles is None else f', writing {shown_time(self.writing)}'})",
            memory,
        ]
        return "\n".join([*lines, *self.problems])


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
    be at work, default those of this process; more than these are taken as workers of an executor, which compute a
    tile each; `store` and `options`: as for the function.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    scene = at_speed(scene, options.pop("speed", None))
    cases = Grid(scene, grid, product=options.get("product", True))
    workers = cores() if workers is None else whole("workers", workers, 1)
    steps = options.get("steps_per_period")
    refine = refined(options.pop("refine", 1), steps)
    if steps is None:
        steps = refine * cases.sample(first_of(options.get("start")), SAMPLED_CASES).default_steps()
    steps = np.ravel(steps)
    # the same for all, so that the probe is one batch
    used = -(-int(np.ceil(steps.mean())) // LEAST_STEPS) * LEAST_STEPS if np.ptp(steps) else int(steps[0])
    options |= dict(workers=1, progress=False, product=False, chunk=options.get("chunk") or LARGEST_CHUNK)
    options["steps_per_period"] = used
    seconds, ds = [], xr.Dataset()
    for _ in range(2):
        begin = time.perf_counter()
        ds = function(scene, grid=cases.spread(LARGEST_CHUNK), **options)
        seconds.append(time.perf_counter() - begin)
    axes, of_store = cases.coordinates(), {}
    if store is not None:
        target = Store.of(store)
        # a call in this process computes a tile on each of its threads
        of_store["at_once"] = workers if workers <= cores() else 1
        of_store["tiles"] = Tiling.of(cases.shape, target.tile)
        of_store["free"] = target.free_bytes
        of_store["shared"] = workers > cores()
    return Estimate(
        cases=cases.count,
        per_case=seconds[1] / LARGEST_CHUNK * float(steps.mean()) / used,
        per_case_memory=bytes_of_case(ds, ("case",), axes),
        workers=workers,
        **of_store,
        function=function.__name__,
        steps_per_period=(int(steps.min()), int(steps.max())),
        compile=max(seconds[0] - seconds[1], 0.0),
        resident=_resident(),
        per_case_stored=_compressed(ds),
        files_per_tile=2 + sum("case" in v.dims for name, v in ds.variables.items() if name not in axes),
    )


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

    values = [v.values for v in ds.variables.values() if "case" in v.dims]
    raw = [np.ascontiguousarray(v.astype("S") if v.dtype.kind in "UO" else v) for v in values]
    return sum(len(Zstd(level=3).encode(array.tobytes())) for array in raw) / ds.sizes["case"]
