"""Texts and tables of searches for parameters: designs, and fits."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import varied_names
from ..plots.designs import case_words, design_quantity, design_variables, margin_rows
from ..plots.fits import fit_quantities
from ..plots.style import Units, quantity_of

NEAREST = "nearest events:"
"""Line before the events."""
AT_BOUND = 1e-6
"""Share of a variable's range within which it is at its bound."""


def design_summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a design as a text, with a line for each case."""
    attrs = ds.attrs
    # numbers of lost motions mean nothing
    if attrs["status"] == "no motion":
        cure = "raise steps_per_period, check the units of the scene, or change the bounds"
        return [f"status: no motion: no design that was tried stays on the rail; {cure}"]
    lines = [f"status: {attrs['status']}", f"best design: {', '.join(_variables(ds))}"]
    q = quantity_of("objective", ds)
    count = ds.sizes["case"]
    cases = f", {attrs['robust']} of {count} cases" if count > 1 else ""
    # averages over chaotic motions have a standard error; orbits have a change by half the step
    error = attrs["stderr"]
    sure = f" +- {q.shown(error):.2g}" if error > 0 else ""
    lines.append(f"{q.named(attrs['objective'])}{sure}{cases}")
    if attrs["judged"]:
        lines.append(f"judged {attrs['judged']}")
    if attrs["has_equal_optima"]:
        lines.append("starts ended at different designs that are about equally good: see start_end in the file")
    counts = Counter(sorted(ds["regime"].values.astype(str).tolist()))
    lines.append(f"motions: {', '.join(f'{count} x {word}' for word, count in counts.items())}")
    trials, starts = ds.sizes["trial"], ds["start_end"].sizes["start"]
    lines.append(f"{trials} trials from {starts} starts, {attrs['cost_periods']:.3g} forcing periods")
    lines += _cases(ds).to_string(index=False).splitlines()
    if "margin_label" in ds:
        lines.append(NEAREST)
        # how far parameters may change before the orbit of a case meets an event
        for case, name, event, value, relative in margin_rows(ds):
            q = design_quantity(ds, name)
            change = f"{q.shown(value):.6g} {q.display_unit} ({100 * relative:+.3g} %)"
            lines.append(f"  {case_words(ds, case)}: {q.name} {event or 'none up to'} {change}")
    return lines


def design_tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each case of the best design, and a row for each trial."""
    smooth = quantity_of("smooth", ds)
    numbers = [(one, ds["trial_design"].sel(variable=one.name)) for one in design_variables(ds)]
    numbers.append((smooth, ds["trial_smooth"]))
    trials = {f"{q.name} [{q.display_unit}]": q.shown(values.values) for q, values in numbers}
    trials |= {name: ds[f"trial_{name}"].values for name in ("start", "violation", "taken", "simulated")}
    return {"cases": _cases(ds), "trials": pd.DataFrame(trials)}


def _cases(ds: xr.Dataset) -> pd.DataFrame:
    q = quantity_of("objective", ds)
    columns = {}
    for name in varied_names(ds):
        over = quantity_of(name, ds)
        columns[f"{name} [{over.display_unit}]"] = [f"{value:.6g}" for value in over.shown(ds[name].values)]
    pairs = q.shown(np.stack([ds["objective"].values, ds["objective_stderr"].values], axis=1))
    texts = [f"{value:.5g}" + (f" +- {error:.2g}" if error > 0 else "") for value, error in pairs]
    return pd.DataFrame(columns | {f"{q.name} [{q.display_unit}]": texts, "motion": ds["regime"].values.astype(str)})


def _variables(ds: xr.Dataset) -> Iterator[str]:
    """Yield the design variables as texts, with the bounds at which they ended."""
    for q in design_variables(ds):
        value, low, high = (float(ds[name].sel(variable=q.name)) for name in ("design", "low", "high"))
        near = AT_BOUND * (high - low)
        bound = "lower" if abs(value - low) <= near else "upper" if abs(value - high) <= near else ""
        yield q.named(value) + f" (its {bound} bound)" * bool(bound)


def fit_summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return parameters that explain measured signals as a text."""
    lines = [f"status: {ds.attrs['status']}", f"{100 * ds.attrs['confidence']:g} % intervals:"]
    for row in fit_tables(ds)["parameters"].itertuples(index=False):
        bound = f", at its {row.bound} bound" if row.bound else ""
        unit = "" if row.unit == "1" else f" {row.unit}"
        lines.append(f"  {row.parameter} {row.estimate:.5g} ({row.low:.5g} to {row.high:.5g}){unit}{bound}")
    for other in ds["minimum"].values:
        shown = [q.named(value) for q, value in zip(fit_quantities(ds), other, strict=True)]
        lines.append(f"another minimum: {', '.join(shown)}")
    # empty texts are left out
    told = (ds.attrs["not_identified"], ds.attrs["misfit"])
    return [*lines, *(line for text in told for line in text.split("; ") if line)]


def fit_tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return a row for each parameter."""
    quantities = fit_quantities(ds)
    columns = {"parameter": [q.name for q in quantities], "unit": [q.display_unit for q in quantities]}
    for name in ("estimate", "stderr", "low", "high", "prior_low", "prior_high"):
        columns[name] = [q.shown(float(value)) for q, value in zip(quantities, ds[name].values, strict=True)]
    return {"parameters": pd.DataFrame(columns | {"bound": ds["at_bound"].values.astype(str)})}
