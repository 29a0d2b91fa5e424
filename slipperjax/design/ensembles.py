"""Objectives and their derivatives where motions are irregular: regression over many short runs.

In chaos the derivative of one motion grows without bound, while an average over the attractor may change smoothly
with a parameter. Many runs with parameters at the corners of a small box, and disturbed starts, are one batch; each
gives the objective over its periods, and a plane through them gives the average and its derivatives with standard
errors. All corners have the same disturbances.
"""

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..flow.period_map import advance_tangents, initial_tangents, states_and_penetrations
from ..flow.record import RecordSet
from ..flow.records import AbstractNumber
from ..flow.simulate import dynamic_steps
from ..flow.status import Status, first_problem
from ..model.dynamics import State
from ..model.kinematics import MOTION_SCALES, Motion
from ..model.quantities import MOTION_NUMBERS
from ..model.scene import Scene
from ..sweeps.grid import Cases
from ..sweeps.records import LargestExponent
from ..sweeps.run import Calls, OnProgress, Part, Plan, run_cases, run_chunk
from ..tools.checks import whole
from .gradients import Objectives, period_values, totals
from .objectives import Objective

DISTURBED = 0.1
"""Standard deviation of the disturbances of the starts' velocities, in multiples of
`slipperjax.model.MOTION_SCALES`. Places are left as they are: they could lie outside the play."""
SETTLED = 20
"""Forcing periods in one call of tangents; in the first they turn into their directions."""
SURE = 0.5
"""Share of the runs that must stay on the rail."""


class Spread(NamedTuple):
    """How ensembles are made. The defaults give slopes to some 10 % where averages change by as much."""

    members: int = 32
    """Runs of each case."""
    transient: int = 60
    """Forcing periods that pass before, so that disturbances have grown to the attractor's size."""
    periods: int = 100
    """Forcing periods over which a run is judged."""
    seed: int = 0


class Averages(NamedTuple):
    """Averages over attractors, arrays with a leading axis of cases."""

    value: Float[np.ndarray, "cases objectives"]
    stderr: Float[np.ndarray, "cases objectives"]
    gradient: Float[np.ndarray, "cases objectives parameters"]
    gradient_stderr: Float[np.ndarray, "cases objectives parameters"]
    status: Int[np.ndarray, " cases"]
    """`Status` of the first run that did not stay on the rail, where too many did not."""
    simulated: Float[np.ndarray, " cases"]
    """Forcing periods."""


