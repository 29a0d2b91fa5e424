"""Maps over two parameters: what motions settle to, and the curves of events between them.

A map of what one start settles to shows basins of attraction as much as stability, because motions coexist. So each
case of a map is run twice: from Table 2's start, and from beside its orbit of period 1, which tests its stability
alone. The prediction that both are compared with comes from the curves of folds, flips and Neimark-Sackers only.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from ...analysis.regions import beside, holding
from ...flow.recorders import coordinates
from ...model.dang2024 import paper_scene
from ...model.kinematics import MOTION_SCALES
from ...model.quantities import COORDINATE_SCALES
from ...orbits.branch_data import BranchEvent
from ...orbits.branches import OrbitBranch, continue_orbit
from ...orbits.critical import continue_event
from ...orbits.periodic import PeriodicOrbit, periodic_orbit
from ...sweeps.attractors import attractors, strobe_states
from ...sweeps.maps import states_of
from ...sweeps.spread import spread_orbits, sweep_from
from ...sweeps.sweep import sweep
from .branches import STEPS, stable_part

AREA = {"speed": (800.0, 2300.0), "clearance": (0.3e-3, 4.8e-3), "length": (0.155, 0.5)}
"""Values that the maps span [SI unit of the parameter]."""
PLANES = {"speed-clearance": ("speed", "clearance"), "speed-length": ("speed", "length")}
"""Parameters of each map; all others are those of the nominal case."""
LINES = {"speed-clearance": (), "speed-length": (0.217, 0.35)}
"""Values of the second parameter [SI unit] at which the same orbits are followed over the first one, too: their
stability ends there at curves that do not pass the nominal case."""
BIFURCATIONS = ("LP", "PD", "NS")
"""Events whose curves separate stable orbits from unstable ones."""
SIMULATED = 100
"""Steps per forcing period of simulations and of the orbits that they begin beside."""
ASIDE = 1e-2
"""How far beside an orbit a run begins, in each coordinate: 10 um, 0.1 mrad, 1 cm/s and 0.1 rad/s."""
LEAP = 3.0
"""The `leap` of `spread_orbits`: towards a fold orbits change fast, at 1 mm by 2.3 more from 2150 to 2200 m/s than
two neighbours lead to."""
SAME = 0.1
"""Distance from an orbit up to which a motion of its period is on it, in multiples of `COORDINATE_SCALES`."""
ON_CURVE = 2e-3
"""Distance of an event from a curve of its kind up to which it is of that curve, in shares of `AREA`."""


class MapEffort(NamedTuple):
    """How fine a map is."""

    first: int
    """Values of the first parameter, and of the second."""
    second: int
    transient: int
    """Forcing periods before motions are judged, and those from which they are."""
    judged: int
    points: int
    """Most points of a curve, each way."""
    doubled: bool
    """Whether the flips of the orbits of period 2 are followed, too."""


FINE = MapEffort(first=31, second=24, transient=400, judged=200, points=150, doubled=True)
COARSE = MapEffort(first=16, second=12, transient=400, judged=200, points=80, doubled=False)


class Followed(NamedTuple):
    """Curves of a plane, and what is known of the stable orbits on lines through it."""

    curves: list[xr.Dataset]
    known: np.ndarray
    """Places with a stable orbit of period 1 of the nominal family, (places, 2) [SI units]."""


def axes_of(plane: str, effort: MapEffort) -> dict[str, np.ndarray]:
    """The values of a map by parameter [SI units]."""
    return {n: np.linspace(*AREA[n], k) for n, k in zip(PLANES[plane], (effort.first, effort.second), strict=True)}


# --- curves ---------------------------------------------------------------------------------------------------------


def follow_plane(plane: str, effort: MapEffort, data: dict[str, xr.Dataset], options: Mapping[str, Any]) -> Followed:
    """The curves of the events at which the nominal orbits of period 1 lose stability, the flip of those of period 2,
    and the grazing next to the stable orbits.

    Branches over both parameters through the nominal case are followed first. Where a branch folds over itself,
    orbits of other sheets are stable in the same places; their curves would divide the plane where nothing happens to
    these, and are left out. Datasets are added to `data` as soon as each is finished.
    """
    how = dict(progress=bool(options.get("progress", False)))
    curves: list[xr.Dataset] = []
    known = []
    first, second = PLANES[plane]

    def line(name: str, other: str, start: PeriodicOrbit | None = None) -> OrbitBranch:
        """A branch over one parameter, with the curves between stable and unstable orbits of its nominal sheet."""
        scene = paper_scene() if start is None else start.scene
        branch = continue_orbit(scene, name, AREA[name], start=start, steps_per_period=STEPS, **how)
        at = float(scene.value(other))
        data[f"{plane}_{name}" + ("" if start is None else f"_at_{at:g}")] = branch.points
        part = stable_part(branch, name, float(scene.value(name)))
        if part is None:
            return branch
        low, high = sheet(branch, part.points)
        values = branch.points[name].values[part.points]
        pairs = {name: values, other: np.full(len(values), at)}
        known.append(np.stack([pairs[n] for n in PLANES[plane]], axis=1))
        for event in edges(branch):
            if low <= event.point <= high:
                _add(curves, branch, event, other, effort, data, plane, how)
        if start is None and name == first:
            grazings = sorted(branch.events_named("GR"), key=lambda event: np.abs(part.points - event.point).min())
            for event in grazings[:1]:
                _add(curves, branch, event, other, effort, data, plane, how)
            if effort.doubled and part.low.event in branch.events_named("PD"):
                twice = branch.switched(part.low.event, bounds=AREA[name], **how)
                data[f"{plane}_period_2"] = twice.points
                for event in edges(twice):
                    _add(curves, twice, event, other, effort, data, plane, how)
        return branch

    line(first, second)
    across = line(second, first)
    for at in LINES[plane]:
        line(first, second, across.orbit(int(np.argmin(np.abs(across.points[second].values - at)))))
    return Followed(curves, np.concatenate(known))


def sheet(branch: OrbitBranch, points: np.ndarray) -> tuple[int, int]:
    """The numbers of the folds before and behind some points of a branch, or of its ends."""
    folds = np.flatnonzero(branch.points["label"].values.astype(str) == "LP")
    before, behind = folds[folds <= points.min()], folds[folds >= points.max()]
    return int(max(before, default=0)), int(min(behind, default=branch.points.sizes["point"] - 1))


def edges(branch: OrbitBranch) -> Iterator[BranchEvent]:
    """The folds, flips and Neimark-Sackers at which all multipliers but the critical ones lie inside the circle."""
    outside = branch.points["outside"].values
    return (event for event in branch.events if event.label in BIFURCATIONS and outside[event.point] == 0)


def _add(
    curves: list[xr.Dataset],
    branch: OrbitBranch,
    event: BranchEvent,
    other: str,
    effort: MapEffort,
    data: dict[str, xr.Dataset],
    plane: str,
    how: dict[str, Any],
) -> None:
    """The curve through an event, if it is none of those that are found already."""
    place = {branch.parameter.name: event.value, other: float(branch.scene.value(other))}
    for one in curves:
        alike = one.attrs["label"] == event.label and one.attrs["orbit_period"] == branch.period
        if alike and distance(points_of(one, plane), [place[n] for n in PLANES[plane]], plane) < ON_CURVE:
            return
    begin = time.perf_counter()
    curve = continue_event(branch, event, other, AREA[other], points=effort.points, **how).points
    curve.attrs["seconds"] = time.perf_counter() - begin
    data[f"{plane}_curve_{len(curves) + 1}"] = curve
    curves.append(curve)


def points_of(curve: xr.Dataset, plane: str) -> np.ndarray:
    """A curve as (points, 2) in the order of the plane's parameters [SI units]."""
    return np.stack([curve[name].values for name in PLANES[plane]], axis=1)


