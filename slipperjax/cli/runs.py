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
from ..tools.checks import one_of, require
from .files import Outputs, keeping, kept_in, said
from .options import (
    COUNT,
    FILE,
    INPUT,
    LOST,
    REST,
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
    from ..results.result import Result
    from ..sweeps.store import Store

SEPARATOR = "\t"
"""Separator between the words of --over, because words may have spaces in them."""
Further = tuple[Outputs, Callable[..., "Result"], dict[str, Any]]
"""Files, function and arguments of a further result of runs."""


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
@option(
    "--measured",
    INPUT,
    "Measured acceleration, laid over the model's: a table with columns time, acceleration, and perhaps distance or "
    "speed.",
)
@option("--sensor", str, "With --measured: table [sensors.NAME] of FILE; default: the only one.", metavar="NAME")
@result("run")
@takes_case
@click.argument("scene", metavar="FILE", type=INPUT)
def run(
    case: Case,
    begin: float | None,
    out: Sequence[Path],
    over: Sequence[str],
    margin: float | None,
    measured: Path | None,
    sensor: str | None,
    **ensemble: object,
) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says; or over many
    rails, for the quantiles of its loads; or compare designs by many runs over the same rails from the same starts.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km"; or -, standard input; or the
    result of a run, which is repeated, with the changes of options such as --set play.vertical="0.1 in". With a table
    [environment] the vibration environment of its places is also printed, with a table [loads] the loads that size
    parts; they are written into further files with -environment and -loads in their names. With --measured a record
    is laid over the model at its sensor, in the bands of the table [environment], into files with -telemetry.
    """
    file = case.file
    path = click.get_current_context().params["scene"]
    if file is None or file.run is None:
        raise ValueError(f"Argument `FILE` must be a TOML file with a table [run], or a run, but is {path}.")
    options = case.options | {"begin": begin}
    # options that the user gave override the file; --length is that of the slipper
    options |= {name: value for name, value in file.run.items() if not (name in options and given(name))}
    files = Outputs(out)
    require(sensor is None or measured is not None, "--sensor", "come with --measured", sensor)
    require(measured is None or not over, "--measured", "come without --over", str(measured))
    if over:
        need = "not come with --over, which makes no specification"
        require(margin is None, "--margin", need, shown="given")
        return _compared(case, over, options | ensemble, files)
    # further results are checked here, before a long run
    further = _environment_of(case, files, margin)
    if measured is not None:
        rails = ensemble["rails"] if given("rails") else 1
        further.append(_over_record(case, options, measured, sensor, files, rails))
    if given("rails"):
        require(not given("starts"), "--starts", "come with --over", ensemble["starts"])
        return _over_rails(case, options, ensemble, files, further)
    for name in ensemble:
        require(not given(name), f"--{name}", "come with --over", ensemble[name])
    return _single(case, options, files, further)


def _environment_of(case: Case, files: Outputs, margin: float | None) -> list[Further]:
    """Return the environment that the file asks for, with another margin; an empty list where it asks for none."""
    from ..sweeps.environment import check_environment, environment

    assert case.file is not None
    asked = case.file.environment
    if asked is None:
        require(margin is None, "--margin", "come with a table [environment]", margin)
        return []
    if margin is not None:
        asked = asked | {"margin": margin}
    check_environment(case.scene, **asked)
    return [(files.named("-environment"), environment, asked)]


def _over_record(
    case: Case, options: Mapping[str, Any], measured: Path, name: str | None, files: Outputs, rails: int
) -> Further:
    """Return the comparison with a record, checked as far as is possible before a long run."""
    from ..fitting.telemetry import check_telemetry, telemetry

    file = case.file
    assert file is not None
    sensors = {sensor.name: sensor for sensor in file.sensors}
    path = click.get_current_context().params["scene"]
    require(sensors, "FILE", "be a TOML file with tables [sensors.NAME]", shown=f"{path}, which has none")
    if name is None:
        require(len(sensors) == 1, "--sensor", f"be one of {', '.join(sensors)}", shown="missing")
        name = next(iter(sensors))
    table = file.environment or {}
    bands = {name: table[name] for name in ("low", "high", "quality", "window") if name in table}
    asked = dict(measured=measured, sensor=sensors[one_of("--sensor", name, sensors)], **bands)
    check_telemetry(case.scene, **asked, length=options["length"], begin=options["begin"], rails=rails)
    return files.named("-telemetry"), telemetry, asked


def _report(further: Sequence[Further], ran: "Result") -> None:
    """Compute, write and print further results of runs."""
    for files, ask, asked in further:
        report = ask(ran, **asked)
        said(files.write(report), *report.summary())


def _single(case: Case, options: dict[str, object], files: Outputs, further: list[Further]) -> int:
    """Run once; write and print the run, its loads, and further results."""
    from ..sweeps.loads import check_loads, loads
    from ..sweeps.runs import run as over_rail

    file = case.file
    assert file is not None
    sized = []
    if file.loads is not None:
        check_loads(case.scene, file.loads["means"], file.loads["cuts"])
        sized.append((files.named("-loads"), loads, file.loads))
    # a run that is repeated keeps its records
    options.setdefault("record", _records(case, options, further))
    with keeping(files.keep):
        ran = over_rail(case.scene, **options, probe=3, progress=True)
    keep_units(ran, case)
    said(files.write(ran), case.text(start=_start(case)), *ran.summary())
    lost = is_lost(int(ran.status))
    # for a lost run only its status is printed
    _report([] if lost else [*further, *sized], ran)
    return LOST if lost else 0


def _records(case: Case, options: Mapping[str, object], further: list[Further]) -> list[object]:
    """Return the records of a run, with those that further results, and the loads of the file, need."""
    from ..sweeps.windows import AccelerationHistory, LoadHistory, default_records

    file = case.file
    assert file is not None
    sized = file.loads or {}
    samples = math.ceil(max(options.get("window", 1.0), 1.0) * AccelerationHistory.samples)
    records: list[object] = [*default_records(case.scene)]
    if further or sized.get("cuts"):
        records.append(AccelerationHistory(samples))
    if sized.get("means") or sized.get("cuts"):
        records.append(LoadHistory(samples))
    return records


def _over_rails(
    case: Case, options: dict[str, object], ensemble: Mapping[str, Any], files: Outputs, further: list[Further]
) -> int:
    """Run over many rails; write and print the loads of each slipper, with their quantiles, and further results."""
    from ..sweeps.compare import on_rails
    from ..sweeps.loads import check_loads, loads
    from ..sweeps.runs import run as over_rail

    assert case.file is not None
    sized = {"quantiles": ensemble["quantiles"]} | (case.file.loads or {})
    check_loads(case.scene, sized.get("means", ()), sized.get("cuts", ()))
    store = _store(ensemble, ensemble["rails"])
    scene, rails = on_rails(case.scene, ensemble["rails"])
    require(rails, "--rails", "be 2 or more", ensemble["rails"])
    options.setdefault("record", _records(case, options, further))
    with keeping(_kept(store), None if store is None else store.path):
        ran = over_rail(scene, rails, product=False, **options, store=store, progress=True)
    if _is_share(store):
        return 0
    keep_units(ran, case)
    report = loads(ran, over="case", **sized)
    said(files.write(report), case.text(start=_start(case)), *report.summary())
    lost = is_lost(report["status"].values).all()
    _report([] if lost else further, ran)
    return LOST if lost else 0


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
    return REST if case.start is None else ""
