"""The command line: parse, call, write."""

import math
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    help="Nonlinear dynamics of rocket-sled slippers.",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Speed = Annotated[float, typer.Option(help="Travelling speed [m/s].")]
Clearance = Annotated[float, typer.Option(help="Total play of slipper and rail [mm].")]
Length = Annotated[float, typer.Option(help="Slipper length [m].")]
Stiffness = Annotated[float, typer.Option(help="Contact stiffness [N/m^1.5].")]
Restitution = Annotated[float, typer.Option(help="Coefficient of restitution, above 0 and at most 1.")]
Wavelength = Annotated[list[float], typer.Option(help="Irregularity wavelength [m]; repeat for several.")]
Amplitude = Annotated[float, typer.Option(help="Irregularity amplitude [mm].")]
RollAmplitude = Annotated[float, typer.Option(help="Irregularity roll amplitude [degrees].")]
Steps = Annotated[int | None, typer.Option(help="Integration steps per forcing period; default from the scene.")]
Out = Annotated[Path, typer.Option(help="Where to write, without ending: makes OUT.nc and OUT.png.")]
Solver = Annotated[
    str,
    typer.Option(help="RK4, Tsit5, Rodas3, Rodas4, ROS34PW2, TwoStep, one of diffrax's, or auto, which says why."),
]
Memory = Annotated[str, typer.Option(help="How contacts remember their touchdown: event or smooth.")]

_UNITS = {"speed": 1.0, "clearance": 1e-3, "length": 1.0, "stiffness": 1.0, "restitution": 1.0}


def _scene(speed, clearance, length, stiffness, restitution, wavelength, amplitude, roll_amplitude):
    from .scene import paper_scene

    return paper_scene(
        speed,
        clearance * 1e-3,
        length,
        stiffness=stiffness,
        restitution=restitution,
        wavelengths=tuple(wavelength),
        amplitude=amplitude * 1e-3,
        roll_amplitude=math.radians(roll_amplitude),
    )


