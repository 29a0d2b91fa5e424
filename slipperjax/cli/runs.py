"""The command that runs a scene over a length of rail, and reports what a track test would measure."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..flow.status import is_lost
from .files import Outputs, fitting, keeping
from .options import FILE, LOST, Case, app, begin, given, takes_case

if TYPE_CHECKING:
    import xarray


@app.command()
@begin
@click.option(
    "--out",
    type=FILE,
    help="File to write, by its ending: .nc (all numbers), .png (a page), .pdf (a report), .csv (tables of windows "
    "and of each 100 m), .xlsx (tables and summary); without one, .nc and .png; repeat for several.",
    multiple=True,
    default=["run"],
)
@takes_case
@click.argument("scene", metavar="FILE", type=FILE)
def run(case: Case, begin: float | None, out: tuple[Path, ...]) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km".
    """
    from ..flow.datasets import load_run, load_units
    from ..plots.report import summary
    from ..plots.runs import UNITS, RunView
    from ..sweeps.runs import run as over_rail

    file = click.get_current_context().params["scene"]
    # options that the user gave override the file
    of_file = {name: value for name, value in load_run(file).items() if not given(name)}
    options = case.options | {"begin": begin} | of_file
    files = [_outputs(path) for path in out]
    with keeping(lambda ds: "\n".join(_write(one, ds, partial=True) for one in files)):
        ds = over_rail(case.scene, **options, probe=3, progress=True)
    # reports of the file have them later, too
    ds.attrs[UNITS] = json.dumps(load_units(file))
    for one in files:
        print(_write(one, ds))
    print("\n".join([case.text(), *summary(RunView.of(ds, case.scene))]))
    return LOST if is_lost(int(ds["status"])) else 0


def _outputs(path: Path) -> Outputs:
    """Return the files of a value of --out."""
    from ..plots.report import endings

    # what comes after a point in a number is no ending
    if not path.suffix[1:].isalpha():
        return Outputs(path, ".nc", ".png")
    return Outputs(path.with_suffix(""), *endings(path, ".nc", ".png", name="--out"))


def _write(files: Outputs, ds: "xarray.Dataset", *, partial: bool = False) -> str:
    """Write a run; return what was written."""
    return files.write(ds, fitting if ".png" in files.endings else None, partial=partial)
