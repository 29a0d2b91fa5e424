"""What a command writes: OUT with endings, whole or not at all, and what an interrupt leaves."""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..tools.files import listed, said, write_each
from .options import make_folder
from .waiting import while_compiling

PARTIAL = "_partial"
"""What is added to the name of what an interrupt left: a name without it is that of a whole result."""


def drawn_by(name: str) -> Callable[[Any], Any]:
    """A function of `slipperjax.plots`, which is imported when it draws: compiling need not wait for it."""
    return lambda ds: getattr(importlib.import_module("slipperjax.plots"), name)(ds)


def _import_writers() -> None:
    """Imports what writes and draws: beside compiling, which does not hold the interpreter's lock."""
    try:
        import h5netcdf  # noqa: F401
        import matplotlib
        import xarray as xr

        matplotlib.use("Agg")
        xr.Variable((), 0.0)  # looks for other kinds of arrays, which imports their packages
        importlib.import_module("slipperjax.plots")
    except Exception:  # who needs it will say so
        pass


def _picture(ds: Any, draw: Callable[[Any], Any]) -> bytes:
    """What `draw` makes of a dataset, as the content of a PNG file."""
    import matplotlib
    import numpy as np

    matplotlib.use("Agg")
    from ..plots.style import png

    return png(np.ravel(draw(ds))[0].figure, 300)


class Outputs:
    """The files OUT.nc and OUT.png of a command, or others."""

    def __init__(self, out: Path, *endings: str):
        """Makes the folder, and says which files will be replaced, before anything long is begun.

        **Raises:** `ValueError` where they cannot be written.
        """
        make_folder(out.parent, out)
        self.out = out
        paths = [Path(f"{out}{ending}") for ending in endings]
        for path in paths:
            if path.is_dir():
                raise ValueError(f"Option --out must name a place for {path.name}, but {path} is a folder.")
        while_compiling(_import_writers)
        old = [str(path) for path in paths if path.exists()]
        if old:
            print(f"{listed(old)} will be replaced", file=sys.stderr)

    def write(self, ds: Any, draw: Callable[[Any], Any], picture: Path | None = None) -> None:
        """Writes a dataset as OUT.nc, and what `draw` makes of it as OUT.png or with the name `picture`."""
        print(self._write(ds, draw, self.out, picture))

    def _write(self, ds: Any, draw: Callable[[Any], Any], out: Path, beside: Path | None = None) -> str:
        # made in memory: HDF5 loses the whole process where a disk is full
        data = lambda: ds.to_netcdf(engine="h5netcdf")
        return said(write_each({Path(f"{out}.nc"): data, Path(f"{beside or out}.png"): lambda: _picture(ds, draw)}))

    def draw(self, ds: Any, draw: Callable[[Any], Any]) -> None:
        """Writes what `draw` makes of a dataset as OUT.png."""
        print(said(write_each({Path(f"{self.out}.png"): lambda: _picture(ds, draw)})))

    def write_partial(self, ds: Any, draw: Callable[[Any], Any]) -> str:
        """Writes what an interrupt left as OUT_partial.nc and .png, and says so."""
        return self._write(ds, draw, self.out.with_name(self.out.name + PARTIAL))

    @contextmanager
    def keeping(self, draw: Callable[[Any], Any]) -> Iterator[None]:
        """Around a sweep: writes the finished cases of one that is interrupted as OUT_partial.nc and .png."""
        from ..flow.status import Interrupted

        try:
            yield
        except Interrupted as stop:
            if stop.result is None:
                print("no case was finished: nothing is written", file=sys.stderr)
            else:
                kept = self.write_partial(stop.result, draw)
                print(f"{stop.finished} of {stop.of} cases were finished: {kept}", file=sys.stderr)
            raise
