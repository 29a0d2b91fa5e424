"""Judging designs: objectives and their derivatives on the motion to which each case settles, as one batch.

A case whose motion is a stable periodic orbit is judged on the orbit, with exact derivatives. Any other motion that
stays on the rail is judged by an ensemble.

In chaos the derivative of one motion grows without bound, but an average over the attractor may change smoothly with
a parameter. An ensemble is one batch of many runs, with parameters at the corners of a small box and disturbed
starts. Each run gives the objective over its periods. A plane through these values gives the average and its
derivatives with standard errors. All corners have the same disturbances.
"""

from collections.abc import Mapping

import jax
import numpy as np

from ..analysis.attractor import classify
from ..analysis.kinds import Regime
from ..flow.period_map import initial_states, states_and_penetrations
from ..flow.record import RecordSet, Strobe
from ..flow.status import Status
from ..model.kinematics import MOTION_SCALES, disturbances
from ..model.quantities import COORDINATE_SCALES, MOTION_NUMBERS
from ..orbits.periodic import TOLERANCE
from ..solvers.latching import calls_lapack
from ..sweeps.attractors import FLOOR, LAST
from ..sweeps.call import Call, make_plan
from ..sweeps.engine import run_cases, run_part, run_parts
from ..sweeps.grid import VECTOR_LANES, Cases, Grid, filled
from ..sweeps.orbits import Maps, find_orbits, rows_of
from ..sweeps.plan import Part
from ..sweeps.reached import reached_orbits
from ..tools.compile import ahead
from ..tools.limits import cores
from .ensembles import box_corners
from .objectives import Evaluation, EvaluationPlan

LANES_PER_CALL = VECTOR_LANES
"""Cases in each call, filled up with copies: a search needs many cases first and few later, and each number of cases
would need its own programs."""
JACOBIAN = 35.0
"""Cost of a period with its Jacobian, in unrecorded periods: measured."""
SLOPES_COST = 8.0
"""Cost of a period with its derivatives by two parameters, in unrecorded periods: measured."""


def judge(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    warm_start: Evaluation | None = None,
) -> Evaluation:
    """Evaluate cases, on orbits or by ensembles. Arguments as for `judge_on_orbits`."""
    evaluation = judge_on_orbits(plan, grid, warm_start)
    # motions that are not periodic, but stay on the rail
    index = np.flatnonzero((evaluation.period == 0) & (evaluation.status == Status.FINITE))
    if len(index):
        of_cases = {name: values[index] for name, values in grid.items()}
        averages = ensemble_averages(plan, of_cases, evaluation.take(index))
        for array, rows in zip(evaluation, averages, strict=True):
            array[index] = rows
    return evaluation


