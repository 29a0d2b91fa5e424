"""Oscillators of textbooks with exact or nearly exact flows, and short ways to follow motions, for the tests."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.linalg import expm

from slipperjax.analysis.continuation import continue_motion
from slipperjax.analysis.hybrid import return_step
from slipperjax.analysis.lyapunov import first_tangents
from slipperjax.analysis.shooting import PeriodicMotions

SAMPLES = 48
"""Instants of an arc between which an extremum is looked for."""


class Polynomial(eqx.Module):
    """x -> sum of c_ij x^i p^j for one number x and a parameter p: one program serves them all."""

    coefficients: jax.Array

    @classmethod
    def of(cls, terms):
        """From c_ij by (i, j), up to x^3 and p^2."""
        return cls(jnp.zeros((4, 3)).at[tuple(np.transpose(list(terms)))].set(jnp.array(list(terms.values()))))

    def __call__(self, p):
        c = self.coefficients @ jnp.stack([jnp.ones_like(p), p, p * p])
        return lambda x, k: ((c[3] * x + c[2]) * x + c[1]) * x + c[0]


LOGISTIC = Polynomial.of({(1, 1): 1.0, (2, 1): -1.0})
"""p x (1 - x)"""


def henon(a, b):
    """Hénon's map over a and b."""
    return lambda s, k: jnp.stack([a - s[0] ** 2 + b * s[1], s[0]])


HENON_AT = {"LP": lambda b: -((1 - b) ** 2) / 4, "PD": lambda b: 3 * (1 - b) ** 2 / 4}
"""Values of a at its folds and flips, where x = y is (b - 1) / 2 and (1 - b) / 2."""


def delayed(r, c):
    """x' = r x (1 - c x - y), y' = x: at c = 0 Maynard Smith's delayed logistic map."""
    return lambda s, k: jnp.stack([r * s[0] * (1 - c * s[0] - s[1]), s[0]])


class Fixed(eqx.Module):
    """A family over the first of its two parameters; the second is a number."""

    family: Callable
    second: jax.Array

    def __call__(self, value):
        return self.family(value, self.second)


def settled(step, state, count):
    """A state after some applications of a map."""
    return jax.jit(lambda s: jax.lax.fori_loop(0, count, lambda k, s: step(s, 0.0), s))(jnp.asarray(state))


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


