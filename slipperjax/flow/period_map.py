"""The period map: a scene's state one or more forcing periods on.

Everything that advances a slipper in time stands on `PeriodMap`. It is applied and differentiated as it is, and the
compiled forms for one case and for batches are here too.
"""

import functools
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from ..analysis import jacobians, push_tangents
from ..model import Args, Motion, Scene, State, contact_points, initial_state, settle_memory, vector_field
from ..solvers import RK4, AbstractLatchingRungeKutta, AbstractLatchingSolver, AdaptiveSteps, differentiable
from ..tools import Batched, call_compiled, jit
from .recorders import AbstractRecorder, Strobe
from .status import Status, status_of, with_resolution
from .tangents import tangent_weights

MOST_ADAPTIVE_STEPS = 1_000_000
"""Adaptive steps per forcing period after which a case has failed."""


class Passage(NamedTuple):
    """What a run over some forcing periods gives."""

    state: State
    """The state at the end."""
    record: Any
    """What the recorder kept, with a leading axis of periods."""
    status: Int[Array, "*cases"]
    """`Status` code: the first that is not `FINITE` at the ends of the periods."""
    steps_taken: Int[Array, "*cases periods"]
    """Steps tried in each period, including those that an adaptive controller rejected."""


class PeriodMap(eqx.Module):
    """The stroboscopic map of one scene: its state `periods` forcing periods on.

    A pytree: jit, vmap or differentiate it. `PeriodMap(scene, steps)(state, k)` is the step that
    `slipperjax.analysis` works on, with k the number of earlier applications.
    """

    scene: Scene
    steps: Any
    """Integration steps per forcing period, a number or an array. With a step size controller, the number of states
    per period that a recorder gets, interpolated; the first step is one period over this."""
    solver: diffrax.AbstractSolver = eqx.field(static=True, default=RK4())
    controller: diffrax.AbstractStepSizeController | None = None
    """Step size controller; None for constant steps."""
    adjoint: diffrax.AbstractAdjoint = eqx.field(static=True, default=diffrax.ForwardMode())
    periods: int = eqx.field(static=True, default=1)
    """Forcing periods in one application."""
    most_steps: int | None = eqx.field(static=True, default=None)
    """Where `steps` is an array, the largest value that it may have; needed by recorders of states inside periods,
    and by reverse mode. The same compiled program serves all values up to it."""

    def __call__(self, state: State, k: Any = 0.0) -> State:
        """The state after one application, the one number `k`."""
        return self.run(state, k * self.periods).state

    def run(
        self,
        state: State,
        epoch: Any = 0.0,
        *,
        periods: int | None = None,
        recorder: AbstractRecorder | None = None,
    ) -> Passage:
        """Integrates some forcing periods, by default one application's, and keeps what `recorder` makes of each.

        **Arguments:** `state`: at the start of the forcing period number `epoch`. **Returns:** a `Passage` with
        scalar status. Where solver or controller gave up, the motion is NaN from there on.
        """
        recorder = Strobe() if recorder is None else recorder
        scene, solver = settle_memory(self.scene), differentiable(self.solver, self.adjoint)
        points = contact_points(scene)  # once for the whole run, not in every evaluation
        terms = diffrax.ODETerm(vector_field(scene))
        carries = isinstance(solver, AbstractLatchingSolver)
        carried = solver.init(terms, 0.0, 1 / self.steps, state, Args(scene, epoch, points)) if carries else None
        adapts = isinstance(self.controller, AdaptiveSteps)
        wanted = jnp.asarray(1 / self.steps, float) if adapts else None
        one_period = functools.partial(self._one_period, terms, scene, solver, points, recorder)
        count = self.periods if periods is None else periods
        start = state, carried, wanted
        (end, _, _), (record, codes, taken) = jax.lax.scan(one_period, start, epoch + jnp.arange(float(count)))
        first = codes[jnp.argmax(codes != int(Status.FINITE))]
        return Passage(end, record, with_resolution(first, scene, self.steps), taken)

    def _one_period(self, terms, scene, solver, points, recorder, carry, epoch):
        state, carried, wanted = carry
        args = Args(scene, epoch, points)
        solution = diffrax.diffeqsolve(
            terms,
            solver,
            t0=0.0,
            t1=1.0,
            dt0=1 / self.steps if wanted is None else wanted,
            y0=state,
            args=args,
            saveat=self._saveat(recorder, carried is not None, wanted is not None),
            stepsize_controller=diffrax.ConstantStepSize() if self.controller is None else self.controller,
            adjoint=self.adjoint,
            max_steps=self._room() if self.controller is None else MOST_ADAPTIVE_STEPS,
            throw=False,
            solver_state=carried,
        )
        assert solution.ys is not None  # it is asked for
        end = jax.tree.map(lambda ys: ys[-1], solution.ys["end"])
        if self.controller is not None or not isinstance(solver, AbstractLatchingRungeKutta):
            failed = solution.result != diffrax.RESULTS.successful
            end = State(jax.tree.map(lambda v: jnp.where(failed, jnp.nan, v), end.motion), end.memory)
        record = end
        if recorder.inside:
            record = recorder(self._filled(state, solution.ys["all"]), args, self.steps)
        carried = solution.solver_state if carried is not None else None
        wanted = None if solution.controller_state is None else solution.controller_state[0]
        return (end, carried, wanted), (record, status_of(end), solution.stats["num_steps"])

    def _room(self) -> int | None:
        """The most steps that one period may take; None for any number."""
        most = self.steps if isinstance(self.steps, int) else self.most_steps
        return None if most is None else most + 1

    def _saveat(self, recorder: AbstractRecorder, solver_state: bool, controller_state: bool) -> diffrax.SaveAt:
        subs = {"end": diffrax.SubSaveAt(t1=True)}
        if recorder.inside:
            room = self._room()
            if room is None:
                raise ValueError("Argument `most_steps` must be given for a recorder of states inside periods.")
            if self.controller is None:
                subs["all"] = diffrax.SubSaveAt(steps=True)
            else:
                subs["all"] = diffrax.SubSaveAt(ts=jnp.arange(1, room) / (room - 1))
        return diffrax.SaveAt(subs=subs, solver_state=solver_state, controller_state=controller_state)

    def _filled(self, start: State, states: PyTree) -> PyTree:
        """The states at both ends of all steps; the entries beyond the last step repeat the start."""
        most = (self._room() or 1) - 1

        def one(first, rest):
            rest = rest[:most]
            if not isinstance(self.steps, int):
                taken = (jnp.arange(most) < self.steps).reshape(-1, *[1] * first.ndim)
                rest = jnp.where(taken, rest, first[None])
            return jnp.concatenate([first[None], rest])

        return jax.tree.map(one, start, states)


