"""The picture that fits a result."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..model.quantities import POINT_DIMS, SECTIONS
from .branches import branches
from .comparisons import comparison
from .designs import design_overview
from .environment import vibration
from .fits import fit_overview
from .maps import attractor_map, basin_map, bifurcations, exponents, parameters_of, quantity_map, regime_map
from .runs import PEAKS, run_overview
from .style import as_dataset
from .trajectories import overview

PICTURES: tuple[tuple[set[str], int | None, Callable[..., Axes | np.ndarray]], ...] = (
    ({"distance", "seconds", "stretch"}, 0, run_overview),
    ({"density_envelope", "shock_response"}, None, vibration),
    ({"runs", "difference", "quantile"}, None, comparison),
    ({"trial_design"}, None, design_overview),
    ({"estimate", "prior_low"}, None, fit_overview),
    ({"event_point", "stable"}, None, branches),
    ({"contact_force", "time"}, 0, overview),
    ({"regime", "exponent"}, 2, regime_map),
    ({"regime", "exponent"}, 1, exponents),
    ({"kind", "period"}, 2, attractor_map),
    ({"basin", "share"}, 2, basin_map),
    (set(SECTIONS), 1, bifurcations),
)
"""Names that a result has, over how many parameters (None for any number), and its picture; the first that fits."""


def plot(result: object, **options: object) -> Axes | np.ndarray:
    """Draw the picture that fits a result.

    The page of a trajectory, a run, a design or a fit; a branch; the bifurcation diagrams, exponents or map of a
    sweep. Of a sweep of numbers it is the net or peak force over one parameter or two, or else the first number. Of
    `follow` each direction has its own colour.

    **Arguments:** `result`: a `Trajectory`, a branch, a design, or a dataset of slipperjax; `options`: as for the
    picture.

    **Returns:** what the picture returns: Axes, or an array of them.

    **Raises:** `ValueError` where none fits.
    """
    ds = as_dataset(result)
    if not isinstance(ds, xr.Dataset):
        raise ValueError(f"Argument `result` must be a result of slipperjax, but is {type(result).__name__}.")
    parameters = parameters_of(ds) if "status" in ds else ()
    count = len(parameters)
    # the first picture that fits the names and the number of parameters
    for names, needed, draw in PICTURES:
        if names <= {*ds.variables, *ds.dims} and needed in (None, count):
            return draw(ds, **options)
    numbers = [
        str(name)
        # whole numbers, such as the period, where there are no others
        for kind in "fi"
        for name, values in ds.data_vars.items()
        # maps draw the highest value of all points
        if set(parameters) == set(values.dims) - {*POINT_DIMS, "direction"} and values.dtype.kind == kind
        if name != "status"
    ]
    if numbers and len(parameters) in (1, 2):
        name = next((name for name in PEAKS if name in numbers), numbers[0])
        return quantity_map(ds, **({"name": name} | options))
    shown = ", ".join(parameters) or "no parameter"
    raise ValueError(
        f"Argument `result` must have a picture that fits, but is over {shown}, with {', '.join(map(str, ds))}: "
        "choose one case by .isel(...), or one of slipperjax.plots."
    )
