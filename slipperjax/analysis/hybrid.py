"""Maps of systems that switch, rebound or cross a section: each crossing is found inside a step.

The instant of a crossing depends on the state in a differentiable way, so that Jacobians of these maps contain the
saltation matrix of each switch and rebound (Leine and Nijmeijer 2004, doi:10.1007/978-3-540-44398-8). Crossings must
be transversal: at a grazing the derivative does not exist. Derivatives exist in forward and reverse mode. States are
arrays along one axis.
"""

import abc
import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..tools.checks import finite, positive, require, whole
from ..tools.forms import in_one_kernel
from ..tools.hermite import highest_point
from ..tools.jacobian import by_jacobian
from ..tools.types import Real

Field = Callable[[Array, Array], Array]
"""Vector field: y' at (t, y)."""
Surface = Callable[[Array, Array], Array]
"""Function of (t, y) that is zero on a surface: a gap, or a coordinate."""
Reset = Callable[[Array, Array], Array]
"""State after an impact at (t, y) on the surface."""
CROSSING_ITERATIONS = 60
"""Most iterations for the instant of a crossing: enough bisections to reach rounding errors."""
CLOSE = 1e-9
"""Newton step, as a share of the integration step, after which the instant is exact: the error is its square."""
SHORTEST = 1e-3
"""Shortest flight between impacts, as a share of the integration step; below this the motion sticks instead."""
MOST_EVENTS = 2000
"""Impacts or crossings in one integration step after which the state is NaN: twice the number of flights of length
`SHORTEST`."""
ON_SURFACE = 1e-9
"""Distance from the surface at which a motion slides, as a share of the way of both fields towards it in a step."""


def rk4(field: Field, t: Array, y: Array, h: Array) -> Array:
    """Return the state at t + h by a step of the classical Runge-Kutta method."""
    a = field(t, y)
    b = field(t + h / 2, y + h / 2 * a)
    c = field(t + h / 2, y + h / 2 * b)
    d = field(t + h, y + h * c)
    return y + h / 6 * (a + 2 * b + 2 * c + d)


def share_before(
    surface: Surface,
    flow: Callable[[Array], Array],
    t: Real,
    dt: Real,
    crosses: Bool[Array, ""],
    reach: Real = 1.0,
) -> Float[Array, ""]:
    """Return the share of a step from `t` after which `surface` crosses zero; `reach` where it does not cross.

    The crossing leads to the sign at `reach`. A start that is on the wrong side of the surface by rounding is no
    crossing. Derivatives are those of the exact share, of any order and in both modes.

    **Arguments:** `flow(share)`: the state after this share of the step `dt`; `reach`: share up to which a crossing
    is sought.
    """
    # the surface as a function of the share of the reach
    height = lambda share: surface(t + share * (reach * dt), flow(share * reach))
    # without a crossing, a function with a root at 1 replaces the surface's function
    sought = lambda share: jnp.where(crosses, height(share), share - 1)

    # the implicit derivative of the share, from the linearised function; zero where that is flat
    def tangent(line, miss):
        slope = line(jnp.ones_like(miss))
        return miss / jnp.where(slope == 0, jnp.inf, slope)

    return reach * jax.lax.custom_root(sought, jnp.zeros_like(jnp.asarray(dt, float)), _crossing, tangent)


