"""The root command, and the options that commands share: their types, their help, and their values.

Commands import what they need only when they are called, so that help is fast.
"""

import ast
import dataclasses
import functools
import importlib
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import diffrax
import numpy as np

from ..model.contact import EventLatch, PeakRateLatch, SmoothSwitch
from ..model.dang2024 import paper_scene
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import MAIN, PARAMETERS, QUANTITIES, STARTS, Parameter, parameter
from ..model.quantities import Quantity, ShownUnits
from ..model.scene import Scene
from ..model.scene_files import SceneFile
from ..tools.cache import compile_cache, keep_in
from ..tools.checks import finite, number, require
from ..tools.files import listed, read_standard_input, user_path
from .files import USUAL

if TYPE_CHECKING:
    from ..results.result import AbstractResult

LOST = 1
"""Exit code where no computed number means anything."""
WRONG = 2
"""Exit code after an error."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
REST = "from rest on the rail"
"""Start of a run in texts, where the scene has no start."""


Command = Callable[..., object]
"""The function of a command."""
Adds = Callable[[Command], Command]
"""A decorator that adds an option to a command."""


@functools.cache
def defaults(function: str) -> dict[str, object]:
    """Return the defaults of a function's arguments that are written as numbers, texts or tuples of these.

    They are read from the source, because importing the function would take long.

    **Arguments:** `function`: its module and name, such as sweeps.sweep.sweep.
    """
    module, _, name = function.rpartition(".")
    source = Path(__file__).parents[1].joinpath(*module.split(".")).with_suffix(".py").read_text()
    named = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    arguments = named[name].args
    positional = arguments.posonlyargs + arguments.args
    pairs = [
        *zip(reversed(positional), reversed(arguments.defaults), strict=False),
        *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True),
    ]
    return {one.arg: ast.literal_eval(value) for one, value in pairs if isinstance(value, ast.Constant | ast.Tuple)}


class CommandOf(click.Command):
    """A command of a function of the package, whose defaults it does not state a second time.

    An option without a default has that of the function's argument of the same name.
    """

    def __init__(self, *given: Any, of: str = "", **more: Any):
        """**Arguments:** `of`: as for `defaults`; empty for a command that states all defaults."""
        super().__init__(*given, **more)
        self.of = of


class _OptionOf(click.Option):
    """An option without a default of its own."""

    def get_default(self, ctx: click.Context, call: bool = True) -> Any:
        value = super().get_default(ctx, call)
        if of := getattr(ctx.command, "of", ""):
            value = defaults(of).get(self.name, value)
        return (value,) if self.multiple and isinstance(value, str) else value


def option(name: str, type: Any, text: str, **more: Any) -> Adds:
    """Return an option of a command; `text` is its help, `more` are arguments of `click.option`."""
    kind = click.Option if "default" in more else _OptionOf
    return click.option(name, cls=kind, type=type, help=text, **more)


def flag(name: str, text: str) -> Adds:
    """Return an option without a value."""
    return click.option(name, is_flag=True, help=text)


class Group(click.Group):
    """A group of commands that ends silently at an interrupt; click would print a line."""

    command_class = CommandOf

    def invoke(self, ctx: click.Context) -> object:
        # click would print a line, and exit with 1
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)


def _print_versions(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from ..flow.datasets import versions

        # first the package, and in brackets the packages with which it computes
        of = dict(versions())
        print(f"slipperjax {of.pop('slipperjax')} ({', '.join(f'{name} {version}' for name, version in of.items())})")
        ctx.exit()


@click.group(cls=Group, context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@option(
    "--cache/--no-cache",
    None,
    "Keep compiled programs for later commands, in the folder SLIPPERJAX_CACHE or else the user's cache folder.",
    default=True,
)
@option(
    "--version",
    None,
    "Print versions and exit.",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_versions,
)
@click.option(
    "--import",
    "modules",
    help="Python module with classes of your own that a scene's file names, such as my_laws; repeat for several.",
    multiple=True,
)
def app(cache: bool, modules: tuple[str, ...]) -> None:
    """Nonlinear dynamics of rocket-sled slippers."""
    if cache:
        compile_cache()
    else:
        keep_in(None)
    for name in modules:
        imported("--import", name)


def imported(option: str, name: str) -> ModuleType:
    """Return the Python module that an option names.

    **Raises:** `ValueError` for a name of no module, and a module that ends the program.
    """
    here = str(Path.cwd())  # where `python` would also search
    if here not in sys.path:
        sys.path.insert(0, here)
    need = f"Option {option} must be a Python module, but is {name}"
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ValueError(f"{need}: {error}.") from None
    except SystemExit as error:
        raise ValueError(f"{need}, a program that exits with {error}.") from None


def of_module(option: str, path: str) -> Any:
    """Return what an option names by a module and a name in it, such as my_pictures.histogram."""
    module, _, name = path.rpartition(".")
    of = imported(option, module)
    require(hasattr(of, name), option, f"be a name in the module {module}", name, names=dir(of))
    return getattr(of, name)


class FilePath(click.Path):
    """A path; ~ is the user's home, also in texts that a shell does not expand, such as --out=~/run.

    With `allow_dash`, - is standard input, which is read at once.
    """

    def convert(self, value: str | Path, param: click.Parameter | None, ctx: click.Context | None) -> object:
        if str(value) != "-":
            return super().convert(user_path(value), param, ctx)
        name = "path" if param is None else param.opts[0]
        require(self.allow_dash, name, "be the path of a file", shown="-, standard input")
        return read_standard_input()


FILE = FilePath(path_type=Path)
INPUT = FilePath(path_type=Path, allow_dash=True)
"""A scene or a table, which may be standard input."""


class Whole(click.IntRange):
    """Whole numbers from a minimum, called "integer" in help."""

    name = "integer"


COUNT = Whole(1)
FROM_ZERO = Whole(0)


class Measure(click.ParamType):
    """A number in the unit of `shown_value`, or a text with any unit of the same kind, such as "1/16 in".

    Without a quantity texts stay texts: another value of the same option names the parameter, and `shown_value`
    converts the texts when both values are known.
    """

    name = "float"

    def __init__(self, quantity: Quantity | None = None):
        self.quantity = quantity

    def convert(self, value: float | str, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        try:
            return float(value)
        except ValueError:
            return value if self.quantity is None else shown_value(self.quantity, value)


VALUE = Measure()


def shown_value(quantity: Quantity, value: float | str) -> float:
    """Return a value of an option in its display unit.

    A number has the display unit for a parameter with a name of its own, and the SI unit for a path.

    **Raises:** `ValueError` for a text without a unit of the quantity's kind.
    """
    if not isinstance(value, str):
        return value if quantity.name in QUANTITIES else quantity.shown(value)
    from ..tools.units import parsed

    return quantity.shown(parsed(quantity.name, value, quantity.unit))


def parameters_of(quantities: Mapping[str, Quantity]) -> str:
    """Return help that lists the parameters and the units of their values."""
    units = ", ".join(f"{name} [{q.display_unit}]" for name, q in quantities.items())
    return f"Parameters: {units}; or a path such as section.play.2 [SI unit]. Other units: '1/16 in'."


def bounds(name: str, text: str, **more: Any) -> Adds:
    """Return an option that takes a parameter and its bounds."""
    return option(name, (str, VALUE, VALUE), f"{text} {parameters_of(PARAMETERS)}", metavar="NAME LOW HIGH", **more)


def result(default: str | None, text: str = "") -> Adds:
    """Return the option --out of commands that write a result, whose value is a list of paths."""
    endings = (
        ".nc (all numbers), .png or .svg (a picture), .pdf (a picture or a report), .csv (tables), .xlsx (tables and "
        f"summary), .mat (MATLAB); without one, {' and '.join(USUAL)}"
    )
    usual = [] if default is None else [default]
    help = f"File to write, by its ending: {endings}; repeat for several.{text}"
    return option("--out", FILE, help, default=usual, multiple=True, show_default=default or False)


_PAPER = inspect.signature(paper_scene).parameters  # help states their defaults


def _of_case(name: str) -> Adds:
    """Return the option that overrides a parameter of the scene."""
    q = PARAMETERS[name]
    # the default scene is the paper's
    shown = "the scene's"
    if name in _PAPER:
        shown = f"{q.shown(_PAPER[name].default):g}, or the scene file's"
    text = f"{q.long_name[0].upper()}{q.long_name[1:]} [{q.display_unit}]."
    return option(f"--{name.replace('_', '-')}", Measure(q), text, show_default=shown)


begin = option(
    "--begin",
    Measure(Quantity("begin", "m", "place of the rail")),
    "Distance along the rail at which the motion begins [m]; default: the beginning of the rail.",
    show_default=False,
    # inf and NaN are numbers, too
    callback=lambda ctx, _, value: None if value is None else number(finite, "begin", value, "m"),
)
"""The option of commands whose motion travels along the rail."""
MEMORIES = {"event": EventLatch, "peak": PeakRateLatch, "smooth": SmoothSwitch}
"""Contact memories by the words for --memory."""
CASE = {
    "scene": option(
        "--scene", INPUT, "TOML file of a scene, - for standard input, or netCDF file of a result with the scene."
    ),
    **{name: _of_case(name) for name in PARAMETERS if not name.startswith(("inertia", "play"))},
    "wavelength": option(
        "--wavelength",
        Measure(Quantity("wavelength", "m", "irregularity wavelength")),
        "Irregularity wavelength [m]; repeat for several.",
        multiple=True,
        default=None,
        show_default="8, or the scene file's",
    ),
    "rail": option(
        "--rail", INPUT, "Measured rail in place of the scene's: a CSV or netCDF file, or - for standard input."
    ),
    "memory": option(
        "--memory",
        click.Choice(list(MEMORIES)),
        "Velocity to which the damping refers: at touchdown (event, or smooth by an equation without events), or the "
        "fastest since touchdown (peak).",
        show_default="the scene file's, or peak on surveyed and random rails and event on others",
    ),
    "set": option(
        "--set",
        str,
        "Any other number of the scene, such as 'section.play.2=0.4 mm', in SI units if it has none; repeat for "
        "several.",
        multiple=True,
    ),
    "solver": option(
        "--solver",
        str,
        "Integration method: ImpulseRK4, RK4, Tsit5, Rodas4, ROS34PW2, TwoStep, or the name of a solver of diffrax.",
        show_default="ImpulseRK4, or RK4 with the smooth memory",
    ),
    "steps_per_period": option(
        "--steps-per-period", COUNT, "Integration steps per forcing period; default: as the scene needs."
    ),
}
"""Options that choose a scene, change it, and set its integration, by the names of their values."""


class Case(NamedTuple):
    """A scene, its start and the settings of its integration, from options."""

    scene: Scene
    start: Motion | State | None = None
    """None for the start of Table 2."""
    solver: diffrax.AbstractSolver | None = None
    steps_per_period: int | None = None
    """None for the number that the scene needs."""
    file: SceneFile | None = None
    """Contents of the scene's TOML file, if the scene is from such a file."""

    @property
    def options(self) -> dict[str, object]:
        """All values except the scene, as arguments of the package's functions."""
        return dict(start=self.start, solver=self.solver, steps_per_period=self.steps_per_period)

    def text(self, varied: Iterable[str] = (), start: str = "") -> str:
        """Return the case as a text: a sled's slippers, speed, clearance and length, unless varied, and its start."""
        from ..flow.datasets import named_parameters, scene_attributes

        # values that depend on a varied parameter are absent
        units = ShownUnits(self.file.units if self.file else ())
        known = named_parameters(scene_attributes(self.scene, list(varied)), units)
        slippers = self.scene.slipper.names
        words = [f"{len(slippers)} slippers"] if slippers else []
        words += [known[name] for name in MAIN if name in known]
        if not start:
            start = "from Table 2's start" if self.start is None else "from the scene file's start"
            # a varied coordinate of the start replaces the start's own
            but = [name for name in varied if name in STARTS]
            start += f" but for {listed(but)}" if but else ""
        return ", ".join([*words, start])


