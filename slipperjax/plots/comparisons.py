"""Designs compared over the same rails and starts: their values as texts, and their picture."""

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from ..model.quantities import Quantity
from .style import Units, check_dataset, in_display_unit, label, line_color, page, quantity_of, shown_units, with_unit

SOURCE = "slipperjax.compare"
"""Function that makes such datasets."""


class Comparison(NamedTuple):
    """A result of `slipperjax.compare` with its designs in one list, in a user's units."""

    ds: xr.Dataset
    """The dataset, with the designs along `design`."""
    labels: list[str]
    """Names of the designs, with units."""
    quantity: Quantity
    """The compared quantity."""

    @classmethod
    def of(cls, ds: object, units: Units = None) -> "Comparison":
        """Return the comparison of a dataset; `units`: as for `comparison`."""
        ds = check_dataset(ds, SOURCE, "runs", "counted", "best", "difference")
        chosen = shown_units(ds, units)
        dims = ds["best"].dims
        # every parameter that differs from design to design
        along = [str(name) for name, values in ds.coords.items() if values.dims and set(values.dims) <= set(dims)]
        flat = ds.stack(design=dims)
        words = []
        for name in along:
            q = quantity_of(name, ds, chosen)
            values = np.broadcast_to(q.shown(flat[name].values), flat.sizes["design"])
            words.append([_stated(f"{q.words} {value:.4g}", q) for value in values])
        record = ds.attrs["record"]
        compared = quantity_of(record, ds.rename(runs=record), chosen)
        return cls(flat, [", ".join(parts) for parts in zip(*words, strict=True)], compared)

    def said(self, name: str, design: int, quantile: int) -> str:
        """Return a value of one design and its standard error as a text."""
        at = self.ds.isel(design=design, quantile=quantile)
        of_error = "stderr" if name == "value" else f"{name}_stderr"
        value, error = (self.quantity.shown(float(at[part])) for part in (name, of_error))
        if not np.isfinite(value):
            return "an unknown value"
        if not np.isfinite(error):
            return _stated(f"{value:.3g}", self.quantity) + " with an unknown error"
        # two digits of the error
        digits = max(0, 1 - math.floor(math.log10(error))) if error > 0 else 3
        return _stated(f"{value:.{digits}f} +- {error:.{digits}f}", self.quantity)


def _stated(text: str, quantity: Quantity) -> str:
    """Return numbers of a quantity and its unit; pure numbers have no unit."""
    return text if quantity.display_unit == "1" else f"{text} {quantity.display_unit}"


def of_runs(share: float) -> str:
    """Return the name of a quantile."""
    return "median" if share == 0.5 else f"{100 * share:g} % quantile"


def comparison(ds: object, units: Units = None) -> np.ndarray:
    """Draw the shares of runs below each value, the quantiles with 95 % intervals, and the designs' differences.

    **Arguments:** `units`: such as ("ft", "lbf"), each for the quantities of its kind; by default the units of the
    scene's file.

    **Returns:** an array of two Axes.

    **Raises:** `ValueError` for another dataset.
    """
    view = Comparison.of(ds, units)
    flat = view.ds
    shares = flat["quantile"].values
    q = view.quantity
    with page(1, 2, 2.9, flat, full=False, width_ratios=(3, 2)) as axes:
        left, right = axes
        for k, design in enumerate(view.labels):
            of_design = flat["runs"].isel(design=k).where(flat["counted"]).values
            runs = np.sort(q.shown(of_design[np.isfinite(of_design)]))
            color = line_color(k)
            left.step(runs, (np.arange(len(runs)) + 1) / len(runs), where="post", color=color, lw=1, label=design)
            for ax, name, prefix, heights in (
                (left, "value", "", shares),
                (right, "difference", "difference_", np.arange(len(shares)) - 0.12 * k),
            ):
                value, low, high = (
                    q.shown(flat[part].isel(design=k).values) for part in (name, f"{prefix}low", f"{prefix}high")
                )
                ends = value - low, high - value
                ax.errorbar(value, heights, xerr=ends, fmt="o", ms=4, color=color, capsize=2)
        left.set(xlabel=label(in_display_unit(q, flat["runs"])), ylabel="share of runs below", ylim=(0, 1.02))
        left.legend(loc="lower right", fontsize=7)
        right.axvline(0.0, color="black", lw=0.6)
        right.set_yticks(np.arange(len(shares)), [of_runs(share) for share in shares])
        right.set_ylim(-0.5 - 0.12 * len(view.labels), len(shares) - 0.5)
        right.set_title("bars: joint 95 % intervals", fontsize=7)
        right.set_xlabel(with_unit("difference from the best", q.display_unit, brackets=True))
    return axes
