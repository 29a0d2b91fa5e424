"""Least squares of closed forms, from many starts at once."""

import numpy as np
import scipy.optimize

from slipperjax.fitting.search import APART, compressed, search

TIME = np.linspace(0.0, 3.0, 40)


def decay(points):
    """Residuals of a decaying wave beside one with the numbers 0.7, 2.5, and their derivatives."""
    a, w = points[:, :1], points[:, 1:]
    wave = np.exp(-a * TIME) * np.cos(w * TIME)
    truth = np.exp(-0.7 * TIME) * np.cos(2.5 * TIME) + 0.01 * np.sin(40 * TIME)
    slope = np.stack([-TIME * wave, -TIME * np.exp(-a * TIME) * np.sin(w * TIME)], axis=-1)
    return (wave - truth) / 0.01, slope / 0.01


def test_the_least_squares_are_those_of_scipy():
    starts = np.array([[0.3, 2.0], [1.5, 3.0], [0.5, 2.6]])
    found = search(lambda points, index: decay(points), starts)
    exact = scipy.optimize.least_squares(lambda p: decay(p[None])[0][0], starts[2], lambda p: decay(p[None])[1][0])
    assert found.converged.any()
    # 0.2 standard errors are near enough
    error = np.sqrt(np.diag(np.linalg.inv(exact.jac.T @ exact.jac)))
    assert np.all(np.abs(found.point[found.lead] - exact.x) < 0.2 * error)
    np.testing.assert_allclose(found.cost[found.lead], 2 * exact.cost, rtol=1e-3)


def test_compression_keeps_sums_of_squares():
    rng = np.random.default_rng(0)
    residual, slope = rng.normal(size=(4, 50)), rng.normal(size=(4, 50, 3))
    few, few_slope = compressed(residual, slope)
    assert few.shape == (4, 4)
    np.testing.assert_allclose(np.sum(few**2, axis=1), np.sum(residual**2, axis=1))
    gradient = np.einsum("sru,sr->su", slope, residual)
    np.testing.assert_allclose(np.einsum("sru,sr->su", few_slope, few), gradient, atol=1e-12)
    # lost motions are far from any record
    residual[2, 7] = np.nan
    assert np.sum(compressed(residual, slope)[0] ** 2, axis=1).argmax() == 2


def test_two_minima_are_told_apart():
    def both(points, index):
        # x^2 = 1 has two solutions; beside it is noise that nothing explains
        noise = np.full((len(points), 1), 200.0)
        slope = np.stack([200 * points, 0 * points], axis=1)
        return np.hstack([100 * (points**2 - 1), noise]), slope

    found = search(both, np.array([[0.5], [-0.4], [2.0]]))
    kept = found.distinct(1.0, 1)
    np.testing.assert_allclose(sorted(found.point[kept, 0]), [-1, 1], atol=1e-3)
    assert APART < 400  # the standard errors between them
