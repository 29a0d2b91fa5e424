"""Cubics through values and slopes: against NumPy's polynomials."""

import numpy as np

from slipperjax.tools.hermite import Cubic


def test_values_are_exact_for_cubics():
    f = lambda x: 2 * x**3 - x**2 + 0.3 * x - 0.7
    df = lambda x: 6 * x**2 - 2 * x + 0.3
    x = np.linspace(0, 1, 7)
    np.testing.assert_allclose(Cubic.through(f(0.0), df(0.0), f(1.0), df(1.0)).value(x), f(x), atol=1e-15)


def test_cubics_have_the_values_slopes_and_extremes_of_their_polynomials():
    rng = np.random.default_rng(0)
    begin, slope, end, end_slope = rng.standard_normal((4, 50))
    cubic = Cubic.through(begin, slope, end, end_slope)
    np.testing.assert_allclose(cubic.value(1.0), end, atol=1e-14)
    np.testing.assert_allclose(cubic.slope_at(1.0), end_slope, atol=1e-13)
    extremes = cubic.extremes()
    # where the slope changes its sign there is one extreme
    turns = slope * end_slope < 0
    x = np.asarray(cubic.turn(np.sign(slope)))
    for k in range(50):
        exact = np.polynomial.Polynomial([part[k] for part in cubic])
        np.testing.assert_allclose(cubic.curvature(0.3)[k], exact.deriv(2)(0.3), atol=1e-13)
        roots = exact.deriv().roots()
        inside = np.sort([root.real for root in roots if abs(root.imag) == 0 and 0 < root.real < 1])
        np.testing.assert_allclose(extremes[: len(inside), k], inside, atol=1e-11)
        assert np.all(np.isnan(extremes[len(inside) :, k]))
        if turns[k]:
            np.testing.assert_allclose([x[k]], inside, atol=1e-11)
    assert 10 < turns.sum() < 40
