"""Files of a command: OUT with endings, written whole or not at all, also after an interrupt."""

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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


def _picture(ds: "xarray.Dataset", draw: Draw) -> bytes:
    """Return the content of a PNG file of a dataset, drawn by `draw`."""
    import matplotlib

    matplotlib.use("Agg")  # which needs no screen
    from ..plots.style import png

    # all Axes of a picture are in one figure
    return png(np.asarray(draw(ds)).flat[0].figure, 300)


class Outputs:
    """The files that a command writes: OUT with each of its endings."""

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
        self, ds: "xarray.Dataset", draw: Draw | None = fitting, *, partial: bool = False, picture: Path | None = None
    ) -> str:
        """Write a dataset to OUT.nc, if it is one of the files, its picture to OUT.png, and the files of its report.

        **Arguments:** `draw`: None for no picture; `partial`: whether it is what an interrupt left, which is
        written to OUT_partial; `picture`: name of the picture instead of OUT.

        **Returns:** what was written, in words.
        """
        out = self.out.with_name(self.out.name + PARTIAL) if partial else self.out
        contents: dict[Path, Callable[[], Content]] = {}
        if ".nc" in self.endings:
            # made in memory: HDF5 loses the whole process where a disk is full
            contents[Path(f"{out}.nc")] = lambda: ds.to_netcdf(engine="h5netcdf")
        if draw is not None:
            contents[Path(f"{picture or out}.png")] = lambda: _picture(ds, draw)
        of_report = [ending for ending in self.endings if ending not in (".nc", ".png")]
        if of_report:
            from ..plots.report import report_files

            contents |= report_files(ds, out, of_report)
        return write_each(contents)


@contextmanager
def keeping(keep: Callable[[Any], str]) -> Iterator[None]:
    """Keep what an interrupted computation inside has finished, and print how much it is and where it is kept.

    **Arguments:** `keep`: stores a partial result, and returns where it is, in words.
    """
    try:
        yield
    except Interrupted as stop:
        count = f"{stop.finished or 'no'}{'' if stop.of is None else f' of {stop.of}'} {stop.unit} were finished"
        # some computations have nothing of use before their end
        kept = "nothing is written" if stop.result is None else keep(stop.result)
        print(f"{count}: {kept}", file=sys.stderr)
        raise
