"""Texts, tables and pictures of sweeps over parameters."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.kinds import REGIMES, lasting
from ..flow.status import counted, is_lost
from ..plots.style import shown_columns
from ..plots.sweeps import of_sweep
from .kind import Kind, Units


class SweepKind(Kind):
    """Cases over parameters, with the recorded values of each."""

    title = "Sweep over parameters"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
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

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        return {"cases": shown_columns(ds, *map(str, ds["status"].dims), units=units)}

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return of_sweep(ds, **options)