def ensemble_averages(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    evaluation: Evaluation,
) -> Evaluation:
    """Return an evaluation with objectives and derivatives from ensembles in place of its own.

    Where too few runs stay on the rail, values are NaN and the status is the worst status of the runs.

    **Arguments:** `grid`: values by name, one for each case; `evaluation`: of the same cases, with states near their
    attractors.
    """
    settings = plan.ensemble
    signs = box_corners(len(plan.names))
    rail, chosen = settings.conditions(plan.scene.track, len(signs))
    # corner by corner for each case, and run by run for each corner
    shape = (len(evaluation.status), len(signs), len(rail))
    each = lambda values: np.broadcast_to(values, shape).ravel()
    runs = {name: each(values[:, None, None]) for name, values in grid.items()}
    here = np.stack([grid[name] for name in plan.names], axis=-1)[:, None]
    reach = np.array([plan.reach[name] for name in plan.names])
    bounds = np.array([plan.bounds.get(name, (-np.inf, np.inf)) for name in plan.names])
    # corners beyond a bound are moved to the bound; in multiples of the reach
    offsets = (np.clip(here + signs * reach, *bounds.T) - here) / reach
    varied = here + offsets * reach
    runs |= {name: each(varied[..., k, None]) for k, name in enumerate(plan.names)}
    # the same rails and disturbances at all corners
    runs |= {path: each(numbers) for path, numbers in chosen.items()}
    disturbed = disturbances(plan.scene, 0.1, len(rail), np.random.default_rng(settings.seed))
    motions = evaluation.state[:, None, None, : disturbed.shape[1]] + disturbed
    values, status = _run_members(plan, runs, np.broadcast_to(motions, (*shape, disturbed.shape[1])))
    status = status.reshape(shape)
    stayed = status == Status.FINITE
    values = np.where(stayed[..., None], values.reshape(*shape, -1), np.nan)
    # one fit for each case
    fits = [settings.fit(*of_case, rail) for of_case in zip(offsets, values, strict=True)]
    planes, errors = map(np.array, zip(*fits, strict=True))
    # slopes are per reach
    per = 1 / reach
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
    # each run has its own start, in place of the plan's start
    starts = list(motions.reshape(-1, len(MOTION_NUMBERS)).T)
    runs.cases.starts = jax.tree.unflatten(jax.tree.structure(MOTION_SCALES), starts)
    # starts may be deep inside contacts, which is intended
    work = lambda part: run_part(part, states_and_penetrations(*part.begun)[0])
    run = run_cases(runs, work, periods=runs.periods)
    made = run.checked(lambda: run.results)
    measured = dict(zip((*plan.numbers, *plan.exponents), made.record, strict=True))
    # exponents without their standard errors
    values = [measured[one][0] if one in plan.exponents else measured[one] for one in plan.objectives]
    return np.stack(values, axis=1), made.status


def judge_on_orbits(
    plan: EvaluationPlan,
    grid: Mapping[str, np.ndarray],
    warm_start: Evaluation | None = None,
) -> Evaluation:
    """Evaluate cases on the stable periodic orbits to which they settle; values of other cases are NaN.

    Where rails do not recur, or bend, cases stay at their starts.

    **Arguments:** `grid`: values by name, one for each case; `warm_start`: an evaluation of the same cases with
    similar parameters. Its orbits are followed where they are still stable; elsewhere the motion settles again from
    its states.
    """
    if not plan.on_orbits:
        cases = Cases(plan.scene, grid, plan.start, product=False)
        epoch = float(plan.scene.epoch_at(plan.scene.track.origin))
        return Evaluation.of_states(plan, rows_of(initial_states(*cases.take(np.arange(cases.count)), epoch)))
    # fewer periods would not show whether an orbit was reached
    options = Call(0, max(plan.transient, 20), steps_per_period=plan.steps, solver=plan.solver)
    transient = make_plan(Grid(plan.scene, grid, product=False), plan.start, options, RecordSet((Strobe(),)))
    cases = transient.cases
    groups = np.split(np.arange(cases.count), range(LANES_PER_CALL, cases.count, LANES_PER_CALL))
    # the last chunk is filled up with copies
    parts = []
    for index in groups:
        lanes = filled(index, LANES_PER_CALL)
        parts.append(Part(transient, lanes, lanes, len(index), transient.schedules[0]))

    def work(part: Part) -> Evaluation:
        found = Evaluation.of_states(plan, rows_of(part.states))
        maps = Maps.of(part, found.period)
        if warm_start is not None:
            _follow(found, maps, warm_start.take(part.index))
        # programs that call LAPACK must run one at a time, see `calls_lapack`
        elif part.index[0] == 0 and plan.names and not calls_lapack(plan.solver):
            # the program of derivatives, the longest program, while others are compiled and run
            start = found.state.copy()
            slopes = np.zeros((len(start), len(plan.names), start.shape[1]))
            ahead(lambda: plan.pushed(maps, np.arange(len(start)), start, slopes))
        if not np.all(found.period):
            _settle(found, maps, part)
        _differentiate(found, maps, plan)
        return found

    run = run_parts(parts, min(cores(), len(parts)), work, periods=1, progress=False)
    return run.checked(lambda: run.results)


