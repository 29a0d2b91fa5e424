"""The contact's memory: the rate at which each contact began, g'_0 of Eq. (12) of Dang et al. 2024.

One number per point that changes at touchdowns only. It is latched between steps (`EventLatch`) or integrated as an
ordinary differential equation (`SmoothSwitch`).
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...tools import ShapeChecked, optional, positive

SLOWEST_IMPACT = 1e-3
"""Approach rate [m/s] below which a touchdown counts as one at this rate.

The damping of Eq. (12) grows as 1 / g'_0. Without a floor, a point that touches down at a micrometre per second and
is then pressed on has a damping too stiff for any explicit method. MBDyn drops the damping below 1e-6 m/s.
"""

WIDTH_PER_DEPTH = 0.01
"""Default width of the smooth switch as a share of the depth of a typical impact."""


class AbstractMemory(ShapeChecked):
    """How the rate at touchdown is carried along."""

    @abc.abstractmethod
    def initial(self, gap: Array, rate: Array) -> Array:
        """The memory at the start, from gap [m] and rate [m/s] of the points there."""

    @abc.abstractmethod
    def rate_ratio(self, memory: Array, rate: Array) -> Array:
        """g' / g'_0 [1] of points that touch, from the memory and g' [m/s]."""

    def scaled(self, depth: Array, duration: Array, period: Array) -> "AbstractMemory":
        """The memory with settings of None chosen for the scene. Here there are none.

        **Arguments:** depth [m] and duration [s] of a typical impact; the forcing period [s].
        """
        del depth, duration, period
        return self


class EventLatch(AbstractMemory):
    """Integrates the motion alone and latches g'_0 after each step, where in the step the gap crossed zero.

    The memory of a point is 1 / g'_0 [s/m], and 0 while it is open. Inside the step in which a point touches
    down, it is still 0 and the point uses g' / g'_0 = 1, its value at touchdown. A point closed at the start and
    approaching began there; one closed and not approaching is a spring without damping until it opens.

    Needs a solver that ends its steps with the latch: one of `slipperjax`, or a stock one in `slipperjax.Latching`.
    """

    slowest: float = eqx.field(static=True, default=SLOWEST_IMPACT)
    """Slower touchdowns count as ones at this rate [m/s]: see `SLOWEST_IMPACT`."""

    def __check_init__(self):
        if not 0 < self.slowest < float("inf"):
            raise ValueError(f"Argument `slowest` must be positive, but is {self.slowest} m/s.")

    def initial(self, gap: Array, rate: Array) -> Array:
        began = jnp.where(rate < 0, 1 / jnp.minimum(rate, -self.slowest), -jnp.finfo(rate.dtype).tiny)
        return jnp.where(gap < 0, began, 0.0)

    def rate_ratio(self, memory: Array, rate: Array) -> Array:
        return jnp.where(memory < 0, rate * memory, 1.0)

    def latch(self, memory: Array, before: "Before", gap: Array, rate: Array, step: Any, ratio: Any) -> Array:
        """The memory after a step of `step` seconds, `ratio` times the one before, from `before` to (`gap`, `rate`).

        A ratio of zero says that no step came before.

        The gap's zero is found on the cubic through both ends. The rate there is that of the parabola through both
        ends and the start of the step before: the chord would be of second order in the step, and set the order of
        the whole simulation. All of it stays differentiable, which is what makes tangents right: the touchdown's
        time and place depend on the state.
        """
        # Tested by the memory: at a start in mere touch the sign of the gap before is a matter of rounding.
        entered = (memory == 0) & (gap < 0)
        fall = before.gap - gap
        slope, slope1 = step * before.rate, step * rate
        a = 2 * before.gap - 2 * gap + slope + slope1
        b = -3 * before.gap + 3 * gap - 2 * slope - slope1
        x = before.gap / jnp.where(entered & (fall > 0), fall, jnp.inf)
        for k in range(3):
            if k == 1:
                # Two Newton steps from a constant x reproduce the zero's derivatives up to the third.
                x = jax.lax.stop_gradient(x)
            value = ((a * x + b) * x + slope) * x + before.gap
            steepness = (3 * a * x + 2 * b) * x + slope
            x = jnp.clip(x - value / jnp.where(entered & (steepness < 0), steepness, -jnp.inf), 0.0, 1.0)
        rise = rate - before.rate
        bend = (rise - ratio * (before.rate - before.earlier_rate)) * (ratio / (1 + ratio))
        began = jnp.minimum(before.rate + x * (rise + (x - 1) * bend), -self.slowest)
        return jnp.where(gap >= 0, 0.0, jnp.where(entered, 1 / began, memory))


