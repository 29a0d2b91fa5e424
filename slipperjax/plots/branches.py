"""Branches of periodic motions over a parameter: stable and unstable parts, events, and multipliers."""

import itertools
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from ..analysis.events import MEANINGS
from ..flow.load import varied_names
from ..model.quantities import COORDINATES, SECTIONS
from ..tools.checks import require
from .bifurcations import bifurcation
from .style import (
    COLORS,
    FLAGGED_LABEL,
    axis_label,
    check_dataset,
    cross,
    flagged,
    legend_above,
    name_case,
    new_axes,
    shown,
    styled,
)

VELOCITY_JUMP = 0.8
"""Change of a crossing's velocity between neighbouring points, over the larger one, beyond which no line is drawn."""
SMALL_JUMP = 0.05
"""Change over the range of all velocities that is no jump, however small the velocities are."""
TIME_JUMP = 0.1
"""Change of a crossing's time [forcing periods] beyond which no line is drawn."""
POOR = 1e6
"""Cost of a match that is not to be made."""


class Thread(NamedTuple):
    """One value, such as the velocity of one crossing, on consecutive points of a branch."""

    first: int
    """The first of the points."""
    values: list[float]


def crossing_threads(velocity: np.ndarray, time: np.ndarray, period: int) -> list[Thread]:
    """The crossings of a section as lines.

    The number of crossings changes from point to point, and their order where one appears or passes the start of the
    period. Those of neighbouring points are matched by velocity and time; where the match is poor, a line ends and
    another begins.

    **Arguments:** `velocity` (points, crossings), NaN where there are fewer; `time` [forcing periods], likewise;
    `period`: after which the orbits recur [forcing periods].
    """
    finite = velocity[np.isfinite(velocity)]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    done: list[Thread] = []
    open_: list[Thread] = []
    was = np.zeros(0), np.zeros(0)
    for point, (values, times) in enumerate(zip(velocity, time, strict=True)):
        there = np.isfinite(values)
        now = values[there], times[there]
        following: list[Thread | None] = [None] * len(now[0])
        for k, n in _matches(was, now, period, span):
            open_[k].values.append(float(now[0][n]))
            following[n] = open_[k]
        done += [Thread(point, [float(v)]) for v, one in zip(now[0], following, strict=True) if one is None]
        begun = iter(done[len(done) - following.count(None) :])
        open_ = [next(begun) if one is None else one for one in following]
        was = now
    return done


def _matches(was: tuple, now: tuple, period: int, span: float) -> Iterator[tuple[int, int]]:
    """Pairs of crossings, velocities and times, of two neighbouring points."""
    (v0, t0), (v1, t1) = ((v[:, None], t[:, None]) for v, t in (was, now))
    v1, t1 = v1.T, t1.T
    larger = np.maximum(np.abs(v0), np.abs(v1))
    jump = np.abs(v1 - v0) / np.maximum(np.maximum(VELOCITY_JUMP * larger, SMALL_JUMP * span), 1e-300)
    shift = np.abs((t1 - t0 + period / 2) % period - period / 2) / TIME_JUMP
    cost = np.hypot(jump, shift)
    cost = np.where(cost <= 1, cost, POOR)
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    for k, n in zip(*linear_sum_assignment(cost), strict=True):
        if cost[k, n] < POOR:
            yield int(k), int(n)


def scalar_threads(values: np.ndarray, breaks: np.ndarray) -> list[Thread]:
    """Values (points,) as lines, which end where they are not finite, and between points k and k + 1 at `breaks`."""
    found: list[Thread] = []
    apart = True
    for point, value in enumerate(values):
        if np.isfinite(value):
            if apart or breaks[point - 1]:
                found.append(Thread(point, []))
            found[-1].values.append(float(value))
        apart = not np.isfinite(value)
    return found


def stable_parts(ds: xr.Dataset) -> np.ndarray:
    """Whether a branch is stable between its points, of shape (points - 1,).

    An event has multipliers on the unit circle, or those of one side of a grazing: its other neighbour decides.
    """
    stable, event = ds["stable"].values.astype(bool), ds["label"].values.astype(str) != ""
    ahead, behind = stable[1:], stable[:-1]
    return np.where(event[:-1] & ~event[1:], ahead, np.where(event[1:] & ~event[:-1], behind, ahead & behind))


def pieces(thread: Thread, chosen: np.ndarray) -> Iterator[tuple[slice, list[float]]]:
    """The parts of a line in which the parts `chosen` (points - 1,) of the branch follow one another."""
    start = None
    last = thread.first + len(thread.values) - 1
    for point in range(thread.first, last + 1):
        inside = point < last and bool(chosen[point])
        if inside and start is None:
            start = point
        if not inside and start is not None:
            yield slice(start, point + 1), thread.values[start - thread.first : point + 1 - thread.first]
            start = None


