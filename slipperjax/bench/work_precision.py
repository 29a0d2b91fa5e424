"""Points of error against cost, as a table and as pictures."""

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..plots.style import png
from ..tools.files import write_each


class Point(NamedTuple):
    """One measured point."""

    case: str
    method: str
    setting: str
    error: float
    """Median over the batch of the worst scaled error; infinite where a case left the finite numbers."""
    cost: dict[int, tuple[float, float]]
    """Best and median microseconds per trajectory and period, by the number of trajectories at once."""


MBDYN = {
    "nominal": 5.9e-3,
    "V = 2300 m/s": 6.8e-3,
    "C = 4 mm": 4.6e-2,
}
"""MBDyn's error over six periods at the paper's 1000 steps per period, by scene."""
MBDYN_NAME = "MBDyn (measured elsewhere)"
MBDYN_MS = {"fastest settings": 24.3, "default Newton": 108.0}
"""Its milliseconds per period on one core. Measured once, and not in the run that shows them."""


def mbdyn_points(scenes: Iterable[str]) -> list[Point]:
    """MBDyn's points for scenes by name. They are quoted, not measured by the benchmark."""
    return [
        Point(scene, MBDYN_NAME, f"1000 steps, {how}", MBDYN[scene], {1: (1e3 * ms,) * 2})
        for scene in scenes
        if scene in MBDYN
        for how, ms in MBDYN_MS.items()
    ]


def cost_at(points: Iterable[Point], error: float, lanes: int) -> float:
    """Microseconds per trajectory and period at which a method reaches an error, by its best times.

    Between points logarithms are interpolated; infinite where no point is that accurate.
    """
    known = sorted((p.error, p.cost[lanes][0]) for p in points if lanes in p.cost and np.isfinite(p.error))
    reach = [(e, c) for e, c in known if e <= error]
    if not reach:
        return float("inf")
    best = min(c for _, c in reach)
    for (e0, c0), (e1, c1) in itertools.pairwise(known):
        if e0 <= error < e1 and c1 < c0:
            share = np.log(error / e0) / np.log(e1 / e0)
            best = min(best, float(np.exp((1 - share) * np.log(c0) + share * np.log(c1))))
    return best


def table(points: list[Point], batches: tuple[int, ...]) -> str:
    """All points as a Markdown table, then what an error of 1e-3 costs."""
    heads = [f"us at {n}, best (median)" for n in batches]
    lines = [f"| scene | method | setting | error | {' | '.join(heads)} |", "|---" * (4 + len(batches)) + "|"]
    for p in points:
        cells = ["-" if n not in p.cost else f"{p.cost[n][0]:.3g} ({p.cost[n][1]:.3g})" for n in batches]
        lines.append(f"| {p.case} | {p.method} | {p.setting} | {p.error:.1e} | {' | '.join(cells)} |")
    cases = list(dict.fromkeys(p.case for p in points))
    heads = [f"{case}, {n} at once" for case in cases for n in batches]
    lines += [
        "",
        "Microseconds per trajectory and period at a scaled error of 1e-3 (best times, interpolated):",
        "",
        f"| method | {' | '.join(heads)} |",
        "|---" * (1 + len(heads)) + "|",
    ]
    for name in dict.fromkeys(p.method for p in points):
        values = [
            cost_at([p for p in points if (p.case, p.method) == (c, name)], 1e-3, n) for c in cases for n in batches
        ]
        lines.append(f"| {name} | " + " | ".join(f"{v:.3g}" if np.isfinite(v) else "-" for v in values) + " |")
    return "\n".join(lines) + "\n"


SHOWN = {
    "RK4": ("RK4", "#12355b"),
    "Tsit5": ("Tsit5", "#2a9d6f"),
    "Rodas4": ("Rodas4", "#8338ec"),
    "smooth: RK4": ("RK4, smooth switch", "#4f86c6"),
    "diffrax Kvaerno5": ("diffrax Kvaerno5,\nlatched", "#e07a1f"),
    "smooth: diffrax Kvaerno5, adaptive": ("diffrax Kvaerno5,\nsmooth switch,\nadaptive", "#c1121f"),
}
"""Methods in the picture for reading, with their labels and colours."""
OTHERS = {
    "C++ scalar, RK4, event latch": ("C++, one core", "#606060"),
    MBDYN_NAME: ("MBDyn,\nmeasured elsewhere", "black"),
}
"""Other codes in it, drawn as points: they run one trajectory at a time."""


