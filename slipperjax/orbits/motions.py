"""Orbits of slippers as equations: the period map over parameters, and states whose memory fits their gaps."""

from typing import Any

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
from ..tools.compile import is_traced


class ScenePath(eqx.Module):
    """The period map of a scene for values of some of its parameters."""

    scene: Scene
    stepping: AbstractStepping
    names: tuple[str, ...] = eqx.field(static=True)
    """Parameters by name or path; without any, the scene's own map."""
    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def __call__(self, *values: Any) -> PeriodMap:
        return PeriodMap(at_values(self.scene, self.names, values), self.stepping, self.solver)


def slipper_motions(
    scene: Scene,
    names: tuple[str, ...],
    reach: Any,
    like: State,
    *,
    stepping: AbstractStepping,
    solver: diffrax.AbstractSolver,
    period: int,
    share: float = 1.0,
) -> PeriodicMotions:
    """Return the equations of orbits over some parameters, with changes `reach` that count as one.

    Lengths of curves are measured by the parameters and, with a weight of `share`, by the motion. Where the
    derivatives of the period map jump, the motion at a fold jumps in proportion, by up to 1e-2 of its scale, and the
    parameters by the square of that. So curves of events are measured by the parameters first of all; the motion
    counts at cusps, where the curve of the parameters has no direction.
    """
    path = ScenePath(scene, stepping, names, solver)
    # the residual counts as a tangent does
    scale = tangent_weights(scene)
    size = sum(map(np.size, jax.tree.leaves(like)))
    motion = len(MOTION_NUMBERS)
    # of a state's numbers, the memory's come after the motion's, and do not count
    lengths = jnp.full(size, jnp.inf).at[:motion].set(np.sqrt(motion) / share)
    return PeriodicMotions(path, like, jnp.asarray(reach, float), scale, period, consistent_state, lengths)


def consistent_memory(scene: Scene, proposed: State, mapped: State) -> State:
    """Return the memory of a proposed state fit its gaps: zero where open, latched where just closed. Pure.

    **Arguments:** `mapped`: what the last iterate is mapped to.
    """
    if not scene.latches_memory:
        return proposed
    # those of this scene
    assert proposed.memory is not None
    assert mapped.memory is not None
    now = contacts(rail_frame(scene, 0.0), proposed.motion)
    fresh = scene.memory.initial(now.gap, now.rate)
    # of a contact that was open at the section, the memory latched since is better than that of a fresh start
    memory = jnp.where(
        proposed.memory < 0,
        proposed.memory,
        jnp.where(
            mapped.memory < 0,
            mapped.memory,
            fresh,
        ),
    )
    return State(proposed.motion, jnp.where(now.gap < 0, memory, 0.0))


def consistent_state(step: PeriodMap, proposed: State, mapped: State) -> State:
    """Return a proposed state consistent, see `slipperjax.analysis.shoot`."""
    return consistent_memory(step.scene, proposed, mapped)


def check_forcing(scene: Scene) -> None:
    """Raise `ValueError` for a track that does not recur with the forcing period, unless it is traced, and for a
    speed that changes."""
    if not is_traced(scene.track):
        need = "have a track that recurs with the forcing period"
        with jax.ensure_compile_time_eval():  # inside jit, too
            recurrence = float(scene.recurrence)
        require(recurrence == 1, "scene", need, scene.track)
    check_steady(scene)


def recurs(scene: Scene) -> Bool[Array, ""]:
    """Return whether a scene's track recurs with the forcing period."""
    return (scene.recurrence == 1) & (not isinstance(scene.speed, SpeedProgramme))
