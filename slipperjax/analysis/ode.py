"""Ordinary differential equations as maps, and their Lyapunov spectra."""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
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
        # time runs from 0 to 1 in each interval, so that all have the same steps
        def field(t, y, args):
            t_start, duration, args = args
            return jax.tree.map(
                lambda r: duration * r,
                self.vector_field(
                    t_start + duration * t,
                    y,
                    args,
                ),
            )

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            self.solver,
            t0=0.0,
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
    """Return `step` of y' = vector_field(t, y, args): `steps` steps of `dt` per interval, the first at time `t0`.

    **Arguments:** `solver`: any diffrax solver; default `diffrax.Tsit5()`.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    require(callable(vector_field), "vector_field", "be a function", vector_field)
    require(
        solver is None or isinstance(solver, diffrax.AbstractSolver),
        "solver",
        "be a diffrax solver",
        solver,
    )
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
    """Return the Lyapunov spectrum of an ODE. Its `per_second` is per unit of the ODE's time.

    **Arguments:** up to `t0` as for `ode_step`; `options` as for `map_spectrum`. If `period` is given, an
    interval has `dt * steps / period` periods; by default a period is one interval.
    """
    step = ode_step(vector_field, dt=dt, steps=steps, solver=solver, args=args, t0=t0)
    period = options.pop("period", step.duration)
    options.setdefault("periods", step.duration / positive("period")(period))
    return map_spectrum(step, state, intervals, period=period, **options)
