"""Kinds of motions: their codes in arrays and their names in results and pictures."""

import enum
from collections.abc import Sequence

import numpy as np

from ..tools.checks import numbers
from ..tools.types import Numbers


class Regime(enum.IntEnum):
    """Kind of motion: its code in arrays, and its names in results. Code 0 also marks cases not computed."""

    UNRESOLVED = 0, "unresolved", "unresolved"
    """Not certainly one of the other kinds."""
    PERIODIC = 1, "period", "periodic"
    REGULAR = 2, "torus", "regular"
    """Neither periodic nor chaotic: a torus."""
    CHAOTIC = 3, "chaotic", "chaotic"
    TRANSIENT = 4, "", "transient chaos"
    """Chaotic for long, then regular."""

    kind_name: str
    """Name by recurrence only, one of `KINDS`; empty where recurrence cannot show the kind."""
    regime_name: str
    """Name by recurrence and the largest Lyapunov exponent, one of `REGIMES`."""

    def __new__(cls, code: int, kind_name: str, regime_name: str) -> "Regime":
        member = int.__new__(cls, code)
        # as an IntEnum a member is its code, with the names as attributes
        member._value_, member.kind_name, member.regime_name = code, kind_name, regime_name
        return member

    @classmethod
    def codes(cls, kind_names: Sequence[str] | np.ndarray) -> np.ndarray:
        """Return the codes for an array of names of `KINDS`."""
        codes = {member.kind_name: int(member) for member in cls}
        return np.array([codes[name] for name in np.ravel(kind_names)], int).reshape(np.shape(kind_names))

    @classmethod
    def kind_names(cls, codes: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the names of `KINDS` for an array of codes."""
        return np.asarray(np.array([member.kind_name for member in cls])[codes])

    @classmethod
    def regime_names(cls, codes: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the names of `REGIMES` for an array of codes."""
        return np.asarray(np.array([member.regime_name for member in cls])[codes])


KINDS = "period", "torus", "chaotic", "unresolved"
"""Names for kinds of motions by recurrence, in the order of legends."""
REGIMES = "periodic", "regular", "chaotic", "unresolved", "transient chaos"
"""Names for kinds of motions by recurrence and the largest exponent, in the order of legends."""


def lasting(name: str, least_mean_life: float | Numbers) -> str:
    """Return the label of a regime; for chaos with the measured least mean life, if any.

    A transient that lasts longer than this life cannot be distinguished from chaos.

    **Arguments:** `name`: of `REGIMES`; `least_mean_life`: of each case [forcing periods], see
    `slipperjax.lyapunov_sweep`, NaN where it was not measured.
    """
    least_mean_life = numbers("least_mean_life", least_mean_life)
    known = np.ravel(least_mean_life)[np.isfinite(np.ravel(least_mean_life))]
    if name != Regime.CHAOTIC.regime_name or not len(known):
        return name
    return f"{name} (mean life {known.min():.0f} periods or more)"
