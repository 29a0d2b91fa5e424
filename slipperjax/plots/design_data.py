"""What pictures of designs have in common: their datasets, labels, markers and scales."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from ..analysis.attractor import KINDS
from ..flow.load import varied_names
from ..model.quantities import PARAMETERS, Quantity, quantity
from .style import axis_label, check_dataset, legend_above, new_axes, shown, styled, typeset

SOURCE = "optimise_design"
"""What makes the datasets drawn here, for errors."""
REGIME_MARKERS = {"period 1": "o", "period n": "s", "irregular": "D"}
"""Markers of cases by their kind of motion; n is above 1."""
WIDE = 8.0
"""Ratio of the greatest to the least value from which a scale is logarithmic."""
CLOSE = 0.09
"""Least distance between labelled ticks, in lengths of their axis."""
OPTIMUM: dict[str, Any] = dict(ls="", marker="*", ms=10, mfc="#ffd23f", mec="black", mew=0.7, zorder=6)
"""How the best design is marked."""


def design_dataset(ds: Any) -> xr.Dataset:
    """The dataset of a design, or of a result that has one."""
    found = ds if isinstance(ds, xr.Dataset) or not hasattr(ds, "to_xarray") else ds.to_xarray()
    check_dataset(found, SOURCE, "trial_design", "objective", "design")
    return found


def panel(draw: Callable[[xr.Dataset, Any], list[Any]], ds: Any, ax: Any) -> Any:
    """One picture of a design, with a legend of the entries that `draw` returns, in Axes that are given or new."""
    ds, own = design_dataset(ds), ax is None
    ax = new_axes(3.5, 2.9) if ax is None else ax
    with styled() if own else nullcontext():
        legend_above(ax, draw(ds, ax))
    return ax


def kinds_of(regimes: Any) -> np.ndarray:
    """Regimes in words, all periods above 1 as one, and all motions without a period."""
    words = np.asarray(regimes).astype(str)
    words = np.where(np.isin(words, KINDS[1:]), "irregular", words)
    return np.where(np.char.startswith(words, "period ") & (words != "period 1"), "period n", words)


def over_cases(ds: xr.Dataset) -> tuple[np.ndarray, str]:
    """The parameter that differs between the cases, and its label; their numbers where there are none or several."""
    names = varied_names(ds) if "varied" in ds.attrs else []
    if len(names) == 1:
        return shown(ds, names[0]), axis_label(names[0], ds)
    return np.arange(1, ds.sizes["case"] + 1), "case" if not names else f"case, over {' and '.join(names)}"


def per_shown(array: xr.DataArray) -> float:
    """SI units in one display unit."""
    return float(array.attrs.get("per_shown", 1.0))


def scaled(array: xr.DataArray, like: xr.DataArray | None = None) -> np.ndarray:
    """Values in the display unit, of `like` where the array has none; NaN in place of infinities."""
    values = np.asarray(array.values, float) / per_shown(array if like is None else like)
    return np.where(np.isfinite(values), values, np.nan)


def label_of(array: xr.DataArray) -> str:
    """The axis label of an objective: name, symbol and display unit."""
    unit = array.attrs.get("shown_unit", array.attrs.get("units", "1"))
    symbol = f" ${array.attrs['symbol']}$" if array.attrs.get("symbol") else ""
    return name_of(array) + symbol + (f" [{typeset(unit)}]" if unit != "1" else "")


def name_of(array: xr.DataArray) -> str:
    """The name of an objective in words."""
    return str(array.attrs.get("quantity", array.name)).replace("_", " ")


def total_label(ds: xr.Dataset, name: str = "smooth") -> str:
    """The axis label of an objective over all cases, in two lines where they are several."""
    return label_of(ds[name]) + (f"\n{many(ds)}" if ds.sizes["case"] > 1 else "")


def many(ds: xr.Dataset) -> str:
    """What is made of several cases."""
    return f"{'worst' if ds.attrs['robust'] == 'worst' else 'mean'} of {ds.sizes['case']} cases"


def variable(ds: xr.Dataset, name: str) -> Quantity:
    """A variable of a design; that of a path has its unit from the dataset."""
    if name in PARAMETERS:
        return quantity(name)
    return Quantity(name, str(ds["variable_unit"].sel(variable=name).item()), name)


def variable_label(ds: xr.Dataset, name: str) -> str:
    """The axis label of a variable."""
    q = variable(ds, name)
    unit = "" if q.display_unit == "1" else f" [{typeset(q.display_unit)}]"
    return axis_label(name) if name in PARAMETERS else name + unit


def in_shown(ds: xr.Dataset, name: str, values: Any) -> np.ndarray:
    """Values of a variable [SI unit] in its display unit."""
    return np.asarray(variable(ds, name).shown(np.asarray(values, float)))


def color_norm(values: np.ndarray) -> Normalize:
    """Colours over finite values, logarithmic where they are wide."""
    found = values[np.isfinite(values)]
    low, high = (float(np.min(found)), float(np.max(found))) if len(found) else (0.0, 1.0)
    if not high > low:
        low, high = low - 0.01 * abs(low) - 1e-12, high + 0.01 * abs(high) + 1e-12
    return LogNorm(low, high) if is_wide(values) else Normalize(low, high)


def is_wide(values: np.ndarray) -> bool:
    """Whether values are drawn on a logarithmic scale."""
    found = values[np.isfinite(values)]
    return bool(len(found) and np.min(found) > 0 and np.max(found) > WIDE * np.min(found))


def color_bar(ax: Any, mappable: Any, label: str) -> None:
    """A colour bar with plain numbers."""
    bar = ax.figure.colorbar(mappable, ax=ax, label=label)
    norm = mappable.norm
    if isinstance(norm, LogNorm):
        bar.set_ticks(ticks := log_ticks(norm.vmin, norm.vmax), labels=[f"{tick:g}" for tick in ticks])
        bar.ax.yaxis.set_minor_locator(NullLocator())


def fit_scale(ax: Any, values: np.ndarray) -> None:
    """A logarithmic vertical axis with plain numbers where values are wide."""
    if is_wide(values):
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(FixedLocator(log_ticks(*ax.get_ylim())))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        ax.yaxis.set_minor_locator(NullLocator())


def log_ticks(low: float, high: float) -> list[float]:
    """Round numbers that lie apart on a logarithmic scale."""
    length, found = np.log(high / low), []
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for steps in ((1,), (2, 5), (3, 7), (1.5, 4, 6)):
        for tick in (step * 10.0**p for p in powers for step in steps):
            apart = all(abs(np.log(tick / other)) > CLOSE * length for other in found)
            if low * (1 - 1e-9) <= tick <= high * (1 + 1e-9) and apart:
                found.append(tick)
    return sorted(found) if len(found) > 1 else [t for t in MaxNLocator(5).tick_values(low, high) if low <= t <= high]