def draw(points: list[Point], batches: tuple[int, ...], scene: str = "nominal") -> Any:
    """Error against cost on one scene: a few methods, labelled at their lines. See `draw_all` for everything.

    **Arguments:** `batches`: the first is drawn; `scene`: by name, the first measured one where it has no points.
    Where none of `SHOWN` was measured, the methods that were are drawn instead.

    **Returns:** the Axes.
    """
    import matplotlib.pyplot as plt

    measured = list(dict.fromkeys(p.case for p in points))
    scene = scene if scene in measured or not measured else measured[0]
    mine = [p for p in points if p.case == scene]
    names = list(dict.fromkeys(p.method for p in mine))
    shown = {name: look for name, look in SHOWN.items() if name in names}
    if not shown:
        shown = {name: (name, f"C{k % 10}") for k, name in enumerate(n for n in names if n not in OTHERS)}
    _, ax = plt.subplots(figsize=(7.2, 4.8), layout="constrained")
    ax.set(xscale="log", yscale="log", xlabel="µs per trajectory and forcing period")
    ax.set_ylabel("error in units of 1 mm, 10 mrad, 1 m/s, 10 rad/s")
    ax.set_title(f"{scene}: {batches[0]} trajectories at once, other codes one by one", fontsize=9, loc="left")
    ax.grid(alpha=0.25, linewidth=0.4)
    drawn = []
    for name, (label, color) in (shown | OTHERS).items():
        lanes, style = (1, "D") if name in OTHERS else (batches[0], "o-")
        x, y = _curve([p for p in mine if p.method == name], lanes)
        if len(x):
            ax.plot(x, y, style, color=color, markersize=4, linewidth=1.4)
            drawn.append((label, color, np.stack([x, y], axis=1), name not in OTHERS))
    ax.margins(0.08)
    _label(ax, drawn)
    return ax


def _curve(points: Iterable[Point], lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Cost and error of the points that can be drawn on logarithmic axes."""
    found = [(p.cost[lanes][0], p.error) for p in points if lanes in p.cost and 0 < p.error < np.inf]
    cost, error = np.array(found).reshape(-1, 2).T
    return cost, error


def _label(ax: Any, drawn: list[tuple[str, str, np.ndarray, bool]]) -> None:
    """Writes each label beside a point of its curve, where it covers as little as possible.

    **Arguments:** `drawn`: label, colour, points (n, 2) in data coordinates, and whether they are joined by a line.
    """
    figure = ax.figure
    figure.draw_without_rendering()  # settles the layout
    frame = ax.get_window_extent()
    curves = [ax.transData.transform(at) for _, _, at, _ in drawn]
    joined = [_dense(at) if lines else at for at, (*_, lines) in zip(curves, drawn, strict=True)]
    ink, boxes = np.concatenate([np.empty((0, 2)), *joined]), []
    for (text, color, data, _), curve in zip(drawn, curves, strict=True):
        found = ax.annotate(text, data[0], (0, 0), textcoords="offset points", color=color, fontsize=8)
        found.set_in_layout(False)
        size = found.get_window_extent()
        best = None
        for at in range(len(data)):
            for ha, va, x, y in _OFFSETS:
                left = curve[at][0] + x * figure.dpi / 72 - {"left": 0, "center": 0.5, "right": 1}[ha] * size.width
                low = curve[at][1] + y * figure.dpi / 72 - {"bottom": 0, "center": 0.5, "top": 1}[va] * size.height
                box = np.array([left, low, left + size.width, low + size.height])
                cost = np.sum(_inside(ink, box)) + 1000 * sum(_overlap(box, other) for other in boxes)
                outside = left < frame.x0 or box[2] > frame.x1 or low < frame.y0 or box[3] > frame.y1
                cost += 1000 * outside
                if best is None or cost < best[0]:
                    best = cost, at, (ha, va, x, y), box
        assert best is not None
        _, at, (ha, va, x, y), box = best
        found.xy = tuple(data[at])
        found.set(position=(x, y), ha=ha, va=va)
        boxes.append(box)


_OFFSETS = (
    ("left", "center", 7, 0),
    ("right", "center", -7, 0),
    ("left", "bottom", 5, 4),
    ("right", "top", -5, -4),
    ("center", "bottom", 0, 6),
    ("center", "top", 0, -6),
)
"""Alignment of a label and its distance from its point [typographic points], the preferred ones first."""


def _dense(at: np.ndarray) -> np.ndarray:
    """Points (n, 2) on a polygon of straight lines."""
    where = np.linspace(0, len(at) - 1, 40 * len(at))
    return np.stack([np.interp(where, np.arange(len(at)), column) for column in at.T], axis=1)


def _inside(at: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Which points lie in a box, or within its margin of two pixels."""
    return np.all((at > box[:2] - 2) & (at < box[2:] + 2), axis=1)


def _overlap(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two boxes (left, low, right, high) overlap."""
    return bool(np.all(a[:2] < b[2:]) and np.all(b[:2] < a[2:]))


LINES = {"full": "-", "dashed": "--", "dotted": ":"}
"""Line styles of the batches in `draw_all`, by what they are called."""


def draw_all(points: list[Point], batches: tuple[int, ...]) -> Any:
    """Error against cost of every method, one panel per scene; full lines for the first batch, dashed for the next.

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


def write(points: list[Point], batches: tuple[int, ...], out: Path) -> tuple[Path, Path, Path]:
    """Writes OUT.md, OUT.png of `draw` and OUT_all.png of `draw_all`, and gives their paths."""
    text, picture, everything = Path(f"{out}.md"), Path(f"{out}.png"), Path(f"{out}_all.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    drawn = lambda drawing: lambda: png(np.ravel(drawing(points, batches))[0].figure, 150)
    write_each({text: table(points, batches).encode, picture: drawn(draw), everything: drawn(draw_all)})
    return text, picture, everything