def _crossing(height: Callable[[Array], Array], zero: Array) -> Array:
    """Return where a function on 0 to 1 gets the sign that it has at 1, by Newton's method within a bracket."""
    slope_at = lambda share: jax.jvp(height, (share,), (jnp.ones_like(share),))
    (start, end), (slope, _) = jax.vmap(slope_at)(jnp.stack([zero, zero + 1]))
    # mirrored if necessary, so that the function falls through zero
    side = jnp.where(end < 0, 1.0, -1.0)
    start, end, slope = side * start, side * end, side * slope
    # first guess: the falling zero of the parabola with the value and slope at the start and the value at the end
    start = jnp.maximum(start, 0.0)
    bend = start - end + slope
    root = jnp.sqrt(jnp.maximum(slope**2 + 4 * bend * start, 0.0))
    first = jnp.where(slope > 0, (slope + root) / (2 * bend), 2 * start / (root - slope))
    first = jnp.where(jnp.isfinite(first), jnp.clip(first, 0.0, 1.0), 0.0)

    def closer(carry):
        x, low, high, count, _ = carry
        value, slope = (side * a for a in slope_at(x))
        low, high = jnp.where(value > 0, x, low), jnp.where(value > 0, high, x)
        newton = x - value / slope
        # bisect where Newton's step leaves the bracket, or leads to a zero at which the function rises
        good = (slope < 0) & (newton >= low) & (newton <= high)
        new = jnp.where(good, newton, (low + high) / 2)
        # the length of a Newton step shows the remaining error, the length of a bisection does not
        done = jnp.abs(new - x) < jnp.where(good, CLOSE, jnp.finfo(new.dtype).eps)
        return new, low, high, count + 1, done

    going = lambda carry: (carry[3] < CROSSING_ITERATIONS) & ~carry[4]
    return jax.lax.while_loop(going, closer, (first, zero, zero + 1, 0, False))[0]


