"""Options of the command line: their types and help, and what they stand for in the package."""

import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..model import PARAMETERS

GridAxis = tuple[str, float, float, int]
"""Parameter, first and last value in its display unit, number of values."""


def _help(name: str, more: str = "") -> str:
    """The help text of a parameter's option: what it is, and its display unit."""
    q = PARAMETERS[name]
    return f"{q.long_name[0].upper()}{q.long_name[1:]}{more or f' [{q.display_unit}]'}."


def without(*endings: str) -> Callable[[Path], Path]:
    """A callback of an option: the path without an ending that the command adds itself."""
    return lambda path: path.with_suffix("") if path.suffix.lower() in endings else path


_NAMES = ", ".join(f"{name} [{q.display_unit}]" for name, q in PARAMETERS.items())

Speed = Annotated[float, typer.Option(help=_help("speed"))]
Clearance = Annotated[float, typer.Option(help=_help("clearance"))]
Length = Annotated[float, typer.Option(help=_help("length"))]
Stiffness = Annotated[float, typer.Option(help=_help("stiffness"))]
Restitution = Annotated[float, typer.Option(help=_help("restitution", ", above 0 and at most 1"))]
Wavelength = Annotated[list[float], typer.Option(help="Irregularity wavelength [m]; repeat for several.")]
Amplitude = Annotated[float, typer.Option(help=_help("amplitude"))]
RollAmplitude = Annotated[float, typer.Option(help=_help("roll_amplitude"))]
Steps = Annotated[int | None, typer.Option(help="Integration steps per forcing period; default from the scene.")]
Out = Annotated[
    Path,
    typer.Option(help="Where to write: makes OUT.nc and OUT.png.", callback=without(".nc", ".png")),
]
Solver = Annotated[
    str,
    typer.Option(help="RK4, Tsit5, Rodas3, Rodas4, ROS34PW2, TwoStep, one of diffrax's, or auto, which says why."),
]
Memory = Annotated[str, typer.Option(help="How contacts remember their touchdown: event or smooth.")]
Over = Annotated[
    GridAxis, typer.Option(help=f"Parameter, first and last value, number of values. Parameters: {_NAMES}.")
]
By = Annotated[GridAxis | None, typer.Option(help="A second parameter likewise: makes a regime map.")]


def make_scene(*, memory: str = "event", wavelength: list[float], **values: float) -> Any:
    """The paper's scene with the values of options.

    **Arguments:** `memory`: of `--memory`; `wavelength`: [m]; `values`: parameters by name, in display units.

    **Raises:** `ValueError` that names the argument or option which is wrong.
    """
    from ..model import EventLatch, SmoothSwitch, paper_scene

    memories = {"event": EventLatch, "smooth": SmoothSwitch}
    if memory not in memories:
        raise ValueError(f"Option --memory must be event or smooth, but is {memory!r}.")
    in_si = {name: PARAMETERS[name].from_shown(value) for name, value in values.items()}
    return paper_scene(wavelengths=tuple(wavelength), memory=memories[memory](), **in_si)


def make_solver(name: str, scene: Any) -> Any:
    """A solver by its name; for "auto" the scene's, with the reason on standard error.

    **Raises:** `ValueError` for a name that is no solver's.
    """
    import diffrax

    import slipperjax.solvers as solvers

    if name == "auto":
        chosen = solvers.choose_solver(scene)
        print(f"solver {solvers.solver_name(chosen.solver)}: {chosen.reason}", file=sys.stderr)
        return chosen.solver
    kind = getattr(solvers, name, getattr(diffrax, name, None))
    if not (isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver)) or name.startswith("Abstract"):
        raise ValueError(f"Option --solver must be auto or a solver of slipperjax or diffrax, but is {name!r}.")
    try:
        found = kind()
        solvers.resolve_solver(scene, found)  # raises where it cannot be latched
        return found
    except TypeError as error:
        raise ValueError(f"Option --solver must be a solver that needs no arguments, but is {name!r}.") from error


def make_grid(over: GridAxis, by: GridAxis | None = None) -> dict[str, Any]:
    """Values in SI units by parameter name, from `--over` and `--by`.

    **Raises:** `ValueError` that names the option which is wrong.
    """
    import numpy as np

    from ..sweeps import refuse_cases

    grid = {}
    for option, axis in (("--over", over), ("--by", by)):
        if axis is None:
            continue
        name, first, last, count = axis
        if name not in PARAMETERS:
            raise ValueError(f"Option {option} must begin with one of {', '.join(PARAMETERS)}, but is {name!r}.")
        if count < 1:
            raise ValueError(f"Option {option} must end with a number of values of 1 or more, but is {count}.")
        if not np.all(np.isfinite((first, last))):
            PARAMETERS[name].checked(PARAMETERS[name].from_shown(first if not np.isfinite(first) else last))
        if name in grid:
            raise ValueError(f"Option --by must name another parameter than --over, but is {name!r} too.")
        refuse_cases(count * math.prod(map(len, grid.values())))  # before the values take the memory
        grid[name] = PARAMETERS[name].from_shown(np.linspace(first, last, count))
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
