"""The command that chooses parameters by an objective."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from ..model.parameters import PARAMETERS
from ..tools.checks import require
from .files import Outputs, keeping, said
from .interrupts import on_thread
from .options import (
    COUNT,
    FROM_ZERO,
    LOST,
    Case,
    Measure,
    app,
    bounds,
    bounds_of_each,
    given,
    option,
    result,
    takes_case,
)

if TYPE_CHECKING:
    from ..design.optimise import Design

TRIAL_PATIENCE = 20.0
"""Seconds that an interrupted command waits for the present trial."""
AROUND = {1: 11, 2: 5, 3: 3}
"""Designs along each variable in a grid around the best design, by the number of variables."""

OBJECTIVE_UNITS = {
    "peak_slipper_force": "kN",
    "peak_slipper_moment": "N m",
    "static_ratio": "1",
    "peak_force": "kN",
    **dict.fromkeys(("rms_a_y", "rms_a_z"), "m/s^2"),
    **dict.fromkeys(("rms_alpha_x", "rms_alpha_y", "rms_alpha_z"), "rad/s^2"),
    "impact_impulse": "N s",
    "contact_load": "kN",
    "contact_work": "J/m",
    "drive_force": "N",
    **dict.fromkeys(("excursion_y", "excursion_z"), "mm"),
    **dict.fromkeys(("excursion_roll", "excursion_pitch", "excursion_yaw"), "mrad"),
    "grazing_distance": "mm",
    "exponent": "1/period",
}
"""Objectives with their display units: a copy, so that help does not wait for the import of design."""
OBJECTIVE = click.Choice(list(OBJECTIVE_UNITS))
SPEED = Measure(PARAMETERS["speed"])


@app.command(of="design.optimise.optimise_design")
@option(
    "--minimise",
    OBJECTIVE,
    f"Objective to minimise: {', '.join(f'{name} [{unit}]' for name, unit in OBJECTIVE_UNITS.items())}.",
    metavar="NAME",
    required=True,
)
@bounds("--vary", "Design variable with its lower and upper bound; repeat for several.", multiple=True, required=True)
@option(
    "--speeds",
    (SPEED, SPEED, COUNT),
    "Speeds that the design must serve: first and last [m/s], and their number; default: only the scene's speed.",
    metavar="FIRST LAST COUNT",
)
@option(
    "--robust",
    click.Choice(["worst", "mean"]),
    "Minimise the objective at its worst speed, or its mean.",
)
@option(
    "--constraint",
    (OBJECTIVE, float, float),
    "Lowest and highest allowed value of an objective at every speed, in the units of --minimise; -inf or inf: no "
    "limit; repeat for several.",
    metavar="NAME LOW HIGH",
    multiple=True,
)
@option(
    "--starts",
    COUNT,
    "Number of starting designs: the scene's own, if within the bounds, then good designs far from each other.",
)
@option("--max-trials", COUNT, "Maximum number of designs tried from each start.")
@option(
    "--transient",
    FROM_ZERO,
    "Forcing periods simulated before a periodic orbit is searched.",
)
@option("--seed", FROM_ZERO, "Random seed of the starting designs.")
@option("--check/--no-check", None, "Simulate a grid of designs around the best design.", default=True)
@option(
    "--margins/--no-margins",
    None,
    "Find the nearest folds, flips and grazings.",
    default=True,
)
@result("design")
@takes_case
def design(case: Case, minimise, vary, speeds, constraint, check, margins, out: Sequence[Path], **options) -> int:
    """Find the parameters within bounds that minimise an objective over a range of speeds.

    All other parameters keep the values of the scene.
    """
    from ..design.objectives import OBJECTIVES
    from ..design.optimise import optimise_design

    variables = bounds_of_each("--vary", case.scene, vary)
    # without speeds there is one case, the scene
    over = {} if speeds is None else {"speed": _speeds(*speeds, variables=variables)}
    limits = {}
    # limits of each objective in its display unit
    for name, *ends in constraint:
        objective = OBJECTIVES[name]
        require(objective not in limits, "--constraint", "name each objective once", name)
        limits[objective] = tuple(map(objective.quantity.from_shown, ends))
    options |= dict(over=over or None, constraints=limits, progress=True, **case.options)
    files = Outputs(out)
    of_case = case.text([*variables, *over])

    def keep(best: "Design") -> str:
        said(*best.summary(), of_case)
        return files.keep(best)

    call = lambda: optimise_design(case.scene, OBJECTIVES[minimise], variables, **options)
    # an interrupted search keeps its best design
    with keeping(keep):
        best = on_thread(call, TRIAL_PATIENCE)
    # before the checks, which take some time
    said(*best.summary(), of_case)
    # checks of a design that is not the best would mislead
    if best.status == "converged":
        best = on_thread(partial(_checked, best, check, margins), TRIAL_PATIENCE)
    said(files.write(best))
    return LOST if best.status == "no motion" else 0


def _checked(best: "Design", check: bool, margins: bool) -> "Design":
    """Return a design with the requested checks; print their results."""
    from ..design.checks import event_margins, surroundings
    from ..results.searches import NEAREST

    # the number of designs grows with the power of the variables
    points = AROUND.get(len(best.design))
    if check and points is None:
        said("too many variables for a grid of designs around it")
    elif check:
        around = surroundings(best, points=points, progress=True)
        best = replace(best, around=around)
        improvement = 100 * around.attrs["improvement_found"]
        count = around["total"].size
        said(f"{count} designs around it by simulation alone: the lowest is {improvement:.2g} % lower")
    # only orbits have a period
    if margins and not any(best.cases["period"].values > 0):
        said("no case is on an orbit that could be followed to events")
    elif margins:
        try:
            best = replace(best, margins=event_margins(best, progress=True))
            words = best.summary()
            said(*words[words.index(NEAREST) :])
        except ValueError as error:  # the results so far are kept
            said(f"nearest events were not found: {error}")
    return best


def _speeds(low: float, high: float, count: int, variables: Collection[str]) -> np.ndarray:
    """Return the speeds of --speeds [m/s]."""
    alone = not given("speed") and "speed" not in variables
    require(alone, "--speeds", "not be given with --speed or --vary speed", shown="given")
    # a single speed has two equal ends
    good = 0 < low <= high < np.inf and (count > 1) == (low < high)
    need = "be the lowest and the highest speed, above zero, and their number"
    require(good, "--speeds", need, shown=f"{low:g} to {high:g} m/s and {count}")
    return np.linspace(low, high, count)
