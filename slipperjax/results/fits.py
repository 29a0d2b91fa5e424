"""Texts, tables and pictures of fits."""

from typing import Any

import pandas as pd
import xarray as xr

from ..model.quantities import Quantity
from ..plots.fits import fit_overview, fit_quantity
from .kind import Kind, Units


class FitKind(Kind):
    """Parameters that explain measured signals."""

    title = "Fit"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        table = self.tables(ds, units)["parameters"]
        lines = [f"status: {ds.attrs['status']}", f"{100 * ds.attrs['confidence']:g} % intervals:"]
        for row in table.itertuples(index=False):
            bound = f", at its {row.bound} bound" if row.bound else ""
            unit = "" if row.unit == "1" else f" {row.unit}"
            lines.append(f"  {row.parameter} {row.estimate:.5g} ({row.low:.5g} to {row.high:.5g}){unit}{bound}")
        quantities = self._quantities(ds)
        for other in ds["minimum"].values:
            shown = [q.named(value) for q, value in zip(quantities, other, strict=True)]
            lines.append(f"another minimum: {', '.join(shown)}")
        # empty texts are left out
        told = (ds.attrs["not_identified"], ds.attrs["misfit"])
        return [*lines, *(line for text in told for line in text.split("; ") if line)]

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        quantities = self._quantities(ds)
        shown = lambda name: [q.shown(float(v)) for q, v in zip(quantities, ds[name].values, strict=True)]
        columns = {name: shown(name) for name in ("estimate", "stderr", "low", "high", "prior_low", "prior_high")}
        names = {"parameter": [q.name for q in quantities], "unit": [q.display_unit for q in quantities]}
        bounds = [str(word) for word in ds["at_bound"].values]
        return {"parameters": pd.DataFrame({**names, **columns, "bound": bounds})}

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return fit_overview(ds, **options)

    def _quantities(self, ds: xr.Dataset) -> list[Quantity]:
        return [fit_quantity(ds, str(name)) for name in ds["parameter"].values]