def run_compiled(
    period_map: PeriodMap, start: Motion, periods: int, recorder: AbstractRecorder
) -> tuple[State, Passage]:
    """The state at time zero of one case, and its run from there; compiled unless a transformation is at work."""
    return call_compiled(_run, period_map, (periods, recorder), start)


def _run(period_map: PeriodMap, static: tuple, start: Motion) -> tuple[State, Passage]:
    periods, recorder = static
    state = initial_state(period_map.scene, start)
    return state, period_map.run(state, periods=periods, recorder=recorder)


@jit
def initial_states(scenes: Batched[Scene], starts: Motion) -> State:
    """The states at time zero of a batch; `starts` has a leading axis of cases."""
    return scenes.map(initial_state, starts)


@functools.partial(jit, static_argnames=("solver", "periods", "recorder", "most_steps"))
def advance(
    scenes: Batched[Scene],
    states: State,
    epoch: Any,
    steps: Any,
    *,
    solver: diffrax.AbstractSolver,
    periods: int,
    recorder: AbstractRecorder | None = None,
    most_steps: int | None = None,
    controller: diffrax.AbstractStepSizeController | None = None,
) -> Passage:
    """Runs a batch over some forcing periods, all cases with the same number of steps: see `PeriodMap.run`.

    **Arguments:** `states`: with a leading axis of cases, as the result; `steps`: per period, at most `most_steps`
    where the recorder needs states inside periods; None for exactly `most_steps`, which saves copies of them.
    """
    steps = most_steps if steps is None else steps

    def one(scene, state):
        period_map = PeriodMap(scene, steps, solver, controller, most_steps=most_steps)
        return period_map.run(state, epoch, periods=periods, recorder=recorder)

    return scenes.map(one, states)


class TangentPassage(NamedTuple):
    """What carrying tangents over some forcing periods gives, with a leading axis of cases."""

    state: State
    tangents: State
    history: Float[Array, "cases periods count"]
    """Logarithm of the tangents' growth in each period."""
    status: Int[Array, " cases"]
    """`Status` code of the state at the end."""


@functools.partial(jit, static_argnames=("solver", "periods"))
def advance_tangents(
    scenes: Batched[Scene],
    states: State,
    tangents: State,
    epoch: Any,
    steps: Any,
    distance: Any = None,
    *,
    solver: diffrax.AbstractSolver,
    periods: int,
) -> TangentPassage:
    """Carries a batch's orthonormal tangents over some forcing periods, see `slipperjax.analysis.push_tangents`."""

    def one(scene, state, tangents):
        step = PeriodMap(scene, steps, solver)
        options = dict(index=epoch, scale=tangent_weights(scene), distance=distance)
        state, tangents, history = push_tangents(step, state, tangents, periods, **options)
        return TangentPassage(state, tangents, history, with_resolution(status_of(state), scene, steps))

    return scenes.map(one, states, tangents)


@functools.partial(jit, static_argnames=("solver", "periods"))
def batch_jacobians(
    scenes: Batched[Scene], states: State, epoch: Any, steps: Any, *, solver: diffrax.AbstractSolver, periods: int
) -> Float[Array, "cases periods size size"]:
    """Jacobians of a batch's successive period maps, for Floquet multipliers."""
    return scenes.map(
        lambda scene, state: jacobians(PeriodMap(scene, steps, solver), state, periods, index=epoch), states
    )