def one_touch(damping, frequency, gap, stop, force, up, down, rising, falling):
    """Gives the residual of a motion that touches a spring once, by instants and speeds at the gap; its matrix over a
    period; and its state at t = 0 in contact."""
    period = 2 * np.pi / frequency
    free, slow = linear(1.0, damping, 0.0, force, frequency)
    touching, fast = linear(1.0 + stop, damping, stop * gap, force, frequency)
    at_down = touching(np.array([gap, rising]), up, down - up) - [gap, falling]
    at_up = free(np.array([gap, falling]), down, up + period - down) - [gap, rising]
    through = expm((up + period - down) * slow) @ expm((down - up) * fast)
    return np.concatenate([at_down, at_up]), through, touching(np.array([gap, rising]), up, -up)


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

    The stop is a spring, or, where its stiffness is infinite, rigid with a coefficient of `restitution`.
    """

    damping: jax.Array
    frequency: jax.Array
    force: jax.Array
    gap: jax.Array
    stop: jax.Array
    restitution: jax.Array
    passes: int = eqx.field(static=True, default=4)
    """Most arcs in a period."""

    @property
    def period(self):
        return 2 * jnp.pi / self.frequency

    def arc(self, touching):
        more = jnp.where(touching == 1, self.stop, 0.0)
        return Arc(self.damping, 1.0 + more, more * self.gap, self.force, self.frequency)

    def __call__(self, state, k):
        return self.followed(state)[0]

    def followed(self, state):
        """The state after a period, the number of touches, and how far the motion is from another number."""
        rigid = jnp.isinf(self.stop)
        touching = jnp.where((state[0] > self.gap) & ~rigid, 1.0, 0.0)

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
            near = jnp.minimum(near, jnp.where(there & rigid, v**2, jnp.inf))
            v = jnp.where(there & rigid, -self.restitution * v, v)
            turned = jnp.where(there & ~rigid, 1 - touching, touching)
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


def two_trajectories(step, state, intervals, distance=1e-7):
    """Logarithms of the growth of a small distance in each interval, without any derivative."""

    def interval(both, k):
        here, near = (step(s, k) for s in both)
        away, unravel = ravel_pytree(jax.tree.map(jnp.subtract, near, here))
        length = jnp.linalg.norm(away)
        near = jax.tree.map(lambda a, b: a + b, here, unravel(distance / length * away))
        return (here, near), jnp.log(length / distance)

    begin = jax.tree.map(jnp.asarray, state)
    moved = first_tangents(begin, 1)
    near = jax.tree.map(lambda a, b: a + distance * b[0], begin, moved)
    return jax.jit(lambda pair: jax.lax.scan(interval, pair, jnp.arange(float(intervals)))[1])((begin, near))


def autoregression(memory, size, count=400):
    """Rows of a series that forgets by `memory`, (count, size), and its mean."""
    random = np.random.default_rng(3).standard_normal((count, size + 3000))
    values = np.zeros_like(random)
    for k in range(1, values.shape[1]):
        values[:, k] = memory * values[:, k - 1] + random[:, k]
    return values[:, 3000:], 0.0


def motions(family, size=1, **options):
    return PeriodicMotions(family, jnp.zeros(size), 1.0, **options)


def follow(family, state, value, bounds, **options):
    return continue_motion(motions(family, len(state)), (jnp.asarray(state, float), value), bounds, **options)


def labels(branch):
    """Labels of the events."""
    return [event.label for event in branch.events]


def where(event):
    return event.value


def column(nodes, place):
    """One of the unknowns at nodes of a branch."""
    return np.array([node.z[place] for node in nodes])


def only(branch, label):
    """The single event with a label, which must be sure of itself."""
    (event,) = [event for event in branch.events if event.label == label]
    assert event.converged
    assert event.node.label == label
    assert event.low <= where(event) <= event.high
    return event


class Generalised(eqx.Module):
    """The generalised Hénon map x' = y, y' = a - b x - y^2 + R x y + S y^3 over a and b."""

    r: jax.Array
    s: jax.Array

    def __call__(self, a, b):
        return lambda x, k: jnp.stack([x[1], a - b * x[0] - x[1] ** 2 + self.r * x[0] * x[1] + self.s * x[1] ** 3])

    def at(self, y, determinant):
        """a and b with which y is fixed and the Jacobian has this determinant."""
        b = determinant + self.r * y
        return y * (1 + b) + (1 - self.r) * y**2 - self.s * y**3, b

    def trace(self, y):
        """Trace of the Jacobian at the fixed point y."""
        return (self.r - 2) * y + 3 * self.s * y**2


class Companion(eqx.Module):
    """x_n' = a + sum of b_k x_k - x_n^2 over a and b_1, with any multipliers at a fixed point."""

    rest: jax.Array
    """b_2, b_3, ..."""

    @classmethod
    def of(cls, multipliers, y):
        """With these multipliers at the fixed point y, and a and b_1 there."""
        row = -np.poly(multipliers).real[:0:-1]
        row[-1] += 2 * y
        return cls(jnp.asarray(row[1:])), (y - y * row.sum() + y**2, row[0])

    def __call__(self, a, b):
        def step(x, k):
            last = a + b * x[0] + self.rest @ x[1:] - x[-1] ** 2
            return jnp.append(x[1:], last)

        return step


def on_table(amplitude, restitution):
    """From impact to impact of a ball on a table that moves as a sine, by phase, height and velocity.

    Lengths are in g / w^2, times in 1 / w, so that the amplitude is the table's greatest acceleration over g.
    """
    field = lambda t, s: jnp.stack([jnp.ones_like(t), s[2], -jnp.ones_like(t)])
    gap = lambda t, s: s[1] - amplitude * jnp.sin(s[0])

    def rebound(t, s):
        rise = amplitude * jnp.cos(s[0])
        return s.at[2].set(rise - restitution * (s[2] - rise))

    flight = return_step(field, gap, rebound, dt=0.05, most=400)
    return lambda s, k: flight(s, k).at[0].add(-2 * jnp.pi)


def table_flip(restitution):
    """Amplitude at the flip of the motion with one impact in a period of the table."""
    return np.hypot(*_table_parts(restitution))


def _table_parts(restitution):
    """The amplitude times cosine and sine of the phase of the impacts at that flip."""
    return np.pi * (1 - restitution) / (1 + restitution), 2 * (1 + restitution**2) / (1 + restitution) ** 2


TABLE_START = [np.arctan2(*_table_parts(0.5)[::-1]), _table_parts(0.5)[1], -np.pi]
"""Phase, height and velocity at the flip at a restitution of 0.5."""
TABLE_BOUNDS = ((0.5, 4.0), (0.3, 0.8))
