"""Quantiles and means over random conditions, such as rails, with standard errors by resampling.

Planes of quantiles follow Koenker and Bassett 1978, doi:10.2307/1913643. Errors are by the bootstrap, which draws
conditions with all runs under them: so errors of differences between designs that ran on the same rails account for
what these runs share.
"""

from collections.abc import Callable

import numpy as np
import scipy.optimize
from jaxtyping import Float

from ..tools.checks import require, warn


def quantile_plane(
    system: Float[np.ndarray, "rows columns"],
    values: Float[np.ndarray, " rows"],
    quantile: float,
    weights: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " columns"]:
    """Return coefficients such that a share `quantile` of weighted values lies below `system @ coefficients`."""
    used = weights > 0
    x = system[used]
    w = weights[used]
    # the solver's tolerances are absolute, for numbers near 1
    size = max(float(np.max(np.abs(values[used]))), 1e-300)
    y = values[used] / size
    bounds = np.stack([np.zeros_like(w), w], axis=1)
    # the dual program, whose multipliers are the coefficients
    dual = scipy.optimize.linprog(
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
    # how often each condition is drawn is its weight
    draws = np.random.default_rng(seed).multinomial(groups, np.full(groups, 1 / groups), size=resamples)
    return fit(np.ones(groups)), np.stack([fit(draw.astype(float)) for draw in draws])


def check_quantile(quantile: object, count: int) -> None:
    """Warn where few of `count` values lie beyond a quantile; None stands for the mean.

    **Raises:** `ValueError` unless it is None or a share between 0 and 1.
    """
    good = quantile is None or (isinstance(quantile, int | float) and 0 < quantile < 1)
    require(good, "quantile", "be a share between 0 and 1, or None for the mean", quantile)
    beyond = count if quantile is None else count * min(quantile, 1 - quantile)  # type: ignore[operator]
    # with fewer than four beyond, errors are too small: with one, 78 % of peak forces lay within two errors
    if beyond < 4 * (1 - 1e-9):
        warn(f"Argument `quantile` leaves {beyond:.2g} of {count} rails beyond it, too few for a true error.")
