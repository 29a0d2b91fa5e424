"""The command that chooses parameters by an objective."""

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from ..model.paths import parameter
from ..model.quantities import PARAMETERS
from .commands import LOST, Once, app
from .files import Outputs
from .interrupts import on_thread
from .options import CASE_OPTIONS, DEFAULTS, Case, Out, Steps, make_case, taking

PATIENCE = 20.0
"""Seconds that an interrupted command waits for the trial that is being judged."""
AROUND = {1: 11, 2: 5, 3: 3}
"""Designs along each variable in a grid around the best one, by the number of variables."""
JOINED = {"--vary": (2,), "--constraint": (1, 2)}
"""Options that are repeated: how many numbers follow their name."""
FIXED = "--fixed"
"""Stands for options of parameters that have one number."""
OF_SCENE = ("scene", "wavelength", "set", "memory", "solver")
"""Options of cases that mean the same here."""

OBJECTIVE_UNITS = {
    "peak_force": "kN",
    **dict.fromkeys(("rms_a_y", "rms_a_z"), "m/s^2"),
    **dict.fromkeys(("rms_alpha_x", "rms_alpha_y", "rms_alpha_z"), "rad/s^2"),
    "impact_impulse": "N s",
    "contact_load": "kN",
    "contact_work": "J/m",
    "drive_force": "N",
    **dict.fromkeys(("excursion_y", "excursion_z"), "mm"),
    **dict.fromkeys(("excursion_roll", "excursion_pitch", "excursion_yaw"), "mrad"),
    "grazing_distance": "mm",
    "exponent": "1/period",
}
"""Objectives with their display units, for help texts, which do not wait for imports."""
_OBJECTIVES = ", ".join(f"{name} [{unit}]" for name, unit in OBJECTIVE_UNITS.items())

Speeds = Annotated[
    tuple[float, float, int] | None,
    typer.Option(
        metavar="FIRST LAST COUNT",
        help="Speeds that the design must serve: first and last [m/s], and how many; default the case's.",
        show_default=False,
    ),
]
Minimise = Annotated[str, typer.Option(help=f"The objective: {_OBJECTIVES}.", show_default=False)]
Robust = Annotated[str, typer.Option(help="What of the speeds' objectives is minimised: worst or mean.")]
Limit = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME [LOW] HIGH",
        help="An objective's highest value at every speed, or the lowest and highest, in the units of --minimise; "
        "repeat for several.",
        show_default=False,
    ),
]


class Box(NamedTuple):
    """What options make: a case, and bounds of what is chosen."""

    case: Case
    variables: dict[str, tuple[float, float]]
    """By name or path [SI unit]."""
    kept: tuple[str, ...] = ()
    """Parameters whose options have one number."""


class _Numbers(Once):
    """A command whose options of parameters have two numbers or one."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, list(_joined(args)))


def _joined(args: Sequence[str]) -> Iterator[str]:
    """Arguments in which a parameter's option with one number, as --mass 15, is --fixed "mass 15", and what follows
    options of `JOINED` is one text, as click needs it."""
    named, at = {_option(name): name for name in PARAMETERS}, 0
    while at < len(args):
        word, at = args[at], at + 1
        option, equals, value = word.partition("=")
        numbers = list(takewhile(_is_number, [value] if equals else args[at : at + 2]))
        if option in named and len(numbers) == 1:
            yield from (FIXED, f"{named[option]} {numbers[0]}")
            at += not equals
        elif option in JOINED and not equals:
            named_first = at < len(args) and not args[at].startswith("--")
            most = at + 1 + max(JOINED[option]) if named_first else at
            many = named_first + len(list(takewhile(_is_number, args[at + 1 : most])))
            yield from (option, " ".join(args[at : at + many]))
            at += many
        else:
            yield word


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _bounds(name: str) -> Any:
    """A parameter's option."""
    q = PARAMETERS[name]
    unit = "" if q.display_unit == "1" else f" [{q.display_unit}]"
    text = f"{q.long_name[0].upper()}{q.long_name[1:]}{unit}: its bounds, or one number that it keeps."
    return Annotated[tuple[float, float] | None, typer.Option(help=text, metavar="LOW HIGH", show_default=False)]


BOX_OPTIONS: dict[str, Any] = {
    **{name: _bounds(name) for name in PARAMETERS},
    "vary": Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH LOW HIGH",
            help="Any other number of the scene and its bounds in SI units, as section.play.2; repeat for several.",
            show_default=False,
        ),
    ],
    "fixed": Annotated[list[str] | None, typer.Option(FIXED, hidden=True)],
    **{name: CASE_OPTIONS[name] for name in OF_SCENE},
}
"""Options that describe the case and what is chosen of it."""


