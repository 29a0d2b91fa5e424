"""The kinds of motions: one code, with the words that results and pictures have for it."""

import enum
from typing import Any

import numpy as np


class Regime(enum.IntEnum):
    """Code of a kind of motion, whose words results have; 0 also marks cases that were not computed."""

    UNRESOLVED = 0, "unresolved", "unresolved"
    """None of the others with certainty."""
    PERIODIC = 1, "period", "periodic"
    REGULAR = 2, "torus", "regular"
    """Neither periodic nor chaotic: a torus."""
    CHAOTIC = 3, "chaotic", "chaotic"
    TRANSIENT = 4, "", "transient chaos"
    """Chaotic for long, and regular in the end."""

    kind: str
    """Word for it where motions are told apart by recurrence; empty where that cannot tell."""
    regime: str
    """Word for it where the largest Lyapunov exponent counts, too."""

    def __new__(cls, number: int, kind: str, regime: str) -> "Regime":
        member = int.__new__(cls, number)
        member._value_, member.kind, member.regime = number, kind, regime
        return member

    @classmethod
    def of_kind(cls, word: str) -> "Regime":
        """Gives the member with a word of `KINDS`."""
        return next(member for member in cls if member.kind == word)

    @classmethod
    def kinds(cls, numbers: Any) -> np.ndarray:
        """Gives the words of `KINDS` for an array of numbers."""
        return np.asarray(np.array([member.kind for member in cls])[numbers])

    @classmethod
    def regimes(cls, numbers: Any) -> np.ndarray:
        """Gives the words of `REGIMES` for an array of numbers."""
        return np.asarray(np.array([member.regime for member in cls])[numbers])


_SHOWN = Regime.PERIODIC, Regime.REGULAR, Regime.CHAOTIC, Regime.UNRESOLVED, Regime.TRANSIENT
KINDS = tuple(member.kind for member in _SHOWN if member.kind)
"""Words for kinds of motions by recurrence, in the order of legends."""
REGIMES = tuple(member.regime for member in _SHOWN)
"""Words for kinds of motions by recurrence and the largest exponent, in the order of legends."""
