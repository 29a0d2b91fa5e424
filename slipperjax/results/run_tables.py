"""Tables of a run: its windows, its hundreds of metres and its worst places, with units in their headers."""

import itertools
from typing import Any

import numpy as np
import pandas as pd

from ..flow.status import Status
from ..model.quantities import Quantity, point_dims
from ..plots.runs import PEAKS, RunView, edges_of, highest_forces, speed_name, stretch_of_windows

SUMMED = ("impacts", "impulse", "friction_work")
"""Numbers that are summed over points and windows; for others the highest value counts."""
MEANS = ("speed", "contact_fraction", "drive_force", "slipper_force", "slipper_roll")
"""Numbers that are averaged over windows."""
PLACED = {
    "peak_slipper_force": ("slipper_load", "peak_slipper_distance"),
    "peak_force": ("point", "peak_distance"),
}
"""Columns for the highest forces of `PEAKS`: their load or point, as a text, and their place."""
SIGNED = ("peak_slipper_force", "peak_slipper_moment")
"""Numbers for which the value of greatest magnitude counts."""
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
    for name, (label, place) in PLACED.items():
        if name not in ds:
            continue
        at = highest_forces(ds, name)
        force = at[name].values
        touched = abs(force) > 0
        # label and place are empty without contact
        columns |= {
            name: force,
            label: np.where(touched, at[PEAKS[name].dim].values, ""),
            place: np.where(touched, at[place].values, np.nan),
        }
    for name, values in ds.data_vars.items():
        known = name in columns and name not in SIGNED
        if "distance" not in values.dims or known or values.dtype.kind not in "fiu":
            continue
        if "point" in values.dims:
            joined = values.sum if name in SUMMED else values.max
            values = joined(point_dims(values), skipna=False)
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


def of_hundreds(windows: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each 100 m of rail, from the windows whose middles are in it; without numbers if one is lost.

    **Arguments:** `windows`: the table of `of_windows`.
    """
    middles = (windows["from"] + windows["to"]) / 2 - windows["from"][0]
    rows = []
    for _, part in windows.groupby(middles // HUNDRED):
        row: dict[str, object] = {"from": part["from"].iloc[0]}
        row |= {"to": part["to"].iloc[-1], "time": part["time"].iloc[-1]}
        row["status"] = ", ".join(part["status"].unique())
        for name, placed in PLACED.items():
            if name in part:
                # NaN counts as the highest value there
                highest = int(np.argmax(part[name].abs().to_numpy()))
                row |= {each: part[each].iloc[highest] for each in (name, *placed)}
        for name in part.columns.difference(list(row), sort=False):
            # the variable comes first, before a slipper or a direction
            of = name.split(" ")[0]
            how = "sum" if of in SUMMED else "mean" if of in MEANS else "max"
            row[name] = _farthest(part[name]) if of in SIGNED else part[name].agg(how, skipna=False)
        rows.append(row)
    return pd.DataFrame(rows, columns=windows.columns)


def _farthest(values: pd.Series) -> float:
    """Return the value of greatest magnitude, with its sign; NaN where any value is NaN."""
    return values.iloc[int(np.argmax(values.abs().to_numpy()))]


def of_worst(windows: pd.DataFrame) -> pd.DataFrame:
    """Return the windows with the greatest net forces, the greatest first, at places that are `APART` or more apart.

    Each window has its highest contact point. Without net forces the windows with the highest contact points are
    returned.

    **Arguments:** `windows`: the table of `of_windows`.
    """
    known = [name for name in PLACED if name in windows]
    # without forces there are no worst windows
    name = known[0] if known else "peak_force"
    label, place = PLACED[name]
    columns = [place, "speed", label, name]
    for other in known[1:]:
        columns += [PLACED[other][0], other]
    rows = []
    left = windows[windows[name].abs() > 0] if known else windows[:0]
    while len(left) and len(rows) < WORST:
        row = left.loc[left[name].abs().idxmax()]
        rows.append(row[columns])
        left = left[(left[place] - row[place]).abs() >= APART]
    return pd.DataFrame(rows, columns=columns).reset_index(drop=True)


def shown_table(view: RunView, table: pd.DataFrame) -> pd.DataFrame:
    """Return a table in display units, which its header states."""
    columns = {}
    for name, values in table.items():
        q = quantity_of_column(view, str(name))
        if q is None:
            columns[name] = values
        else:
            columns[name if q.display_unit == "1" else f"{name} [{q.display_unit}]"] = q.shown(values)
    return pd.DataFrame(columns)


def quantity_of_column(view: RunView, name: str) -> Quantity | None:
    """Return the quantity of a column; None for a column of texts."""
    if name in ("status", "point", "slipper_load"):
        return None
    if name == "time":
        return view.units.of(Quantity(name, "s", name))
    # distances, also the distance of the peak
    if name.split(" ")[0] in ("from", "to", "peak_distance", "peak_slipper_distance"):
        return view.quantity("distance")
    # the variable comes first, before a direction
    return view.quantity(name.split(" ")[0])


def words(code: int) -> str:
    """Return a status in one or two words."""
    return Status(code).name.lower().replace("_", " ")


def tables(view: RunView) -> dict[str, pd.DataFrame]:
    """Return the tables of a run by name, in display units."""
    windows = of_windows(view)
    made = {"windows": windows, "100 m": of_hundreds(windows), "worst places": of_worst(windows)}
    return {name: shown_table(view, table) for name, table in made.items()}