def make_box(*, vary: list[str] | None, fixed: list[str] | None, **options: Any) -> Box:
    """The case and the bounds that options describe.

    **Arguments:** `vary`: texts such as "section.play.2 1e-4 1e-3"; `fixed`: such as "mass 15" [display unit];
    `options`: those of `OF_SCENE`, and bounds of parameters [display unit] by name.

    **Raises:** `ValueError` that names the option which is wrong.
    """
    of_scene = {name: options.pop(name) for name in OF_SCENE}
    given = [(_option(name), name, pair) for name, pair in options.items() if pair is not None]
    kept = dict(text.split() for text in fixed or ())
    twice = [name for name in kept if len(kept) < len(fixed or ()) or options.get(name) is not None]
    if twice:
        raise ValueError(f"Option {_option(twice[0])} must be given once, but is given more often.")
    case = make_case(**of_scene, **{name: float(number) for name, number in kept.items()})
    for text in vary or ():
        name, *numbers = text.split() or [""]
        if len(numbers) != 2 or not all(map(_is_number, numbers)):
            raise ValueError(f"Option --vary must be a path and two bounds, but is {text!r}.")
        given.append(("--vary", name, tuple(map(float, numbers))))
    if not given:
        raise ValueError("An option such as --clearance 0.2 3 must be given: what is chosen, and its bounds.")
    variables: dict[str, tuple[float, float]] = {}
    for option, name, pair in given:
        if name in variables:
            raise ValueError(f"Option {option} must name another parameter than other options, but is {name!r}.")
        variables[name] = _checked(case.scene, option, name, pair)
    return Box(case, variables, tuple(kept))


def takes_box(command: Any) -> Any:
    """A command with the options of `BOX_OPTIONS` besides its own, which gets what they make as `box`."""
    defaults = dict.fromkeys(BOX_OPTIONS) | {"solver": DEFAULTS["solver"]}
    return taking(command, "box", make_box, BOX_OPTIONS, defaults)


def _checked(scene: Any, option: str, name: str, pair: tuple[float, float]) -> tuple[float, float]:
    """Bounds of a parameter [SI unit]."""
    from ..model.paths import parameter

    known = parameter(name, scene)
    low, high = (float(known.checked(known.from_shown(end))) for end in pair)
    if not low < high:
        raise ValueError(
            f"Option {option} must have two bounds, the smaller first, but has {pair[0]:g} to {pair[1]:g} "
            f"{known.display_unit}."
        )
    return low, high


@app.command(cls=_Numbers)
@takes_box
def design(
    box: Box,
    minimise: Minimise,
    speeds: Speeds = None,
    robust: Robust = "worst",
    constraint: Limit = None,
    periodic: Annotated[bool, typer.Option("--periodic", help="Allow periodic motions only.")] = False,
    starts: Annotated[
        int, typer.Option(help="Designs to begin from: the case's, if within the bounds, and others spread evenly.")
    ] = 5,
    max_trials: Annotated[int, typer.Option(help="Most trials of each start.")] = 60,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before an orbit is looked for.")] = 200,
    steps_per_period: Steps = None,
    seed: Annotated[int, typer.Option(help="Of the starts.")] = 0,
    check: Annotated[bool, typer.Option(help="Simulate a grid of designs around the best one.")] = True,
    margins: Annotated[bool, typer.Option(help="Look for the nearest folds, flips and grazings.")] = True,
    out: Out = Path("design"),
):
    """Find parameters within bounds that keep an objective lowest over a range of speeds.

    A parameter's option with two numbers says that it is chosen between them; with one number it is fixed.
    """
    from ..design.optimise import optimise_design
    from ..plots.designs import design_overview
    from ..tools.checks import whole

    # checked here, too, so that an error is the only line
    least = dict(starts=1, max_trials=1, transient=0, seed=0)
    counts = dict(starts=starts, max_trials=max_trials, transient=transient, seed=seed)
    for name, value in counts.items():
        whole(name, value, least[name])
    objective, limits = _objective("--minimise", minimise), _limits(constraint)
    over = None if speeds is None else {"speed": _speeds(speeds, box)}
    if robust not in ("worst", "mean"):
        raise ValueError(f"Option --robust must be worst or mean, but is {robust!r}.")
    files = Outputs(out, ".nc", ".png")
    options: dict[str, Any] = dict(
        over=over,
        robust=robust,
        constraints=limits,
        periodic=periodic,
        steps_per_period=steps_per_period,
        solver=box.case.solver,
        start=box.case.start,
        progress=sys.stderr.isatty(),
    )
    call = lambda: optimise_design(box.case.scene, objective, box.variables, **counts, **options)
    found = _found(call, files)
    print(report(found), flush=True)
    done = found.status == "converged"
    around = on_thread(partial(_around, found), PATIENCE) if check and done else None
    events = on_thread(partial(_margins, found), PATIENCE) if margins and done else None
    files.write(found.to_xarray(events), partial(design_overview, surroundings=around, margins=events))
    if found.status == "no motion":
        raise typer.Exit(LOST)