class AbstractCrossingStep(eqx.Module):
    """Map over an interval of integration steps; steps that cross a surface are split at the crossing."""

    dt: Float[Array, ""]
    t0: Float[Array, ""]
    steps: int = eqx.field(static=True)
    surface: Surface

    @abc.abstractmethod
    def _side(self, up) -> tuple[Field, Surface]:
        """Return the field of a motion that does not stick, and its gap, positive off the surface.

        **Arguments:** `up`: whether the motion is on the side where the surface's function is positive.
        """

    @abc.abstractmethod
    def _held(self, t, y) -> Array:
        """Return the field of a motion that sticks to the surface."""

    @abc.abstractmethod
    def _holding(self, t, y) -> Array:
        """Return a number that is positive as long as a motion sticks to the surface."""

    @abc.abstractmethod
    def _ahead(self, t, y) -> tuple[Array, Bool[Array, ""]]:
        """Return the state after a whole step from (t, y), and whether the step may cross the surface."""

    @abc.abstractmethod
    def _stuck(self, t, y) -> Bool[Array, ""]:
        """Return whether the motion sticks to the surface, so that the step from there is not a plain step."""

    @abc.abstractmethod
    def _after(self, t, y, up, sticks, happens) -> tuple[Array, Bool[Array, ""], Bool[Array, ""]]:
        """Return state, side and whether the motion sticks, after a part of a step that may end with an event."""

    def _begin(self, t, y) -> tuple[Array, Bool[Array, ""]]:
        """Return the state with which a step begins at (t, y), and whether the motion sticks there."""
        return y, self._stuck(t, y)

    def _lasts(self, t, y, sticks) -> Bool[Array, ""]:
        """Return whether an event may also follow the lowest point of the gap in the step."""
        return sticks

    def _across(self, t, y, crosses: Bool[Array, ""]) -> tuple[Array, Bool[Array, ""]]:
        """Return the state after a split step, if it `crosses`, and whether the motion then sticks to the surface."""
        at, left = lambda share: t + share * self.dt, lambda share: (1 - share) * self.dt

        def to_event(carry):
            # advance to the next event or to the end of the step
            share, y, up, sticks, _, count = carry
            free, gap = self._side(up)
            # jit, so that each function is traced once: tracing takes longer than all steps
            field = jax.jit(lambda t, y: jnp.where(sticks, self._held(t, y), free(t, y)))
            margin = jax.jit(lambda t, y: jnp.where(sticks, self._holding(t, y), gap(t, y)))
            flow = jax.jit(lambda part: rk4(field, at(share), y, part * left(share)))
            # events are searched up to the lowest point, because the gap may rise after it within the step
            lowest = _lowest(free, gap, at(share), y, at(1.0), flow(1.0))[0]
            reach = jnp.where(self._lasts(at(share), y, sticks), 1.0, lowest)
            end = margin(at(share) + reach * left(share), flow(reach))
            # the function must fall, because rounding may put a start on the surface below it
            happens = crosses & (end < jnp.minimum(margin(at(share), y), 0.0))
            reach = jnp.where(happens, reach, 1.0)
            part = share_before(margin, flow, at(share), left(share), happens, reach)
            share, y = share + part * (1 - share), flow(part)
            return share, *self._after(at(share), y, up, sticks, happens), happens, count + 1

        start, sticks = self._begin(t, y)
        begin = jnp.zeros_like(self.dt), start, self.surface(t, y) >= 0, sticks, jnp.asarray(True), 0
        going = lambda carry: carry[4] & (carry[5] < MOST_EVENTS)
        _, y, _, sticks, lost, _ = jax.lax.while_loop(going, to_event, begin)
        return jnp.where(lost, jnp.nan, y), sticks

    def nearness(self, state: Array, k: Real) -> tuple[Array, Array]:
        """Return how near the motion of an interval is to a grazing: the least gap at which it turns before it
        touches the surface, and the least rate of a touch (with a smaller rate it would turn first). Infinite where
        there is none.
        """

        def one(y, i):
            t = self.t0 + (k * self.steps + i) * self.dt
            field, gap = self._side(self.surface(t, y) >= 0)
            flow = lambda share: rk4(field, t, y, share * self.dt)
            end, split = self._ahead(t, y)
            stuck = self._stuck(t, y)
            lowest = _lowest(field, gap, t, y, t + self.dt, end)[0]
            least = gap(t + lowest * self.dt, flow(lowest))
            touches = split & (least < 0)
            share = share_before(gap, flow, t, self.dt, touches, lowest)
            touch = t + share * self.dt, flow(share)
            after = jax.lax.cond(touches | stuck, lambda: self._across(t, y, touches | stuck)[0], lambda: end)
            rate = along(field, gap)
            turns = ~stuck & ~touches & (lowest > 0) & (lowest < 1)
            grazes = ~stuck & touches & (along(field, rate)(*touch) > 0)
            return after, (jnp.where(turns, least, jnp.inf), jnp.where(grazes, jnp.abs(rate(*touch)), jnp.inf))

        gaps, rates = jax.lax.scan(one, state, jnp.arange(self.steps))[1]
        return jnp.min(gaps), jnp.min(rates)

    def other_side(self, state: Array, intervals: int) -> tuple[Array, Array, Array]:
        """Return the gap at a state that recurs after some intervals, its rate, and the state on the other side of a
        jump at that instant; NaN where no crossing makes the state jump."""
        none = jnp.full_like(self.dt, jnp.nan)
        return none, none, state

    def __call__(self, state: Array, k: Real) -> Array:
        return in_both_modes(self._interval, state, k)

    def _interval(self, state, k):
        # time at which step number i of this interval begins
        instant = lambda i: self.t0 + (k * self.steps + i) * self.dt

        def whole_step(carry):
            i, y, _ = carry
            end, crosses = self._ahead(instant(i), y)
            return jnp.where(crosses, i, i + 1), jnp.where(crosses, y, end), crosses

        # Whole steps run in an inner loop, because under vmap both sides of a condition would run in every step.
        def to_crossing(carry):
            i, y, _ = jax.lax.while_loop(lambda c: (c[0] < self.steps) & ~c[2], whole_step, carry)
            crosses = i < self.steps
            end, stuck = self._across(instant(i), y, crosses)
            return jnp.where(crosses, i + 1, i), jnp.where(crosses, end, y), stuck

        begin = 0, state, self._stuck(instant(0), state)
        return jax.lax.while_loop(lambda carry: carry[0] < self.steps, to_crossing, begin)[1]


