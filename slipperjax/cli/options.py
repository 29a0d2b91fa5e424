"""Options of the command line: their types and help, and what they stand for in the package."""

import dataclasses
import functools
import inspect
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from ..model.quantities import PARAMETERS, STARTS

GridAxis = tuple[str, float, float, int]
"""Parameter, first and last value in its display unit, number of values."""


def _help(name: str, more: str = "") -> str:
    """The help text of a parameter's option: what it is, and its display unit."""
    q = PARAMETERS[name]
    return f"{q.long_name[0].upper()}{q.long_name[1:]}{more or f' [{q.display_unit}]'}."


def without(*endings: str) -> Callable[[Path], Path]:
    """A callback of an option: the path without an ending that the command adds itself."""
    return lambda path: path.with_suffix("") if path.suffix.lower() in endings else path


_NAMES, _STARTS = (", ".join(f"{n} [{q.display_unit}]" for n, q in known.items()) for known in (PARAMETERS, STARTS))

PAPER: dict[str, Any] = {
    "speed": 1250.0,
    "clearance": 1.0,
    "length": 0.2,
    "mass": 14.0,
    "gravity": "none",
    "stiffness": 1e8,
    "restitution": 0.9,
    "amplitude": 1.0,
    "roll_amplitude": 0.2,
    "wavelength": 8.0,
    "memory": "event",
}
"""Values of the paper's scene in display units, for help texts."""


def _default(name: str) -> str:
    value = PAPER[name]
    return f"{value if isinstance(value, str) else format(value, 'g')}, or the scene file's"


Steps = Annotated[int | None, typer.Option(help="Integration steps per forcing period; default from the scene.")]
Out = Annotated[
    Path,
    typer.Option(help="Where to write: makes OUT.nc and OUT.png.", callback=without(".nc", ".png")),
]
Over = Annotated[
    GridAxis,
    typer.Option(
        help=f"Parameter, first and last value, number of values. Parameters: {_NAMES}; of the start: {_STARTS}; and "
        f"paths in SI units such as section.play.2."
    ),
]
By = Annotated[GridAxis | None, typer.Option(help="A second parameter likewise: makes a regime map.")]
Log = Annotated[
    list[str] | None, typer.Option(help="A parameter of --over or --by with logarithmic spacing; repeat for both.")
]
Solver = Annotated[
    str,
    typer.Option(help="RK4, Tsit5, Rodas4, ROS34PW2, TwoStep, or one of diffrax's."),
]


class Case(NamedTuple):
    """What the options of `takes_case` make."""

    scene: Any
    start: Any
    """A motion, or None for Table 2's."""
    solver: Any


def _number(name: str, more: str = "") -> Any:
    return Annotated[float | None, typer.Option(help=_help(name, more), show_default=_default(name))]


CASE_OPTIONS: dict[str, Any] = {
    "scene": Annotated[
        Path | None,
        typer.Option(help="A TOML file of a scene, or a result's netCDF file.", show_default=False),
    ],
    "speed": _number("speed"),
    "clearance": _number("clearance"),
    "length": _number("length"),
    "mass": _number("mass"),
    "gravity": _number("gravity"),
    "stiffness": _number("stiffness"),
    "restitution": _number("restitution", ", above 0 and at most 1"),
    "wavelength": Annotated[
        list[float] | None,
        typer.Option(help="Irregularity wavelength [m]; repeat for several.", show_default=_default("wavelength")),
    ],
    "amplitude": _number("amplitude"),
    "roll_amplitude": _number("roll_amplitude"),
    "set": Annotated[
        list[str] | None,
        typer.Option(help="Any other number of the scene, as in 'section.play.2=0.4 mm'; without a unit in SI."),
    ],
    "memory": Annotated[
        str | None,
        typer.Option(help="How contacts remember their touchdown: event or smooth.", show_default=_default("memory")),
    ],
    "solver": Solver,
}
"""Options that describe the case; each overrides what the scene's file says."""
DEFAULTS = dict.fromkeys(CASE_OPTIONS) | {"solver": "RK4"}


