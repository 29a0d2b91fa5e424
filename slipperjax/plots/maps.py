"""Results over one or two parameters: sections, exponents, regimes, attractors, any quantity of a sweep or store."""

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, Colormap, FuncNorm, ListedColormap, Normalize
from matplotlib.patches import Patch

from ..analysis.kinds import REGIMES, Regime, lasting
from ..analysis.lyapunov import LEAST, SURE
from ..flow.datasets import varied_names
from ..flow.status import Status
from ..model.quantities import SECTIONS
from ..tools.checks import instance, one_of
from .style import (
    COLORS,
    FLAGGED_LABEL,
    REGIME_COLORS,
    axis_label,
    check_axes,
    check_dataset,
    color_bar,
    color_norm,
    cross,
    drawing,
    fit_scale,
    fit_swept,
    flagged,
    legend_above,
    mark_cases,
    name_case,
    shown,
    status_of,
    styled,
    swept,
)

DIRECTION_COLORS = {"up": COLORS["orange"], "down": COLORS["green"]}
"""Colours of the motions that are followed with the parameter raised and lowered."""
EXPONENT_LABEL = "largest exponent [1/period]"
UNRESOLVED_LABEL = "unresolved: estimates\ndisagree or are not sure"
NOT_RUN_LABEL = "not computed yet"
"""Legend entry of cases that a store does not have yet; they are left white."""
FLAGGED_COLOR = COLORS["grey"]
_MARKERS = dict(zip(REGIMES, "oDs^v", strict=True))
_LONGEST_NAMED = 4
"""Longest period with a colour of its own."""
MOTION_COLORS = {
    "period 1": "#d6e6f4",
    "period 2": "#8fc1de",
    "period 3": "#cbc3e8",
    "period 4": "#4a94c5",
    "other periods": "#9a86cc",
    "quasi-periodic": "#8fd0b0",
    "regular": "#c9ebd9",
    "chaotic": "#e8a090",
    "transient chaos": "#f5cf9f",
    "unresolved": "#e4e4e4",
}
"""Colours of motions, near those of their regimes in `REGIME_COLORS`, but lighter, so that curves are seen above."""