class SwitchedStep(AbstractCrossingStep):
    """Map of y' = above(t, y) where surface(t, y) >= 0, and below(t, y) elsewhere. See `switched_step`."""

    above: Field
    below: Field

    def _side(self, up):
        side = jnp.where(up, 1.0, -1.0)
        field = lambda t, y: jnp.where(up, self.above(t, y), self.below(t, y))
        return field, lambda t, y: side * self.surface(t, y)

    def _rates(self, t, y):
        """Return how fast the surface's function grows along the field above, and along the field below."""
        return along(self.above, self.surface)(t, y), along(self.below, self.surface)(t, y)

    def _held(self, t, y):
        # Filippov's mixture of both fields, which stays on the surface
        above, below = self._rates(t, y)
        apart = jnp.where(below == above, 1.0, below - above)
        return (below * self.above(t, y) - above * self.below(t, y)) / apart

    def _holding(self, t, y):
        # both fields point towards the surface
        above, below = self._rates(t, y)
        return jnp.minimum(-above, below)

    def _near(self, t, y):
        """Return whether the surface is so near that rounding errors may decide on which side the motion is."""
        above, below = self._rates(t, y)
        return jnp.abs(self.surface(t, y)) <= ON_SURFACE * self.dt * (jnp.abs(above) + jnp.abs(below))

    def _ahead(self, t, y):
        field, gap = self._side(self.surface(t, y) >= 0)
        end = rk4(field, t, y, self.dt)
        rate, then = along(field, gap), t + self.dt
        fall, rise, last = rate(t, y), rate(then, end), gap(then, end)
        # a gap that falls and rises may be below zero in between, unless one of its end tangents stays above zero
        dips = (fall < 0) & (rise > 0) & (gap(t, y) + self.dt * fall < 0) & (last - self.dt * rise < 0)
        return end, (last < 0) | dips

    def _stuck(self, t, y):
        above, below = self._rates(t, y)
        return self._near(t, y) & (above < 0) & (below > 0)

    def _lasts(self, t, y, sticks):
        return sticks | self._near(t, y)

    def _after(self, t, y, up, sticks, happens):
        above, below = self._rates(t, y)
        # sliding ends along the field that no longer points towards the surface
        up = jnp.where(happens, jnp.where(sticks, -above < below, ~up), up)
        slides = jnp.where(happens, ~sticks & (above < 0) & (below > 0), sticks)
        return jnp.where(slides, _to_surface(self.surface, t, y), y), up, slides


class ImpactStep(AbstractCrossingStep):
    """Map of y' = field(t, y), with impacts where `surface` falls to zero. See `impact_step`."""

    field: Field
    reset: Reset

    @property
    def _rate(self) -> Surface:
        return along(self.field, self.surface)

    @property
    def _push(self) -> Surface:
        """Acceleration of the gap in flight, negative where the motion is pressed into the surface."""
        return along(self.field, self._rate)

    def _side(self, up):
        return self.field, self.surface

    def _ahead(self, t, y):
        end = rk4(self.field, t, y, self.dt)
        height = _lowest(self.field, self.surface, t, y, t + self.dt, end)[1]
        # the gap must fall, because rounding may put a start on the surface below it
        return end, height < jnp.minimum(self.surface(t, y), 0.0)

    def other_side(self, state, intervals):
        # up to the unsplit last step, which is then taken without the impact
        state_before = jax.lax.fori_loop(0, intervals - 1, lambda k, s: self(s, 1.0 * k), state)
        begin = self.t0 + (intervals - 1) * self.steps * self.dt
        shorter = dataclasses.replace(self, t0=begin, steps=self.steps - 1)
        before = rk4(self.field, begin + (self.steps - 1) * self.dt, shorter(state_before, 0.0), self.dt)
        rate = self._rate(self.t0, state)
        beyond = jnp.where(rate < 0, self.reset(self.t0, state), before)
        return self.surface(self.t0, state), rate, beyond

    def _stuck(self, t, y):
        gap, rate, push = jnp.maximum(self.surface(t, y), 0.0), jnp.abs(self._rate(t, y)), self._push(t, y)
        # the time until the gap closes again, at constant acceleration
        pressed = push < 0
        flight = (rate + jnp.sqrt(jnp.maximum(rate**2 - 2 * push * gap, 0.0))) / jnp.where(
            pressed,
            -push,
            1.0,
        )
        return pressed & (flight < SHORTEST * self.dt)

    def _begin(self, t, y):
        stuck = self._stuck(t, y)
        return jnp.where(stuck, self._settled(t, y), y), stuck

    def _after(self, t, y, up, sticks, happens):
        y = jnp.where(happens & ~sticks, self.reset(t, y), y)
        after = jnp.where(sticks, ~happens, happens & self._stuck(t, y))
        return jnp.where(after | sticks, self._settled(t, y), y), up, after

    def _reaction(self, t, y):
        """Return the change of the state by an impact, scaled so that the rate of the gap changes by one."""
        slope = jax.grad(lambda y: self._rate(t, y))(y)
        # the change by an impact for a change of the state along the gradient of the rate
        jump = jax.jvp(lambda y: self.reset(t, y), (y,), (slope,))[1] - slope
        return jump / (slope @ jump)

    def _holding(self, t, y):
        return -self._push(t, y)

    def _held(self, t, y):
        # the reaction cancels the acceleration of the gap
        return self.field(t, y) - self._push(t, y) * self._reaction(t, y)

    def _settled(self, t, y):
        """Return the state moved onto the surface, with a zero rate of the gap."""
        # first to the surface along its normal, then the rate across it becomes zero
        y = _to_surface(self.surface, t, y)
        return y - self._rate(t, y) * self._reaction(t, y)


