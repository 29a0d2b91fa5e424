"""Points of error against cost, as a table and as pictures."""

import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..plots.style import png
from ..tools.files import table_lines, write_each


class Point(NamedTuple):
    """One measured point."""

    case: str
    method: str
    setting: str
    error: float
    """Median over the batch of the worst scaled error; infinite where a case left the finite numbers."""
    cost: dict[int, tuple[float, float]]
    """Best and median microseconds per trajectory and period, by the number of trajectories at once."""


MBDYN = {"nominal": 5.9e-3, "V = 2300 m/s": 6.8e-3, "C = 4 mm": 4.6e-2}
"""MBDyn's error over six periods at the paper's 1000 steps per period, by scene."""
MBDYN_NAME = "MBDyn (measured elsewhere)"
MBDYN_MS = {"fastest settings": 24.3, "default Newton": 108.0}
"""Its milliseconds per period on one core. Measured once, and not in the run that shows them."""


def mbdyn_points(scenes: Iterable[str]) -> list[Point]:
    """Gives MBDyn's points for scenes by name. They are quoted, not measured by the benchmark."""
    return [
        Point(scene, MBDYN_NAME, f"1000 steps, {settings}", MBDYN[scene], {1: (1e3 * ms,) * 2})
        for scene in scenes
        if scene in MBDYN
        for settings, ms in MBDYN_MS.items()
    ]


def cost_at(points: Iterable[Point], error: float, lanes: int) -> float:
    """Gives the microseconds per trajectory and period at which a method reaches an error, by its best times.

    Between points logarithms are interpolated; infinite where no point is that accurate.
    """
    rows = sorted((p.error, p.cost[lanes][0]) for p in points if lanes in p.cost and np.isfinite(p.error))
    accurate = [(e, c) for e, c in rows if e <= error]
    if not accurate:
        return float("inf")
    best = min(c for _, c in accurate)
    for (e0, c0), (e1, c1) in itertools.pairwise(rows):
        if e0 <= error < e1 and c1 < c0:
            share = np.log(error / e0) / np.log(e1 / e0)
            best = min(best, float(np.exp((1 - share) * np.log(c0) + share * np.log(c1))))
    return best


def table(points: list[Point], batches: tuple[int, ...]) -> str:
    """Gives all points as a Markdown table, then the cost of an error of 1e-3."""
    shown = lambda p, n: f"{p.cost[n][0]:.3g} ({p.cost[n][1]:.3g})" if n in p.cost else "-"
    every = [
        dict(scene=p.case, method=p.method, setting=p.setting, error=f"{p.error:.1e}")
        | {f"us at {n}, best (median)": shown(p, n) for n in batches}
        for p in points
    ]
    at_error = []
    for name in dict.fromkeys(p.method for p in points):
        row = dict(method=name)
        for case, n in itertools.product(dict.fromkeys(p.case for p in points), batches):
            cost = cost_at([p for p in points if (p.case, p.method) == (case, name)], 1e-3, n)
            row[f"{case}, {n} at once"] = f"{cost:.3g}" if np.isfinite(cost) else "-"
        at_error.append(row)
    said = "Microseconds per trajectory and period at a scaled error of 1e-3 (best times, interpolated):"
    return "\n".join([*table_lines(every), "", said, "", *table_lines(at_error)]) + "\n"


SHOWN = {
    "RK4": ("RK4", "#12355b"),
    "ImpulseRK4": ("ImpulseRK4", "#c2410c"),
    "Tsit5": ("Tsit5", "#2a9d6f"),
    "Rodas4": ("Rodas4", "#8338ec"),
    "smooth: RK4": ("RK4, smooth switch", "#4f86c6"),
    "diffrax Kvaerno5": ("diffrax Kvaerno5,\nlatched", "#e07a1f"),
    "smooth: diffrax Kvaerno5, adaptive": ("diffrax Kvaerno5,\nsmooth switch,\nadaptive", "#c1121f"),
}
"""Methods in the picture for reading, with their labels and colours."""
OTHERS = {MBDYN_NAME: ("MBDyn,\nmeasured elsewhere", "black")}
"""Other codes in it, drawn as points: they run one trajectory at a time."""


def draw(
    points: list[Point],
    batches: tuple[int, ...],
    scene: str = "nominal",
    *,
    others: Mapping[str, tuple[str, str]] = OTHERS,
) -> Any:
    """Draws error against cost on one scene: a few methods, labelled at their lines. See `draw_all` for all.

    **Arguments:** `batches`: the first is drawn; `scene`: by name, the first measured one where it has no points;
    `others`: as `OTHERS`. Where none of `SHOWN` was measured, the methods that were are drawn instead.

    **Returns:** the Axes.
    """
    import matplotlib.pyplot as plt

    measured = list(dict.fromkeys(p.case for p in points))
    scene = scene if scene in measured or not measured else measured[0]
    mine = [p for p in points if p.case == scene]
    names = list(dict.fromkeys(p.method for p in mine))
    shown = {name: look for name, look in SHOWN.items() if name in names}
    if not shown:
        shown = {name: (name, f"C{k % 10}") for k, name in enumerate(n for n in names if n not in others)}
    _, ax = plt.subplots(figsize=(7.2, 4.8), layout="constrained")
    ax.set(xscale="log", yscale="log", xlabel="µs per trajectory and forcing period")
    ax.set_ylabel("error in units of 1 mm, 10 mrad, 1 m/s, 10 rad/s")
    ax.set_title(f"{scene}: {batches[0]} trajectories at once, other codes one by one", fontsize=9, loc="left")
    ax.grid(alpha=0.25, linewidth=0.4)
    for name, (label, color) in (shown | dict(others)).items():
        lanes, style = (1, "D") if name in others else (batches[0], "o-")
        x, y = _curve([p for p in mine if p.method == name], lanes)
        if len(x):
            ax.plot(x, y, style, color=color, markersize=4, linewidth=1.4, label=label)
    ax.margins(0.08)
    _label(ax)
    return ax


