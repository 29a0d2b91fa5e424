"""The one function that labels variables of datasets, with unit and description, in the form that xarray takes."""

from collections.abc import Sequence
from typing import TypeVar

Dims = str | Sequence[str]
Values = TypeVar("Values")


def column(
    dims: Dims, values: Values, unit: str, text: str, **more: object
) -> tuple[Dims, Values, dict[str, object]]:
    """Return dimensions, values and attributes of a dataset's variable.

    **Arguments:** `dims`: names of the dimensions, or one name; `unit`: SI unit, "1" for pure numbers, "" for texts
    and states; `text`: description in a few words; `more`: further attributes.
    """
    units = {"units": unit} if unit else {}
    return dims, values, units | {"long_name": text} | more
