"""`ds.slipper`: the pictures of a result, as methods of its dataset."""

import functools
import importlib
import inspect
from typing import Any

import xarray as xr


@xr.register_dataset_accessor("slipper")
class Pictures:
    """All of `slipperjax.plots` that draws a dataset: `ds.slipper.plot()` is `slipperjax.plots.plot(ds)`."""

    def __init__(self, ds: xr.Dataset):
        self._ds = ds

    def __getattr__(self, name: str) -> Any:
        return functools.partial(getattr(_plots(), name), self._ds)

    def __dir__(self) -> list[str]:
        return [name for name, draw in vars(_plots()).items() if inspect.isfunction(draw)]


def _plots() -> Any:
    # by its name, and not before a picture is asked for: pictures stand above, and matplotlib takes long to import
    return importlib.import_module("slipperjax.plots")
