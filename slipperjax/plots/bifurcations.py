"""Bifurcation diagrams: Poincare sections over a parameter."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from ..model.quantities import SECTIONS
from .style import (
    COLORS,
    FLAGGED_LABEL,
    axis_label,
    check_dataset,
    cross,
    drawing,
    flagged,
    legend_above,
    mark_cases,
    name_case,
    shown,
    styled,
    swept,
)

DIRECTION_COLORS = {"up": COLORS["orange"], "down": COLORS["green"]}
"""Colours of the motions that are followed with the parameter raised and lowered."""


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
        if _draw_dots(ds, section, ax, style):
            _show_legend(ax, True)
    return ax


def bifurcations(ds: xr.Dataset, axes: Any = None, followed: xr.Dataset | None = None) -> Any:
    """Draws all five bifurcation diagrams above each other, at column width, as in Figs. 5, 8 and 10 of the paper.

    **Arguments:**

    - `ds`: as for `bifurcation`.
    - `axes`: five Axes; default those of a new figure, with the fixed parameters as its title.
    - `followed`: from `follow`, drawn beneath: the motions that are met when the parameter is raised and lowered. Its
        crosses are coloured as its dots.

    **Returns:** the Axes, an array.
    """
    check_dataset(ds, "sweep or follow", *SECTIONS)
    with styled():
        if axes is None:
            figure, axes = plt.subplots(5, 1, figsize=(3.5, 7.9), sharex=True, layout="constrained")
            name_case(figure, ds, full=True)
        lost = False
        for tag, section, ax in zip("abcde", SECTIONS, axes, strict=True):
            size = _dot_size(ds[section])
            for k, (way, color) in enumerate(DIRECTION_COLORS.items(), 1):
                if followed is not None and way in followed["direction"]:
                    style = {"ms": 1.1 * size, "color": color, "label": f"followed {way}"}
                    lost |= _draw_dots(followed.sel(direction=way), section, ax, style, color, 0.04 + 0.06 * k)
            share = 1.0 if followed is None else 0.7  # the dots beneath stay visible
            lost |= _draw_dots(ds, section, ax, {"ms": share * size, "label": "from one start"})
            ax.text(0.012, 0.94, f"({tag})", transform=ax.transAxes, va="top", fontsize=8)
            if ax is not axes[-1]:
                ax.set_xlabel("")
        if followed is not None or lost:
            _show_legend(axes[0], lost)
    return axes


def _draw_dots(
    ds: xr.Dataset, section: str, ax: Any, style: dict[str, Any], color: str = COLORS["grey"], height: float = 0.04
) -> bool:
    """Draws the dots of one section, and crosses of a colour and height for cases that are left out.

    **Returns:** whether there are such cases.
    """
    (over,) = swept(ds[section], "crossing")
    values, bad, at = ds[section].transpose(over, "crossing").values, flagged(ds, over), shown(ds, over)
    case, crossing = np.nonzero(np.isfinite(values) & ~bad[:, None])
    style = {"ms": _dot_size(ds[section]), "mew": 0, "color": COLORS["blue"], "rasterized": True} | style
    ax.plot(at[case], values[case, crossing], ".", **style)
    mark_cases(ax, at[bad], color, height)
    ax.set(xlabel=axis_label(over, ds), ylabel=axis_label(section))
    # margins hold the dots of the first and the last case
    ax.margins(x=max(0.5 / max(len(at) - 1, 1), 0.015) if len(at) > 10 else 0.05)
    ax.update_datalim(np.stack([at, at], axis=1), updatey=False)
    ax.autoscale_view()
    return bool(bad.any())


def _dot_size(array: xr.DataArray) -> float:
    """Gives the marker size [points] of dots that can be seen, and hardly overlap where cases are few."""
    return float(np.clip(700 / array[swept(array, "crossing")[0]].size, 3.4, 5.0))


def _show_legend(ax: Any, lost: bool) -> None:
    """Draws a legend of the dots, and of the crosses where cases are left out."""
    legend_above(ax, ax.get_legend_handles_labels()[0] + [cross(label=FLAGGED_LABEL)] * lost)
    for handle in ax.get_legend().legend_handles:
        handle.set_markersize(5 if handle.get_marker() == "." else 4)
