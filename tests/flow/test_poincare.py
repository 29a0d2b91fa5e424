"""Section crossings of known motions."""

import jax.numpy as jnp
import numpy as np

import slipperjax as sj
from slipperjax.flow import course

crossing = sj.jit(course.crossing)  # one small program instead of one for each operation


def test_crossings_of_an_oscillation_converge_with_fourth_order():
    worst = []
    for steps in (20, 80):
        h, errors = 2 * np.pi / steps, []
        for phase in 0.3 + np.linspace(0, h, 9)[:-1]:  # the error depends on where in its step the root falls
            t = np.arange(steps + 1) * h + phase
            q, v = np.sin(t) + 0.1 * np.sin(3 * t), np.cos(t) + 0.3 * np.cos(3 * t)
            a = -np.sin(t) - 0.9 * np.sin(3 * t)
            place, velocity = (np.asarray(x) for x in crossing(*map(jnp.asarray, (q, h * v, v, h * a))))
            hit = ~np.isnan(place)
            assert hit.sum() == 1
            time = (np.flatnonzero(hit)[0] + place[hit][0]) * h + phase
            errors.append([abs(time - 2 * np.pi), abs(velocity[hit][0] - 1.3)])
        worst.append(np.max(errors, axis=0))
    assert worst[1].max() < 1e-5
    assert np.all(worst[0] / worst[1] > 100)  # order 4 is 256 over two halvings, order 3 would be 64


def test_downward_crossings_and_misses_are_left_out():
    ends = lambda *values: jnp.array(values)
    down = crossing(ends(0.5, -0.5), ends(-1.0, -1.0), ends(1.0, 1.0), ends(0.0, 0.0))
    miss = crossing(ends(0.5, 1.5), ends(1.0, 1.0), ends(1.0, 1.0), ends(0.0, 0.0))
    assert np.isnan(down).all()
    assert np.isnan(miss).all()
