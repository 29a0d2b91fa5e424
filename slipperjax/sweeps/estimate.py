"""One estimate of time, memory and disk: it refuses sweeps, warns of them, and is what `slipperjax.explain` shows."""

import math
import warnings
from contextvars import ContextVar
from dataclasses import dataclass, field, replace

from ..tools.checks import warn
from ..tools.limits import LONGEST, available_memory, cores, refuse_impossible, shown_bytes, shown_time
from .grid import Tiling

SECONDS_PER_STEP = 4e-7
"""Time of a step of one case in a batch, on one core: measured 0.38 us, see the page on speed."""
LEAST_BYTES = 1000.0
"""Memory that a case takes at least: its scene, start, status and labels."""
COPIES_OF_RESULT, COPIES_OF_TILE = 2.0, 3.0
"""How often results are in memory while they are put together, and while a tile is written."""
WEEK = 7 * 86400.0
STORE: ContextVar["CountedEstimate | None"] = ContextVar("STORE", default=None)
"""While the first case of a store is run, which tells its memory: the estimate of all, but for the time of a case."""


@dataclass(frozen=True)
class CountedEstimate:
    """Time, memory and disk of a sweep, counted from the shapes of its results.

    `check` has the only rules: `slipperjax.explain` applies them to numbers that it has measured.
    """

    cases: int
    per_case: float
    """Time [s] of a case on one core, when all cores are busy alike; NaN where it is not known."""
    per_case_memory: float
    """Bytes of the results of a case in memory."""
    periods: str = ""
    """Length of a case in words, such as " of 364 forcing periods"."""
    workers: int = field(default_factory=cores)
    """Cores."""
    tiles: Tiling | None = None
    """Those of a store; without one, all results are in memory at the end."""
    at_once: int = 1
    """Tiles that are in the memory of a machine together."""
    free: float = math.inf
    """Bytes that are free on the disk of the store."""
    shared: bool = False
    """Whether more processes than this one compute the store: an executor's, or those of other shares."""

    @property
    def seconds(self) -> float:
        """Time in all [s]."""
        return self.cases * self.per_case / self.workers

    @property
    def memory(self) -> float:
        """Bytes that the process needs besides its programs."""
        if self.tiles is None:
            return self.cases * (COPIES_OF_RESULT * self.per_case_memory + LEAST_BYTES)
        return self.at_once * self.tiles.size * COPIES_OF_TILE * self.per_case_memory

    @property
    def stored(self) -> float:
        """Bytes on disk in all."""
        return self.cases * self.per_case_memory

    @property
    def stored_text(self) -> str:
        """`stored` in words."""
        return f"{shown_bytes(self.stored)} before it is compressed"

    def check(self) -> None:
        """Refuses a sweep that needs more memory than there is or, without a store, more than a year.

        Of a store that may not fit on its disk it warns, and of more than a day without one. Of a store that one
        process computes it refuses more than a year, and of others it warns of that. The first case of a store is
        judged as all of its cases.

        **Raises:** `ValueError` that names memory and time, or the store.
        """
        if (store := STORE.get()) is not None:
            self = replace(store, per_case=self.per_case, periods=self.periods)
        if self.tiles is None:
            refuse_impossible(f"{self.cases} cases{self.periods}", self.memory, self.seconds)
            return
        memory = available_memory()
        if memory is not None and self.memory > memory:
            raise ValueError(
                f"Argument `store` must have tiles that fit into memory, but {self.at_once} at once of "
                f"{self.tiles.size} cases need {shown_bytes(self.memory)}, of which {shown_bytes(float(memory))} are "
                "available: take smaller tiles, slipperjax.Store(path, tile=...), or keep less of each case."
            )
        if self.stored > self.free:
            warn(
                f"The store needs {self.stored_text}, and its disk has {shown_bytes(self.free)}: keep less of each "
                "case, such as record=['peak_force'], or take another disk."
            )
        if self.seconds > LONGEST:
            takes = f"{shown_time(self.seconds)} on {self.workers} cores"
            weeks = math.ceil(self.workers * self.seconds / WEEK)
            advice = f"{weeks:.3g} cores would be done in a week, see `executor` and shares."
            if not self.shared:
                cases = f"{self.cases} cases{self.periods}"
                raise ValueError(f"Argument `store` must be done in a year, but {cases} take {takes}: {advice}")
            warn(f"The store takes {takes}: {advice}")

    @property
    def problems(self) -> list[str]:
        """The refusal of `check`, or its warnings; nothing where there are none."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                self.check()
                refusal = []
            except ValueError as error:
                refusal = [f"impossible: {error}"]
        return [*refusal, *(f"warning: {one.message}" for one in caught)]
