"""Pictures of Lyapunov exponents and regimes over one or two parameters."""

from contextlib import nullcontext
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import FuncNorm
from matplotlib.patches import Patch

from ..analysis import LEAST, REGIMES, SURE
from .style import (
    COLORS,
    FLAGGED_LABEL,
    REGIME_COLORS,
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

SOURCE = "lyapunov_sweep"
"""What makes the datasets drawn here, for errors."""
EXPONENT_LABEL = "largest exponent [1/period]"
NO_COLOR = "#d0d0d0"
_MARKERS = dict(zip(REGIMES, "oDs^v", strict=True))
UNRESOLVED_LABEL = "unresolved: estimates\ndisagree or are not sure"


def exponents(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent [1/period] over one parameter, with three standard errors, coloured by regime.

    Cases with a status other than 0 count as unresolved; where they have no finite exponent, a cross at the bottom
    stands for them.

    **Arguments:** `ds`: from `lyapunov_sweep` over one parameter; `ax`: the Axes to draw into, default those of a new
    figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    check_dataset(ds, SOURCE, "regime")
    if ax is None:
        ax = new_axes(3.5, 2.8)
        name_case(ax.figure, ds, full=True)
    (over,) = swept(ds["regime"])
    x, y, error = shown(ds, over), *(ds[name].isel(count=0).values for name in ("exponent", "stderr"))
    names = _regimes(ds, over)
    ax.axhline(0, lw=0.5, color="black")
    ax.plot(x, np.where(flagged(ds, over), np.nan, y), lw=0.5, color=COLORS["grey"], zorder=1)
    handles = []
    for name, color in REGIME_COLORS.items():
        at = (names == name) & np.isfinite(y)
        if name not in REGIMES[:4] and not at.any():
            continue  # rare
        bars = dict(fmt=_MARKERS[name], ms=3.5, mew=0, elinewidth=0.8, color=color, label=name)
        handles.append(ax.errorbar(x[at], y[at], SURE * error[at], **bars))
    absent = ~np.isfinite(y)
    mark_cases(ax, x[absent])
    handles += [cross(label="no exponent")] * bool(absent.any())
    legend_above(ax, handles)
    ax.margins(x=0.03)
    ax.set(xlabel=axis_label(over, ds), ylabel=EXPONENT_LABEL)
    return ax


def regime_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent [1/period] over two parameters: red above zero, blue below, white at zero.

    Each colour ends at the largest exponent of its sign and goes as the square root, so that exponents slightly below
    zero differ from zero. Unresolved cases have a cross. Cases with a status other than 0 are unresolved, and grey
    instead of coloured.

    **Arguments:** `ds`: from `lyapunov_sweep` over two parameters, the first drawn upwards; `ax`: the Axes
    to draw into, default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    check_dataset(ds, SOURCE, "regime")
    over_y, over_x = swept(ds["regime"], count=2)
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 3.3)
        name_case(ax.figure, ds, full=True)
    values = ds["exponent"].isel(count=0).transpose(over_y, over_x).values
    values = np.ma.masked_invalid(np.where(flagged(ds, over_y, over_x), np.nan, values))
    x, y = shown(ds, over_x), shown(ds, over_y)
    colors = plt.get_cmap("RdBu_r").with_extremes(bad=NO_COLOR)
    mesh = ax.pcolormesh(x, y, values, cmap=colors, norm=_norm(values))
    with styled() if own else nullcontext():
        bar = ax.figure.colorbar(mesh, ax=ax, label=EXPONENT_LABEL)
    ticks = _ticks(mesh.norm)
    bar.set_ticks(ticks, labels=[f"{tick:g}".replace("-", "−") for tick in ticks])
    handles, lost = [], _regimes(ds, over_y, over_x) == "unresolved"
    if lost.any():
        label = {"color": "black", "ms": 2.5, "mew": 0.6, "label": UNRESOLVED_LABEL}
        handles.append(ax.add_line(cross(*(a[lost] for a in np.meshgrid(x, y)), **label)))
    if flagged(ds, over_y, over_x).any():
        handles.append(Patch(color=NO_COLOR, label=FLAGGED_LABEL))
    if handles:
        legend_above(ax, handles)
    ax.grid(False)
    ax.set(xlabel=axis_label(over_x, ds), ylabel=axis_label(over_y, ds))
    return ax


def _norm(values: np.ma.MaskedArray) -> FuncNorm:
    """Colours that are white at zero only: each sign has its own half of them, by the square root."""
    top, bottom = (max(float(np.max(sign * values)), LEAST) if values.count() else 1.0 for sign in (1, -1))
    scale = lambda v: np.where(v < 0, bottom, top)
    forward = lambda v: np.sign(v) * np.sqrt(np.abs(v) / scale(v))
    backward = lambda c: np.sign(c) * np.square(c) * scale(c)
    return FuncNorm((forward, backward), vmin=-bottom, vmax=top)


def _ticks(norm: FuncNorm) -> list[float]:
    """Round numbers for the colour bar that lie apart on its uneven scale."""
    both = [sign * n * 10.0**p for sign in (-1, 1) for p in range(-3, 2) for n in (1, 2, 5)]
    place, ticks = lambda tick: float(norm(tick)), [0.0]
    for tick in sorted(both, key=abs, reverse=True):
        within = -1e-9 <= place(tick) <= 1 + 1e-9
        if within and all(abs(place(tick) - place(other)) > 0.07 for other in ticks):
            ticks.append(tick)
    return sorted(ticks)


def _regimes(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """The regime of each case, shape as `dims`; "unresolved" where the status is not 0."""
    return np.where(flagged(ds, *dims), "unresolved", ds["regime"].transpose(*dims).values)
