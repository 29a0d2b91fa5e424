"""Least squares of closed forms, from many starts at once."""

import numpy as np
import scipy.optimize

from slipperjax.fitting.search import APART, Chain, search

TIME = np.linspace(0.0, 3.0, 40)


def alone(residual, slope):
    """Levels alone, without windows."""
    rows = np.concatenate([slope, residual[..., None]], axis=2)
    return Chain.of(np.zeros((len(rows), 0, 0, rows.shape[2])), rows)


def decay(points):
    """Residuals of a decaying wave beside one with the numbers 0.7, 2.5, and their derivatives."""
    a, w = points[:, :1], points[:, 1:]
    wave = np.exp(-a * TIME) * np.cos(w * TIME)
    truth = np.exp(-0.7 * TIME) * np.cos(2.5 * TIME) + 0.01 * np.sin(40 * TIME)
    slope = np.stack([-TIME * wave, -TIME * np.exp(-a * TIME) * np.sin(w * TIME)], axis=-1)
    return (wave - truth) / 0.01, slope / 0.01


def test_the_least_squares_are_those_of_scipy():
    starts = np.array([[0.3, 2.0], [1.5, 3.0], [0.5, 2.6]])
    found = search(lambda points, index: alone(*decay(points)), starts)
    exact = scipy.optimize.least_squares(lambda p: decay(p[None])[0][0], starts[2], lambda p: decay(p[None])[1][0])
    assert found.converged.any()
    # 0.2 standard errors are near enough
    error = np.sqrt(np.diag(np.linalg.inv(exact.jac.T @ exact.jac)))
    assert np.all(np.abs(found.point[found.lead] - exact.x) < 0.2 * error)
    np.testing.assert_allclose(found.cost[found.lead], 2 * exact.cost, rtol=1e-3)


def test_two_minima_are_told_apart():
    def both(points, index):
        # x^2 = 1 has two solutions; beside it is noise that nothing explains
        noise = np.full((len(points), 1), 200.0)
        slope = np.stack([200 * points, 0 * points], axis=1)
        return alone(np.hstack([100 * (points**2 - 1), noise]), slope)

    found = search(both, np.array([[0.5], [-0.4], [2.0]]))
    kept = found.distinct(1.0)
    np.testing.assert_allclose(sorted(found.point[kept, 0]), [-1, 1], atol=1e-3)
    assert APART < 400  # the standard errors between them
