"""How a grid is cut: equal blocks, each one task and one chunk of every stored array."""

import math
from typing import NamedTuple

SMALLEST, LARGEST = 2048, 65_536
"""Cases in a tile where none is asked for: a few seconds of work, and few enough to lose in a crash."""
MANY = 4096
"""Tiles above which they grow up to `LARGEST`: each has a file for every variable."""


class Tiling(NamedTuple):
    """A grid as blocks of equal shape, cut off at its ends, numbered with the last dimension fastest."""

    shape: tuple[int, ...]
    """Of the grid."""
    tile: tuple[int, ...]
    """Of a block."""

    @property
    def across(self) -> tuple[int, ...]:
        """Blocks along each dimension."""
        return tuple(-(-n // m) for n, m in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Blocks in all."""
        return math.prod(self.across)

    def place(self, number: int) -> tuple[int, ...]:
        """Where a block is, counted in blocks."""
        found = []
        for n in reversed(self.across):
            number, at = divmod(number, n)
            found.append(at)
        return tuple(reversed(found))

    def region(self, number: int) -> tuple[slice, ...]:
        """The cases of a block, a slice for each dimension."""
        cuts = zip(self.place(number), self.shape, self.tile, strict=True)
        return tuple(slice(at * m, min((at + 1) * m, n)) for at, n, m in cuts)

    def cases(self, number: int) -> int:
        """How many there are in a block."""
        return math.prod(cut.stop - cut.start for cut in self.region(number))


def tiling(shape: tuple[int, ...], size: int | None = None) -> Tiling:
    """A grid in blocks of about `size` cases, whole along the last dimensions.

    By default a block has `SMALLEST`, or more where there would be more than `MANY` blocks.
    """
    if size is None:
        size = min(max(SMALLEST, math.prod(shape) // MANY), LARGEST)
    tile, left = [1] * len(shape), size
    for k in reversed(range(len(shape))):
        pieces = -(-shape[k] // max(left, 1))
        tile[k] = -(-shape[k] // pieces)
        left //= shape[k]
    return Tiling(shape, tuple(tile))
