"""Many cases of one scene: what varies between them, and running them in chunks on all cores."""

import math
import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm.auto import tqdm

from .checks import finite, fraction, whole
from .compilation import jit
from .dynamics import State, initial_state
from .kinematics import Motion
from .labels import attributes
from .scene import PARAMETERS, Scene, default_steps_per_period

LARGEST_CHUNK = 1024
"""Cases in one call: enough to hide the cost of starting a kernel, few enough to stay in the cache."""

LANES = 8
"""Batches are filled up to multiples of this: a vector register's worth, and one program for all small ones."""

START = {
    "y": ("m", "lateral displacement at the start"),
    "z": ("m", "vertical displacement at the start"),
    "v_y": ("m/s", "lateral velocity at the start"),
    "v_z": ("m/s", "vertical velocity at the start"),
    "w_x": ("rad/s", "roll rate at the start"),
    "w_y": ("rad/s", "pitch rate at the start"),
    "w_z": ("rad/s", "yaw rate at the start"),
}
"""Unit and description of the start's coordinates that a grid may vary beside `PARAMETERS`, for basins."""


class Grid:
    """Named axes of parameter values, and the flat list of cases they make.

    **Arguments:** `scene`: the case whose parameters are varied; `grid`: values by name, of `PARAMETERS` or `START`;
    `product`: whether every combination is a case, or the lists are read side by side.

    **Raises:** `ValueError` for a wrong name, an empty axis, a bad value, or lists of several lengths side by side.
    """

    def __init__(self, scene: Scene, grid: Mapping[str, Any], *, product: bool = True):
        if not isinstance(grid, Mapping) or not grid:
            raise ValueError(f"Argument `grid` must name one or more parameters with their values, but is {grid!r}.")
        self.axes: dict[str, np.ndarray] = {}
        for name, raw in grid.items():
            values = np.atleast_1d(np.asarray(_check_of(scene, name)(raw)))
            if values.ndim != 1 or values.size == 0:
                raise ValueError(
                    f"Argument `{name}` must be a list of one or more values, but has shape {values.shape}."
                )
            self.axes[name] = values
        lengths = tuple(len(v) for v in self.axes.values())
        if product:
            mesh = np.meshgrid(*self.axes.values(), indexing="ij")
            self.values = {name: m.ravel() for name, m in zip(self.axes, mesh, strict=True)}
            self.dims = tuple(self.names().values())
            self.shape = lengths
        else:
            if len(set(lengths)) > 1:
                raise ValueError(f"Argument `grid` must have lists of one length, but they have {lengths}.")
            self.values = self.axes
            self.dims = ("case",)
            self.shape = lengths[:1]
        self.lanes = math.prod(self.shape)

    def names(self) -> dict[str, str]:
        """What the axes are called in a dataset, where y is the displacement and not the start."""
        return {name: f"start_{name}" if name in START else name for name in self.axes}

    def coordinates(self) -> dict[str, Any]:
        """The axes as coordinates of a dataset."""
        return {
            label: (label if label in self.dims else "case", self.axes[name], attributes(*self.label(name)))
            for name, label in self.names().items()
        }

    def label(self, name: str) -> tuple[str, str]:
        """Unit and description of an axis."""
        return START[name] if name in START else PARAMETERS[name][:2]

    def most_steps(self, scene: Scene) -> int:
        """The most steps per period that `default_steps_per_period` wants for any case."""
        # The clearance and the start have no part in it, and the play per face would not broadcast.
        values = {k: v for k, v in self.values.items() if k != "clearance" and k not in START}
        return default_steps_per_period(scene.replace(**values))


def _check_of(scene: Scene, name: str) -> Callable:
    if name in START:
        return finite(name, START[name][0])
    scene.value(name)
    return fraction("restitution") if name == "restitution" else PARAMETERS[name][2]


def case_scene(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene of one case of a grid."""
    return scene.replace(**{k: v for k, v in values.items() if k not in START})


def case_state(scene: Scene, values: Mapping[str, Any], start: Motion) -> State:
    """The state at time zero of one case of a grid."""
    own = {k: values.get(k, v) for k, v in vars(start).items()}
    return initial_state(case_scene(scene, values), Motion(**own))


@jit
def start_states(scene: Scene, values: Mapping[str, Any], start: Motion) -> State:
    """The states at time zero of a batch; `values` and the result have a leading axis of cases."""
    return jax.vmap(lambda v: case_state(scene, v, start))(values)


def filled(lanes: int) -> np.ndarray:
    """Indices of a batch's cases, its last one repeated until their number is a multiple of `LANES`."""
    return np.minimum(np.arange(-(-lanes // LANES) * LANES), lanes - 1)


class Workers:
    """How a batch is cut up: cases per call, and threads. Neither changes any result.

    **Arguments:** `alone`: whether calls must not run side by side, whatever `workers` says.
    """

    def __init__(self, lanes: int, chunk: int | None, workers: int | None, *, alone: bool = False):
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
        self.workers = cores if workers is None else whole("workers", workers, 1)
        if alone:
            self.workers = 1
        if chunk is None:
            chunk = len(filled(min(-(-lanes // self.workers), LARGEST_CHUNK)))
        self.chunk = whole("chunk", chunk, 1)
        self.lanes = lanes

    def run(
        self,
        work: Callable[[dict[str, jax.Array], Callable[[int], None]], list[np.ndarray]],
        values: Mapping[str, np.ndarray],
        *,
        periods: int,
        progress: bool,
    ) -> list[np.ndarray]:
        """Calls `work` for each chunk and joins the results, see `join`.

        **Arguments:** `work(values, tick)`: gives arrays, cases first; it calls `tick(n)` after every n periods,
        which shows progress, and which raises where another chunk failed or the user interrupted; `values`: flat
        values by name; `periods`: how many periods one case takes in all.
        """
        stop = threading.Event()
        bar = tqdm(total=self.lanes * periods, unit="period", unit_scale=True, disable=not progress)
        lock = threading.Lock()

        def piece(at: int):
            # The last chunk is filled up with copies of its last case, so that every chunk runs the same program.
            index = np.minimum(np.arange(at, at + self.chunk), self.lanes - 1)

            def tick(periods: int) -> None:
                if stop.is_set():
                    raise _Stopped
                with lock:
                    bar.update(min(self.chunk, self.lanes - at) * periods)

            return work({name: jnp.asarray(v[index]) for name, v in values.items()}, tick)

        starts = range(0, self.lanes, self.chunk)
        with bar, ThreadPoolExecutor(min(self.workers, len(starts))) as pool:
            try:
                pieces = list(pool.map(piece, starts))
            except BaseException:
                stop.set()  # a chunk stops at its next tick, not in the middle of a call
                raise
        return [a[: self.lanes] for a in join(pieces)]


class _Stopped(Exception):
    """Ends a chunk's thread after another one failed or the user interrupted."""


def join(pieces: list[list[np.ndarray]]) -> list[np.ndarray]:
    """Joins lists of arrays (cases, samples, ...) along the cases; fewer samples are filled up with NaN."""

    def one(*parts: np.ndarray) -> np.ndarray:
        if parts[0].ndim > 1:
            most = max(p.shape[1] for p in parts)
            rest = [(0, 0)] * (parts[0].ndim - 2)
            missing = [most - p.shape[1] for p in parts]
            parts = tuple(
                np.pad(p, [(0, 0), (0, m), *rest], constant_values=np.nan) if m else p
                for p, m in zip(parts, missing, strict=True)
            )
        return np.concatenate(parts)

    return [one(*parts) for parts in zip(*pieces, strict=True)]
