"""Sweeps on disk: a zarr store whose tiles any executor computes, each complete or absent.

A tile is a block of the grid: one task, and one chunk of every array. It is complete where its digest and all of its
files are there; the digest is written last. The same call goes on where the last one ended, whatever ended it.
"""

import errno
import functools
import hashlib
import importlib
import inspect
import json
import math
import multiprocessing
import os
import shutil
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import numpy as np
import xarray as xr

from ..flow.datasets import versions
from ..flow.simulate import first_of
from ..flow.status import Interrupted, Status
from ..model.scene import Scene
from ..model.scene_files import scene_to_json
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.cache import compile_cache, keep_programs
from ..tools.checks import brief, require, warn, whole, yes_or_no
from ..tools.description import describe
from ..tools.limits import available_memory, cores, shown_bytes
from .grid import Grid
from .run import ARGUMENTS_WITHOUT_EFFECT, LARGEST_CHUNK, TICK, all_stopped, heed_interrupts, progress_shown

MARK = "slipperjax_store"
"""Attribute by which a store of ours is known: its identity, the call as JSON, and its tiles."""
DIGEST = "digest_of_tile"
"""Array of the tiles' digests, which are written last."""
COPIES = 3.0
"""How often results are in memory while a tile is put together and written."""
SMALLEST_TILE, LARGEST_TILE = 2048, 65_536
"""Cases in a tile where none is asked for: a few seconds of work, and few enough to lose in a crash."""
MOST_SMALL_TILES = 4096
"""Tiles above which they grow up to `LARGEST_TILE`: each has a file for every variable."""
RETRIES = 3
"""How often dask tries a task again that failed."""
LOCK_WAIT, SHARE_WAIT = 0.5, 60.0
"""Seconds for which a lock is waited for, and for which a share waits until another one has made the store."""
THREAD_PATIENCE = 10.0
"""Seconds after Ctrl-C that threads have to end the call that they are in."""
ZARR: Any = {"zarr_format": 3, "consolidated": False}
_ALONE = threading.Lock()

P = ParamSpec("P")
R = TypeVar("R")


class StoreInUse(OSError):
    """Another process writes to the store. Its lock ends with that process, however this ends."""


class WorkerLost(OSError):
    """A worker process ended, and its executor with it. What was finished is stored."""


@dataclass(frozen=True)
class Store:
    """A zarr store on a disk that all workers share.

    ```python
    sj.sweep(scene, grid, store=sj.Store("map.zarr", fresh=True))
    ```
    """

    path: Path
    tile: int | None = None
    """Cases, about, that are computed and written as one: what a crash can lose; default from the grid."""
    fresh: bool = False
    """Whether a store of slipperjax that is there is deleted first."""
    share: tuple[int, int] | None = None
    """(i, n): compute the i-th of n shares only, i from 1 to n, while other processes compute the others."""

    def __post_init__(self):
        path = Path(self.path)
        if path.suffix != ".zarr":
            raise ValueError(f"Argument `store` must be a path that ends in .zarr, but is {str(path)!r}.")
        object.__setattr__(self, "path", path)
        if self.tile is not None:
            whole("tile", self.tile, 1)
        yes_or_no("fresh", self.fresh)
        if self.share is not None:
            pair = isinstance(self.share, tuple | list) and len(self.share) == 2
            numbers = pair and all(isinstance(number, int) for number in self.share)
            good = numbers and 1 <= self.share[0] <= self.share[1]
            require(good, "share", "be (i, n) with i from 1 to n", self.share)
            object.__setattr__(self, "share", tuple(self.share))
            if self.fresh:
                raise ValueError("Argument `fresh` must be False for a share, whose store others write to.")

    @classmethod
    def of(cls, given: Any) -> "Store":
        """The store of an argument, a path or a `Store`."""
        if isinstance(given, Store):
            return given
        require(isinstance(given, str | Path), "store", "be a path or a slipperjax.Store", given)
        return Store(Path(given))


