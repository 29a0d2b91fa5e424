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

from ..tools.checks import finite, number, positive, require, unless_traced, whole
from ..tools.compile import call_compiled, is_traced
from .curves import AbstractEquations, Evaluation
from .floquet import jacobians, solve
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


Family = Callable[..., Step]
"""The map for values of its parameters: `family(value, ...)(state, k)` is the state one interval later."""


class PeriodicMotions(AbstractEquations):
    """Motions that recur after some intervals: P(x; values) - x = 0 for the state x and the parameters.

    The unknowns are the components of the state and the values of the parameters, in this order.
    """

    family: Family
    """A pytree, such as an `equinox.Module`, whose array leaves may change without compiling anew."""
    like: Any
    """A state, of which the structure counts."""
    reach: Any
    """Changes of the parameters that count as a length of one, of shape (parameters,)."""
    scale: Scale | None = None
    """Weights of the state's components, as for `slipperjax.analysis.shoot`."""
    index: Any = 0.0
    """Number of the first interval."""
    intervals: int = eqx.field(static=True, default=1)

    @property
    def size(self) -> int:
        """Numbers in a state."""
        return sum(jnp.size(leaf) for leaf in jax.tree.leaves(self.like))

    @property
    def parameters(self) -> int:
        """How many parameters there are."""
        return jnp.size(self.reach)

    def place(self, state: Any, *values: Any) -> Array:
        """The unknowns from a state and values of the parameters."""
        flat = ravel_pytree(state)[0]
        require(flat.size == self.size, "state", f"have {self.size} numbers as `like` has", flat.size)
        return jnp.concatenate([flat, jnp.asarray(values, float)])

    def state(self, z: Array) -> Any:
        """The state of a place."""
        return ravel_pytree(self.like)[1](jnp.asarray(z)[: self.size])

    def values(self, z: Array) -> tuple[Array, ...]:
        """The values of the parameters at a place."""
        return tuple(jnp.asarray(z)[self.size : self.size + self.parameters])

    def step(self, z: Array) -> Step:
        """The map at a place."""
        return self.family(*self.values(z))

    def mapped(self, z: Array) -> Array:
        """The state after the intervals, as one array. Pure."""
        step, ks = self.step(z), self.index + jnp.arange(float(self.intervals))
        return ravel_pytree(jax.lax.scan(lambda s, k: (step(s, k), None), self.state(z), ks)[0])[0]

    def evaluate(self, z: Array) -> Evaluation:
        size, count = self.size, self.parameters
        unravel = ravel_pytree(self.like)[1]

        def interval(carry, k):
            x, by_values = carry
            flow = lambda of: ravel_pytree(self.family(*of[size:])(unravel(of[:size]), k))[0]
            of = jnp.concatenate([x, z[size : size + count]])
            along = lambda t: jax.jvp(flow, (of,), (t,))
            end, matrix = jax.vmap(along, out_axes=(None, 1))(jnp.eye(size + count))
            return (end, matrix[:, :size] @ by_values + matrix[:, size:]), matrix[:, :size]

        begin = z[:size], jnp.zeros((size, count))
        ks = self.index + jnp.arange(float(self.intervals))
        (end, by_values), matrices = jax.lax.scan(interval, begin, ks)
        by_state = product(matrices) - jnp.eye(size)
        return Evaluation(end - z[:size], jnp.concatenate([by_state, by_values], axis=1), matrices)

    def weights(self, z: Array) -> tuple[Array, Array]:
        found = weights_of(self.state(z), self.scale)
        of_state = jnp.ones(self.size) if found is None else found
        return of_state, jnp.concatenate([self.measure(of_state), 1 / jnp.atleast_1d(self.reach)])

    def measure(self, weights: Array) -> Array:
        """Weights of the state in the length of a curve, from those of the residual. Here the same."""
        return weights

    def settled(self, z: Array, before: Array, residual: Array) -> Array:
        mapped = before[: self.size] + residual[: self.size]
        new = self.settle(self.step(z), self.state(z), ravel_pytree(self.like)[1](mapped))
        return z.at[: self.size].set(ravel_pytree(new)[0])

    def settle(self, step: Step, proposed: Any, mapped: Any) -> Any:
        """A consistent state from a proposed one, and from what the last iterate is mapped to. Here as proposed."""
        del step, mapped
        return proposed
