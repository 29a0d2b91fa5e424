"""Contact loads of a forcing period: peak forces and their instants, impulses, time in contact, penetration.

Looked for over every integration step and inside it, on cubics through both ends of the step: fourth order in the
step, like the solution, where the highest of a few saved samples misses the peak.

Slopes are central differences over five ends of steps, fourth order too: those along the motion would need the
derivatives of rail and contacts, which cost as much as all else.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.dynamics import Args, contact_forces
from ..model.kinematics import Contacts
from ..tools.fused import sums
from .poincare import hermite, highest_point

DIFFERENCE_MARGIN = 2
"""Values that a central difference needs before and after its place."""

_NEXT = {2: (-1, 2), 3: (1, -3, 3), 4: (-1, 4, -6, 4)}
"""Weights of equidistant values in the next one of the polynomial through them."""


def continued(values: Float[Array, "ends ..."], steps: Any) -> Float[Array, "ends+4 ..."]:
    """Returns values at the ends of steps, of which the first `steps` + 1 count, with two before and two after those.

    Before and after the period, values go on as the cubics through the nearest four.
    """
    last, few = jnp.asarray(steps, int), min(len(values), 4)
    earlier = _two_more(values[few - 1 :: -1])[::-1]
    later = _two_more(jax.lax.dynamic_slice_in_dim(values, last + 1 - few, few))
    values = jnp.concatenate([earlier, values, later])
    return jax.lax.dynamic_update_slice_in_dim(values, later, last + 1 + DIFFERENCE_MARGIN, 0)


def central_difference(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Returns the slope [per step] amid four values: two samples before the place and two after it."""
    return (8 * (c - b) + a - d) / 12


def step_slopes(values: Float[Array, "ends ..."], steps: Any) -> Float[Array, "ends ..."]:
    """Returns slopes [per step] at the ends of steps, of which the first `steps` + 1 count."""
    a, b, _, c, d = (continued(values, steps)[k : k + len(values)] for k in range(2 * DIFFERENCE_MARGIN + 1))
    return central_difference(a, b, c, d)


def _two_more(values: Array) -> Array:
    """Returns the next two values of the polynomial through two to four equidistant ones, along the first axis."""
    weights = np.array(_NEXT[len(values)])
    following = lambda v: jnp.tensordot(weights, v[-len(weights) :], 1)
    values = jnp.stack([*values, following(values)])
    return jnp.stack([values[-1], following(values)])


class Loads(NamedTuple):
    """Loads of each contact point, front and rear, in one forcing period or in a stretch of them."""

    peak_force: Float[Array, "*cases 2 points"]
    """Highest normal force [N]."""
    peak_period: Float[Array, "*cases 2 points"]
    """Its instant [forcing periods]; NaN where the force is zero throughout."""
    impulse: Float[Array, "*cases 2 points"]
    """Integral of the normal force over time [N s]."""
    contact_fraction: Float[Array, "*cases 2 points"]
    """Share of the time in which the gap is negative [1]."""
    penetration: Float[Array, "*cases 2 points"]
    """Greatest penetration [m]; negative where the gap stays open, then the smallest gap."""
    stability_number: Float[Array, "*cases"]
    """Greatest product of step length and rate of the contacts, of their oscillation or their damping [1]. Explicit
    methods of fourth order are unstable above 2.8."""


