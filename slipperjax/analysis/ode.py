"""Ordinary differential equations as maps, and their Lyapunov spectra."""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
from jaxtyping import Array, Float, PyTree

from ..tools.checks import finite, instance, positive, require, whole
from ..tools.types import Real
from .lyapunov import LyapunovSpectrum, map_spectrum

VectorField = Callable[[Array, PyTree, PyTree], PyTree]
"""Right-hand side of an ODE: y' at (t, y, args)."""


class OdeStep(eqx.Module):
    """The map of an ODE over an interval, `step(state, k)`: a `diffrax.diffeqsolve` with constant steps."""

    vector_field: VectorField
    solver: diffrax.AbstractSolver
    args: PyTree
    t0: Float[Array, ""]
    duration: Float[Array, ""]
    """Length of an interval [unit of t]."""
    steps: int = eqx.field(static=True)

    def __call__(self, state: PyTree, k: Real) -> PyTree:
        # time runs from 0 to 1 in each interval, so that the steps of all intervals are equal to the last bit
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
        # only the state at the end is saved
        return jax.tree.map(lambda ys: ys[0], solution.ys)


def ode_step(
    vector_field: VectorField,
    *,
    dt: Real,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    args: PyTree = None,
    t0: Real = 0.0,
) -> OdeStep:
    """Return the map of y' = vector_field(t, y, args) over an interval of `steps` steps of length `dt` from `t0` on.

    **Arguments:** `solver`: any diffrax solver; default `diffrax.Tsit5()`.

    **Raises:** `ValueError` that names the wrong argument.
    """
    require(callable(vector_field), "vector_field", "be a function", vector_field)
    solver = diffrax.Tsit5() if solver is None else solver
    instance("solver", solver, diffrax.AbstractSolver, "a diffrax solver")
    steps = whole("steps", steps, 1)
    duration = steps * positive("dt")(dt)
    return OdeStep(vector_field, solver, args, finite("t0")(t0), duration, steps)


def ode_spectrum(
    vector_field: VectorField,
    state: PyTree,
    intervals: int,
    *,
    dt: Real,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    args: PyTree = None,
    t0: Real = 0.0,
    **options: Real,
) -> LyapunovSpectrum:
    """Return the Lyapunov spectrum of an ODE. Its `per_second` is per unit of t.

    **Arguments:** `state`, `intervals` and `options` as for `map_spectrum`, the others as for `ode_step`. With the
    option `period`, an interval has `dt * steps / period` periods; by default a period is one interval.
    """
    step = ode_step(vector_field, dt=dt, steps=steps, solver=solver, args=args, t0=t0)
    period = options.pop("period", step.duration)
    options.setdefault("periods", step.duration / positive("period")(period))
    return map_spectrum(step, state, intervals, period=period, **options)
