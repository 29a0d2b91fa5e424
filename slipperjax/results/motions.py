"""Texts and tables of motions: simulated motions, periodic orbits, branches of orbits, and curves of their events."""

import json
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.degenerate import POINTS
from ..flow.datasets import scene_of, varied_names
from ..flow.status import Status, is_lost, step_error
from ..model.scene import travel_unit
from ..plots.style import Units, quantity_of, shown_columns
from ..plots.trajectories import Along, most_loaded

LEADING = 4
"""Number of multipliers in a summary."""


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a trajectory as a text."""
    status = Status(int(ds.attrs["status"]))
    scene = scene_of(ds)
    lines = [f"status: {status}", f"{ds.attrs['steps_per_period']} steps per {travel_unit(scene)}"]
    # forces and errors of a lost motion mean nothing
    if is_lost(status):
        return lines
    highest = most_loaded(ds, 1)[0]
    if "peak_force" in ds and highest.peak > 0:
        along = Along.of(ds)
        when = along.words.format(along.unit * highest.instant)
        lines.append(f"highest single contact point {highest.peak:.4g} kN at {highest.name}, {when}")
    error = ds.attrs.get("probe_error [scales]")
    if error is not None:
        # without contact there is no force, and no error of a force
        peak = ds.attrs.get("probe_peak_error", np.nan)
        force = f" and its highest force by {peak:.1e} of it" if np.isfinite(peak) else ""
        lines.append(step_error(scene, error) + force)
    return lines


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each saved state."""
    return {"motion": shown_columns(ds, "time", units=units)}


def orbit_summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a periodic orbit as a text."""
    attrs = ds.attrs
    period = int(attrs["orbit_period"])
    multipliers = ds["multiplier_real"].values + 1j * ds["multiplier_imag"].values
    exponent = np.log(abs(multipliers[0])) / period
    # a real multiplier has no imaginary part
    leading = [f"{mu.real:.6g}" + (f"{mu.imag:+.6g}i" if mu.imag else "") for mu in multipliers[:LEADING]]
    return [
        f"period {period}, {'stable' if attrs['stable'] else 'unstable'}, largest exponent {exponent:.6g} per "
        "forcing period",
        f"multipliers {', '.join(leading)}, ...",
        f"touchdowns {attrs['signature'] or 'none'}",
        f"{attrs['iterations']} iterations of Newton's method, residual {attrs['residual']:.1g} (scaled)",
        *summary(ds),
    ]


def orbit_tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return the motion over the period, and a row for each multiplier."""
    multipliers = ds[["multiplier_real", "multiplier_imag"]].to_dataframe()
    return tables(ds, units) | {"multipliers": multipliers}


def branch_summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a branch over one parameter as a text, with a line for each event."""
    (name,) = varied_names(ds)
    varied = quantity_of(name, ds)
    values = ds[name].values
    shown = lambda value: f"{varied.shown(value):.8g}"
    first, last = (f"{shown(values[k])} ({ds.attrs['ended'][k] or 'start'})" for k in (0, -1))
    title = f"{name} [{varied.display_unit}]"
    lines = [
        f"orbits of period {ds.attrs['orbit_period']} over {name}: {len(values)} points, "
        f"{int(np.sum(ds['stable'].values))} stable, from {first} to {last} {varied.display_unit}",
        f"  {'label':5}  {title:>20}  {'+-':>7}  {'multiplier':>22}  outside",
    ]
    for event in _events_of(ds).itertuples():
        error = varied.shown(event.high - event.low) / 2
        real, imag = float(event.multiplier_real), float(event.multiplier_imag)
        # grazings and ends have no critical multiplier
        critical = "" if np.isnan(real) else f"{real:.5f}" + (f"{imag:+.5f}i" if imag else "")
        sure = f"{error:.0e}" if event.converged else "unsure"
        outside = ds["outside"].values[event.point]
        lines.append(
            f"  {event.label:5}  {shown(event.value):>20}  {sure:>7}  {critical:>22}  {outside:>7}"
            f"  {event.note}".rstrip()
        )
    return lines


def branch_tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each point, and a row for each event."""
    return points_tables(ds) | {"events": _events_of(ds)}


def _events_of(ds: xr.Dataset) -> pd.DataFrame:
    """Return a row for each event of a branch, in the order of its points."""
    # the table of events has all variables along `event` only
    names = [name for name, array in ds.data_vars.items() if array.dims == ("event",)]
    return ds[names].to_dataframe().rename(columns=lambda name: name.removeprefix("event_"))


def points_tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
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


def curve_summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a curve of events over two parameters as a text."""
    names = varied_names(ds)

    def at(k: int, errors: Mapping[str, float]) -> str:
        """Return both parameters at a point, with their errors where they are known."""
        return ", ".join(number(ds[name].values[k], 0.0, errors.get(name, 0.0)) for name in names)

    first, last = (f"({at(k, {})}: {ds.attrs['ended'][k] or 'start'})" for k in (0, -1))
    lines = [
        f"{ds.attrs['label']} of period {ds.attrs['orbit_period']} over {' and '.join(names)}: "
        f"{ds.sizes['point']} points, from {first} to {last}"
    ]
    if "event_coefficients" not in ds:
        return lines
    columns = (ds[f"event_{name}"].values.tolist() for name in ("label", "point", "coefficients", "stderr", "note"))
    for name, point, coefficients, stderr, note in zip(*columns, strict=True):
        if name in POINTS:
            texts = [f"{key} = {number(*parts)}" for key, parts in json.loads(coefficients).items()]
            lines.append(f"  {name} at ({at(point, json.loads(stderr))}): {', '.join(texts) or note}")
    return lines


def number(real: float, imaginary: float, error: float) -> str:
    """Return a coefficient or a place as a text, with its error where it has one."""
    text = f"{real:.6g}" + (f"{imaginary:+.6g}i" if imaginary else "")
    return f"{text} +- {error:.1g}" if error else text
