"""Designs: the objective in each case, the trials on the way, the progress of the search, and sensitivities."""

from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D

from ..model.quantities import PARAMETERS
from .design_data import (
    OPTIMUM,
    REGIME_MARKERS,
    color_bar,
    color_norm,
    design_dataset,
    fit_scale,
    in_shown,
    kinds_of,
    label_of,
    many,
    name_of,
    over_cases,
    panel,
    per_shown,
    scaled,
    total_label,
    variable,
    variable_label,
)
from .design_panels import draw_map, draw_margins
from .style import COLORS, case_title, cross, legends_above, mark_cases, styled, typeset

VARIABLE_COLORS = ("blue", "red", "green", "orange")
"""Colours of variables in their order; further ones begin anew."""
VIOLATED = 1e-6
"""Violation from which a trial counts as breaking a constraint."""
FIRST: dict[str, Any] = dict(ls="", marker="s", ms=6.5, mfc="none", mec="black", mew=0.8, zorder=4)
_SHAPES = ((True, "o"), (False, "v"))
"""Markers of trials that keep the constraints, and of those that do not."""


def design_overview(
    ds: Any, surroundings: xr.Dataset | None = None, axes: Any = None, *, margins: xr.Dataset | None = None
) -> Any:
    """A design on one page: objective in each case, trials, progress of the search, sensitivities, and checks.

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
    with styled():
        if axes is None:
            more = [name for name, given in (("map", surroundings), ("margins", margins)) if given is not None]
            below = [[more[0], more[-1]]] if more else []
            places: Any = [["cases", "trials"], ["progress", "slopes"], *below]
            figure, found = plt.subplot_mosaic(places, figsize=(7.2, 2.9 * len(places)), layout="constrained")
            figure.suptitle(_title(ds), fontsize=7)
            axes = np.array([found[name] for row in places for name in dict.fromkeys(row)])
        draws = [_cases, _trials, _progress, _slopes]
        if surroundings is not None:
            draws.append(partial(draw_map, surroundings))
        if margins is not None:
            draws.append(partial(draw_margins, margins))
        # legends come last: their columns follow from widths that each panel changes
        legends_above([(ax, draw(ds, ax)) for ax, draw in zip(np.ravel(axes), draws, strict=True)])
    return axes


def design_cases(ds: Any, ax: Any = None) -> Any:
    """The objective in each case, at the best design and at the first one that was tried, marked by regime.

    Bars are standard errors. A cross at the bottom is a case without a motion.

    **Arguments:** `ds`: a result of `optimise_design`, or its dataset; `ax`: the Axes to draw into, default those of
    a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return panel(_cases, ds, ax)


def _cases(ds: xr.Dataset, ax: Any) -> list[Any]:
    x, label = over_cases(ds)
    order = np.argsort(x)
    before = scaled(ds["trial_objective"].isel(trial=0), ds["objective"]), kinds_of(ds["trial_regime"].values[0])
    best = scaled(ds["objective"]), kinds_of(ds["regime"].values)
    error = np.nan_to_num(ds["objective_stderr"].values / per_shown(ds["objective"]))
    for (y, kinds), color in ((before, COLORS["grey"]), (best, COLORS["blue"])):
        ax.plot(x[order], y[order], lw=0.8, color=color, zorder=2)
        for kind, marker in REGIME_MARKERS.items():
            at = (kinds == kind) & np.isfinite(y)
            ax.plot(x[at], y[at], ls="", marker=marker, ms=4.5, mew=0.5, mec="white", color=color, zorder=4)
        mark_cases(ax, x[~np.isfinite(y)], color)
    unsure = (error > 0) & np.isfinite(best[0])
    if unsure.any():
        ax.errorbar(x[unsure], best[0][unsure], error[unsure], fmt="none", lw=0.8, capsize=2, color=COLORS["blue"])
    words = (("best design", "blue"), ("first design", "grey"))
    handles = [Line2D([], [], lw=1, color=COLORS[color], label=text) for text, color in words]
    if ds.sizes["case"] > 1 and np.isfinite(ds.attrs["objective"]):
        total = ds.attrs["objective"] / per_shown(ds["objective"])
        handles.append(
            ax.axhline(total, lw=0.7, ls=":", color=COLORS["blue"], zorder=1, label=str(ds.attrs["robust"]))
        )
    present = {kind for y, kinds in (before, best) for kind in kinds[np.isfinite(y)]}
    style = dict(ls="", ms=4, color="black", mew=0)
    handles += [
        Line2D([], [], marker=m, label=kind, **style) for kind, m in REGIME_MARKERS.items() if kind in present
    ]
    every = np.concatenate([before[0], best[0]])
    handles += [cross(label="no motion")] * bool(np.isnan(every).any())
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=label_of(ds["objective"]))
    fit_scale(ax, every)
    return handles


