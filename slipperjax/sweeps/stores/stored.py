"""Sweeps into a store: the same call again goes on where the last one ended, however that was."""

import functools
import hashlib
import inspect
import json
import math
import shutil
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np
import xarray as xr

from ...flow.datasets import versions
from ...flow.simulate import first_of
from ...flow.status import Interrupted
from ...model.scene import Scene
from ...model.scene_files import scene_to_json
from ...solvers.latching import calls_lapack
from ...solvers.named import resolve_solver
from ...tools.checks import brief, warn, whole
from ...tools.description import describe
from ...tools.limits import available_memory, cores, shown_bytes
from ..grid import Grid
from ..plan import LARGEST_CHUNK
from .archive import Archive, make_archive, open_archive, open_store
from .target import Store, Tiling, making, store_of, tiling, writing
from .tasks import Job, run_tasks

COPIES = 3.0
"""How often results are in memory while a tile is put together and written."""

P = ParamSpec("P")
R = TypeVar("R")


def storable(function: Callable[P, R]) -> Callable[P, R]:
    """A sweep with the arguments `store` and `executor`, which are handled here.

    The function takes `scene` and `grid`, then keywords, `product`, `workers`, `chunk` and `progress` among them, and
    gives a dataset over the grid in which no case depends on another.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Any:
        store, executor = kwargs.pop("store", None), kwargs.pop("executor", None)
        if store is None:
            if executor is not None:
                raise ValueError("Argument `executor` needs `store`, to which its workers write.")
            return function(*args, **kwargs)
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        given = dict(bound.arguments)
        for name in ("store", "executor"):
            given.pop(name)
        return stored(function, given.pop("scene"), given.pop("grid"), given, store_of(store), executor)

    return call


def stored(
    function: Callable[..., xr.Dataset],
    scene: Scene,
    grid: Mapping[str, Any],
    options: Mapping[str, Any],
    store: Store,
    executor: Any = None,
) -> xr.Dataset:
    """Runs a function over a grid, tile by tile, into a store, and opens that.

    **Raises:** `ValueError` where the store is of another call, with the differences; `StoreInUse` where another
    process writes to it; `Interrupted` after Ctrl-C, with the store as its dataset.
    """
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise ValueError(
            "Argument `executor` must be a dask.distributed.Client or a concurrent.futures.Executor, but is "
            f"{brief(executor)}."
        )
    checked = Grid(scene, grid, product=options.get("product", True))
    if (steps := np.asarray(options.get("steps_per_period"))).ndim and steps.shape != checked.shape:
        raise ValueError(
            f"Argument `steps_per_period` must be one number or one for each case, {checked.shape}, but has shape "
            f"{steps.shape}."
        )
    workers = options.get("workers")
    workers = None if workers is None else whole("workers", workers, 1)
    tiles = _tiling(checked, store)
    asked = _fingerprint(function, checked, options, tiles)
    # threads of this process run a tile each; those of other processes may have several cores
    inside = {**options, "workers": 1 if executor is None else (workers or 1), "progress": False}
    # always as many, so that a worker compiles its programs once
    inside["chunk"] = options.get("chunk") or LARGEST_CHUNK
    if "start" in inside:
        inside["start"] = first_of(inside["start"])  # a trajectory may be long, and every worker gets it
    named = f"{function.__module__}:{function.__qualname__}"
    # LAPACK must not be called from two threads, and a device computes one batch at a time
    alone = calls_lapack(resolve_solver(scene, options.get("solver")), True) or jax.default_backend() != "cpu"
    job = Job(store.path.absolute(), named, scene, tuple(checked.axes), inside, alone)
    with writing(store):
        try:
            archive = _archive(job, checked, tiles, asked, store, 1 if executor is not None else (workers or cores()))
        except Interrupted:
            raise Interrupted(None, 0, checked.count) from None
        done = archive.done()
        share, shares = store.share or (1, 1)
        todo = [k for k in range(tiles.count) if not done[k] and k % shares == share - 1]
        archive.tidy(None if store.share is None else todo)
        try:
            run_tasks(job, todo, executor, workers, bool(options.get("progress")), archive.finished(done))
        except KeyboardInterrupt:
            raise Interrupted(open_store(store.path), archive.finished(), checked.count) from None
    return open_store(store.path)


def _check_room(like: xr.Dataset, count: int, tiles: Tiling, store: Store, threads: int) -> None:
    """Refuses tiles that do not fit into memory, and warns of a store that may not fit on its disk.

    **Arguments:** `like`: the results of one case.
    """
    size, room = math.prod(tiles.tile), available_memory()
    needed = COPIES * like.nbytes * size * threads
    if room is not None and needed > room:
        raise ValueError(
            f"Argument `store` must have tiles that fit into memory, but {threads} at once of {size} cases "
            f"need {shown_bytes(needed)}, of which {shown_bytes(float(room))} are available: take smaller "
            "ones, slipperjax.Store(path, tile=...), or keep less of each case."
        )
    free = float(shutil.disk_usage(store.path.absolute().parent).free)
    if like.nbytes * count > free:
        warn(
            f"The store has {shown_bytes(float(like.nbytes * count))} before it is compressed, and its disk has "
            f"{shown_bytes(free)}: see slipperjax.explain, and keep less of each case where it does not fit."
        )


def _tiling(grid: Grid, store: Store) -> Tiling:
    """As asked; otherwise as in the store, if there is one of this shape."""
    if store.tile is None and not store.fresh and store.path.exists():
        tiles = open_archive(store.path).tiles
        if tiles.shape == grid.shape:
            return tiles
    return tiling(grid.shape, store.tile)


def _archive(job: Job, grid: Grid, tiles: Tiling, asked: Mapping[str, Any], store: Store, threads: int) -> Archive:
    """The store, which is made where there is none."""
    with making(store):
        if store.fresh or not store.path.exists():
            # first of all, so that a wrong argument deletes nothing
            corner = tuple(slice(1) for _ in grid.shape)
            like = job.part(grid.part(corner), corner)
            _check_room(like, grid.count, tiles, store, threads)
            return make_archive(store.path, grid, tiles, asked, like)
        archive = open_archive(store.path)
        _check_asked(archive, asked)
        return archive


# --- the call that a store is of ------------------------------------------------------------------------------------

UNSEEN = ("progress", "workers", "chunk")
"""Arguments that change no result."""
LONG = 60
"""Length from which a value is cut in a message."""


def _fingerprint(function: Any, grid: Grid, options: Mapping[str, Any], tiles: Tiling) -> dict[str, Any]:
    """What determines every number of a store, as JSON holds it."""
    asked = {name: value for name, value in options.items() if name not in (*UNSEEN, "start", "product")}
    if "start" in options:
        asked["start"] = first_of(options["start"])
    return {
        "function": function.__name__,
        "scene": json.loads(scene_to_json(grid.scene)),
        "grid": {name: _summary(values) for name, values in grid.axes.items()},
        "product": grid.product,
        "tile": list(tiles.tile),
        "arguments": {name: _plain(value) for name, value in asked.items()},
        "versions": {name: version for name, version in versions().items() if name != "python"},
    }


def _summary(values: np.ndarray) -> dict[str, Any]:
    """An axis in few numbers that tell it from others."""
    ends = {"values": len(values), "first": float(values[0]), "last": float(values[-1])}
    return ends | {"sha256": hashlib.sha256(np.ascontiguousarray(values, float).tobytes()).hexdigest()[:16]}


def _plain(value: Any) -> Any:
    """A value as JSON holds it; a function by its name and a digest of its code."""
    if isinstance(value, np.ndarray) and value.size > LONG:
        return _summary(value.ravel())
    return json.loads(json.dumps(describe(value)))


def _differences(found: Any, asked: Any, path: str = "") -> list[str]:
    """Where two fingerprints differ, a line each: "scene.contact.restitution: 0.9 in the store, 0.8 asked"."""
    if isinstance(found, dict) and isinstance(asked, dict):
        lines = []
        for name in dict.fromkeys([*found, *asked]):
            below = f"{path}.{name}" if path else str(name)
            lines += _differences(found.get(name, "nothing"), asked.get(name, "nothing"), below)
        return lines
    # NaN is a value of its own here, as in JSON's text
    if json.dumps(found) == json.dumps(asked):
        return []
    return [f"{path}: {_short(found)} in the store, {_short(asked)} asked"]


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= LONG else f"{text[: LONG - 3]}..."


def _check_asked(archive: Archive, asked: Mapping[str, Any]) -> None:
    """Refuses a store that was made by another call.

    **Raises:** `ValueError` that shows the differences.
    """
    lines = _differences(archive.asked(), json.loads(json.dumps(asked)))
    if lines:
        shown = "\n  ".join(lines[:10] + [f"and {len(lines) - 10} more"] * (len(lines) > 10))
        raise ValueError(
            f"Argument `store` must be of the same call, but {archive.path} was made by another one:\n  {shown}\n"
            "Take another path, or start over with slipperjax.Store(path, fresh=True), on the command line --fresh."
        )
