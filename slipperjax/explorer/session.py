"""The state of a page without the page: maps and their history, the case looked at, and calls that compute them."""

import copy
import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from ..analysis.attractor import classify
from ..flow.datasets import dataset_of, load_base, load_call, load_scene, load_start, varied_names
from ..flow.simulate import Trajectory, simulate
from ..flow.status import Status
from ..model.dang2024 import paper_scene, table_2_start
from ..model.kinematics import euler_angles, quaternion_from_euler
from ..model.parameters import STARTS, parameter
from ..model.quantities import COORDINATE_SCALES, COORDINATES, Quantity
from ..model.scene import Scene, check_steady
from ..model.step_size import default_steps_per_period
from ..orbits.branches import OrbitBranch, continue_orbit, steps_of_branch
from ..orbits.periodic import PeriodicOrbit, periodic_orbit
from ..plots.runs import edges_of, peak_of
from ..sweeps.attractors import FLOOR, LAST
from ..sweeps.grid import Cases
from ..sweeps.records import MotionKind
from ..sweeps.runs import run as run_along
from ..sweeps.store import open_store
from ..sweeps.sweep import sweep
from ..tools.checks import require
from ..tools.files import user_path

PERIODS, SETTLED = 320, 200
"""Forcing periods of a case that is looked at, and those at its end that are drawn and classified."""
SAVES = 40
"""Saved states per forcing period."""
LIVE: dict[str, int] = {"transient": 100, "periods": 64}
"""Forcing periods of the cases of a map that is computed here."""
SURE = 200
"""Recorded periods with which tori and chaos are told apart, where no period was found with fewer."""
COUNTS = {1: (200,), 2: (16, 25)}
"""Cases along each parameter of what is computed here, by the number of parameters."""
RECORDS = {1: ("sections",), 2: ("motion",)}
"""Its records, by the number of parameters."""
SLICE, LANES, FEW = 80, 40, 16
"""Cases that are computed and shown at once; in one call, so that one program serves all; and in one of `SURE`."""
POINTS = 8
"""Points of a branch, of each way, that are computed and shown at once."""
HALVINGS = 6
"""How often at most windows of a run are halved."""
SLIDERS = {"speed": (100.0, 2500.0), "clearance": (1e-4, 5e-3), "length": (0.05, 0.5), "restitution": (0.1, 1.0)}
"""Parameters with a slider, and its ends [SI units]."""
MOST_PERIOD = 8
"""Longest period of a motion whose orbit is looked for [forcing periods]: a program each."""


def default_grid() -> dict[str, np.ndarray]:
    """The map that is computed where none is given: 400 cases over speed and clearance."""
    rows, columns = COUNTS[2]
    return {"clearance": np.linspace(2e-4, 4e-3, rows), "speed": np.linspace(200.0, 2500.0, columns)}


@dataclass(frozen=True)
class View:
    """A map, a diagram or a run, which the left side of a page shows."""

    scene: Scene
    start: Any = None
    ds: xr.Dataset | None = None
    """Its cases so far; None before there are any."""
    grid: dict[str, np.ndarray] | None = None
    """Values by parameter [SI units] of what is computed here; None for what was given."""
    record: tuple[str, ...] = ()
    source: Path | None = None
    """File or store that it is from."""
    span: tuple[float, float] | None = None
    """Distances of a run between which it is shown, in finer windows where these are computed [m]; None for all."""

    @property
    def names(self) -> list[str]:
        """The coordinates that vary, the one drawn upwards first; of a run its distance."""
        return list(map(Cases.label, self.grid)) if self.grid is not None else varied_names(self.ds) or ["distance"]

    @property
    def parameters(self) -> list[str]:
        """The names of what varies in a grid for `sweep`."""
        return [name.removeprefix("start_") for name in self.names]

    @property
    def is_run(self) -> bool:
        """Whether it is of a run over a length of rail."""
        return self.ds is not None and "distance" in self.ds.dims

    def axis(self, name: str) -> np.ndarray:
        """The values of a coordinate [SI units]; of a distance the middles of windows."""
        if self.grid is not None:
            return self.grid[name.removeprefix("start_")]
        assert self.ds is not None
        return self.ds[name].values - self.ds.attrs.get("window [m]", 0.0) / 2

    def quantity(self, name: str) -> Quantity:
        """The quantity that a coordinate is of."""
        if name == "distance":
            return Quantity(name, "m", name)
        bare = name.removeprefix("start_")
        return STARTS[bare] if bare != name else parameter(name, self.scene)

    @property
    def growing(self) -> bool:
        """Whether it is a store that lacks cases."""
        return self.source is not None and self.ds is not None and bool((self.ds["status"] == Status.NOT_RUN).any())


