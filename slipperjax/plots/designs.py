"""Designs: objective in each case, trials, progress, sensitivities, margins to events, and the objective nearby."""

from collections.abc import Callable
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap

from ..flow.datasets import varied_names
from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from .branches import EVENT_MARKERS, EVENT_NAMES
from .style import (
    COLORS,
    case_title,
    check_dataset,
    color_bar,
    color_norm,
    drawing,
    entitle,
    fit_scale,
    in_display_unit,
    label,
    legend_above,
    line_color,
    mark_cases,
    name_and_symbol,
    quantity_of,
    rows_of,
    shown,
    typeset,
    with_unit,
)

OPTIMUM: dict[str, object] = dict(
    ls="", marker="*", ms=9, mfc="#ffd23f", mec="black", mew=0.6, zorder=6, label="best"
)
"""Marker of the best design."""


def design_overview(ds: object) -> np.ndarray:
    """Draw a design on one page: objective by case, trials, progress of the search, sensitivities, and checks.

    The title states the fixed parameters and the best design. The panels are

    - the objective in each case, for the best design and for the first tried design, marked by kind of motion; bars
      are standard errors, and a cross at the bottom is a case without a motion;
    - the trials in the plane of the first two variables, coloured by the objective, with a line through the trials
      from each start; with one variable the objective is drawn over it;
    - the objective of each trial, and the lowest so far without violations, over the simulated periods;
    - percent of the objective for one percent of a variable, with standard errors;
    - where the design has them, the objective around the best design, as colours or over one variable as a line, and
      the distances to events of `design_margins`.

    **Arguments:** `ds`: a result of `optimise_design`, or its dataset.

    **Returns:** the Axes, an array.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = _design(ds)
    draws: list[Callable[..., object]] = [_draw_cases, _draw_trials, _draw_progress, _draw_slopes]
    if "around_total" in ds:
        draws.append(_draw_map)
    if "margin_label" in ds:
        draws.append(design_margins)
    # panels of each row
    counts = {4: (2, 2), 5: (2, 2, 1), 6: (2, 2, 2)}[len(draws)]
    with rows_of(*counts, height=2.9 * len(counts)) as axes:
        entitle(axes[0].figure, _title(ds))
        for draw, ax in zip(draws, axes, strict=True):
            draw(ds, ax=ax)
            legend_above(ax)
    return axes


def _design(ds: object) -> xr.Dataset:
    """Return the dataset of a design, or of a result that has one, with NaN where an objective is infinite."""
    ds = check_dataset(ds, "optimise_design", "trial_design", "objective", "design")
    names = ["objective", "trial_objective", "trial_smooth"]
    return ds.assign({name: ds[name].where(np.isfinite(ds[name])) for name in names})


def _draw_cases(ds: xr.Dataset, ax: Axes) -> None:
    blue = line_color(0)
    x, over = _over_cases(ds)
    order = np.argsort(x)
    best = shown(ds, "objective")
    first = shown(ds.isel(trial=0), "trial_objective")
    drawn = (
        (first.values, ds["trial_regime"].values[0], COLORS["grey"], "first design"),
        (best.values, ds["regime"].values, blue, "best design"),
    )
    for y, regimes, color, text in drawn:
        ax.plot(x[order], y[order], lw=0.8, color=color, zorder=2, label=text)
        mark_cases(ax, x[~np.isfinite(y)], "no motion", color)
        periodic = np.char.startswith(regimes.astype(str), "period ")
        # markers by kind of motion
        for kind, marker, at in (("periodic", "o", periodic), ("irregular", "D", ~periodic)):
            if np.isfinite(y[at]).any():
                ax.plot(x[at], y[at], marker, ms=4.5, mew=0.5, mec="white", color=color, zorder=4, label=kind)
    q = quantity_of("objective", ds)
    error = q.shown(ds["objective_stderr"].values)
    # orbits have no standard error
    unsure = error > 0
    if unsure.any():
        ax.errorbar(x[unsure], best[unsure], error[unsure], fmt="none", lw=0.8, capsize=2, color=blue)
    # with one case, the total equals the case
    if len(x) > 1:
        total = q.shown(ds.attrs["objective"])
        ax.axhline(total, lw=0.7, ls=":", color=blue, zorder=1, label=ds.attrs["robust"])
    ax.set(xlabel=over, ylabel=label(best))
    fit_scale(ax, np.concatenate([first, best]))


def _draw_trials(ds: xr.Dataset, ax: Axes) -> None:
    # with one variable the objective is drawn upwards
    x, y = [*_places(ds, "trial_design"), shown(ds, "trial_smooth").values][:2]
    taken = ds["trial_taken"].values.astype(bool)
    # a line through the trials from each start, and a square at the start, which frames the star of the best design
    for start in np.unique(ds["trial_start"].values):
        own = ds["trial_start"].values == start
        ax.plot(x[own & taken], y[own & taken], lw=0.7, color=COLORS["grey"], zorder=1)
        ax.plot(x[own][:1], y[own][:1], "s", ms=10, mfc="none", mec="black", mew=0.7, zorder=5, label="start")
    dots = _scatter_trials(ds, ax, x, y)
    # bounds of each variable across its axis
    for line, *ends in zip((ax.axvline, ax.axhline), _places(ds, "low"), _places(ds, "high"), strict=False):
        for bound in ends:
            line(bound, ls=":", lw=0.9, color=COLORS["red"], zorder=1, label="bound")
    _finish_plane(ds, ax, shown(ds, "trial_smooth"), dots)


def _places(ds: xr.Dataset, name: str) -> list[Any]:
    """Return a number of each design variable, for the first two, in display units."""
    return [one.shown(ds[name].sel(variable=one.name).values) for one in design_variables(ds)[:2]]


def _finish_plane(ds: xr.Dataset, ax: Axes, total: xr.DataArray, drawn: ScalarMappable | None) -> None:
    """Mark the best design, and label the axes: two variables, or one variable and the objective `total`."""
    place = _places(ds, "design")
    labels = [label(in_display_unit(one, ds["design"])) for one in design_variables(ds)]
    if len(labels) == 1:
        place.append(quantity_of("smooth", ds).shown(ds.attrs["smooth"]))
        labels.append(_smooth_label(ds))
        fit_scale(ax, total.values)
    else:
        color_bar(ax, drawn, _smooth_label(ds))
    ax.plot(*place, **OPTIMUM)
    ax.set(xlabel=labels[0], ylabel=labels[1])


def _scatter_trials(ds: xr.Dataset, ax: Axes, x: np.ndarray, y: np.ndarray) -> ScalarMappable:
    """Draw trials coloured by the minimised number, grey without a motion, as triangles if a constraint is violated.

    **Returns:** the dots, for a colour bar.
    """
    total = shown(ds, "trial_smooth").values
    style: dict[str, Any] = dict(cmap=_colors(), norm=color_norm(total), lw=0, zorder=3, plotnonfinite=True)
    kept = _kept(ds)
    dots = None
    # each kind of trial has its own marker and entry
    for text, marker, at in (("constraint violated", "v", ~kept), ("trial", "o", kept)):
        dots = ax.scatter(x[at], y[at], 16, total[at], label=text if at.any() else "", marker=marker, **style)
    return dots


def _colors() -> Colormap:
    return plt.get_cmap("viridis").with_extremes(bad=COLORS["grey"])


def _kept(ds: xr.Dataset) -> np.ndarray:
    """Return whether each trial meets the constraints, up to rounding."""
    return ds["trial_violation"].values <= 1e-6


def _draw_progress(ds: xr.Dataset, ax: Axes) -> None:
    total = shown(ds, "trial_smooth").values
    x = ds["trial_simulated"].values
    # trials that break a constraint do not count as progress
    lowest = np.fmin.accumulate(np.where(_kept(ds), total, np.nan))
    ax.plot(x, lowest, lw=1.2, color=line_color(0), drawstyle="steps-post", label="lowest")
    _scatter_trials(ds, ax, x, total)
    mark_cases(ax, x[np.isnan(total)], "no motion")
    # from the beginning of the work, because the first designs take much of it
    ax.set(xlabel="forcing periods simulated", ylabel=_smooth_label(ds), xlim=(0, 1.03 * x.max()))
    fit_scale(ax, total)


def _draw_slopes(ds: xr.Dataset, ax: Axes) -> None:
    x, over = _over_cases(ds)
    order = np.argsort(x)
    # relative: percent by percent
    per = 1 / ds["smooth"] * ds["design"]
    slopes = (ds["gradient"] * per).values[order]
    errors = (ds["gradient_stderr"] * abs(per)).fillna(0.0).values[order]
    ax.axhline(0, lw=0.5, color="black")
    # a line for each variable over the cases
    for k, one in enumerate(design_variables(ds)):
        style = dict(fmt="o-", ms=3, mew=0, lw=0.8, capsize=2, color=line_color(k))
        ax.errorbar(x[order], slopes[:, k], errors[:, k], label=name_and_symbol(one), **style)
    objective = quantity_of("smooth", ds).name.replace("_", " ")
    ax.set(xlabel=over, ylabel=f"change of {objective}\nby 1 % of a variable [%]")


def design_margins(ds: object, ax: Axes | None = None) -> Axes:
    """Draw bars for how far parameters may change, in both directions, before the orbit of a case meets an event.

    A marker at the end of a bar is the event, with the parameter's value there; a bar without an event ends where the
    search ended.

    **Arguments:**

    - `ds`: a result of `optimise_design` with its `margins`, or its dataset.
    - `ax`: the Axes to draw into, default the Axes of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = _design(ds)
    ds = check_dataset(ds, "optimise_design with margins", "margin_label")
    rows = margin_rows(ds)
    cases = list(dict.fromkeys(ds["margin_case"].values))
    parameters = {name: design_quantity(ds, name) for name in dict.fromkeys(ds["margin_parameter"].values)}
    names = list(parameters)
    with drawing(ax, None, 3.5, 2.9) as ax:
        for case, name, event, value, relative in rows:
            color = line_color(cases.index(case))
            # a row for each parameter, with the cases' bars below each other
            row = names.index(name) + 0.7 * ((cases.index(case) + 0.5) / len(cases) - 0.5)
            change = 100 * relative
            text = typeset(case_words(ds, case).replace("_", " "))
            ax.plot([0, change], [row] * 2, color=color, label=text, lw=3.5, alpha=0.35, solid_capstyle="butt")
            end = "no event"
            if event:
                text = f"{event} {EVENT_NAMES[event]}"
                ax.plot(change, row, EVENT_MARKERS[event], ms=5, color=color, zorder=3, label=text)
                end = f"{parameters[name].shown(value):.4g}"
            side = "right" if change < 0 else "left"
            ax.text(change, row, f"  {end}  ", va="center", ha=side, fontsize=6)
        ax.axvline(0, lw=0.5, color="black", zorder=1)
        ticks = [with_unit(q.words, q.display_unit, brackets=True) for q in parameters.values()]
        ax.set_yticks(range(len(names)), ticks)
        # percent, with space for the texts next to the bars
        farthest = 150 * max(float(np.nanmax(np.abs(ds["margin_relative"].values), initial=0.0)), 1e-9)
        ax.set(xlabel="change of the parameter [%]", xlim=(-farthest, farthest), ylim=(len(names) - 0.5, -0.5))
    return ax


