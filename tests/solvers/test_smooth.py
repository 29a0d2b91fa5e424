"""The smooth switch: a plain ODE for any solver, close to the event latch."""

import diffrax
import jax
import jax.numpy as jnp
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


@pytest.mark.slow
def test_stock_implicit_solver_under_vmap_agrees_with_rk4():
    scene = sj.paper_scene(memory=sj.SmoothSwitch(width=1e-4))

    @jax.jit
    @jax.vmap
    def both(speed):
        case = scene.replace(speed=speed)
        state = sj.initial_state(case, sj.table_2_start())
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(sj.vector_field(case)),
            diffrax.Kvaerno5(),
            t0=0.0,
            t1=1.0,
            dt0=1e-3,
            y0=state,
            args=sj.Args(case),
            stepsize_controller=diffrax.PIDController(rtol=1e-7, atol=1e-9),
            max_steps=20_000,
        )
        ours = sj.period_map(case, state, steps_per_period=800)
        last = jax.tree.map(lambda ys: ys[-1], solution.ys)
        return tuple(jnp.stack(jax.tree.leaves(s.motion)) for s in (last, ours))

    stock, ours = both(jnp.array([900.0, 1250.0]))
    # measured 1e-6 and less
    assert np.max(np.abs(np.asarray(stock - ours)) / SCALES) < 1e-4


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
