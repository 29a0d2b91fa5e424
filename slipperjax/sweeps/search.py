"""Periodic orbits of many cases at once, by Newton's method with Broyden's updates.

Each iteration integrates one proposal of every case that goes on, whatever it needs: a full step, a halved one, or
one after a new Jacobian. So no case waits for another one's line search, and cases that are done cost nothing.
"""

import functools
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..flow import Status, advance, batch_jacobians, flexible_steps, status_of, tangent_weights
from ..model import Scene, State
from ..orbits import Settled
from ..tools import Batched, jit
from .cases import filled
from .measure import JACOBIAN
from .plan import OnProgress

HALVINGS = 5
"""How often a step is halved before it is taken whatever it gives."""
FALL = 0.1
"""Share of a step by which the residual must fall for the step to be taken."""
SLOW = 0.3
"""Share of the residual that may be left after a step; where more is left, the Jacobian is computed anew."""
MOST_JACOBIANS = 6
"""Jacobians of a case after which it counts as without an orbit."""


class Orbits(NamedTuple):
    """Periodic orbits of many cases, as far as they were found."""

    state: State
    """At the start of a forcing period."""
    residual: Float[np.ndarray, " cases"]
    """Greatest scaled component of what a state misses after the period [1]."""
    iterations: Int[np.ndarray, " cases"]
    matrices: Float[np.ndarray, "cases period size size"]
    """Jacobians of the successive forcing periods."""
    status: Int[np.ndarray, " cases"]
    """`Status` codes."""