def averages(
    scene: Scene,
    grid: Mapping[str, Any],
    names: tuple[str, ...],
    reach: Mapping[str, float],
    objectives: tuple[Objective, ...],
    starts: Motion,
    spread: Spread,
    *,
    steps: int,
    solver: diffrax.AbstractSolver,
    progress: bool = False,
) -> Averages:
    """Averages of objectives and their derivatives by parameters.

    **Arguments:** `grid`: values by name, read side by side; `names`: of it, to differentiate by; `reach`: how far
    the runs' parameters are from the case's [their SI units]; `starts`: motions near the attractors, with a leading
    axis of cases.
    """
    cases, count = len(next(iter(grid.values()))), len(names)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=count))).reshape(-1, count)
    repeats = max(1, -(-whole("members", spread.members, 4) // len(corners)))
    signs = np.repeat(corners, repeats, axis=0)
    members = len(signs)
    draws = np.random.default_rng(spread.seed).normal(size=(repeats, len(MOTION_NUMBERS))) * DISTURBED
    draws[:, :5] = 0.0
    kicks = np.tile(draws, (len(corners), 1))
    flat = {name: np.repeat(np.asarray(values, float), members) for name, values in grid.items()}
    for k, name in enumerate(names):
        flat[name] = flat[name] + np.tile(signs[:, k] * reach[name], cases)
    runs = Cases(scene, flat, jax.tree.map(lambda a: np.asarray(a)[0], starts), product=False)
    motions = jax.tree.map(lambda a: np.repeat(np.asarray(a), members, axis=0), starts)
    leaves, structure = jax.tree.flatten(motions)
    scales = jax.tree.leaves(MOTION_SCALES)
    moved = [a + np.tile(kicks[:, k] * scales[k], cases) for k, a in enumerate(leaves)]
    runs.starts = jax.tree.unflatten(structure, moved)
    values, status = _run(runs, objectives, spread, steps, solver, progress)
    values = values.reshape(cases, members, -1)
    codes = status.reshape(cases, members)
    found = [_fitted(signs, v, np.where(c == Status.FINITE, 1.0, 0.0)) for v, c in zip(values, codes, strict=True)]
    value, stderr, slope, slope_stderr = (np.stack(part) for part in zip(*found, strict=True))
    per = 1 / np.array([reach[name] for name in names])
    good = np.mean(codes == Status.FINITE, axis=1) >= SURE
    worst = np.where(good, int(Status.FINITE), codes.max(axis=1))
    simulated = np.full(cases, float(members * (spread.transient + spread.periods)))
    lost = lambda a: np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan)
    return Averages(lost(value), lost(stderr), lost(slope * per), lost(slope_stderr * per), worst, simulated)


def _run(
    runs: Cases,
    objectives: tuple[Objective, ...],
    spread: Spread,
    steps: int,
    solver: diffrax.AbstractSolver,
    progress: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The objectives of each run (cases, objectives), and the runs' statuses."""
    of_courses: Objectives = tuple(one for one in objectives if isinstance(one, AbstractNumber))
    exponents = [isinstance(one, LargestExponent) for one in objectives]
    records = period_values(of_courses) if of_courses else RecordSet()
    passed, block = whole("transient", spread.transient, 0), _divisor(whole("periods", spread.periods, 1))
    transient = Calls(10, -(-passed // 10))
    plan = Plan(runs, solver, records, np.full(runs.count, steps), transient, Calls(block, spread.periods // block))

    def work(part: Part) -> _Values:
        scenes, on_progress = part.scenes, part.on_progress
        # motions of runs may be deep inside contacts, which is no oversight
        begin = states_and_penetrations(scenes, part.starts)[0]
        run = run_chunk(plan, scenes, begin, steps, on_progress)
        lanes = len(run.status)
        kept = jax.tree.map(jnp.asarray, run.record)
        found = np.asarray(totals(of_courses, *kept)) if of_courses else np.zeros((lanes, 0))
        values, status = np.empty((lanes, len(objectives))), run.status
        values[:, np.flatnonzero(np.logical_not(exponents))] = found
        if any(exponents):
            exponent, codes = _exponents(scenes, run.state, spread.periods, steps, solver, on_progress)
            values[:, np.flatnonzero(exponents)] = exponent[:, None]
            status = first_problem(status, codes)
        return _Values(values, status)

    cost = plan.cost + any(exponents) * 2.6 * spread.periods
    run = run_cases(plan, work, cost=cost, progress=progress, name="ensembles")
    return run.checked(lambda: tuple(run.results))


class _Values(NamedTuple):
    value: np.ndarray
    status: np.ndarray


def _exponents(scenes: Any, states: State, periods: int, steps: int, solver: Any, on_progress: OnProgress) -> tuple:
    """Largest local exponents over some periods [1/period], after as many as `SETTLED` for the tangents to turn."""
    states = jax.tree.map(jnp.asarray, states)
    tangents, logs, status = initial_tangents(scenes, states, 1), [], np.zeros(len(states.motion.y), int)
    for k in range(-(-periods // SETTLED) + 1):
        options: dict[str, Any] = dict(solver=solver, periods=SETTLED)
        done = advance_tangents(scenes, states, tangents, float(k * SETTLED), dynamic_steps(steps), **options)
        states, tangents = done.state, done.tangents
        status = first_problem(status, np.asarray(done.status))
        logs += [np.asarray(done.history)[..., 0]] if k else []
        on_progress(2.6 * SETTLED)
    return np.concatenate(logs, axis=1).mean(axis=1), status


def _divisor(periods: int) -> int:
    return next(k for k in range(min(periods, 50), 0, -1) if periods % k == 0)


def _fitted(signs: np.ndarray, values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, ...]:
    """Intercepts and slopes of planes through values (members, objectives) over `signs`, with standard errors.

    Members of weight zero are left out.
    """
    used = (weight > 0) & np.all(np.isfinite(values), axis=1)
    count, places = values.shape[1], signs.shape[1]
    if used.sum() <= places + 1:
        nothing = np.full(count, np.nan), np.full((count, places), np.nan)
        return nothing[0], nothing[0], nothing[1], nothing[1]
    system = np.column_stack([np.ones(used.sum()), signs[used]])
    found, *_ = np.linalg.lstsq(system, values[used], rcond=None)
    left = values[used] - system @ found
    variance = np.sum(left**2, axis=0) / (used.sum() - places - 1)
    spread = np.sqrt(np.diag(np.linalg.pinv(system.T @ system))[:, None] * variance)
    return found[0], spread[0], found[1:].T, spread[1:].T
