"""The commands that repeat the paper's study, and those that time the package."""

from collections.abc import Iterable
from pathlib import Path

import click

from ..tools.files import listed, write_each
from .files import PARTIAL, Outputs, make_folder
from .options import COUNT, app, flag, option, out

Texts = tuple[str, ...]
"""Values of an option that may be repeated."""


@app.command()
@click.argument("figures", nargs=-1)
@flag("--quick", "Use coarser grids and shorter transients.")
@option("--transient", COUNT, "Forcing periods simulated before recording; default: 600, with --quick 300.")
@out("reproduced", "Folder to write into.")
def reproduce(figures: Texts, quick: bool, transient: int | None, out: Path) -> None:
    """Repeat the paper's study: draw its figures, and report which of its claims hold.

    FIGURES: numbers from 4 to 13; default: all.
    """
    import matplotlib

    from ..studies.dang2024.claims import write_report
    from ..studies.dang2024.figures import write_figures
    from ..studies.dang2024.runs import FIGURES, readings, reproduce as run

    matplotlib.use("Agg")
    runs = run(figures or FIGURES, quick=quick, transient=transient, progress=True)
    make_folder(out, out)
    answers = {}
    seconds = {}
    partial = ()
    # what is finished is written at once; the report gets its name when all of it is
    for done in runs:
        write_figures(done, out)
        answers |= done.answers
        seconds[done.name] = done.seconds
        partial = write_report(out, answers, seconds, [], f"claims{PARTIAL}")
        print(f"{done.name}: figures {', '.join(done.figures)} in {done.seconds:.1f} s", flush=True)
    # only the whole study compares other readings of the paper
    table = readings(progress=True) if not figures and not quick else []
    report, _ = write_report(out, answers, seconds, table)
    _delete(partial)
    good = sum(answer.good for answer in answers.values())
    print(f"{good} of {len(answers)} claims reproduced, {len(answers) - good} differ: see {report}")


def _delete(partial: Iterable[Path]) -> None:
    """Delete the files of partial results, once the whole ones are written."""
    for path in partial:
        path.unlink(missing_ok=True)


@app.command()
@flag("--quick", "Time two scenes, four methods and one batch only, which saves minutes.")
@option("--scene", str, "Name of a scene; repeat for several; default: all.", multiple=True)
@option("--method", str, "Name of a method; repeat for several; default: all.", multiple=True)
@option(
    "--batch",
    COUNT,
    "Number of trajectories at once; repeat for several; default: 241 and 1.",
    multiple=True,
)
@option("--repeats", COUNT, "Number of times that each point is timed; default: 5, with --quick 2.")
@out("bench", "Write OUT.md and OUT.png.", ".md", ".png")
def bench(
    quick: bool,
    scene: tuple[str, ...],
    method: tuple[str, ...],
    batch: tuple[int, ...],
    repeats: int | None,
    out: Path,
) -> None:
    """Measure and draw error against cost of every solver."""
    import matplotlib

    from ..bench.measure import bench as run
    from ..bench.work_precision import write

    matplotlib.use("Agg")
    Outputs(out, ".md", ".png")
    points = []
    partial = ()
    # written after each scene; the files get their names when all scenes are done
    for found in run(quick=quick, repeats=repeats, cases=scene, methods=method, batches=batch):
        points += found
        for point in found:
            times = ", ".join(f"{best:.3g} us at {lanes}" for lanes, (best, _) in point.cost.items())
            print(
                f"{point.case}: {point.method}, {point.setting}: error {point.error:.1e}, {times}",
                flush=True,
            )
        partial = write(points, out.with_name(out.name + PARTIAL))
        print(f"wrote {listed([str(path) for path in partial])}", flush=True)
    print(f"wrote {listed([str(path) for path in write(points, out)])}")
    _delete(partial)


@app.command()
@option(
    "--batch",
    COUNT,
    "Number of trajectories computed at once; repeat for several; default: 100 to 1000000.",
    multiple=True,
)
@option("--engine", str, "What is timed: RK4, Rodas4 or Lyapunov; repeat for several; default: all.", multiple=True)
@out("throughput", "Write OUT.md.", ".md")
def throughput(batch: tuple[int, ...], engine: Texts, out: Path) -> None:
    """Measure how many forcing periods are simulated per second, over the number of trajectories at once.

    A GPU is used where JAX has one, else the cores of the CPU; they always are with JAX_PLATFORMS=cpu in the
    environment.
    """
    from ..bench.rates import rows, throughput as run

    Outputs(out, ".md")
    # without them the functions have their own
    given = {name: values for name, values in (("batches", batch), ("engines", engine)) if values}
    rates = []
    # a row as soon as it is measured
    for rate in run(**given):
        rates.append(rate)
        print(rows([rate])[-1], flush=True)
    table = "\n".join(rows(rates)) + "\n"
    print(write_each({Path(f"{out}.md"): table.encode}))
