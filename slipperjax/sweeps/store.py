"""Sweeps on disk: a zarr store whose tiles any executor computes, each complete or absent.

A tile is a block of the grid: one task, and one chunk of every array. It is complete where its digest and all of its
files are there; the digest is written last. The same call goes on where the last one ended, whatever ended it.
"""

import errno
import functools
import glob
import hashlib
import html
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
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import numpy as np
import xarray as xr
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

from ..flow.datasets import versions
from ..flow.simulate import first_of
from ..flow.status import Interrupted, Status, Stop
from ..model.scene import at_speed
from ..model.scene_files import scene_to_json
from ..solvers.latching import calls_lapack
from ..solvers.named import resolve_solver
from ..tools.cache import compile_cache, keep_programs
from ..tools.checks import TOLD, require, warn, whole, yes_or_no
from ..tools.code import IMPORTED, classes_of, code_digest
from ..tools.description import describe, type_name
from ..tools.files import content_of, listed, readable, user_path
from ..tools.limits import cores, shown_bytes
from .estimate import STORE, CountedEstimate
from .grid import Grid, Tiling
from .run import ARGUMENTS_WITHOUT_EFFECT, LARGEST_CHUNK, TICK, heed_interrupts, progress_shown

MARK = "slipperjax_store"
"""Attribute by which a store of ours is known: its identity, the call as JSON, and its tiles."""
DIGEST = "digest_of_tile"
"""Array of the tiles' digests, which are written last."""
VERSIONS = "versions_of_tile"
"""Array of the versions of packages with which tiles were computed, as JSON."""
RETRIES = 3
"""How often dask tries a task again that failed."""
LOCK_WAIT, SHARE_WAIT = 0.5, 60.0
"""Seconds for which a lock is waited for, and for which a share waits until another one has made the store."""
MOST_TILES = 10**8
"""Tiles of one store: each is some files."""
MOST_PROCESSES = 4096
"""Processes of one executor."""
THREADS_WAIT = 10.0
"""Seconds after Ctrl-C that threads have to end the call that they are in."""
ZARR: Any = {"zarr_format": 3, "consolidated": False}
IMPORTED_BY = os.getpid()
"""Process that imported this module; in a forked copy, the one that was copied."""
_ALONE = threading.Lock()
_TOLD: dict[str, set[str]] = {}
"""Warnings that this process has given, by identity of the store."""

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
        require(isinstance(self.path, str | os.PathLike), "store", "be a path that ends in .zarr", self.path)
        object.__setattr__(self, "path", user_path(self.path))
        require(self.path.suffix == ".zarr", "store", "be a path that ends in .zarr", str(self.path))
        if self.tile is not None:
            whole("tile", self.tile, 1)
        yes_or_no("fresh", self.fresh)
        if self.share is not None:
            pair = isinstance(self.share, tuple | list) and [type(number) for number in self.share] == [int, int]
            require(pair and 1 <= self.share[0] <= self.share[1], "share", "be (i, n) with i from 1 to n", self.share)
            object.__setattr__(self, "share", tuple(self.share))
            require(not self.fresh, "fresh", "be False for a share, whose store others write to", self.fresh)

    @classmethod
    def of(cls, store: Any) -> "Store":
        """The store of an argument, a path or a `Store`."""
        require(isinstance(store, str | Path | Store), "store", "be a path or a slipperjax.Store", store)
        return store if isinstance(store, Store) else Store(Path(store))

    def _repr_html_(self) -> str:
        status: Any = "nothing yet"
        with suppress(ValueError):
            status = store_status(self.path)
        return f"<b>Store: {html.escape(str(self.path))}</b><br>{status}"

    @property
    def free_bytes(self) -> float:
        """Bytes that are free on its disk."""
        folder = next(folder for folder in self.path.absolute().parents if folder.exists())
        return float(shutil.disk_usage(folder).free)


# --- the call that a store is of ------------------------------------------------------------------------------------

LONGEST_TEXT = 60
"""Length from which a value is cut in a message."""


