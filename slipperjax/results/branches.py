"""Texts, tables and pictures of branches of orbits, and of curves of their events."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import varied_names
from ..plots.branches import branches, event_curves
from ..plots.style import quantity_of
from .kind import Kind, Units


class PointsKind(Kind):
    """Orbits along a curve."""

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        """Return a row for each point: parameters, numbers of the orbits, multipliers and states [SI unit].

        Points of Poincare sections are left out, because their number differs from orbit to orbit.
        """
        columns = {name: ds[name].values for name in varied_names(ds)}
        columns |= {str(name): array.values for name, array in ds.data_vars.items() if array.dims == ("point",)}
        # a column for each multiplier and each number of the state
        for name in ("multiplier_real", "multiplier_imag", "state"):
            if name in ds:
                columns |= {f"{name}_{k}": column for k, column in enumerate(ds[name].values.T)}
        return {"points": pd.DataFrame(columns, index=ds["point"].to_index())}


class BranchKind(PointsKind):
    """A branch over one parameter."""

    title = "Branch of orbits"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        (name,) = varied_names(ds)
        varied = quantity_of(name, ds)
        values = ds[name].values
        shown = lambda value: f"{varied.shown(value):.8g}"
        begin, end = ds.attrs["ended"]
        first = f"{shown(values[0])} ({begin or 'start'})"
        last = f"{shown(values[-1])} ({end or 'start'})"
        title = f"{name} [{varied.display_unit}]"
        lines = [
            f"orbits of period {ds.attrs['orbit_period']} over {name}: {len(values)} points, "
            f"{int(np.sum(ds['stable'].values))} stable, from {first} to {last} {varied.display_unit}",
            f"  {'label':5}  {title:>20}  {'+-':>7}  {'multiplier':>22}  outside",
        ]
        for event in events_of(ds).to_dict("records"):
            error = varied.shown(event["high"] - event["low"]) / 2
            real, imag = float(event["multiplier_real"]), float(event["multiplier_imag"])
            # grazings and ends have no critical multiplier
            critical = "" if np.isnan(real) else f"{real:.5f}" + (f"{imag:+.5f}i" if imag else "")
            sure = f"{error:.0e}" if event["converged"] else "unsure"
            outside = ds["outside"].values[event["point"]]
            lines.append(
                f"  {event['label']:5}  {shown(event['value']):>20}  {sure:>7}  {critical:>22}  {outside:>7}"
                f"  {event['note']}".rstrip()
            )
        return lines

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        return super().tables(ds, units) | {"events": events_of(ds)}

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return branches(ds, **options)


class OwnBranchKind(BranchKind):
    """A branch of a user's own system."""

    def plot(self, ds: xr.Dataset, quantity: str = "state_0", **options: Any) -> Any:
        return branches(ds, quantity, **options)


class CurveKind(PointsKind):
    """A curve of events over two parameters."""

    title = "Curve of events"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        names = varied_names(ds)
        ends = ds.attrs["ended"]
        at = lambda k: ", ".join(f"{ds[name].values[k]:.6g}" for name in names)
        first, last = (f"({at(k)}: {ends[k] or 'start'})" for k in (0, -1))
        return [
            f"{ds.attrs['label']} of period {ds.attrs['orbit_period']} over {' and '.join(names)}: "
            f"{ds.sizes['point']} points, from {first} to {last}"
        ]

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return event_curves(ds, **options)


def events_of(ds: xr.Dataset) -> pd.DataFrame:
    """Return a row for each event of a branch, in the order of its points."""
    # the table of events has all variables along `event` only
    names = [name for name, array in ds.data_vars.items() if array.dims == ("event",)]
    return ds[names].to_dataframe().rename(columns=lambda name: name.removeprefix("event_"))
