"""Branches of periodic motions: stable and unstable parts, events, multipliers, and curves of events."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import Normal, withStroke
from matplotlib.transforms import Bbox

from ..analysis.events import MEANINGS
from ..flow.datasets import varied_names
from ..model.parameters import quantity as registered
from ..model.quantities import COORDINATES, SECTIONS
from ..tools.checks import instance, one_of, require
from .maps import bifurcation, draw_attractors, draw_regimes
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
FONT_SIZE = 6.5
"""Size of labels [points]."""
LABEL_DISTANCES = (8.0, 13.0)
"""Distances [points] of labels from their markers, the best first."""
LABEL_DIRECTIONS = ((0, 1), (0, -1), (1.2, 0), (-1.2, 0), (0.9, 0.8), (-0.9, 0.8), (0.9, -0.8), (-0.9, -0.8))
_POINT_VALUES = "slowest_touchdown", "grazing_gap", "outside", "residual"
QUANTITIES = (*SECTIONS, *(f"start_{name}" for name in COORDINATES), *_POINT_VALUES)
"""Variables of `continue_orbit` that can be drawn."""


class Mark(NamedTuple):
    """An event in a picture: its label, the parameter [display unit], and the orbit's values there."""

    label: str
    x: float
    values: list[float]
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
    instance("quantity", quantity, str, "the name of a variable")
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
        if brute is not None:  # which may be over a wider range, where the branch has nothing to show
            values = np.concatenate([shown(one, name) for one in points])
            ends, margin = (values.min(), values.max()), 0.05 * np.ptp(values)
            ax.set_xlim(max(ends[0] - margin, ax.get_xlim()[0]), min(ends[1] + margin, ax.get_xlim()[1]))
        several = len(colors) > 1
        handles += [Line2D([], [], color=colors[p], lw=1.3, label=f"period {p}") for p in order if several]
        for text, style in (("stable", dict(lw=1.3, ls=SOLID)), ("unstable", dict(lw=0.8, ls=DASHED))):
            handles.append(Line2D([], [], color="black" if several else colors[order[0]], label=text, **style))
        legend_above(ax, handles + _event_entries(marks))
        write_labels(ax, marks)
    return ax


def check_quantity(quantity: str) -> None:
    """Raises `ValueError` where branches have no such quantity."""
    one_of("quantity", quantity, tuple(QUANTITIES))


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

    Critical multipliers of events have a marker and a label. Multipliers of a modulus above 2 lie on an outer circle,
    in their direction.

    **Arguments:** `ds`: a branch, a result of `continue_orbit` or its dataset; `ax`: the Axes to draw into, default
    those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    points = _datasets(ds, "branch", "continue_orbit", "stable", "event_point")
    if len(points) > 1:
        raise ValueError(f"Argument `ds` must be one branch, not {len(points)}.")
    (one,), name = points, _parameter(points)
    mu = (one["multiplier_real"].values + 1j * one["multiplier_imag"].values).ravel()
    values, modulus = np.repeat(shown(one, name), one.sizes["multiplier"]), np.abs(mu)
    reach = min(LARGEST_MODULUS, max(1.0, float(np.max(modulus))))
    mu = mu / np.maximum(1.0, modulus / LARGEST_MODULUS)
    with drawing(ax, one, 4.6, 4.2) as ax:
        ax.add_patch(Circle((0, 0), 1.0, fill=False, lw=0.8, ec="black", zorder=1))
        dots = ax.scatter(mu.real, mu.imag, c=values, cmap="viridis", s=7, linewidths=0, zorder=2)
        handles = [Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], label="multiplier")]
        if np.max(modulus) > LARGEST_MODULUS:
            ax.add_patch(Circle((0, 0), LARGEST_MODULUS, fill=False, lw=0.6, ls=":", ec=COLORS["grey"], zorder=1))
            text = f"beyond, up to {np.max(modulus):.3g}"
            handles.append(Line2D([], [], lw=0.6, ls=":", color=COLORS["grey"], label=text))
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
    over = varied_names(curves[0])
    for one in curves:
        label, names = one.attrs.get("label"), varied_names(one)
        require(label in CURVE_COLORS, "ds", f"have a label of {', '.join(CURVE_COLORS)}", label)
        if len(names) != 2:
            raise ValueError(f"Argument `ds` must be a curve over two parameters, but is over {names}.")
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
        used = {one.attrs["label"] for one in curves}
        entries = [
            Line2D([], [], color=color, lw=1.4, label=f"{label} {EVENT_NAMES[label]}")
            for label, color in CURVE_COLORS.items()
            if label in used
        ]
        if any(np.any(one["outside"].values) for one in curves):
            entries.append(Line2D([], [], color="black", lw=1.1, ls=DASHED, label="others outside, too"))
        legend_above(ax, entries + handles)
        write_labels(ax, [mark for one in curves for mark in _curve_marks(ax, one, over)])
    return ax


