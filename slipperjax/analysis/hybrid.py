"""Maps of systems that switch, rebound or are seen at a section: each crossing is found inside a step.

The instant of a crossing depends on the state in a differentiable way, so that Jacobians of these maps contain the
saltation matrix of each switch and rebound (Leine and Nijmeijer 2004, doi:10.1007/978-3-540-44398-8). Crossings must
be transversal: at a grazing the derivative does not exist. Derivatives are there in forward and reverse mode.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from ..tools.checks import finite, positive, require, whole

Field = Callable[[Any, Any], Any]
"""y' at (t, y)."""
Surface = Callable[[Any, Any], Any]
"""A number at (t, y), which is zero on a surface: a gap, or a coordinate."""
Reset = Callable[[Any, Any], Any]
"""The state after a rebound, at (t, y) on the surface."""
CROSSING_ITERATIONS = 5
"""Newton iterations for the instant of a crossing from the chord; converged, so that the derivative is exact too."""


def rk4(field: Field, t: Any, y: Any, h: Any) -> Any:
    """Makes a step of the classical method of Runge and Kutta: the state at t + h."""
    ahead = lambda k, part: jax.tree.map(lambda y, k: y + part * h * k, y, k)
    a = field(t, y)
    b = field(t + h / 2, ahead(a, 0.5))
    c = field(t + h / 2, ahead(b, 0.5))
    d = field(t + h, ahead(c, 1.0))
    return jax.tree.map(lambda y, a, b, c, d: y + h / 6 * (a + 2 * b + 2 * c + d), y, a, b, c, d)


def share_before(
    surface: Surface, flow: Callable[[Any], Any], t: Any, dt: Any, crosses: Bool[Array, ""]
) -> Float[Array, ""]:
    """Computes the share of a step from `t` after which `surface` is zero; 1 where it is not crossed.

    **Arguments:** `flow(share)`: the state after this share of the step `dt`.
    """
    height = lambda share: surface(t + share * dt, flow(share))
    start, end = height(0.0), height(1.0)

    def closer(_, share):
        value, slope = jax.jvp(height, (share,), (jnp.ones_like(share),))
        return jnp.clip(share - value / jnp.where(slope == 0, jnp.inf, slope), 0.0, 1.0)

    chord = jnp.clip(start / jnp.where(crosses, start - end, 1.0), 0.0, 1.0)
    return jnp.where(crosses, jax.lax.fori_loop(0, CROSSING_ITERATIONS, closer, chord), 1.0)


class AbstractCrossingStep(eqx.Module):
    """`step` that takes whole integration steps until one crosses a surface, and splits that one."""

    dt: Float[Array, ""]
    t0: Float[Array, ""]
    steps: int = eqx.field(static=True)

    @abc.abstractmethod
    def _ahead(self, t: Any, y: Any) -> tuple[Any, Bool[Array, ""]]:
        """The state after a whole step from (t, y), and whether that crosses."""

    @abc.abstractmethod
    def _across(self, t: Any, y: Any, crosses: Bool[Array, ""]) -> Any:
        """The state after a step from (t, y) with a crossing inside, where it `crosses`."""

    def __call__(self, state: Any, k: Any) -> Any:
        return in_both_modes(self._interval, state, k)

    def _interval(self, state, k):
        instant = lambda i: self.t0 + (k * self.steps + i) * self.dt

        def whole_step(carry):
            i, y, _ = carry
            end, crosses = self._ahead(instant(i), y)
            return jnp.where(crosses, i, i + 1), _where(crosses, y, end), crosses

        def to_crossing(carry):
            i, y, _ = jax.lax.while_loop(lambda c: (c[0] < self.steps) & ~c[2], whole_step, (*carry, False))
            crosses = i < self.steps
            y = _where(crosses, self._across(instant(i), y, crosses), y)
            return jnp.where(crosses, i + 1, i), y

        return jax.lax.while_loop(lambda carry: carry[0] < self.steps, to_crossing, (0, state))[1]


class SwitchedStep(AbstractCrossingStep):
    """`step` of y' = above(t, y) where surface(t, y) >= 0, and below(t, y) elsewhere. See `switched_step`."""

    above: Field
    below: Field
    surface: Surface

    def _field(self, up):
        return lambda t, y: _where(up, self.above(t, y), self.below(t, y))

    def _ahead(self, t, y):
        up = self.surface(t, y) >= 0
        end = rk4(self._field(up), t, y, self.dt)
        return end, (self.surface(t + self.dt, end) >= 0) != up

    def _across(self, t, y, crosses):
        up = self.surface(t, y) >= 0
        flow = lambda share: rk4(self._field(up), t, y, share * self.dt)
        share = share_before(self.surface, flow, t, self.dt, crosses)
        return rk4(self._field(~up), t + share * self.dt, flow(share), (1 - share) * self.dt)


class ImpactStep(AbstractCrossingStep):
    """`step` of y' = field(t, y), which rebounds where `surface` falls to zero. See `impact_step`."""

    field: Field
    surface: Surface
    reset: Reset

    def _ahead(self, t, y):
        end = rk4(self.field, t, y, self.dt)
        height = self.surface(t + self.dt, end)
        # by falling, since a state on the surface may lie below it by rounding
        return end, (height < 0) & (height < self.surface(t, y))

    def _across(self, t, y, crosses):
        flow = lambda share: rk4(self.field, t, y, share * self.dt)
        share = share_before(self.surface, flow, t, self.dt, crosses)
        then = t + share * self.dt
        return rk4(self.field, then, self.reset(then, flow(share)), (1 - share) * self.dt)


