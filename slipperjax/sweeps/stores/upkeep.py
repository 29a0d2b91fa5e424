"""Looking after stores: how far they are, whether they can be read, and shares brought together."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...tools.limits import shown_bytes
from .archive import Archive, asked_of, check_asked, open_archive


class StoreStatus(NamedTuple):
    """How far a store is."""

    tiles: int
    tiles_done: int
    cases: int
    cases_done: int
    bytes: int
    """On disk."""

    def __str__(self) -> str:
        return (
            f"{self.cases_done} of {self.cases} cases ({self.cases_done / self.cases:.1%}), {self.tiles_done} of "
            f"{self.tiles} tiles, {shown_bytes(float(self.bytes))}"
        )


def store_status(path: Any) -> StoreStatus:
    """How much of a store is done, without reading results.

    **Raises:** `ValueError` for a path that is no store of slipperjax.
    """
    archive = open_archive(Path(path))
    done = archive.done()
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    return StoreStatus(len(done), int(done.sum()), int(np.prod(archive.tiles.shape)), archive.finished(done), size)


def check_store(path: Any, *, repair: bool = False) -> list[str]:
    """Reads every complete tile of a store, and gives what is wrong, a line each; nothing where all is well.

    **Arguments:** `repair`: make damaged tiles absent, so that the same call as before computes them again.
    """
    archive, lines = open_archive(Path(path)), []
    for number, problem in archive.damaged():
        lines.append(f"tile {number}: {problem}")
        if repair:
            archive.forget(number)
    return lines


def merge_stores(paths: Sequence[Any], into: Any) -> StoreStatus:
    """Collects the complete tiles of stores of one call, such as shares that were computed on different disks.

    **Arguments:** `into`: the path of a new store, or of one of the same call.

    **Raises:** `ValueError` where the stores are of different calls.
    """
    parts = [open_archive(Path(path)) for path in paths]
    if not parts:
        raise ValueError("Argument `paths` must name one store or more, but is empty.")
    for part in parts[1:]:
        check_asked(part, asked_of(parts[0]))
    target = Path(into)
    if not target.exists():
        _copy_empty(parts[0], target)
    whole = open_archive(target)
    check_asked(whole, asked_of(parts[0]))
    done = whole.done()
    for part in parts:
        for number in np.flatnonzero(part.done() & ~done).tolist():
            for source, file in zip(part.files(number).values(), whole.files(number).values(), strict=True):
                file.parent.mkdir(parents=True, exist_ok=True)
                making = file.with_name(f"{file.name}.{os.getpid()}.partial")
                shutil.copyfile(source, making)
                os.replace(making, file)
            done[number] = True
    return store_status(target)


def _copy_empty(archive: Archive, target: Path) -> None:
    """Makes a store of the same call without any tile."""
    making, by_tile = target.with_name(f".{target.name}.{os.getpid()}.part"), archive.arrays()
    for source in archive.path.rglob("*"):
        inside = source.relative_to(archive.path)
        if source.is_file() and not (inside.parts[0] in by_tile and "c" in inside.parts[1:]):
            making.joinpath(inside).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, making / inside)
    os.rename(making, target)
