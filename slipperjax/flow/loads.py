"""Contact loads of a forcing period: peak forces and their instants, impulses, time in contact, penetration.

Looked for over every integration step and inside it, on cubics through both ends of the step with their slopes along
the motion: fourth order in the step, like the solution, where the highest of a few saved samples misses the peak.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model import Args, Contacts, Motion, State, contact_forces, contacts
from ..tools import materialise
from .poincare import hermite, highest_point, motion_rates_at


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
    stretch: Float[Array, "*cases"]
    """Greatest product of step length and rate of the contacts, of their oscillation or their damping [1]. Explicit
    methods of fourth order are unstable above 2.8."""


def contact_loads(states: State, args: Args, steps: Any, rates: Motion | None = None) -> Loads:
    """Loads of one period.

    **Arguments:** `states`: the states at both ends of every step, leading axis `most` + 1, of which the first
    `steps` + 1 count; `args`: scene and epoch; `steps`: integration steps per period, may be traced; `rates`: of
    `motion_rates_at`, if known.
    """
    most, step = states.motion.y.shape[0] - 1, 1 / steps
    rates = motion_rates_at(jnp.arange(most + 1) / steps, states, args) if rates is None else rates

    def sample(place):
        state, rate = jax.tree.map(lambda a: a[place], (states, rates))
        return _sample(place / steps, state, rate, args)

    begin = sample(0)
    closed = jnp.full_like(begin.force, -jnp.inf)
    nothing = jnp.zeros_like(begin.force)

    def one(carry, place):
        before, (highest, when, impulse, contact, depth, fastest) = carry
        now = sample(place + 1)
        values = [jnp.stack([n.force, -n.gap]) for n in (before, now)]
        slopes = [jnp.stack([step * n.force_rate, -step * n.gap_rate]) for n in (before, now)]
        (inside, _), (peak, deep) = highest_point(values[0], slopes[0], values[1], slopes[1])
        area = (before.force + now.force) / 2 + step * (before.force_rate - now.force_rate) / 12
        share = _share_closed(before.gap, step * before.gap_rate, now.gap, step * now.gap_rate)
        higher = (peak > highest) & (peak > 0)
        found = (
            jnp.maximum(highest, peak),
            jnp.where(higher, (place + inside) / steps + args.epoch, when),
            impulse + area,
            contact + share,
            jnp.maximum(depth, deep),
            jnp.maximum(fastest, now.fastest),
        )
        return now, jax.tree.map(lambda new, old: jnp.where(place < steps, new, old), found, carry[1])

    found = closed, jnp.full_like(nothing, jnp.nan), nothing, nothing, closed, begin.fastest
    # step by step, so that what is computed stays in the cache
    (_, found), _ = jax.lax.scan(lambda carry, place: (one(carry, place), None), (begin, found), jnp.arange(most))
    highest, when, impulse, contact, depth, fastest = found
    ends = lambda a: a.reshape(2, -1)
    seconds = step * args.scene.period
    return Loads(
        ends(highest), ends(when), ends(seconds * impulse), ends(step * contact), ends(depth), step * fastest
    )


def over_periods(loads: Loads, axis: int = 0) -> Loads:
    """Loads of a stretch of periods from those of each, along the axis of periods. Contact fractions are means."""
    highest = jnp.max(loads.peak_force, axis, keepdims=True)
    when = jnp.where(loads.peak_force == highest, loads.peak_period, jnp.inf)
    when = jnp.min(jnp.where(jnp.isnan(when), jnp.inf, when), axis)
    return Loads(
        highest.squeeze(axis),
        jnp.where(jnp.isfinite(when), when, jnp.nan),
        jnp.sum(loads.impulse, axis),
        jnp.mean(loads.contact_fraction, axis),
        jnp.max(loads.penetration, axis),
        jnp.max(loads.stretch, axis),
    )


class _Sample(NamedTuple):
    """Forces and gaps at one instant, with their derivatives along the motion [per forcing period]."""

    force: Array
    force_rate: Array
    gap: Array
    gap_rate: Array
    fastest: Array
    """Rate of the contacts [per forcing period], see `Loads.stretch`."""


def _sample(t: Array, state: State, rates: Motion, args: Args) -> _Sample:
    scene = args.scene

    def at(t, motion):
        now = contacts(args.frame(t), motion)
        return (contact_forces(scene, now, state.memory), now.gap), now

    (force, gap), (force_rate, gap_rate), now = jax.jvp(
        at, (t, state.motion), (jnp.ones_like(t), rates), has_aux=True
    )
    fastest = scene.period * _contact_rate(now, state.memory, args)
    # stored, so that XLA does not compute a sample again wherever it is used
    return _Sample(*materialise((force, force_rate, gap, gap_rate)), fastest)  # pyright: ignore[reportCallIssue]


def _contact_rate(now: Contacts, memory: Any, args: Args) -> Array:
    """The greatest rate of the contacts [1/s]: the sum of their decay rates, or the frequency of their springs.

    For one point of effective mass m these are (dF/dg')/m and sqrt((dF/dg)/m); the sum over the points bounds the
    greatest rate of all together.
    """
    scene, zero = args.scene, jnp.zeros_like(now.gap)
    force = lambda gap, rate: contact_forces(scene, Contacts(gap, rate, now.lever), memory)
    spring = jax.jvp(force, (now.gap, now.rate), (-jnp.ones_like(zero), zero))[1]
    damper = jax.jvp(force, (now.gap, now.rate), (zero, -jnp.ones_like(zero)))[1]
    turn = sum(lever**2 / j for lever, j in zip(now.lever, scene.slipper.inertia, strict=True))
    per_mass = jax.lax.stop_gradient(1 / scene.slipper.mass + turn)
    decay = jnp.sum(jnp.maximum(jax.lax.stop_gradient(damper), 0) * per_mass)
    square = jnp.sum(jnp.maximum(jax.lax.stop_gradient(spring), 0) * per_mass)
    return jnp.maximum(decay, jnp.sqrt(square))


def _share_closed(g0: Array, d0: Array, g1: Array, d1: Array) -> Array:
    """Share of a step in which a gap is negative [1]."""
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
