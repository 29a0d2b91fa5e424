"""Pictures of runs over a length of rail: rail, forces, impacts and spectra over distance; numbers over the speed."""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..flow.datasets import load_scene
from ..model.parameters import quantity
from ..model.scene import Scene, check_scene
from ..tools.checks import require
from .branches import DASHED, joined, stable_parts
from .style import (
    COLORS,
    axis_label,
    check_dataset,
    color_bar,
    color_norm,
    drawing,
    highest,
    legend_above,
    line_color,
    name_case,
    name_status,
    set_log_ticks,
    shown,
    styled,
    with_unit,
)

RUN_SOURCE = "one run, such as sj.run(scene, length=1000.0)"
"""Kind of the datasets drawn here, for errors."""


def run_overview(ds: xr.Dataset, scene: Scene | None = None) -> np.ndarray:
    """Draw a run on one page, over the distance travelled: rail, speed and time, contact forces, impacts, spectra.

    What the dataset lacks is left out. Forces are the highest of all points in each window, with their percentiles in
    each stretch of windows, and a dot at the highest of all; impacts are those of all points at the front and at the
    rear. Spectra are root mean squares of the vertical acceleration in third octaves; those that are finer than a
    stretch resolves, or beyond half of the sampling frequency, are blank.

    **Arguments:** `ds`: of `run`, without a grid or one case of it, or a part of it along the distance; `scene`:
    whose rail is drawn, default that of the dataset.

    **Returns:** the Axes, an array.
    """
    check_dataset(ds, RUN_SOURCE, "distance", "seconds", "status")
    dims = ds["status"].dims
    require(
        not dims,
        "ds",
        "be of one run, as is ds.isel(...)",
        shown=f"over {', '.join(map(str, dims))}",
    )
    if scene is None and "scene" in ds.attrs:
        scene = load_scene(ds)
    ds = _stretches_of(ds)
    # panels by the variable that they need
    panels = {
        "seconds": _draw_speed,
        "peak_force": _draw_forces,
        "impact_rate": _draw_impacts,
        "band_a_z": _draw_bands,
    }
    draws = [draw for name, draw in panels.items() if name in ds]
    rows = len(draws) + (scene is not None)
    with styled():
        size = (7.2, 1.5 * rows + 0.5)
        figure, grid = plt.subplots(
            rows,
            1,
            figsize=size,
            sharex=True,
            squeeze=False,
            layout="constrained",
        )
        name_case(figure, ds.drop_vars(_speed_name(ds)), full=True)
        axes = grid[:, 0]
        if scene is not None:
            # many more places than pixels, so that short waves keep their height
            begin, end = edges_of(ds, "distance")[[0, -1]]
            places = np.linspace(begin, end, 1 << 16)
            draw_irregularity(axes[0], check_scene(scene), places)
        # what the dataset has, below the rail
        for ax, draw in zip(axes[rows - len(draws) :], draws, strict=True):
            draw(ax, ds)
        for ax in axes:
            ax.set_xlim(edges_of(ds, "distance")[[0, -1]])
            ax.label_outer(remove_inner_ticks=False)
        axes[-1].set_xlabel("distance [m]")
        figure.align_ylabels(axes)
        name_status(figure, int(ds["status"]))
    return axes


def edges_of(ds: xr.Dataset, along: str) -> np.ndarray:
    """Return the edges [m] of the windows (`along` is "distance") or stretches ("stretch") of a run."""
    return np.append(ds["distance"].values[0] - ds.attrs["window [m]"], ds[along].values)


def _stretches_of(ds: xr.Dataset) -> xr.Dataset:
    """Return a run with only those stretches that its windows lie in, which `ds.isel(distance=...)` does not drop."""
    if "stretch" not in ds.dims:
        return ds
    begin, end = edges_of(ds, "distance")[[0, -1]]
    # rounding must not add a stretch that is only touched
    first, last = np.searchsorted(ds["stretch"].values, [begin * (1 + 1e-12), end * (1 - 1e-12)])
    return ds.isel(stretch=slice(first, last + 1))


def _speed_name(ds: xr.Dataset) -> str:
    """Return the name of the speed along a run: another one where "speed" is the parameter that was varied."""
    return "speed_along" if "speed_along" in ds.coords else "speed"


