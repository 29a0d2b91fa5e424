"""Derivatives of objectives along motions, and on periodic orbits by the theorem of implicit functions.

An orbit x recurs, P(x, p) = x, so that its derivative by a parameter solves (I - P_x) dx/dp = P_p, of which Newton's
method leaves the inverse. Forward mode pushes the parameters through the motion once to find P_p, and again along
(dx/dp, dp).
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from ..analysis.floquet import linearise
from ..flow.period_map import PeriodMap
from ..flow.record import RecordSet, Unlabelled
from ..flow.records import AbstractNumber
from ..flow.stepping import AbstractStepping
from ..model.dynamics import State
from ..model.parameters import at_values, values_of
from ..model.scene import Scene
from ..tools.batching import Batched
from ..tools.compile import jit
from ..tools.types import Real

Objectives = tuple[AbstractNumber, ...]


@dataclass(frozen=True)
class PeriodValues(Unlabelled):
    """The values of some numbers in each forcing period, whose totals are differentiated."""

    numbers: Objectives

    def values(self, scene, periods):
        return 10 * len(self.numbers) * periods

    def sample(self, course):
        return tuple(one.of(course) for one in self.numbers)


class PeriodDerivatives(NamedTuple):
    """States of a batch after a forcing period, the objectives' values in it, and derivatives of both.

    The derivatives are along directions of start and parameters.
    """

    end: Float[Array, "cases size"]
    end_slopes: Float[Array, "cases directions size"]
    kept: PyTree
    """For each objective, arrays (cases, ...)."""
    kept_slopes: PyTree
    """For each objective, arrays (cases, directions, ...)."""


@functools.partial(jit, static_argnames=("names", "objectives", "solver"))
def push_period(
    scenes: Batched[Scene],
    states: State,
    slopes: Float[Array, "cases directions size"],
    epoch: Real,
    stepping: AbstractStepping,
    *,
    names: tuple[str, ...],
    objectives: Objectives,
    solver: diffrax.AbstractSolver,
) -> PeriodDerivatives:
    """Run one forcing period, and differentiate it by the parameters `names`.

    **Arguments:** `slopes`: derivatives of the states at the start; `epoch`: forcing periods from distance zero.
    """
    records = RecordSet((PeriodValues(objectives),))

    def one(scene: Scene, state: State, slopes: Array) -> PeriodDerivatives:
        flat, unravel = ravel_pytree(state)

        def run(x: Array, p: Array) -> tuple[Array, PyTree]:
            step = PeriodMap(at_values(scene, names, p), stepping, solver)
            passage = step.run(unravel(x), epoch, periods=1, records=records)
            # the only record, without its axis of periods
            kept = jax.tree.map(lambda a: a[0], passage.samples[0])
            return ravel_pytree(passage.state)[0], kept

        # Along each parameter, with its change of the start. Values are the same for all parameters: no axis.
        p = values_of(scene, names)
        push = lambda dx, dp: jax.jvp(run, (flat, p), (dx, dp))
        every = jax.vmap(push, out_axes=((None, None), 0))
        (end, kept), (end_slopes, kept_slopes) = every(slopes, jnp.eye(p.size))
        return PeriodDerivatives(end, end_slopes, kept, kept_slopes)

    return scenes.map(one, states, slopes)


@functools.partial(jit, static_argnames=("objectives",))
def totals(objectives: Objectives, kept: PyTree) -> Float[Array, "cases objectives"]:
    """Return the objectives of a batch from their values in each period, arrays (cases, periods, ...)."""
    return jax.vmap(lambda rows: _totals(objectives, rows))(kept)


@functools.partial(jit, static_argnames=("objectives",))
def total_slopes(
    objectives: Objectives,
    kept: PyTree,
    slopes: PyTree,
) -> tuple[Array, Array]:
    """Return objectives (cases, objectives), and their derivatives (cases, objectives, directions).

    **Arguments:** `kept`: values in each period, arrays (cases, periods, ...); `slopes`: their derivatives, arrays
    (cases, directions, periods, ...).
    """

    def one(kept: PyTree, slopes: PyTree) -> tuple[Array, Array]:
        of_rows = functools.partial(_totals, objectives)
        push = lambda along: jax.jvp(of_rows, (kept,), (along,))
        return jax.vmap(push, out_axes=(None, 1))(slopes)

    return jax.vmap(one)(kept, slopes)


def _totals(objectives: Objectives, kept: PyTree) -> Float[Array, " objectives"]:
    return jnp.stack([one.total(rows) for one, rows in zip(objectives, kept, strict=True)])


@functools.partial(jit, static_argnames=("names", "solver"))
def matrix_slopes(
    scenes: Batched[Scene],
    states: State,
    slopes: Float[Array, "cases directions size"],
    epoch: Real,
    stepping: AbstractStepping,
    *,
    names: tuple[str, ...],
    solver: diffrax.AbstractSolver,
) -> Float[Array, "cases directions size size"]:
    """Differentiate the Jacobian of one forcing period by parameters.

    **Arguments:** `slopes`: derivatives of the states at the start.
    """

    def one(scene: Scene, state: State, slopes: Array) -> Array:
        flat, unravel = ravel_pytree(state)

        def matrix(x: Array, p: Array) -> Array:
            step = PeriodMap(at_values(scene, names, p), stepping, solver)
            return linearise(step, unravel(x), 1, index=epoch)[1][0]

        # along each parameter, with what it changes at the start
        p = values_of(scene, names)
        push = lambda dx, dp: jax.jvp(matrix, (flat, p), (dx, dp))[1]
        return jax.vmap(push)(slopes, jnp.eye(p.size))

    return scenes.map(one, states, slopes)
