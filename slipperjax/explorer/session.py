"""Page state, independent of Bokeh: maps and their history, the case looked at, and what computes them."""

import copy
import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr

from ..analysis.attractor import classify
from ..flow.datasets import dataset_of, load_base, load_call, load_scene, load_start, varied_names
from ..flow.simulate import Trajectory, simulate
from ..flow.status import Status
from ..model.dang2024 import paper_scene, table_2_start
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

PERIODS = 320
"""Forcing periods of a case that is looked at."""
SETTLED = 200
"""Forcing periods at its end that are drawn and classified."""
SAVES = 40
"""Saved states per forcing period."""
SURE = 200
"""Recorded periods with which tori and chaos are told apart, where no period was found with fewer."""
SLIDERS = {"speed": (100.0, 2500.0), "clearance": (1e-4, 5e-3), "length": (0.05, 0.5), "restitution": (0.1, 1.0)}
"""Parameters with a slider, and its ends [SI units]."""
RECORDS = {1: ("sections",), 2: ("motion",)}
"""Records of what is computed here, by the number of parameters."""


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

    @property
    def names(self) -> list[str]:
        """Coordinates that vary, the one drawn upwards first; of a run its distance."""
        return list(map(Cases.label, self.grid)) if self.grid is not None else varied_names(self.ds) or ["distance"]

    @property
    def is_run(self) -> bool:
        """Whether it is of a run over a length of rail."""
        return self.ds is not None and "distance" in self.ds.dims

    @property
    def growing(self) -> bool:
        """Whether it is a store that lacks cases."""
        return self.source is not None and self.ds is not None and bool((self.ds["status"] == Status.NOT_RUN).any())

    def axis(self, name: str) -> np.ndarray:
        """Return the values of a coordinate [SI units]; of a distance the middles of windows."""
        if self.grid is not None:
            return self.grid[name.removeprefix("start_")]
        assert self.ds is not None
        return self.ds[name].values - self.ds.attrs.get("window [m]", 0.0) / 2

    def quantity(self, name: str) -> Quantity:
        """Return the quantity that a coordinate is of."""
        if name == "distance":
            return Quantity(name, "m", name)
        bare = name.removeprefix("start_")
        return STARTS[bare] if bare != name else parameter(name, self.scene)


