"""Tables of a run: its windows, its hundreds of metres and its worst places, with units in their headers."""

import itertools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.status import Status, texts_of_status
from ..model.quantities import highest_of_points, point_dims
from ..plots.runs import PEAKS, RunView, edges_of, highest_forces, speed_name, stretch_of_windows

SUMMED = ("impacts", "impulse", "friction_work")
"""Numbers that are summed over points and windows; for others the highest value counts."""
MEANS = ("speed", "contact_fraction", "drive_force", "slipper_force", "slipper_roll")
"""Numbers that are averaged over windows."""
SIGNED = ("peak_slipper_force", "peak_slipper_moment")
"""Numbers for which the value of greatest magnitude counts."""
TEXTS = ("status", "point", "slipper_load")
"""Columns of texts."""
VARIABLES = {"time": "seconds"} | dict.fromkeys(("from", "to", "peak_distance", "peak_slipper_distance"), "distance")
"""Variables that have the units of columns of other names."""
HUNDRED = 100.0
"""Length of rail of the second table [m]."""
APART = 10.0
"""Least distance between two worst places [m]."""
WORST = 10
"""Number of worst places."""


def of_windows(view: RunView) -> pd.DataFrame:
    """Return a row for each window: place [m], status as a text, and numbers of all points together [SI unit].

    Columns have the names of the dataset's variables. The greatest net force of all slippers has its slipper and axis
    as `slipper_load`, and its place; the highest force of a contact point has its `point` and its place.
    """
    ds = view.ds
    edges = edges_of(ds, "distance")
    columns: dict[str, Any] = {
        "from": edges[:-1],
        "to": edges[1:],
        "time": ds["seconds"].values,
        "speed": ds[speed_name(ds)].values,
        "status": [words(code) for code in view.codes],
    }
    for name, peak in PEAKS.items():
        if name in ds:
            at = highest_forces(ds, name)
            touched = abs(at[name]) > 0
            # label and place are empty without contact
            columns |= {
                name: at[name].values,
                peak.column: np.where(touched, at[peak.dim], ""),
                peak.place: np.where(touched, at[peak.place], np.nan),
            }
    for name, values in ds.data_vars.items():
        known = name in columns and name not in SIGNED
        if "distance" not in values.dims or known or values.dtype.kind not in "fiu":
            continue
        # histories within windows are no numbers of windows
        if "sample" in values.dims:
            continue
        if "point" in values.dims:
            values = over_points(values)
        # one column for each direction or other label
        others = [dim for dim in values.dims if dim != "distance"]
        for labels in itertools.product(*(values[dim].values for dim in others)):
            part = values.sel(dict(zip(others, labels, strict=True)))
            columns[" ".join(map(str, (name, *labels)))] = part.values
    # numbers of stretches, which are the same in all windows of a stretch
    for name, values in ds.data_vars.items():
        if values.dims == ("stretch",) and str(name).startswith("rms_"):
            columns[str(name)] = values.values[stretch_of_windows(ds)]
    return pd.DataFrame(columns)


def over_points(values: xr.DataArray) -> xr.DataArray:
    """Return the number of all contact points or slippers together: the sum for `SUMMED`, otherwise the highest.

    Of net loads it is the greatest magnitude. It is NaN where any value is NaN.
    """
    if not point_dims(values):
        return values
    joined = values.sum(point_dims(values), skipna=False) if values.name in SUMMED else highest_of_points(values)
    return joined.assign_attrs(values.attrs)


