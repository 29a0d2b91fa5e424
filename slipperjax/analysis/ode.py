"""Ordinary differential equations as maps, also with switching vector fields, and their Lyapunov spectra."""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.checks import finite, positive, require, whole
from .lyapunov import LyapunovSpectrum, map_spectrum


class OdeStep(eqx.Module):
    """`step` of an ODE: one `diffrax.diffeqsolve` with constant steps over each interval. See `ode_step`."""

    vector_field: Callable[[Any, Any, Any], Any]
    solver: diffrax.AbstractSolver
    args: Any
    t0: Float[Array, ""]
    duration: Float[Array, ""]
    """Length of an interval, in the ODE's unit of time."""
    steps: int = eqx.field(static=True)

    def __call__(self, state: Any, k: Any) -> Any:
        def field(t, y, args):
            t_start, duration, args = args
            return jax.tree.map(lambda r: duration * r, self.vector_field(t_start + duration * t, y, args))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            self.solver,
            t0=0.0,  # from 0 to 1 in each interval, so that all have the same steps
            t1=1.0,
            dt0=1 / self.steps,
            y0=state,
            args=(self.t0 + k * self.duration, self.duration, self.args),
            stepsize_controller=diffrax.ConstantStepSize(),
            adjoint=diffrax.ForwardMode(),
            max_steps=self.steps + 1,
            throw=False,
        )
        return jax.tree.map(lambda ys: ys[0], solution.ys)


def ode_step(
    vector_field: Callable[[Any, Any, Any], Any],
    *,
    dt: Any,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    args: Any = None,
    t0: Any = 0.0,
) -> OdeStep:
    """Makes `step` of y' = vector_field(t, y, args): `steps` steps of `dt` per interval, the first at time `t0`.

    **Arguments:** `solver`: any diffrax solver; default `diffrax.Tsit5()`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    require(callable(vector_field), "vector_field", "be a function", vector_field)
    require(solver is None or isinstance(solver, diffrax.AbstractSolver), "solver", "be a diffrax solver", solver)
    steps = whole("steps", steps, 1)
    duration = steps * positive("dt")(dt)
    solver = diffrax.Tsit5() if solver is None else solver
    return OdeStep(vector_field, solver, args, finite("t0")(t0), duration, steps)


def ode_spectrum(
    vector_field: Callable[[Any, Any, Any], Any],
    state: Any,
    intervals: int,
    *,
    dt: Any,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    args: Any = None,
    t0: Any = 0.0,
    **options: Any,
) -> LyapunovSpectrum:
    """Computes the Lyapunov spectrum of an ODE. Its `per_second` is per unit of the ODE's time.

    **Arguments:** up to `t0` as for `ode_step`; `options` as for `map_spectrum`. If `period` is given, an
    interval has `dt * steps / period` periods; by default a period is one interval.
    """
    step = ode_step(vector_field, dt=dt, steps=steps, solver=solver, args=args, t0=t0)
    period = options.pop("period", step.duration)
    options.setdefault("periods", step.duration / positive("period")(period))
    return map_spectrum(step, state, intervals, period=period, **options)


Field = Callable[[Any, Any], Any]
"""y' at (t, y)."""
CROSSING_ITERATIONS = 5
"""Newton iterations for the instant of a crossing from the chord; converged, so that the derivative is exact too."""


class SwitchedStep(eqx.Module):
    """`step` of y' = above(t, y) where surface(t, y) >= 0, and below(t, y) elsewhere. See `switched_step`."""

    above: Field
    below: Field
    surface: Callable[[Any, Any], Any]
    dt: Float[Array, ""]
    t0: Float[Array, ""]
    steps: int = eqx.field(static=True)

    def __call__(self, state: Any, k: Any) -> Any:
        def one(i, y):
            return self._across(self.t0 + (k * self.steps + i) * self.dt, y)

        return jax.lax.fori_loop(0, self.steps, one, state)

    def _across(self, t, y):
        """Gives the state after one step, split where it crosses the surface."""
        up = self.surface(t, y) >= 0
        here = lambda part: self._rk4(up, t, y, part * self.dt)
        height = lambda part: self.surface(t + part * self.dt, here(part))
        start, end = self.surface(t, y), height(1.0)
        crossed = (end >= 0) != up

        def closer(_, part):
            value, slope = jax.jvp(height, (part,), (jnp.ones_like(part),))
            return jnp.clip(part - value / jnp.where(slope == 0, jnp.inf, slope), 0.0, 1.0)

        chord = jnp.where(crossed, start / jnp.where(crossed, start - end, 1.0), 1.0)
        part = jnp.where(crossed, jax.lax.fori_loop(0, CROSSING_ITERATIONS, closer, chord), 1.0)
        return self._rk4(~up, t + part * self.dt, here(part), (1 - part) * self.dt)

    def _rk4(self, up, t, y, h):
        def field(t, y):
            return jax.tree.map(lambda a, b: jnp.where(up, a, b), self.above(t, y), self.below(t, y))

        ahead = lambda k, part: jax.tree.map(lambda y, k: y + part * h * k, y, k)
        a = field(t, y)
        b = field(t + h / 2, ahead(a, 0.5))
        c = field(t + h / 2, ahead(b, 0.5))
        d = field(t + h, ahead(c, 1.0))
        return jax.tree.map(lambda y, a, b, c, d: y + h / 6 * (a + 2 * b + 2 * c + d), y, a, b, c, d)


def switched_step(
    above: Field, below: Field, surface: Callable[[Any, Any], Any], *, dt: Any, steps: int, t0: Any = 0.0
) -> SwitchedStep:
    """Makes `step` for `map_spectrum` of an ODE whose right-hand side jumps where `surface` changes its sign.

    Each integration step (classical Runge-Kutta) that crosses the surface is split at the instant of the crossing.
    That instant depends on the state in a differentiable way, so tangents include the saltation term. Crossings must
    be transversal, at most one per step; grazing, sliding, and steps longer than the time between two crossings are
    not supported.

    **Arguments:** `above`, `below`: y' at (t, y) where surface(t, y) >= 0, and elsewhere; `dt`: integration step, in
    the system's unit of time; `steps`: steps in one interval; `t0`: time at which interval 0 starts.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    for name, function in (("above", above), ("below", below), ("surface", surface)):
        require(callable(function), name, "be a function", function)
    dt, t0 = positive("dt")(dt), finite("t0")(t0)
    return SwitchedStep(above, below, surface, jnp.asarray(dt), jnp.asarray(t0), whole("steps", steps, 1))