class Before(NamedTuple):
    """What the latch needs to know of the time before a step; arrays of shape (points,)."""

    gap: Array
    """Gap at the step's start [m]."""
    rate: Array
    """Its rate there [m/s]."""
    earlier_rate: Array
    """Its rate at the start of the step before [m/s]."""


def _settled(value: Array | None) -> Array:
    if value is None:
        raise ValueError("Arguments `width` and `relaxation` must be numbers here: call settle_memory(scene) before.")
    return value


class SmoothSwitch(AbstractMemory):
    """The memory as an ordinary differential equation, so that any solver integrates it: no events.

        m' = S(g / width + 1/2) [ (g' - m) / relaxation + d(g')/dt ],      g'_0 = min(m, -small)

    The memory m [m/s] follows g' while the point is open and freezes while it is closed. S is a twice
    continuously differentiable step from 0 to 1, centred on g = 0; d(g')/dt is the feed-forward without which
    m would lag behind.

    Settings of None are scaled from the scene, case by case: see `scaled`. `tests/benchmarks/test_smooth_switch.py`
    prints the table from which that was chosen.
    """

    width: Float[Array, ""] | None = eqx.field(converter=optional(positive("width", "m")), default=None)
    """Width of the switch about g = 0 [m]."""
    relaxation: Float[Array, ""] | None = eqx.field(converter=optional(positive("relaxation", "s")), default=None)
    """Time in which m forgets an error while the point is open [s]; short against the open time."""
    slowest: Float[Array, ""] = eqx.field(converter=positive("slowest", "m/s"), default=1e-3)
    """`small` [m/s]: keeps the force finite while m changes sign at the end of a contact."""

    def initial(self, gap: Array, rate: Array) -> Array:
        return rate

    def rate_ratio(self, memory: Array, rate: Array) -> Array:
        return rate / jnp.minimum(memory, -self.slowest)

    def scaled(self, depth: Array, duration: Array, period: Array) -> "SmoothSwitch":
        """Fills in `width` and `relaxation`.

        The width is a share of the depth of a typical impact, and not of the clearance, which may be zero: a point
        opens as far as its opposite is pressed in. The relaxation is as short as the default steps allow an explicit
        method, 0.6 of a step: a longer one forgets too little between two contacts.

        Bias, as the worst scaled difference from the event latch, RK4 at 1600 steps: 4.9e-5 after 10 periods at
        V = 1250 m/s, C = 1 mm; 1.5e-3 after 10 at V = 2300 m/s; 1.6e-4 after 2 at K = 1e10; but 0.35 after 6 at
        C = 4 mm, where near-grazing touchdowns magnify every error and only a width of a micrometre or two helps.
        """
        if self.width is not None and self.relaxation is not None:
            return self
        width = WIDTH_PER_DEPTH * depth if self.width is None else self.width
        relaxation = jnp.minimum(duration / 25, period / 80) if self.relaxation is None else self.relaxation
        fields = lambda m: (m.width, m.relaxation)
        # A new SmoothSwitch would run its checks, which put a callback to Python into the compiled program.
        return eqx.tree_at(fields, self, (width, relaxation), is_leaf=lambda x: x is None)

    def derivative(self, memory: Array, gap: Array, rate: Array, acceleration: Array) -> Array:
        """m' [m/s^2] from gap [m], its rate [m/s] and that rate's own rate along the flow [m/s^2].

        Raises `ValueError` where width or relaxation are None still.
        """
        return self._switch(gap) * ((rate - memory) / _settled(self.relaxation) + acceleration)

    def decay(self, gap: Array) -> Array:
        """Derivative of m' with respect to m [1/s], the acceleration's part in it left out."""
        return -self._switch(gap) / _settled(self.relaxation)

    def _switch(self, gap: Array) -> Array:
        u = jnp.clip(gap / _settled(self.width) + 0.5, 0.0, 1.0)
        return u**3 * (10 + u * (6 * u - 15))
