"""The base class of solvers with the event latch, and the latch as a wrapper of diffrax's own solvers.

The contact memory is constant during the stages of a step. After the stages, the vector field closes the step: it
latches touchdowns, and evaluates the derivative at the end.
"""

from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from ..model.dynamics import State, VectorField, fill_frozen
from ..model.kinematics import Motion
from ..tools.checks import require
from ..tools.types import Real
from .simplified_newton import SimplifiedNewton, with_root_finder


class StateInterpolation(diffrax.ThirdOrderHermitePolynomialInterpolation):
    """Cubic in the motion; a latched memory is constant during a step, with the contact's value in this step."""

    frozen: Array | None

    def __init__(self, *, frozen, **step):
        super().__init__(**step)
        self.frozen = frozen

    def evaluate(self, t0, t1=None, left=True):
        value = super().evaluate(t0, t1, left)
        # with t1, diffrax asks for the change between two instants
        if t1 is not None or self.frozen is None:
            return value
        return State(value.motion, self.frozen)


def field_of(terms: diffrax.AbstractTerm) -> VectorField:
    """Return the vector field inside diffrax's terms; raises `ValueError` if it is not a scene's."""
    while hasattr(terms, "term"):  # diffrax wraps terms to run backwards in time
        terms = terms.term
    field: Any = getattr(terms, "vector_field", None)
    require(
        isinstance(field, VectorField),
        "terms",
        "be a diffrax.ODETerm of slipperjax.model.vector_field(scene) for this solver",
        terms,
    )
    return field


def dense_info(dt: Real, y0: State, y1: State, rates0: State, rates1: State) -> dict[str, State | Array | None]:
    """Pack a step for `StateInterpolation`; `rates0`, `rates1`: derivatives at its ends [per forcing period]."""
    frozen = None
    if rates1.memory is None and y0.memory is not None:
        # for a contact that opens in the step, the memory at the end is already that of an open point; other contacts
        # have the memory with which the step was made
        frozen = jnp.where(y0.memory < 0, y0.memory, y1.memory)
    return dict(
        y0=y0,
        y1=y1,
        k0=jax.tree.map(lambda rate: dt * rate, fill_frozen(rates0, y0)),
        k1=jax.tree.map(lambda rate: dt * rate, fill_frozen(rates1, y1)),
        frozen=frozen,
    )


class AbstractLatchingSolver(diffrax.AbstractSolver):
    """Solvers that end each step with the vector field's `close_step`, and therefore work for every scene.

    The solver state at the end of one solve may start the next solve.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = StateInterpolation
    explicit: ClassVar[bool] = False
    """True for explicit methods."""
    restarts_each_period: ClassVar[bool] = False
    """Whether forcing periods of equal steps begin with `init`: a period is then a function of the state alone."""

    def rates(self, solver_state: PyTree) -> Motion | None:
        """Return the motion's derivative at a step's end [per forcing period] if known to the solver; else None."""
        return None

    def init(self, terms, t0, t1, y0, args):
        return field_of(terms).open_step(t0, y0, args)

    def func(self, terms, t0, y0, args):
        return fill_frozen(field_of(terms).evaluate(t0, y0, args), y0)


class _FrozenField(eqx.Module):
    """The motion's derivative with constant memory, passed in the arguments, so that diffrax has only ten states."""

    field: VectorField

    def __call__(self, t, motion, args):
        memory, args = args
        return self.field.evaluate(t, State(motion, memory), args).motion


