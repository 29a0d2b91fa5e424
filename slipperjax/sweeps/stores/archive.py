"""Stores on disk: made whole, written tile by tile, each complete or absent, read while they grow, and repaired."""

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ...flow.status import Status
from ...tools.limits import shown_bytes
from ..grid import Grid
from .target import Tiling

LAST = "status"
"""The variable that is written last: a tile is there when its chunk of it is."""
ASKED = "asked"
"""Attribute of the store that holds its fingerprint."""
SHAPE = "tiles"
"""Attribute with the grid's dimensions, and their lengths and those of a tile."""
COORDINATES = "coordinates_of_cases"
"""Attribute that names the variables over the grid which are coordinates."""
WHOLE: Any = {"write_empty_chunks": True}
"""Chunks of one value have a file, too, so that none can be lost unseen."""


class Archive(NamedTuple):
    """A store that exists."""

    path: Path
    dims: tuple[str, ...]
    """Dimensions of the grid."""
    axes: tuple[str, ...]
    """The variables that hold the grid's values, which were written when the store was made."""
    tiles: Tiling

    def asked(self) -> dict[str, Any]:
        """The fingerprint of the call that made the store."""
        return _group(self.path, "r").attrs[ASKED]

    def done(self) -> np.ndarray:
        """Whether each tile is complete."""
        folder = self.path / LAST / "c"
        exists = lambda number: folder.joinpath(*map(str, self.tiles.place(number))).is_file()
        return np.fromiter((exists(number) for number in range(self.tiles.count)), bool, self.tiles.count)

    def finished(self, done: np.ndarray | None = None) -> int:
        """How many cases are in complete tiles, or in those of an earlier `done()`."""
        there = self.done() if done is None else done
        return sum(self.tiles.cases(int(number)) for number in np.flatnonzero(there))

    def write(self, number: int, ds: xr.Dataset) -> None:
        """Writes the results of a tile.

        **Raises:** `OSError` where the disk is full or protected; the tile is absent then.
        """
        import zarr

        region = dict(zip(self.dims, self.tiles.region(number), strict=True))
        for name in self.arrays():
            array, variable = zarr.open_array(self.path / name, mode="r+").with_config(WHOLE), ds.variables[name]
            place = tuple(region.get(str(d), slice(None)) for d in variable.dims)
            array[place] = _fitted(name, variable, array.shape, self.dims)

    def values(self, names: Sequence[str], number: int) -> dict[str, np.ndarray]:
        """The coordinates of a tile, by the names that the grid has for them."""
        group, region = _group(self.path, "r"), self.tiles.region(number)
        slices = region if len(self.dims) == len(names) else region * len(names)
        labels = [Grid.label(name) for name in names]
        return {name: group[label][cut] for name, label, cut in zip(names, labels, slices, strict=True)}

    def arrays(self) -> dict[str, Any]:
        """The arrays that tiles have a chunk of, in the order in which these are written."""
        found = dict(_group(self.path, "r").arrays())
        of_tile = lambda name: name not in self.axes and set(self.dims) <= set(_dims(found[name]))
        found = {name: array for name, array in found.items() if of_tile(name)}
        return {name: found[name] for name in [*sorted(name for name in found if name != LAST), LAST]}

    def files(self, number: int) -> dict[str, Path]:
        """The files of a tile by variable, in the order in which they are written."""
        at = dict(zip(self.dims, map(str, self.tiles.place(number)), strict=True))
        return {
            name: self.path.joinpath(name, "c", *(at.get(d, "0") for d in _dims(array)))
            for name, array in self.arrays().items()
        }

    def damaged(self) -> Iterator[tuple[int, str]]:
        """Complete tiles that cannot be read, with what is wrong: all is read and compared with its checksums."""
        arrays = self.arrays()
        for number in np.flatnonzero(self.done()).tolist():
            region = dict(zip(self.dims, self.tiles.region(number), strict=True))
            for name, file in self.files(number).items():
                if not file.is_file():
                    yield number, f"{file} is missing"
                    continue
                try:
                    arrays[name][tuple(region.get(d, slice(None)) for d in _dims(arrays[name]))]
                except Exception as error:  # codecs raise many kinds of errors
                    yield number, f"{file} cannot be read: {error}"

    def forget(self, number: int) -> None:
        """Makes a tile absent, so that the next run computes it again."""
        self.path.joinpath(LAST, "c", *map(str, self.tiles.place(number))).unlink(missing_ok=True)

    def tidy(self, numbers: Sequence[int] | None = None) -> None:
        """Deletes what a process that was killed had not finished to write of some tiles, or of all of the store.

        Nobody else may be writing to them.
        """
        if numbers is None:
            parts = self.path.rglob("*.partial")
        else:
            files = (file for number in numbers for file in self.files(number).values())
            parts = (part for file in files for part in file.parent.glob(f"{file.name}.*.partial"))
        for part in parts:
            part.unlink(missing_ok=True)


def _group(path: Path, mode: str) -> Any:
    import zarr

    return zarr.open_group(path, mode=mode, zarr_format=3, use_consolidated=False)


def _dims(array: Any) -> tuple[str, ...]:
    return tuple(array.metadata.dimension_names or ())


def _fitted(name: str, variable: xr.Variable, shape: tuple[int, ...], dims: tuple[str, ...]) -> np.ndarray:
    """Values as the store has room for them: shorter dimensions other than the grid's are filled up with NaN."""
    values = _storable(variable)
    room = [n if d in dims else m for d, n, m in zip(variable.dims, values.shape, shape, strict=True)]
    if any(n > m for n, m in zip(values.shape, room, strict=True)):
        raise ValueError(
            f"A case has more values of `{name}` than the store has room for, {values.shape} in {tuple(room)}; keep "
            "fewer periods, or another record."
        )
    if tuple(room) != values.shape:
        found = np.full(room, np.nan)
        found[tuple(slice(n) for n in values.shape)] = values
        values = found
    return values


