"""Files of a command: OUT with endings, written whole or not at all, also after an interrupt."""

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..flow.status import Interrupted
from ..tools.files import listed, write_each

Draw = Callable[[Any], Any]
"""Makes a picture of a dataset."""

PARTIAL = "_partial"
"""Added to the name of a result that an interrupt cut short: a name without it is that of a whole one."""


def make_folder(folder: Path, out: Path) -> None:
    """Make the folder to write into, before anything long is begun.

    **Raises:** `ValueError` where it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"Option --out must name a place that can be written, but {out}: {error}") from error


def fitting(ds: Any, **options: Any) -> Any:
    """Draw the picture that fits a dataset."""
    # imported when it draws: help and errors need not wait for it
    from ..plots.picture import plot

    return plot(ds, **options)


def _picture(ds: Any, draw: Draw) -> bytes:
    """Draw a dataset by `draw`, as the content of a PNG file."""
    import matplotlib
    import numpy as np

    matplotlib.use("Agg")
    from ..plots.style import png

    return png(np.ravel(draw(ds))[0].figure, 300)


class Outputs:
    """The files of a command: OUT with endings."""

    def __init__(self, out: Path, *endings: str):
        """Make the folder, and say which files will be replaced, before anything long is begun.

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
        old = [str(path) for path in paths if path.exists()]
        if old:
            print(f"{listed(old)} will be replaced", file=sys.stderr)

    def write(
        self, ds: Any, draw: Draw | None = fitting, *, partial: bool = False, picture: Path | None = None
    ) -> str:
        """Write a dataset as OUT.nc where that is one of the files, and its picture as OUT.png; says so.

        **Arguments:** `draw`: None for no picture; `partial`: whether an interrupt left it, which makes it
        OUT_partial; `picture`: another name than OUT for the picture.
        """
        out = self.out.with_name(self.out.name + PARTIAL) if partial else self.out
        contents: dict[Path, Any] = {}
        if ".nc" in self.endings:
            # made in memory: HDF5 loses the whole process where a disk is full
            contents[Path(f"{out}.nc")] = lambda: ds.to_netcdf(engine="h5netcdf")
        if draw is not None:
            contents[Path(f"{picture or out}.png")] = lambda: _picture(ds, draw)
        return write_each(contents)


@contextmanager
def keeping(keep: Callable[[Any], str]) -> Iterator[None]:
    """Around what can be interrupted: keeps what was finished until then, and says so.

    **Arguments:** `keep`: keeps a result, and says where it is.
    """
    try:
        yield
    except Interrupted as stop:
        count = f"{stop.finished or 'no'}{'' if stop.of is None else f' of {stop.of}'} {stop.unit} were finished"
        kept = "nothing is written" if stop.result is None else keep(stop.result)
        print(f"{count}: {kept}", file=sys.stderr)
        raise


def step_error(scene: Any, changes: Any) -> str:
    """Say by how much half the step changes forcing periods: the most of some, in multiples of `accuracy_scales`."""
    import numpy as np

    from ..model.kinematics import share_of_scale

    most = float(np.max(changes))
    share = float(share_of_scale(scene))
    if not np.isfinite(most):
        return "half the step does not stay finite"
    units = f"{share:g} mm, {10 * share:g} mrad, 1 m/s, 10 rad/s"
    return f"half the step changes a period by {most:.1e} (unit: {units})"
