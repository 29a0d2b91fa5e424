"""Simplified Newton iterations for diffrax's diagonally implicit methods, with the slipper's closed-form matrix.

A stage k = h f(y + gamma k) is solved by k <- k - (1 - h gamma J)^-1 (k - h f(y + gamma k)), with J taken once per
step: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.8, doi:10.1007/978-3-642-05221-7. The
matrix reduces to five unknowns, see `slipperjax.model.linearised`, so that nothing here calls LAPACK.
"""

from collections.abc import Callable
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array

from ..model.dynamics import Args, State, vector_field
from ..model.kinematics import Motion, scaled_size
from ..model.linearised import LinearSystem
from ..tools.checks import number, positive
from ..tools.tracing import is_traced
from ..tools.types import Real

NEWTON_TOLERANCE = 1e-7
"""Default of `SimplifiedNewton.tolerance` with constant steps."""


class _Stage(NamedTuple):
    """Arguments that diffrax passes to a root finder, by name."""

    t: Real
    y: Motion | State  # the stage's state without its own share
    args: Args
    frozen: Array | None  # memory that is constant during the step, None where it is integrated
    share: Real  # change of the stage's state per change of the unknown
    factor: Real  # the diagonal coefficient times the step
    sign: float  # sign of the residual: diffrax's implicit Euler has a different one

    @classmethod
    def of(cls, args) -> "_Stage":
        # from _implicit_relation_f and _implicit_relation_k of diffrax's Runge-Kutta methods, and _implicit_relation
        # of its implicit Euler; in diffrax 0.7 the number of arguments distinguishes them
        _, *diagonal, t, y, inner, step = args
        if len(args) == 5:
            share, factor, sign = 1.0, step, -1.0
        else:
            factor = diagonal[0] * step
            share = diagonal[0] if len(args) == 7 else factor
            sign = 1.0
        memory, inner = inner if isinstance(y, Motion) else (None, inner)
        if not isinstance(inner, Args) or not isinstance(y, Motion | State):
            raise ValueError(
                "Argument `root_finder` must be another one than SimplifiedNewton for equations other than "
                "slipperjax.model.vector_field(scene)."
            )
        return cls(t, y, inner, memory, share, factor, sign)

    def at(self, unknown) -> State:
        """Return the stage's state for a value of the unknown."""
        state = jax.tree.map(lambda a, k: a + self.share * k, self.y, unknown)
        return State(state, self.frozen) if isinstance(state, Motion) else state


class _Iteration(eqx.Module):
    """The state of an iteration."""

    system: LinearSystem
    size: Array  # size of the last correction, see `scaled_size`
    before: Array
    count: Array


class SimplifiedNewton(optx.AbstractRootFinder):
    """A root finder for `diffrax.Kvaerno3`, `Kvaerno4`, `Kvaerno5` and `ImplicitEuler`, as in
    `diffrax.Kvaerno5(root_finder=SimplifiedNewton())`, for slippers only.

    An integrated memory has its own diagonal matrix. Derivatives are those of diffrax: the implicit function theorem
    with a dense Jacobian.
    """

    tolerance: float | Array | None = None
    """Greatest estimated error of a stage, in multiples of `slipperjax.model.MOTION_SCALES` [1]. None:
    `NEWTON_TOLERANCE`, and with `AdaptiveSteps` a tenth of its tolerance."""
    # not used; here because every root finder must have them
    rtol: float = eqx.field(static=True, default=0.0)
    atol: float = eqx.field(static=True, default=0.0)
    norm: Callable = eqx.field(static=True, default=optx.max_norm)

    def __check_init__(self):
        if self.tolerance is not None and not is_traced(self.tolerance):
            number(positive, "tolerance", self.tolerance)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        if "init_state" in options:  # diffrax linearises once per step
            return options["init_state"]
        stage = _Stage.of(args)
        linearised = vector_field(stage.args.scene).linearised(stage.t, stage.at(y), stage.args)
        begin = jnp.asarray(jnp.inf)
        return _Iteration(LinearSystem(linearised, stage.factor), begin, begin, jnp.asarray(0))

    def step(self, fn, y, args, options, state, tags):
        stage = _Stage.of(args)
        residual, aux = fn(y, args)
        residual = jax.tree.map(lambda r: stage.sign * r, residual)
        motion, memory = (residual, None) if isinstance(residual, Motion) else (residual.motion, residual.memory)
        if memory is not None:  # at the iterate, because the switch may change within a step
            decay = vector_field(stage.args.scene).memory_decay(stage.t, stage.at(y), stage.args)
            assert decay is not None  # an integrated memory has a decay
            memory = memory / (1 - stage.factor * decay)
        change = State(state.system.solve(motion), memory)
        of_stage = jax.tree.map(lambda c: stage.share * c, change)
        size = scaled_size(of_stage.motion)
        if memory is not None:  # rates [m/s]
            size = jnp.maximum(size, jnp.max(jnp.abs(of_stage.memory)))
        new = jax.tree.map(jnp.subtract, y, change.motion if isinstance(y, Motion) else change)
        return new, _Iteration(state.system, size, state.size, state.count + 1), aux

    def terminate(self, fn, y, args, options, state, tags):
        rate = state.size / state.before
        # the corrections still to come, as a geometric series
        error = jnp.where(rate < 1, state.size * rate / (1 - jnp.minimum(rate, 0.999)), jnp.inf)
        most = NEWTON_TOLERANCE if self.tolerance is None else self.tolerance
        # the rate of convergence is known from the second iteration on
        small = (state.count >= 2) & (error <= most) | (state.size <= most)
        lost = ~jnp.isfinite(state.size) & (state.count > 0)
        result = optx.RESULTS.where(lost, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return small | lost, result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}


def with_root_finder(solver: diffrax.AbstractSolver) -> diffrax.AbstractSolver:
    """Return a diffrax solver whose stages are solved by `SimplifiedNewton`, unless the user gave a root finder.

    Only diffrax's default root finder, which takes its tolerances from an adaptive controller, is replaced.
    """
    if not isinstance(solver, diffrax.AbstractImplicitSolver):
        return solver
    finder = solver.root_finder
    if isinstance(getattr(finder, "rtol", 0.0), float | jax.Array):
        return solver
    at = lambda s: s.solver.root_finder if isinstance(s, diffrax.HalfSolver) else s.root_finder
    return eqx.tree_at(at, solver, SimplifiedNewton())
