"""Methods of a kind of results."""

import abc
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Units = Sequence[str] | None
"""Units that a user chooses, such as ("ft", "lbf"); None for the units of the scene's file."""


class Kind(abc.ABC):
    """Texts, tables and pictures of the results of a function; one subclass for each kind of question."""

    title: str
    """Title of a report."""
    reports = False
    """Whether a PDF of the result also has its text, and pictures take `units`."""

    @abc.abstractmethod
    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        """Return a result as a text."""

    @abc.abstractmethod
    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        """Return the tables of a result, the main one first."""

    @abc.abstractmethod
    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        """Return the Axes of the picture of a result."""

    def report(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        """Return the text of a report."""
        return self.summary(ds, units)

    def pages(self, ds: xr.Dataset, units: Units = None) -> "Iterator[Figure]":
        """Yield the pictures of a report."""
        yield np.asarray(self.plot(ds, units=units)).flat[0].figure
