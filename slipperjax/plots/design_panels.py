"""Panels around a design: margins to folds, flips and grazings, and the objective nearby."""

from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..flow.load import varied_names
from ..model.quantities import PARAMETERS
from .branches import EVENT_MARKERS, EVENT_NAMES
from .design_data import (
    OPTIMUM,
    REGIME_MARKERS,
    color_bar,
    color_norm,
    fit_scale,
    in_shown,
    panel,
    per_shown,
    scaled,
    total_label,
    variable,
    variable_label,
)
from .maps import NO_COLOR
from .style import COLORS, check_dataset, cross, mark_cases, shown, typeset

MARGIN_COLORS = ("blue", "red", "green", "orange")
"""Colours of cases in their order; further ones begin anew."""


def design_margins(ds: Any, margins: xr.Dataset, ax: Any = None) -> Any:
    """Bars that say how far parameters may change, either way, before the orbit of a case meets an event.

    A marker at the end of a bar is the event, with the parameter's value there; a bar without one ends where nothing
    more was looked for.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `margins`: of it, by `event_margins`.
    - `ax`: the Axes to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return panel(partial(draw_margins, margins), ds, ax)


def draw_margins(margins: xr.Dataset, ds: xr.Dataset, ax: Any) -> list[Any]:
    """As `design_margins`, without the legend, whose entries are returned."""
    check_dataset(margins, "event_margins", "parameter", "relative", "label")
    pairs = list(zip(margins["case"].values.tolist(), margins["parameter"].values.astype(str), strict=True))
    rows = {pair: row for row, pair in enumerate(dict.fromkeys(pairs))}
    cases = list(dict.fromkeys(case for case, _ in rows))
    colors = {case: COLORS[MARGIN_COLORS[k % len(MARGIN_COLORS)]] for k, case in enumerate(cases)}
    changes, labels = 100 * margins["relative"].values, margins["label"].values.astype(str)
    far = max(float(np.nanmax(np.abs(changes), initial=0.0)), 1e-9)
    for pair, change, label, value in zip(pairs, changes, labels, margins["value"].values, strict=True):
        case, name = pair
        style: dict[str, Any] = dict(color=colors[case], solid_capstyle="butt")
        ax.plot([0, change], [rows[pair]] * 2, lw=3.5, alpha=0.35, zorder=2, **style)
        if label:
            ax.plot([change], [rows[pair]], ls="", marker=EVENT_MARKERS[label], ms=5, mew=0.9, zorder=3, **style)
            q, way = variable(ds, name), np.sign(change) or 1.0
            style = dict(xytext=(5 * way, 0), textcoords="offset points", va="center", fontsize=6)
            ax.annotate(f"{q.shown(value):.4g}", (change, rows[pair]), ha="left" if way > 0 else "right", **style)
    ax.axvline(0, lw=0.5, color="black", zorder=1)
    units = {name: variable(ds, name).display_unit for _, name in rows}
    words = {name: name.replace("_", " ") + (f" [{typeset(u)}]" if u != "1" else "") for name, u in units.items()}
    ax.set_yticks(list(rows.values()), [words[name] for _, name in rows])
    ax.set(xlabel="change of the parameter [%]", xlim=(-1.35 * far, 1.35 * far))
    ax.set_ylim(len(rows) - 0.5, -0.5)
    marked = [label for label in EVENT_MARKERS if label in labels]
    dark: dict[str, Any] = dict(ls="", ms=5, mew=0.9, color="black")
    handles = [Line2D([], [], lw=3.5, alpha=0.35, color=colors[case], label=_case(ds, case)) for case in cases]
    return handles + [Line2D([], [], marker=EVENT_MARKERS[m], label=f"{m} {EVENT_NAMES[m]}", **dark) for m in marked]


def _case(ds: xr.Dataset, case: int) -> str:
    """A case in words."""
    names = varied_names(ds) if "varied" in ds.attrs else []
    found = []
    for name in names:
        unit = PARAMETERS[name].display_unit
        value = f"{shown(ds, name)[case]:.5g}"
        found.append(f"{name.replace('_', ' ')} {value}{'' if unit == '1' else f' {typeset(unit)}'}")
    return ", ".join(found) or "the case"


REGIME_HATCHES = {"period n": "...", "irregular": "////", "lost": "xxxx"}
"""Hatches of places where a case at least moves so; none where all have period 1."""
LOWEST: dict[str, Any] = dict(ls="", marker="P", ms=6, mfc="white", mec="black", mew=0.7, zorder=5)


def design_map(ds: Any, surroundings: xr.Dataset, ax: Any = None) -> Any:
    """A grid around the best design: the objective as colours, hatched where not all cases move with period 1.

    With one variable the objective is drawn over it. The grid's lowest place is marked, too.

    **Arguments:**

    - `ds`: a result of `optimise_design`, or its dataset.
    - `surroundings`: over one variable or several by name, and over cases: what was minimised, by its name such as
        soft_peak_force, or else the objective itself, and if known `period`, 0 for irregular motions. Of more than
        two variables the further ones are taken as near the best design as the grid has them.
    - `ax`: the Axes to draw into, default those of a new figure.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    return panel(partial(draw_map, surroundings), ds, ax)


