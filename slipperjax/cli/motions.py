"""The commands for one case: a trajectory, a periodic motion, and its branch through a parameter."""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..flow.status import Status, is_lost
from ..model.parameters import Parameter
from ..model.scene import Scene
from ..tools.checks import require
from .files import Outputs, keeping, said
from .interrupts import Kept, on_thread
from .options import (
    CASE,
    COUNT,
    FILE,
    FROM_ZERO,
    LOST,
    Case,
    app,
    begin,
    bounds,
    given,
    make_bounds,
    option,
    result,
    takes_case,
)

if TYPE_CHECKING:
    from ..orbits.branches import OrbitBranch
    from ..orbits.periodic import PeriodicOrbit

Bounds = tuple[str, float | str, float | str]
"""Parameter, lower and upper bound in the unit of `shown_value` or as texts with a unit."""
period = option("--period", COUNT, "Forcing periods after which the motion repeats.")
SWITCHED = ("PD", "BP")
"""Labels of the events at which other branches begin: flips and branch points."""
WITHOUT_FROM = ("period", "transient", *CASE)
"""Options that the file of --from has already set."""
LONGEST_PREPARED = 1000
"""Forcing periods of the longest run whose picture is prepared while the run is compiled."""
BRANCH_PATIENCE = 10.0
"""Seconds that an interrupted command waits for the present point."""


@app.command(of="orbits.simulate.simulate")
@option("--periods", COUNT, "Forcing periods to simulate.")
@option("--saves-per-period", COUNT, "Saved states per forcing period.")
@option("--probe", FROM_ZERO, "Periods rerun at half the step to estimate the error; 0: none.", default=4)
@begin
@result("trajectory")
@takes_case
def simulate(
    case: Case, periods: int, saves_per_period: int | None, probe: int, begin: float | None, out: Sequence[Path]
) -> int:
    """Simulate one case and write its trajectory."""
    from ..orbits.simulate import simulate as run
    from ..results.result import Result
    from ..tools.compile import ahead
    from ..tools.progress import bar

    scene = case.scene
    files = Outputs(out)
    saving = dict(begin=begin, saves_per_period=saves_per_period)
    of_case = dict(start=case.start, steps_per_period=case.steps_per_period)
    preparing = []
    prepare = lambda: preparing.append(ahead(lambda: _prepare(scene, periods, **of_case, **saving)))
    with bar(None, meanwhile=prepare, desc="simulate", bar_format="{desc}"):
        trajectory = on_thread(lambda: run(scene, periods, probe=probe, **saving, **case.options))
    # matplotlib cannot be used while another thread imports it
    for thread in preparing:
        thread.join()
    # computed once
    found = Result(trajectory.ds)
    said(files.write(found), case.text(), *found.summary())
    return LOST if is_lost(int(trajectory.status)) else 0


def _prepare(scene: Scene, periods: int, **options: object) -> None:
    """Compile and import what writes and draws a trajectory, while the program that computes it is compiled."""
    # zeros of a longer run would take memory that the run itself may need
    if periods > LONGEST_PREPARED:
        return
    from ..orbits.simulate import stand_in

    trajectory = stand_in(scene, periods, **options)
    # these calls also import texts and pictures
    trajectory.summary()


@app.command(of="orbits.periodic.periodic_orbit")
@period
@option(
    "--transient", FROM_ZERO, "Forcing periods simulated before Newton's method; default: 60, then 240 if it fails."
)
@result("orbit")
@takes_case
def orbit(case: Case, period: int, transient: int | None, out: Sequence[Path]) -> int:
    """Find a periodic motion, stable or not, and print its Floquet multipliers and sequence of contacts."""
    from ..orbits.periodic import periodic_orbit
    from ..results.result import Result

    files = Outputs(out)
    print(f"looking for a motion of period {period} ...", file=sys.stderr)
    motion = on_thread(lambda: periodic_orbit(case.scene, period, transient=transient, **case.options))
    if _is_missed(motion):
        return LOST
    found = Result(motion.ds)
    said(files.write(found), case.text(), *found.summary())
    return 0


def _is_missed(motion: "PeriodicOrbit") -> bool:
    """Return whether Newton's method found no orbit, and print why."""
    status = Status(int(motion.status))
    if status != Status.FINITE:
        print(f"no file is written; status: {status}")
    return status != Status.FINITE


