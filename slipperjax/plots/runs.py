"""Pictures of runs over a length of rail: rail, forces, impacts and spectra over distance; numbers over the speed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int
from matplotlib.axes import Axes

from ..flow.datasets import scene_of
from ..flow.status import Status, is_lost
from ..model.quantities import POINT_DIMS, Quantity, ShownUnits, point_dims
from ..model.scene import Scene, check_scene
from ..tools.checks import require
from ..tools.types import Numbers
from ..tools.units import STANDARD_GRAVITY
from .branches import DASHED, datasets_of, joined, stable_parts
from .style import (
    COLORS,
    FLAGGED_LABEL,
    Units,
    by_contact,
    by_load,
    check_dataset,
    color_bar,
    color_norm,
    drawing,
    highest,
    in_display_unit,
    in_units,
    label,
    legend_above,
    line_color,
    name_status,
    page,
    quantity_of,
    set_log_ticks,
    shown,
    shown_units,
    typeset,
    with_unit,
)

RUN_SOURCE = "one run, such as sj.run(scene, length=1000.0)"
"""Kind of the datasets drawn here, for errors."""
DISTANCE = Quantity("distance", "m", "distance along the rail")
DISPLACEMENT = Quantity("rail_displacement", "m", "displacement of the rail", shown_unit="mm")


class RunView(NamedTuple):
    """One run for pictures, tables and reports: in a user's units, and without numbers that mean nothing."""

    ds: xr.Dataset
    """The run; numbers of lost windows, and of stretches with lost windows, are NaN."""
    codes: Int[np.ndarray, " windows"]
    """`Status` of each window: its own, or the status of the run where its own is `FINITE` or unknown."""
    scene: Scene | None
    units: ShownUnits

    @classmethod
    def of(cls, ds: object, scene: Scene | None = None, units: Units = None) -> "RunView":
        """Return the view of a run.

        **Arguments:** as for `run_overview`.

        **Raises:** `ValueError` for another dataset, or a wrong unit.
        """
        ds = check_dataset(ds, RUN_SOURCE, "distance", "seconds", "status")
        dims = ds["status"].dims
        require(not dims, "ds", "be of one run, as is ds.isel(...)", shown=f"over {', '.join(map(str, dims))}")
        if scene is None and "scene" in ds.attrs:
            scene = scene_of(ds)
        chosen = shown_units(ds, units)
        codes = _codes(ds)
        ds = ds.drop_vars("window_status", errors="ignore")
        # a part of a run has all stretches of the run
        if "stretch" in ds.dims:
            ds = ds.isel(stretch=np.unique(stretch_of_windows(ds)))
        # titles also have these units
        ds = in_units(_kept(ds, codes), chosen.units)
        return cls(ds, codes, scene, units_along(scene, chosen))

    @property
    def status(self) -> Status:
        """Status of the whole run."""
        return Status(int(self.ds["status"]))

    @property
    def flagged(self) -> list[tuple[float, float, Status]]:
        """Lengths of rail with their own status other than `FINITE`: both ends [m] and the status."""
        edges = edges_of(self.ds, "distance").tolist()
        first = np.flatnonzero(np.diff(self.codes, prepend=-1))
        spans = zip(first, [*first[1:], len(self.codes)], map(Status, self.codes[first]), strict=True)
        # the status of the whole run is not repeated here
        known = (Status.FINITE, self.status)
        return [(edges[begin], edges[end], status) for begin, end, status in spans if status not in known]

    def quantity(self, name: str) -> Quantity:
        """Return a quantity with its shown unit."""
        # the speed along a run has another name where the speed is varied
        if name == DISTANCE.name:
            return self.units.of(DISTANCE)
        return quantity_of(name.removesuffix("_along"), self.ds, self.units)

    def shown(self, name: str) -> xr.DataArray:
        """Return a variable or coordinate as `slipperjax.plots.style.shown`, in the user's units."""
        return in_display_unit(self.quantity(name), self.ds[name])

    def places(self, places: Numbers) -> np.ndarray:
        """Return distances [m] in their shown unit."""
        return self.quantity(DISTANCE.name).shown(np.asarray(places))

    def said(self, name: str, value: Any) -> str:
        """Return a value [SI unit] of a quantity as a text, in its shown unit; an acceleration in m/s^2 also in g."""
        q = self.quantity(name)
        text = f"{q.shown(float(value)):.4g} {q.display_unit}"
        return text + f" ({float(value) / STANDARD_GRAVITY:.3g} g)" * (q.display_unit == "m/s^2")

    def where(self, *places: float) -> str:
        """Return a place [m], or a length of rail by both its ends, as a text with two decimals, because stations
        have many digits before the point."""
        numbers = " to ".join(f"{round(place, 2):.12g}" for place in self.places(places).tolist())
        return f"{numbers} {self.quantity(DISTANCE.name).display_unit}"

    @property
    def times(self) -> np.ndarray:
        """Times at the edges of windows [s]."""
        seconds = self.ds["seconds"].values
        first = self.ds.attrs["window [m]"] / self.ds[speed_name(self.ds)].values[0]
        # From rest, the first window of a run takes 1.41 of its length over the speed in its middle. Before the first
        # window of a part of a run more time has passed.
        begins = seconds[0] < 1.5 * first or self.codes[0] == Status.TOO_SLOW
        return np.append(0.0 if begins else seconds[0] - first, seconds)

    def edges(self, along: str) -> np.ndarray:
        """Return the edges of windows ("distance") or stretches ("stretch") in the unit of distances."""
        return self.places(edges_of(self.ds, along))


