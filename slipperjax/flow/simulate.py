"""One scene, simulated: trajectories and the plain period map."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model import (
    Args,
    Motion,
    Reactions,
    Scene,
    State,
    default_steps_per_period,
    euler_angles,
    reactions,
    table_2_start,
)
from ..solvers import check_error_estimate, resolve_controller, resolve_solver
from ..tools import is_traced, jit, whole
from .period_map import PeriodMap, map_compiled, run_compiled
from .recorders import Samples, Strobe
from .status import status_of, with_resolution
from .stepping import ConstantSteps, ControlledSteps


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
    steps, periods = whole("steps_per_period", steps, 1), whole("periods", periods, 1)
    solver, controller = resolve_solver(scene, solver), resolve_controller(stepsize_controller)
    check_error_estimate(solver, controller)
    stepping = ConstantSteps(steps) if controller is None else _controlled(1, steps, controller, adjoint)
    return map_compiled(PeriodMap(scene, stepping, solver, periods), state)


def _controlled(
    samples: int, first_steps: int, controller: Any, adjoint: diffrax.AbstractAdjoint | None
) -> ControlledSteps:
    return ControlledSteps(samples, first_steps, controller, diffrax.ForwardMode() if adjoint is None else adjoint)


class Trajectory(eqx.Module):
    """A simulated motion, saved at constant intervals."""

    scene: Scene
    period: Float[Array, " saves"]
    """Time in forcing periods [1]."""
    state: State
    """The saved states, with a leading axis of saves."""
    steps_per_period: int = eqx.field(static=True)
    """Integration steps per forcing period; with adaptive steps, the number of states they were interpolated at."""
    steps_taken: Int[Array, " periods"]
    """Steps tried in each forcing period, those included that an adaptive controller rejected."""

    @property
    def time(self) -> Float[Array, " saves"]:
        """Time [s]."""
        return self.period * self.scene.period

    @property
    def status(self) -> Array:
        """0 where nothing is wrong, else see `slipperjax.flow.Status`."""
        return _judged(self.state, self.scene, jnp.min(self.steps_taken))

    @property
    def euler_angles(self) -> tuple[Array, Array, Array]:
        """Roll, pitch and yaw of Eq. (2) [rad]."""
        return _euler_angles(self.state.motion)

    @property
    def reactions(self) -> Reactions:
        """Contact forces, drive force, loads on the track nodes, accelerations; leading axis saves."""
        return _reactions(self.scene, self.period, self.state)

    def to_xarray(self):
        """The trajectory as an `xarray.Dataset` with units: see `slipperjax.flow.datasets.trajectory_dataset`."""
        from .datasets import trajectory_dataset

        return trajectory_dataset(self)


_euler_angles = jax.jit(jax.vmap(euler_angles))
_judged = jax.jit(lambda states, scene, steps: with_resolution(status_of(states), scene, steps))


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
    - `adjoint`: for a step size controller only, as constant steps can be differentiated in both modes: default
        `diffrax.ForwardMode()`, for `jax.jvp` and `jax.jacfwd`; `diffrax.RecursiveCheckpointAdjoint()` for
        `jax.grad`.

    **Returns:** a `Trajectory`, the start included.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    periods = whole("periods", periods, 1)
    steps, saves = step_plan(scene, steps_per_period, saves_per_period)
    solver = resolve_solver(scene, solver)
    start = table_2_start() if start is None else check_start(start)
    controller = resolve_controller(stepsize_controller)
    check_error_estimate(solver, controller)
    if controller is not None:
        stepping = _controlled(saves, steps, controller, adjoint)
        steps = saves if saves > 1 else steps
    elif saves == 1 and not is_traced((scene, start)):
        stepping = ConstantSteps(steps=jnp.asarray(float(steps)))  # one program serves any number of steps
    else:
        stepping = ConstantSteps(steps)
    recorder = Strobe() if saves == 1 else Samples(saves)
    first, passage = run_compiled(PeriodMap(scene, stepping, solver), start, periods, recorder)
    kept = passage.record if saves == 1 else recorder.collect(passage.record)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, kept)
    return Trajectory(scene, jnp.arange(periods * saves + 1) / saves, states, steps, passage.steps_taken)


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
