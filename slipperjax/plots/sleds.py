"""Pictures of sleds: the view from above, and the load of each slipper."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from ..model.kinematics import contact_points
from ..model.scene import Scene, check_scene
from ..tools.checks import require, whole
from ..tools.types import Numbers
from .runs import RUN_SOURCE, RunView, main_peak
from .sections import RAIL_STYLE, SLIPPER_STYLE
from .style import Units, check_dataset, color_bar, drawing, label, legend_above, page, point_colors


def plan(source: Scene | xr.Dataset, ax: Axes | None = None, units: Units = None) -> Axes:
    """Draw a sled on its rails from above, to scale: its slippers with their names, and its centre of mass.

    The sled travels to the right. For a run, colours show the slippers' greatest net forces, unless these mean
    nothing. For a grid, such as of rails, they show the medians of its runs: one run of a chaotic motion is one draw.

    **Arguments:** `source`: a scene, or a dataset of `run`, whose first case has the drawn scene; `ax`: the Axes to
    draw into, default the Axes of a new figure; `units`: of forces, as for `run_overview`.

    **Returns:** the Axes, in m.
    """
    case, views = None, []
    if not isinstance(source, Scene):
        ds = check_dataset(source, RUN_SOURCE, "status", argument="source")
        grid = ds["status"].dims
        # a run without a grid is one case
        cases = (dict(zip(grid, place, strict=True)) for place in np.ndindex(ds["status"].shape))
        views = [RunView.of(ds.isel(at), units=units) for at in cases]
        case = views[0].ds.drop_vars(grid)
    scene = check_scene(views[0].scene if views else source)
    names = list(scene.slipper.names or ["slipper"])
    axis = contact_points(scene).axis[0]
    # the same for all points of each slipper
    rails = np.zeros(len(names)) if axis is None else np.asarray(axis).reshape(len(names), -1)[:, 0]
    with drawing(ax, case, 5.0, 3.6) as ax:
        colors = [SLIPPER_STYLE["facecolor"]] * len(names)
        if case is not None and (peak := main_peak(case)):
            forces = [abs(view.shown(peak)) for view in views]
            values = np.median([np.atleast_1d(of.max(set(of.dims) - {"slipper"})) for of in forces], axis=0)
            # from zero, so that the differences within a run do not look larger than they are
            by_force = ScalarMappable(Normalize(0.0, float(np.max(values[np.isfinite(values)], initial=0.0))))
            of_several = f"median of {len(views)} runs:\n" if grid else ""
            color_bar(ax, by_force, of_several + label(forces[0]))
            colors = by_force.to_rgba(values)
            unit = forces[0].attrs["units"]
            names = [f"{name}\n{value:.4g} {unit}" for name, value in zip(names, values, strict=True)]
        for name, slipper, rail, color in zip(names, scene.mounted, rails, colors, strict=True):
            x, y, _ = (0.0 if place is None else float(place) for place in slipper.place)
            across = np.asarray(slipper.section.points)[:, 0]
            low, high = across.min(), across.max()
            half = float(slipper.length) / 2
            ax.axhspan(rail + low, rail + high, **RAIL_STYLE)
            ax.plot([0, x], [0, y], lw=0.8, color=SLIPPER_STYLE["edgecolor"])
            ax.fill_between([x - half, x + half], y + low, y + high, **SLIPPER_STYLE | {"facecolor": color})
            # the name is between the rails, where there is space
            edge, space, align = (y + low, -3, "top") if y > 0 else (y + high, 3, "bottom")
            over_lines = dict(facecolor="white", edgecolor="none", alpha=0.8, pad=1)
            style = dict(textcoords="offset points", ha="center", va=align, fontsize=7, bbox=over_lines)
            ax.annotate(name, (x, edge), (0, space), **style)
        ax.plot(0, 0, "o", ms=6, mfc="white", mec="black", label="centre of mass")
        ax.set_aspect("equal", "datalim")
        ax.margins(0.2)
        ax.set(xlabel="$x$ [m], direction of travel", ylabel="$y$ [m]")
        ax.grid(False)
    return ax


def load_sharing(ds: xr.Dataset, static: Numbers | None = None, *, windows: int = 10) -> np.ndarray:
    """Draw the share of each slipper of a sled in the vertical and the lateral load and in the roll moment.

    Shares are shares of the magnitudes of the slippers' mean forces and moments, because these may have opposite
    signs.

    **Arguments:**

    - `ds`: a run of a sled with `slipper_force`, and with `slipper_roll` for the moment.
    - `static`: share of each slipper in the vertical load at rest [1], such as `Sled.static_shares`, drawn as dashed
        lines; default none.
    - `windows`: number of windows over which forces are averaged.

    **Returns:** the Axes, an array.

    **Raises:** `ValueError` for another dataset, or unless there is one share for each slipper.
    """
    view = RunView.of(check_dataset(ds, RUN_SOURCE, "slipper", "slipper_force"))
    over = whole("windows", windows, 1)
    names = [str(name) for name in view.ds["slipper"].values]
    loads = {f"{name} load": view.ds["slipper_force"].sel(direction=name) for name in ("vertical", "lateral")}
    if "slipper_roll" in view.ds:
        loads["roll moment"] = view.ds["slipper_roll"]
    need = f"have a share for each of {len(names)} slippers"
    require(static is None or np.shape(static) == (len(names),), "static", need, static)
    middles = view.places(view.ds["distance"] - view.ds.attrs["window [m]"] / 2)
    with page(len(loads), 1, 1.6 * len(loads) + 0.7, view.ds, sharex=True) as axes:
        for ax, (name, load) in zip(axes, loads.items(), strict=True):
            # lost windows have no share
            mean = np.abs(load.rolling(distance=over, center=True, min_periods=1).mean().where(load.notnull()))
            shares = (mean / mean.sum("slipper")).transpose("slipper", "distance").values
            ax.stackplot(middles, shares, labels=names, colors=point_colors(len(names)), alpha=0.6, lw=0)
            ax.set(ylabel=f"share of the\n{name}", ylim=(0, 1), xlim=view.edges("distance")[[0, -1]])
        for share in np.cumsum([] if static is None else static)[:-1]:
            axes[0].axhline(share, color="black", ls="--", lw=0.9, label="at rest")
        axes[-1].set_xlabel(label(view.shown("distance")))
        legend_above(axes[0])
    return axes