def units_along(scene: Scene | None, chosen: ShownUnits) -> ShownUnits:
    """Return a user's units, and after them the unit of distances in the survey of a scene, if any."""
    surveyed = getattr(scene and scene.track, "distance_unit", "m")
    return ShownUnits((*chosen.units, surveyed))


def run_overview(ds: xr.Dataset, scene: Scene | None = None, units: Units = None) -> np.ndarray:
    """Draw a run on one page, over the distance travelled: rail, speed and time, forces, impacts, spectra.

    Panels whose variables the dataset does not have are left out, and so are numbers that mean nothing by their
    status. Forces are the greatest net forces of slippers in each window; below are the forces of the highest single
    contact point. Both have their percentiles in each stretch of windows and a dot at the highest force of all.
    Impacts are those of all points at the front and at the rear, or of each slipper of a sled. Spectra are root mean
    squares of the vertical acceleration in third octaves; bands finer than a stretch resolves, or beyond half of the
    sampling frequency, are blank.

    **Arguments:** `ds`: of `run`, without a grid or one case of it, or a part of it along the distance; `scene`:
    its rail is drawn, default the scene of the dataset; `units`: such as ("ft", "lbf"), each for the quantities of
    its kind, by default the units of the scene's file, and for distances the unit of the survey.

    **Returns:** the Axes, an array.
    """
    view = RunView.of(ds, scene, units)
    # panels by the variable that they need
    draws = {"seconds": _draw_speed, **dict.fromkeys(PEAKS, _draw_forces)}
    draws |= {"impact_rate": _draw_impacts, "band_a_z": _draw_bands}
    names = [name for name in draws if name in view.ds]
    rails = 0 if view.scene is None else 2
    ratios = [0.6] * rails + [1.0] * len(names)
    case = view.ds.drop_vars(speed_name(view.ds))
    inches = 1.5 * len(names) + 0.9 * rails + 0.5
    with page(len(ratios), 1, inches, case, height_ratios=ratios, sharex=True, squeeze=False) as grid:
        axes = grid[:, 0]
        if view.scene is not None:
            # many more places than pixels, so that short waves keep their height
            begin, end = edges_of(view.ds, "distance")[[0, -1]]
            draw_irregularity(axes[:2], check_scene(view.scene), np.linspace(begin, end, 1 << 16), view.units)
            for ax in axes[: 2 * bool(view.scene.track.rails)]:
                legend_above(ax)
        for ax, name in zip(axes[rails:], names, strict=True):
            draws[name](ax, view, name)
            legend_above(ax)
        for ax in axes:
            ax.set_xlim(view.edges("distance")[[0, -1]])
            ax.label_outer(remove_inner_ticks=False)
        axes[-1].set_xlabel(label(view.shown("distance")))
        axes[0].figure.align_ylabels(axes)
        name_status(axes[0].figure, view.status)
    return axes


def edges_of(ds: xr.Dataset, along: str) -> np.ndarray:
    """Return the edges [m] of the windows (`along` is "distance") or stretches ("stretch") of a run."""
    return np.append(ds["distance"].values[0] - ds.attrs["window [m]"], ds[along].values)


