"""Designs compared over the same rails and starts: in words, as a table and as a picture."""

import json
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.quantiles import Estimates
from ..flow.status import Status, is_lost
from ..model.quantities import Quantity, ShownUnits
from ..tools.files import first_ones
from .runs import UNITS
from .style import check_dataset, line_color, name_label, page, quantity_of, with_unit

SOURCE = "slipperjax.compare"
"""What makes such datasets."""


class Comparison(NamedTuple):
    """A result of `slipperjax.compare` with its designs in one list, in a user's units."""

    ds: xr.Dataset
    """With the designs along `design`."""
    labels: list[str]
    """Of the designs, with units."""
    quantity: Quantity
    """What is compared."""

    @classmethod
    def of(cls, ds: object, units: Sequence[str] | None = None) -> "Comparison":
        """Return the comparison of a dataset; `units`: as of `slipperjax.plots.report`."""
        ds = check_dataset(ds, SOURCE, "runs", "counted", "best", "difference")
        chosen = ShownUnits(json.loads(ds.attrs.get(UNITS, "[]")) if units is None else units)
        dims = ds["best"].dims
        # every parameter that differs from design to design
        along = [str(name) for name, values in ds.coords.items() if values.dims and set(values.dims) <= set(dims)]
        flat = ds.stack(design=dims)
        words = []
        for name in along:
            q = chosen.of(quantity_of(name, ds))
            values = q.shown(np.broadcast_to(flat[name].values, flat.sizes["design"]))
            words.append([_stated(f"{q.name.replace('_', ' ')} {value:.4g}", q) for value in values])
        labels = [", ".join(parts) for parts in zip(*words, strict=True)]
        return cls(flat, labels, chosen.of(quantity_of(ds.attrs["record"], ds.rename(runs=ds.attrs["record"]))))

    def said(self, name: str, design: int, quantile: int) -> str:
        """Return a value of one design and its standard error in words."""
        value, error = (
            self.quantity.shown(float(self.ds[part][dict(design=design, quantile=quantile)]))
            for part in (name, "stderr" if name == "value" else f"{name}_stderr")
        )
        if not np.isfinite(value):
            return "an unknown value"
        if not np.isfinite(error):
            return _stated(f"{value:.3g}", self.quantity) + " with an unknown error"
        # two digits of the error
        digits = max(0, 1 - math.floor(math.log10(error))) if error > 0 else 3
        return _stated(f"{value:.{digits}f} +- {error:.{digits}f}", self.quantity)


def _stated(text: str, quantity: Quantity) -> str:
    """Return numbers of a quantity and its unit, which pure numbers have none of."""
    return text if quantity.display_unit == "1" else f"{text} {quantity.display_unit}"


def verdict(ds: object, units: Sequence[str] | None = None) -> list[str]:
    """Return in words which design is better and how sure that is: the status of lost runs first, then a line for
    each design. Behind +- stand standard errors."""
    view = Comparison.of(ds, units)
    flat = view.ds
    lines = list(_lost(view))
    shares = flat["quantile"].values
    best = int(np.argmax(flat["best"].values))
    if np.isnan(flat["value"].isel(design=best, quantile=-1)):
        return [*lines, "too many runs are lost to tell which design is better"]
    for k, label in enumerate(view.labels):
        if k == best:
            continue
        at = flat.isel(design=k, quantile=-1)
        words = "is better than" if float(at["difference_low"]) > 0 else "cannot be told from"
        # the last quantile, which decides, first
        each = [f"{view.said('difference', k, j)} in the {_of_runs(shares[j])}" for j in reversed(range(len(shares)))]
        lines.append(f"{view.labels[best]} {words} {label}: by {', '.join(each)}")
    rails, starts = flat.sizes["rail"], flat.sizes["start"]
    runs = f"{rails} rail{'s' * (rails > 1)} from {starts} start{'s' * (starts > 1)} each"
    over = flat.attrs.get("mean_over")
    lines.append(f"{view.quantity.long_name}{f' over {over}' * bool(over)} on {runs}:")
    for k, label in enumerate(view.labels):
        values = [f"{_of_runs(share)} {view.said('value', k, j)}" for j, share in enumerate(shares)]
        lines.append(f"{label}: {', '.join(values)}")
    return lines