def distance(points: np.ndarray, place: Any, plane: str) -> float:
    """The least distance of a place from a curve, in shares of the map's sides."""
    reach = np.array([np.ptp(AREA[name]) for name in PLANES[plane]])
    scaled, at = points / reach, np.asarray(place) / reach
    a, chord = scaled[:-1], np.diff(scaled, axis=0)
    length = np.maximum(np.sum(chord**2, axis=1), 1e-300)
    share = np.clip(np.sum((at - a) * chord, axis=1) / length, 0, 1)
    return float(np.min(np.linalg.norm(a + share[:, None] * chord - at, axis=1)))


def barriers(curves: list[xr.Dataset], plane: str, axes: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """The parts of the curves of period 1 on which stability changes: all other multipliers lie inside the circle.

    A curve that stops less than a cell from the map's edge goes straight on to it.
    """
    found = []
    for curve in curves:
        if curve.attrs["label"] not in BIFURCATIONS or curve.attrs["orbit_period"] != 1:
            continue
        points, inside = points_of(curve, plane), curve["outside"].values == 0
        points, inside = (np.concatenate([a[:1], a, a[-1:]]) for a in (points, inside))
        points[0], points[-1] = (_to_edge(points[1:-1][::way], axes.values()) for way in (-1, 1))
        # up to the place, between two points, where another multiplier leaves the circle
        parts = inside[1:] | inside[:-1]
        pieces = [points[k : k + 2] for k in np.flatnonzero(parts)]
        found += [np.concatenate([np.concatenate([p, [[np.nan, np.nan]]]) for p in pieces])] if pieces else []
    return found


def _to_edge(points: np.ndarray, axes: Iterable[np.ndarray]) -> np.ndarray:
    """Where the end of a curve meets the map's edge, if it is less than a cell away; else the end itself."""
    end, way = points[-1], points[-1] - points[-2]
    steps = []
    for k, values in enumerate(axes):
        for edge in (values[0], values[-1]):
            step = (edge - end[k]) / way[k] if way[k] else -1.0
            steps += [step] if step > 0 and abs(edge - end[k]) < np.diff(values).max() else []
    return end + (1 + 1e-9) * min(steps, default=0.0) * way


# --- brute force ----------------------------------------------------------------------------------------------------


def run_plane(plane: str, effort: MapEffort, data: dict[str, xr.Dataset], options: Mapping[str, Any]) -> xr.Dataset:
    """What each case of a map settles to: `kind`, `period` and `on_orbit` from Table 2's start, and `beside_kind`,
    `beside_period` and `kept` from beside its orbit.

    `orbit`: whether there is an orbit of period 1 of the nominal family; where there is none, runs begin at that of a
    neighbour, and nowhere where `tested` is False.
    """
    grid, scene = axes_of(plane, effort), paper_scene()
    begin = time.perf_counter()
    orbit = periodic_orbit(scene, steps_per_period=SIMULATED)
    spread = spread_orbits(scene, grid, orbit, leap=LEAP)
    found = time.perf_counter()
    data[f"{plane}_orbits"] = spread
    common: dict[str, Any] = dict(transient=effort.transient, periods=effort.judged, steps_per_period=SIMULATED)
    plain = sweep(scene, grid, record="strobe", **common, **options)
    first = time.perf_counter()
    tested = np.isfinite(spread["state"].values).all(axis=-1)
    rows = spread["state"].values.reshape(tested.size, -1).copy()
    rows[~tested.ravel()] = rows[tested.ravel()][0]  # these are run for nothing
    near = sweep_from(scene, grid, states_of(pushed(rows), orbit.state), **common, **options)
    second = time.perf_counter()
    places = coordinates(states_of(rows, orbit.state)).reshape(*tested.shape, -1)
    ds = assembled(spread, plain, near, tested, places)
    seconds = {"orbits": found - begin, "one_start": first - found, "beside": second - first}
    ds.attrs |= plain.attrs | {f"seconds_{name}": value for name, value in seconds.items()}
    data[plane] = ds
    return ds


def pushed(rows: np.ndarray) -> np.ndarray:
    """States moved by `ASIDE`, with alternating signs."""
    scales = np.array(jax.tree.leaves(MOTION_SCALES))
    rows = rows.copy()
    rows[:, : len(scales)] += ASIDE * scales * np.where(np.arange(len(scales)) % 2, -1.0, 1.0)
    return rows


def assembled(
    spread: xr.Dataset, plain: xr.Dataset, near: xr.Dataset, tested: np.ndarray, states: np.ndarray
) -> xr.Dataset:
    """The dataset of `run_plane`; `states`: coordinates of the orbits, shape (first, second, 10)."""
    dims = plain["status"].dims
    there = spread["status"].values == 0
    ds = plain[["status", "steps_per_period"]].copy()
    ds["orbit"] = (dims, there, {"long_name": "whether there is an orbit of period 1 of the nominal family"})
    ds["tested"] = (dims, tested, {"long_name": "whether a run began beside that orbit, or a neighbour's"})
    for name, run in (("", plain), ("beside_", near)):
        judged = attractors(run, run.sizes["period"])
        away = np.max(np.abs(strobe_states(run)[..., -1, :] - states) / COORDINATE_SCALES, axis=-1)
        on = (judged.period == 1) & there & (away < SAME)
        ds[f"{name}kind"] = (dims, np.asarray(judged.kind).astype(str), {"long_name": "what the motion is"})
        ds[f"{name}period"] = (dims, judged.period, {"units": "1", "long_name": "forcing periods of the motion"})
        label = "kept" if name else "on_orbit"
        ds[label] = (dims, on, {"long_name": "whether the motion is on the orbit of period 1"})
    ds["beside_status"] = near["status"]
    return ds


# --- the prediction -------------------------------------------------------------------------------------------------


def predict(plane: str, followed: Followed, axes: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Where orbits of period 1 are stable, by the curves alone, and the cells beside these curves."""
    lines = barriers(followed.curves, plane, axes)
    reach = np.array([np.ptp(AREA[name]) for name in PLANES[plane]])
    x, y = (axes[name] / size for name, size in zip(PLANES[plane], reach, strict=True))
    scaled = [points / reach for points in lines]
    return holding(x, y, scaled, followed.known / reach), beside(x, y, scaled)


def map_plane(plane: str, effort: MapEffort, data: dict[str, xr.Dataset], options: Mapping[str, Any]) -> xr.Dataset:
    """A map with its prediction: as from `run_plane`, and `predicted` and `beside_curve`."""
    begin = time.perf_counter()
    followed = follow_plane(plane, effort, data, options)
    seconds = time.perf_counter() - begin
    ds = run_plane(plane, effort, data, options)
    predicted, band = predict(plane, followed, axes_of(plane, effort))
    dims = PLANES[plane]
    ds["predicted"] = (dims, predicted, {"long_name": "whether the curves enclose stable orbits of period 1"})
    ds["beside_curve"] = (dims, band, {"long_name": "whether a curve passes between this case and a neighbour"})
    ds.attrs["seconds_curves"] = seconds
    return ds