def design_trials(ds: Any, ax: Any = None) -> Any:
    """The designs that were tried, in the plane of the first two variables, coloured by the objective.

    Filled ones were taken, and lines join them; hollow ones were not. With one variable the objective is drawn over
    it.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return panel(_trials, ds, ax)


def _trials(ds: xr.Dataset, ax: Any) -> list[Any]:
    names, total = [str(name) for name in ds["variable"].values[:2]], scaled(ds["trial_smooth"])
    tried = [in_shown(ds, name, ds["trial_design"].sel(variable=name)) for name in names]
    best = [float(in_shown(ds, name, ds["design"].sel(variable=name))) for name in names]
    plane, norm = len(names) > 1, color_norm(total)
    if not plane:
        tried.append(total)
        best.append(ds.attrs["smooth"] / per_shown(ds["smooth"]))
    x, y = tried
    taken, start, there = ds["trial_taken"].values.astype(bool), ds["trial_start"].values, np.isfinite(total)
    kept = ds["trial_violation"].values <= VIOLATED
    colors = plt.get_cmap("viridis")(norm(np.where(there, total, float(norm.vmin or 0.0))))
    colors = colors if plane else np.tile(to_rgba(COLORS["blue"]), (len(x), 1))
    for number in np.unique(start):
        of, way = start == number, (start == number) & taken & there
        ax.plot(x[way], y[way], lw=0.7, color=COLORS["grey"], zorder=1)
        ax.plot(x[of][:1], y[of][:1], **FIRST)
    for filled in (True, False):
        for good, marker in _SHAPES:
            at = there & (taken == filled) & (kept == good)
            face = colors[at] if filled else "none"
            ax.scatter(x[at], y[at], 16, facecolors=face, edgecolors=colors[at], marker=marker, lw=0.9, zorder=3)
    if plane:
        ax.add_line(cross(x[~there], y[~there], zorder=3))
    else:
        mark_cases(ax, x[~there])
    ax.plot(*best, **OPTIMUM)
    handles = [Line2D([], [], label="best", **OPTIMUM), Line2D([], [], label="start", **FIRST)]
    handles += _trial_entries(taken[there], kept[there], "black") + [cross(label="no motion")] * bool(not there.all())
    ends = [in_shown(ds, name, [ds[end].sel(variable=name) for end in ("low", "high")]) for name in names]
    for (low, high), set_limits in zip(ends, (ax.set_xlim, ax.set_ylim), strict=False):
        set_limits(low - 0.04 * (high - low), high + 0.04 * (high - low))
    ax.set(xlabel=variable_label(ds, names[0]))
    if plane:
        ax.set(ylabel=variable_label(ds, names[1]))
        color_bar(ax, ScalarMappable(norm, "viridis"), total_label(ds))
    else:
        ax.set(ylabel=total_label(ds))
        fit_scale(ax, total)
    return handles


def design_progress(ds: Any, ax: Any = None) -> Any:
    """The objective of each trial, and the lowest until then that violates no constraint, over what was simulated.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return panel(_progress, ds, ax)


