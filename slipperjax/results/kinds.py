"""The kinds of results, by the functions that make them: texts, tables and pictures of each."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd
import xarray as xr

from ..flow.datasets import function_of
from ..plots.branches import branches, plane
from ..plots.comparisons import comparison
from ..plots.designs import design_overview
from ..plots.environment import vibration
from ..plots.fits import fit_overview
from ..plots.loads import greatest_loads
from ..plots.maps import of_basins
from ..plots.runs import run_overview
from ..plots.style import Units
from ..plots.sweeps import of_sweep
from ..plots.telemetry import record_over_model
from ..plots.trajectories import overview
from ..tools.checks import require
from . import basins, cases, comparisons, environments, loads, motions, runs, searches, telemetry

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Kind(NamedTuple):
    """Functions that make texts, tables and pictures of the datasets of one kind of results."""

    summary: Callable[[xr.Dataset, Units], list[str]]
    tables: Callable[[xr.Dataset, Units], dict[str, pd.DataFrame]]
    """The main table is the first."""
    plot: Callable[..., Any]
    """Returns Axes, all of one figure."""
    title: str = ""
    """Title of a PDF with a text and pictures; empty where a PDF has the picture alone."""
    report: Callable[[xr.Dataset, Units], list[str]] | None = None
    """Text of the PDF; None for the summary."""
    pages: "Callable[[xr.Dataset], Iterable[Figure]] | None" = None
    """Pictures of the PDF; None for the one picture."""


SWEEP = Kind(cases.summary, cases.tables, of_sweep)
SEVERAL_RUNS = Kind(cases.summary_of_runs, cases.tables_of_runs, of_sweep)
BRANCH = Kind(motions.branch_summary, motions.branch_tables, branches)
KINDS: dict[str, Kind] = {
    "simulate": Kind(motions.summary, motions.tables, overview),
    "periodic_orbit": Kind(motions.orbit_summary, motions.orbit_tables, overview),
    "continue_orbit": BRANCH,
    "continue_event": Kind(motions.curve_summary, motions.points_tables, plane),
    "continue_motion": BRANCH._replace(plot=partial(branches, quantity="state_0")),
    "sweep": SWEEP,
    "follow": SWEEP,
    "basins": Kind(basins.summary, basins.tables, of_basins),
    "run": Kind(runs.summary, runs.tables, run_overview, "Run over a rail", runs.report),
    "compare": Kind(comparisons.summary, comparisons.tables, comparison, "Designs compared"),
    "environment": Kind(
        environments.summary,
        environments.tables,
        vibration,
        "Vibration environment",
        environments.report,
        pages=lambda ds: (vibration(ds, place)[0, 0].figure for place in range(ds.sizes["place"])),
    ),
    "telemetry": Kind(
        telemetry.summary, telemetry.tables, record_over_model, "Record over the model", telemetry.report
    ),
    "loads": Kind(loads.summary, loads.tables, greatest_loads, "Loads", loads.report),
    "optimise_design": Kind(searches.design_summary, searches.design_tables, design_overview),
    "fit": Kind(searches.fit_summary, searches.fit_tables, fit_overview),
}


def kind_of(ds: xr.Dataset) -> Kind:
    """Return the kind of a result.

    **Raises:** `ValueError` for a dataset that no function of slipperjax made.
    """
    function = function_of(ds)
    need = f"be of one of {', '.join(KINDS)}, or of a kind whose module is imported before"
    require(function in KINDS, "result", need, function)
    return SEVERAL_RUNS if function == "run" and ds["status"].ndim else KINDS[function]