def contact_loads(
    force: Float[Array, "ends 2 points"],
    gap: Float[Array, "ends 2 points"],
    rate: Float[Array, " ends"],
    args: Args,
    steps: Any,
) -> Loads:
    """Returns loads of one period.

    **Arguments:** forces [N], gaps [m] and `contact_rate` [1/s] at both ends of every step, of which the first
    `steps` + 1 count; `args`: scene and epoch; `steps`: integration steps per period, may be traced; 3 at least.
    """
    most, step = len(force) - 1, 1 / steps
    period = args.travel(0.5).period
    fastest = jnp.max(jnp.where(jnp.arange(most + 1) <= steps, rate, 0.0)) * period
    # all points in one row, which is faster than two
    flat = lambda a: a.reshape(most + 1, -1)
    values = continued(jnp.stack((flat(force), flat(-gap)), axis=1), steps)

    def one(carry, place):
        (highest, when, impulse, contact, deepest), slope = carry
        around = jax.lax.dynamic_slice_in_dim(values, place + 1, 5)
        _, begin, end, _, _ = around
        next_slope = _slope(*around)
        (inside, _), (peak, deep) = highest_point(begin, slope, end, next_slope)
        area = (begin[0] + end[0]) / 2 + (slope[0] - next_slope[0]) / 12
        new = (
            jnp.maximum(highest, peak),
            jnp.where((peak > highest) & (peak > 0), (place + inside) * step + args.epoch, when),
            impulse + area,
            contact + _share_closed(-begin[1], -slope[1], -end[1], -next_slope[1]),
            jnp.maximum(deepest, deep),
        )
        return (jax.tree.map(lambda n, old: jnp.where(place < steps, n, old), new, carry[0]), next_slope), None

    nothing = jnp.zeros(values.shape[-1])
    totals = nothing - jnp.inf, nothing + jnp.nan, nothing, nothing, nothing - jnp.inf
    # step by step, so that what is computed stays in the cache
    (totals, _), _ = jax.lax.scan(one, (totals, _slope(*values[:5])), jnp.arange(most))
    highest, when, impulse, contact, depth = (a.reshape(force.shape[1:]) for a in totals)
    return Loads(highest, when, step * period * impulse, step * contact, depth, step * fastest)


def over_periods(loads: Loads) -> Loads:
    """Returns loads of several periods from those of each, along the first axis. Contact fractions are means."""
    highest = jnp.max(loads.peak_force, 0)
    when = jnp.where(loads.peak_force == highest[None], loads.peak_period, jnp.inf)
    when = jnp.min(jnp.where(jnp.isnan(when), jnp.inf, when), 0)
    return Loads(
        highest,
        jnp.where(jnp.isfinite(when), when, jnp.nan),
        jnp.sum(loads.impulse, 0),
        jnp.mean(loads.contact_fraction, 0),
        jnp.max(loads.penetration, 0),
        jnp.max(loads.stability_number, 0),
    )


def _slope(a: Array, b: Array, here: Array, c: Array, d: Array) -> Array:
    """Returns slopes of force and penetration [per step] from the values of two samples before and two after.

    A force that is zero begins or ends there, or is zero throughout: its slope is zero in each case.
    """
    slope = central_difference(a, b, c, d)
    return jnp.stack([jnp.where(here[0] > 0, slope[0], 0.0), slope[1]])


def contact_rate(now: Contacts, memory: Any, args: Args) -> Array:
    """Gives the greatest rate of the contacts [1/s]: the sum of their decay rates, or the frequency of their springs.

    For one point of effective mass m these are (dF/dg')/m and sqrt((dF/dg)/m); the sum over the points bounds the
    greatest rate of all together.
    """
    scene, zero = args.scene, jnp.zeros_like(now.gap)
    force = lambda gap, rate: contact_forces(scene, Contacts(gap, rate, now.lever), memory)
    spring = jax.jvp(force, (now.gap, now.rate), (-jnp.ones_like(zero), zero))[1]
    damper = jax.jvp(force, (now.gap, now.rate), (zero, -jnp.ones_like(zero)))[1]
    turn = sum(lever**2 * (1 / j) for lever, j in zip(now.lever, scene.slipper.inertia, strict=True))
    per_mass = jax.lax.stop_gradient(1 / scene.slipper.mass + turn)
    # one pass over the points, see `slipperjax.tools.fused`
    decay, square = sums(*(jnp.maximum(jax.lax.stop_gradient(x), 0) * per_mass for x in (damper, spring)))
    return jnp.maximum(decay, jnp.sqrt(square))


def _share_closed(g0: Array, d0: Array, g1: Array, d1: Array) -> Array:
    """Returns the share of a step in which a gap is negative [1]."""
    changes = (g0 < 0) != (g1 < 0)
    x = g0 / jnp.where(changes, g0 - g1, 1.0)
    a, b = 2 * (g0 - g1) + d0 + d1, 3 * (g1 - g0) - 2 * d0 - d1
    for _ in range(2):
        slope = (3 * a * x + 2 * b) * x + d0
        towards = changes & (slope * (g1 - g0) > 0)
        x = jnp.clip(
            x - jnp.where(towards, hermite(x, g0, d0, g1, d1) / jnp.where(towards, slope, 1.0), 0.0), 0.0, 1.0
        )
    within = jnp.where(g0 < 0, x, 1 - x)
    return jnp.where(changes, within, jnp.where(g0 < 0, 1.0, 0.0))
