"""Page state, independent of Bokeh: the map, the shown case, and their computation."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr

from ..analysis.attractor import classify
from ..flow.datasets import load_base, load_call, start_of, varied_names
from ..flow.status import Status
from ..model.dang2024 import paper_scene, table_2_start
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import parameter
from ..model.quantities import COORDINATE_SCALES, COORDINATES, Quantity
from ..model.scene import Scene, check_steady
from ..orbits.simulate import Trajectory, first_of, simulate
from ..plots.runs import PEAKS, edges_of, main_peak, peak_of
from ..results.result import Result
from ..sweeps.attractors import FLOOR
from ..sweeps.grid import Cases
from ..sweeps.loading import load
from ..sweeps.runs import run as run_along
from ..sweeps.sweep import sweep
from ..tools.checks import require
from ..tools.files import user_path
from ..tools.types import Numbers

Source = Result | xr.Dataset | Scene | Path | str
"""What a page is opened with: a result, a scene, or a file or store of a result or scene."""
Start = Motion | State | None
"""Where motions start; None for the start of Table 2."""
PERIODS = 320
"""Forcing periods of a shown case."""
SETTLED = 200
"""Forcing periods at its end that are drawn and classified."""
SAVES = 40
"""Saved states per forcing period."""
SLIDERS = {
    "speed": (100.0, 2500.0),
    "clearance": (1e-4, 5e-3),
    "length": (0.05, 0.5),
    "restitution": (0.1, 1.0),
}
"""Parameters with a slider, and its ends [SI units]."""
COMPUTED: dict[int, dict[str, object]] = {
    1: {"record": "sections", "transient": 200, "periods": 10},
    2: {"record": ["motion", "peak_force"], "transient": 100, "periods": 200},
}
"""Options of the sweep of a diagram or a map, by the number of parameters."""


@dataclass(frozen=True)
class View:
    """A map, a diagram or a run, shown on the left side of a page."""

    scene: Scene
    start: Start = None
    ds: xr.Dataset = field(default_factory=xr.Dataset)
    """Its cases so far; empty before there are any."""
    grid: dict[str, np.ndarray] = field(default_factory=dict)
    """Values by parameter [SI units] of cases that are computed here; empty for a given result."""
    source: Path | None = None
    """File or store of the view."""

    @property
    def names(self) -> list[str]:
        """Coordinates that vary, first the one drawn upwards; for a run its distance."""
        return list(self.grid) or varied_names(self.ds) or ["distance"]

    @property
    def is_run(self) -> bool:
        """Whether the view is of a run over a length of rail."""
        return "distance" in self.ds.dims

    @property
    def growing(self) -> bool:
        """Whether the view is of a store with missing cases."""
        return self.source is not None and bool((self.ds["status"] == Status.NOT_RUN).any())

    def axis(self, name: str) -> np.ndarray:
        """Return the values of a coordinate [SI units]; for a distance the middles of windows."""
        if self.grid:
            return self.grid[name]
        return self.ds[name].values - self.ds.attrs.get("window [m]", 0.0) / 2

    def of_slipper(self, name: str) -> "View":
        """Return the view with the contact points of one slipper of a sled; with an empty name, of all slippers."""
        return dataclasses.replace(self, ds=self.ds.sel(slipper=name)) if name and "slipper" in self.ds.dims else self

    def quantity(self, name: str) -> Quantity:
        """Return the quantity of a coordinate."""
        if name == "distance":
            return Quantity(name, "m", name)
        return parameter(name, self.scene)


@dataclass(frozen=True)
class Case:
    """One case, shown on the right side of a page."""

    scene: Scene
    start: Start = None
    """None for the start of Table 2."""
    steps: int | None = None
    """Integration steps per forcing period, where they are not the default."""
    solver: diffrax.AbstractSolver | None = None
    window: tuple[float, float] | None = None
    """Both ends of a window of a run [m]; None for a steady motion."""

    @property
    def options(self) -> dict[str, object]:
        """Arguments of `simulate` other than the scene."""
        return {"steps_per_period": self.steps, "solver": self.solver}

    @property
    def saves(self) -> int | None:
        """Saved states per forcing period; None, for each step, where `SAVES` does not divide its steps."""
        whole = self.steps is None or self.steps % SAVES == 0
        return SAVES if whole else None


class Shown(NamedTuple):
    """A computed case."""

    case: Case
    run: Trajectory
    ds: xr.Dataset
    """Its last `SETTLED` forcing periods, or all periods of a run."""
    kind: str
    """One of `slipperjax.analysis.kinds.KINDS`, or "run"."""
    period: int
    """Forcing periods after which the motion recurs; 0 for other motions."""

    @property
    def unit(self) -> float:
        """Unit of time axes: 1 for forcing periods; for a run a period's length [m], so that axes show distance."""
        return 1.0 if self.case.window is None else _wavelength(self.case.scene)


