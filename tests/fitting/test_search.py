"""Least squares: chains of windows beside all of their rows, and searches from many starts beside scipy."""

import functools
import tracemalloc

import numpy as np
import pytest
import scipy.optimize

from slipperjax.fitting.search import LOST, Chain, search

TEN, OWN = 10, 3
TIME = np.linspace(0.0, 3.0, 40)


def banded(windows, points=2, rows=7):
    """Rows of windows: by ten numbers of each, ten of the next, the levels, and the residual; and rows of levels."""
    rng = np.random.default_rng(0)
    made = rng.normal(size=(points, windows, rows + 20, 21 + OWN))
    made[:, -1, :, 10:20] = 0.0
    return made, rng.normal(size=(points, OWN, OWN + 1))


def dense(windows, levels):
    """All rows of one point by all unknowns, and the residual."""
    count, each = windows.shape[:2]
    rows = np.zeros((count, each, OWN + TEN * (count + 1) + 1))
    for k, part in enumerate(windows):
        rows[k, :, OWN + TEN * k : OWN + TEN * (k + 2)] = part[:, : 2 * TEN]
    rows[..., :OWN] = windows[..., 2 * TEN : -1]
    rows[..., -1] = windows[..., -1]
    of_levels = np.zeros((len(levels), rows.shape[2]))
    of_levels[:, :OWN], of_levels[:, -1] = levels[:, :-1], levels[:, -1]
    # the last window has no next one
    return np.delete(np.vstack([*rows, of_levels]), OWN + TEN * count + np.arange(TEN), axis=1)


@pytest.mark.parametrize("windows", [1, 5])
def test_windows_are_eliminated_one_by_one_without_a_change_of_the_sums(windows):
    given = banded(windows)
    chain = Chain.of(*given)
    way = np.random.default_rng(1).normal(size=(2, OWN + TEN * windows))
    close = functools.partial(np.testing.assert_allclose, rtol=1e-10)  # measured 1.3e-13
    for k in range(2):
        rows = dense(given[0][k], given[1][k])
        slope, residual, here = rows[:, :-1], rows[:, -1], chain.at(np.array([k]))
        close(here.cost[0], residual @ residual)
        close(np.sum(here.along(way) ** 2, axis=1), np.sum((slope @ way.T) ** 2, axis=0))
        close(here.lengths[0], np.linalg.norm(slope, axis=0))
        best, left, *_ = np.linalg.lstsq(slope, -residual)
        close(here.solve(-here.residual[:, :-1])[0], best)
        close(here.cost[0] - here.distance[0] ** 2, left[0])
        covariance = np.linalg.inv(slope.T @ slope)
        close(here.root[0].T @ here.root[0], np.linalg.inv(covariance[:OWN, :OWN]))
        weight = np.abs(way[k])
        damped = here.damped(weight[None])
        step = np.linalg.lstsq(np.vstack([slope, np.diag(weight)]), -np.append(residual, 0 * weight))[0]
        close(damped.solve(-damped.residual[:, :-1])[0], step)


def test_lost_motions_are_far_from_any_record():
    windows, levels = banded(3)
    windows[1, 2, 4, 5] = np.nan
    chain = Chain.of(windows, levels)
    np.testing.assert_allclose(chain.cost[1], LOST)
    assert chain.cost[0] < 1e3
    assert np.all(chain.lengths[1] == 0)


def test_the_memory_of_a_search_grows_as_its_windows():
    """With square arrays of all unknowns, a search of 400 windows and 16 starts had 41 GB."""
    peaks = []
    for windows in (25, 100):
        rows, levels = banded(windows, points=1)

        def evaluate(points, index, windows=windows, rows=rows, levels=levels):
            numbers = points[:, OWN:].reshape(len(points), windows, TEN)
            each = np.broadcast_to(points[:, None, :OWN], (len(points), windows, OWN))
            here = np.concatenate([numbers, np.roll(numbers, -1, axis=1), each, np.ones_like(each[..., :1])], axis=2)
            moved = [np.repeat(part, len(points), axis=0) for part in (rows, levels)]
            moved[0][..., -1] = np.einsum("wrc,pwc->pwr", rows[0], here)
            moved[1][..., -1] += points[:, :OWN] @ levels[0, :, :-1].T
            return Chain.of(*moved)

        tracemalloc.start()
        found = search(evaluate, np.random.default_rng(2).normal(size=(4, OWN + TEN * windows)))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        # the four ends are one
        assert found.converged.all()
        np.testing.assert_allclose(found.cost, found.cost[found.lead], rtol=1e-3)
    assert peaks[1] < 5 * peaks[0]  # with square arrays 16 times


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
        # x^2 = 1 has two solutions, 400 standard errors apart; beside it is noise that nothing explains
        noise = np.full((len(points), 1), 200.0)
        return alone(np.hstack([100 * (points**2 - 1), noise]), np.stack([200 * points, 0 * points], axis=1))

    found = search(both, np.array([[0.5], [-0.4], [2.0]]))
    np.testing.assert_allclose(sorted(found.point[found.distinct(1.0), 0]), [-1, 1], atol=1e-3)
