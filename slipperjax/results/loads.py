"""Texts and tables of loads that size parts."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.status import counted, is_lost
from ..model.quantities import Quantity, ShownUnits
from ..plots.comparisons import of_runs
from ..plots.loads import KINDS, Load, load_quantity, loads_of
from ..plots.style import Units, shown_units
from .run_tables import lines_of, words

DISTANCE = Quantity("distance", "m", "distance travelled")
SPEED = Quantity("speed", "m/s", "speed")


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return loads as a text: lost runs, and a line for each load."""
    return [*_lost(ds), *_words(ds, shown_units(ds, units))]


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a table of forces and a table of moments, with a row for each part, axis and interval of time."""
    chosen = shown_units(ds, units)
    return {name: _table(ds, kind, chosen) for name, kind in KINDS.items()}


def report(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return the text of a report: lost runs and the tables."""
    text = list(_lost(ds))
    for name, table in tables(ds, units).items():
        # quantiles for which there are too few runs are left out
        text += [name, "", *lines_of(table.dropna(axis=1, how="all")), ""]
    return text


def _lost(ds: xr.Dataset) -> Iterator[str]:
    """Yield texts that say how many runs there are, and which are lost and therefore left out."""
    codes = ds["status"].values
    if codes.ndim == 0 and not is_lost(int(codes)):
        return
    yield f"{codes.size} run{'s' * (codes.size > 1)}" + (
        f" over {', '.join(map(str, ds['status'].dims))}" * codes.ndim
    )
    yield from (f"{n} runs: {meaning}" for meaning, n in counted(codes).items())
    lost = np.flatnonzero(is_lost(np.ravel(codes)))
    if len(lost):
        yield f"runs number {', '.join(map(str, lost[:10]))} are lost, and left out"


def _words(ds: xr.Dataset, chosen: ShownUnits) -> Iterator[str]:
    """Yield a line for each load: its peak with its place, and its means over time."""
    for kind in KINDS.values():
        q = load_quantity(kind, chosen)
        rows = list(loads_of(ds, kind))
        for part, axis in dict.fromkeys((row.part, row.axis) for row in rows):
            mine = [row for row in rows if (row.part, row.axis) == (part, axis)]
            peak = mine[0]
            if np.isnan(peak.value):
                continue
            named = f"{axis} force" if kind == "force" else f"moment {axis}"
            where = f" at {_place(peak, chosen)}" * bool(peak.value)
            text = f"{part} {named}: {_said(q, peak.value)}{where}".strip()
            means = [f"{_said(q, row.value)} over {1e3 * row.mean:g} ms" for row in mine[1:]]
            shares = zip(ds["quantile"].values if "quantile" in ds.coords else [], peak.quantiles, strict=False)
            known = [f"{of_runs(s)} {_said(q, v)} +- {_said(q, e)}" for s, (v, e, *_) in shares if np.isfinite(v)]
            parts = [f"means {', '.join(means)}" * bool(means), f"peaks over runs: {', '.join(known)}" * bool(known)]
            yield "; ".join(filter(None, [text, *parts]))


def _said(q: Quantity, value: float) -> str:
    return f"{q.shown(value):.4g} {q.display_unit}"


def _place(load: Load, chosen: ShownUnits) -> str:
    """Return where a load is greatest, as a text."""
    where = _said(chosen.of(DISTANCE), load.distance)
    return f"{where} and {_said(chosen.of(SPEED), load.speed)}" + f", {load.run}" * bool(load.run)


def _table(ds: xr.Dataset, kind: str, chosen: ShownUnits) -> pd.DataFrame:
    """Return a row for each load, with units in the header."""
    q = load_quantity(kind, chosen)
    place, speed = chosen.of(DISTANCE), chosen.of(SPEED)
    shares = ds["quantile"].values if "quantile" in ds.coords else []
    rows = []
    for load in loads_of(ds, kind):
        row: dict[str, object] = {"part": load.part} if load.part else {}
        row |= {
            "load": load.axis,
            "mean over [ms]": 1e3 * load.mean,
            f"greatest [{q.display_unit}]": q.shown(load.value),
            f"distance [{place.display_unit}]": place.shown(load.distance),
            f"speed [{speed.display_unit}]": speed.shown(load.speed),
        }
        row["status"] = words(load.status)
        for share, (value, error, *_) in zip(shares, load.quantiles, strict=True):
            row[f"{of_runs(share)} [{q.display_unit}]"] = q.shown(value)
            row[f"{of_runs(share)} +- [{q.display_unit}]"] = q.shown(error)
        if load.run:
            row["run"] = load.run
        rows.append(row)
    return pd.DataFrame(rows)
