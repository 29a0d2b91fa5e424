"""How long a typical impact lasts and how deep it goes, and what follows: step sizes and the smooth switch."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .scene import Scene

SLOWEST_APPROACH = 0.1
"""Least approach speed that a typical impact is taken to have [m/s]."""
PER_CONTACT = 15
"""Steps that a typical impact takes by default."""
LEAST_STEPS = 50
"""Least steps per forcing period by default, and the smallest unit to which they are rounded up."""


def contact_duration(scene: Scene) -> Float[Array, ""]:
    """How long a typical impact lasts [s], from Hertz's theory without damping.

    The approach speed is the track's, see `AbstractTrack.approach_speed` (0.1 m/s at least); the mass is what a
    corner presents, translation and rotation together. Serves to choose step sizes and the smooth switch only.
    """
    return 2.94 * contact_depth(scene) / _approach(scene)


@jax.jit  # one small program instead of one for each operation
def impacts_per_period(scene: Scene) -> Float[Array, ""]:
    """How many typical impacts, one after the other, would fill a forcing period [1]: see `contact_duration`."""
    return scene.period / contact_duration(scene)


def contact_depth(scene: Scene) -> Float[Array, ""]:
    """How deep a typical impact goes [m]: see `contact_duration`."""
    slipper = scene.slipper
    reach = jnp.max(jnp.abs(scene.section.points))
    mass = 1 / (1 / slipper.mass + reach**2 / slipper.inertia[0] + slipper.length**2 / 4 / slipper.inertia[1])
    return (1.25 * mass * _approach(scene) ** 2 / scene.contact.stiffness) ** 0.4


def _approach(scene: Scene) -> Float[Array, ""]:
    return jnp.maximum(scene.track.approach_speed(scene.speed), SLOWEST_APPROACH)


def settle_memory(scene: Scene) -> Scene:
    """A copy whose contact memory has the settings that it leaves to the scene, see `SmoothSwitch`."""
    memory = scene.memory.scaled(contact_depth(scene), contact_duration(scene), scene.period)
    return scene if memory is scene.memory else eqx.tree_at(lambda s: s.memory, scene, memory)


def default_steps_per_period(scene: Scene) -> int:
    """Steps per forcing period such that a typical impact takes `PER_CONTACT` steps, and `LEAST_STEPS` at least.

    Rounded up: to a multiple of 50 up to 300 steps, of 100 up to 600, of 200 up to 1200, and so on.

    **Raises:** `ValueError` for a traced scene, whose numbers are not known.
    """
    ratio = impacts_per_period(scene)
    if isinstance(ratio, jax.core.Tracer):
        raise ValueError("Argument `steps_per_period` must be given where the scene is traced (jit, grad, vmap).")
    return int(steps_from_impacts(np.asarray(ratio)))


def steps_from_impacts(impacts: Any) -> Int[np.ndarray, "*cases"]:
    """Steps per forcing period from `impacts_per_period`, as `default_steps_per_period` gives them."""
    steps = np.maximum(PER_CONTACT * np.asarray(impacts), LEAST_STEPS)
    # Units of 50 up to 300 steps, of 100 up to 600, and so on: the cases of a sweep then share a few step counts.
    octave = np.maximum(np.ceil(np.log2(steps / (6 * LEAST_STEPS))), 0)
    unit = LEAST_STEPS * 2**octave
    return np.asarray(unit * np.ceil(steps / unit), int)
