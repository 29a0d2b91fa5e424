"""Sweeps on disk: a zarr store whose tiles any executor computes, each complete or absent.

A tile is a block of the grid: one task, and one chunk of every array. The tile's mark is a file next to the chunks of
`status`, written last: a tile with a mark is complete, and the mark identifies the call. Therefore the same call
continues where the last call ended, for any reason.
"""

import errno
import functools
import hashlib
import json
import math
import multiprocessing
import os
import re
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from ..flow.datasets import versions
from ..flow.status import Interrupted, Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..model.scene_files import scene_to_json
from ..results.result import Result
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.cache import keep_in, keep_programs, kept_folder
from ..tools.checks import TOLD, require, told_once, warn, whole, yes_or_no
from ..tools.code import IMPORTED, classes_of, code_digest
from ..tools.description import describe, type_name
from ..tools.files import content_of, listed, readable, user_path
from ..tools.limits import cores, shown_bytes
from ..tools.progress import DELAY
from .call import AbstractCall
from .engine import gather, progress_shown
from .grid import Grid, Tiling
from .plan import largest_chunk

MARK = "slipperjax_store"
"""Attribute that identifies a store of slipperjax: JSON of the fields of `Archive`."""
DESCRIPTION = "zarr.json"
"""File that says that a folder is a store."""
ZARR: Any = {"zarr_format": 3, "consolidated": False}
_ALONE = threading.Lock()  # held by the one computed tile, where two at a time are not allowed


class StoreInUse(OSError):
    """Error where another process writes to the store. The lock ends with its process, even if that is killed."""


class WorkerLost(OSError):
    """Error where a worker process ended, and its executor with it. Finished tiles are stored."""


@dataclass(frozen=True)
class Store:
    """A folder on disk, in zarr's format, which a sweep writes tile by tile, and from which the sweep can continue.

    All processes that compute a store must see the same disk.

    ```python
    sj.sweep(scene, grid, store=sj.sweeps.Store("map.zarr", fresh=True))
    ```
    """

    path: Path
    tile: int | None = None
    """Approximate number of cases that are computed and written together, and that a crash may lose; default from the
    grid."""
    fresh: bool = False
    """Whether to replace an existing store of slipperjax at the path."""
    share: tuple[int, int] | None = None
    """(i, n): compute only the i-th of n shares, i from 1 to n, while other processes compute the other shares."""

    def __post_init__(self):
        require(
            isinstance(self.path, str | os.PathLike),
            "store",
            "be a path that ends in .zarr",
            self.path,
        )
        object.__setattr__(self, "path", user_path(self.path))  # the class is frozen
        require(self.path.suffix == ".zarr", "store", "be a path that ends in .zarr", str(self.path))
        if self.tile is not None:
            whole("tile", self.tile, 1)
        yes_or_no("fresh", self.fresh)
        if self.share is not None:
            pair = isinstance(self.share, tuple | list) and [type(number) for number in self.share] == [int, int]
            require(
                pair and 1 <= self.share[0] <= self.share[1],
                "share",
                "be (i, n) with i from 1 to n",
                self.share,
            )
            require(
                not self.fresh,
                "fresh",
                "be False for a share, whose store others write to",
                self.fresh,
            )

    @classmethod
    def of(cls, store: object) -> "Store":
        """Return the store of an argument, a path or a `Store`."""
        require(
            isinstance(store, str | Path | Store),
            "store",
            "be a path or a slipperjax.sweeps.Store",
            store,
        )
        return store if isinstance(store, Store) else Store(Path(store))

    @property
    def free_bytes(self) -> float:
        """Free bytes on the store's disk."""
        # the store may not exist yet
        folder = next(folder for folder in self.path.absolute().parents if folder.exists())
        return float(shutil.disk_usage(folder).free)


# --- the call that a store is of ------------------------------------------------------------------------------------


