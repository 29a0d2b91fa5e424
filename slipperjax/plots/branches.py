"""Branches of periodic motions: stable and unstable parts, events, multipliers, and curves of events."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import Normal, withStroke

from ..analysis.events import MEANINGS
from ..flow.datasets import varied_names
from ..model.quantities import COORDINATES, SECTIONS
from ..tools.checks import one_of, require
from .maps import bifurcation, draw_attractors, draw_regimes
from .style import (
    COLORS,
    FLAGGED_LABEL,
    axis_label,
    check_dataset,
    cross,
    drawing,
    flagged,
    legend_above,
    line_color,
    shown,
    swept,
)

EVENT_MARKERS = {"LP": "D", "BP": "s", "PD": "^", "NS": "o", "GR": "|", "MX": "x"}
"""Markers of events; ends on a bound have none."""
EVENT_NAMES = {label: text.partition(":")[0] for label, text in MEANINGS.items()} | {"MX": "no convergence"}
DASHED = (0, (3.0, 1.4))
"""Line style of unstable motions; stable ones are solid."""


class Mark(NamedTuple):
    """An event in a picture: its label, the parameter [display unit], and the orbit's values there."""

    label: str
    x: float
    values: list[float]
    color: str


def branches(ds: Any, quantity: str = "v_z", brute: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Draw branches of periodic motions over a parameter: stable parts solid, unstable ones dashed, events marked.

    Colours tell periods apart. An event has a marker at each value that its orbit has, and its label beside the
    highest of them; grazings, which crowd, have no label.

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
    check_quantity(quantity)
    points = _datasets(ds, "branch", "continue_orbit", "stable", "event_point")
    name = _parameter(points)
    lines = [_lines_of(one, quantity) for one in points]
    if brute is not None:
        check_brute(brute, name, quantity)
    periods = [int(one.attrs["orbit_period"]) for one in points]
    # one colour for each period that occurs
    colors = {period: line_color(k) for k, period in enumerate(sorted(set(periods)))}
    marks: list[Mark] = []
    with drawing(ax, points[0], 3.5, 2.9) as ax:
        handles = [] if brute is None else _draw_brute(ax, brute, name, quantity)
        # the lines of all branches, and where their events lie
        for one, (threads, linked), period in zip(points, lines, periods, strict=True):
            x = shown(one, name)
            _draw_lines(ax, x, threads, linked, stable_parts(one), colors[period])
            for label, k in zip(one["event_label"].values.astype(str), one["event_point"].values, strict=True):
                # an event has as many values as its orbit has crossings
                values = threads[np.isfinite(threads[:, k]), k].tolist()
                if label in EVENT_MARKERS and values:
                    marks.append(Mark(label, float(x[k]), values, colors[period]))
        for mark in marks:
            ax.plot([mark.x] * len(mark.values), mark.values, **_marker(mark.label, mark.color), zorder=4)
            # grazings crowd, and the legend names them
            if mark.label != "GR":
                style = dict(textcoords="offset points", ha="center", fontsize=6.5, color=mark.color)
                ax.annotate(mark.label, (mark.x, max(mark.values)), (0, 4), **style)
        ax.set(xlabel=axis_label(name, points[0]), ylabel=axis_label(quantity, points[0]))
        ax.margins(x=0.03, y=0.08)
        if brute is not None:  # which may be over a wider range, where the branch has nothing to show
            values = np.concatenate([shown(one, name) for one in points])
            margin = 0.05 * np.ptp(values)
            left, right = ax.get_xlim()
            ax.set_xlim(max(values.min() - margin, left), min(values.max() + margin, right))
        # colours are explained where there are several
        if len(colors) > 1:
            handles += [Line2D([], [], color=color, lw=1.3, label=f"period {p}") for p, color in colors.items()]
        color = "black" if len(colors) > 1 else colors[periods[0]]
        handles.append(Line2D([], [], color=color, lw=1.3, label="stable"))
        handles.append(Line2D([], [], color=color, lw=0.8, ls=DASHED, label="unstable"))
        legend_above(ax, handles + _event_entries(marks))
    return ax


def check_quantity(quantity: str) -> None:
    """Raise `ValueError` where branches have no such quantity."""
    of_points = ("slowest_touchdown", "grazing_gap", "outside", "residual")
    one_of("quantity", quantity, (*SECTIONS, *(f"start_{name}" for name in COORDINATES), *of_points))


def check_brute(brute: Any, name: str, quantity: str) -> None:
    """Check that a bifurcation diagram is over a parameter and has a section.

    **Raises:** `ValueError` where not.
    """
    # simulations record sections only
    if quantity not in SECTIONS:
        raise ValueError(f"Argument `brute` must be None where `quantity` is {quantity}, which simulations lack.")
    check_dataset(brute, 'sweep with record="sections"', quantity, argument="brute")
    over = [str(d) for d in brute[quantity].dims if d != "crossing"]
    if over != [name]:
        raise ValueError(f"Argument `brute` must be swept over {name}, as the branch is, but is over {over}.")


def multiplier_circle(ds: Any, ax: Any = None) -> Any:
    """Draw Floquet multipliers of a branch in the complex plane, coloured by its parameter, with the unit circle.

    Critical multipliers of events have a marker. Multipliers of a modulus above 2 lie on an outer circle, in their
    direction.

    **Arguments:** `ds`: a branch, a result of `continue_orbit` or its dataset; `ax`: the Axes to draw into, default
    those of a new figure, with the fixed parameters as its title.

    **Returns:** the Axes.

    **Raises:** `ValueError` for another kind of dataset.
    """
    points = _datasets(ds, "branch", "continue_orbit", "stable", "event_point")
    if len(points) > 1:
        raise ValueError(f"Argument `ds` must be one branch, not {len(points)}.")
    one = points[0]
    name = _parameter(points)
    mu = (one["multiplier_real"].values + 1j * one["multiplier_imag"].values).ravel()
    # each multiplier has the parameter of its point
    values = np.repeat(shown(one, name), one.sizes["multiplier"])
    largest = float(np.max(np.abs(mu)))
    outer = 2.0
    # what lies beyond the outer circle is drawn on it
    mu = mu / np.maximum(1.0, np.abs(mu) / outer)
    limit = 1.08 * float(np.clip(largest, 1.0, outer))
    with drawing(ax, one, 4.6, 4.2) as ax:
        ax.add_patch(Circle((0, 0), 1.0, fill=False, lw=0.8, ec="black", zorder=1))
        dots = ax.scatter(mu.real, mu.imag, c=values, cmap="viridis", s=7, linewidths=0, zorder=2)
        handles = [Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], label="multiplier")]
        if largest > outer:
            ax.add_patch(Circle((0, 0), outer, fill=False, lw=0.6, ls=":", ec=COLORS["grey"], zorder=1))
            text = f"beyond, up to {largest:.3g}"
            handles.append(Line2D([], [], lw=0.6, ls=":", color=COLORS["grey"], label=text))
        marks = _critical_marks(one)
        for mark in marks:
            style = _marker(mark.label, mark.color) | dict(mfc="none", mec=mark.color, ms=6, mew=0.9)
            ax.plot([mark.x] * len(mark.values), mark.values, **style, zorder=4)
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        ax.set(xlabel="real part of multiplier", ylabel="imaginary part of multiplier")
        ax.figure.colorbar(dots, ax=ax, label=axis_label(name, one), shrink=0.85)
        legend_above(ax, handles + _event_entries(marks))
    return ax


