"""One scene, integrated: everything else batches this."""

import functools
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .checks import whole
from .compilation import is_traced, jit
from .dynamics import Args, LatchedField, Reactions, State, initial_state, reactions, vector_field
from .kinematics import Motion, contact_points, euler_angles, table_2_start
from .scene import Scene, contact_duration, default_steps_per_period
from .solvers import (
    RK4,
    AbstractLatchingRungeKutta,
    AbstractLatchingSolver,
    AdaptiveSteps,
    Latching,
    choose_solver,
    differentiable,
    estimates_error,
    with_newton,
)

LEAST_PER_CONTACT = 3
"""Steps of a typical impact below which a case is not trusted. The default is 15; at K = 1e12 a case stayed finite
at 5 and did not at 1.3."""

STATUS = {
    0: "finite",
    1: "not finite: the steps are too long for this case, raise steps_per_period; or the solver gave up, where it "
    "iterates or adapts its steps: loosen its tolerance",
    2: "derailed: the slipper turned by more than 90 degrees, where the contact model has no meaning",
    3: f"unresolved: a typical impact takes less than {LEAST_PER_CONTACT} steps, raise steps_per_period",
}
"""Meaning of the status codes of a case."""


def status(states: State) -> Array:
    """Status code of a case from its states, along whatever leading axes: see `STATUS`."""
    leaves = jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(states.motion)])
    m = states.motion
    turned = jnp.any(m.q_x**2 + m.q_y**2 + m.q_z**2 > 0.5)  # half the angle's sine is sqrt(1/2) at 90 degrees
    return jnp.where(jnp.all(jnp.isfinite(leaves)), jnp.where(turned, 2, 0), 1)


def judged(code: Array, scene: Scene, steps: Any) -> Array:
    """A status code from the states, with what the scene and the steps per period say: 3 for unresolved impacts.

    Those come before a derailment, which too few steps can bring about.
    """
    unresolved = contact_duration(scene) * steps < LEAST_PER_CONTACT * scene.period
    return jnp.where(unresolved & (code != 1), 3, code)


def check_controller(controller: Any) -> diffrax.AbstractStepSizeController | None:
    """The step size controller, None for constant steps; raises `ValueError` for what is none."""
    if controller is None or isinstance(controller, diffrax.ConstantStepSize):
        return None
    if not isinstance(controller, diffrax.AbstractStepSizeController):
        raise ValueError(f"Argument `stepsize_controller` must be a diffrax controller, but is {controller!r}.")
    return controller


def check_solver(scene: Scene, solver: diffrax.AbstractSolver | str | None) -> diffrax.AbstractSolver:
    """The solver to use: where the scene latches touchdowns, a stock one in `Latching`.

    **Raises:** `ValueError` for what is no solver, or one that cannot be latched.
    """
    if solver is None:
        return RK4()
    if isinstance(solver, str) and solver == "auto":
        return choose_solver(scene).solver
    if not isinstance(solver, diffrax.AbstractSolver):
        raise ValueError(f"Argument `solver` must be a diffrax solver, but is {solver!r}.")
    if isinstance(solver, AbstractLatchingSolver):
        return solver
    return Latching(solver) if isinstance(vector_field(scene), LatchedField) else with_newton(solver)


MOST_STEPS = 1_000_000
"""Adaptive steps per forcing period after which a case has failed."""

Record = Callable[[State, Args, int], Any]
"""What to keep of a period: from the states at both ends of all steps, the arguments, and the number of steps."""


def integrate(scene: Scene, state: State, **options: Any) -> tuple[State, Any]:
    """`integrate_counted` without the number of steps."""
    return integrate_counted(scene, state, **options)[:2]


