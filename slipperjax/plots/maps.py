"""Results over one or two parameters: sections, exponents, regimes, attractors, any quantity of a sweep or store."""

from collections.abc import Callable, Sequence

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, FuncNorm, ListedColormap, Normalize

from ..analysis.kinds import REGIMES, Regime, lasting
from ..analysis.lyapunov import LEAST, SURE
from ..flow.status import Status
from ..model.quantities import SECTIONS
from .style import (
    COLORS,
    FLAGGED_LABEL,
    MOTION_COLORS,
    NOT_RUN_LABEL,
    check_dataset,
    color_bar,
    color_norm,
    drawing,
    fit_scale,
    flagged,
    highest,
    label,
    label_axes,
    legend_above,
    legend_patch,
    line_color,
    mark_cases,
    name_and_symbol,
    page,
    quantity_of,
    shown,
    status_of,
    swept,
)

DIRECTION_COLORS = {"up": 3, "down": 2}
"""Numbers of the colours of motions that are followed with a rising and a falling parameter, see `line_color`."""
EXPONENT_LABEL = "largest exponent [1/period]"
BASIN_COLORS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377")
"""Colours of the largest basins, in Paul Tol's bright scheme for all kinds of colour vision; others are grey."""


def each_way(ds: xr.Dataset, text: str = "") -> list[tuple[xr.Dataset, dict[str, str]]]:
    """Return the directions of a dataset of `follow` with their colours and labels; for another dataset all its cases
    with the label `text`."""
    if "direction" not in ds.dims:
        return [(ds, dict(color=line_color(0), label=text))]
    ways = map(str, ds["direction"].values)
    style = lambda way: dict(color=line_color(DIRECTION_COLORS[way]), label=f"followed {way}")
    return [(ds.sel(direction=way), style(way)) for way in ways]


