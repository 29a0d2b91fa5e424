"""The commands. Each imports what it needs when it is called, so that help is quick."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from ..tools.cache import compile_cache
from ..tools.files import listed, said, write_each
from .files import PARTIAL, Outputs, drawn_by
from .interrupts import on_thread
from .options import By, Case, Log, Out, Over, Steps, make_folder, make_grid, takes_case, without

LOST = 1
"""Exit code where no case stayed finite."""


class Once(typer.core.TyperCommand):
    """A command that refuses an option which is given twice and can have one value only."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        _, _, given = self.make_parser(ctx).parse_args(list(args))
        for option in given:
            if given.count(option) > 1 and not option.multiple:
                raise typer.BadParameter(f"Option {option.opts[0]} must be given once, but is given more often.")
        return super().parse_args(ctx, args)


app = typer.Typer(
    help="Nonlinear dynamics of rocket-sled slippers.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        from ..flow.datasets import versions

        of = dict(versions())
        print(f"slipperjax {of.pop('slipperjax')} ({', '.join(f'{name} {version}' for name, version in of.items())})")
        raise typer.Exit


@app.callback()
def options(
    cache: Annotated[
        bool,
        typer.Option(help="Keep compiled programs in the user's cache folder, or in that of SLIPPERJAX_CACHE."),
    ] = True,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print versions and exit.")
    ] = False,
):
    """Nonlinear dynamics of rocket-sled slippers."""
    if cache:
        compile_cache()


@app.command(cls=Once)
@takes_case
def simulate(
    case: Case,
    periods: Annotated[int, typer.Option(help="Forcing periods to simulate.")] = 60,
    steps_per_period: Steps = None,
    saves_per_period: Annotated[int | None, typer.Option(help="Saved states per forcing period.")] = None,
    probe: Annotated[
        int, typer.Option(help="Periods that are repeated with half the step, for the error; or 0.")
    ] = 4,
    out: Out = Path("trajectory"),
):
    """Simulate one case and write its trajectory."""
    from ..flow.simulate import simulate as run
    from ..flow.simulate import step_plan
    from ..flow.status import Status
    from ..tools.checks import whole

    scene = case.scene
    files = Outputs(out, ".nc", ".png")
    options = dict(steps_per_period=steps_per_period, saves_per_period=saves_per_period)
    # checked here, too, so that an error is the only line
    whole("periods", periods, 1)
    whole("probe", probe, 0)
    step_plan(scene, steps_per_period, saves_per_period)
    print(f"simulating {periods} periods of {float(scene.period) * 1e3:.4g} ms ...", file=sys.stderr)
    found = on_thread(lambda: run(scene, periods, start=case.start, solver=case.solver, probe=probe, **options))
    ds = found.to_xarray()
    files.write(ds, drawn_by("overview"))
    status, parts = Status(int(found.status)), [f"{ds.attrs['steps_per_period']} steps per period"]
    if status != Status.NOT_FINITE:
        if float(found.peak.force) > 0:
            parts.append(found.peak.text(scene))
        if found.probe is not None:
            parts.append(_error(found.probe))
    print("; ".join([*parts, f"status: {status}"]))
    if status == Status.NOT_FINITE:
        raise typer.Exit(LOST)


@app.command(cls=Once)
@takes_case
def orbit(
    case: Case,
    period: Annotated[int, typer.Option(help="Forcing periods after which the motion recurs.")] = 1,
    transient: Annotated[
        int | None,
        typer.Option(help="Forcing periods simulated before Newton's method; default 60, and 240 if need be."),
    ] = None,
    steps_per_period: Steps = None,
    out: Out = Path("orbit"),
):
    """Find a periodic motion, stable or not, with its Floquet multipliers and contact signature."""
    from ..flow.status import Status
    from ..orbits.periodic import periodic_orbit

    files = Outputs(out, ".nc", ".png")
    options = dict(start=case.start, transient=transient, steps_per_period=steps_per_period, solver=case.solver)
    found = on_thread(lambda: periodic_orbit(case.scene, period, **options))
    status = Status(int(found.status))
    if status != Status.FINITE:
        print(f"no file is written; residual {float(found.residual):.2g}; status: {status}")
        raise typer.Exit(LOST)
    files.write(found.to_xarray(), drawn_by("overview"))
    leading = ", ".join(f"{m.real:.6g}{m.imag:+.6g}i" if m.imag else f"{m.real:.6g}" for m in found.multipliers[:4])
    print(
        f"period {found.period}, {'stable' if found.stable else 'unstable'}, largest exponent "
        f"{float(found.exponent):.6g} per period; multipliers {leading}, ...; {found.signature}; "
        f"{int(found.iterations)} iterations, residual {float(found.residual):.1g} (scaled)"
    )


