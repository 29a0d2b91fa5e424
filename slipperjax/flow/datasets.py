"""Results as labelled datasets of xarray, and from datasets the scene, the start and the call of a result."""

import functools
import importlib.metadata
import json
import platform
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import diffrax
import jax
import jax.numpy as jnp
import lineax
import numpy as np
import optimistix

from ..model.beam import RailState
from ..model.dynamics import State
from ..model.kinematics import ModalMotion, Motion, PayloadMotion
from ..model.layout import coordinates
from ..model.parameters import PARAMETERS, STARTS, PlayAlong, check_units, of_motion, parameter
from ..model.quantities import LOADS, ShownUnits
from ..model.scene import Scene
from ..model.scene_files import scene_from_json, scene_to_json
from ..model.sensors import Sensor
from ..model.travel import SpeedProgramme
from ..tools.checks import finite, known, require
from ..tools.columns import column
from ..tools.compile import jit
from ..tools.description import build, describe
from ..tools.files import check_file, readable
from .course import over_periods
from .record import AbstractOutput, History, HistoryValues
from .status import MEANINGS

if TYPE_CHECKING:
    import xarray as xr

READ_AT_ONCE = 1e8
"""Largest dataset that is read from a file at once [bytes]."""
SCENE_NUMBER = "scene_number"
"""Coordinate of a checksum of the scene in a result's attributes."""