def _found(call: Any, files: Outputs) -> Any:
    """What a search finds; an interrupted one is written first."""
    from ..flow.status import Interrupted
    from ..plots.designs import design_overview

    try:
        return on_thread(call, PATIENCE)
    except Interrupted as stop:
        if stop.result is not None:
            print(report(stop.result))
            kept = files.write_partial(stop.result.to_xarray(), design_overview)
            print(f"{stop.finished} trials were judged: {kept}", file=sys.stderr)
        raise


def _around(found: Any) -> Any:
    """The objective around a design by simulation alone."""
    from ..design.checks import surroundings

    points = AROUND.get(len(found.problem.bounds))
    if points is None:
        print("too many variables for a grid of designs around it")
        return None
    ds = surroundings(found, points=points, progress=sys.stderr.isatty())
    lower = 100 * ds.attrs["lower"]
    print(f"{ds['total'].size} designs around it by simulation alone: the lowest is {lower:.2g} % lower", flush=True)
    return ds


def _margins(found: Any) -> Any:
    """The nearest events of the cases that tell most; they are printed."""
    from ..design.checks import event_margins

    if not any(found.cases["period"].values > 0):
        print("no case is on an orbit that could be followed to events")
        return None
    try:
        ds = event_margins(found, progress=sys.stderr.isatty())
    except ValueError as error:  # what was found stands
        print(f"nearest events were not found: {error}")
        return None
    print("nearest events:")
    for row in range(ds.sizes["margin"]):
        at = ds.isel(margin=row)
        known = parameter(str(at["parameter"].item()), found.problem.scene)
        where = ", ".join(
            f"{name} {PARAMETERS[name].shown(values[int(at['case'])]):.5g} {PARAMETERS[name].display_unit}"
            for name, values in found.problem.cases.items()
        )
        event = str(at["label"].item()) or "none up to"
        value = f"{known.shown(float(at['value'])):.6g} {known.display_unit} ({100 * float(at['relative']):+.3g} %)"
        print(f"  {where or 'the case'}: {known.name} {event} {value}", flush=True)
    return ds


def _objective(option: str, name: str) -> Any:
    from ..design.objectives import OBJECTIVES

    if name not in OBJECTIVES:
        raise ValueError(f"Option {option} must be one of {', '.join(OBJECTIVES)}, but is {name!r}.")
    return OBJECTIVES[name]


def _limits(constraint: list[str] | None) -> dict[Any, Any]:
    """Limits [SI unit] by objective, of texts such as "peak_force 20"."""
    found: dict[Any, Any] = {}
    for text in constraint or ():
        name, *numbers = text.split() or [""]
        objective = _objective("--constraint", name)
        if len(numbers) not in JOINED["--constraint"] or not all(map(_is_number, numbers)):
            raise ValueError(f"Option --constraint must be an objective and its highest value, but is {text!r}.")
        if objective in found:
            raise ValueError(f"Option --constraint must name each objective once, but has {name} more often.")
        values = [objective.quantity.from_shown(float(number)) for number in numbers]
        if len(values) == 2 and not values[0] < values[1]:
            raise ValueError(f"Option --constraint must have the lower value first, but is {text!r}.")
        found[objective] = (None, values[0]) if len(values) == 1 else tuple(values)
    return found


def _speeds(speeds: tuple[float, float, int], box: Box) -> Any:
    """The speeds of --speeds."""
    import numpy as np

    low, high, count = speeds
    if "speed" in (*box.variables, *box.kept):
        raise ValueError("Option --speeds must not be given with --speed.")
    if count < 1:
        raise ValueError(f"Option --speeds must end with a number of speeds of 1 or more, but is {count}.")
    if not 0 < low <= high < np.inf or (count > 1) != (low < high):
        raise ValueError(
            f"Option --speeds must be the lowest and the highest speed, above zero, and their number, but is {low:g} "
            f"to {high:g} m/s and {count}."
        )
    return np.linspace(low, high, count)


def report(found: Any) -> str:
    """A design in words: what was found, how sure, and a line for each case."""
    from ..plots.style import shown

    q, cases = found.problem.objective.quantity, found.cases
    lines = [repr(found), f"relative slope left {found.gradient_norm:.2g}"]
    if found.stderr > 0:
        lines[-1] += f"; standard error {q.shown(found.stderr):.2g} {q.display_unit}"
    if found.several:
        lines.append("starts ended at different designs that are about equally good: see start_end in the file")
    columns = []
    for name in found.problem.over:
        unit = PARAMETERS[name].display_unit
        columns.append([f"{name} [{unit}]", *(f"{v:.6g}" for v in shown(cases, name))])
    values, errors = (q.shown(cases[name].values) for name in ("objective", "objective_stderr"))
    texts = [f"{v:.5g}" + (f" +- {e:.2g}" if e > 0 else "") for v, e in zip(values, errors, strict=True)]
    columns += [[f"{q.name} [{q.display_unit}]", *texts], ["regime", *cases["regime"].values]]
    widths = [max(map(len, column)) for column in columns]
    lines += [
        "  ".join(text.ljust(w) for text, w in zip(row, widths, strict=True)).rstrip()
        for row in zip(*columns, strict=True)
    ]
    return "\n".join(lines)
