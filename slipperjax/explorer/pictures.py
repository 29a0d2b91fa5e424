"""Maps, diagrams and panels of a case, as plain arrays in display units that a page draws."""

from typing import Any, NamedTuple

import numpy as np

from ..analysis.kinds import lasting
from ..flow.status import Status
from ..model.parameters import PARAMETERS
from ..model.quantities import SECTIONS, Quantity
from ..orbits.branches import OrbitBranch
from ..plots.branches import EVENT_NAMES, joined, stable_parts, start_of
from ..plots.maps import DIRECTION_COLORS, motions_of, regimes_of
from ..plots.runs import edges_of
from ..plots.sections import Frames, label_places, outline, rail_outline
from ..plots.style import COLORS, FLAGGED_LABEL, MOTION_COLORS, REGIME_COLORS, flagged, highest, quantity_of
from .session import SURE, View


def label(q: Quantity) -> str:
    """Return the label of an axis in plain words, with the display unit."""
    text = f"{q.name.replace('_', ' ')} {q.symbol}".strip() if q.name in PARAMETERS else q.long_name.split(",")[0]
    return text if q.display_unit == "1" else f"{text} [{q.display_unit}]"


def choices(view: View) -> list[str]:
    """Return the choices of the left side: kinds of motions, sections, and numbers of each case."""
    ds = view.ds
    plane = len(view.names) == 2
    if ds is None:
        return ["motion", "peak_force"] if plane else list(SECTIONS)
    over = {"distance"} if view.is_run else set(ds["status"].dims)
    kinds = [name for name, of in (("motion", "kind"), ("regime", "regime")) if of in ds]
    found = kinds if plane else [name for name in SECTIONS if name in ds]
    if view.grid is not None and plane:  # it can be computed
        found.append("peak_force")
    # numbers with a value for each case, or for each of its points
    for name, values in ds.data_vars.items():
        of_cases = over <= set(values.dims) <= over | {"end", "point", "count"}
        if of_cases and values.dtype.kind in "fiu" and name not in ("status", "period"):
            found.append(str(name))
    return list(dict.fromkeys(found))


class Picture(NamedTuple):
    """Values of each case over the dimensions of a view, for colours."""

    values: np.ndarray
    """Indices of `names`, or numbers in the display unit; NaN for what is not there."""
    names: list[str]
    """Kinds that occur; empty for numbers."""
    colors: list[str]
    label: str


def picture_of(view: View, choice: str) -> Picture:
    """Return the colours of a map."""
    assert view.ds is not None
    ds = view.ds
    dims = tuple(view.names) if ds["status"].ndim == 2 else ("case",)
    bad = flagged(ds, *dims)
    if choice not in ("motion", "regime"):
        numbers = np.where(bad, np.nan, highest(ds, choice, *dims))
        return Picture(numbers, [], [], label(quantity_of(choice, ds)))
    words = motions_of(ds, *dims) if choice == "motion" else regimes_of(ds, *dims)
    words = np.where(bad, FLAGGED_LABEL, words)
    words = np.where(ds["status"].transpose(*dims) == Status.NOT_RUN, "", words)
    colors = {name: color for name, color in (MOTION_COLORS | REGIME_COLORS).items() if name in words}
    # the index of each case among the kinds that occur
    index = np.select([words == name for name in colors], [float(k) for k in range(len(colors))], np.nan)
    names = [lasting(name, ds.get("least_mean_life", np.nan)) for name in colors]
    if "motion" in view.record and ds.attrs["measured"] < SURE and "unresolved" in colors:
        names[names.index("unresolved")] = f"no period within {ds.attrs['periods']} forcing periods"
    return Picture(index, names, list(colors.values()), choice)


