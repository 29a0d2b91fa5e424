"""Regions between curves on grids, and predictions from curves against maps of which the stable region is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.critical import CriticalMotions, continue_critical
from slipperjax.analysis.regions import holding, regions
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import HENON, HENON_AT

X, Y = np.arange(5.0), np.arange(4.0)


def test_a_line_divides_a_grid():
    line = np.array([[1.5, -1.0], [1.5, 9.0]])
    found = regions(X, Y, [line])
    np.testing.assert_array_equal(found, np.repeat([[1], [1], [0], [0], [0]], 4, axis=1))
    np.testing.assert_array_equal(holding(X, Y, [line], np.array([[0.2, 2.0]])), found == 1)


def test_a_curve_that_ends_within_separates_nothing():
    line = np.array([[1.5, -1.0], [1.5, 2.5]])
    assert regions(X, Y, [line]).max() == 0
    # the rest of it closes the gap; a gap of NaN leaves it open
    assert regions(X, Y, [line, np.array([[1.5, 2.4], [1.5, 9.0]])]).max() == 1
    broken = np.array([[1.5, -1.0], [1.5, 1.5], [np.nan, np.nan], [1.5, 2.5], [1.5, 9.0]])
    assert regions(X, Y, [broken]).max() == 0


def test_curves_that_end_on_the_edge_of_the_grid_divide_it():
    for ends in ((0.0, 3.0), (3.0, 0.0)):
        assert regions(X, Y, [np.array([[1.5, ends[0]], [1.7, ends[1]]])]).max() == 1
    for ends in ((0.0, 4.0), (4.0, 0.0)):
        assert regions(X, Y, [np.array([[ends[0], 1.5], [ends[1], 1.5]])]).max() == 1
    along = np.array([[0.0, 1.0], [4.0, 1.0]])  # through grid points, which belong to both sides
    assert not np.isnan(regions(X, Y, [along])).any()


def test_closed_curves_enclose_regions():
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = np.stack([2 + 1.2 * np.cos(angle), 1 + 1.2 * np.sin(angle)], axis=1)
    inside = (X[:, None] - 2) ** 2 + (Y - 1) ** 2 < 1.2**2
    np.testing.assert_array_equal(holding(X, Y, [circle], np.array([[2.0, 1.0]])), inside)
    np.testing.assert_array_equal(holding(X, Y, [circle], np.array([[4.0, 3.0]])), ~inside)
    # nothing is known of a region whose place lies behind a curve, or outside the grid
    assert not holding(X, Y, [np.array([[0.4, -1.0], [0.4, 9.0]])], np.array([[0.45, 1.0], [9.0, 9.0]]))[0].any()


def test_without_curves_there_is_one_region():
    assert regions(X, Y, []).max() == 0
    with pytest.raises(ValueError, match="Argument `y` must be values that rise"):
        regions(X, Y[::-1], [])


def henon_curve(label):
    """A curve of critical fixed points over a in (-1, 2) and b in (-0.95, 0.8)."""
    motions = PeriodicMotions(HENON, jnp.zeros(2), jnp.ones(2))
    begin = jnp.full(2, {"LP": -0.4, "PD": 0.4}[label])
    bounds = (-1.5, 3.5), (-0.95, 0.85)
    found = continue_critical(CriticalMotions.of(motions, label), begin, (HENON_AT[label](0.2), 0.2), bounds)
    return np.array([spot.z[2:4] for spot in found.spots])


def test_curves_of_henons_map_predict_what_is_simulated():
    """Between fold and flip Henon's map has a stable fixed point, for |b| < 1: the curves are followed, the motions
    begin beside the fixed point."""
    a, b = np.linspace(-1.0, 2.6, 46), np.linspace(-0.9, 0.8, 33)
    curves = [henon_curve(label) for label in ("LP", "PD")]
    predicted = holding(a, b, curves, np.array([[0.0, 0.2]]))
    exact = (a[:, None] > HENON_AT["LP"](b)) & (a[:, None] < HENON_AT["PD"](b))
    np.testing.assert_array_equal(predicted, exact)

    fixed = -(1 - b) / 2 + np.sqrt(np.maximum((1 - b) ** 2 / 4 + a[:, None], 0.0))
    x = y = fixed + 1e-3
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(2000):
            x, y = a[:, None] - x**2 + b * y, x
        seen = np.maximum(np.abs(x - fixed), np.abs(y - fixed)) < 1e-2
    np.testing.assert_array_equal(predicted, seen)
    # without the flip the region leaks, which the comparison shows; measured: 56 %
    alone = holding(a, b, curves[:1], np.array([[0.0, 0.2]]))
    assert np.mean(alone == seen) < 0.75
