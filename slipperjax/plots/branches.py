"""Branches of periodic motions: stable and unstable parts, events, multipliers, and curves of events."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from ..analysis.degenerate import POINTS
from ..analysis.events import MEANINGS
from ..flow.datasets import varied_names
from ..model.parameters import START
from ..model.quantities import COORDINATES, SECTIONS
from ..tools.checks import one_of, require
from .maps import attractor_map, bifurcation, regime_map
from .style import (
    COLORS,
    check_dataset,
    color_bar,
    drawing,
    in_display_unit,
    label,
    line_color,
    quantity_of,
    shown,
    swept,
)

EVENT_MARKERS = {"LP": "D", "BP": "s", "PD": "^", "NS": "o", "GR": "|", "MX": "x"}
"""Markers of events; ends at a bound have none."""
EVENT_NAMES = {label: text.partition(":")[0] for label, text in MEANINGS.items()} | {"MX": "no convergence"}
CROWD = 4
"""Events that are a crowd where they are close to each other."""
CROWDED = 0.2
"""Share of the axis within which they are."""
DASHED = (0, (3.0, 1.4))
"""Line style of unstable motions; stable motions are solid."""


def branches(
    ds: object,
    quantity: str = "v_z",
    brute: object = None,
    ax: Axes | None = None,
    *,
    others: Sequence[object] = (),
) -> Axes:
    """Draw branches of periodic motions over a parameter: stable parts solid, unstable parts dashed, events marked.

    Colours distinguish periods. An event has a marker at each value that its orbit has.

    **Arguments:**

    - `ds`: one branch or several, results of `continue_orbit` or their datasets.
    - `quantity`: v_y, v_z [m/s], w_x, w_y or w_z [rad/s] at upward zero crossings, as in bifurcation diagrams;
        start_y, or another coordinate, at the start of the orbit's period; or a variable with one value per point,
        such as slowest_touchdown or grazing_gap.
    - `brute`: from `sweep(..., record="sections")` over the same parameter, drawn beneath as grey dots.
    - `ax`: the Axes to draw into; default the Axes of a new figure, with the fixed parameters as its title.
    - `others`: branches that are drawn before these.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset, an unknown quantity, or where the parameters differ.
    """
    these = ds if isinstance(ds, list | tuple) else [ds]
    points = datasets_of([*others, *these], "continue_orbit", "stable", "event_point")
    # a user's own systems have other numbers
    if any(quantity not in one or one[quantity].dims != ("point",) for one in points):
        check_quantity(quantity)
    names = {varied_names(one)[0] for one in points}
    if len(names) > 1:
        raise ValueError(f"Argument `ds` must be branches over one parameter, but they are over {sorted(names)}.")
    (name,) = names
    if brute is not None:
        check_brute(brute, name, quantity)
    lines = [_lines_of(one, quantity) for one in points]
    periods = sorted({one.attrs["orbit_period"] for one in points})

    def draw(ax: Axes) -> list[np.ndarray]:
        """Draw everything; return the places of each event, (values, 2)."""
        if brute is not None:
            bifurcation(brute, quantity, ax, color=COLORS["grey"], zorder=1, label="from simulation")
        places = []
        # the lines of all branches, with their events
        for one, threads in zip(points, lines, strict=True):
            period = one.attrs["orbit_period"]
            color = line_color(periods.index(period))
            # a legend of colours where there are several
            of = f"period {period}, " if len(periods) > 1 else ""
            x = shown(one, name).values
            stable = stable_parts(one)
            style = dict(color=color, zorder=3, solid_capstyle="butt")
            ax.plot(*joined(x, threads.values, stable), lw=1.3, label=f"{of}stable", **style)
            ax.plot(*joined(x, threads.values, ~stable), lw=0.8, ls=DASHED, label=f"{of}unstable", **style)
            for event, k in zip(one["event_label"].values.astype(str), one["event_point"].values, strict=True):
                # an event has as many values as its orbit has crossings
                values = threads[:, k].dropna("line").values
                if event in EVENT_MARKERS and len(values):
                    places.append(np.column_stack([np.full(len(values), x[k]), values]))
                    ax.plot(*places[-1].T, label=f"{event} {EVENT_NAMES[event]}", **_marker(event, color))
        return places

    with drawing(ax, points[0], 3.5, 2.9) as axes:
        places = draw(axes)
        axes.set(xlabel=label(shown(points[0], name)), ylabel=label(lines[0]))
        axes.margins(x=0.03, y=0.08)
        if ax is None:
            _enlarge_crowd(axes, draw, places)
    return axes


def _enlarge_crowd(ax: Axes, draw: Callable[[Axes], object], places: list[np.ndarray]) -> None:
    """Draw the part with most events a second time, larger, where `CROWD` or more events are close to each other.

    **Arguments:** `draw`: draws everything into Axes; `places`: of each event, (values, 2).
    """
    limits = ax.get_xlim(), ax.get_ylim()
    middles = np.mean(limits, axis=1)
    width = CROWDED * np.ptp(limits[0])
    at = np.array([place[0, 0] for place in places])
    # the events within a width to the right of each event
    near = (at >= at[:, None]) & (at <= at[:, None] + width)
    if near.sum(axis=1).max(initial=0) < CROWD or np.ptp(at) <= width:
        return
    inside = near[np.argmax(near.sum(axis=1))]
    crowd = np.concatenate([places[k] for k in np.flatnonzero(inside)])
    low, high = crowd.min(axis=0), crowd.max(axis=0)
    margin = [0.15, 0.25] * np.maximum(high - low, [0.2 * width, 0.02 * np.ptp(limits[1])])
    # above the crowd there is space where values are low, below it where they are high
    left = 0.12 if at[inside].mean() < middles[0] else 0.52
    bottom = 0.5 if crowd[:, 1].mean() < middles[1] else 0.12
    inset = ax.inset_axes((left, bottom, 0.36, 0.4))
    draw(inset)
    if (legend := inset.get_legend()) is not None:
        legend.remove()
    xlim, ylim = np.stack([low - margin, high + margin], axis=1)
    inset.set(xlim=xlim, ylim=ylim, xlabel="", ylabel="")
    inset.tick_params(labelsize=5)
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.indicate_inset_zoom(inset, edgecolor="black", lw=0.5)


def check_quantity(quantity: str) -> None:
    """Raise `ValueError` where branches do not have the quantity."""
    of_points = ("slowest_touchdown", "grazing_gap", "outside", "residual")
    one_of("quantity", quantity, (*SECTIONS, *(f"start_{name}" for name in COORDINATES), *of_points))


def check_brute(brute: object, name: str, quantity: str) -> None:
    """Raise `ValueError` unless a bifurcation diagram is over the parameter `name` and has the section `quantity`."""
    # only simulations record sections
    if quantity not in SECTIONS:
        raise ValueError(f"Argument `brute` must be None where `quantity` is {quantity}, which simulations lack.")
    of_sweep = check_dataset(brute, 'sweep with record="sections"', quantity, argument="brute")
    over = [str(d) for d in of_sweep[quantity].dims if d != "crossing"]
    if over != [name]:
        raise ValueError(f"Argument `brute` must be swept over {name}, as the branch is, but is over {over}.")


def multiplier_circle(ds: object, ax: Axes | None = None) -> Axes:
    """Draw Floquet multipliers of a branch in the complex plane, coloured by its parameter, with the unit circle.

    Multipliers with a real or imaginary part above 2 are outside of the picture.

    **Arguments:** `ds`: a branch, a result of `continue_orbit` or its dataset; `ax`: the Axes to draw into, default
    the Axes of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    one = check_dataset(ds, "continue_orbit", "stable", "multiplier_real", "multiplier_imag")
    (name,) = varied_names(one)
    mu = (one["multiplier_real"].values + 1j * one["multiplier_imag"].values).ravel()
    values = shown(one, name)
    # each multiplier has the parameter of its point
    colors = np.repeat(values, one.sizes["multiplier"])
    limit = 1.08 * float(np.clip(np.max(np.abs(mu)), 1.0, 2.0))
    with drawing(ax, one, 4.6, 4.2) as ax:
        ax.add_patch(Circle((0, 0), 1.0, fill=False, lw=0.8, ec="black", zorder=1))
        dots = ax.scatter(mu.real, mu.imag, c=colors, cmap="viridis", s=7, linewidths=0, zorder=2)
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        ax.set(xlabel="real part of multiplier", ylabel="imaginary part of multiplier")
        color_bar(ax, dots, label(values))
    return ax


