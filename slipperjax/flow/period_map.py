"""The period map: a scene's state after one or more forcing periods.

All code that advances a slipper in time uses `PeriodMap`. This module also has its compiled forms, for one case and
for batches.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..analysis.floquet import linearise
from ..analysis.lyapunov import first_tangents, push_tangents
from ..model.beam import RailStep, weights_of
from ..model.contact import AbstractMemory
from ..model.dynamics import Args, State, vector_field
from ..model.kinematics import Motion, Points, contact_points, rail_step, scales_of
from ..model.layout import coordinate_rows
from ..model.parameters import at_values, values_of
from ..model.scene import Scene
from ..model.starts import state_and_penetration, warn_of_start
from ..model.step_size import prepared
from ..model.travel import SpeedProgramme
from ..solvers.named import resolve_solver
from ..tools.batching import Batched
from ..tools.compile import jit, with_standard_promotion
from ..tools.forms import in_one_kernel
from ..tools.jacobian import by_jacobian, slopes_along
from ..tools.types import Real, Whole
from .course import Course
from .record import RecordSet
from .status import Status, judge_states, with_growth, with_resolution
from .stepping import AbstractEqualSteps, AbstractStepping, as_stepping


def tangent_weights(scene: Scene) -> Callable[[State], State]:
    """Return the weights of a tangent's components at a state, see `slipperjax.analysis.lyapunov.push_tangents`.

    The motion counts in multiples of its scales. With `EventLatch` the memory of a closed contact counts relative to
    its value, and the memory of an open contact does not count. With `SmoothSwitch` 1 m/s of memory counts as one.
    """
    return _weights_with(type(scene.contact_memory))


@functools.cache  # one that is made anew would be compiled anew in every call
def _weights_with(memory: type[AbstractMemory]) -> Callable[[State], State]:
    def weights(state: State) -> State:
        of_memory = None if state.memory is None else memory.weights(state.memory)
        of_motion = jax.tree.map(lambda scale: 1 / scale, scales_of(state.motion))
        return State(of_motion, of_memory, state.rail and weights_of(state.rail))

    return weights


@functools.partial(jit, static_argnames=("count",))
def initial_tangents(scenes: Batched[Scene], states: State, count: int) -> State:
    """Return `count` orthonormal tangents for each case of a batch, with axes (cases, count, ...)."""
    return scenes.map(lambda scene, state: first_tangents(state, count, tangent_weights(scene)), states)


class Passage(NamedTuple):
    """The result of a run over some forcing periods."""

    state: State  # at the end
    samples: tuple[PyTree, ...]
    """Samples of each record, with a leading axis of periods."""
    status: Int[Array, "*cases"]
    """First `Status` code that is not `FINITE` at the end of a period."""
    steps_taken: Int[Array, "*cases periods"]
    """Steps tried in each period, including those that an adaptive controller rejected."""
    carried: tuple[PyTree, ...]  # of the records after all periods


class PeriodMap(eqx.Module):
    """The stroboscopic map of one scene: from a state to the state `periods` forcing periods later.

    The map is a pytree, for jit, vmap and derivatives. `PeriodMap(scene, steps)(state, k)` has the form of maps in
    `slipperjax.analysis`, with k the number of earlier applications.
    """

    scene: Scene
    stepping: AbstractStepping = eqx.field(converter=as_stepping)
    """How a period is integrated; a whole number is the number of constant steps."""
    solver: diffrax.AbstractSolver | None = eqx.field(static=True, default=None)
    """None: the default solver of the scene, see `resolve_solver`."""
    periods: int = eqx.field(static=True, default=1)
    """Forcing periods in one application."""

    def __call__(self, state: State, k: Real = 0.0) -> State:
        """Return the state after one application; `k`: number of earlier applications, for the place on the rail."""
        return self.run(state, k * self.periods).state

    @with_standard_promotion
    def run(
        self,
        state: State,
        epoch: Real = 0.0,
        *,
        periods: int | None = None,
        records: RecordSet = RecordSet(),
        used: Whole = None,
        earlier: PyTree = None,
    ) -> Passage:
        """Integrate some forcing periods, and sample the records.

        **Arguments:** `state`: at the start of the forcing period number `epoch`; `periods`: by default the periods
        of one application; `used`: how many of `periods` are integrated, by default all. `used` may be traced, so
        that one program serves several numbers; results of the other periods are meaningless. `earlier`: values that
        the records carry from the periods before, by default the values at a beginning.

        **Returns:** a `Passage` with scalar status. If the solver or the step size controller gives up, the motion is
        NaN from this period on.
        """
        count = self.periods if periods is None else periods
        # the program of reverse mode through all steps would be three times as large, see `by_jacobian`
        run = lambda self, *of_run: self._run(count, records, *of_run)
        return by_jacobian(run, self, state, jnp.asarray(epoch, float), used, earlier)

    def _run(
        self,
        count: int,
        records: RecordSet,
        state: State,
        epoch: Real,
        used: Whole,
        earlier: PyTree,
    ) -> Passage:
        scene = prepared(self.scene)
        state = jax.tree.map(lambda a: jnp.asarray(a, float), state)  # 32-bit numbers become 64-bit ones
        # tangents from the start, so that JAX traces the loops below once
        state = _moving_with(state, eqx.filter(scene, eqx.is_array))
        solver = self.stepping.prepared(resolve_solver(scene, self.solver))
        points = contact_points(scene)  # once for the whole run, not in every evaluation
        rails = _steps_of_rails(scene, self.stepping, points)
        terms = diffrax.ODETerm(vector_field(scene))
        earlier = records.begin(scene, state) if earlier is None else earlier
        # Where records use the states inside a period, their work takes as long to compile as the steps. Therefore
        # steps and records are two kernels, which compile at the same time. A kernel takes microseconds to start;
        # without such records the period is too short for this, and the whole loop is one kernel.
        called = lambda fun, *args: fun(*args)
        part, whole = (in_one_kernel, called) if records.inside else (called, in_one_kernel)

        @functools.partial(jax.jit, inline=True)  # traced once: `period_if_used` needs its shapes, too
        def period(carry, epoch):
            state, solver_state, carried = carry
            args = Args(scene, epoch, points, rails)
            # some records change the scene from period to period, such as wear
            now = records.feed_back(scene, carried, epoch)
            if now is not scene:  # the gaps that the solver keeps also change
                args = Args(now, epoch, contact_points(now), rails)
                solver_state = self.stepping.begin(terms, solver, state, args)
            stepped = lambda a, b: self.stepping.period(terms, solver, a, b, args, records.view)
            done = part(stepped, state, solver_state)
            end = _lost_where(done.failed, done.end)
            inside = _lost_where(done.failed, done.inside) if records.inside else None

            def recorded(end: State, inside: State | None, rates: Motion | None, carried: tuple) -> tuple:
                course = Course(end, inside, args, self.stepping.number, rates)
                return records.add(carried, course), records.sample(course), judge_states(end)

            carried, sample, code = part(recorded, end, inside, done.rates, carried)
            return (end, done.solver_state, carried), (sample, code, jnp.asarray(done.steps_taken, int))

        # Skips a period at run time. `used` is one number for the whole batch, so that `jax.vmap` keeps the `cond`.
        def period_if_used(carry, epoch_now):
            none = jax.tree.map(
                lambda a: jnp.zeros(a.shape, a.dtype),
                jax.eval_shape(period, carry, epoch_now)[1],
            )
            return jax.lax.cond(
                epoch_now < epoch + used,
                period,
                lambda c, _: (c, none),
                carry,
                epoch_now,
            )

        solver_state = self.stepping.begin(terms, solver, state, Args(scene, epoch, points, rails))
        epochs = epoch + jnp.arange(float(count))
        one = period if used is None else period_if_used
        run = lambda carry: jax.lax.scan(one, carry, epochs)
        (end, _, carried), (samples, codes, steps_taken) = whole(run, (state, solver_state, earlier))
        judged = steps_taken
        if used is not None:
            # skipped periods count as periods that resolve all impacts
            run = jnp.arange(float(count)) < used
            steps_taken = jnp.where(run, steps_taken, jnp.max(steps_taken))
            judged = jnp.where(run, steps_taken, jnp.inf)
        # code of the first period with a problem
        code = with_resolution(codes[jnp.argmax(codes != int(Status.FINITE))], scene, judged, epoch)
        return Passage(end, samples, code, steps_taken, carried)


def _steps_of_rails(scene: Scene, stepping: AbstractStepping, points: Points) -> RailStep | None:
    """Return what every step needs about rails that bend; None where steps differ, or for rigid rails."""
    if scene.beam is None or isinstance(scene.speed, SpeedProgramme) or not isinstance(stepping, AbstractEqualSteps):
        return None
    return rail_step(scene, scene.speed, scene.period / stepping.total, points)


def _lost_where(failed: Array, state: State) -> State:
    """Return the state or states, with a motion of NaN where the solver or the controller gave up."""
    lost = jax.tree.map(lambda v: jnp.where(failed, jnp.nan, v), state.motion)
    return eqx.tree_at(lambda s: s.motion, state, lost)


def _moving_with(state: State, numbers: PyTree) -> State:
    """Return `state` plus a zero that depends on all `numbers`, so that the state has their tangents and batch axes.

    In its first pass a loop's state gets tangents from `numbers`. JAX traces the loop only once where the state has
    these tangents from the start. Otherwise JAX must trace the loop again, and nested loops even more often.
    """
    # NaN and infinity would spoil the zero
    floats = (x for x in jax.tree.leaves(numbers) if jnp.issubdtype(x.dtype, jnp.floating))
    finite = (jnp.where(jnp.isfinite(x), x, 0.0) for x in floats)
    nothing = 0.0 * sum(jnp.sum(x) for x in finite)
    return jax.tree.map(lambda x: x + nothing, state)


def initial_states(scenes: Batched[Scene], starts: Motion | State, epoch: Real = 0.0) -> State:
    """Return the states with which the runs of a batch begin; `starts` has a leading axis of cases.

    Gives an `ImplausibleWarning` where slippers begin far outside their play.

    **Arguments:** `epoch`: forcing periods from distance zero to where the runs begin.
    """
    states, outside = states_and_penetrations(scenes, starts, epoch)
    warn_of_start(starts, outside, scenes.case, epoch)
    return states


@jit
def states_and_penetrations(
    scenes: Batched[Scene], starts: Motion | State, epoch: Real = 0.0
) -> tuple[State, Float[Array, " cases"]]:
    """Return a batch's states and penetrations, see `slipperjax.model.starts.state_and_penetration`."""
    return scenes.map(lambda scene, start: state_and_penetration(scene, start, epoch), starts)


