"""Averages of objectives over ensembles of runs, and their derivatives.

In chaos the derivative of one motion grows without bound, while an average over the attractor may change smoothly
with a parameter. Many runs with parameters at corners of a small box, and disturbed starts, are one batch; each gives
the objective over its periods, and a plane through them gives the average and its derivatives with standard errors.
All corners have the same disturbances.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np

from ..flow.period_map import states_and_penetrations
from ..flow.record import RecordSet
from ..flow.records import AbstractNumber
from ..flow.status import Status
from ..model.kinematics import MOTION_SCALES, disturbances
from ..model.quantities import MOTION_NUMBERS
from ..sweeps.call import Call
from ..sweeps.grid import Grid
from ..sweeps.plan import Part, make_plan
from ..sweeps.records import LargestExponent
from ..sweeps.run import run_cases, run_chunk
from .ensembles import Plane, box_corners
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
    repeats = len(rail)
    members = len(signs) * repeats
    # corner by corner for each case, and run by run for each corner
    runs = {}
    for name, values in grid.items():
        runs[name] = np.repeat(values, members)
    offsets = np.tile(signs, (cases, 1, 1))  # in multiples of the reach
    for k, name in enumerate(plan.names):
        here = grid[name][:, None]
        reach = plan.reach[name]
        low, high = plan.bounds.get(name, (-np.inf, np.inf))
        # corners beyond a bound are moved to it
        corner = np.clip(here + signs[:, k] * reach, low, high)
        offsets[..., k] = (corner - here) / reach
        runs[name] = runs[name] + np.repeat(offsets[..., k], repeats) * reach
    # the same rails at all corners
    for path, numbers in chosen.items():
        runs[path] = np.tile(numbers, cases * len(signs))
    # the same disturbances at all corners, too
    motions = np.repeat(evaluation.state[:, : len(MOTION_NUMBERS)], members, axis=0)
    disturbed = disturbances(plan.scene, 0.1, repeats, np.random.default_rng(settings.seed))
    motions += np.tile(disturbed, (cases * len(signs), 1))
    values, status = _run_members(plan, runs, motions)
    values = values.reshape(cases, len(signs), repeats, -1)
    stayed = (status == Status.FINITE).reshape(cases, len(signs), repeats)
    # one fit for each case, of whose planes the parts are stacked
    fits = [settings.fit(*of_case, rail) for of_case in zip(offsets, values, stayed, strict=True)]
    plane = Plane(*(np.stack(part) for part in zip(*fits, strict=True)))
    # slopes are per reach
    per = 1 / np.array([plan.reach[name] for name in plan.names])
    worst = status.reshape(cases, members).max(axis=1)
    lost = np.sum(~stayed, axis=(1, 2))
    # too few runs stayed on the rail
    few = np.isnan(plane.value).all(axis=1) & (lost > 0)
    return evaluation._replace(
        value=plane.value,
        stderr=plane.stderr,
        gradient=plane.slope * per,
        gradient_stderr=plane.slope_stderr * per,
        status=np.where(few, worst, int(Status.FINITE)),
        lost=lost,
        simulated=evaluation.simulated + members * (settings.transient + settings.periods),
    )


class _RunValues(NamedTuple):
    """Objectives (lanes, objectives) and statuses of the runs of a chunk."""

    value: np.ndarray
    status: np.ndarray


def _run_members(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    motions: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the objectives (runs, objectives) and the statuses of runs from `motions` (runs, numbers)."""
    ensemble = plan.ensemble
    options = Call(ensemble.transient, ensemble.periods, plan.steps, steps_per_period=plan.steps, solver=plan.solver)
    cases = Grid(plan.scene, grid, product=False)
    exponents = plan.places(LargestExponent)
    stages = tuple(plan.objectives[k] for k in exponents)
    runs = make_plan(cases, plan.start, options, RecordSet(plan.numbers), stages)
    # each run has its own start, in place of the plan's
    runs.cases.starts = jax.tree.unflatten(jax.tree.structure(MOTION_SCALES), list(motions.T))

    def work(part: Part) -> _RunValues:
        # starts of runs may be deep inside contacts, which is no oversight
        states = states_and_penetrations(part.scenes, part.starts)[0]
        run = run_chunk(part, states)
        values = np.empty((len(run.status), len(plan.objectives)))
        # exponents are measured after the record, by stages, and have a standard error
        measured = [*run.record[: len(plan.numbers)], *(value for value, _ in run.record[len(plan.numbers) :])]
        for k, value in zip([*plan.places(AbstractNumber), *exponents], measured, strict=True):
            values[:, k] = value
        return _RunValues(values, run.status)

    run = run_cases(runs, work, periods=runs.periods)
    return run.checked(lambda: tuple(run.results))