def cells(axis: np.ndarray) -> np.ndarray:
    """Return borders of cells around values, half-way between them."""
    if len(axis) == 1:
        return axis[0] + np.array([-0.5, 0.5]) * (abs(axis[0]) or 1.0)
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def image(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    """Return an image of even pixels, of values over two axes that rise or fall, in steps that may differ."""
    index, begins, widths = [], [], []
    # the value under the middle of each pixel
    for axis in (y, x):
        order = np.argsort(axis)
        border = cells(axis[order])
        width = border[-1] - border[0]
        count = max(400, len(axis))
        middles = border[0] + (np.arange(count) + 0.5) * width / count
        index.append(order[np.searchsorted(border[1:-1], middles)])
        begins.append([border[0]])
        widths.append([width])
    pixels = values[np.ix_(*index)].astype("float32")
    return {"image": [pixels], "x": begins[1], "y": begins[0], "dw": widths[1], "dh": widths[0]}


def ways(view: View) -> dict[str, str]:
    """Return colours of the ways of `follow`; none for other datasets."""
    there = () if view.ds is None or "direction" not in view.ds.dims else view.ds["direction"].values
    return {way: color for way, color in DIRECTION_COLORS.items() if way in there}


def dots(view: View, choice: str) -> dict[str, np.ndarray]:
    """Return dots over one parameter: those of a section, or one number of each case; each way in its colour."""
    assert view.ds is not None
    (name,) = view.names
    q = quantity_of(choice, view.ds)
    at = view.quantity(name).shown(view.ds[name].values)
    parts = [(view.ds.sel(direction=way), color) for way, color in ways(view).items()]
    x, y, colors = [], [], []
    # each way of `follow`, or all
    for ds, color in parts or [(view.ds, COLORS["blue"])]:
        rows = ds[choice].transpose(name, ...).values.astype(float).reshape(len(at), -1)
        if choice not in SECTIONS:
            rows = np.nanmax(rows, axis=1, keepdims=True)
        # a dot for each number there is
        case, crossing = np.nonzero(np.isfinite(rows) & ~flagged(ds, name)[:, None])
        x.append(at[case])
        y.append(q.shown(rows[case, crossing]))
        colors.append(np.full(len(case), color))
    return {"x": np.concatenate(x), "y": np.concatenate(y), "color": np.concatenate(colors)}


def along(view: View, choice: str) -> dict[str, np.ndarray]:
    """Return a number of each window of a run, the highest of all points, over distance [m]."""
    assert view.ds is not None
    y = highest(view.ds, choice, "distance")
    return {"x": edges_of(view.ds, "distance"), "y": np.append(y[:1], y)}


def slipper_columns(drawn: Frames, unit: float) -> dict[str, np.ndarray]:
    """Return corners, points, ends of arrows [mm] and forces [kN] of both ends, by column (instants, numbers).

    **Arguments:** `unit`: of the column `x`, which is the time.
    """
    columns = {"x": drawn.period * unit}
    for k, end in enumerate(("front", "rear")):
        points = 1e3 * drawn.points[:, k]
        arrows = 1e3 * drawn.newton * drawn.force[:, k, :, None] * np.asarray(drawn.shape.normals)
        places = {"corner": outline(drawn.shape, drawn.points[:, k]), "point": points, "tip": points + arrows}
        # one column for each axis, contiguous for the browser
        for name, place in places.items():
            columns[f"{end}_{name}_y"] = np.ascontiguousarray(place[..., 0])
            columns[f"{end}_{name}_z"] = np.ascontiguousarray(place[..., 1])
        columns[f"{end}_force"] = drawn.force[:, k] / 1e3
    return columns


def rail_places(drawn: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Return the rail head's corners and the places of the points' labels [mm], y and z in columns."""
    return rail_outline(drawn.shape), label_places(drawn.shape)


def branch_data(branch: OrbitBranch, coordinate: str) -> dict[str, dict[str, Any]]:
    """Return the state of a branch's orbits at the start of a forcing period: its parts, and its events by name."""
    ds, varied = branch.points, branch.parameter
    x = varied.shown(ds[varied.name].values)
    y = start_of(ds, coordinate)
    data = {}
    stable = stable_parts(ds)
    # lines with gaps where the other kind is
    for name, parts in (("stable", stable), ("unstable", ~stable)):
        line = joined(x, y[None], parts)
        data[name] = {"x": line[0], "y": line[1]}
    events = [event for event in branch.events if event.label in EVENT_NAMES]
    data["events"] = {
        "x": [float(varied.shown(event.value)) for event in events],
        "y": [float(y[event.point]) for event in events],
        "label": ["" if event.label == "GR" else event.label for event in events],  # grazings crowd
        "name": [EVENT_NAMES[event.label] for event in events],
    }
    return data