def draw_map(surroundings: xr.Dataset, ds: xr.Dataset, ax: Any) -> list[Any]:
    """As `design_map`, without the legend, whose entries are returned."""
    what, names, grid = _grid(ds, surroundings)
    values = grid[str(ds[what].attrs["quantity"])]
    of_cases = [d for d in values.dims if d not in names]
    worst = ds.attrs["robust"] == "worst"
    reduced = values.max(of_cases, skipna=False) if worst else values.mean(of_cases, skipna=False)
    total = scaled(reduced.transpose(*names), ds[what])
    kinds = _worst_kinds(grid, values, names)
    best = [float(in_shown(ds, name, ds["design"].sel(variable=name))) for name in names]
    axes = [in_shown(ds, name, grid[name].values) for name in names]
    found = np.isfinite(total)
    least = np.unravel_index(np.argmin(np.where(found, total, np.inf)), total.shape)
    if len(names) == 1:
        ax.plot(axes[0], total, lw=0.8, color=COLORS["grey"], zorder=1)
        for kind, marker in REGIME_MARKERS.items():
            at = (kinds == kind) & found
            ax.plot(axes[0][at], total[at], ls="", marker=marker, ms=4, mew=0, color=COLORS["blue"], zorder=3)
        mark_cases(ax, axes[0][~found])
        best.append(ds.attrs[what] / per_shown(ds[what]))
        lowest = axes[0][least[0]], total[least]
        fit_scale(ax, total)
        label = total_label(ds, what)
    else:
        colors = plt.get_cmap("viridis").with_extremes(bad=NO_COLOR)
        shown = np.ma.masked_invalid(total.T)
        mesh = ax.pcolormesh(*axes, shown, cmap=colors, norm=color_norm(total), shading="nearest")
        for kind, hatch in REGIME_HATCHES.items():
            if np.any(kinds == kind):
                ax.add_collection(_hatched(axes, kinds == kind, hatch))
        color_bar(ax, mesh, total_label(ds, what))
        lowest = tuple(a[k] for a, k in zip(axes, least, strict=True))
        label = variable_label(ds, names[1])
        ax.grid(False)
    handles = [Line2D([], [], label="best design", **OPTIMUM)]
    if found.any():
        ax.plot(*lowest, **LOWEST)
        handles.append(Line2D([], [], label=f"lowest of the grid, {np.min(total[found]):.4g}", **LOWEST))
    ax.plot(*best, **OPTIMUM)
    ax.set(xlabel=variable_label(ds, names[0]), ylabel=label)
    return handles + _kind_entries(kinds, found, len(names) == 1)


def _grid(ds: xr.Dataset, surroundings: Any) -> tuple[str, list[str], xr.Dataset]:
    """What is drawn, "smooth" or "objective", one or two variables of a grid, and the grid at the others' best."""
    found = {name: str(ds[name].attrs["quantity"]) for name in ("smooth", "objective")}
    what = next(
        (name for name in found if isinstance(surroundings, xr.Dataset) and found[name] in surroundings), None
    )
    if what is None:
        words = " or ".join(f"`{name}`" for name in dict.fromkeys(found.values()))
        raise ValueError(f"Argument `surroundings` must be a dataset with {words} over variables and cases.")
    dims = surroundings[found[what]].dims
    names = [str(name) for name in ds["variable"].values if name in dims]
    if not names:
        known, over = ", ".join(map(str, ds["variable"].values)), ", ".join(map(str, dims)) or "nothing"
        raise ValueError(f"Argument `surroundings` must be over some of {known}, but is over {over}.")
    rest = {name: float(ds["design"].sel(variable=name)) for name in names[2:]}
    return what, names[:2], surroundings.sel(rest, method="nearest") if rest else surroundings


def _worst_kinds(grid: xr.Dataset, values: xr.DataArray, names: list[str]) -> np.ndarray:
    """Of each design the least regular kind among its cases."""
    order = np.array(["period 1", *REGIME_HATCHES])
    period = grid["period"].transpose(*values.dims).values if "period" in grid else np.ones(values.shape)
    rank = np.where(period == 1, 0, np.where(period > 1, 1, 2))
    found = values.copy(data=np.where(np.isfinite(values), rank, 3))
    return order[found.max([d for d in values.dims if d not in names]).transpose(*names).values.astype(int)]


def _kind_entries(kinds: np.ndarray, found: np.ndarray, line: bool) -> list[Any]:
    """Entries of a legend for the kinds of motion."""
    if line:
        style = dict(ls="", ms=4, mew=0, color=COLORS["blue"])
        present = [
            Line2D([], [], marker=m, label=k, **style) for k, m in REGIME_MARKERS.items() if np.any(kinds == k)
        ]
        return present + [cross(label="no motion")] * bool(not found.all())
    style = dict(facecolor=COLORS["grey"], edgecolor="white", lw=0)
    words = {"period n": "a case of period above 1", "irregular": "a case irregular", "lost": "a case lost"}
    return [Patch(hatch=h, label=words[k], **style) for k, h in REGIME_HATCHES.items() if np.any(kinds == k)]


def _hatched(axes: list[np.ndarray], chosen: np.ndarray, hatch: str) -> PolyCollection:
    """Cells of a grid, shape as `chosen`, hatched and without colours."""
    x, y = (_edges(values) for values in axes)
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    cells = [[(x[i + a], y[j + b]) for a, b in corners] for i, j in zip(*np.nonzero(chosen), strict=True)]
    return PolyCollection(cells, facecolors="none", edgecolors="white", linewidths=0, hatch=hatch, zorder=2)


def _edges(values: np.ndarray) -> np.ndarray:
    """Edges of cells around values, as `pcolormesh` draws them."""
    if len(values) == 1:
        return values[0] + np.array([-0.5, 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