def _fingerprint(call: AbstractCall, grid: Grid, start: Motion | State) -> dict[str, object]:
    """Return all values that determine the numbers of a store, as plain data."""
    # sources of the package, and of other classes, such as a user's track or record
    code = {"slipperjax": IMPORTED}
    code |= {type_name(kind): code_digest(kind) for kind in classes_of([grid.scene, vars(call)])}
    asked = {
        "scene": json.loads(scene_to_json(grid.scene)),
        "start": describe(start),
        "grid": {name: _summary(values) for name, values in grid.axes.items()},
        # a function by its name and a digest of its code, an array by a summary
        "call": {
            name: _summary(value.ravel()) if isinstance(value, np.ndarray) else describe(value)
            for name, value in vars(call).items()
        },
        "code": code,
    }
    # in the form that a store returns: tuples become lists
    return json.loads(json.dumps(asked))


def _summary(values: np.ndarray) -> dict[str, object]:
    """Return the few numbers of an axis that distinguish it from other axes."""
    digest = _digest(np.ascontiguousarray(values, float).tobytes())
    return {"values": len(values), "first": float(values[0]), "last": float(values[-1]), "digest": digest}


def _digest(content: bytes) -> str:
    """Return 16 hexadecimal digits that distinguish contents."""
    return hashlib.sha256(content).hexdigest()[:16]


