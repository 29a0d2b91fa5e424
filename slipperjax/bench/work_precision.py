"""Work-precision: points of error against cost as a table and as a picture."""

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


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
MBDYN_MS = {"fastest settings": 24.3, "default Newton": 108.0}
"""Its milliseconds per period on one core. Measured once, on another day, and not in the run that shows them."""


def mbdyn_points(scenes: Iterable[str]) -> list[Point]:
    """MBDyn's points for scenes by name, which are not measured here."""
    return [
        Point(scene, "MBDyn (measured elsewhere)", f"1000 steps, {how}", MBDYN[scene], {1: (1e3 * ms,) * 2})
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


LINES = {"full": "-", "dashed": "--", "dotted": ":"}
"""Line styles of the batches, by what they are called."""


def draw(points: list[Point], batches: tuple[int, ...]) -> Any:
    """Error against cost, one panel per scene; lines are full for the first batch, dashed for the second.

    **Returns:** the axes, an array.
    """
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(p.case for p in points))
    methods = list(dict.fromkeys(p.method for p in points))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure, axes = plt.subplots(
        # wide enough for the legend, too
        rows,
        columns,
        figsize=(max(4.2 * columns, 10), 3.6 * rows + 2.4),
        squeeze=False,
        layout="constrained",
    )
    handles = {}
    for ax, name in zip(axes.flat, names, strict=False):
        for k, method in enumerate(methods):
            mine = [p for p in points if p.case == name and p.method == method and np.isfinite(p.error)]
            marker = "osD"[k // 10 % 3]  # there are ten colours
            for lanes, style in zip(batches, LINES.values(), strict=False):
                here = [p for p in mine if lanes in p.cost and p.error > 0]
                if here:
                    x, y = [p.cost[lanes][0] for p in here], [p.error for p in here]
                    (line,) = ax.plot(x, y, style + marker, color=f"C{k % 10}", markersize=4, linewidth=1)
                    handles.setdefault(method, line)
        ax.set(xscale="log", yscale="log", title=name, xlabel="µs per trajectory and period", ylabel="scaled error")
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(names) :]:
        ax.set_axis_off()
    marks = ", ".join(f"{line}: {n} at once" for n, line in zip(batches, LINES, strict=False))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, title=marks)
    return axes


def write(points: list[Point], batches: tuple[int, ...], out: Path) -> tuple[Path, Path]:
    """Writes OUT.md and OUT.png and gives their paths."""
    import matplotlib.pyplot as plt

    text, picture = Path(f"{out}.md"), Path(f"{out}.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    text.write_text(table(points, batches))
    draw(points, batches).flat[0].figure.savefig(picture, dpi=150)
    plt.close("all")
    return text, picture
