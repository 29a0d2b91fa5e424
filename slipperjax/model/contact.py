"""Contact of one point: laws of the normal force, and the memory of the gap rate at touchdown.

Laws follow Eq. (12) of Dang et al. 2024,

    F = K d^(3/2) (1 + c g' / g'_0),       d = -g > 0,

with g the gap [m], g' its rate [m/s] and g'_0 < 0 the rate at touchdown, when the contact began. The laws of this
family differ only in c.

g'_0 is the contact's memory: one number per point, which changes only at touchdowns. The memory is latched between
steps (`EventLatch`) or integrated as an ordinary differential equation (`SmoothSwitch`). In long contacts the fastest
approach since touchdown is a better g'_0 (`PeakRateLatch`).
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.checks import converted, fraction, not_negative, number, positive, warn_unless_within, yes_or_no
from ..tools.fields import ShapeChecked, field
from ..tools.hermite import Cubic, sign_change
from ..tools.types import Real


class AbstractContactLaw(ShapeChecked):
    """Normal force of a point from its gap, the gap's rate, and the ratio of that rate to the rate at touchdown."""

    has_memory: ClassVar[bool] = False
    """Whether the force depends on the rate at touchdown."""
    clamp: eqx.AbstractVar[bool]
    """Whether the force is limited to F >= 0; each law has such a field or property."""
    stiffness: Float[Array, ""] = field("N/m^1.5", positive, plausible=(1e4, 1e14), symbol="K")
    """Generalised stiffness K [N/m^1.5]."""

    @abc.abstractmethod
    def damping(self, rate: Array, rate_ratio: Array | None) -> Array | float:
        """Return the damping force as a multiple of the elastic force [1].

        **Arguments:** `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1], None for a law without memory.
        """

    def __check_init__(self):
        yes_or_no("clamp", self.clamp)

    def force(self, gap: Array, rate: Array, rate_ratio: Array | None) -> Array:
        """Return the normal force [N]; zero where the gap is open.

        **Arguments:** `gap`: g [m]; `rate`: g' [m/s]; `rate_ratio`: g' / g'_0 [1] or None. All have the same shape.
        """
        force = self.stiffness * _hertz(gap) * (1 + self.damping(rate, rate_ratio))
        # a selection, because `jnp.maximum` has a division in its derivative
        return jnp.where(force > 0, force, 0.0) if self.clamp else force


@jax.custom_jvp
def _hertz(gap: Array) -> Array:
    """Return d^(3/2) of penetrations d = -gap, 0 where open."""
    # an open point takes the root of 1, so that no derivative is infinite
    return jnp.where(gap < 0, -gap, 0.0) * jnp.sqrt(jnp.where(gap < 0, -gap, 1.0))


@_hertz.defjvp
def _hertz_jvp(primals, tangents):
    # without the division of a root's derivative, and all higher derivatives are finite where the gap is zero
    (gap,) = primals
    root = jnp.sqrt(jnp.where(gap < 0, -gap, 1.0))
    closed = jnp.where(gap < 0, root, 0.0)
    return jnp.where(gap < 0, -gap, 0.0) * root, -1.5 * closed * tangents[0]


class _RestitutionLaw(AbstractContactLaw):
    """Laws whose damping follows from a coefficient of restitution."""

    has_memory: ClassVar = True
    restitution: Float[Array, ""] = field("", fraction, text="coefficient of restitution", symbol="c_r")
    """Coefficient of restitution c_r [1], in (0, 1]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether the force is limited to F >= 0. The paper has no such limit."""

    @property
    @abc.abstractmethod
    def factor(self) -> Float[Array, ""]:
        """c of Eq. (12) [1]."""

    def damping(self, rate, rate_ratio):
        assert rate_ratio is not None  # callers pass it to laws with memory
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

    @property
    def clamp(self) -> bool:
        return False  # the force is never negative

    def damping(self, rate, rate_ratio):
        return 0.0


class ConstantDamping(AbstractContactLaw):
    """F = K d^(3/2) (1 - chi g'), with the same chi for every impact, hence no memory."""

    hysteresis: Float[Array, ""] = field("s/m", not_negative)
    """Damping per approach rate chi [s/m]."""
    clamp: bool = eqx.field(static=True, default=True)
    """Whether the force is limited to F >= 0."""

    def damping(self, rate, rate_ratio):
        return -self.hysteresis * rate


