"""Where a sweep is stored, how its grid is cut into equal blocks, and who may write there.

Each block is one task and one chunk of every array.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ...tools.checks import brief, whole, yes_or_no


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

    def __post_init__(self):
        path = Path(self.path)
        if path.suffix != ".zarr":
            raise ValueError(f"Argument `store` must be a path that ends in .zarr, but is {str(path)!r}.")
        object.__setattr__(self, "path", path)
        if self.tile is not None:
            whole("tile", self.tile, 1)
        yes_or_no("fresh", self.fresh)
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


WAIT = 60.0
"""Seconds for which a share waits until another one has made the store."""


class StoreInUse(OSError):
    """Another process writes to the store. Its lock ends with that process, however this ends."""


def _lock_path(store: Path, share: tuple[int, int] | None = None) -> Path:
    return store.with_name(store.name + (".lock" if share is None else f".{share[0]}-of-{share[1]}.lock"))


@contextmanager
def writing(store: Store) -> Iterator[None]:
    """Holds the right to write to a store, or to a share of it.

    **Raises:** `StoreInUse`; `OSError` where the folder is missing or read-only.
    """
    with _held(_lock_path(store.path, store.share)):
        if store.share is None:
            for other in store.path.parent.glob(f"{store.path.name}.*-of-*.lock"):
                with _held(other):
                    pass
        yield


@contextmanager
def making(store: Store) -> Iterator[None]:
    """Holds the right to make a store, for which other shares wait; who writes to all of it has it already."""
    if store.share is None:
        yield
    else:
        with _held(_lock_path(store.path), WAIT):
            yield


@contextmanager
def _held(path: Path, wait: float = 0.5) -> Iterator[None]:
    """Holds a lock, and deletes its file afterwards."""
    import filelock

    if not path.parent.is_dir():
        raise FileNotFoundError(f"No such folder: {path.parent}")
    lock = filelock.FileLock(path)
    try:
        lock.acquire(timeout=wait)
    except filelock.Timeout:
        raise StoreInUse(
            f"Another process writes to {path.name.removesuffix('.lock')} (it holds {path}); wait for it or stop it, "
            "then call again: what it has finished is kept."
        ) from None
    except PermissionError:
        raise PermissionError(f"{path.parent} is protected against writing") from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: who waits for it then looks for a new one
        lock.release()
