"""The system of Dang et al. 2024, doi:10.1115/1.4065629: its section, scene and start."""

import math
from collections.abc import Sequence

from ..tools.types import Real
from .contact import AbstractMemory, Flores
from .kinematics import Motion
from .parameters import PARAMETERS, half_play
from .scene import Scene
from .section import Section
from .slipper import Slipper
from .tracks import HarmonicTrack

# Table 1: y (left) and z (up) of the points A to J in the slipper's frame [m]
_TABLE_1 = (
    (0.03, 0.013),
    (0.048, 0.0055),
    (0.048, -0.0145),
    (0.0445, -0.0249),
    (0.029, -0.029),
    (-0.029, -0.029),
    (-0.0445, -0.0249),
    (-0.048, -0.0145),
    (-0.048, 0.0055),
    (-0.03, 0.013),
)


def paper_section(clearance: Real) -> Section:
    """Return the section of Table 1 with a total play of `clearance` [m], half of it per face.

    **Raises:** `ValueError` for a negative clearance.
    """
    clearance = PARAMETERS["clearance"].check(clearance)
    # an array of clearances would give a batch of sections
    if clearance.ndim:
        raise ValueError(f"Argument `clearance` must be of shape (), but has shape {clearance.shape}.")
    return Section(points=_TABLE_1, play=half_play(clearance, 5))


def paper_scene(
    speed: Real = 1250.0,
    clearance: Real = 1e-3,
    length: Real = 0.2,
    *,
    stiffness: Real = 1e8,
    restitution: Real = 0.9,
    wavelengths: Sequence[float] = (8.0,),
    amplitude: Real = 1e-3,
    roll_amplitude: Real = math.radians(0.2),
    clamp: bool = True,
    memory: AbstractMemory | None = None,
) -> Scene:
    """Return the system of Dang et al. 2024, Tables 1 to 3.

    **Arguments:**

    - `speed`: travelling speed V [m/s].
    - `clearance`: total play C of slipper and rail [m]; each face has half of it.
    - `length`: slipper length L_S [m].
    - `stiffness`: contact stiffness K [N/m^1.5]. `restitution`: coefficient c_r [1].
    - `wavelengths`: one or more wavelengths L_X of the irregularity [m].
    - `amplitude`, `roll_amplitude`: amplitudes of the irregularity [m] and [rad].
    - `clamp`: whether forces are limited to F >= 0. `memory`: model of the contact memory, see `Scene.memory`.

    **Returns:** a `Scene`.

    **Raises:** `ValueError` that names the argument out of range.
    """
    return Scene(
        speed=speed,
        slipper=Slipper(mass=14.0, inertia=(0.051, 0.060, 0.086), length=length),
        section=paper_section(clearance),
        track=HarmonicTrack(wavelengths, amplitude, roll_amplitude),
        contact=Flores(stiffness, restitution, clamp),
        memory=memory,
    )


def table_2_start() -> Motion:
    """Return the start of Table 2: centred, velocities of 0.5 m/s along y and z, spins of 0.2, 0.3 and 0.4 rad/s."""
    return Motion(v_y=0.5, v_z=0.5, w_x=0.2, w_y=0.3, w_z=0.4)
