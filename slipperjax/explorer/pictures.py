"""Maps, diagrams and the slipper of a case, as plain arrays in display units that a page draws."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from ..flow.status import Status
from ..model.parameters import PARAMETERS
from ..model.quantities import POINT_DIMS, SECTIONS, Quantity
from ..plots.maps import categories, dots_of, motions_of, regimes_of
from ..plots.runs import edges_of
from ..plots.sections import Frames, outline
from ..plots.style import flagged, highest, lost, quantity_of
from .session import View


def label(q: Quantity) -> str:
    """Return the label of an axis in plain words, with the display unit."""
    text = q.name.replace("_", " ") if q.name in PARAMETERS else q.long_name.split(",")[0]
    return text if q.display_unit == "1" else f"{text} [{q.display_unit}]"


def choices(view: View) -> list[str]:
    """Return the possible contents of the left side for a view: kinds of motions, sections, numbers of cases."""
    ds = view.ds
    plane = len(view.names) == 2
    found = []
    if not ds:
        return ["motion"] if plane else list(SECTIONS)
    if plane:
        words = {"motion": "kind", "regime": "regime"}
        found = [name for name, of in words.items() if of in ds]
    elif not view.is_run:
        found = [name for name in SECTIONS if name in ds]
    over = {"distance"} if view.is_run else set(ds["status"].dims)
    # numbers with a value for each case, or for each of its points
    for name, values in ds.data_vars.items():
        of_cases = over <= set(values.dims) <= {*over, *POINT_DIMS, "count"}
        if of_cases and values.dtype.kind in "fiu" and name not in ("status", "period"):
            found.append(str(name))
    return found


class Picture(NamedTuple):
    """Values of a map, one for each case, with their colours."""

    values: np.ndarray
    """Indices of `colors`, or numbers in the display unit; NaN where there is none."""
    colors: dict[str, str]
    """Colours by name of the kinds that occur; empty for numbers."""
    label: str


def picture_of(view: View, choice: str) -> Picture:
    """Return the values and colours of a map."""
    ds = view.ds
    dims = view.names
    if choice not in ("motion", "regime"):
        numbers = np.where(flagged(ds, *dims), np.nan, highest(ds, choice, *dims))
        return Picture(numbers, {}, label(quantity_of(choice, ds)))
    words = (motions_of if choice == "motion" else regimes_of)(ds, *dims)
    # missing cases have no colour
    words = np.where(ds["status"].transpose(*dims) == Status.NOT_RUN, "", words)
    return Picture(*categories(ds, words), choice)


def image(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> dict[str, list[float | np.ndarray]]:
    """Return a glyph of Bokeh: pixels of equal size, each with the value of the nearest case on the two axes."""
    places = {}
    ends = {}
    # pixels reach half a step beyond both ends of an axis, or a half around its one value
    for name, axis in (("y", y), ("x", x)):
        half = np.ptp(axis) / (2 * len(axis) - 2) if len(axis) > 1 else 0.5
        edges = np.linspace(axis.min() - half, axis.max() + half, max(400, len(axis)) + 1)
        places[name] = (edges[1:] + edges[:-1]) / 2
        ends[name] = edges[[0, -1]]
    cells = xr.DataArray(values.astype("float32"), {"y": y, "x": x}).sortby(["y", "x"])
    pixels = cells.sel(places, method="nearest").values
    return {
        "image": [pixels],
        "x": ends["x"][:1],
        "y": ends["y"][:1],
        "dw": np.diff(ends["x"]),
        "dh": np.diff(ends["y"]),
    }


def dots(view: View, choice: str) -> dict[str, np.ndarray]:
    """Return dots over one parameter: the points of a section, or the highest number of each case."""
    ds = view.ds
    # the highest of all points
    if choice not in SECTIONS:
        ds = ds.assign({choice: ds[choice].max([d for d in ds[choice].dims if d not in ds["status"].dims])})
    return dict(zip("xy", dots_of(ds, choice, *view.names), strict=True))


def along(view: View, choice: str) -> dict[str, np.ndarray]:
    """Return a number of each window of a run, the highest of all points, over distance [m]."""
    # steps need a value at both ends of each window
    y = highest(view.ds, choice, "distance")
    # numbers of a lost run mean nothing
    if lost(view.ds):
        y = np.nan * y
    return {"x": edges_of(view.ds, "distance"), "y": np.append(y[:1], y)}


def slipper_columns(drawn: Frames, unit: float) -> dict[str, np.ndarray]:
    """Return by column (instants, values) corners, points, tips of arrows [mm] and forces [kN] of both ends.

    **Arguments:** `unit`: unit of the column `x`, which is the time.
    """
    columns = {"x": drawn.period * unit}
    corners = outline(drawn.shape, drawn.points)
    points = 1e3 * drawn.points
    for k, end in enumerate(("front", "rear")):
        columns[f"{end}_force"] = drawn.force[:, k] / 1e3
        # one column for each axis, contiguous for the browser
        for name, places in (("corner", corners), ("point", points), ("tip", points + drawn.arrows)):
            for axis, values in zip("yz", np.moveaxis(places[:, k], -1, 0), strict=True):
                columns[f"{end}_{name}_{axis}"] = np.ascontiguousarray(values)
    return columns
