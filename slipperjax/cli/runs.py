"""The command that runs a scene over a length of rail, and reports the values that a track test would measure."""

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from .sweep import keep_units, target

if TYPE_CHECKING:
    from ..sweeps.store import Store

SEPARATOR = "\t"
"""Separator between the words of --over, because words may have spaces in them."""


class _Comparing(CommandOf):
    """A command whose option --over takes a name and any number of values."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        # the name, and all words that begin like numbers, except a file such as 2024_sled.toml
        is_value = lambda word: re.match(r"[-+]?\.?\d", word) and not word.lower().endswith(".toml")
        left = list(args)
        joined = []
        while left:
            joined.append(left.pop(0))
            if joined[-1] == "--over" and left:
                values = list(itertools.takewhile(is_value, left[1:]))
                joined.append(SEPARATOR.join([left[0], *values]))
                left = left[1 + len(values) :]
        return super().parse_args(ctx, joined)


@app.command(cls=_Comparing, of="sweeps.compare.compare")
@begin
@option(
    "--over",
    str,
    f"Compare designs: a parameter and two or more values; repeat for every combination. {parameters_of(PARAMETERS)}",
    metavar="NAME VALUE VALUE ...",
    multiple=True,
)
@option(
    "--rails",
    COUNT,
    "Number of rails, first the survey, or of seeds of a random rail; the median needs 8, the share 0.95 needs 80.",
)
@option("--starts", COUNT, "With --over: number of starts on each rail.")
@option(
    "--quantiles",
    float,
    "With --rails or --over: share of the runs with lower values; of several shares, for which the option is "
    "repeated, the last decides.",
    multiple=True,
)
@option("--store", FILE, "With --rails or --over: keep runs in this store, from which the same command continues.")
@option("--share", str, "With --store: compute only share I of N of the runs, for jobs of an array.", metavar="I/N")
@option("--margin", float, "Margin of the specification of a table [environment] [dB], without --over.", default=None)
@result("run")
@takes_case
@click.argument("scene", metavar="FILE", type=INPUT)
def run(
    case: Case,
    begin: float | None,
    out: Sequence[Path],
    over: Sequence[str],
    margin: float | None,
    **ensemble: object,
) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says; or over many
    rails, for the quantiles of its loads; or compare designs by many runs over the same rails from the same starts.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km"; or -, standard input; or the
    result of a run, which is repeated, with the changes of options such as --set play.vertical="0.1 in". With a table
    [environment] the vibration environment of its places is also printed, with a table [loads] the loads that size
    parts; they are written into further files with -environment and -loads in their names.
    """
    file = case.file
    path = click.get_current_context().params["scene"]
    if file is None or file.run is None:
        raise ValueError(f"Argument `FILE` must be a TOML file with a table [run], or a run, but is {path}.")
    # options that the user gave override the file
    of_file = {name: value for name, value in file.run.items() if not given(name)}
    options = case.options | {"begin": begin} | of_file
    files = Outputs(out)
    changes = {} if margin is None else {"margin": margin}
    if over:
        require(not changes, "--margin", "not come with --over, which makes no specification", shown="given")
        return _compared(case, over, options | ensemble, files)
    if given("rails"):
        require(not given("starts"), "--starts", "come with --over", ensemble["starts"])
        return _over_rails(case, options, ensemble, files, changes)
    for name in ensemble:
        require(not given(name), f"--{name}", "come with --over", ensemble[name])
    return _single(case, options, files, changes)


def _environment_of(case: Case, changes: dict[str, float]) -> dict[str, Any] | None:
    """Return the arguments of the environment that the file asks for, with changes; None where it asks for none.

    They are checked here, before a long run.
    """
    from ..sweeps.environment import check_environment

    assert case.file is not None
    asked = case.file.environment
    if asked is None:
        require(not changes, "--margin", "come with a table [environment]", changes.get("margin"))
        return None
    check_environment(case.scene, **asked | changes)
    return asked | changes


def _single(case: Case, options: dict[str, object], files: Outputs, changes: dict[str, float]) -> int:
    """Run once; write and print the run, its vibration environment and its loads.

    **Arguments:** `changes`: of the arguments of the environment.
    """
    from ..sweeps.environment import environment
    from ..sweeps.loads import check_loads, loads
    from ..sweeps.runs import run as over_rail

    file = case.file
    assert file is not None
    places = _environment_of(case, changes)
    if file.loads is not None:
        check_loads(case.scene, file.loads["means"], file.loads["cuts"])
    reports = [
        (files.named(more), ask, asked)
        for more, ask, asked in (("-environment", environment, places), ("-loads", loads, file.loads))
        if asked is not None
    ]
    # a run that is repeated keeps its records
    options.setdefault("record", _records(case, options))
    with keeping(files.keep):
        ran = over_rail(case.scene, **options, probe=3, progress=True)
    keep_units(ran, case)
    said(files.write(ran), case.text(start=_start(case)), *ran.summary())
    lost = is_lost(int(ran.status))
    # for a lost run only its status is printed
    for further, ask, asked in [] if lost else reports:
        report = ask(ran, **asked)
        said(further.write(report), *report.summary())
    return LOST if lost else 0