def margin_rows(ds: xr.Dataset) -> list[tuple[int, str, str, float, float]]:
    """Return case, parameter, event, value and relative change of each margin of a design."""
    columns = [f"margin_{name}" for name in ("case", "parameter", "label", "value", "relative")]
    return list(ds[columns].to_dataframe().itertuples(index=False, name=None))


def case_words(ds: xr.Dataset, case: int) -> str:
    """Return the parameters of a case of a design as a text."""
    return ", ".join(quantity_of(name, ds).named(ds[name].values[case]) for name in varied_names(ds)) or "the case"


def _draw_map(ds: xr.Dataset, ax: Axes) -> None:
    """Draw a grid around the best design, over one variable as a line, over two as colours."""
    grid = in_display_unit(quantity_of("smooth", ds), ds["around_total"])
    first, *others = (one for one in design_variables(ds) if one.name in grid.dims)
    # with more than two variables, the others have the grid's values nearest to the best design
    nearest = {one.name: float(ds["design"].sel(variable=one.name)) for one in others[1:]}
    total = grid.where(np.isfinite(grid)).sel(nearest, method="nearest").transpose(..., first.name)
    places = [one.shown(grid[one.name].values) for one in (first, *others[:1])]
    drawn = None
    if len(places) == 1:
        ax.plot(*places, total, ".-", lw=0.8, color=line_color(0), zorder=1)
    else:
        drawn = ax.pcolormesh(*places, total, cmap=_colors(), norm=color_norm(total.values))
        ax.grid(False)
    _finish_plane(ds, ax, total, drawn)


