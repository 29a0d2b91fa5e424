"""Results as labelled xarray datasets with all that made them; scenes, starts and calls from datasets and files."""

import functools
import importlib.metadata
import json
import os
import platform
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import lineax
import numpy as np
import optimistix

from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import coordinates
from ..model.parameters import PARAMETERS, STARTS, parameter
from ..model.quantities import LOADS
from ..model.scene import Scene
from ..model.scene_files import SceneFile, scene_from_json, scene_from_toml, scene_to_json
from ..model.travel import SpeedProgramme
from ..tools.checks import brief, finite, known, number, require
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.description import build, describe
from ..tools.files import check_file, content_of, readable, user_path
from ..tools.limits import refuse_impossible
from .course import over_periods
from .record import AbstractRecord, History, HistoryValues
from .status import MEANINGS

SAME_VALUE = 1e-9
"""Relative difference up to which a value asked for is one of a dataset's."""


@functools.cache
def versions() -> dict[str, str]:
    """Return versions of slipperjax, of the packages it computes with, and of Python."""
    numbers = {"python": platform.python_version()}
    for name in ("slipperjax", "jax", "jaxlib", "diffrax", "equinox", "numpy"):
        try:
            numbers[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            numbers[name] = "unknown"
    return numbers


def run_attributes(scene: Scene, start: Motion | State, call: Mapping[str, Any], varied: Any = ()) -> dict[str, str]:
    """Return attributes, JSON each, from which `load_scene`, `load_start` and `load_call` read.

    **Arguments:** `call`: the function's name as `function`, and its arguments; `varied`: names of the coordinates
    that hold what differs between cases.
    """
    from ..tools import accessor  # noqa: F401  # which datasets then have; here, because it imports xarray

    return {
        "scene": scene_to_json(scene),
        "start": json.dumps(describe(start)),
        "varied": json.dumps(list(varied)),
        "call": json.dumps(describe(dict(call))),
        "versions": json.dumps(versions()),
    }


def scene_attributes(scene: Scene, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the scene's parameters, as attributes of a dataset.

    **Arguments:** `without`: names and paths of parameters which a dataset has as coordinates. All that depend on
    them are left out, as the clearance where section.play.2 is varied, and so are those with several values.
    """
    # what depends on a varied number becomes NaN, and is left out below
    for p in (parameter(name, scene) for name in without if name not in STARTS):
        scene = p.replaced(scene, np.nan)
    out: dict[str, Any] = {"contact_law": type(scene.contact).__name__, "contact_memory": type(scene.memory).__name__}
    for name, q in PARAMETERS.items():
        value = q.of(scene)
        if value is not None and np.ndim(value) == 0 and not np.isnan(value):
            out[name if q.unit == "1" else f"{name} [{q.unit}]"] = float(value)
    name = "wavelengths"
    lengths = getattr(scene.track, name, None)
    if lengths is None:
        out["track"] = type(scene.track).__name__
        name = "reference_length"
        lengths = scene.track.wavelength
    lengths = np.atleast_1d(np.asarray(lengths, float))
    if not np.isnan(lengths).any():
        out[f"{name} [m]"] = lengths
    return out


_over_periods = jit(over_periods)


def trajectory_dataset(trajectory: Any) -> Any:
    """Return a `Trajectory` as an `xarray.Dataset`.

    Dimensions time, end (front, rear) and point (A..J); variables y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z,
    a_y, a_z, alpha_x, alpha_y, alpha_z, contact_force, gap and drive_force, and over all steps of the run, by end and
    point, peak_force, peak_period, impulse, contact_fraction and penetration; coordinates time [s] and period
    [forcing periods].
    """
    import xarray as xr  # here, because importing it takes longer than a small simulation

    known("trajectory", trajectory)
    # as the record of a sweep's history, which has the same variables
    now = trajectory.reactions
    parts = trajectory.period, now.acceleration, now.contact_force, now.gap, now.drive_force
    history = HistoryValues(coordinates(trajectory.state), *map(np.asarray, parts))
    data, coords = History().label(trajectory.scene, (), history)
    coords = {"time": column("time", np.asarray(trajectory.time), "s", "time"), **coords}
    start = jax.tree.map(lambda a: np.asarray(a)[0], trajectory.state)
    call = {"function": "simulate", **json.loads(trajectory.call)}
    attrs = scene_attributes(trajectory.scene) | run_attributes(trajectory.scene, start, call)
    attrs |= {"steps_per_period": int(trajectory.steps_per_period), "status": int(trajectory.status)}
    attrs["status_meaning"] = MEANINGS
    if trajectory.loads is not None:
        # loads of the whole run, over periods that may differ in their duration
        saves = (len(trajectory.period) - 1) // len(trajectory.steps_taken)
        total = _over_periods(trajectory.loads, jnp.diff(trajectory.time[::saves]))
        for name, q in LOADS.items():
            data[name] = column(("end", "point"), np.asarray(getattr(total, name)), q.unit, q.long_name)
    if trajectory.probe is not None:
        attrs["probe_error [scales]"] = float(np.max(trajectory.probe.error))
        attrs["probe_peak_error"] = float(np.max(trajectory.probe.peak_error))
    return xr.Dataset(data, coords, attrs)


def load_scene(source: Any, **chosen: Any) -> Scene:
    """Return the scene of a TOML file, of a result's netCDF file, or of a dataset; exactly as it was.

    **Arguments:** `source`: a path or an `xarray.Dataset`. `chosen`: for a result of many cases, the values of what
    was varied, by name [SI units, or quantities], unless the dataset is of one case, as by `ds.isel(speed=3)`.

    **Raises:** `ValueError` where the source holds no scene, or several and none is chosen; `OSError` for a file that
    cannot be read.
    """
    file = _scene_file(source, chosen)
    if file is not None:
        return file.scene
    ds = _labels_of(source)
    scene, _ = load_base(ds)
    values = _varied(ds, chosen, of_start=False)
    return scene.replace(**values) if values else scene


def load_start(source: Any, **chosen: Any) -> Motion | State | None:
    """Return the start of a TOML file, a netCDF file or a dataset; None where a TOML file has none.

    **Arguments:** and **Raises:** as for `load_scene`.
    """
    file = _scene_file(source, chosen)
    if file is not None:
        return file.start
    ds = _labels_of(source)
    _, start = load_base(ds)
    values = {name.removeprefix("start_"): v for name, v in _varied(ds, chosen, of_start=True).items()}
    # what was varied replaces the numbers of the start that all cases have in common
    if isinstance(start, State):
        return State(type(start.motion)(**(vars(start.motion) | values)), start.memory)
    return type(start)(**(vars(start) | values))


def load_run(source: Any) -> dict[str, Any]:
    """Return the arguments of `run` in the table [run] of a TOML file, as in
    `sj.run(sj.load_scene(file), start=sj.load_start(file), **sj.load_run(file))`.

    **Raises:** `ValueError` where the file has no such table; `OSError` for a file that cannot be read.
    """
    file = _scene_file(source, {})
    if file is None or file.run is None:
        raise ValueError(f"Argument `source` must be a TOML file with a table [run], but is {brief(source)}.")
    return file.run


def load_base(source: Any) -> tuple[Scene, Motion | State]:
    """Return scene and start of which a result's cases are variations; raise `ValueError` as `load_scene`."""
    ds = _labels_of(source)
    scene = scene_from_json(str(_attribute(ds, "scene")))
    description = _described(ds, "start", dict)
    # the description of a motion, or of a state with its memory
    if "motion" not in description:
        return scene, build(description, (Motion,), "start")
    memory = description.get("memory")
    motion = build(description["motion"], (Motion,), "start")
    return scene, State(motion, None if memory is None else finite("start.memory")(memory))


def load_call(source: Any) -> dict[str, Any]:
    """Return the function that made a result, as `function`, and its arguments besides scene, grid and start.

    **Raises:** `ValueError` where a solver, controller or record cannot be rebuilt.
    """
    call = _described(_labels_of(source), "call", dict)
    kinds = (
        diffrax.AbstractSolver,
        diffrax.AbstractStepSizeController,
        diffrax.AbstractAdjoint,
        optimistix.AbstractRootFinder,
        lineax.AbstractLinearSolver,
        Motion,
        SpeedProgramme,
        AbstractRecord,
    )
    return {name: build(value, kinds, name) for name, value in call.items()}


def _scene_file(source: Any, chosen: Mapping[str, Any]) -> SceneFile | None:
    """Return what a TOML file holds; None for another source."""
    if not isinstance(source, str | os.PathLike) or Path(source).suffix.lower() != ".toml":
        return None
    try:
        text = content_of(user_path(source, "source")).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, but is not: {error}.") from None
    file = scene_from_toml(text, str(source))
    if chosen:
        raise ValueError(f"Argument `{next(iter(chosen))}` must not be given for a TOML file, which has one scene.")
    return file


def dataset_of(source: Any) -> Any:
    """Return a dataset as it is, or that of a netCDF file or a zarr store.

    **Raises:** `ValueError` for something else, or more than fits into memory; `OSError` for a file that cannot be
    read.
    """
    with _opened(source) as ds:
        if not (isinstance(source, str | os.PathLike) and user_path(source, "source").is_file()):
            return ds
        refuse_impossible(f"the variables of {source}", float(ds.nbytes), 0.0)
        with readable(source, "netCDF file"):
            return ds.load()


def _labels_of(source: Any) -> Any:
    """Return the attributes and coordinates of a result, which say its scenes, as a dataset."""
    with _opened(source) as ds:
        if ds is source:
            return ds
        with readable(source, "result"):
            return ds.drop_vars(list(ds.data_vars)).load()


@contextmanager
def _opened(source: Any) -> Iterator[Any]:
    """Give a dataset as it is, or that of a file or a store, of which nothing is read yet; see `dataset_of`."""
    import xarray as xr

    if not isinstance(source, str | os.PathLike):
        is_dataset = hasattr(source, "attrs") and hasattr(source, "coords")
        require(is_dataset, "source", "be a TOML or netCDF file, or a dataset of slipperjax", source)
        yield source
        return
    path = user_path(source, "source")
    if (path / "zarr.json").is_file():
        with readable(path, "zarr store"):
            ds = xr.open_zarr(path, consolidated=False, chunks=None, zarr_format=3)
        yield ds
        return
    require(not path.is_dir(), "source", "be a file or a store of slipperjax", shown=f"the folder {path}")
    check_file(path)
    try:
        ds = xr.open_dataset(path, engine="h5netcdf")
    except Exception as error:  # of damaged files of any class
        need = "must be a TOML file or a netCDF file of slipperjax"
        raise ValueError(f"{path}: {need}, but is neither: {' '.join(str(error).split())}") from None
    with ds:
        yield ds


def _described(ds: Any, name: str, kind: type) -> Any:
    """Return what an attribute describes in JSON; raises `ValueError` where that is of another kind."""
    text = _attribute(ds, name)
    found = None
    # attributes of other files may hold anything
    with suppress(json.JSONDecodeError, RecursionError, TypeError):
        found = json.loads(text)
    need = f"have JSON of {'names' if kind is list else 'values by name'} in its attribute `{name}`"
    require(isinstance(found, kind), "source", need, text)
    return found


def _attribute(ds: Any, name: str) -> Any:
    if name not in ds.attrs:
        raise ValueError(
            f"Argument `source` must be a result of slipperjax, but has no attribute `{name}`. Single variables and "
            f"results of calculations have none."
        )
    return ds.attrs[name]


def varied_names(ds: Any) -> list[str]:
    """Return names of the coordinates that were varied; raises `ValueError` where one of them is lost."""
    names = _described(ds, "varied", list)
    for name in names:
        if not isinstance(name, str) or name not in ds.coords:
            raise ValueError(
                f"Argument `source` must have the coordinate `{name}`, which was varied; without it the scene is "
                f"unknown."
            )
    return names


def _varied(ds: Any, chosen: Mapping[str, Any], of_start: bool) -> dict[str, float]:
    """Return the values of one case of what was varied of the start, or of the scene: chosen, or the dataset's own if
    it is of one case."""
    # one case is chosen by values, one after the other
    names = varied_names(ds)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ValueError(f"Argument `{unknown[0]}` must be one of what was varied, {', '.join(names) or 'nothing'}.")
    cases = ds.coords.to_dataset()[names]
    for name, value in chosen.items():
        values = np.asarray(cases[name].values, float)
        value = float(number(finite, name, value, cases[name].attrs.get("units", "")))
        hits = np.abs(values - value) <= SAME_VALUE * abs(value)
        if not np.any(hits):
            nearest = values.ravel()[np.argmin(np.abs(values.ravel() - value))]
            raise ValueError(
                f"Argument `{name}` must be one of the result's, but is {value:g}; nearest is {nearest:.10g}."
            )
        # of several names along one dimension, such as lists that were read side by side, the other ones, too
        cases = cases.isel({dim: np.flatnonzero(hits) for dim in cases[name].dims})
    columns = {name: cases[name].values.ravel() for name in names if name.startswith("start_") == of_start}
    for name, values in columns.items():
        if values.size != 1:
            raise ValueError(
                f"Argument `{name}` must be given, as the result has {values.size} values of it; or select a case, "
                f"as by ds.isel({name}=0)."
            )
    return {name: float(values[0]) for name, values in columns.items()}
