"""The command that finds parameters from measured signals."""

from collections.abc import Sequence
from pathlib import Path

import click

from ..model.parameters import PARAMETERS
from ..tools.checks import require
from .files import Outputs, said
from .interrupts import on_thread
from .options import (
    COUNT,
    FROM_ZERO,
    INPUT,
    LOST,
    REST,
    Case,
    app,
    begin,
    bounds,
    bounds_of_each,
    given,
    option,
    result,
    takes_case,
)


@app.command(of="fitting.fit.fit")
@bounds("--fit", "Parameter to find, with its lower and upper bound; repeat for several.", multiple=True)
@option(
    "--fit-sensor",
    (str, float, float),
    "Number of a sensor to find, such as front.gain, with its bounds [SI unit]; repeat for several.",
    metavar="NAME LOW HIGH",
    multiple=True,
)
@option(
    "--by",
    click.Choice(["trajectories", "features"]),
    "Compare signals sample by sample, for periodic motions and short records; or compare their features, in chaos.",
    default="trajectories",
)
@option("--starts", COUNT, "With trajectories: number of simultaneous searches.", default=16)
@option(
    "--window",
    COUNT,
    "With trajectories: forcing periods after which a motion begins again; default: never, "
    "or 1 on rails that do not recur.",
)
@option(
    "--confidence",
    click.FloatRange(0.0, 1.0, True, True),
    "Probability of the intervals.",
)
@option("--seed", FROM_ZERO, "Random seed of the first points.")
@begin
@result("fit")
@takes_case
@click.argument("scene", metavar="FILE", type=INPUT)
@click.argument("measured", metavar="RECORD...", type=INPUT, nargs=-1, required=True)
def fit(
    case: Case,
    measured: tuple[Path, ...],
    fit,
    fit_sensor,
    by: str,
    starts: int,
    window: int | None,
    out: Sequence[Path],
    **options,
) -> int:
    """Find parameters of the scene of FILE, and numbers of its sensors, from the signals of RECORDs.

    FILE: a TOML file with a table for each sensor, such as [sensors.front]. RECORD: a CSV or netCDF file of a run,
    with a column of times and a column for each sensor, such as "time [s], front [g]". One of these files may be -,
    standard input.
    """
    from ..fitting.fit import fit as find
    from ..fitting.likelihood import Features
    from ..fitting.trajectories import Trajectories
    from ..model.starts import AtRest

    sensors = case.file.sensors if case.file else []
    path = click.get_current_context().params["scene"]
    require(sensors, "FILE", "be a TOML file with tables [sensors.NAME]", shown=f"{path}, which has none")
    unknowns = bounds_of_each("--fit", case.scene, fit)
    unknowns |= {f"sensors.{name}": (low, high) for name, low, high in fit_sensor}
    require(unknowns, "--fit", "be given for one parameter or more", shown="missing")
    method = Features() if by == "features" else Trajectories(starts, window)
    # the method chooses a solver that the user did not choose
    solver = case.solver if given("solver") else None
    how = dict(start=case.start, steps_per_period=case.steps_per_period, solver=solver, progress=True)
    files = Outputs(out)
    found = on_thread(lambda: find(case.scene, list(measured), unknowns, sensors, method=method, **how, **options))
    start = REST if case.start is None and isinstance(found.problem.start, AtRest) else ""
    said(*found.summary(), case.text(list(PARAMETERS.keys() & unknowns.keys()), start), files.write(found))
    return LOST if found.status == "not converged" else 0