def _fingerprint(function: Any, grid: Grid, options: Mapping[str, Any], tiles: Tiling) -> dict[str, Any]:
    """The call as JSON, to recognise a store: all that determines its numbers."""
    arguments = {name: value for name, value in options.items() if name not in (*ARGUMENTS_WITHOUT_EFFECT, "product")}
    code = {"slipperjax": IMPORTED}
    code |= {type_name(kind): code_digest(kind) for kind in classes_of([grid.scene, arguments])}
    call = {
        "function": function.__name__,
        "scene": json.loads(scene_to_json(grid.scene)),
        "grid": {name: _summary(values) for name, values in grid.axes.items()},
        "product": grid.product,
        "tile": tiles.tile,
        "arguments": {name: _described(value) for name, value in arguments.items()},
        "code": code,
    }
    return json.loads(json.dumps(call))


def _summary(values: np.ndarray) -> dict[str, Any]:
    """An axis in few numbers that tell it from others."""
    ends = {"values": len(values), "first": float(values[0]), "last": float(values[-1])}
    return ends | {"sha256": _sha(np.ascontiguousarray(values, float).tobytes())}


def _described(value: Any) -> Any:
    """A value as plain data; a function by its name and a digest of its code, a long array by a summary."""
    long = isinstance(value, np.ndarray) and value.size > LONGEST_TEXT
    return _summary(value.ravel()) if long else describe(value)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """The texts of a call by their paths, such as scene.contact.restitution."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _leaves(part, f"{path}.{name}".strip("."))
    else:
        yield path, value if isinstance(value, str) else json.dumps(value)  # in which NaN is equal to itself


# --- the store on disk ----------------------------------------------------------------------------------------------


class Archive(NamedTuple):
    """A store that exists."""

    path: Path
    # Content of its attribute `MARK`: `identity`, `call`, `versions`, `dims`, `shape`, `tile`, `axes`, `coords`, the
    # dimensions of the `variables` that tiles have a chunk of, and digests of the `common` files, of no tile.
    mark: dict[str, Any]

    @property
    def tiles(self) -> Tiling:
        """Its tiles."""
        return Tiling(tuple(self.mark["shape"]), tuple(self.mark["tile"]))

    def place(self, number: int) -> dict[str, slice]:
        """Slices of the dimensions of `VERSIONS` and `DIGEST` that make up a tile."""
        dims, at = self.mark["dims"], self.tiles.indices(number)
        return {f"tile_{d}": slice(k, k + 1) for d, k in zip(dims, at, strict=True)}

    def region(self, number: int) -> dict[str, slice]:
        """Slices of the dimensions that make up a tile."""
        return dict(zip(self.mark["dims"], self.tiles.region(number), strict=True))

    def files(self, number: int) -> dict[str, Path]:
        """The files of a tile by variable, that of the digest last."""
        at = dict(zip(self.mark["dims"], map(str, self.tiles.indices(number)), strict=True))
        variables = self.mark["variables"] | dict.fromkeys((VERSIONS, DIGEST), self.mark["dims"])
        return {
            name: self.path.joinpath(name, "c", *(at.get(d, "0") for d in dims)) for name, dims in variables.items()
        }

    def complete_tiles(self) -> np.ndarray:
        """Whether each tile is complete: its digest is there, and so are all of its files."""
        complete = lambda number: all(file.is_file() for file in reversed(self.files(number).values()))
        return np.fromiter(map(complete, range(self.tiles.count)), bool, self.tiles.count)

    def complete_cases(self, done: np.ndarray | None = None) -> int:
        """How many cases are in complete tiles, or in those of an earlier `complete_tiles()`."""
        return sum(self.tiles.cases(int(k)) for k in np.flatnonzero(self.complete_tiles() if done is None else done))

    def open(self) -> xr.Dataset:
        """All of it, digests and texts as they are stored.

        **Raises:** `ValueError` where zarr or xarray cannot read it.
        """
        with readable(self.path, "zarr store"):
            return xr.open_zarr(_regular_files(self.path), chunks=None, mask_and_scale=False, **ZARR)

    def digest(self, number: int, of_versions: str) -> int:
        """The digest of a tile: of the store's call, its versions, and the bytes of its files.

        **Raises:** `FileNotFoundError` where one is missing.
        """
        total = hashlib.sha256(json.dumps([self.mark["call"], number, of_versions], sort_keys=True).encode())
        for name, file in self.files(number).items():
            if name in self.mark["variables"]:
                total.update(name.encode() + hashlib.sha256(file.read_bytes()).digest())
        return int.from_bytes(total.digest()[:8], "big") >> 1

    def common_damage(self) -> list[str]:
        """Says which of the files that belong to no tile, such as axes, are missing or changed."""
        changed = lambda file, digest: not file.is_file() or _sha(file.read_bytes()) != digest
        names = [name for name, digest in self.mark.get("common", {}).items() if changed(self.path / name, digest)]
        return [f"{self.path / name} is missing or changed: start over with fresh=True" for name in names]

    def damage(self, number: int, ds: xr.Dataset) -> str | None:
        """Says what is wrong with a tile whose digest is there, as far as checksums tell; None where nothing is."""
        files, of_tile = self.files(number), {}
        for file in files.values():  # a pipe or a device would be read for ever
            if not file.is_file():
                return f"{file} is {'no file' if file.exists() else 'missing'}"
        for name in (VERSIONS, DIGEST):
            try:
                of_tile[name] = ds[name].isel(self.place(number)).values.item()
            except Exception as error:
                return f"{files[name]} cannot be read: {error}"
        if of_tile[DIGEST] == self.digest(number, of_tile[VERSIONS]):
            return None
        for name in self.mark["variables"]:
            try:
                ds[name].isel(self.region(number)).load()
            except Exception as error:  # codecs raise many kinds of errors
                return f"{files[name]} cannot be read: {error}"
        return "its files are not those that were written"

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
        capacity = {str(d): n for d, n in self.open().sizes.items() if d not in dims}
        self.check_same()
        part = xr.Dataset({name: _fitted(name, ds.variables[name], capacity) for name in self.mark["variables"]})
        part.to_zarr(self.path, region=self.region(number), write_empty_chunks=True, **ZARR)
        self.check_same()
        place, of_versions = self.place(number), json.dumps(versions())
        values = {VERSIONS: np.array(of_versions, object), DIGEST: self.digest(number, of_versions)}
        one = xr.Dataset({name: (tuple(place), np.full((1,) * len(place), value)) for name, value in values.items()})
        one.to_zarr(self.path, region=place, write_empty_chunks=True, **ZARR)

    def tidy(self, numbers: Collection[int] | None = None) -> None:
        """Deletes what a killed process had not finished to write, of some tiles or of all of the store.

        Nobody else may be writing to them.
        """
        own = self.own_files(range(self.tiles.count) if numbers is None else numbers)
        for part in self.path.rglob("*.partial"):
            if _whole_name(part) in own:
                part.unlink(missing_ok=True)

    def own_files(self, numbers: Iterable[int]) -> set[Path]:
        """The files of some tiles, and those of no tile, without their endings."""
        of_tiles = {file for number in numbers for file in self.files(number).values()}
        return of_tiles | {_whole_name(self.path / name) for name in ("zarr.json", *self.mark.get("common", ()))}

    def check_own(self) -> None:
        """Checks that nothing is in the store but its own files.

        **Raises:** `ValueError` that names another one.
        """
        own = self.own_files(range(self.tiles.count))
        for file in self.path.rglob("*"):
            is_own = _whole_name(file) in own and file.suffix in ("", ".json", ".partial")
            if file.is_symlink() or not (is_own or file.is_dir()):
                raise ValueError(f"Argument `store` must hold nothing else where it is made anew, but has {file}.")


def _regular_files(path: Path) -> Any:
    """Returns what zarr reads a store by, which refuses links, devices and pipes, some of which never end."""
    from zarr.storage import LocalStore

    class RegularFiles(LocalStore):
        async def get(self, key, prototype=None, byte_range=None):
            file = self.root / key
            if file.is_symlink() or (file.exists() and not file.is_file()):
                raise OSError(f"{file} is no regular file")
            return await super().get(key, prototype, byte_range)

    return RegularFiles(path, read_only=True)


def _whole_name(file: Path) -> Path:
    """A file's name without its ending; of one that was not finished, that of the whole one."""
    return file.parent / file.name.partition(".")[0]


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
    return variable.astype(object) if variable.dtype.kind == "U" else variable


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _lengths(variable: xr.Variable, grid: Mapping[str, int]) -> tuple[int, ...]:
    """Lengths of a variable's dimensions, with the grid's as given, and with capacity for all crossings."""
    # the number of crossings differs from case to case
    crossings = variable.attrs.get("capacity") or variable.sizes.get("crossing")
    lengths = {**variable.sizes, "crossing": crossings, **grid}
    return tuple(lengths[d] for d in variable.dims)