@functools.partial(jit, static_argnames=("solver", "periods", "records"))
def advance(
    scenes: Batched[Scene],
    states: State,
    epoch: Real,
    stepping: AbstractStepping,
    *,
    solver: diffrax.AbstractSolver,
    periods: int,
    records: RecordSet = RecordSet(),
    used: Whole = None,
    earlier: PyTree = None,
) -> Passage:
    """Run a batch over some forcing periods, all cases with the same stepping: see `PeriodMap.run`.

    `states`, `earlier` and the result have a leading axis of cases. Callers cut off the results of periods that are
    not `used`.
    """

    def one(scene: Scene, state: State, earlier: PyTree) -> Passage:
        step = PeriodMap(scene, stepping, solver)
        return step.run(state, epoch, periods=periods, records=records, used=used, earlier=earlier)

    return scenes.map(one, states, earlier)


class SlopePassage(NamedTuple):
    """A batch after a forcing period, the records' samples, and derivatives of both along some directions."""

    state: State
    slopes: Float[Array, "cases directions size"]
    """Derivatives of all numbers of the states."""
    samples: tuple[PyTree, ...]
    """For each record, arrays (cases, ...)."""
    sample_slopes: tuple[PyTree, ...]
    """For each record, arrays (cases, directions, ...)."""