def _critical_marks(ds: xr.Dataset) -> list[Mark]:
    """Return the critical multipliers of events, alike ones once, since all folds of a branch have +1."""
    parts = [ds[f"event_multiplier_{part}"].values.round(3).tolist() for part in ("real", "imag")]
    alike = dict.fromkeys(zip(ds["event_label"].values.astype(str), *parts, strict=True))
    marks = []
    for label, real, imaginary in alike:
        # grazings have no critical multiplier
        if label in EVENT_MARKERS and np.isfinite(real):
            # a complex one comes with its conjugate
            pair = [imaginary, -imaginary] if imaginary else [0.0]
            marks.append(Mark(label, real, pair, COLORS["red"]))
    return marks


def event_curves(ds: Any, regimes: xr.Dataset | None = None, ax: Any = None) -> Any:
    """Draw curves of folds, flips, Neimark-Sacker points and grazings over two parameters.

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
    colors = {"LP": "black", "PD": "#2a9d6f", "NS": "#7b4ea3", "GR": "#e07a1f"}
    curves = _datasets(ds, "curve", "continue_event", "outside")
    over = varied_names(curves[0])
    for one in curves:
        label = one.attrs.get("label")
        names = varied_names(one)
        # of a known label, and over the same plane as the first
        good = label in colors and len(names) == 2 and set(names) == set(over)
        need = f"be curves of {', '.join(colors)} over the same two parameters"
        require(good, "ds", need, shown=f"of {label} over {' and '.join(names)}")
    if regimes is not None:
        over = _map_parameters(regimes, over)
    base = curves[0] if regimes is None else regimes
    with drawing(ax, base, 3.5, 3.3 if regimes is None else 3.9) as ax:
        handles = []
        if regimes is None:
            ax.set(xlabel=axis_label(over[1], base), ylabel=axis_label(over[0], base))
            ax.margins(0.05)
        else:
            handles = (draw_regimes if "regime" in regimes else draw_attractors)(regimes, over, ax)
            ax.axis(ax.axis())  # only the area of the map is shown
        entries = {}
        for one in curves:
            label = one.attrs["label"]
            color = colors[label]
            _draw_curve(ax, one, over, color)
            # one entry for all curves of a label
            entries[label] = Line2D([], [], color=color, lw=1.4, label=f"{label} {EVENT_NAMES[label]}")
        if any(np.any(one["outside"].values) for one in curves):
            entries["outside"] = Line2D([], [], color="black", lw=1.1, ls=DASHED, label="others outside, too")
        legend_above(ax, [*entries.values(), *handles])
    return ax


def _map_parameters(regimes: xr.Dataset, over: Sequence[str]) -> Sequence[str]:
    """Return the parameters of a map, the one upwards first; raise `ValueError` where the curves have others."""
    kinds = isinstance(regimes, xr.Dataset) and "regime" not in regimes and "kind" in regimes
    name = "kind" if kinds else "regime"
    check_dataset(regimes, "lyapunov_sweep", name)
    own = swept(regimes[name], count=2)
    if set(own) != set(over):
        names = f"{' and '.join(over)}, as the curves are, but is over {' and '.join(own)}"
        raise ValueError(f"Argument `regimes` must be swept over {names}.")
    return own


def _draw_curve(ax: Any, ds: xr.Dataset, over: Sequence[str], color: str) -> None:
    """Draw one curve, its points in their order; a part is solid where both its ends are. Name a longer period."""
    x = shown(ds, over[1])
    y = shown(ds, over[0])
    # where the curve bounds a stable motion
    single = ds["outside"].values == 0
    solid = single[1:] & single[:-1]
    halo = [withStroke(linewidth=2.6, foreground="white"), Normal()]
    style: dict[str, Any] = dict(color=color, zorder=4, path_effects=halo)
    ax.plot(*joined(x, y[None], solid), lw=1.4, **style)
    ax.plot(*joined(x, y[None], ~solid), lw=1.1, ls=DASHED, **style)
    period = int(ds.attrs.get("orbit_period", 1))
    # the label stands in the middle of what is seen
    inside = [k for k in range(len(x)) if ax.viewLim.contains(x[k], y[k])]
    if period > 1 and inside:
        middle = inside[len(inside) // 2]
        offset: dict[str, Any] = dict(xytext=(4, 4), textcoords="offset points", fontsize=6.5)
        ax.annotate(f"of period {period}", (x[middle], y[middle]), **offset, **style)


def _event_entries(marks: Sequence[Mark]) -> list[Line2D]:
    """Return entries of a legend with the meaning of labels."""
    used = {mark.label for mark in marks}
    names = [label for label in EVENT_MARKERS if label in used]
    return [Line2D([], [], **_marker(label, "black"), label=f"{label} {EVENT_NAMES[label]}") for label in names]


def _datasets(ds: Any, kind: str, source: str, *names: str) -> list[xr.Dataset]:
    """Return the datasets, with the variables `names`, of one result or several."""
    # one result is a list of one
    several = list(ds) if isinstance(ds, list | tuple) else [ds]
    if not several:
        raise ValueError(f"Argument `ds` must be one {kind} or more, not 0.")
    return [check_dataset(one, source, *names) for one in several]


def _parameter(points: Sequence[xr.Dataset]) -> str:
    """Return the parameter of all branches."""
    names = {varied_names(one)[0] for one in points}
    if len(names) > 1:
        raise ValueError(f"Argument `ds` must be branches over one parameter, but they are over {sorted(names)}.")
    return names.pop()


def start_of(ds: xr.Dataset, coordinate: str) -> np.ndarray:
    """Return a coordinate of a branch's orbits at the start of their periods [display unit], (points,)."""
    start = ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate)
    return COORDINATES[coordinate].shown(start.values)


