"""Objectives and their derivatives without a stable orbit: regression over many short runs.

In chaos the derivative of one motion grows without bound, while an average over the attractor may change smoothly
with a parameter. Many runs with parameters at the corners of a small box, and disturbed starts, are one batch; each
gives the objective over its periods, and a plane through them gives the average and its derivatives with standard
errors. All corners have the same disturbances.
"""

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..flow.period_map import states_and_penetrations
from ..flow.record import RecordSet
from ..flow.status import Status
from ..model.kinematics import MOTION_SCALES
from ..model.quantities import MOTION_NUMBERS
from ..sweeps.grid import Grid
from ..sweeps.records import LargestExponent
from ..sweeps.run import ChunkInputs, Plan, RunOptions, make_plan, run_cases, run_chunk
from ..tools.checks import whole
from .evaluation import Evaluation, EvaluationPlan
from .gradients import PeriodValues, totals

DISTURBANCE = 0.1
"""Standard deviation of the disturbances of the starts' velocities, in multiples of
`slipperjax.model.MOTION_SCALES`. Displacements are left as they are: they could lie outside the play."""
LEAST_SHARE = 0.5
"""Share of the runs that must stay on the rail."""


def ensemble_averages(plan: EvaluationPlan, grid: Mapping[str, Any], evaluation: Evaluation) -> Evaluation:
    """Returns an evaluation with objectives and derivatives from ensembles in place of its own.

    Where less than half of the runs stay on the rail, the status is that of a run that does not.

    **Arguments:** `grid`: values by name, one for each case; `evaluation`: of the same cases, with states near their
    attractors.
    """
    settings, names, cases = plan.ensemble, plan.names, len(evaluation.status)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=len(names)))).reshape(-1, len(names))
    repeats = max(1, -(-whole("members", settings.members, 4) // len(corners)))
    signs = np.repeat(corners, repeats, axis=0)
    members = len(signs)
    disturbances = np.random.default_rng(settings.seed).normal(size=(repeats, len(MOTION_NUMBERS))) * DISTURBANCE
    disturbances[:, :5] = 0.0
    # member by member for each case, as `signs`
    grid = {name: np.repeat(np.asarray(values, float), members) for name, values in grid.items()}
    for k, name in enumerate(names):
        grid[name] = grid[name] + np.tile(signs[:, k] * plan.reach[name], cases)
    scales, structure = jax.tree.flatten(MOTION_SCALES)
    kicks = np.tile(disturbances * np.array(scales), (cases * len(corners), 1))
    runs = _plan_of_runs(plan, grid)
    motions = np.repeat(evaluation.state[:, : len(MOTION_NUMBERS)], members, axis=0) + kicks
    runs.cases.starts = jax.tree.unflatten(structure, list(motions.T))
    values, status = _run(plan, runs)
    values, status = values.reshape(cases, members, -1), status.reshape(cases, members)
    fits = [fit_plane(signs, v, code == Status.FINITE) for v, code in zip(values, status, strict=True)]
    value, stderr, slope, slope_stderr = (np.stack(part) for part in zip(*fits, strict=True))
    good = np.mean(status == Status.FINITE, axis=1) >= LEAST_SHARE
    kept = lambda a: np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan)
    per = 1 / np.array([plan.reach[name] for name in names])
    return evaluation._replace(
        value=kept(value),
        stderr=kept(stderr),
        gradient=kept(slope * per),
        gradient_stderr=kept(slope_stderr * per),
        status=np.where(good, int(Status.FINITE), status.max(axis=1)),
        simulated=evaluation.simulated + members * (settings.transient + settings.periods),
    )


class _RunValues(NamedTuple):
    """Objectives (lanes, objectives) and statuses of the runs of a chunk."""

    value: np.ndarray
    status: np.ndarray


def _plan_of_runs(plan: EvaluationPlan, grid: Mapping[str, Any]) -> Plan:
    """Plans the runs of an ensemble, with records of all objectives."""
    courses, exponents = plan.of_courses, [one for one in plan.objectives if isinstance(one, LargestExponent)]
    records = RecordSet((*([PeriodValues(courses)] if courses else []), *exponents))
    options = RunOptions(plan.ensemble.transient, plan.ensemble.periods, plan.steps, plan.steps, plan.solver)
    return make_plan(Grid(plan.scene, grid, product=False), plan.start, options, records)


def _run(plan: EvaluationPlan, runs: Plan) -> tuple[np.ndarray, np.ndarray]:
    """The objectives of each run (runs, objectives), and the runs' statuses."""
    courses = plan.of_courses

    def work(part: ChunkInputs) -> _RunValues:
        # starts of runs may be deep inside contacts, which is no oversight
        states = states_and_penetrations(part.scenes, part.starts)[0]
        run = run_chunk(runs, part.scenes, states, plan.steps, part.on_progress)
        values = np.empty((len(run.status), len(plan.objectives)))
        if courses:
            values[:, plan.indices(exponents=False)] = totals(courses, jax.tree.map(jnp.asarray, run.record[0]))
        for k, record in zip(plan.indices(exponents=True), run.record[bool(courses) :], strict=True):
            values[:, k] = record.exponent
        return _RunValues(values, run.status)

    run = run_cases(runs, work, cost=runs.cost)
    return run.checked(lambda: tuple(run.results))


def fit_plane(
    signs: Float[np.ndarray, "members parameters"], values: Float[np.ndarray, "members objectives"], kept: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Fits planes through `values` over `signs`, to the members that are `kept` and finite.

    **Returns:** intercepts (objectives,) and their standard errors, slopes (objectives, parameters) and theirs; NaN
    where the members are too few.
    """
    used = kept & np.all(np.isfinite(values), axis=1)
    freedom = used.sum() - signs.shape[1] - 1
    if freedom < 1:
        intercept, slope = np.full(values.shape[1], np.nan), np.full((values.shape[1], signs.shape[1]), np.nan)
        return intercept, intercept, slope, slope
    system = np.column_stack([np.ones(used.sum()), signs[used]])
    plane, *_ = np.linalg.lstsq(system, values[used], rcond=None)
    variance = np.sum((values[used] - system @ plane) ** 2, axis=0) / freedom
    stderr = np.sqrt(np.diag(np.linalg.pinv(system.T @ system))[:, None] * variance)
    return plane[0], stderr[0], plane[1:].T, stderr[1:].T
