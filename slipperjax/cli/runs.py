"""The command that runs a scene over a length of rail, and reports the values that a track test would measure."""

import itertools
import json
import math
import re
from typing import TYPE_CHECKING

import click
import numpy as np

from ..flow.status import is_lost
from ..model.parameters import PARAMETERS, parameter
from ..tools.checks import require
from .files import Outputs, keeping, kept_in, said
from .options import (
    COUNT,
    FILE,
    INPUT,
    LOST,
    VALUE,
    Case,
    CommandOf,
    app,
    begin,
    given,
    option,
    parameters_of,
    result,
    shown_value,
    takes_case,
)

if TYPE_CHECKING:
    from ..results.result import Result

FURTHER = "-environment"
"""Text added to the names of files with the vibration environment of a run."""
SEPARATOR = "\t"
"""Separator between the words of --over, because words may have spaces in them."""


class _Comparing(CommandOf):
    """A command whose option --over takes a name and any number of values."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "--over" in args:
            first = args.index("--over") + 1
            # the name, and all words that begin like numbers, except a file such as 2024_sled.toml
            is_value = lambda word: re.match(r"[-+]?\.?\d", word) and not word.lower().endswith(".toml")
            values = itertools.takewhile(is_value, args[first + 1 :])
            joined = [*args[first : first + 1], *values]
            args = [*args[:first], SEPARATOR.join(joined), *args[first + len(joined) :]]
        return super().parse_args(ctx, args)


@app.command(cls=_Comparing, of="sweeps.compare.compare")
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
    "With --over: number of rails, first the survey, or seeds of a random rail; the median needs 8, 0.95 needs 80.",
)
@option("--starts", COUNT, "With --over: number of starts on each rail.")
@option(
    "--quantiles",
    float,
    "With --over: share of the runs with lower values; the last share decides; repeat for several.",
    multiple=True,
)
@option("--store", FILE, "With --over: keep runs in this store, from which the same command continues.")
@result("run")
@takes_case
@click.argument("scene", metavar="FILE", type=INPUT)
def run(case: Case, begin, out, over, **ensemble) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says; or compare
    designs by many runs over the same rails from the same starts.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km"; or -, standard input. With a
    table [environment], the vibration environment of its places is also printed, and written into further files with
    -environment in their names.
    """
    from ..sweeps.environment import check_environment, environment
    from ..sweeps.runs import run as over_rail
    from ..sweeps.windows import AccelerationHistory, default_records

    file = case.file
    path = click.get_current_context().params["scene"]
    if file is None or file.run is None:
        raise ValueError(f"Argument `FILE` must be a TOML file with a table [run], but is {path}.")
    # options that the user gave override the file
    of_file = {name: value for name, value in file.run.items() if not given(name)}
    options = case.options | {"begin": begin} | of_file
    files = Outputs(out)
    if over is not None:
        return _compared(case, over, options | ensemble, files)
    for name in ensemble:
        require(not given(name), f"--{name}", "come with --over", ensemble[name])
    further = None
    places = file.environment
    if places is not None:
        # checked before a long run
        check_environment(case.scene, **places)
        further = files.named(FURTHER)
        history = AccelerationHistory(math.ceil(max(options.get("window", 1.0), 1.0) * AccelerationHistory.samples))
        options["record"] = [*default_records(case.scene), history]
    with keeping(files.keep):
        ran = over_rail(case.scene, **options, probe=3, progress=True)
    _keep_units(ran, case)
    said(files.write(ran), case.text(start=_start(case)), *ran.summary())
    lost = is_lost(int(ran.status))
    # for a lost run only its status is printed
    if further is not None and places is not None and not lost:
        report = environment(ran, **places)
        said(further.write(report), *report.summary())
    return LOST if lost else 0


def _keep_units(result: "Result", case: Case) -> None:
    """Add the units of the scene's file to a result, so that later reports also use them."""
    from ..plots.style import UNITS

    assert case.file is not None
    result.attrs[UNITS] = json.dumps(case.file.units)


def _compared(case: Case, over: str, options: dict[str, object], files: Outputs) -> int:
    """Compare designs; write and print the results."""
    from ..sweeps.compare import compare

    name, *written = over.split(SEPARATOR)
    require(len(written) > 1, "--over", "have a parameter and two or more values", over.replace(SEPARATOR, " "))
    q = parameter(name, case.scene)
    values = q.from_shown(np.array([shown_value(q, VALUE.convert(word, None, None)) for word in written]))
    store = options["store"]
    without = "nothing is written; with --store runs are kept, and the same command goes on"
    with keeping(lambda ds: without if store is None else kept_in(store), store):
        found = compare(case.scene, {name: values}, progress=True, **options)
    _keep_units(found, case)
    said(files.write(found), case.text([name], _start(case)), *found.summary())
    # by the last quantile, which decides
    return 0 if np.isfinite(found["value"].values[..., -1]).all() else LOST


def _start(case: Case) -> str:
    """Return a text that says where a run begins whose scene has no start; empty for a scene with a start."""
    return "from rest on the rail" if case.start is None else ""
