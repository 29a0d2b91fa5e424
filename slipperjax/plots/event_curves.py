"""Curves of events, such as folds and flips, over two parameters."""

import json
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, withStroke

from ..tools.checks import require
from .branches import DASHED, EVENT_NAMES, SOLID
from .maps import attractor_map, regime_map
from .style import axis_label, check_dataset, legend_above, name_case, new_axes, shown, styled, swept

SOURCE = "continue_event"
"""What makes the datasets drawn here, for errors."""
CURVE_COLORS = {"LP": "black", "PD": "#2a9d6f", "NS": "#7b4ea3", "GR": "#e07a1f"}
"""Colours of curves by label, other than those of regime maps."""
OUTSIDE_LABEL = "others outside, too"


def event_curves(ds: Any, regimes: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Curves of folds, flips, Neimark-Sacker points and grazings over two parameters.

    A curve is solid where all other multipliers lie inside the unit circle, so that the motion changes there that is
    met in simulations, and dashed elsewhere.

    **Arguments:**

    - `ds`: one curve or several, results of `continue_event` or their datasets: along `point`, with two coordinates
        named by the attribute `varied`, the attribute `label` and the variable `outside`, the number of other
        multipliers outside the unit circle.
    - `regimes`: over the same parameters, drawn beneath; only its area is shown then. From `lyapunov_sweep`, as
        `regime_map` draws it, or as for `attractor_map`.
    - `ax`: the Axes to draw into; default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes, with the first parameter upwards, or as in the regime map.

    **Raises:** `ValueError` for another kind of dataset, or where the parameters differ.
    """
    found = _all(ds)
    over = _parameters(found[0])
    for one in found[1:]:
        if set(_parameters(one)) != set(over):
            raise ValueError(f"Argument `ds` must be curves over {_both(over)}, but one is over {_parameters(one)}.")
    if regimes is not None:
        over = _area(regimes, over)
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 3.3 if regimes is None else 3.9)
        name_case(ax.figure, found[0] if regimes is None else regimes, full=True)
    handles = []
    with styled() if own else nullcontext():
        if regimes is not None:
            draw = regime_map if "regime" in regimes else attractor_map
            draw(regimes, ax)
            handles = _handles(ax.get_legend())
            frame = ax.axis()
        for one in found:
            _draw(ax, one, over)
        if regimes is not None:
            ax.axis(frame)
        else:
            ax.set(xlabel=axis_label(over[1], found[0]), ylabel=axis_label(over[0], found[0]))
            ax.margins(0.05)
        for one in found:
            _name(ax, one, over)
        legend_above(ax, _entries(found) + handles)
    return ax


def _area(regimes: xr.Dataset, over: tuple[str, ...]) -> tuple[str, ...]:
    """The parameters of a map, the one drawn upwards first; raises `ValueError` where the curves have others."""
    name = "kind" if isinstance(regimes, xr.Dataset) and "regime" not in regimes and "kind" in regimes else "regime"
    check_dataset(regimes, "lyapunov_sweep", name)
    found = swept(regimes[name], count=2)
    if set(found) != set(over):
        raise ValueError(
            f"Argument `regimes` must be swept over {_both(over)}, as the curves are, but is over {_both(found)}."
        )
    return found


def _all(ds: Any) -> list[xr.Dataset]:
    """The datasets of one curve or several."""
    several = list(ds) if isinstance(ds, list | tuple) else [ds]
    found = [one if isinstance(one, xr.Dataset) else getattr(one, "points", one) for one in several]
    if not found:
        raise ValueError("Argument `ds` must be one curve or more, but has none.")
    for one in found:
        check_dataset(one, SOURCE, "outside")
        label = one.attrs.get("label")
        require(label in CURVE_COLORS, "ds", f"have a label of {', '.join(CURVE_COLORS)}", label)
        check_dataset(one, SOURCE, *_parameters(one))
    return found


def _parameters(ds: xr.Dataset) -> tuple[str, ...]:
    """The two parameters that vary along a curve."""
    names = ds.attrs.get("varied", ())
    names = tuple(map(str, json.loads(names) if isinstance(names, str) else names))
    if len(names) != 2:
        raise ValueError(f"Argument `ds` must be a curve over two parameters, but is over {names}.")
    return names


def _both(names: Sequence[str]) -> str:
    return " and ".join(names)


def _draw(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> None:
    """One curve, its points in their order; a part is solid where both its ends are."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    first = ds["outside"].values == 0
    solid = first[1:] & first[:-1]
    casing = [withStroke(linewidth=2.6, foreground="white"), Normal()]
    for chosen, style in ((solid, {"ls": SOLID, "lw": 1.4}), (~solid, {"ls": DASHED, "lw": 1.1})):
        parts = _parts(x, y, chosen)
        if len(parts):
            line = Line2D(*parts.T, color=CURVE_COLORS[ds.attrs["label"]], zorder=4, **style)
            line.set_path_effects(casing)
            ax.add_line(line)
    ax.update_datalim(np.stack([x, y], axis=1))
    ax.autoscale_view()


def _name(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> None:
    """Writes the event beside the middle of what is seen of a curve, of its solid part if it has one."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    (left, right), (low, high) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
    seen = (x >= left) & (x <= right) & (y >= low) & (y <= high)
    solid = seen & (ds["outside"].values == 0)
    places = np.flatnonzero(solid if solid.any() else seen)
    if not len(places):
        return
    k, period = places[len(places) // 2], int(ds.attrs.get("orbit_period", 1))
    text = ds.attrs["label"] + (f" of period {period}" if period > 1 else "")
    far = x[k] > left + 0.75 * (right - left)
    style = dict(fontsize=6.5, color=CURVE_COLORS[ds.attrs["label"]], zorder=5, ha="right" if far else "left")
    found = ax.annotate(text, (x[k], y[k]), (-4 if far else 4, 3), textcoords="offset points", **style)
    found.set_path_effects([withStroke(linewidth=1.8, foreground="white")])


def _parts(x: np.ndarray, y: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Points of the parts `chosen` (points - 1,) of a curve, with NaN between those that are apart."""
    found = []
    for k in np.flatnonzero(chosen):
        if not found or not chosen[k - 1] or k == 0:
            found += [(np.nan, np.nan), (x[k], y[k])]
        found.append((x[k + 1], y[k + 1]))
    return np.array(found[1:], float)


def _handles(legend: Any) -> list[Any]:
    """The entries of a legend, for another one."""
    if legend is None:
        return []
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        handle.set_label(text.get_text())
    return list(legend.legend_handles)


def _entries(found: Sequence[xr.Dataset]) -> list[Line2D]:
    """Entries of a legend."""
    used = {one.attrs["label"] for one in found}
    lines = [
        Line2D([], [], color=color, lw=1.4, label=f"{label} {EVENT_NAMES[label]}")
        for label, color in CURVE_COLORS.items()
        if label in used
    ]
    if any(np.any(one["outside"].values) for one in found):
        lines.append(Line2D([], [], color="black", lw=1.1, ls=DASHED, label=OUTSIDE_LABEL))
    return lines