def _codes(ds: xr.Dataset) -> Int[np.ndarray, " windows"]:
    """Return the `Status` of each window of a run: its own, or the status of the run where its own is `FINITE`.

    Windows know only whether the sled is too slow there. All other problems are those of the whole run.
    """
    own = ds.get("window_status", xr.full_like(ds["distance"], Status.FINITE, int)).values
    return np.where(own == Status.FINITE, _code(ds), own)


def _code(ds: xr.Dataset) -> int:
    """Return the `Status` of a whole run; `FINITE` where it has none."""
    return int(ds.get("status", int(Status.FINITE)))


def _kept(ds: xr.Dataset, codes: Int[np.ndarray, " windows"]) -> xr.Dataset:
    """Return a run without the numbers of lost windows, by their `codes`, and of stretches with such windows."""
    # a window that is too slow is also lost with its run
    lost = is_lost(codes) | is_lost(_code(ds))
    if not lost.any():
        return ds
    good = {"distance": ~lost}
    if "stretch" in ds.dims:
        good["stretch"] = ~np.isin(np.arange(ds.sizes["stretch"]), stretch_of_windows(ds)[lost])
    for dim, mask in good.items():
        along = ds[[name for name, values in ds.data_vars.items() if dim in values.dims]]
        ds = ds.assign(along.where(xr.DataArray(mask, dims=dim)))
    return ds


def stretch_of_windows(ds: xr.Dataset) -> Int[np.ndarray, " windows"]:
    """Return the number of the stretch that contains each window of a run."""
    middles = ds["distance"].values - ds.attrs["window [m]"] / 2
    return np.searchsorted(ds["stretch"].values, middles)


def speed_name(ds: xr.Dataset) -> str:
    """Return the name of the speed along a run: another name where "speed" is the varied parameter."""
    return "speed_along" if "speed_along" in ds.coords else "speed"


def draw_irregularity(axes: np.ndarray, scene: Scene, places: np.ndarray, units: ShownUnits) -> None:
    """Draw the displacements of the rail, or of both rails, at `places` [m] in two panels: lateral and vertical, on
    one scale."""
    along, height = units.of(DISTANCE), units.of(DISPLACEMENT)
    # on one scale, so that heights can be compared
    axes[1].sharey(axes[0])
    rails = scene.track.rails or {"": scene.track}
    displacements = {side: rail.irregularity(places + 0 * scene.wavelength) for side, rail in rails.items()}
    for ax, name, colors in zip(axes, ("lateral", "vertical"), ((0, 2), (1, 3)), strict=True):
        for (side, here), color in zip(displacements.items(), colors, strict=False):
            values = height.shown(np.broadcast_to(np.asarray(getattr(here, name)), places.shape))
            ax.plot(along.shown(places), values, lw=0.5, color=line_color(color), label=f"{side} {name}".strip())
        ax.set_ylabel(f"{name}\n[{typeset(height.display_unit)}]")


def _draw_speed(ax: Axes, view: RunView, name: str) -> None:
    """Draw speed and time."""
    edges = view.edges("distance")
    speed = view.shown(speed_name(view.ds))
    # speeds are those in the middles of windows
    places = np.concatenate([edges[:1], (edges[1:] + edges[:-1]) / 2, edges[-1:]])
    ax.plot(places, np.pad(speed, 1, "edge"), lw=0.9, color=line_color(0), label="speed")
    ax.set_ylabel(label(speed))
    beside = ax.twinx()
    beside.plot(edges, view.times, lw=0.9, color=line_color(3))
    ax.plot([], [], lw=0.9, color=line_color(3), label="time")
    beside.set_ylabel("time [s]")
    beside.grid(visible=False)
    ax.set_ylim(bottom=0)
    beside.set_ylim(bottom=0)