def make_archive(path: Path, grid: Grid, tiles: Tiling, asked: Mapping[str, Any], like: xr.Dataset) -> Archive:
    """Makes an empty store, whole or not at all, in place of one that may be there.

    **Arguments:** `asked`: its fingerprint; `like`: the results of one case.
    """
    _clear(path)
    part, old = (path.with_name(f".{path.name}.{os.getpid()}.{name}") for name in ("part", "old.part"))
    try:
        _make(part, grid, tiles, asked, like)
        if path.exists():
            os.rename(path, old)
        os.rename(part, path)
    finally:
        _clear(path)
    return open_archive(path)


def _clear(path: Path) -> None:
    """Deletes what was not finished beside a store, also by processes that were killed."""
    for part in path.parent.glob(f".{path.name}.*.part"):
        shutil.rmtree(part, ignore_errors=True)


def _make(path: Path, grid: Grid, tiles: Tiling, asked: Mapping[str, Any], like: xr.Dataset) -> None:
    import zarr

    group = zarr.open_group(path, mode="w-", zarr_format=3)
    axes = grid.coordinates()
    for name, (dim, values, attrs) in axes.items():
        _add(group, name, xr.Variable(dim, values, attrs))
    lengths, pieces = (dict(zip(grid.dims, numbers, strict=True)) for numbers in (tiles.shape, tiles.tile))
    for name, variable in like.variables.items():
        if name not in axes and set(grid.dims) <= set(variable.dims):
            # the number of crossings differs from case to case
            room = {"crossing": variable.attrs.get("capacity")}
            inner = {d: room.get(str(d)) or n for d, n in zip(variable.dims, variable.shape, strict=True)}
            whole, chunk = (tuple((inner | of_grid).values()) for of_grid in (lengths, pieces))
            _add(group, str(name), variable, whole, chunk)
        elif name not in axes:
            _add(group, str(name), variable)
    shape = {"dims": list(grid.dims), "axes": list(axes), "shape": list(tiles.shape), "tile": list(tiles.tile)}
    more = [str(name) for name in like.coords if name not in axes and name not in like.dims]
    attributes = {name: _json(value) for name, value in like.attrs.items()}
    group.attrs.update({**attributes, ASKED: dict(asked), SHAPE: shape, COORDINATES: more})


def _add(
    group: Any, name: str, variable: xr.Variable, whole: tuple[int, ...] | None = None, chunk: tuple[int, ...] = ()
) -> None:
    """An array like a variable: with its values, or of another shape and empty."""
    from zarr.codecs import ZstdCodec

    values = _storable(variable)
    fill: Any = {"f": np.nan, "c": np.nan, "T": "", "b": False}.get(values.dtype.kind, 0)
    shape = values.shape if whole is None else whole
    array = group.create_array(
        name,
        shape=shape,
        chunks=tuple(max(n, 1) for n in (chunk or shape)),
        dtype=values.dtype,
        fill_value=int(Status.NOT_RUN) if name == LAST else fill,
        attributes={key: _json(value) for key, value in variable.attrs.items()},
        dimension_names=[str(d) for d in variable.dims],
        compressors=(ZstdCodec(level=3, checksum=True),),
    )
    if whole is None:
        array[...] = values


def _storable(variable: xr.Variable) -> np.ndarray:
    """Values in a type that zarr's specification knows."""
    values = np.asarray(variable.values)
    return values.astype(np.dtypes.StringDType()) if values.dtype.kind in "UO" else values


def _json(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def open_archive(path: Path) -> Archive:
    """A store that exists.

    **Raises:** `ValueError` where it is none of ours.
    """
    try:
        shape = _group(path, "r").attrs[SHAPE]
        tiles = Tiling(tuple(shape["shape"]), tuple(shape["tile"]))
        return Archive(path, tuple(shape["dims"]), tuple(shape["axes"]), tiles)
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: must be a store of slipperjax, but is none: {error}") from None


def open_store(path: Any) -> xr.Dataset:
    """A store as a dataset over its whole grid, whose values are read from disk when they are asked for.

    It may be complete, or still growing: cases that are not there yet have `Status.NOT_RUN` and NaN.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = open_archive(Path(path))
    ds = xr.open_zarr(archive.path, consolidated=False, chunks=None, zarr_format=3)
    more = [name for name in ds.attrs[COORDINATES] if name in ds.data_vars]
    for name in (SHAPE, ASKED, COORDINATES):
        del ds.attrs[name]
    # labels, such as those of points, as other datasets have them
    words = {name: (name, np.array(ds[name].values.tolist())) for name in ds.indexes if ds[name].dtype.kind == "T"}
    return ds.set_coords(more).assign_coords(words)


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
    """How much of a store is done, without reading results.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = open_archive(Path(path))
    done = archive.done()
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    return StoreStatus(len(done), int(done.sum()), int(np.prod(archive.tiles.shape)), archive.finished(done), size)


def check_store(path: Any, *, repair: bool = False) -> list[str]:
    """Reads every complete tile of a store, and gives what is wrong, a line each; nothing where all is well.

    **Arguments:** `repair`: make damaged tiles absent, so that the same call as before computes them again.
    """
    archive, lines = open_archive(Path(path)), []
    for number, problem in archive.damaged():
        lines.append(f"tile {number}: {problem}")
        if repair:
            archive.forget(number)
    return lines