def draw_irregularity(ax: Axes, scene: Scene, places: np.ndarray) -> None:
    """Draw the displacements of the rail [mm] at `places` [m]."""
    here = scene.track.irregularity(places + 0 * scene.wavelength)
    # both directions on one scale
    for name, color in (("lateral", "blue"), ("vertical", "red")):
        height = 1e3 * np.broadcast_to(np.asarray(getattr(here, name)), places.shape)
        ax.plot(places, height, lw=0.6, color=COLORS[color], alpha=0.8, label=name)
    ax.set_ylabel("rail [mm]")
    legend_above(ax)


def _draw_speed(ax: Axes, ds: xr.Dataset) -> None:
    edges = edges_of(ds, "distance")
    speed = ds[_speed_name(ds)].values
    # speeds are those in the middles of windows
    places = np.concatenate([edges[:1], (edges[1:] + edges[:-1]) / 2, edges[-1:]])
    ax.plot(places, np.pad(speed, 1, "edge"), lw=0.9, color=COLORS["blue"], label="speed")
    ax.set_ylabel(axis_label("speed"))
    beside = ax.twinx()
    seconds = ds["seconds"].values
    begin = seconds[0] - ds.attrs["window [m]"] / speed[0]  # zero, or later in a part of a run
    beside.plot(
        edges,
        np.append(begin, seconds),
        lw=0.9,
        color=COLORS["orange"],
        label="time",
    )
    beside.set_ylabel("time [s]")
    beside.grid(visible=False)
    ax.set_ylim(bottom=0)
    beside.set_ylim(bottom=0)
    legend_above(ax, [*ax.lines, *beside.lines])


def _draw_forces(ax: Axes, ds: xr.Dataset) -> None:
    force = quantity("peak_force")
    _draw_steps(
        ax,
        ds,
        "distance",
        highest(ds, "peak_force", "distance"),
        "each window",
        COLORS["grey"],
    )
    # steps over stretches, one line for each percentile
    for k, percent in enumerate(ds["percentile"].values):
        values = force.shown(ds["peak_force_percentile"].isel(percentile=k).values)
        _draw_steps(ax, ds, "stretch", values, f"{percent:g} % of a stretch", line_color(k))
    peak = peak_of(ds)
    high = force.shown(float(peak["peak_force"]))
    # a run without contact has no peak
    if high > 0:
        place = float(peak["peak_distance"])
        label = f"{high:.3g} {force.display_unit} at {peak['name'].item()}, {place:.5g} m"
        ax.plot(place, high, "o", ms=3.5, mew=0, color=COLORS["red"], label=label)
    ax.set_ylabel(axis_label("contact_force"))
    ax.set_ylim(bottom=0)
    legend_above(ax)


