"""Designs: objective in each case, trials, progress, sensitivities, margins to events, and the objective nearby."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch

from ..analysis.kinds import KINDS
from ..flow.datasets import varied_names
from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from ..tools.checks import require
from .branches import EVENT_MARKERS, EVENT_NAMES
from .style import (
    COLORS,
    axis_label,
    case_title,
    check_axes,
    check_dataset,
    color_bar,
    color_norm,
    cross,
    drawing,
    fit_scale,
    legend_above,
    line_color,
    mark_cases,
    name_label,
    quantity_of,
    shown,
    styled,
    with_unit,
)

REGIME_HATCHES = {
    "period n": ("...", "a case of period above 1"),
    "irregular": ("////", "a case irregular"),
    "lost": ("xxxx", "a case lost"),
}
"""Hatches of designs by their least regular case, and their entries in a legend; none where all have period 1."""
OPTIMUM: dict[str, Any] = dict(ls="", marker="*", ms=10, mfc="#ffd23f", mec="black", mew=0.7, zorder=6, label="best")
"""Marker of the best design."""


def design_overview(
    ds: Any, surroundings: xr.Dataset | None = None, axes: Any = None, *, margins: xr.Dataset | None = None
) -> Any:
    """Draw a design on one page: objective by case, trials, progress of the search, sensitivities, and checks.

    The title states what is fixed, and the best design. The panels are

    - the objective in each case, at the best design and at the first one that was tried, marked by kind of motion;
      bars are standard errors, and a cross at the bottom is a case without a motion;
    - the trials in the plane of the first two variables, coloured by the objective; with one variable it is drawn
      over it. Filled ones were taken, and lines join them; hollow ones were not;
    - the objective of each trial, and the lowest until then without violations, over the simulated periods;
    - percent of the objective by one percent of a variable, with standard errors.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `surroundings`: a grid around the best design, by `slipperjax.design.surroundings`, drawn as colours, hatched
      where not all cases have period 1, or over one variable as a line.
    - `axes`: 4 Axes, and one more for each of `surroundings` and `margins`; default those of a new figure.
    - `margins`: distances to events, drawn at the end by `design_margins`.

    **Returns:** the Axes, an array.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = _design(ds)
    count = 4 + (surroundings is not None) + (margins is not None)
    with styled():
        if axes is None:
            rows = {4: "AB;CD", 5: "AB;CD;EE", 6: "AB;CD;EF"}[count]
            size = (7.2, 5.8 if count == 4 else 8.7)
            figure, panels = plt.subplot_mosaic(rows, figsize=size, layout="constrained")
            figure.suptitle(_title(ds), fontsize=7)
            axes = np.array([panels[label] for label in sorted(panels)])
        every = np.ravel(check_axes(axes, count))
        # the panels that every design has, and those of the checks behind them
        for draw, ax in zip((_draw_cases, _draw_trials, _draw_progress, _draw_slopes), every, strict=False):
            draw(ds, ax)
        if surroundings is not None:
            _draw_map(ds, surroundings, every[4])
        if margins is not None:
            design_margins(ds, margins, every[count - 1])
    return axes


def _design(ds: Any) -> xr.Dataset:
    """Return the dataset of a design, or of a result that has one."""
    return check_dataset(ds, "optimise_design", "trial_design", "objective", "design")


