"""Margins of a design: how far parameters may change before an orbit meets an event."""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D

from ..flow import varied_names
from ..model import PARAMETERS
from .branches import EVENT_MARKERS, EVENT_NAMES
from .design_data import panel, variable
from .style import COLORS, check_dataset, shown, typeset

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