def _folder(folder: Path, out: Path) -> None:
    """Makes the folder to write into, before anything long is begun."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"Option --out must name a place that can be written, but {out}: {error}") from error


def _memory(name: str):
    from .contact import EventLatch, SmoothSwitch

    known = {"event": EventLatch, "smooth": SmoothSwitch}
    if name not in known:
        raise ValueError(f"Option --memory must be event or smooth, but is {name!r}.")
    return known[name]()


def _solver(name: str, scene: Any):
    """A solver by its name; says why where the choice is left to the scene."""
    import diffrax

    from . import solvers

    if name == "auto":
        chosen = solvers.choose_solver(scene)
        print(f"solver {solvers.solver_name(chosen.solver)}: {chosen.reason}", file=sys.stderr)
        return chosen.solver
    kind = getattr(solvers, name, getattr(diffrax, name, None))
    if not (isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver)) or name.startswith("Abstract"):
        raise ValueError(f"Option --solver must be auto or a solver of slipperjax or diffrax, but is {name!r}.")
    try:
        return kind()
    except TypeError as error:
        raise ValueError(f"Option --solver must be a solver that needs no arguments, but is {name!r}.") from error


def _axis(option: str, over: tuple[str, float, float, int]):
    import numpy as np

    name, first, last, count = over
    if name not in _UNITS:
        raise ValueError(f"Option {option} must begin with one of {', '.join(_UNITS)}, but is {name!r}.")
    if count < 1:
        raise ValueError(f"Option {option} must end with a number of values of 1 or more, but is {count}.")
    return name, np.linspace(first, last, count) * _UNITS[name]


def _write(ds: Any, draw: Any, out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    data, picture = Path(f"{out}.nc"), Path(f"{out}.png")
    ds.to_netcdf(data, engine="h5netcdf")
    axes = draw(ds)
    axes.flat[0].figure.savefig(picture, dpi=300)
    plt.close("all")
    print(f"wrote {data} and {picture}")


@app.command()
def simulate(
    speed: Speed = 1250.0,
    clearance: Clearance = 1.0,
    length: Length = 0.2,
    periods: Annotated[int, typer.Option(help="Forcing periods to simulate.")] = 60,
    stiffness: Stiffness = 1e8,
    restitution: Restitution = 0.9,
    wavelength: Wavelength = [8.0],  # noqa: B006  (typer copies it)
    amplitude: Amplitude = 1.0,
    roll_amplitude: RollAmplitude = 0.2,
    steps_per_period: Steps = None,
    saves_per_period: Annotated[int | None, typer.Option(help="Saved states per forcing period.")] = None,
    solver: Solver = "RK4",
    memory: Memory = "event",
    out: Out = Path("trajectory"),
):
    """Simulate one case and write its trajectory."""
    import dataclasses

    import numpy as np

    from . import plots
    from .simulate import STATUS
    from .simulate import simulate as run

    scene = _scene(speed, clearance, length, stiffness, restitution, wavelength, amplitude, roll_amplitude)
    _folder(out.parent, out)
    scene = dataclasses.replace(scene, memory=_memory(memory))
    options = dict(steps_per_period=steps_per_period, saves_per_period=saves_per_period)
    method = _solver(solver, scene)
    print(f"simulating {periods} periods of {float(scene.period) * 1e3:.4g} ms ...", file=sys.stderr)
    ds = run(scene, periods, solver=method, **options).to_xarray()
    _write(ds, lambda ds: plots.overview(ds), out)
    peak = ds["contact_force"].max(["time"])
    at = np.unravel_index(int(np.argmax(peak.values)), peak.shape)
    print(
        f"{ds.attrs['steps_per_period']} steps per period; highest contact force {float(peak.max()):.0f} N "
        f"at {peak['point'].values[at[1]]}{at[0] + 1}; status: {STATUS[ds.attrs['status']]}"
    )


@app.command()
def bifurcation(
    over: Annotated[
        tuple[str, float, float, int],
        typer.Option(help="Parameter, first and last value, number of values; speed m/s, clearance mm, length m."),
    ],
    speed: Speed = 1250.0,
    clearance: Clearance = 1.0,
    length: Length = 0.2,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before the section is recorded.")] = 300,
    periods: Annotated[int, typer.Option(help="Forcing periods to record.")] = 10,
    stiffness: Stiffness = 1e8,
    restitution: Restitution = 0.9,
    wavelength: Wavelength = [8.0],  # noqa: B006
    amplitude: Amplitude = 1.0,
    roll_amplitude: RollAmplitude = 0.2,
    steps_per_period: Steps = None,
    out: Out = Path("bifurcation"),
):
    """Draw the five bifurcation diagrams over a parameter, from Poincare sections as in the paper's Fig. 5."""
    import time

    from . import plots
    from .sweep import sweep

    name, values = _axis("--over", over)
    scene = _scene(speed, clearance, length, stiffness, restitution, wavelength, amplitude, roll_amplitude)
    _folder(out.parent, out)
    begin = time.perf_counter()
    ds = sweep(
        scene,
        {name: values},
        transient=transient,
        periods=periods,
        steps_per_period=steps_per_period,
        progress=sys.stderr.isatty(),
    )
    seconds = time.perf_counter() - begin
    _write(ds, lambda ds: plots.bifurcations(ds), out)
    bad = int((ds["status"] != 0).sum())
    print(
        f"{len(values)} cases, {ds.attrs['transient']} + {periods} periods, {ds.attrs['steps_per_period']} steps per "
        f"period: {seconds:.1f} s with compiling; {bad} cases flagged"
    )


@app.command()
def lyapunov(
    over: Annotated[
        tuple[str, float, float, int],
        typer.Option(help="Parameter, first and last value, number of values; speed m/s, clearance mm, length m."),
    ],
    by: Annotated[
        tuple[str, float, float, int] | None, typer.Option(help="A second parameter likewise: makes a regime map.")
    ] = None,
    speed: Speed = 1250.0,
    clearance: Clearance = 1.0,
    length: Length = 0.2,
    count: Annotated[int, typer.Option(help="Number of exponents, the largest first.")] = 1,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before.")] = 300,
    periods: Annotated[int, typer.Option(help="Forcing periods to average over.")] = 500,
    certify: Annotated[bool, typer.Option(help="Check every case by other means.")] = True,
    stiffness: Stiffness = 1e8,
    restitution: Restitution = 0.9,
    wavelength: Wavelength = [8.0],  # noqa: B006
    amplitude: Amplitude = 1.0,
    roll_amplitude: RollAmplitude = 0.2,
    steps_per_period: Steps = None,
    out: Out = Path("lyapunov"),
):
    """Largest Lyapunov exponents over one parameter, or over two as a regime map, with certificates."""
    import time

    import numpy as np

    from . import plots
    from .spectra import lyapunov_sweep

    grid = dict(_axis(option, axis) for option, axis in (("--over", over), ("--by", by)) if axis is not None)
    if len(grid) < 1 + (by is not None):
        raise ValueError(f"Option --by must name another parameter than --over, but is {over[0]!r} too.")
    scene = _scene(speed, clearance, length, stiffness, restitution, wavelength, amplitude, roll_amplitude)
    _folder(out.parent, out)
    begin = time.perf_counter()
    ds = lyapunov_sweep(
        scene,
        grid,
        count=count,
        transient=transient,
        periods=periods,
        certify=certify,
        steps_per_period=steps_per_period,
        progress=sys.stderr.isatty(),
    )
    seconds = time.perf_counter() - begin
    draw = plots.exponents if by is None else plots.regime_map
    _write(ds, lambda ds: np.array([draw(ds)]), out)
    kinds = plots.regimes(ds)
    shares = ", ".join(f"{int((kinds == k).sum())} {name}" for k, (name, _) in enumerate(plots.REGIMES))
    print(f"{kinds.size} cases: {shares}; {seconds:.1f} s with compiling")


