"""The command that chooses parameters by an objective."""

from collections.abc import Collection
from functools import partial
from typing import TYPE_CHECKING

import click
import numpy as np

from ..model.parameters import PARAMETERS, parameter
from ..tools.checks import require
from .files import Outputs, fitting, keeping
from .interrupts import on_thread
from .options import (
    COUNT,
    FROM_ZERO,
    LOST,
    Case,
    Measure,
    Target,
    app,
    bounds,
    given,
    make_bounds,
    option,
    result,
    takes_case,
)

if TYPE_CHECKING:
    import xarray

    from ..design.objectives import Objective
    from ..design.optimise import Design

TRIAL_PATIENCE = 20.0
"""Seconds that an interrupted command waits for the trial that is being judged."""
AROUND = {1: 11, 2: 5, 3: 3}
"""Designs along each variable in a grid around the best one, by the number of variables."""

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
"""Objectives with their display units: a copy, so that help need not wait for the import of design."""
OBJECTIVE = click.Choice(list(OBJECTIVE_UNITS))
SPEED = Measure(PARAMETERS["speed"])


@app.command()
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
    "Speeds that the design must serve: first and last [m/s], and their number; default: the scene's alone.",
    metavar="FIRST LAST COUNT",
)
@option(
    "--robust",
    click.Choice(["worst", "mean"]),
    "Minimise the objective at its worst speed, or its mean.",
    default="worst",
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
    "Number of starting designs: the scene's own, if within the bounds, then good ones far from each other.",
    default=5,
)
@option("--max-trials", COUNT, "Maximum number of designs tried from each start.", default=60)
@option("--transient", FROM_ZERO, "Forcing periods simulated before a periodic orbit is searched.", default=200)
@option("--seed", FROM_ZERO, "Random seed of the starting designs.", default=0)
@option("--check/--no-check", None, "Simulate a grid of designs around the best one.", default=True)
@option(
    "--margins/--no-margins",
    None,
    "Find the nearest folds, flips and grazings.",
    default=True,
)
@result("design")
@takes_case
def design(case: Case, minimise, vary, speeds, constraint, check, margins, out: Target, **options) -> int:
    """Find the parameters within bounds that minimise an objective over a range of speeds.

    All other parameters keep the values of the scene.
    """
    from ..design.objectives import OBJECTIVES
    from ..design.optimise import optimise_design

    variables: dict[str, tuple[float, float]] = {}
    # bounds of each variable in SI units
    for name, low, high in vary:
        require(name not in variables, "--vary", "name each parameter once", name)
        variables[name] = make_bounds("--vary", case.scene, name, low, high)[1]
    # one case alone, the scene, without speeds
    over = {} if speeds is None else {"speed": _speeds(*speeds, variables=variables)}
    limits: dict[Objective, tuple[float, ...]] = {}
    # limits of each objective in its display unit
    for name, *ends in constraint:
        objective = OBJECTIVES[name]
        require(objective not in limits, "--constraint", "name each objective once", name)
        limits[objective] = tuple(map(objective.quantity.from_shown, ends))
    options |= dict(over=over or None, constraints=limits, progress=True, **case.options)
    files = Outputs(out.path, ".nc", out.picture)
    of_case = case.text([*variables, *over])

    def keep(best: "Design") -> str:
        print(f"{report(best)}\n{of_case}")
        return files.write(best.to_xarray(), partial=True)

    call = lambda: optimise_design(case.scene, OBJECTIVES[minimise], variables, **options)
    # an interrupted search keeps its best design
    with keeping(keep):
        best = on_thread(call, TRIAL_PATIENCE)
    # before the checks, which take a while
    print(f"{report(best)}\n{of_case}", flush=True)
    # checks of a design that is not the best one would mislead
    done = best.status == "converged"
    around = on_thread(partial(_around, best), TRIAL_PATIENCE) if check and done else None
    events = on_thread(partial(_margins, best), TRIAL_PATIENCE) if margins and done else None
    print(files.write(best.to_xarray(events), partial(fitting, surroundings=around, margins=events)))
    return LOST if best.status == "no motion" else 0


def _around(best: "Design") -> "xarray.Dataset | None":
    """Return the objective on a grid of designs around the best one, by simulation alone; None where too many."""
    from ..design.checks import surroundings

    # the number of designs grows with the power of the variables
    points = AROUND.get(len(best.problem.bounds))
    if points is None:
        print("too many variables for a grid of designs around it")
        return None
    ds = surroundings(best, points=points, progress=True)
    lower = 100 * ds.attrs["lower"]
    print(f"{ds['total'].size} designs around it by simulation alone: the lowest is {lower:.2g} % lower", flush=True)
    return ds


def _margins(best: "Design") -> "xarray.Dataset | None":
    """Return and print how far parameters may change before an event; None where no orbit can be followed."""
    from ..design.checks import event_margins

    # only orbits have a period
    if not any(best.cases["period"].values > 0):
        print("no case is on an orbit that could be followed to events")
        return None
    try:
        ds = event_margins(best, progress=True)
    except ValueError as error:  # what was found stands
        print(f"nearest events were not found: {error}")
        return None
    print("nearest events:")
    columns = ds[["case", "parameter", "label", "value", "relative"]].to_dataframe()
    # a line for each case, parameter and way that it changes
    for case, name, event, value, relative in columns.itertuples(index=False):
        quantity = parameter(name, best.problem.scene)
        where = ", ".join(
            f"{over} {PARAMETERS[over].shown(values[case]):.5g} {PARAMETERS[over].display_unit}"
            for over, values in best.problem.cases.items()
        )
        change = f"{quantity.shown(value):.6g} {quantity.display_unit} ({100 * relative:+.3g} %)"
        print(f"  {where or 'the case'}: {quantity.name} {event or 'none up to'} {change}", flush=True)
    return ds


def _speeds(low: float, high: float, count: int, variables: Collection[str]) -> np.ndarray:
    """Return the speeds of --speeds [m/s]."""
    alone = not given("speed") and "speed" not in variables
    require(alone, "--speeds", "not be given with --speed or --vary speed", shown="given")
    # one speed alone has two equal ends
    good = 0 < low <= high < np.inf and (count > 1) == (low < high)
    need = "be the lowest and the highest speed, above zero, and their number"
    require(good, "--speeds", need, shown=f"{low:g} to {high:g} m/s and {count}")
    return np.linspace(low, high, count)


def report(best: "Design") -> str:
    """Return a design in words: what was found, its uncertainty, and a line for each case."""
    import pandas as pd

    from ..plots.style import shown

    if best.status == "no motion":
        return repr(best)
    q = best.problem.objective.quantity
    cases = best.cases
    lines = [repr(best)]
    # averages over chaotic motions have one, orbits none
    if best.stderr > 0:
        lines.append(f"standard error {q.shown(best.stderr):.2g} {q.display_unit}")
    if best.several:
        lines.append("starts ended at different designs that are about equally good: see start_end in the file")
    # a row for each case, a column for each quantity
    table = {}
    for name in best.problem.over:
        table[f"{name} [{PARAMETERS[name].display_unit}]"] = [f"{v:.6g}" for v in shown(cases, name)]
    pairs = q.shown(cases[["objective", "objective_stderr"]].to_array().values).T
    texts = [f"{value:.5g}" + (f" +- {error:.2g}" if error > 0 else "") for value, error in pairs]
    table[f"{q.name} [{q.display_unit}]"] = texts
    table["regime"] = cases["regime"].values
    lines.append(pd.DataFrame(table).to_string(index=False))
    return "\n".join(lines)