def bifurcation(ds: xr.Dataset, section: str, ax: Any = None, **style: Any) -> Any:
    """Draws one bifurcation diagram: a section's velocities over the swept parameter, in display units.

    Cases with a status other than 0 have no dots, but a grey cross at the bottom.

    **Arguments:**

    - `ds`: from `sweep(..., record="sections")` over one parameter, or one direction of `follow`.
    - `section`: v_y, v_z [m/s], w_x, w_y or w_z [rad/s].
    - `ax`: the Axes to draw into; default those of a new figure, with the fixed parameters as its title.
    - `style`: of the dots, for `Axes.plot`.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    check_dataset(ds, "sweep or follow", section)
    swept(ds[section], "crossing")
    with drawing(ax, ds) as ax:
        legend_above(ax, [cross(label=FLAGGED_LABEL)] * _draw_dots(ds, section, ax, **style))
    return ax


def bifurcations(
    ds: xr.Dataset,
    axes: Any = None,
    followed: xr.Dataset | None = None,
    *,
    sections: Sequence[str] = tuple(SECTIONS),
) -> Any:
    """Draws the bifurcation diagrams of all five sections, as Figs. 5, 8 and 10 of the paper, or of some.

    **Arguments:**

    - `ds`: as for `bifurcation`.
    - `axes`: as many Axes as sections; default those of a new figure, in two columns where there are more than three,
        with the fixed parameters as its title.
    - `followed`: from `follow`, drawn beneath: the motions that are met when the parameter is raised and lowered. Its
        crosses are coloured as its dots.
    - `sections`: names of velocities, such as ("v_y", "v_z").

    **Returns:** the Axes, an array.
    """
    check_dataset(ds, "sweep or follow", *SECTIONS)
    instance("sections", sections, Sequence, "a list of sections")
    for name in sections:
        one_of("sections", name, tuple(SECTIONS))
    if followed is not None:
        check_dataset(followed, "follow", "direction", argument="followed")
    with styled():
        columns = 2 if axes is None and len(sections) > 3 else 1
        if axes is None:
            axes = _stacked(len(sections), columns)
            name_case(axes[0].figure, ds, full=True)
        check_axes(axes, len(sections))
        ways = {} if followed is None else {way: followed.sel(direction=way) for way in followed["direction"].values}
        lost = False
        for tag, section, ax in zip("abcde", sections, axes, strict=False):
            for k, (way, color) in enumerate(DIRECTION_COLORS.items(), 1):
                if way in ways:
                    style = dict(color=color, label=f"followed {way}")
                    lost |= _draw_dots(ways[way], section, ax, 1.1, 0.04 + 0.06 * k, color, **style)
            # the dots beneath stay visible
            lost |= _draw_dots(ds, section, ax, 0.7 if ways else 1.0, label="from one start")
            if len(sections) > 1:  # beside the axes, where it hides no dot
                beside: dict[str, Any] = dict(xycoords="axes fraction", textcoords="offset points", fontsize=8)
                ax.annotate(f"({tag})", (0, 1), (-22, 0), va="top", ha="right", **beside)
        for ax in axes[:-columns]:
            ax.set_xlabel("")
        if ways or lost:
            legend_above(axes[0], axes[0].get_legend_handles_labels()[0] + [cross(label=FLAGGED_LABEL)] * lost)
            plt.setp(axes[0].get_legend().legend_handles, markersize=5)
    return axes


def _stacked(count: int, columns: int) -> np.ndarray:
    """Gives some Axes of a new figure over one another, in columns, of which the first row may lack its last."""
    rows = -(-count // columns)
    size = (3.6 * columns, 1.6 * rows + 0.7)
    _, grid = plt.subplots(rows, columns, figsize=size, sharex=True, layout="constrained", squeeze=False)
    axes = grid.ravel()
    absent = slice(columns - (-count % columns), columns)  # at the top, as the lowest ones have labels
    for ax in axes[absent]:
        ax.remove()
    return np.delete(axes, absent)


def _draw_dots(
    ds: xr.Dataset,
    section: str,
    ax: Any,
    size: float = 1.0,
    height: float = 0.04,
    cross_color: str = COLORS["grey"],
    **style: Any,
) -> bool:
    """Draws the dots of one section, and crosses of a colour and height for cases that are left out.

    **Arguments:** `size`: of the dots, relative to one at which they hardly overlap and can be seen.

    **Returns:** whether there are such cases.
    """
    (over,) = swept(ds[section], "crossing")
    values, bad, at = ds[section].transpose(over, "crossing").values, flagged(ds, over), shown(ds, over)
    case, crossing = np.nonzero(np.isfinite(values) & ~bad[:, None])
    points = size * float(np.clip(700 / len(at), 3.4, 5.0))
    style = {"ms": points, "mew": 0, "color": COLORS["blue"], "rasterized": True} | style
    ax.plot(at[case], values[case, crossing], ".", **style)
    mark_cases(ax, at[bad], cross_color, height)
    ax.set(xlabel=axis_label(over, ds), ylabel=axis_label(section))
    # margins hold the dots of the first and the last case
    ax.margins(x=max(0.5 / max(len(at) - 1, 1), 0.015) if len(at) > 10 else 0.05)
    ax.update_datalim(np.stack([at, at], axis=1), updatey=False)
    ax.autoscale_view()
    fit_swept(ax, x=at)
    return bool(bad.any())


def regimes_of(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Gives the name in `REGIMES` of each case, shape as `dims`; "unresolved" where the status is not 0.

    Without the variable `regime` it is read from `kind`.
    """
    if "regime" in ds:
        names = ds["regime"].transpose(*dims).values
    else:
        words = ds["kind"].transpose(*dims).values
        names = Regime.regime_names(Regime.codes(words))
    return np.where(flagged(ds, *dims), "unresolved", names)