class ReturnStep(eqx.Module):
    """Map from one fall of `surface` through zero to the next. See `return_step`."""

    field: Field
    surface: Surface
    reset: Reset | None
    dt: Float[Array, ""]
    most: int = eqx.field(static=True)

    def __call__(self, state: Array, k: Real) -> Array:
        return in_both_modes(self._flight, state, k)

    def _flight(self, state, k):
        start = jnp.zeros_like(self.dt)

        def whole_step(carry):
            i, y, risen, _ = carry
            end = rk4(self.field, i * self.dt, y, self.dt)
            height = self.surface((i + 1) * self.dt, end)
            # after a reset without lift-off, the surface falls at once
            falls = (risen | (self.reset is not None)) & (height < 0)
            return jnp.where(falls, i, i + 1), jnp.where(falls, y, end), risen | (height > 0), falls

        # Rounding puts a start on the surface above or below it. Therefore the surface must rise before it can fall.
        risen = jnp.zeros((), bool)
        if self.reset is not None:
            state = self.reset(start, state)
            risen = along(self.field, self.surface)(start, state) > 0
        begin = 0, state, risen, False
        i, y, risen, falls = jax.lax.while_loop(lambda c: (c[0] < self.most) & ~c[3], whole_step, begin)
        t = i * self.dt
        flow = lambda share: rk4(self.field, t, y, share * self.dt)
        end = flow(share_before(self.surface, flow, t, self.dt, falls))
        # NaN where the motion sticks, or does not return within `most` steps
        return jnp.where(falls & risen, end, jnp.nan)


def in_both_modes(function: Callable[[Array, Array], Array], state: Array, k: Real) -> Array:
    """Return function(state, k), differentiable in both modes, although while loops have only forward mode.

    Forward mode gives the Jacobian with respect to all differentiated numbers, also those that `function` closes
    over. A derivative costs as many tangents as there are such numbers. States are small.
    """
    kernel = lambda state, k: in_one_kernel(function, state, k)
    return by_jacobian(kernel, jnp.asarray(state), jnp.asarray(k), most=math.inf)


def switched_step(
    above: Field, below: Field, surface: Surface, *, dt: Real, steps: int, t0: Real = 0.0
) -> SwitchedStep:
    """Return the map of an ODE over an interval, where the right-hand side jumps when `surface` changes its sign.

    Each integration step (classical Runge-Kutta) that crosses the surface is split at the instant of the crossing.
    Where both fields point towards the surface, the motion slides along it until one field points away, by Filippov
    (doi:10.1007/978-94-015-7793-9): dry friction sticks. The lowest point of a cubic shows a crossing there and back
    within one step.

    **Arguments:** `above`, `below`: y' at (t, y) where surface(t, y) >= 0, and elsewhere; `dt`: integration step, in
    the system's unit of time; `steps`: steps in one interval; `t0`: time at which interval 0 starts.

    **Raises:** `ValueError` that names the wrong argument.
    """
    _check(above=above, below=below, surface=surface)
    return SwitchedStep(*_instants(dt, t0, steps), surface, above, below)