@app.command()
def reproduce(
    figures: Annotated[
        list[str] | None, typer.Argument(help="Figures: 4 to 13, basins; default all of them.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Coarser grids and shorter transients.")] = False,
    transient: Annotated[
        int | None, typer.Option(help="Forcing periods before recording; default 600, with --quick 300.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("reproduced"),
):
    """Run the paper's study: its figures, and a report that answers its claims one by one."""
    import matplotlib

    matplotlib.use("Agg")
    from . import paper
    from .claims import write_report
    from .figures import write_figures

    bars = sys.stderr.isatty()
    runs = paper.reproduce(figures or paper.FIGURES, quick=quick, transient=transient, progress=bars)
    _folder(out, out)
    answers, seconds = {}, {}
    # what is finished is written at once, so that an interrupt loses nothing but the run it hits
    for done in runs:
        answers |= done.outcome.answers
        seconds[done.name] = done.seconds
        write_figures(done, out)
        report, _ = write_report(out, answers, seconds, [])
        print(f"{done.name}: figures {', '.join(done.figures)} in {done.seconds:.1f} s", flush=True)
    if not figures and not quick:
        table = paper.readings(paper.FULL, {"progress": bars})
        report, _ = write_report(out, answers, seconds, table)
    good = sum(answer.good for answer in answers.values())
    print(f"{good} of {len(answers)} claims reproduced, {len(answers) - good} differ: see {report}")


@app.command()
def bench(
    quick: Annotated[bool, typer.Option(help="Two scenes, three methods, one batch: minutes less.")] = False,
    scene: Annotated[list[str] | None, typer.Option(help="A scene by name; repeat for several; default all.")] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="A method by name; repeat for several; default all.")
    ] = None,
    batch: Annotated[
        list[int] | None, typer.Option(help="Trajectories at once; repeat for several; default 241 and 1.")
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs of each point.")] = 5,
    out: Annotated[Path, typer.Option(help="Where to write, without ending: makes OUT.md and OUT.png.")] = Path(
        "bench"
    ),
):
    """Draw error against cost for every solver, and for other codes where they are at hand."""
    import matplotlib

    matplotlib.use("Agg")
    from . import bench as work
    from .work_precision import write

    def show(point):
        times = ", ".join(f"{best:.3g} us at {lanes}" for lanes, (best, _) in point.cost.items())
        print(f"{point.case}: {point.method}, {point.setting}: error {point.error:.1e}, {times}", flush=True)

    _folder(out.parent, out)
    names = dict(cases=scene or None, methods=method or None, batches=batch or None)
    # written anew after each scene, so that an interrupt loses nothing but the scene it hits
    for found in work.bench(quick=quick, repeats=repeats, report=show, **names):
        text, picture = write(*found, out)
        print(f"wrote {text} and {picture}")


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0, or 2 with one line that says what is wrong."""
    try:
        code = app(args=arguments, standalone_mode=False)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        usage = hasattr(error, "format_message")
        if not usage and not isinstance(error, ValueError | OSError):
            raise
        text = error.format_message() if usage else str(error)  # type: ignore[union-attr]
        print("error: " + " ".join(text.split()), file=sys.stderr)
        sys.exit(2)
    sys.exit(code if isinstance(code, int) else 0)
