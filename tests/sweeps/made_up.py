"""A sweep that costs no time, for tests of stores: numbers that follow from each case's parameters alone."""

import contextlib
import os
import signal
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import slipperjax as sj
from slipperjax.flow.datasets import run_attributes
from slipperjax.sweeps.estimate import Estimate
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.store import Store, run_or_store

SHAPE = (12, 10)


@dataclass(frozen=True)
class MadeUp:
    """What the sweep was asked, and what it computes.

    Each part lasts for PAUSE seconds, and kills its process where the file DIES exists, which it deletes.
    """

    periods: int = 3
    product: bool = True
    steps_per_period: Any = None
    solver: Any = None
    function: str = "made_up"

    def estimate(self, grid, start):
        return Estimate.counted(grid.count, 0.0, 10 * self.periods, "")

    def compute(self, scene, grid, start, **how):
        time.sleep(float(os.environ.get("PAUSE", "0")))
        with contextlib.suppress(FileNotFoundError):  # of two workers that see the file, the one that deletes it dies
            Path(os.environ.get("DIES", "none")).unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        known = Grid(scene, grid, product=self.product)
        mesh = np.meshgrid(*known.axes.values(), indexing="ij") if self.product else known.axes.values()
        first = sum(np.sin(len(name) * 1e3 * values) for name, values in zip(known.axes, mesh, strict=True))
        crossings = np.arange(1, 2 * self.periods)
        steps = 50 if self.steps_per_period is None else self.steps_per_period
        data = {
            "v_z": ((*known.dims, "crossing"), first[..., None] * crossings, {"units": "m/s"}),
            "kind": (known.dims, np.where(first > 0, "up", "down and on")),
            "good": (known.dims, first > 0),
            "status": (known.dims, np.where(first > 1.5, 2, 0)),
            "steps_per_period": (known.dims, np.broadcast_to(steps, known.shape)),
        }
        seconds = first[..., None] + np.arange(self.periods)
        coords = {**known.coordinates(), "seconds": ((*known.dims, "period"), seconds), "point": ["A", "B"]}
        attrs = run_attributes(scene, start, {"function": "made_up"}, known.dims) | {"periods": self.periods}
        return sj.Result(xr.Dataset(data, coords, attrs))


def made_up(scene, grid, *, store=None, executor=None, chunk=None, workers=None, progress=False, **asked):
    how = dict(store=store, executor=executor, chunk=chunk, workers=workers, progress=progress)
    return run_or_store(MadeUp(**asked), scene, grid, sj.table_2_start(), **how)


def a_grid() -> dict:
    return {"speed": np.linspace(1000.0, 1600.0, SHAPE[0]), "clearance": np.linspace(0.5e-3, 1.5e-3, SHAPE[1])}


def call(path, **more):
    """The sweep of the tests, in tiles of ten cases."""
    store = Store(path, tile=10, share=more.pop("share", None), fresh=more.pop("fresh", False))
    return made_up(sj.paper_scene(), a_grid(), store=store, **more)


def first_half(path):
    """Computes a share, without a word."""
    with warnings.catch_warnings(action="error"):
        call(path, share=(1, 2), workers=1)


def files(path) -> dict[str, bytes]:
    """Every byte of a store."""
    return {str(file.relative_to(path)): file.read_bytes() for file in Path(path).rglob("*") if file.is_file()}


if __name__ == "__main__":
    print("ready", flush=True)
    call(Path(sys.argv[1]), workers=1)
