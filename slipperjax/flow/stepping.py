"""Steppings: one forcing period integrated by constant steps, or by a step size controller."""

import abc
import functools
from collections.abc import Callable
from typing import ClassVar, NamedTuple, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..model.dynamics import Args, State
from ..model.kinematics import MOTION_SCALES, Motion, scaled_size
from ..model.step_size import given_steps
from ..solvers.adaptive import AdaptiveSteps
from ..solvers.latching import AbstractLatchingSolver, differentiable, field_of, with_tolerance
from ..tools.forms import in_one_kernel
from ..tools.types import Whole

ROOM = 50
"""Most forcing periods in one call of a program. The program is compiled for this number, and serves any smaller one.
Progress and Ctrl-C are checked between calls."""


def calls_of(periods: int) -> list[int]:
    """Return the number of forcing periods in each call of a program, for `periods` in all."""
    return [min(ROOM, periods - passed) for passed in range(0, periods, ROOM)]


class Period(NamedTuple):
    """One integrated forcing period."""

    end: State
    inside: State | None
    """The states at both ends of all steps, leading axis `most` + 1; None where they were not requested."""
    rates: Motion | None
    """The motion's derivatives at the same ends [per forcing period], where the solver provides them."""
    steps_taken: Whole  # steps tried
    failed: Array  # whether the solver or the controller gave up
    solver_state: PyTree  # carried over to the next period


class AbstractStepping(eqx.Module):
    """A way to integrate a forcing period, in which time runs from 0 to 1."""

    @property
    @abc.abstractmethod
    def number(self) -> Whole:
        """Steps per forcing period; for adaptive steps, the number of instants at which records get states."""

    @abc.abstractmethod
    def prepared(self, solver: diffrax.AbstractSolver) -> diffrax.AbstractSolver:
        """Return a solver with the settings that this stepping needs, for derivatives and tolerances."""

    @abc.abstractmethod
    def begin(self, terms: diffrax.AbstractTerm, solver: diffrax.AbstractSolver, state: State, args: Args) -> PyTree:
        """Return the solver state for the first `period` of a run; None for solvers that carry no state over."""

    @abc.abstractmethod
    def period(
        self,
        terms: diffrax.AbstractTerm,
        solver: diffrax.AbstractSolver,
        state: State,
        solver_state: PyTree,
        args: Args,
        inside: Callable[[State], State] | None,
    ) -> Period:
        """Integrate one period of diffrax's `terms` by `solver`; `inside`: returns what is needed of the states at
        all steps; None: nothing."""

    @abc.abstractmethod
    def finer(self) -> "AbstractStepping":
        """Return a stepping with a fraction of this one's error, to measure the error."""


class AbstractEqualSteps(AbstractStepping):
    """Steps of equal length."""

    keeps_rates: ClassVar[bool] = True
    """Whether records get the solver's derivatives together with the states."""

    @property
    def total(self) -> Whole:
        """Integration steps per forcing period."""
        return self.number

    @abc.abstractmethod
    def loop(self, step: Callable, carry: PyTree, ends_of: Callable) -> tuple[PyTree, PyTree]:
        """Apply `step(carry, k)` for all steps k; return the last carry, and `ends_of` the carries for records."""

    def prepared(self, solver):
        return differentiable(solver, diffrax.ForwardMode())

    def begin(self, terms, solver, state, args):
        # a diffrax solver that integrates the memory also begins each period again
        continues = isinstance(solver, AbstractLatchingSolver) and not solver.restarts_each_period
        return solver.init(terms, 0.0, 1 / self.total, state, args) if continues else None

    def period(self, terms, solver, state, solver_state, args, inside):
        # a solver that begins again carries nothing from period to period
        begins = solver_state is None
        if begins:
            solver_state = solver.init(terms, 0.0, 1 / self.total, state, args)
        # steps of explicit methods cannot fail
        may_fail = not getattr(solver, "explicit", False)
        has_rates = self.keeps_rates and isinstance(solver, AbstractLatchingSolver)

        def step(carry, k):
            state, solver_state, failed = carry
            ends = k / self.total, (k + 1) / self.total
            # neither the error estimate nor data for an interpolation are used, so that XLA omits their computation
            state, _, _, solver_state, result = solver.step(terms, *ends, state, args, solver_state, False)
            return state, solver_state, failed | (may_fail and result != diffrax.RESULTS.successful)

        def ends_of(carry):
            """Return state and rates at a step's end, for records; None where they are not requested."""
            if inside is None:
                return None, None
            return inside(carry[0]), solver.rates(carry[1]) if has_rates else None

        carry = state, solver_state, jnp.zeros((), bool)
        # both ends of all steps: the start of the first step, and the end of each step
        start = ends_of(carry)
        (end, solver_state, failed), ends = self.loop(step, carry, ends_of)
        states, rates = jax.tree.map(lambda a, others: jnp.concatenate([a[None], others]), start, ends)
        return Period(end, states, rates, self.total, failed, None if begins else solver_state)


