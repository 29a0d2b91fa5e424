"""Local exponents of a chunk of cases, from the states to which it settled."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..flow import (
    ConstantSteps,
    advance_tangents,
    first_problem,
    initial_tangents,
)
from ..model import Scene, State
from ..tools import Batched
from .plan import OnProgress, Plan

BLOCK = 20
"""Forcing periods in one call; the first such block turns the tangents into their directions and is not counted."""
LONGEST = 16
"""Longest period of a motion whose Floquet multipliers are computed, or whose orbit is looked for."""
LAST = 200
"""Forcing periods at the end of a record from which a motion is classified."""
PAIR, JACOBIAN, LOOK = 2.0, 35.0, 2.4
"""What a period of two trajectories, with its Jacobian, and with its loads costs, in plain ones: measured."""


def tangents_cost(count: int) -> float:
    """What a period with `count` tangents costs, in plain ones: measured 2.1 to 2.9 with one, 5.7 with three."""
    return 1.0 + 1.6 * count


def measured_periods(blocks: int) -> int:
    """Forcing periods of a measurement of which `blocks` count."""
    return BLOCK * (blocks + 1)


class Local(NamedTuple):
    """Local exponents of a chunk."""

    history: Float[np.ndarray, "cases periods count"]
    status: Int[np.ndarray, " cases"]
    strobe: Float[np.ndarray, "cases last 10"]
    """States once per period in the last `LAST` counted periods, or in all if they are fewer."""
    state: State
    """The states at the end."""


class Measure(NamedTuple):
    """Measures exponents of a chunk from its states at the start of the period `epoch`."""

    plan: Plan
    scenes: Batched[Scene]
    states: State
    epoch: float
    blocks: int
    """Blocks of `BLOCK` periods that count."""
    steps: int
    """Steps per period of those periods in which progress is counted."""
    on_progress: OnProgress

    @property
    def periods(self) -> int:
        """Forcing periods of one measurement, those in which tangents turn into their directions included."""
        return measured_periods(self.blocks)

    def __call__(self, steps: int, count: int, distance: float | None = None) -> Local:
        """Local exponents with `steps` per period; by differences to neighbours at `distance` if that is given."""
        states, tangents = self.states, initial_tangents(self.scenes, self.states, count)
        away = None if distance is None else jnp.asarray(distance)
        weight = (tangents_cost(count) if distance is None else PAIR) * steps / self.steps
        rows, strobes, status = [], [], np.zeros(len(states.motion.y), int)
        for k in range(self.blocks + 1):
            at = self.epoch + k * BLOCK
            states, tangents, history, strobe, codes = advance_tangents(
                self.scenes, states, tangents, at, _constant(steps), away, solver=self.plan.solver, periods=BLOCK
            )
            rows.append(np.asarray(history))
            strobes = [*strobes, np.asarray(strobe)][-LAST // BLOCK :] if k else []
            status = first_problem(status, codes)
            self.on_progress(weight * BLOCK)
        return Local(np.concatenate(rows[1:], axis=1), status, np.concatenate(strobes, axis=1), states)


def _constant(steps: int) -> ConstantSteps:
    """So many steps as an array: one compiled program serves every number."""
    return ConstantSteps(steps=jnp.asarray(float(steps)))
