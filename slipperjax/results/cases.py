"""Texts and tables of many cases: sweeps over parameters, and runs over parameters."""

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.kinds import REGIMES, lasting
from ..flow.status import counted, is_lost
from ..plots.style import Units, shown_columns


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a sweep as a text."""
    status = ds["status"].values
    periods = f", {ds.attrs['settled']} + {ds.attrs['measured']} periods" if "measured" in ds.attrs else ""
    # one number, or the least and the greatest
    steps = ds["steps_per_period"]
    many = " to ".join(map(str, np.unique([steps.min(), steps.max()])))
    lines = [f"{status.size} cases{periods}, {many} steps per period"]
    counts = counted(status)
    meanings = " and ".join(f"{n} {meaning}" for meaning, n in counts.items())
    lines.append(f"{sum(counts.values())} cases flagged" + (f" ({meanings})" if meanings else ""))
    # the error of a lost case means nothing
    lost = is_lost(status)
    if "probe_error" in ds and not lost.all():
        most = float(ds["probe_error"].values[~lost].max())
        lines.append(f"half the step changes the motion by {most:.1e} scales at most")
    # chaos is named with its least mean life
    if "regime" in ds:
        life = ds.get("least_mean_life", np.nan)
        found = [f"{int((ds['regime'] == name).sum())} {lasting(name, life)}" for name in REGIMES]
        lines.append(", ".join(found))
    return lines


def summary_of_runs(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return several runs as a text: their number, and how many are lost."""
    status = ds["status"]
    lines = [f"{status.size} runs over {', '.join(map(str, status.dims))}"]
    return lines + [f"{n} runs: {meaning}" for meaning, n in counted(status.values).items()]


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each case."""
    name = "runs" if "distance" in ds.dims else "cases"
    return {name: shown_columns(ds, *map(str, ds["status"].dims), units=units)}
