"""Periodic motions of any differentiable map by Newton's method, with the derivatives of the exact motions.

The unknowns are the state at the start. The forcing fixes the period, so that no phase condition is needed.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..tools.checks import number, positive, require, whole
from ..tools.compile import as_argument, call_compiled
from ..tools.forms import in_one_kernel
from ..tools.tracing import is_transformed
from ..tools.types import Real
from .floquet import linearise, product
from .lyapunov import Scale, Step, checked_system, weights_of
from .newton import AbstractEquations, Linearisation, constant, exact_zero, newton, weighted_size

Consistent = Callable[[Step, PyTree, PyTree], PyTree]
"""Function `consistent(step, proposed, mapped)`: a consistent state for a state that Newton's method proposes;
`mapped` is the state to which the map takes the last iterate."""


class Shot(eqx.Module):
    """A periodic motion from Newton's method, if its `residual` is small."""

    state: PyTree
    """The state at the start."""
    residual: Float[Array, ""]
    """Greatest weighted component of the change of the state over all intervals."""
    iterations: Int[Array, ""]
    matrices: Float[Array, "intervals size size"]
    """Jacobians of the successive intervals, for `multipliers`."""


def shoot(
    step: Step,
    state: PyTree,
    *,
    intervals: int = 1,
    scale: Scale | None = None,
    consistent: Consistent | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 30,
) -> Shot:
    """Return a motion that recurs after some intervals, by Newton's method from a state near it. Pure.

    Steps are halved where the residual does not fall. The result has the derivatives of the exact motion with respect
    to all numbers of `step`, of any order, in forward and reverse mode.

    **Arguments:**

    - `step(state, k)`: the state one interval later, differentiable, with k the number of the interval, from 0 on.
    - `state`: a pytree of floats, the first guess.
    - `intervals`: number of intervals after which the motion recurs.
    - `scale`: function of a state that returns the weights of the residual's components; components of weight zero do
        not count. By default all weights are one.
    - `consistent(step, proposed, mapped)`: makes proposed states consistent, see `Consistent`; by default they stay.
    - `tolerance`: residual at which the iteration ends. `max_iterations`: most iterations.

    **Returns:** a `Shot`; check its `residual`, which is NaN or large where there is no such motion nearby.

    **Raises:** `ValueError` that names the wrong argument.
    """
    require(consistent is None or callable(consistent), "consistent", "be a function", consistent)
    count = whole("intervals", intervals, 1)
    limit = whole("max_iterations", max_iterations, 0)
    tolerance = number(positive, "tolerance", tolerance)
    static = count, limit, is_transformed()
    with checked_system(step, state, scale) as first:
        return call_compiled(_shoot, (step, scale, consistent), static, first, as_argument(tolerance))


def _shoot(functions, static, state, tolerance):
    """Return the `Shot` of `shoot`, by equations without parameters."""
    intervals, limit, differentiable = static

    step, scale, consistent = functions
    motions = PeriodicMotions(lambda: step, state, jnp.zeros(0), scale, intervals, consistent)
    # Short steps get stuck where the map's derivative jumps. Of 70 orbits at 880 to 2300 m/s, of period 1 and 2, 64
    # are found with 2 halvings, and 58 with 8.
    options = dict(tolerance=tolerance, iterations=limit, halvings=2, polish=True)
    root = constant(lambda: newton(motions, ravel_pytree(state)[0], **options))
    z = root.z
    matrices = root.linearisation.matrices
    if differentiable:
        z = exact_zero(lambda z: motions.mapped(z) - z, z, root.linearisation.jacobian)
        matrices = motions.evaluate(z).matrices
    return Shot(motions.state(z), root.residual, root.iterations, matrices)


def minimal_period(
    step: Step,
    state: PyTree,
    intervals: int,
    *,
    scale: Scale | None = None,
) -> dict[int, Array]:
    """Return how nearly a motion that recurs after `intervals` also recurs after each divisor of `intervals`. Pure.

    **Arguments:** as for `shoot`.

    **Returns:** residuals, as in `Shot`, by divisor; the first divisor with a small residual is the minimal period.

    **Raises:** `ValueError` that names the wrong argument.
    """
    count = whole("intervals", intervals, 1)
    with checked_system(step, state, scale) as first:
        return call_compiled(_residuals, (step, scale), (count,), first)