def bytes_of_case(ds: xr.Dataset, dims: Sequence[str], axes: Collection[str]) -> float:
    """Bytes of the results of a case that a store keeps.

    **Arguments:** `dims`, `axes`: dimensions of the grid, and names of its coordinates.
    """
    one = dict.fromkeys(dims, 1)
    variables = [v for name, v in ds.variables.items() if name not in axes and set(dims) <= set(v.dims)]
    return float(sum(v.dtype.itemsize * math.prod(_lengths(v, one)) for v in variables))


def _create(path: Path, grid: Grid, tiles: Tiling, call: Mapping[str, Any], like: xr.Dataset) -> None:
    """Writes an empty store in the form of one case's results."""
    import zarr
    from zarr.codecs import ZstdCodec

    axes, dims = grid.coordinates(), list(grid.dims)
    lengths, pieces = dict(zip(dims, tiles.shape, strict=True)), dict(zip(dims, tiles.tile, strict=True))
    data, shapes = {name: _storable(v) for name, v in like.variables.items() if name not in axes}, {}
    encoding: dict[Any, dict[str, Any]] = {name: {} for name in data}
    for name, variable in data.items():
        if set(dims) <= set(variable.dims):
            fill: Any = {"f": np.nan, "c": np.nan, "O": "", "b": False}.get(variable.dtype.kind, 0)
            fill = int(Status.NOT_RUN) if name == "status" else fill
            shapes[name] = _lengths(variable, lengths)
            data[name] = variable.copy(data=np.full(variable.shape, fill, variable.dtype))
            chunks = tuple(max(n, 1) for n in _lengths(variable, pieces))
            compressors = (ZstdCodec(level=3, checksum=True),)
            encoding[name] = {"chunks": chunks, "fill_value": fill, "compressors": compressors}
    mark: dict[str, Any] = {"identity": uuid.uuid4().hex, "call": call, "versions": versions()}
    mark |= {"dims": dims, "axes": list(axes)}
    mark |= {"shape": tiles.shape, "tile": tiles.tile, "coords": [n for n in like.coords if n not in axes]}
    mark["variables"] = {name: data[name].dims for name in sorted(shapes)}
    ones = (1,) * len(dims)
    for name, fill, text in ((VERSIONS, "", "versions of packages"), (DIGEST, 0, "digest of the files")):
        values = np.full(ones, fill, object if name == VERSIONS else np.int64)
        data[name] = xr.Variable([f"tile_{d}" for d in dims], values, {"long_name": f"{text} of a tile"})
        encoding[name], shapes[name] = {"chunks": ones, "fill_value": fill}, tiles.counts
    for of_variable in encoding.values():
        of_variable["_FillValue"] = None  # else it would be an attribute, too
    xr.Dataset(data).to_zarr(path, mode="w-", encoding=encoding, write_empty_chunks=False, **ZARR)
    for name, whole_shape in shapes.items():  # afterwards, so that nothing of the size of the grid is in memory
        zarr.open_array(path / name, mode="r+").resize(whole_shape)
    ds = xr.Dataset(coords=axes, attrs=like.attrs)
    ds.to_zarr(path, mode="a", encoding={name: {"_FillValue": None} for name in axes}, **ZARR)
    common = sorted(file for file in path.glob("*/**/*") if file.is_file())  # no tile is there yet
    mark["common"] = {file.relative_to(path).as_posix(): _sha(file.read_bytes()) for file in common}
    zarr.open_group(path, mode="r+").update_attributes({MARK: json.dumps(mark)})


