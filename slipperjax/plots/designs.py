"""Designs: objective in each case, trials, progress, sensitivities, margins to events, and the objective nearby."""

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable

from ..flow.datasets import varied_names
from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from .branches import EVENT_MARKERS, EVENT_NAMES
from .style import (
    COLORS,
    axis_label,
    case_title,
    check_dataset,
    color_bar,
    color_norm,
    drawing,
    entitle,
    fit_scale,
    legend_above,
    line_color,
    mark_cases,
    name_label,
    quantity_of,
    rows_of,
    shown,
    with_unit,
)

OPTIMUM: dict[str, object] = dict(
    ls="",
    marker="*",
    ms=9,
    mfc="#ffd23f",
    mec="black",
    mew=0.6,
    zorder=6,
    label="best",
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
    return axes


def _design(ds: object) -> xr.Dataset:
    """Return the dataset of a design, or of a result that has one, with NaN where an objective is infinite."""
    ds = check_dataset(ds, "optimise_design", "trial_design", "objective", "design")
    names = ["objective", "trial_objective", "trial_smooth"]
    return ds.assign({name: ds[name].where(np.isfinite(ds[name])) for name in names})


def _draw_cases(ds: xr.Dataset, ax: Axes) -> None:
    blue = line_color(0)
    x, label = _over_cases(ds)
    order = np.argsort(x)
    q = quantity_of("objective", ds)
    best = shown(ds, "objective")
    first = shown(ds.isel(trial=0), "trial_objective")
    drawn = (
        (first, ds["trial_regime"].values[0], COLORS["grey"], "first design"),
        (best, ds["regime"].values, blue, "best design"),
    )
    for y, regimes, color, text in drawn:
        ax.plot(x[order], y[order], lw=0.8, color=color, zorder=2, label=text)
        mark_cases(ax, x[~np.isfinite(y)], "no motion", color)
        periodic = np.char.startswith(regimes.astype(str), "period ")
        # markers by kind of motion
        for kind, marker, at in (("periodic", "o", periodic), ("irregular", "D", ~periodic)):
            if np.isfinite(y[at]).any():
                ax.plot(x[at], y[at], marker, ms=4.5, mew=0.5, mec="white", color=color, zorder=4, label=kind)
    error = q.shown(ds["objective_stderr"].values)
    # orbits have no standard error
    unsure = error > 0
    if unsure.any():
        ax.errorbar(x[unsure], best[unsure], error[unsure], fmt="none", lw=0.8, capsize=2, color=blue)
    # with one case, the total equals the case
    if len(x) > 1:
        total = q.shown(ds.attrs["objective"])
        ax.axhline(total, lw=0.7, ls=":", color=blue, zorder=1, label=ds.attrs["robust"])
    ax.set(xlabel=label, ylabel=name_label(q))
    fit_scale(ax, np.concatenate([first, best]))
    legend_above(ax)


def _draw_trials(ds: xr.Dataset, ax: Axes) -> None:
    variables = _variables(ds)[:2]
    total = shown(ds, "trial_smooth")
    places = [one.shown(ds["trial_design"].sel(variable=one.name).values) for one in variables]
    # with one variable the objective is drawn upwards
    x, y = [*places, total][:2]
    taken = ds["trial_taken"].values.astype(bool)
    # a line through the trials from each start, and a square at the start, which frames the star of the best design
    for start in np.unique(ds["trial_start"].values):
        own = ds["trial_start"].values == start
        ax.plot(x[own & taken], y[own & taken], lw=0.7, color=COLORS["grey"], zorder=1)
        ax.plot(x[own][:1], y[own][:1], "s", ms=10, mfc="none", mec="black", mew=0.7, zorder=5, label="start")
    dots = _scatter_trials(ds, ax, x, y)
    # bounds of each variable across its axis
    for one, line in zip(variables, (ax.axvline, ax.axhline), strict=False):
        for end in ("low", "high"):
            bound = one.shown(ds[end].sel(variable=one.name).item())
            line(bound, ls=":", lw=0.9, color=COLORS["red"], zorder=1, label="bound")
    _finish_plane(ds, ax, variables, total, dots)


def _finish_plane(
    ds: xr.Dataset,
    ax: Axes,
    variables: list[Quantity],
    total: np.ndarray,
    drawn: ScalarMappable | None,
) -> None:
    """Mark the best design, and label the axes: two variables, or one variable and the objective."""
    place = [one.shown(ds["design"].sel(variable=one.name).item()) for one in variables]
    labels = [name_label(one) for one in variables]
    objective = _smooth_label(ds)
    if len(variables) == 1:
        place.append(quantity_of("smooth", ds).shown(ds.attrs["smooth"]))
        labels.append(objective)
        fit_scale(ax, total)
    else:
        color_bar(ax, drawn, objective)
    ax.plot(*place, **OPTIMUM)
    ax.set(xlabel=labels[0], ylabel=labels[1])
    legend_above(ax)


def _scatter_trials(ds: xr.Dataset, ax: Axes, x: np.ndarray, y: np.ndarray) -> ScalarMappable:
    """Draw trials coloured by the minimised number, grey without a motion, as triangles if a constraint is violated.

    **Returns:** the dots, for a colour bar.
    """
    total = shown(ds, "trial_smooth")
    colors = plt.get_cmap("viridis").with_extremes(bad=COLORS["grey"])
    norm = color_norm(total)
    kept = _kept(ds)
    dots = None
    # each kind of trial has its own marker and entry
    for label, marker, at in (("constraint violated", "v", ~kept), ("trial", "o", kept)):
        dots = ax.scatter(
            x[at],
            y[at],
            16,
            total[at],
            label=label if at.any() else "",
            marker=marker,
            cmap=colors,
            norm=norm,
            lw=0,
            zorder=3,
            plotnonfinite=True,
        )
    return dots


def _kept(ds: xr.Dataset) -> np.ndarray:
    """Return whether each trial meets the constraints, up to rounding."""
    return ds["trial_violation"].values <= 1e-6


def _draw_progress(ds: xr.Dataset, ax: Axes) -> None:
    total = shown(ds, "trial_smooth")
    x = ds["trial_simulated"].values
    # trials that break a constraint do not count as progress
    lowest = np.fmin.accumulate(np.where(_kept(ds), total, np.nan))
    ax.plot(x, lowest, lw=1.2, color=line_color(0), drawstyle="steps-post", label="lowest")
    _scatter_trials(ds, ax, x, total)
    mark_cases(ax, x[np.isnan(total)], "no motion")
    # from the beginning of the work, because the first designs take much of it
    ax.set(xlabel="forcing periods simulated", ylabel=_smooth_label(ds), xlim=(0, 1.03 * x.max()))
    fit_scale(ax, total)
    legend_above(ax)


def _draw_slopes(ds: xr.Dataset, ax: Axes) -> None:
    x, label = _over_cases(ds)
    order = np.argsort(x)
    # relative: percent by percent
    per = 1 / ds["smooth"] * ds["design"]
    slopes = (ds["gradient"] * per).values
    errors = (ds["gradient_stderr"] * abs(per)).fillna(0.0).values
    ax.axhline(0, lw=0.5, color="black")
    # a line for each variable over the cases
    for k, name in enumerate(map(str, ds["variable"].values)):
        text = name.replace("_", " ") + (f" ${PARAMETERS[name].symbol}$" if name in PARAMETERS else "")
        ax.errorbar(
            x[order],
            slopes[order, k],
            errors[order, k],
            fmt="o-",
            ms=3,
            mew=0,
            lw=0.8,
            capsize=2,
            color=line_color(k),
            label=text,
        )
    ax.set(xlabel=label, ylabel=f"change of {_name(quantity_of('smooth', ds))}\nby 1 % of a variable [%]")
    legend_above(ax)


def design_margins(ds: object, ax: Axes | None = None) -> Axes:
    """Draw bars for how far parameters may change, in both directions, before the orbit of a case meets an event.

    A marker at the end of a bar is the event, with the parameter's value there; a bar without a marker ends where the
    search ended.

    **Arguments:**

    - `ds`: a result of `optimise_design` with its `margins`, or its dataset.
    - `ax`: the Axes to draw into, default the Axes of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    ds = _design(ds)
    ds = check_dataset(ds, "optimise_design with margins", "margin_label")
    margins = ds[[name for name, values in ds.data_vars.items() if values.dims == ("margin",)]]
    margins = margins.rename({name: str(name).removeprefix("margin_") for name in margins.data_vars})
    cases = list(dict.fromkeys(margins["case"].values))
    parameters = {name: design_quantity(ds, name) for name in dict.fromkeys(margins["parameter"].values)}
    names = list(parameters)
    over = [(design_quantity(ds, name), ds[name].values) for name in varied_names(ds)]
    with drawing(ax, None, 3.5, 2.9) as ax:
        rows = margins[["case", "parameter", "label", "value", "relative"]].to_dataframe()
        for case, name, label, value, relative in rows.itertuples(index=False):
            color = line_color(cases.index(case))
            text = ", ".join(_stated(q, values[case]) for q, values in over) or "the case"
            # a row for each parameter, with the cases' bars below each other
            row = names.index(name) + 0.7 * ((cases.index(case) + 0.5) / len(cases) - 0.5)
            change = 100 * relative
            ax.plot([0, change], [row] * 2, color=color, label=text, lw=3.5, alpha=0.35, solid_capstyle="butt")
            # the side without an event has only a bar
            if label:
                text = f"{label} {EVENT_NAMES[label]}"
                ax.plot(change, row, EVENT_MARKERS[label], ms=5, color=color, zorder=3, label=text)
                side = "right" if change < 0 else "left"
                value = f"  {parameters[name].shown(value):.4g}  "
                ax.text(change, row, value, va="center", ha=side, fontsize=6)
        ax.axvline(0, lw=0.5, color="black", zorder=1)
        ticks = [with_unit(_name(q), q.display_unit, brackets=True) for q in parameters.values()]
        ax.set_yticks(range(len(names)), ticks)
        # percent, with space for the values next to the bars
        farthest = 135 * max(float(np.nanmax(np.abs(margins["relative"].values), initial=0.0)), 1e-9)
        ax.set(xlabel="change of the parameter [%]", xlim=(-farthest, farthest), ylim=(len(names) - 0.5, -0.5))
        legend_above(ax)
    return ax


def _draw_map(ds: xr.Dataset, ax: Axes) -> None:
    """Draw a grid around the best design, over one variable as a line, over two as colours."""
    grid = ds["around_total"]
    over = [one for one in _variables(ds) if one.name in grid.dims]
    # with more than two variables, the others have the grid's values nearest to the best design
    nearest = {one.name: float(ds["design"].sel(variable=one.name)) for one in over[2:]}
    variables = over[:2]
    values = grid.sel(nearest, method="nearest").transpose(*(one.name for one in variables))
    places = [one.shown(grid[one.name].values) for one in variables]
    total = quantity_of("smooth", ds).shown(values.where(np.isfinite(values)).values)
    drawn = None
    if len(variables) == 1:
        ax.plot(*places, total, ".-", lw=0.8, color=line_color(0), zorder=1)
    else:
        colors = plt.get_cmap("viridis").with_extremes(bad=COLORS["grey"])
        drawn = ax.pcolormesh(
            *places,
            total.T,
            cmap=colors,
            norm=color_norm(total),
        )
        ax.grid(False)
    _finish_plane(ds, ax, variables, total, drawn)


def _over_cases(ds: xr.Dataset) -> tuple[np.ndarray, str]:
    """Return the values of the parameter that differs between cases, and its label; otherwise the cases' numbers."""
    names = varied_names(ds)
    if len(names) == 1:
        return shown(ds, names[0]), axis_label(names[0], ds)
    # without such a parameter cases have numbers
    return np.arange(1, ds.sizes["case"] + 1), "case" if not names else f"case, over {' and '.join(names)}"


def _smooth_label(ds: xr.Dataset) -> str:
    """Return the label of the minimised number."""
    return name_label(quantity_of("smooth", ds)) + _reduction(ds, "\n")


def _variables(ds: xr.Dataset) -> list[Quantity]:
    """Return the quantities of the design variables."""
    return [design_quantity(ds, name) for name in ds["variable"].values.tolist()]


def design_quantity(ds: xr.Dataset, name: str) -> Quantity:
    """Return the quantity of a design variable, or of a parameter that differs between cases."""
    if name in ds or name in PARAMETERS:
        return quantity_of(name, ds)
    return Quantity(name, str(ds["variable_unit"].sel(variable=name).item()), name)


def _name(q: Quantity) -> str:
    return q.name.replace("_", " ")


def _stated(q: Quantity, value: float) -> str:
    """Return a quantity as a text, with its value [SI unit] in the display unit."""
    return with_unit(f"{_name(q)} {q.shown(value):.5g}", q.display_unit)


def _reduction(ds: xr.Dataset, before: str) -> str:
    """Return a text such as "worst of 5 cases" after `before`; nothing for one case."""
    return f"{before}{ds.attrs['robust']} of {ds.sizes['case']} cases" if ds.sizes["case"] > 1 else ""


def _title(ds: xr.Dataset) -> str:
    """Return the fixed parameters, and the best design."""
    stated = [_stated(q, value) for q, value in zip(_variables(ds), ds["design"].values, strict=True)]
    objective = _stated(quantity_of("objective", ds), ds.attrs["objective"])
    best = f"{ds.attrs['status']}: {', '.join(stated)}; {objective}{_reduction(ds, ', ')}"
    return f"{case_title(ds, full=True)}\n{best}".strip()