def rows_of(states: State) -> Float[np.ndarray, "cases size"]:
    """States with a leading axis of cases as rows of all their numbers."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(states)]
    return np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)


class _Maps(NamedTuple):
    """The period map and its derivatives, for some of the cases."""

    scenes: Batched[Scene]
    like: State
    steps: int
    solver: diffrax.AbstractSolver
    period: int
    on_progress: OnProgress

    def states(self, rows: np.ndarray) -> State:
        """Rows of numbers as states."""
        leaves, structure = jax.tree.flatten(self.like)
        ends = np.cumsum([np.size(leaf[0]) for leaf in leaves])
        parts = np.split(rows, ends[:-1], axis=1)
        shaped = [part.reshape(len(rows), *np.shape(leaf)[1:]) for part, leaf in zip(parts, leaves, strict=True)]
        return jax.tree.unflatten(structure, shaped)

    def of(self, index: np.ndarray, rows: np.ndarray) -> tuple[Batched[Scene], State]:
        """Scenes and states of some cases, filled up to one of few sizes, each of which needs compiled programs."""
        size = next(n for n in (8 * 4**k for k in range(30)) if n >= len(index))
        more = filled(np.arange(len(index)), min(size, len(self.like.motion.y)))
        return self.scenes.take(index[more]), self.states(rows[more])

    def mapped(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """States after the period."""
        scenes, states = self.of(index, rows)
        options: dict[str, Any] = dict(solver=self.solver, periods=self.period)
        end = advance(scenes, states, 0.0, flexible_steps(self.steps), **options).state
        self.on_progress(self.period * len(index) / len(self.like.motion.y))
        return rows_of(end)[: len(index)]

    def jacobians(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Jacobians of the forcing periods."""
        scenes, states = self.of(index, rows)
        options: dict[str, Any] = dict(solver=self.solver, periods=self.period)
        found = np.asarray(batch_jacobians(scenes, states, 0.0, flexible_steps(self.steps), **options))
        self.on_progress(JACOBIAN * self.period * len(index) / len(self.like.motion.y))
        return found[: len(index)]

    def settled(self, index: np.ndarray, proposed: np.ndarray, mapped: np.ndarray) -> np.ndarray:
        """Proposed states that the latch agrees with."""
        scenes, states = self.of(index, proposed)
        return rows_of(_settled(scenes, states, self.of(index, mapped)[1]))[: len(index)]

    def weights(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Weights of the components of states."""
        return rows_of(_weights(*self.of(index, rows)))[: len(index)]


@jit
def _settled(scenes: Batched[Scene], proposed: State, mapped: State) -> State:
    return scenes.map(lambda scene, p, m: Settled(scene)(p, m), proposed, mapped)


@jit
def _weights(scenes: Batched[Scene], states: State) -> State:
    def one(scene, state):
        found = tangent_weights(scene)(state)
        return jax.tree.map(lambda s, w: jnp.broadcast_to(jnp.asarray(w, float), s.shape), state, found)

    return scenes.map(one, states)


@jit
def _statuses(states: State) -> jax.Array:
    return jax.vmap(status_of)(states)


def find_orbits(
    scenes: Batched[Scene],
    states: State,
    steps: int,
    *,
    solver: diffrax.AbstractSolver,
    period: int,
    tolerance: float,
    max_iterations: int,
    on_progress: OnProgress,
) -> Orbits:
    """The orbits near some states of a batch, each by Newton's method; see `Orbits.status` for what became of them.

    **Arguments:** `states`: with a leading axis of cases; `period`: forcing periods after which the orbits recur;
    `steps`: per forcing period.
    """
    maps = _Maps(scenes, states, steps, solver, period, on_progress)
    x = rows_of(states)
    everyone = np.arange(len(x))
    miss = maps.mapped(everyone, x) - x
    size = _sizes(miss, maps.weights(everyone, x))
    share, count, jacobians = np.ones(len(x)), np.zeros(len(x), int), np.zeros(len(x), int)
    inverse, stale = np.zeros((len(x), x.shape[1], x.shape[1])), np.ones(len(x), bool)
    while True:
        going = np.isfinite(size) & (size > tolerance) & (count < max_iterations)
        going &= ~(stale & (jacobians >= MOST_JACOBIANS))
        if not going.any():
            break
        fresh = np.flatnonzero(going & stale)
        if len(fresh):
            inverse[fresh] = _inverses(maps.jacobians(fresh, x[fresh]))
            jacobians[fresh] += 1
            stale[fresh], share[fresh] = False, 1.0
        now = np.flatnonzero(going)
        direction = np.einsum("kij,kj->ki", inverse[now], miss[now])
        proposed = maps.settled(now, x[now] + share[now, None] * direction, x[now] + miss[now])
        weights = maps.weights(now, proposed)
        new_miss = maps.mapped(now, proposed) - proposed
        new_size = _sizes(new_miss, weights)
        count[now] += 1
        last = share[now] <= 0.5**HALVINGS
        good = (new_size <= (1 - FALL * share[now]) * size[now]) | (last & np.isfinite(new_size))
        some = now[good]
        moved, fell = proposed[good] - x[some], miss[some] - new_miss[good]
        inverse[some] = _broyden(inverse[some], moved, fell, weights[good])
        stale[some] = new_size[good] > SLOW * size[some]
        x[some], miss[some], size[some], share[some] = proposed[good], new_miss[good], new_size[good], 1.0
        share[now[~good]] /= 2
        count[now[~good & last]] = max_iterations  # every step leaves the finite numbers
    status = np.asarray(_statuses(maps.states(x)))
    status = np.where((status == Status.FINITE) & ~(size <= tolerance), int(Status.NO_ORBIT), status)
    matrices = np.full((len(x), period, x.shape[1], x.shape[1]), np.nan)
    found = np.flatnonzero(status == Status.FINITE)
    if len(found):
        matrices[found] = maps.jacobians(found, x[found])
        # one more step by the Jacobian at hand
        inverse[found] = _inverses(matrices[found])
        x[found] += np.einsum("kij,kj->ki", inverse[found], miss[found])
    return Orbits(maps.states(x), size, count, matrices, status)


def _sizes(miss: np.ndarray, weights: np.ndarray) -> np.ndarray:
    seen = np.max(np.abs(np.where(weights > 0, weights * miss, 0.0)), axis=1)
    return np.where(np.all(np.isfinite(miss), axis=1), seen, np.inf)


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses of I - P_x, from the Jacobians of successive periods; NaN where they are not finite."""
    whole = functools.reduce(lambda total, later: later @ total, np.moveaxis(matrices, 1, 0))
    system = np.eye(whole.shape[-1]) - whole
    finite = np.all(np.isfinite(system), axis=(1, 2))
    found = np.full_like(system, np.nan)
    # the pseudo-inverse is defined at folds, too
    found[finite] = np.linalg.pinv(system[finite], rcond=1e-14)
    return found


def _broyden(inverse: np.ndarray, moved: np.ndarray, fell: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Inverses that map what the residuals fell by to the steps, otherwise as before."""
    row = np.einsum("ki,kij->kj", weights**2 * moved, inverse)
    share = np.einsum("ki,ki->k", row, fell)
    left = moved - np.einsum("kij,kj->ki", inverse, fell)
    return inverse + left[:, :, None] * row[:, None, :] / np.where(share == 0, np.inf, share)[:, None, None]
