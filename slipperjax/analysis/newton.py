"""Newton's method for equations that are evaluated with their derivatives: the one loop of this room.

Motions that recur, points of curves and bifurcations are all found by `newton`, as zeros of `AbstractEquations`.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .floquet import solve

LEAST_FALL = 0.1
"""Share of a step by which the residual must fall for a damped step to be accepted."""


class Linearisation(NamedTuple):
    """Equations at one point, with their derivatives."""

    residual: Float[Array | np.ndarray, " n"]
    """Value of each equation, zero at a solution."""
    jacobian: Float[Array | np.ndarray, "n more"]
    """Its derivative with respect to all unknowns."""
    matrices: Any = None
    """Jacobians of a motion's intervals, of shape (intervals, size, size)."""
    null_vectors: Any = None
    """Left and right ones of a critical motion, see `slipperjax.analysis.critical.CriticalMotions`."""


class AbstractEquations(eqx.Module):
    """Equations for as many unknowns, or for one more where they are a curve's."""

    @abc.abstractmethod
    def evaluate(self, z: Float[Array, " more"]) -> Linearisation:
        """Return residual and derivative at `z`. Pure."""

    @abc.abstractmethod
    def weights(
        self,
        z: Float[Array, " more"],
    ) -> tuple[Float[Array, " n"], Float[Array, " more"]]:
        """Return factors of the residual's components, and of the unknowns in the measure of length; zero for
        those that are left out."""

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        """Return a consistent point for `z`, proposed from `before`, where the residual was `residual`. Pure."""
        return z

    def update(self, z: Any, null_vectors: Any) -> "AbstractEquations":
        """Return the same equations in a form that suits the neighbourhood of a point `z`. Here as they are."""
        return self


class Root(NamedTuple):
    """A zero of equations, as far as Newton's method came."""

    z: Float[Array, " n"]
    linearisation: Linearisation
    """At `z`."""
    residual: Float[Array, ""]
    """Greatest weighted component of the residual; infinite where that is not finite."""
    iterations: Int[Array, ""]
    equations: AbstractEquations
    """As last updated."""


class _Carry(NamedTuple):
    """State of the iteration."""

    z: Array  # to be evaluated next; at the end that of the linearisation
    start: Array  # where the current step begins
    missed: Array  # residual there
    size: Array  # of that residual
    step: Array  # Newton's step from there
    share: Array  # of the step, to which it was halved
    linearisation: Linearisation  # of the last pass
    count: Array  # of iterations, negative during updates
    polishing: Array  # whether the step is the last one, which polishes
    going: Array
    numbers: Any  # array leaves of the equations


def newton(
    equations: AbstractEquations,
    z: Array,
    *,
    tolerance: Any,
    iterations: Any,
    halvings: int = 0,
    updates: int = 0,
    polish: bool = False,
) -> Root:
    """Solve as many equations as unknowns. Pure; not to be differentiated.

    **Arguments:**

    - `z`: first guess.
    - `tolerance`: weighted residual at which the iterations end. `iterations`: they end then in any case.
    - `halvings`: how often a step may be halved until the residual falls by a share `LEAST_FALL` of it; after that
        it is accepted whatever it gives.
    - `updates`: how often the equations are updated at `z` before the first step; if at all, they are updated
        after each step, too.
    - `polish`: whether one more step follows, which is not counted, where the tolerance is met, but not a thousandth
        of it.

    **Returns:** a `Root`; look at its `residual`.
    """
    # arrays that updates change are carried, all others are constants of the loop
    numbers, fixed = eqx.partition(equations, eqx.is_array if updates else False)
    # traced once, for the shapes of its result and for the loop
    evaluate = jax.jit(lambda numbers, z: eqx.combine(numbers, fixed).evaluate(z), inline=True)

    # each pass evaluates one point, whatever it was proposed for, so that the program has the equations once
    def advance(carry: _Carry) -> _Carry:
        current: AbstractEquations = eqx.combine(carry.numbers, fixed)
        now = evaluate(carry.numbers, carry.z)
        size = weighted_size(now.residual, current.weights(carry.z)[0])
        updating = carry.count < 0  # passes that update the equations and keep the point
        fell = size <= (1 - LEAST_FALL * carry.share) * carry.size
        accepted = fell | (carry.share <= 0.5**halvings) | carry.polishing
        ended = ~((size > tolerance) & (carry.count < iterations) & jnp.isfinite(size))
        polishing = accepted & (size <= tolerance) & (size > 1e-3 * tolerance) & ~carry.polishing & polish
        done = carry.polishing | (accepted & ~updating & ended & ~polishing)
        # the next step begins here, or is half as long as the last one from where that began
        pick = lambda here, before: jnp.where(accepted, here, before)
        start = pick(carry.z, carry.start)
        missed = pick(now.residual, carry.missed)
        step = pick(solve(now.jacobian, -now.residual), carry.step)
        share = pick(1.0, carry.share / 2)
        proposal = current.project(start + share * step, start, missed)
        new = eqx.filter(current.update(carry.z, now.null_vectors), eqx.is_array) if updates else carry.numbers
        return _Carry(
            z=jnp.where(done | updating, carry.z, proposal),
            start=start,
            missed=missed,
            size=jnp.where(updating, jnp.inf, pick(size, carry.size)),
            step=step,
            share=share,
            linearisation=now,
            count=carry.count + ~(done | polishing),
            polishing=polishing,
            going=~done,
            numbers=jax.tree.map(lambda a, b: jnp.where(done, a, b), carry.numbers, new),
        )

    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(evaluate, numbers, z))
    # of the types that a pass gives, because the loop would be traced again otherwise
    one = jnp.ones(())
    yes = jnp.ones((), bool)
    begin = _Carry(
        z=z,
        start=z,
        missed=nothing.residual,
        size=jnp.inf * one,
        step=jnp.zeros_like(z),
        share=one,
        linearisation=nothing,
        count=jnp.zeros((), int) - updates,
        polishing=~yes,
        going=yes,
        numbers=numbers,
    )
    end = jax.lax.while_loop(lambda carry: carry.going, advance, begin)
    return Root(end.z, end.linearisation, end.size, end.count, eqx.combine(end.numbers, fixed))


def weighted_size(residual: Array, weights: Array) -> Array:
    """Return the greatest weighted component, of those with weights; infinite where any is not finite."""
    counted = jnp.where(weights > 0, weights * residual, 0.0)
    return jnp.where(jnp.all(jnp.isfinite(residual)), jnp.max(jnp.abs(counted)), jnp.inf)


def without_derivatives(tree: Any) -> Any:
    """Return a pytree whose arrays are constants to derivatives."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree)
