"""Derivatives of batches of period maps and simulations, by numbers of all kinds: those of a loop over the cases.

Compositions of all transformations to depth three are in `tests/tools/test_compositions.py`, on a loop that is small.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj

SPEEDS = jnp.array([1100.0, 1250.0])
NUMBERS = {"clearance": jnp.asarray(1e-3), "v_z": jnp.asarray(0.4), "sample": jnp.asarray(0.5e-3)}
STEPS = dict(steps_per_period=20, solver=sj.solvers.RK4())
DISTANCE = np.linspace(0.0, 16.0, 17)
RAIL = sj.model.SampledTrack(DISTANCE, 1e-3 * np.sin(DISTANCE), 1e-3 * np.cos(DISTANCE))
SURVEYED, RANDOM = (
    dataclasses.replace(sj.paper_scene(), track=track) for track in (RAIL, sj.RandomTrack.sled(length=200.0))
)


def scene_of(numbers, speed):
    """A scene with a number of its own, and with a sample of its rail."""
    given = {"clearance": numbers["clearance"], "speed": speed, "track.vertical.2": numbers["sample"]}
    return SURVEYED.replace(**given)


def mapped(numbers, speed):
    scene = scene_of(numbers, speed)
    state = sj.initial_state(scene, sj.Motion(v_z=numbers["v_z"]))
    return sj.period_map(scene, state, **STEPS).motion.v_z


def simulated(numbers, speed):
    run = sj.simulate(scene_of(numbers, speed), 1, start=sj.Motion(v_z=numbers["v_z"]), **STEPS)
    return run.peak.force * 1e-3 + run.state.motion.v_z[-1]


def seeded(numbers, seed):
    scene = RANDOM.replace(**{"clearance": numbers["clearance"], "track.seed": seed})
    state = sj.initial_state(scene, sj.Motion(v_z=numbers["v_z"]))
    return sj.period_map(scene, state, **STEPS).motion.v_z


def mean_of(run, cases):
    return lambda numbers: jnp.mean(jax.vmap(lambda case: run(numbers, case))(cases))


def looped(run, cases):
    """The mean of the derivatives of one case after another."""
    one = jax.jit(jax.jacfwd(run))
    slopes = [one(NUMBERS, case) for case in cases]
    return jax.tree.map(lambda *of: sum(of) / len(of), *slopes)


def close(found, right):
    for name in right:
        # measured: 4e-15
        np.testing.assert_allclose(found[name], right[name], rtol=1e-11, atol=1e-14, err_msg=name)


@pytest.mark.full
@pytest.mark.parametrize(
    ("run", "cases"),
    [(mapped, SPEEDS), (simulated, SPEEDS), (seeded, jnp.array([0.0, 3.0]))],
    ids=["period_map", "simulate", "seeds"],
)
def test_derivatives_of_a_batch_are_those_of_a_loop(run, cases):
    right = looped(run, cases)
    assert abs(float(right["clearance"])) > 0
    for derivative in (jax.jacfwd, jax.grad):
        close(derivative(mean_of(run, cases))(NUMBERS), right)


@pytest.mark.full
def test_a_batch_of_gradients_inside_jit_and_a_scan():
    right = looped(mapped, SPEEDS)
    grads = jax.jit(jax.vmap(jax.grad(mapped), (None, 0)))(NUMBERS, SPEEDS)
    close(jax.tree.map(jnp.mean, grads), right)

    def total(numbers):
        add = lambda total, speed: (total + jax.checkpoint(mapped)(numbers, speed), None)
        return jax.lax.scan(add, 0.0, SPEEDS)[0] / SPEEDS.size

    close(jax.grad(total)(NUMBERS), right)
