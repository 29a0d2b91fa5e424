"""Norm and first directions of tangents of a slipper's state."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from ..analysis import first_tangents
from ..model import MOTION_SCALES, Scene, SmoothField, State, vector_field
from ..tools import Batched, jit

MOTION_WEIGHTS = jax.tree.map(lambda scale: 1 / scale, MOTION_SCALES)
"""Weights of the motion in a tangent's norm [1/unit], the reciprocals of `slipperjax.model.MOTION_SCALES`."""


def tangent_weights(scene: Scene) -> Callable[[State], State]:
    """Gives the weights of a tangent's components at a state, see `slipperjax.analysis.push_tangents`.

    The motion counts in multiples of its scales. Of `EventLatch`, the memory of closed contacts counts relative to
    itself, that of open ones not at all; of `SmoothSwitch`, 1 m/s of memory counts as one.
    """
    return _smooth_weights if isinstance(vector_field(scene), SmoothField) else _latched_weights


def _latched_weights(state: State) -> State:
    if state.memory is None:
        return State(MOTION_WEIGHTS, None)
    closed = state.memory < -1e-9
    return State(MOTION_WEIGHTS, jnp.where(closed, -1 / jnp.where(closed, state.memory, -1.0), 0.0))


def _smooth_weights(state: State) -> State:
    return State(MOTION_WEIGHTS, jnp.ones_like(state.memory))


@functools.partial(jit, static_argnames=("count",))
def initial_tangents(scenes: Batched[Scene], states: State, count: int) -> State:
    """`count` orthonormal tangents for each case of a batch, with axes (cases, count, ...)."""
    return scenes.map(lambda scene, state: first_tangents(state, count, tangent_weights(scene)), states)
