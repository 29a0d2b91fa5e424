"""Results: all results have the same methods for summary, tables, picture and files, and one function loads them."""

import abc
import html
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..flow.datasets import load_call, scene_of, start_of
from ..flow.status import Status
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..tools.checks import require
from ..tools.files import first_ones, write_each
from .writing import contents_of

if TYPE_CHECKING:
    import os

    import pandas as pd
    import xarray as xr

    from .kinds import Kind

WIDTH = 92
"""Characters in a line of what a result prints."""


class AbstractResult(abc.ABC):
    """A result, with its numbers as a dataset of xarray.

    Subclasses also have `scene` and `status`.
    """

    @property
    @abc.abstractmethod
    def ds(self) -> "xr.Dataset":
        """All numbers, with units and with the call that made them, as one dataset for files and pictures."""

    @property
    def call(self) -> dict[str, Any]:
        """The name of the function that made the result, as `function`, and its arguments by name, without scene,
        grid and start."""
        return load_call(self.ds)

    def summary(self, units: Sequence[str] | None = None) -> list[str]:
        """Return the result as a text, with a line for each finding: problems come first.

        **Arguments:** `units`: such as ("ft", "lbf", "g"), each for the quantities of its kind; by default the units
        of the scene's file.
        """
        kind, ds = _known(self)
        return kind.summary(ds, units)

    def tables(self, units: Sequence[str] | None = None) -> "dict[str, pd.DataFrame]":
        """Return the result as tables by name, the main table first, with units in their headers.

        **Arguments:** as for `summary`.
        """
        kind, ds = _known(self)
        return kind.tables(ds, units)

    def plot(self, *, units: Sequence[str] | None = None, **options: Any) -> Any:
        """Draw the picture that suits the result.

        **Arguments:** `units`: as for `summary`; `options`: of the picture, see `slipperjax.plots`.

        **Returns:** Axes of matplotlib, or an array of them.

        **Raises:** `ValueError` where no picture suits, as for a sweep over three parameters.
        """
        from ..plots.style import in_units  # here, because pictures take long to import

        kind, ds = _known(self)
        return kind.plot(in_units(ds, units), **options)

    def write(
        self,
        *paths: "str | os.PathLike[str]",
        units: Sequence[str] | None = None,
        picture: Callable[..., Any] | None = None,
        **options: object,
    ) -> str:
        """Write files, each whole or not at all, by their endings.

        - `.nc`: all numbers, which `slipperjax.load` reads; `.mat`: the same for MATLAB.
        - `.png`, `.svg`, `.pdf`: the picture; for a run, a comparison and an environment the PDF is a report, whose
            first page is a text.
        - `.csv`: the main table, and further tables in files with their names before the ending; `.xlsx`: summary and
            tables as sheets.

        **Arguments:** `units`: as for `summary`; `picture`: a function of a dataset that draws another picture and
        returns its Axes, such as `slipperjax.plots.quantity_map`; `options`: of the picture, as for `plot`.

        **Returns:** a text that names the written files.

        **Raises:** `ValueError` for another ending; `OSError` for a file that cannot be written.
        """
        kind, ds = _known(self)
        if picture is not None:
            require(callable(picture), "picture", "be a function that returns Axes of matplotlib", picture)
            # alone, without the text of a report
            kind = kind._replace(plot=picture, title="")
        return write_each(contents_of(kind, ds, paths, units, options))

    def __repr__(self) -> str:
        return "\n  ".join([type(self).__name__, *self.summary()])


def _known(result: AbstractResult) -> "tuple[Kind, xr.Dataset]":
    """Return the kind of a result, and its dataset, which some results compute."""
    # here, because texts and pictures take long to import
    from .kinds import kind_of

    ds = result.ds
    return kind_of(ds), ds


class Result(AbstractResult):
    """A result that is a dataset: `result["peak_force"]`, `result.sizes` and all other names of the dataset work.

    `isel` and `sel` return a part of the result as a result; other methods of xarray return what they return there.
    """

    def __init__(self, ds: "xr.Dataset"):
        # recognised by its attributes, because xarray takes long to import
        require(hasattr(ds, "data_vars") and hasattr(ds, "attrs"), "ds", "be an xarray.Dataset", ds)
        self._ds = ds

    @property
    def ds(self) -> "xr.Dataset":
        return self._ds

    @property
    def scene(self) -> Scene:
        """The scene of a result of one case, such as `result.isel(speed=3)`; exactly as it was.

        **Raises:** `ValueError` for several cases.
        """
        return scene_of(self.ds)

    @property
    def start(self) -> Motion | State:
        """The motion or state with which the only case began; raises as `scene`."""
        return start_of(self.ds)

    @property
    def status(self) -> "Status | xr.DataArray":
        """The `Status` of one case, or the codes of all cases."""
        found = self.ds["status"] if "status" in self.ds else self.ds.attrs.get("status", int(Status.FINITE))
        return Status(int(found)) if np.ndim(found) == 0 else found

    def isel(self, *args: Any, **kwargs: Any) -> "Result":
        """Return a part of the result by positions, as of `xarray.Dataset.isel`."""
        return type(self)(self.ds.isel(*args, **kwargs))

    def sel(self, *args: Any, **kwargs: Any) -> "Result":
        """Return a part of the result by values of its coordinates, as of `xarray.Dataset.sel`."""
        return type(self)(self.ds.sel(*args, **kwargs))

    def __getattr__(self, name: str) -> Any:
        # called only for names that this class lacks; `_ds` is such a name while a copy is made
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._ds, name)

    def __getitem__(self, key: Any) -> Any:
        return self.ds[key]

    def __contains__(self, name: object) -> bool:
        return name in self.ds

    def __iter__(self) -> Iterator[object]:
        return iter(self.ds)

    def __len__(self) -> int:
        return len(self.ds)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(name for name in dir(self.ds) if not name.startswith("_"))})

    def __repr__(self) -> str:
        ds = self.ds
        # a count of values for each dimension
        over = first_ones([f"{name} {size}" for name, size in ds.sizes.items()])
        has = f"variables {first_ones(list(map(str, ds.data_vars)))}; dimensions {over or 'none'}"
        return "\n  ".join([super().__repr__(), *textwrap.wrap(has, WIDTH)])

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(chr(10).join(self.summary()))}</pre>{self.ds._repr_html_()}"
