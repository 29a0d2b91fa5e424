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


class Evaluation(NamedTuple):
    """Equations evaluated at one point."""

    residual: Float[Array | np.ndarray, " n"]
    """Value of each equation, zero at a solution."""
    jacobian: Float[Array | np.ndarray, "n more"]
    """Its derivative with respect to all unknowns."""
    extra: Any = None
    """By-products, such as the Jacobians of the intervals."""


class AbstractEquations(eqx.Module):
    """Equations for as many unknowns, or for one more where they are a curve's."""

    @abc.abstractmethod
    def evaluate(self, z: Float[Array, " more"]) -> Evaluation:
        """Computes residual and derivative at `z`. Pure."""

    @abc.abstractmethod
    def weights(self, z: Float[Array, " more"]) -> tuple[Float[Array, " n"], Float[Array, " more"]]:
        """Gives factors of the residual's components, and of the unknowns in the measure of length; zero for those
        that are left out."""

    def settled(self, z: Array, before: Array, residual: Array) -> Array:
        """Makes `z` consistent, which was proposed from `before`, where the residual was `residual`. Pure."""
        del before, residual
        return z

    def eased(self) -> "AbstractEquations | None":
        """Gives equations that accept more, for a point where these have no solution. Here there are none."""
        return None

    def renewed(self, extra: Any) -> "AbstractEquations":
        """Gives the same equations in a form that suits the neighbourhood of a point, from its `Evaluation.extra`.
        Here as they are."""
        del extra
        return self


class Root(NamedTuple):
    """A zero of equations, as far as Newton's method came."""

    z: Float[Array, " n"]
    evaluation: Evaluation
    """At `z`."""
    residual: Float[Array, ""]
    """Greatest weighted component of the residual; infinite where that is not finite."""
    iterations: Int[Array, ""]
    equations: AbstractEquations
    """As last renewed."""


class _Carry(NamedTuple):
    """State of the iteration."""

    z: Array  # to be evaluated next; at the end that of the evaluation
    start: Array  # where the current step begins, with the residual there, its size, and Newton's step
    missed: Array
    size: Array
    step: Array
    share: Array  # of the step, to which it was halved
    evaluation: Evaluation
    count: Array
    going: Array
    numbers: Any  # array leaves of the equations


def newton(
    equations: AbstractEquations, z: Array, *, tolerance: Any, iterations: Any, halvings: int = 0, renewals: int = 0
) -> Root:
    """Solves as many equations as unknowns. Pure; not to be differentiated.

    **Arguments:**

    - `z`: first guess.
    - `tolerance`: weighted residual at which the iterations end. `iterations`: they end then in any case.
    - `halvings`: how often a step may be halved until the residual falls by a share `LEAST_FALL` of it; after that
        it is accepted whatever it gives.
    - `renewals`: how often the equations are renewed at `z` before the first step; if at all, they are renewed
        after each step, too.

    **Returns:** a `Root`; look at its `residual`.
    """
    # arrays that renewals change are carried, all others are constants of the loop
    numbers, fixed = eqx.partition(equations, eqx.is_array if renewals else False)

    # each pass evaluates one point, whatever it was proposed for, so that the program has the equations once
    def advance(carry: _Carry) -> _Carry:
        of_pass: AbstractEquations = eqx.combine(carry.numbers, fixed)
        now = of_pass.evaluate(carry.z)
        size = weighted_size(now.residual, of_pass.weights(carry.z)[0])
        renewing = carry.count < 0  # passes that renew the equations and keep the point
        accepted = (size <= (1 - LEAST_FALL * carry.share) * carry.size) | (carry.share <= 0.5**halvings)
        done = accepted & ~renewing & ~((size > tolerance) & (carry.count < iterations) & jnp.isfinite(size))
        # from here, or half as far from where the step began
        pick = lambda here, before: jnp.where(accepted, here, before)
        start, missed = pick(carry.z, carry.start), pick(now.residual, carry.missed)
        step, share = pick(solve(now.jacobian, -now.residual), carry.step), pick(1.0, carry.share / 2)
        proposal = of_pass.settled(start + share * step, start, missed)
        new = eqx.filter(of_pass.renewed(now.extra), eqx.is_array) if renewals else carry.numbers
        renewed = jax.tree.map(lambda a, b: jnp.where(done, a, b), carry.numbers, new)
        z, size = jnp.where(done | renewing, carry.z, proposal), jnp.where(renewing, jnp.inf, pick(size, carry.size))
        return _Carry(z, start, missed, size, step, share, now, carry.count + ~done, ~done, renewed)

    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(equations.evaluate, z))
    size, share, count, going = jnp.asarray(jnp.inf), jnp.ones(()), jnp.asarray(-renewals), jnp.asarray(True)
    begin = _Carry(z, z, nothing.residual, size, jnp.zeros_like(z), share, nothing, count, going, numbers)
    end = jax.lax.while_loop(lambda carry: carry.going, advance, begin)
    return Root(end.z, end.evaluation, end.size, end.count, eqx.combine(end.numbers, fixed))


def weighted_size(residual: Array, weights: Array) -> Array:
    """Gives the greatest weighted component, of those with weights; infinite where any is not finite."""
    counted = jnp.where(weights > 0, weights * residual, 0.0)
    return jnp.where(jnp.all(jnp.isfinite(residual)), jnp.max(jnp.abs(counted)), jnp.inf)


def without_derivatives(tree: Any) -> Any:
    """Gives a pytree whose arrays are constants to derivatives."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree)
