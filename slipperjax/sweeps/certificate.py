"""The certificate of exponents: other estimates, longer motions, and whether all agree."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..analysis.kinds import Regime
from ..analysis.lyapunov import kaplan_yorke, pooled_standard_error, regime, standard_error, weighted_mean
from ..flow.status import Status
from ..model.dynamics import State
from .measure import BLOCK
from .transience import HOLD, MOTIONS, LongerMotions

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


class CaseExponents(NamedTuple):
    """Exponents of cases."""

    status: Int[np.ndarray, " cases"]
    kind: Int[np.ndarray, " cases"]
    """Numbers of `slipperjax.analysis.Regime`."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods of a periodic motion, 0 for others."""
    history: Float[np.ndarray, "cases periods count"]
    state: State
    checks: Checks | None


def labels_of(count: int, certify: bool) -> dict[str, tuple[tuple[str, ...], str, str]]:
    """Dimension, unit and description of each variable, by name."""
    each, one = ("count",), ()
    labels = {
        "exponent": (each, "1/period", "Lyapunov exponents"),
        "stderr": (each, "1/period", "standard error of the exponents"),
        "weighted_exponent": (each, "1/period", "Lyapunov exponents by a smoothly weighted mean"),
        "by_orbit": (one, "", "whether the exponents are those of the periodic orbit that was reached"),
        "kind": (one, "", "kind of motion, by recurrence"),
        "period": (one, "1", "forcing periods of a periodic motion, 0 for others"),
        "regime": (one, "", "periodic, regular (neither periodic nor chaotic), chaotic, transient or unresolved"),
    }
    if count > 1:
        labels["kaplan_yorke"] = (one, "1", "Kaplan-Yorke dimension")
    if certify:
        regular = f"motions of {MOTIONS} that became regular within {HOLD} more forcing periods"
        labels |= {
            "half_step": (one, "1/period", "largest exponent with half the step"),
            "half_step_stderr": (one, "1/period", "standard error of the largest exponent with half the step"),
            "floquet": (one, "1/period", "ln of the largest Floquet multiplier's modulus, per forcing period"),
            "resolved": (one, "", "whether the other estimates agree"),
            "escapes": (one, "1", regular),
            "chaotic_for": (one, "1", "forcing periods for which chaos lasted at least, 0 for other motions"),
        }
    return labels


def exponent_variables(
    passed: int, measured: CaseExponents, by_orbit: Bool[np.ndarray, " cases"], longer: LongerMotions | None
) -> dict[str, np.ndarray]:
    """Makes all variables of `labels_of` by name, with the certificate where checks were made.

    **Arguments:** `passed`: forcing periods before the measurement; `by_orbit`: cases with the exponents of their
    orbit, which all rows of their history repeat; `longer`: longer motions of chaotic cases.
    """
    good, history = measured.status == Status.FINITE, measured.history
    exponent, error, weighted = history.mean(axis=1), standard_error(history), weighted_mean(history)
    # an orbit's are exact
    exponent[by_orbit] = weighted[by_orbit] = history[by_orbit, 0]
    error[by_orbit] = 0.0
    kind = np.where(good, Regime.kind_names(measured.kind), Regime.UNRESOLVED.kind_name)
    trusted, escapes = good, np.zeros(len(good), int)
    variables: dict[str, np.ndarray] = {}
    if measured.checks is not None:
        if longer is not None:
            escapes[longer.chosen] = longer.escapes
            lasting = longer.escapes == 0
            exponent[longer.chosen[lasting]] = longer.history[lasting].mean(axis=(1, 2))
            error[longer.chosen[lasting]] = pooled_standard_error(longer.history[lasting])
        variables = _checked(measured, measured.checks, by_orbit, longer, exponent[:, 0], error[:, 0])
        trusted = variables["resolved"]
        variables |= {"escapes": escapes, "chaotic_for": _lasting(passed, measured, longer, escapes)}
    if exponent.shape[1] > 1:
        variables["kaplan_yorke"] = kaplan_yorke(exponent)
    return variables | {
        "exponent": exponent,
        "stderr": error,
        "weighted_exponent": weighted,
        "by_orbit": by_orbit,
        "kind": kind,
        "period": np.where(good, measured.period, 0),
        "regime": regime(exponent[:, 0], error[:, 0], kind, trusted, escapes),
    }


def _checked(
    measured: CaseExponents,
    checks: Checks,
    by_orbit: np.ndarray,
    longer: LongerMotions | None,
    exponent: np.ndarray,
    error: np.ndarray,
) -> dict[str, np.ndarray]:
    """The other estimates, and whether they agree with the largest exponents and their standard errors."""
    good = measured.status == Status.FINITE
    agree = good & (checks.half_step_status == Status.FINITE)
    # of one record, where the error of several is known, and so that of one
    of_one = np.zeros_like(error)
    if longer is not None:
        agree[longer.chosen] &= longer.status == Status.FINITE
        of_one[longer.chosen] = np.sqrt(MOTIONS) * error[longer.chosen] * (longer.escapes == 0)
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
    return {"half_step": half, "half_step_stderr": half_error, "floquet": floquet, "resolved": agree}


def _lasting(passed: int, measured: CaseExponents, longer: LongerMotions | None, escapes: np.ndarray) -> np.ndarray:
    """Forcing periods for which chaos was seen to last."""
    periods = np.zeros(len(escapes), int)
    if longer is not None:
        before = passed + measured.history.shape[1] + BLOCK
        more = HOLD + measured.history.shape[1] + BLOCK
        periods[longer.chosen] = before + more * (longer.escapes == 0)
    return periods
