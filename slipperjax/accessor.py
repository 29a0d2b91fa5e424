"""`ds.slipper`: the pictures of a result, as methods of its dataset."""

import functools
import inspect
from collections.abc import Callable

import xarray as xr


@xr.register_dataset_accessor("slipper")
class Pictures:
    """All of `slipperjax.plots` that draws a dataset: `ds.slipper.plot()` is `slipperjax.plots.plot(ds)`."""

    def __init__(self, ds: xr.Dataset):
        self._ds = ds

    def __getattr__(self, name: str) -> Callable[..., object]:
        from . import plots  # not before a picture is asked for: matplotlib takes long to import

        return functools.partial(getattr(plots, name), self._ds)

    def __dir__(self) -> list[str]:
        from . import plots

        return [name for name, draw in vars(plots).items() if inspect.isfunction(draw)]