def impact_step(
    vector_field: Field,
    surface: Surface,
    reset: Reset,
    *,
    dt: Real,
    steps: int,
    t0: Real = 0.0,
) -> ImpactStep:
    """Return the map of a system with rigid stops over an interval: when `surface` falls to zero, `reset` is applied.

    Each impact is found inside a step. Where impacts accumulate (chattering), the motion sticks to the surface
    instead of making a flight shorter than `SHORTEST` of a step. A force in the direction of the impacts keeps the
    gap closed, and the motion slides along the surface until the vector field pulls it off (Nordmark and Piiroinen
    2009, Nonlinear Dynamics 58, 85). The state becomes NaN where `reset` does not turn the motion around. The lowest
    point of a cubic shows a touch within one step.

    The instants k steps dt + t0 are instants of a strobe, at which an impact changes the state at once. An impact
    that falls on the strobe is no bifurcation: `continue_motion` continues beyond it, from the state on the other
    side of the impact, and labels the place ST.

    **Arguments:**

    - `vector_field`: y' at (t, y).
    - `surface`: the gap at (t, y), positive where the stop is not touched.
    - `reset`: the state after an impact at (t, y), such as a velocity times minus the coefficient of restitution.
    - `dt`, `steps`, `t0`: as for `switched_step`.

    **Raises:** `ValueError` that names the wrong argument.
    """
    _check(vector_field=vector_field, surface=surface, reset=reset)
    return ImpactStep(*_instants(dt, t0, steps), surface, vector_field, reset)


def return_step(
    vector_field: Field,
    surface: Surface,
    reset: Reset | None = None,
    *,
    dt: Real,
    most: int = 100_000,
) -> ReturnStep:
    """Return the Poincare map of an autonomous system: from one fall of `surface` to zero to the next fall.

    `shoot` on this map finds periodic orbits of a flow without a phase condition. Along the flow the map's Jacobian
    has the multiplier zero, because neighbours on one trajectory return at one point. With `reset` it is an impact
    map, from just before an impact to just before the next. A motion that sticks to the surface has no next impact:
    NaN.

    **Arguments:**

    - `vector_field`: y' at (t, y), t from the start of a return; a forced system carries its phase in the state.
    - `surface`: a number at (t, y); use its negative where it should rise.
    - `reset`: as for `impact_step`, at the start of each return; default none.
    - `dt`: integration step; `most`: steps after which the state is NaN.

    **Raises:** `ValueError` that names the wrong argument.
    """
    _check(vector_field=vector_field, surface=surface, reset=vector_field if reset is None else reset)
    return ReturnStep(vector_field, surface, reset, positive("dt")(dt), whole("most", most, 1))


def _instants(dt, t0, steps):
    return positive("dt")(dt), finite("t0")(t0), whole("steps", steps, 1)


def _lowest(field: Field, gap: Surface, t: Array, y: Array, then: Array, end: Array) -> tuple[Array, Array]:
    """Return the share of a flight at which its gap is least, and the gap there, by a cubic."""
    rate = along(field, gap)
    (start, slope), (last, last_slope) = ((-gap(*at), -(then - t) * rate(*at)) for at in ((t, y), (then, end)))
    share, height = highest_point(start, slope, last, last_slope)
    return jax.lax.stop_gradient(share), -height


def _to_surface(surface: Surface, t: Array, y: Array) -> Array:
    """Return the state moved onto a surface along its normal, to first order."""
    slope = jax.grad(lambda y: surface(t, y))(y)
    return y - surface(t, y) / (slope @ slope) * slope


def along(field: Field, function: Surface) -> Surface:
    """Return the time derivative of a function of (t, y) along the motions of a field."""

    def derivative(t, y):
        t = jnp.asarray(t, float)
        return jax.jvp(function, (t, y), (jnp.ones_like(t), field(t, y)))[1]

    return derivative


def _check(**functions):
    for name, function in functions.items():
        require(callable(function), name, "be a function", function)