class Tiling(NamedTuple):
    """A grid as blocks of equal shape, cut off at its ends, numbered with the last dimension fastest."""

    shape: tuple[int, ...]
    """Of the grid."""
    tile: tuple[int, ...]
    """Of a block."""

    @classmethod
    def of(cls, shape: tuple[int, ...], size: int | None = None) -> "Tiling":
        """Blocks of about `size` cases, whole along the last dimensions.

        By default a block has `SMALLEST_TILE`, or more where there would be more than `MOST_SMALL_TILES` blocks.
        """
        if size is None:
            size = min(max(SMALLEST_TILE, math.prod(shape) // MOST_SMALL_TILES), LARGEST_TILE)
        tile, left = [1] * len(shape), size
        for k in reversed(range(len(shape))):
            pieces = -(-shape[k] // max(left, 1))
            tile[k] = -(-shape[k] // pieces)
            left //= shape[k]
        return cls(shape, tuple(tile))

    @property
    def counts(self) -> tuple[int, ...]:
        """Blocks along each dimension."""
        return tuple(-(-n // m) for n, m in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    def place(self, number: int) -> tuple[int, ...]:
        """Indices of a block along the dimensions, which name its files."""
        return tuple(int(k) for k in np.unravel_index(number, self.counts))

    def region(self, number: int) -> tuple[slice, ...]:
        """Slices of the grid that make up a block."""
        ends = zip(self.place(number), self.tile, self.shape, strict=True)
        return tuple(slice(k * m, min((k + 1) * m, n)) for k, m, n in ends)

    def cases(self, number: int) -> int:
        """Number of cases of a block."""
        return math.prod(part.stop - part.start for part in self.region(number))


# --- the call that a store is of ------------------------------------------------------------------------------------

LONGEST_TEXT = 60
"""Length from which a value is cut in a message."""


def _fingerprint(function: Any, grid: Grid, options: Mapping[str, Any], tiles: Tiling) -> dict[str, Any]:
    """The call as JSON, to recognise a store: all that determines its numbers."""
    arguments = {name: value for name, value in options.items() if name not in (*ARGUMENTS_WITHOUT_EFFECT, "product")}
    return {
        "function": function.__name__,
        "scene": json.loads(scene_to_json(grid.scene)),
        "grid": {name: _summary(values) for name, values in grid.axes.items()},
        "product": grid.product,
        "tile": list(tiles.tile),
        "arguments": {name: _as_json(value) for name, value in arguments.items()},
        "versions": {name: version for name, version in versions().items() if name != "python"},
    }


def _summary(values: np.ndarray) -> dict[str, Any]:
    """An axis in few numbers that tell it from others."""
    ends = {"values": len(values), "first": float(values[0]), "last": float(values[-1])}
    return ends | {"sha256": hashlib.sha256(np.ascontiguousarray(values, float).tobytes()).hexdigest()[:16]}


def _as_json(value: Any) -> Any:
    """A value as JSON holds it; a function by its name and a digest of its code."""
    if isinstance(value, np.ndarray) and value.size > LONGEST_TEXT:
        return _summary(value.ravel())
    return json.loads(json.dumps(describe(value)))


def _differences(stored: Any, asked: Any, path: str = "") -> list[str]:
    """Lines that say where two calls differ: "scene.contact.restitution: 0.9 in the store, 0.8 asked"."""
    if isinstance(stored, dict) and isinstance(asked, dict):
        lines = []
        for name in dict.fromkeys([*stored, *asked]):
            below = f"{path}.{name}" if path else str(name)
            lines += _differences(stored.get(name, "nothing"), asked.get(name, "nothing"), below)
        return lines
    texts = [value if isinstance(value, str) else json.dumps(value) for value in (stored, asked)]
    if texts[0] == texts[1]:  # NaN, too, is equal to itself here
        return []
    short = [text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 3]}..." for text in texts]
    return [f"{path}: {short[0]} in the store, {short[1]} asked"]


# --- the store on disk ----------------------------------------------------------------------------------------------


class Archive(NamedTuple):
    """A store that exists."""

    path: Path
    mark: dict[str, Any]
    """Content of its attribute `MARK`: `identity`, `call`, `dims`, `shape`, `tile`, `axes`, `coords`, `variables`."""

    @property
    def tiles(self) -> Tiling:
        """Its tiles."""
        return Tiling(tuple(self.mark["shape"]), tuple(self.mark["tile"]))

    def file(self, name: str, number: int, dims: Sequence[str]) -> Path:
        """The file of a variable that holds a tile."""
        at = dict(zip(self.mark["dims"], map(str, self.tiles.place(number)), strict=True))
        return self.path.joinpath(name, "c", *(at.get(d, "0") for d in dims))

    def digest_file(self, number: int) -> Path:
        """The file that is written last of a tile."""
        return self.file(DIGEST, number, self.mark["dims"])

    def complete_tiles(self) -> np.ndarray:
        """Whether each tile is complete: its digest is there, and so are all of its files."""
        count = self.tiles.count
        files = lambda number: (self.file(name, number, dims) for name, dims in self.variables.items())
        complete = lambda number: self.digest_file(number).is_file() and all(map(Path.is_file, files(number)))
        return np.fromiter(map(complete, range(count)), bool, count)

    def complete_cases(self, done: np.ndarray | None = None) -> int:
        """How many cases are in complete tiles, or in those of an earlier `complete_tiles()`."""
        return sum(self.tiles.cases(int(k)) for k in np.flatnonzero(self.complete_tiles() if done is None else done))

    def open(self) -> xr.Dataset:
        """All of it, digests and texts as they are stored."""
        return xr.open_zarr(self.path, chunks=None, mask_and_scale=False, **ZARR)

    @property
    def variables(self) -> dict[str, list[str]]:
        """Dimensions by name of the variables that tiles have a chunk of."""
        return self.mark["variables"]

    def digest(self, number: int) -> int:
        """The digest of a tile, of the bytes of its files.

        **Raises:** `FileNotFoundError` where one is missing.
        """
        total = hashlib.sha256(str(number).encode())
        for name, dims in self.variables.items():
            total.update(name.encode() + hashlib.sha256(self.file(name, number, dims).read_bytes()).digest())
        return int.from_bytes(total.digest()[:8], "big") >> 1

    def check_same(self) -> None:
        """Checks that no other store was put in this one's place, into which a worker of this one must not write.

        **Raises:** `OSError`.
        """
        with suppress(ValueError):
            if _open_archive(self.path).mark == self.mark:
                return
        raise OSError(errno.ESTALE, "another store was put in its place")

    def write(self, number: int, ds: xr.Dataset) -> None:
        """Writes the results of a tile, the digest last.

        **Raises:** `OSError` where the disk is full or protected; the tile is absent then.
        """
        dims = self.mark["dims"]
        region = dict(zip(dims, self.tiles.region(number), strict=True))
        capacity = {str(d): n for d, n in self.open().sizes.items() if d not in dims}
        self.check_same()
        part = xr.Dataset({name: _fitted(name, ds.variables[name], capacity) for name in self.variables})
        part.to_zarr(self.path, region=region, write_empty_chunks=True, **ZARR)
        self.check_same()
        value = np.full((1,) * len(dims), self.digest(number))
        place = {f"tile_{d}": slice(k, k + 1) for d, k in zip(dims, self.tiles.place(number), strict=True)}
        digest = xr.Dataset({DIGEST: (tuple(place), value)})
        digest.to_zarr(self.path, region=place, write_empty_chunks=True, **ZARR)

    def tidy(self, numbers: Sequence[int] | None = None) -> None:
        """Deletes what a killed process had not finished to write, of some tiles or of all of the store.

        Nobody else may be writing to them.
        """
        parts = self.path.rglob("*.partial")
        if numbers is not None:
            variables = self.variables | {DIGEST: self.mark["dims"]}
            files = (self.file(name, number, dims) for number in numbers for name, dims in variables.items())
            parts = (part for file in files for part in file.parent.glob(f"{file.name}.*.partial"))
        for part in parts:
            part.unlink(missing_ok=True)


def _fitted(name: str, variable: xr.Variable, capacity: Mapping[str, int]) -> xr.Variable:
    """Values as the store holds them: dimensions other than the grid's are filled up with NaN."""
    missing = {d: capacity.get(str(d), n) - n for d, n in variable.sizes.items()}
    if any(n < 0 for n in missing.values()):
        raise ValueError(
            f"A case has more values of `{name}` than the store has capacity for, {dict(variable.sizes)} in "
            f"{dict(capacity)}; keep fewer periods, or another record."
        )
    longer = {d: (0, n) for d, n in missing.items() if n}
    return _storable(variable.pad(longer, constant_values=np.nan) if longer else variable)


def _storable(variable: xr.Variable) -> xr.Variable:
    """With texts of any length, which zarr's specification knows."""
    return variable.astype(np.dtypes.StringDType()) if variable.dtype.kind in "UO" else variable


def _create(path: Path, grid: Grid, tiles: Tiling, call: Mapping[str, Any], like: xr.Dataset) -> None:
    """Writes an empty store in the form of one case's results."""
    import zarr
    from zarr.codecs import ZstdCodec

    axes, dims = grid.coordinates(), list(grid.dims)
    lengths, pieces = dict(zip(dims, tiles.shape, strict=True)), dict(zip(dims, tiles.tile, strict=True))
    data, encoding, shapes, compressors = {}, {}, {}, (ZstdCodec(level=3, checksum=True),)
    for name, variable in like.variables.items():
        if name in axes:
            continue
        data[name] = variable = _storable(variable)
        if set(dims) <= set(variable.dims):
            fill: Any = {"f": np.nan, "c": np.nan, "T": "", "b": False}.get(variable.dtype.kind, 0)
            fill = int(Status.NOT_RUN) if name == "status" else fill
            # the number of crossings differs from case to case
            inner = {**variable.sizes, "crossing": variable.attrs.get("capacity") or variable.sizes.get("crossing")}
            shapes[name] = tuple(lengths.get(d) or inner[d] for d in variable.dims)
            data[name] = variable.copy(data=np.full(variable.shape, fill, variable.dtype))
            chunks = tuple(max(pieces.get(d) or inner[d], 1) for d in variable.dims)
            encoding[name] = {
                "chunks": chunks,
                "fill_value": fill,
                "compressors": compressors,
            }
    ones, shapes[DIGEST] = (1,) * len(dims), tiles.counts
    label = {"long_name": "digest of the files of a tile"}
    data[DIGEST] = xr.Variable([f"tile_{d}" for d in dims], np.zeros(ones, np.int64), label)
    encoding[DIGEST] = {"chunks": ones, "fill_value": 0}
    shape: dict[str, Any] = {"dims": dims, "shape": list(tiles.shape), "tile": list(tiles.tile)}
    names: dict[str, Any] = {"axes": list(axes), "coords": [n for n in like.coords if n not in axes]}
    names["variables"] = {name: list(data[name].dims) for name in sorted(shapes) if name != DIGEST}
    mark = {"identity": uuid.uuid4().hex, "call": dict(call), **shape, **names}
    for name in data:
        encoding.setdefault(name, {})["_FillValue"] = None  # else it would be an attribute, too
    xr.Dataset(data).to_zarr(path, mode="w-", encoding=encoding, write_empty_chunks=False, **ZARR)
    for name, whole_shape in shapes.items():  # afterwards, so that nothing of the size of the grid is in memory
        zarr.open_array(path / name, mode="r+").resize(whole_shape)
    ds = xr.Dataset(coords=axes, attrs=like.attrs | {MARK: json.dumps(mark)})
    ds.to_zarr(path, mode="a", encoding={name: {"_FillValue": None} for name in axes}, **ZARR)


def _make_archive(path: Path, grid: Grid, tiles: Tiling, call: Mapping[str, Any], like: xr.Dataset) -> Archive:
    """Makes an empty store, whole or not at all, in place of one of ours that may be there.

    **Arguments:** `call`: its fingerprint; `like`: the results of one case.
    """
    for part in path.parent.glob(f".{path.name}.*.part"):  # of processes that were killed
        shutil.rmtree(part, ignore_errors=True)
    new, old = (path.with_name(f".{path.name}.{kind}-{os.getpid()}.part") for kind in ("new", "old"))
    try:
        _create(new, grid, tiles, call, like)
        if path.exists():
            os.rename(path, old)
        os.rename(new, path)
    finally:
        for part in (new, old):
            shutil.rmtree(part, ignore_errors=True)
    return _open_archive(path)


def _open_archive(path: Path) -> Archive:
    """Opens a store that exists.

    **Raises:** `ValueError` where it is none of ours.
    """
    try:
        attributes = json.loads((path / "zarr.json").read_text())["attributes"]
        return Archive(path, json.loads(attributes[MARK]))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise ValueError(f"{path}: must be a store of slipperjax, but is none: {error!r}") from None


def open_store(path: Any) -> xr.Dataset:
    """Opens a store as a dataset over its whole grid, whose values are read from disk when they are asked for.

    It may be complete, or still growing: cases that are not there yet have `Status.NOT_RUN` and NaN.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = _open_archive(Path(path))
    ds = archive.open().drop_vars(DIGEST)
    del ds.attrs[MARK]
    # labels, such as those of points, as other datasets have them
    labels = {name: (name, np.array(ds[name].values.tolist())) for name in ds.indexes if ds[name].dtype.kind == "T"}
    return ds.set_coords([n for n in archive.mark["coords"] if n in ds.data_vars]).assign_coords(labels)


class StoreStatus(NamedTuple):
    """How far a store is."""

    tiles: int
    tiles_done: int
    cases: int
    cases_done: int
    bytes: int
    """On disk."""

    def __str__(self) -> str:
        return (
            f"{self.cases_done} of {self.cases} cases ({self.cases_done / self.cases:.1%}), {self.tiles_done} of "
            f"{self.tiles} tiles, {shown_bytes(float(self.bytes))}"
        )


def store_status(path: Any) -> StoreStatus:
    """Counts how much of a store is done, without reading results.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = _open_archive(Path(path))
    done = archive.complete_tiles()
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    return StoreStatus(len(done), int(done.sum()), math.prod(archive.tiles.shape), archive.complete_cases(done), size)


def check_store(path: Any, *, repair: bool = False) -> list[str]:
    """Reads all of a store, and gives a line for whatever is wrong: files missing, cut short, changed or swapped.

    **Arguments:** `repair`: make damaged tiles absent, so that the same call as before computes them again.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive, lines = _open_archive(Path(path)), []
    ds = archive.open()
    for name, axis in zip(archive.mark["axes"], archive.mark["call"]["grid"].values(), strict=True):
        if _summary(ds[name].values) != axis:
            lines.append(f"the values of {name} are not those of the call: start over with fresh=True")
    for number in range(archive.tiles.count):
        if not archive.digest_file(number).is_file():
            continue
        try:
            place = archive.tiles.place(number)
            stored, actual = int(ds[DIGEST].variable[place].values), archive.digest(number)
            problem = None if stored == actual else _culprit(archive, number)
        except FileNotFoundError as error:
            problem = f"{error.filename} is missing"
        if problem is not None:
            lines.append(f"tile {number}: {problem}")
            if repair:
                archive.digest_file(number).unlink(missing_ok=True)
    return lines


def _culprit(archive: Archive, number: int) -> str:
    """Says which file of a tile is not as it was written, as far as checksums tell."""
    ds, region = archive.open(), dict(zip(archive.mark["dims"], archive.tiles.region(number), strict=True))
    for name, dims in archive.variables.items():
        try:
            ds[name].isel(region).load()
        except Exception as error:  # codecs raise many kinds of errors
            return f"{archive.file(name, number, dims)} cannot be read: {error}"
    return "its files are not those that were written"


# --- locks ----------------------------------------------------------------------------------------------------------


@contextmanager
def _writing(store: Store) -> Iterator[None]:
    """Holds the right to write to a store, or to a share of it.

    **Raises:** `StoreInUse`; `OSError` where the folder is missing or read-only.
    """
    with _held(_lock_path(store.path, store.share)):
        if store.share is None:
            for other in store.path.parent.glob(f"{store.path.name}.*-of-*.lock"):
                with _held(other):
                    pass
        yield


def _lock_path(store: Path, share: tuple[int, int] | None = None) -> Path:
    return store.with_name(store.name + (".lock" if share is None else f".{share[0]}-of-{share[1]}.lock"))


@contextmanager
def _held(path: Path, seconds: float = LOCK_WAIT) -> Iterator[None]:
    """Holds a lock, and deletes its file afterwards."""
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
        if isinstance(error, PermissionError) or error.errno == errno.EROFS:
            raise PermissionError(f"{path.parent} is protected against writing") from None
        raise
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: who waits for it then looks for a new one
        lock.release()


# --- sweeps into a store --------------------------------------------------------------------------------------------


def storable(function: Callable[P, R]) -> Callable[P, R]:
    """Gives a sweep the arguments `store` and `executor`, which are handled here.

    The function takes `scene` and `grid`, then keywords, `product`, `workers`, `chunk` and `progress` among them, and
    gives a dataset over the grid in which no case depends on another.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Any:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        options = dict(bound.arguments)
        store, executor = options.pop("store"), options.pop("executor")
        if store is None:
            if executor is not None:
                raise ValueError("Argument `executor` needs `store`, to which its workers write.")
            return function(*args, **kwargs)
        return _stored(function, options.pop("scene"), options.pop("grid"), options, Store.of(store), executor)

    return call


@dataclass(frozen=True)
class _Task:
    """Computes a tile of a store and writes it; it can be pickled if its options can."""

    archive: Archive
    function: str
    """Module and name, as in "slipperjax.sweeps.sweep:sweep"."""
    scene: Scene
    options: Mapping[str, Any]
    alone: bool
    """Whether a process may compute one tile at a time only."""

    def __call__(self, number: int, values: Mapping[str, np.ndarray], steps: Any) -> None:
        """Calling it again is harmless: it writes the same bytes.

        **Arguments:** `values`, `steps`: of the tile, by name of the grid and as `steps_per_period`.
        """
        with _ALONE if self.alone else nullcontext():
            ds = _part(self.function, self.scene, values, self.options, steps)
        try:
            self.archive.write(number, ds)
        except OSError as error:
            cases = f"{self.archive.complete_cases()} of {math.prod(self.archive.tiles.shape)} cases are stored"
            raise OSError(
                error.errno,
                f"cannot write to {self.archive.path}: {error.strerror or error}; {cases}, call again to go on",
            ) from None


def _part(function: str, scene: Scene, values: Mapping[str, Any], options: Mapping[str, Any], steps: Any) -> Any:
    """Results for the values of a part of a grid."""
    module, _, name = function.partition(":")
    more = {"steps_per_period": steps} if "steps_per_period" in options else {}
    return getattr(importlib.import_module(module), name)(scene, grid=dict(values), **{**options, **more})


def _stored(
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
    known = Grid(scene, grid, product=options.get("product", True))
    steps: Any = options.get("steps_per_period")
    known.check_steps(steps)
    workers = options.get("workers")
    workers = None if workers is None else whole("workers", workers, 1)
    # a trajectory may be long, and every worker gets its first state only
    options = {**options, **({"start": first_of(options["start"])} if "start" in options else {})}
    tiles = _tiling(known, store)
    call = json.loads(json.dumps(_fingerprint(function, known, options, tiles)))
    if not store.fresh and store.path.exists():
        archive = _checked_archive(store.path, call)
        if archive.complete_tiles().all():
            return open_store(store.path)  # on a disk, perhaps, that is protected against writing
    # threads of this process compute a tile each; other processes may have several cores. Chunks are of one size, so
    # that a worker compiles its programs once
    threads = 1 if executor is None else (workers or 1)
    chunk = options.get("chunk") or LARGEST_CHUNK
    inside = {**options, "workers": threads, "progress": False, "chunk": chunk}
    name = f"{function.__module__}:{function.__qualname__}"
    # LAPACK must not be called from two threads, and a device computes one batch at a time
    alone = calls_lapack(resolve_solver(scene, options.get("solver")), True) or jax.default_backend() != "cpu"
    steps_of = lambda region: np.asarray(steps)[region] if np.ndim(steps) else steps
    with _writing(store):
        with nullcontext() if store.share is None else _held(_lock_path(store.path), SHARE_WAIT):
            if store.fresh or not store.path.exists():
                _check_replaceable(store.path)
                # first of all one case, so that a wrong argument deletes nothing
                corner = tuple(slice(1) for _ in known.shape)
                try:
                    like = _part(name, scene, known.part(corner), inside, steps_of(corner))
                except Interrupted:
                    raise Interrupted(None, 0, known.count) from None
                _check_capacity(like, known.count, tiles, store, 1 if executor is not None else workers or cores())
                archive = _make_archive(store.path, known, tiles, call, like)
            else:
                archive = _checked_archive(store.path, call)
        task = _Task(archive._replace(path=store.path.absolute()), name, scene, inside, alone)
        done = archive.complete_tiles()
        share, shares = store.share or (1, 1)
        todo = [k for k in range(tiles.count) if not done[k] and k % shares == share - 1]
        archive.tidy(None if store.share is None else todo)
        parts = ((k, known.part(tiles.region(k)), steps_of(tiles.region(k))) for k in todo)
        try:
            _run_tasks(
                task, list(parts), executor, workers, bool(options.get("progress")), archive.complete_cases(done)
            )
        except KeyboardInterrupt:
            raise Interrupted(open_store(store.path), archive.complete_cases(), known.count) from None
    return open_store(store.path)


def _tiling(grid: Grid, store: Store) -> Tiling:
    """Tiles as asked; otherwise as in the store, if there is one of this shape."""
    if store.tile is None and not store.fresh and store.path.exists():
        tiles = _open_archive(store.path).tiles
        if tiles.shape == grid.shape:
            return tiles
    return Tiling.of(grid.shape, store.tile)


def _checked_archive(path: Path, call: Mapping[str, Any]) -> Archive:
    """Opens a store of this call.

    **Raises:** `ValueError` that shows the differences where it was made by another call.
    """
    archive = _open_archive(path)
    lines = _differences(archive.mark["call"], call)
    if lines:
        shown = "\n  ".join(lines[:10] + [f"and {len(lines) - 10} more"] * (len(lines) > 10))
        raise ValueError(
            f"Argument `store` must be of the same call, but {path} was made by another one:\n  {shown}\n"
            "Take another path, or start over with slipperjax.Store(path, fresh=True), on the command line --fresh."
        )
    return archive


def _check_replaceable(path: Path) -> None:
    """Refuses to delete anything but a store of ours, and anything through a link.

    **Raises:** `ValueError`.
    """
    if path.is_symlink():
        raise ValueError(
            f"Argument `store` must be no link where it is made anew, but {path} leads to {path.resolve()}."
        )
    if path.exists():
        _open_archive(path)


def _check_capacity(like: xr.Dataset, count: int, tiles: Tiling, store: Store, threads: int) -> None:
    """Refuses tiles that do not fit into memory, and warns of a store that may not fit on its disk.

    **Arguments:** `like`: the results of one case.
    """
    size, memory = math.prod(tiles.tile), available_memory()
    needed = COPIES * like.nbytes * size * threads
    if memory is not None and needed > memory:
        raise ValueError(
            f"Argument `store` must have tiles that fit into memory, but {threads} at once of {size} cases "
            f"need {shown_bytes(needed)}, of which {shown_bytes(float(memory))} are available: take smaller "
            "ones, slipperjax.Store(path, tile=...), or keep less of each case."
        )
    free = float(shutil.disk_usage(store.path.absolute().parent).free)
    if like.nbytes * count > free:
        warn(
            f"The store has {shown_bytes(float(like.nbytes * count))} before it is compressed, and its disk has "
            f"{shown_bytes(free)}: see slipperjax.explain, and keep less of each case where it does not fit."
        )


# --- workers --------------------------------------------------------------------------------------------------------


def _run_tasks(task: _Task, parts: list, executor: Any, workers: int | None, progress: bool, before: int) -> None:
    """Computes tiles, in any order.

    **Arguments:** `parts`: arguments of the task; `executor`: a `concurrent.futures.Executor`, a
    `dask.distributed.Client`, or None for `workers` threads of this process; `before`: cases that were stored before.

    **Raises:** `KeyboardInterrupt` after Ctrl-C; `WorkerLost`; the error of a task.
    """
    sizes = {number: task.archive.tiles.cases(number) for number, *_ in parts}
    cases, name = sum(sizes.values()), f"{before} cases stored before" if before else ""
    if not parts:
        return
    with _pool(executor, workers) as pool, progress_shown(cases, cases, name, progress) as shown:
        futures = {pool.submit(task, *part): part[0] for part in parts}
        try:
            while futures:
                for future in wait(futures, TICK, "FIRST_COMPLETED").done:
                    future.result()
                    size = sizes[futures.pop(future)]
                    shown(size, size)
                heed_interrupts()
        except BaseException as error:
            for future in futures:
                future.cancel()
            if isinstance(error, BrokenExecutor):
                stored = f"{task.archive.complete_cases()} cases or more are stored, call again to go on"
                raise WorkerLost(f"a worker process ended abruptly, for want of memory perhaps; {stored}") from error
            raise


@contextmanager
def _pool(executor: Any, workers: int | None) -> Iterator[Any]:
    """The executor of tiles: as given, of a dask client, or threads, which end soon after an error or Ctrl-C."""
    if executor is not None:
        # tasks of one function and argument are the same to dask unless they are said to be impure
        dask = type(executor).__module__.split(".")[0] == "distributed"
        yield executor.get_executor(pure=False, retries=RETRIES) if dask else executor
        return
    pool = ThreadPoolExecutor(cores() if workers is None else workers)
    try:
        yield pool
    except BaseException:
        with all_stopped():
            pool.shutdown(wait=False, cancel_futures=True)
            until = time.monotonic() + THREAD_PATIENCE
            while any(thread.is_alive() for thread in pool._threads) and time.monotonic() < until:
                time.sleep(TICK / 5)
        raise
    pool.shutdown()


def processes(count: int | None = None) -> ProcessPoolExecutor:
    """Makes an executor of spawned processes for `store`, one for each group of cores; default one per core.

    Programs that are kept on disk, see `slipperjax.compile_cache`, are kept for them, too. They end with the process
    that made them, however it ends. In a script it belongs under `if __name__ == "__main__":`, because new processes
    import the script.

    ```python
    with sj.processes(2) as pool:
        ds = sj.sweep(scene, grid, store="map.zarr", executor=pool)
    ```

    **Raises:** `ValueError` for fewer than one.
    """
    count = cores() if count is None else whole("count", count, 1)
    context = multiprocessing.get_context("spawn")
    folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    begun = (context.Value("i", 0), _core_groups(count), None if folder is None else str(folder))
    return ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=begun)


def _core_groups(count: int) -> list[list[int]]:
    """Cores for each process, as equal as they can be; processes above the number of cores share them."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    own = sorted(os.sched_getaffinity(0))
    return [own[k * len(own) // count : (k + 1) * len(own) // count] or [own[k % len(own)]] for k in range(count)]


def _begin(counter, groups: list[list[int]], folder: str | None) -> None:
    """Prepares a new process, before JAX starts its threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the business of who waits for the results
    threading.Thread(target=_end_with_parent, daemon=True).start()
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


def _end_with_parent() -> None:
    """Ends this process when the one that started it has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
