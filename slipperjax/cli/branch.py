"""The command that follows a periodic motion through a parameter."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..model.quantities import PARAMETERS
from .commands import LOST, Once, app
from .files import Outputs
from .interrupts import on_thread
from .options import CASE_OPTIONS, Case, Out, Steps, takes_case

SWITCHED = ("PD", "BP")
"""Labels of events at which other branches leave."""
WITHOUT_FROM = ("period", "transient", "steps_per_period", *CASE_OPTIONS)
"""Options that stand in the file of --from."""
PATIENCE = 10.0
"""Seconds that an interrupted command waits for the point that is being computed."""

Bounds = Annotated[
    tuple[str, float, float] | None,
    typer.Option(
        help="Parameter, lower and upper bound, which hold the case's value. Parameters: "
        f"{', '.join(f'{n} [{q.display_unit}]' for n, q in PARAMETERS.items())}; and paths in SI units such as "
        "section.play.2.",
        show_default=False,
    ),
]
From = Annotated[
    Path | None,
    typer.Option(
        "--from",
        help="A branch's netCDF file to follow further: where it was interrupted, ended for --points, or met a bound "
        "of which --over names another.",
        show_default=False,
    ),
]
Switch = Annotated[
    list[str] | None,
    typer.Option(
        help="PD or BP: follow the branches that leave at all these events, too, as OUT_PD1.nc and so on; repeat for "
        "both.",
        show_default=False,
    ),
]
Brute = Annotated[
    Path | None,
    typer.Option(help="A netCDF file of slipperjax bifurcation, to draw the branches over.", show_default=False),
]


@app.command("continue", cls=Once)
@takes_case
def follow_branch(
    case: Case,
    context: typer.Context,
    over: Bounds = None,
    source: From = None,
    period: Annotated[int, typer.Option(help="Forcing periods after which the motion recurs.")] = 1,
    transient: Annotated[int, typer.Option(help="Forcing periods simulated before the first motion.")] = 60,
    points: Annotated[int, typer.Option(help="Most points of each way.")] = 400,
    steps_per_period: Steps = None,
    switch: Switch = None,
    brute: Brute = None,
    quantity: Annotated[
        str, typer.Option(help="What is drawn: v_y, v_z, w_x, w_y, w_z, start_y, slowest_touchdown or grazing_gap.")
    ] = "v_z",
    out: Out = Path("branch"),
):
    """Follow a periodic motion through a parameter, stable or not, and name folds, flips and grazings."""
    from ..orbits.branches import load_branch
    from ..plots.branches import branches

    labels = _labels(switch)
    options = dict(points=points, progress=sys.stderr.isatty())
    if source is None:
        if over is None:
            raise ValueError("Option --over must be given, or --from.")
        known, bounds = make_bounds(over, case.scene)
        how = dict(transient=transient, steps_per_period=steps_per_period)
        call = partial(_begun, case, known, bounds, period, how, options)
    else:
        _refuse_case(context)
        try:
            before = load_branch(source)
        except ValueError as error:
            raise ValueError(
                f"Option --from must name a file of slipperjax continue, but {source}: {error}"
            ) from error
        known, bounds = before.parameter, None
        if over is not None:
            bounds = make_bounds(over, before.scene, known.name)[1]
        call = partial(before.extended, bounds, **options)
    beneath = _beneath(brute, quantity, known.name)
    files = Outputs(out, ".nc", ".png")
    drawn: list[Any] = []
    draw = lambda ds: branches([*drawn, ds], quantity, beneath)
    found = _followed(call, files, draw)
    print(found.summary())
    files.write(found.points, draw)
    drawn.append(found.points)
    for label in labels:
        for number, event in enumerate(found.events_named(label), 1):
            name = f"{label}{number}"
            place = f"{name} at {found.parameter.shown(event.value):.8g} {found.parameter.display_unit}"
            beside = Outputs(Path(f"{out}_{name}"), ".nc")
            try:
                other = _followed(partial(found.switched, event, **options), beside, draw)
            except ValueError as error:
                print(f"{place}: {error}", file=sys.stderr)
                continue
            print(f"{place}: {other.summary()}")
            beside.write(other.points, draw, picture=files.out)
            drawn.append(other.points)


def make_bounds(
    over: tuple[str, float, float], scene: Any, of_file: str | None = None
) -> tuple[Any, tuple[float, float]]:
    """A parameter, and bounds of its values [SI unit], from `--over`.

    **Arguments:** `scene`: whose value the bounds must hold, except where a branch of a file goes on; `of_file`: the
    parameter of that branch.

    **Raises:** `ValueError` that names the option which is wrong.
    """
    from ..model.paths import parameter

    name, *ends = over
    if name not in PARAMETERS and "." not in name:
        raise ValueError(
            f"Option --over must begin with one of {', '.join(PARAMETERS)}, or a path such as section.play.2, but is "
            f"{name!r}."
        )
    if of_file not in (None, name):
        raise ValueError(f"Option --over must begin with {of_file}, as in the file of --from, but is {name!r}.")
    known = parameter(name, scene)
    low, high = (float(known.checked(known.from_shown(end))) for end in ends)
    given, unit = f"{ends[0]:g} to {ends[1]:g} {known.display_unit}", known.display_unit
    if not low < high:
        raise ValueError(f"Option --over must have two bounds, the smaller first, but has {given}.")
    if of_file is None:
        value = float(scene.value(name))
        if not low <= value <= high:
            raise ValueError(
                f"Option --over must hold the case's {name}, {known.shown(value):g} {unit}, but is {given}."
            )
    return known, (low, high)


def _labels(switch: list[str] | None) -> list[str]:
    for label in switch or ():
        if label not in SWITCHED:
            raise ValueError(f"Option --switch must be {' or '.join(SWITCHED)}, but is {label!r}.")
    return [label for label in SWITCHED if label in (switch or ())]


def _refuse_case(context: typer.Context) -> None:
    """Refuses options that describe a case besides that of a file."""
    for name in WITHOUT_FROM:
        source: Any = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            option = name.replace("_", "-")
            raise ValueError(f"Option --{option} must not be given with --from, whose file says it.")


def _beneath(brute: Path | None, quantity: str, name: Any) -> Any:
    """The diagram of --brute, checked before anything long is begun, as is the quantity."""
    from ..flow.load import dataset_of
    from ..plots.branches import check_brute, check_quantity

    check_quantity(quantity)
    if brute is None:
        return None
    found = dataset_of(brute)
    check_brute(found, name, quantity)
    return found


def _begun(case: Case, known: Any, bounds: tuple[float, float], period: int, how: dict, options: dict) -> Any:
    """The branch of the motion on which the case settles."""
    from ..flow.status import Status
    from ..orbits.branches import continue_orbit, steps_of_branch
    from ..orbits.periodic import periodic_orbit
    from ..tools.checks import whole

    whole("points", options["points"], 1)
    # the first orbit has the steps of the branch, and shares its programs
    steps = steps_of_branch(case.scene, known, bounds, how["steps_per_period"])
    first = periodic_orbit(
        case.scene, period, start=case.start, solver=case.solver, transient=how["transient"], steps_per_period=steps
    )
    status = Status(int(first.status))
    if status != Status.FINITE:
        print(f"no file is written; residual {float(first.residual):.2g}; status: {status}")
        raise typer.Exit(LOST)
    return continue_orbit(
        case.scene, known.name, bounds, start=first, steps_per_period=steps, solver=case.solver, **options
    )


def _followed(call: Callable[[], Any], files: Outputs, draw: Callable[[Any], Any]) -> Any:
    """What a call finds; an interrupted branch is written first."""
    from ..flow.status import Interrupted

    try:
        return on_thread(call, PATIENCE)
    except Interrupted as stop:
        print(f"{stop.finished} points were found: {files.write_partial(stop.result.points, draw)}", file=sys.stderr)
        raise
