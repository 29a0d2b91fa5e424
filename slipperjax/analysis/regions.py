"""Regions of a plane of two parameters between curves, on a grid.

A region is found from the curves alone: two neighbouring grid points belong to one region where no curve passes
between them. So a prediction from curves knows nothing of the motions at the grid points, and can be wrong there.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..tools.checks import numbers, require

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

    x, y, curves = _rising("x", x), _rising("y", y), [np.asarray(curve, float) for curve in curves]
    number = np.arange(len(x) * len(y)).reshape(len(x), len(y))
    # neighbours along x and along y between which no curve passes
    open_x, open_y = ~_passed(x, y, curves), ~_passed(y, x, [curve[:, ::-1] for curve in curves]).T
    ends = [(number[:-1][open_x], number[1:][open_x]), (number[:, :-1][open_y], number[:, 1:][open_y])]
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
    values = numbers(name, values).astype(float)
    require(values.ndim == 1 and np.all(np.diff(values) > 0), name, "be values that rise", values)
    return values


def _passed(x: np.ndarray, y: np.ndarray, curves: Sequence[Points]) -> Bool[np.ndarray, "gaps lines"]:
    """Tells whether a curve passes between neighbours along x, on each line of constant y."""
    passed = np.zeros((len(x) - 1, len(y)), bool)
    # where each curve meets each line; one that ends on the line meets it, too
    for along, across in (curve.T for curve in curves):
        a, b = across[:-1], across[1:]
        for j, line in enumerate(y):
            hit = np.flatnonzero((np.minimum(a, b) <= line) & (np.maximum(a, b) >= line))
            step = b[hit] - a[hit]
            share = np.where(step == 0, 0.0, (line - a[hit]) / np.where(step == 0, 1.0, step))
            k = np.searchsorted(x, along[hit] + share * (along[hit + 1] - along[hit]), side="right") - 1
            passed[k[(k >= 0) & (k < len(x) - 1)], j] = True
    return passed


def _crosses(curve: Points, start: np.ndarray, end: np.ndarray) -> bool:
    """Tells whether a curve crosses the straight line between two points."""
    a, b = np.asarray(curve, float)[:-1], np.asarray(curve, float)[1:]
    area = lambda p, q, r: (
        (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
    )
    apart = (area(start, end, a) > 0) != (area(start, end, b) > 0)
    other = (area(a, b, start) > 0) != (area(a, b, end) > 0)
    return bool(np.any(apart & other & np.isfinite(a).all(1) & np.isfinite(b).all(1)))