def lasting_name(ds: xr.Dataset, name: str) -> str:
    """Gives a regime's entry in a legend, in two lines where chaos has a least mean life."""
    return lasting(name, ds.get("least_mean_life", np.nan)).replace(" (", "\n(")


def motions_of(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Gives the name in `MOTION_COLORS` of each case, shape as `dims`: its regime, or its period."""
    regime = regimes_of(ds, *dims)
    kind, period = (ds[name].transpose(*dims).values for name in ("kind", "period"))
    number = np.char.add("period ", period.astype(int).astype(str))
    periodic = np.where(period <= _LONGEST_NAMED, number, "other periods")
    irregular = np.where((regime == "regular") & (kind == "torus"), "quasi-periodic", regime)
    return np.where(regime == "periodic", periodic, irregular)


def map_over(
    ds: xr.Dataset,
    over: Sequence[str],
    values: np.ndarray,
    ax: Any,
    colors: Colormap,
    norm: Callable[[Any], Normalize],
) -> tuple[Any, list[Any]]:
    """Draws values over two parameters as colours: cells of a grid, or dots of a sample over the dimension `case`.

    Cases with a status other than 0 are grey. Those without a value, such as those that a growing store does not have
    yet, are white.

    **Arguments:** `over`: dimensions of `values`, the first drawn upwards; `norm`: makes the scale of `colors` from
    the values that are drawn.

    **Returns:** what a colour bar needs, and entries of a legend.
    """
    names = over if len(over) == 2 else varied_names(ds)
    y, x = (shown(ds, name) for name in names)
    missing = status_of(ds, *over) == Status.NOT_RUN
    bad = flagged(ds, *over) & ~missing
    values = np.ma.masked_invalid(np.where(bad | missing, np.nan, values))
    style: dict[str, Any] = dict(cmap=colors.with_extremes(bad=FLAGGED_COLOR), norm=norm(values), rasterized=True)
    if len(over) == 2:
        drawn = ax.pcolormesh(x, y, values, **style)
        white = np.ma.getmaskarray(values) & ~bad
        if white.any():
            blank = np.ma.masked_where(~white, np.zeros(white.shape))
            ax.pcolormesh(x, y, blank, cmap=ListedColormap(["white"]), rasterized=True)
        ax.grid(False)
    else:
        finite = ~np.ma.getmaskarray(values)
        drawn = ax.scatter(x[finite], y[finite], 6, values[finite], lw=0, **style)
        ax.scatter(x[bad], y[bad], 6, FLAGGED_COLOR, lw=0, rasterized=True)
    ax.set(xlabel=axis_label(names[1], ds), ylabel=axis_label(names[0], ds))
    if len(over) == 2:
        fit_swept(ax, x=x, y=y)
    handles = [Patch(color=FLAGGED_COLOR, label=FLAGGED_LABEL)] * bool(bad.any())
    if missing.any() and len(over) == 2:
        handles.append(Patch(facecolor="white", edgecolor="black", lw=0.5, label=NOT_RUN_LABEL))
    return drawn, handles


def regime_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """Draws the largest Lyapunov exponent [1/period] over two parameters: red above zero, blue below, white at zero.

    Each colour ends at the largest exponent of its sign and goes as the square root, so that exponents slightly below
    zero differ from zero. Unresolved cases have a cross. Cases with a status other than 0 are unresolved, and grey
    instead of coloured.

    **Arguments:** `ds`: from `lyapunov_sweep` over two parameters, the first drawn upwards; `ax`: the Axes
    to draw into, default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    check_dataset(ds, "lyapunov_sweep", "regime")
    over = swept(ds["regime"], count=2)
    with drawing(ax, ds, 3.5, 3.3) as ax:
        legend_above(ax, draw_regimes(ds, over, ax))
    return ax


def draw_regimes(ds: xr.Dataset, over: Sequence[str], ax: Any) -> list[Any]:
    """Draws as `regime_map`, without the legend, whose entries are returned."""
    exponent = ds["exponent"].isel(count=0).transpose(*over).values
    drawn, handles = map_over(ds, over, exponent, ax, plt.get_cmap("RdBu_r"), _signed_norm)
    color_bar(ax, drawn, EXPONENT_LABEL)
    unresolved = regimes_of(ds, *over) == "unresolved"
    if unresolved.any():
        y, x = np.meshgrid(*(shown(ds, name) for name in over), indexing="ij")
        style = dict(color="black", ms=2.5, mew=0.6, label=UNRESOLVED_LABEL)
        handles.insert(0, ax.add_line(cross(x[unresolved], y[unresolved], **style)))
    return handles


def _signed_norm(values: np.ma.MaskedArray) -> FuncNorm:
    """Gives colours that are white at zero only: each sign has its own half of them, by the square root."""
    top, bottom = (max(float(np.max(sign * values)), LEAST) if values.count() else 1.0 for sign in (1, -1))
    scale = lambda v: np.where(v < 0, bottom, top)
    forward = lambda v: np.sign(v) * np.sqrt(np.abs(v) / scale(v))
    backward = lambda c: np.sign(c) * np.square(c) * scale(c)
    return FuncNorm((forward, backward), vmin=-bottom, vmax=top)


def attractor_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """Draws the kind of motion over two parameters: periods 1 to 4, others, quasi-periodic, chaotic or unresolved.

    Of a dataset of `lyapunov_sweep` they are chaotic, regular and unresolved as in `regime_map`.

    **Arguments:** `ds`: over two parameters, the first drawn upwards, with the variables `kind` and `period` as
    `slipperjax.analysis.Attractors` has them; `ax`: the Axes to draw into, default those of a new figure, with the
    fixed parameters as its title.

    **Returns:** the Axes, with a legend of what occurs.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    check_dataset(ds, "lyapunov_sweep, or of a sweep with `kind` and `period` of its attractors", "kind", "period")
    over = swept(ds["kind"], count=2)
    with drawing(ax, ds, 3.5, 3.3) as ax:
        legend_above(ax, draw_attractors(ds, over, ax))
    return ax


def draw_attractors(ds: xr.Dataset, over: Sequence[str], ax: Any) -> list[Any]:
    """Draws as `attractor_map`, without the legend, whose entries are returned."""
    names, motions = list(MOTION_COLORS), motions_of(ds, *over)
    norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
    index = np.vectorize(names.index)(motions)
    _, handles = map_over(ds, over, index, ax, ListedColormap(list(MOTION_COLORS.values())), lambda values: norm)
    present = set(motions[~flagged(ds, *over)])
    edge = dict(edgecolor=COLORS["grey"], linewidth=0.4)
    patches = [
        Patch(facecolor=MOTION_COLORS[name], label=lasting_name(ds, name), **edge)
        for name in names
        if name in present
    ]
    return patches + handles


BASIN_COLORS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377")
"""Colours of the largest basins; further ones are grey. Paul Tol's bright scheme, for all kinds of colour vision."""


def basin_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """Draws which attractor each start leads to, with a legend of the attractors and their shares.

    **Arguments:** `ds`: of `slipperjax.sweeps.groups`, over two numbers, the first drawn to the right; `ax`: the Axes
    to draw into, default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not over two numbers.
    """
    check_dataset(ds, "slipperjax.sweeps.groups", "basin", "basin_period", "share")
    over = swept(ds["basin"], count=2)[::-1]
    numbers, most = ds["basin"].transpose(*over).values, len(BASIN_COLORS)
    colors = ListedColormap([*BASIN_COLORS, COLORS["grey"]])
    norm = BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)
    values = np.where(numbers < 0, np.nan, np.minimum(numbers, most))
    with drawing(ax, ds, 3.5, 3.3) as ax:
        _, handles = map_over(ds, over, values, ax, colors, lambda values: norm)
        periods, shares = ds["basin_period"].values, ds["share"].values
        kinds = [f"period {period}" if period else "no period" for period in periods[:most]]
        patches = [
            Patch(color=BASIN_COLORS[k], label=f"{kind}: {share:.0%}")
            for k, (kind, share) in enumerate(zip(kinds, shares, strict=False))
        ]
        if len(periods) > most:
            rest = f"{len(periods) - most} others: {shares[most:].sum():.0%}"
            patches.append(Patch(color=COLORS["grey"], label=rest))
        legend_above(ax, patches + handles)
    return ax


