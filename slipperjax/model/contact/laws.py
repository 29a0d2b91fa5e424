"""Normal contact: force laws, and the memory of the rate at which each contact began.

Laws follow Eq. (12) of Dang et al. 2024,

    F = K d^(3/2) (1 + c g' / g'_0),       d = -g > 0,

with g the gap [m], g' its rate [m/s] and g'_0 < 0 that rate at the instant at which this contact began. The
laws of the family differ in c alone. g'_0 is a memory: one number per point that changes at touchdowns only.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import fraction, not_negative, optional, positive

SLOWEST_IMPACT = 1e-3
"""Approach rate [m/s] below which a touchdown counts as one at this rate.

The damping of Eq. (12) grows as 1 / g'_0. Without a floor, a point that touches down at a micrometre per second and
is pressed on afterwards creeps under a damping that no explicit method follows at any sensible step: the law is made
for impacts, and this is none. MBDyn drops the damping below 1e-6 m/s.
"""

WIDTH_PER_DEPTH = 0.01
"""Default width of the smooth switch as a share of the depth of a typical impact."""


def zero_safe_sqrt(x: Array) -> Array:
    """Square root whose derivative at zero is zero and not infinite."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0)


class AbstractContactLaw(eqx.Module):
    """Normal force of a point from its gap, the gap's rate, and their ratio to the rate at touchdown."""

    stiffness: eqx.AbstractVar[Float[Array, ""]]
    clamp: eqx.AbstractVar[bool]

    @property
    @abc.abstractmethod
    def has_memory(self) -> bool:
        """Whether the force depends on the rate at touchdown."""

    @abc.abstractmethod
    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        """The damping force as a multiple of the elastic force [1].

        **Arguments:** `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1], None for a law without memory.
        """

    def force(self, gap: Array, rate: Array, rate_ratio: Array | None) -> Array:
        """Normal force [N]; zero where the gap is open.

        **Arguments:** `gap`: g [m]; `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1] or None. One shape for all.
        """
        depth = jnp.maximum(-gap, 0.0)
        # sqrt(depth) with a harmless derivative at zero; the factor `depth` makes the product zero there
        root = jnp.sqrt(jnp.where(depth > 0, depth, 1.0))
        force = self.stiffness * depth * root * (1 + self.damping(rate, rate_ratio))
        return jnp.maximum(force, 0.0) if self.clamp else force

    def elastic_energy(self, gap: Array) -> Array:
        """Energy stored in the elastic part of the force [J]."""
        depth = jnp.maximum(-gap, 0.0)
        return 0.4 * self.stiffness * depth**2 * zero_safe_sqrt(depth)


class _RestitutionLaw(AbstractContactLaw):
    """The laws that tell their damping from a coefficient of restitution."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""
    restitution: Float[Array, ""] = eqx.field(converter=fraction("restitution"))
    """Coefficient of restitution c_r [1], in (0, 1]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether a contact may only push: F >= 0. The paper has no such clamp."""

    @property
    def has_memory(self) -> bool:
        return True

    @property
    @abc.abstractmethod
    def factor(self) -> Float[Array, ""]:
        """c of Eq. (12) [1]."""

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        del rate
        assert rate_ratio is not None  # a law with memory is given it
        return self.factor * rate_ratio


class Flores(_RestitutionLaw):
    """Flores et al. 2011, doi:10.1007/s11044-010-9237-4; the paper's law: c = 8 (1 - c_r) / (5 c_r)."""

    @property
    def factor(self):
        return 8 * (1 - self.restitution) / (5 * self.restitution)


class HuntCrossley(_RestitutionLaw):
    """Hunt and Crossley 1975, doi:10.1115/1.3423596: c = 3 (1 - c_r) / 2."""

    @property
    def factor(self):
        return 1.5 * (1 - self.restitution)


class LankaraniNikravesh(_RestitutionLaw):
    """Lankarani and Nikravesh 1990, doi:10.1115/1.2912617: c = 3 (1 - c_r^2) / 4."""

    @property
    def factor(self):
        return 0.75 * (1 - self.restitution**2)