def _leaves(value: object, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the texts of a call by their paths, such as scene.contact.restitution."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _leaves(part, f"{path}.{name}".strip("."))
    else:
        yield path, value if isinstance(value, str) else json.dumps(value)  # as text, NaN is equal to itself


# --- the store on disk ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Archive:
    """An existing store: the content of its attribute `MARK`, and its path."""

    path: Path
    digest: str
    """Digest of the store's description on disk, which contains the call."""
    call: dict[str, Any]
    versions: dict[str, str]
    dims: list[str]
    shape: list[int]
    tile: list[int]
    coords: list[str]
    variables: dict[str, list[str]]
    """Dimensions of the variables of which each tile has a chunk."""

    @property
    def tiles(self) -> Tiling:
        """Its tiles."""
        return Tiling(tuple(self.shape), tuple(self.tile))

    def region(self, number: int) -> dict[str, slice]:
        """Return the slices of the dimensions that give a tile."""
        return dict(zip(self.dims, self.tiles.region(number), strict=True))

    def files(self, number: int) -> list[Path]:
        """Return the files of a tile, one for each variable."""
        at = dict(zip(self.dims, map(str, self.tiles.indices(number)), strict=True))
        files = []
        for name, dims in self.variables.items():
            # zarr's file of a chunk is c/0/3/1; dimensions that the grid does not have are one chunk
            chunk = [at.get(d, "0") for d in dims]
            files.append(self.path.joinpath(name, "c", *chunk))
        return files

    def mark(self, number: int) -> Path:
        """Return the file that says that a tile is complete. Readers of zarr ignore it."""
        return self.path / "status" / "marks" / str(number)

    def mark_of(self, number: int) -> str:
        """Return a text that distinguishes a tile from tiles of other calls and places."""
        return _digest(f"{self._called} {number}".encode())

    @functools.cached_property
    def _called(self) -> str:
        """Digest of the call, which may contain a whole rail."""
        return _digest(json.dumps(self.call, sort_keys=True).encode())

    def is_complete(self, number: int) -> bool:
        """Return whether all files of a tile exist, with the mark of this store."""
        mark = self.mark(number)
        there = all(file.is_file() for file in (mark, *self.files(number)))
        return there and mark.read_text().startswith(self.mark_of(number))

    def complete_tiles(self) -> np.ndarray:
        """Return whether each tile is complete."""
        return np.array([self.is_complete(k) for k in range(self.tiles.count)])

    def complete_cases(self) -> int:
        """Return the number of cases in complete tiles."""
        return sum(self.tiles.cases(int(k)) for k in np.flatnonzero(self.complete_tiles()))

    def open(self) -> xr.Dataset:
        """Return the whole store, with texts as they are stored.

        **Raises:** `ValueError` where it cannot be read, or where a variable is missing.
        """
        with readable(self.path, "zarr store"):
            ds = xr.open_zarr(self.path, chunks=None, mask_and_scale=False, **ZARR)
        lost = sorted({*self.variables, *self.coords} - set(ds.variables))
        require(
            not lost,
            "store",
            "be whole",
            shown=f"without {', '.join(lost)}: start over with fresh=True",
        )
        return ds

    def write(self, number: int, ds: xr.Dataset) -> None:
        """Write the results of a tile, its mark last.

        **Raises:** `OSError` where the disk is full or protected; the tile is absent then. `ValueError` where a store
        of another call has replaced this store.
        """
        if _digest(content_of(self.path / DESCRIPTION)) != self.digest:
            _open_archive(self.path, self.call)  # raises where a store of another call has replaced this one
        capacity = {str(d): n for d, n in self.open().sizes.items() if d not in self.dims}
        part = xr.Dataset({name: _fitted(name, ds.variables[name], capacity) for name in self.variables})
        # chunks of zeros and NaN are also written, because a tile with a missing file is absent
        part.to_zarr(self.path, region=self.region(number), write_empty_chunks=True, **ZARR)
        mark = self.mark(number)
        mark.parent.mkdir(exist_ok=True)
        mark.write_text(f"{self.mark_of(number)} {json.dumps(versions())}")


def _fitted(name: str, variable: xr.Variable, capacity: Mapping[str, int]) -> xr.Variable:
    """Return values in the store's form: dimensions other than the grid's are filled up with NaN."""
    missing = {d: capacity.get(str(d), n) - n for d, n in variable.sizes.items()}
    if any(n < 0 for n in missing.values()):
        raise ValueError(
            f"A case has more values of `{name}` than the store has capacity for, {dict(variable.sizes)} in "
            f"{dict(capacity)}; keep fewer periods, or another record."
        )
    longer = {d: (0, n) for d, n in missing.items() if n}
    return _storable(variable.pad(longer, constant_values=np.nan) if longer else variable)


def _storable(variable: xr.Variable) -> xr.Variable:
    """Return a variable with texts of any length, which zarr's specification has."""
    return variable.astype(object) if variable.dtype.kind == "U" else variable


def _lengths(variable: xr.Variable, grid: Mapping[str, int]) -> tuple[int, ...]:
    """Return the lengths of a variable's dimensions: the grid's as given, and enough places for all crossings."""
    # the number of crossings differs from case to case
    crossings = variable.attrs.get("capacity") or variable.sizes.get("crossing")
    lengths = {**variable.sizes, "crossing": crossings, **grid}
    return tuple(lengths[d] for d in variable.dims)


def _create(path: Path, grid: Grid, tiles: Tiling, call: Mapping[str, object], like: xr.Dataset) -> None:
    """Write an empty store in the form of the results of one case.

    **Arguments:** `like`: a dataset over a grid of one case.
    """
    import zarr
    from zarr.codecs import ZstdCodec

    dims = list(grid.dims)
    axes = grid.coordinates()
    lengths = dict(zip(dims, tiles.shape, strict=True))
    pieces = dict(zip(dims, tiles.tile, strict=True))
    data = {name: _storable(v) for name, v in like.variables.items() if name not in axes}
    # a fill value would also be an attribute
    plain = {"_FillValue": None}
    encoding: dict[Any, dict[str, Any]] = dict.fromkeys(data, plain)
    shapes = {}
    for name, variable in data.items():
        # variables over the grid are filled tile by tile; other variables, such as labels, are the same in all tiles
        if set(dims) <= set(variable.dims):
            fill: Any = {"f": np.nan, "c": np.nan, "O": "", "b": False}.get(variable.dtype.kind, 0)
            fill = int(Status.NOT_RUN) if name == "status" else fill
            shapes[name] = _lengths(variable, lengths)
            data[name] = variable.copy(data=np.full(variable.shape, fill, variable.dtype))
            chunks = tuple(max(n, 1) for n in _lengths(variable, pieces))
            compressors = (ZstdCodec(level=3, checksum=True),)
            encoding[name] = plain | {"chunks": chunks, "fill_value": fill, "compressors": compressors}
    mark = {
        "call": call,
        "versions": versions(),
        "dims": dims,
        "shape": tiles.shape,
        "tile": tiles.tile,
        "coords": list(like.coords),
        "variables": {name: data[name].dims for name in sorted(shapes)},
    }
    xr.Dataset(data).to_zarr(path, mode="w-", encoding=encoding, write_empty_chunks=False, **ZARR)
    for name, whole_shape in shapes.items():  # afterwards, so that no array of the grid's size is in memory
        zarr.open_array(path / name, mode="r+").resize(whole_shape)
    ds = xr.Dataset(coords=axes, attrs=like.attrs)
    ds.to_zarr(path, mode="a", encoding=dict.fromkeys(axes, plain), **ZARR)
    zarr.open_group(path, mode="r+").update_attributes({MARK: json.dumps(mark)})


def _check_replaceable(path: Path) -> None:
    """Raise `ValueError` where the path has anything else than a store of slipperjax."""
    if not path.exists():
        return
    _open_archive(path)
    own = re.compile(r"([^/]+/)?(zarr\.json|marks/\d+|c(/\d+)*)(\..+\.partial)?")
    for file in path.rglob("*"):
        good = file.is_dir() or own.fullmatch(file.relative_to(path).as_posix())
        require(good, "store", "have no other files where it is made anew", shown=str(file))


def _make_archive(path: Path, *contents: object) -> Archive:
    """Make an empty store, completely or not at all, in place of an older store of slipperjax, if any.

    **Arguments:** `contents`: as for `_create`.

    """
    # made in a folder next to it and renamed, so that a crash leaves no incomplete store
    with TemporaryDirectory(".part", f".{path.name}.", path.parent, ignore_cleanup_errors=True) as part:
        _create(Path(part, "new"), *contents)
        if path.exists():  # deleted with the folder
            os.rename(path, Path(part, "old"))
        os.rename(Path(part, "new"), path)
    return _open_archive(path)


def _open_archive(path: Path, call: Mapping[str, object] | None = None) -> Archive:
    """Open an existing store.

    **Raises:** `ValueError` where it is no store of slipperjax, or where another call than `call` made it, with the
    differences.
    """
    try:
        content = content_of(path / DESCRIPTION)
        archive = Archive(path, _digest(content), **json.loads(json.loads(content)["attributes"][MARK]))
        archive.files(archive.tiles.count - 1)  # raises where shapes and dimensions do not fit together
    except (OSError, KeyError, ValueError, TypeError, RecursionError, AttributeError, ZeroDivisionError) as error:
        raise ValueError(f"{path}: must be a store of slipperjax, but is none: {error!r}") from None
    if call is None:
        return archive
    stored = dict(_leaves(archive.call))
    called = dict(_leaves(call))
    lines = []
    for name in stored | called:
        pair = [side.get(name, "nothing") for side in (stored, called)]
        if pair[0] != pair[1]:
            before, now = (text if len(text) <= 60 else f"{text[:57]}..." for text in pair)
            lines.append(f"{name}: {before} in the store, {now} asked")
    if lines:
        shown = "\n  ".join(lines[:10])
        raise ValueError(
            f"Argument `store` must be of the same call, but {path} was made by another one:\n  {shown}\n"
            "Take another path, or start over with slipperjax.sweeps.Store(path, fresh=True), on the command line "
            "--fresh."
        )
    return archive


def open_store(path: object) -> xr.Dataset:
    """Open a store as a dataset over its whole grid; values are read from disk when they are used.

    The store may be complete or still growing: missing cases have `Status.NOT_RUN` and NaN.

    **Raises:** `ValueError` for a path that is no store of slipperjax, or for a store that lacks more than tiles.
    """
    archive = _open_archive(user_path(path))
    ds = archive.open()
    del ds.attrs[MARK]
    # labels, such as the names of points, as in other datasets
    labels = {name: (name, np.array(ds[name].values.tolist())) for name in ds.indexes if ds[name].dtype.kind in "OT"}
    return ds.set_coords([n for n in archive.coords if n in ds.data_vars]).assign_coords(labels)


class StoreStatus(NamedTuple):
    """Progress of a store."""

    tiles: int
    tiles_done: int
    cases: int
    cases_done: int
    bytes: int
    """Bytes on disk."""

    def __str__(self) -> str:
        return (
            f"{self.cases_done} of {self.cases} cases ({self.cases_done / self.cases:.1%}), {self.tiles_done} of "
            f"{self.tiles} tiles, {shown_bytes(float(self.bytes))}"
        )


def store_status(path: object) -> StoreStatus:
    """Count the finished tiles and cases of a store, and its bytes, without reading results.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = _open_archive(user_path(path))
    done = int(archive.complete_tiles().sum())
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    return StoreStatus(
        archive.tiles.count,
        done,
        math.prod(archive.shape),
        archive.complete_cases(),
        size,
    )


def check_store(path: object) -> list[int]:
    """Read a whole store and delete the marks of damaged tiles, so that the same call computes them again.

    **Returns:** the numbers of these tiles.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = _open_archive(user_path(path))
    ds = archive.open()
    damaged = []
    for number in np.flatnonzero(archive.complete_tiles()).tolist():
        try:
            ds.isel(archive.region(number)).load()
        except Exception:  # checksums and codecs raise many kinds of errors
            archive.mark(number).unlink()
            damaged.append(number)
    return damaged


# --- locks ----------------------------------------------------------------------------------------------------------


def _lock_path(store: Path, share: tuple[int, int] | None = None) -> Path:
    """Return the lock of a store, or of a share of it."""
    store = store.resolve()  # one lock for a store, even with links to it
    return store.with_name(store.name + (".lock" if share is None else f".{share[0]}-of-{share[1]}.lock"))


@contextmanager
def _writing(store: Store) -> Iterator[None]:
    """Hold the right to write to a store, or to a share of it.

    **Raises:** `StoreInUse`; `OSError` where the folder is missing or read-only.
    """
    with _held(_lock_path(store.path, store.share)):
        if store.path.exists() and not os.access(store.path, os.W_OK):
            raise PermissionError(f"{store.path} is protected against writing")
        # a process that writes to the whole store must be alone: free locks of shares are taken and deleted
        shares = [] if store.share else store.path.resolve().parent.glob(f"{store.path.name}.*-of-*.lock")
        for other in shares:
            with _held(other):
                pass
        yield


@contextmanager
def _held(path: Path, seconds: float = 0.5) -> Iterator[None]:
    """Hold a lock and delete its file afterwards. **Arguments:** `seconds`: time to wait for the lock."""
    import filelock

    if not path.parent.is_dir():
        raise FileNotFoundError(f"No such folder: {path.parent}")
    lock = filelock.FileLock(path)
    try:
        lock.acquire(timeout=seconds)
    except filelock.Timeout:
        raise StoreInUse(
            f"Another process writes to {path.name.removesuffix('.lock')} (it holds {path}); wait for it or stop it, "
            "then call again: what it has finished is kept."
        ) from None
    except OSError as error:
        raise PermissionError(f"{path.parent} is protected against writing: {error}") from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # deleted while held: a waiting process then looks for a new file
        lock.release()


# --- sweeps into a store --------------------------------------------------------------------------------------------


def run_or_store(
    call: AbstractCall,
    scene: Scene,
    grid: Mapping[str, object],
    start: Motion | State,
    *,
    store: object = None,
    executor: object = None,
    **how: object,
) -> Result:
    """Compute a sweep, or open the store into which it is computed, tile by tile.

    **Arguments:** `store`: a path or a `Store`; None: all cases are computed here; `executor`: computes the tiles;
    None for threads of this process; `how`: `chunk`, `workers` and `progress`.

    **Raises:** `ValueError` where the store belongs to another call, with the differences; `StoreInUse` where another
    process writes to it; `Interrupted` after Ctrl-C, with the store as its result.
    """
    if store is None:
        require(executor is None, "executor", "come with `store`, to which its workers write", executor)
        return call.compute(scene, grid, start, **how)
    need = "be a dask.distributed.Client or a concurrent.futures.Executor"
    require(executor is None or callable(getattr(executor, "submit", None)), "executor", need, executor)
    # the start method of a ProcessPoolExecutor: JAX's programs wait for threads that a fork does not copy
    start_method = getattr(getattr(executor, "_mp_context", None), "get_start_method", lambda: "")()
    spawn = "mp_context=multiprocessing.get_context('spawn')"
    need = f"start new processes, as slipperjax.sweeps.processes() or {spawn} does"
    require(start_method != "fork", "executor", need, shown="one that forks this one, in whose copies JAX hangs")
    cases = Grid(scene, grid, product=call.product)
    with told_once():
        path = _stored(call, cases, start, Store.of(store), executor, **how)
    return Result(open_store(path))


def _stored(
    call: AbstractCall,
    grid: Grid,
    start: Motion | State,
    store: Store,
    executor: object,
    *,
    chunk: int | None,
    workers: int | None,
    progress: bool | None,
) -> Path:
    """Compute the missing tiles of a store, and return its path. Arguments as for `run_or_store`."""
    steps = call.steps_per_period
    grid.check_steps(steps)
    workers = None if workers is None else whole("workers", workers, 1)
    asked = _fingerprint(call, grid, start)
    # called twice: before and after the lock is taken
    is_made = lambda: store.path.exists() and not store.fresh
    if is_made() and _open_archive(store.path, asked).complete_tiles().all():
        return store.path  # without a lock, because the disk may be read-only
    # threads of this process compute one tile each; other processes may have several cores
    alone = executor is None
    threads = workers or cores() if alone else 1
    how = dict(
        chunk=chunk or largest_chunk(grid.scene),  # all of one size, so that a worker compiles its programs once
        workers=1 if alone else workers or 1,
        progress=False,  # one bar shows the tiles
    )

    def work_on(index: tuple[slice, ...]) -> Callable[[], Result]:
        """Return the function that computes a part of the grid."""
        # steps of each case are cut like the grid
        of_part = replace(call, steps_per_period=np.asarray(steps)[index]) if np.ndim(steps) else call
        return functools.partial(of_part.compute, grid.scene, grid.part(index), start, **how)

    with _writing(store):
        # a share waits until another share has made the store
        with _held(_lock_path(store.path), 60.0) if store.share else nullcontext():
            # read again, because another process may have made the store
            if is_made():
                archive = _open_archive(store.path, asked)
            else:
                tiles = Tiling.of(grid.shape, store.tile)
                shared = not alone or store.share is not None
                of_store = dict(tiles=tiles, workers=threads, shared=shared, free=store.free_bytes)
                replace(call.estimate(grid, start), **of_store).check()
                _check_replaceable(store.path)
                # one case first, so that a wrong argument deletes nothing
                try:
                    with progress_shown(1.0, 1, "first case", progress, delay=DELAY) as shown:
                        like = work_on(tuple(slice(1) for _ in grid.shape))().ds
                        shown(1.0, 1)
                except Interrupted:
                    raise Interrupted(None, 0, grid.count) from None
                archive = _make_archive(store.path, grid, tiles, asked, like)
        archive.open()  # raises where variables are missing
        # workers of an executor may have another working directory
        archive = replace(archive, path=store.path.absolute())
        if store.share is None:
            for part in archive.path.rglob("*.partial"):  # left by a killed process
                part.unlink()
        _warn_of_versions(archive)
        # LAPACK must not be called from two threads, and a device computes one batch at a time
        solver = resolve_solver(grid.scene, call.solver)
        one_by_one = calls_lapack(solver, True) or jax.default_backend() != "cpu"
        share, shares = store.share or (1, 1)
        missing = np.flatnonzero(~archive.complete_tiles())
        # each share computes every n-th tile, because neighbouring tiles take about equally long
        own = missing[missing % shares == share - 1].tolist()
        tiles = archive.tiles
        task = lambda k: functools.partial(_compute_tile, archive, k, work_on(tiles.region(k)), one_by_one)
        sizes = list(map(tiles.cases, own))
        total = sum(sizes)
        try:
            with progress_shown(total, total, "", progress) as shown:
                done = lambda k: shown(sizes[k], sizes[k])
                # wait for the end of the present calls of threads, because they write to the store
                gather(list(map(task, own)), threads, _pool_of(executor), done, patience=10.0)
        except KeyboardInterrupt:
            result = Result(open_store(archive.path))
            raise Interrupted(result, archive.complete_cases(), grid.count) from None
        except BrokenExecutor as error:
            stored = f"{archive.complete_cases()} cases or more are stored, call again to go on"
            raise WorkerLost(f"a worker process ended abruptly, for want of memory perhaps; {stored}") from error
    return store.path


def _warn_of_versions(archive: Archive) -> None:
    """Warn where a store was begun with other versions of packages, because last digits may differ."""
    before = archive.versions
    now = versions()
    other = [f"{name} {before.get(name)} and not {now[name]}" for name in now if before.get(name) != now[name]]
    if other:
        warn(
            f"The store {archive.path} was begun with {listed(other)}: tiles may differ by rounding, chaotic cases "
            f"altogether. The mark of each tile has its versions; fresh=True starts over."
        )


# --- workers --------------------------------------------------------------------------------------------------------


def _compute_tile(archive: Archive, number: int, work: Callable[[], Result], one_by_one: bool) -> None:
    """Compute a tile of a store and write it. A repeated call is harmless: it writes the same bytes.

    **Arguments:** `one_by_one`: whether a process may compute only one tile at a time.
    """
    # a store must not contain tiles of two versions
    if archive.call["code"]["slipperjax"] != IMPORTED:
        raise RuntimeError("a worker imported other code of slipperjax than the process that called it: restart both")
    if TOLD.get() is None:  # in another process
        TOLD.set(set())
    with _ALONE if one_by_one else nullcontext():
        ds = work().ds
    try:
        archive.write(number, ds)
    except OSError as error:
        cases = f"{archive.complete_cases()} of {math.prod(archive.shape)} cases are stored"
        text = f"cannot write to {archive.path}: {error.strerror or error}; {cases}, call again to go on"
        raise OSError(error.errno or errno.EIO, text) from None


def _pool_of(executor: object) -> object:
    """Return an executor with the interface of `concurrent.futures`, also for a client of dask."""
    if type(executor).__module__.split(".")[0] != "distributed":
        return executor
    # for dask, tasks of one function and argument are the same unless they are marked as impure
    return executor.get_executor(pure=False, retries=3)


def processes(count: int | None = None) -> ProcessPoolExecutor:
    """Return an executor of new processes that compute the tiles of a `store`, by default one per core.

    They use the compiled programs on disk of the process that made them, and end with this process. In a script the
    call must be under `if __name__ == "__main__":`, because new processes import the script.

    ```python
    with sj.sweeps.processes(2) as pool:
        ds = sj.sweep(scene, grid, store="map.zarr", executor=pool)
    ```

    **Raises:** `ValueError` for a count below one.
    """
    count = cores() if count is None else whole("count", count, 1, 4096)
    folders = kept_folder(), jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=folders)


def _begin(kept: Path | None, of_jax: str | None) -> None:
    """Prepare a new process, before JAX starts its threads.

    **Arguments:** folders of whole programs, and of JAX's cache; None where there is none.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that waits for the results handles Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()
    keep_in(kept)
    if of_jax is not None:
        keep_programs(Path(of_jax))


def _end_with_parent() -> None:
    """End this process when the process that started it has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
