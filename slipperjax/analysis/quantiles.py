"""Quantiles and means over random conditions, such as rails, with their errors and intervals.

Rails are independent, but runs over one rail are not. Errors come from the bootstrap, which draws rails with all of
their runs, so that the common part of these runs counts. Intervals of quantiles come from order statistics, for the
number of independent runs that has the same information as all runs. A rail with a lost run is left out for all
designs. Planes of quantiles follow Koenker and Bassett 1978, doi:10.2307/1913643.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..tools.checks import require

LEAST_BEYOND = 4
"""Fewest rails beyond a quantile. All of n rails are below the quantile 1 - 4/n with a probability below exp(-4), or
1.8 %, so that order statistics bound a 95 % interval on both sides."""


def check_quantile(quantile: object, rails: int, counted: str = "rails") -> None:
    """Refuse a quantile that needs more independent rails than there are; None means the mean.

    **Arguments:** `counted`: the argument that is the number of rails, for the error.

    **Raises:** `ValueError` unless it is None or a share between 0 and 1, with `least_rails` or more.
    """
    good = quantile is None or (isinstance(quantile, int | float) and 0 < quantile < 1)
    require(good, "quantile", "be a share between 0 and 1, or None for the mean", quantile)
    least = least_rails(quantile)  # type: ignore[arg-type]
    of = "a mean" if quantile is None else f"the quantile {quantile:g}, with {LEAST_BEYOND} of them beyond it"
    require(rails >= least, counted, f"be {least} or more for {of}", rails)


def least_rails(quantile: float | None) -> int:
    """Return the fewest independent rails that give a quantile, or with None a mean, and its error."""
    # 1 - 0.95 is slightly more than 0.05
    return 2 if quantile is None else math.ceil(LEAST_BEYOND / min(quantile, 1 - quantile) * (1 - 1e-9))


def whole_rails(numbers: Float[np.ndarray, "rails ..."]) -> Bool[np.ndarray, " rails"]:
    """Return whether a rail has the numbers of all its runs, in all cases; other rails are left out in all cases."""
    return np.asarray(np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim))))


def quantile_plane(
    system: Float[np.ndarray, "rows columns"],
    values: Float[np.ndarray, " rows"],
    quantile: float,
    weights: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " columns"]:
    """Return coefficients such that a share `quantile` of weighted values lies below `system @ coefficients`."""
    from scipy.optimize import linprog  # here, because importing it takes time

    used = weights > 0
    x = system[used]
    w = weights[used]
    # the solver's tolerances are absolute, for numbers near 1
    size = max(float(np.max(np.abs(values[used]))), 1e-300)
    y = values[used] / size
    bounds = np.stack([np.zeros_like(w), w], axis=1)
    # the dual program, whose multipliers are the coefficients
    dual = linprog(
        -y,
        A_eq=x.T,
        b_eq=(1 - quantile) * (x.T @ w),
        bounds=bounds,
        method="highs",
    )
    return -size * dual.eqlin.marginals


def mean_plane(
    system: Float[np.ndarray, "rows columns"],
    values: Float[np.ndarray, " rows"],
    weights: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " columns"]:
    """Return coefficients by weighted least squares."""
    # rows times the roots of their weights make an unweighted problem
    root = np.sqrt(weights)
    return np.linalg.lstsq(system * root[:, None], values * root, rcond=None)[0]


def bootstrap(
    fit: Callable[[np.ndarray], np.ndarray],
    groups: int,
    *,
    resamples: int = 100,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers that `fit` estimates from all conditions, and from each resample, (resamples, numbers).

    **Arguments:** `fit`: estimates numbers, given the weight of each condition; `groups`: number of conditions;
    `resamples`: number of draws with replacement; 100 give a standard error to 7 %.
    """
    # the weight of a condition is the number of times that it is drawn
    draws = np.random.default_rng(seed).multinomial(groups, np.full(groups, 1 / groups), size=resamples)
    return fit(np.ones(groups)), np.stack([fit(draw.astype(float)) for draw in draws])


def standard_error(drawn: Float[np.ndarray, "resamples ..."], groups: int) -> np.ndarray:
    """Return the standard errors of numbers from the numbers of the resamples of `bootstrap`.

    The mean of n values drawn from n values scatters less than the mean of n new values, by sqrt((n - 1) / n).
    """
    return drawn.std(axis=0, ddof=1) * np.sqrt(groups / (groups - 1))


