"""Periodic motions of a map with parameters, as equations for curves."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from .curves import AbstractEquations, Evaluation
from .lyapunov import Scale, Step, weights_of
from .shooting import product

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
        if flat.size != self.size:
            raise ValueError(f"Argument `state` must have {self.size} numbers as `like` has, but has {flat.size}.")
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