@functools.cache
def versions() -> dict[str, str]:
    """Return versions of slipperjax, of the packages that it computes with, and of Python."""
    numbers = {"python": platform.python_version()}
    for name in ("slipperjax", "jax", "jaxlib", "diffrax", "equinox", "numpy"):
        # a copy of the sources that is not installed has no version
        try:
            numbers[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            numbers[name] = "unknown"
    return numbers


def run_attributes(
    scene: Scene,
    start: Motion | State,
    call: Mapping[str, object],
    varied: Iterable[str] = (),
) -> dict[str, str]:
    """Return the attributes of a dataset, each JSON, that `scene_of`, `start_of` and `load_call` read.

    **Arguments:** `call`: the name of the function as `function`, and its arguments; `varied`: names of the
    coordinates whose values differ between cases.
    """
    return {
        "scene": scene_to_json(scene),
        "start": json.dumps(describe(start)),
        "varied": json.dumps(list(varied)),
        "call": json.dumps(describe(dict(call))),
        "versions": json.dumps(versions()),
    }


def result_dataset(data: Mapping[str, Any], coords: Mapping[str, Any], attrs: Mapping[str, Any]) -> "xr.Dataset":
    """Return a dataset with the attributes of `run_attributes`, and a number of their scene at each case.

    Joined datasets have the attributes of the first dataset, but the numbers stay with their cases.
    """
    import xarray as xr  # here, because importing it takes longer than a small simulation

    ds = xr.Dataset(data, coords, attrs)
    sizes = ds[json.loads(attrs["varied"])].sizes
    number = np.full(tuple(sizes.values()), _scene_number(ds))
    return ds.assign_coords({SCENE_NUMBER: column(tuple(sizes), number, "", "checksum of the scene")})


def has_one_scene(ds: "xr.Dataset") -> bool:
    """Return whether the attributes of a result are valid for all its cases, as they are not after a join."""
    if SCENE_NUMBER not in ds.coords:
        return True
    numbers = ds[SCENE_NUMBER].values
    # cases that a join or a store has left empty have no number
    return bool(np.isin(numbers[~np.isnan(numbers)], _scene_number(ds)).all())


def _scene_number(ds: "xr.Dataset") -> float:
    """Return a number of the scene in a result's attributes; a float, because it may be missing."""
    return float(zlib.crc32(str(ds.attrs.get("scene")).encode()))


def scene_attributes(scene: Scene, without: Collection[str] = ()) -> dict[str, object]:
    """Return the scene's parameters as attributes of a dataset, with units in their names.

    **Arguments:** `without`: names and paths of parameters that are coordinates of the dataset. Parameters that
    depend on these are left out, such as the clearance where section.play.2 varies, and so are parameters with
    several values.
    """
    # parameters that depend on a varied number become NaN, and are left out below
    for name in without:
        if name not in STARTS:
            scene = parameter(name, scene).replaced(scene, np.nan)
    out: dict[str, object] = {
        "contact_law": type(scene.contact).__name__,
        "contact_memory": type(scene.contact_memory).__name__,
    }
    for q in PARAMETERS.values():
        # a clearance states the plays along both axes, too
        if isinstance(q, PlayAlong) and "clearance [m]" in out:
            continue
        value = q.stated(scene)
        if value is not None and np.ndim(value) == 0 and not np.isnan(value):
            out[q.attribute] = float(value)
    name = "wavelengths"
    # a rail that is no sum of waves has one wavelength, the length of a forcing period
    lengths = getattr(scene.track, name, None)
    if lengths is None:
        out["track"] = type(scene.track).__name__
        name = "wavelength"
        lengths = scene.wavelength
    lengths = np.atleast_1d(np.asarray(lengths, float))
    if not np.isnan(lengths).any():
        out[f"{name} [m]"] = lengths
    return out


_over_periods = jit(over_periods)


def trajectory_dataset(trajectory: Any) -> "xr.Dataset":
    """Return a `Trajectory` as an `xarray.Dataset`.

    - Dimensions: time, for a sled also slipper (with the mounts' names), end (front, rear) and point (A..J).
    - Coordinates: time [s] and period [forcing periods].
    - Variables over time: y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z, a_y, a_z, alpha_x, alpha_y, alpha_z,
        drive_force, and at each end and point contact_force and gap.
    - Variables of the whole run, at each end and point: peak_force, peak_period, impulse, contact_fraction and
        penetration.
    """
    known("trajectory", trajectory)
    # like the record of a sweep's history, which has the same variables
    now = trajectory.reactions
    parts = trajectory.period, now.acceleration, now.contact_force, now.gap, now.drive_force
    history = HistoryValues(coordinates(trajectory.state), *map(np.asarray, parts))
    data, coords = History().label(trajectory.scene, (), history)
    coords = {"time": column("time", np.asarray(trajectory.time), "s", "time"), **coords}
    start = jax.tree.map(lambda a: np.asarray(a)[0], trajectory.state)
    call = {"function": "simulate", **json.loads(trajectory.call)}
    attrs = scene_attributes(trajectory.scene) | run_attributes(trajectory.scene, start, call)
    attrs |= {
        "steps_per_period": int(trajectory.steps_per_period),
        "status": int(trajectory.status),
        "status_meaning": MEANINGS,
    }
    if trajectory.loads is not None:
        # of the whole run: periods are weighted by their duration, which differs where the speed changes
        saves = (len(trajectory.period) - 1) // len(trajectory.steps_taken)
        total = _over_periods(trajectory.loads, jnp.diff(trajectory.time[::saves]))
        dims = tuple(trajectory.scene.point_labels)
        for name, q in LOADS.items():
            data[name] = column(dims, np.asarray(getattr(total, name)), q.unit, q.long_name)
    if trajectory.probe is not None:
        attrs["probe_error [scales]"] = float(np.max(trajectory.probe.error))
        attrs["probe_peak_error"] = float(np.max(trajectory.probe.peak_error))
    return result_dataset(data, coords, attrs)


def scene_of(ds: "xr.Dataset") -> Scene:
    """Return the scene of a result of one case, exactly as it was.

    **Raises:** `ValueError` where the dataset has no scene, or several.
    """
    scene, _ = load_base(ds)
    values = _case_of(ds, of_start=False)
    return scene.replace(**values) if values else scene


def start_of(ds: "xr.Dataset") -> Motion | State:
    """Return the start of a result of one case; raises as `scene_of`."""
    _, start = load_base(ds)
    motion = start.motion if isinstance(start, State) else start
    # varied values replace the start's numbers that all cases have in common
    motion = replace(motion, **of_motion(_case_of(ds, of_start=True)))
    return replace(start, motion=motion) if isinstance(start, State) else motion


def named_parameters(attributes: Mapping[str, Any], units: ShownUnits = ShownUnits()) -> dict[str, str]:
    """Return texts such as "clearance 1 mm" by parameter, from `scene_attributes` or those of a dataset."""
    known = {name: q for name, q in PARAMETERS.items() if q.attribute in attributes}
    return {name: units.of(q).named(attributes[q.attribute]) for name, q in known.items()}


def sources_of(ds: "xr.Dataset") -> list[str]:
    """Return texts on the files that the scene of a result was made from: part, file and digest."""
    numbers = dict(flattened(json.loads(ds.attrs.get("scene", "{}"))))
    found = []
    for path, value in numbers.items():
        part, _, name = path.rpartition(".")
        if name == "file" and value:
            found.append(f"{part} from {value}, sha256 {numbers.get(f'{part}.sha256', 'unknown')}")
        if name == "source" and value:
            found.append(f"{part} from {value}")
    return found


def flattened(value: object, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers, lists of numbers and texts of a description of a scene, by their paths."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from flattened(part, f"{path}.{name}" if path else str(name))
    elif isinstance(value, list) and any(isinstance(part, dict | list) for part in value):
        for k, part in enumerate(value):
            yield from flattened(part, f"{path}.{k}")
    else:
        yield path, value


def load_base(ds: "xr.Dataset") -> tuple[Scene, Motion | State]:
    """Return the scene and the start of a result, without varied values; raises as `scene_of`."""
    # a clear error where the attribute is missing or not JSON
    _described(ds, "scene")
    need = "be of one scene: these are joined from several, and only the first's is known"
    require(has_one_scene(ds), "source", need, shown="of several")
    try:
        scene = scene_from_json(ds.attrs["scene"])
    except OSError as error:
        asked = ds.encoding.get("source", "the result")
        raise type(error)(f"{asked} was made with a file that cannot be read now: {error}") from None
    description = _described(ds, "start")
    # the description of a motion, or of a state with its memory
    of_motion = description.get("motion", description)
    motion = build(of_motion, (Motion, PayloadMotion, ModalMotion), "start")
    if of_motion is description:
        return scene, motion
    memory = finite("start.memory", optional=True)(description.get("memory"))
    return scene, State(motion, memory, _rails(description.get("rail")))


def _rails(description: Mapping[str, Any] | None) -> RailState | None:
    """Return the rails of a described state; None for rigid rails."""
    if description is None:
        return None
    parts = {name: finite(f"start.rail.{name}")(description.get(name)) for name in ("deflection", "rate", "waves")}
    return RailState(parts["deflection"], parts["rate"], tuple(parts["waves"]))


def function_of(ds: "xr.Dataset") -> str:
    """Return the name of the function that made a result."""
    return str(_described(ds, "call").get("function"))


def load_call(ds: "xr.Dataset") -> dict[str, Any]:
    """Return the call that made a result: the function's name as `function`, and its arguments by name.

    Scene, grid and start are not included.

    **Raises:** `ValueError` where a solver, controller or record cannot be rebuilt.
    """
    call = _described(ds, "call")
    kinds = (
        diffrax.AbstractSolver,
        diffrax.AbstractStepSizeController,
        diffrax.AbstractAdjoint,
        optimistix.AbstractRootFinder,
        lineax.AbstractLinearSolver,
        Motion,
        SpeedProgramme,
        Sensor,
        AbstractOutput,
    )
    return {name: build(value, kinds, name) for name, value in call.items()}


def read_dataset(path: Path) -> "xr.Dataset":
    """Return the dataset of a netCDF file; if larger than `READ_AT_ONCE`, variables are read when they are used.

    **Raises:** `ValueError` for a file of another kind; `OSError` for a file that cannot be read.
    """
    import xarray as xr

    check_file(path)
    with readable(path, "TOML file or netCDF file"):
        ds = xr.open_dataset(path, engine="h5netcdf")
        if ds.nbytes > READ_AT_ONCE:
            return ds
        with ds:
            return ds.load()


def _described(ds: "xr.Dataset", name: str, kind: type = dict) -> Any:
    """Return the value of an attribute in JSON; raises `ValueError` where it is missing or not of the kind `kind`."""
    text = ds.attrs.get(name)
    lacks = f"a dataset with no attribute `{name}`"
    require(text is not None, "source", "be a result of slipperjax", shown=lacks)
    found = None
    # attributes of other files may hold anything
    with suppress(ValueError, RecursionError, TypeError):
        found = json.loads(text)
    require(isinstance(found, kind), "source", f"have JSON in its attribute `{name}`", text)
    return found


def varied_names(ds: "xr.Dataset") -> list[str]:
    """Return the names of the varied coordinates; raises `ValueError` where one is missing in the dataset, or has
    another unit."""
    names = _described(ds, "varied", list)
    check_units(ds, "source")
    for name in names:
        need = f"have the coordinate `{name}`, which was varied"
        # in a list, because names in other files may be of a type that no mapping accepts
        require(name in list(ds.coords), "source", need, shown="none")
    return names


def _case_of(ds: "xr.Dataset", of_start: bool) -> dict[str, float]:
    """Return the varied values of the one case of a result, of its start or of its scene."""
    values = {}
    for name in varied_names(ds):
        if (name in STARTS) == of_start:
            count = ds[name].size
            need = "have one value"
            require(count == 1, name, need, shown=f"{count}: select a case, as by .isel({name}=0)")
            values[name] = ds[name].item()
    return values