@functools.partial(jit, static_argnames=("names", "records", "solver"))
def advance_slopes(
    scenes: Batched[Scene],
    states: State,
    slopes: Float[Array, "cases directions size"],
    epoch: Real | Float[Array, " cases"],
    stepping: AbstractStepping,
    *,
    names: tuple[str, ...],
    records: RecordSet,
    solver: diffrax.AbstractSolver,
) -> SlopePassage:
    """Run a batch over one forcing period, and differentiate it in forward mode.

    **Arguments:** `slopes`: derivatives of the states at the start. Each of the first directions also changes one of
    the parameters `names`; the other directions change only the start. `epoch`: one number, or one for each case.
    """

    def one(scene: Scene, state: State, slopes: Array, own_epoch: Real | None) -> SlopePassage:
        flat, unravel = ravel_pytree(state)

        def run(x: Array, p: Array) -> tuple[Array, PyTree]:
            step = PeriodMap(at_values(scene, names, p), stepping, solver)
            passage = step.run(unravel(x), epoch if own_epoch is None else own_epoch, periods=1, records=records)
            # without the axis of periods
            return ravel_pytree(passage.state)[0], jax.tree.map(lambda a: a[0], passage.samples)

        p = values_of(scene, names)
        each = jnp.eye(len(slopes), p.size)
        (end, samples), (end_slopes, sample_slopes) = slopes_along(run, (flat, p), slopes, each)
        return SlopePassage(unravel(end), end_slopes, samples, sample_slopes)

    return scenes.map(one, states, slopes, None if jnp.ndim(epoch) == 0 else epoch)