@app.command("continue", of="orbits.branches.continue_orbit")
@bounds("--over", "Parameter, lower and upper bound of the branch; the scene's value must lie within.")
@click.option(
    "--from",
    "source",
    type=FILE,
    help="File of a branch to extend: one that was interrupted, ended after --points, or reached a bound that "
    "--over now moves.",
)
@period
@option("--transient", FROM_ZERO, "Forcing periods simulated before the first motion.", default=60)
@option("--points", COUNT, "Maximum number of points in each direction.")
@option(
    "--switch",
    click.Choice(SWITCHED),
    "Also follow the branches that begin at every flip (PD) or branch point (BP), into files with _PD1 and so "
    "on in their names; repeat for both.",
    multiple=True,
)
@bounds(
    "--two",
    "Second parameter and its bounds: also follow every fold, flip and Neimark-Sacker of the branch over both, into "
    "files with _PD1 and so on in their names, and print the points of codimension two.",
)
@option("--brute", FILE, "netCDF file of slipperjax bifurcation, drawn beneath the branches.")
@option(
    "--quantity",
    str,
    "Quantity to draw: v_y, v_z, w_x, w_y, w_z, start_y, slowest_touchdown or grazing_gap.",
    default="v_z",
)
@result("branch")
@takes_case
def follow_branch(
    case: Case, over, source, period, transient, points, switch, two, brute, quantity, out: Sequence[Path]
) -> int:
    """Follow a periodic motion, stable or not, as a parameter changes, and locate folds, flips and grazings."""
    from ..plots.branches import check_brute, check_quantity
    from ..sweeps.loading import load

    options = dict(points=points, progress=True)
    if source is not None:
        parameter, call = _further(source, over, options)
    elif over is not None:
        parameter, call = _from_case(case, over, period, transient, options)
    else:
        raise ValueError("Option --over must be given, or --from.")
    # checked before anything long is begun
    check_quantity(quantity)
    second = None if two is None else make_bounds("--two", case.scene, *two)
    beneath = None if brute is None else load(brute).ds
    if beneath is not None:
        check_brute(beneath, parameter.name, quantity)
    drawn = []

    def followed(call: Callable[[], Kept], files: Outputs) -> Kept:
        """Return the branch of a call; where that is interrupted, write the points so far."""
        # each picture also has the branches before it
        with keeping(partial(files.keep, quantity=quantity, brute=beneath, others=drawn)):
            return on_thread(call, BRANCH_PATIENCE)

    files = Outputs(out)
    branch = followed(call, files)
    # no first orbit was found, and the reason is printed
    if branch is None:
        return LOST
    # an extended branch has its scene in the file, not in the options
    varied = [parameter.name]
    text = case.text(varied) if source is None else Case(branch.scene).text(varied, f"from {source}")
    picture = dict(quantity=quantity, brute=beneath)
    said(*branch.summary(), text, files.write(branch, **picture))
    drawn.append(branch)
    if second is not None:
        _follow_events(branch, second, files, points)
    # branches that begin at events are drawn together with earlier branches
    for label in sorted(set(switch)):
        for number, event in enumerate(branch.events_named(label), 1):
            name = f"{label}{number}"
            place = f"{name} at {parameter.shown(event.value):.8g} {parameter.display_unit}"
            own = files.named(f"_{name}")
            # no branch begins at some events; the others are still followed
            try:
                other = followed(partial(branch.switched, event, **options), own)
            except ValueError as error:
                print(f"{place}: {error}", file=sys.stderr)
                continue
            said(f"{place}:", *other.summary())
            # the first picture has all branches
            said(own.write(other, drawn=False), other.write(*files.pictures, others=tuple(drawn), **picture))
            drawn.append(other)
    return 0


def _follow_events(
    branch: "OrbitBranch", second: tuple[Parameter, tuple[float, float]], files: Outputs, points: int | None
) -> None:
    """Follow the folds, flips and Neimark-Sackers of a branch over its own and a second parameter."""
    from ..analysis.critical import CRITICAL_MULTIPLIERS
    from ..orbits.critical import continue_event

    quantity, ends = second
    most = {} if points is None else dict(points=points)
    for label in CRITICAL_MULTIPLIERS:
        for number, event in enumerate(branch.events_named(label), 1):
            own = files.named(f"_{label}{number}")
            with keeping(own.keep):
                follow = partial(continue_event, branch, event, quantity.name, ends, progress=True, **most)
                curve = on_thread(follow, BRANCH_PATIENCE)
            said(*curve.summary(), own.write(curve))


def _from_case(
    case: Case, over: Bounds, period: int, transient: int, options: dict[str, object]
) -> "tuple[Parameter, Callable[[], OrbitBranch | None]]":
    """Return the parameter of --over, and a function that follows the orbit on which the case settles.

    The function returns None where the case settles on no orbit.
    """
    from ..orbits.branches import continue_orbit, steps_of_branch
    from ..orbits.periodic import periodic_orbit

    quantity, (low, high) = make_bounds("--over", case.scene, *over)
    value = float(case.scene.value(quantity.name))
    text = lambda number: f"{quantity.shown(number):g} {quantity.display_unit}"
    need = f"hold the case's {quantity.name}, {text(value)}"
    require(low <= value <= high, "--over", need, shown=f"{text(low)} to {text(high)}")

    def call():
        # the first orbit has the steps of the branch, and uses the same programs
        steps = steps_of_branch(case.scene, quantity, (low, high), case.steps_per_period)
        with_steps = case.options | dict(steps_per_period=steps)
        first = periodic_orbit(case.scene, period, transient=transient, **with_steps)
        if _is_missed(first):
            return None
        return continue_orbit(case.scene, quantity.name, (low, high), **with_steps | options | dict(start=first))

    return quantity, call


def _further(
    source: Path, over: Bounds | None, options: dict[str, object]
) -> "tuple[Parameter, Callable[[], OrbitBranch]]":
    """Return the parameter of the branch in a file, and a function that extends it, to other bounds where given."""
    from ..orbits.branches import OrbitBranch
    from ..sweeps.loading import load

    # only the first of these options is named
    for name in given(*WITHOUT_FROM):
        raise ValueError(f"Option {name} must not be given with --from, whose file says it.")
    try:
        before = load(source)
        require(isinstance(before, OrbitBranch), "source", "be a result of continue_orbit", source)
    except ValueError as error:
        raise ValueError(f"Option --from must name a file of slipperjax continue, but {source}: {error}") from error
    quantity = before.parameter
    ends = None
    if over is not None:
        need = f"begin with {quantity.name}, as in the file of --from"
        require(over[0] == quantity.name, "--over", need, over[0])
        _, ends = make_bounds("--over", before.scene, *over)
    return quantity, partial(before.extended, ends, **options)