def joined(x: np.ndarray, threads: list[Thread], chosen: np.ndarray) -> tuple[Any, Any]:
    """One curve of all chosen parts of lines, with NaN between them."""
    xs, ys = [], []
    for thread in threads:
        for where, values in pieces(thread, chosen):
            xs += [*x[where], np.nan]
            ys += [*values, np.nan]
    return np.array(xs), np.array(ys)


SOURCE = "continue_orbit"
"""What makes the datasets drawn here, for errors."""
PERIOD_COLORS = ("blue", "red", "green", "orange")
"""Colours of branches by their period, the shortest first; further ones begin anew."""
EVENT_MARKERS = {"LP": "D", "BP": "s", "PD": "^", "NS": "o", "GR": "|", "MX": "x"}
"""Markers of events; ends on a bound have none."""
EVENT_NAMES = {label: text.partition(":")[0] for label, text in MEANINGS.items()} | {"MX": "no convergence"}
SOLID, DASHED = "-", (0, (3.0, 1.4))
"""Lines of what is stable and what is not."""
SIMULATED = "from simulation"
FARTHEST = 2.0
"""Greatest modulus of a multiplier that is drawn at its place."""
CROWDED = 22.0
"""Distance [points] between grazings within which one label stands for them."""
_SHOWN_AS = {"grazing_gap": "gap"}
"""Variables of branches that are shown in the unit of a quantity with another name."""


_OTHERS = ("slowest_touchdown", "grazing_gap", "outside", "residual")
QUANTITIES = (*SECTIONS, *(f"start_{name}" for name in COORDINATES), *_OTHERS)
"""What the datasets of `continue_orbit` have to draw."""


class Mark(NamedTuple):
    """An event in a picture."""

    label: str
    x: float
    """The parameter [display unit]."""
    values: list[float]
    """What is drawn of the orbit there."""
    color: str


