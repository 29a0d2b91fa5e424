"""The picture that suits a sweep."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..model.quantities import POINT_DIMS, SECTIONS
from .maps import attractor_map, basin_map, bifurcations, exponents, parameters_of, quantity_map, regime_map
from .runs import PEAKS
from .trajectories import overview

PICTURES: tuple[tuple[set[str], int, Callable[..., Axes | np.ndarray]], ...] = (
    ({"contact_force", "time"}, 0, overview),
    ({"regime", "exponent"}, 2, regime_map),
    ({"regime", "exponent"}, 1, exponents),
    ({"kind", "period"}, 2, attractor_map),
    ({"basin", "share"}, 2, basin_map),
    (set(SECTIONS), 1, bifurcations),
)
"""What a sweep recorded, over how many parameters, and its picture; the first suitable entry counts."""


def of_sweep(ds: xr.Dataset, show: str | None = None, **options: object) -> Axes | np.ndarray:
    """Draw the picture that suits a sweep: bifurcation diagrams, exponents or a map.

    For a sweep of numbers the picture shows the net or peak force over one parameter or two, or else the first
    number. For `follow` each direction has its own colour.

    **Arguments:** `show`: the variable to draw in place of the default; `options`: as for the picture.

    **Raises:** `ValueError` where no picture suits.
    """
    parameters = parameters_of(ds)
    if show is not None:
        return quantity_map(ds, name=show, **options)
    for names, count, draw in PICTURES:
        if names <= {*ds.variables, *ds.dims} and count == len(parameters):
            return draw(ds, **options)
    numbers = [
        str(name)
        # whole numbers, such as the period, where there are no other numbers
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