def parameters_of(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the parameters over which a dataset has cases; the directions of `follow` are no parameter."""
    return tuple(str(dim) for dim in ds["status"].dims if dim != "direction")


def bifurcation(ds: xr.Dataset, section: str, ax: Axes | None = None, **style: object) -> Axes:
    """Draw one bifurcation diagram: a section's velocities over the swept parameter, in display units.

    Cases with a status other than 0 have no dots, but a grey cross at the bottom. Directions of `follow` have their
    own colours, and differ where there is hysteresis.

    **Arguments:**

    - `ds`: from `sweep(..., record="sections")` over one parameter, or from `follow`.
    - `section`: v_y, v_z [m/s], w_x, w_y or w_z [rad/s].
    - `ax`: the Axes to draw into; default the Axes of a new figure, with the fixed parameters as its title.
    - `style`: of the dots, for `Axes.plot`.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    ds = check_dataset(ds, "sweep or follow", section)
    swept(ds[section], "crossing", "direction")
    with drawing(ax, ds) as ax:
        _draw_dots(each_way(ds), section, ax, **style)
    return ax


def bifurcations(ds: xr.Dataset, followed: xr.Dataset | None = None) -> np.ndarray:
    """Draw the bifurcation diagrams of all five sections on one page, as Figs. 5, 8 and 10 of the paper.

    Velocities are in the upper row, angular velocities in the lower row.

    **Arguments:**

    - `ds`: as for `bifurcation`.
    - `followed`: from `follow`, drawn beneath: the motions while the parameter rises and falls.

    **Returns:** the Axes, an array.
    """
    ds = check_dataset(ds, "sweep or follow", *SECTIONS)
    drawn = each_way(ds)
    if followed is not None:
        followed = check_dataset(followed, "follow", "direction", argument="followed")
        # followed motions beneath, motions from one start above
        drawn = each_way(followed) + each_way(ds, "from one start")
    # one width for one abscissa; the third of six places is empty
    with page(2, 3, 4.6, ds, sharex=True) as places:
        places[0, 2].remove()
        axes = np.delete(places.ravel(), 2)
        for section, ax in zip(SECTIONS, axes, strict=True):
            _draw_dots(drawn, section, ax)
        plt.setp(axes[:2], xlabel="")
        legend_above(axes[0])
    return axes


def _draw_dots(drawn: Sequence[tuple[xr.Dataset, dict[str, str]]], section: str, ax: Axes, **style: object) -> None:
    """Draw the dots of one section in each dataset, and crosses for cases that are left out."""
    for k, (ds, look) in enumerate(drawn):
        (over,) = swept(ds[section], "crossing")
        # dots beneath others are larger, so that they stay visible
        size = max(3.4 - 0.8 * k, 1.0)
        ax.plot(*dots_of(ds, section, over), ".", **{"mew": 0, "ms": size, "rasterized": True, **look, **style})
        at = shown(ds, over)
        mark_cases(ax, at[flagged(ds, over)], FLAGGED_LABEL)
        label_axes(ax, at, shown(ds, section))
    ax.margins(x=0.03)


def dots_of(ds: xr.Dataset, name: str, over: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a parameter, and the values of a variable in each of its cases [display units], as places of dots.

    Cases with a status other than 0 have no dots.
    """
    values = shown(ds, name)
    if "status" in ds:
        values = values.where(ds["status"] == Status.FINITE)
    rows = values.transpose(over, ...).values.reshape(ds.sizes[over], -1)
    case, number = np.nonzero(np.isfinite(rows))
    return shown(ds, over).values[case], rows[case, number]


def regimes_of(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Return the name in `REGIMES` of each case, shape as `dims`; "unresolved" where the status is not 0.

    Without the variable `regime`, `kind` gives the name.
    """
    # exponents show more than recurrence
    if "regime" in ds:
        names = ds["regime"].transpose(*dims).values
    else:
        names = Regime.regime_names(Regime.codes(ds["kind"].transpose(*dims).values))
    return np.where(flagged(ds, *dims), "unresolved", names)


def motions_of(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """Return the name in `MOTION_COLORS` of each case, shape as `dims`: its period, its regime, or "flagged"."""
    regime = regimes_of(ds, *dims)
    kind = ds["kind"].transpose(*dims).values
    period = ds["period"].transpose(*dims).values.astype(int)
    number = np.char.add("period ", period.astype(str))
    # recurrence shows tori; other regular motions have no kind
    motion = np.where((regime == "regular") & (kind == "torus"), "quasi-periodic", regime)
    # longer periods have one colour
    motion = np.where(regime == "periodic", np.where(period <= 4, number, "other periods"), motion)
    return np.where(flagged(ds, *dims), FLAGGED_LABEL, motion)


def map_over(
    ds: xr.Dataset,
    over: Sequence[str],
    values: np.ndarray,
    ax: Axes,
    colors: Sequence[str] | str,
    norm: Callable[[np.ma.MaskedArray], Normalize] | None = None,
    bad_color: str = COLORS["grey"],
) -> ScalarMappable:
    """Draw values over two parameters as colours of cells; return the mesh, for a colour bar.

    Cases with a status other than 0 have the colour `bad_color`. Cases without a value, such as missing cases of a
    growing store, are white.

    **Arguments:** `over`: dimensions of `values`, the first drawn upwards; `colors`: a list, of which `values` are
    indices, or the name of a colour map; `norm`: for a colour map, returns its scale for the drawn values.
    """
    y, x = (shown(ds, name) for name in over)
    missing = status_of(ds, *over) == Status.NOT_RUN
    bad = flagged(ds, *over) & ~missing
    values = np.ma.masked_invalid(np.where(bad | missing, np.nan, values))
    if norm is None:
        colormap: Colormap = ListedColormap(colors)
        scale = Normalize(-0.5, len(colors) - 0.5)  # each index has one colour
    else:
        colormap = plt.get_cmap(colors)
        scale = norm(values)
    drawn = ax.pcolormesh(x, y, values, cmap=colormap.with_extremes(bad=bad_color), norm=scale, rasterized=True)
    # places without a value are covered in white, because the mesh has only one colour for masked values
    white = np.ma.getmaskarray(values) & ~bad
    if white.any():
        blank = np.ma.masked_where(~white, np.zeros(white.shape))
        ax.pcolormesh(x, y, blank, cmap=ListedColormap(["white"]), rasterized=True)
    if bad.any():
        legend_patch(ax, FLAGGED_LABEL, color=bad_color)
    if missing.any():
        legend_patch(ax, NOT_RUN_LABEL, facecolor="white", edgecolor="black", lw=0.5)
    ax.grid(False)
    label_axes(ax, x, y)
    return drawn


def regime_map(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw the largest Lyapunov exponent [1/period] over two parameters: red above zero, blue below, white at zero.

    Each colour ends at the largest exponent of its sign. Colours follow the square root, so that exponents slightly
    below zero differ from zero. Unresolved cases have a cross. Cases with a status other than 0 are unresolved, and
    grey.

    **Arguments:** `ds`: from `lyapunov_sweep` over two parameters, the first drawn upwards; `ax`: the Axes
    to draw into, default the Axes of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    ds = check_dataset(ds, "lyapunov_sweep", "regime")
    over = swept(ds["regime"], count=2)
    with drawing(ax, ds, 3.5, 3.3) as ax:
        # a cross on each unresolved case
        unresolved = regimes_of(ds, *over) == "unresolved"
        if unresolved.any():
            y, x = np.meshgrid(*(shown(ds, name) for name in over), indexing="ij")
            label = "unresolved: estimates\ndisagree or are not sure"
            ax.plot(x[unresolved], y[unresolved], "x", color="black", ms=2.5, mew=0.6, label=label)
        exponent = ds["exponent"].isel(count=0).transpose(*over).values
        drawn = map_over(ds, over, exponent, ax, "RdBu_r", _signed_norm)
        color_bar(ax, drawn, EXPONENT_LABEL)
    return ax


def _signed_norm(values: np.ma.MaskedArray) -> FuncNorm:
    """Return a colour scale with zero in its middle; each sign fills its half by the square root."""
    # exponents below `LEAST` count as zero, and must not fill a half
    top = max(float(values.max()), LEAST) if values.count() else 1.0
    bottom = max(float(-values.min()), LEAST) if values.count() else 1.0
    # each half has its own scale
    scale = lambda v: np.where(v < 0, bottom, top)
    forward = lambda v: np.sign(v) * np.sqrt(np.abs(v) / scale(v))
    backward = lambda c: np.sign(c) * np.square(c) * scale(c)
    return FuncNorm((forward, backward), vmin=-bottom, vmax=top)


def attractor_map(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw the kind of motion over two parameters: periods 1 to 4, others, quasi-periodic, chaotic or unresolved.

    For a dataset of `lyapunov_sweep` the kinds are chaotic, regular and unresolved as in `regime_map`.

    **Arguments:** `ds`: over two parameters, the first drawn upwards, with the variables `kind` and `period` of
    `slipperjax.analysis.Attractors`; `ax`: the Axes to draw into, default the Axes of a new figure, with the
    fixed parameters as its title.

    **Returns:** the Axes, with a legend of the kinds that occur.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    ds = check_dataset(
        ds,
        "lyapunov_sweep, or of a sweep with `kind` and `period` of its attractors",
        "kind",
        "period",
    )
    over = swept(ds["kind"], count=2)
    index, colors = categories(ds, motions_of(ds, *over))
    with drawing(ax, ds, 3.5, 3.3) as ax:
        for name, color in colors.items():
            # the map has its own entry for flagged cases
            if name != FLAGGED_LABEL:
                legend_patch(ax, name, facecolor=color, edgecolor=COLORS["grey"], lw=0.4)
        map_over(ds, over, index, ax, list(colors.values()), bad_color=MOTION_COLORS[FLAGGED_LABEL])
    return ax


def categories(ds: xr.Dataset, words: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
    """Return the index of each word among the kinds of motion that occur (NaN for other words), and their colours."""
    present = {name: color for name, color in MOTION_COLORS.items() if name in words}
    index = np.select([words == name for name in present], list(range(len(present))), np.nan)
    life = ds.get("least_mean_life", np.nan)
    return index, {lasting(name, life): color for name, color in present.items()}


def basin_map(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw to which attractor each start leads, with a legend of the attractors and their shares.

    **Arguments:** `ds`: of `slipperjax.sweeps.groups`, over two numbers, the first drawn to the right; `ax`: the Axes
    to draw into, default the Axes of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not over two numbers.
    """
    ds = check_dataset(ds, "slipperjax.sweeps.groups", "basin", "basin_period", "share")
    over = swept(ds["basin"], count=2)[::-1]
    numbers = ds["basin"].transpose(*over).values
    most = len(BASIN_COLORS)
    periods = ds["basin_period"].values
    # over parameters: of all cases
    shares = ds["share"].mean([d for d in ds["share"].dims if d != "attractor"]).values
    with drawing(ax, ds, 3.5, 3.3) as ax:
        # entries of the largest basins
        for k, (color, period, share) in enumerate(zip(BASIN_COLORS, periods, shares, strict=False)):
            legend_patch(ax, f"{_kind_of(k, period)}, {share:.0%}", color=color)
        if len(periods) > most:
            legend_patch(ax, f"{len(periods) - most} others: {shares[most:].sum():.0%}", color=COLORS["grey"])
        index = np.where(numbers < 0, np.nan, np.minimum(numbers, most))
        map_over(ds, over, index, ax, [*BASIN_COLORS, COLORS["grey"]])
    return ax


def _kind_of(number: int, period: int) -> str:
    return f"{number}: period {period}" if period else f"{number}: no period"


def basin_shares(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw the share of starts that lead to each attractor over a parameter, with bars of one standard error.

    **Arguments:** `ds`: of `slipperjax.basins` over one parameter; `ax`: the Axes to draw into, default the Axes of a
    new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not over one parameter.
    """
    ds = check_dataset(ds, "slipperjax.basins", "basin_period", "share", "share_stderr")
    (over,) = swept(ds["share"].isel(attractor=0), count=1)
    x = shown(ds, over)
    with drawing(ax, ds, 3.5, 2.6) as ax:
        for k, (color, period) in enumerate(zip(BASIN_COLORS, ds["basin_period"].values, strict=False)):
            of = ds.isel(attractor=k)
            bars = dict(color=color, marker="o", ms=3, lw=1.0, capsize=2)
            ax.errorbar(x.values, of["share"].values, of["share_stderr"].values, label=_kind_of(k, period), **bars)
        ax.set(xlabel=label(x), ylabel="share of the starts", ylim=(-0.03, 1.03))
    return ax


def of_basins(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw basins: shares over a parameter, or the map of starts at one value."""
    return basin_map(ds, ax) if ds["share"].ndim == 1 else basin_shares(ds, ax)


def quantity_map(ds: xr.Dataset, name: str = "peak_force", ax: Axes | None = None) -> Axes:
    """Draw a quantity over one parameter as dots, or over two as colours, in its display unit.

    Directions of `follow` are curves, up and down, which differ where there is hysteresis. For a quantity with
    several values in each case, such as one value for each contact point, the largest is drawn. Cases with a status
    other than 0 are grey, missing cases of a growing store are white. The scale is logarithmic where the values
    differ by a factor above 8.

    **Arguments:** `ds`: from `sweep` or `follow`, or a store; over two parameters the first is drawn upwards; `name`:
    a variable; `ax`: the Axes to draw into, default the Axes of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for a name that is no variable with numbers, or more than two parameters.
    """
    ds = check_dataset(ds, "sweep", name)
    if ds[name].dtype.kind not in "fiub":
        raise ValueError(f"Argument `name` must be a variable with numbers, but {name} has {ds[name].dtype}.")
    over = parameters_of(ds)
    if len(over) not in (1, 2) or not set(over) <= set(ds[name].dims):
        raise ValueError(f"Argument `ds` must be over one parameter or two, but {name} is over {ds[name].dims}.")
    with drawing(ax, ds, height=2.8 if len(over) == 1 else 3.3) as ax:
        if len(over) == 2:
            values = highest(ds, name, *over).assign_attrs(long_name=name_and_symbol(quantity_of(name, ds)))
            color_bar(ax, map_over(ds, over, values.values, ax, "viridis", color_norm), label(values))
            return ax
        drawn = []
        for one, look in each_way(ds):
            x = shown(one, over[0])
            values = highest(one, name, *over)
            bad = flagged(one, *over)
            drawn.append(np.where(bad, np.nan, values))
            # each case of a direction begins as its neighbour ended
            line = "-" if "direction" in ds.dims else ""
            ax.plot(x, drawn[-1], ".", ls=line, lw=0.7, ms=3, mew=0, **look)
            # missing cases have no mark
            mark_cases(ax, x[bad & (status_of(one, *over) != Status.NOT_RUN)], FLAGGED_LABEL)
            label_axes(ax, x, values)
        ax.margins(x=0.03)
        fit_scale(ax, np.stack(drawn))
    return ax


def exponents(ds: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw the largest Lyapunov exponent [1/period] over one parameter, with three standard errors, by regime.

    Cases with a status other than 0 count as unresolved; where they have no finite exponent, a cross at the bottom
    represents them.

    **Arguments:** `ds`: from `lyapunov_sweep` over one parameter; `ax`: the Axes to draw into, default the Axes of a
    new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` where `ds` is not swept over one parameter.
    """
    ds = check_dataset(ds, "lyapunov_sweep", "regime")
    (over,) = swept(ds["regime"])
    x = shown(ds, over)
    y, error = (ds[name].isel(count=0).values for name in ("exponent", "stderr"))
    regimes = regimes_of(ds, over)
    absent = ~np.isfinite(y)
    life = ds.get("least_mean_life", np.nan)
    with drawing(ax, ds, 3.5, 2.8) as ax:
        ax.axhline(0, lw=0.5, color="black")
        ax.plot(x, np.where(flagged(ds, over), np.nan, y), lw=0.5, color=COLORS["grey"], zorder=1)
        # a colour and a marker for each regime
        for name, marker in zip(REGIMES, "oDs^v", strict=True):
            at = (regimes == name) & ~absent
            if at.any():
                style = dict(color=MOTION_COLORS[name], label=lasting(name, life))
                ax.errorbar(x[at], y[at], SURE * error[at], fmt=marker, ms=3.5, mew=0, elinewidth=0.8, **style)
        mark_cases(ax, x[absent], "no exponent")
        ax.margins(x=0.03)
        ax.set(xlabel=label(x), ylabel=EXPONENT_LABEL)
    return ax
