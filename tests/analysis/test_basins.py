"""Shares of starts of a map with two attractors, beside a plain loop over more starts."""

import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax import analysis

pytestmark = pytest.mark.full


def duffing(c):
    """Holmes's map, with two unequal attractors for c other than 0."""
    return lambda s, k: jnp.stack([s[1], -0.2 * s[0] + 2.2 * s[1] - s[1] ** 3 + c])


def brute_shares(c, starts):
    """Return the shares of starts that end at positive and at negative x."""
    x, y = np.transpose(starts)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(1500):
            x, y = y, -0.2 * x + 2.2 * y - y**3 + c
    return np.mean(x > 0), np.mean(x < 0)


def test_shares_beside_20000_starts():
    draw = lambda seed, count: np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 2))
    values = [0.0, 0.05, 0.1]
    found = analysis.map_basins(duffing, draw(0, 2000), values)
    assert found.period.tolist() == [1, 1]
    brute = np.array([brute_shares(c, draw(1, 20_000)) for c in values])
    both = np.hypot(found.stderr, np.sqrt(brute * (1 - brute) / 20_000))
    # measured 1.8 at most
    assert np.abs((found.share - brute) / both).max() < 3
    # the same starts without chance
    exact = np.array([brute_shares(c, draw(0, 2000)) for c in values])
    np.testing.assert_allclose(found.share, exact, rtol=0, atol=1e-12)
    # one attractor grows, and both keep their numbers
    assert np.all(np.diff(found.share[:, 0]) > 0)


def test_starts_that_leave_have_no_attractor():
    starts = np.array([[0.5, 0.5], [0.5, 0.6], [9.0, 9.0]])
    found = analysis.map_basins(duffing, starts, [0.1])
    assert found.number.tolist() == [[0, 0, -1]]
    assert found.share.tolist() == [[2 / 3]]
    # (k + 1)(n - k + 1) / ((n + 2)^2 (n + 3)) with k = 2 of n = 3
    assert found.stderr[0, 0] == pytest.approx(np.sqrt(3 * 2 / (5**2 * 6)))