class Estimates(NamedTuple):
    """Quantiles or means of cases that ran over the same rails; each an array (cases,) in the unit of the runs."""

    value: np.ndarray
    stderr: np.ndarray
    low: np.ndarray
    high: np.ndarray
    difference: np.ndarray
    difference_stderr: np.ndarray
    difference_low: np.ndarray
    difference_high: np.ndarray


def estimate(
    numbers: Float[np.ndarray, "rails starts cases"],
    quantile: float | None,
    base: int | None = 0,
    *,
    resamples: int = 400,
    seed: int = 0,
) -> Estimates:
    """Estimate a quantile or the mean of each case, and its difference from that of a base case, with 95 % intervals.

    Intervals of differences hold for all pairs of cases at once, by Tukey's studentized range. Therefore they are
    also true for the case that is best by chance. Where too few rails are whole, all results are NaN.

    **Arguments:** `numbers`: of the runs, NaN for a lost run; `quantile`: a share [1], or None for the mean;
    `base`: the case from which differences count, None for the case of the lowest value; `resamples`, `seed`: of
    `bootstrap`.
    """
    numbers = numbers[whole_rails(numbers)]
    rails, _, cases = numbers.shape
    if rails < least_rails(quantile):
        return Estimates(*np.full((len(Estimates._fields), cases), np.nan))
    value, drawn = bootstrap(sample_fit(numbers, quantile), rails, resamples=resamples, seed=seed)
    stderr = standard_error(drawn, rails)
    if quantile is None:
        from scipy.stats import t  # here, because importing it takes as long as importing JAX

        reach = t.ppf(0.975, rails - 1) * stderr
        low, high = value - reach, value + reach
    else:
        low, high = quantile_interval(numbers, quantile)
    base = int(np.argmin(value)) if base is None else base
    difference = value - value[base]
    # all cases of a resample have the same rails, so that their common part cancels
    difference_stderr = standard_error(drawn - drawn[:, base : base + 1], rails)
    reach = range_factor(max(cases, 2), rails) * difference_stderr
    return Estimates(value, stderr, low, high, difference, difference_stderr, difference - reach, difference + reach)


@functools.cache
def range_factor(cases: int, rails: int) -> float:
    """Return the number of errors that 95 % of the greatest differences between equal cases do not exceed [1].

    By Tukey's studentized range: for 2, 3, 5 and 10 cases on many rails 1.96, 2.34, 2.73 and 3.16.
    """
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(0.95, cases, rails - 1)) / np.sqrt(2)


def quantile_interval(
    numbers: Float[np.ndarray, "rails starts cases"], quantile: float
) -> Float[np.ndarray, "2 cases"]:
    """Return the ends of the 95 % interval of a quantile of each case.

    With one start per rail the interval is true for any distribution, because the number of values below a quantile
    follows a binomial law. With several starts, the number of independent runs is the one with the same scatter of
    the share below (Woodruff 1952, doi:10.1080/01621459.1952.10483443; Korn and Graubard 1998).

    **Arguments:** `numbers`: finite, with enough rails for the quantile.
    """
    from scipy.stats import binom

    rails, starts, cases = numbers.shape
    ends = np.empty((2, cases))
    for k in range(cases):
        ordered = np.sort(numbers[..., k], axis=None)
        below = np.mean(numbers[..., k] <= np.quantile(ordered, quantile), axis=1)
        scatter = below.var(ddof=1)
        each = starts if scatter == 0 else np.clip(quantile * (1 - quantile) / scatter, 1, starts)
        worth = round(rails * each)
        low, high = binom.ppf([0.025, 0.975], worth, quantile)
        # numbered from 1, in the order of all runs
        places = np.floor(low * len(ordered) / worth), np.ceil((high + 1) * len(ordered) / worth)
        ends[:, k] = ordered[np.clip(places, 1, len(ordered)).astype(int) - 1]
    return ends


def sample_fit(
    numbers: Float[np.ndarray, "rails starts cases"], quantile: float | None
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function of the number of draws of each rail, which returns the quantiles or means of the cases."""

    def fit(weights: np.ndarray) -> np.ndarray:
        drawn = numbers[np.repeat(np.arange(len(numbers)), weights.astype(int))].reshape(-1, numbers.shape[-1])
        if quantile is None:
            return drawn.mean(axis=0)
        return np.quantile(drawn, quantile, axis=0, method="median_unbiased")

    return fit