def of_stretches(windows: pd.DataFrame, length: float = HUNDRED) -> pd.DataFrame:
    """Return a row for each stretch, from the windows whose middles are in it; without numbers if one is lost.

    **Arguments:** `windows`: the table of `of_windows`; `length`: of a stretch [m], infinite for the whole run.
    """
    middles = (windows["from"] + windows["to"]) / 2 - windows["from"][0]
    rows = []
    for _, part in windows.groupby(middles // length):
        row: dict[str, object] = {"from": part["from"].iloc[0]}
        row |= {"to": part["to"].iloc[-1], "time": part["time"].iloc[-1]}
        row["status"] = ", ".join(part["status"].unique())
        for name, peak in PEAKS.items():
            if name in part:
                highest = part.iloc[_farthest(part[name])]
                row |= {each: highest[each] for each in (name, peak.column, peak.place)}
        for name in part.columns.difference(list(row), sort=False):
            # the variable comes first, before a slipper or a direction
            of = name.split(" ")[0]
            how = "sum" if of in SUMMED else "mean" if of in MEANS else "max"
            column = part[name]
            row[name] = column.iloc[_farthest(column)] if of in SIGNED else column.agg(how, skipna=False)
        rows.append(row)
    return pd.DataFrame(rows, columns=windows.columns)


def _farthest(values: pd.Series) -> int:
    """Return the place of the value of greatest magnitude, or of NaN where any value is NaN."""
    return int(np.argmax(values.abs().to_numpy()))


def of_worst(windows: pd.DataFrame) -> pd.DataFrame:
    """Return the windows with the greatest net forces, the greatest first, at places that are `APART` or more apart.

    Each window has its highest contact point. Without net forces the windows with the highest contact points are
    returned.

    **Arguments:** `windows`: the table of `of_windows`.
    """
    known = [name for name in PEAKS if name in windows]
    # without forces there are no worst windows
    name = known[0] if known else "peak_force"
    peak = PEAKS[name]
    columns = [peak.place, "speed", peak.column, name]
    for other in known[1:]:
        columns += [PEAKS[other].column, other]
    rows = []
    left = windows[windows[name].abs() > 0] if known else windows[:0]
    while len(left) and len(rows) < WORST:
        row = left.loc[left[name].abs().idxmax()]
        rows.append(row[columns])
        left = left[(left[peak.place] - row[peak.place]).abs() >= APART]
    return pd.DataFrame(rows, columns=columns).reset_index(drop=True)


def words(code: int) -> str:
    """Return a status in one or two words."""
    return Status(code).name.lower().replace("_", " ")


def statuses(ds: xr.Dataset) -> list[str]:
    """Return how many runs of a dataset have a status other than 0, as texts; none where it has no status."""
    return texts_of_status(ds["status"].values) if "status" in ds else []


def status_column(ds: xr.Dataset) -> dict[str, str]:
    """Return a column of a table with the statuses of all runs of a dataset, none where it has no status."""
    return {"status": ", ".join(map(words, np.unique(ds["status"].values)))} if "status" in ds else {}


def lines_of(table: pd.DataFrame, form: str = "{:.4g}") -> list[str]:
    """Return a table as lines of a page, with the words of its header below each other, so that long lines fit.

    **Arguments:** `form`: of numbers that are not whole; missing numbers are left out.
    """
    # a unit in brackets is one word
    heads = [re.split(r"\s+(?![^\[]*\])", str(name)) for name in table]
    shown = lambda value: form.format(value).replace("nan", "") if isinstance(value, float) else str(value)
    cells = [list(map(shown, row)) for row in table.itertuples(index=False)]
    rows = [*itertools.zip_longest(*heads, fillvalue=""), *cells]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.rjust, row, widths)) for row in rows]


def tables(view: RunView) -> dict[str, pd.DataFrame]:
    """Return the tables of a run by name, in display units, which their headers state."""
    windows = of_windows(view)
    made = {"windows": windows, "100 m": of_stretches(windows), "worst places": of_worst(windows)}
    return {name: in_display_units(view, table) for name, table in made.items()}


def in_display_units(view: RunView, table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in display units, which its header states."""
    return pd.DataFrame(dict(_shown(view, table)))


def _shown(view: RunView, table: pd.DataFrame) -> Iterator[tuple[str, pd.Series]]:
    """Yield the columns of a table in display units, each with its header."""
    for name, values in table.items():
        # the variable comes first, before a direction
        of = str(name).split(" ")[0]
        if of in TEXTS:
            yield str(name), values
        else:
            q = view.quantity(VARIABLES.get(of, of))
            yield f"{name}" + f" [{q.display_unit}]" * (q.display_unit != "1"), q.shown(values)
