"""Equations of a slipper's orbits: the period map over parameters, and states with a memory that fits their gaps."""

import dataclasses

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..analysis.shooting import PeriodicMotions
from ..flow.period_map import PeriodMap, tangent_weights
from ..flow.stepping import AbstractStepping
from ..model.dynamics import State
from ..model.kinematics import contacts, rail_frame
from ..model.parameters import at_values
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene, check_steady
from ..model.travel import SpeedProgramme
from ..tools.checks import require
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from .simulate import dynamic_steps

WIDTH = 0.01
"""Half the weighted width of differences for second and third derivatives of the period map. At the flip at 1095.9
m/s three times this width reaches other touchdowns."""


class ScenePath(eqx.Module):
    """Function from values of some parameters of a scene to its period map."""

    scene: Scene
    stepping: AbstractStepping
    names: tuple[str, ...] = eqx.field(static=True)
    """Names or paths of the parameters."""
    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def __call__(self, *values: Real) -> PeriodMap:
        return PeriodMap(at_values(self.scene, self.names, values), self.stepping, self.solver)


def slipper_motions(
    scene: Scene,
    names: tuple[str, ...],
    reach: Numbers,
    like: State,
    *,
    stepping: AbstractStepping,
    solver: diffrax.AbstractSolver,
    period: int,
    share: float = 1.0,
) -> PeriodicMotions:
    """Return the equations of orbits over some parameters.

    **Arguments:** `reach`: change of each parameter that counts as a length of one; `share`: weight of the motion in
    lengths. For curves of events the share should be small. Where the derivatives of the period map jump, the motion
    at a fold jumps in proportion, by up to 1e-2 of its scale, but the parameters jump only by the square of this. The
    share should not be zero: at a cusp the parameters alone give the curve no direction.
    """
    path = ScenePath(scene, stepping, names, solver)
    # the memory, which follows the motion in a state, does not count in lengths
    size = sum(map(np.size, jax.tree.leaves(like)))
    motion = len(MOTION_NUMBERS)
    lengths = jnp.full(size, jnp.inf).at[:motion].set(np.sqrt(motion) / share)
    scale = tangent_weights(scene)
    reach = jnp.asarray(reach, float)
    # Between touchdowns and openings the motion is smooth, and so are their instants: the exact map has all
    # derivatives. But a touchdown falls somewhere within a step, so that the error of the step, of order h^2.5, has
    # third derivatives that grow as h^-0.5. Differences wider than a step do not see this.
    return PeriodicMotions(path, like, reach, scale, period, consistent_state, lengths, derivatives=3, width=WIDTH)


def with_steps(motions: PeriodicMotions, steps: int, most: int | None = None) -> PeriodicMotions:
    """Return the equations of a slipper's orbits with another number of steps; `most`: as for `dynamic_steps`."""
    family = dataclasses.replace(motions.family, stepping=dynamic_steps(steps, most=most))  # type: ignore[type-var]
    return dataclasses.replace(motions, family=family)


def consistent_memory(scene: Scene, proposed: State, mapped: State) -> State:
    """Return a proposed state with a memory that fits its gaps: zero where open, latched where just closed. Pure.

    **Arguments:** `mapped`: the state to which the map takes the last iterate.
    """
    if not scene.latches_memory:
        return proposed
    # those of this scene
    assert proposed.memory is not None
    assert mapped.memory is not None
    now = contacts(rail_frame(scene, 0.0), proposed.motion)
    fresh = scene.contact_memory.initial(now.gap, now.rate)
    # For a contact that was open, the rate latched during the period is a better guess than a fresh start's rate.
    latched = jnp.where(mapped.memory < 0, mapped.memory, fresh)
    memory = jnp.where(proposed.memory < 0, proposed.memory, latched)
    return State(proposed.motion, jnp.where(now.gap < 0, memory, 0.0))


def consistent_state(step: PeriodMap, proposed: State, mapped: State) -> State:
    """Return a proposed state made consistent, see `slipperjax.analysis.shoot`."""
    return consistent_memory(step.scene, proposed, mapped)


def check_forcing(scene: Scene) -> None:
    """Raise `ValueError` unless the forcing is periodic: constant speed, and a rail that recurs with the forcing
    period (not checked where traced)."""
    check_steady(scene)
    require(scene.beam is None, "scene", "have rigid rails for an orbit", scene.beam)
    if not is_traced(scene.track):
        need = "have a track that recurs with the forcing period"
        with jax.ensure_compile_time_eval():  # inside jit, too
            recurrence = float(scene.recurrence)
        require(recurrence == 1, "scene", need, scene.track)


def recurs(scene: Scene) -> Bool[Array, ""]:
    """Return whether a scene's track recurs with the forcing period."""
    return (scene.recurrence == 1) & (not isinstance(scene.speed, SpeedProgramme))