class ReturnStep(eqx.Module):
    """`step` from one fall of `surface` to zero to the next. See `return_step`."""

    field: Field
    surface: Surface
    reset: Reset | None
    dt: Float[Array, ""]
    most: int = eqx.field(static=True)

    def __call__(self, state: Any, k: Any) -> Any:
        return in_both_modes(self._flight, state, k)

    def _flight(self, state, k):
        def whole_step(carry):
            i, y, risen, _ = carry
            end = rk4(self.field, i * self.dt, y, self.dt)
            height = self.surface((i + 1) * self.dt, end)
            falls = risen & (height < 0)
            return jnp.where(falls, i, i + 1), _where(falls, y, end), risen | (height > 0), falls

        # a start on the surface lies above or below it by rounding: it must have risen before it can fall
        begin = 0, state if self.reset is None else self.reset(jnp.zeros_like(self.dt), state), False, False
        i, y, _, falls = jax.lax.while_loop(lambda c: (c[0] < self.most) & ~c[3], whole_step, begin)
        t = i * self.dt
        flow = lambda share: rk4(self.field, t, y, share * self.dt)
        end = flow(share_before(self.surface, flow, t, self.dt, falls))
        return jax.tree.map(lambda y: jnp.where(falls, y, jnp.nan), end)


def in_both_modes(function: Callable[[Any, Any], Any], state: Any, k: Any) -> Any:
    """Gives function(state, k) with derivatives in reverse mode too, where loops know forward mode only.

    They are those of its Jacobian by forward mode, a matrix, by all numbers that are differentiated, also those
    that `function` closes over. States are small; a derivative costs as many as there are such numbers.
    """
    state, k = jax.tree.map(jnp.asarray, (state, k))
    return _by_jacobian(eqx.filter_closure_convert(function, state, k), state, k)


@eqx.filter_custom_jvp
def _by_jacobian(function, state, k):
    return function(state, k)


@_by_jacobian.def_jvp
def _(primals, tangents):
    moves = jax.tree.map(lambda _, tangent: tangent is not None, primals, tangents)
    moving, fixed = eqx.partition(primals, moves)
    flat, unravel = ravel_pytree(moving)
    back = ravel_pytree(primals[1])[1]  # a step gives a state of the same kind

    def end(flat):
        function, state, k = eqx.combine(unravel(flat), fixed)
        return ravel_pytree(function(state, k))[0]

    slopes = lambda direction: jax.jvp(end, (flat,), (direction,))
    value, jacobian = jax.vmap(slopes, out_axes=(None, 1))(jnp.eye(flat.size))
    return back(value), back(jacobian @ ravel_pytree(tangents)[0])


def switched_step(
    above: Field, below: Field, surface: Surface, *, dt: Any, steps: int, t0: Any = 0.0
) -> SwitchedStep:
    """Makes `step` of an ODE whose right-hand side jumps where `surface` changes its sign.

    Each integration step (classical Runge-Kutta) that crosses the surface is split at the instant of the crossing.
    Grazing, sliding, and steps longer than the time between two crossings are not supported.

    **Arguments:** `above`, `below`: y' at (t, y) where surface(t, y) >= 0, and elsewhere; `dt`: integration step, in
    the system's unit of time; `steps`: steps in one interval; `t0`: time at which interval 0 starts.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    _check(above=above, below=below, surface=surface)
    return SwitchedStep(*_instants(dt, t0, steps), above, below, surface)


def impact_step(
    vector_field: Field, surface: Surface, reset: Reset, *, dt: Any, steps: int, t0: Any = 0.0
) -> ImpactStep:
    """Makes `step` of an oscillator with rigid stops: where `surface` falls to zero, `reset` gives the state.

    The motion rebounds at the instant of the impact inside a step, at most once a step: impacts that accumulate are
    not followed to rest.

    **Arguments:**

    - `vector_field`: y' at (t, y).
    - `surface`: a number at (t, y) that is positive where the stop is not touched: the gap.
    - `reset`: the state after an impact at (t, y), such as a velocity times minus the coefficient of restitution.
    - `dt`, `steps`, `t0`: as for `switched_step`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    _check(vector_field=vector_field, surface=surface, reset=reset)
    return ImpactStep(*_instants(dt, t0, steps), vector_field, surface, reset)


def return_step(
    vector_field: Field, surface: Surface, reset: Reset | None = None, *, dt: Any, most: int = 100_000
) -> ReturnStep:
    """Makes the Poincare map of an autonomous system: from a point where `surface` falls to zero to the next.

    `shoot` on it finds periodic orbits of a flow without a phase condition: along the flow the map's Jacobian has the
    multiplier zero, because neighbours on one trajectory return at one point. With `reset` it is an impact map, from
    just before an impact to just before the next.

    **Arguments:**

    - `vector_field`: y' at (t, y), t from the start of a return; a forced system carries its phase in the state.
    - `surface`: a number at (t, y); where it should rise, take its negative.
    - `reset`: as for `impact_step`, at the start of each return; default none.
    - `dt`: integration step, shorter than any flight; `most`: steps after which the state is NaN.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    _check(vector_field=vector_field, surface=surface, reset=vector_field if reset is None else reset)
    return ReturnStep(vector_field, surface, reset, positive("dt")(dt), whole("most", most, 1))


def _instants(dt, t0, steps):
    return positive("dt")(dt), finite("t0")(t0), whole("steps", steps, 1)


def _where(which, one, other):
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), one, other)


def _check(**functions):
    for name, function in functions.items():
        require(callable(function), name, "be a function", function)
