"""The command that repeats the paper's study."""

from pathlib import Path

import click

from .files import PARTIAL, make_folder
from .options import COUNT, FILE, app, flag, option


@app.command()
@click.argument("figures", nargs=-1)
@flag("--quick", "Use coarser grids and shorter transients.")
@option("--transient", COUNT, "Forcing periods simulated before recording; default: 600, with --quick 300.")
@option("--out", FILE, "Folder to write into.", default="reproduced")
def reproduce(figures: tuple[str, ...], quick: bool, transient: int | None, out: Path) -> None:
    """Repeat the paper's study: draw its figures, and report which of its claims hold.

    FIGURES: numbers from 4 to 13; default: all.
    """
    from ..studies.dang2024.claims import write_report
    from ..studies.dang2024.figures import write_figures
    from ..studies.dang2024.runs import FIGURES, readings, reproduce as run

    runs = run(figures or FIGURES, quick=quick, transient=transient, progress=True)
    make_folder(out, out)
    answers = {}
    seconds = {}
    partial = ()
    # finished figures are written at once; the report gets its name when all figures are finished
    for done in runs:
        write_figures(done, out)
        answers |= done.answers
        seconds[done.name] = done.seconds
        partial = write_report(out, answers, seconds, [], f"claims{PARTIAL}")
        drawn = "figure" + "s" * (len(done.figures) > 1)
        print(f"{done.name}: {drawn} {', '.join(done.figures)} in {done.seconds:.1f} s", flush=True)
    # only the whole study compares other readings of the paper
    table = readings(progress=True) if not figures and not quick else []
    report, _ = write_report(out, answers, seconds, table)
    for path in partial:
        path.unlink(missing_ok=True)
    good = sum(answer.good for answer in answers.values())
    print(f"{good} of {len(answers)} claims reproduced, {len(answers) - good} differ: see {report}")
