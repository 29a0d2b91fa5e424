"""Explicit Runge-Kutta methods with the event latch built in, as diffrax solvers.

The contact memory is constant during the stages of a step. After the stages, the vector field closes the step: it
latches touchdowns, and evaluates the derivative at the end, from which the next step starts. Therefore a step of RK4
costs four evaluations and a latch, and the error estimate of Tsit5 needs no further evaluation.
"""

from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
from diffrax import RESULTS

from ..model.dynamics import State
from ..tools.forms import store
from .latching import AbstractLatchingSolver, dense_info, field_of


def _step(y: State, dt, stages: list[State], weights: tuple[float, ...]) -> State:
    """Return y + dt sum(weights k); parts with a derivative of None are constant and stay unchanged."""
    used = [(w, k) for w, k in zip(weights, stages, strict=False) if w != 0]

    def leaf(y, *ks):
        return y if ks[0] is None else y + dt * sum(w * k for (w, _), k in zip(used, ks, strict=True))

    return _stored(jax.tree.map(leaf, y, *(k for _, k in used)))


def _stored(state: State) -> State:
    """Return the same state, but compute its motion in one kernel, not again in each kernel that uses the motion."""
    return State(store(state.motion), state.memory)


class AbstractLatchingRungeKutta(AbstractLatchingSolver):
    """A step of an explicit tableau with frozen memory, then the latch. Subclasses define the tableau."""

    a_lower: ClassVar[tuple[tuple[float, ...], ...]]
    b: ClassVar[tuple[float, ...]]
    b_error: ClassVar[tuple[float, ...] | None] = None
    """Weights of the stages, and of the derivative at the step's end, in the error estimate."""
    explicit: ClassVar = True

    def rates(self, solver_state):
        return solver_state[0].motion

    def init(self, terms, t0, t1, y0, args):
        field = field_of(terms)
        t0 = jnp.asarray(t0, float)
        # types and frame as in `step`, so that one traced derivative serves both
        return field.evaluate(t0, y0, args, args.frame(t0)), field.open_step(t0, y0, args)

    @jax.jit  # diffrax traces it more than once
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        field = field_of(terms)
        dt = t1 - t0
        rates, before = solver_state
        stages = [rates]
        frames = {1.0: args.frame(t1)}  # one frame per instant, because XLA would compute it again in every stage
        # each row of the tableau makes a further stage from the stages before
        for row in self.a_lower:
            node = 1.0 if abs(sum(row) - 1) < 1e-12 else sum(row)
            at = t1 if node == 1 else t0 + node * dt  # exactly t1, because rounding would add a further instant
            if node not in frames:
                frames[node] = args.frame(at)
            stages.append(field.evaluate(at, _step(y0, dt, stages, row), args, frames[node]))
        y1 = _step(y0, dt, stages, self.b)
        y1, rates1, after = field.close_step(before, t0, t1, y1, args, frames[1.0])
        rates1 = _stored(rates1)
        error = None
        if self.b_error is not None:
            scaled = _step(jax.tree.map(jnp.zeros_like, y0), dt, [*stages, rates1], self.b_error)
            error = jax.tree.map(jnp.abs, scaled)
        dense = dense_info(dt, y0, y1, rates, rates1)
        return y1, error, dense, (rates1, after), RESULTS.successful


class RK4(AbstractLatchingRungeKutta):
    """The classical fourth-order method with the event latch. No error estimate: constant steps only."""

    a_lower: ClassVar = ((1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0))
    b: ClassVar = (1 / 6, 1 / 3, 1 / 3, 1 / 6)

    def order(self, terms):
        return 4


class Tsit5(AbstractLatchingRungeKutta, diffrax.AbstractAdaptiveSolver):
    """Tsitouras' 5(4) method, doi:10.1016/j.camwa.2011.06.002, with the event latch and an error estimate."""

    a_lower: ClassVar = tuple(tuple(row.tolist()) for row in diffrax.Tsit5.tableau.a_lower[:-1])
    b: ClassVar = tuple(diffrax.Tsit5.tableau.b_sol[:-1].tolist())
    b_error: ClassVar = tuple(diffrax.Tsit5.tableau.b_error.tolist())

    def order(self, terms):
        return 5

    def error_order(self, terms):
        return 4.0
