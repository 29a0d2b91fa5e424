"""Periodic motions of any differentiable map by Newton's method, with the derivatives of the exact motions.

The unknowns are the state at the start; the forcing fixes the period, so that no phase condition is needed. The
Jacobian is computed where it has to be; between, Broyden's updates (doi:10.1090/S0025-5718-1965-0198670-6) follow it,
because it costs as much as the map of all directions, and a step costs one map.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from ..tools import call_compiled, finite, is_traced, number, positive, unless_traced, whole
from .floquet import jacobians
from .linear import solve
from .lyapunov import Scale, Step, check_functions, check_state, weights_of

Settle = Callable[[Any, Any], Any]
"""A consistent state from one that Newton's method proposes, and from the one that the last iterate is mapped to."""

HALVINGS = 8
"""How often a step of Newton's method is halved before it is taken whatever it gives."""
FALL = 0.1
"""Share of a step by which the residual must fall for the step to be taken."""
AIM = 1e-3
"""Residual that Broyden's updates go on to, over the tolerance: the Jacobian at the end is of the motion there."""
SLOW = 0.3
"""Share of the residual that may be left after a step; where more is left, the Jacobian is computed anew."""


class Shot(eqx.Module):
    """A periodic motion, as far as Newton's method came."""

    state: Any
    """The state at the start."""
    residual: Float[Array, ""]
    """Greatest weighted component of what the state misses after the intervals."""
    iterations: Int[Array, ""]
    matrices: Float[Array, "intervals size size"]
    """Jacobians of the successive intervals there, for `multipliers`."""


