"""A result computed again from what its dataset or file says of itself."""

import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ..flow.datasets import dataset_of, load_base, load_call, varied_names
from ..flow.simulate import simulate
from ..tools.checks import brief, require
from .follow import follow
from .run import ARGUMENTS_WITHOUT_EFFECT
from .sweep import sweep

FUNCTIONS: dict[str, Any] = {"simulate": simulate, "sweep": sweep, "follow": follow}
"""Functions whose results can be computed again."""
NOT_OF_CALL = {"scene", "grid", "path", "start", "refine", *ARGUMENTS_WITHOUT_EFFECT}
"""Their arguments that no file's call may have: what files keep elsewhere, paths, executors and chunks."""


def repeat(source: Any, **options: Any) -> xr.Dataset:
    """Computes a result again: with the same versions on the same machine, to the same bits.

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
    name, whole_path = call.pop("function", None), call.pop("values", None)
    known = isinstance(name, str) and name in FUNCTIONS
    require(known, "source", f"be a result of one of {', '.join(FUNCTIONS)}", shown=f"of {brief(name)}")
    others = sorted(call.keys() - (inspect.signature(FUNCTIONS[name]).parameters.keys() - NOT_OF_CALL))
    need = f"have a call of `{name}` with what changes its numbers only"
    require(not others, "source", need, shown=f"{', '.join(others)}, too")
    if name == "simulate":
        return simulate(scene, start=start, **call, **options).to_xarray()
    axes = varied_names(ds)
    grid = {label.removeprefix("start_"): np.atleast_1d(ds[label].values) for label in axes}
    if name == "follow":
        if ds.sizes.get(axes[0]) != whole_path:
            raise ValueError(
                "Argument `source` must be a whole result of `follow`, as its cases depend on one another."
            )
    elif "steps_per_period" not in ds:
        raise ValueError("Argument `source` must have the variable `steps_per_period`, but has not.")
    else:
        call["steps_per_period"] = _over(ds["steps_per_period"], axes if call.get("product", True) else ("case",))
    return FUNCTIONS[name](scene, grid, start=start, **call, **options)


def _over(array: xr.DataArray, dims: Sequence[str]) -> np.ndarray:
    """Values with the axes `dims`, one of length 1 for a dimension of which a single value was selected."""
    return array.expand_dims([dim for dim in dims if dim not in array.dims]).transpose(*dims).values
