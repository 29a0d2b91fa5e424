"""Results as labelled xarray datasets, with the scene, the start, the call and the versions as attributes."""

import functools
import importlib.metadata
import json
import platform
from collections.abc import Collection, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import coordinates
from ..model.paths import parameter
from ..model.quantities import LOADS, PARAMETERS, STARTS
from ..model.scene import Scene
from ..model.scene_files import scene_to_json
from ..tools.compile import jit
from ..tools.description import build, describe
from .course import over_periods
from .record import attributes
from .series import History, HistoryValues
from .status import MEANINGS


@functools.cache
def versions() -> dict[str, str]:
    """Returns versions of slipperjax, of the packages it computes with, and of Python."""
    numbers = {"python": platform.python_version()}
    for name in ("slipperjax", "jax", "jaxlib", "diffrax", "equinox", "numpy"):
        try:
            numbers[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            numbers[name] = "unknown"
    return numbers


def run_attributes(scene: Scene, start: Motion | State, call: Mapping[str, Any], varied: Any = ()) -> dict[str, str]:
    """Returns attributes, JSON each, from which `load_scene`, `load_start` and `load_call` read.

    **Arguments:** `call`: the function's name as `function`, and its arguments; `varied`: names of the coordinates
    that hold what differs between cases.
    """
    return {
        "scene": scene_to_json(scene),
        "start": json.dumps(describe(start)),
        "varied": json.dumps(list(varied)),
        "call": json.dumps(describe(dict(call))),
        "versions": json.dumps(versions()),
    }


def start_from_json(text: str) -> Motion | State:
    """Returns the start of an attribute of `run_attributes`."""
    description = json.loads(text)
    if "motion" not in description:
        return build(description, (Motion,), "start")
    memory = description["memory"]
    motion = build(description["motion"], (Motion,), "start")
    return State(motion, None if memory is None else jnp.asarray(memory))


def scene_attributes(scene: Scene, without: Collection[str] = ()) -> dict[str, Any]:
    """Returns the scene's parameters, as attributes of a dataset.

    **Arguments:** `without`: names and paths of parameters which a dataset has as coordinates. All that depend on
    them are left out, as the clearance where section.play.2 is varied, and so are those with several values.
    """
    for p in (parameter(name, scene) for name in without if name not in STARTS):
        scene = p.replaced(scene, np.nan)
    parts = {"contact_law": scene.contact, "contact_memory": scene.memory}
    out: dict[str, Any] = {name: type(part).__name__ for name, part in parts.items()}
    for name, q in PARAMETERS.items():
        value = q.of(scene)
        if value is not None and np.ndim(value) == 0 and not np.isnan(value):
            out[name if q.unit == "1" else f"{name} [{q.unit}]"] = float(value)
    wavelengths = np.atleast_1d(getattr(scene.track, "wavelengths", scene.track.wavelength)).astype(float)
    if not np.isnan(wavelengths).any():
        out["wavelengths [m]"] = wavelengths
    return out


def open_result(path: Any) -> Any:
    """Returns a result's netCDF file or zarr store, opened.

    **Raises:** `ValueError` for a file that is none; `OSError` where it cannot be read.
    """
    import xarray as xr

    if (path / "zarr.json").is_file():
        return xr.open_zarr(path, consolidated=False, chunks=None, zarr_format=3)
    if not path.is_file():
        raise FileNotFoundError(f"No such file: {path}")
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{path}: must be a TOML file or a netCDF file of slipperjax, but is neither: {error}"
        ) from None


_over_periods = jit(over_periods)


def trajectory_dataset(trajectory: Any) -> Any:
    """Returns a `Trajectory` as an `xarray.Dataset`.

    Dimensions time, end (front, rear) and point (A..J); variables y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z,
    a_y, a_z, alpha_x, alpha_y, alpha_z, contact_force, gap and drive_force, and over all steps of the run, by end and
    point, peak_force, peak_period, impulse, contact_fraction and penetration; coordinates time [s] and period
    [forcing periods].
    """
    import xarray as xr  # here, because importing it takes longer than a small simulation

    now = trajectory.reactions
    parts = trajectory.period, now.acceleration, now.contact_force, now.gap, now.drive_force
    history = HistoryValues(coordinates(trajectory.state), *map(np.asarray, parts))
    data, coords = History().label(trajectory.scene, (), history)
    coords = {"time": ("time", np.asarray(trajectory.time), attributes("s", "time")), **coords}
    start = jax.tree.map(lambda a: np.asarray(a)[0], trajectory.state)
    call = {"function": "simulate", **json.loads(trajectory.call)}
    attrs = scene_attributes(trajectory.scene) | run_attributes(trajectory.scene, start, call)
    attrs |= {"steps_per_period": int(trajectory.steps_per_period), "status": int(trajectory.status)}
    attrs["status_meaning"] = MEANINGS
    if trajectory.loads is not None:
        total = _over_periods(trajectory.loads)
        data |= {n: (("end", "point"), np.asarray(getattr(total, n)), q.attributes) for n, q in LOADS.items()}
    if trajectory.probe is not None:
        attrs["probe_error [scales]"] = float(np.max(trajectory.probe.error))
        attrs["probe_peak_error"] = float(np.max(trajectory.probe.peak_error))
    return xr.Dataset(data, coords, attrs)