def _draw_cases(ds: xr.Dataset, ax: Any) -> None:
    blue = COLORS["blue"]
    grey = COLORS["grey"]
    x, label = _over_cases(ds)
    order = np.argsort(x)
    q = quantity_of("objective", ds)
    best = _scaled(q, ds["objective"])
    first = _scaled(q, ds["trial_objective"].isel(trial=0))
    drawn = (
        (first, ds["trial_regime"].values[0], grey, "first design"),
        (best, ds["regime"].values, blue, "best design"),
    )
    for y, regimes, color, text in drawn:
        ax.plot(x[order], y[order], lw=0.8, color=color, zorder=2, label=text)
        _mark_kinds(ax, x, y, _kinds_of(regimes), color)
        mark_cases(ax, x[~np.isfinite(y)], "no motion", color)
    error = np.nan_to_num(q.shown(ds["objective_stderr"].values))
    # orbits have no standard error
    unsure = (error > 0) & np.isfinite(best)
    if unsure.any():
        ax.errorbar(x[unsure], best[unsure], error[unsure], fmt="none", lw=0.8, capsize=2, color=blue)
    total = q.shown(ds.attrs["objective"])
    # of one case the total is the case
    if ds.sizes["case"] > 1 and np.isfinite(total):
        ax.axhline(total, lw=0.7, ls=":", color=blue, zorder=1, label=ds.attrs["robust"])
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=name_label(q))
    fit_scale(ax, np.concatenate([first, best]))
    legend_above(ax)


def _draw_trials(ds: xr.Dataset, ax: Any) -> None:
    variables = [_parameter(ds, name) for name in ds["variable"].values[:2].tolist()]
    plane = len(variables) > 1
    total = _scaled(quantity_of("smooth", ds), ds["trial_smooth"])
    label = _smooth_label(ds)
    finite = np.isfinite(total)
    taken = ds["trial_taken"].values.astype(bool) & finite
    places = [one.shown(ds["trial_design"].sel(variable=one.name).values) for one in variables]
    # with one variable the objective is drawn upwards
    x, y = places if plane else (*places, total)
    first: dict[str, Any] = dict(ls="", marker="s", ms=6.5, mfc="none", mec="black", mew=0.8, zorder=4, label="start")
    # a line through what each start took, and a square where it began
    for start in np.unique(ds["trial_start"].values):
        own = ds["trial_start"].values == start
        ax.plot(x[own & taken], y[own & taken], lw=0.7, color=COLORS["grey"], zorder=1)
        ax.plot(x[own][:1], y[own][:1], **first)
    norm = color_norm(total)
    colors = np.tile(to_rgba(COLORS["blue"]), (len(x), 1))
    # in the plane colours are the objective
    if plane:
        colors = plt.get_cmap("viridis")(norm(np.where(finite, total, float(norm.vmin or 0.0))))
        ax.add_line(cross(x[~finite], y[~finite], zorder=3))
        color_bar(ax, ScalarMappable(norm, "viridis"), label)
    else:
        mark_cases(ax, x[~finite], "no motion")
    ax.plot(*_best_place(ds, variables), **OPTIMUM)
    _scatter_trials(ds, ax, x, y, colors)
    sides = (ax.set_xlim, ax.axvline), (ax.set_ylim, ax.axhline)
    bound: dict[str, Any] = dict(ls=":", lw=0.9, color=COLORS["red"], zorder=1, label="bound")
    # bounds of each variable along its axis
    for one, (set_limits, line) in zip(variables, sides, strict=False):
        low, high = (float(one.shown(ds[end].sel(variable=one.name))) for end in ("low", "high"))
        margin = 0.04 * (high - low)
        set_limits(low - margin, high + margin)
        line(low, **bound)
        line(high, **bound)
    ax.set(xlabel=name_label(variables[0]), ylabel=name_label(variables[1]) if plane else label)
    if not plane:
        fit_scale(ax, total)
    legend_above(ax)


def _scatter_trials(ds: xr.Dataset, ax: Any, x: np.ndarray, y: np.ndarray, colors: np.ndarray) -> None:
    """Draw trials as dots, filled where taken, triangles where they violate a constraint."""
    finite = np.isfinite(ds["trial_smooth"].values)
    taken = ds["trial_taken"].values.astype(bool)
    kept = _kept(ds)
    kinds = (
        ("taken", "o", taken & kept),
        ("not taken", "o", ~taken & kept),
        ("taken, violated", "v", taken & ~kept),
        ("constraint violated", "v", ~taken & ~kept),
    )
    # each kind of trial has its own marker and entry
    for label, marker, those in kinds:
        at = finite & those
        if at.any():
            face = colors[at] if label.startswith("taken") else "none"
            style = dict(marker=marker, lw=0.9, zorder=3, label=label)
            ax.scatter(x[at], y[at], 16, facecolors=face, edgecolors=colors[at], **style)


