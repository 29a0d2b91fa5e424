"""`ds.slipper`: the pictures of a result, as methods of its dataset."""

import functools
import inspect
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr


@xr.register_dataset_accessor("slipper")
class Pictures:
    """All of `slipperjax.plots` that draws a dataset: `ds.slipper.plot()` is `slipperjax.plots.plot(ds)`.

    Of a sled, whose results have a dimension of the same name, it also is the coordinate `ds["slipper"]`, as far as
    that is asked for what is no picture: `ds.slipper.values`, `np.asarray(ds.slipper)`.
    """

    def __init__(self, ds: xr.Dataset):
        self._ds = ds

    def __getattr__(self, name: str) -> Any:
        from . import plots  # not before a picture is asked for: matplotlib takes long to import

        if "slipper" in self._ds.coords and not hasattr(plots, name):
            return getattr(self._ds["slipper"], name)
        return functools.partial(getattr(plots, name), self._ds)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self._ds["slipper"].values, dtype, copy=copy)

    def __len__(self) -> int:
        return len(self._ds["slipper"])

    def __iter__(self) -> Iterator[object]:
        return iter(self._ds["slipper"])

    def __getitem__(self, key: object) -> object:
        return self._ds["slipper"][key]

    def __bool__(self) -> bool:
        return True

    def __dir__(self) -> list[str]:
        from . import plots

        return [name for name, draw in vars(plots).items() if inspect.isfunction(draw)]
