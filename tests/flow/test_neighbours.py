"""Slopes from neighbouring steps: exact for cubics, of fourth order, and blind to what lies beyond the steps."""

import jax
import numpy as np
import pytest

from slipperjax.flow.course import step_slopes

slopes = jax.jit(step_slopes)


@pytest.mark.parametrize(("degree", "ends"), [(1, 2), (2, 3), (3, 4), (3, 30)])
def test_polynomials_have_exact_slopes_whatever_lies_beyond_the_steps(degree, ends):
    """Fewer than three steps have no room beyond them."""
    place = np.arange(ends + 5.0)
    values = np.where(place < ends, place**degree - 3 * place, np.nan)
    exact = degree * place[:ends] ** (degree - 1) - 3
    for given in (values[:ends], values)[: 2 if ends > 3 else 1]:
        np.testing.assert_allclose(slopes(given, ends - 1)[:ends], exact, atol=1e-14 * np.abs(exact).max())


def test_they_are_of_fourth_order_also_at_both_ends_of_the_period():
    def error(steps):
        t = np.arange(steps + 1) / steps
        wave = np.stack([np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)], axis=1)
        exact = 2 * np.pi / steps * np.stack([wave[:, 1], -wave[:, 0]], axis=1)
        return np.abs(steps * (slopes(wave, steps) - exact)).max(axis=1)

    coarse, fine = error(50), error(100)
    middle = coarse[2:-2].max() / fine[2:-2].max()
    assert middle == pytest.approx(16, rel=0.01)  # measured: 15.98
    assert coarse.max() / fine.max() > 7.5  # cubics beyond the ends are of third order in slopes; measured: 7.92
