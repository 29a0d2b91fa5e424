"""Texts and tables of vibration environments, in g as in test reports."""

import datetime
import json

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import sources_of
from ..plots.environment import RMS, greatest_of_rails, named_place, places_of, three_digits
from ..plots.style import Units
from .run_tables import status_column, statuses


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return an environment by frequency, a row for each band of each place.

    Columns are the place's coordinates [m], both edges of the band [Hz], and along each direction the maximum, the
    mean and the 95/50 limit over rails of the density [g^2/Hz], and of the shock response of an oscillator whose
    natural frequency is the upper edge [g].
    """
    rows = []
    for at in places_of(ds):
        columns: dict[str, object] = {f"{axis} [m]": float(at[axis]) for axis in "xyz"}
        columns |= {"low [Hz]": at["low"].values, "high [Hz]": at["high"].values}
        # there is one edge more than bands: the lowest edge has no row
        shock = at["shock_envelope"][..., 1:]
        for direction in at["direction"].values:
            for kind, values, unit in (("density", at["density_envelope"], "g^2/Hz"), ("shock response", shock, "g")):
                for name in at["summary"].values:
                    one = values.sel(direction=direction, summary=name)
                    columns[f"{kind} {direction} {name} [{unit}]"] = one.values
        rows.append(pd.DataFrame(columns))
    bands = pd.concat(rows, ignore_index=True).assign(**status_column(ds))
    return {"bands": bands} | _specification(ds)


def _specification(ds: xr.Dataset) -> dict[str, pd.DataFrame]:
    """Return the straight-line specification, a row for each breakpoint of each place and direction, in g^2/Hz; no
    table where a result has none."""
    if "specification_frequency" not in ds:
        return {}
    tables = []
    for at in places_of(ds):
        for direction in at["direction"].values:
            one = at.sel(direction=direction)
            known = np.isfinite(one["specification_frequency"].values)
            columns: dict[str, object] = {f"{axis} [m]": float(at[axis]) for axis in "xyz"}
            columns |= {
                "direction": str(direction),
                "frequency [Hz]": one["specification_frequency"].values[known],
                "density [g^2/Hz]": one["specification_density"].values[known],
                "g-RMS": float(one["specification_rms"]),
                "runs": ds.sizes["rail"],
                **status_column(ds),
            }
            tables.append(pd.DataFrame(columns))
    return {"specification": pd.concat(tables, ignore_index=True)}


def report(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return the text of a report: results, what they were made from, and the specification."""
    lines = [*summary(ds), "", *_stated(ds)]
    for table in _specification(ds).values():
        if table.empty:
            continue
        text = table.to_string(index=False, float_format="{:.4g}".format)
        lines += ["", "Specification", "", *text.splitlines()]
    return lines


def _stated(ds: xr.Dataset) -> list[str]:
    """Return what an environment was made from: rails, speeds, windows, margin, files, versions and the day."""
    if "windows of densities" not in ds.attrs:
        return []
    call = json.loads(ds.attrs["call"])
    low, high = (ds.attrs[f"{end} speed [m/s]"] for end in ("lowest", "highest"))
    window, count = ds.attrs["window of densities [s]"], ds.attrs["windows of densities"]
    rails = ds.sizes["rail"]
    versions = json.loads(ds.attrs.get("versions", "{}"))
    return [
        f"{rails} run{'s' * (rails > 1)} from {low:.4g} to {high:.4g} m/s",
        f"densities: Welch's method, {count} Hann windows of {window:.3g} s that overlap by half, in sixth octaves",
        "maximax: the greatest density of all windows and runs; mean: over all windows, the greatest of all runs",
        f"specification: straight lines {call.get('margin') or 0:g} dB above the maximax density of all runs",
        f"shock response: oscillators of Q = {call.get('quality') or 10:g}, greatest of all runs",
        *sources_of(ds),
        f"slipperjax {versions.get('slipperjax', 'unknown')}, printed on {datetime.date.today().isoformat()}",
    ]


def _points(one: xr.Dataset) -> str:
    """Return the breakpoints of a specification as a text."""
    frequency, density = (one[f"specification_{name}"].values for name in ("frequency", "density"))
    known = np.isfinite(frequency)
    points = zip(frequency[known], density[known], strict=True)
    return ", ".join(f"{three_digits(f)} Hz {level:.2g}" for f, level in points) + " g^2/Hz"


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return an environment as a text, two lines for each place: the greatest values of all rails."""
    lines = statuses(ds)
    rails = ds.sizes["rail"]
    low, high = (float(ds[name][end]) for name, end in (("low", 0), ("high", -1)))
    for at in places_of(ds):
        greatest = greatest_of_rails(at)
        level, in_bands, loudest = (
            " ".join(f"{direction} {three_digits(value)}" for direction, value in greatest[name].items())
            for name in RMS
        )
        lines.append(
            f"environment at {named_place(at)}: g-RMS of the whole record {level}; of {low:g} to {high:g} Hz "
            f"{in_bands}, in the loudest window {loudest}"
        )
        worst = greatest["shock_response"].idxmax()
        shock = at["shock_response"].sel(direction=worst).max("rail")
        frequency = float(shock.idxmax("natural_frequency"))
        strongest = greatest["rms"].idxmax()
        lines.append(
            f"highest shock response {three_digits(shock.max())} g along {worst} at {three_digits(frequency)} Hz; "
            f"level within 6 dB of its highest for {greatest['duration'][strongest]:.3g} s along {strongest}"
        )
        if "specification_rms" in at:
            of_lines = at["specification_rms"].to_series()
            unknown = [str(direction) for direction, value in of_lines.items() if np.isnan(value)]
            if unknown:
                lines.append(f"no specification along {', '.join(unknown)}: fewer than two densities are known")
                continue
            most = of_lines.idxmax()
            # runs that are lost have been left out
            over = f" over {rails} rails" if rails > 1 else ""
            points = _points(at.sel(direction=most))
            lines.append(f"specification{over} along {most}: {points}; {of_lines[most]:.3g} g-RMS")
    return lines
