"""Least squares of chains of windows, beside all of their rows by all unknowns."""

import functools
import tracemalloc

import numpy as np
import pytest

from slipperjax.fitting.search import LOST, Chain, search

TEN, OWN = 10, 3


def banded(windows, points=2, rows=7):
    """Rows of windows: by ten numbers of each, ten of the next, the levels, and the residual; and rows of levels."""
    rng = np.random.default_rng(0)
    made = rng.normal(size=(points, windows, rows + 20, 21 + OWN))
    made[:, -1, :, 10:20] = 0.0
    return made, rng.normal(size=(points, OWN, OWN + 1))


def dense(windows, levels):
    """All rows of one point by all unknowns, and the residual."""
    count, each = windows.shape[:2]
    rows = np.zeros((count * each + len(levels), OWN + TEN * count + 1))
    for w, part in enumerate(windows):
        at = slice(each * w, each * (w + 1))
        rows[at, OWN + TEN * w : OWN + TEN * (w + 1)] = part[:, :TEN]
        if w + 1 < count:
            rows[at, OWN + TEN * (w + 1) : OWN + TEN * (w + 2)] = part[:, TEN : 2 * TEN]
        rows[at, :OWN], rows[at, -1] = part[:, 2 * TEN : -1], part[:, -1]
    rows[count * each :, :OWN], rows[count * each :, -1] = levels[:, :-1], levels[:, -1]
    return rows


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
        inverse = here.root[0].T @ here.root[0]
        close(inverse, np.linalg.inv(covariance[:OWN, :OWN]))
        weight = np.abs(way[k])
        both = np.vstack([slope, np.diag(weight)])
        step = np.linalg.lstsq(both, -np.append(residual, 0 * weight))[0]
        damped = here.damped(weight[None])
        close(damped.solve(-damped.residual[:, :-1])[0], step)


def test_lost_motions_are_far_from_any_record():
    windows, levels = banded(3)
    windows[1, 2, 4, 5] = np.nan
    chain = Chain.of(windows, levels)
    assert chain.cost[0] < 1e3
    np.testing.assert_allclose(chain.cost[1], LOST)
    assert np.all(chain.lengths[1] == 0)


def following(windows, points):
    """Windows whose numbers a level and a sine turn into those of the next one."""
    rng = np.random.default_rng(2)
    signal = np.cos(0.7 * np.arange(windows + 1))[:-1, None] * np.linspace(1.0, 2.0, TEN)
    signal = signal + 0.01 * rng.normal(size=signal.shape)

    def evaluate(points, index):
        level, numbers = points[:, :OWN], points[:, OWN:].reshape(len(points), windows, TEN)
        rows = np.zeros((len(points), windows, 2 * TEN, 2 * TEN + OWN + 1))
        k = np.arange(TEN)
        # the samples, and the next window's start as a nonlinear function of this one's
        rows[:, :, k, k] = 1 / 0.01
        rows[..., :TEN, -1] = (numbers - signal) / 0.01
        a = level[:, :1, None]
        end, by_number, by_level = np.sin(a + numbers), np.cos(a + numbers), np.cos(a + numbers)
        jump = (end[:, :-1] - numbers[:, 1:]) / 0.1
        rows[:, :-1, TEN + k, k] = by_number[:, :-1] / 0.1
        rows[:, :-1, TEN + k, TEN + k] = -1 / 0.1
        rows[:, :-1, TEN:, 2 * TEN] = by_level[:, :-1] / 0.1
        rows[:, :-1, TEN:, -1] = jump
        known = np.concatenate([np.broadcast_to(np.eye(OWN), (len(points), OWN, OWN)), level[..., None]], axis=2)
        return Chain.of(rows, known)

    return evaluate, rng.normal(scale=0.1, size=(points, OWN + TEN * windows))


def test_the_memory_of_a_search_grows_as_its_windows():
    """With square arrays of all unknowns, a search of 400 windows and 16 starts had 41 GB."""
    peaks = []
    for windows in (25, 100):
        evaluate, points = following(windows, 4)
        tracemalloc.start()
        found = search(evaluate, points)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert found.converged.all()
        # the four ends are one
        np.testing.assert_allclose(found.cost, found.cost[found.lead], rtol=1e-3)
    assert peaks[1] < 5 * peaks[0]  # measured 4.0; with square arrays 16