class AbstractMemory(ShapeChecked):
    """A model of the contact memory, which keeps the gap rate at touchdown.

    The memory is latched between steps: zero for an open point, below zero for a closed point. Memories that are
    integrated with the motion inherit from `AbstractIntegratedMemory`.
    """

    unit: ClassVar[str] = ""
    """SI unit of the memory of a point."""
    integrated: ClassVar[bool] = False
    """Whether the memory is integrated with the motion, and not latched between steps."""

    @abc.abstractmethod
    def initial(self, gap: Array, rate: Array) -> Array:
        """Return the memory at the start, from gap [m] and gap rate [m/s] of the points, of shape (points,)."""

    @abc.abstractmethod
    def rate_ratio(self, memory: Array, rate: Array) -> Array:
        """Return g' / g'_0 [1] of points in contact, from the memory and g' [m/s], all of shape (points,)."""

    def latch(self, memory: Array, before: "Before", gap: Array, rate: Array, step: Real, ratio: Real) -> Array:
        """Return the memory after a step, shape (points,): `at_touchdown` for points whose gap closed in the step,
        zero for open points, and unchanged for points that stay closed.

        **Arguments:** `memory` and `before` (gaps and rates): at the step's start; `gap` [m] and `rate` [m/s]: at the
        step's end; `step`: length of the step [s]; `ratio`: this length over that of the previous step [1], 0 if
        there was none.
        """
        # Decided by the memory, because at a gap of zero, as at a start, the previous gap's sign is arbitrary.
        entered = (memory == 0) & (gap < 0)
        place = before.touchdown(gap, rate, step, entered)
        rise, bend = before.change_of_rate(rate, ratio)
        began = self.at_touchdown(gap, before.rate + place * (rise + (place - 1) * bend))
        rates = Rates(before.rate, rise - bend, bend, rate)
        # closed points keep their memory until they open
        return jnp.where(gap >= 0, 0.0, self.kept(jnp.where(entered, began, memory), rates, entered))

    def kept(self, memory: Array, rates: "Rates", entered: Array) -> Array:
        """Return the memory of contacts after a step, by default unchanged from its start or from their touchdown.

        **Arguments:** `rates`: of the gaps in the step; `entered`: whether the points touched down in the step.
        """
        return memory

    def at_touchdown(self, gap: Array, rate: Array) -> Array:
        """Return the memory of points in contact [`unit`] from the rate at touchdown [m/s], by default `initial`."""
        return self.initial(gap, rate)

    @staticmethod
    def weights(memory: Array) -> Array:
        """Return the weights of a tangent's components: relative to the memory for closed contacts, 0 for open."""
        # the greatest number below zero marks a contact without damping, which counts as open
        closed = memory < -1e-9
        return jnp.where(closed, -1 / jnp.where(closed, memory, -1.0), 0.0)

    def scaled(self, depth: Array, duration: Array, period: Array) -> "AbstractMemory":
        """Return a copy in which values for the scene replace settings of None. By default unchanged.

        **Arguments:** depth [m] and duration [s] of a typical impact; the forcing period [s].
        """
        return self


class EventLatch(AbstractMemory):
    """A memory that is latched after each step: g'_0 is the rate at the instant at which the gap crossed zero.

    The memory of a point is 1 / g'_0 [s/m], and 0 while the point is open. In the step in which a point touches down
    the memory is still 0; the point then uses g' / g'_0 = 1, the value at touchdown. For a point that is closed at
    the start, g'_0 is its rate there if it approaches; otherwise the point has no damping until it opens.

    This memory needs a solver that applies the latch after each step: a solver of `slipperjax`, or one of diffrax in
    `slipperjax.solvers.Latching`.
    """

    unit: ClassVar = "s/m"
    slowest: float = eqx.field(
        static=True, converter=converted("slowest", "m/s"), default=1e-3, metadata={"unit": "m/s"}
    )
    """Least approach rate at touchdown [m/s]; slower touchdowns are treated as touchdowns at this rate.

    The damping of Eq. (12) grows as 1 / g'_0. Without a least rate, a point that touches down at a micrometre per
    second and is then pressed in has damping too stiff for any explicit method. MBDyn drops the damping below 1e-6
    m/s.
    """

    def __check_init__(self):
        warn_unless_within("slowest", number(positive, "slowest", self.slowest, "m/s"), 0, 1.0, "m/s")

    def initial(self, gap, rate):
        # closed, but not approaching: the greatest number below zero marks a contact without damping
        began = jnp.where(rate < 0, 1 / jnp.minimum(rate, -self.slowest), -jnp.finfo(rate.dtype).tiny)
        return jnp.where(gap < 0, began, 0.0)

    def rate_ratio(self, memory, rate):
        # in the step of a touchdown the memory is still zero: the ratio is that at the touchdown
        return jnp.where(memory < 0, rate * memory, 1.0)

    def at_touchdown(self, gap, rate):
        # for any sign of the rate, because only the sign of the gap is certain
        return 1 / jnp.minimum(rate, -self.slowest)


