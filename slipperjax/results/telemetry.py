"""Texts and tables of records over the model, in g as in test reports."""

import json

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import sources_of
from ..plots.environment import in_g, three_digits
from ..plots.style import Units
from ..plots.telemetry import Sides, sides_of
from .run_tables import status_column, statuses


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return tables of bands, of natural frequencies and of windows: record, model and their ratio [dB], a row for
    each; the model's columns are quantiles over rails."""
    made = {name: _table(ds, sides) for name, sides in sides_of(ds, units)}
    made["bands"].insert(0, "low [Hz]", ds["low"].values)
    made["bands"].insert(1, "high [Hz]", ds["high"].values)
    made["windows"]["bands up to [Hz]"] = ds["known_to"].values
    return {name: table.assign(**status_column(ds)) for name, table in made.items()}


def _table(ds: xr.Dataset, sides: Sides) -> pd.DataFrame:
    shares = ds["quantile"].values
    names = [f"model {100 * share:g} %" for share in shares] if len(shares) > 1 else ["model"]
    rows = zip(["record", *names], [sides.record, *sides.model], strict=True)
    columns = {f"{sides.at.long_name} [{sides.at.display_unit}]": sides.places}
    columns |= {f"{name} [{sides.of.unit}]": values for name, values in rows}
    return pd.DataFrame(columns | {"record over model [dB]": sides.ratio})


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a record over the model as a text: RMS of both sides, a line for each comparison, and what was done."""
    call = json.loads(ds.attrs["call"])
    shown = in_g(ds)
    model = [f"{three_digits(value)} g" for value in shown["total_rms"].values]
    several = len(model) > 1
    over = f"{ds.attrs['rails']} rails (5 to 95 %)" if several else "one run"
    band = f" ({model[0]} to {model[-1]})" if several else ""
    known = float(ds["known_to"].max())
    lines = [
        *statuses(ds),
        f"record at {call['sensor']['name']} over {over}, {call['low']:g} to {known:.4g} Hz",
        f"RMS: record {three_digits(shown['measured_total_rms'])} g, model {model[len(model) // 2]}{band}, "
        f"{float(ds['total_rms_ratio']):+.2f} dB",
        *(_compared(ds, name, sides) for name, sides in sides_of(ds, units)),
        f"both sides alike: {ds.attrs['rate [Hz]']:g} Hz, low-pass {ds.attrs['cutoff [Hz]']:g} Hz, line removed, "
        f"{ds.sizes['distance']} Hann windows of {ds.attrs['window of densities [s]']:.3g} s, "
        f"Q = {call['quality']:g}",
    ]
    if known < 0.999 * float(ds["high"][-1]):
        lines.append(f"bands up to {call['high']:g} Hz need more steps and samples of the run")
    return lines


def _compared(ds: xr.Dataset, name: str, sides: Sides) -> str:
    """Return a line for one comparison: the range of ratios, the farthest one's place, and the share in the band."""
    known = np.isfinite(sides.ratio)
    if not known.any():
        return f"{sides.of.text}: not known"
    ratio = sides.ratio[known]
    k = int(np.argmax(np.abs(ratio)))
    place = f"{three_digits(sides.places[known][k])} {sides.at.display_unit}"
    text = f"{sides.of.text}: {ratio.min():+.2f} to {ratio.max():+.2f} dB, farthest at {place}"
    inside = f"{sides.of.name}_inside"
    return f"{text}; {100 * float(ds[inside]):.0f} % of {known.sum()} {name} inside" if inside in ds else text


def report(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return the text of a report: the summary, what it was made from, and the tables."""
    lines = [*summary(ds, units), *sources_of(ds)]
    for name, table in tables(ds, units).items():
        lines += ["", name.capitalize(), "", *table.to_string(index=False, float_format="{:.4g}".format).splitlines()]
    return lines
