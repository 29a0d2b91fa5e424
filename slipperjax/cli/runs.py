"""The command that runs a scene over a length of rail, and reports what a track test would measure."""

import itertools
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from ..flow.status import is_lost
from ..model.parameters import PARAMETERS, parameter
from ..tools.checks import require
from .files import Reports, keeping, kept_in
from .options import (
    COUNT,
    FILE,
    INPUT,
    LOST,
    VALUE,
    Case,
    app,
    begin,
    given,
    option,
    parameters_of,
    shown_value,
    takes_case,
)

BESIDE = "-environment"
"""Added to the names of files with the vibration environment of a run."""
SEPARATOR = "\t"
"""Between the words of --over, which may have spaces in them."""


class _Comparing(click.Command):
    """A command whose option --over takes a name and any number of values."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "--over" in args:
            first = args.index("--over") + 1
            # the name, and all that begin as numbers do, such as 2024_sled.toml, which is the file
            is_value = lambda word: re.match(r"[-+]?\.?\d", word) and not word.lower().endswith(".toml")
            values = itertools.takewhile(is_value, args[first + 1 :])
            joined = [*args[first : first + 1], *values]
            args = [*args[:first], SEPARATOR.join(joined), *args[first + len(joined) :]]
        return super().parse_args(ctx, args)


@app.command(cls=_Comparing)
@begin
@option(
    "--over",
    str,
    f"Compare designs: a parameter and two or more values. {parameters_of(PARAMETERS)}",
    metavar="NAME VALUE VALUE ...",
)
@option(
    "--rails",
    COUNT,
    "With --over: number of rails, the survey first, or seeds of a random one; the median takes 8, 0.95 takes 80.",
    default=80,
)
@option("--starts", COUNT, "With --over: number of starts on each rail.", default=1)
@option(
    "--quantiles",
    float,
    "With --over: share of the runs below what is compared; the last one decides; repeat for several.",
    multiple=True,
    default=[0.5, 0.95],
)
@option("--store", FILE, "With --over: keep runs in this store, from which the same command goes on.")
@click.option(
    "--out",
    type=FILE,
    help="File to write, by its ending: .nc (all numbers), .png or .svg (a page), .pdf (a report), .csv (tables of "
    "windows and of each 100 m), .xlsx (tables and summary); without one, .nc and .png; repeat for several.",
    multiple=True,
    default=["run"],
)
@takes_case
@click.argument("scene", metavar="FILE", type=INPUT)
def run(case: Case, begin: float | None, out: tuple[Path, ...], over: str | None, **ensemble: object) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says; or compare
    designs by many runs over the same rails from the same starts.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km"; or -, standard input. With a
    table [environment], the vibration environment of its places is told, too, and written beside each --out with
    -environment in its name.
    """
    from ..flow.datasets import load_environment, load_run, load_units
    from ..plots.environment import environment_summary
    from ..plots.report import summary
    from ..plots.runs import UNITS, RunView
    from ..sweeps.environment import check_environment, environment
    from ..sweeps.runs import run as over_rail
    from ..sweeps.windows import AccelerationHistory, default_records

    file = click.get_current_context().params["scene"]
    # options that the user gave override the file
    of_file = {name: value for name, value in load_run(file).items() if not given(name)}
    options = case.options | {"begin": begin} | of_file
    if over is not None:
        return _compared(case, over, options | ensemble, out, load_units(file))
    for name in ensemble:
        require(not given(name), f"--{name}", "come with --over", ensemble[name])
    files = [_outputs(path) for path in out]
    asked = load_environment(file)
    beside: list[Reports] = []
    if asked is not None:
        # before a long run
        check_environment(case.scene, **asked)
        beside = [Reports(one.out.with_name(f"{one.out.name}{BESIDE}"), *one.endings) for one in files]
        history = AccelerationHistory(math.ceil(max(options.get("window", 1.0), 1.0) * AccelerationHistory.samples))
        options["record"] = [*default_records(case.scene), history]
    with keeping(lambda ds: "\n".join(one.write(ds, partial=True) for one in files)):
        ds = over_rail(case.scene, **options, probe=3, progress=True)
    # reports of the file have them later, too
    ds.attrs[UNITS] = json.dumps(load_units(file))
    for one in files:
        print(one.write(ds))
    lost = is_lost(int(ds["status"]))
    told = [case.text(start=_start(case)), *summary(RunView.of(ds, case.scene))]
    # of a lost run nothing but its status is told
    if asked is not None and not lost:
        report = environment(ds, **asked)
        for one in beside:
            print(one.write(report))
        told += environment_summary(report)
    print("\n".join(told))
    return LOST if lost else 0


def _compared(case: Case, over: str, options: dict[str, object], out: tuple[Path, ...], units: Sequence[str]) -> int:
    """Compare designs, write and print what was found."""
    from ..plots.comparisons import verdict
    from ..plots.runs import UNITS
    from ..sweeps.compare import compare

    name, *written = over.split(SEPARATOR)
    require(len(written) > 1, "--over", "have a parameter and two or more values", over.replace(SEPARATOR, " "))
    q = parameter(name, case.scene)
    values = q.from_shown(np.array([shown_value(q, VALUE.convert(word, None, None)) for word in written]))
    files = [_outputs(path) for path in out]
    store = options["store"]
    without = "nothing is written; with --store runs are kept, and the same command goes on"
    with keeping(lambda ds: without if store is None else kept_in(store), store):
        ds = compare(case.scene, {name: values}, progress=True, **options)
    ds.attrs[UNITS] = json.dumps(units)
    for one in files:
        print(one.write(ds))
    print("\n".join([case.text([name], _start(case)), *verdict(ds)]))
    # by the last quantile, which decides
    return 0 if np.isfinite(ds["value"].values[..., -1]).all() else LOST


def _start(case: Case) -> str:
    """Return in words where a run begins whose scene has no start; empty for one that has."""
    return "from rest on the rail" if case.start is None else ""


def _outputs(path: Path) -> Reports:
    """Return the files of a value of --out."""
    from ..plots.report import endings

    # what comes after a point in a number is no ending
    if not path.suffix[1:].isalpha():
        return Reports(path, ".nc", ".png")
    return Reports(path.with_suffix(""), *endings(path, ".nc", *Reports.pictures, name="--out"))