class PeakRateLatch(EventLatch):
    """A memory whose g'_0 is the fastest approach since touchdown, so that the damping of long contacts is bounded.

    The ratio g' / g'_0 is 1 when the rate is the fastest so far, and never more. In an impact without other loads the
    force is the same as with `EventLatch`, because such an impact is fastest at touchdown. A point that touches down
    gently and is pressed in later has at most the damping of an impact at the rate at which it is pressed in.

    The memory is 1 / g'_0 [s/m], as with `EventLatch`. In a step the memory is that at the step's start; where the
    rate is faster than before, the ratio is 1. After the step the memory includes the fastest rate at its end and
    inside the step; after the step of a touchdown the memory is the rate at the touchdown.
    """

    def rate_ratio(self, memory, rate):
        ratio = super().rate_ratio(memory, rate)
        return jnp.where(ratio < 1, ratio, 1.0)

    def kept(self, memory, rates, entered):
        # 1 / g'_0 is a quotient, at the end of the step or where the rate has an extreme inside the step
        turns = (rates.slope < 0) & (rates.slope + 2 * rates.bend > 0)
        above = jnp.where(turns, 4 * rates.bend, 1.0)
        below = jnp.where(turns, 4 * rates.bend * rates.start - rates.slope * rates.slope, rates.end)
        # False for points that are open, have no damping, or recede. Where a contact begins, its force bends the rate
        # more than the parabola can describe; the rate can have become faster by no more than the step's power 2.5.
        faster = (memory * below > above) & ~entered
        return jnp.where(faster, above / jnp.where(faster, below, -1.0), memory)


class Rates(NamedTuple):
    """Gap rates in a step, start + slope x + bend x^2 of x from 0 to 1 [m/s]; arrays of shape (points,)."""

    start: Array
    slope: Array
    bend: Array
    end: Array
    """The rate at the step's end."""


class Before(NamedTuple):
    """Gaps and gap rates at a step's start and before, for the latch; arrays of shape (points,)."""

    gap: Array
    """Gap at the step's start [m]."""
    rate: Array
    """Gap rate at the step's start [m/s]."""
    earlier_rate: Array
    """Gap rate at the start of the previous step [m/s]."""
    step: Array
    """Length of the previous step [forcing periods], a number; infinite if there was none."""

    def touchdown(self, gap: Array, rate: Array, step: Real, entered: Array) -> Array:
        """Return the places in the step, from 0 to 1, at which the points that `entered` touched down; 0 for others.

        The places are zeros of the gap's cubic through both ends of the step. They are differentiable, so that
        tangents include how the time and place of the touchdown depend on the state.

        **Arguments:** as for `AbstractMemory.latch`.
        """
        path = Cubic.through(self.gap, step * self.rate, gap, step * rate)
        return sign_change(path, gap, entered)

    def change_of_rate(self, rate: Array, ratio: Real) -> tuple[Array, Array]:
        """Return rise and bend [m/s] of the rate in the step, before + x (rise + (x - 1) bend) of x from 0 to 1.

        The rate is the parabola through both ends and the start of the previous step. Linear interpolation would
        limit the whole simulation to second order.
        """
        rise = rate - self.rate
        # in the first step the ratio is zero, which gives the straight line through both ends
        bend = (rise - ratio * (self.rate - self.earlier_rate)) * (ratio / (1 + ratio))
        return rise, bend


def _number(value: Array | None) -> Array:
    if value is None:
        raise ValueError("Arguments `width` and `relaxation` must be numbers here: call settle_memory(scene) before.")
    return value


class AbstractIntegratedMemory(AbstractMemory):
    """A contact memory that is integrated with the motion, by any solver."""

    integrated: ClassVar = True

    @staticmethod
    def weights(memory):
        return jnp.ones_like(memory)

    @abc.abstractmethod
    def derivative(self, memory: Array, gap: Array, rate: Array, acceleration: Array) -> Array:
        """Return the memory's derivative [unit/s], shape (points,).

        **Arguments:** of the points, `gap` [m] and `rate` [m/s]; `acceleration`: d(g')/dt along the flow [m/s^2].
        """

    @abc.abstractmethod
    def decay(self, gap: Array) -> Array:
        """Return the derivative of `derivative` with respect to the memory [1/s], shape (points,)."""

    @property
    def closing_gap(self) -> Array | float:
        """Gap [m] at which the equation for the memory of an approaching point changes; adaptive steps end there."""
        return 0.0

    def felt(self, gap: Array, rate: Array, depth: Array) -> Array:
        """Return how much of an error in the memory still affects a contact [1], shape (points,); by default all.

        **Arguments:** `gap` [m] and `rate` [m/s]; `depth` of a typical impact [m].
        """
        return jnp.ones_like(gap)


