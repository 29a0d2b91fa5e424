"""A result computed again from what its dataset or file says of itself."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ..flow.datasets import dataset_of, load_base, load_call, varied_names
from ..flow.simulate import simulate
from ..tools.checks import brief
from .follow import follow
from .sweep import sweep

FUNCTIONS = {"sweep": sweep, "follow": follow}
"""Functions of many cases whose results can be computed again."""


def repeat(source: Any, **options: Any) -> xr.Dataset:
    """Computes a result again: with the same versions on the same machine, to the same bits.

    **Arguments:** `source`: a netCDF file or a dataset of slipperjax, or a selection of its cases. `options`: as in
    `progress=True`, what the function takes besides what changes its result.

    **Returns:** a new dataset.

    **Raises:** `ValueError` for a dataset that does not say how it was made, a part of a result of `follow`, whose
    cases depend on one another, or a solver that cannot be rebuilt.
    """
    ds = dataset_of(source)
    scene, start = load_base(ds)
    call = load_call(ds)
    name = call.pop("function")
    if name == "simulate":
        return simulate(scene, start=start, **call, **options).to_xarray()
    if name not in FUNCTIONS:
        known = ", ".join(("simulate", *FUNCTIONS))
        raise ValueError(f"Argument `source` must be a result of one of {known}, but is of {brief(name)}.")
    axes = varied_names(ds)
    grid = {label.removeprefix("start_"): np.atleast_1d(ds[label].values) for label in axes}
    if name == "follow":
        if ds.sizes.get(axes[0]) != call.pop("values"):
            raise ValueError(
                "Argument `source` must be a whole result of `follow`, as its cases depend on one another."
            )
        call["directions"] = tuple(call["directions"])
    elif "steps_per_period" not in ds:
        raise ValueError("Argument `source` must have the variable `steps_per_period`, but has not.")
    else:
        call["steps_per_period"] = _over(ds["steps_per_period"], axes if call["product"] else ("case",))
    return FUNCTIONS[name](scene, grid, start=start, **call, **options)


def _over(array: xr.DataArray, dims: Sequence[str]) -> np.ndarray:
    """Values with the axes `dims`, one of length 1 for a dimension of which a single value was selected."""
    return array.expand_dims([dim for dim in dims if dim not in array.dims]).transpose(*dims).values
