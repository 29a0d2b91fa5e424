"""Newton's method for equations that give their derivatives together with their values.

Periodic motions, points of curves and bifurcations are zeros of `AbstractEquations`, found by `newton`.
"""

import abc
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..tools.types import Real, Whole
from .floquet import solve

LEAST_FALL = 0.1
"""Least relative fall of the residual, over the taken share of Newton's step, for a step to be accepted."""

NullVectors = tuple[Array | np.ndarray, Array | np.ndarray] | None
"""Left and right null vectors at a critical motion, of shape (size,); None for other equations."""


class Linearisation(NamedTuple):
    """Equations at one point, with their derivatives."""

    residual: Float[Array | np.ndarray, " n"]
    """Value of each equation, zero at a solution."""
    jacobian: Float[Array | np.ndarray, "n more"]
    """Derivative of the residual with respect to all unknowns."""
    matrices: Float[Array | np.ndarray, "intervals size size"] | None = None
    """Jacobians of the successive intervals of a motion; None for equations of another kind."""
    null_vectors: NullVectors = None


class AbstractEquations(eqx.Module):
    """Equations for as many unknowns; or for one unknown more, so that the solutions form a curve."""

    @abc.abstractmethod
    def evaluate(self, z: Float[Array, " more"]) -> Linearisation:
        """Return residual and Jacobian at `z`. Pure."""

    @abc.abstractmethod
    def weights(
        self,
        z: Float[Array, " more"],
    ) -> tuple[Float[Array, " n"], Float[Array, " more"]]:
        """Return weights of the residual's components, and of the unknowns in lengths along a curve.

        Components and unknowns of weight zero do not count.
        """

    def project(self, z: Array, before: Array, residual: Array) -> Array:
        """Return a consistent point for the proposal `z`, by default `z` itself. Pure.

        **Arguments:** `before`: the point from which the step was made; `residual`: the residual there.
        """
        return z

    def update(self, z: Array | np.ndarray, null_vectors: NullVectors) -> "AbstractEquations":
        """Return equivalent equations that are better conditioned near a point `z`, by default the same equations."""
        return self


class Root(NamedTuple):
    """The end of Newton's iteration; a zero of the equations where its `residual` is small."""

    z: Float[Array, " n"]
    linearisation: Linearisation
    """At `z`."""
    residual: Float[Array, ""]
    """Greatest weighted component of the residual; infinite where it is not finite."""
    iterations: Int[Array, ""]
    equations: AbstractEquations
    """The equations after their last update."""


class _Carry(NamedTuple):
    """State of the loop in `newton`."""

    z: Array  # point to evaluate next; after the loop, the point of the linearisation
    start: Array  # point at which the current step begins
    missed: Array  # residual at `start`
    size: Array  # weighted size of `missed`
    step: Array  # Newton's step from `start`
    share: Array  # part of the step that is tried, after halvings
    linearisation: Linearisation  # at the point evaluated last
    count: Array  # number of iterations; negative during the first updates
    polishing: Array  # True in the last step, after the tolerance is met
    going: Array
    numbers: PyTree  # array leaves of the equations


def newton(
    equations: AbstractEquations,
    z: Array,
    *,
    tolerance: Real,
    iterations: Whole,
    halvings: int = 0,
    updates: int = 0,
    polish: bool = False,
) -> Root:
    """Solve as many equations as unknowns. Pure; not to be differentiated.

    **Arguments:**

    - `z`: first guess.
    - `tolerance`: weighted residual at which the iteration ends. `iterations`: most iterations.
    - `halvings`: how often a step may be halved until the residual falls enough, see `LEAST_FALL`; the last half is
        accepted in any case.
    - `updates`: how often the equations are updated at `z` before the first step. If not 0, they are also updated
        after each step.
    - `polish`: whether one more step, which does not count, follows where the residual is below `tolerance`, but
        above a thousandth of it.

    **Returns:** a `Root`; check its `residual`.
    """
    # Updates change arrays of the equations, and the loop carries these; otherwise they are constants of the loop.
    numbers, fixed = eqx.partition(equations, eqx.is_array if updates else False)
    # jit, so that the equations are traced once, for the shapes of the result and for the loop
    evaluate = jax.jit(lambda numbers, z: eqx.combine(numbers, fixed).evaluate(z), inline=True)

    # Each pass evaluates one point: for an update, a full step or a half step. So the program has the equations once.
    def advance(carry: _Carry) -> _Carry:
        current: AbstractEquations = eqx.combine(carry.numbers, fixed)
        now = evaluate(carry.numbers, carry.z)
        size = weighted_size(now.residual, current.weights(carry.z)[0])
        updating = carry.count < 0  # the first passes update the equations at the same point
        fell = size <= (1 - LEAST_FALL * carry.share) * carry.size
        accepted = fell | (carry.share <= 0.5**halvings) | carry.polishing
        ended = ~((size > tolerance) & (carry.count < iterations) & jnp.isfinite(size))
        polishing = accepted & (size <= tolerance) & (size > 1e-3 * tolerance) & ~carry.polishing & polish
        done = carry.polishing | (accepted & ~updating & ended & ~polishing)
        # an accepted step ends here, where the next step begins; other steps are halved
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
    # arrays with the types that a pass returns; otherwise JAX traces the loop a second time
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
    """Return the greatest weighted component; infinite where any component is not finite."""
    counted = jnp.where(weights > 0, weights * residual, 0.0)
    return jnp.where(jnp.all(jnp.isfinite(residual)), jnp.max(jnp.abs(counted)), jnp.inf)


def without_derivatives(tree: PyTree) -> PyTree:
    """Return a pytree whose arrays pass no derivatives."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree)


def constant(fun: Callable[[], PyTree]) -> PyTree:
    """Return `fun()`, whose arrays have no derivatives by what `fun` closes over. Pure."""
    return without_derivatives(eqx.filter_closure_convert(fun))()


def exact_zero(residual: Callable[[Array], Array], z: Array, jacobian: Array) -> Array:
    """Return z, a zero of `residual`, with its derivatives by all numbers that `residual` closes over. Pure.

    The derivatives are those of the implicit function, of any order, in both modes.

    **Arguments:** `jacobian`: of the residual at z, without derivatives; first derivatives need no other.
    """
    return _zero(eqx.filter_closure_convert(residual, z), *without_derivatives((z, jacobian)))


@eqx.filter_custom_jvp
def _zero(residual, z, jacobian):
    return z


@_zero.def_jvp
def _(primals, tangents):
    residual, z, jacobian = primals
    # the zero again, and a Jacobian with derivatives, so that the slope has derivatives, too
    z = _zero(residual, z, jacobian)
    jacobian = _known(residual, z, jacobian)
    _, miss = eqx.filter_jvp(lambda residual: residual(z), (residual,), (tangents[0],))
    # by the inverse, because elimination of both sides together is not linear in the right one, as reverse mode needs
    return z, -solve(jacobian, jnp.eye(z.size)) @ miss


@eqx.filter_custom_jvp
def _known(residual, z, jacobian):
    return jacobian


@_known.def_jvp
def _(primals, tangents):
    residual, z, _ = primals
    _, change = eqx.filter_jvp(lambda residual, z: jax.jacfwd(residual)(z), (residual, z), tangents[:2])
    return _known(*primals), change