def _kept(ds: xr.Dataset) -> np.ndarray:
    """Return whether each trial keeps the constraints, but for rounding."""
    return ds["trial_violation"].values <= 1e-6


def _draw_progress(ds: xr.Dataset, ax: Any) -> None:
    blue = COLORS["blue"]
    total = _scaled(quantity_of("smooth", ds), ds["trial_smooth"])
    label = _smooth_label(ds)
    finite = np.isfinite(total)
    x = ds["trial_simulated"].values
    # trials that break a constraint are no progress
    lowest = np.minimum.accumulate(np.where(_kept(ds) & finite, total, np.inf))
    begun = np.isfinite(lowest)
    ax.plot(x[begun], lowest[begun], lw=1.2, color=blue, drawstyle="steps-post", label="lowest")
    _scatter_trials(ds, ax, x, total, np.tile(to_rgba(blue), (len(x), 1)))
    mark_cases(ax, x[~finite], "no motion")
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel="forcing periods simulated", ylabel=label)
    fit_scale(ax, total)
    legend_above(ax)


def _draw_slopes(ds: xr.Dataset, ax: Any) -> None:
    x, label = _over_cases(ds)
    order = np.argsort(x)
    # relative: percent by percent
    per = ds["design"] / ds["smooth"]
    slopes, errors = ((ds[f"gradient{s}"] * per).transpose("case", "variable").values for s in ("", "_stderr"))
    ax.axhline(0, lw=0.5, color="black")
    # a line for each variable over the cases
    for k, name in enumerate(map(str, ds["variable"].values)):
        error = np.nan_to_num(np.abs(errors[order, k]))
        text = name.replace("_", " ") + (f" ${PARAMETERS[name].symbol}$" if name in PARAMETERS else "")
        style = dict(fmt="o-", ms=3, mew=0, lw=0.8, elinewidth=0.8, capsize=2 if error.any() else 0)
        ax.errorbar(x[order], slopes[order, k], error, color=line_color(k), label=text, **style)
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=f"change of {_name(quantity_of('smooth', ds))}\nby 1 % of a variable [%]")
    legend_above(ax)