def _make_archive(path: Path, *contents: Any) -> Archive:
    """Makes an empty store, whole or not at all, in place of one of ours that may be there.

    **Arguments:** `contents`: as for `_create`.
    """
    begin, end = f".{path.name}.", ".part"
    for part in path.parent.glob(f"{glob.escape(begin)}*{end}"):  # of processes that were killed
        shutil.rmtree(part, ignore_errors=True)
    with TemporaryDirectory(end, begin, path.parent, ignore_cleanup_errors=True) as part:
        _create(Path(part, "new"), *contents)
        if path.exists():
            os.rename(path, Path(part, "old"))
        os.rename(Path(part, "new"), path)
    return _open_archive(path)


def _open_archive(path: Path, call: Mapping[str, Any] | None = None) -> Archive:
    """Opens a store that exists.

    **Raises:** `ValueError` where it is none of ours, or was made by another call than `call`, with the differences.
    """
    try:
        attributes = json.loads(content_of(path / "zarr.json"))["attributes"]
        archive = Archive(path, json.loads(attributes[MARK]))
    except (OSError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: must be a store of slipperjax, but is none: {error!r}") from None
    if not _is_mark(archive.mark):
        raise ValueError(f"{path}: must be a store of slipperjax, but its attribute `{MARK}` was changed.")
    if call is None:
        return archive
    stored, called = dict(_leaves(archive.mark["call"])), dict(_leaves(call))
    brief = lambda text: text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 3]}..."
    pairs = {name: (stored.get(name, "nothing"), called.get(name, "nothing")) for name in stored | called}
    lines = [f"{name}: {brief(a)} in the store, {brief(b)} asked" for name, (a, b) in pairs.items() if a != b]
    if lines:
        shown = "\n  ".join(lines[:10] + [f"and {len(lines) - 10} more"] * (len(lines) > 10))
        raise ValueError(
            f"Argument `store` must be of the same call, but {path} was made by another one:\n  {shown}\n"
            "Take another path, or start over with slipperjax.Store(path, fresh=True), on the command line --fresh."
        )
    return archive