@dataclass(frozen=True)
class Case:
    """One case that is looked at."""

    scene: Scene
    start: Any = None
    """A motion or state; None is Table 2's."""
    origin: str = "the map's start"
    steps: int | None = None
    """Integration steps per forcing period, where they are not the default."""
    solver: Any = None
    window: tuple[float, float] | None = None
    """Where of a run it is [m]; None for a steady motion."""

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of its functions besides the scene."""
        options = {"steps_per_period": self.steps, "solver": self.solver}
        return {name: value for name, value in options.items() if value is not None}


class Shown(NamedTuple):
    """A case that was computed."""

    case: Case
    run: Trajectory
    ds: xr.Dataset
    """Its last `SETTLED` forcing periods, or all of a run's."""
    kind: str
    """One of `slipperjax.analysis.kinds.KINDS`, or "run"."""
    period: int
    """Forcing periods after which it recurs; 0 for others."""

    @property
    def unit(self) -> float:
        """Unit of the axis over time: a forcing period, which is one, or of a run its length [m]."""
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

    @classmethod
    def of(cls, source: Any = None, grid: Mapping[str, Any] | None = None, *, start: Any = None) -> "Session":
        """Return a session whose first view is of a scene, a dataset, a file or a store.

        **Raises:** `ValueError` where it is none of these, or `grid` is wrong; `OSError` for what cannot be read.
        """
        path = None
        if isinstance(source, str | Path):
            path = user_path(source).resolve()
            need = "be a store, a netCDF file or a scene's TOML file of slipperjax"
            require(path.suffix != ".zarr" or path.is_dir(), "source", need, shown=f"{path}, which is not there")
            source = path if path.suffix.lower() == ".toml" else _opened(path)
        ds = None
        if source is None or isinstance(source, Scene):
            scene = paper_scene() if source is None else source
        elif isinstance(source, Path):
            scene = load_scene(source)
            start = start or load_start(source)
        else:
            ds = dataset_of(source)
            scene, of_ds = load_base(ds)
            start = of_ds if start is None else start
        # a dataset that varies nothing is the source of a scene
        if ds is not None and grid is None and (varied_names(ds) or "distance" in ds.dims):
            view = View(scene, start, ds, source=path)
            _check_drawable(view)
        else:
            check_steady(scene)
            # 400 cases over speed and clearance
            if grid is None:
                grid = {"clearance": np.linspace(2e-4, 4e-3, 16), "speed": np.linspace(200.0, 2500.0, 25)}
            grid = {name: np.asarray(values, float) for name, values in grid.items()}
            require(len(grid) in RECORDS, "grid", "have one or two parameters", list(grid))
            Cases(scene, grid, start or table_2_start())  # for its checks
            view = View(scene, start, None, grid, RECORDS[len(grid)])
        session = cls([view], 0, Case(scene, start))
        if view.is_run:  # the window with the highest force, where forces are known
            place = float(peak_of(session.run)["peak_distance"]) if "peak_force" in session.run else 0.0
            session.case = session.case_at(session.nearest(place))
        return session

    def copied(self) -> "Session":
        """Return a session for another window, which goes on from here."""
        return dataclasses.replace(self, views=copy.copy(self.views))

    @property
    def view(self) -> View:
        """The view that is shown on the left."""
        return self.views[self.at]

    # --- the map ----------------------------------------------------------------------------------------------------

    def show(self, view: View) -> None:
        """Show another view, from which `move` leads back to this one; those that were ahead are forgotten."""
        # as browsers do it
        self.views[self.at + 1 :] = [view]
        self.at += 1

    def move(self, step: int) -> bool:
        """Go back (-1) or forward (1) in the history; return whether there was something."""
        moved = 0 <= self.at + step < len(self.views)
        self.at += step * moved
        return moved

    def box(self, *ends: tuple[float, float]) -> View | None:
        """Return a finer view of a box; None where it is too small.

        **Arguments:** `ends`: those of its sides along `view.names` [SI units].
        """
        names = self.view.names
        counts = (200,) if len(names) == 1 else (16, 25)
        grid = {}
        # each side of the box, within the map
        for name, pair, count in zip(names, ends, counts, strict=True):
            values = self.view.axis(name)
            low, high = map(float, np.clip(sorted(pair), values.min(), values.max()))
            finer = np.linspace(low, high, count)
            # seeds and the like have no values between
            if self.view.quantity(name).whole:
                finer = np.arange(math.ceil(low), math.floor(high) + 1.0)
            if len(finer) < 2 or not finer[-1] - finer[0] > 1e-6 * np.ptp(values):
                return None
            grid[name.removeprefix("start_")] = finer
        record = self.view.record if self.view.grid and len(names) == 2 else RECORDS[len(names)]
        return View(self.view.scene, self.view.start, None, grid, record)

    def with_case(self) -> View:
        """Return the same map with the other values of the case that is looked at."""
        view = self.view
        grid = view.grid or {name.removeprefix("start_"): np.unique(view.axis(name)) for name in view.names}
        return View(self.case.scene, view.start, None, grid, view.record or RECORDS[len(grid)])

    def compute(self, view: View) -> Iterator[tuple[View, str, float]]:
        """Yield what there is of a view after each 80 cases, what is being done, and its share.

        Cases of a map that have no period in the record are run once more with `SURE` periods.
        """
        assert view.grid is not None
        cases = Cases(view.scene, view.grid, view.start or table_2_start())
        options = self.sweep_options(view)
        # cases with the same steps together, which run as one batch
        order = np.argsort(-cases.default_steps(), kind="stable")
        whole: xr.Dataset | None = None
        # in all calls of a pass as many lanes, so that one program serves them
        for text, lanes in (("computing the map", 40), ("telling chaos from quasi-periodic motions", 16)):
            # the first pass has too few periods for kinds other than periods
            kinds = MotionKind(min(options["periods"], LAST))
            options["record"] = [kinds if name == "motion" else name for name in view.record]
            # each piece is shown before the next one begins
            for first in range(0, len(order), 80):
                part = order[first : first + 80]
                values = cases.part(np.unravel_index(part, cases.shape))
                ds = sweep(view.scene, values, product=False, **options, chunk=lanes)
                whole = _put(whole, ds, part, cases)
                yield dataclasses.replace(view, ds=whole), text, min(1.0, (first + 80) / len(order))
            if whole is None or "kind" not in whole:
                return
            # of the cases with a finite motion
            unsure = (whole["kind"].values == "unresolved") & (whole["status"].values == Status.FINITE)
            order = order[unsure.ravel()[order]]
            options["periods"] = SURE

    @staticmethod
    def sweep_options(view: View) -> dict[str, Any]:
        """Return arguments of `slipperjax.sweep` for a view, those of all of its cases where it is there."""
        record = view.record[0] if len(view.record) == 1 else list(view.record)
        transient, periods = (100, 64) if "motion" in view.record else (200, 10)
        if view.ds is not None:
            periods = int(view.ds.attrs["measured"])
        options = {"record": record, "transient": transient, "periods": periods}
        return options if view.start is None else options | {"start": view.start}

    def refreshed(self) -> View | None:
        """Return a growing store as it is now; None where nothing is new."""
        view = self.view
        if not view.growing:
            return None
        assert view.ds is not None
        ds = _opened(view.source)
        if np.array_equal(ds["status"].values, view.ds["status"].values):
            return None
        self.views[self.at] = dataclasses.replace(view, ds=ds)
        return self.view

    # --- runs -------------------------------------------------------------------------------------------------------

    @property
    def run(self) -> xr.Dataset:
        """The run, of which cases are windows."""
        assert self.views[0].ds is not None
        return self.views[0].ds

    @property
    def run_options(self) -> dict[str, Any]:
        """Its window, records and solver."""
        call = load_call(self.run)
        options = {name: call[name] for name in ("record", "solver") if call.get(name) is not None}
        return {"window": float(self.run.attrs["window [m]"]), **options}

    def way(self, distance: float) -> tuple[float, float]:
        """Return the last place up to a distance where the run kept its state, and the beginning of a window [m]."""
        edges = edges_of(self.run, "distance")
        limit = max(distance, edges[0]) + 1e-6
        # where the run begins, and the ends of its stretches
        kept = [place for place in (edges[0], *self.run["stretch"].values) if place <= limit]
        return float(max(kept)), float(edges[edges <= limit].max())

    def state_at(self, distance: float) -> Any:
        """Return a run with its state where the window at a distance [m] begins, or the start there."""
        kept, begin = self.way(distance)
        start = self.run if kept in self.run["stretch"] else load_start(self.run)
        # the state is there; else the run goes on up to the window
        if begin == kept:
            return start
        return run_along(self.view.scene, length=begin - kept, begin=kept, start=start, **self.run_options)

    def passage(self, case: Case) -> tuple[Scene, int, float]:
        """Return the scene in a window, and whole forcing periods with it near their end, from a place on [m]."""
        assert case.window is not None
        low, high = case.window
        scene = case.scene
        wave = _wavelength(scene)
        # one wavelength at least, with the window at its end
        periods = max(1, math.ceil((high - self.way(low)[1]) / wave - 1e-6))
        kept, begin = self.way(high - periods * wave + self.run.attrs["window [m]"] - 2e-6)
        if scene.wear is not None:  # too little to matter within a window
            play = self.run["play"].sel(stretch=kept).values if kept in self.run["stretch"] else scene.section.play
            scene = dataclasses.replace(scene, wear=None, section=dataclasses.replace(scene.section, play=play))
        return scene, periods, begin

    # --- the case ---------------------------------------------------------------------------------------------------

    def nearest(self, *place: float) -> dict[str, int]:
        """Return indices by dimension of the case nearest to a place along `view.names` [SI units]."""
        view = self.view
        away = {name: np.abs(view.axis(name) - p) for name, p in zip(view.names, place, strict=True)}
        # a sample has one dimension, in which axes are scaled by their range
        if view.grid is None and view.ds is not None and "case" in view.ds["status"].dims:
            scaled = [(distance / (np.ptp(view.axis(name)) or 1.0)) ** 2 for name, distance in away.items()]
            return {"case": int(np.argmin(np.sum(scaled, axis=0)))}
        return {name: int(np.argmin(distance)) for name, distance in away.items()}

    def case_at(self, index: Mapping[str, int]) -> Case:
        """Return the case at a place of the map."""
        view = self.view
        if view.is_run:
            low, high = map(float, edges_of(view.ds, "distance")[index["distance"] :][:2])
            # steps are counted by stretch
            stretch = min(int(np.searchsorted(self.run["stretch"], (low + high) / 2)), self.run.sizes["stretch"] - 1)
            per_metre = float(self.run["steps_per_window"][stretch]) / self.run.attrs["window [m]"]
            steps = math.ceil(per_metre * _wavelength(view.scene))
            return Case(view.scene, view.start, "", steps, load_call(self.run).get("solver"), (low, high))
        scene = view.scene
        motion = getattr(view.start, "motion", view.start) or table_2_start()
        # each name changes the start or the scene
        for name in view.names:
            value = float(view.axis(name)[index.get(name, index.get("case", 0))])
            if name.startswith("start_"):
                motion = dataclasses.replace(motion, **{name.removeprefix("start_"): value})
            else:
                scene = scene.replace(**{name: value})
        start = view.start
        if any(name.startswith("start_") for name in view.names):
            start = eqx.tree_at(lambda state: state.motion, start, motion) if hasattr(start, "motion") else motion
        steps = solver = None
        # what was given keeps its own steps and solver
        if view.ds is not None and view.grid is None:
            solver = load_call(view.ds).get("solver")
            count = int(view.ds["steps_per_period"].isel(index).max()) if "steps_per_period" in view.ds else 0
            steps = count if count and count != default_steps_per_period(scene) else None
        return Case(scene, start, steps=steps, solver=solver)

    def place(self) -> list[float]:
        """Return where the case that is looked at is on the map, along `view.names` [SI units]."""
        case = self.case
        if case.window is not None:
            return [float(np.mean(case.window))]
        motion = getattr(case.start, "motion", case.start) or table_2_start()
        places = []
        for name in self.view.names:
            bare = name.removeprefix("start_")
            places.append(
                float(getattr(motion, bare) if bare != name else parameter(name, case.scene).of(case.scene))
            )
        return places

    def begun(self, case: Case, goes_on: bool) -> Case:
        """Return the case, or the case from the end of what is shown now, as `follow` begins it."""
        if not goes_on or self.shown is None or int(self.shown.run.status) != Status.FINITE:
            return case
        return dataclasses.replace(case, start=self.shown.run.end, origin="the end of the case before")

    def look(self, case: Case) -> Iterator[Shown]:
        """Compute the motion of a case."""
        if case.window is not None:
            scene, periods, begin = self.passage(case)
            options = case.options | {"start": self.state_at(begin), "begin": begin, "saves_per_period": case.steps}
            run = simulate(scene, periods, **options)
            yield Shown(case, run, run.to_xarray(), "run", 0)
            return
        saves = None if case.steps is not None and case.steps % SAVES else SAVES
        run = simulate(case.scene, PERIODS, start=case.start, saves_per_period=saves, **case.options)
        # saves per period
        every = len(run.period) // PERIODS
        ds = run.to_xarray().isel(time=slice(-SETTLED * every - 1, None))
        kind, period = "unresolved", 0
        if int(run.status) == Status.FINITE:
            strobe = np.stack([ds[name].values[::every] for name in COORDINATES], axis=-1)
            found = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
            kind, period = str(found.kind), int(found.period)
        yield Shown(case, run, ds, kind, period)

    def find_orbit(self, shown: Shown) -> Iterator[PeriodicOrbit]:
        """Find the orbit of a case whose motion is periodic."""
        case = shown.case
        if not no_orbit(shown):
            yield periodic_orbit(case.scene, shown.period, start=shown.run.end, **case.options)

    def follow(self, name: str) -> Iterator[OrbitBranch]:
        """Follow the orbit of the case over a parameter between the map's ends, eight points of each way a piece."""
        orbit = self.orbit
        assert orbit is not None
        bounds = self.branch_bounds(name)
        # the first orbit has the steps of the branch, and shares its programs
        steps = steps_of_branch(orbit.scene, parameter(name, orbit.scene), bounds, None)
        options: dict[str, Any] = dict(steps_per_period=steps, solver=orbit.solver)
        first = periodic_orbit(orbit.scene, orbit.period, start=orbit.state, **options)
        branch = continue_orbit(orbit.scene, name, bounds, start=first, points=8, **options)
        yield branch
        while "count" in branch.points.attrs["ended"]:
            branch = branch.extended(points=8)
            yield branch

    def branch_bounds(self, name: str) -> tuple[float, float]:
        """Return ends between which a branch is followed [SI unit], which hold the case's value."""
        assert self.orbit is not None
        value = float(parameter(name, self.orbit.scene).of(self.orbit.scene))
        ends = self.view.axis(name) if name in self.view.names else np.array(SLIDERS[name])
        return min(float(np.min(ends)), value), max(float(np.max(ends)), value)


