"""Maps, diagrams and the panels of a case, as plain arrays in display units that a page draws."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ..analysis.kinds import lasting
from ..analysis.spectra import power_spectral_density
from ..flow.status import Status
from ..model.parameters import PARAMETERS, quantity
from ..model.quantities import COORDINATES, SECTIONS, Quantity
from ..orbits.branches import OrbitBranch
from ..plots.branches import EVENT_NAMES, joined, stable_parts
from ..plots.maps import DIRECTION_COLORS, motions_of, regimes_of
from ..plots.runs import edges_of
from ..plots.sections import colors_of, frames_of, label_places, outline, rail_outline
from ..plots.style import COLORS, FLAGGED_LABEL, REGIME_COLORS, flagged
from ..plots.trajectories import most_loaded
from .session import SURE, Session, Shown, View

MOTIONS = {
    "period 1": "#d0fcff",
    "period 2": "#79a7f8",
    "period 3": "#ffea81",
    "period 4": "#4055c8",
    "other periods": "#001951",
    "quasi-periodic": "#009b68",
    "regular": "#aff1b5",
    "chaotic": "#af2b19",
    "transient chaos": "#ff7d20",
    "unresolved": "#aca0bf",
    FLAGGED_LABEL: "#453131",
}
"""Colours of motions, which nobody confuses: each two differ by 25 in CIELAB or more, also without red or green."""
REGIMES = {name: MOTIONS.get(name, MOTIONS["period 2"]) for name in REGIME_COLORS} | {FLAGGED_LABEL: "#453131"}
"""Colours of regimes."""
MOST_PIXELS = 400
"""Columns and rows to which maps with uneven axes are drawn."""
LAST = 4
"""Forcing periods at the end of a case that are drawn over time."""
MOST_FRAMES = 640
"""Instants at which the slipper of a run is drawn."""
MOST_FORCES = 6
"""Points whose forces are drawn."""


def unit_of(name: str, view: View) -> Quantity:
    """The quantity of a variable or coordinate of a view, with its display unit."""
    if name in view.names:
        return view.quantity(name)
    try:
        return quantity(name)
    except KeyError:
        attrs = {} if view.ds is None else view.ds[name].attrs
        return Quantity(name, attrs.get("units", "1"), name.replace("_", " "))


def label(q: Quantity) -> str:
    """The label of an axis in plain words, with the display unit."""
    text = f"{q.name.replace('_', ' ')} {q.symbol}".strip() if q.name in PARAMETERS else q.long_name.split(",")[0]
    return text if q.display_unit == "1" else f"{text} [{q.display_unit}]"


def choices(view: View) -> list[str]:
    """The choices of the left side: kinds of motions, sections, and numbers of each case, the usual ones first."""
    ds, plane = view.ds, len(view.names) == 2
    if ds is None:
        return ["motion", "peak_force"] if plane else list(SECTIONS)
    over, inner = {"distance"} if view.is_run else set(ds["status"].dims), {"end", "point", "count"}
    numbers = [
        str(n)
        for n, v in ds.data_vars.items()
        if v.dtype.kind in "fiu" and over <= set(v.dims) <= over | inner and n not in ("status", "period")
    ]
    kinds = [name for name, of in (("motion", "kind"), ("regime", "regime")) if of in ds]
    first = kinds if plane else [name for name in SECTIONS if name in ds]
    wanted = ["peak_force"] if view.grid is not None and plane else []
    return list(dict.fromkeys([*first, *wanted, *numbers]))


class Picture(NamedTuple):
    """The left side."""

    values: np.ndarray
    """Indices of `names`, or numbers in the display unit; NaN for what is not there."""
    names: list[str]
    """Kinds that occur; empty for numbers."""
    colors: list[str]
    label: str


def picture_of(view: View, choice: str) -> Picture:
    """Values of each case over the dimensions of a view, for colours."""
    assert view.ds is not None
    ds, dims = view.ds, tuple(map(str, view.ds["status"].dims))
    dims = tuple(view.names) if len(dims) == 2 else dims
    missing = ds["status"].transpose(*dims).values == Status.NOT_RUN
    bad = flagged(ds, *dims) & ~missing
    if choice not in ("motion", "regime"):
        q, numbers = unit_of(choice, view), ds[choice]
        most = numbers.max([d for d in numbers.dims if d not in dims]).transpose(*dims).values
        return Picture(np.where(bad | missing, np.nan, q.shown(most.astype(float))), [], [], label(q))
    words = motions_of(ds, *dims) if choice == "motion" else regimes_of(ds, *dims)
    words, colors = np.where(bad, FLAGGED_LABEL, words), MOTIONS if choice == "motion" else REGIMES
    names = [name for name in colors if name in set(words[~missing])]
    index = np.select([words == name for name in names], [float(k) for k in range(len(names))], np.nan)
    short = "motion" in view.record and int(ds.attrs["periods"]) < SURE
    told = [
        f"no period within {ds.attrs['periods']} forcing periods"
        if short and n == "unresolved"
        else lasting(n, ds.get("least_mean_life", np.nan))
        for n in names
    ]
    return Picture(np.where(missing, np.nan, index), told, [colors[n] for n in names], choice)


def cells(axis: np.ndarray) -> np.ndarray:
    """Borders of cells around values, half-way between them."""
    if len(axis) == 1:
        return axis[0] + np.array([-0.5, 0.5]) * (abs(axis[0]) or 1.0)
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def image(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    """An image of values over two axes that rise or fall, of even pixels."""
    pixels = []
    for axis in (x, y):
        order = np.argsort(axis)
        border, step = cells(axis[order]), np.diff(axis)
        even = len(axis) < 3 or np.ptp(step) < 1e-6 * abs(step[0])
        count = len(axis) if even else MOST_PIXELS
        middle = border[0] + (np.arange(count) + 0.5) * (border[-1] - border[0]) / count
        pixels.append((order[np.searchsorted(border[1:-1], middle)], border[0], border[-1] - border[0]))
    (i, left, width), (j, bottom, height) = pixels
    return {
        "image": [values[np.ix_(j, i)].astype("float32")],
        "x": [left],
        "y": [bottom],
        "dw": [width],
        "dh": [height],
    }


def ways(view: View) -> dict[str, str]:
    """Colours of the ways of `follow`; none for other datasets."""
    there = () if view.ds is None or "direction" not in view.ds.dims else view.ds["direction"].values
    return {way: color for way, color in DIRECTION_COLORS.items() if way in there}


def dots(view: View, choice: str) -> dict[str, np.ndarray]:
    """Dots over one parameter: those of a section, or one number of each case; those of each way in its colour."""
    assert view.ds is not None
    parts = [(view.ds.sel(direction=way), color) for way, color in ways(view).items()]
    columns = [_dots(ds, view, choice, color) for ds, color in parts or [(view.ds, COLORS["blue"])]]
    return {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}


def _dots(ds: xr.Dataset, view: View, choice: str, color: str) -> dict[str, np.ndarray]:
    (name,) = view.names
    x = view.quantity(name).shown(ds[name].values)
    rows = ds[choice].transpose(name, ...).values.astype(float).reshape(len(x), -1)
    if choice not in SECTIONS:
        rows = np.nanmax(rows, axis=1, keepdims=True)
    case, crossing = np.nonzero(np.isfinite(rows) & ~flagged(ds, name)[:, None])
    y = unit_of(choice, view).shown(rows[case, crossing])
    return {"x": x[case], "y": y, "color": np.full(len(case), color)}


def along(view: View, choice: str) -> dict[str, np.ndarray]:
    """A number of each window of a run, the highest of all points, in its display unit over distance [m]."""
    assert view.ds is not None
    numbers = view.ds[choice]
    y = numbers.max([d for d in numbers.dims if d != "distance"]).values
    return {"x": edges_of(view.ds, "distance"), "y": unit_of(choice, view).shown(np.append(y[:1], y))}


# --- panels of a case -----------------------------------------------------------------------------------------------


def over_time(shown: Shown, name: str) -> dict[str, np.ndarray]:
    """A coordinate over the last forcing periods, or the distance of a run [m]."""
    ds = _last(shown)
    return {"x": ds["period"].values * shown.unit, "y": quantity(name).shown(ds[name].values)}


def forces(shown: Shown) -> dict[str, list[Any]]:
    """Forces of the points with the highest ones [kN], a line each."""
    ds = _last(shown).drop_vars(["peak_force", "peak_period"], errors="ignore")
    lines = [line for line in most_loaded(ds, MOST_FORCES) if line.peak > 0]
    return {
        "xs": [ds["period"].values * shown.unit for _ in lines],
        "ys": [line.force for line in lines],
        "name": [line.name for line in lines],
        "color": [line.style["color"] for line in lines],
        "dash": ["solid" if line.style["ls"] == "-" else "dashed" for line in lines],
    }


def _last(shown: Shown, periods: int = LAST) -> xr.Dataset:
    """The last forcing periods; all of a run's."""
    period = shown.ds["period"].values
    return shown.ds.isel(time=(period >= period[-1] - periods - 1e-9) | (shown.case.window is not None))


