"""Exponents of a grid as a dataset, with what certifies each case."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..analysis.attractor import KINDS
from ..analysis.lyapunov import REGIMES, kaplan_yorke, pooled_standard_error, regime, standard_error, weighted_mean
from ..flow.status import Status
from ..model.dynamics import State
from .records import BLOCK
from .run import Plan
from .sweep import Column, case_dataset
from .transience import HOLD, MOTIONS, Votes

AGREE = 1e-3
"""Differences between exponents [1/period] that are accepted whatever the standard errors."""
STEADY = 1e-2
"""Differences between the halves of a record [1/period] that are accepted whatever the standard errors."""


class Checks(NamedTuple):
    """Other estimates, which certify the cases."""

    half_step: Float[np.ndarray, "cases periods 1"]
    half_step_status: Int[np.ndarray, " cases"]
    floquet: Float[np.ndarray, " cases"]
    """ln |largest multiplier| per forcing period of periodic motions [1/period], NaN for others."""


class Measured(NamedTuple):
    """Exponents of cases."""

    status: Int[np.ndarray, " cases"]
    kind: Int[np.ndarray, " cases"]
    """Index into `slipperjax.analysis.KINDS`."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods of a periodic motion, 0 for others."""
    history: Float[np.ndarray, "cases periods count"]
    state: State
    checks: Checks | None


def exponent_data(
    plan: Plan, measured: Measured, by_orbit: Bool[np.ndarray, " cases"], votes: Votes | None, attrs: dict[str, Any]
) -> xr.Dataset:
    """Makes the dataset of `slipperjax.lyapunov_sweep`.

    **Arguments:** `by_orbit`: cases whose rows of the history, all alike, are exponents of their orbit.
    """
    good, history = measured.status == Status.FINITE, measured.history
    exponent, error, weighted = history.mean(axis=1), standard_error(history), weighted_mean(history)
    # an orbit's are exact
    exponent[by_orbit] = weighted[by_orbit] = history[by_orbit, 0]
    error[by_orbit] = 0.0
    kind = np.where(good, np.array(KINDS)[measured.kind], "unresolved")
    trusted, escapes = good, np.zeros(len(good), int)
    columns: dict[str, Column] = {}
    if measured.checks is not None:
        if votes is not None:
            escapes[votes.chosen] = votes.escapes
            lasting = votes.escapes == 0
            exponent[votes.chosen[lasting]] = votes.history[lasting].mean(axis=(1, 2))
            error[votes.chosen[lasting]] = pooled_standard_error(votes.history[lasting])
        columns, trusted = _certified(measured, measured.checks, by_orbit, votes, exponent[:, 0], error[:, 0])
        columns |= _lasting(plan, measured, votes, escapes)
    regimes = np.array(REGIMES)[regime(exponent[:, 0], error[:, 0], kind, trusted, escapes)]
    if exponent.shape[1] > 1:
        columns["kaplan_yorke"] = (kaplan_yorke(exponent), (), "1", "Kaplan-Yorke dimension")
    columns |= {
        "exponent": (exponent, ("count",), "1/period", "Lyapunov exponents"),
        "stderr": (error, ("count",), "1/period", "standard error of the exponents"),
        "weighted_exponent": (weighted, ("count",), "1/period", "Lyapunov exponents by a smoothly weighted mean"),
        "by_orbit": (by_orbit, (), "", "whether the exponents are those of the periodic orbit that was reached"),
        "kind": (kind, (), "", "kind of motion, by recurrence"),
        "period": (np.where(good, measured.period, 0), (), "1", "forcing periods of a periodic motion, 0 for others"),
        "regime": (
            regimes,
            (),
            "",
            "periodic, regular (neither periodic nor chaotic), chaotic, transient or unresolved",
        ),
    }
    return case_dataset(plan, measured.status, columns, attrs)


def _certified(
    measured: Measured,
    checks: Checks,
    by_orbit: np.ndarray,
    votes: Votes | None,
    exponent: np.ndarray,
    error: np.ndarray,
) -> tuple[dict[str, Column], np.ndarray]:
    """The other estimates, and whether they agree with the largest exponents and their standard errors."""
    good = measured.status == Status.FINITE
    agree = good & (checks.half_step_status == Status.FINITE)
    # of one record, where the error of several is known, and so that of one
    of_one = np.zeros_like(error)
    if votes is not None:
        agree[votes.chosen] &= votes.status == Status.FINITE
        of_one[votes.chosen] = np.sqrt(MOTIONS) * error[votes.chosen] * (votes.escapes == 0)
    half, half_error = (
        checks.half_step.mean(axis=1)[:, 0],
        np.maximum(standard_error(checks.half_step)[:, 0], of_one),
    )
    half[by_orbit], half_error[by_orbit] = checks.half_step[by_orbit, 0, 0], 0.0
    close = np.abs(half - exponent) <= np.maximum(3 * np.hypot(error, half_error), AGREE)
    agree &= close | (by_orbit & (np.abs(half - exponent) <= STEADY))
    rows = measured.history[..., 0]
    middle = rows.shape[1] // 2
    first, second = rows[:, :middle].mean(axis=1), rows[:, middle:].mean(axis=1)
    # each half has twice the variance of the whole
    of_record = np.maximum(standard_error(measured.history)[:, 0], of_one)
    agree &= np.abs(first - second) <= np.maximum(3 * 2 * of_record, STEADY)
    periodic = (measured.period > 0) & good
    agree &= ~periodic | (np.abs(checks.floquet - weighted_mean(measured.history)[:, 0]) <= AGREE)
    floquet = np.where(good, checks.floquet, np.nan)
    return {
        "half_step": (half, (), "1/period", "largest exponent with half the step"),
        "half_step_stderr": (half_error, (), "1/period", "standard error of the largest exponent with half the step"),
        "floquet": (floquet, (), "1/period", "ln of the largest Floquet multiplier's modulus, per forcing period"),
        "resolved": (agree, (), "", "whether the other estimates agree"),
    }, agree


def _lasting(plan: Plan, measured: Measured, votes: Votes | None, escapes: np.ndarray) -> dict[str, Column]:
    """How long chaos was seen to last."""
    periods = np.zeros(len(escapes), int)
    if votes is not None:
        before = plan.periods + measured.history.shape[1] + BLOCK
        longer = HOLD + measured.history.shape[1] + BLOCK
        periods[votes.chosen] = before + longer * (votes.escapes == 0)
    words = f"motions of {MOTIONS} that became regular within {HOLD} more forcing periods"
    return {
        "escapes": (escapes, (), "1", words),
        "chaotic_for": (
            periods,
            (),
            "1",
            "forcing periods for which chaos lasted at least, 0 for other motions",
        ),
    }
