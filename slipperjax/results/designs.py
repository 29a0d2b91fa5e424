"""Texts, tables and pictures of designs."""

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import varied_names
from ..model.quantities import Quantity
from ..plots.designs import design_overview, design_quantity
from ..plots.style import quantity_of, shown
from .kind import Kind, Units

NEAREST = "nearest events:"
"""Line before the events."""
AT_BOUND = 1e-6
"""Share of a variable's range within which it is at its bound."""


class DesignKind(Kind):
    """An optimal design over some cases."""

    title = "Design"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        status = ds.attrs["status"]
        # numbers of lost motions mean nothing
        if status == "no motion":
            cure = "raise steps_per_period, check the units of the scene, or change the bounds"
            return [f"status: no motion: no design that was tried stays on the rail; {cure}"]
        lines = [f"status: {status}", f"best design: {', '.join(_variables(ds))}"]
        q = quantity_of("objective", ds)
        count = ds.sizes["case"]
        cases = f", {ds.attrs['robust']} of {count} cases" if count > 1 else ""
        # averages over chaotic motions have a standard error; orbits have a change by half the step
        error = ds.attrs["stderr"]
        sure = f" +- {q.shown(error):.2g}" if error > 0 else ""
        lines.append(f"{q.named(ds.attrs['objective'])}{sure}{cases}")
        if ds.attrs["judged"]:
            lines.append(f"judged {ds.attrs['judged']}")
        if ds.attrs["has_equal_optima"]:
            lines.append("starts ended at different designs that are about equally good: see start_end in the file")
        counts = Counter(sorted(ds["regime"].values.astype(str).tolist()))
        lines.append(f"motions: {', '.join(f'{count} x {word}' for word, count in counts.items())}")
        trials, starts = ds.sizes["trial"], ds["start_end"].sizes["start"]
        lines.append(f"{trials} trials from {starts} starts, {ds.attrs['cost_periods']:.3g} forcing periods")
        lines += self.tables(ds, units)["cases"].to_string(index=False).splitlines()
        if "margin_label" in ds:
            lines += [NEAREST, *_margins(ds)]
        return lines

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        q = quantity_of("objective", ds)
        cases: dict[str, Any] = {}
        for name in varied_names(ds):
            over = quantity_of(name, ds)
            cases[f"{name} [{over.display_unit}]"] = [f"{v:.6g}" for v in over.shown(ds[name].values)]
        pairs = q.shown(np.stack([ds["objective"].values, ds["objective_stderr"].values], axis=1))
        texts = [f"{value:.5g}" + (f" +- {error:.2g}" if error > 0 else "") for value, error in pairs]
        cases[f"{q.name} [{q.display_unit}]"] = texts
        cases["motion"] = ds["regime"].values.astype(str)
        trials = {f"{one.name} [{one.display_unit}]": _of_trials(ds, one) for one in _quantities(ds)}
        smooth = quantity_of("smooth", ds)
        trials[f"{smooth.name} [{smooth.display_unit}]"] = shown(ds, "trial_smooth")
        trials |= {name: ds[f"trial_{name}"].values for name in ("start", "violation", "taken", "simulated")}
        return {"cases": pd.DataFrame(cases), "trials": pd.DataFrame(trials)}

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return design_overview(ds, **options)


def _quantities(ds: xr.Dataset) -> list[Quantity]:
    return [design_quantity(ds, str(name)) for name in ds["variable"].values]


def _of_trials(ds: xr.Dataset, q: Quantity) -> np.ndarray:
    return q.shown(ds["trial_design"].sel(variable=q.name).values)


def _variables(ds: xr.Dataset) -> list[str]:
    """Return the design variables as a text, with the bounds at which they ended."""
    words = []
    for q in _quantities(ds):
        value, low, high = (float(ds[name].sel(variable=q.name)) for name in ("design", "low", "high"))
        near = AT_BOUND * (high - low)
        bound = "lower" if abs(value - low) <= near else "upper" if abs(value - high) <= near else ""
        words.append(q.named(value) + (f" (its {bound} bound)" if bound else ""))
    return words


def _margins(ds: xr.Dataset) -> list[str]:
    """Return texts that say how far parameters may change before the orbit of a case meets an event."""
    lines = []
    columns = ds[[f"margin_{name}" for name in ("case", "parameter", "label", "value", "relative")]]
    for case, name, event, value, relative in columns.to_dataframe().itertuples(index=False):
        q = design_quantity(ds, name)
        over = [(quantity_of(other, ds), ds[other].values[case]) for other in varied_names(ds)]
        where = ", ".join(o.named(at) for o, at in over) or "the case"
        change = f"{q.shown(value):.6g} {q.display_unit} ({100 * relative:+.3g} %)"
        lines.append(f"  {where}: {q.name} {event or 'none up to'} {change}")
    return lines