def branches(ds: Any, quantity: str = "v_z", brute: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Branches of periodic motions over their parameter: stable parts solid, unstable ones dashed, events marked.

    Colours tell periods apart. An event has a marker at each value that its orbit has, and its label beside one of
    them where there is room.

    **Arguments:**

    - `ds`: one branch or several, results of `continue_orbit` or their datasets.
    - `quantity`: v_y, v_z [m/s], w_x, w_y or w_z [rad/s] at upward zero crossings, as in bifurcation diagrams;
        start_y, or another coordinate, at the start of the orbit's period; or a variable with one value per point,
        such as slowest_touchdown or grazing_gap.
    - `brute`: from `sweep(..., record="sections")` over the same parameter, drawn beneath as grey dots.
    - `ax`: the Axes to draw into; default those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset, an unknown quantity, or where the parameters differ.
    """
    found = _all(ds)
    name = _parameter(found)
    lines = [_threads(one, quantity) for one in found]
    if brute is not None:
        check_brute(brute, name, quantity)
    own = ax is None
    if ax is None:
        ax = new_axes(3.5, 2.9)
        name_case(ax.figure, found[0], full=True)
    handles = [] if brute is None else _draw_brute(ax, brute, name, quantity)
    periods = [int(one.attrs["orbit_period"]) for one in found]
    order = sorted(set(periods))
    colors = [COLORS[PERIOD_COLORS[order.index(p) % len(PERIOD_COLORS)]] for p in periods]
    marks: list[Mark] = []
    for one, threads, color in zip(found, lines, colors, strict=True):
        _draw_lines(ax, one, shown(one, name), threads, color)
        marks += _marks(one, name, threads, color)
    for mark in marks:
        ax.plot([mark.x] * len(mark.values), mark.values, **_marker(mark.label, mark.color), zorder=4)
    ax.set(xlabel=axis_label(name, found[0]), ylabel=_label(quantity, found[0]))
    ax.margins(x=0.03, y=0.08)
    legend_above(ax, handles + _line_entries(dict(zip(periods, colors, strict=True))) + event_entries(marks))
    with styled() if own else nullcontext():
        _write_labels(ax, marks)
    return ax


def check_quantity(quantity: str) -> None:
    """Raises `ValueError` where branches have no such quantity."""
    require(quantity in QUANTITIES, "quantity", f"be one of {', '.join(QUANTITIES)}", quantity)


def check_brute(brute: Any, name: str, quantity: str) -> None:
    """Checks that a bifurcation diagram is over a parameter and has a quantity.

    **Raises:** `ValueError` where not.
    """
    variable = "strobe" if quantity.startswith("start_") else quantity
    if quantity not in SECTIONS and variable != "strobe":
        raise ValueError(f"Argument `brute` must be None where `quantity` is {quantity}, which simulations lack.")
    if not isinstance(brute, xr.Dataset) or variable not in brute:
        raise ValueError(f'Argument `brute` must be a dataset of sweep with record="sections", with `{variable}`.')
    over = [str(d) for d in brute[variable].dims if d not in ("crossing", "strobe_period", "coordinate")]
    if over != [name]:
        raise ValueError(f"Argument `brute` must be swept over {name}, as the branch is, but is over {over}.")


def multiplier_circle(ds: Any, ax: Any = None) -> Any:
    """Floquet multipliers of a branch in the complex plane, coloured by its parameter, with the unit circle.

    Critical multipliers of events have a marker and a label. Multipliers of a modulus above 2 are squares on an outer
    circle, in their direction.

    **Arguments:** `ds`: a branch, a result of `continue_orbit` or its dataset; `ax`: the Axes to draw into, default
    those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    (one,) = found = _all(ds, most=1)
    name, own = _parameter(found), ax is None
    if ax is None:
        ax = new_axes(3.5, 3.3)
        name_case(ax.figure, one, full=True)
    mu = one["multiplier_real"].values + 1j * one["multiplier_imag"].values
    values = np.broadcast_to(shown(one, name)[:, None], mu.shape)
    far = np.abs(mu) > FARTHEST
    ax.add_patch(Circle((0, 0), 1.0, fill=False, lw=0.8, ec="black", zorder=1))
    style = dict(cmap="viridis", vmin=np.min(values), vmax=np.max(values), linewidths=0)
    near = ax.scatter(mu[~far].real, mu[~far].imag, c=values[~far], s=7, zorder=2, **style)
    handles = [Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], label="multiplier")]
    if far.any():
        ax.add_patch(Circle((0, 0), FARTHEST, fill=False, lw=0.4, ls=":", ec=COLORS["grey"], zorder=1))
        at = FARTHEST * mu[far] / np.abs(mu[far])
        ax.scatter(at.real, at.imag, c=values[far], s=12, marker="s", zorder=2, **style)
        style_far = dict(ls="", marker="s", ms=3.2, color=COLORS["grey"])
        handles.append(Line2D([], [], **style_far, label=f"beyond, up to {np.max(np.abs(mu)):.3g}"))
    marks = _critical(one)
    for mark in marks:
        style = _marker(mark.label, mark.color) | {"mfc": "none", "mec": mark.color, "ms": 6, "mew": 0.9}
        ax.plot([mark.x] * len(mark.values), mark.values, **style, zorder=4)
    reach = FARTHEST if far.any() else max(1.0, float(np.max(np.abs(mu))))
    ax.set(xlim=(-1.08 * reach, 1.08 * reach), ylim=(-1.08 * reach, 1.08 * reach), aspect="equal")
    ax.set(xlabel="real part of multiplier", ylabel="imaginary part of multiplier")
    with styled() if own else nullcontext():
        ax.figure.colorbar(near, ax=ax, label=axis_label(name, one), shrink=0.85)
        legend_above(ax, handles + event_entries(marks))
        _write_labels(ax, marks)
    return ax


def event_entries(marks: Sequence[Mark]) -> list[Line2D]:
    """Entries of a legend that say what labels mean."""
    used = {mark.label for mark in marks}
    styles = {label: _marker(label, "black") for label in EVENT_MARKERS if label in used}
    return [Line2D([], [], **style, label=f"{label} {EVENT_NAMES[label]}") for label, style in styles.items()]


def _all(ds: Any, most: int | None = None) -> list[xr.Dataset]:
    """The datasets of one branch or several."""
    several = list(ds) if isinstance(ds, list | tuple) else [ds]
    found = [one if isinstance(one, xr.Dataset) else getattr(one, "points", one) for one in several]
    for one in found:
        check_dataset(one, SOURCE, "stable", "event_point")
    if not found or (most is not None and len(found) > most):
        raise ValueError(f"Argument `ds` must be {'one branch' if most else 'one branch or more'}, not {len(found)}.")
    return found


def _parameter(found: Sequence[xr.Dataset]) -> str:
    """The parameter of all branches."""
    names = {varied_names(one)[0] for one in found}
    if len(names) > 1:
        raise ValueError(f"Argument `ds` must be branches over one parameter, but they are over {sorted(names)}.")
    return names.pop()


