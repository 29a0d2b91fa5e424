"""Pictures of what motions settle to over two parameters."""

from contextlib import nullcontext
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from ..analysis import KINDS
from .style import FLAGGED_LABEL, axis_label, check_dataset, flagged, legend_above, new_axes, shown, styled, swept
from .titles import name_case

SOURCE = "lyapunov_sweep, or of a sweep with `kind` and `period` of its attractors"
"""What makes the datasets drawn here, for errors."""
ATTRACTOR_COLORS = {
    "period 1": "#d6e6f4",
    "period 2": "#8fc1de",
    "period 3": "#b9dfb0",
    "period 4": "#4a94c5",
    "other periods": "#71b77a",
    "quasi-periodic": "#f6dd8c",
    "chaotic": "#e8a090",
    "unresolved": "#e4e4e4",
    FLAGGED_LABEL: "#ffffff",
}
"""Colours of motions by name: light, so that curves are seen above them."""
OTHER_COLOR = "#ffffff"
"""Colour of cases with another kind, which is then its name."""
_NAMED = 4
"""Longest period with a colour of its own."""


def attractor_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """What motions settle to over two parameters: periods 1 to 4, others, quasi-periodic, chaotic or unresolved.

    **Arguments:** `ds`: over two parameters, the first drawn upwards, with the variables `kind` and `period` as
    `slipperjax.analysis.Attractors` has them; `ax`: the Axes to draw into, default those of a new figure, with the
    fixed parameters as its title. Cases of another kind than `slipperjax.analysis.KINDS` are white.

    **Returns:** the Axes, with a legend of what occurs.

    **Raises:** `ValueError` where `ds` is not swept over two parameters.
    """
    check_dataset(ds, SOURCE, "kind", "period")
    over_y, over_x = swept(ds["kind"], count=2)
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 3.3)
        name_case(ax.figure, ds, full=True)
    with styled() if own else nullcontext():
        found = motion_names(ds, over_y, over_x)
        others = sorted(set(found.ravel()) - set(ATTRACTOR_COLORS))
        colors = ATTRACTOR_COLORS | dict.fromkeys(others, OTHER_COLOR)
        names, cmap = list(colors), ListedColormap(list(colors.values()))
        norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
        numbers = np.array([names.index(name) for name in found.ravel()]).reshape(found.shape)
        ax.pcolormesh(shown(ds, over_x), shown(ds, over_y), numbers, cmap=cmap, norm=norm, rasterized=True)
        there = [name for name in names if np.any(found == name)]
        outlined = {"edgecolor": "#a0a0a0", "linewidth": 0.4}
        legend_above(ax, [Patch(facecolor=colors[n], label=n, **outlined) for n in there])
        ax.grid(False)
        ax.set(xlabel=axis_label(over_x, ds), ylabel=axis_label(over_y, ds))
    return ax


def motion_names(ds: xr.Dataset, *dims: str) -> np.ndarray:
    """The name in `ATTRACTOR_COLORS` of each case, shape as `dims`."""
    kind, period = (ds[name].transpose(*dims).values for name in ("kind", "period"))
    named = np.where(period <= _NAMED, np.char.add("period ", period.astype(int).astype(str)), "other periods")
    words = dict(zip(KINDS, ("", "quasi-periodic", "chaotic", "unresolved"), strict=True))
    found = named.astype(object)
    for name in set(kind.ravel()) - {KINDS[0]}:
        found[kind == name] = words.get(name, name)
    found[flagged(ds, *dims)] = FLAGGED_LABEL
    return found