def design_margins(ds: Any, margins: xr.Dataset, ax: Any = None) -> Any:
    """Draw bars of how far parameters may change, either way, before the orbit of a case meets an event.

    A marker at the end of a bar is the event, with the parameter's value there; a bar without one ends where the
    search ended.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `margins`: of it, by `event_margins`.
    - `ax`: the Axes to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = _design(ds)
    check_dataset(margins, "event_margins", "parameter", "relative", "label")
    cases = list(dict.fromkeys(margins["case"].values.tolist()))
    names = list(dict.fromkeys(margins["parameter"].values.astype(str).tolist()))
    parameters = {name: _parameter(ds, name) for name in names}
    over = [(_parameter(ds, name), ds[name].values) for name in varied_names(ds)]
    with drawing(ax, None, 3.5, 2.9) as ax:
        columns = (margins[name].values.tolist() for name in ("case", "parameter", "label", "value", "relative"))
        for case, name, label, value, relative in zip(*columns, strict=True):
            color = line_color(cases.index(case))
            text = ", ".join(_stated(q, values[case]) for q, values in over) or "the case"
            # a row for each parameter, with the cases' bars beneath each other
            row = names.index(name) + 0.7 * ((cases.index(case) + 0.5) / len(cases) - 0.5)
            change = 100 * relative
            ax.plot([0, change], [row] * 2, color=color, lw=3.5, alpha=0.35, solid_capstyle="butt", label=text)
            # the side without an event has a bar alone
            if label:
                marker = dict(ls="", marker=EVENT_MARKERS[label], ms=5, mew=0.9, color=color)
                ax.plot([change], [row], zorder=3, label=f"{label} {EVENT_NAMES[label]}", **marker)
                offset, side = (-5, "right") if change < 0 else (5, "left")
                style: dict[str, Any] = dict(textcoords="offset points", va="center", ha=side, fontsize=6)
                ax.annotate(f"{parameters[name].shown(value):.4g}", (change, row), (offset, 0), **style)
        ax.axvline(0, lw=0.5, color="black", zorder=1)
        ticks = [with_unit(_name(q), q.display_unit, brackets=True) for q in parameters.values()]
        ax.set_yticks(range(len(names)), ticks)
        farthest = 135 * max(float(np.nanmax(np.abs(margins["relative"].values), initial=0.0)), 1e-9)
        ax.set(xlabel="change of the parameter [%]", xlim=(-farthest, farthest), ylim=(len(names) - 0.5, -0.5))
        legend_above(ax)
    return ax


def _draw_map(ds: xr.Dataset, surroundings: xr.Dataset, ax: Any) -> None:
    """Draw a grid around the best design, over one variable as a line, over two as colours with hatches."""
    grid = check_dataset(surroundings, "slipperjax.design.surroundings", "total", argument="surroundings")
    over = [str(name) for name in ds["variable"].values if name in grid["total"].dims]
    need = f"be over some of {', '.join(map(str, ds['variable'].values))}"
    require(over, "surroundings", need, shown=f"over {', '.join(map(str, grid['total'].dims))}")
    # of more than two variables the further ones are as near the best design as the grid has them
    grid = grid.sel({name: float(ds["design"].sel(variable=name)) for name in over[2:]}, method="nearest")
    variables = [_parameter(ds, name) for name in over[:2]]
    places = [q.shown(grid[q.name].values) for q in variables]
    total = _scaled(quantity_of("smooth", ds), grid["total"].transpose(*over[:2]))
    label = _smooth_label(ds)
    # one irregular case is enough for the hatch
    kinds = _least_regular(ds, grid, over[:2])
    best = ax.plot(*_best_place(ds, variables), **OPTIMUM)
    ax.set_xlabel(name_label(variables[0]))
    if len(variables) == 1:
        ax.plot(*places, total, lw=0.8, color=COLORS["grey"], zorder=1)
        _mark_kinds(ax, places[0], total, kinds, COLORS["blue"])
        mark_cases(ax, places[0][np.isnan(total)], "no motion")
        fit_scale(ax, total)
        ax.set_ylabel(label)
        legend_above(ax)
        return
    colors = plt.get_cmap("viridis").with_extremes(bad=COLORS["grey"])
    mesh = ax.pcolormesh(
        *places, np.ma.masked_invalid(total.T), cmap=colors, norm=color_norm(total), shading="nearest"
    )
    hatches = []
    # hatches lie above the colours, a mask for each kind
    for kind, (hatch, text) in REGIME_HATCHES.items():
        if np.any(kinds == kind):
            cells = np.ma.masked_where(kinds != kind, np.zeros(kinds.shape)).T
            style: dict[str, Any] = dict(facecolors="none", edgecolors="white", linewidths=0, zorder=2)
            ax.pcolor(*places, cells, shading="nearest", hatch=hatch, **style)
            hatches.append(Patch(hatch=hatch, label=text, facecolor=COLORS["grey"], edgecolor="white", lw=0))
    color_bar(ax, mesh, label)
    ax.set_ylabel(name_label(variables[1]))
    ax.grid(False)
    legend_above(ax, best + hatches)


def _least_regular(ds: xr.Dataset, grid: xr.Dataset, over: list[str]) -> np.ndarray:
    """Return the least regular kind of motion among the cases of each design of a grid."""
    kinds = np.array(["period 1", *REGIME_HATCHES])
    lost = ~np.isfinite(grid[ds["smooth"].attrs["quantity"]])
    period = grid.get("period", 1)
    # the higher, the less regular
    rank = xr.where(lost, 3, xr.where(period == 1, 0, xr.where(period > 1, 1, 2)))
    return kinds[rank.max([d for d in rank.dims if d not in over]).transpose(*over).values]


def _kinds_of(regimes: Any) -> np.ndarray:
    """Return regimes in words, all periods above 1 as one, and all motions without a period."""
    words = np.asarray(regimes).astype(str)
    # KINDS begins with the periodic ones
    words = np.where(np.isin(words, KINDS[1:]), "irregular", words)
    return np.where(np.char.startswith(words, "period ") & (words != "period 1"), "period n", words)


def _mark_kinds(ax: Any, x: np.ndarray, y: np.ndarray, kinds: np.ndarray, color: str) -> None:
    """Draw markers by kind of motion."""
    # one line of markers for each kind that occurs
    for kind, marker in {"period 1": "o", "period n": "s", "irregular": "D"}.items():
        at = (kinds == kind) & np.isfinite(y)
        if at.any():
            style = dict(ls="", marker=marker, ms=4.5, mew=0.5, mec="white", color=color, zorder=4, label=kind)
            ax.plot(x[at], y[at], **style)


def _over_cases(ds: xr.Dataset) -> tuple[np.ndarray, str]:
    """Return the parameter that differs between the cases, and its label; their numbers for none or several."""
    names = varied_names(ds)
    if len(names) == 1:
        return shown(ds, names[0]), axis_label(names[0], ds)
    # without one parameter cases have numbers
    return np.arange(1, ds.sizes["case"] + 1), "case" if not names else f"case, over {' and '.join(names)}"


def _smooth_label(ds: xr.Dataset) -> str:
    """Return the label of what is minimised."""
    return name_label(quantity_of("smooth", ds)) + _reduction(ds, "\n")


def _parameter(ds: xr.Dataset, name: str) -> Quantity:
    """Return the quantity of a parameter that was chosen or varied."""
    if name in ds or name in PARAMETERS:
        return quantity_of(name, ds)
    return Quantity(name, str(ds["variable_unit"].sel(variable=name).item()), name)


def _scaled(q: Quantity, array: Any) -> np.ndarray:
    """Return values [SI unit] in their display unit; NaN in place of infinities."""
    values = np.asarray(q.shown(np.asarray(array, float)))
    return np.where(np.isfinite(values), values, np.nan)


def _name(q: Quantity) -> str:
    return q.name.replace("_", " ")


def _stated(q: Quantity, value: float) -> str:
    """Return a quantity in words, with its value [SI unit] in the display unit."""
    return with_unit(f"{_name(q)} {q.shown(value):.5g}", q.display_unit)


def _reduction(ds: xr.Dataset, before: str) -> str:
    """Return how several cases become one number, after a text; nothing for one case."""
    return f"{before}{ds.attrs['robust']} of {ds.sizes['case']} cases" if ds.sizes["case"] > 1 else ""


def _best_place(ds: xr.Dataset, variables: list[Quantity]) -> list[float]:
    """Return the coordinates of the best design [display units]: two variables, or one and the objective."""
    place = [float(one.shown(ds["design"].sel(variable=one.name))) for one in variables]
    return place if len(place) > 1 else [*place, quantity_of("smooth", ds).shown(ds.attrs["smooth"])]


def _title(ds: xr.Dataset) -> str:
    """Return the fixed parameters, and the best design."""
    pairs = zip(ds["variable"].values.tolist(), ds["design"].values, strict=True)
    design = ", ".join(_stated(_parameter(ds, name), value) for name, value in pairs)
    best = f"{ds.attrs['status']}: {design}; {_stated(quantity_of('objective', ds), ds.attrs['objective'])}"
    return f"{case_title(ds, full=True)}\n{best}{_reduction(ds, ', ')}".strip()
