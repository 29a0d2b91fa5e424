"""Work-precision diagrams: points of error against cost, as a table and as a picture."""

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipperjax.plots.style import png
from slipperjax.tools.files import table_lines, write_each


class Point(NamedTuple):
    """Error and cost of one method with one setting on one scene."""

    case: str
    method: str
    setting: str
    error: float
    """Median over the batch of the worst scaled error; infinite where a case left the finite numbers."""
    cost: dict[int, tuple[float, float]]
    """Best and median microseconds per trajectory and period, by the number of trajectories at once."""


MBDYN = "MBDyn (measured elsewhere)"
SHOWN = {
    "ImpulseRK4": "ImpulseRK4,\nthe default",
    "RK4": "RK4",
    "Rodas4": "Rodas4,\nimplicit",
    "smooth: RK4": "RK4,\nsmooth switch",
    "smooth: diffrax Kvaerno5, adaptive": "diffrax Kvaerno5,\nsmooth switch,\nadaptive steps",
    "C++ scalar, RK4, event latch": "C++ program, RK4",
    "SciPy DOP853 with events": "SciPy DOP853,\nwith events",
    MBDYN: "MBDyn,\nmeasured elsewhere",
}
"""Methods to draw where there are too many for one picture, with their labels. A benchmark in the tests measures C++
and SciPy."""
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
"""Colours that colour-blind readers can tell apart, and markers with dashes, in the order of `SHOWN`."""


def mbdyn_points(scene: str) -> list[Point]:
    """Return the points of MBDyn for a scene by name, quoted from a measurement elsewhere.

    It ran 1000 steps per period, as in the paper, over six periods on one core.
    """
    error = {"nominal": 5.9e-3, "V = 2300 m/s": 6.8e-3, "C = 4 mm": 4.6e-2}.get(scene)
    if error is None:
        return []
    micros = {"fastest settings": 24_300.0, "default Newton": 108_000.0}
    return [Point(scene, MBDYN, f"1000 steps, {name}", error, {1: (cost, cost)}) for name, cost in micros.items()]


def cost_at(points: Iterable[Point], error: float, lanes: int) -> float:
    """Return the least microseconds per trajectory and period at which a method reaches an error, by its best times.

    Logarithms are interpolated between points. Infinite where no point is that accurate.
    """
    # from the most accurate point to the least
    rows = sorted((p.error, p.cost[lanes][0]) for p in points if lanes in p.cost and np.isfinite(p.error))
    if not rows or rows[0][0] > error:
        return np.inf
    errors, costs = np.transpose(rows)
    between = np.exp(np.interp(np.log(error), np.log(errors), np.log(costs)))
    # a more accurate point may cost less than the interpolated one
    return float(min(between, *costs[errors <= error]))


def table(points: list[Point]) -> str:
    """Return a Markdown table of all points, and a second one of the costs of an error of 1e-3."""
    batches = _batches(points)
    scenes = dict.fromkeys(p.case for p in points)
    every = []
    for point in points:
        row = dict(scene=point.case, method=point.method, setting=point.setting, error=f"{point.error:.1e}")
        # not every code was run with every batch
        for n in batches:
            best, median = point.cost.get(n, (np.nan, np.nan))
            row[f"us at {n}, best (median)"] = f"{best:.3g} ({median:.3g})" if n in point.cost else "-"
        every.append(row)
    # a row for each method, with the cost in every scene and batch
    at_error = []
    for method in dict.fromkeys(p.method for p in points):
        row = dict(method=method)
        for case, n in itertools.product(scenes, batches):
            cost = cost_at([p for p in points if (p.case, p.method) == (case, method)], 1e-3, n)
            row[f"{case}, {n} at once"] = f"{cost:.3g}" if np.isfinite(cost) else "-"
        at_error.append(row)
    said = "Microseconds per trajectory and period at a scaled error of 1e-3 (best times, interpolated):"
    return "\n".join([*table_lines(every), "", said, "", *table_lines(at_error)]) + "\n"


