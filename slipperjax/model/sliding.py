"""Sliding of contacts along the rail, and the tractions of friction."""

import jax.numpy as jnp
from jaxtyping import Array

from ..tools.fused import spread, store
from .kinematics import Motion, RailFrame, rotation
from .loads import AbstractFriction


def sliding_velocity(frame: RailFrame, m: Motion, speed: Array) -> tuple[Array, Array, Array]:
    """Returns the velocities of the slipper's points along the rail's faces, x, y and z [m/s], shape (points,) each.

    The rail stands still. What a point has along its normal is left out.
    """
    r = store(rotation(m))
    normal, (a_x, a_y, a_z) = frame.normal, frame.arm
    flat = spread(a_y.shape[-1], *r[0], *r[1], *r[2], m.v_y, m.v_z, m.w_x, m.w_y, m.w_z)
    r, (v_y, v_z, w_x, w_y, w_z) = (flat[:3], flat[3:6], flat[6:9]), flat[9:]
    spin = w_y * a_z - w_z * a_y, w_z * a_x - w_x * a_z, w_x * a_y - w_y * a_x
    turned = [sum(row[j] * spin[j] for j in range(3)) for row in r]
    velocity = speed + turned[0], v_y + turned[1], v_z + turned[2]
    along = sum(n * v for n, v in zip(normal, velocity, strict=True))
    x, y, z = (v - along * n for v, n in zip(velocity, normal, strict=True))
    return x, y, z


def tractions(
    friction: AbstractFriction, frame: RailFrame, m: Motion, force: Array, speed: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Returns what friction adds to each point per unit of normal force: the force along x, y and z [1], the moment
    about the slipper's axes [m], and the power that becomes heat [m/s]; all of shape (points,).

    **Arguments:** `force`: normal forces [N]; `speed`: travelling speed [m/s].
    """
    velocity = sliding_velocity(frame, m, speed)
    size = jnp.sqrt(sum(v * v for v in velocity))
    share = friction.coefficient_at(force, size)
    f_x, f_y, f_z = (-(share / size) * v for v in velocity)
    r, (a_x, a_y, a_z) = rotation(m), frame.arm
    s_x, s_y, s_z = (r[0][j] * f_x + r[1][j] * f_y + r[2][j] * f_z for j in range(3))
    moment = a_y * s_z - a_z * s_y, a_z * s_x - a_x * s_z, a_x * s_y - a_y * s_x
    return (f_x, f_y, f_z), moment, share * size
