"""Statistics of exponents: weighted means, standard errors of correlated series, the Kaplan-Yorke dimension."""

from typing import Any

import numpy as np
from jaxtyping import Float


def kaplan_yorke(exponents: Any) -> Float[np.ndarray, "*lanes"]:
    """Kaplan-Yorke dimension of spectra along the last axis, in any order and unit (doi:10.1007/BFb0064319).

    0 where all exponents are negative; the number of exponents, a lower bound, where their sum is positive. An
    exponent whose exact value is zero is used as measured: the dimension of a limit cycle of an ODE is 1 for a
    measured +1e-9, and 0 for -1e-9.
    """
    falling = -np.sort(-np.asarray(exponents), axis=-1)
    sums = np.cumsum(falling, axis=-1)
    whole_part = np.sum(sums >= 0, axis=-1, keepdims=True)
    surplus = np.take_along_axis(np.concatenate([0 * sums[..., :1], sums], axis=-1), whole_part, axis=-1)
    following = np.append(-falling, np.full_like(falling[..., :1], np.inf), axis=-1)
    following = np.take_along_axis(following, whole_part, axis=-1)
    dimension = whole_part + surplus / np.where(following > 0, following, np.inf)
    return np.where(np.isnan(falling).any(axis=-1), np.nan, dimension[..., 0])


def weighted_mean(history: Any) -> Float[np.ndarray, "*lanes count"]:
    """Mean over the axis before the last, with the smooth weights exp(-1 / (t (1 - t))) that vanish at both ends.

    For a regular motion the local exponents are a quasi-periodic series: the error of the plain mean falls as the
    reciprocal of its length, the error of this one faster than any power of it (doi:10.1088/1361-6544/aa84c2). For
    chaos it is as accurate as a plain mean over about half of the record.

    **Arguments:** `history`: shape (*lanes, intervals, count).
    """
    history = np.asarray(history)
    t = (np.arange(history.shape[-2]) + 0.5) / history.shape[-2]
    weights = np.exp(-1 / (t * (1 - t)))
    return np.einsum("k,...kc->...c", weights / weights.sum(), history)


def standard_error(history: Any) -> Float[np.ndarray, "*lanes count"]:
    """Standard error of the mean over the axis before the last, with autocorrelation taken into account.

    Means over 100 to 199 blocks remove most of the correlation, of any length and kind (doi:10.1063/1.457480). An
    autoregression of these means, of the order that minimises Akaike's criterion, accounts for the remaining
    correlation by its spectral density at frequency zero. Local exponents are mostly anticorrelated, because parts
    that depend on the position alone cancel from one interval to the next; block means alone would overestimate the
    error. For an exponent with such parts only, like the zero exponent of a flow, the result is too large by a factor
    of about two. NaN below 8 intervals.

    **Arguments:** `history`: shape (*lanes, intervals, count).
    """
    history = np.asarray(history)
    if history.shape[-2] < 8:
        return np.full(history.shape[:-2] + history.shape[-1:], np.nan)
    length = max(1, history.shape[-2] // 100)
    n = history.shape[-2] // length
    used = history[..., history.shape[-2] - n * length :, :]
    means = used.reshape(*history.shape[:-2], n, length, history.shape[-1]).mean(axis=-2)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x = means - means.mean(axis=-2, keepdims=True)
        top = min(int(10 * np.log10(n)), n // 4)
        covariance = [np.sum(x[..., lag:, :] * x[..., : n - lag, :], axis=-2) / n for lag in range(top + 1)]
        noise, weights = covariance[0], []
        densities, criteria = [noise * n / (n - 1)], [n * np.log(noise)]
        for order in range(1, top + 1):  # Levinson and Durbin
            known = sum(w * covariance[order - 1 - lag] for lag, w in enumerate(weights))
            last = (covariance[order] - known) / noise
            weights = [w - last * v for w, v in zip(weights, weights[::-1], strict=True)] + [last]
            noise = noise * (1 - last**2)
            densities.append(noise * n / (n - order - 1) / (1 - sum(weights)) ** 2)
            criteria.append(n * np.log(noise) + 2 * order)
        best = np.argmin(np.stack(criteria), axis=0)[None]
        density = np.take_along_axis(np.stack(densities), best, axis=0)[0]
    return np.sqrt(np.where(covariance[0] == 0, 0.0, density) / n)


def pooled_standard_error(history: Any) -> Float[np.ndarray, "*lanes count"]:
    """Standard error of the mean over several independent motions on one attractor.

    The larger of two estimates. One is that of `standard_error` within the motions. The other is the scatter of the
    means of their halves about the mean of all, which sees correlations that are as long as a motion's record: with
    500 forcing periods of a chaotic slipper these can double the error of the first.

    **Arguments:** `history`: local exponents, shape (*lanes, motions, intervals, count).
    """
    history = np.asarray(history)
    motions, intervals = history.shape[-3], history.shape[-2]
    within = np.sqrt(np.mean(standard_error(history) ** 2, axis=-2) / motions)
    half = intervals // 2
    halves = np.stack([history[..., :half, :].mean(axis=-2), history[..., half:, :].mean(axis=-2)], axis=-2)
    halves = halves.reshape(*history.shape[:-3], 2 * motions, history.shape[-1])
    return np.maximum(within, halves.std(axis=-2, ddof=1) / np.sqrt(2 * motions))