def quantity_map(ds: xr.Dataset, name: str = "peak_force", ax: Any = None) -> Any:
    """Draws a quantity over one parameter as dots, or over two as colours, in its display unit.

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
    over = tuple(map(str, ds["status"].dims))
    if len(over) not in (1, 2) or not set(over) <= set(ds[name].dims):
        raise ValueError(f"Argument `ds` must be over one parameter or two, but {name} is over {ds[name].dims}.")
    array = ds[name].astype(float)
    largest = array.where(np.isfinite(array)).max([d for d in array.dims if d not in over]).transpose(*over)
    values = shown(largest.to_dataset(name=name), name)
    names = varied_names(ds) if over == ("case",) else list(over)
    with drawing(ax, ds, 3.5, 2.8 if len(over) == 1 else 3.3) as ax:
        if len(names) == 2:
            drawn, handles = map_over(ds, over, values, ax, plt.get_cmap("viridis"), color_norm)
            color_bar(ax, drawn, axis_label(name, ds))
        else:
            x, bad = shown(ds, names[0]), flagged(ds, *over)
            values = np.where(bad, np.nan, values)
            bad &= status_of(ds, *over) != Status.NOT_RUN
            ax.plot(x, values, ".", ms=3, mew=0, color=COLORS["blue"])
            mark_cases(ax, x[bad])
            ax.margins(x=0.03)
            ax.set(xlabel=axis_label(names[0], ds), ylabel=axis_label(name, ds))
            fit_swept(ax, x=x)
            fit_scale(ax, values)
            handles = [cross(label=FLAGGED_LABEL)] * bool(bad.any())
        legend_above(ax, handles)
    return ax


def exponents(ds: xr.Dataset, ax: Any = None) -> Any:
    """Draws the largest Lyapunov exponent [1/period] over one parameter, with three standard errors, by regime.

    Cases with a status other than 0 count as unresolved; where they have no finite exponent, a cross at the bottom
    stands for them.

    **Arguments:** `ds`: from `lyapunov_sweep` over one parameter; `ax`: the Axes to draw into, default those of a new
    figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    check_dataset(ds, "lyapunov_sweep", "regime")
    (over,) = swept(ds["regime"])
    x, y, error = shown(ds, over), *(ds[name].isel(count=0).values for name in ("exponent", "stderr"))
    regimes, absent = regimes_of(ds, over), ~np.isfinite(y)
    with drawing(ax, ds, 3.5, 2.8) as ax:
        ax.axhline(0, lw=0.5, color="black")
        ax.plot(x, np.where(flagged(ds, over), np.nan, y), lw=0.5, color=COLORS["grey"], zorder=1)
        handles = []
        for name, color in REGIME_COLORS.items():
            at = (regimes == name) & ~absent
            if name != "transient chaos" or at.any():  # rare
                bars = dict(
                    fmt=_MARKERS[name], ms=3.5, mew=0, elinewidth=0.8, color=color, label=lasting_name(ds, name)
                )
                handles.append(ax.errorbar(x[at], y[at], SURE * error[at], **bars))
        mark_cases(ax, x[absent])
        legend_above(ax, handles + [cross(label="no exponent")] * bool(absent.any()))
        ax.margins(x=0.03)
        ax.set(xlabel=axis_label(over, ds), ylabel=EXPONENT_LABEL)
        fit_swept(ax, x=x)
    return ax