class Latching(AbstractLatchingSolver):
    """The event latch around one of diffrax's one-step solvers, explicit or implicit.

    The inner solver integrates only the motion, with constant memory. Some methods use the last stage of a step as
    the first stage of the next one; they evaluate this stage again, because the latch may have changed it.
    """

    solver: diffrax.AbstractSolver

    def __init__(self, solver: diffrax.AbstractSolver):
        """**Arguments:** `solver`: a Runge-Kutta method of diffrax, Euler or ImplicitEuler, or HalfSolver of one of
        these.

        In an implicit solver, `SimplifiedNewton` replaces a root finder that takes its tolerances from a step size
        controller.

        **Raises:** `ValueError` for other solvers, because the latch would invalidate their data of earlier steps.
        """
        inner = solver.solver if isinstance(solver, diffrax.HalfSolver) else solver
        one_step = (diffrax.AbstractERK, diffrax.AbstractDIRK, diffrax.Euler, diffrax.ImplicitEuler)
        if not isinstance(inner, one_step):
            raise ValueError(
                f"Argument `solver` must be a one-step method for ordinary differential equations, which can be "
                f"latched at touchdowns, but is {type(inner).__name__}."
            )
        self.solver = with_root_finder(solver)

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(diffrax.ODETerm(_FrozenField(field_of(terms))))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        field = field_of(terms)
        inner = diffrax.ODETerm(_FrozenField(field))
        # the constant memory is passed together with the arguments
        inner_args = (y0.memory, args)
        # the latch may have changed the derivative with which the last step ended
        fresh = self.solver.init(inner, t0, t1, y0.motion, inner_args)
        motion, error, _, _, result = self.solver.step(
            inner,
            t0,
            t1,
            y0.motion,
            inner_args,
            fresh,
            made_jump,
        )
        y1, rates1, after = field.close_step(solver_state, t0, t1, State(motion, y0.memory), args)
        if error is not None:
            error = State(jax.tree.map(jnp.abs, error), jax.tree.map(jnp.zeros_like, y0.memory))
        # not carried to the next step, so that XLA omits both derivatives where the interpolation is not used
        dense = dense_info(t1 - t0, y0, y1, field.evaluate(t0, y0, args), rates1)
        return y1, error, dense, after, result


def _innermost(solver: diffrax.AbstractSolver) -> diffrax.AbstractSolver:
    """Return the solver inside all wrappers."""
    inner = getattr(solver, "solver", None)
    return _innermost(inner) if isinstance(inner, diffrax.AbstractSolver) else solver


def solver_name(solver: diffrax.AbstractSolver) -> str:
    """Return a solver's name in results: its class, and in brackets the class of the solver inside it."""
    own = type(solver).__name__
    inner = getattr(solver, "solver", None)
    return f"{own}({solver_name(inner)})" if isinstance(inner, diffrax.AbstractSolver) else own


def differentiable(
    solver: diffrax.AbstractSolver,
    adjoint: diffrax.AbstractAdjoint,
) -> diffrax.AbstractSolver:
    """Return a solver whose loop over its stages can be differentiated as `adjoint` requires.

    diffrax does this for its own Runge-Kutta methods; this function also does it for methods inside a wrapper.
    """
    inner = _innermost(solver)
    # loops that JAX can differentiate: in forward mode, and in both modes
    kind = {diffrax.ForwardMode: "lax", diffrax.DirectAdjoint: "bounded"}.get(type(adjoint))
    if kind and isinstance(inner, diffrax.AbstractRungeKutta) and inner.scan_kind is None:
        at = lambda s: _innermost(s).scan_kind
        return eqx.tree_at(at, solver, kind, is_leaf=lambda x: x is None)
    return solver


def with_tolerance(solver: diffrax.AbstractSolver, tolerance: Real) -> diffrax.AbstractSolver:
    """Return a solver in which `SimplifiedNewton`, inside all wrappers, has this tolerance where it had None."""
    finder = getattr(_innermost(solver), "root_finder", None)
    if isinstance(finder, SimplifiedNewton) and finder.tolerance is None:
        at = lambda s: _innermost(s).root_finder.tolerance
        return eqx.tree_at(at, solver, jax.lax.stop_gradient(tolerance), is_leaf=lambda x: x is None)
    return solver


def is_explicit(solver: diffrax.AbstractSolver) -> bool:
    """Return whether a solver is explicit: stability bounds its steps, and steps cannot fail."""
    inner = _innermost(solver)
    return isinstance(inner, diffrax.AbstractERK | diffrax.Euler) or getattr(inner, "explicit", False)


def calls_lapack(solver: diffrax.AbstractSolver, tangents: bool = False) -> bool:
    """Return whether a solver's linear systems go to LAPACK.

    Root finders of diffrax use LAPACK, and so do derivatives (`tangents`) of all implicit methods of diffrax.

    Programs with LAPACK must run one at a time. jaxlib divides a batch of systems among the threads of a pool, and
    one of these threads waits for the others. As many simultaneous batches as there are threads would wait for ever.
    """
    inner = _innermost(solver)
    if not isinstance(inner, diffrax.AbstractImplicitSolver):
        return False
    return tangents or not isinstance(inner.root_finder, SimplifiedNewton)