def takes_case(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with the options of `CASE_OPTIONS` besides its own, which gets what they make as `case`."""
    return taking(command, "case", make_case, CASE_OPTIONS, DEFAULTS)


def taking(
    command: Callable[..., Any],
    name: str,
    make: Callable[..., Any],
    options: Mapping[str, Any],
    defaults: Mapping[str, Any],
) -> Callable[..., Any]:
    """A command with further options, which gets what `make` makes of their values as its argument `name`."""

    @functools.wraps(command)
    def call(**given: Any) -> Any:
        of_case = {option: given.pop(option) for option in options}
        return command(**{name: make(**of_case)}, **given)

    kind = inspect.Parameter.KEYWORD_ONLY
    own = [p.replace(kind=kind) for key, p in inspect.signature(command).parameters.items() if key != name]
    more = [inspect.Parameter(key, kind, default=defaults[key], annotation=a) for key, a in options.items()]
    call.__signature__ = inspect.Signature([*own, *more])  # type: ignore[attr-defined]  # which typer reads
    call.__annotations__ = {p.name: p.annotation for p in (*own, *more)}
    return call


def make_case(*, scene: Path | None, solver: str, **values: Any) -> Case:
    """The case that options describe.

    **Raises:** `ValueError` that names the argument or option which is wrong.
    """
    from ..flow.load import load_scene, load_start

    start = None
    if scene is not None:
        base, start = load_scene(scene), load_start(scene)
    found = make_scene(None if scene is None else base, **values)
    return Case(found, start, make_solver(solver, found))


def make_scene(
    base: Any = None, *, memory: str | None = None, wavelength: Any = None, set: Any = None, **values: float | None
) -> Any:
    """A scene with the values of options.

    **Arguments:** `base`: the scene without them, default the paper's; `memory`: of `--memory`; `wavelength`: [m];
    `set`: texts such as section.play.2=0.4 mm; `values`: parameters by name, in display units, None for those of
    the base.

    **Raises:** `ValueError` that names the argument or option which is wrong.
    """
    from ..model.contact import EventLatch, SmoothSwitch
    from ..model.dang2024 import paper_scene
    from ..model.tracks import HarmonicTrack

    scene = paper_scene() if base is None else base
    memories = {"event": EventLatch, "smooth": SmoothSwitch}
    if memory is not None:
        if memory not in memories:
            raise ValueError(f"Option --memory must be event or smooth, but is {memory!r}.")
        scene = dataclasses.replace(scene, memory=memories[memory]())
    if wavelength:
        if not isinstance(scene.track, HarmonicTrack):
            raise ValueError(f"Option --wavelength needs a HarmonicTrack, but the track is {scene.track!r}.")
        scene = dataclasses.replace(scene, track=dataclasses.replace(scene.track, wavelengths=tuple(wavelength)))
    in_si = {name: PARAMETERS[name].from_shown(value) for name, value in values.items() if value is not None}
    given = [*in_si.items(), *(_assigned(scene, text) for text in set or ())]
    names = [name for name, _ in given]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"Option --set must not give {name}, which another option gives, too.")
    return scene.replace(**dict(given))


def _assigned(scene: Any, text: str) -> tuple[str, float]:
    """A parameter's name or path, and its value in SI units, of one `--set`."""
    from ..model.paths import parameter
    from ..model.scene_files import parsed

    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise ValueError(f"Option --set must be a name and a value, as in mass=15, but is {text!r}.")
    try:
        return name, float(value)
    except ValueError:
        return name, parsed(name, value, parameter(name, scene).unit)


def make_solver(name: str, scene: Any) -> Any:
    """A solver by its name.

    **Raises:** `ValueError` for a name that is no solver's, or a solver that does not suit the scene.
    """
    from ..solvers.named import resolve_solver

    return resolve_solver(scene, name)


def axis_of(option: str, text: str) -> GridAxis:
    """A parameter, its first and last value and their number, from text such as "speed 100 2500 241".

    **Raises:** `ValueError` that names the option.
    """
    try:
        name, first, last, count = text.split()
        return name, float(first), float(last), int(count)
    except ValueError:
        raise ValueError(
            f"Option {option} must be a parameter, its first and last value, and how many, but is {text!r}."
        ) from None


def make_grid(*axes: GridAxis | None, log: Sequence[str] | None = None) -> dict[str, Any]:
    """Values in SI units by parameter name; those named by `log` in equal ratios.

    **Arguments:** `axes`: of `--over` and of each `--by`, or None where it was not given.

    **Raises:** `ValueError` that names the option which is wrong.
    """
    import numpy as np

    from ..sweeps.grid import refuse_cases

    grid = {}
    for k, axis in enumerate(axes):
        if axis is None:
            continue
        (name, first, last, count), named = axis, "--by" if k else "--over"
        known = PARAMETERS.get(name) or STARTS.get(name)
        if known is None and "." not in name:
            raise ValueError(
                f"Option {named} must begin with one of {', '.join((*PARAMETERS, *STARTS))}, or a path such as "
                f"section.play.2, but is {name!r}."
            )
        if count < 1:
            raise ValueError(f"Option {named} must end with a number of values of 1 or more, but is {count}.")
        if known is not None and not np.all(np.isfinite((first, last))):
            known.checked(known.from_shown(first if not np.isfinite(first) else last))
        if name in grid:
            raise ValueError(f"Option --by must name another parameter than --over, but is {name!r} too.")
        if name in (log or ()) and not min(first, last) > 0:
            raise ValueError(f"Option --log {name} needs values above zero, but {named} has {min(first, last):g}.")
        refuse_cases(count * math.prod(map(len, grid.values())))  # before the values take the memory
        space = np.geomspace if name in (log or ()) else np.linspace
        values = space(first, last, count)
        grid[name] = values if known is None else known.from_shown(values)
    for name in log or ():
        if name not in grid:
            raise ValueError(f"Option --log must name a parameter of --over or --by, but is {name!r}.")
    return grid


def make_folder(folder: Path, out: Path) -> None:
    """Makes the folder to write into, before anything long is begun.

    **Raises:** `ValueError` where it cannot be made or written to.
    """
    if out == Path(""):
        raise ValueError("Option --out must name a file or folder, but is empty.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"Option --out must name a place that can be written, but {out}: {error}") from error
