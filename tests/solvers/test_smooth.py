"""The smooth switch: a plain ODE for any solver, close to the event latch."""

import jax
import numpy as np
import pytest

import slipperjax as sj

from ..common import SCALES, columns


@pytest.fixture(scope="module")
def bias():
    """Worst scaled difference from the event latch after 10 periods, by width of the switch [m]."""
    run = lambda memory: columns(
        sj.simulate(sj.paper_scene(memory=memory), 10, steps_per_period=1600, saves_per_period=1)
    )
    truth = run(None)
    return {w: np.max(np.abs(run(sj.SmoothSwitch(width=w)) - truth) / SCALES) for w in (2e-4, 1e-4, 5e-5)}


@pytest.mark.slow
def test_bias_is_of_second_order_in_the_width(bias):
    # known for this scene: 1.3e-3, 3.7e-4 and 9.9e-5 at 200, 100 and 50 um
    assert bias[2e-4] < 2 * 1.3e-3
    assert bias[1e-4] < 2 * 3.7e-4
    assert bias[5e-5] < 2 * 9.9e-5
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
    straight = sj.Scene(plain.speed, plain.slipper, plain.section, sj.StraightTrack(8.0), sj.HertzSpring(1e8))
    assert count(straight) < count(spring) < count(plain)
