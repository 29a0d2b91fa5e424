"""Texts and tables of many cases: sweeps over parameters, and runs over parameters."""

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.kinds import KINDS, REGIMES, lasting
from ..flow.datasets import SCENE_NUMBER
from ..flow.status import counted, is_lost
from ..model.quantities import POINT_DIMS
from ..plots.maps import regimes_of
from ..plots.runs import PEAKS, RunView
from ..plots.style import Units, shown_columns
from ..tools.checks import warn
from ..tools.files import first_ones
from .run_tables import in_display_units, of_stretches, of_windows, over_points

PLACES = ("peak_period", *(peak.place for peak in PEAKS.values()))
"""Places of highest values, which belong to one contact point or slipper: the highest place means nothing."""


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
    elif "kind" in ds:
        # recurrence has a name for each kind, and cannot tell transient chaos
        names = regimes_of(ds, *map(str, ds["status"].dims))
        found = [f"{int(np.sum(names == name))} {name}" for name in REGIMES[: len(KINDS)]]
        lines.append(f"by recurrence: {', '.join(found)}")
    return lines


def summary_of_runs(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return several runs as a text: their number, and how many are lost."""
    status = ds["status"]
    lines = [f"{status.size} runs over {', '.join(map(str, status.dims))}"]
    return lines + [f"{n} run{'s' * (n > 1)}: {meaning}" for meaning, n in counted(status.values).items()]


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each case. A warning names the variables that are left out, because they have many values in
    each case."""
    dims = list(map(str, ds["status"].dims))
    ds = _numbers_of_cases(ds)
    left = [str(name) for name, values in ds.data_vars.items() if set(values.dims) != set(dims)]
    if left:
        warn(f"The table leaves out {first_ones(left)}, with several values in each case; a file .nc has all values.")
    return {"cases": shown_columns(ds, *dims, units=units)}


def tables_of_runs(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each run, and a row for each window of each run, with what was varied in front.

    Root mean squares of stretches are in the windows alone, because the greatest is not that of a run.
    """
    dims = list(map(str, ds["status"].dims))
    ds = ds.drop_vars(SCENE_NUMBER, errors="ignore").stack(run=dims, create_index=False)
    varied = shown_columns(ds[["status"]], "run", units=units).drop(columns="status")
    runs = shown_columns(ds, "run", units=units)
    views = [RunView.of(ds.isel(run=k), units=units) for k in range(ds.sizes["run"])]
    windows = [of_windows(view) for view in views]
    wholes = [of_stretches(each, np.inf).filter(regex="^(?!status|rms_)") for each in windows]
    of_each = varied.iloc[np.repeat(runs.index, list(map(len, windows)))]
    return {"runs": _beside(runs, views, wholes), "windows": _beside(of_each, views, windows)}


def _beside(first: pd.DataFrame, views: list[RunView], tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Return a table and, beside it, one below the other, tables of runs, without columns that the first has."""
    shown = [in_display_units(view, table) for view, table in zip(views, tables, strict=True)]
    numbers = pd.concat(shown, ignore_index=True).drop(columns=first.columns, errors="ignore")
    return pd.concat([first.reset_index(drop=True), numbers], axis=1)


def _numbers_of_cases(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset where each case has one number of all contact points, and the largest of several exponents, as
    in pictures."""
    # the checksum of a scene means something only next to the scene, which tables do not have
    ds = ds.drop_vars(SCENE_NUMBER, errors="ignore")
    if "count" in ds.dims:
        ds = ds.isel(count=0, drop=True)
    of_points = {*ds["status"].dims, *POINT_DIMS}
    return ds.assign(
        {
            name: over_points(values)
            for name, values in ds.data_vars.items()
            if set(values.dims) <= of_points and values.dtype.kind in "fiu" and name not in PLACES
        }
    )