def plane(curves: object, attractors: object = None, ax: Axes | None = None) -> Axes:
    """Draw curves of folds, flips, Neimark-Sacker points and grazings over two parameters, with their points of
    codimension two.

    A curve is solid where all other multipliers are inside the unit circle, so that the motion of simulations changes
    there, and dashed elsewhere.

    **Arguments:**

    - `curves`: one curve or several, results of `continue_event`, `branch_result` for your own system, or their
        datasets: along `point`, with two coordinates named by the attribute `varied`, the attribute `label` and the
        variable `outside`, the number of other multipliers outside the unit circle.
    - `attractors`: over the same parameters, drawn beneath; only its area is shown then. From `lyapunov_sweep`, as
        for `regime_map`, or as for `attractor_map`.
    - `ax`: the Axes to draw into; default the Axes of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes, with the first parameter upwards, or as in the regime map.

    **Raises:** `ValueError` for another kind of dataset, or where the parameters differ.
    """
    # black, and colours that differ clearly from a regime map
    colors = {"LP": "black", "PD": "#2a9d6f", "NS": "#7b4ea3", "GR": "#e07a1f"}
    several = datasets_of(curves, "continue_event", "outside", argument="curves")
    over = varied_names(several[0])
    for one in several:
        event = one.attrs.get("label")
        names = varied_names(one)
        # with a known label, and over the same plane as the first
        good = event in colors and len(names) == 2 and set(names) == set(over)
        need = f"be curves of {', '.join(colors)} over the same two parameters"
        require(good, "curves", need, shown=f"of {event} over {' and '.join(names)}")
    beneath = None
    if attractors is not None:
        beneath = check_dataset(attractors, "lyapunov_sweep", argument="attractors")
        # attractors without exponents
        name = "kind" if "kind" in beneath and "regime" not in beneath else "regime"
        own = swept(check_dataset(beneath, "lyapunov_sweep", name, argument="attractors")[name], count=2)
        need = f"be swept over {' and '.join(over)}, as the curves are"
        require(set(own) == set(over), "attractors", need, shown=f"over {' and '.join(own)}")
        over = own
    with drawing(ax, several[0] if beneath is None else beneath, 3.5, 3.3 if beneath is None else 3.9) as ax:
        if beneath is None:
            up, across = (label(shown(several[0], name)) for name in over)
            ax.set(xlabel=across, ylabel=up)
            ax.margins(0.05)
        else:
            {"kind": attractor_map, "regime": regime_map}[name](beneath, ax)
            ax.axis(ax.axis())  # only the area of the map is shown
        marked = []
        for one in several:
            event = one.attrs["label"]
            period = int(one.attrs.get("orbit_period", 1))
            text = f"{event} {EVENT_NAMES[event]}" + f" of period {period}" * (period > 1)
            y, x = (shown(one, name).values for name in over)
            # a part is solid where both its ends belong to a stable motion
            single = one["outside"].values == 0
            solid = single[1:] & single[:-1]
            style = dict(color=colors[event], zorder=4)
            ax.plot(*joined(x, y[None], solid), lw=1.4, label=text, **style)
            ax.plot(*joined(x, y[None], ~solid), lw=1.1, ls=DASHED, **style)
            marked += _points_of(one, x, y)
        size = np.ptp([ax.get_xlim(), ax.get_ylim()], axis=1)
        # curves that cross at a point share it, and a point may be of several kinds
        shared: list[tuple[set[str], np.ndarray]] = []
        for name, at in marked:
            kinds = next((kinds for kinds, place in shared if np.all(np.abs(at - place) < 1e-3 * size)), set())
            if not kinds:
                shared.append((kinds, at))
            kinds.add(name)
        for kinds, at in shared:
            name = ", ".join(sorted(kinds))
            ax.plot(*at, ls="", marker="o", ms=3.6, mec="white", mew=0.6, color="black", zorder=6)
            offset = dict(xytext=(3, 3), textcoords="offset points", fontsize=6, zorder=6)
            box = dict(boxstyle="square,pad=0.1", fc="white", ec="none", alpha=0.7)
            ax.annotate(name, at, bbox=box, annotation_clip=True, **offset)
        if any(np.any(one["outside"].values) for one in several):
            ax.plot([], [], color="black", lw=1.1, ls=DASHED, label="others outside, too")
    return ax