class SmoothSwitch(AbstractIntegratedMemory):
    """The memory as an ordinary differential equation, which any solver integrates without events.

        m' = S(g / width + 1/2) [ (g' - m) / relaxation + d(g')/dt ],      g'_0 = min(m, -slowest)

    The memory m [m/s] follows g' while the point is open, and is constant while it is closed. S is a twice
    continuously differentiable step from 0 to 1, centred on g = 0. The feed-forward term d(g')/dt prevents a lag of m
    behind g'.

    Settings of None are scaled for each case of a scene, see `scaled`. `tests/benchmarks/test_smooth_switch.py`
    prints the table from which the scaling was chosen.
    """

    unit: ClassVar = "m/s"
    width: Float[Array, ""] | None = field("m", positive, plausible=(0.0, 1e-2), default=None)
    """Width of the switch about g = 0 [m]."""
    relaxation: Float[Array, ""] | None = field("s", positive, plausible=(0.0, 1e-2), default=None)
    """Decay time of errors in m while the point is open [s]; short compared with the time between contacts."""
    slowest: Float[Array, ""] = field("m/s", positive, plausible=(0.0, 1.0), default=1e-3)
    """Slowest approach rate [m/s]; it keeps the force finite while m changes sign at the end of a contact."""

    def initial(self, gap, rate):
        return rate

    def rate_ratio(self, memory, rate):
        # below zero, because the quotient has a pole at zero
        return rate / jnp.minimum(memory, -self.slowest)

    def scaled(self, depth, duration, period):
        """Fill in `width` and `relaxation`.

        The width is a fraction of the depth of a typical impact. The width does not depend on the clearance, because
        at zero clearance a point opens only as far as the opposite point is pressed in. The relaxation is the
        shortest that explicit methods allow at the default steps, 0.6 of a step; with a longer relaxation, errors
        last from one contact to the next.

        Bias, as the greatest scaled difference from the event latch, with RK4 at 1600 steps: 4.9e-5 after 10 periods
        at V = 1250 m/s, C = 1 mm; 1.5e-3 after 10 at V = 2300 m/s; 1.6e-4 after 2 at K = 1e10. The bias is 0.35 after
        6 periods at C = 4 mm, where near-grazing touchdowns magnify every error; only a width of a micrometre or two
        helps.
        """
        if self.width is not None and self.relaxation is not None:
            return self
        # a hundredth of the depth; a twenty-fifth of the impact, or the shortest that explicit methods allow
        width = 0.01 * depth if self.width is None else self.width
        relaxation = jnp.minimum(duration / 25, period / 80) if self.relaxation is None else self.relaxation
        fields = lambda m: (m.width, m.relaxation)
        # The checks of the constructor would put a Python callback into the compiled program.
        return eqx.tree_at(fields, self, (width, relaxation), is_leaf=lambda x: x is None)

    def derivative(self, memory, gap, rate, acceleration):
        """Return m' [m/s^2].

        **Raises:** `ValueError` if width or relaxation is None.
        """
        return self._switch(gap) * ((rate - memory) / _number(self.relaxation) + acceleration)

    def decay(self, gap):
        return -self._switch(gap) / _number(self.relaxation)

    @property
    def closing_gap(self):
        # half of the switch lies on either side of a gap of zero
        return 0.5 * _number(self.width)

    def felt(self, gap, rate, depth):
        """Return how much of an error in m still affects a contact [1], shape (points,).

        Errors of an approaching point decay until touchdown. A receding point that is pressed in is affected in what
        is left of its rebound, about (d / `depth`)^(5/2) by its energy. An open point that recedes is not affected.
        """
        # share of the rebound that is left, and decay until touchdown
        left = jnp.clip(-gap / depth, 0.0, 1.0)
        decays = jnp.exp(-jnp.maximum(gap, 0.0) / (_number(self.relaxation) * jnp.where(rate < 0, -rate, 1.0)))
        return jnp.where(rate < 0, decays, left * left * jnp.sqrt(left))

    def _switch(self, gap: Array) -> Array:
        # a polynomial whose first two derivatives are zero at both ends
        u = jnp.clip(gap / _number(self.width) + 0.5, 0.0, 1.0)
        return u**3 * (10 + u * (6 * u - 15))