# Steps in the evaluation of a chunk, which write into `found`; period maps are over the periods in `found`.


def _follow(found: Evaluation, maps: Maps, warm_start: Evaluation) -> None:
    """Follow the orbits of a warm start to these parameters."""
    # lost cases keep their start
    finite = np.all(np.isfinite(warm_start.state), axis=1)
    found.state[finite] = warm_start.state[finite]
    # gaps change with the parameters, and the contacts' memory must agree with the gaps
    found.state[:] = maps.settled(np.arange(len(finite)), found.state, found.state)
    _find_orbits(found, maps, np.where(finite, warm_start.period, 0), warm_start.inverse)


def _settle(found: Evaluation, maps: Maps, part: Part) -> None:
    """Simulate the cases until those without an orbit have settled, and find the orbits that these have reached."""
    unsettled = found.period == 0
    states = maps.states(found.state)
    run = run_part(part, states)
    strobe = run.record[0][:, -LAST:]
    # only motions that stay on the rail can have reached an orbit
    good = maps._replace(periods=(unsettled & (run.status == Status.FINITE)).astype(int))
    reached = reached_orbits(good, jax.tree.map(np.asarray, run.state), strobe, count=1, half_step=False)
    simulated = part.plan.periods + np.where(reached.period, JACOBIAN, 0)
    found.simulated[unsettled] += simulated[unsettled]
    found.state[unsettled] = rows_of(reached.state)[unsettled]
    found.status[unsettled] = run.status[unsettled]
    if reached.period.any():
        _find_orbits(found, maps, reached.period)
    # the other motions are only classified
    others = found.period == 0
    if others.any():
        kinds = classify(strobe[others], scales=COORDINATE_SCALES, floor=FLOOR).kind
        # recurrence without a stable orbit is a contradiction
        found.kind[others] = Regime.codes(np.where(kinds == "period", "unresolved", kinds))


def _find_orbits(found: Evaluation, maps: Maps, period: np.ndarray, inverse: np.ndarray | None = None) -> None:
    """Find periodic orbits near the states of cases whose `period` is not 0; stable orbits become the cases' motions.

    **Arguments:** `inverse`: of I - P_x, from a warm start, whose orbits must be near the states.
    """
    maps = maps._replace(periods=period)
    orbits = find_orbits(maps, maps.states(found.state), tolerance=TOLERANCE, max_iterations=20, inverse=inverse)
    found.simulated[:] += period * (orbits.iterations + JACOBIAN * orbits.jacobians)
    rows = rows_of(orbits.state)
    good = (period > 0) & (orbits.status == Status.FINITE) & orbits.stable
    if inverse is not None:
        moved = np.abs(maps.weights(np.arange(len(rows)), rows) * (rows - found.state))[:, : len(MOTION_NUMBERS)]
        # an orbit further away than one unit of the scales is another orbit
        good &= np.max(moved, axis=1) <= 1.0
    # the other cases keep their values
    found.period[good] = period[good]
    found.kind[good] = Regime.PERIODIC
    found.state[good] = rows[good]
    found.inverse[good] = orbits.inverse[good]
    found.multiplier[good] = np.abs(orbits.multipliers[good, 0])


def _differentiate(found: Evaluation, maps: Maps, plan: EvaluationPlan) -> None:
    """Set objectives and their derivatives for the cases on orbits."""
    on_orbit = found.period > 0
    if plan.names:
        _, found.value[:], found.gradient[:] = plan.on(maps, found.state, found.inverse)
        cost = 2 * SLOPES_COST
        if plan.exponents:
            # each Jacobian costs once for its value, and about twice more for each derivative
            cost += (1 + 2 * len(plan.names)) * JACOBIAN
        found.simulated[:] += cost * found.period
    # on orbits there is no chance, and therefore no standard error
    found.stderr[on_orbit] = 0.0
    found.gradient_stderr[on_orbit] = 0.0
