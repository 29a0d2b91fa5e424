"""Cases that another store has already, such as those of a coarser map: they are copied, and the others computed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ...model.scene import Scene
from ...tools.checks import one_of
from ..grid import Grid
from .archive import Archive, asked_of, check_asked, open_archive, open_store

OWN = ("grid", "product", "tile")
"""What may differ between a store and one whose cases it takes."""


def check_reuse(path: Path, asked: Mapping[str, Any], names: tuple[str, ...]) -> None:
    """Refuses to take cases from a store whose numbers mean something else.

    **Raises:** `ValueError` that shows the differences.
    """
    other = open_archive(path)
    found = asked_of(other)
    if set(found["grid"]) != set(names) or not found["product"]:
        raise ValueError(
            f"Argument `reuse` must be a store of every combination of {', '.join(names)}, but {path} is of "
            f"{', '.join(found['grid'])}{'' if found['product'] else ', side by side'}."
        )
    check_asked(other, {**asked, **{name: found[name] for name in OWN}})


class Known(NamedTuple):
    """Where the cases of a part of a grid are in another store."""

    ds: xr.Dataset
    """The store."""
    places: dict[str, np.ndarray]
    """Indices in it along each of its dimensions, for each case of the part that is there and complete."""
    there: np.ndarray
    """Which cases of the part these are, in their flat order."""


def known_cases(path: Path, part: Mapping[str, np.ndarray], product: bool) -> Known:
    """The cases of a part of a grid that a store has."""
    archive, ds = open_archive(path), open_store(path)
    lists = np.meshgrid(*part.values(), indexing="ij") if product else list(part.values())
    flat = {name: values.ravel() for name, values in zip(part, lists, strict=True)}
    there, places = np.ones(len(next(iter(flat.values()))), bool), {}
    for name, values in flat.items():
        label = Grid.label(name)
        axis = ds[label].values
        order = np.argsort(axis, kind="stable")
        at = order[np.minimum(np.searchsorted(axis[order], values), len(axis) - 1)]
        there &= axis[at] == values
        places[label] = at
    found = np.flatnonzero(there)
    there[found] &= _complete(archive, ds, {name: at[found] for name, at in places.items()})
    return Known(ds, {name: at[there] for name, at in places.items()}, there)


def _complete(archive: Archive, ds: xr.Dataset, places: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which cases lie in tiles that are there."""
    across, done = archive.tiles.across, archive.done()
    tiles = [places[d] // n for d, n in zip(archive.dims, archive.tiles.tile, strict=True)]
    return done[np.ravel_multi_index(tiles, across)] if len(tiles[0]) else np.zeros(0, bool)


def run_rest(
    function: Callable[..., xr.Dataset],
    scene: Scene,
    part: Mapping[str, np.ndarray],
    product: bool,
    options: Mapping[str, Any],
    reuse: Path,
) -> xr.Dataset:
    """The function's results for a part of a grid, of which only what another store does not have is computed."""
    known, shape = known_cases(reuse, part, product), _shape(part, product)
    lists = np.meshgrid(*part.values(), indexing="ij") if product else list(part.values())
    rest = {name: values.ravel()[~known.there] for name, values in zip(part, lists, strict=True)}
    dims = tuple(map(Grid.label, part)) if product else ("case",)
    over = tuple(known.ds["status"].dims)
    copied = known.ds.isel({d: xr.DataArray(known.places[str(d)], dims="case") for d in over}).load()
    copied = copied.drop_vars([Grid.label(name) for name in part])
    if known.there.all():
        both = copied
    else:
        steps = options.get("steps_per_period")
        of_rest = {"steps_per_period": np.asarray(steps).ravel()[~known.there]} if np.ndim(steps) else {}
        computed = function(scene, grid=rest, **{**options, **of_rest, "product": False})
        computed = computed.drop_vars([Grid.label(name) for name in part])
        both = _joined(copied, computed, known.there)
    found = xr.Dataset(attrs=both.attrs)
    for name, variable in both.variables.items():
        if "case" not in variable.dims:
            found[name] = variable
            continue
        values = np.moveaxis(variable.values, variable.dims.index("case"), 0)
        inner = [d for d in variable.dims if d != "case"]
        found[name] = ((*dims, *inner), values.reshape(*shape, *values.shape[1:]), variable.attrs)
    return found.set_coords([name for name in both.coords if name in found])


def _shape(part: Mapping[str, np.ndarray], product: bool) -> tuple[int, ...]:
    lengths = tuple(len(values) for values in part.values())
    return lengths if product else lengths[:1]


def _joined(copied: xr.Dataset, computed: xr.Dataset, there: np.ndarray) -> xr.Dataset:
    """Two datasets over `case` as one, the first where `there` says so; shorter other dimensions are filled up."""
    found: dict[Any, xr.Variable] = {}
    for name, variable in computed.variables.items():
        if "case" not in variable.dims:
            found[name] = variable
            continue
        parts = (copied[name].variable.transpose(*variable.dims), there), (variable, ~there)
        sizes = [len(there) if d == "case" else max(one.sizes[d] for one, _ in parts) for d in variable.dims]
        fill = {"f": np.nan, "U": None, "O": None}.get(variable.dtype.kind, 0)
        # words are of any length in stores
        whole = np.full(sizes, fill, object if variable.dtype.kind == "U" else variable.dtype)
        axis = variable.dims.index("case")
        for one, rows in parts:
            within: list[Any] = [slice(n) for n in one.shape]
            within[axis] = np.flatnonzero(rows)
            whole[tuple(within)] = one.values
        found[name] = xr.Variable(variable.dims, whole, variable.attrs)
    return xr.Dataset(found, attrs=computed.attrs).set_coords(list(computed.coords))


def refined(store: Any, within: Mapping[str, tuple[float, float]] | None = None) -> dict[str, np.ndarray]:
    """The grid of a store, or of a box in it, at twice the resolution: its values, and those midway between them.

    ```python
    grid = sj.refined("map.zarr", {"speed": (1200.0, 1300.0)})
    sj.sweep(scene, grid, ..., store=sj.Store("fine.zarr", reuse="map.zarr"))
    ```

    **Arguments:** `within`: lowest and highest value of parameters by name, in SI units; others stay whole.

    **Raises:** `ValueError` for a name that the store does not vary, or a box without two of its values.
    """
    path = Path(store)
    archive = open_archive(path)
    asked = asked_of(archive)
    if not asked["product"]:
        raise ValueError(f"Argument `store` must be of every combination of its values, but {path} is side by side.")
    ds, box = open_store(path), dict(within or {})
    for name in box:
        one_of("within", name, tuple(asked["grid"]))
    found = {}
    for name in asked["grid"]:
        values = ds[Grid.label(name)].values
        low, high = box.get(name, (-np.inf, np.inf))
        values = values[(values >= low) & (values <= high)]
        if len(values) < 2:
            raise ValueError(
                f"Argument `within` must hold two values or more of {name}, but {low:g} to {high:g} holds "
                f"{len(values)}."
            )
        finer = np.empty(2 * len(values) - 1)
        finer[::2], finer[1::2] = values, (values[:-1] + values[1:]) / 2
        found[name] = finer
    return found
