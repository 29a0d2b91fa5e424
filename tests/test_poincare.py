"""Section crossings of motions that are known."""

import jax
import jax.numpy as jnp
import numpy as np

from slipperjax.analysis.poincare import crossing, hermite


def test_hermite_is_exact_for_cubics():
    f = lambda x: 2 * x**3 - x**2 + 0.3 * x - 0.7
    df = lambda x: 6 * x**2 - 2 * x + 0.3
    x = np.linspace(0, 1, 7)
    np.testing.assert_allclose(hermite(x, f(0.0), df(0.0), f(1.0), df(1.0)), f(x), atol=1e-15)


def test_crossings_of_an_oscillation_converge_with_fourth_order():
    phase, errors = 0.3, []
    for steps in (20, 40, 80):
        h = 2 * np.pi / steps
        t = np.arange(steps + 1) * h + phase
        q, v, a = np.sin(t), np.cos(t), -np.sin(t)
        q, v, a = q + 0.1 * np.sin(3 * t), v + 0.3 * np.cos(3 * t), a - 0.9 * np.sin(3 * t)
        ends = lambda x: (x[:-1], x[1:])
        (q0, q1), (v0, v1), (a0, a1) = ends(q), ends(v), ends(a)
        place, velocity = jax.vmap(crossing)(*map(jnp.asarray, (q0, h * v0, q1, h * v1, v0, h * a0, v1, h * a1)))
        hit = ~np.isnan(place)
        assert hit.sum() == 1
        time = (np.flatnonzero(hit)[0] + np.asarray(place)[hit][0]) * h + phase
        errors.append([abs(time - 2 * np.pi), abs(np.asarray(velocity)[hit][0] - 1.3)])
    errors = np.array(errors)
    assert errors[2].max() < 1e-6
    assert np.all(errors[0] / errors[2] > 16**2 / 4)  # order 4 over two halvings, with room for where the root falls


def test_downward_crossings_and_misses_are_left_out():
    down = crossing(0.5, -1.0, -0.5, -1.0, 1.0, 0.0, 1.0, 0.0)
    miss = crossing(0.5, 1.0, 1.5, 1.0, 1.0, 0.0, 1.0, 0.0)
    assert np.isnan(down).all()
    assert np.isnan(miss).all()