_KINDS = {"identity": str, "call": dict, "versions": dict, "dims": [str], "shape": [int], "tile": [int]}
_KINDS |= {"axes": [str], "coords": [str], "variables": {str: [str]}, "common": {str: str}}


def _is_mark(mark: Any) -> bool:
    """Tells whether a value is what the attribute `MARK` holds, of a store of at most `MOST_TILES`."""
    if not isinstance(mark, dict):
        return False
    kinds = all(_fits(mark.get(name, {} if name == "common" else None), kind) for name, kind in _KINDS.items())
    if not kinds or not len(mark["dims"]) == len(mark["shape"]) == len(mark["tile"]) > 0:
        return False
    return (
        min(mark["shape"] + mark["tile"]) > 0
        and Tiling(tuple(mark["shape"]), tuple(mark["tile"])).count <= MOST_TILES
    )


def _fits(value: Any, kind: Any) -> bool:
    """Tells whether a value is of a class, or a list or dict of values of one."""
    if isinstance(kind, list):
        return isinstance(value, list) and all(_fits(one, kind[0]) for one in value)
    if isinstance(kind, dict):
        return isinstance(value, dict) and all(_fits(one, kind[str]) for one in value.values())
    return type(value) is kind


def _undamaged(archive: Archive) -> Archive:
    """Gives the archive; raises `ValueError` where files are damaged that all tiles have in common."""
    for line in archive.common_damage()[:1]:
        raise ValueError(f"Argument `store` must be whole, but {line}.")
    return archive


class _Reader(BackendEntrypoint):
    """Opens a store's results so that a value which cannot be read is said with its place, whenever that is."""

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: Any = None, **options: Any) -> xr.Dataset:
        ds = _open_archive(Path(filename_or_obj)).open().drop_vars([VERSIONS, DIGEST])
        lazy = lambda name: indexing.LazilyIndexedArray(_Stored(Path(filename_or_obj), str(name), ds.variables[name]))
        return ds.assign({name: ds.variables[name].copy(data=lazy(name)) for name in ds.data_vars})


class _Stored(BackendArray):
    """Values of a variable, which are read when they are asked for."""

    def __init__(self, path: Path, name: str, variable: xr.Variable):
        self.path, self.name, self.variable = path, name, variable
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        try:
            return self.variable[key].values
        except IndexError:  # of what is asked for
            raise
        except Exception as error:  # codecs raise many kinds of errors
            advice = f"`slipperjax store check {self.path}` names the file"
            raise OSError(f"{self.path / self.name} is damaged: {advice}: {error}") from None


def open_store(path: Any) -> xr.Dataset:
    """Opens a store as a dataset over its whole grid, whose values are read from disk when they are asked for.

    It may be complete, or still growing: cases that are not there yet have `Status.NOT_RUN` and NaN.

    **Raises:** `ValueError` for a path that is no store of slipperjax, or one that lacks more than tiles.
    """
    archive = _undamaged(_open_archive(user_path(path)))
    ds = xr.open_dataset(archive.path, engine=_Reader)
    del ds.attrs[MARK]
    # labels, such as those of points, as other datasets have them
    labels = {name: (name, np.array(ds[name].values.tolist())) for name in ds.indexes if ds[name].dtype.kind in "OT"}
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
    archive = _open_archive(user_path(path))
    done = archive.complete_tiles()
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    return StoreStatus(len(done), int(done.sum()), math.prod(archive.tiles.shape), archive.complete_cases(done), size)