def _residuals(functions, static, state):
    step, scale = functions
    (intervals,) = static
    flat, _ = ravel_pytree(state)
    weights = weights_of(state, scale)

    # the state after each interval, and its weighted distance from the start
    def interval(s, k):
        s = step(s, k)
        return s, weighted_size(ravel_pytree(s)[0] - flat, weights)

    run = lambda state: jax.lax.scan(interval, state, jnp.arange(float(intervals)))[1]
    residuals = in_one_kernel(run, state)
    # residuals after 1, 2, ... intervals
    return {n: residuals[n - 1] for n in range(1, intervals + 1) if intervals % n == 0}


Family = Callable[..., Step]
"""Function from parameter values to the map: `family(value, ...)(state, k)` is the state one interval later."""


class PeriodicMotions(AbstractEquations):
    """Motions that recur after some intervals: P(x; values) - x = 0 for the state x and the parameters.

    The unknowns are the components of the state and the values of the parameters, in this order.
    """

    family: Family
    """A pytree, such as an `equinox.Module`; new values in its array leaves need no compilation."""
    like: PyTree
    """A state, for its structure."""
    reach: Real
    """Changes of the parameters that count as a length of one, of shape (parameters,)."""
    scale: Scale | None = None
    """Weights of the state's components, as for `slipperjax.analysis.shoot`."""
    intervals: int = eqx.field(static=True, default=1)
    consistent: Consistent | None = None
    """Makes proposed states consistent, see `Consistent`; None leaves them."""
    lengths: Real = 1.0
    """Divisors of the state's weights in lengths along a curve; infinite for components that do not count."""
    derivatives: int = eqx.field(static=True, default=5)
    """Order of the highest derivatives of the map that can be computed and are needed; at most five are."""
    width: Real | None = None
    """Half the width, in weighted components, of differences of first derivatives, for higher derivatives of a map
    that is smooth, but computed by rough steps; None: derivatives of the steps."""

    @property
    def size(self) -> int:
        """Number of numbers in a state."""
        return sum(jnp.size(leaf) for leaf in jax.tree.leaves(self.like))

    def unknowns(self, state: PyTree, *values: Real) -> Array:
        """Return the unknowns for a state and values of the parameters."""
        flat = ravel_pytree(state)[0]
        require(flat.size == self.size, "state", f"have {self.size} numbers as `like` has", flat.size)
        return jnp.concatenate([flat, jnp.asarray(values, float)])

    def state(self, z: Array) -> PyTree:
        """Return the state of a point."""
        return ravel_pytree(self.like)[1](jnp.asarray(z)[: self.size])

    def values(self, z: Array) -> tuple[Array, ...]:
        """Return the values of the parameters at a point."""
        return tuple(jnp.asarray(z)[self.size : self.size + jnp.size(self.reach)])

    def step(self, z: Array) -> Step:
        """Return the map at a point."""
        return self.family(*self.values(z))

    def flow(self, z: Array) -> Callable[[PyTree], PyTree]:
        """Return the function of a state that is the state after the intervals. Pure."""
        step = self.step(z)
        ks = jnp.arange(float(self.intervals))
        return lambda state: jax.lax.scan(lambda s, k: (step(s, k), None), state, ks)[0]

    def mapped(self, z: Array) -> Array:
        """Return the state after the intervals, as one array. Pure."""
        return ravel_pytree(in_one_kernel(self.flow(z), self.state(z)))[0]

    def evaluate(self, z: Array) -> Linearisation:
        size = self.size
        unravel = ravel_pytree(self.like)[1]

        # The parameters become constant components of the state, so that one Jacobian has all derivatives.
        def step(unknowns, k):
            end = self.family(*unknowns[size:])(unravel(unknowns[:size]), k)
            return jnp.concatenate([ravel_pytree(end)[0], unknowns[size:]])

        end, matrices = linearise(step, z, self.intervals)
        # the derivative of P(x; values) - x
        jacobian = product(matrices)[:size] - jnp.eye(size, z.size)
        return Linearisation(end[:size] - z[:size], jacobian, matrices[:, :size, :size])

    def weights(self, z: Array) -> tuple[Array, Array]:
        of_state = weights_of(self.state(z), self.scale)
        return of_state, jnp.concatenate([of_state / self.lengths, 1 / jnp.atleast_1d(self.reach)])

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        if self.consistent is None:
            return z
        mapped = self.state(before[: self.size] + residual[: self.size])
        consistent = self.consistent(self.step(z), self.state(z), mapped)
        return z.at[: self.size].set(ravel_pytree(consistent)[0])