def takes_case(command: Command) -> Command:
    """Return a command that also has the options of `CASE`, and whose function gets a `Case` as its argument `case`.

    A command that has its own option or argument `scene` keeps it.
    """
    # click keeps here what the decorators below have added
    own = {one.name for one in getattr(command, "__click_params__", [])}

    @functools.wraps(command)
    def call(**given: object) -> object:
        case = make_case(**{name: given.pop(name) for name in CASE})
        return command(case=case, **given)

    # decorators apply from the last, so that help lists the first option first
    made: Command = call
    for name, add in reversed(CASE.items()):
        made = made if name in own else add(made)
    return made


def given(*names: str) -> list[str]:
    """Return those of a command's options that the user gave, in the form of the command line."""
    # values may also be defaults
    source = click.get_current_context().get_parameter_source
    return [f"--{name.replace('_', '-')}" for name in names if source(name) is click.core.ParameterSource.COMMANDLINE]


def make_case(
    *,
    scene: Path | None = None,
    memory: str | None = None,
    wavelength: Sequence[float] = (),
    rail: Path | None = None,
    set: Sequence[str] = (),
    solver: str | None = None,
    steps_per_period: int | None = None,
    **values: float | None,
) -> Case:
    """Return the case that options describe.

    **Arguments:** the options of `CASE`; `wavelength`: [m]; `values`: parameters by name in display units, None where
    the scene's value stays.

    **Raises:** `ValueError` that names the wrong argument or option.
    """
    # here, because help does not need these
    from ..model.surveys import load_rail
    from ..model.tracks import HarmonicTrack
    from ..solvers.named import resolve_solver
    from ..sweeps.loading import load

    found = None if scene is None else load(scene)
    made = paper_scene() if found is None else found.scene
    start = None if found is None else found.start
    # parts of the scene first, because parameters are written into the parts
    parts: dict[str, object] = {}
    if memory is not None:
        parts["memory"] = MEMORIES[memory]()
    if rail is not None:
        parts["track"] = load_rail(rail)
    if wavelength:
        # other rails have no wavelengths
        track = parts.get("track", made.track)
        if not isinstance(track, HarmonicTrack):
            raise ValueError(f"Option --wavelength needs a HarmonicTrack, but the track is {track!r}.")
        parts["track"] = dataclasses.replace(track, wavelengths=tuple(wavelength))
    if parts:
        made = dataclasses.replace(made, **parts)
    numbers: dict[str, Any] = {
        name: PARAMETERS[name].from_shown(value) for name, value in values.items() if value is not None
    }
    # each text is a name and a value, with or without a unit
    for text in set:
        name, equals, value = (part.strip() for part in text.partition("="))
        require(equals, "--set", "be a name and a value, as in mass=15", text)
        if name in numbers:
            raise ValueError(f"Option --set must not give {name}, which another option gives, too.")
        try:
            numbers[name] = float(value)
        except ValueError:
            numbers[name] = value
    made = made.replace(**numbers)
    file = found if found is None or isinstance(found, SceneFile) else _as_file(found)
    return Case(made, start, resolve_solver(made, solver), steps_per_period, file)