def _label(name: str, ds: xr.Dataset) -> str:
    """The axis label of a quantity."""
    if name in _SHOWN_AS:
        unit = axis_label(_SHOWN_AS[name]).partition(" [")[2]
        return f"{name.replace('_', ' ')} [{unit}"
    coordinate = name.removeprefix("start_")
    return f"start {axis_label(coordinate)}" if name != coordinate else axis_label(name, ds)


def _threads(ds: xr.Dataset, name: str) -> list[Thread]:
    """What is drawn of a branch, as lines, in display units."""
    points = ds.sizes["point"]
    nowhere = np.zeros(points - 1, bool)
    if name in SECTIONS:
        check_dataset(ds, SOURCE, name, f"{name}_period")
        velocity, time = (ds[n].transpose("point", "crossing").values for n in (name, f"{name}_period"))
        return crossing_threads(velocity, time, int(ds.attrs["orbit_period"]))
    coordinate = name.removeprefix("start_")
    if name != coordinate and coordinate in COORDINATES:
        values = ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate).values
        return scalar_threads(COORDINATES[coordinate].shown(values), nowhere)
    if name not in ds or ds[name].dims != ("point",) or ds[name].dtype.kind not in "fiub":
        usual = ", ".join((*SECTIONS, "start_y", "slowest_touchdown", "grazing_gap"))
        raise ValueError(f"Argument `quantity` must have one value per point, such as {usual}, but is {name!r}.")
    # the slowest touchdown becomes another one where a touchdown comes or goes
    touchdowns = ds["touchdowns"].values.reshape(points, -1) if name == "slowest_touchdown" else np.zeros((points, 1))
    changes = np.any(np.diff(touchdowns, axis=0) != 0, axis=1)
    values = shown(ds, name) if name not in _SHOWN_AS else ds[name].values * 1e3
    return scalar_threads(np.asarray(values, float), changes)


def _draw_brute(ax: Any, brute: xr.Dataset, name: str, quantity: str) -> list[Any]:
    """Grey dots of simulations; gives the entries of the legend."""
    style: dict[str, Any] = {"color": COLORS["grey"], "zorder": 1, "ms": 3.4}
    if quantity in SECTIONS:
        bifurcation(brute, quantity, ax, **style)
    else:
        recorded = brute["strobe"].isel(strobe_period=slice(-int(brute.attrs.get("periods", 0)), None))
        found = recorded.sel(coordinate=quantity.removeprefix("start_")).transpose(name, "strobe_period")
        values = np.where(flagged(brute, name)[:, None], np.nan, found.values)
        values = COORDINATES[quantity.removeprefix("start_")].shown(values)
        ax.plot(np.repeat(shown(brute, name), values.shape[1]), values.ravel(), ".", mew=0, rasterized=True, **style)
    dots = Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], mew=0, label=SIMULATED)
    return [dots, cross(label=FLAGGED_LABEL)] if flagged(brute, name).any() else [dots]


def _draw_lines(ax: Any, ds: xr.Dataset, x: np.ndarray, threads: list[Thread], color: str) -> None:
    """The stable and the unstable parts; a value without neighbours is a dot."""
    stable = stable_parts(ds)
    style: dict[str, Any] = dict(color=color, zorder=3, solid_capstyle="butt")
    ax.plot(*joined(x, threads, ~stable), lw=0.8, ls=DASHED, **style)
    ax.plot(*joined(x, threads, stable), lw=1.3, ls=SOLID, **style)
    lone = [(x[t.first], t.values[0]) for t in threads if len(t.values) == 1]
    if lone:
        ax.plot(*np.transpose(lone), ".", ms=2, mew=0, color=color, zorder=3)


def _line_entries(colors: dict[int, str]) -> list[Line2D]:
    """Entries of a legend for what is stable, and for the periods where there are several."""
    one = next(iter(colors.values())) if len(colors) == 1 else "black"
    periods = sorted(colors) if len(colors) > 1 else []
    return [
        *(Line2D([], [], color=colors[p], lw=1.3, label=f"period {p}") for p in periods),
        Line2D([], [], color=one, lw=1.3, ls=SOLID, label="stable"),
        Line2D([], [], color=one, lw=0.8, ls=DASHED, label="unstable"),
    ]


def _events(ds: xr.Dataset) -> list[tuple[str, int]]:
    """Labels and points of the events that are marked."""
    labels, points = ds["event_label"].values.astype(str), ds["event_point"].values
    return [(label, int(k)) for label, k in zip(labels, points, strict=True) if label in EVENT_MARKERS]