class ConstantSteps(AbstractEqualSteps):
    """Steps of equal length; records get the states at the ends of all steps.

    With `most` alone, the number of steps is part of the compiled program, which can be differentiated in both modes.
    With `steps`, an array, one program serves every number, but can be differentiated only in forward mode. Then
    `most` is the greatest number, for which the records' arrays of states inside periods have places.
    """

    most: int | None = eqx.field(static=True, default=None)
    """Steps per forcing period, or the greatest number of steps where `steps` is given."""
    steps: Float[Array, ""] | None = None
    """Steps per forcing period as an array."""

    def __check_init__(self):
        if self.steps is None:
            given_steps(self.most)

    @property
    def number(self) -> Whole:
        return cast(int, self.most) if self.steps is None else self.steps

    def prepared(self, solver):
        # reverse mode needs a loop whose length the program knows
        return differentiable(solver, diffrax.DirectAdjoint()) if self.steps is None else super().prepared(solver)

    def finer(self):
        assert self.steps is not None  # errors are measured only with `steps`
        return ConstantSteps(self.most, 2 * self.steps)

    def loop(self, step, carry, ends_of):
        # With `steps` as an array, only the first `steps` entries are valid.
        if self.steps is None:
            # Reverse mode keeps each step's state and computes its stages again; in a loop XLA cannot merge both.
            @functools.partial(jax.checkpoint, prevent_cse=False)
            def scanned(carry, k):
                carry = step(carry, k)
                return carry, ends_of(carry)

            steps = jnp.arange(float(cast(int, self.most)))
            return in_one_kernel(lambda carry: jax.lax.scan(scanned, carry, steps), carry)

        # The number of steps is an argument: the results of each step go to their place in arrays of length `most`.
        def one(k, both):
            carry, ends = both
            carry = step(carry, k * 1.0)
            return carry, jax.tree.map(lambda array, a: array.at[k].set(a), ends, ends_of(carry))

        repeated = lambda end: jnp.broadcast_to(end, (cast(int, self.most), *end.shape))
        steps = jnp.asarray(self.steps).astype(int)
        loop = lambda both: jax.lax.fori_loop(0, steps, one, both)
        return in_one_kernel(loop, (carry, jax.tree.map(repeated, ends_of(carry))))


class SampledSteps(AbstractEqualSteps):
    """Steps of equal length whose number is an argument of the program; records get states at only a few steps' ends.

    Arrays have no places for states that no record needs. It can be differentiated only in forward mode.
    """

    samples: int = eqx.field(static=True)
    """Instants in a forcing period at which records get states."""
    each: Whole
    """Steps between two instants."""

    keeps_rates = False

    @property
    def number(self) -> Whole:
        return self.samples

    @property
    def total(self) -> Whole:
        return self.samples * self.each

    def finer(self):
        return SampledSteps(self.samples, 2 * self.each)

    def loop(self, step, carry, ends_of):
        each = jnp.asarray(self.each).astype(int)

        def sampled(carry, k):
            carry = jax.lax.fori_loop(0, each, lambda j, carry: step(carry, k * each + j), carry)
            return carry, ends_of(carry)

        places = jnp.arange(float(self.samples))
        return in_one_kernel(lambda carry: jax.lax.scan(sampled, carry, places), carry)


