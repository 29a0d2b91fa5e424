"""Averages of objectives over ensembles of runs, and their derivatives.

In chaos the derivative of one motion grows without bound, while an average over the attractor may change smoothly
with a parameter. Many runs with parameters at corners of a small box, and disturbed starts, are one batch; each gives
the objective over its periods, and a plane through them gives the average and its derivatives with standard errors.
All corners have the same disturbances.
"""

from collections.abc import Mapping

import jax
import numpy as np

from ..flow.period_map import states_and_penetrations
from ..flow.record import RecordSet
from ..flow.status import Status
from ..model.kinematics import MOTION_SCALES, disturbances
from ..model.quantities import MOTION_NUMBERS
from ..sweeps.call import Call
from ..sweeps.grid import Grid
from ..sweeps.plan import make_plan
from ..sweeps.run import run_cases, run_chunk
from .ensembles import box_corners
from .objectives import Evaluation, EvaluationPlan


def ensemble_averages(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    evaluation: Evaluation,
) -> Evaluation:
    """Return an evaluation with objectives and derivatives from ensembles in place of its own.

    Where too few runs stay on the rail, values are NaN and the status is the worst of the runs.

    **Arguments:** `grid`: values by name, one for each case; `evaluation`: of the same cases, with states near their
    attractors.
    """
    settings = plan.ensemble
    cases = len(evaluation.status)
    signs = box_corners(len(plan.names))
    rail, chosen = settings.conditions(plan.scene.track, len(signs))
    # corner by corner for each case, and run by run for each corner
    shape = (cases, len(signs), len(rail))
    each = lambda values: np.broadcast_to(values, shape).ravel()
    runs = {name: each(values[:, None, None]) for name, values in grid.items()}
    offsets = np.tile(signs, (cases, 1, 1))  # in multiples of the reach
    for k, name in enumerate(plan.names):
        here = grid[name][:, None]
        reach = plan.reach[name]
        # corners beyond a bound are moved to it
        corner = np.clip(here + signs[:, k] * reach, *plan.bounds.get(name, (-np.inf, np.inf)))
        offsets[..., k] = (corner - here) / reach
        runs[name] = each((here + offsets[..., k] * reach)[..., None])
    # the same rails and disturbances at all corners
    runs |= {path: each(numbers) for path, numbers in chosen.items()}
    disturbed = disturbances(plan.scene, 0.1, len(rail), np.random.default_rng(settings.seed))
    motions = evaluation.state[:, None, None, : disturbed.shape[1]] + disturbed
    values, status = _run_members(plan, runs, np.broadcast_to(motions, (*shape, disturbed.shape[1])))
    values = values.reshape(*shape, -1)
    status = status.reshape(shape)
    stayed = status == Status.FINITE
    # one fit for each case
    fits = [settings.fit(*of_case, rail) for of_case in zip(offsets, values, stayed, strict=True)]
    planes, errors = map(np.array, zip(*fits, strict=True))
    # slopes are per reach
    per = 1 / np.array([plan.reach[name] for name in plan.names])
    lost = np.sum(~stayed, axis=(1, 2))
    # too few runs stayed on the rail
    few = np.isnan(planes[..., 0]).all(axis=1) & (lost > 0)
    return evaluation._replace(
        value=planes[..., 0],
        stderr=errors[..., 0],
        gradient=planes[..., 1:] * per,
        gradient_stderr=errors[..., 1:] * per,
        status=np.where(few, status.max(axis=(1, 2)), int(Status.FINITE)),
        lost=lost,
        simulated=evaluation.simulated + stayed[0].size * (settings.transient + settings.periods),
    )


def _run_members(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    motions: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the objectives (runs, objectives) and the statuses of runs from `motions` (..., numbers)."""
    ensemble = plan.ensemble
    options = Call(ensemble.transient, ensemble.periods, plan.steps, steps_per_period=plan.steps, solver=plan.solver)
    runs = make_plan(
        Grid(plan.scene, grid, product=False), plan.start, options, RecordSet(plan.numbers), plan.exponents
    )
    # each run has its own start, in place of the plan's
    starts = list(motions.reshape(-1, len(MOTION_NUMBERS)).T)
    runs.cases.starts = jax.tree.unflatten(jax.tree.structure(MOTION_SCALES), starts)
    # starts may be deep inside contacts, which is no oversight
    work = lambda part: run_chunk(part, states_and_penetrations(part.scenes, part.starts)[0])
    run = run_cases(runs, work, periods=runs.periods)
    made = run.checked(lambda: run.results)
    measured = dict(zip((*plan.numbers, *plan.exponents), made.record, strict=True))
    for one in plan.exponents:
        # without its standard error
        measured[one], _ = measured[one]
    return np.stack([measured[one] for one in plan.objectives], axis=1), made.status
