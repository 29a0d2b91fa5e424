"""The command that follows a periodic motion through a parameter."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from .files import Draw, Outputs, keeping
from .interrupts import on_thread
from .options import CASE, COUNT, FILE, FROM_ZERO, Case, bounds, given, make_bounds, option, result, takes_case
from .root import LOST, app
from .simulate import is_lost

SWITCHED = ("PD", "BP")
"""Labels of events at which other branches leave."""
WITHOUT_FROM = ("period", "transient", *CASE)
"""Options that stand in the file of --from."""
BRANCH_PATIENCE = 10.0
"""Seconds that an interrupted command waits for the point that is being computed."""


@app.command("continue")
@bounds("--over", "Parameter, lower and upper bound, which hold the case's value.")
@click.option(
    "--from",
    "source",
    type=FILE,
    help="A branch's netCDF file to follow further: where it was interrupted, ended for --points, or met a bound of "
    "which --over names another.",
)
@option("--period", COUNT, "Forcing periods after which the motion recurs.", default=1)
@option("--transient", FROM_ZERO, "Forcing periods simulated before the first motion.", default=60)
@option("--points", COUNT, "Most points of each way.", default=400)
@option(
    "--switch",
    click.Choice(SWITCHED),
    "Follow the branches that leave at all these events, too, as OUT_PD1.nc and so on; repeat for both.",
    multiple=True,
)
@option("--brute", FILE, "A netCDF file of slipperjax bifurcation, to draw the branches over.")
@option(
    "--quantity",
    str,
    "What is drawn: v_y, v_z, w_x, w_y, w_z, start_y, slowest_touchdown or grazing_gap.",
    default="v_z",
)
@result("branch")
@takes_case
def follow_branch(case: Case, over, source, period, transient, points, switch, brute, quantity, out) -> int:
    """Follow a periodic motion through a parameter, stable or not, and name folds, flips and grazings."""
    from ..plots.branches import branches

    options = dict(points=points, progress=sys.stderr.isatty())
    if source is None:
        if over is None:
            raise ValueError("Option --over must be given, or --from.")
        known, ends = _around(case, over)
        call = partial(_begun, case, known, ends, period, transient, options)
    else:
        known, call = _further(source, over, options)
    beneath = _beneath(brute, quantity, known.name)
    files = Outputs(out, ".nc", ".png")
    drawn: list[Any] = []
    draw = lambda ds: branches([*drawn, ds], quantity, beneath)
    found = _followed(call, files, draw)
    if found is None:
        return LOST
    print(found.summary())
    files.write(found.points, draw)
    drawn.append(found.points)
    labelled = [
        (f"{label}{n}", e) for label in sorted(set(switch)) for n, e in enumerate(found.events_named(label), 1)
    ]
    for name, event in labelled:
        place = f"{name} at {known.shown(event.value):.8g} {known.display_unit}"
        beside = Outputs(Path(f"{out}_{name}"), ".nc")
        try:
            other = _followed(partial(found.switched, event, **options), beside, draw)
        except ValueError as error:
            print(f"{place}: {error}", file=sys.stderr)
            continue
        print(f"{place}: {other.summary()}")
        beside.write(other.points, draw, picture=files.out)
        drawn.append(other.points)
    return 0


def _around(case: Case, over: tuple[str, float, float]) -> tuple[Any, tuple[float, float]]:
    """A parameter and its bounds, which must hold the case's value."""
    known, (low, high) = make_bounds("--over", case.scene, *over)
    value, unit = float(case.scene.value(known.name)), known.display_unit
    if not low <= value <= high:
        raise ValueError(
            f"Option --over must hold the case's {known.name}, {known.shown(value):g} {unit}, but is "
            f"{over[1]:g} to {over[2]:g} {unit}."
        )
    return known, (low, high)


def _further(source: Path, over: tuple[str, float, float] | None, options: dict[str, Any]) -> Any:
    """The parameter of a file's branch, and what follows it further, over other bounds where they are given."""
    from ..orbits.branches import load_branch

    for name in given(*WITHOUT_FROM):
        raise ValueError(f"Option {name} must not be given with --from, whose file says it.")
    try:
        before = load_branch(source)
    except ValueError as error:
        raise ValueError(f"Option --from must name a file of slipperjax continue, but {source}: {error}") from error
    known = before.parameter
    if over is not None and over[0] != known.name:
        raise ValueError(f"Option --over must begin with {known.name}, as in the file of --from, but is {over[0]!r}.")
    ends = None if over is None else make_bounds("--over", before.scene, *over)[1]
    return known, partial(before.extended, ends, **options)


def _beneath(brute: Path | None, quantity: str, name: str) -> Any:
    """The diagram of --brute, checked before anything long is begun, as is the quantity."""
    from ..flow.datasets import dataset_of
    from ..plots.branches import check_brute, check_quantity

    check_quantity(quantity)
    if brute is None:
        return None
    found = dataset_of(brute)
    check_brute(found, name, quantity)
    return found


def _begun(case: Case, known: Any, ends: Any, period: int, transient: int, options: dict[str, Any]) -> Any:
    """The branch of the motion on which the case settles; None where it settles on no orbit."""
    from ..orbits.branches import continue_orbit, steps_of_branch
    from ..orbits.periodic import periodic_orbit

    # the first orbit has the steps of the branch, and shares its programs
    steps = steps_of_branch(case.scene, known, ends, case.steps_per_period)
    case = case._replace(steps_per_period=steps)
    first = periodic_orbit(case.scene, period, transient=transient, **case.options)
    if is_lost(first):
        return None
    return continue_orbit(case.scene, known.name, ends, **case._replace(start=first).options, **options)


def _followed(call: Callable[[], Any], files: Outputs, draw: Draw) -> Any:
    """The branch that a call finds; of an interrupted one its points are written first."""

    with keeping(lambda branch: files.write_partial(branch.points, draw)):
        return on_thread(call, BRANCH_PATIENCE)