class ControlledSteps(AbstractStepping):
    """Steps that a step size controller chooses; states inside a period are interpolated at equal intervals."""

    samples: int = eqx.field(static=True)
    """Number of instants in a forcing period at which records get states."""
    first_steps: int = eqx.field(static=True)
    """The first step of a run is one forcing period divided by this number."""
    controller: diffrax.AbstractStepSizeController
    adjoint: diffrax.AbstractAdjoint = eqx.field(static=True, default=diffrax.ForwardMode())

    @property
    def number(self) -> Whole:
        return self.samples

    def prepared(self, solver):
        solver = differentiable(solver, self.adjoint)
        if not isinstance(self.controller, AdaptiveSteps):
            return solver
        # root finders use the controller's tolerance, converted to the motion's scales that they use
        return with_tolerance(
            solver,
            self.controller.atol / scaled_size(MOTION_SCALES, self.controller.scales),
        )

    def finer(self):
        """Return a stepping with a tenth of the tolerances.

        **Raises:** `ValueError` for a controller without tolerances.
        """
        fields = [name for name in ("tolerance", "rtol", "atol") if name in vars(self.controller)]
        if not fields:
            raise ValueError(
                f"Argument `probe` must be 0 with {type(self.controller).__name__}, which has no tolerance."
            )
        # diffrax's controllers have rtol and atol, `AdaptiveSteps` has one tolerance
        at = lambda s: [getattr(s.controller, name) for name in fields]
        return eqx.tree_at(at, self, replace_fn=lambda tolerance: tolerance / 10)

    def begin(self, terms, solver, state, args):
        first = 1 / self.first_steps
        carries = isinstance(solver, AbstractLatchingSolver)
        wanted = jnp.asarray(first) if isinstance(self.controller, AdaptiveSteps) else None
        return solver.init(terms, 0.0, first, state, args) if carries else None, wanted

    def period(self, terms, solver, state, solver_state, args, inside):
        # `wanted` is the next step that `AdaptiveSteps` would have taken; others begin again in each period
        solver_state, wanted = solver_state
        # the end is saved separately, because the last instant is interpolated
        subs = {"end": diffrax.SubSaveAt(t1=True)}
        instants = jnp.arange(1, self.samples + 1) / self.samples
        if inside:
            subs["inside"] = diffrax.SubSaveAt(ts=instants)
        first = 1 / self.first_steps if wanted is None else wanted
        solution = diffrax.diffeqsolve(
            *(terms, solver, 0.0, 1.0, first, state, args),
            saveat=diffrax.SaveAt(
                subs=subs, solver_state=solver_state is not None, controller_state=wanted is not None
            ),
            stepsize_controller=self.controller,
            adjoint=self.adjoint,
            solver_state=solver_state,
            max_steps=1_000_000,  # a case with more steps has failed
            throw=False,
        )
        assert solution.ys is not None  # it is asked for
        end = jax.tree.map(lambda ys: ys[-1], solution.ys["end"])
        states = None
        if inside:
            # an interpolated state gets the memory that belongs to its gaps
            within = jax.tree.map(lambda ys: ys[: self.samples], solution.ys["inside"])
            within = jax.vmap(lambda t, y: field_of(terms).inside_step(t, y, args))(instants, within)
            states = jax.tree.map(lambda a, ys: jnp.concatenate([a[None], ys]), state, within)
        failed = solution.result != diffrax.RESULTS.successful
        wanted = None if solution.controller_state is None else solution.controller_state[0]
        solver_state = None if solver_state is None else solution.solver_state, wanted
        return Period(end, states, None, solution.stats["num_steps"], failed, solver_state)


def as_stepping(stepping: AbstractStepping | int) -> AbstractStepping:
    """Return a stepping unchanged, and a whole number as a number of constant steps."""
    return stepping if isinstance(stepping, AbstractStepping) else ConstantSteps(stepping)


def capacity_for(count: int) -> int:
    """Return the least of 1, 2, 4, 8, 16, 32, 50, 100, 200, ... that is at least `count`, to have few programs."""
    if count <= 32:
        return 1 << (count - 1).bit_length()
    return 50 * (1 << max(-(-count // 50) - 1, 0).bit_length())
