"""Pictures of Lyapunov exponents and regimes over one or two parameters."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from ..analysis import REGIMES, SURE
from .style import COLORS, REGIME_COLORS, STYLE, axis_label, cross, flagged, mark_cases, new_axes, shown, swept

EXPONENT_LABEL = "largest exponent [1/period]"


def exponents(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent [1/period] over one parameter, with three standard errors, coloured by regime.

    Cases with a status other than 0 count as unresolved; where they have no finite exponent, a cross at the bottom
    stands for them.

    **Arguments:** `ds`: from `lyapunov_sweep` over one parameter; `ax`: the Axes to draw into, default those of a new
    figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    ax = new_axes() if ax is None else ax
    (over,) = swept(ds["regime"])
    x, y, error = shown(ds, over), *(ds[name].isel(count=0).values for name in ("exponent", "stderr"))
    names = _regimes(ds, over)
    ax.axhline(0, lw=0.5, color="black")
    ax.plot(x, np.where(flagged(ds, over), np.nan, y), lw=0.3, color=COLORS["grey"], zorder=1)
    handles = []
    for name, color in REGIME_COLORS.items():
        at = (names == name) & np.isfinite(y)
        if name not in REGIMES[:4] and not at.any():
            continue  # rare
        bars = dict(fmt=".", ms=3, mew=0, lw=0.6, color=color, label=name)
        handles.append(ax.errorbar(x[at], y[at], SURE * error[at], **bars))
    absent = ~np.isfinite(y)
    mark_cases(ax, x[absent])
    handles += [cross(label="no exponent")] * bool(absent.any())
    above = dict(loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.legend(handles=handles, fontsize=6, ncols=4 - len(handles) % 2, **above)
    ax.set(xlabel=axis_label(over), ylabel=EXPONENT_LABEL)
    return ax


def regime_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent [1/period] over two parameters: red above zero, blue below.

    Unresolved cases have a cross. Cases with a status other than 0 are unresolved, and grey instead of coloured.

    **Arguments:** `ds`: from `lyapunov_sweep` over two parameters, the first drawn upwards; `ax`: the Axes
    to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    style = STYLE if ax is None else {}
    ax = new_axes(3.5, 3.0) if ax is None else ax
    over_y, over_x = swept(ds["regime"], count=2)
    values = ds["exponent"].isel(count=0).transpose(over_y, over_x).values
    values = np.ma.masked_invalid(np.where(flagged(ds, over_y, over_x), np.nan, values))
    most = float(np.abs(values).max()) if values.count() else 1.0
    x, y = shown(ds, over_x), shown(ds, over_y)
    colors = plt.get_cmap("RdBu_r").with_extremes(bad="#d0d0d0")
    mesh = ax.pcolormesh(x, y, values, cmap=colors, vmin=-most, vmax=most)
    with plt.rc_context(style):
        ax.figure.colorbar(mesh, ax=ax, label=EXPONENT_LABEL)
    lost = _regimes(ds, over_y, over_x) == "unresolved"
    if lost.any():
        ax.plot(*(a[lost] for a in np.meshgrid(x, y)), "x", ms=2, mew=0.4, color="black", label="unresolved")
        ax.legend(fontsize=6, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.grid(False)
    ax.set(xlabel=axis_label(over_x), ylabel=axis_label(over_y))
    return ax


def _regimes(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """The regime of each case, shape as `dims`; "unresolved" where the status is not 0."""
    return np.where(flagged(ds, *dims), "unresolved", ds["regime"].transpose(*dims).values)
