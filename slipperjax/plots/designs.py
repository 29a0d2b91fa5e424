"""Designs: objective in each case, trials, progress, sensitivities, margins to events, and the objective nearby."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..analysis.kinds import KINDS
from ..flow.datasets import varied_names
from ..model.parameters import PARAMETERS, quantity
from ..model.quantities import Quantity
from .branches import EVENT_MARKERS, EVENT_NAMES
from .maps import FLAGGED_COLOR
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
    legends_above,
    line_color,
    mark_cases,
    shown,
    styled,
    with_unit,
)

REGIME_MARKERS = {"period 1": "o", "period n": "s", "irregular": "D"}
"""Markers of cases by their kind of motion; n is above 1."""
REGIME_HATCHES = {
    "period n": ("...", "a case of period above 1"),
    "irregular": ("////", "a case irregular"),
    "lost": ("xxxx", "a case lost"),
}
"""Hatches of designs by their least regular case, and their entries in a legend; none where all have period 1."""
VIOLATED = 1e-6
"""Violation from which a trial counts as breaking a constraint."""
OPTIMUM: dict[str, Any] = dict(ls="", marker="*", ms=10, mfc="#ffd23f", mec="black", mew=0.7, zorder=6)
"""Marker of the best design."""
FIRST_TRIAL: dict[str, Any] = dict(ls="", marker="s", ms=6.5, mfc="none", mec="black", mew=0.8, zorder=4)
"""Marker of the first trial of a start."""
BOUND: dict[str, Any] = dict(ls=":", lw=0.9, color=COLORS["red"], zorder=1)
"""Line of the least and the greatest value that a variable may have."""
GRID_MINIMUM: dict[str, Any] = dict(ls="", marker="P", ms=4, mfc="white", mec="black", mew=0.7, zorder=7)
"""Marker of the lowest value of a grid."""


def design_overview(
    ds: Any, surroundings: xr.Dataset | None = None, axes: Any = None, *, margins: xr.Dataset | None = None
) -> Any:
    """Draws a design on one page: objective by case, trials, progress of the search, sensitivities, and checks.

    The title states what is fixed, and the best design.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `surroundings`: a grid around the best design, drawn below by `design_map`.
    - `axes`: 4 Axes, and one more for each of `surroundings` and `margins`; default those of a new figure.
    - `margins`: distances to events, drawn at the end by `design_margins`.

    **Returns:** the Axes, an array.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = design_dataset(ds)
    draws: list[Any] = [_draw_cases, _draw_trials, _draw_progress, _draw_slopes]
    checks = [(_draw_map, surroundings), (_draw_margins, margins)]
    draws += [partial(draw, dataset) for draw, dataset in checks if dataset is not None]
    with styled():
        if axes is None:
            rows = {4: "AB;CD", 5: "AB;CD;EE", 6: "AB;CD;EF"}[len(draws)]
            figure, panels = plt.subplot_mosaic(rows, figsize=(7.2, 2.9 * (len(rows) // 3 + 1)), layout="constrained")
            figure.suptitle(_title(ds), fontsize=7)
            axes = np.array([panels[label] for label in sorted(panels)])
        # legends come last: their columns follow from widths that each panel changes
        every = np.ravel(check_axes(axes, len(draws)))
        legends_above([(ax, draw(ds, ax)) for ax, draw in zip(every, draws, strict=True)])
    return axes


def design_dataset(ds: Any) -> xr.Dataset:
    """Gives the dataset of a design, or of a result that has one."""
    return check_dataset(ds, "optimise_design", "trial_design", "objective", "design")


def _panel(draw: Callable[[xr.Dataset, Any], list[Any]], ds: Any, ax: Any) -> Any:
    """Draws one panel, with a legend of the entries that `draw` returns, in Axes that are given or new."""
    ds = design_dataset(ds)
    with drawing(ax, None, 3.5, 2.9) as ax:
        legend_above(ax, draw(ds, ax))
    return ax


def design_cases(ds: Any, ax: Any = None) -> Any:
    """Draws the objective in each case, at the best design and at the first one that was tried, marked by regime.

    Bars are standard errors. A cross at the bottom is a case without a motion.

    **Arguments:** `ds`: a result of `optimise_design`, or its dataset; `ax`: the Axes to draw into, default those of
    a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return _panel(_draw_cases, ds, ax)


def _draw_cases(ds: xr.Dataset, ax: Any) -> list[Any]:
    x, label = _over_cases(ds)
    order, blue, q = np.argsort(x), COLORS["blue"], _objective(ds, "objective")
    first, best = _scaled(q, ds["trial_objective"].isel(trial=0)), _scaled(q, ds["objective"])
    kinds = _kinds_of(ds["trial_regime"].values[0]), _kinds_of(ds["regime"].values)
    for y, of_cases, color in zip((first, best), kinds, (COLORS["grey"], blue), strict=True):
        ax.plot(x[order], y[order], lw=0.8, color=color, zorder=2)
        _mark_kinds(ax, x, y, of_cases, color)
        mark_cases(ax, x[~np.isfinite(y)], color)
    error = np.nan_to_num(q.shown(ds["objective_stderr"].values))
    unsure = (error > 0) & np.isfinite(best)
    if unsure.any():
        ax.errorbar(x[unsure], best[unsure], error[unsure], fmt="none", lw=0.8, capsize=2, color=blue)
    words = ("best design", blue), ("first design", COLORS["grey"])
    handles = [Line2D([], [], lw=1, color=color, label=text) for text, color in words]
    if ds.sizes["case"] > 1 and np.isfinite(ds.attrs["objective"]):
        total = q.shown(ds.attrs["objective"])
        handles.append(ax.axhline(total, lw=0.7, ls=":", color=blue, zorder=1, label=ds.attrs["robust"]))
    values = np.concatenate([first, best])
    handles += _kind_entries(np.concatenate(kinds)[np.isfinite(values)], "black")
    handles += [cross(label="no motion")] * bool(np.isnan(values).any())
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=_label(q))
    fit_scale(ax, values)
    return handles


def design_trials(ds: Any, ax: Any = None) -> Any:
    """Draws the trials in the plane of the first two variables, coloured by the objective.

    Filled ones were taken, and lines join them; hollow ones were not. With one variable the objective is drawn over
    it.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return _panel(_draw_trials, ds, ax)


def _draw_trials(ds: xr.Dataset, ax: Any) -> list[Any]:
    variables = [_parameter(ds, name) for name in ds["variable"].values[:2].tolist()]
    q = _objective(ds, "smooth")
    total, label = _scaled(q, ds["trial_smooth"]), _label(q) + _reduction(ds, "\n")
    trials = [one.shown(ds["trial_design"].sel(variable=one.name).values) for one in variables]
    plane, norm, finite = len(variables) > 1, color_norm(total), np.isfinite(total)
    x, y = trials if plane else (*trials, total)
    accepted, start = ds["trial_taken"].values.astype(bool), ds["trial_start"].values
    for number in np.unique(start):
        own = start == number
        ax.plot(x[own & accepted & finite], y[own & accepted & finite], lw=0.7, color=COLORS["grey"], zorder=1)
        ax.plot(x[own][:1], y[own][:1], **FIRST_TRIAL)
    if plane:
        colors = plt.get_cmap("viridis")(norm(np.where(finite, total, float(norm.vmin or 0.0))))
        ax.add_line(cross(x[~finite], y[~finite], zorder=3))
        color_bar(ax, ScalarMappable(norm, "viridis"), label)
    else:
        colors = np.tile(to_rgba(COLORS["blue"]), (len(x), 1))
        mark_cases(ax, x[~finite])
    ax.plot(*_best_place(ds, variables), **OPTIMUM)
    handles = [Line2D([], [], label="best", **OPTIMUM), Line2D([], [], label="start", **FIRST_TRIAL)]
    handles += _scatter_trials(ds, ax, x, y, colors, "black")
    sides = (ax.set_xlim, ax.axvline), (ax.set_ylim, ax.axhline)
    for one, (set_limits, line) in zip(variables, sides, strict=False):
        low, high = (float(one.shown(ds[end].sel(variable=one.name))) for end in ("low", "high"))
        set_limits(low - 0.04 * (high - low), high + 0.04 * (high - low))
        for bound in (low, high):
            line(bound, **BOUND)
    handles.append(Line2D([], [], label="bound", **BOUND))
    ax.set(xlabel=_label(variables[0]), ylabel=_label(variables[1]) if plane else label)
    if not plane:
        fit_scale(ax, total)
    return handles


def _scatter_trials(
    ds: xr.Dataset, ax: Any, x: np.ndarray, y: np.ndarray, colors: np.ndarray, legend_color: str
) -> list[Any]:
    """Draws trials as dots, filled where accepted, triangles where they violate a constraint; gives entries."""
    finite, accepted = np.isfinite(ds["trial_smooth"].values), ds["trial_taken"].values.astype(bool)
    kept = ds["trial_violation"].values <= VIOLATED
    for filled in (True, False):
        for good, marker in ((True, "o"), (False, "v")):
            at = finite & (accepted == filled) & (kept == good)
            face = colors[at] if filled else "none"
            ax.scatter(x[at], y[at], 16, facecolors=face, edgecolors=colors[at], marker=marker, lw=0.9, zorder=3)
    entries = (
        ("taken", "o", legend_color, accepted[finite].any()),
        ("not taken", "o", "none", not accepted[finite].all()),
        ("constraint violated", "v", "none", not kept[finite].all()),
    )
    style = dict(ls="", ms=3.8, mew=0.8, mec=legend_color)
    handles = [Line2D([], [], marker=m, mfc=face, label=text, **style) for text, m, face, drawn in entries if drawn]
    return handles + [cross(label="no motion")] * bool(not finite.all())


def design_progress(ds: Any, ax: Any = None) -> Any:
    """Draws the objective of each trial, and the lowest until then without violations, over the simulated periods.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return _panel(_draw_progress, ds, ax)


def _draw_progress(ds: xr.Dataset, ax: Any) -> list[Any]:
    q, blue = _objective(ds, "smooth"), COLORS["blue"]
    x, total = ds["trial_simulated"].values, _scaled(q, ds["trial_smooth"])
    kept = (ds["trial_violation"].values <= VIOLATED) & np.isfinite(total)
    lowest = np.minimum.accumulate(np.where(kept, total, np.inf))
    begun = np.isfinite(lowest)
    handles = ax.plot(x[begun], lowest[begun], lw=1.2, color=blue, drawstyle="steps-post", label="lowest")
    handles += _scatter_trials(ds, ax, x, total, np.tile(to_rgba(blue), (len(x), 1)), blue)
    mark_cases(ax, x[~np.isfinite(total)])
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel="forcing periods simulated", ylabel=_label(q) + _reduction(ds, "\n"))
    fit_scale(ax, total)
    return handles


def design_slopes(ds: Any, ax: Any = None) -> Any:
    """Draws relative sensitivities at the best design: percent of the objective by one percent of a variable.

    Bars are standard errors.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return _panel(_draw_slopes, ds, ax)


def _draw_slopes(ds: xr.Dataset, ax: Any) -> list[Any]:
    x, label = _over_cases(ds)
    order, per = np.argsort(x), ds["design"] / ds["smooth"]
    slopes, errors = ((ds[f"gradient{s}"] * per).transpose("case", "variable").values for s in ("", "_stderr"))
    ax.axhline(0, lw=0.5, color="black")
    handles = []
    for k, name in enumerate(map(str, ds["variable"].values)):
        error = np.nan_to_num(np.abs(errors[order, k]))
        text = name.replace("_", " ") + (f" ${PARAMETERS[name].symbol}$" if name in PARAMETERS else "")
        style = dict(fmt="o-", ms=3, mew=0, lw=0.8, elinewidth=0.8, capsize=2 if error.any() else 0)
        handles.append(ax.errorbar(x[order], slopes[order, k], error, color=line_color(k), label=text, **style))
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=f"change of {_name(_objective(ds, 'smooth'))}\nby 1 % of a variable [%]")
    return handles


def design_margins(ds: Any, margins: xr.Dataset, ax: Any = None) -> Any:
    """Draws bars of how far parameters may change, either way, before the orbit of a case meets an event.

    A marker at the end of a bar is the event, with the parameter's value there; a bar without one ends where the
    search ended.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `margins`: of it, by `event_margins`.
    - `ax`: the Axes to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return _panel(partial(_draw_margins, margins), ds, ax)


def _draw_margins(margins: xr.Dataset, ds: xr.Dataset, ax: Any) -> list[Any]:
    check_dataset(margins, "event_margins", "parameter", "relative", "label")
    pairs = list(zip(margins["case"].values.tolist(), margins["parameter"].values.astype(str), strict=True))
    names, cases = (
        list(dict.fromkeys(part)) for part in (margins["parameter"].values.tolist(), [c for c, _ in pairs])
    )
    colors = {case: line_color(k) for k, case in enumerate(cases)}
    # a row for each parameter, with the cases' bars beneath each other
    place = lambda case, name: names.index(name) + 0.7 * ((cases.index(case) + 0.5) / len(cases) - 0.5)
    changes, labels = 100 * margins["relative"].values, margins["label"].values.astype(str)
    for pair, change, label, value in zip(pairs, changes, labels, margins["value"].values, strict=True):
        color, row = colors[pair[0]], place(*pair)
        ax.plot([0, change], [row] * 2, lw=3.5, alpha=0.35, color=color, solid_capstyle="butt", zorder=2)
        if label:
            ax.plot([change], [row], ls="", marker=EVENT_MARKERS[label], ms=5, mew=0.9, color=color, zorder=3)
            offset, side = (-5, "right") if change < 0 else (5, "left")
            style: dict[str, Any] = dict(textcoords="offset points", va="center", ha=side, fontsize=6)
            ax.annotate(f"{_parameter(ds, pair[1]).shown(value):.4g}", (change, row), (offset, 0), **style)
    ax.axvline(0, lw=0.5, color="black", zorder=1)
    parameters = [_parameter(ds, name) for name in names]
    ax.set_yticks(range(len(names)), [with_unit(_name(q), q.display_unit, brackets=True) for q in parameters])
    farthest = 1.35 * max(float(np.nanmax(np.abs(changes), initial=0.0)), 1e-9)
    ax.set(xlabel="change of the parameter [%]", xlim=(-farthest, farthest), ylim=(len(names) - 0.5, -0.5))
    over = [(_parameter(ds, name), ds[name].values) for name in varied_names(ds)]
    of_case = lambda case: ", ".join(_stated(q, values[case]) for q, values in over) or "the case"
    handles = [Line2D([], [], lw=3.5, alpha=0.35, color=c, label=of_case(case)) for case, c in colors.items()]
    dark: dict[str, Any] = dict(ls="", ms=5, mew=0.9, color="black")
    present = [label for label in EVENT_MARKERS if label in labels]
    if not np.all(labels):
        handles.append(Line2D([], [], lw=3.5, alpha=0.35, color="black", label="no marker: no event up to there"))
    return handles + [Line2D([], [], marker=EVENT_MARKERS[m], label=f"{m} {EVENT_NAMES[m]}", **dark) for m in present]


def design_map(ds: Any, surroundings: xr.Dataset, ax: Any = None) -> Any:
    """Draws a grid around the best design: the objective as colours, hatched where not all cases have period 1.

    With one variable the objective is drawn over it. The grid's lowest value is marked, too.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `surroundings`: over one variable or several by name, and over cases: what was minimised, by its name such as
        soft_peak_force, or else the objective itself, and if available `period`, 0 for irregular motions. Of more
        than two variables the further ones are taken as near the best design as the grid has them.
    - `ax`: the Axes to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return _panel(partial(_draw_map, surroundings), ds, ax)


def _draw_map(surroundings: xr.Dataset, ds: xr.Dataset, ax: Any) -> list[Any]:
    objective, names, grid = _grid(ds, surroundings)
    values = grid[str(ds[objective].attrs["quantity"])]
    cases = [d for d in values.dims if d not in names]
    total = values.max(cases, skipna=False) if ds.attrs["robust"] == "worst" else values.mean(cases, skipna=False)
    variables, q = [_parameter(ds, name) for name in names], _objective(ds, objective)
    total, label = _scaled(q, total.transpose(*names)), _label(q) + _reduction(ds, "\n")
    kinds, finite = _least_regular(grid, values, names), np.isfinite(total)
    axes = [one.shown(grid[one.name].values) for one in variables]
    least = np.unravel_index(np.argmin(np.where(finite, total, np.inf)), total.shape)
    lowest = [values[k] for values, k in zip(axes, least, strict=True)]
    if len(names) == 1:
        blue = COLORS["blue"]
        ax.plot(axes[0], total, lw=0.8, color=COLORS["grey"], zorder=1)
        _mark_kinds(ax, axes[0], total, kinds, blue)
        mark_cases(ax, axes[0][~finite])
        fit_scale(ax, total)
        lowest.append(total[least])
        entries = _kind_entries(kinds, blue) + [cross(label="no motion")] * bool(not finite.all())
    else:
        colors = plt.get_cmap("viridis").with_extremes(bad=FLAGGED_COLOR)
        masked = np.ma.masked_invalid(total.T)
        mesh = ax.pcolormesh(*axes, masked, cmap=colors, norm=color_norm(total), shading="nearest")
        entries = []
        for kind, (hatch, text) in REGIME_HATCHES.items():
            if np.any(kinds == kind):
                cells = np.ma.masked_where(kinds != kind, np.zeros(kinds.shape)).T
                style: dict[str, Any] = dict(facecolors="none", edgecolors="white", linewidths=0, zorder=2)
                ax.pcolor(*axes, cells, shading="nearest", hatch=hatch, **style)
                entries.append(Patch(hatch=hatch, label=text, facecolor=COLORS["grey"], edgecolor="white", lw=0))
        color_bar(ax, mesh, label)
        ax.grid(False)
    of_cases = [*_kinds_of(ds["regime"].values)]  # the hatch is that of the least regular one
    words = ",\n".join(f"{of_cases.count(kind)} × {kind}" for kind in dict.fromkeys(sorted(of_cases)))
    handles = [Line2D([], [], label=f"best design:\n{words}", **OPTIMUM)]
    if finite.any():
        ax.plot(*lowest, **GRID_MINIMUM)
        handles.append(Line2D([], [], label=f"lowest of the grid, {np.min(total[finite]):.4g}", **GRID_MINIMUM))
    ax.plot(*_best_place(ds, variables, objective), **OPTIMUM)
    ax.set(xlabel=_label(variables[0]), ylabel=_label(variables[1]) if len(names) > 1 else label)
    return handles + entries


def _grid(ds: xr.Dataset, surroundings: Any) -> tuple[str, list[str], xr.Dataset]:
    """Gives the drawn objective, "smooth" or "objective", one or two variables, and the grid at the best others."""
    quantities = {name: str(ds[name].attrs["quantity"]) for name in ("smooth", "objective")}
    is_dataset = isinstance(surroundings, xr.Dataset)
    objective = next((name for name, of in quantities.items() if is_dataset and of in surroundings), None)
    if objective is None:
        words = " or ".join(f"`{name}`" for name in dict.fromkeys(quantities.values()))
        raise ValueError(f"Argument `surroundings` must be a dataset with {words} over variables and cases.")
    dims, variables = surroundings[quantities[objective]].dims, [str(name) for name in ds["variable"].values]
    names = [name for name in variables if name in dims]
    if not names:
        over = ", ".join(map(str, dims)) or "nothing"
        raise ValueError(f"Argument `surroundings` must be over some of {', '.join(variables)}, but is over {over}.")
    further = {name: float(ds["design"].sel(variable=name)) for name in names[2:]}
    return objective, names[:2], surroundings.sel(further, method="nearest") if further else surroundings


def _least_regular(grid: xr.Dataset, values: xr.DataArray, names: list[str]) -> np.ndarray:
    """Gives the least regular kind of motion among the cases of each design."""
    order = np.array(["period 1", *REGIME_HATCHES])
    period = grid["period"].transpose(*values.dims).values if "period" in grid else np.ones(values.shape)
    rank = np.where(period == 1, 0, np.where(period > 1, 1, 2))
    ranks = values.copy(data=np.where(np.isfinite(values), rank, 3))
    return order[ranks.max([d for d in values.dims if d not in names]).transpose(*names).values.astype(int)]


def _kinds_of(regimes: Any) -> np.ndarray:
    """Gives regimes in words, all periods above 1 as one, and all motions without a period."""
    words = np.asarray(regimes).astype(str)
    words = np.where(np.isin(words, KINDS[1:]), "irregular", words)
    return np.where(np.char.startswith(words, "period ") & (words != "period 1"), "period n", words)


def _mark_kinds(ax: Any, x: np.ndarray, y: np.ndarray, kinds: np.ndarray, color: str) -> None:
    """Draws markers by kind of motion."""
    for kind, marker in REGIME_MARKERS.items():
        at = (kinds == kind) & np.isfinite(y)
        ax.plot(x[at], y[at], ls="", marker=marker, ms=4.5, mew=0.5, mec="white", color=color, zorder=4)


def _kind_entries(kinds: Iterable[str], color: str) -> list[Line2D]:
    """Gives entries of a legend for markers by kind of motion."""
    present, style = set(kinds), dict(ls="", ms=4, mew=0, color=color)
    return [Line2D([], [], marker=m, label=kind, **style) for kind, m in REGIME_MARKERS.items() if kind in present]


def _over_cases(ds: xr.Dataset) -> tuple[np.ndarray, str]:
    """Gives the parameter that differs between the cases, and its label; their numbers for none or several."""
    names = varied_names(ds)
    if len(names) == 1:
        return shown(ds, names[0]), axis_label(names[0], ds)
    return np.arange(1, ds.sizes["case"] + 1), "case" if not names else f"case, over {' and '.join(names)}"


def _objective(ds: xr.Dataset, name: str) -> Quantity:
    """Gives the quantity of a variable of objectives, from its attributes."""
    attrs = ds[name].attrs
    unit, symbol = attrs.get("units", "1"), attrs.get("symbol", "")
    return Quantity(attrs["quantity"], unit, "", symbol, 1.0, attrs["shown_unit"])


def _parameter(ds: xr.Dataset, name: str) -> Quantity:
    """Gives the quantity of a parameter that was chosen or varied; that of a path has its unit from the dataset."""
    if name in PARAMETERS:
        return quantity(name)
    unit = ds[name].attrs.get("units", "1") if name in ds else ds["variable_unit"].sel(variable=name).item()
    return Quantity(name, str(unit), name)


def _scaled(q: Quantity, array: Any) -> np.ndarray:
    """Gives values [SI unit] in their display unit; NaN in place of infinities."""
    values = np.asarray(q.shown(np.asarray(array, float)))
    return np.where(np.isfinite(values), values, np.nan)


def _name(q: Quantity) -> str:
    return q.name.replace("_", " ")


def _label(q: Quantity) -> str:
    """Gives an axis label: name, symbol and display unit."""
    return with_unit(_name(q) + (f" ${q.symbol}$" if q.symbol else ""), q.display_unit, brackets=True)


def _stated(q: Quantity, value: float) -> str:
    """Gives a quantity in words, with its value [SI unit] in the display unit."""
    return with_unit(f"{_name(q)} {q.shown(value):.5g}", q.display_unit)


def _reduction(ds: xr.Dataset, before: str) -> str:
    """Gives how several cases become one number, after a text; nothing for one case."""
    return f"{before}{ds.attrs['robust']} of {ds.sizes['case']} cases" if ds.sizes["case"] > 1 else ""


def _best_place(ds: xr.Dataset, variables: list[Quantity], objective: str = "smooth") -> list[float]:
    """Gives the coordinates of the best design [display units]: two variables, or one and the objective."""
    place = [float(one.shown(ds["design"].sel(variable=one.name))) for one in variables]
    return place if len(place) > 1 else [*place, _objective(ds, objective).shown(ds.attrs[objective])]


def _title(ds: xr.Dataset) -> str:
    """Gives the fixed parameters, and the best design."""
    pairs = zip(ds["variable"].values.tolist(), ds["design"].values, strict=True)
    design = ", ".join(_stated(_parameter(ds, name), value) for name, value in pairs)
    best = f"{ds.attrs['status']}: {design}; {_stated(_objective(ds, 'objective'), ds.attrs['objective'])}"
    return f"{case_title(ds, full=True)}\n{best}{_reduction(ds, ', ')}".strip()
