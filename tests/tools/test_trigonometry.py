"""Sine and cosine by polynomials, against NumPy's."""

import jax
import jax.numpy as jnp
import numpy as np

from slipperjax.tools import jit, sin_cos


def test_sine_and_cosine_are_exact_to_rounding():
    angle = np.concatenate([np.linspace(-4 * np.pi, 4 * np.pi, 100_001), np.linspace(-1e-3, 1e-3, 1001)])
    for function in (sin_cos, jit(sin_cos)):
        s, c = function(angle)
        np.testing.assert_allclose(s, np.sin(angle), rtol=0, atol=7e-16)  # measured 5.6e-16
        np.testing.assert_allclose(c, np.cos(angle), rtol=0, atol=7e-16)


def test_derivatives_of_first_and_second_order_in_both_modes():
    angle = jnp.linspace(-7.0, 7.0, 29)
    sine = lambda a: sin_cos(a)[0]
    for slope, bend in ((jax.grad(sine), jax.grad(jax.grad(sine))), (jax.jacfwd(sine), jax.hessian(sine))):
        np.testing.assert_allclose(jax.vmap(slope)(angle), np.cos(angle), atol=7e-16)
        np.testing.assert_allclose(jax.vmap(bend)(angle), -np.sin(angle), atol=7e-16)


def test_nan_and_infinite_angles_give_nan():
    assert np.all(np.isnan(sin_cos(jnp.asarray([np.nan, np.inf]))))
