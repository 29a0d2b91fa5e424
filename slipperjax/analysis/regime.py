"""The rule that calls a case chaotic, regular or unresolved from its exponent and what it settled to."""

from typing import Any

import numpy as np

SURE = 3.0
"""Standard errors that an exponent must lie above zero."""
LEAST = 1e-3
"""Exponents up to this count as zero [1/period]."""
REGIMES = ("periodic", "regular", "chaotic", "unresolved")
"""Names of the regimes, by the numbers that `regime` gives. "regular" is not chaotic and not periodic."""


def is_chaotic(exponent: Any, stderr: Any) -> np.ndarray:
    """Whether a largest Lyapunov exponent [1/period] is above zero, by three standard errors and by `LEAST`."""
    return np.asarray(exponent) > np.maximum(SURE * np.asarray(stderr), LEAST)


def regime(exponent: Any, stderr: Any, kind: Any, trusted: Any) -> np.ndarray:
    """Index into `REGIMES` of each case.

    **Arguments:** `exponent`, `stderr`: the largest exponent and its standard error [1/period]; `kind`: of
    `Attractors`; `trusted`: whether status and certificates hold. All of one shape.
    """
    found = np.where(is_chaotic(exponent, stderr), 2, np.where(np.asarray(kind) == "period", 0, 1))
    return np.where(np.asarray(trusted) & np.isfinite(exponent), found, 3)