def _marks(ds: xr.Dataset, name: str, threads: list[Thread], color: str) -> list[Mark]:
    at = shown(ds, name)
    there = lambda k: [t.values[k - t.first] for t in threads if t.first <= k < t.first + len(t.values)]
    return [Mark(label, float(at[k]), there(k), color) for label, k in _events(ds) if there(k)]


def _critical(ds: xr.Dataset) -> list[Mark]:
    """Critical multipliers of events."""
    re, im = (ds[f"event_multiplier_{part}"].values for part in ("real", "imag"))
    labels = ds["event_label"].values.astype(str)
    # folds of one branch have the same multiplier, +1
    found = {
        (label, round(float(a), 3), round(float(b), 3)): (float(a), float(b))
        for label, a, b in zip(labels, re, im, strict=True)
        if label in EVENT_MARKERS and np.isfinite(a)
    }
    return [Mark(label, a, [b, -b] if b else [0.0], COLORS["red"]) for (label, *_), (a, b) in found.items()]


def _marker(label: str, color: str) -> dict[str, Any]:
    """How an event is drawn."""
    thin = EVENT_MARKERS[label] in "|x"
    size, edge = (5.5, 0.9) if thin else (4.4, 0.6)
    mec = color if thin else "white"
    return dict(ls="", marker=EVENT_MARKERS[label], ms=size, mew=edge, mec=mec, mfc=color)


def _write_labels(ax: Any, marks: Sequence[Mark], fontsize: float = 6.5) -> None:
    """Labels beside the markers, where they hide neither each other nor, if possible, a line.

    Where grazings crowd, one label stands for them.
    """
    layout = ax.figure.canvas.figure.get_layout_engine()
    if layout is not None:
        layout.execute(ax.figure.canvas.figure)  # places are known once the axes are laid out
    pixel = ax.figure.dpi / 72
    busy = np.concatenate([_outline(ax, line, 2 * pixel) for line in ax.lines if line.get_zorder() >= 3])
    frame, taken = ax.get_window_extent().padded(-1.5 * pixel), np.zeros((0, 4))
    grazings = np.zeros((0, 2))
    for label, x, values, color in sorted(marks, key=lambda mark: mark.label == "GR"):
        places = ax.transData.transform([(x, value) for value in values])
        if label == "GR":
            if len(grazings) and np.min(np.abs(places[:, :1] - grazings[:, 0])) < CROWDED * pixel:
                continue
            grazings = np.vstack([grazings, places])
        half = np.array([0.36 * len(label), 0.5]) * fontsize * pixel
        best: tuple[float, Any] | None = None
        for value in sorted(values, reverse=True):
            at = ax.transData.transform((x, value))
            for far in (8.0, 13.0):
                for way in ((0, 1), (0, -1), (1.2, 0), (-1.2, 0), (0.9, 0.8), (-0.9, 0.8), (0.9, -0.8), (-0.9, -0.8)):
                    middle = at + far * pixel * np.array(way)
                    box = np.array([*(middle - half), *(middle + half)])
                    outside = box[0] < frame.x0 or box[1] < frame.y0 or box[2] > frame.x1 or box[3] > frame.y1
                    if outside or np.any(_overlap(box, taken)):
                        continue
                    score = far / 8 + np.sum(np.all((busy > box[:2]) & (busy < box[2:]), axis=1))
                    if best is None or score < best[0]:
                        best = score, (value, far * np.array(way), box)
        if best is not None:
            value, offset, box = best[1]
            taken = np.vstack([taken, box])
            style = dict(ha="center", va="center", fontsize=fontsize, color=color, zorder=5)
            note = ax.annotate(label, (x, value), offset, textcoords="offset points", **style)
            note.set_path_effects([withStroke(linewidth=1.5, foreground="white")])


def _outline(ax: Any, line: Any, step: float) -> np.ndarray:
    """Points at most `step` pixels apart on a line, and those of its markers."""
    places = np.asarray(line.get_xydata(), float).reshape(-1, 2)
    places = ax.transData.transform(places) if len(places) else places
    if line.get_linestyle() == "None" or len(places) < 2:
        return places[np.isfinite(places).all(axis=1)]
    found = [places[np.isfinite(places).all(axis=1)]]
    for a, b in itertools.pairwise(places):
        if np.isfinite(a).all() and np.isfinite(b).all():
            count = min(int(np.hypot(*(b - a)) / step) + 1, 500)
            found.append(a + (b - a) * np.linspace(0, 1, count + 1)[:, None])
    return np.concatenate(found)


def _overlap(box: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Which of other boxes overlap a box; each left, bottom, right, top."""
    return np.all((others[:, :2] < box[2:]) & (others[:, 2:] > box[:2]), axis=1)
