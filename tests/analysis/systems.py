"""Oscillators of textbooks with exact or nearly exact flows, and short ways to follow motions, for the tests."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from slipperjax.analysis.continuation import continue_motion
from slipperjax.analysis.shooting import PeriodicMotions

SAMPLES = 48
"""Instants of an arc between which an extremum is looked for."""


def rk4(field, state, period, steps):
    """`state` after a period of s' = field(s, t) from t = 0, by the classical method of Runge and Kutta."""
    h = period / steps

    def one(s, i):
        t = i * h
        k1 = field(s, t)
        k2 = field(s + h / 2 * k1, t + h / 2)
        k3 = field(s + h / 2 * k2, t + h / 2)
        return s + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(s + h * k3, t + h)), None

    return jax.lax.scan(one, state, jnp.arange(float(steps)))[0]


class Arc(eqx.Module):
    """x'' + 2 damping x' + stiffness x = offset + force cos(frequency t), by its closed form."""

    damping: jax.Array
    stiffness: jax.Array
    offset: jax.Array
    force: jax.Array
    frequency: jax.Array

    def steady(self, t):
        w = self.frequency
        value = self.force / (self.stiffness - w**2 + 2j * self.damping * w) * jnp.exp(1j * w * t)
        return value.real + self.offset / self.stiffness, (1j * w * value).real

    def __call__(self, state, start, span):
        """(x, v) after a time `span` from `state` = (x, v) at the time `start`."""
        d, root = self.damping, jnp.sqrt(self.stiffness - self.damping**2)
        x0, v0 = self.steady(start)
        y, z = state[0] - x0, state[1] - v0
        cos, sin, fade = jnp.cos(root * span), jnp.sin(root * span) / root, jnp.exp(-d * span)
        x1, v1 = self.steady(start + span)
        return x1 + fade * (y * cos + (z + d * y) * sin), v1 + fade * (z * cos - (d * z + self.stiffness * y) * sin)


def linear(stiffness, damping, shift, force, frequency):
    """By SciPy: the flow of x'' + 2 damping x' + stiffness x = shift + force cos(frequency t)."""
    matrix = np.array([[0.0, 1.0], [-stiffness, -2 * damping]])
    gain = force / (stiffness - frequency**2 + 2j * damping * frequency)

    def steady(t):
        value = gain * np.exp(1j * frequency * t)
        return np.array([value.real + shift / stiffness, (1j * frequency * value).real])

    return lambda s, t, span: steady(t + span) + expm(span * matrix) @ (s - steady(t)), matrix


def _halved(beyond, low, high):
    """Instants between `low` and `high` from which on `beyond` holds, to rounding."""

    def half(_, pair):
        low, high = pair
        middle = (low + high) / 2
        there = beyond(middle)
        return jnp.where(there, low, middle), jnp.where(there, middle, high)

    return jax.lax.fori_loop(0, 55, half, (low, high))[1]


class Stopped(eqx.Module):
    """A linear forced oscillator with a stop at x = gap, over one forcing period, with exact instants of contact.

    The stop is a spring of stiffness `stop`, or, where this is None, rigid with a coefficient of `restitution`.
    """

    damping: jax.Array
    frequency: jax.Array
    force: jax.Array
    gap: jax.Array
    stop: jax.Array | None = None
    restitution: jax.Array | None = None
    passes: int = eqx.field(static=True, default=4)
    """Most arcs in a period."""

    @property
    def period(self):
        return 2 * jnp.pi / self.frequency

    def arc(self, touching):
        more = 0.0 if self.stop is None else touching * self.stop
        return Arc(self.damping, 1.0 + more, more * self.gap, self.force, self.frequency)

    def __call__(self, state, k):
        return self.followed(state)[0]

    def followed(self, state):
        """The state after a period, the number of touches, and how far the motion is from another number."""
        touching = jnp.where(state[0] > self.gap, 1.0, 0.0) if self.stop is not None else jnp.asarray(0.0)

        def one(carry, _):
            state, time, touching, touches, margin = carry
            arc, side, left = self.arc(touching), 1 - 2 * touching, self.period - time
            at = lambda span: arc(state, time, span)
            fixed, begin = jax.lax.stop_gradient((self, (arc, state, time, side, left)))
            span, there, near = fixed._crossing(*begin)
            # its first derivatives, by the implicit function theorem
            miss, speed = at(span)[0] - self.gap, jax.lax.stop_gradient(at(span)[1])
            change = (jax.lax.stop_gradient(miss) - miss) / jnp.where(there, speed, 1.0)
            span = jnp.where(there, span + change, span)
            end = jnp.where(there, span, left)
            x, v = at(end)
            if self.stop is None:
                near = jnp.minimum(near, jnp.where(there, v**2, jnp.inf))
                v, turned = jnp.where(there, -self.restitution * v, v), touching
            else:
                turned = jnp.where(there, 1 - touching, touching)
            touches = touches + jnp.where(there & (touching == 0), 1, 0)
            return (jnp.stack([x, v]), time + end, turned, touches, jnp.minimum(margin, near)), None

        begin = state, jnp.asarray(0.0), touching, jnp.asarray(0), jnp.asarray(jnp.inf)
        state, _, _, touches, margin = jax.lax.scan(one, begin, None, length=self.passes)[0]
        return state, touches, margin

    def _crossing(self, arc, state, time, side, left):
        """When the arc passes the gap to the `side`, whether it does, and how far its extrema are from the gap."""
        at = lambda span: arc(state, time, span)
        grid = left * jnp.linspace(0.0, 1.0, SAMPLES)
        low, high = grid[:-1], grid[1:]

        def extrema(sign):
            speed = lambda span: sign * at(span)[1]
            return (speed(low) > 0) & (speed(high) < 0), _halved(lambda span: speed(span) < 0, low, high)

        turns, peaks = extrema(side)
        grid = jnp.stack([jnp.where(turns, peaks, (low + high) / 2), high], axis=1).reshape(-1)
        beyond = lambda span: side * (at(span)[0] - self.gap) > 0
        there = jnp.any(beyond(grid)) & (left > 1e-12)
        k = jnp.argmax(beyond(grid))
        span = _halved(beyond, jnp.where(k > 0, grid[k - 1], 0.0), grid[k])
        highest, peaks = extrema(1.0)  # above the gap in contact, below it else
        counted = highest & (~there | (peaks < span)) & (left > 1e-12)
        return span, there, jnp.min(jnp.where(counted, jnp.abs(at(peaks)[0] - self.gap), jnp.inf))


def motions(family, size=1, **options):
    return PeriodicMotions(family, jnp.zeros(size), 1.0, **options)


def follow(family, state, value, bounds, **options):
    return continue_motion(motions(family, len(state)), (jnp.asarray(state, float), value), bounds, **options)


def found(branch):
    """Labels and values of the events."""
    return [(event.label, float(event.node.spot.z[-1])) for event in branch.events]


def only(branch, label):
    """The single event with a label, which must be sure of itself."""
    (event,) = [event for event in branch.events if event.label == label]
    assert event.converged
    assert event.node.label == label
    assert event.low <= event.node.spot.z[-1] <= event.high
    return event


def where(event):
    return float(event.node.spot.z[-1])
