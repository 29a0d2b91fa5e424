"""Files of a command: OUT with endings, written whole or not at all, also after an interrupt."""

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial as partial_of
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..flow.status import Interrupted
from ..tools.files import Content, listed, write_each

if TYPE_CHECKING:
    import matplotlib.axes
    import xarray

Draw = Callable[["xarray.Dataset"], "matplotlib.axes.Axes | np.ndarray"]
"""Draws a dataset; returns Axes, or an array of them."""

PICTURES = (".png", ".pdf", ".svg")
"""Endings of pictures; the first is that of a command whose --out has none."""
PARTIAL = "_partial"
"""Added to the names of files with the part of a result that was finished before an interrupt."""


def make_folder(folder: Path, out: Path) -> None:
    """Make the folder of `out`; raise `ValueError` where it cannot be made or written to.

    Commands call this first, so that no long computation ends without a place for its result.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # permissions alone do not tell whether a disk takes a file
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"Option --out must name a place that can be written, but {out}: {error}") from error


def fitting(ds: "xarray.Dataset", **options: object) -> "matplotlib.axes.Axes | np.ndarray":
    """Draw the picture that fits a dataset; import matplotlib only now, so that help and errors need not wait."""
    from ..plots.picture import plot

    return plot(ds, **options)


def _picture(ds: "xarray.Dataset", draw: Draw, ending: str) -> bytes:
    """Return the content of a file of a dataset's picture, drawn by `draw`."""
    import matplotlib

    matplotlib.use("Agg")  # which needs no screen
    from ..plots.style import FILES

    # all Axes of a picture are in one figure
    return FILES[ending](np.asarray(draw(ds)).flat[0].figure)


class Outputs:
    """The files that a command writes: OUT with each of its endings."""

    pictures = PICTURES
    """Endings of pictures."""

    def __init__(self, out: Path, *endings: str):
        """Make the folder, and print which files will be replaced.

        **Raises:** `ValueError` where they cannot be written.
        """
        if out.name in ("", ".."):
            raise ValueError(f"Option --out must name files, as ./result does, but is the folder '{out}'.")
        make_folder(out.parent, out)
        self.out = out
        self.endings = endings
        paths = [Path(f"{out}{ending}") for ending in endings]
        # a folder in the way is found before anything runs
        for path in paths:
            if path.is_dir():
                raise ValueError(f"Option --out must name a place for {path.name}, but {path} is a folder.")
        # on standard error, so that output stays what scripts read
        old = [str(path) for path in paths if path.exists()]
        if old:
            print(f"{listed(old)} will be replaced", file=sys.stderr)

    def write(
        self,
        ds: "xarray.Dataset",
        draw: Draw | None = fitting,
        *,
        partial: bool = False,
        redraw: "Outputs | None" = None,
    ) -> str:
        """Write a dataset to OUT.nc, and its picture to OUT.png or another ending, as far as these are its files.

        **Arguments:** `draw`: None for no picture; `partial`: whether it is what an interrupt left, which is
        written to OUT_partial; `redraw`: files whose picture is replaced in place of making one.

        **Returns:** what was written, in words.
        """
        out = self.out.with_name(self.out.name + PARTIAL) if partial else self.out
        contents: dict[Path, Callable[[], Content]] = {}
        if ".nc" in self.endings:
            # made in memory: HDF5 loses the whole process where a disk is full
            contents[Path(f"{out}.nc")] = lambda: ds.to_netcdf(engine="h5netcdf")
        if draw is not None:
            contents |= self._pictures(ds, draw, out) if redraw is None else redraw._pictures(ds, draw, redraw.out)
        return write_each(contents | self._others(ds, out))

    def _pictures(self, ds: "xarray.Dataset", draw: Draw, out: Path) -> dict[Path, Callable[[], Content]]:
        """Return functions that make the content of pictures, by their paths."""
        ends = [ending for ending in self.endings if ending in self.pictures]
        return {Path(f"{out}{ending}"): partial_of(_picture, ds, draw, ending) for ending in ends}

    def _others(self, ds: "xarray.Dataset", out: Path) -> dict[Path, Callable[[], Content]]:
        """Return functions that make the content of further files, by their paths."""
        return {}


class Reports(Outputs):
    """The files that a run writes, of which a PDF is a report with several pages, and others are tables."""

    pictures = (".png", ".svg")

    def _others(self, ds: "xarray.Dataset", out: Path) -> dict[Path, Callable[[], Content]]:
        from ..plots.report import report_files

        ends = [ending for ending in self.endings if ending not in (".nc", *self.pictures)]
        return report_files(ds, out, ends) if ends else {}


def kept_in(store: Path | None) -> str:
    """Return in words where an interrupt leaves what was finished: in a store, or nowhere."""
    is_there = store is not None and store.exists()
    return f"kept in {store}; the same command goes on" if is_there else "nothing is written"


@contextmanager
def keeping(keep: Callable[[Any], str], store: Path | None = None) -> Iterator[None]:
    """Keep what an interrupted computation inside has finished, and print how much it is and where it is kept.

    **Arguments:** `keep`: stores a partial result, and returns where it is, in words; `store`: where results go
    before, if anywhere.
    """
    try:
        yield
    except Interrupted as stop:
        count = f"{stop.finished} of {stop.of}" if stop.of else stop.finished or "no"
        # some computations have nothing of use before their end
        kept = kept_in(store) if stop.result is None else keep(stop.result)
        print(f"{count} {stop.unit} were finished: {kept}", file=sys.stderr)
        raise
    except KeyboardInterrupt:
        # before the first case or after the last one
        print(kept_in(store), file=sys.stderr)
        raise
