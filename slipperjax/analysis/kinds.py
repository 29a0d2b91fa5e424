"""The kinds of motions: one code, with the names that results and pictures have for it."""

import enum
from typing import Any

import numpy as np

from ..tools.checks import numbers


class Regime(enum.IntEnum):
    """Code of a kind of motion, with its names in results; 0 also marks cases that were not computed."""

    UNRESOLVED = 0, "unresolved", "unresolved"
    """None of the others with certainty."""
    PERIODIC = 1, "period", "periodic"
    REGULAR = 2, "torus", "regular"
    """Neither periodic nor chaotic: a torus."""
    CHAOTIC = 3, "chaotic", "chaotic"
    TRANSIENT = 4, "", "transient chaos"
    """Chaotic for long, and regular in the end."""

    kind_name: str
    """Name where motions are told apart by recurrence; empty where that cannot tell."""
    regime_name: str
    """Name where the largest Lyapunov exponent counts, too."""

    def __new__(cls, code: int, kind_name: str, regime_name: str) -> "Regime":
        member = int.__new__(cls, code)
        member._value_, member.kind_name, member.regime_name = code, kind_name, regime_name
        return member

    @classmethod
    def codes(cls, kind_names: Any) -> np.ndarray:
        """Return the codes for an array of names of `KINDS`."""
        codes = {member.kind_name: int(member) for member in cls}
        return np.array([codes[name] for name in np.ravel(kind_names)], int).reshape(np.shape(kind_names))

    @classmethod
    def kind_names(cls, codes: Any) -> np.ndarray:
        """Return the names of `KINDS` for an array of codes."""
        return np.asarray(np.array([member.kind_name for member in cls])[codes])

    @classmethod
    def regime_names(cls, codes: Any) -> np.ndarray:
        """Return the names of `REGIMES` for an array of codes."""
        return np.asarray(np.array([member.regime_name for member in cls])[codes])


KINDS = "period", "torus", "chaotic", "unresolved"
"""Names for kinds of motions by recurrence, in the order of legends."""
REGIMES = "periodic", "regular", "chaotic", "unresolved", "transient chaos"
"""Names for kinds of motions by recurrence and the largest exponent, in the order of legends."""


def lasting(name: str, least_mean_life: Any) -> str:
    """Return the name of a regime as it is shown: of chaos with how long it lasts on average at least, where that
    was looked at. A transient that is longer cannot be told from chaos.

    **Arguments:** `name`: of `REGIMES`; `least_mean_life`: of the cases, see `slipperjax.lyapunov_sweep`, NaN where
    there is none.
    """
    least_mean_life = numbers("least_mean_life", least_mean_life)
    known = np.ravel(least_mean_life)[np.isfinite(np.ravel(least_mean_life))]
    if name != Regime.CHAOTIC.regime_name or not len(known):
        return name
    return f"{name} (mean life {known.min():.0f} periods or more)"