def no_orbit(shown: Shown, longest: int = 8) -> str:
    """Return why no orbit is looked for; empty where one is.

    **Arguments:** `longest`: period up to which orbits are looked for [forcing periods]: a program each.
    """
    if shown.kind != "period":
        return "none, as the motion has no period"
    if float(shown.case.scene.track.recurrence) != 1:
        return "none, as the rail does not repeat after a wavelength"
    return f"looked for up to period {longest} only" if shown.period > longest else ""


def _wavelength(scene: Scene) -> float:
    return float(np.max(np.asarray(scene.track.wavelength)))


def _opened(path: Any) -> xr.Dataset:
    """Return a store or a file as a dataset, with statuses in memory."""
    ds = open_store(path) if path.is_dir() else dataset_of(path)
    return ds.assign(status=ds["status"].load()) if "status" in ds else ds


def _check_drawable(view: View) -> None:
    """Raise `ValueError` for a dataset with more parameters than a plane has."""
    assert view.ds is not None
    if view.is_run:
        over = ", ".join(map(str, view.ds["status"].dims))
        require(not over, "source", "be one run, as is ds.isel(...)", shown=f"over {over}")
        return
    branch = "point" in view.ds.dims and "state" in view.ds
    good = len(view.names) in RECORDS and not branch
    require(good, "source", "be a sweep over one or two parameters", shown=f"over {', '.join(view.names)}")
    check_steady(view.scene)