def _draw_forces(ax: Axes, view: RunView, name: str) -> None:
    """Draw the highest of some of `PEAKS` in each window, and its percentiles in each stretch."""
    ds = view.ds
    force = view.quantity(name)
    at = view.quantity("distance")
    length = lambda metres: f"{at.shown(metres):.3g} {at.display_unit}"
    per_window = f"peak per {length(ds.attrs['window [m]'])}"
    _draw_steps(ax, view, "distance", highest(ds, name, "distance", units=view.units), per_window, COLORS["grey"])
    per_stretch = f"per {length(np.diff(edges_of(ds, 'stretch')).max())}"
    # steps over stretches, one line for each percentile
    for k, percent in enumerate(ds["percentile"].values):
        values = force.shown(ds[f"{name}_percentile"].isel(percentile=k))
        _draw_steps(ax, view, "stretch", values, f"{percent:g}th percentile {per_stretch}", line_color(k))
    words = PEAKS[name]
    peak = peak_of(ds, name)
    # a run without contact has no peak
    if abs(peak[name]) > 0:
        place = peak[words.place].item()
        text = f"{view.said(name, peak[name])}: {peak[words.dim].item()}, {view.where(place)}"
        high = abs(force.shown(peak[name]))
        ax.plot(view.places([place]), [high], "o", ms=3.5, mew=0, color=line_color(1), label=text)
    ax.set_ylabel(with_unit(words.label, force.display_unit, brackets=True))
    ax.set_ylim(bottom=0)
    # lengths of rail that have their own status
    for *ends, _ in view.flagged:
        ax.axvspan(*view.places(ends), color=COLORS["red"], alpha=0.15, lw=0, label=FLAGGED_LABEL)


class PeakWords(NamedTuple):
    """Places, lists and names of a kind of highest forces."""

    place: str
    """Variable with their places [m]."""
    dim: str
    """Dimension of the forces in `listed`."""
    listed: Callable[[xr.Dataset], xr.Dataset]
    column: str
    """Column of tables with the load or point of the force."""
    label: str
    """Label of axes."""


PEAKS = {
    "peak_slipper_force": PeakWords(
        "peak_slipper_distance", "load", by_load, "slipper_load", "net force\nof a slipper"
    ),
    "peak_force": PeakWords("peak_distance", "contact", by_contact, "point", "highest single\ncontact point"),
}
"""Highest forces of runs: first net forces of slippers, then forces of single contact points."""


def main_peak(ds: xr.Dataset) -> str | None:
    """Return the name of the first of `PEAKS` that a run has; None where it has none."""
    return next((name for name in PEAKS if name in ds), None)


def peak_of(ds: xr.Dataset, name: str = "peak_force") -> xr.Dataset:
    """Return `highest_forces` at the window with the highest force."""
    return _at_highest(highest_forces(ds, name), name, "distance")


def highest_forces(ds: xr.Dataset, name: str = "peak_force") -> xr.Dataset:
    """Return the force of greatest magnitude in each window of a run, and its place, at its contact point or slipper.

    The coordinates are those of `by_contact`, or of `by_load`; the force is NaN where no force is known.

    **Arguments:** `name`: one of `PEAKS`.
    """
    words = PEAKS[name]
    places = ds.get(words.place, ds["distance"])
    return _at_highest(words.listed(ds[[name]].assign({words.place: places})), name, words.dim)


def _at_highest(ds: xr.Dataset, name: str, dim: str) -> xr.Dataset:
    # NaN is lower than any force
    return ds.isel({dim: abs(ds[name]).fillna(-np.inf).argmax(dim).compute()})


def _draw_impacts(ax: Axes, view: RunView, name: str) -> None:
    # of all points at one end together, or of a sled's slipper
    along, *others = point_dims(view.ds[name])
    rates = view.ds[name].sum(others, skipna=False)
    for k, of in enumerate(rates[along].values):
        _draw_steps(ax, view, "stretch", rates.isel({along: k}), str(of), line_color(k))
    ax.set_ylabel("impacts [1/s]")
    ax.set_ylim(bottom=0)


def _draw_bands(ax: Axes, view: RunView, name: str) -> None:
    q = view.quantity("a_z")
    # windows may be too few or too long for any band; bands beyond the resolved bands are cut off
    values = q.shown(view.ds[name].transpose("band", "stretch"))
    known = np.flatnonzero(np.isfinite(values).any("stretch"))
    ax.set_ylabel("third octaves\nof $A_Z$ [Hz]")
    ax.grid(visible=False)
    if len(known):
        values = values[known[0] : known[-1] + 1]
        # the edges of third octaves, from their middles
        half = 10 ** (1 / 20)
        middles = values["band"].values
        edges = np.append(middles / half, middles[-1] * half)
        mesh = ax.pcolormesh(view.edges("stretch"), edges, values, norm=color_norm(values), rasterized=True)
        ax.set(yscale="log", ylim=edges[[0, -1]])
        set_log_ticks(ax.yaxis)
        text = with_unit("RMS", q.display_unit, brackets=True)
        color_bar(ax, mesh, text, cax=ax.inset_axes([1.015, 0, 0.015, 1]))


