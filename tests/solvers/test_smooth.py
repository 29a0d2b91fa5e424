"""The smooth switch: a plain ODE for any solver, close to the event latch."""

import jax
import numpy as np
import pytest

import slipperjax as sj

from ..common import SCALES, columns


@pytest.mark.slow
def test_bias_is_of_second_order_in_the_width():
    """Worst scaled difference from the event latch after 10 periods."""
    options = dict(steps_per_period=1600, saves_per_period=1)
    run = lambda memory: columns(sj.simulate(sj.paper_scene(memory=memory), 10, **options))
    truth = run(None)
    # known for this scene, by the width of the switch [m]
    known = {2e-4: 1.3e-3, 1e-4: 3.7e-4, 5e-5: 9.9e-5}
    bias = {w: np.max(np.abs(run(sj.SmoothSwitch(width=w)) - truth) / SCALES) for w in known}
    assert all(bias[w] < 2 * most for w, most in known.items())
    assert np.log2(bias[2e-4] / bias[5e-5]) / 2 > 1.6


def test_what_a_scene_lacks_costs_no_state():
    start = sj.table_2_start()
    plain = sj.paper_scene()
    spring = sj.Scene(plain.speed, plain.slipper, plain.section, plain.track, sj.HertzSpring(1e8))
    assert sj.initial_state(spring, start).memory is None
    assert len(jax.tree.leaves(sj.initial_state(spring, start))) == 10
    assert sj.initial_state(plain, start).memory.shape == (20,)
    count = lambda s: str(
        jax.make_jaxpr(lambda y: sj.vector_field(s)(0.1, y, sj.Args(s)))(sj.initial_state(s, start))
    ).count("\n")
    straight = sj.Scene(plain.speed, plain.slipper, plain.section, sj.StraightTrack(), sj.HertzSpring(1e8))
    assert count(straight) < count(spring) < count(plain)