def _records(case: Case, options: Mapping[str, object]) -> list[object]:
    """Return the records of a run, with those that the tables of the file need."""
    from ..sweeps.windows import AccelerationHistory, LoadHistory, default_records

    file = case.file
    assert file is not None
    sized = file.loads or {}
    samples = math.ceil(max(options.get("window", 1.0), 1.0) * AccelerationHistory.samples)
    records: list[object] = [*default_records(case.scene)]
    if file.environment is not None or sized.get("cuts"):
        records.append(AccelerationHistory(samples))
    if sized.get("means") or sized.get("cuts"):
        records.append(LoadHistory(samples))
    return records


def _over_rails(
    case: Case, options: dict[str, object], ensemble: Mapping[str, Any], files: Outputs, changes: dict[str, float]
) -> int:
    """Run over many rails; write and print the loads of each slipper, with their quantiles, and the environment.

    **Arguments:** `changes`: of the arguments of the environment.
    """
    from ..sweeps.compare import on_rails
    from ..sweeps.environment import environment
    from ..sweeps.loads import check_loads, loads
    from ..sweeps.runs import run as over_rail

    assert case.file is not None
    sized = {"quantiles": ensemble["quantiles"]} | (case.file.loads or {})
    check_loads(case.scene, sized.get("means", ()), sized.get("cuts", ()))
    places = _environment_of(case, changes)
    store = _store(ensemble, ensemble["rails"])
    scene, rails = on_rails(case.scene, ensemble["rails"])
    require(rails, "--rails", "be 2 or more", ensemble["rails"])
    options.setdefault("record", _records(case, options))
    with keeping(_kept(store), None if store is None else store.path):
        ran = over_rail(scene, rails, product=False, **options, store=store, progress=True)
    if _is_share(store):
        return 0
    report = loads(ran, over="case", **sized)
    keep_units(report, case)
    said(files.write(report), case.text(start=_start(case)), *report.summary())
    if is_lost(report["status"].values).all():
        return LOST
    if places is not None:
        vibration = environment(ran, **places)
        said(files.named("-environment").write(vibration), *vibration.summary())
    return 0


def _store(ensemble: Mapping[str, Any], runs: int) -> "Store | None":
    """Return the store that options describe; each share of it is a tile, as far as `runs` suffice."""
    tile = None
    if ensemble["share"] is not None:
        jobs = ensemble["share"].rpartition("/")[2]
        tile = -(-runs // max(int(jobs), 1)) if jobs.isdigit() else None
    return target(ensemble["store"], share=ensemble["share"], tile=tile)


def _kept(store: "Store | None") -> Callable[[Any], str]:
    """Return a function that says where an interrupt leaves finished runs."""
    without = "nothing is written; with --store runs are kept, and the same command goes on"
    return lambda ds: without if store is None else kept_in(store.path)


def _is_share(store: "Store | None") -> bool:
    """Return whether runs are only a share of a store, and print how many are there; these have no result yet."""
    from ..sweeps.store import store_status

    if store is None or store.share is None:
        return False
    status = store_status(store.path)
    said(f"share {store.share[0]}/{store.share[1]}: {status}")
    return status.tiles_done < status.tiles


def _compared(case: Case, over: Sequence[str], options: dict[str, Any], files: Outputs) -> int:
    """Compare designs; write and print the results."""
    from ..sweeps.compare import compare

    designs = {}
    for text in over:
        name, *written = text.split(SEPARATOR)
        require(len(written) > 1, "--over", "have a parameter and two or more values", text.replace(SEPARATOR, " "))
        require(name not in designs, "--over", "name each parameter once", name)
        q = parameter(name, case.scene)
        designs[name] = q.from_shown(np.array([shown_value(q, VALUE.convert(word, None, None)) for word in written]))
    runs = math.prod(map(len, designs.values())) * options["rails"] * options["starts"]
    store = _store(options, runs)
    # designs are compared by one number, whatever a run that is repeated has recorded
    options = {name: value for name, value in options.items() if name not in ("share", "record")} | {"store": store}
    with keeping(_kept(store), None if store is None else store.path):
        found = compare(case.scene, designs, progress=True, **options)
    if _is_share(store):
        return 0
    keep_units(found, case)
    said(files.write(found), case.text(designs, _start(case)), *found.summary())
    # by the last quantile, which decides
    return 0 if np.isfinite(found["value"].values[..., -1]).all() else LOST


def _start(case: Case) -> str:
    """Return a text that says where a run begins whose scene has no start; empty for a scene with a start."""
    return "from rest on the rail" if case.start is None else ""