def check_store(path: Any, *, repair: bool = False) -> list[str]:
    """Reads all of a store, and gives a line for whatever is wrong: files missing, cut short, changed or swapped.

    **Arguments:** `repair`: make damaged tiles absent, so that the same call as before computes them again.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = _open_archive(user_path(path))
    lines = archive.common_damage()
    if lines:
        return lines
    ds = archive.open()
    for number in range(archive.tiles.count):
        digest_file = archive.files(number)[DIGEST]
        problem = archive.damage(number, ds) if digest_file.is_file() else None
        if problem is not None:
            lines.append(f"tile {number}: {problem}")
            if repair:
                digest_file.unlink(missing_ok=True)
    return lines


# --- locks ----------------------------------------------------------------------------------------------------------


@contextmanager
def _writing(store: Store) -> Iterator[None]:
    """Holds the right to write to a store, or to a share of it.

    **Raises:** `StoreInUse`; `OSError` where the folder is missing or read-only.
    """
    with _held(_lock_path(store.path, store.share)):
        if store.path.exists() and not os.access(store.path, os.W_OK):
            raise PermissionError(f"{store.path} is protected against writing")
        if store.share is None:
            path = store.path.resolve()
            for other in path.parent.glob(f"{glob.escape(path.name)}.*-of-*.lock"):
                with _held(other):
                    pass
        yield


def _lock_path(store: Path, share: tuple[int, int] | None = None) -> Path:
    store = store.resolve()  # a store has one lock, whatever links lead to it
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
        if path.is_symlink():
            raise PermissionError(f"{path} must be a lock and no link, which leads elsewhere: delete it") from None
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

    The function takes those of `slipperjax.sweep` that say how cases are run, and gives a dataset over the grid in
    which no case depends on another.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Any:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        options = dict(bound.arguments)
        store, executor = options.pop("store"), options.pop("executor")
        if store is not None:
            return _stored(call, options, Store.of(store), executor)
        if executor is not None:
            raise ValueError("Argument `executor` needs `store`, to which its workers write.")
        return function(*args, **kwargs)

    return call


def _stored(function: Callable[..., Any], options: dict[str, Any], store: Store, executor: Any) -> xr.Dataset:
    """Runs a function over a grid, tile by tile, into a store, and opens that.

    **Raises:** `ValueError` where the store is of another call, with the differences; `StoreInUse` where another
    process writes to it; `Interrupted` after Ctrl-C, with the store as its dataset.
    """
    need = "be a dask.distributed.Client or a concurrent.futures.Executor"
    require(executor is None or callable(getattr(executor, "submit", None)), "executor", need, executor)
    _check_not_forked(executor)
    scene, steps, workers = (options.pop(name) for name in ("scene", "steps_per_period", "workers"))
    scene = at_speed(scene, options.pop("speed", None))  # of `run`, whose grid may vary it
    grid = Grid(scene, options.pop("grid"), product=options["product"])
    grid.check_steps(steps)
    workers = None if workers is None else whole("workers", workers, 1)
    # a trajectory may be long, and every worker gets its first state only
    options["start"] = first_of(options["start"])
    tiles, exists = Tiling.of(grid.shape, store.tile), not store.fresh and store.path.exists()
    if store.tile is None and exists:
        stored = _open_archive(store.path).tiles
        tiles = stored if stored.shape == grid.shape else tiles
    call = _fingerprint(function, grid, options | {"steps_per_period": steps}, tiles)
    if exists and _open_archive(store.path, call).complete_tiles().all():
        return open_store(store.path)  # on a disk, perhaps, that is protected against writing
    # threads of this process compute a tile each; other processes may have several cores
    threads, inside = (workers or cores(), 1) if executor is None else (1, workers or 1)
    # chunks of one size, so that a worker compiles its programs once
    chunk = options["chunk"] or LARGEST_CHUNK
    how = options | dict(workers=inside, progress=False, chunk=chunk)
    compute = functools.partial(function, scene, **how)
    # LAPACK must not be called from two threads, and a device computes one batch at a time
    alone = calls_lapack(resolve_solver(scene, options["solver"]), True) or jax.default_backend() != "cpu"
    steps_of = lambda region: np.asarray(steps)[region] if np.ndim(steps) else steps
    with _writing(store):
        with nullcontext() if store.share is None else _held(_lock_path(store.path), SHARE_WAIT):
            if store.fresh or not store.path.exists():
                _check_replaceable(store.path)
                # first of all one case, so that a wrong argument deletes nothing
                corner = tuple(slice(1) for _ in grid.shape)
                shared = executor is not None or store.share is not None
                of_store: dict[str, Any] = dict(tiles=tiles, at_once=threads, shared=shared)
                before = STORE.set(CountedEstimate(grid.count, math.nan, 0.0, **of_store))
                try:
                    like = compute(grid.part(corner), steps_per_period=steps_of(corner))
                except Interrupted:
                    raise Interrupted(None, 0, grid.count) from None
                finally:
                    STORE.reset(before)
                size = bytes_of_case(like, grid.dims, grid.coordinates())
                CountedEstimate(grid.count, math.nan, size, free=store.free_bytes, **of_store).check()
                archive = _make_archive(store.path, grid, tiles, call, like)
            else:
                archive = _undamaged(_open_archive(store.path, call))
        archive, done = archive._replace(path=store.path.absolute()), archive.complete_tiles()
        share, shares = store.share or (1, 1)
        todo = [k for k in range(tiles.count) if not done[k] and k % shares == share - 1]
        archive.tidy(None if store.share is None else todo)
        _warn_of_versions(archive)
        task = functools.partial(_compute_tile, archive, compute, alone, os.getpid())
        parts = {k: (grid.part(tiles.region(k)), steps_of(tiles.region(k))) for k in todo}
        before = archive.complete_cases(done)
        name = f"{before} cases stored before" if before else ""
        try:
            _run_tasks(task, parts, tiles, executor, threads, wanted=options["progress"], name=name)
        except KeyboardInterrupt:
            raise Interrupted(open_store(store.path), archive.complete_cases(), grid.count) from None
        except BrokenExecutor as error:
            stored = f"{archive.complete_cases()} cases or more are stored, call again to go on"
            raise WorkerLost(f"a worker process ended abruptly, for want of memory perhaps; {stored}") from error
    return open_store(store.path)


def _warn_of_versions(archive: Archive) -> None:
    """Warns where a store was begun with other versions of packages, whose last digits may differ."""
    before, now = archive.mark["versions"], versions()
    other = [f"{name} {before.get(name)} and not {now[name]}" for name in now if before.get(name) != now[name]]
    if other:
        warn(
            f"The store {archive.path} was begun with {listed(other)}: tiles may differ by rounding, chaotic cases "
            f"altogether. Its array `{VERSIONS}` says which tile is of which; fresh=True starts over."
        )


def _check_replaceable(path: Path) -> None:
    """Refuses to delete anything but a store of ours, with nothing else in it, and anything through a link.

    **Raises:** `ValueError`.
    """
    if path.is_symlink():
        raise ValueError(
            f"Argument `store` must be no link where it is made anew, but {path} leads to {path.resolve()}."
        )
    if path.exists():
        _open_archive(path).check_own()


# --- workers --------------------------------------------------------------------------------------------------------


def _compute_tile(
    archive: Archive,
    compute: Callable[..., Any],
    alone: bool,
    caller: int,
    number: int,
    values: dict[str, np.ndarray],
    steps: Any,
) -> None:
    """Computes a tile of a store and writes it. Calling it again is harmless: it writes the same bytes.

    **Arguments:** `alone`: whether a process may compute one tile at a time only; `caller`: process that asks for it;
    `values`, `steps`: of the tile, by name of the grid and as `steps_per_period`.
    """
    _require_new(forked=caller == IMPORTED_BY != os.getpid())
    if archive.mark["call"]["code"]["slipperjax"] != IMPORTED:
        raise RuntimeError("a worker imported other code of slipperjax than the process that called it: restart both")
    before = TOLD.set(_TOLD.setdefault(archive.mark["identity"], set()))
    try:
        with _ALONE if alone else nullcontext():
            ds = compute(values, steps_per_period=steps)
    finally:
        TOLD.reset(before)
    try:
        archive.write(number, ds)
    except OSError as error:
        cases = f"{archive.complete_cases()} of {math.prod(archive.tiles.shape)} cases are stored"
        text = f"cannot write to {archive.path}: {error.strerror or error}; {cases}, call again to go on"
        raise OSError(error.errno or errno.EIO, text) from None


def _check_not_forked(executor: Any) -> None:
    """Raises `ValueError` before anything is computed where it can be told; else each worker tells it of itself."""
    # of a ProcessPoolExecutor; Python's default on Linux before 3.14
    context = getattr(executor, "_mp_context", None)
    _require_new(forked=context is not None and context.get_start_method() == "fork")


def _require_new(forked: bool) -> None:
    """Raises `ValueError` for forked processes, in which programs of JAX wait for threads that were not copied."""
    need = "start new processes, as slipperjax.processes() or mp_context=multiprocessing.get_context('spawn') does"
    require(not forked, "executor", need, shown="one that forks this one, in whose copies JAX hangs")


def _run_tasks(
    task: Callable[..., None],
    parts: Mapping[int, tuple[Any, ...]],
    tiles: Tiling,
    executor: Any,
    threads: int,
    **shown_as: Any,
) -> None:
    """Computes tiles, in any order.

    **Arguments:** `parts`: arguments of the task by number of the tile; `executor`: a `concurrent.futures.Executor`,
    a `dask.distributed.Client`, or None for `threads` of this process; `shown_as`: of the progress.

    **Raises:** `KeyboardInterrupt` after Ctrl-C; the error of a task, or of the executor.
    """
    sizes = {number: tiles.cases(number) for number in parts}
    pool: Any = ThreadPoolExecutor(threads) if executor is None else executor
    if type(pool).__module__.split(".")[0] == "distributed":
        # tasks of one function and argument are the same to dask unless they are said to be impure
        pool = pool.get_executor(pure=False, retries=RETRIES)
    stop, cases = Stop(Stop.here()), sum(sizes.values())
    submit = pool.submit if executor is not None else functools.partial(stop.submit, pool)
    with progress_shown(cases, cases, **shown_as) as shown:
        futures = {submit(task, number, *part): number for number, part in parts.items()}
        try:
            while futures:
                for future in wait(futures, TICK, "FIRST_COMPLETED").done:
                    future.result()
                    size = sizes[futures.pop(future)]
                    shown(size, size)
                heed_interrupts()
        except BrokenExecutor:  # which ends all tasks itself, and fails where it finds a cancelled one
            raise
        except BaseException:
            running = [future for future in futures if not future.cancel()]
            if executor is None:
                stop.set()
                wait(running, THREADS_WAIT)
            raise
        finally:
            if executor is None:
                pool.shutdown(wait=False)


def processes(count: int | None = None) -> ProcessPoolExecutor:
    """Makes an executor of spawned processes for `store`, one for each group of cores; default one per core.

    Programs that are kept on disk, see `slipperjax.compile_cache`, are kept for them, too. They end with the process
    that made them, however it ends, and all of them where one ends abruptly. In a script it belongs under
    `if __name__ == "__main__":`, because new processes import the script.

    ```python
    with sj.processes(2) as pool:
        ds = sj.sweep(scene, grid, store="map.zarr", executor=pool)
    ```

    **Raises:** `ValueError` for fewer than one.
    """
    count = cores() if count is None else whole("count", count, 1, MOST_PROCESSES)
    context = _Together()
    folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    # each process takes a group of cores, as equal as they can be; processes above the number of cores share them
    own = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    # by locks that nobody waits for: who is killed takes no more than its own group along
    groups = [(context.Lock(), own[k % len(own) :: count]) for k in range(count if own else 0)]
    begun = (groups, None if folder is None else str(folder))
    return ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=begun)


class _Together(SpawnContext):
    """Makes processes that end together: where one ends abruptly, the others are ended.

    They might wait for ever for a lock that it held. A pool of Python's ends them, too, unless it is shut down then.
    """

    def __init__(self) -> None:
        self._made: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:
        self._made.append(SpawnProcess(*args, **kwargs))
        if len(self._made) == 1:
            threading.Thread(target=self._end_together, daemon=True).start()
        return self._made[-1]

    def _end_together(self) -> None:
        """Waits until all processes have ended."""
        codes: list[int | None] = [None]
        while None in codes:
            time.sleep(TICK)
            codes = [process.exitcode for process in self._made]
            if any(codes):
                for process in self._made:
                    if process.pid is not None and process.exitcode is None:
                        process.kill()


def _begin(groups: list[tuple[Any, list[int]]], folder: str | None) -> None:
    """Prepares a new process, before JAX starts its threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the business of who waits for the results
    threading.Thread(target=_end_with_parent, daemon=True).start()
    group = next((group for free, group in groups if free.acquire(block=False)), None)
    if group:
        with suppress(OSError):
            os.sched_setaffinity(0, group)
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
