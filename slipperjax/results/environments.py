"""Texts and tables of vibration environments, in g as in test reports."""

import pandas as pd
import xarray as xr

from ..plots.environment import RMS, greatest_of_rails, named_place, places_of, three_digits
from ..plots.style import Units


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
    return {"bands": pd.concat(rows, ignore_index=True)}


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return an environment as a text, two lines for each place: the greatest values of all rails."""
    lines = []
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
    return lines
