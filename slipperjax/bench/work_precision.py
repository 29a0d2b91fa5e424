"""Points of error against cost, as a table and as a picture."""

import itertools
from collections.abc import Iterable, Mapping
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


DEFAULT = "ImpulseRK4"
SHOWN = {
    DEFAULT: "ImpulseRK4,\nthe default",
    "RK4": "RK4",
    "Rodas4": "Rodas4,\nimplicit",
    "smooth: RK4": "RK4,\nsmooth switch",
    "smooth: diffrax Kvaerno5, adaptive": "diffrax Kvaerno5,\nsmooth switch,\nadaptive steps",
    "C++ scalar, RK4, event latch": "C++ program, RK4",
    "SciPy DOP853 with events": "SciPy DOP853,\nwith events",
    MBDYN_NAME: "MBDyn,\nmeasured elsewhere",
}
"""Curves of a picture in which not all can be, with their labels; a benchmark of the tests measures C++ and SciPy."""
LOOKS = (
    ("#d55e00", "o-"),
    ("#0072b2", "s--"),
    ("#9f20ff", "^-."),
    ("#45a5dd", "v:"),
    ("#800000", "P-"),
    ("#000000", "D--"),
    ("#8f8f78", "X-."),
    ("#004d38", "*:"),
)
"""Colours that colour-blind readers tell apart, markers and dashes of the curves, in the order of `SHOWN`."""

DISTANCES = (8, 12, 18, 26, 38, 54, 75, 100)
"""Distances of a label from its line that are tried [typographic points]."""
NEAR = 12
"""Distance from which a thin line leads to it [typographic points]."""


