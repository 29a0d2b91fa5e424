"""Estimated time, memory and disk of a sweep: impossible sweeps are refused before anything is compiled."""

import math
from dataclasses import dataclass, field

from ..tools.checks import warn
from ..tools.limits import cores, refuse_impossible, shown_bytes, shown_time
from .grid import Tiling


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Time, memory and disk of a sweep, counted from shapes or measured on a few of its cases."""

    cases: int
    per_case: float
    """Time of a case on one core [s]."""
    bytes_per_case: float
    """Memory of the results of a case."""
    periods: str = ""
    """Length of a case as a text, such as " of 364 forcing periods"."""
    workers: int = field(default_factory=cores)
    """Cores that compute."""
    tiles: Tiling | None = None
    """Number of tiles of a store, one at a time for each worker; None: no store, all results in memory."""
    free: float = math.inf
    """Bytes that are free on the disk of the store."""
    shared: bool = False
    """Whether other processes also compute the store: those of an executor, or of other shares."""
    stored_per_case: float | None = None
    """Bytes of a case on disk, compressed; None where no case was computed."""
    at_work: float = 0.0
    """Memory of the batches at work, for example of their rails [bytes]."""
    facts: str = ""
    """Further measured facts, as lines of text."""

    @classmethod
    def counted(cls, cases: int, steps: float, values: int, periods: str, at_work: float = 0.0) -> "Estimate":
        """Return the estimate of cases with so many steps and kept values each, and `periods` in words."""
        # a step of a case in a batch takes 0.38 us of one core, see the page on speed
        per_case = dict(per_case=4e-7 * steps, bytes_per_case=8.0 * values)
        return cls(cases=cases, periods=periods, at_work=at_work, **per_case)

    @property
    def seconds(self) -> float:
        """Total time [s]."""
        if self.tiles is None or not self.shared:
            return self.cases * self.per_case / self.workers
        # each worker computes whole tiles, one after the other
        rounds = math.ceil(self.tiles.count / self.workers)
        return rounds * min(self.tiles.size, self.cases) * self.per_case

    @property
    def memory(self) -> float:
        """Bytes that the process needs in addition to its programs."""
        if self.tiles is None:
            # results are in memory twice while they are put together; scene, start and labels take a kilobyte
            return self.at_work + self.cases * (2 * self.bytes_per_case + 1000)
        # three times while a tile is written
        at_once = 1 if self.shared else self.workers
        return self.at_work + 3 * at_once * self.tiles.size * self.bytes_per_case

    @property
    def stored(self) -> float:
        """Total bytes on disk."""
        per_case = self.bytes_per_case if self.stored_per_case is None else self.stored_per_case
        return self.cases * per_case

    def check(self) -> None:
        """Refuse a sweep that needs more memory than there is or, in this process, more than a year.

        Warn of a sweep that takes long, or may not fit on the disk of its store.

        **Raises:** `ValueError` that states memory and time.
        """
        # it is not known here how many processes share the work
        seconds = 0.0 if self.shared else self.seconds
        refuse_impossible(f"{self.cases} cases{self.periods}", self.memory, seconds)
        if self.tiles is not None and self.stored > self.free:
            warn(
                f"The store needs about {shown_bytes(self.stored)}, and its disk has {shown_bytes(self.free)}: keep "
                "less of each case, such as record=['peak_force'], or take another disk."
            )

    def __str__(self) -> str:
        tiles = ""
        disk = []
        if self.tiles is not None:
            shape = " x ".join(map(str, self.tiles.tile))
            tiles = f" in {self.tiles.count} tiles of {self.tiles.size} ({shape})"
            disk = [f"disk: {shown_bytes(self.stored)}, {shown_bytes(self.free)} free"]
        each = f"{self.per_case * 1e3:.3g} ms per case and core"
        lines = [
            f"{self.cases} cases{tiles}",
            f"time: {shown_time(self.seconds)} on {self.workers} cores, {each}",
            f"memory: {shown_bytes(self.memory)} of results at once",
            *disk,
        ]
        return "\n".join([*lines, self.facts])
