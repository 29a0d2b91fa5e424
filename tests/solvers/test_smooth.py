"""The smooth switch: a plain ODE for any solver, close to the event latch."""

import jax

import slipperjax as sj


def test_what_a_scene_lacks_costs_no_state():
    start = sj.table_2_start()
    plain = sj.paper_scene()
    spring = sj.Scene(plain.speed, plain.slipper, plain.section, plain.track, sj.model.HertzSpring(1e8))
    assert sj.initial_state(spring, start).memory is None
    assert len(jax.tree.leaves(sj.initial_state(spring, start))) == 10
    assert sj.initial_state(plain, start).memory.shape == (20,)
    count = lambda s: str(
        jax.make_jaxpr(lambda y: sj.model.vector_field(s)(0.1, y, sj.model.Args(s)))(sj.initial_state(s, start))
    ).count("\n")
    straight = sj.Scene(
        plain.speed, plain.slipper, plain.section, sj.model.StraightTrack(), sj.model.HertzSpring(1e8)
    )
    assert count(straight) < count(spring) < count(plain)
