"""The commands that repeat the paper's study, and those that time the package."""

from pathlib import Path
from typing import Any

import click

from ..tools.files import listed, write_each
from .files import PARTIAL, Outputs, make_folder
from .options import COUNT, app, flag, option, out


@app.command()
@click.argument("figures", nargs=-1)
@flag("--quick", "Coarser grids and shorter transients.")
@option("--transient", COUNT, "Forcing periods before recording; default 600, with --quick 300.")
@out("reproduced", "Folder to write into.")
def reproduce(figures: tuple[str, ...], quick: bool, transient: int | None, out: Path) -> None:
    """Run the paper's study: its figures, and a report that answers its claims one by one.

    FIGURES: 4 to 13; default all of them.
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
    table = readings(progress=True) if not figures and not quick else []
    report, _ = write_report(out, answers, seconds, table)
    _delete(partial)
    good = sum(answer.good for answer in answers.values())
    print(f"{good} of {len(answers)} claims reproduced, {len(answers) - good} differ: see {report}")


def _delete(partial: Any) -> None:
    """Delete files whose content has its name now."""
    for path in partial:
        path.unlink(missing_ok=True)


@app.command()
@flag("--quick", "Two scenes, four methods, one batch: minutes less.")
@option("--scene", str, "A scene by name; repeat for several; default all.", multiple=True)
@option("--method", str, "A method by name; repeat for several; default all.", multiple=True)
@option("--batch", COUNT, "Trajectories at once; repeat for several; default 241 and 1.", multiple=True)
@option("--repeats", COUNT, "Timed runs of each point; default 5, with --quick 2.")
@out("bench", "Where to write: makes OUT.md and OUT.png.", ".md", ".png")
def bench(quick: bool, scene: Any, method: Any, batch: Any, repeats: int | None, out: Path) -> None:
    """Draw error against cost for every solver."""
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
    "Trajectories at once; repeat for several; default 100 to 1000000.",
    multiple=True,
)
@option("--engine", str, "RK4, Rodas4 or Lyapunov; repeat for several; default all.", multiple=True)
@out("throughput", "Makes OUT.md.", ".md")
def throughput(batch: Any, engine: Any, out: Path) -> None:
    """Time trajectory-periods per second over the batch, on a GPU where JAX has one, else on the CPU's cores.

    With JAX_PLATFORMS=cpu in the environment, on the cores beside a GPU.
    """
    from ..bench.rates import rows, throughput as run

    Outputs(out, ".md")
    given = {name: values for name, values in (("batches", batch), ("engines", engine)) if values}
    rates = []
    for rate in run(**given):
        rates.append(rate)
        print(rows([rate])[-1], flush=True)
    table = "\n".join(rows(rates)) + "\n"
    print(write_each({Path(f"{out}.md"): table.encode}))
