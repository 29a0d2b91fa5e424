"""Regions of a plane of two parameters between curves, on a grid.

A region is found from the curves alone: two neighbouring grid points belong to one region where no curve passes
between them. So a prediction from curves knows nothing of the motions at the grid points, and can be wrong there.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..tools.checks import require

Points = Float[np.ndarray, "_ 2"]
"""A curve: its points in their order, one column per parameter; NaN between parts that are apart."""


def regions(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " m"], curves: Sequence[Points]
) -> Int[np.ndarray, "n m"]:
    """Numbers the regions into which curves divide a grid: 0, 1, ... by falling size.

    **Arguments:** `x`, `y`: values of the two parameters on the grid, rising; `curves`: in the same units. A curve
    that ends within the grid separates nothing behind its end.

    **Returns:** the region of each grid point.

    **Raises:** `ValueError` for values that do not rise.
    """
    import scipy.sparse.csgraph  # here, because it is the only function that needs it

    blocked = _blocked(_rising("x", x), _rising("y", y), curves)
    number = np.arange(len(x) * len(y)).reshape(len(x), len(y))
    ends = [
        (number[:-1][~blocked[0]], number[1:][~blocked[0]]),
        (number[:, :-1][~blocked[1]], number[:, 1:][~blocked[1]]),
    ]
    rows, columns = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    graph = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(number.size,) * 2)
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(-np.bincount(label, minlength=count), kind="stable")
    return np.argsort(order)[label].reshape(number.shape)


def holding(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " m"], curves: Sequence[Points], known: Points
) -> Bool[np.ndarray, "n m"]:
    """Gives the grid points in those regions of `regions` that hold one of the `known` points.

    A known point counts for the nearest grid point, if no curve passes between the two.
    """
    label = regions(x, y, curves)
    holders = set()
    for point in np.asarray(known, float):
        i, j = int(np.argmin(np.abs(x - point[0]))), int(np.argmin(np.abs(y - point[1])))
        inside = x[0] <= point[0] <= x[-1] and y[0] <= point[1] <= y[-1]
        if inside and not any(_crosses(curve, point, np.array([x[i], y[j]])) for curve in curves):
            holders.add(int(label[i, j]))
    return np.isin(label, list(holders))


def _rising(name: str, values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, float)
    require(values.ndim == 1 and np.all(np.diff(values) > 0), name, "be values that rise", values)
    return values


def _blocked(x: np.ndarray, y: np.ndarray, curves: Sequence[Points]) -> tuple[np.ndarray, np.ndarray]:
    """Tells whether a curve passes between neighbours along x, shape (n - 1, m), and along y, (n, m - 1)."""
    along_x, along_y = np.zeros((len(x) - 1, len(y)), bool), np.zeros((len(x), len(y) - 1), bool)
    for curve in curves:
        points = np.asarray(curve, float)
        # where the curve meets the line of grid points with one y, and those with one x
        for j, at in _meetings(points[:, 1], points[:, 0], y):
            along_x[_between(x, at), j] = True
        for i, at in _meetings(points[:, 0], points[:, 1], x):
            along_y[i, _between(y, at)] = True
    return along_x, along_y


def _meetings(across: np.ndarray, along: np.ndarray, lines: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Gives the lines that a curve meets: line number, and positions along it."""
    meetings = []
    a, b = across[:-1], across[1:]
    for k, line in enumerate(lines):
        # a curve that ends on the line meets it, too
        hit = np.flatnonzero((np.minimum(a, b) <= line) & (np.maximum(a, b) >= line))
        if len(hit):
            step = b[hit] - a[hit]
            share = np.where(step == 0, 0.0, (line - a[hit]) / np.where(step == 0, 1.0, step))
            meetings.append((k, along[hit] + share * (along[hit + 1] - along[hit])))
    return meetings


def _between(values: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Gives the numbers k of the gaps values[k]..values[k + 1] that hold positions; those outside are left out."""
    k = np.searchsorted(values, positions, side="right") - 1
    return k[(k >= 0) & (k < len(values) - 1)]


def _crosses(curve: Points, start: np.ndarray, end: np.ndarray) -> bool:
    """Tells whether a curve crosses the straight line between two points."""
    a, b = np.asarray(curve, float)[:-1], np.asarray(curve, float)[1:]
    area = lambda p, q, r: (
        (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
    )
    apart = (area(start, end, a) > 0) != (area(start, end, b) > 0)
    other = (area(a, b, start) > 0) != (area(a, b, end) > 0)
    return bool(np.any(apart & other & np.isfinite(a).all(1) & np.isfinite(b).all(1)))