def _map_parameters(regimes: xr.Dataset, over: Sequence[str]) -> Sequence[str]:
    """Gives the parameters of a map, the one upwards first; raises `ValueError` where the curves have others."""
    kinds = isinstance(regimes, xr.Dataset) and "regime" not in regimes and "kind" in regimes
    check_dataset(regimes, "lyapunov_sweep", "kind" if kinds else "regime")
    own = swept(regimes["kind" if kinds else "regime"], count=2)
    if set(own) != set(over):
        names = f"{' and '.join(over)}, as the curves are, but is over {' and '.join(own)}"
        raise ValueError(f"Argument `regimes` must be swept over {names}.")
    return own


def _draw_curve(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> None:
    """Draws one curve, its points in their order; a part is solid where both its ends are."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    single = ds["outside"].values == 0
    solid = single[1:] & single[:-1]
    style = dict(color=CURVE_COLORS[ds.attrs["label"]], zorder=4)
    style["path_effects"] = [withStroke(linewidth=2.6, foreground="white"), Normal()]
    ax.plot(*joined(x, y[None], solid), lw=1.4, ls=SOLID, **style)
    ax.plot(*joined(x, y[None], ~solid), lw=1.1, ls=DASHED, **style)


def _curve_marks(ax: Any, ds: xr.Dataset, over: Sequence[str]) -> list[Mark]:
    """Gives the event's name at the middle of a curve's part inside the axes, of its solid part if it has one."""
    x, y = shown(ds, over[1]), shown(ds, over[0])
    index = [k for k in range(len(x)) if ax.viewLim.contains(x[k], y[k])]
    index = [k for k in index if ds["outside"].values[k] == 0] or index
    if not index:
        return []
    label, period, middle = ds.attrs["label"], int(ds.attrs.get("orbit_period", 1)), index[len(index) // 2]
    text = label + (f" of period {period}" if period > 1 else "")
    return [Mark(text, float(x[middle]), [float(y[middle])], CURVE_COLORS[label])]


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
    return [check_dataset(one, source, *names) for one in several]


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
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    finite, points = np.isfinite(velocity), len(velocity)
    small = max(SMALL_JUMP * float(np.ptp(velocity[finite])), 1e-300) if finite.any() else 1.0
    lines = np.full((0, 2, points), np.nan)  # velocities and times
    for k, present in enumerate(finite):
        v, t = velocity[k, present], time[k, present]
        alive = np.flatnonzero(np.isfinite(lines[:, 0, k - 1]))
        v_before, t_before = lines[alive, :, k - 1].T[..., None]
        jump = (v - v_before) / np.maximum(VELOCITY_JUMP * np.maximum(np.abs(v), np.abs(v_before)), small)
        shift = ((t - t_before + period / 2) % period - period / 2) / TIME_JUMP
        cost = np.hypot(jump, shift)
        old, new = linear_sum_assignment(np.where(cost <= 1, cost, 1e6))  # at any price as many matches as possible
        matched = cost[old, new] <= 1
        line = np.full(len(v), -1)
        line[new[matched]] = alive[old[matched]]
        # crossings without a match begin a line
        begun = np.flatnonzero(line < 0)
        line[begun] = len(lines) + np.arange(len(begun))
        lines = np.concatenate([lines, np.full((len(begun), 2, points), np.nan)])
        lines[line, :, k] = np.stack([v, t], axis=1)
    return lines[:, 0]


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


def write_labels(ax: Any, marks: Iterable[Mark]) -> None:
    """Writes labels next to the markers, where they hide neither each other nor, if possible, a line.

    Where grazings crowd, one label stands for them.
    """
    layout_now(ax.figure.canvas.figure)
    pixel = ax.figure.dpi / 72
    frame = ax.get_window_extent().padded(-1.5 * pixel)
    lines = [line for line in ax.lines if line.get_zorder() >= 3 and len(line.get_xdata())]
    # points between the ends of long segments may be hidden, too
    paths = [line.get_path().interpolated(1 if line.get_linestyle() == "None" else 32) for line in lines]
    drawn = ax.transData.transform(np.concatenate([np.zeros((0, 2)), *(path.vertices for path in paths)]))
    boxes: list[Bbox] = []
    grazings: list[float] = []
    for label, x, values, color in sorted(marks, key=lambda mark: mark.label == "GR"):
        x_drawn = ax.transData.transform((x, values[0]))[0]
        if label == "GR":
            if any(abs(x_drawn - other) < CROWDED_DISTANCE * pixel for other in grazings):
                continue
            grazings.append(x_drawn)
        half, places = pixel * FONT_SIZE * np.array([0.36 * len(label), 0.5]), []
        values = sorted(values, reverse=True)
        for distance, value, direction in itertools.product(LABEL_DISTANCES, values, LABEL_DIRECTIONS):
            offset = distance * np.array(direction)
            middle = ax.transData.transform((x, value)) + pixel * offset
            box = Bbox([middle - half, middle + half])
            inside = frame.contains(*box.min) and frame.contains(*box.max)
            if inside and not any(box.overlaps(other) for other in boxes):
                places.append((box.count_contains(drawn), box, value, offset))
        if places:
            # the first of those that hide least
            _, box, value, offset = min(places, key=lambda place: place[0])
            boxes.append(box)
            style = dict(ha="center", va="center", fontsize=FONT_SIZE, color=color, zorder=5)
            note = ax.annotate(label, (x, value), offset, textcoords="offset points", **style)
            note.set_path_effects([withStroke(linewidth=1.5, foreground="white")])
