"""The root command, and the options that commands share: their types and help, and what they stand for.

Commands import what they need when they are called: help is quick.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from ..model.dang2024 import paper_scene
from ..model.parameters import PARAMETERS, STARTS, parameter
from ..model.quantities import Quantity
from ..tools.cache import compile_cache
from ..tools.checks import finite, number, require
from ..tools.files import listed, user_path

LOST = 1
"""Exit code where nothing finite came out."""
WRONG = 2
"""Exit code after an error."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def option(name: str, type: Any, text: str, **more: Any) -> Callable[..., Any]:
    """Return an option of a command; `text` is its help."""
    return click.option(name, type=type, help=text, **more)


def flag(name: str, text: str) -> Callable[..., Any]:
    """Return an option without a value."""
    return click.option(name, is_flag=True, help=text)


class Group(click.Group):
    """A group of commands, which an interrupt ends without a word of click's."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)


def _print_versions(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from ..flow.datasets import versions

        of = dict(versions())
        print(f"slipperjax {of.pop('slipperjax')} ({', '.join(f'{name} {version}' for name, version in of.items())})")
        ctx.exit()


@click.group(cls=Group, context_settings={"show_default": True})
@option(
    "--cache/--no-cache",
    None,
    "Keep compiled programs in the user's cache folder, or in that of SLIPPERJAX_CACHE.",
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
def app(cache: bool) -> None:
    """Nonlinear dynamics of rocket-sled slippers."""
    if cache:
        compile_cache()


class FilePath(click.Path):
    """A path, which begins in the user's home after ~ also where the shell leaves it, as in --out=~/run."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return super().convert(user_path(value), param, ctx)


FILE = FilePath(path_type=Path)


class Whole(click.IntRange):
    """Whole numbers from a least one on."""

    name = "integer"


COUNT = Whole(1)
FROM_ZERO = Whole(0)


class Measure(click.ParamType):
    """A number in a display unit, or a text with any unit of that kind, such as "1/16 in".

    Without a quantity texts are left as they are: `shown_value` reads them as values of the parameter beside them.
    """

    name = "float"

    def __init__(self, quantity: Quantity | None = None):
        self.quantity = quantity

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        # numbers are in the display unit
        try:
            return float(value)
        except ValueError:
            return value if self.quantity is None else shown_value(self.quantity, value)


VALUE = Measure()


def shown_value(quantity: Quantity, value: float | str) -> float:
    """Return a value of an option in its display unit.

    **Raises:** `ValueError` for a text without a unit of the quantity's kind.
    """
    if not isinstance(value, str):
        return value
    from ..tools.units import parsed

    return quantity.shown(parsed(quantity.name, value, quantity.unit))


def parameters_of(names: dict[str, Any]) -> str:
    """Help on values of parameters: their names with display units."""
    units = ", ".join(f"{name} [{q.display_unit}]" for name, q in names.items())
    return f"Parameters: {units}; and paths in SI units such as section.play.2. Other units as in '1/16 in'."


def bounds(name: str, text: str, **more: Any) -> Callable[..., Any]:
    """Return an option that bounds a parameter."""
    return option(name, (str, VALUE, VALUE), f"{text} {parameters_of(PARAMETERS)}", metavar="NAME LOW HIGH", **more)


