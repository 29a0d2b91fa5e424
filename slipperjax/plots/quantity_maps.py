"""Any stored quantity over one or two parameters, also of a store that still grows."""

from contextlib import nullcontext
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from ..flow import Status, varied_names
from .design_data import color_bar, color_norm, fit_scale
from .regimes import NO_COLOR
from .style import (
    COLORS,
    FLAGGED_LABEL,
    axis_label,
    check_dataset,
    cross,
    flagged,
    legend_above,
    mark_cases,
    new_axes,
    shown,
    styled,
    swept,
)
from .titles import name_case

SOURCE = "sweep"
"""What makes the datasets drawn here, for errors."""
NOT_YET = "not computed yet"
"""Label of cases that a store does not have yet; they are left white."""


def quantity_map(ds: xr.Dataset, name: str = "peak_force", ax: Any = None) -> Any:
    """A quantity over one parameter as dots, or over two as colours, in its display unit.

    Of a quantity with several values in each case, such as one for each contact point, the largest is drawn. Cases
    with a status other than 0 are grey, those that a growing store does not have yet white. The scale is logarithmic
    where the values differ by a factor above 8.

    **Arguments:** `ds`: from `sweep`, or a store; over two parameters the first is drawn upwards; `name`: a variable;
    `ax`: the Axes to draw into, default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for a name that is no variable with numbers, or more than two parameters.
    """
    check_dataset(ds, SOURCE, name)
    if ds[name].dtype.kind not in "fiub":
        raise ValueError(f"Argument `name` must be a variable with numbers, but {name} has {ds[name].dtype}.")
    dims = [d for d in ds["status"].dims if d in ds[name].dims]
    if len(dims) not in (1, 2) or not set(ds["status"].dims) <= set(ds[name].dims):
        raise ValueError(f"Argument `ds` must be over one parameter or two, but {name} is over {ds[name].dims}.")
    over = swept(ds["status"], count=len(dims))
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 2.8 if len(over) == 1 else 3.3)
        name_case(ax.figure, ds, full=True)
    values = shown(ds, name).astype(float)
    inner = tuple(k for k, d in enumerate(ds[name].dims) if d not in over)
    some = np.isfinite(values).any(axis=inner)
    values = np.where(some, np.max(np.where(np.isfinite(values), values, -np.inf), axis=inner), np.nan)
    kept = [d for d in ds[name].dims if d in over]
    values = values if tuple(kept) == over else values.T
    bad, missing = flagged(ds, *over), ds["status"].transpose(*over).values == Status.NOT_RUN
    values = np.where(bad, np.nan, values)
    draw = _line if len(over) == 1 else _map
    with styled() if own else nullcontext():
        handles = draw(ds, name, over, values, bad & ~missing, ax)
        if missing.any() and len(over) == 2:
            handles.append(Patch(facecolor="white", edgecolor="black", lw=0.5, label=NOT_YET))
        if handles:
            legend_above(ax, handles)
    return ax


def _line(
    ds: xr.Dataset, name: str, over: tuple[str, ...], values: np.ndarray, bad: np.ndarray, ax: Any
) -> list[Any]:
    names = varied_names(ds) if over == ("case",) else list(over)
    if len(names) == 2:
        return _scatter(ds, name, names, values, bad, ax)
    along = names[0]
    x = shown(ds, along)
    ax.plot(x, values, ".", ms=3, mew=0, color=COLORS["blue"])
    mark_cases(ax, x[bad])
    ax.margins(x=0.03)
    ax.set(xlabel=axis_label(along, ds), ylabel=axis_label(name, ds))
    fit_scale(ax, values)
    return [cross(label=FLAGGED_LABEL)] * bool(bad.any())


def _scatter(ds: xr.Dataset, name: str, names: Any, values: np.ndarray, bad: np.ndarray, ax: Any) -> list[Any]:
    """Two parameters whose values were read side by side."""
    y, x = (shown(ds, one) for one in names)
    there = np.isfinite(values)
    dots = ax.scatter(x[there], y[there], 6, values[there], norm=color_norm(values), lw=0, rasterized=True)
    ax.scatter(x[bad], y[bad], 6, NO_COLOR, lw=0, rasterized=True)
    color_bar(ax, dots, axis_label(name, ds))
    ax.set(xlabel=axis_label(names[1], ds), ylabel=axis_label(names[0], ds))
    return [Patch(color=NO_COLOR, label=FLAGGED_LABEL)] * bool(bad.any())


def _map(ds: xr.Dataset, name: str, over: Any, values: np.ndarray, bad: np.ndarray, ax: Any) -> list[Any]:
    y, x = (shown(ds, d) for d in over)
    colors = plt.get_cmap("viridis").with_extremes(bad="white")
    mesh = ax.pcolormesh(x, y, np.ma.masked_invalid(values), cmap=colors, norm=color_norm(values), rasterized=True)
    if bad.any():
        grey = ListedColormap([NO_COLOR])
        ax.pcolormesh(x, y, np.ma.masked_where(~bad, np.ones_like(values)), cmap=grey, rasterized=True)
    color_bar(ax, mesh, axis_label(name, ds))
    ax.grid(False)
    ax.set(xlabel=axis_label(over[1], ds), ylabel=axis_label(over[0], ds))
    return [Patch(color=NO_COLOR, label=FLAGGED_LABEL)] * bool(bad.any())