class TangentPassage(NamedTuple):
    """The result of carrying tangents over some forcing periods, with a leading axis of cases."""

    state: State
    tangents: State
    history: Float[Array, "cases periods count"]  # logarithm of the tangents' growth in each period
    strobe: Float[Array, "cases periods coordinates"]
    """The state at the end of each period, in the order of `slipperjax.model.COORDINATES`."""
    status: Int[Array, " cases"]
    """`Status` code of the state at the end; states before the end are not judged."""


@functools.partial(jit, static_argnames=("solver", "periods"))
def advance_tangents(
    scenes: Batched[Scene],
    states: State,
    tangents: State,
    epoch: Real,
    stepping: AbstractStepping,
    *,
    solver: diffrax.AbstractSolver,
    periods: int,
) -> TangentPassage:
    """Carry a batch's orthonormal tangents over forcing periods, see `slipperjax.analysis.lyapunov.push_tangents`."""

    def one(scene, state, tangents):
        step = PeriodMap(scene, stepping, solver)
        scale = tangent_weights(scene)

        # one period at a time, to keep the growth and the state of each
        def period(carry, epoch):
            state, tangents = carry
            state, tangents, logs = push_tangents(step, state, tangents, 1, index=epoch, scale=scale)
            return (state, tangents), (logs[0], coordinate_rows(state))

        epochs = epoch + jnp.arange(float(periods))
        (state, tangents), (history, strobe) = jax.lax.scan(period, (state, tangents), epochs)
        code = with_resolution(judge_states(state), scene, jnp.full(periods, stepping.number), epoch)
        code = with_growth(code, history)
        return TangentPassage(state, tangents, history, strobe, code)

    return scenes.map(one, states, tangents)


@functools.partial(jit, static_argnames=("solver",))
def batch_jacobians(
    scenes: Batched[Scene], states: State, epoch: Real, stepping: AbstractStepping, *, solver: diffrax.AbstractSolver
) -> Float[Array, "cases size size"]:
    """Return the Jacobian of each case's period map, for Floquet multipliers."""

    def one(scene: Scene, state: State) -> Array:
        _, matrices = linearise(PeriodMap(scene, stepping, solver), state, 1, index=epoch)
        return matrices[0]

    return scenes.map(one, states)
