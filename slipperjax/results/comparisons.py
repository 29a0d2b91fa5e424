"""Texts and tables of designs that were compared over the same rails from the same starts."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.quantiles import Estimates
from ..flow.status import Status, is_lost
from ..plots.comparisons import Comparison, of_runs
from ..plots.style import Units
from ..tools.files import first_ones


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a text that says which design is better and how certain this is: first the status of lost runs, then a
    line for each design. Standard errors are after +-."""
    view = Comparison.of(ds, units)
    flat = view.ds
    lines = list(_lost(view))
    shares = flat["quantile"].values
    best = int(np.argmax(flat["best"].values))
    if np.isnan(flat["value"].isel(design=best, quantile=-1)):
        return [*lines, "too many runs are lost to tell which design is better"]
    for k, label in enumerate(view.labels):
        if k == best:
            continue
        at = flat.isel(design=k, quantile=-1)
        words = "is better than" if float(at["difference_low"]) > 0 else "cannot be told from"
        # first the last quantile, which decides
        each = [f"{view.said('difference', k, j)} in the {of_runs(shares[j])}" for j in reversed(range(len(shares)))]
        lines.append(f"{view.labels[best]} {words} {label}: by {', '.join(each)}")
    rails, starts = flat.sizes["rail"], flat.sizes["start"]
    runs = f"{rails} rail{'s' * (rails > 1)} from {starts} start{'s' * (starts > 1)} each"
    over = flat.attrs.get("mean_over")
    lines.append(f"{view.quantity.long_name}{f' over {over}' * bool(over)} on {runs}:")
    for k, label in enumerate(view.labels):
        values = [f"{of_runs(share)} {view.said('value', k, j)}" for j, share in enumerate(shares)]
        lines.append(f"{label}: {', '.join(values)}")
    return lines


def _lost(view: Comparison) -> Iterator[str]:
    """Yield texts that say which runs are lost, by their status, and which other runs do not count therefore."""
    codes = view.ds["status"].transpose("design", "rail", "start").values
    for code in np.unique(codes[is_lost(codes)]):
        runs = [f"{view.labels[k]} rail={rail} start={start}" for k, rail, start in np.argwhere(codes == code)]
        yield f"status of {len(runs)} of {codes.size} runs: {Status(int(code))}: {first_ones(runs)}"
    if not view.ds["counted"].all():
        along = "rail" if view.ds.sizes["rail"] > 1 else "start"
        counted = view.ds["counted"].all({"rail", "start"} - {along}).values
        left_out = f"{np.sum(~counted)} of {len(counted)} {along}s"
        yield f"{left_out} are left out for all designs, because a run is lost there"


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each design and quantile, with units in the header."""
    view = Comparison.of(ds, units)
    q = view.quantity
    rows = []
    for k, label in enumerate(view.labels):
        for j, share in enumerate(view.ds["quantile"].values):
            at = view.ds.isel(design=k, quantile=j)
            row = {"design": label, "quantile": share}
            row |= {
                f"{name.replace('_', ' ')} [{q.display_unit}]": q.shown(float(at[name])) for name in Estimates._fields
            }
            rows.append(row | {"runs": at["runs"].size, "lost": int(is_lost(at["status"].values).sum())})
    return {"designs": pd.DataFrame(rows)}