def _progress(ds: xr.Dataset, ax: Any) -> list[Any]:
    x, total = ds["trial_simulated"].values, scaled(ds["trial_smooth"])
    taken, kept = ds["trial_taken"].values.astype(bool), ds["trial_violation"].values <= VIOLATED
    there, blue = np.isfinite(total), COLORS["blue"]
    lowest = np.minimum.accumulate(np.where(kept & there, total, np.inf))
    begun = np.isfinite(lowest)
    handles = ax.plot(x[begun], lowest[begun], lw=1.2, color=blue, drawstyle="steps-post", label="lowest")
    for filled in (True, False):
        for good, marker in _SHAPES:
            at = there & (taken == filled) & (kept == good)
            ax.plot(x[at], total[at], **_trial(marker, filled, blue), zorder=3)
    mark_cases(ax, x[~there])
    handles += _trial_entries(taken[there], kept[there], blue) + [cross(label="no motion")] * bool(not there.all())
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel="forcing periods simulated", ylabel=total_label(ds))
    fit_scale(ax, total)
    return handles


def design_slopes(ds: Any, ax: Any = None) -> Any:
    """Relative sensitivities of the objective at the best design: its change in percent by one percent of a variable.

    Bars are standard errors.

    **Arguments:**, **Returns:** and **Raises:** as for `design_cases`.
    """
    return panel(_slopes, ds, ax)


def _slopes(ds: xr.Dataset, ax: Any) -> list[Any]:
    x, label = over_cases(ds)
    order = np.argsort(x)
    per = ds["design"] / ds["smooth"]
    slopes, errors = ((ds[f"gradient{s}"] * per).transpose("case", "variable").values for s in ("", "_stderr"))
    ax.axhline(0, lw=0.5, color="black")
    handles = []
    for k, name in enumerate(map(str, ds["variable"].values)):
        error = np.nan_to_num(np.abs(errors[order, k]))
        style = dict(fmt="o-", ms=3, mew=0, lw=0.8, elinewidth=0.8, capsize=2 if error.any() else 0)
        color, text = COLORS[VARIABLE_COLORS[k % len(VARIABLE_COLORS)]], name.replace("_", " ")
        if name in PARAMETERS:
            text += f" ${PARAMETERS[name].symbol}$"
        handles.append(ax.errorbar(x[order], slopes[order, k], error, color=color, label=text, **style))
    ax.margins(x=0.04, y=0.1)
    ax.set(xlabel=label, ylabel=f"change of {name_of(ds['smooth'])}\nby 1 % of a variable [%]")
    return handles


def _trial(marker: str, filled: bool, color: str) -> dict[str, Any]:
    """How a trial is drawn."""
    return dict(ls="", marker=marker, ms=3.8, mew=0.8, mec=color, mfc=color if filled else "none")


def _trial_entries(taken: np.ndarray, kept: np.ndarray, color: str) -> list[Line2D]:
    """Entries of a legend for the trials that there are."""
    some = [("taken", "o", True, taken.any()), ("not taken", "o", False, not taken.all())]
    some.append(("constraint violated", "v", False, not kept.all()))
    return [Line2D([], [], label=text, **_trial(m, filled, color)) for text, m, filled, there in some if there]


def _title(ds: xr.Dataset) -> str:
    """What is fixed, and the best design."""
    found = []
    for name, value in zip(map(str, ds["variable"].values), ds["design"].values, strict=True):
        q = variable(ds, name)
        unit = "" if q.display_unit == "1" else f" {typeset(q.display_unit)}"
        found.append(f"{name.replace('_', ' ')} {q.shown(value):.4g}{unit}")
    total, unit = ds.attrs["objective"] / per_shown(ds["objective"]), ds["objective"].attrs.get("shown_unit", "1")
    number = f"{name_of(ds['objective'])} {total:.4g}{'' if unit == '1' else f' {typeset(unit)}'}"
    of = f", {many(ds)}" if ds.sizes["case"] > 1 else ""
    best = f"{ds.attrs['status']}: {', '.join(found)}; {number}{of}"
    return "\n".join(line for line in (case_title(ds, full=True), best) if line)
