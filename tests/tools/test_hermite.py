"""Cubics through values and slopes: against NumPy's polynomials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.tools.hermite import Cubic, sign_change


def test_cubics_have_the_values_slopes_and_extremes_of_their_polynomials():
    rng = np.random.default_rng(0)
    begin, slope, end, end_slope = rng.standard_normal((4, 50))
    cubic = Cubic.through(begin, slope, end, end_slope)
    np.testing.assert_allclose(cubic.value(1.0), end, rtol=0, atol=1e-14)
    np.testing.assert_allclose(cubic.slope_at(1.0), end_slope, rtol=0, atol=1e-13)
    extremes = cubic.extremes()
    # where the slope changes its sign there is one extreme
    turns = slope * end_slope < 0
    x = np.asarray(cubic.turn(np.sign(slope)))
    for k in range(50):
        exact = np.polynomial.Polynomial([part[k] for part in cubic])
        np.testing.assert_allclose(cubic.curvature(0.3)[k], exact.deriv(2)(0.3), rtol=0, atol=1e-13)
        roots = exact.deriv().roots()
        inside = np.sort([root.real for root in roots if abs(root.imag) == 0 and 0 < root.real < 1])
        np.testing.assert_allclose(extremes[: len(inside), k], inside, rtol=0, atol=1e-11)
        assert np.all(np.isnan(extremes[len(inside) :, k]))
        if turns[k]:
            np.testing.assert_allclose([x[k]], inside, rtol=0, atol=1e-11)
    assert 10 < turns.sum() < 40


COUNT = 2000
"""Cubics of each kind."""


def path(kind, rng):
    """Start, slope, square and cube of cubics that begin above zero, or at it, and end below."""
    start, end, more = rng.uniform(0.0, 1.0, COUNT), -rng.uniform(0.01, 1.0, COUNT), rng.uniform(0.0, 2.0, COUNT)
    if kind == "hesitates":
        # -(x - at) (slowness + (x - at)^2), nearly level where it is zero
        at, slowness = rng.uniform(0.1, 0.9, COUNT), 10 ** rng.uniform(-2, 0, COUNT)
        return at**3 + slowness * at, -(3 * at**2 + slowness), 3 * at, -np.ones(COUNT)
    slope = {
        "falls": end - start + 0.3 * more,
        "rises first": more,
        "turns": 2.5 * (end - start) - more,  # and is on its way up at the end
        "leaves zero": more,
        "begins to fall": 0.0 * more,
    }[kind]
    start = np.where(kind in ("leaves zero", "begins to fall"), 0.0, start)
    # the parabola with these, bent by a fifth at most
    bend = start + slope - end
    cube = 0.2 * rng.uniform(-1, 1, COUNT) * np.maximum(np.abs(bend), np.abs(slope))
    return start, slope, -bend - cube, cube


def right_zeros(start, slope, square, cube):
    """The zeros between 0 and 1 at which a cubic falls, by NumPy."""
    roots = np.roots([cube, square, slope, start])
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    falls = (3 * cube * real + 2 * square) * real + slope <= 1e-12
    return real[falls & (real > -1e-12) & (real < 1 + 1e-12)]


# greatest errors in all, in 99 % and in the median, about three times what was measured
GREATEST = {
    "falls": (2e-14, 3e-15, 3e-16),
    "rises first": (5e-13, 2e-14, 1e-15),
    "turns": (6e-10, 2e-14, 1e-16),
    "leaves zero": (6e-12, 2e-12, 3e-16),
    "begins to fall": (1e-15, 1e-15, 1e-15),
    "hesitates": (0.15, 0.1, 2e-3),  # triple zeros, nearly
}


@jax.jit
def zeros(start, slope, square, cube):
    """The zeros that the package finds, and the slopes there."""
    cubic = Cubic(start, slope, square, cube)
    found = sign_change(cubic, start + slope + square + cube, jnp.ones(start.shape, bool))
    return found, cubic.slope_at(found)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kind", GREATEST)
def test_the_zero_is_that_in_the_direction_of_the_change(kind, sign):
    numbers = np.stack(path(kind, np.random.default_rng(1)))
    assert np.all(numbers.sum(axis=0) < 0)
    found, falling = map(np.asarray, zeros(*(sign * numbers)))
    # where there are two of them, either is one
    error = np.array([np.min(np.abs(right_zeros(*row) - x)) for row, x in zip(numbers.T, found, strict=True)])
    assert np.all(np.quantile(error, (1.0, 0.99, 0.5)) <= GREATEST[kind])
    # nowhere does it go the other way
    assert np.all(sign * falling <= 0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_guess_on_the_way_back_leads_to_the_change_nevertheless(sign):
    """Cubics that fall through zero and rise towards it again."""
    rng, uniform = np.random.default_rng(2), lambda low, high: rng.uniform(low, high, COUNT)
    ends = uniform(0.1, 0.3), uniform(0.0, 0.2), -uniform(0.1, 0.3), uniform(1.5, 3.0)
    cubic = Cubic.through(*ends)
    # the first guess: the parabola through the start, its slope and the end
    bend = ends[0] + ends[1] - ends[2]
    guess = (ends[1] + np.sqrt(ends[1] ** 2 + 4 * bend * ends[0])) / (2 * bend)
    assert np.mean(cubic.slope_at(guess) > 0) > 0.3  # measured 0.39
    found, _ = map(np.asarray, zeros(*(sign * part for part in cubic)))
    error = np.array([np.min(np.abs(right_zeros(*row) - x)) for row, x in zip(np.stack(cubic).T, found, strict=True)])
    # measured 0.0026 and 0.017; by Newton's method 0.32 and 1
    assert np.median(error) < 0.01
    assert np.max(error) < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_path_that_nearly_touches_zero_before_it_crosses(sign):
    """A gap over a step of a sled on random rails, in micrometres: at 0.88 of the step it falls through zero.

    Two steps of Newton's method from the first guess end at 0.67, where it falls more than three times as fast.
    """
    ends = 8.47446, -16.6054, -0.0424738, 0.982105
    cubic = Cubic.through(*ends)
    found, _ = zeros(*(np.full(COUNT, sign * part) for part in cubic))
    (zero,) = right_zeros(*cubic)
    np.testing.assert_allclose(found, zero, rtol=1e-8)  # measured 1.6e-9


def test_no_zero_is_looked_for_where_none_is_wanted():
    cubic = Cubic(jnp.array([1.0, 0.0, jnp.nan]), jnp.array([-2.0, 0.0, 0.0]), jnp.zeros(3), jnp.zeros(3))
    end, wanted = jnp.array([-1.0, 0.0, 1.0]), jnp.array([False, True, False])
    total, slopes = jax.jit(jax.value_and_grad(lambda c: sign_change(c, end, wanted).sum()))(cubic)
    assert total == 0
    assert all(np.all(part == 0) for part in slopes)


@pytest.mark.full
def test_derivatives_are_those_of_the_zero_to_second_order():
    """Of a stone thrown upwards, whose fall to the ground has a closed form, and of a cubic by differences."""

    def landing(p):
        height, rate, weight = p
        return sign_change(Cubic(height, rate, -weight, 0.0), height + rate - weight, jnp.array(True))

    exact = lambda p: (p[1] + jnp.sqrt(p[1] ** 2 + 4 * p[2] * p[0])) / (2 * p[2])
    for p in ((0.1, 0.4, 1.3), (0.3, -0.2, 1.0), (0.0, 0.5, 0.9)):
        at = jnp.array(p)
        assert landing(at) == pytest.approx(float(exact(at)), abs=1e-14)
        for first, second in ((jax.jacfwd, jax.jacfwd), (jax.jacrev, jax.jacrev), (jax.jacfwd, jax.jacrev)):
            np.testing.assert_allclose(first(landing)(at), first(exact)(at), rtol=1e-12)
            np.testing.assert_allclose(second(first(landing))(at), second(first(exact))(at), rtol=1e-11, atol=1e-12)
    cubic = lambda p: sign_change(Cubic(*p), jnp.sum(p), jnp.array(True))
    p = np.array([0.3, 0.4, -1.2, -0.2])
    by_roots = lambda p: right_zeros(*p)[0]
    step = 1e-4 * np.eye(4)
    mixed = lambda i, j: sum(a * b * by_roots(p + a * step[i] + b * step[j]) for a in (1, -1) for b in (1, -1)) / 4e-8
    differences = np.array([[mixed(i, j) for j in range(4)] for i in range(4)])
    # measured 2.5e-6, the differences' own error
    np.testing.assert_allclose(jax.hessian(cubic)(jnp.array(p)), differences, rtol=0, atol=1e-5)