class HertzSpring(AbstractContactLaw):
    """F = K d^(3/2): no damping and no memory."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""

    @property
    def clamp(self) -> bool:
        return False  # it cannot pull

    @property
    def has_memory(self) -> bool:
        return False

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        return 0.0


class ConstantDamping(AbstractContactLaw):
    """F = K d^(3/2) (1 - chi g'), with the same chi for every impact, hence no memory."""

    stiffness: Float[Array, ""] = eqx.field(converter=positive("stiffness", "N/m^1.5"))
    """Generalised stiffness K [N/m^1.5]."""
    hysteresis: Float[Array, ""] = eqx.field(converter=not_negative("hysteresis", "s/m"))
    """Damping per approach rate chi [s/m]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether a contact may only push: F >= 0."""

    @property
    def has_memory(self) -> bool:
        return False

    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        return -self.hysteresis * rate


class AbstractMemory(eqx.Module):
    """How the rate at touchdown is carried along."""

    @abc.abstractmethod
    def initial(self, gap: Array, rate: Array) -> Array:
        """The memory at the start, from gap [m] and rate [m/s] of the points there."""

    @abc.abstractmethod
    def rate_ratio(self, memory: Array, rate: Array) -> Array:
        """g' / g'_0 [1] of points that touch, from the memory and g' [m/s]."""

    def scaled(self, depth: Array, duration: Array, period: Array) -> "AbstractMemory":
        """The memory with what it leaves to the scene filled in. Here nothing.

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
        # by the memory and not by the gap before, whose sign at a start in mere touch is a matter of rounding
        entered = (memory == 0) & (gap < 0)
        fall = before.gap - gap
        slope, slope1 = step * before.rate, step * rate
        a = 2 * before.gap - 2 * gap + slope + slope1
        b = -3 * before.gap + 3 * gap - 2 * slope - slope1
        x = before.gap / jnp.where(entered & (fall > 0), fall, jnp.inf)
        for k in range(3):
            if k == 1:
                # what two of Newton's steps make of a fixed x has the zero's own derivatives up to the third
                x = jax.lax.stop_gradient(x)
            value = ((a * x + b) * x + slope) * x + before.gap
            steepness = (3 * a * x + 2 * b) * x + slope
            x = jnp.clip(x - value / jnp.where(entered & (steepness < 0), steepness, -jnp.inf), 0.0, 1.0)
        rise = rate - before.rate
        bend = (rise - ratio * (before.rate - before.earlier_rate)) * (ratio / (1 + ratio))
        began = jnp.minimum(before.rate + x * (rise + (x - 1) * bend), -self.slowest)
        return jnp.where(gap >= 0, 0.0, jnp.where(entered, 1 / began, memory))


class Before(NamedTuple):
    """What the latch wants of the time before a step; arrays of shape (points,)."""

    gap: Array
    """Gap at the step's start [m]."""
    rate: Array
    """Its rate there [m/s]."""
    earlier_rate: Array
    """Its rate at the start of the step before [m/s]."""


def _settled(value: Array | None) -> Array:
    if value is None:
        raise ValueError("Arguments `width` and `relaxation` must be numbers here: call Scene.settled() before.")
    return value


class SmoothSwitch(AbstractMemory):
    """The memory as an ordinary differential equation, so that any solver integrates it: no events.

        m' = S(g / width + 1/2) [ (g' - m) / relaxation + d(g')/dt ],      g'_0 = min(m, -small)

    The memory m [m/s] follows g' while the point is open and freezes while it is closed. S is a twice
    continuously differentiable step from 0 to 1, centred on g = 0; d(g')/dt is the feed-forward without which
    m would lag behind.

    What is None is scaled from the scene, case by case: see `scaled`. `tests/benchmarks/test_smooth_switch.py`
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
        # not by making a new one, whose checks would put a call back to Python into the compiled program
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
