"""Files of a command: the files of --out, written whole or not at all, also after an interrupt."""

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..flow.status import Interrupted
from ..results.writing import PICTURES, check_ending
from ..tools.files import listed

if TYPE_CHECKING:
    from ..results.result import AbstractResult

USUAL = (".nc", ".png")
"""Endings of the files for an --out without an ending."""
PARTIAL = "_partial"
"""Text added to the names of files with a partial result after an interrupt."""


def make_folder(folder: Path, out: Path) -> None:
    """Make the folder of `out`; raise `ValueError` where this is impossible, or where it cannot be written to.

    Commands call this first, so that no long computation ends without a place for its result.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # permissions do not show whether a disk takes a file
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"Option --out must name a place that can be written, but {out}: {error}") from error


class Outputs:
    """The files that a command writes."""

    def __init__(self, out: Sequence[Path], usual: Sequence[str] = USUAL):
        """Make the folders, and print which files will be replaced.

        **Arguments:** `out`: values of --out; `usual`: endings of the files for one without an ending.

        **Raises:** `ValueError` for an unknown ending, and where the files cannot be written.
        """
        self.paths: list[Path] = []
        for path in out:
            if path.name in ("", ".."):
                raise ValueError(f"Option --out must name files, as ./result does, but is the folder '{path}'.")
            # the digits after the point of a number are no ending
            if path.suffix[1:].isalpha():
                check_ending(path, "--out")
                self.paths.append(path)
            else:
                self.paths += [path.with_name(path.name + ending) for ending in usual]
        for path in self.paths:
            make_folder(path.parent, path)
            # a folder at the place of a file is found before anything runs
            if path.is_dir():
                raise ValueError(f"Option --out must name a place for {path.name}, but {path} is a folder.")
        # on standard error, so that scripts read unchanged output
        old = [str(path) for path in self.paths if path.exists()]
        if old:
            print(f"{listed(old)} will be replaced", file=sys.stderr)

    def named(self, more: str) -> "Outputs":
        """Return files with a text added to their names, before the ending."""
        return Outputs([path.with_name(f"{path.stem}{more}{path.suffix}") for path in self.paths])

    @property
    def pictures(self) -> list[Path]:
        """The files that are pictures."""
        return [path for path in self.paths if path.suffix.lower() in PICTURES]

    def write(self, result: "AbstractResult", *, drawn: bool = True, **options: object) -> str:
        """Write a result.

        **Arguments:** `drawn`: whether pictures are also written; `options`: of the picture.

        **Returns:** a text that names the written files.
        """
        paths = [path for path in self.paths if drawn or path not in self.pictures]
        return result.write(*paths, **options)

    def keep(self, result: "AbstractResult", **options: object) -> str:
        """Write the partial result of an interrupt, with `PARTIAL` in the names of the files."""
        return self.named(PARTIAL).write(result, **options)


def kept_in(store: Path | None) -> str:
    """Return a text that says where an interrupt leaves finished results: in a store, or nowhere."""
    is_there = store is not None and store.exists()
    return f"kept in {store}; the same command goes on" if is_there else "nothing is written"


@contextmanager
def keeping(keep: Callable[[Any], str], store: Path | None = None) -> Iterator[None]:
    """Keep the finished part of an interrupted computation inside, and print its extent and its place.

    **Arguments:** `keep`: stores a partial result, and returns a text on its place; `store`: where results were
    written before, if anywhere.
    """
    try:
        yield
    except Interrupted as stop:
        count = f"{stop.finished} of {stop.of}" if stop.of else stop.finished or "no"
        # some computations have no useful result before their end
        kept = kept_in(store) if stop.result is None else keep(stop.result)
        print(f"{count} {stop.unit} were finished: {kept}", file=sys.stderr)
        raise
    except KeyboardInterrupt:
        # before the first case or after the last one
        print(kept_in(store), file=sys.stderr)
        raise


def said(*lines: str) -> None:
    """Print lines at once, also where the output is a file."""
    print("\n".join(lines), flush=True)
