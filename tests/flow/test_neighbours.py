"""Slopes from neighbouring steps: exact for cubics, of fourth order, and blind to what lies beyond the steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.flow import course
from slipperjax.flow.course import DIFFERENCE_MARGIN

# few programs instead of one for each operation
continued, slopes = jax.jit(course.continued), jax.jit(course.step_slopes)


@pytest.mark.parametrize(("degree", "ends"), [(1, 2), (2, 3), (3, 4), (3, 5), (3, 30)])
def test_polynomials_go_on_and_have_exact_slopes(degree, ends):
    place = np.arange(-DIFFERENCE_MARGIN, ends + DIFFERENCE_MARGIN, dtype=float)
    values, rates = place**degree - 3 * place, degree * place ** (degree - 1) - 3
    inner = slice(DIFFERENCE_MARGIN, -DIFFERENCE_MARGIN)
    scale = np.abs(values).max()  # measured: no difference at all
    np.testing.assert_allclose(continued(jnp.asarray(values[inner]), ends - 1), values, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(slopes(jnp.asarray(values[inner]), ends - 1), rates[inner], rtol=0, atol=1e-14 * scale)


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


def test_what_lies_beyond_the_steps_does_not_count():
    values = np.sin(np.arange(41.0) / 7)
    short, padded = (slopes(given, 30) for given in (values[:31], np.where(np.arange(41) < 31, values, np.nan)))
    np.testing.assert_array_equal(padded[:31], short)
