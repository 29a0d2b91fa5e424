"""The period map of some cases of a batch, and its derivatives, by programs of one size for all numbers of cases."""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ..flow.period_map import advance, batch_jacobians, tangent_weights
from ..flow.record import RecordSet
from ..flow.records import ContactChecks, judged_by_contacts
from ..flow.simulate import dynamic_steps
from ..flow.status import most_stability_number, status_of
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.layout import StateLayout, coordinates
from ..model.scene import Scene
from ..orbits.motions import consistent_memory
from ..tools.batching import Batched
from ..tools.compile import jit
from .grid import filled
from .run import PERIODS_PER_CALL, OnProgress

JACOBIAN, LOOK = 35.0, 2.4
"""Cost of a period with its Jacobian, and with its loads, in unrecorded ones: measured."""
LANES_PER_CALL = 32
"""Cases in one call. A program of another size takes as long to compile as hundreds of Jacobians take to compute."""


rows_of = StateLayout.pack


class Maps(NamedTuple):
    """Maps over some forcing periods, each of one case of a batch. Cases are given by their places in it.

    Each period is a call of its own, so that cases of different periods share programs, and a solver that begins
    each differentiated period anew begins each mapped one anew.
    """

    scenes: Batched[Scene]
    steps: int
    """Per forcing period."""
    solver: diffrax.AbstractSolver
    periods: Int[np.ndarray, " cases"]
    """Forcing periods of each case's map."""
    on_progress: OnProgress
    epoch: float = 0.0
    """Forcing period at which the maps begin."""

    @property
    def count(self) -> int:
        """Cases of the batch."""
        return len(self.periods)

    def states(self, rows: np.ndarray) -> State:
        """Rows of numbers as states."""
        return StateLayout.of(self.scenes.shared).unpack(rows)

    def mapped(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """States after each case's period."""
        return self.path(index, rows)[1]

    def path(self, index: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States at the start of each forcing period, (cases, periods, size), and after the last.

        Beyond a case's own period its row after it is repeated.
        """
        along, rows = [], rows.copy()
        for k in range(self.periods[index].max(initial=1)):
            along.append(rows.copy())
            going = np.flatnonzero(self.periods[index] > k)
            rows[going] = self._of_blocks(self._advanced, index[going], rows[going], at=self.epoch + k)
            self.on_progress(len(going) / self.count)
        return np.stack(along, axis=1), rows

    def jacobians(self, index: np.ndarray, rows: np.ndarray) -> list[np.ndarray]:
        """Jacobians of each case's forcing periods, (period, size, size) each; for a forcing that recurs."""
        if not len(index):
            return []
        along, counts = self.path(index, rows)[0], self.periods[index]
        # the periods of all cases at once, because few cases have many
        lane, period = np.nonzero(np.arange(along.shape[1]) < counts[:, None])
        matrices = self._of_blocks(self._derived, index[lane], along[lane, period], at=self.epoch)
        self.on_progress(JACOBIAN * len(lane) / self.count)
        return np.split(matrices, np.cumsum(counts)[:-1])

    def settled(self, index: np.ndarray, proposed: np.ndarray, mapped: np.ndarray) -> np.ndarray:
        """Proposed states that the latch agrees with."""
        return self._of_blocks(lambda s, p, m: rows_of(_settled(s, p, m)), index, proposed, mapped)

    def weights(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Weights of the components of states."""
        return self._of_blocks(lambda *of: rows_of(_weights(*of)), index, rows)

    def coordinates(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Coordinates and velocities of states, in the order of `slipperjax.model.COORDINATES`."""
        return self._of_blocks(lambda _, states: coordinates(states), index, rows)

    def look(self, index: np.ndarray, rows: np.ndarray, capacity: int) -> Int[np.ndarray, " some"]:
        """Judges states by the contact loads of some periods from there on, as `Status` codes.

        **Arguments:** `capacity`: steps per period that the program has capacity for, of `Plan.capacity`.
        """
        codes = self._of_blocks(self._looked, index, rows, capacity=capacity)
        self.on_progress(LOOK * PERIODS_PER_CALL * len(index) / self.count)
        return codes

    def statuses(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """`Status` codes of states."""
        return self._of_blocks(lambda _, states: np.asarray(_statuses(states)), index, rows)

    @property
    def _once(self) -> dict[str, Any]:
        return dict(solver=self.solver, periods=1)

    @property
    def _looking(self) -> dict[str, Any]:
        return dict(solver=self.solver, periods=PERIODS_PER_CALL, records=RecordSet((ContactChecks(),)))

    def _stepping(self, capacity: int) -> ConstantSteps:
        return ConstantSteps(capacity, jnp.asarray(float(self.steps)))

    def _advanced(self, scenes: Batched[Scene], states: State, at: float) -> np.ndarray:
        return rows_of(advance(scenes, states, at, dynamic_steps(self.steps), **self._once).state)

    def _derived(self, scenes: Batched[Scene], states: State, at: float) -> np.ndarray:
        return np.asarray(batch_jacobians(scenes, states, at, dynamic_steps(self.steps), **self._once))[:, 0]

    def _looked(self, scenes: Batched[Scene], states: State, capacity: int) -> np.ndarray:
        seen = advance(scenes, states, self.epoch, self._stepping(capacity), **self._looking)
        return np.asarray(judged_by_contacts(scenes, seen.status, *seen.carried, most_stability_number(self.solver)))

    def _of_blocks(self, call: Any, index: np.ndarray, *rows: np.ndarray, **options: Any) -> np.ndarray:
        """`call(scenes, *states)` over the cases in blocks of one size."""
        if not len(index):
            return np.empty((0, *rows[0].shape[1:]))
        parts = []
        for count, more in self._blocks(index):
            parts.append(
                call(self.scenes.take(index[more]), *(self.states(r[more]) for r in rows), **options)[:count]
            )
        return np.concatenate(parts)

    def _blocks(self, index: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """How many of `index` are in each call, and their places in it, filled up to one size."""
        size = LANES_PER_CALL if self.count > 8 else 8
        parts = [np.arange(at, min(at + size, len(index))) for at in range(0, len(index), size)]
        return [(len(some), filled(some, size)) for some in parts]


@jit
def _settled(scenes: Batched[Scene], proposed: State, mapped: State) -> State:
    return scenes.map(consistent_memory, proposed, mapped)


@jit
def _weights(scenes: Batched[Scene], states: State) -> State:
    def one(scene, state):
        weights = tangent_weights(scene)(state)
        return jax.tree.map(lambda s, w: jnp.broadcast_to(jnp.asarray(w, float), s.shape), state, weights)

    return scenes.map(one, states)


@jit
def _statuses(states: State) -> jax.Array:
    return jax.vmap(status_of)(states)
