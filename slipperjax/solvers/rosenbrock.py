"""Rosenbrock methods with the event latch: implicit, at the cost of one Jacobian and a few solves per step.

A stage solves one linear system, in the form of Hairer and Wanner, Solving Ordinary Differential Equations II,
section IV.7, doi:10.1007/978-3-642-05221-7, with u_i the stages and J, f_t the derivatives at the step's start:

    (1 - h gamma J) u_i = h gamma f(t_0 + alpha_i h, y_0 + sum a_ij u_j) + gamma sum c_ij u_j + gamma gamma_i h^2 f_t
    y_1 = y_0 + sum m_i u_i,    error = sum e_i u_i

There is no iteration, so that convergence cannot fail. The matrix is reduced to five unknowns and factored once, see
`slipperjax.model.linearised`; an integrated memory has a separate, diagonal matrix.
"""

from collections.abc import Sequence
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
from diffrax import RESULTS
from jaxtyping import Array

from ..model.dynamics import State
from ..model.linearised import LinearSystem
from .latching import AbstractLatchingSolver, dense_info, field_of

Rows = tuple[tuple[float, ...], ...]


class AbstractRosenbrock(AbstractLatchingSolver, diffrax.AbstractAdaptiveSolver):
    """A step of a Rosenbrock method with constant memory, then the latch. Subclasses define the tableau."""

    gamma: ClassVar[float]
    a: ClassVar[Rows]
    """Rows of the stages after the first."""
    c: ClassVar[Rows]
    nodes: ClassVar[tuple[float, ...]]
    """alpha_i"""
    slopes: ClassVar[tuple[float, ...] | None]
    """gamma_i; None where the method keeps its order without f_t."""
    m: ClassVar[tuple[float, ...]]
    e: ClassVar[tuple[float, ...]]

    @jax.jit  # diffrax traces it more than once
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        field = field_of(terms)
        h = t1 - t0
        system = LinearSystem(field.linearised(t0, y0, args), h * self.gamma)
        decay = field.memory_decay(t0, y0, args)
        drift = None
        if self.slopes is not None:
            at = lambda t: field.evaluate(t, y0, args).motion
            _, drift = jax.jvp(at, (jnp.asarray(t0, float),), (jnp.ones(()),))

        def stage(stages, row):
            """Return the stages with a further one, as a loop's body: unrolled stages take minutes to compile."""
            point = combine(y0, stages, row["a"])
            # exactly t1 at the end, so that the rail there equals the rail at the next step's start
            f = field.evaluate(jnp.where(row["node"] == 1, t1, t0 + row["node"] * h), point, args)
            right = jax.tree.map(lambda f: h * self.gamma * f, f)
            right = combine(right, stages, self.gamma * row["c"])
            motion = right.motion
            if drift is not None:
                weight = self.gamma * row["slope"] * h * h
                motion = jax.tree.map(lambda v, d: v + weight * d, motion, drift)
            memory = None if right.memory is None or decay is None else right.memory / (1 - h * self.gamma * decay)
            new = State(system.solve(motion), memory)
            return jax.tree.map(lambda u, v: u.at[row["index"]].set(v), stages, new), None

        integrated = State(y0.motion, None if decay is None else y0.memory)
        stages = jax.tree.map(lambda y: jnp.zeros((len(self.nodes), *jnp.shape(y))), integrated)
        stages, _ = jax.lax.scan(stage, stages, self._rows())
        y1 = combine(y0, stages, self.m)
        error = combine(jax.tree.map(jnp.zeros_like, y0), stages, self.e)
        y1, rates1, after = field.close_step(solver_state, t0, t1, y1, args)
        # not carried to the next step, so that XLA omits both derivatives where the interpolation is not used
        dense = dense_info(h, y0, y1, field.evaluate(t0, y0, args), rates1)
        return y1, jax.tree.map(jnp.abs, error), dense, after, RESULTS.successful

    def _rows(self) -> dict[str, Array]:
        """Return the tableau by stages, for a loop over them."""
        count = len(self.nodes)
        # zeros above the diagonal, so that the rows of all stages have one length
        square = lambda rows: jnp.array([[*row, *[0.0] * (count - len(row))] for row in ((), *rows)])
        return dict(
            a=square(self.a),
            c=square(self.c),
            node=jnp.array(self.nodes),
            slope=jnp.array(self.slopes or [0.0] * count),
            index=jnp.arange(count),
        )


def combine(y: State, stages: State, weights: Sequence[float] | Array) -> State:
    """Return y + sum(weights u) over the stages u; parts that are None in the stages stay unchanged."""
    # weights that are known to be zero cost nothing
    used = [k for k in range(len(weights)) if not isinstance(weights[k], float) or weights[k]]
    leaf = lambda y, u: y if u is None else y + sum(weights[k] * u[k] for k in used)
    return jax.tree.map(leaf, y, stages)


class Rodas4(AbstractRosenbrock):
    """RODAS of Hairer and Wanner, see the module: order 4(3), L-stable and stiffly accurate, six stages."""

    gamma: ClassVar = 0.25
    a: ClassVar = (
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
    )
    c: ClassVar = (
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    )
    nodes: ClassVar = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
    slopes: ClassVar = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
    m: ClassVar = (*a[4], 1.0)
    e: ClassVar = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def order(self, terms):
        return 4


class ROS34PW2(AbstractRosenbrock):
    """Rang and Angermann 2005, doi:10.1007/s10543-005-0035-y: order 3(2), L-stable, four stages.

    A W-method: its order holds with any matrix in place of the Jacobian, and without f_t. It is therefore used for
    `SmoothSwitch`, where motion and memory are solved separately; there it costs 0.3 to 0.6 of `Rodas4` at equal
    error (tests/benchmarks/test_smooth_switch.py).
    """

    gamma: ClassVar = 0.43586652150845900
    # from the published form, whose stages are h f + h gamma J k, by the inverse of its matrix of gammas
    a: ClassVar = (
        (2.0000000000000004,),
        (1.4192173174557652, -0.2592322116729698),
        (4.184760482319161, -0.285192017355496, 2.2942803602790423),
    )
    c: ClassVar = (
        (-4.588560720558084,),
        (-4.184760482319161, 0.285192017355496),
        (-6.36817920012836, -6.795620944466837, 2.870098604331055),
    )
    nodes: ClassVar = (0.0, 0.871733043016918, 0.7315799577888524, 1.0)
    slopes: ClassVar = None
    m: ClassVar = (4.184760482319163, -0.28519201735549543, 2.2942803602790423, 1.0)
    e: ClassVar = (0.2777499476479686, -1.4032398951759992, 1.772630127667551, 0.5)

    def order(self, terms):
        return 3
