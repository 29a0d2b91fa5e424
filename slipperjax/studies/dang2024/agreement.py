"""How well the curves of a map predict what simulations show, in numbers of cells."""

from typing import Any

import numpy as np
import xarray as xr

from ...analysis.regions import Agreement, agreement


def agreements(ds: xr.Dataset) -> dict[str, Agreement]:
    """The prediction of a map against both runs of each case.

    "beside": the curves enclose a stable orbit exactly where a run that begins beside it stays on it; cases without
    an orbit near, in which nothing was tested, do not count. "one start": likewise for motions of period 1 that Table
    2's start leads to.
    """
    predicted, band = ds["predicted"].values, ds["beside_curve"].values
    counts = lambda name: ds[name].values == 0
    return {
        "beside": agreement(predicted, ds["kept"].values, band, ds["tested"].values & counts("beside_status")),
        "one start": agreement(predicted, ds["period"].values == 1, band, counts("status")),
    }


def disagreements(ds: xr.Dataset) -> dict[str, int]:
    """Why Table 2's start does not show what the curves predict, in numbers of cases.

    "another attractor": the orbit is stable, as the run beside it shows, and the start leads elsewhere; "another
    orbit": the start leads to an orbit of period 1 of another family; "not explained": all others.
    """
    one, good = ds["period"].values == 1, ds["status"].values == 0
    predicted, kept = ds["predicted"].values, ds["kept"].values
    unseen, unpredicted = predicted & ~one & good, ~predicted & one & good
    coexisting, other = unseen & kept, unpredicted & ~ds["on_orbit"].values & ~kept
    found = {"another attractor": coexisting, "another orbit": other}
    return {name: int(a.sum()) for name, a in found.items()} | {
        "not explained": int(((unseen & ~coexisting) | (unpredicted & ~other)).sum())
    }


def agreement_rows(ds: xr.Dataset) -> list[dict[str, Any]]:
    """A table of the agreement of a map, one row per quantity."""
    found, why = agreements(ds), disagreements(ds)
    near, one = found["beside"], found["one start"]
    share = lambda value: "none" if np.isnan(value) else f"{value:.1f} %"
    rows = {
        "cells": f"{ds['predicted'].size}",
        "cells with a stable orbit by the curves": f"{int(ds['predicted'].sum())}",
        "cells beside a curve": f"{int(ds['beside_curve'].sum())}",
        "run beside the orbit: cells tested": f"{near.cells}",
        "run beside the orbit: agreement": share(near.percent),
        "of cells away from the curves": share(near.percent_away),
        "of cells beside a curve": share(near.percent_beside),
        "Table 2's start: agreement": share(one.percent),
        "of cells away from the curves ": share(one.percent_away),
        "cells that disagree": f"{one.cells - one.agreeing}",
        "stable, but the start leads to another attractor": f"{why['another attractor']}",
        "unstable, and the start leads to another orbit of period 1": f"{why['another orbit']}",
        "not explained": f"{why['not explained']}",
    }
    rows |= {f"time: {name[8:].replace('_', ' ')}": f"{ds.attrs[name]:.0f} s" for name in _TIMES if name in ds.attrs}
    return [{"quantity": name.strip(), "value": value} for name, value in rows.items()]


_TIMES = ("seconds_curves", "seconds_orbits", "seconds_one_start", "seconds_beside")