def _lines_of(ds: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return lines of a branch (lines, points) [display unit], NaN for none, and the parts to draw (points - 1,)."""
    # by default all neighbours are joined
    linked = np.ones(ds.sizes["point"] - 1, bool)
    if name in SECTIONS:
        check_dataset(ds, "continue_orbit", name, f"{name}_period")
        velocity, time = (ds[n].transpose("point", "crossing").values for n in (name, f"{name}_period"))
        return crossing_threads(velocity, time, int(ds.attrs["orbit_period"])), linked
    if name.startswith("start_"):
        return start_of(ds, name.removeprefix("start_"))[None], linked
    check_dataset(ds, "continue_orbit", name)
    if name == "slowest_touchdown":  # it becomes another one where a touchdown comes or goes
        linked = np.all(np.diff(ds["touchdowns"].values.reshape(len(linked) + 1, -1), axis=0) == 0, axis=1)
    values = shown(ds, name)
    return np.where(np.isfinite(values), values, np.nan)[None], linked


def crossing_threads(
    velocity: np.ndarray, time: np.ndarray, period: int, *, velocity_jump: float = 0.8, time_jump: float = 0.1
) -> np.ndarray:
    """Return the velocities of a section's crossings as lines (lines, points), NaN where a line is absent.

    The number of crossings changes from point to point, and their order where one appears or passes the start of the
    period. Those of neighbouring points are matched by velocity and time; where the match is poor, a line ends and
    another begins.

    **Arguments:** `velocity` (points, crossings), NaN where there are fewer; `time` [forcing periods], likewise;
    `period`: after which the orbits recur [forcing periods]; `velocity_jump`: change over the larger velocity, and
    `time_jump`: change of the time [forcing periods], beyond which neighbours do not match.
    """
    from scipy.optimize import linear_sum_assignment  # here, because its import takes long

    finite = np.isfinite(velocity)
    points = len(velocity)
    # a twentieth of all velocities' range is no jump, however small the velocities are
    small = max(0.05 * float(np.ptp(velocity[finite])), 1e-300) if finite.any() else 1.0
    lines = np.full((0, 2, points), np.nan)  # velocities and times
    # go along the branch, and continue the lines that reach its last point
    for k, present in enumerate(finite):
        v = velocity[k, present]
        t = time[k, present]
        alive = np.flatnonzero(np.isfinite(lines[:, 0, k - 1]))
        v_before, t_before = lines[alive, :, k - 1].T[..., None]
        jump = (v - v_before) / np.maximum(velocity_jump * np.maximum(np.abs(v), np.abs(v_before)), small)
        # the shorter way around the period
        shift = ((t - t_before + period / 2) % period - period / 2) / time_jump
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
    """Return whether a branch is stable between its points, of shape (points - 1,).

    An event has multipliers on the unit circle, or those of one side of a grazing: its other neighbour decides.
    """
    stable = ds["stable"].values.astype(bool)
    event = ds["label"].values.astype(str) != ""
    ahead, behind = stable[1:], stable[:-1]
    return np.where(event[:-1] & ~event[1:], ahead, np.where(event[1:] & ~event[:-1], behind, ahead & behind))


def _ends(threads: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whether a part of a line ends at each of its points, and whether one begins there, (lines, points)."""
    finite = np.isfinite(threads)
    # a part needs both its ends
    drawn = parts & finite[:, 1:] & finite[:, :-1]
    return np.pad(drawn, ((0, 0), (1, 0))), np.pad(drawn, ((0, 0), (0, 1)))


def joined(x: np.ndarray, threads: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return one curve of the chosen `parts` (points - 1,) of lines (lines, points), with NaN after each.

    **Arguments:** `x`: (points,).
    """
    end, begin = _ends(threads, parts)
    # each point that a part touches, and a NaN after it where no part goes on
    keep = np.stack([end | begin, end & ~begin], axis=-1)
    gap = np.full(threads.shape, np.nan)
    xs = np.broadcast_to(x, threads.shape)
    return np.stack([xs, gap], axis=-1)[keep], np.stack([threads, gap], axis=-1)[keep]


def _draw_lines(
    ax: Any, x: np.ndarray, threads: np.ndarray, linked: np.ndarray, stable: np.ndarray, color: str
) -> None:
    """Draw the stable and the unstable parts; a value without neighbours is a dot."""
    style: dict[str, Any] = dict(color=color, zorder=3, solid_capstyle="butt")
    ax.plot(*joined(x, threads, linked & ~stable), lw=0.8, ls=DASHED, **style)
    ax.plot(*joined(x, threads, linked & stable), lw=1.3, **style)
    # single points have no part, and would not be seen
    end, begin = _ends(threads, linked)
    line, point = np.nonzero(np.isfinite(threads) & ~end & ~begin)
    if len(line):
        ax.plot(x[point], threads[line, point], ".", ms=2, mew=0, color=color, zorder=3)


def _draw_brute(ax: Any, brute: xr.Dataset, name: str, quantity: str) -> list[Any]:
    """Draw grey dots of simulations; return the entries of the legend."""
    bifurcation(brute, quantity, ax, color=COLORS["grey"], zorder=1, ms=3.4)
    dots = Line2D([], [], ls="", marker=".", ms=5, color=COLORS["grey"], mew=0, label="from simulation")
    return [dots] + [cross(label=FLAGGED_LABEL)] * bool(flagged(brute, name).any())


def _marker(label: str, color: str) -> dict[str, Any]:
    """Return the style of an event's marker."""
    # filled markers have a white edge, which parts them from lines
    marker = EVENT_MARKERS[label]
    if marker in "|x":  # lines without an area
        return dict(ls="", marker=marker, ms=5.5, mew=0.9, mec=color)
    return dict(ls="", marker=marker, ms=4.4, mew=0.6, mec="white", mfc=color)