def shoot(
    step: Step,
    state: Any,
    *,
    intervals: int = 1,
    index: Any = 0.0,
    scale: Scale | None = None,
    settle: Settle | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 30,
) -> Shot:
    """A motion that recurs after some intervals, by Newton's method from a state near it. Pure.

    The step is halved until the residual falls. The result has the derivatives of the exact motion with respect to
    all numbers of `step`, in forward and reverse mode, whatever the iterations were.

    **Arguments:**

    - `step(state, k)`: the state one interval later, differentiable, with k the number of the interval.
    - `state`: a pytree of floats, the first guess.
    - `intervals`: after how many the motion recurs; `index`: that of the first.
    - `scale`: gives the weights of the components at a state, which the residual's components are multiplied by; a
        component of weight zero is not looked at. Default all one.
    - `settle`: makes proposed states consistent, see `Settle`; default leaves them.
    - `tolerance`: residual at which the iteration ends. `max_iterations`: it ends then in any case.

    **Returns:** a `Shot`; look at its `residual`, which is NaN or large where there is no such motion nearby.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    check_functions(step, scale)
    state, count = check_state(state), whole("intervals", intervals, 1)
    limit = whole("max_iterations", max_iterations, 0)
    tolerance = number(positive, "tolerance", tolerance)
    settle = _as_proposed if settle is None else settle
    index = unless_traced(finite("index"), index)
    differentiable = is_traced((step, state, index))
    static = count, limit, differentiable
    return call_compiled(_shoot, (step, scale, settle), static, state, index, jnp.asarray(tolerance))


def _as_proposed(proposed: Any, mapped: Any) -> Any:
    del mapped
    return proposed


class _Iterate(eqx.Module):
    x: Array
    residual: Array
    size: Array
    count: Array


def _shoot(functions, static, state, index, tolerance):
    step, scale, settle = functions
    intervals, limit, differentiable = static
    flat, unravel = ravel_pytree(state)
    # the iteration itself is not differentiated
    fixed = jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, step)
    here = jax.lax.stop_gradient(index)

    def mapped(function, x, start):
        steps = start + jnp.arange(float(intervals))
        return jax.lax.scan(lambda s, k: (function(s, k), None), unravel(x), steps)[0]

    def judged(x, count):
        residual = ravel_pytree(mapped(fixed, x, here))[0] - x
        weights = weights_of(unravel(x), scale)
        seen = residual if weights is None else jnp.where(weights > 0, weights * residual, 0.0)
        size = jnp.max(jnp.abs(seen))
        return _Iterate(x, residual, jnp.where(jnp.all(jnp.isfinite(residual)), size, jnp.inf), count)

    def proposed(now, share, direction):
        new = settle(unravel(now.x + share * direction), unravel(now.x + now.residual))
        return judged(ravel_pytree(new)[0], now.count + 1)

    def halved(now, direction):
        """The longest of the steps of 1, 1/2, 1/4, ... after which the residual has fallen."""

        def worse(carry):
            share, new = carry
            return (new.size > (1 - FALL * share) * now.size) & (share > 0.5**HALVINGS)

        half = lambda carry: (carry[0] / 2, proposed(now, carry[0] / 2, direction))
        first = jnp.asarray(2.0), dataclasses.replace(now, size=jnp.asarray(jnp.inf))
        return jax.lax.while_loop(worse, half, first)[1]

    def newton(now):
        matrix = product(jacobians(fixed, unravel(now.x), intervals, index=here))
        inverse = solve(jnp.eye(flat.size) - matrix, jnp.eye(flat.size))

        def broyden(carry):
            now, inverse, _ = carry
            new = halved(now, inverse @ now.residual)
            moved, fell = new.x - now.x, now.residual - new.residual
            weights = weights_of(unravel(now.x), scale)
            row = moved if weights is None else weights**2 * moved
            row = row @ inverse
            share = row @ fell
            update = jnp.outer(moved - inverse @ fell, row) / jnp.where(share == 0, jnp.inf, share)
            return new, inverse + update, new.size < SLOW * now.size

        def further(carry):
            now, _, fast = carry
            return fast & (now.size > AIM * tolerance) & (now.count < limit) & jnp.isfinite(now.size)

        return jax.lax.while_loop(further, broyden, (now, inverse, True))[0]

    first = judged(jax.lax.stop_gradient(flat), jnp.asarray(0))
    going_on = lambda now: (now.size > tolerance) & (now.count < limit) & jnp.isfinite(now.size)
    last = jax.lax.while_loop(going_on, newton, first)
    x = jax.lax.stop_gradient(last.x)
    matrices = jacobians(fixed, unravel(x), intervals, index=here)
    # one more step: with the derivatives of the map alone it has those of the exact motion
    miss = ravel_pytree(mapped(step, x, index))[0] - x
    left = jnp.where(last.size <= tolerance, 0.0, jax.lax.stop_gradient(miss))
    x = x + solve(jnp.eye(flat.size) - product(matrices), miss - left)
    if differentiable:
        matrices = jacobians(step, unravel(x), intervals, index=index)
    return Shot(unravel(x), judged(jax.lax.stop_gradient(x), last.count).size, last.count, matrices)


def product(matrices: Array) -> Array:
    """The product of successive Jacobians, the first applied first."""
    return jax.lax.scan(lambda total, m: (m @ total, None), jnp.eye(matrices.shape[1]), matrices)[0]


def minimal_period(step: Step, state: Any, intervals: int, *, index: Any = 0.0, scale: Scale | None = None) -> Any:
    """The residuals of a motion that recurs after `intervals` intervals, after each of its divisors. Pure.

    **Returns:** a dict of residuals, as in `Shot`, by divisor; the first that is small is the minimal period.
    """
    count = whole("intervals", intervals, 1)
    return call_compiled(
        _residuals, (step, scale), (count,), check_state(state), unless_traced(finite("index"), index)
    )


def _residuals(functions, static, state, index):
    step, scale = functions
    flat, _ = ravel_pytree(state)
    weights = weights_of(state, scale)

    def interval(s, k):
        s = step(s, k)
        miss = ravel_pytree(s)[0] - flat
        seen = miss if weights is None else jnp.where(weights > 0, weights * miss, 0.0)
        return s, jnp.max(jnp.abs(seen))

    missed = jax.lax.scan(interval, state, index + jnp.arange(float(static[0])))[1]
    return {n: missed[n - 1] for n in range(1, static[0] + 1) if static[0] % n == 0}
