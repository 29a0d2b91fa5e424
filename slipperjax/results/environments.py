"""Texts, tables and pictures of vibration environments, in g as in test reports."""

import datetime
import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from ..plots.environment import RMS, greatest_of_rails, named_place, of_place, three_digits, vibration
from .kind import Kind, Units

FILE = r'"file": "([^"]+)", "sha256": "([^"]+)"'
"""A file with its digest, in the JSON of a scene."""


class EnvironmentKind(Kind):
    """The vibration environment of places."""

    title = "Vibration environment"
    reports = True

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        return environment_summary(ds)

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        return {"bands": environment_table(ds), "specification": specification_table(ds)}

    def report(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        lines = [*environment_summary(ds), "", *stated(ds)]
        lines += ["", "Specification", ""]
        return lines + specification_table(ds).to_string(index=False, float_format="{:.4g}".format).splitlines()

    def plot(self, ds: xr.Dataset, place: int = 0, units: Units = None, **options: Any) -> Any:
        return vibration(ds, place, **options)

    def pages(self, ds: xr.Dataset, units: Units = None) -> Iterator[Figure]:
        for place in range(ds.sizes["place"]):
            yield vibration(ds, place)[0, 0].figure


def environment_table(report: xr.Dataset) -> pd.DataFrame:
    """Return a report by frequency, a row for each band of each place.

    Columns are the place's coordinates [m], both edges of the band [Hz], and along each direction the maximum, the
    mean and the 95/50 limit over rails of the density [g^2/Hz], and of the shock response of an oscillator whose
    natural frequency is the upper edge [g].
    """
    tables = []
    for place in range(report.sizes["place"]):
        at = of_place(report, place)
        columns: dict[str, object] = {f"{axis} [m]": float(at[axis]) for axis in "xyz"}
        columns |= {"low [Hz]": at["low"].values, "high [Hz]": at["high"].values}
        # there is one edge more than bands: the lowest edge has no row
        shock = at["shock_envelope"][..., 1:]
        for direction in at["direction"].values:
            for kind, values, unit in (("density", at["density_envelope"], "g^2/Hz"), ("shock response", shock, "g")):
                for name in at["summary"].values:
                    one = values.sel(direction=direction, summary=name)
                    columns[f"{kind} {direction} {name} [{unit}]"] = one.values
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def specification_table(report: xr.Dataset) -> pd.DataFrame:
    """Return the straight-line specification, a row for each breakpoint of each place and direction, in g^2/Hz."""
    tables = []
    for place in range(report.sizes["place"]):
        at = of_place(report, place)
        for direction in at["direction"].values:
            one = at.sel(direction=direction)
            known = np.isfinite(one["specification_frequency"].values)
            columns: dict[str, object] = {f"{axis} [m]": float(at[axis]) for axis in "xyz"}
            columns |= {
                "direction": str(direction),
                "frequency [Hz]": one["specification_frequency"].values[known],
                "density [g^2/Hz]": one["specification_density"].values[known],
                "g-RMS": float(one["specification_rms"]),
            }
            tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def stated(report: xr.Dataset) -> list[str]:
    """Return what a specification was made from: rails, speeds, windows, margin, files, versions and the day."""
    call = json.loads(report.attrs["call"])
    low, high = (report.attrs[f"{end} speed [m/s]"] for end in ("lowest", "highest"))
    window, count = report.attrs["window of densities [s]"], report.attrs["windows of densities"]
    rails = report.sizes["rail"]
    scene = report.attrs.get("scene", "")
    files = [f"{name} (sha256 {digest})" for name, digest in re.findall(FILE, scene)]
    versions = json.loads(report.attrs.get("versions", "{}"))
    return [
        f"{rails} run{'s' * (rails > 1)} from {low:.4g} to {high:.4g} m/s",
        f"densities: Welch's method, {count} Hann windows of {window:.3g} s that overlap by half, in sixth octaves",
        "maximax: the greatest density of all windows and runs; mean: over all windows, the greatest of all runs",
        f"specification: straight lines {call.get('margin') or 0:g} dB above the maximax density",
        f"shock response: oscillators of Q = {call.get('quality') or 10:g}, greatest of all runs",
        *(f"made with {name}" for name in files),
        f"slipperjax {versions.get('slipperjax', 'unknown')}, printed on {datetime.date.today().isoformat()}",
    ]


def environment_summary(report: xr.Dataset) -> list[str]:
    """Return a report as a text, two lines for each place: the greatest values of all rails."""
    lines = []
    low, high = (float(report[name][end]) for name, end in (("low", 0), ("high", -1)))
    for place in range(report.sizes["place"]):
        at = of_place(report, place)
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
        of_lines = at["specification_rms"].to_series()
        most = of_lines.idxmax()
        lines.append(f"specification along {most}: {_points(at.sel(direction=most))}; {of_lines[most]:.3g} g-RMS")
    return lines


def _points(one: xr.Dataset) -> str:
    """Return the breakpoints of a specification as a text."""
    frequency, density = (one[f"specification_{name}"].values for name in ("frequency", "density"))
    known = np.isfinite(frequency)
    points = zip(frequency[known], density[known], strict=True)
    return ", ".join(f"{three_digits(f)} Hz {level:.2g}" for f, level in points) + " g^2/Hz"