def _lost(view: Comparison) -> Iterator[str]:
    """Yield in words which runs are lost, by their status, and which others do not count for that."""
    codes = view.ds["status"].transpose("design", "rail", "start").values
    for code in np.unique(codes[is_lost(codes)]):
        runs = [f"{view.labels[k]} rail={rail} start={start}" for k, rail, start in np.argwhere(codes == code)]
        yield f"status of {len(runs)} of {codes.size} runs: {Status(int(code))}: {first_ones(runs)}"
    if not view.ds["counted"].all():
        along = "rail" if view.ds.sizes["rail"] > 1 else "start"
        counted = view.ds["counted"].all({"rail", "start"} - {along}).values
        left_out = f"{np.sum(~counted)} of {len(counted)} {along}s"
        yield f"{left_out} are left out for all designs, because a run is lost there"


def _of_runs(share: float) -> str:
    return "median" if share == 0.5 else f"{100 * share:g} % quantile"


def table(ds: object, units: Sequence[str] | None = None) -> pd.DataFrame:
    """Return a row for each design and quantile, with units in the header."""
    view = Comparison.of(ds, units)
    rows = []
    for k, label in enumerate(view.labels):
        for j, share in enumerate(view.ds["quantile"].values):
            at = view.ds.isel(design=k, quantile=j)
            numbers = {
                f"{name.replace('_', ' ')} [{view.quantity.display_unit}]": view.quantity.shown(float(at[name]))
                for name in Estimates._fields
            }
            lost = int(is_lost(at["status"].values).sum())
            rows.append({"design": label, "quantile": share} | numbers | {"runs": at["runs"].size, "lost": lost})
    return pd.DataFrame(rows)


def comparison(ds: object, units: Sequence[str] | None = None) -> np.ndarray:
    """Draw the shares of runs below each value, with the quantiles and their 95 % intervals, and what designs
    differ by.

    **Arguments:** as for `verdict`.

    **Returns:** an array of two Axes.

    **Raises:** `ValueError` for another dataset.
    """
    view = Comparison.of(ds, units)
    flat = view.ds
    shares = flat["quantile"].values
    q = view.quantity
    with page(1, 2, 2.9, flat, full=False, width_ratios=(3, 2)) as axes:
        left, right = axes
        for k, label in enumerate(view.labels):
            of_design = flat["runs"].isel(design=k).where(flat["counted"]).values
            runs = np.sort(q.shown(of_design[np.isfinite(of_design)]))
            color = line_color(k)
            left.step(runs, (np.arange(len(runs)) + 1) / len(runs), where="post", color=color, lw=1, label=label)
            for ax, name, prefix, heights in (
                (left, "value", "", shares),
                (right, "difference", "difference_", np.arange(len(shares)) - 0.12 * k),
            ):
                value, low, high = (
                    q.shown(flat[part].isel(design=k).values) for part in (name, f"{prefix}low", f"{prefix}high")
                )
                ends = value - low, high - value
                ax.errorbar(value, heights, xerr=ends, fmt="o", ms=4, color=color, capsize=2)
        left.set(xlabel=name_label(q), ylabel="share of runs below", ylim=(0, 1.02))
        left.legend(loc="lower right", fontsize=7)
        right.axvline(0.0, color="black", lw=0.6)
        right.set_yticks(np.arange(len(shares)), [_of_runs(share) for share in shares])
        right.set_ylim(-0.5 - 0.12 * len(view.labels), len(shares) - 0.5)
        right.set_title("bars: 95 % intervals, of all differences at once", fontsize=7)
        right.set_xlabel(with_unit("difference from the best", q.display_unit, brackets=True))
    return axes