def integrate_counted(
    scene: Scene,
    state: State,
    *,
    solver: diffrax.AbstractSolver,
    steps: Any,
    periods: int,
    record: Record | None,
    adjoint: diffrax.AbstractAdjoint,
    epoch: Any = 0.0,
    controller: diffrax.AbstractStepSizeController | None = None,
) -> tuple[State, Any, Array]:
    """Integrates `periods` forcing periods from the period `epoch` on, and keeps what `record` makes of each.

    One diffeqsolve per period, each over times 0..1 from its own epoch. Without `record` the states at the ends
    of the periods are kept, and nothing is stored in between; then `steps`, the number per period, may be traced.
    With a step size controller `steps` is the number of states per period that `record` gets, interpolated, and
    the first step is 1 / steps. Where solver or controller gave up, the motion is NaN from there on.

    **Returns:** the last state, what was kept with a leading axis of length `periods`, and the number of steps
    tried in each period.
    """
    scene, solver = scene.settled(), differentiable(solver, adjoint)
    points = contact_points(scene)  # once, and not in every evaluation
    terms = diffrax.ODETerm(vector_field(scene))
    carries = isinstance(solver, AbstractLatchingSolver)
    remembers = isinstance(controller, AdaptiveSteps)
    if controller is None:
        saveat = diffrax.SaveAt(t1=record is None, steps=record is not None, solver_state=carries)
        most = steps + 1 if isinstance(steps, int) else None
    else:
        times = None if record is None else jnp.arange(1, steps + 1) / steps
        saveat = diffrax.SaveAt(t1=True, ts=times, solver_state=carries, controller_state=remembers)
        most = MOST_STEPS
    may_fail = controller is not None or not isinstance(solver, AbstractLatchingRungeKutta)

    def period(carry, k):
        state, solver_state, wanted = carry
        args = Args(scene, k, points)
        solution = diffrax.diffeqsolve(
            terms,
            solver,
            t0=0.0,
            t1=1.0,
            dt0=1 / steps if wanted is None else wanted,
            y0=state,
            args=args,
            saveat=saveat,
            stepsize_controller=diffrax.ConstantStepSize() if controller is None else controller,
            adjoint=adjoint,
            max_steps=most,
            throw=False,
            solver_state=solver_state,
        )
        last = -1 if controller is not None or record is None else steps - 1
        end = jax.tree.map(lambda ys: ys[last], solution.ys)
        if may_fail:
            failed = solution.result != diffrax.RESULTS.successful
            end = State(jax.tree.map(lambda v: jnp.where(failed, jnp.nan, v), end.motion), end.memory)
        if record is None:
            kept = end
        else:
            states = jax.tree.map(lambda a, ys: jnp.concatenate([a[None], ys[:steps]]), state, solution.ys)
            kept = record(states, args, steps)
        wanted = None if solution.controller_state is None else solution.controller_state[0]
        return (end, solution.solver_state if carries else None, wanted), (kept, solution.stats["num_steps"])

    solver_state = solver.init(terms, 0.0, 1 / steps, state, Args(scene, epoch, points)) if carries else None
    wanted = jnp.asarray(1 / steps, float) if remembers else None
    start = state, solver_state, wanted
    (end, _, _), (kept, taken) = jax.lax.scan(period, start, epoch + jnp.arange(float(periods)))
    return end, kept, taken