def _draw_steps(ax: Axes, view: RunView, along: str, heights: xr.DataArray, text: str, color: str) -> None:
    """Draw one value for each window or stretch as steps."""
    # windows are many, and their steps thin
    width = 0.5 if along == "distance" else 0.9
    ax.stairs(heights, view.edges(along), baseline=None, lw=width, color=color, label=text)


def passing(
    runs: object,
    branch: object = None,
    brute: xr.Dataset | None = None,
    quantity: str = "peak_force",
    ax: Axes | None = None,
) -> Axes:
    """Draw how a motion passes through speeds: a dot for each window of a run, over the speed in the window's middle.

    Colours show whether the speed rises or falls, and names give its rate; further runs are lighter. Windows at a
    constant speed are left out. For several contact points the highest value is drawn.

    **Arguments:**

    - `runs`: one run of a case or several, datasets of `run` without a grid.
    - `branch`: of `continue_orbit` over the speed, or its dataset, with `quantity` at each point; solid where orbits
        are stable, dashed elsewhere.
    - `brute`: motions at constant speeds, of `follow`, `sweep` or `run` over "speed", drawn as grey dots.
    - `quantity`: a variable with a value per window, such as rms_a_z from `record="rms_a_z"`.
    - `ax`: the Axes to draw into; default the Axes of a new figure, with the case as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset, or one without `quantity`.
    """
    several = datasets_of(runs, RUN_SOURCE, quantity, argument="runs")
    for one in several:
        # the highest value of all points is drawn
        dims = set(one[quantity].dims) - set(POINT_DIMS)
        need = f"be runs with `{quantity}` of each window, as by sj.run(..., record={quantity!r}), each one case"
        good = dims == {"distance"} and one.sizes["distance"] > 1
        require(good, "runs", need, shown=f"over {', '.join(map(str, one[quantity].dims))}")
    if branch is not None:
        source = "continue_orbit over the speed"
        branch = check_dataset(branch, source, quantity, "speed", "stable", argument="branch")
    case = several[0].drop_vars(speed_name(several[0]))
    pace = quantity_of("speed", case)
    with drawing(ax, case, 3.5, 2.7) as ax:
        style = dict(ls="", marker=".", ms=2.5, mew=0, rasterized=True)
        if brute is not None:
            source = "follow over the speed"
            brute = check_dataset(brute, source, quantity, "speed", "status", argument="brute")
            values = highest(brute, quantity, *brute["status"].dims).where(brute["status"] == Status.FINITE)
            x, y = (a.values.ravel() for a in xr.broadcast(pace.shown(brute["speed"]), values))
            ax.plot(x, y, color="#c4c4c4", label="constant speed", **style)
        for k, one in enumerate(several):
            speed = one[speed_name(one)].values
            values = highest(_kept(one, _codes(one)), quantity, "distance")
            # acceleration from speeds over distance
            rate = np.gradient(speed**2) / (2 * one.attrs["window [m]"])  # v dv/dx
            # windows at a constant speed belong to neither direction
            for way, sign, color in (("up", 1, line_color(1)), ("down", -1, line_color(0))):
                there = sign * rate > 1e-9 * np.max(np.abs(rate))
                if there.any():
                    text = f"{way}, {with_unit(f'{np.median(np.abs(rate[there])):.3g}', 'm/s^2')}"
                    lighter = 1 - 0.7 * k / len(several)
                    ax.plot(pace.shown(speed[there]), values[there], label=text, color=color, alpha=lighter, **style)
        # stable parts solid, unstable parts dashed
        if branch is not None:
            lines = shown(branch, "speed").values, shown(branch, quantity).values[None]
            stable = stable_parts(branch)
            ax.plot(*joined(*lines, stable), color="black", lw=1.2, label="stable orbit")
            ax.plot(*joined(*lines, ~stable), color="black", lw=0.8, ls=DASHED, label="unstable orbit")
        ax.set(xlabel=label(in_display_unit(pace, case["distance"])), ylabel=label(values))
    return ax
