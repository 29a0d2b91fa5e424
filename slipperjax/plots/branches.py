"""Branches of periodic motions: stable and unstable parts, events, multipliers, and curves of events."""

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import Normal, withStroke

from ..analysis.events import MEANINGS
from ..flow.datasets import varied_names
from ..model.quantities import COORDINATES, SECTIONS
from ..model.quantities import quantity as registered
from ..tools.checks import require
from .bifurcations import bifurcation
from .maps import draw_attractors, draw_regimes
from .style import (
    COLORS,
    FLAGGED_LABEL,
    axis_label,
    check_dataset,
    cross,
    drawing,
    flagged,
    layout_now,
    legend_above,
    line_color,
    shown,
    swept,
)

VELOCITY_JUMP = 0.8
"""Change of a crossing's velocity between neighbouring points, over the larger one, beyond which no line is drawn."""
SMALL_JUMP = 0.05
"""Change over the range of all velocities that is no jump, however small the velocities are."""
TIME_JUMP = 0.1
"""Change of a crossing's time [forcing periods] beyond which no line is drawn."""
EVENT_MARKERS = {"LP": "D", "BP": "s", "PD": "^", "NS": "o", "GR": "|", "MX": "x"}
"""Markers of events; ends on a bound have none."""
EVENT_NAMES = {label: text.partition(":")[0] for label, text in MEANINGS.items()} | {"MX": "no convergence"}
CURVE_COLORS = {"LP": "black", "PD": "#2a9d6f", "NS": "#7b4ea3", "GR": "#e07a1f"}
"""Colours of curves by label, other than those of regime maps."""
SOLID, DASHED = "-", (0, (3.0, 1.4))
"""Line styles of stable and unstable motions."""
LARGEST_MODULUS = 2.0
"""Greatest modulus of a multiplier that is drawn at its place."""
CROWDED_DISTANCE = 22.0
"""Distance [points] between grazings within which one label stands for them."""
_ASIDE = np.array([(0, 1), (0, -1), (1.2, 0), (-1.2, 0), (0.9, 0.8), (-0.9, 0.8), (0.9, -0.8), (-0.9, -0.8)])
LABEL_OFFSETS = np.concatenate([8.0 * _ASIDE, 13.0 * _ASIDE])
"""Offsets [points] of labels from their markers, the best first."""
_POINT_VALUES = "slowest_touchdown", "grazing_gap", "outside", "residual"
QUANTITIES = (*SECTIONS, *(f"start_{name}" for name in COORDINATES), *_POINT_VALUES)
"""Variables of `continue_orbit` that can be drawn."""


class Mark(NamedTuple):
    """An event in a picture."""

    label: str
    x: float
    """The parameter [display unit]."""
    values: list[float]
    """Values of the orbit there."""
    color: str