def _as_file(result: "AbstractResult") -> SceneFile | None:
    """Return the result of one run as the file that would repeat it; None for other results."""
    call = result.call
    if call["function"] != "run":
        return None
    names = ("length", "begin", "window", "record", "steps_per_period", "refine", "solver")
    asked = {name: call[name] for name in names if call.get(name) is not None}
    units = tuple(json.loads(result.ds.attrs.get("shown_units", "[]")))
    return SceneFile(result.scene, result.start, asked, units, None, None, [])


def make_bounds(
    option: str, scene: Scene, name: str, low: float | str, high: float | str
) -> tuple[Parameter, tuple[float, float]]:
    """Return a parameter and its bounds [SI unit].

    **Arguments:** `option`: for errors; `low`, `high`: in the unit of `shown_value`, or texts with a unit.

    **Raises:** `ValueError` that names the wrong option or parameter.
    """
    quantity = parameter(name, scene)
    low = shown_value(quantity, low)
    high = shown_value(quantity, high)
    # a value out of range is an error, an implausible value gives a warning
    bounds = quantity.check(quantity.from_shown(np.array([low, high])))
    shown = f"{low:g} to {high:g} {quantity.display_unit}"
    require(low < high, option, "have two bounds, the smaller first", shown=shown)
    return quantity, (float(bounds[0]), float(bounds[1]))


def bounds_of_each(
    option: str, scene: Scene, rows: Iterable[tuple[str, float | str, float | str]]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of parameters [SI unit] by name, see `make_bounds`; each name must be given once."""
    found: dict[str, tuple[float, float]] = {}
    for name, low, high in rows:
        require(name not in found, option, "name each parameter once", name)
        found[name] = make_bounds(option, scene, name, low, high)[1]
    return found
