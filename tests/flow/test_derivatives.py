"""Tangents through many touchdowns against central differences, and why the latch is interpolated."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj

from ..common import SCALES

NAMES = ("clearance", "length", "speed", "stiffness", "restitution", "v_y", "w_x")
VALUES = np.array([1e-3, 0.2, 1250.0, 1e8, 0.9, 0.5, 0.2])
STEPS = 100


def end_state(values, adjoint, steps=STEPS, memory=None):
    """The ten states after three periods, scaled, from parameters relative to `VALUES`."""
    p = dict(zip(NAMES, values * VALUES, strict=True))
    scene = sj.paper_scene(memory=memory).replace(**{k: p[k] for k in NAMES[:5]})
    start = sj.Motion(v_y=p["v_y"], v_z=0.5, w_x=p["w_x"], w_y=0.3, w_z=0.4)
    state = sj.initial_state(scene, start)
    end = sj.period_map(scene, state, periods=3, steps_per_period=steps, adjoint=adjoint).motion
    q_scales = np.concatenate([SCALES[:2], SCALES[2:5] / 2, SCALES[5:]])
    return jnp.stack(jax.tree.leaves(end)) / q_scales


@pytest.fixture(scope="module")
def forward():
    return np.asarray(jax.jit(jax.jacfwd(lambda v: end_state(v, diffrax.ForwardMode())))(jnp.ones(7)))


def test_forward_mode_is_the_derivative_of_the_map(forward):
    run = jax.jit(jax.vmap(lambda v: end_state(v, diffrax.ForwardMode())))

    def differences(h):
        shifts = np.concatenate([np.eye(7), -np.eye(7)]) * h
        out = np.asarray(run(1 + shifts))
        return (out[:7] - out[7:]).T / (2 * h)

    central = (4 * differences(1e-6) - differences(2e-6)) / 3
    size = np.abs(central).max(axis=0)
    assert np.all(size > 1e-2)  # every parameter has an effect
    assert np.all(np.isfinite(forward))
    worst = np.max(np.abs(forward - central) / size)
    assert worst < 1e-5, worst


@pytest.mark.slow
def test_reverse_mode_agrees_with_forward_mode(forward):
    cotangent = jnp.cos(jnp.arange(10.0))  # one combination of the states, as their Jacobian would need ten passes

    def combination(values):
        return cotangent @ end_state(values, diffrax.RecursiveCheckpointAdjoint())

    reverse = jax.jit(jax.grad(combination))(jnp.ones(7))
    expected = np.asarray(cotangent) @ forward
    np.testing.assert_allclose(reverse, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


class StepEndLatch(sj.EventLatch):
    """Wrong on purpose: latches the rate at the end of the step in which a point touched down."""

    def latch(self, memory, before, gap, rate, step, ratio):
        entered = (before.gap >= 0) & (gap < 0)
        return jnp.where(gap >= 0, 0.0, jnp.where(entered, 1 / jnp.minimum(rate, -1e-9), memory))


@pytest.mark.slow
def test_a_latch_at_the_steps_end_has_wrong_tangents(forward):
    starts = np.array([5, 6])  # the tangents with respect to the start, v_y and w_x
    basis = jnp.eye(7)[starts]
    truth = forward[:, starts]  # of the interpolated latch: its own error at these steps is below 2e-2

    def error(steps):
        run = lambda v: end_state(v, diffrax.ForwardMode(), steps, StepEndLatch())
        tangents = jax.jit(jax.vmap(lambda t: jax.jvp(run, (jnp.ones(7),), (t,))[1]))(basis)
        return np.abs(np.asarray(tangents).T - truth).max() / np.abs(truth).max()

    assert error(STEPS) > 5e-2
    assert error(4 * STEPS) > 5e-2  # shorter steps do not help
