"""Tables of a run: its windows, its hundreds of metres and its worst places, with units in their headers."""

import itertools
from typing import Any

import numpy as np
import pandas as pd

from ..flow.status import Status
from ..model.quantities import Quantity, point_dims
from .runs import RunView, edges_of, highest_forces, speed_name, stretch_of_windows

SUMMED = ("impacts", "impulse", "friction_work")
"""Numbers that are summed over points and windows; of others the highest counts."""
MEANS = ("speed", "contact_fraction", "drive_force", "slipper_force", "slipper_roll")
"""Numbers that are averaged over windows."""
PLACED = ("peak_force", "point", "peak_distance")
"""What belongs to the highest force."""
HUNDRED = 100.0
"""Length of rail of the second table [m]."""
APART = 10.0
"""Least distance between two worst places [m]."""
WORST = 10
"""Number of worst places."""


def of_windows(view: RunView) -> pd.DataFrame:
    """Return a row for each window: place [m], status in words, and numbers of all points together [SI unit].

    Names of columns are those of the dataset's variables. The highest force has its `point` and its `peak_distance`.
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
    if "peak_force" in ds:
        at = highest_forces(ds)
        force = at["peak_force"].values
        # point and place are empty without contact
        columns |= {
            "peak_force": force,
            "point": np.where(force > 0, at["contact"].values, ""),
            "peak_distance": np.where(force > 0, at["peak_distance"].values, np.nan),
        }
    for name, values in ds.data_vars.items():
        if "distance" not in values.dims or name in PLACED or values.dtype.kind not in "fiu":
            continue
        if "point" in values.dims:
            joined = values.sum if name in SUMMED else values.max
            values = joined(point_dims(values), skipna=False)
        # one column for each direction and the like
        others = [dim for dim in values.dims if dim != "distance"]
        for labels in itertools.product(*(values[dim].values for dim in others)):
            part = values.sel(dict(zip(others, labels, strict=True)))
            columns[" ".join(map(str, (name, *labels)))] = part.values
    # numbers of stretches, which are the same in all windows of one
    for name, values in ds.data_vars.items():
        if values.dims == ("stretch",) and str(name).startswith("rms_"):
            columns[str(name)] = values.values[stretch_of_windows(ds)]
    return pd.DataFrame(columns)


def of_hundreds(windows: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each 100 m of rail, of the windows whose middles lie in it; without numbers if one is lost.

    **Arguments:** `windows`: the table of `of_windows`.
    """
    middles = (windows["from"] + windows["to"]) / 2 - windows["from"][0]
    rows = []
    for _, part in windows.groupby(middles // HUNDRED):
        row: dict[str, object] = {"from": part["from"].iloc[0]}
        row |= {"to": part["to"].iloc[-1], "time": part["time"].iloc[-1]}
        row["status"] = ", ".join(part["status"].unique())
        if "peak_force" in part:
            # NaN counts as the highest there
            highest = int(np.argmax(part["peak_force"].to_numpy()))
            row |= {name: part[name].iloc[highest] for name in PLACED}
        for name in part.columns.difference(list(row), sort=False):
            # the variable comes first, before a slipper or a direction
            of = name.split(" ")[0]
            how = "sum" if of in SUMMED else "mean" if of in MEANS else "max"
            row[name] = part[name].agg(how, skipna=False)
        rows.append(row)
    return pd.DataFrame(rows, columns=windows.columns)


def of_worst(windows: pd.DataFrame) -> pd.DataFrame:
    """Return the windows with the highest forces, the highest first, whose places are `APART` or more apart.

    **Arguments:** `windows`: the table of `of_windows`.
    """
    columns = ["peak_distance", "speed", "point", "peak_force"]
    rows = []
    # without forces there are none
    left = windows[windows["peak_force"] > 0] if "peak_force" in windows else windows[:0]
    while len(left) and len(rows) < WORST:
        row = left.loc[left["peak_force"].idxmax()]
        rows.append(row[columns])
        left = left[(left["peak_distance"] - row["peak_distance"]).abs() >= APART]
    return pd.DataFrame(rows, columns=columns).reset_index(drop=True)


def shown_table(view: RunView, table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in display units, which stand in its header."""
    columns = {}
    for name, values in table.items():
        q = quantity_of_column(view, str(name))
        if q is None:
            columns[name] = values
        else:
            columns[name if q.display_unit == "1" else f"{name} [{q.display_unit}]"] = q.shown(values)
    return pd.DataFrame(columns)


def quantity_of_column(view: RunView, name: str) -> Quantity | None:
    """Return the quantity of a column; None for one of words."""
    if name in ("status", "point"):
        return None
    if name == "time":
        return view.units.of(Quantity(name, "s", name))
    # distances, also that of the peak
    if name in ("from", "to", "peak_distance"):
        return view.quantity("distance")
    # the variable comes first, before a direction
    return view.quantity(name.split(" ")[0])


def words(code: int) -> str:
    """Return a status in one or two words."""
    return Status(code).name.lower().replace("_", " ")


def tables(view: RunView) -> dict[str, pd.DataFrame]:
    """Return the tables of a run by their names, in display units."""
    windows = of_windows(view)
    made = {"windows": windows, "100 m": of_hundreds(windows), "worst places": of_worst(windows)}
    return {name: shown_table(view, table) for name, table in made.items()}
