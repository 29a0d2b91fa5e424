"""Texts, tables and pictures of vibration environments, in g as in test reports."""

from collections.abc import Iterator
from typing import Any

import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from ..plots.environment import RMS, greatest_of_rails, named_place, of_place, three_digits, vibration
from .kind import Kind, Units


class EnvironmentKind(Kind):
    """The vibration environment of places."""

    title = "Vibration environment"
    reports = True

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        return environment_summary(ds)

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        return {"bands": environment_table(ds)}

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
    return lines
