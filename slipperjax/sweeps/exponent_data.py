"""Exponents of a grid as a dataset, with what certifies each case."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..analysis.attractor import KINDS
from ..analysis.lyapunov import kaplan_yorke, pooled_standard_error, regime, standard_error, weighted_mean
from ..flow.status import Status
from ..model.dynamics import State
from .grid import Cases
from .plan import Plan
from .records import BLOCK
from .sweep import case_variables
from .transience import HOLD, MOTIONS, Votes

AGREE = 1e-3
"""Differences between exponents [1/period] that are accepted whatever the standard errors."""
STEADY = 1e-2
"""Differences between the halves of a record [1/period] that are accepted whatever the standard errors."""


class Checks(NamedTuple):
    """What certifies the cases."""

    half_step: Float[np.ndarray, "cases periods 1"]
    half_step_status: Int[np.ndarray, " cases"]
    two_trajectories: Float[np.ndarray, "cases periods 1"]
    two_trajectories_status: Int[np.ndarray, " cases"]
    floquet: Float[np.ndarray, " cases"]
    """ln |largest multiplier| per forcing period of periodic motions [1/period], NaN for others."""


class Measured(NamedTuple):
    """What was found of the cases."""

    status: Int[np.ndarray, " cases"]
    kind: Int[np.ndarray, " cases"]
    """Place in `slipperjax.analysis.KINDS`."""
    period: Int[np.ndarray, " cases"]
    """Forcing periods of a periodic motion, 0 for others."""
    history: Float[np.ndarray, "cases periods count"]
    state: State
    checks: Checks | None


class Voted(NamedTuple):
    """Cases with longer motions, and what these showed."""

    chosen: Int[np.ndarray, " cases"]
    votes: Votes


Variables = dict[str, tuple[np.ndarray, str, str]]
"""Values, unit and description by name."""


def exponent_data(
    cases: Cases,
    plan: Plan,
    found: Measured,
    by_orbit: Bool[np.ndarray, " cases"],
    voted: Voted | None,
    attrs: dict[str, Any],
) -> xr.Dataset:
    """The dataset of `slipperjax.lyapunov_sweep`.

    **Arguments:** `by_orbit`: cases whose rows of the history, all alike, are exponents of their orbit.
    """
    good = found.status == Status.FINITE
    exponent, error, weighted = (
        found.history.mean(axis=1),
        standard_error(found.history),
        weighted_mean(found.history),
    )
    # an orbit's are exact
    exponent[by_orbit] = weighted[by_orbit] = found.history[by_orbit, 0]
    error[by_orbit] = 0.0
    kind = np.where(good, np.array(KINDS)[found.kind], "unresolved")
    period = np.where(good, found.period, 0)
    flat: Variables = {
        "weighted_exponent": (weighted, "1/period", "Lyapunov exponents by a smoothly weighted mean"),
        "by_orbit": (
            by_orbit,
            "",
            "whether the exponents are those of the periodic orbit that the motion has reached",
        ),
        "kind": (kind, "", "what the motion is by recurrence"),
        "period": (period, "1", "forcing periods of a periodic motion, 0 for others"),
    }
    trusted, escapes = good, np.zeros(len(good), int)
    if found.checks is not None:
        if voted is not None:
            escapes[voted.chosen] = voted.votes.escapes
            lasting = voted.votes.escapes == 0
            of_motions = voted.votes.history[lasting]
            exponent[voted.chosen[lasting]] = of_motions.mean(axis=(1, 2))
            error[voted.chosen[lasting]] = pooled_standard_error(of_motions)
        checked, trusted = _certified(found, found.checks, by_orbit, voted, exponent[:, 0], error[:, 0])
        flat |= checked | _lasting(plan, found, voted, escapes)
    flat |= {
        "exponent": (exponent, "1/period", "Lyapunov exponents"),
        "stderr": (error, "1/period", "standard error of the exponents"),
    }
    if exponent.shape[1] > 1:
        flat["kaplan_yorke"] = (kaplan_yorke(exponent), "1", "Kaplan-Yorke dimension")
    names = regime(exponent[:, 0], error[:, 0], kind, trusted, escapes)
    flat["regime"] = (names, "", "periodic, regular (neither periodic nor chaotic), chaotic, transient or unresolved")
    ds = xr.Dataset(coords=cases.coordinates(), attrs=attrs)
    for name, (values, unit, text) in flat.items():
        dims = (*cases.dims, "count") if values.ndim > 1 else cases.dims
        label = {"units": unit, "long_name": text} if unit else {"long_name": text}
        ds[name] = (dims, values.reshape(cases.shape + values.shape[1:]), label)
    by_case = case_variables(cases.dims, found.status.reshape(cases.shape), plan.steps.reshape(cases.shape))
    return ds.assign(by_case)


def _certified(
    found: Measured,
    checks: Checks,
    by_orbit: np.ndarray,
    voted: Voted | None,
    exponent: np.ndarray,
    error: np.ndarray,
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
        value[by_orbit], its_error[by_orbit] = (
            rows[by_orbit, 0, 0],
            np.where(np.isnan(rows[by_orbit, 0, 0]), np.nan, 0),
        )
        flat[name] = (value, "1/period", f"largest exponent {text}")
        flat[f"{name}_stderr"] = (its_error, "1/period", f"standard error of the largest exponent {text}")
        near = np.abs(value - exponent) <= np.maximum(3 * np.hypot(error, its_error), AGREE)
        if name == "half_step":
            near |= by_orbit & (np.abs(value - exponent) <= STEADY)
        agree &= near | (by_orbit & np.isnan(value))
    rows = found.history[..., 0]
    half = rows.shape[1] // 2
    first, second = rows[:, :half].mean(axis=1), rows[:, half:].mean(axis=1)
    # each half has twice the variance of the whole
    its_error = np.maximum(standard_error(found.history)[:, 0], of_one)
    agree &= np.abs(first - second) <= np.maximum(3 * 2 * its_error, STEADY)
    periodic = (found.period > 0) & good
    agree &= ~periodic | (np.abs(checks.floquet - weighted_mean(found.history)[:, 0]) <= AGREE)
    floquet = np.where(good, checks.floquet, np.nan)
    flat["floquet"] = (floquet, "1/period", "ln of the largest Floquet multiplier's modulus, per forcing period")
    flat["resolved"] = (agree, "", "whether the other estimates agree")
    return flat, agree


def _lasting(plan: Plan, found: Measured, voted: Voted | None, escapes: np.ndarray) -> Variables:
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
