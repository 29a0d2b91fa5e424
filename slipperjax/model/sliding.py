"""Sliding of contacts along the rail, and the tractions of friction."""

import jax.numpy as jnp
from jaxtyping import Array

from ..tools.forms import spread, store
from .kinematics import Motion, RailFrame, cross, in_slipper_frame, rotation
from .loads import AbstractFriction


def tractions(
    friction: AbstractFriction, frame: RailFrame, m: Motion, force: Array, speed: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Return what friction adds to each point per unit of normal force: the force along x, y and z [1], the moment
    about the slipper's axes [m], and the power that becomes heat [m/s]; all of shape (points,).

    **Arguments:** `force`: normal forces [N]; `speed`: travelling speed [m/s].
    """
    r = store(rotation(m))
    flat = spread(frame.arm[1].shape[-1], *r[0], *r[1], *r[2], m.v_y, m.v_z, m.w_x, m.w_y, m.w_z)
    v_y, v_z, *spin = flat[9:]
    by_spin = cross(spin, frame.arm)  # in the slipper's frame
    x, y, z = (sum(row[j] * by_spin[j] for j in range(3)) for row in (flat[:3], flat[3:6], flat[6:9]))
    velocity = speed + x, v_y + y, v_z + z
    # the rail does not move, and motion along a point's normal is no sliding
    along = sum(n * v for n, v in zip(frame.normal, velocity, strict=True))
    sliding = [v - along * n for v, n in zip(velocity, frame.normal, strict=True)]
    size = jnp.sqrt(sum(v * v for v in sliding))
    share = friction.coefficient_at(force, size)
    f_x, f_y, f_z = (-(share / size) * v for v in sliding)
    moment = cross(frame.arm, in_slipper_frame(rotation(m), (f_x, f_y, f_z)))
    return (f_x, f_y, f_z), moment, share * size
