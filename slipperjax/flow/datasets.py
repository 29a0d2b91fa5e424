"""Names, units and descriptions of outputs, and results as labelled xarray datasets."""

from typing import Any

import numpy as np
import xarray as xr

from .scene import PARAMETERS, Scene

OUTPUTS = {
    "y": ("m", "lateral displacement"),
    "z": ("m", "vertical displacement"),
    "roll": ("rad", "roll angle"),
    "pitch": ("rad", "pitch angle"),
    "yaw": ("rad", "yaw angle"),
    "v_y": ("m/s", "lateral velocity"),
    "v_z": ("m/s", "vertical velocity"),
    "w_x": ("rad/s", "roll rate, slipper frame"),
    "w_y": ("rad/s", "pitch rate, slipper frame"),
    "w_z": ("rad/s", "yaw rate, slipper frame"),
}
"""Unit and description of the slipper's coordinates and velocities."""

ACCELERATIONS = {
    "a_y": ("m/s^2", "lateral acceleration"),
    "a_z": ("m/s^2", "vertical acceleration"),
    "alpha_x": ("rad/s^2", "roll acceleration, slipper frame"),
    "alpha_y": ("rad/s^2", "pitch acceleration, slipper frame"),
    "alpha_z": ("rad/s^2", "yaw acceleration, slipper frame"),
}
"""Unit and description of the accelerations."""


def attributes(unit: str, long_name: str) -> dict[str, str]:
    """xarray attributes that name unit and quantity."""
    return {"units": unit, "long_name": long_name}


def scene_attributes(scene: Scene) -> dict[str, Any]:
    """The scene's parameters, as attributes of a dataset; those with several values are left to coordinates."""
    out: dict[str, Any] = {
        "contact_law": type(scene.contact).__name__,
        "contact_memory": type(scene.memory).__name__,
    }
    for name, (unit, _, _) in PARAMETERS.items():
        try:
            value = np.asarray(scene.value(name))
        except (ValueError, AttributeError):
            continue
        if value.ndim == 0:
            out[name if unit == "1" else f"{name} [{unit}]"] = float(value)
    wavelengths = np.atleast_1d(getattr(scene.track, "wavelengths", scene.track.wavelength))
    out["wavelengths [m]"] = wavelengths.astype(float)
    return out


def trajectory_dataset(trajectory: Any) -> xr.Dataset:
    """A trajectory as a dataset.

    Dimensions time, end (front, rear) and point (A..J); variables y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z,
    a_y, a_z, alpha_x, alpha_y, alpha_z, contact_force, gap and drive_force; coordinates time [s] and period
    [forcing periods].
    """
    scene, m = trajectory.scene, trajectory.state.motion
    values = dict(zip(("roll", "pitch", "yaw"), trajectory.euler_angles, strict=True))
    reactions = trajectory.reactions
    data: dict[str, Any] = {
        name: ("time", np.asarray(values[name] if name in values else getattr(m, name)), attributes(*label))
        for name, label in OUTPUTS.items()
    }
    acceleration = np.asarray(reactions.acceleration)
    for k, (name, label) in enumerate(ACCELERATIONS.items()):
        data[name] = ("time", acceleration[:, k], attributes(*label))
    at_points = ("time", "end", "point")
    data["contact_force"] = (
        at_points,
        np.asarray(reactions.contact_force),
        attributes("N", "normal contact force on the slipper"),
    )
    data["gap"] = (at_points, np.asarray(reactions.gap), attributes("m", "gap, negative where penetrating"))
    data["drive_force"] = (
        "time",
        np.asarray(reactions.drive_force),
        attributes("N", "force along x that keeps the speed constant"),
    )
    coords = {
        "time": ("time", np.asarray(trajectory.time), attributes("s", "time")),
        "period": ("time", np.asarray(trajectory.period), attributes("1", "time in forcing periods")),
        "end": ["front", "rear"],
        "point": list(scene.section.names),
    }
    attrs = scene_attributes(scene) | {
        "steps_per_period": trajectory.steps_per_period,
        "status": int(trajectory.status),
    }
    return xr.Dataset(data, coords, attrs)
