"""Where a sweep is stored, and how it is cut and shared."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...tools import brief, whole, yes_or_no


@dataclass(frozen=True)
class Store:
    """A zarr store on a disk that all workers share.

    ```python
    sj.sweep(scene, grid, store=sj.Store("map.zarr", fresh=True))
    ```
    """

    path: Path
    tile: int | None = None
    """Cases, about, that are computed and written as one: what a crash can lose; default from the grid."""
    fresh: bool = False
    """Whether what the store holds is deleted first."""
    share: tuple[int, int] | None = None
    """(i, n): compute the i-th of n shares only, i from 1 to n, beside other processes that compute the others."""
    reuse: Path | None = None
    """Another store of the same call over other values: cases that it has are copied."""

    def __post_init__(self):
        path = Path(self.path)
        if path.suffix != ".zarr":
            raise ValueError(f"Argument `store` must be a path that ends in .zarr, but is {str(path)!r}.")
        object.__setattr__(self, "path", path)
        if self.tile is not None:
            whole("tile", self.tile, 1)
        yes_or_no("fresh", self.fresh)
        if self.reuse is not None:
            object.__setattr__(self, "reuse", Path(self.reuse))
        if self.share is not None:
            i, n = check_share(self.share)
            object.__setattr__(self, "share", (i, n))
            if self.fresh:
                raise ValueError("Argument `fresh` must be False for a share, whose store others write to.")


def check_share(share: Any) -> tuple[int, int]:
    """(i, n) with 1 <= i <= n; raises `ValueError`."""
    good = isinstance(share, tuple | list) and len(share) == 2 and all(isinstance(v, int) for v in share)
    if not good or not 1 <= share[0] <= share[1]:
        raise ValueError(f"Argument `share` must be (i, n) with i from 1 to n, but is {brief(share)}.")
    return share[0], share[1]


def store_of(given: Any) -> Store:
    """The store of an argument, a path or a `Store`."""
    if isinstance(given, Store):
        return given
    if not isinstance(given, str | Path):
        raise ValueError(f"Argument `store` must be a path or a slipperjax.Store, but is {brief(given)}.")
    return Store(Path(given))
