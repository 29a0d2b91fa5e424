"""LocalExponents Lyapunov exponents of a chunk of cases, block by block."""

from typing import NamedTuple

import diffrax
import numpy as np
from jaxtyping import Float, Int

from ..flow.period_map import advance_tangents, initial_tangents
from ..flow.simulate import dynamic_steps
from ..flow.status import first_problem
from ..model.dynamics import State
from ..model.scene import Scene
from ..tools.batching import Batched
from .run import OnProgress

BLOCK = 20
"""Forcing periods in one call; the first such block turns the tangents into their directions and is not counted."""
LAST = 200
"""Forcing periods at the end of a record from which a motion is classified."""


def tangents_cost(count: int) -> float:
    """Cost of a period with `count` tangents, in unrecorded ones: measured 2.1 to 2.9 with one, 5.7 with three."""
    return 1.0 + 1.6 * count


def measured_periods(blocks: int) -> int:
    """Forcing periods of a measurement of which `blocks` count."""
    return BLOCK * (blocks + 1)


class LocalExponents(NamedTuple):
    """LocalExponents exponents of a chunk."""

    history: Float[np.ndarray, "cases periods count"]
    status: Int[np.ndarray, " cases"]
    strobe: Float[np.ndarray, "cases last 10"]
    """States once per period in the last `LAST` counted periods, or in all if they are fewer."""
    state: State
    """The states at the end."""


class Measure(NamedTuple):
    """A measurement of exponents of a chunk, from its states at the start of the period `epoch`."""

    solver: diffrax.AbstractSolver
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

    def __call__(self, steps: int, count: int) -> LocalExponents:
        """Measures local exponents with `steps` per period."""
        states, tangents = self.states, initial_tangents(self.scenes, self.states, count)
        weight = tangents_cost(count) * steps / self.steps
        rows, strobes, status = [], [], np.zeros(len(states.motion.y), int)
        for k in range(self.blocks + 1):
            at = self.epoch + k * BLOCK
            states, tangents, history, strobe, codes = advance_tangents(
                self.scenes, states, tangents, at, dynamic_steps(steps), solver=self.solver, periods=BLOCK
            )
            rows.append(np.asarray(history))
            strobes = [*strobes, np.asarray(strobe)][-LAST // BLOCK :] if k else []
            status = first_problem(status, codes)
            self.on_progress(weight * BLOCK)
        return LocalExponents(np.concatenate(rows[1:], axis=1), status, np.concatenate(strobes, axis=1), states)