@dataclass
class Session:
    """All contents of a page, and their computation."""

    views: list[View]
    """The given view, and boxes of it, each inside the previous one; the last view is shown."""
    case: Case
    shown: Shown | None = None

    @classmethod
    def of(
        cls, source: Source | None = None, grid: Mapping[str, Numbers] | None = None, *, start: Start = None
    ) -> "Session":
        """Return a session whose view is of a scene, a dataset, a file or a store.

        **Raises:** `ValueError` for another source, or a wrong `grid`; `OSError` for files that cannot be read.
        """
        start = None if start is None else first_of(start)
        require(grid is None or isinstance(grid, Mapping), "grid", "name parameters with their values", grid)
        path = None
        if isinstance(source, str | Path):
            path = user_path(source).resolve()
            need = "be a store, a netCDF file or a scene's TOML file of slipperjax"
            there = path.suffix != ".zarr" or path.is_dir()
            require(there, "source", need, shown=f"{path}, which is not there")
            found = load(path)
            if isinstance(found, Result):
                source = _with_statuses(found.ds)
            else:
                source = found.scene
                start = start or found.start
        ds = xr.Dataset()
        if source is None or isinstance(source, Scene):
            scene = paper_scene() if source is None else source
        else:
            ds = load(source).ds
            scene, of_ds = load_base(ds)
            start = start or of_ds
        # a dataset that varies nothing is the source of a scene
        if ds.attrs and grid is None and (varied_names(ds) or "distance" in ds.dims):
            view = View(scene, start, ds, source=path)
            _check_drawable(view)
        else:
            check_steady(scene)
            # 400 cases over speed and clearance
            if grid is None:
                grid = {"clearance": np.linspace(2e-4, 4e-3, 16), "speed": np.linspace(200.0, 2500.0, 25)}
            grid = {name: np.asarray(parameter(name, scene).check(values)) for name, values in grid.items()}
            require(len(grid) in COMPUTED, "grid", "have one or two parameters", list(grid))
            view = View(scene, start, grid=grid)
            _cases(view)  # to check the arguments
        session = cls([view], Case(scene, start))
        # the window with the highest force, if forces are known
        if view.is_run:
            name = main_peak(ds)
            place = 0.0 if name is None else float(peak_of(ds, name)[PEAKS[name].place])
            session.case = session.case_at(session.nearest(place))
        return session

    @property
    def view(self) -> View:
        """The view on the left."""
        return self.views[-1]

    # --- the map ----------------------------------------------------------------------------------------------------

    def box(self, *ends: tuple[float, float]) -> View | None:
        """Return a finer view of a box; None where it is too small.

        **Arguments:** `ends`: of the box's sides along `view.names` [SI units].
        """
        view = self.view
        counts = (200,) if len(view.names) == 1 else (16, 25)
        grid = {}
        # each side of the box, within the map
        for name, pair, count in zip(view.names, ends, counts, strict=True):
            values = view.axis(name)
            low, high = map(float, np.clip(sorted(pair), values.min(), values.max()))
            finer = np.linspace(low, high, count)
            # whole numbers, such as seeds, have no values between
            if view.quantity(name).whole:
                finer = np.arange(math.ceil(low), math.floor(high) + 1.0)
            if len(finer) < 2 or not finer[-1] - finer[0] > 1e-6 * np.ptp(values):
                return None
            grid[name] = finer
        return View(view.scene, view.start, grid=grid)

    def compute(self, view: View) -> Iterator[tuple[View, float]]:
        """Yield the view with the cases computed so far, and their share of all, after each 80 cases."""
        cases = _cases(view)
        # cases with the same steps together, as one batch
        order = np.argsort(-cases.default_steps(), kind="stable")
        pieces = []
        # each piece is shown before the next piece begins
        for first in range(0, len(order), 80):
            part = np.unravel_index(order[first : first + 80], cases.shape)
            values = cases.part(part)
            pieces.append(sweep(view.scene, values, product=False, **sweep_options(view), chunk=40).ds)
            done = min(first + 80, len(order))
            ds = _on_grid(pieces, order[:done], cases)
            yield dataclasses.replace(view, ds=ds), done / len(order)

    def refreshed(self) -> bool:
        """Read the present state of a growing store; return whether anything is new."""
        view = self.view
        if not view.growing:
            return False
        ds = _with_statuses(load(view.source).ds)
        # the status of a case changes when it is computed
        if np.array_equal(ds["status"].values, view.ds["status"].values):
            return False
        self.views[-1] = dataclasses.replace(view, ds=ds)
        return True

    # --- runs -------------------------------------------------------------------------------------------------------

    @property
    def run(self) -> xr.Dataset:
        """The run, whose windows are the cases."""
        return self.view.ds

    @property
    def run_options(self) -> dict[str, object]:
        """Arguments with which the run was made: window, records and solver."""
        call = load_call(self.run)
        options = {name: call[name] for name in ("record", "solver") if call.get(name) is not None}
        return {"window": float(self.run.attrs["window [m]"]), **options}

    def last_state(self, distance: float) -> tuple[float, float]:
        """Return the last place up to a distance where the run stored its state, and the window's beginning [m]."""
        edges = edges_of(self.run, "distance")
        limit = max(distance, edges[0]) + 1e-6
        # where the run begins, and the ends of its stretches
        places = np.array([edges[0], *self.run["stretch"].values])
        kept = places[places <= limit].max()
        begin = edges[edges <= limit].max()
        return float(kept), float(begin)

    def state_at(self, distance: float) -> xr.Dataset | Start:
        """Return the start of a simulation from the beginning of the window at a distance [m]: a run to this place,
        or the run's own start."""
        kept, begin = self.last_state(distance)
        start = self.run if kept in self.run["stretch"] else start_of(self.run)
        # the run stored its state there; otherwise the run is repeated up to the window
        if begin == kept:
            return start
        return run_along(self.view.scene, length=begin - kept, begin=kept, start=start, **self.run_options).ds

    def passage(self, case: Case) -> tuple[Scene, int, float]:
        """Return what to simulate to see a window at the end: scene, forcing periods, and their beginning [m]."""
        assert case.window is not None
        low, high = case.window
        scene = case.scene
        wave = _wavelength(scene)
        # at least one wavelength, with the window at its end
        periods = max(1, math.ceil((high - self.last_state(low)[1]) / wave - 1e-6))
        kept, begin = self.last_state(high - periods * wave + self.run.attrs["window [m]"] - 2e-6)
        if scene.wear is not None:  # too little to matter within a window
            play = self.run["play"].sel(stretch=kept).values if kept in self.run["stretch"] else scene.play
            scene = dataclasses.replace(scene, wear=None).with_play(jnp.asarray(play))
        return scene, periods, begin

    # --- the case ---------------------------------------------------------------------------------------------------

    def nearest(self, *place: float) -> dict[str, int]:
        """Return indices by dimension of the case nearest to a place along `view.names` [SI units]."""
        index = {}
        for name, at in zip(self.view.names, place, strict=True):
            index[name] = int(np.argmin(np.abs(self.view.axis(name) - at)))
        return index

    def case_at(self, index: Mapping[str, int]) -> Case:
        """Return the case at a place of the map."""
        view = self.view
        if view.is_run:
            low, high = map(float, edges_of(view.ds, "distance")[index["distance"] :][:2])
            # integration steps of the window for a forcing period
            per_metre = self.run["steps_per_window"].values[index["distance"]] / self.run.attrs["window [m]"]
            steps = math.ceil(per_metre * _wavelength(view.scene))
            return Case(view.scene, view.start, steps, load_call(self.run).get("solver"), (low, high))
        scene = view.scene
        for name in view.names:
            scene = scene.replace(**{name: float(view.axis(name)[index[name]])})
        if view.grid:
            return Case(scene, view.start)
        # a given result keeps its own steps and solver
        solver = load_call(view.ds).get("solver")
        steps = int(view.ds["steps_per_period"].isel(index).max()) if "steps_per_period" in view.ds else 0
        return Case(scene, view.start, steps or None, solver)

    def place(self) -> list[float]:
        """Return the place of the shown case on the map, along `view.names` [SI units]."""
        case = self.case
        if case.window is not None:
            return [float(np.mean(case.window))]
        return [float(parameter(name, case.scene).of(case.scene)) for name in self.view.names]

    def look(self, case: Case) -> Iterator[Shown]:
        """Yield the motion of a case when it is computed."""
        if case.window is not None:
            scene, periods, begin = self.passage(case)
            options = case.options | {"start": self.state_at(begin), "begin": begin, "saves_per_period": case.steps}
            run = simulate(scene, periods, **options)
            yield Shown(case, run, run.ds, "run", 0)
            return
        run = simulate(case.scene, PERIODS, start=case.start, saves_per_period=case.saves, **case.options)
        every = len(run.period) // PERIODS  # saves per period
        ds = run.ds.isel(time=slice(-SETTLED * every - 1, None))
        # a lost motion has no kind
        kind, period = "unresolved", 0
        if int(run.status) == Status.FINITE:
            strobe = np.stack([ds[name].values[::every] for name in COORDINATES], axis=-1)
            found = classify(strobe, scales=COORDINATE_SCALES, floor=FLOOR)
            kind, period = str(found.kind), int(found.period)
        yield Shown(case, run, ds, kind, period)