def out(default: str | None, text: str, *endings: str) -> Callable[..., Any]:
    """Return the option --out, without an ending that the command adds itself."""

    def without(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
        return path.with_suffix("") if path is not None and path.suffix.lower() in endings else path

    return option("--out", FILE, text, default=default, callback=without)


def result(default: str) -> Callable[..., Any]:
    """Return the option --out of commands that write a dataset and a picture."""
    return out(default, "Where to write: makes OUT.nc and OUT.png.", ".nc", ".png")


_PAPER = inspect.signature(paper_scene).parameters


def _of_case(name: str) -> Callable[..., Any]:
    """Return the option that overrides a parameter of the scene."""
    q = PARAMETERS[name]
    shown = "the scene's"
    if name in _PAPER:
        shown = f"{q.shown(_PAPER[name].default):g}, or the scene file's"
    text = f"{q.long_name[0].upper()}{q.long_name[1:]} [{q.display_unit}]."
    return option(f"--{name.replace('_', '-')}", Measure(q), text, show_default=shown)


begin = option(
    "--begin",
    Measure(Quantity("begin", "m", "place of the rail")),
    "Place of the rail where it begins [m]; default where the rail does.",
    show_default=False,
    callback=lambda ctx, _, value: None if value is None else number(finite, "begin", value, "m"),
)
"""The option of commands that travel along the rail."""
CASE: dict[str, Callable[..., Any]] = {
    "scene": option("--scene", FILE, "A TOML file of a scene, or a result's netCDF file."),
    **{name: _of_case(name) for name in PARAMETERS if not name.startswith("inertia")},
    "wavelength": option(
        "--wavelength",
        Measure(Quantity("wavelength", "m", "irregularity wavelength")),
        "Irregularity wavelength [m]; repeat for several.",
        multiple=True,
        default=None,
        show_default="8, or the scene file's",
    ),
    "rail": option("--rail", FILE, "A survey of the rail, CSV or netCDF-4, in place of the scene's track."),
    "memory": option(
        "--memory",
        click.Choice(["event", "smooth"]),
        "How contacts remember their touchdown.",
        show_default="event, or the scene file's",
    ),
    "set": option(
        "--set",
        str,
        "Any other number of the scene, as in 'section.play.2=0.4 mm'; without a unit in SI.",
        multiple=True,
    ),
    "solver": option(
        "--solver",
        str,
        "ImpulseRK4, RK4, Tsit5, Rodas4, ROS34PW2, TwoStep, or one of diffrax's.",
        show_default="ImpulseRK4, or RK4 with the smooth memory",
    ),
    "steps_per_period": option(
        "--steps-per-period", COUNT, "Integration steps per forcing period; default from the scene."
    ),
}
"""Options that describe the case, which override what the scene's file says, and its steps."""


class Case(NamedTuple):
    """A case as options describe it."""

    scene: Any
    start: Any = None
    """A motion, or None for Table 2's."""
    solver: Any = None
    steps_per_period: int | None = None
    """None for the scene's own."""

    @property
    def options(self) -> dict[str, Any]:
        """All but the scene, as the package's functions take it."""
        return dict(start=self.start, solver=self.solver, steps_per_period=self.steps_per_period)

    def text(self, varied: Iterable[str] = (), start: str = "") -> str:
        """Return speed, clearance and length without what is varied, and the origin of the start, for summaries."""
        from ..flow.datasets import scene_attributes

        known = scene_attributes(self.scene, list(varied))
        words = []
        for name in ("speed", "clearance", "length"):
            q = PARAMETERS[name]
            value = known.get(f"{name} [{q.unit}]")
            if value is not None:
                words.append(f"{name} {q.shown(value):g} {q.display_unit}")
        if not start:
            start = "from Table 2's start" if self.start is None else "from the scene file's start"
            but = [name for name in varied if name in STARTS]
            start += f" but for {listed(but)}" if but else ""
        return ", ".join([*words, start])


def takes_case(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command with the options of `CASE` besides its own, which gets what they describe as `case`.

    One that has a parameter `scene` of its own gets no option of that name.
    """
    own = {one.name for one in getattr(command, "__click_params__", [])}

    @functools.wraps(command)
    def call(**given: Any) -> Any:
        case = make_case(**{name: given.pop(name) for name in CASE})
        return command(case=case, **given)

    # decorators apply from the last, so that help lists the first one first
    for name, add in reversed(CASE.items()):
        call = call if name in own else add(call)
    return call


def given(*names: str) -> list[str]:
    """Return a command's options that stand on its command line, as they are written there."""
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

    **Arguments:** those of `CASE`; `wavelength`: [m]; `values`: parameters by name, in display units, None for those
    of the scene.

    **Raises:** `ValueError` that names the argument or option which is wrong.
    """
    from ..flow.datasets import load_scene, load_start
    from ..model.contact import EventLatch, SmoothSwitch
    from ..model.surveys import load_rail
    from ..model.tracks import HarmonicTrack
    from ..solvers.named import resolve_solver
    from ..tools.units import parsed

    made = paper_scene() if scene is None else load_scene(scene)
    start = None if scene is None else load_start(scene)
    parts: dict[str, Any] = {}
    if memory is not None:
        parts["memory"] = SmoothSwitch() if memory == "smooth" else EventLatch()
    if rail is not None:
        parts["track"] = load_rail(rail)
    if wavelength:
        track = parts.get("track", made.track)
        if not isinstance(track, HarmonicTrack):
            raise ValueError(f"Option --wavelength needs a HarmonicTrack, but the track is {track!r}.")
        parts["track"] = dataclasses.replace(track, wavelengths=tuple(wavelength))
    if parts:
        made = dataclasses.replace(made, **parts)
    numbers = {name: PARAMETERS[name].from_shown(value) for name, value in values.items() if value is not None}
    # each text is a name and a value, with or without a unit
    for text in set:
        name, equals, value = (part.strip() for part in text.partition("="))
        require(equals, "--set", "be a name and a value, as in mass=15", text)
        if name in numbers:
            raise ValueError(f"Option --set must not give {name}, which another option gives, too.")
        try:
            numbers[name] = float(value)
        except ValueError:
            numbers[name] = parsed(name, value, parameter(name, made).unit)
    made = made.replace(**numbers)
    return Case(made, start, resolve_solver(made, solver), steps_per_period)


def make_bounds(option: str, scene: Any, name: str, low: Any, high: Any) -> tuple[Any, tuple[float, float]]:
    """Return a parameter, and bounds of its values [SI unit].

    **Arguments:** `low`, `high`: as for `shown_value`.

    **Raises:** `ValueError` that names the option or the parameter which is wrong.
    """
    import numpy as np

    quantity = parameter(name, scene)
    low = shown_value(quantity, low)
    high = shown_value(quantity, high)
    # out of range is an error, implausible a warning
    bounds = quantity.check(quantity.from_shown(np.array([low, high])))
    shown = f"{low:g} to {high:g} {quantity.display_unit}"
    require(low < high, option, "have two bounds, the smaller first", shown=shown)
    return quantity, tuple(bounds.tolist())