@app.command(cls=Once)
@takes_case
def bifurcation(
    case: Case,
    over: Over,
    log: Log = None,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before the section is recorded.")] = 300,
    periods: Annotated[int, typer.Option(help="Forcing periods to record.")] = 10,
    steps_per_period: Steps = None,
    out: Out = Path("bifurcation"),
):
    """Draw the five bifurcation diagrams over a parameter, from Poincare sections as in the paper's Fig. 5."""
    from ..sweeps.sweep import sweep

    grid = make_grid(over, log=log)
    files = Outputs(out, ".nc", ".png")
    begin = time.perf_counter()
    with files.keeping(draw := drawn_by("bifurcations")):
        ds = sweep(
            case.scene,
            grid,
            transient=transient,
            periods=periods,
            steps_per_period=steps_per_period,
            solver=case.solver,
            start=case.start,
            progress=True,
        )
    seconds = time.perf_counter() - begin
    files.write(ds, draw)
    flagged, meanings = flagged_cases(ds)
    print(
        f"{ds['status'].size} cases, {ds.attrs['transient']} + {periods} periods, {steps_text(ds)} steps per period: "
        f"{seconds:.1f} s with compiling; {flagged} cases flagged{meanings}"
    )
    exit_if_lost(ds)


@app.command(cls=Once)
@takes_case
def lyapunov(
    case: Case,
    over: Over,
    by: By = None,
    log: Log = None,
    count: Annotated[int, typer.Option(help="Number of exponents, the largest first.")] = 1,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before.")] = 300,
    periods: Annotated[int, typer.Option(help="Forcing periods to average over.")] = 500,
    certify: Annotated[bool, typer.Option(help="Check every case by other means.")] = True,
    orbits: Annotated[bool, typer.Option(help="Take the exponents of periodic cases from their orbits.")] = True,
    steps_per_period: Steps = None,
    out: Out = Path("lyapunov"),
):
    """Largest Lyapunov exponents over one parameter, or over two as a regime map, with certificates."""
    from ..analysis.lyapunov import REGIMES
    from ..sweeps.exponents import lyapunov_sweep

    grid = make_grid(over, by, log=log)
    files = Outputs(out, ".nc", ".png")
    draw = drawn_by("exponents" if by is None else "regime_map")
    begin = time.perf_counter()
    with files.keeping(draw):
        ds = lyapunov_sweep(
            case.scene,
            grid,
            count=count,
            transient=transient,
            periods=periods,
            certify=certify,
            orbits=orbits,
            steps_per_period=steps_per_period,
            solver=case.solver,
            start=case.start,
            progress=True,
        )
    seconds = time.perf_counter() - begin
    files.write(ds, draw)
    shares = ", ".join(f"{int((ds['regime'] == name).sum())} {name}" for name in REGIMES)
    flagged, meanings = flagged_cases(ds)
    print(
        f"{ds['regime'].size} cases: {shares}; {steps_text(ds)} steps per period, {seconds:.1f} s with compiling; "
        f"{flagged} cases flagged{meanings}"
    )
    exit_if_lost(ds)


