"""What a fit is worth: which parameters the record tells apart, and what the model leaves unexplained."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

LEAST_INFORMATION = 3.0
"""Information on a direction in multiples of what the bounds tell, below which a record tells little of it: the
standard error is half that of the bounds then."""
LEAST_SHARE = 0.3
"""Least share of a parameter in a direction over the greatest, to be named."""
MOST_NOISE_RATIO = 1.2
"""What is left over the noise that was given, above which a model does not explain a signal [1]."""
SIGNIFICANCE = 1e-3
"""Probability of residuals below which a model does not explain them."""


def not_identified(names: Sequence[str], information: Float[np.ndarray, "parameters parameters"]) -> list[str]:
    """Return in words what a record does not tell.

    **Arguments:** `information`: Fisher's, of the record alone, by levels: multiples of what is known before.
    """
    texts = []
    values, directions = np.linalg.eigh(information)
    for value, way in zip(values, directions.T, strict=True):
        if value < LEAST_INFORMATION:
            named = [names[k] for k in np.argsort(-np.abs(way)) if abs(way[k]) > LEAST_SHARE * np.abs(way).max()]
            if len(named) == 1:
                texts.append(f"the record tells little of {named[0]}")
            else:
                texts.append(f"the record does not tell {named[0]} from {' and '.join(map(str, named[1:]))}")
    return texts


def whiteness(residual: Float[np.ndarray, " samples"]) -> float:
    """Return the probability that white noise is as correlated as some residuals, or more, by Ljung and Box's test.

    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297, doi:10.1093/biomet/65.2.297.
    """
    count = len(residual)
    lags = np.arange(1, min(20, count // 5) + 1)
    x = residual - residual.mean()
    power = x @ x
    correlation = np.array([x[k:] @ x[:-k] for k in lags]) / power
    statistic = count * (count + 2) * np.sum(correlation**2 / (count - lags))
    return float(chi2.sf(statistic, len(lags)))
