"""Periodic orbits of many cases at once, by Newton's method with Broyden's updates.

Each iteration integrates one proposal of every unfinished case: a full step, a halved step, or a step with a new
Jacobian. Therefore no case waits for the line search of another case, and finished cases cost nothing.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int, PyTree

from ..analysis.floquet import circle_error, multipliers
from ..analysis.newton import LEAST_FALL
from ..flow.numbers import ContactChecks, judged_by_contacts
from ..flow.period_map import advance, batch_jacobians, tangent_weights
from ..flow.record import Labelled, RecordSet
from ..flow.status import Status, first_problem, judge_states, most_stability_number
from ..flow.stepping import ConstantSteps
from ..model.dynamics import State
from ..model.layout import StateLayout, coordinates
from ..model.quantities import COORDINATES
from ..model.scene import Scene
from ..orbits.motions import check_forcing, consistent_memory
from ..orbits.periodic import MOST_PERIOD, TOLERANCE
from ..orbits.simulate import dynamic_steps
from ..tools.batching import Batched
from ..tools.checks import number, positive, whole
from ..tools.columns import column
from ..tools.compile import as_argument, jit
from .plan import AbstractStage, OnProgress, Part
from .schedule import FEW

# --- period maps of some cases of a batch, by programs of one size for all numbers of cases -------------------------

rows_of = StateLayout.pack


class Maps(NamedTuple):
    """Period maps of the cases of a batch, each over its own number of forcing periods.

    `index` gives cases by their places in the batch, and `rows` their states as rows of numbers. Each period is one
    call, as in the Jacobian. Therefore cases of different periods share programs, and solvers restart in the same
    way.
    """

    scenes: Batched[Scene]
    steps: int  # per forcing period
    solver: diffrax.AbstractSolver
    periods: Int[np.ndarray, " cases"]  # forcing periods of each case's map
    on_progress: OnProgress
    epoch: float = 0.0  # forcing period at which the maps begin

    @classmethod
    def of(cls, part: Part, periods: Int[np.ndarray, " cases"], epoch: float | None = None) -> "Maps":
        """Return maps of the cases of a chunk, by default from the beginning of its plan."""
        epoch = part.plan.epoch if epoch is None else epoch
        return cls(part.scenes, part.steps, part.plan.solver, periods, part.on_progress, epoch)

    def states(self, rows: np.ndarray) -> State:
        """Return rows of numbers as states."""
        return StateLayout.of(self.scenes.shared).unpack(rows)

    def mapped(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the states after each case's period."""
        _, end = self.path(index, rows)
        return end

    def path(self, index: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the states at the start of each forcing period, (cases, periods, size), and after the last period.

        After a case's own period its last row is repeated.
        """
        along = []
        rows = rows.copy()
        for k in range(self.periods[index].max(initial=1)):
            along.append(rows.copy())
            # a case whose map is complete does not move
            going = np.flatnonzero(self.periods[index] > k)
            rows[going] = self._of_states(
                lambda scenes, states, at=self.epoch + k: advance(scenes, states, at, periods=1, **self._how).state,
                index[going],
                rows[going],
            )
            self.on_progress(0)
        return np.stack(along, axis=1), rows

    def jacobians(self, index: np.ndarray, rows: np.ndarray) -> list[np.ndarray]:
        """Return the Jacobians of each forcing period of each case, (period, size, size), for recurring forcings."""
        if not len(index):
            return []
        along, _ = self.path(index, rows)
        counts = self.periods[index]
        # the periods of all cases at once, because few cases have many periods
        lane, period = np.nonzero(np.arange(along.shape[1]) < counts[:, None])
        derived = lambda scenes, states: batch_jacobians(scenes, states, self.epoch, **self._how)
        matrices = self._of_states(derived, index[lane], along[lane, period])
        self.on_progress(0)
        return np.split(matrices, np.cumsum(counts)[:-1])

    def settled(self, index: np.ndarray, proposed: np.ndarray, mapped: np.ndarray) -> np.ndarray:
        """Return proposed states with a consistent contact memory, from the memory of `mapped`."""
        return self._of_states(_settled, index, proposed, mapped)

    def weights(self, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the weights that scale components of states [1/unit]; 0 for components that do not count."""
        return self._of_states(_weights, index, rows)

    def contact_status(self, index: np.ndarray, rows: np.ndarray, capacity: int) -> Int[np.ndarray, " some"]:
        """Return `Status` codes of states, from the contact loads of some periods after them.

        **Arguments:** `capacity`: steps per period for which the program has places, of `Plan.capacities`.
        """
        stepping = ConstantSteps(capacity, as_argument(self.steps))
        how = dict(records=RecordSet((ContactChecks(),)), solver=self.solver, periods=FEW)

        def judged(scenes: Batched[Scene], states: State) -> Int[Array, " some"]:
            seen = advance(scenes, states, self.epoch, stepping, **how)
            return judged_by_contacts(scenes, seen.status, *seen.carried, most_stability_number(self.solver))

        return self._of_states(judged, index, rows)

    @property
    def _how(self) -> dict[str, object]:
        """Options with which programs integrate a period without records."""
        return dict(stepping=dynamic_steps(self.steps), solver=self.solver)

    def _of_states(self, call: Callable[..., PyTree], index: np.ndarray, *rows: np.ndarray) -> np.ndarray:
        """Return the array, or the rows of states, that `call(scenes, *states)` gives for the cases."""

        def of_rows(scenes: Batched[Scene], *rows: np.ndarray) -> PyTree:
            made = call(scenes, *map(self.states, rows))
            return rows_of(made) if isinstance(made, State) else made

        return self.of_blocks(of_rows, index, *rows)

    def of_blocks(self, call: Callable[..., PyTree], index: np.ndarray, *arrays: PyTree) -> PyTree:
        """Return the arrays that `call(scenes, *arrays)` gives for the cases, in blocks of one size.

        **Arguments:** `arrays`: with an axis of the cases at `index`.
        """
        if not len(index):
            return np.empty((0, *arrays[0].shape[1:]))
        # a program of another size takes as long to compile as hundreds of Jacobians take to compute
        size = 32 if len(self.periods) > 8 else 8
        parts = []
        for first in range(0, len(index), size):
            # copies of the last case fill up the last block
            lanes = np.minimum(np.arange(first, first + size), len(index) - 1)
            of_lanes = jax.tree.map(operator.itemgetter(lanes), arrays)
            parts.append(jax.tree.map(np.asarray, call(self.scenes.take(index[lanes]), *of_lanes)))
        return jax.tree.map(lambda *of: np.concatenate(of)[: len(index)], *parts)


# Functions of the module, so that each is compiled once, and not once for each instance of `Maps`.


@jit
def _settled(scenes: Batched[Scene], proposed: State, mapped: State) -> State:
    return scenes.map(consistent_memory, proposed, mapped)


@jit
def _weights(scenes: Batched[Scene], states: State) -> State:
    def one(scene, state):
        weights = tangent_weights(scene)(state)
        return jax.tree.map(
            lambda s, w: jnp.broadcast_to(jnp.asarray(w, float), s.shape),
            state,
            weights,
        )

    return scenes.map(one, states)


@jit
def _statuses(states: State) -> jax.Array:
    return jax.vmap(judge_states)(states)


# --- Newton's method ------------------------------------------------------------------------------------------------

# `analysis.newton` under `jax.vmap` would compute a Jacobian at each point, for all cases until the last is done. On
# 16 speeds Broyden's updates needed 3.6 iterations with two Jacobians, 74 periods; `analysis.newton` needed five
# iterations, 175 periods.


class Orbits(NamedTuple):
    """Periodic orbits of many cases, as far as they were found."""

    state: State  # at the start of a forcing period
    residual: Float[np.ndarray, " cases"]  # greatest scaled component of the change of a state over the period [1]
    iterations: Int[np.ndarray, " cases"]
    jacobians: Int[np.ndarray, " cases"]  # number of computed Jacobians, including the orbit's
    # Multipliers over the orbit's period, the largest modulus first [1]; NaN where there is no orbit.
    multipliers: Complex[np.ndarray, "cases size"]
    # Logarithm of the greatest growth of a scaled tangent in one forcing period [1]; NaN without an orbit.
    growth: Float[np.ndarray, " cases"]
    # Inverse of I - P_x, with P_x the Jacobian over the orbit's period, for its derivatives; NaN without an orbit.
    inverse: Float[np.ndarray, "cases size size"]
    status: Int[np.ndarray, " cases"]  # `Status` codes

    @property
    def stable(self) -> np.ndarray:
        """Whether all multipliers are inside the unit circle by more than their errors: the orbit attracts."""
        return np.abs(self.multipliers[:, 0]) < 1 - circle_error(self.multipliers)


HALVINGS = 5
"""Number of halvings after which a step is taken even if the residual rises."""
SLOW = 0.3
"""Greatest share of the residual that may be left after a step; above it the Jacobian is computed again."""
MOST_JACOBIANS = 6
"""Number of Jacobians of a case after which its search ends without success."""


def find_orbits(
    maps: Maps,
    states: State,
    *,
    tolerance: float,
    max_iterations: int,
    inverse: Float[np.ndarray, "cases size size"] | None = None,
) -> Orbits:
    """Find the orbit near each state of a batch by Newton's method; see `Orbits.status` for the outcome.

    **Arguments:** `maps`: over the periods after which the orbits recur, 0 for cases without a search; `states`: with
    a leading axis of cases; `inverse`: guesses of `Orbits.inverse`, for example of neighbours, NaN without a guess.
    """
    rows = rows_of(states)
    cases, size = rows.shape
    miss = np.zeros_like(rows)
    residual = np.full(cases, np.inf)
    share = np.ones(cases)  # of the full step, for the next try
    iterations = np.zeros(cases, int)
    jacobians = np.zeros(cases, int)
    inverse = np.full((cases, size, size), np.nan) if inverse is None else inverse.copy()
    # whether the Jacobian is computed again before the next step
    stale = ~np.all(np.isfinite(inverse), axis=(1, 2))
    # a case without a search keeps an infinite residual, so that it never continues
    wanted = np.flatnonzero(maps.periods)
    miss[wanted] = maps.mapped(wanted, rows[wanted]) - rows[wanted]
    residual[wanted] = _residuals(miss[wanted], maps.weights(wanted, rows[wanted]))
    while True:
        going = (residual > tolerance) & (residual < np.inf) & (iterations < max_iterations)
        index = np.flatnonzero(going & ~(stale & (jacobians >= MOST_JACOBIANS)))
        if not len(index):
            break
        renewed = index[stale[index]]
        if len(renewed):
            inverse[renewed] = _inverses(maps.jacobians(renewed, rows[renewed]))
            jacobians[renewed] += 1
            stale[renewed] = False
            share[renewed] = 1.0
        # a step is taken where the residual falls enough, or after `HALVINGS`
        before = rows[index]
        fraction = share[index]
        direction = np.einsum("kij,kj->ki", inverse[index], miss[index])
        proposed = maps.settled(index, before + fraction[:, None] * direction, before + miss[index])
        weights = maps.weights(index, proposed)
        new_miss = maps.mapped(index, proposed) - proposed
        new_residual = _residuals(new_miss, weights)
        iterations[index] += 1
        last = fraction <= 0.5**HALVINGS
        # the fall that the share of a full step promises, as in `analysis.newton`
        good = (new_residual <= (1 - LEAST_FALL * fraction) * residual[index]) | (last & np.isfinite(new_residual))
        taken = index[good]
        moved = (proposed - before)[good]
        fell = miss[taken] - new_miss[good]
        inverse[taken] = _broyden(inverse[taken], moved, fell, weights[good])
        stale[taken] = new_residual[good] > SLOW * residual[taken]
        rows[taken] = proposed[good]
        miss[taken] = new_miss[good]
        residual[taken] = new_residual[good]
        share[taken] = 1.0
        share[index[~good]] /= 2
        iterations[index[~good & last]] = max_iterations  # all its steps lead to NaN: the search ends
    found = np.where(residual <= tolerance, int(Status.FINITE), int(Status.NO_ORBIT))
    status = first_problem(_statuses(maps.states(rows)), found)
    mu = np.full(rows.shape, np.nan + 0j)
    growth = np.full(cases, np.nan)
    on_orbit = np.flatnonzero(status == Status.FINITE)
    if len(on_orbit):
        matrices = maps.jacobians(on_orbit, rows[on_orbit])
        jacobians[on_orbit] += 1
        mu[on_orbit] = [multipliers(of_periods) for of_periods in matrices]
        scales = maps.weights(on_orbit, rows[on_orbit])
        growth[on_orbit] = [_growth(*both) for both in zip(matrices, scales, strict=True)]
        inverse[on_orbit] = _inverses(matrices)
        # one more step with this Jacobian costs nothing, and squares the small error
        rows[on_orbit] += np.einsum("kij,kj->ki", inverse[on_orbit], miss[on_orbit])
    inverse[status != Status.FINITE] = np.nan
    return Orbits(maps.states(rows), residual, iterations, jacobians, mu, growth, inverse, status)


def _growth(matrices: np.ndarray, weights: np.ndarray) -> float:
    """Return the logarithm of the greatest growth of a scaled tangent in any of a case's forcing periods."""
    used = weights > 0
    scaled = (matrices * weights[:, None])[:, used][:, :, used] / weights[used]
    return float(np.log(np.max(np.linalg.norm(scaled, 2, axis=(1, 2)), initial=1e-300)))


def _residuals(miss: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the greatest scaled component of each state's change over its period; infinity for NaN."""
    greatest = np.max(np.abs(np.where(weights > 0, weights * miss, 0.0)), axis=1)
    return np.where(np.all(np.isfinite(miss), axis=1), greatest, np.inf)


def _inverses(matrices: Sequence[np.ndarray]) -> np.ndarray:
    """Return inverses of I - P_x, from the Jacobians of each case's successive periods; NaN without Jacobians."""
    whole = np.stack([functools.reduce(lambda total, later: later @ total, of_periods) for of_periods in matrices])
    system = np.eye(whole.shape[-1]) - whole
    finite = np.all(np.isfinite(system), axis=(1, 2))
    inverses = np.full_like(system, np.nan)
    # the pseudo-inverse also exists at folds
    inverses[finite] = np.linalg.pinv(system[finite], rcond=1e-14)
    return inverses


def _broyden(inverse: np.ndarray, moved: np.ndarray, fell: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return inverses that map the falls of the residuals to the steps, and otherwise change little."""
    # Broyden's first update; rows are scaled, because components of a state have several units
    row = np.einsum("ki,kij->kj", weights**2 * moved, inverse)
    share = np.einsum("ki,ki->k", row, fell)
    left = moved - np.einsum("kij,kj->ki", inverse, fell)
    return inverse + left[:, :, None] * row[:, None, :] / np.where(share == 0, np.inf, share)[:, None, None]


@dataclass(frozen=True)
class NearestOrbit(AbstractStage):
    """The periodic orbit near the end of each motion, by Newton's method, with its Floquet multipliers.

    Cases whose iterations end elsewhere get `Status.NO_ORBIT`.
    """

    period: int = 1
    """Forcing periods after which the orbits recur."""
    tolerance: float = TOLERANCE
    """Scaled residual that counts as found [1]."""
    max_iterations: int = 40

    def __post_init__(self):
        whole("period", self.period, 1, MOST_PERIOD)
        whole("max_iterations", self.max_iterations, 1)
        number(positive, "tolerance", self.tolerance)

    name = "orbits"
    least_settled = 1

    @property
    def measured(self) -> int:
        """Forcing periods over which each case is measured."""
        return self.period

    def over(self, periods: int) -> "NearestOrbit":
        """Return the same stage: the orbit's period does not depend on the length of the measurement."""
        return self

    @property
    def variables(self):
        names = ("orbit", "orbit_state", "multiplier_real", "multiplier_imag", "orbit_exponent", "stable")
        return (*names, "residual", "iterations")

    def values(self, scene, periods):
        return 150

    def check(self, scene, periods, steps):
        check_forcing(scene)

    def of_chunk(self, part, states, epoch, status, strobe):
        # no search for cases that already have a problem
        maps = Maps.of(part, np.where(part.good(status), self.period, 0))
        states = jax.tree.map(np.asarray, states)
        orbits = find_orbits(maps, states, tolerance=self.tolerance, max_iterations=self.max_iterations)
        return self.kept(part, maps, orbits), first_problem(status, orbits.status)

    def kept(self, part: Part, maps: Maps, orbits: Orbits) -> tuple[np.ndarray, ...]:
        """Return the kept values of a chunk's orbits, arrays (lanes, ...)."""
        start = coordinates(orbits.state)
        return start, rows_of(orbits.state), orbits.multipliers, orbits.residual, orbits.iterations

    def label(self, scene, dims, values) -> Labelled:
        strobe, state, mu, residual, iterations = values[:5]
        largest = np.abs(mu[..., 0])
        with np.errstate(divide="ignore"):  # ln of a multiplier of zero is minus infinity
            exponent = np.log(largest) / self.period
        stable = largest <= 1 + circle_error(mu)
        text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
        over = (*dims, "multiplier")
        return {
            "orbit": column(
                (*dims, "coordinate"),
                strobe,
                "",
                f"state at the start of a period: {text}",
            ),
            "orbit_state": column((*dims, "number"), state, "", "all numbers of the orbit's state"),
            "multiplier_real": column(over, mu.real, "1", "Floquet multipliers, real parts"),
            "multiplier_imag": column(over, mu.imag, "1", "Floquet multipliers, imaginary parts"),
            "orbit_exponent": column(
                dims,
                exponent,
                "1/period",
                "ln of the largest multiplier's modulus",
            ),
            "stable": column(dims, stable, "", "whether no multiplier lies outside the unit circle"),
            "residual": column(dims, residual, "1", "scaled residual"),
            "iterations": column(dims, iterations, "1", "iterations of Newton's method"),
        }, {"coordinate": list(COORDINATES)}