def draw(
    points: list[Point],
    batches: tuple[int, ...],
    *,
    shown: Mapping[str, str] = SHOWN,
    error: str = "error [1 mm, 10 mrad, 1 m/s, 10 rad/s]",
) -> np.ndarray:
    """Draws error against cost, a panel per scene on the same axes, at most eight curves with labels of their own.

    **Arguments:** `batches`: the first is drawn, and a single trajectory of codes that run no batches; `shown`: the
    curves and their labels where more were measured than there are `LOOKS`; `error`: label of the vertical axis.

    **Returns:** the axes, an array.
    """
    import matplotlib.pyplot as plt

    scenes = list(dict.fromkeys(p.case for p in points))
    names = list(dict.fromkeys(p.method for p in points))
    if len(names) > len(LOOKS):
        names = [name for name in names if name in shown] or names[: len(LOOKS)]
    own = dict(zip(shown, LOOKS, strict=False))
    free = iter([look for name, look in zip(shown, LOOKS, strict=False) if name not in names])
    looks = {name: own[name] if name in own else next(free) for name in names}
    columns = 1 if len(scenes) < 2 else 2 if len(scenes) < 5 else 3
    rows = max(1, -(-len(scenes) // columns))
    size = (7.2, 4.8) if columns == 1 else (4.6 * columns, 3.8 * rows)
    options: Any = dict(figsize=size, squeeze=False, sharex=True, sharey=True, layout="constrained")
    figure, axes = plt.subplots(rows, columns, **options)
    figure.supxlabel("← faster     time per trajectory and forcing period [µs]", fontsize=9)
    figure.supylabel(f"← better     {error}", fontsize=9)
    for ax, scene in zip(axes.flat, scenes, strict=False):
        ax.set(xscale="log", yscale="log")
        ax.set_title(scene, fontsize=9, loc="left")
        ax.grid(alpha=0.25, linewidth=0.4)
        for name, (color, style) in looks.items():
            x, y = _curve((p for p in points if (p.case, p.method) == (scene, name)), batches[0])
            if len(x):
                thick = dict(linewidth=3.2, markersize=7, zorder=3) if name == DEFAULT else dict(markersize=4.5)
                ax.plot(x, y, style, color=color, label=shown.get(name, name), **({"linewidth": 1.3} | thick))
        ax.margins(0.1)
    figure.suptitle(f"{batches[0]} trajectories at once, other codes one by one", fontsize=9, x=0.01, ha="left")
    for ax in axes.flat[len(scenes) :]:
        ax.set_axis_off()
    for ax in axes.flat[max(len(scenes) - columns, 0) : len(scenes)]:
        ax.tick_params(labelbottom=True)
    figure.draw_without_rendering()  # settles the layout
    for ax in axes.flat[: len(scenes)]:
        _label(ax)
    return axes


def _curve(points: Iterable[Point], lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Gives cost and error of the points that can be drawn on logarithmic axes, of one trajectory if need be."""
    rows = [(p.cost.get(lanes, p.cost.get(1)), p.error) for p in points]
    drawn = [(cost[0], error) for cost, error in rows if cost is not None and 0 < error < np.inf]
    cost, error = np.array(drawn).reshape(-1, 2).T
    return cost, error


def _label(ax: Any) -> None:
    """Writes the label of each line near it, where it is free, with a thin line to it from further away."""
    pixels, frame = ax.figure.dpi / 72, ax.get_window_extent()
    # points on the lines in pixels, 40 on each piece
    inks = [line.get_path().transformed(ax.transData).interpolated(40).vertices for line in ax.lines]
    # what is taken: lower left and upper right corners of labels, and points on the lines that lead to them
    boxes, leaders = np.empty((0, 2, 2)), np.empty((0, 2))
    for k, line in enumerate(ax.lines):
        style = dict(color=line.get_color(), fontsize=8, linespacing=1.0, va="center", ha="center")
        if line.get_linewidth() > 2:
            style |= dict(fontsize=9.5, fontweight="bold")
        trial = ax.text(0.5, 0.5, line.get_label(), transform=ax.transAxes, **style)
        size = trial.get_window_extent().size
        trial.remove()
        others = np.concatenate([*inks[:k], *inks[k + 1 :], leaders])
        anchors, reach, way = _places(inks[k][::10], pixels)
        middle = anchors + reach * way + size / 2 * np.sign(np.round(way, 1))
        low, high = middle - size / 2, middle + size / 2
        path = anchors + np.linspace(0, 1, 20)[:, None, None] * (middle - anchors)
        cost = _inside(others, low - 15, high + 15) + reach[:, 0] / pixels
        cost += 1e3 * _inside(np.concatenate([others, inks[k]]), low - 4, high + 4)
        cost += 1e6 * np.any((low < frame.min + 4) | (high > frame.max - 4), axis=1)
        for start, end in boxes:
            cost += 1e6 * np.all((low < end + 4) & (high > start - 4), axis=1)
            cost += 1e6 * np.any(np.all((path > start - 2) & (path < end + 2), axis=2), axis=0)
        best = int(np.argmin(cost))
        boxes = np.concatenate([boxes, [[low[best], high[best]]]])
        far = reach[best, 0] > NEAR * pixels
        leaders = np.concatenate([leaders, path[:, best]]) if far else leaders
        ax.annotate(
            line.get_label(),
            ax.transData.inverted().transform(anchors[best]),
            (middle[best] - anchors[best]) / pixels,
            textcoords="offset points",
            arrowprops=dict(arrowstyle="-", lw=0.6, color=style["color"], shrinkA=1, shrinkB=2) if far else None,
            **style,
        ).set_in_layout(False)


def _inside(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Counts the points in each box."""
    return np.sum(np.all((points > low[:, None]) & (points < high[:, None]), axis=2), axis=1)


def _places(anchors: np.ndarray, pixels: float) -> list[np.ndarray]:
    """Gives all places of a label: points of its line, distances from them [pixels], and directions."""
    angles = np.pi / 4 * np.arange(8)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    shape = (len(anchors), len(DISTANCES), len(ways), 2)
    parts = anchors[:, None, None], pixels * np.array(DISTANCES)[None, :, None, None], ways[None, None]
    return [np.broadcast_to(part, shape).reshape(-1, 2) for part in parts]


def write(points: list[Point], batches: tuple[int, ...], out: Path) -> tuple[Path, Path]:
    """Writes OUT.md of `table` and OUT.png of `draw`, and gives their paths."""
    text, picture = Path(f"{out}.md"), Path(f"{out}.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    drawn = lambda: png(draw(points, batches)[0, 0].figure, 150)
    write_each({text: table(points, batches).encode, picture: drawn})
    return text, picture
