"""Classification of a case as periodic, regular, chaotic or unresolved, from its exponent and its attractor."""

from typing import Any

import numpy as np

SURE = 3.0
"""Number of standard errors by which an exponent must exceed zero to count as positive."""
LEAST = 1e-3
"""Exponents up to this count as zero [1/period]."""
WIDE = 0.01
"""An exponent that is not positive is known where `SURE` standard errors are less than itself, or than this
[1/period]."""
REGIMES = ("periodic", "regular", "chaotic", "unresolved", "transient chaos")
"""Names of the regimes, in the order of the indices from `regime`. "regular" is neither chaotic nor periodic;
"transient chaos" is chaotic for long, and regular in the end."""


def is_chaotic(exponent: Any, stderr: Any) -> np.ndarray:
    """Whether a largest Lyapunov exponent [1/period] exceeds both `SURE` standard errors and `LEAST`."""
    return np.asarray(np.asarray(exponent) > np.maximum(SURE * np.asarray(stderr), LEAST))


def regime(exponent: Any, stderr: Any, kind: Any, trusted: Any, escapes: Any = 0) -> np.ndarray:
    """Index into `REGIMES` of each case.

    A case is unresolved where it is not trusted, where exponent and recurrence contradict each other, and where the
    exponent is neither positive nor known well enough to be called zero or negative.

    **Arguments:** `exponent`, `stderr`: the largest exponent and its standard error [1/period]; `kind`: of
    `Attractors`; `trusted`: whether status and certificates are good; `escapes`: how many of several longer motions
    became regular in the end. All have the same shape.
    """
    exponent, stderr, kind = np.asarray(exponent), np.asarray(stderr), np.asarray(kind)
    chaotic, periodic = is_chaotic(exponent, stderr), kind == "period"
    known = chaotic | (SURE * stderr <= np.maximum(np.abs(exponent), WIDE))
    contradicts = (chaotic & periodic) | (~chaotic & (kind == "chaotic"))
    found = np.where(chaotic, np.where(np.asarray(escapes) > 0, 4, 2), np.where(periodic, 0, 1))
    return np.where(np.asarray(trusted) & np.isfinite(exponent) & known & ~contradicts, found, 3)
