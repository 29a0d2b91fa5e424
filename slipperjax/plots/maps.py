"""Maps over one or two parameters: exponents, regimes, attractors, and any quantity of a sweep or store."""

from contextlib import nullcontext
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, FuncNorm, ListedColormap
from matplotlib.patches import Patch

from ..analysis.attractor import KINDS
from ..analysis.lyapunov import LEAST, REGIMES, SURE
from ..flow.load import varied_names
from ..flow.status import Status
from .design_data import color_bar, color_norm, fit_scale
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
    name_case,
    new_axes,
    shown,
    styled,
    swept,
)

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
    check_dataset(ds, "lyapunov_sweep", "regime")
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
    check_dataset(ds, "lyapunov_sweep", "regime")
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


_ATTRACTOR_SOURCE = "lyapunov_sweep, or of a sweep with `kind` and `period` of its attractors"
"""What makes the datasets drawn here, for errors."""
ATTRACTOR_COLORS = {
    "period 1": "#d6e6f4",
    "period 2": "#8fc1de",
    "period 3": "#b9dfb0",
    "period 4": "#4a94c5",
    "other periods": "#71b77a",
    "quasi-periodic": "#f6dd8c",
    "chaotic": "#e8a090",
    "unresolved": "#e4e4e4",
    FLAGGED_LABEL: "#ffffff",
}
"""Colours of motions by name: light, so that curves are seen above them."""
_NAMED = 4
"""Longest period with a colour of its own."""


def attractor_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """What motions settle to over two parameters: periods 1 to 4, others, quasi-periodic, chaotic or unresolved.

    **Arguments:** `ds`: over two parameters, the first drawn upwards, with the variables `kind` and `period` as
    `slipperjax.analysis.Attractors` has them; `ax`: the Axes to draw into, default those of a new figure, with the
    fixed parameters as its title.

    **Returns:** the Axes, with a legend of what occurs.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    check_dataset(ds, _ATTRACTOR_SOURCE, "kind", "period")
    over_y, over_x = swept(ds["kind"], count=2)
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 3.3)
        name_case(ax.figure, ds, full=True)
    with styled() if own else nullcontext():
        found = motion_names(ds, over_y, over_x)
        names, cmap = list(ATTRACTOR_COLORS), ListedColormap(list(ATTRACTOR_COLORS.values()))
        norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
        numbers = np.array([names.index(name) for name in found.ravel()]).reshape(found.shape)
        ax.pcolormesh(shown(ds, over_x), shown(ds, over_y), numbers, cmap=cmap, norm=norm, rasterized=True)
        there = [name for name in names if np.any(found == name)]
        outlined = {"edgecolor": "#a0a0a0", "linewidth": 0.4}
        legend_above(ax, [Patch(facecolor=ATTRACTOR_COLORS[n], label=n, **outlined) for n in there])
        ax.grid(False)
        ax.set(xlabel=axis_label(over_x, ds), ylabel=axis_label(over_y, ds))
    return ax


def motion_names(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """The name in `ATTRACTOR_COLORS` of each case, shape as `dims`."""
    kind, period = (ds[name].transpose(*dims).values for name in ("kind", "period"))
    named = np.where(period <= _NAMED, np.char.add("period ", period.astype(int).astype(str)), "other periods")
    found = named.astype(object)
    for name, word in zip(KINDS[1:], ("quasi-periodic", "chaotic", "unresolved"), strict=True):
        found[kind == name] = word
    found[flagged(ds, *dims)] = FLAGGED_LABEL
    return found


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
    check_dataset(ds, "sweep", name)
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