def _put(whole: xr.Dataset | None, ds: xr.Dataset, part: np.ndarray, cases: Cases) -> xr.Dataset:
    """Put some cases of a grid, side by side in `ds`, into the dataset of all of them."""
    data = {}
    # cases along the first axis, in the shape of the grid afterwards
    for name, variable in ds.data_vars.items():
        values = variable.values
        shape = values.shape[1:]
        old = None
        if whole is not None:  # the number of crossings differs
            old = whole[name].values.reshape(cases.count, *whole[name].shape[len(cases.dims) :])
            shape = tuple(map(max, shape, old.shape[1:]))
        # what is not computed yet
        empty = {"f": np.nan, "U": ""}.get(values.dtype.kind, 0)
        dtype = "U16" if values.dtype.kind == "U" else values.dtype
        full = np.full((cases.count, *shape), int(Status.NOT_RUN) if name == "status" else empty, dtype)
        if old is not None:
            full[(slice(None), *map(slice, old.shape[1:]))] = old
        full[(part, *map(slice, values.shape[1:]))] = values
        data[name] = ((*cases.dims, *variable.dims[1:]), full.reshape(*cases.shape, *shape), variable.attrs)
    others = {str(d): ds[d] for d in ds.indexes if d not in ("case", *cases.dims)}
    return xr.Dataset(data, {**others, **cases.coordinates()}, ds.attrs)
