"""A result computed again from what its dataset or file says of itself."""

import inspect
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import xarray as xr

from ..flow.datasets import dataset_of, load_base, load_call, varied_names
from ..flow.simulate import simulate
from ..tools.checks import one_of, require
from .call import Call
from .follow import follow_of
from .sweep import sweep_of


def repeat(source: Any, **options: Any) -> xr.Dataset:
    """Compute a result again: with the same versions on the same machine, to the same bits.

    **Arguments:** `source`: a netCDF file or a dataset of slipperjax, or a selection of its cases. `options`: as in
    `progress=True`, what the function takes besides what changes its result.

    **Returns:** a new dataset.

    **Raises:** `ValueError` for a dataset that does not say how it was made, or whose call has other arguments than
    those that change the function's numbers; for a part of a result of `follow`, whose cases depend on one another;
    for a solver that cannot be rebuilt.
    """
    ds = dataset_of(source)
    scene, start = load_base(ds)
    call = load_call(ds)
    name = one_of("source", call.pop("function", None), ("simulate", "sweep", "follow"))
    whole_path = call.pop("values", None)
    if name == "simulate":
        known = inspect.signature(simulate).parameters.keys() - {"scene", "start", "progress"}
    else:
        known = {field.name for field in fields(Call)}
    others = sorted(call.keys() - known)
    need = f"have a call of `{name}` with what changes its numbers only"
    require(not others, "source", need, shown=f"{', '.join(others)}, too")
    if name == "simulate":
        return simulate(scene, start=start, **call, **options).to_xarray()
    asked = Call(**call)
    axes = varied_names(ds)
    grid = {label.removeprefix("start_"): np.atleast_1d(ds[label].values) for label in axes}
    if name == "follow":
        whole = ds.sizes.get(axes[0]) == whole_path
        require(whole, "source", "be a whole result of `follow`, whose cases depend on one another", shown="a part")
        return follow_of(replace(asked, function=name), scene, grid, start, **options)
    require("steps_per_period" in ds, "source", "have the variable `steps_per_period`", shown="none")
    steps = _over(ds["steps_per_period"], axes if asked.product else ("case",))
    return sweep_of(replace(asked, steps_per_period=steps), scene, grid, start, **options)


def _over(array: xr.DataArray, dims: Sequence[str]) -> np.ndarray:
    """Return values with the axes `dims`, one of length 1 for a dimension of which a single value was selected."""
    return array.expand_dims([dim for dim in dims if dim not in array.dims]).transpose(*dims).values