def peak_of(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset of a run at the window and the contact point of its highest contact force.

    The point's `name` is its letter, and 1 at the front or 2 at the rear; the force is NaN where none is known.
    """
    force = ds["peak_force"].transpose("distance", "end", "point")
    # NaN is lower than any force
    k, end, point = np.unravel_index(np.argmax(force.fillna(-np.inf).values), force.shape)
    at = ds.isel(distance=k, end=end, point=point)
    return at.assign(name=f"{at['point'].item()}{end + 1}", peak_distance=at.get("peak_distance", at["distance"]))


def _draw_impacts(ax: Axes, ds: xr.Dataset) -> None:
    # of all points at an end together
    for end, color in zip(ds["end"].values, ("blue", "red"), strict=True):
        rate = ds["impact_rate"].sel(end=end).sum("point", skipna=False).values
        _draw_steps(ax, ds, "stretch", rate, str(end), COLORS[color])
    ax.set_ylabel("impacts [1/s]")
    ax.set_ylim(bottom=0)
    legend_above(ax)


def _draw_bands(ax: Axes, ds: xr.Dataset) -> None:
    values = ds["band_a_z"].transpose("band", "stretch").values
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    ax.set_ylabel("third octaves\nof $A_Z$ [Hz]")
    ax.grid(visible=False)
    # windows may be too few or too long for any band
    if not len(known):
        return
    # bands beyond the resolved ones are cut off
    rows = slice(known[0], known[-1] + 1)
    bands = ds["band"].values[rows]
    half = 10 ** (1 / 20)  # from the middle of a third octave to its end
    edges = np.append(bands / half, bands[-1] * half)
    mesh = ax.pcolormesh(
        edges_of(ds, "stretch"),
        edges,
        values[rows],
        norm=color_norm(values),
        rasterized=True,
    )
    ax.set(yscale="log", ylim=edges[[0, -1]])
    set_log_ticks(ax.yaxis)
    color_bar(ax, mesh, "RMS [m/s$^{2}$]", cax=ax.inset_axes([1.015, 0, 0.015, 1]))


def _draw_steps(
    ax: Axes,
    ds: xr.Dataset,
    along: str,
    heights: np.ndarray,
    label: str,
    color: str,
) -> None:
    """Draw one value for each window or stretch as steps."""
    # windows are many, and their steps thin
    width = 0.5 if along == "distance" else 0.9
    ax.stairs(heights, edges_of(ds, along), baseline=None, lw=width, color=color, label=label)


def passing(
    runs: object,
    branch: object = None,
    brute: xr.Dataset | None = None,
    quantity: str = "peak_force",
    ax: Axes | None = None,
) -> Axes:
    """Draw how a motion passes through speeds: a dot for each window of a run, over the speed in its middle.

    Dots are coloured by the way the speed goes, up or down, and named with its rate; further runs are lighter.
    Windows at a constant speed are left out. Of several contact points the highest value is drawn.

    **Arguments:**

    - `runs`: one run of a case or several, datasets of `run` without a grid.
    - `branch`: of `continue_orbit` over the speed, or its dataset, with `quantity` at each point; drawn solid where
        orbits are stable, dashed where not.
    - `brute`: what happens at constant speeds, of `follow`, `sweep` or `run` over "speed", drawn as grey dots.
    - `quantity`: a variable with a value per window, such as rms_a_z by `record="rms_a_z"`.
    - `ax`: the Axes to draw into; default those of a new figure, with the case as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset, or one without `quantity`.
    """
    several = list(runs) if isinstance(runs, list | tuple) else [runs]
    runs = [check_dataset(one, RUN_SOURCE, quantity, argument="runs") for one in several]
    for one in runs:
        # the highest of all points is drawn
        dims = set(one[quantity].dims) - {"end", "point"}
        need = f"be runs with `{quantity}` of each window, as by sj.run(..., record={quantity!r}), each one case"
        good = dims == {"distance"} and one.sizes["distance"] > 1
        require(good, "runs", need, shown=f"over {', '.join(map(str, one[quantity].dims))}")
    if branch is not None:
        source = "continue_orbit over the speed"
        branch = check_dataset(branch, source, quantity, "speed", "stable", argument="branch")
    with drawing(ax, runs[0].drop_vars(_speed_name(runs[0])), 3.5, 2.7) as ax:
        style = dict(ls="", marker=".", ms=2.5, mew=0, rasterized=True)
        if brute is not None:
            check_dataset(
                brute,
                "follow over the speed",
                quantity,
                "speed",
                "status",
                argument="brute",
            )
            values = highest(brute, quantity, *brute["status"].dims)
            good = brute["status"].copy(data=np.where(brute["status"].values == 0, values, np.nan))
            x, y = (a.values.ravel() for a in xr.broadcast(brute["speed"], good))
            ax.plot(x, y, color="#c4c4c4", label="constant speed", **style)
        for k, one in enumerate(runs):
            speed = one[_speed_name(one)].values
            values = highest(one, quantity, "distance")
            # acceleration from speeds over distance
            rate = np.gradient(speed**2) / (2 * one.attrs["window [m]"])  # v dv/dx
            # windows at a constant speed belong to neither way
            for way, sign, color in (("up", 1, "red"), ("down", -1, "blue")):
                there = sign * rate > 1e-9 * np.max(np.abs(rate))
                if there.any():
                    label = f"{way}, {with_unit(f'{np.median(np.abs(rate[there])):.3g}', 'm/s^2')}"
                    ax.plot(
                        speed[there],
                        values[there],
                        label=label,
                        color=COLORS[color],
                        alpha=1 - 0.7 * k / len(runs),
                        **style,
                    )
        # stable parts solid, unstable ones dashed
        if branch is not None:
            x = shown(branch, "speed")
            y = shown(branch, quantity)[None]
            stable = stable_parts(branch)
            ax.plot(*joined(x, y, stable), color="black", lw=1.2, label="stable orbit")
            ax.plot(*joined(x, y, ~stable), color="black", lw=0.8, ls=DASHED, label="unstable orbit")
        ax.set(xlabel=axis_label("speed"), ylabel=axis_label(quantity, runs[0]))
        legend_above(ax)
    return ax