def _batches(points: Iterable[Point]) -> list[int]:
    """Return the numbers of trajectories at once, the largest first."""
    return sorted(set().union(*(point.cost for point in points)), reverse=True)


def draw(
    points: list[Point],
    *,
    shown: Mapping[str, str] = SHOWN,
    error: str = "scaled error of the motion",
) -> np.ndarray:
    """Draw error against cost with a panel per scene and at most eight methods.

    Costs are those of the largest batch, or of a single trajectory for codes that run no batches.

    **Arguments:** `shown`: labels by method, and the methods to draw where there are more than eight; the first one
    is emphasised. `error`: label of the vertical axis.

    **Returns:** the axes, an array (rows, columns).
    """
    import matplotlib.pyplot as plt

    scenes = list(dict.fromkeys(p.case for p in points))
    names = list(dict.fromkeys(p.method for p in points))
    if len(names) > len(LOOKS):
        names = [name for name in names if name in shown] or names[: len(LOOKS)]
    # methods of `shown` come first, so that each looks the same in all pictures
    names = sorted(names, key=lambda name: list(shown).index(name) if name in shown else len(shown))
    # one column for a single panel, two for up to four panels, else three
    columns = 1 if len(scenes) < 2 else 2 if len(scenes) < 5 else 3
    rows = max(1, -(-len(scenes) // columns))
    size = (8.6, 4.8) if columns == 1 else (4.6 * columns, 3.8 * rows)
    figure, axes = plt.subplots(
        rows, columns, figsize=size, squeeze=False, sharex=True, sharey=True, layout="constrained"
    )
    lanes = _batches(points)[0]
    for ax, scene in zip(axes.flat, scenes, strict=False):
        ax.set(xscale="log", yscale="log")
        ax.set_title(scene, fontsize=9, loc="left")
        ax.grid(alpha=0.25, linewidth=0.4)
    # one line of each method for the legend
    lines = {}
    for name, (color, style) in zip(names, LOOKS, strict=False):
        # the first method of `shown` stands out
        width = 3.2 if name == next(iter(shown)) else 1.3
        for ax, scene in zip(axes.flat, scenes, strict=False):
            own_points = [p for p in points if (p.case, p.method) == (scene, name)]
            cost, off = _drawable(own_points, lanes)
            if len(cost):
                (lines[name],) = ax.plot(cost, off, style, color=color, lw=width, ms=5, label=shown.get(name, name))
    for ax in axes.flat[len(scenes) :]:
        ax.set_axis_off()
    # the lowest panel of each column has the numbers of the shared axis
    for ax in axes.flat[max(len(scenes) - columns, 0) : len(scenes)]:
        ax.tick_params(labelbottom=True)
    figure.supxlabel("← faster     time per trajectory and forcing period [µs]", fontsize=9)
    figure.supylabel(f"← better     {error}", fontsize=9)
    figure.suptitle(f"{lanes} trajectories at once, other codes one by one", fontsize=9, x=0.01, ha="left")
    figure.legend(handles=list(lines.values()), loc="outside right upper", fontsize=8, frameon=False)
    return axes


def _drawable(points: Iterable[Point], lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return costs and errors of the points that logarithmic axes can show; costs of one trajectory if no others."""
    drawn = []
    for point in points:
        cost, _ = point.cost.get(lanes, point.cost.get(1, (np.nan, np.nan)))
        # zero and infinity have no logarithm
        if cost > 0 and 0 < point.error < np.inf:
            drawn.append((cost, point.error))
    # the shape also suits an empty list
    cost, error = np.array(drawn).reshape(-1, 2).T
    return cost, error


def write(points: list[Point], out: Path) -> tuple[Path, Path]:
    """Write OUT.md of `table` and OUT.png of `draw`, and return their paths."""
    text = Path(f"{out}.md")
    picture = Path(f"{out}.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    drawn = lambda: png(draw(points)[0, 0].figure, 150)
    write_each({text: table(points).encode, picture: drawn})
    return text, picture