def _curve(points: Iterable[Point], lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Gives cost and error of the points that can be drawn on logarithmic axes."""
    rows = [(p.cost[lanes][0], p.error) for p in points if lanes in p.cost and 0 < p.error < np.inf]
    cost, error = np.array(rows).reshape(-1, 2).T
    return cost, error


def _label(ax: Any) -> None:
    """Writes the label of each line beside one of its points, where it covers as little as possible."""
    ax.figure.draw_without_rendering()  # settles the layout
    frame, boxes = ax.get_window_extent().padded(-4), []
    # points on all lines in pixels, 40 on each piece of a line that joins its points
    paths = [line.get_path().transformed(ax.transData) for line in ax.lines]
    pieces = [1 if line.get_linestyle() == "None" else 40 for line in ax.lines]
    ink = np.concatenate(
        [np.empty((0, 2)), *(p.interpolated(n).vertices for p, n in zip(paths, pieces, strict=True))]
    )
    for line in ax.lines:
        style = dict(textcoords="offset points", color=line.get_color(), fontsize=8)
        label = ax.annotate(line.get_label(), line.get_xydata()[0], (0, 0), **style)
        label.set_in_layout(False)

        def put(position: Any, label: Any = label) -> Any:
            """Moves the label to an offset from a point, and gives its box in pixels."""
            label.xy, (ha, va, x, y) = position
            label.set(position=(x, y), ha=ha, va=va)
            return label.get_window_extent()

        def hidden(position: Any, put: Callable = put) -> Any:
            """Counts points of curves under the label; other labels, and the outside of the frame, count for many."""
            box = put(position)
            outside = frame.count_contains(box.corners()) < 4
            return box.padded(2).count_contains(ink) + 1000 * (sum(map(box.overlaps, boxes)) + outside)

        boxes.append(put(min(itertools.product(line.get_xydata(), _OFFSETS), key=hidden)))


_OFFSETS = (
    ("left", "center", 7, 0),
    ("right", "center", -7, 0),
    ("left", "bottom", 5, 4),
    ("right", "top", -5, -4),
    ("center", "bottom", 0, 6),
    ("center", "top", 0, -6),
)
"""Alignment of a label and its distance from its point [typographic points], the preferred ones first."""


LINES = {"full": "-", "dashed": "--", "dotted": ":"}
"""Line styles of the batches in `draw_all`, by their names."""


def draw_all(points: list[Point], batches: tuple[int, ...]) -> Any:
    """Draws error against cost of every method, a panel per scene, with full, dashed and dotted lines for batches.

    **Returns:** the axes, an array.
    """
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(p.case for p in points))
    methods = list(dict.fromkeys(p.method for p in points))
    columns = max(1, min(4, len(names)))
    rows = max(1, -(-len(names) // columns))
    size = (max(4.2 * columns, 10), 3.6 * rows + 2.4)  # wide enough for the legend, too
    figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    handles = {}
    for ax, name in zip(axes.flat, names, strict=False):
        for k, method in enumerate(methods):
            mine = [p for p in points if p.case == name and p.method == method]
            marker = "osD"[k // 10 % 3]  # there are ten colours
            for lanes, style in zip(batches, LINES.values(), strict=False):
                x, y = _curve(mine, lanes)
                if len(x):
                    (line,) = ax.plot(x, y, style + marker, color=f"C{k % 10}", markersize=4, linewidth=1)
                    handles.setdefault(method, line)
        ax.set(xscale="log", yscale="log", title=name, xlabel="µs per trajectory and period", ylabel="scaled error")
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(names) :]:
        ax.set_axis_off()
    marks = ", ".join(f"{line}: {n} at once" for n, line in zip(batches, LINES, strict=False))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, title=marks)
    return axes


def write(points: list[Point], batches: tuple[int, ...], out: Path, **options: Any) -> tuple[Path, Path, Path]:
    """Writes OUT.md, OUT.png of `draw` with its options and OUT_all.png of `draw_all`, and gives their paths."""
    text, picture, everything = Path(f"{out}.md"), Path(f"{out}.png"), Path(f"{out}_all.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    drawn = lambda drawing, **options: lambda: png(np.ravel(drawing(points, batches, **options))[0].figure, 150)
    write_each({text: table(points, batches).encode, picture: drawn(draw, **options), everything: drawn(draw_all)})
    return text, picture, everything
