"""Poincare section by upward zero crossings of a coordinate, as the paper's bifurcation diagrams have it.

The section of a coordinate q is the velocity at the instants at which q crosses zero upwards. Both are found
on cubics through the ends of each integration step, which use the accelerations: fourth order in the step, like
the solution, and not the chord between saved samples.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.dynamics import Args
from ..model.kinematics import Motion, euler_angles


class Crossings(NamedTuple):
    """One entry per section, in the order of `slipperjax.model.SECTIONS`, and step; NaN where nothing crossed."""

    time: Float[Array, "5 steps"]
    """Instant of the crossing [forcing periods]."""
    velocity: Float[Array, "5 steps"]
    """Velocity there, v_y, v_z [m/s], w_x, w_y, w_z [rad/s]."""


def hermite(x, f0, d0, f1, d1):
    """Returns the cubic on [0, 1] with values f0, f1 and slopes d0, d1 at the ends."""
    a, b = 2 * (f0 - f1) + d0 + d1, 3 * (f1 - f0) - 2 * d0 - d1
    return ((a * x + b) * x + d0) * x + f0


def highest_point(f0: Array, d0: Array, f1: Array, d1: Array) -> tuple[Array, Array]:
    """Gives place in [0, 1] and value of a cubic's highest point, from its values f and slopes d at the ends."""
    a, b = 2 * (f0 - f1) + d0 + d1, 3 * (f1 - f0) - 2 * d0 - d1
    inside = (d0 > 0) & (d1 < 0)
    # zero of the slope 3 a x^2 + 2 b x + d0; real, as the slope changes its sign
    root = jnp.sqrt(jnp.where(inside, b * b - 3 * a * d0, 1.0))
    x = jnp.where(inside, d0 / jnp.where(inside, root - b, 1.0), jnp.where(f1 > f0, 1.0, 0.0))
    return x, jnp.where(inside, hermite(x, f0, d0, f1, d1), jnp.maximum(f0, f1))


def crossing(q0, d0, q1, d1, v0, a0, v1, a1):
    """Tells where in a step a coordinate crosses zero upwards, and the velocity there.

    **Arguments:** coordinate and its slope at both ends, velocity and its slope at both ends; slopes are per step.

    **Returns:** the place in [0, 1] and the velocity, both NaN without an upward crossing.
    """
    crosses = (q0 < 0) & (q1 >= 0)
    a, b = 2 * (q0 - q1) + d0 + d1, 3 * (q1 - q0) - 2 * d0 - d1

    def newton(_, bracket):  # kept between bounds that close in
        x, low, high = bracket
        value = ((a * x + b) * x + d0) * x + q0
        low, high = jnp.where(value < 0, x, low), jnp.where(value < 0, high, x)
        slope = (3 * a * x + 2 * b) * x + d0
        to = x - value / jnp.where(slope > 0, slope, 1.0)
        inside = (slope > 0) & (to >= low) & (to <= high)
        return jnp.where(inside, to, (low + high) / 2), low, high

    x = -q0 / jnp.where(crosses, q1 - q0, 1.0)
    x, _, _ = jax.lax.fori_loop(0, 6, newton, (x, jnp.zeros_like(x), jnp.ones_like(x)))
    velocity = hermite(x, v0, a0, v1, a1)
    return jnp.where(crosses, x, jnp.nan), jnp.where(crosses, velocity, jnp.nan)


def section_crossings(motion: Motion, rates: Motion, args: Args, steps: Any) -> Crossings:
    """Returns crossings of all five sections in one period.

    **Arguments:** `motion`, `rates`: the motion at both ends of every step and its derivatives [per forcing period],
    leading axis `most` + 1, of which the first `steps` + 1 count; `args`: with the epoch; `steps`: integration steps
    per period, may be traced.
    """
    index = jnp.arange(motion.y.shape[0])

    def sample(m, rate):
        angles, angle_rates = jax.jvp(euler_angles, (m,), (rate,))
        coordinate = jnp.stack([m.y, m.z, *angles])
        slope = jnp.stack([rate.y, rate.z, *angle_rates])
        velocity = jnp.stack([m.v_y, m.v_z, m.w_x, m.w_y, m.w_z])
        acceleration = jnp.stack([rate.v_y, rate.v_z, rate.w_x, rate.w_y, rate.w_z])
        return coordinate, slope / steps, velocity, acceleration / steps

    q, d, v, a = jax.vmap(sample, out_axes=1)(motion, rates)
    place, velocity = crossing(q[:, :-1], d[:, :-1], q[:, 1:], d[:, 1:], v[:, :-1], a[:, :-1], v[:, 1:], a[:, 1:])
    used = (index[:-1] < steps)[None]
    time = (index[:-1][None] + place) / steps + args.epoch
    return Crossings(jnp.where(used, time, jnp.nan), jnp.where(used, velocity, jnp.nan))