@app.command(cls=Once)
def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(help="Figures: 4 to 13, basins; default all of them."),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Coarser grids and shorter transients.")] = False,
    transient: Annotated[
        int | None, typer.Option(help="Forcing periods before recording; default 600, with --quick 300.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("reproduced"),
):
    """Run the paper's study: its figures, and a report that answers its claims one by one."""
    import matplotlib

    from ..studies.dang2024.claims import write_report
    from ..studies.dang2024.figures import write_figures
    from ..studies.dang2024.runs import FIGURES, FULL, readings
    from ..studies.dang2024.runs import reproduce as run

    matplotlib.use("Agg")
    runs = run(figures or FIGURES, quick=quick, transient=transient, progress=True)
    make_folder(out, out)
    answers, seconds, partial = {}, {}, ()
    # what is finished is written at once; the report gets its name when all of it is
    for done in runs:
        try:
            names = [str(path) for path in write_figures(done, out)]
        finally:  # where the disk is full, the report may still find room
            answers |= done.outcome.answers
            seconds[done.name] = done.seconds
            partial = write_report(out, answers, seconds, [], f"claims{PARTIAL}")
        if done.figures:
            print(f"{done.name}: figures {', '.join(done.figures)} in {done.seconds:.1f} s", flush=True)
        else:
            print(f"{done.name}: interrupted after {done.seconds:.1f} s; wrote {listed(names)}", flush=True)
    table = readings(FULL, {"progress": True}) if not figures and not quick else []
    report, _ = write_report(out, answers, seconds, table)
    for path in partial:
        path.unlink(missing_ok=True)
    good = sum(answer.good for answer in answers.values())
    print(f"{good} of {len(answers)} claims reproduced, {len(answers) - good} differ: see {report}")


@app.command(cls=Once)
def bench(
    quick: Annotated[bool, typer.Option(help="Two scenes, three methods, one batch: minutes less.")] = False,
    scene: Annotated[list[str] | None, typer.Option(help="A scene by name; repeat for several; default all.")] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="A method by name; repeat for several; default all.")
    ] = None,
    batch: Annotated[
        list[int] | None, typer.Option(help="Trajectories at once; repeat for several; default 241 and 1.")
    ] = None,
    repeats: Annotated[int | None, typer.Option(help="Timed runs of each point; default 5, with --quick 2.")] = None,
    out: Annotated[
        Path,
        typer.Option(help="Where to write: makes OUT.md, OUT.png and OUT_all.png.", callback=without(".md", ".png")),
    ] = Path("bench"),
):
    """Draw error against cost for every solver, and for other codes where they are installed."""
    import matplotlib

    from ..bench.measure import bench as run
    from ..bench.work_precision import write

    def show(point):
        times = ", ".join(f"{best:.3g} us at {lanes}" for lanes, (best, _) in point.cost.items())
        print(f"{point.case}: {point.method}, {point.setting}: error {point.error:.1e}, {times}", flush=True)

    matplotlib.use("Agg")
    Outputs(out, ".md", ".png", "_all.png")
    names = dict(cases=scene or None, methods=method or None, batches=batch or None)
    # written after each scene; the files get their names when all scenes are done
    found, partial = None, ()
    for found in run(quick=quick, repeats=repeats, report=show, **names):
        partial = write(*found, out.with_name(out.name + PARTIAL))
        print(f"wrote {listed([str(path) for path in partial])}", flush=True)
    if found is not None:
        print(f"wrote {listed([str(path) for path in write(*found, out)])}")
    for path in partial:
        path.unlink(missing_ok=True)


@app.command(cls=Once)
def throughput(
    batch: Annotated[
        list[int] | None, typer.Option(help="Trajectories at once; repeat for several; default 100 to 1000000.")
    ] = None,
    engine: Annotated[
        list[str] | None, typer.Option(help="RK4, Rodas4 or Lyapunov; repeat for several; default all.")
    ] = None,
    beside_cpu: Annotated[
        bool, typer.Option(help="Where JAX runs on a GPU: the same on all CPU cores, for comparison.")
    ] = True,
    out: Annotated[Path, typer.Option(help="Makes OUT.md.", callback=without(".md"))] = Path("throughput"),
):
    """Time trajectory-periods per second over the batch, on a GPU where JAX has one, else on the CPU's cores."""
    from ..bench.rates import rows
    from ..bench.rates import throughput as run

    Outputs(out, ".md")
    show = lambda rate: print(rows([rate])[-1], flush=True)
    table = "\n".join(rows(run(batch or None, engine or None, beside_cpu=beside_cpu, report=show))) + "\n"
    print(said(write_each({Path(f"{out}.md"): table.encode})))


def steps_text(ds: Any) -> str:
    """Steps per period of all cases of a sweep: one number, or the least to the most."""
    least, most = int(ds["steps_per_period"].min()), int(ds["steps_per_period"].max())
    return f"{least}" if least == most else f"{least} to {most}"


def _error(probe: Any) -> str:
    """What half the step changes, in words."""
    import numpy as np

    most, peaks = float(np.max(probe.error)), np.asarray(probe.peak_error)
    of_force = peaks[np.isfinite(peaks)]
    if not np.isfinite(most):
        return "half the step does not stay finite"
    force = f" and its highest force by {float(np.max(of_force)):.1e} of it" if len(of_force) else ""
    return f"half the step changes a period by {most:.1e} (unit: 1 mm, 10 mrad, 1 m/s, 10 rad/s){force}"


def exit_if_lost(ds: Any) -> None:
    """Ends with exit code `LOST` where no case of a sweep stayed finite."""
    from ..flow.status import Status

    if bool((ds["status"] == Status.NOT_FINITE).all()):
        raise typer.Exit(LOST)


def flagged_cases(ds: Any) -> tuple[int, str]:
    """How many cases of a sweep have a status other than 0, and in brackets what their statuses mean."""
    import numpy as np

    from ..flow.status import Status

    codes, counts = np.unique(ds["status"].values, return_counts=True)
    found = {Status(int(c)): int(n) for c, n in zip(codes, counts, strict=True) if c != Status.FINITE}
    meanings = " and ".join(f"{n} {status}" for status, n in found.items())
    return sum(found.values()), f" ({meanings})" if found else ""
