"""Lyapunov exponents of a whole grid as one batch, with a certificate for each case."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis import (
    REGIMES,
    classify,
    is_chaotic,
    kaplan_yorke,
    largest_exponent,
    pooled_standard_error,
    regime,
    standard_error,
    weighted_mean,
)
from ..flow import Interrupted, Status, Trajectory, first_of, first_problem, initial_states
from ..model import COORDINATE_SCALES, Motion, Scene, State
from ..orbits import check_count
from ..tools import whole
from .attractors import FLOOR
from .cases import Cases
from .executors import records_in_order, run_chunk, run_chunks
from .limits import refuse_run
from .measure import BLOCK, JACOBIAN, LONGEST, LOOK, PAIR, Measure, measured_periods, tangents_cost
from .plan import PAUSE, Chunk, Plan, make_plan, strobe_plan
from .progress import Later
from .sweep import case_attributes, case_variables
from .votes import HOLD, MOTIONS, Votes, take_votes, work_of_votes

AGREE = 1e-3
"""Differences between exponents [1/period] that are accepted whatever the standard errors."""
STEADY = 1e-2
"""Differences between the halves of a record [1/period] that are accepted whatever the standard errors."""


def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, Any],
    *,
    count: int = 1,
    product: bool = True,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    **Arguments:** `count`, `periods`: as for `lyapunov_spectrum`; `certify`: whether each case is checked, which
    costs about twice as much again, and six times as much for chaotic cases; `transient`: `BLOCK` periods at least;
    others as for `sweep`. Periods are rounded up to whole blocks of `BLOCK`, after each of which the status is looked
    at.

    **Returns:** an `xarray.Dataset` over the grid with

    - `exponent` and `stderr` [1/period], with dimension `count`; `weighted_exponent`: the same by a smoothly weighted
      mean, sharper for regular motions (see `slipperjax.analysis.weighted_mean`); `kaplan_yorke` where count > 1;
      `kind` and `period`: what the motion is by recurrence in the last `LAST` counted periods, see
      `slipperjax.analysis.classify`; `regime`: see `slipperjax.analysis.regime`; `status` and `steps_per_period`: as
      `sweep` gives them;
    - with `certify`: `half_step`, the largest exponent with steps half as long, and its standard error
      `half_step_stderr`; `two_trajectories`, an estimate without tangents, and `two_trajectories_stderr`;
      `floquet`, ln |largest multiplier| per period, of periodic motions; `resolved`: whether all that applies agrees;
      `escapes`, how many of `MOTIONS` motions of a chaotic case became regular within `HOLD` periods more, and
      `chaotic_for`, the forcing periods for which none did.

    A case is `resolved` where its status is 0, the two other estimates lie within three standard errors of their
    difference or 1e-3, the exponents of both halves of the record within three of theirs or 1e-2, and the weighted
    exponent of a periodic motion is that of its multiplier within 1e-3.

    The exponents of a certified chaotic case, and their standard errors, are those of its `MOTIONS` longer motions,
    see `slipperjax.analysis.pooled_standard_error`. Where some became regular, it is "transient chaos", with the
    exponents of the chaotic stretch.

    **Raises:** `ValueError` that names the argument which is wrong; `Interrupted` after Ctrl-C. Chaotic cases whose
    longer motions were not finished then have the exponents that were measured, and `Status.NOT_RUN`.
    """
    start = first_of(start)
    cases = Cases(scene, grid, start, product=product)
    options: dict[str, Any] = dict(steps_per_period=steps_per_period, solver=solver)
    plan = make_plan(scene, cases, record="strobe", transient=0, periods=1, **options)
    plan = strobe_plan(plan, whole("transient", transient, BLOCK))
    count, counted = check_count(scene, count), -(-whole("periods", periods, 1) // BLOCK)
    work_of_case = plan.work + _work(counted, count, certify)
    refuse_run(
        cases.count, work_of_case, plan.values + measured_periods(counted) * (count + 2), float(plan.steps.sum())
    )
    asked = workers
    chunks, workers = plan.chunks(chunk, workers)

    def work(chunk, on_progress):
        scenes, starts = cases.take(chunk.index)
        settled = run_chunk(plan, scenes, initial_states(scenes, starts), chunk.steps, on_progress)
        measure = Measure(plan, scenes, settled.state, float(plan.periods), counted, chunk.steps, on_progress)
        plain = measure(chunk.steps, count)
        status = first_problem(first_problem(settled.status, plain.status), measure.look(chunk.steps, plain.state))
        checks = None
        if certify:
            half, pair = measure(2 * chunk.steps, 1), measure(chunk.steps, 1, 1e-7)
            matrices = measure.jacobians(chunk.steps, plain.state)
            checks = _Checks(half.history, half.status, pair.history, pair.status, matrices)
        return _Exponents(status, plain.strobe, plain.history, jax.tree.map(np.asarray, plain.state), checks)

    runs = run_chunks(
        chunks,
        workers,
        work,
        periods=work_of_case,
        progress=progress,
        name="exponents",
        later=_later(chunks, counted, count) if certify else None,
    )
    found, votes = records_in_order(chunks, runs.results), None
    if certify and not runs.interrupted:
        exponent, error = found.history.mean(axis=1)[:, 0], standard_error(found.history)[:, 0]
        chosen = np.flatnonzero(is_chaotic(exponent, error) & (found.status == Status.FINITE))
        if len(chosen):
            states = jax.tree.map(lambda a: a[chosen], found.state)
            epoch = plan.periods + measured_periods(counted)
            run = (counted, count, chunk, asked, progress)
            votes, unfinished = _votes(chosen, lambda: take_votes(plan, cases, chosen, states, epoch, *run))
            if unfinished is not None:
                found.status[unfinished] = Status.NOT_RUN
                runs = runs._replace(finished=runs.finished - len(unfinished), interrupted=True)
    call = dict(
        function="lyapunov_sweep",
        count=count,
        product=product,
        transient=transient,
        periods=periods,
        certify=certify,
    )
    attrs = case_attributes(plan, cases, call) | {"transient": plan.periods, "periods": counted * BLOCK}
    ds = _dataset(cases, plan, found, votes, attrs)
    return runs.checked(ds)


def _work(blocks: int, count: int, certify: bool) -> float:
    """What the measurements of one case cost, in plain forcing periods."""
    plain, checks = tangents_cost(count), 2 * tangents_cost(1) + PAIR if certify else 0.0
    jacobians = JACOBIAN * LONGEST if certify else 0.0
    return (plain + checks) * measured_periods(blocks) + LOOK * PAUSE + jacobians


def _later(chunks: Sequence[Chunk], blocks: int, count: int) -> Later:
    """The longer motions, which every case may need."""
    return Later(sum(chunk.cost for chunk in chunks) * work_of_votes(blocks, count), "for chaotic cases")


def _votes(chosen: np.ndarray, take: Callable) -> tuple["_Voted | None", np.ndarray | None]:
    """The votes of the chosen cases, and which cases have none because of an interrupt; None without one."""
    try:
        votes, interrupted = take()
    except Interrupted:
        return None, chosen
    if not interrupted:
        return _Voted(chosen, votes), None
    done = votes.status != Status.NOT_RUN
    return _Voted(chosen[done], jax.tree.map(lambda a: a[done], votes)), chosen[~done]


class _Checks(NamedTuple):
    """What certifies the cases."""

    half_step: Float[np.ndarray, "cases periods 1"]
    half_step_status: Int[np.ndarray, " cases"]
    two_trajectories: Float[np.ndarray, "cases periods 1"]
    two_trajectories_status: Int[np.ndarray, " cases"]
    jacobians: Float[np.ndarray, "cases periods size size"]


class _Exponents(NamedTuple):
    """What was found of the cases."""

    status: Int[np.ndarray, " cases"]
    strobe: Float[np.ndarray, "cases last 10"]
    history: Float[np.ndarray, "cases periods count"]
    state: State
    checks: _Checks | None


class _Voted(NamedTuple):
    """Cases with longer motions, and what these showed."""

    chosen: Int[np.ndarray, " cases"]
    votes: Votes


Variables = dict[str, tuple[np.ndarray, str, str]]
"""Values, unit and description by name."""


def _dataset(cases: Cases, plan: Plan, found: _Exponents, voted: _Voted | None, attrs: dict[str, Any]) -> xr.Dataset:
    good = found.status == Status.FINITE
    settled = classify(np.where(good[:, None, None], found.strobe, np.nan), scales=COORDINATE_SCALES, floor=FLOOR)
    exponent, error = found.history.mean(axis=1), standard_error(found.history)
    flat: Variables = {
        "weighted_exponent": (
            weighted_mean(found.history),
            "1/period",
            "Lyapunov exponents by a smoothly weighted mean",
        ),
        "kind": (settled.kind, "", "what the motion is by recurrence"),
        "period": (settled.period, "1", "forcing periods of a periodic motion, 0 for others"),
    }
    trusted, escapes = good, np.zeros(len(good), int)
    if found.checks is not None:
        if voted is not None:
            escapes[voted.chosen] = voted.votes.escapes
            lasting = voted.votes.escapes == 0
            of_motions = voted.votes.history[lasting]
            exponent[voted.chosen[lasting]] = of_motions.mean(axis=(1, 2))
            error[voted.chosen[lasting]] = pooled_standard_error(of_motions)
        checked, trusted = _certified(found, found.checks, voted, exponent[:, 0], error[:, 0], settled.period)
        flat |= checked | _lasting(plan, found, voted, escapes)
    flat |= {
        "exponent": (exponent, "1/period", "Lyapunov exponents"),
        "stderr": (error, "1/period", "standard error of the exponents"),
    }
    if exponent.shape[1] > 1:
        flat["kaplan_yorke"] = (kaplan_yorke(exponent), "1", "Kaplan-Yorke dimension")
    names = np.array(REGIMES)[regime(exponent[:, 0], error[:, 0], settled.kind, trusted, escapes)]
    flat["regime"] = (names, "", "periodic, regular (neither periodic nor chaotic), chaotic, transient or unresolved")
    ds = xr.Dataset(coords=cases.coordinates(), attrs=attrs)
    for name, (values, unit, text) in flat.items():
        dims = (*cases.dims, "count") if values.ndim > 1 else cases.dims
        label = {"units": unit, "long_name": text} if unit else {"long_name": text}
        ds[name] = (dims, values.reshape(cases.shape + values.shape[1:]), label)
    by_case = case_variables(cases.dims, found.status.reshape(cases.shape), plan.steps.reshape(cases.shape))
    return ds.assign(by_case)


def _certified(
    found: _Exponents,
    checks: _Checks,
    voted: _Voted | None,
    exponent: np.ndarray,
    error: np.ndarray,
    period: np.ndarray,
) -> tuple[Variables, np.ndarray]:
    """The other estimates, and whether they agree with the largest exponents and their standard errors."""
    good = found.status == Status.FINITE
    agree = good & (checks.half_step_status == Status.FINITE) & (checks.two_trajectories_status == Status.FINITE)
    flat: Variables = {}
    # of one record, where the error of several is known, and so that of one
    of_one = np.zeros_like(error)
    if voted is not None:
        agree[voted.chosen] &= voted.votes.status == Status.FINITE
        of_one[voted.chosen] = np.sqrt(MOTIONS) * error[voted.chosen] * (voted.votes.escapes == 0)
    others = {
        "half_step": ("with half the step", checks.half_step),
        "two_trajectories": ("from two trajectories", checks.two_trajectories),
    }
    for name, (text, rows) in others.items():
        value, its_error = rows.mean(axis=1)[:, 0], np.maximum(standard_error(rows)[:, 0], of_one)
        flat[name] = (value, "1/period", f"largest exponent {text}")
        flat[f"{name}_stderr"] = (its_error, "1/period", f"standard error of the largest exponent {text}")
        agree &= np.abs(value - exponent) <= np.maximum(3 * np.hypot(error, its_error), AGREE)
    rows = found.history[..., 0]
    half = rows.shape[1] // 2
    first, second = rows[:, :half].mean(axis=1), rows[:, half:].mean(axis=1)
    # each half has twice the variance of the whole
    its_error = np.maximum(standard_error(found.history)[:, 0], of_one)
    agree &= np.abs(first - second) <= np.maximum(3 * 2 * its_error, STEADY)
    floquet = np.full(len(good), np.nan)
    periodic = (period > 0) & good
    for k in np.flatnonzero(periodic):
        floquet[k] = largest_exponent(checks.jacobians[k], period[k])
    agree &= ~periodic | (np.abs(floquet - weighted_mean(found.history)[:, 0]) <= AGREE)
    flat["floquet"] = (floquet, "1/period", "ln of the largest Floquet multiplier's modulus")
    flat["resolved"] = (agree, "", "whether the other estimates agree")
    return flat, agree


def _lasting(plan: Plan, found: _Exponents, voted: _Voted | None, escapes: np.ndarray) -> Variables:
    """How long chaos was seen to last."""
    periods = np.zeros(len(escapes), int)
    if voted is not None:
        seen = plan.periods + found.history.shape[1] + BLOCK
        longer = HOLD + found.history.shape[1] + BLOCK
        periods[voted.chosen] = np.where(escapes[voted.chosen] == 0, seen + longer, seen)
    return {
        "escapes": (escapes, "1", f"motions of {MOTIONS} that became regular within {HOLD} more forcing periods"),
        "chaotic_for": (periods, "1", "forcing periods for which chaos lasted at least, 0 for other motions"),
    }