def period_map(
    scene: Scene,
    state: State,
    *,
    periods: int = 1,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> State:
    """The state `periods` forcing periods after `state`: the stroboscopic map. Pure; jit, vmap or differentiate it.

    **Arguments:** as for `simulate`; `state` comes from `initial_state` or an earlier call.
    """
    steps = default_steps_per_period(scene) if steps_per_period is None else steps_per_period
    return integrate(
        scene,
        state,
        solver=check_solver(scene, solver),
        steps=whole("steps_per_period", steps, 1),
        periods=whole("periods", periods, 1),
        record=None,
        adjoint=diffrax.ForwardMode() if adjoint is None else adjoint,
        controller=check_controller(stepsize_controller),
    )[0]


class Trajectory(eqx.Module):
    """A simulated motion, saved at constant intervals. Leading axis of everything: saves."""

    scene: Scene
    period: Float[Array, " saves"]
    """Time in forcing periods [1]."""
    state: State
    """The saved states."""
    steps_per_period: int = eqx.field(static=True)
    """Integration steps per forcing period; with adaptive steps, the number of states they were interpolated at."""
    steps_taken: Int[Array, " periods"] | None = None
    """Steps tried in each forcing period, those included that an adaptive controller rejected."""

    @property
    def time(self) -> Float[Array, " saves"]:
        """Time [s]."""
        return self.period * self.scene.period

    @property
    def status(self) -> Array:
        """0 where all is well, else see `slipperjax.simulate.STATUS`."""
        return _judged(self.state, self.scene, self.steps_per_period)

    @property
    def euler_angles(self) -> tuple[Array, Array, Array]:
        """Roll, pitch and yaw of Eq. (2) [rad]."""
        return _euler_angles(self.state.motion)

    @property
    def reactions(self) -> Reactions:
        """Contact forces, drive force, loads on the track nodes, accelerations; leading axis saves."""
        return _reactions(self.scene, self.period, self.state)

    def to_xarray(self):
        """The trajectory as an `xarray.Dataset` with units: see `slipperjax.labels.trajectory_dataset`."""
        from .labels import trajectory_dataset

        return trajectory_dataset(self)


_euler_angles = jax.jit(jax.vmap(euler_angles))
_judged = jax.jit(lambda states, scene, steps: judged(status(states), scene, steps))


@jit
def _reactions(scene, periods, states):
    return jax.vmap(lambda p, s: reactions(0.0, s, Args(scene, p)))(periods, states)


def simulate(
    scene: Scene,
    periods: int = 60,
    *,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    start: Motion | None = None,
    saves_per_period: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> Trajectory:
    """Simulates one scene.

    **Arguments:**

    - `scene`: the case, see `paper_scene`.
    - `periods`: number of forcing periods, wavelength / speed each.
    - `steps_per_period`: integration steps per forcing period; default from the duration of a typical contact,
        see `default_steps_per_period`, rounded up to a multiple of `saves_per_period`.
    - `solver`: a diffrax solver; default `RK4()`. With `EventLatch` memory a stock one is put into `Latching`.
        "auto" takes what `choose_solver` chooses for the scene.
    - `stepsize_controller`: default constant steps. `AdaptiveSteps(tolerance)`, or one of diffrax's, goes with
        solvers that estimate their error; then `steps_per_period` is the first guess, and saved states between
        the ends of periods are interpolated, to third order.
    - `start`: motion at time zero; default Table 2 of Dang et al. 2024.
    - `saves_per_period`: saved states per forcing period, a divisor of `steps_per_period`; default 50, or
        `steps_per_period` where that is given and no multiple of 50.
    - `adjoint`: default `diffrax.ForwardMode()`, for `jax.jvp` and `jax.jacfwd`, which suit a system with few
        parameters; `diffrax.RecursiveCheckpointAdjoint()` for `jax.grad` and `jax.vjp`.

    **Returns:** a `Trajectory`, the start included.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    periods = whole("periods", periods, 1)
    steps, saves = step_plan(scene, steps_per_period, saves_per_period)
    solver = check_solver(scene, solver)
    adjoint = diffrax.ForwardMode() if adjoint is None else adjoint
    start = table_2_start() if start is None else check_start(start)
    controller = check_controller(stepsize_controller)
    if isinstance(controller, diffrax.AbstractAdaptiveStepSizeController) and not estimates_error(solver):
        raise ValueError(
            f"Argument `solver` must be one with an error estimate for adaptive steps (Tsit5, ROS34PW2, Dopri8), "
            f"but is {type(solver).__name__}."
        )
    if controller is not None:
        steps = saves if saves > 1 else steps
    # tolerances are numbers like any other: one compiled program serves them all
    numbers, controller = eqx.partition(controller, lambda leaf: isinstance(leaf, float))
    if is_traced((scene, start)):
        states, taken = _simulate(scene, start, steps, solver, saves, periods, adjoint, controller, numbers)
    elif saves == 1 and isinstance(adjoint, diffrax.ForwardMode):
        # nothing is stored between the ends of the periods, so one compiled program serves any number of steps
        states, taken = _strobe_jit(scene, start, float(steps), solver, saves, periods, adjoint, controller, numbers)
    else:
        states, taken = _simulate_jit(scene, start, steps, solver, saves, periods, adjoint, controller, numbers)
    return Trajectory(scene, jnp.arange(periods * saves + 1) / saves, states, steps, taken)


def step_plan(scene: Scene, steps: int | None, saves: int | None) -> tuple[int, int]:
    """Integration steps and saves per period from what the caller gave; the second divides the first."""
    if saves is not None:
        saves = whole("saves_per_period", saves, 1)
    if steps is None:
        saves = 50 if saves is None else saves
        return -(-default_steps_per_period(scene) // saves) * saves, saves
    steps = whole("steps_per_period", steps, 1)
    if saves is None:
        return steps, (50 if steps % 50 == 0 else steps)
    if steps % saves:
        raise ValueError(f"Argument `saves_per_period` must divide steps_per_period = {steps}, but is {saves}.")
    return steps, saves


def check_start(start: Any) -> Motion:
    """`start` as a motion of finite numbers; raises `ValueError` otherwise."""
    if not isinstance(start, Motion):
        raise ValueError(f"Argument `start` must be a slipperjax.Motion, but is {start!r}.")
    for name, value in vars(start).items():
        if not isinstance(value, jax.core.Tracer) and not np.all(np.isfinite(value)):
            raise ValueError(f"Argument `start` must be finite, but its {name} is {value}.")
    return start


def _simulate(scene, start, steps, solver, saves, periods, adjoint, controller, numbers):
    controller = eqx.combine(controller, numbers)
    state = initial_state(scene, start)
    record = None if saves == 1 else _every(steps // saves)
    options = dict(solver=solver, steps=steps, periods=periods, record=record, adjoint=adjoint, controller=controller)
    _, kept, taken = integrate_counted(scene, state, **options)
    if saves > 1:
        kept = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), kept)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, kept), taken


@functools.cache
def _every(stride: int) -> Record:
    return lambda states, args, steps: jax.tree.map(lambda a: a[stride::stride], states)


_simulate_jit = jit(_simulate, static_argnums=(2, 3, 4, 5, 6, 7))
_strobe_jit = jit(_simulate, static_argnums=(3, 4, 5, 6, 7))