def branches(ds: Any, quantity: str = "v_z", brute: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Draws branches of periodic motions over a parameter: stable parts solid, unstable ones dashed, events marked.

    Colours tell periods apart. An event has a marker at each value that its orbit has, and its label next to one of
    them where there is space.

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
    points = _datasets(ds, "branch", "continue_orbit", "stable", "event_point")
    name = _parameter(points)
    lines = [_lines_of(one, quantity) for one in points]
    if brute is not None:
        check_brute(brute, name, quantity)
    periods = [int(one.attrs["orbit_period"]) for one in points]
    order = sorted(set(periods))
    colors = {p: line_color(k) for k, p in enumerate(order)}
    marks: list[Mark] = []
    with drawing(ax, points[0], 3.5, 2.9) as ax:
        handles = [] if brute is None else _draw_brute(ax, brute, name, quantity)
        for one, (threads, linked), period in zip(points, lines, periods, strict=True):
            x = shown(one, name)
            _draw_lines(ax, x, threads, linked, stable_parts(one), colors[period])
            for label, k in zip(one["event_label"].values.astype(str), one["event_point"].values, strict=True):
                values = threads[np.isfinite(threads[:, k]), k].tolist()
                if label in EVENT_MARKERS and values:
                    marks.append(Mark(label, float(x[k]), values, colors[period]))
        for mark in marks:
            ax.plot([mark.x] * len(mark.values), mark.values, **_marker(mark.label, mark.color), zorder=4)
        ax.set(xlabel=axis_label(name, points[0]), ylabel=_quantity_label(quantity, points[0]))
        ax.margins(x=0.03, y=0.08)
        several = len(colors) > 1
        handles += [Line2D([], [], color=colors[p], lw=1.3, label=f"period {p}") for p in order if several]
        for text, style in (("stable", dict(lw=1.3, ls=SOLID)), ("unstable", dict(lw=0.8, ls=DASHED))):
            handles.append(Line2D([], [], color="black" if several else colors[order[0]], label=text, **style))
        legend_above(ax, handles + _event_entries(marks))
        write_labels(ax, marks)
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
    """Draws Floquet multipliers of a branch in the complex plane, coloured by its parameter, with the unit circle.

    Critical multipliers of events have a marker and a label. Multipliers of a modulus above 2 are squares on an outer
    circle, in their direction.

    **Arguments:** `ds`: a branch, a result of `continue_orbit` or its dataset; `ax`: the Axes to draw into, default
    those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    points = _datasets(ds, "branch", "continue_orbit", "stable", "event_point")
    if len(points) > 1:
        raise ValueError(f"Argument `ds` must be one branch, not {len(points)}.")
    (one,), name = points, _parameter(points)
    mu = one["multiplier_real"].values + 1j * one["multiplier_imag"].values
    values, modulus = np.broadcast_to(shown(one, name)[:, None], mu.shape), np.abs(mu)
    far, reach = modulus > LARGEST_MODULUS, min(LARGEST_MODULUS, max(1.0, float(np.max(modulus))))
    with drawing(ax, one, 3.5, 3.3) as ax:
        style = dict(cmap="viridis", vmin=np.min(values), vmax=np.max(values), linewidths=0, zorder=2)
        ax.add_patch(Circle((0, 0), 1.0, fill=False, lw=0.8, ec="black", zorder=1))
        dots = ax.scatter(mu[~far].real, mu[~far].imag, c=values[~far], s=7, **style)
        grey: dict[str, Any] = dict(ls="", color=COLORS["grey"])
        handles = [Line2D([], [], marker=".", ms=5, label="multiplier", **grey)]
        if far.any():
            ax.add_patch(Circle((0, 0), LARGEST_MODULUS, fill=False, lw=0.4, ls=":", ec=COLORS["grey"], zorder=1))
            rim = LARGEST_MODULUS * mu[far] / modulus[far]
            ax.scatter(rim.real, rim.imag, c=values[far], s=12, marker="s", **style)
            text = f"beyond, up to {np.max(modulus):.3g}"
            handles.append(Line2D([], [], marker="s", ms=3.2, label=text, **grey))
        marks = _critical_marks(one)
        for mark in marks:
            style = _marker(mark.label, mark.color) | dict(mfc="none", mec=mark.color, ms=6, mew=0.9)
            ax.plot([mark.x] * len(mark.values), mark.values, **style, zorder=4)
        ax.set(xlim=(-1.08 * reach, 1.08 * reach), ylim=(-1.08 * reach, 1.08 * reach), aspect="equal")
        ax.set(xlabel="real part of multiplier", ylabel="imaginary part of multiplier")
        ax.figure.colorbar(dots, ax=ax, label=axis_label(name, one), shrink=0.85)
        legend_above(ax, handles + _event_entries(marks))
        write_labels(ax, marks)
    return ax


def _critical_marks(ds: xr.Dataset) -> list[Mark]:
    """Gives the critical multipliers of events, alike ones once, since all folds of a branch have +1."""
    parts = [ds[f"event_multiplier_{part}"].values.round(3).tolist() for part in ("real", "imag")]
    alike = dict.fromkeys(zip(ds["event_label"].values.astype(str), *parts, strict=True))
    return [
        Mark(label, re, [im, -im] if im else [0.0], COLORS["red"])
        for label, re, im in alike
        if label in EVENT_MARKERS and np.isfinite(re)
    ]


def event_curves(ds: Any, regimes: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Draws curves of folds, flips, Neimark-Sacker points and grazings over two parameters.

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
    curves = _datasets(ds, "curve", "continue_event", "outside")
    over = _two_parameters(curves[0])
    for one in curves:
        label, names = one.attrs.get("label"), _two_parameters(one)
        require(label in CURVE_COLORS, "ds", f"have a label of {', '.join(CURVE_COLORS)}", label)
        check_dataset(one, "continue_event", *names)
        if set(names) != set(over):
            raise ValueError(f"Argument `ds` must be curves over {' and '.join(over)}, but one is over {names}.")
    if regimes is not None:
        over = _map_parameters(regimes, over)
    base = curves[0] if regimes is None else regimes
    with drawing(ax, base, 3.5, 3.3 if regimes is None else 3.9) as ax:
        if regimes is None:
            ax.set(xlabel=axis_label(over[1], base), ylabel=axis_label(over[0], base))
            ax.margins(0.05)
            handles = []
        else:
            handles = (draw_regimes if "regime" in regimes else draw_attractors)(regimes, over, ax)
            ax.axis(ax.axis())  # only the area of the map is shown
        for one in curves:
            _draw_curve(ax, one, over)
        legend_above(ax, _curve_entries(curves) + handles)
        write_labels(ax, [mark for one in curves for mark in _curve_marks(ax, one, over)])
    return ax


def _map_parameters(regimes: xr.Dataset, over: tuple[str, ...]) -> tuple[str, ...]:
    """Gives the parameters of a map, the one upwards first; raises `ValueError` where the curves have others."""
    kinds = isinstance(regimes, xr.Dataset) and "regime" not in regimes and "kind" in regimes
    check_dataset(regimes, "lyapunov_sweep", "kind" if kinds else "regime")
    own = swept(regimes["kind" if kinds else "regime"], count=2)
    if set(own) != set(over):
        names = f"{' and '.join(over)}, as the curves are, but is over {' and '.join(own)}"
        raise ValueError(f"Argument `regimes` must be swept over {names}.")
    return own


def _two_parameters(ds: xr.Dataset) -> tuple[str, ...]:
    """Gives the two parameters that vary along a curve."""
    names = ds.attrs.get("varied", ())
    names = tuple(map(str, json.loads(names) if isinstance(names, str) else names))
    if len(names) != 2:
        raise ValueError(f"Argument `ds` must be a curve over two parameters, but is over {names}.")
    return names


def _draw_curve(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> None:
    """Draws one curve, its points in their order; a part is solid where both its ends are."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    single = ds["outside"].values == 0
    solid = single[1:] & single[:-1]
    style = dict(color=CURVE_COLORS[ds.attrs["label"]], zorder=4)
    style["path_effects"] = [withStroke(linewidth=2.6, foreground="white"), Normal()]
    ax.plot(*joined(x, y[None], solid), lw=1.4, ls=SOLID, **style)
    ax.plot(*joined(x, y[None], ~solid), lw=1.1, ls=DASHED, **style)


def _curve_marks(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> Iterator[Mark]:
    """Gives the event's name at the middle of a curve's part inside the axes, of its solid part if it has one."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    (left, right), (low, high) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
    inside = (x >= left) & (x <= right) & (y >= low) & (y <= high)
    solid = inside & (ds["outside"].values == 0)
    index = np.flatnonzero(solid if solid.any() else inside)
    label, period = ds.attrs["label"], int(ds.attrs.get("orbit_period", 1))
    if len(index):
        middle = index[len(index) // 2]
        text = label + (f" of period {period}" if period > 1 else "")
        yield Mark(text, float(x[middle]), [float(y[middle])], CURVE_COLORS[label])


def _curve_entries(curves: Sequence[xr.Dataset]) -> list[Line2D]:
    """Gives entries of a legend for curves."""
    used = {one.attrs["label"] for one in curves}
    lines = [
        Line2D([], [], color=color, lw=1.4, label=f"{label} {EVENT_NAMES[label]}")
        for label, color in CURVE_COLORS.items()
        if label in used
    ]
    if any(np.any(one["outside"].values) for one in curves):
        lines.append(Line2D([], [], color="black", lw=1.1, ls=DASHED, label="others outside, too"))
    return lines


def _event_entries(marks: Sequence[Mark]) -> list[Line2D]:
    """Gives entries of a legend with the meaning of labels."""
    used = {mark.label for mark in marks}
    names = [label for label in EVENT_MARKERS if label in used]
    return [Line2D([], [], **_marker(label, "black"), label=f"{label} {EVENT_NAMES[label]}") for label in names]


def _datasets(ds: Any, kind: str, source: str, *names: str) -> list[xr.Dataset]:
    """Gives the datasets, with the variables `names`, of one result or several."""
    several = list(ds) if isinstance(ds, list | tuple) else [ds]
    if not several:
        raise ValueError(f"Argument `ds` must be one {kind} or more, not 0.")
    datasets = [one if isinstance(one, xr.Dataset) else getattr(one, "points", one) for one in several]
    for one in datasets:
        check_dataset(one, source, *names)
    return datasets


def _parameter(points: Sequence[xr.Dataset]) -> str:
    """Gives the parameter of all branches."""
    names = {varied_names(one)[0] for one in points}
    if len(names) > 1:
        raise ValueError(f"Argument `ds` must be branches over one parameter, but they are over {sorted(names)}.")
    return names.pop()


def _quantity_label(name: str, ds: xr.Dataset) -> str:
    """Gives the axis label of a quantity."""
    if name == "grazing_gap":
        return f"grazing gap [{registered('gap').display_unit}]"
    coordinate = name.removeprefix("start_")
    return f"start {axis_label(coordinate)}" if name != coordinate else axis_label(name, ds)


def _lines_of(ds: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Gives lines of a branch (lines, points) [display unit], NaN for none, and the parts to draw (points - 1,)."""
    linked = np.ones(ds.sizes["point"] - 1, bool)
    if name in SECTIONS:
        check_dataset(ds, "continue_orbit", name, f"{name}_period")
        velocity, time = (ds[n].transpose("point", "crossing").values for n in (name, f"{name}_period"))
        return crossing_threads(velocity, time, int(ds.attrs["orbit_period"])), linked
    coordinate = name.removeprefix("start_")
    if name != coordinate and coordinate in COORDINATES:
        values = ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate).values
        return COORDINATES[coordinate].shown(values)[None], linked
    if name not in ds or ds[name].dims != ("point",) or ds[name].dtype.kind not in "fiub":
        usual = ", ".join((*SECTIONS, "start_y", "slowest_touchdown", "grazing_gap"))
        raise ValueError(f"Argument `quantity` must have one value per point, such as {usual}, but is {name!r}.")
    if name == "slowest_touchdown":  # it becomes another one where a touchdown comes or goes
        linked = np.all(np.diff(ds["touchdowns"].values.reshape(len(linked) + 1, -1), axis=0) == 0, axis=1)
    values = registered("gap").shown(ds[name].values) if name == "grazing_gap" else shown(ds, name)
    return np.where(np.isfinite(values), values, np.nan)[None], linked


def crossing_threads(velocity: np.ndarray, time: np.ndarray, period: int) -> np.ndarray:
    """Gives the velocities of a section's crossings as lines (lines, points), NaN where a line is absent.

    The number of crossings changes from point to point, and their order where one appears or passes the start of the
    period. Those of neighbouring points are matched by velocity and time; where the match is poor, a line ends and
    another begins.

    **Arguments:** `velocity` (points, crossings), NaN where there are fewer; `time` [forcing periods], likewise;
    `period`: after which the orbits recur [forcing periods].
    """
    finite = np.isfinite(velocity)
    span = float(np.ptp(velocity[finite])) if finite.any() else 0.0
    threads: list[np.ndarray] = []
    before, line_before = (np.zeros(0), np.zeros(0)), np.zeros(0, int)
    for point, present in enumerate(finite):
        now = velocity[point, present], time[point, present]
        line = np.full(len(now[0]), -1)
        old, new = _matches(before, now, period, span)
        line[new] = line_before[old]
        for n in np.flatnonzero(line < 0):  # crossings without a match begin a line
            line[n] = len(threads)
            threads.append(np.full(len(velocity), np.nan))
        for n, value in zip(line, now[0], strict=True):
            threads[n][point] = value
        before, line_before = now, line
    return np.reshape(threads, (-1, len(velocity)))


def _matches(before: tuple, now: tuple, period: int, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Gives the indices of matching crossings, velocities and times, of two neighbouring points."""
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    (v0, t0), (v1, t1) = ((v[:, None], t[:, None]) for v, t in (before, now))
    larger = np.maximum(np.abs(v0), np.abs(v1.T))
    jump = np.abs(v1.T - v0) / np.maximum(np.maximum(VELOCITY_JUMP * larger, SMALL_JUMP * span), 1e-300)
    shift = np.abs((t1.T - t0 + period / 2) % period - period / 2) / TIME_JUMP
    cost = np.hypot(jump, shift)
    old, new = linear_sum_assignment(np.where(cost <= 1, cost, 1e6))  # at any price as many matches as possible
    matched = cost[old, new] <= 1
    return old[matched], new[matched]


def stable_parts(ds: xr.Dataset) -> np.ndarray:
    """Returns whether a branch is stable between its points, of shape (points - 1,).

    An event has multipliers on the unit circle, or those of one side of a grazing: its other neighbour decides.
    """
    stable, event = ds["stable"].values.astype(bool), ds["label"].values.astype(str) != ""
    ahead, behind = stable[1:], stable[:-1]
    return np.where(event[:-1] & ~event[1:], ahead, np.where(event[1:] & ~event[:-1], behind, ahead & behind))


def _ends(threads: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns whether a part of a line ends at each of its points, and whether one begins there, (lines, points)."""
    finite = np.isfinite(threads)
    drawn = parts & finite[:, 1:] & finite[:, :-1]
    return np.pad(drawn, ((0, 0), (1, 0))), np.pad(drawn, ((0, 0), (0, 1)))


def joined(x: np.ndarray, threads: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gives one curve of the chosen `parts` (points - 1,) of lines (lines, points), with NaN after each.

    **Arguments:** `x`: (points,).
    """
    end, begin = _ends(threads, parts)
    # each point that a part touches, and a NaN after it where no part goes on
    keep = np.stack([end | begin, end & ~begin], axis=-1)
    xs, gap = np.broadcast_to(x, threads.shape), np.full(threads.shape, np.nan)
    return np.stack([xs, gap], axis=-1)[keep], np.stack([threads, gap], axis=-1)[keep]


def _draw_lines(
    ax: Any, x: np.ndarray, threads: np.ndarray, linked: np.ndarray, stable: np.ndarray, color: str
) -> None:
    """Draws the stable and the unstable parts; a value without neighbours is a dot."""
    style: dict[str, Any] = dict(color=color, zorder=3, solid_capstyle="butt")
    ax.plot(*joined(x, threads, linked & ~stable), lw=0.8, ls=DASHED, **style)
    ax.plot(*joined(x, threads, linked & stable), lw=1.3, ls=SOLID, **style)
    end, begin = _ends(threads, linked)
    line, point = np.nonzero(np.isfinite(threads) & ~end & ~begin)
    if len(line):
        ax.plot(x[point], threads[line, point], ".", ms=2, mew=0, color=color, zorder=3)


def _draw_brute(ax: Any, brute: xr.Dataset, name: str, quantity: str) -> list[Any]:
    """Draws grey dots of simulations; gives the entries of the legend."""
    style: dict[str, Any] = {"color": COLORS["grey"], "zorder": 1, "ms": 3.4}
    if quantity in SECTIONS:
        bifurcation(brute, quantity, ax, **style)
    else:
        coordinate = quantity.removeprefix("start_")
        last = brute["strobe"].isel(strobe_period=slice(-int(brute.attrs.get("periods", 0)), None))
        states = last.sel(coordinate=coordinate).transpose(name, "strobe_period").values
        values = COORDINATES[coordinate].shown(np.where(flagged(brute, name)[:, None], np.nan, states))
        ax.plot(shown(brute, name), values, ".", mew=0, rasterized=True, **style)
    dots = Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], mew=0, label="from simulation")
    return [dots] + [cross(label=FLAGGED_LABEL)] * bool(flagged(brute, name).any())


def _marker(label: str, color: str) -> dict[str, Any]:
    """Gives the style of an event's marker."""
    thin = EVENT_MARKERS[label] in "|x"
    size, edge = (5.5, 0.9) if thin else (4.4, 0.6)
    return dict(ls="", marker=EVENT_MARKERS[label], ms=size, mew=edge, mec=color if thin else "white", mfc=color)


def write_labels(ax: Any, marks: Iterable[Mark], fontsize: float = 6.5) -> None:
    """Writes labels next to the markers, where they hide neither each other nor, if possible, a line.

    Where grazings crowd, one label stands for them.
    """
    layout_now(ax.figure.canvas.figure)
    pixel = ax.figure.dpi / 72
    low, high = ax.get_window_extent().padded(-1.5 * pixel).get_points()
    paths = [
        line.get_path().interpolated(1 if line.get_linestyle() == "None" else 32).vertices
        for line in ax.lines
        if line.get_zorder() >= 3 and len(line.get_xdata())
    ]
    hidden = ax.transData.transform(np.concatenate([np.zeros((0, 2)), *paths]))
    hidden = hidden[np.isfinite(hidden).all(axis=1)]
    boxes, grazings = np.zeros((2, 0, 2)), np.zeros(0)
    for label, x, values, color in sorted(marks, key=lambda mark: mark.label == "GR"):
        at = np.array([(x, value) for value in sorted(values, reverse=True)])
        positions = ax.transData.transform(at)
        if label == "GR":
            if np.any(np.abs(grazings - positions[0, 0]) < CROWDED_DISTANCE * pixel):
                continue
            grazings = np.append(grazings, positions[0, 0])
        # boxes of all offsets from all values, and what each of them hides
        half = np.array([0.36 * len(label), 0.5]) * fontsize * pixel
        middles = (positions[:, None] + pixel * LABEL_OFFSETS).reshape(-1, 1, 2)
        lower, upper = middles - half, middles + half
        free = np.all((lower > low) & (upper < high), axis=(1, 2))
        free &= ~np.any(np.all((boxes[0] < upper) & (boxes[1] > lower), axis=-1), axis=1)
        cost = np.sum(np.all((hidden > lower) & (hidden < upper), axis=-1), axis=1)
        farther = np.arange(len(free)) // len(_ASIDE) % 2
        cost = np.where(free, cost + 0.5 * farther, np.inf)
        best = int(np.argmin(cost))
        if free[best]:
            boxes = np.concatenate([boxes, [lower[best], upper[best]]], axis=1)
            style = dict(ha="center", va="center", fontsize=fontsize, color=color, zorder=5)
            which, offset = divmod(best, len(LABEL_OFFSETS))
            note = ax.annotate(label, at[which], LABEL_OFFSETS[offset], textcoords="offset points", **style)
            note.set_path_effects([withStroke(linewidth=1.5, foreground="white")])