def phase(shown: Shown, coordinate: str, velocity: str) -> dict[str, np.ndarray]:
    """The motion in the plane of a coordinate and its velocity, over its last forcing periods."""
    ds = _last(shown, 64)
    x, y = (quantity(name).shown(ds[name].values) for name in (coordinate, velocity))
    return {"x": x, "y": y}


def section(session: Session, coordinate: str, velocity: str) -> dict[str, np.ndarray]:
    """The states once per forcing period in the same plane."""
    return {name: quantity(q).shown(session.strobe(q)) for name, q in (("x", coordinate), ("y", velocity))}


def spectrum(shown: Shown, velocity: str, most: float = 8.0) -> dict[str, np.ndarray]:
    """The power spectral density of a velocity, over multiples of the forcing frequency up to `most`."""
    period = float(shown.run.scene.period)
    every = (shown.ds.sizes["time"] - 1) // round(float(np.ptp(shown.ds["period"].values)))
    found = power_spectral_density(shown.ds[velocity].values[:-1], every / period)
    at = found.frequency * period
    used = (at > 0) & (at <= most)
    return {"x": at[used], "y": np.maximum(found.density[used], 1e-30 + 1e-12 * np.max(found.density))}


class Slipper(NamedTuple):
    """The slipper around the rail head over two forcing periods or a run's, at the front and the rear [mm]."""

    rail: np.ndarray
    places: np.ndarray
    names: tuple[str, ...]
    colors: list[str]
    frames: dict[str, np.ndarray]
    """By column, (instants, numbers): corners, points and ends of arrows of both ends; and `x`, as that of forces."""
    magnify: float
    highest: float
    """Force of the longest arrow [kN]."""
    busiest: int
    """The instant with the highest force."""