def _points_of(ds: xr.Dataset, x: np.ndarray, y: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return label and place of each point of codimension two on a curve."""
    if "event_label" not in ds:
        return []
    events = zip(ds["event_label"].values.astype(str), ds["event_point"].values, strict=True)
    return [(name, np.array([x[k], y[k]])) for name, k in events if name in POINTS]


def datasets_of(ds: object, source: str, *names: str, argument: str = "ds") -> list[xr.Dataset]:
    """Return the datasets of one result or several; arguments and errors as of `check_dataset`."""
    # one result is a list of one
    several = list(ds) if isinstance(ds, list | tuple) else [ds]
    require(several, argument, f"be one result of {source} or more", ds)
    return [check_dataset(one, source, *names, argument=argument) for one in several]


def _lines_of(ds: xr.Dataset, name: str) -> xr.DataArray:
    """Return a quantity along a branch over line and point in its display unit; NaN where a line is absent."""
    if name in SECTIONS:
        of_section = check_dataset(ds, "continue_orbit", name, f"{name}_period")[[name, f"{name}_period"]]
        velocity, time = (one.values for one in of_section.transpose("point", "crossing").values())
        threads = crossing_threads(velocity, time, int(ds.attrs["orbit_period"]))
        return in_display_unit(quantity_of(name, ds), xr.DataArray(threads, dims=("line", "point")), short=True)
    if name.startswith(START):
        coordinate = name.removeprefix(START)
        start = ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate).expand_dims("line")
        return in_display_unit(replace(quantity_of(coordinate, ds), name=name), start, short=True)
    return shown(check_dataset(ds, "continue_orbit", name), name).expand_dims("line")


def crossing_threads(velocity: np.ndarray, time: np.ndarray, period: int) -> np.ndarray:
    """Return the velocities of a section's crossings as lines (lines, points), NaN where a line is absent.

    The number of crossings changes from point to point, and so does their order where a crossing appears or passes
    the start of the period. Crossings of neighbouring points are matched by velocity and time. Where the velocity
    changes by more than 0.8 of the larger velocity, or the time by more than a tenth of a forcing period, a line ends
    and another begins.

    **Arguments:** `velocity` (points, crossings), NaN where there are fewer; `time` [forcing periods], likewise;
    `period`: after which the orbits recur [forcing periods].
    """
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    finite = np.isfinite(velocity)
    points = len(velocity)
    # a change of a twentieth of the range of all velocities is no jump, also for small velocities
    small = max(0.05 * float(np.ptp(velocity[finite])), 1e-300) if finite.any() else 1.0
    lines = np.full((0, 2, points), np.nan)  # velocities and times
    # along the branch, continue the lines that reach its last point
    for k, present in enumerate(finite):
        v = velocity[k, present]
        t = time[k, present]
        alive = np.flatnonzero(np.isfinite(lines[:, 0, k - 1]))
        v_before, t_before = lines[alive, :, k - 1].T[..., None]
        jump = (v - v_before) / np.maximum(0.8 * np.maximum(np.abs(v), np.abs(v_before)), small)
        # the shorter way around the period
        shift = ((t - t_before + period / 2) % period - period / 2) / 0.1
        cost = np.hypot(jump, shift)
        old, new = linear_sum_assignment(np.where(cost <= 1, cost, 1e6))  # as many matches as possible, at any cost
        matched = cost[old, new] <= 1
        line = np.full(len(v), -1)
        line[new[matched]] = alive[old[matched]]
        # crossings without a match begin a new line
        begun = np.flatnonzero(line < 0)
        line[begun] = len(lines) + np.arange(len(begun))
        lines = np.concatenate([lines, np.full((len(begun), 2, points), np.nan)])
        lines[line, :, k] = np.stack([v, t], axis=1)
    return lines[:, 0]


def stable_parts(ds: xr.Dataset) -> np.ndarray:
    """Return whether a branch is stable between its points, of shape (points - 1,).

    At an event itself stability is undecided, so that a part next to an event has the stability of its other end.
    """
    stable = ds["stable"].values.astype(bool)
    event = ds["label"].values.astype(str) != ""
    ahead = stable[1:]
    behind = stable[:-1]
    return np.where(event[:-1] & ~event[1:], ahead, np.where(event[1:] & ~event[:-1], behind, ahead & behind))


def joined(x: np.ndarray, threads: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of one polyline that draws some parts of several lines, with NaN where it is interrupted.

    **Arguments:** `x`: (points,); `threads`: the lines' y (lines, points); `parts`: which parts between neighbouring
    points are drawn (points - 1,).
    """
    finite = np.isfinite(threads)
    # a part needs both its ends
    drawn = parts & finite[:, 1:] & finite[:, :-1]
    end = np.pad(drawn, ((0, 0), (1, 0)))
    begin = np.pad(drawn, ((0, 0), (0, 1)))
    # each point that belongs to a drawn part, and a NaN after it where no part follows
    keep = np.stack([end | begin, end & ~begin], axis=-1)
    gap = np.full(threads.shape, np.nan)
    xs = np.broadcast_to(x, threads.shape)
    return np.stack([xs, gap], axis=-1)[keep], np.stack([threads, gap], axis=-1)[keep]


def _marker(event: str, color: str) -> dict[str, object]:
    """Return the style of an event's marker."""
    marker = EVENT_MARKERS[event]
    # filled markers have a white edge, which separates them from lines; these two have no area
    own = dict(ms=5.5, mew=0.9, mec=color) if marker in "|x" else dict(ms=4.4, mew=0.6, mec="white", mfc=color)
    return dict(ls="", marker=marker, zorder=4, **own)