def _over_cases(ds: xr.Dataset) -> tuple[np.ndarray, str]:
    """Return the values of the parameter that differs between cases, and its label; otherwise the cases' numbers."""
    names = varied_names(ds)
    if len(names) == 1:
        values = shown(ds, names[0])
        return values.values, label(values)
    # without such a parameter cases have numbers
    return np.arange(1, ds.sizes["case"] + 1), "case" if not names else f"case, over {' and '.join(names)}"


def _smooth_label(ds: xr.Dataset) -> str:
    """Return the label of the minimised number."""
    return label(shown(ds, "smooth")) + _reduction(ds, "\n")


def design_variables(ds: xr.Dataset) -> list[Quantity]:
    """Return the quantities of the design variables."""
    return [design_quantity(ds, name) for name in ds["variable"].values.tolist()]


def design_quantity(ds: xr.Dataset, name: str) -> Quantity:
    """Return the quantity of a design variable, or of a parameter that differs between cases."""
    if name in ds or name in PARAMETERS:
        return quantity_of(name, ds)
    return Quantity(name, str(ds["variable_unit"].sel(variable=name).item()), name)


def _reduction(ds: xr.Dataset, before: str) -> str:
    """Return a text such as "worst of 5 cases" after `before`; nothing for one case."""
    return f"{before}{ds.attrs['robust']} of {ds.sizes['case']} cases" if ds.sizes["case"] > 1 else ""


def _title(ds: xr.Dataset) -> str:
    """Return the fixed parameters, and the best design."""
    numbers = [*zip(design_variables(ds), ds["design"].values, strict=True)]
    numbers.append((quantity_of("objective", ds), ds.attrs["objective"]))
    *stated, objective = (typeset(q.named(value).replace("_", " ")) for q, value in numbers)
    best = f"{ds.attrs['status']}: {', '.join(stated)}; {objective}{_reduction(ds, ', ')}"
    return f"{case_title(ds, full=True)}\n{best}".strip()
