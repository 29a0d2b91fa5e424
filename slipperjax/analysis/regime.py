"""Classification of a case as periodic, regular, chaotic or unresolved, from its exponent and its attractor."""

from typing import Any

import numpy as np

SURE = 3.0
"""Number of standard errors by which an exponent must exceed zero to count as positive."""
LEAST = 1e-3
"""Exponents up to this count as zero [1/period]."""
REGIMES = ("periodic", "regular", "chaotic", "unresolved")
"""Names of the regimes, in the order of the indices from `regime`. "regular" is neither chaotic nor periodic."""


def is_chaotic(exponent: Any, stderr: Any) -> np.ndarray:
    """Whether a largest Lyapunov exponent [1/period] exceeds both `SURE` standard errors and `LEAST`."""
    return np.asarray(exponent) > np.maximum(SURE * np.asarray(stderr), LEAST)


def regime(exponent: Any, stderr: Any, kind: Any, trusted: Any) -> np.ndarray:
    """Index into `REGIMES` of each case.

    **Arguments:** `exponent`, `stderr`: the largest exponent and its standard error [1/period]; `kind`: of
    `Attractors`; `trusted`: whether status and certificates are good. All have the same shape.
    """
    found = np.where(is_chaotic(exponent, stderr), 2, np.where(np.asarray(kind) == "period", 0, 1))
    return np.where(np.asarray(trusted) & np.isfinite(exponent), found, 3)
