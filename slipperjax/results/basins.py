"""Texts and tables of basins of attraction."""

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.status import counted
from ..plots.style import Units, shown_columns


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return basins as a text: a line for each attractor, with the range of its shares."""
    status = ds["status"]
    lines = [f"{status.size} cases, {ds.sizes['attractor']} attractors"]
    lines += [f"{n} cases: {meaning}" for meaning, n in counted(status.values).items()]
    for k, period in enumerate(ds["basin_period"].values):
        share, error = (ds[name].isel(attractor=k).values for name in ("share", "share_stderr"))
        least, most = share.min(), share.max()
        of = f"{most:.3f}" if least == most else f"{least:.3f} to {most:.3f}"
        recurs = f"period {period}" if period else "no period"
        lines.append(f"attractor {k}, {recurs}: share {of} +- {error.max():.3f}")
    return lines


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each attractor at each value."""
    rows = shown_columns(ds[["share", "share_stderr"]], *map(str, ds["share"].dims), units=units)
    # the attractors are the last dimension of the shares
    again = len(rows) // ds.sizes["attractor"]
    rows.insert(0, "attractor", np.tile(np.arange(ds.sizes["attractor"]), again))
    rows.insert(1, "period", np.tile(ds["basin_period"].values, again))
    return {"basins": rows}