def sweep_options(view: View) -> dict[str, object]:
    """Return arguments of `slipperjax.sweep` for a view."""
    options = COMPUTED[len(view.names)]
    return options if view.start is None else options | {"start": view.start}


def _cases(view: View) -> Cases:
    return Cases(view.scene, view.grid, view.start or table_2_start())


def _wavelength(scene: Scene) -> float:
    return float(np.max(np.asarray(scene.wavelength)))


def _with_statuses(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset of a store or a file, with statuses in memory."""
    return ds.assign(status=ds["status"].load()) if "status" in ds else ds


def _check_drawable(view: View) -> None:
    """Raise `ValueError` unless a dataset is one run, or a grid of one or two parameters of the scene."""
    dims = ", ".join(map(str, view.ds["status"].dims)) if "status" in view.ds else "no cases"
    if view.is_run:
        require(not dims, "source", "be one run, as is ds.isel(...)", shown=f"over {dims}")
        return
    names = view.names
    good = len(names) in COMPUTED and "status" in view.ds and set(names) <= set(view.ds["status"].dims)
    require(good, "source", "be a sweep over one or two parameters", shown=f"over {dims}")
    for name in names:
        parameter(name, view.scene)
    check_steady(view.scene)


def _on_grid(pieces: list[xr.Dataset], places: np.ndarray, cases: Cases) -> xr.Dataset:
    """Return computed cases as a dataset over the whole grid; all other cases are marked as not run.

    **Arguments:** `places`: numbers of the cases in the grid, the last parameter fastest.
    """
    # the number of crossings differs between pieces
    numbered = [ds.assign_coords(crossing=np.arange(ds.sizes.get("crossing", 0))) for ds in pieces]
    together = xr.concat(numbered, "case", join="outer").drop_vars([*cases.dims, "crossing"])
    # values of missing cases; NaN for numbers
    missing = {"status": int(Status.NOT_RUN), "kind": "", "period": 0, "steps_per_period": 0}
    fill = {name: missing.get(str(name), np.nan) for name in together}
    whole = together.assign_coords(case=places).reindex(case=np.arange(cases.count), fill_value=fill)
    # from numbers to the axes of the grid
    index = pd.MultiIndex.from_product(list(cases.axes.values()), names=cases.dims)
    coordinates = xr.Coordinates.from_pandas_multiindex(index, "case")
    return whole.assign_coords(coordinates).unstack("case").reindex(cases.axes).assign_coords(cases.coordinates())