def slipper(shown: Shown) -> Slipper | None:
    """The drawing of `slipperjax.plots.animate`; None where the motion is not finite."""
    ds = shown.ds if shown.case.window is None else shown.ds.thin(time=-(-shown.ds.sizes["time"] // MOST_FRAMES))
    try:
        drawn = frames_of(ds, shown.run.scene, last=2.0 if shown.case.window is None else None)
    except ValueError:
        return None
    shape, columns = drawn.shape, {"x": drawn.period * shown.unit}
    for k, end in enumerate(("front", "rear")):
        corners = outline(shape, drawn.points[:, k])
        points = 1e3 * drawn.points[:, k]
        tips = points + 1e3 * drawn.newton * drawn.force[:, k, :, None] * np.asarray(shape.normals)
        for name, places in (("corner", corners), ("point", points), ("tip", tips)):
            columns |= {f"{end}_{name}_{axis}": np.ascontiguousarray(places[..., j]) for j, axis in enumerate("yz")}
        columns[f"{end}_force"] = drawn.force[:, k] / 1e3
    places, colors = label_places(shape), colors_of(shape)
    highest, busiest = float(drawn.force.max()) / 1e3, int(np.argmax(drawn.force.max(axis=(1, 2))))
    rail = rail_outline(shape)
    return Slipper(rail, places, shape.names, colors, columns, drawn.magnify, highest, busiest)


def branch_lines(branch: OrbitBranch, coordinate: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The state of a branch's orbits at the start of a forcing period: its stable and its unstable parts."""
    ds, varied, q = branch.points, branch.parameter, COORDINATES[coordinate]
    x, stable = varied.shown(ds[varied.name].values), stable_parts(ds)
    y = q.shown(ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate).values)[None]
    return {"stable": joined(x, y, stable), "unstable": joined(x, y, ~stable)}


def branch_events(branch: OrbitBranch, coordinate: str) -> dict[str, list[Any]]:
    """Where a branch folds, flips, branches or grazes, with the names of these events."""
    ds, varied, q = branch.points, branch.parameter, COORDINATES[coordinate]
    strobe = q.shown(ds["strobe"].isel(strobe_period=0).sel(coordinate=coordinate).values)
    events = [event for event in branch.events if event.label in EVENT_NAMES]
    return {
        "x": [float(varied.shown(event.value)) for event in events],
        "y": [float(strobe[event.point]) for event in events],
        "label": [event.label * (event.label != "GR") for event in events],  # grazings crowd
        "name": [EVENT_NAMES[event.label] for event in events],
    }