@dataclass(frozen=True)
class Case:
    """One case that is looked at."""

    scene: Scene
    start: Any = None
    """A motion or state; None is Table 2's."""
    origin: str = "Table 2's start"
    steps: int | None = None
    """Integration steps per forcing period, where they are not the default."""
    solver: Any = None
    window: tuple[float, float] | None = None
    """Where of a run it is [m]; None for a steady motion."""

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of its functions besides the scene."""
        return {name: v for name, v in (("steps_per_period", self.steps), ("solver", self.solver)) if v is not None}


class Shown(NamedTuple):
    """A case that was computed."""

    case: Case
    run: Trajectory
    ds: xr.Dataset
    """Its last `SETTLED` forcing periods, or all of a run's."""
    kind: str
    """Of `slipperjax.analysis.kinds.KINDS`, or "run"."""
    period: int
    """Forcing periods after which it recurs; 0 for others."""

    @property
    def unit(self) -> float:
        """Of the axis over time: a forcing period, which is one, or of a run its length [m]."""
        return 1.0 if self.case.window is None else _wavelength(self.case.scene)


@dataclass
class Session:
    """All that a page shows and can compute. Copies share nothing that changes."""

    views: list[View]
    at: int
    """Which of the views is shown."""
    case: Case
    shown: Shown | None = None
    orbit: PeriodicOrbit | None = None
    branch: OrbitBranch | None = None
    picked: Any = None
    """The state that was clicked in the section."""

    @classmethod
    def of(cls, source: Any = None, grid: Mapping[str, Any] | None = None, *, start: Any = None) -> "Session":
        """Makes the first view of a scene, a dataset, a file or a store.

        **Raises:** `ValueError` where it is none of these, or `grid` is wrong; `OSError` for what cannot be read.
        """
        path, ds, given = None, None, source
        if source is None:
            scene = paper_scene()
        elif isinstance(source, Scene):
            scene = source
        else:
            if isinstance(source, str | Path):
                path = user_path(source).resolve()
                need = "be a store, a netCDF file or a scene's TOML file of slipperjax"
                require(path.suffix != ".zarr" or path.is_dir(), "source", need, shown=f"{path}, which is not there")
                given = _opened(path)
            if isinstance(given, Path):  # of a scene
                scene, start = load_scene(given), start or load_start(given)
            else:
                ds = dataset_of(given)
                scene, of_ds = load_base(ds)
                start = of_ds if start is None else start
        if ds is not None and grid is None and (varied_names(ds) or "distance" in ds.dims):
            view = View(scene, start, ds, source=path)
            _check_drawable(view)
        else:
            check_steady(scene)
            grid = {k: np.asarray(v, float) for k, v in (default_grid() if grid is None else grid).items()}
            require(len(grid) in COUNTS, "grid", "have one or two parameters", list(grid))
            Cases(scene, grid, start or table_2_start())
            view = View(scene, start, None, grid, RECORDS[len(grid)])
        session = cls([view], 0, Case(scene, start, _origin(start)))
        if view.is_run:  # the window with the highest force, where forces are known
            place = float(peak_of(session.run)["peak_distance"]) if "peak_force" in session.run else 0.0
            session.case = session.case_at(session.nearest(place))
        return session

    def copied(self) -> "Session":
        """A session for another window, which goes on from here."""
        return dataclasses.replace(self, views=copy.copy(self.views))

    @property
    def view(self) -> View:
        """The view that is shown on the left."""
        return self.views[self.at]

    # --- the map ----------------------------------------------------------------------------------------------------

    def show(self, view: View) -> None:
        """Shows another view, from which `move` leads back to this one; those that were ahead are forgotten."""
        self.views[self.at + 1 :] = [view]
        self.at += 1

    def move(self, step: int) -> bool:
        """Goes back (-1) or forward (1) in the history; says whether there was something."""
        moved = 0 <= self.at + step < len(self.views)
        self.at += step * moved
        return moved

    def box(self, *ends: tuple[float, float]) -> View | None:
        """A finer view of a box, the ends of its sides along `view.names` [SI units]; None where it is too small."""
        names, grid = self.view.names, {}
        for name, pair, count in zip(names, ends, COUNTS[len(names)], strict=True):
            values = self.view.axis(name)
            low, high = map(float, np.clip(sorted(pair), values.min(), values.max()))
            if not high - low > 1e-6 * np.ptp(values):
                return None
            finer = np.linspace(low, high, count)
            if self.view.quantity(name).whole:
                whole = np.unique(np.round(finer))
                finer = whole[(whole >= low) & (whole <= high)]
                if len(finer) < 2:
                    return None
            grid[name.removeprefix("start_")] = finer
        if self.view.is_run:
            return dataclasses.replace(self.view, span=(low, high))
        record = self.view.record if self.view.grid and len(names) == 2 else RECORDS[len(names)]
        return View(self.view.scene, self.view.start, None, grid, record)

    def with_case(self) -> View:
        """The same map with the other values of the case that is looked at."""
        view = self.view
        grid = view.grid or {p: np.unique(view.axis(n)) for n, p in zip(view.names, view.parameters, strict=True)}
        return View(self.case.scene, view.start, None, grid, view.record or RECORDS[len(grid)])

    def compute(self, view: View) -> Iterator[tuple[View, str, float]]:
        """Computes a view, `SLICE` cases at a time: gives what there is of it, what is being done, and its share.

        Cases of a map that have no period in the record are run once more with `SURE` periods.
        """
        if view.is_run:
            if (span := view.span) is not None and (window := self.finer(span)) is not None:
                begin = self.way(span[0])[1]
                options = {"begin": begin, "start": self.state_at(begin), "window": window, **self.run_options}
                ds = run_along(view.scene, length=span[1] - begin, **options)
                yield dataclasses.replace(view, ds=ds), "running once more", 1.0
            return
        assert view.grid is not None
        cases = Cases(view.scene, view.grid, view.start or table_2_start())
        # cases with the same steps together, which run as one batch
        order, options = np.argsort(-cases.default_steps(), kind="stable"), self.sweep_options(view)
        whole: xr.Dataset | None = None
        for text, lanes in (("computing the map", LANES), ("telling chaos from quasi-periodic motions", FEW)):
            for first in range(0, len(order), SLICE):
                part = order[first : first + SLICE]
                values = cases.part(np.unravel_index(part, cases.shape))
                # of too few periods for the others, which are run once more
                kinds = MotionKind(min(options["periods"], LAST))
                record = [kinds if name == "motion" else name for name in view.record]
                ds = sweep(view.scene, values, product=False, **options | {"record": record}, chunk=lanes)
                whole = _put(whole, ds, part, cases)
                yield dataclasses.replace(view, ds=whole), text, min(1.0, (first + SLICE) / len(order))
            if whole is None or "kind" not in whole:
                return
            unsure = (whole["kind"].values == "unresolved") & (whole["status"].values == Status.FINITE)
            order, options = order[unsure.ravel()[order]], options | {"periods": SURE}

    @staticmethod
    def sweep_options(view: View) -> dict[str, Any]:
        """Arguments of `slipperjax.sweep` for a view, those of all of its cases where it is there."""
        record = view.record[0] if len(view.record) == 1 else list(view.record)
        lengths = LIVE if "motion" in view.record else {"transient": 200, "periods": 10}
        if view.ds is not None:
            lengths = lengths | {"periods": int(view.ds.attrs["periods"])}
        return {"record": record, **lengths, **({} if view.start is None else {"start": view.start})}

    def refreshed(self) -> View | None:
        """A growing store as it is now; None where nothing is new."""
        view = self.view
        if not view.growing:
            return None
        ds = open_store(view.source)
        assert view.ds is not None
        before, now = (int((one["status"] == Status.NOT_RUN).sum()) for one in (view.ds, ds))
        if now == before:
            return None
        self.views[self.at] = dataclasses.replace(view, ds=ds.assign(status=ds["status"].load()))
        return self.view

    # --- runs -------------------------------------------------------------------------------------------------------

    @property
    def run(self) -> xr.Dataset:
        """The whole run, of which views and cases are parts."""
        assert self.views[0].ds is not None
        return self.views[0].ds

    @property
    def run_options(self) -> dict[str, Any]:
        """Its records and its solver."""
        call = load_call(self.run)
        return {name: call[name] for name in ("record", "solver") if call.get(name) is not None}

    def way(self, distance: float) -> tuple[float, float]:
        """The last place up to a distance where the run kept its state, and where its window there begins [m]."""
        edges = edges_of(self.run, "distance")
        before = lambda places: float(max(p for p in places if p <= max(distance, edges[0]) + 1e-6))
        return before([edges[0], *self.run["stretch"].values]), before(edges)

    def state_at(self, distance: float) -> Any:
        """A run with its state where the window at a distance [m] begins, or the start there."""
        kept, begin = self.way(distance)
        start = self.run if kept in self.run["stretch"] else load_start(self.run)
        if begin == kept:
            return start
        options = {"begin": kept, "start": start, "window": self.run.attrs["window [m]"], **self.run_options}
        return run_along(self.views[0].scene, length=begin - kept, **options)

    def finer(self, span: tuple[float, float]) -> float | None:
        """The length of windows in which a part is computed [m], halved while there are few; None where it is not."""
        width = float(self.run.attrs["window [m]"])
        halvings = min(math.ceil(math.log2(COUNTS[1][0] * width / (span[1] - span[0]))), HALVINGS)
        return width / 2**halvings if halvings > 0 else None

    def passage(self, case: Case) -> tuple[Scene, int, float]:
        """The scene in a window, and whole forcing periods that have it near their end, from a place on [m]."""
        assert case.window is not None
        scene, (low, high), wave = case.scene, case.window, _wavelength(case.scene)
        periods = max(1, math.ceil((high - self.way(low)[1]) / wave - 1e-6))
        kept, begin = self.way(high - periods * wave + self.run.attrs["window [m]"] - 2e-6)
        if scene.wear is not None:  # too little to matter within a window
            play = self.run["play"].sel(stretch=kept).values if kept in self.run["stretch"] else scene.section.play
            scene = dataclasses.replace(scene, wear=None, section=dataclasses.replace(scene.section, play=play))
        return scene, periods, begin

    # --- the case ---------------------------------------------------------------------------------------------------

    def nearest(self, *place: float) -> dict[str, int]:
        """Indices by dimension of the case nearest to a place along `view.names` [SI units]."""
        view = self.view
        names, axes = view.names, [view.axis(name) for name in view.names]
        if view.grid is None and view.ds is not None and view.ds[names[0]].dims == ("case",):
            away = sum(((v - p) / (np.ptp(v) or 1.0)) ** 2 for v, p in zip(axes, place, strict=True))
            return {"case": int(np.argmin(away))}
        return {name: int(np.argmin(abs(v - p))) for name, v, p in zip(names, axes, place, strict=True)}

    def case_at(self, index: Mapping[str, int]) -> Case:
        """The case at a place of the map."""
        view = self.view
        if view.is_run:
            ds, window = self.run, edges_of(view.ds, "distance")[index["distance"] :][:2]
            at = min(int(np.searchsorted(ds["stretch"].values, window.mean())), ds.sizes["stretch"] - 1)
            count = float(ds["steps_per_window"][at]) * _wavelength(view.scene) / ds.attrs["window [m]"]
            solver = load_call(ds).get("solver")
            return Case(view.scene, view.start, "", math.ceil(count), solver, (float(window[0]), float(window[1])))
        values = {name: float(view.axis(name)[index.get(name, index.get("case", 0))]) for name in view.names}
        of_start = {name.removeprefix("start_"): v for name, v in values.items() if name.startswith("start_")}
        scene = view.scene.replace(**{name: v for name, v in values.items() if not name.startswith("start_")})
        start, origin = view.start, _origin(view.start)
        if of_start:
            begin = table_2_start() if start is None else start
            motion = dataclasses.replace(getattr(begin, "motion", begin), **of_start)
            start = dataclasses.replace(begin, motion=motion) if hasattr(begin, "motion") else motion
            origin = "the map's start"
        steps = solver = None
        if view.ds is not None and view.grid is None:
            solver = load_call(view.ds).get("solver")
            count = int(view.ds["steps_per_period"].isel(index).max()) if "steps_per_period" in view.ds else 0
            steps = count if count and count != default_steps_per_period(scene) else None
        return Case(scene, start, origin, steps, solver)

    def place(self) -> list[float]:
        """Where the case that is looked at is on the map, along `view.names` [SI units]."""
        case, motion = self.case, getattr(self.case.start, "motion", self.case.start) or table_2_start()
        if case.window is not None:
            return [float(np.mean(case.window))]
        of_start = lambda name: getattr(motion, name.removeprefix("start_"))
        of_scene = lambda name: parameter(name, case.scene).of(case.scene)
        return [float(of_start(n) if n.startswith("start_") else of_scene(n)) for n in self.view.names]

    def begun(self, case: Case, choice: str) -> Case:
        """The case from a chosen start: "map", "picked", or "end" of what is shown now."""
        if choice == "picked" and self.picked is not None:
            return dataclasses.replace(case, start=self.picked, origin="a state clicked in the section")
        if choice == "end" and self.shown is not None and int(self.shown.run.status) == Status.FINITE:
            return dataclasses.replace(case, start=self.shown.run.end, origin="the end of the case before")
        return case

    def pick(self, coordinate: str, velocity: str, *place: float) -> None:
        """Takes the state of the section nearest to a place in a plane [display units], put there, as a start."""
        assert self.shown is not None
        names, quantities = (coordinate, velocity), (COORDINATES[coordinate], COORDINATES[velocity])
        values = [q.from_shown(p) for q, p in zip(quantities, place, strict=True)]
        away = [(self.strobe(n) - v) / q.scale for n, q, v in zip(names, quantities, values, strict=True)]
        at = (PERIODS - SETTLED + int(np.argmin(np.hypot(*away)))) * (len(self.shown.run.period) // PERIODS)
        motion = jax.tree.map(lambda a: float(np.asarray(a)[at]), self.shown.run.state.motion)
        angles = dict(zip(("roll", "pitch", "yaw"), map(float, euler_angles(motion)), strict=True))
        changed = dict(zip(names, values, strict=True))
        turned = quaternion_from_euler(*(angles | {n: v for n, v in changed.items() if n in angles}).values())
        changed = dict(zip(("q_x", "q_y", "q_z"), map(float, turned), strict=True)) | changed
        self.picked = dataclasses.replace(motion, **{n: v for n, v in changed.items() if n not in angles})

    def strobe(self, name: str) -> np.ndarray:
        """A coordinate of what is shown, once per forcing period [SI unit]."""
        assert self.shown is not None
        return self.shown.ds[name].values[:: (self.shown.ds.sizes["time"] - 1) // SETTLED]

    def look(self, case: Case) -> Iterator[Shown]:
        """Computes the motion of a case."""
        if case.window is not None:
            scene, periods, begin = self.passage(case)
            start, saves = self.state_at(begin), {"saves_per_period": case.steps}
            run = simulate(scene, periods, start=start, begin=begin, **case.options, **saves)
            yield Shown(case, run, run.to_xarray(), "run", 0)
            return
        saves = {} if case.steps is None or case.steps % SAVES else {"saves_per_period": SAVES}
        run = simulate(case.scene, PERIODS, start=case.start, **case.options, **saves)
        ds = run.to_xarray()
        ds = ds.isel(time=slice(-SETTLED * (len(run.period) // PERIODS) - 1, None))
        kind, period = "unresolved", 0
        if int(run.status) == Status.FINITE:
            strobe = np.stack([ds[name].values[:: len(run.period) // PERIODS] for name in COORDINATES], axis=-1)
            found = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
            kind, period = str(found.kind), int(found.period)
        yield Shown(case, run, ds, kind, period)

    def find_orbit(self, shown: Shown) -> Iterator[PeriodicOrbit]:
        """Finds the orbit of a case whose motion is periodic."""
        case = shown.case
        if not no_orbit(shown):
            yield periodic_orbit(case.scene, shown.period, start=shown.run.end, **case.options)

    def warm(self) -> Iterator[None]:
        """Compiles the programs of `look` for all of the map, which are few: the steps' capacity tells them."""
        ends = [np.array([axis.min(), axis.max()]) for axis in map(self.view.axis, self.view.names)]
        corners = Cases(self.view.scene, dict(zip(self.view.parameters, ends, strict=True)), table_2_start())
        for steps in np.unique(corners.default_steps()):
            simulate(self.view.scene, PERIODS, steps_per_period=int(steps), saves_per_period=SAVES)
            yield

    def follow(self, name: str) -> Iterator[OrbitBranch]:
        """Follows the orbit of the case over a parameter between the map's ends, some points at a time."""
        require(
            self.orbit is not None and int(self.orbit.status) == Status.FINITE, "orbit", "be found first", self.orbit
        )
        orbit, bounds = self.orbit, self.branch_bounds(name)
        assert orbit is not None
        steps = steps_of_branch(orbit.scene, parameter(name, orbit.scene), bounds, None)
        first = periodic_orbit(
            orbit.scene, orbit.period, start=orbit.state, steps_per_period=steps, solver=orbit.solver
        )
        branch = continue_orbit(
            orbit.scene, name, bounds, start=first, steps_per_period=steps, solver=orbit.solver, points=POINTS
        )
        yield branch
        while "count" in branch.points.attrs["ended"]:
            branch = branch.extended(points=POINTS)
            yield branch

    def branch_bounds(self, name: str) -> tuple[float, float]:
        """Ends between which a branch is followed [SI unit], which hold the case's value."""
        assert self.orbit is not None
        value = float(parameter(name, self.orbit.scene).of(self.orbit.scene))
        ends = self.view.axis(name) if name in self.view.names else np.array(SLIDERS[name])
        return min(float(np.min(ends)), value), max(float(np.max(ends)), value)


def no_orbit(shown: Shown) -> str:
    """Why no orbit is looked for; empty where one is."""
    if shown.kind != "period":
        return "none, as the motion has no period"
    if float(shown.case.scene.track.recurrence) != 1:
        return "none, as the rail does not repeat after a wavelength"
    return f"looked for up to period {MOST_PERIOD} only" if shown.period > MOST_PERIOD else ""


def _wavelength(scene: Scene) -> float:
    return float(np.max(np.asarray(scene.track.wavelength)))


def _opened(path: Path) -> Any:
    """A store or a file as a dataset, with statuses in memory; the path of a scene's file as it is."""
    if path.suffix.lower() == ".toml":
        return path
    ds = open_store(path) if path.is_dir() else dataset_of(path)
    return ds.assign(status=ds["status"].load()) if "status" in ds else ds


def _check_drawable(view: View) -> None:
    """Raises `ValueError` for a dataset with more parameters than a plane has."""
    assert view.ds is not None
    if view.is_run:
        over = view.ds["status"].dims
        require(not over, "source", "be one run, as is ds.isel(...)", shown=f"over {', '.join(map(str, over))}")
        return
    count, points = len(view.names), "point" in view.ds.dims and "state" in view.ds
    require(
        count in COUNTS and not points,
        "source",
        "be a sweep over one or two parameters",
        shown=f"over {', '.join(view.names)}",
    )
    check_steady(view.scene)


def _put(whole: xr.Dataset | None, ds: xr.Dataset, part: np.ndarray, cases: Cases) -> xr.Dataset:
    """Puts some cases of a grid, side by side in `ds`, into the dataset of all of them."""
    data = {}
    for name, variable in ds.data_vars.items():
        shape = variable.shape[1:]
        old = (
            None if whole is None else whole[name].values.reshape(cases.count, *whole[name].shape[len(cases.dims) :])
        )
        if old is not None:  # the number of crossings differs
            shape = tuple(map(max, shape, old.shape[1:]))
        empty: Any = {"f": np.nan, "U": ""}.get(variable.dtype.kind, 0)
        dtype = "U16" if variable.dtype.kind == "U" else variable.dtype
        full = np.full((cases.count, *shape), int(Status.NOT_RUN) if name == "status" else empty, dtype)
        if old is not None:
            full[(slice(None), *map(slice, old.shape[1:]))] = old
        full[(part, *map(slice, variable.shape[1:]))] = variable.values
        data[name] = ((*cases.dims, *variable.dims[1:]), full.reshape(*cases.shape, *shape), variable.attrs)
    others = {str(d): ds[d] for d in ds.indexes if d not in ("case", *cases.dims)}
    return xr.Dataset(data, {**others, **cases.coordinates()}, ds.attrs)


def _origin(start: Any) -> str:
    same = start is None or json.dumps(jax.tree.map(float, vars(getattr(start, "motion", start)))) == json.dumps(
        jax.tree.map(float, vars(table_2_start()))
    )
    return "Table 2's start" if same else "the map's start"
