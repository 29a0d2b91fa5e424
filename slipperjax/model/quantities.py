"""Computed quantities: name, unit, symbol, scale and display unit of coordinates, accelerations, forces and loads.

Solvers, datasets, plots and the command line use this list; the module `parameters` has a scene's parameters.
"""

import functools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..tools.checks import brief, require
from ..tools.units import unit_factor

PER_SHOWN = {"": 1.0, "mm": 1e-3, "mrad": 1e-3, "degrees": np.pi / 180, "kN": 1e3, "kJ": 1e3}
"""How many SI units one display unit is, for pictures and the command line; pint knows other units."""
KINDS = {
    "m/s^2": "acceleration",
    "m": "length",
    "m/s": "speed",
    "N": "force",
    "N s": "impulse",
    "J": "energy",
    "kg": "mass",
    "s": "time",
    "N m": "moment",
    "kg m^2": "moment of inertia",
    "N/m^1.5": "contact stiffness",
}
"""Kinds of quantities whose unit users may choose, by SI unit; g is a unit of acceleration."""
IMPLIED = {"ft": ("ft/s", "in"), "lbf": ("ft lbf", "lbf s", "lb", "lb ft^2", "lbf/in^1.5")}
"""Units that are used together with others, unless units of these kinds are also given."""
LONG = 0.1
"""Length [m] from which a unit is for distances along the rail; smaller units are for displacements."""


@dataclass(frozen=True)
class Quantity:
    """A named physical quantity."""

    name: str
    unit: str
    """SI unit, "1" for pure numbers."""
    long_name: str
    """Description in a few words, for datasets and help texts."""
    symbol: str = ""
    """LaTeX symbol for axis labels; empty where the name itself is the label."""
    scale: float = 1.0
    """Typical size [unit]; differences of states are measured in multiples of it."""
    shown_unit: str = ""
    """Unit in pictures and on the command line; empty for the SI unit."""

    @property
    def attribute(self) -> str:
        """Name of the attribute of a dataset that has a value, with its unit, such as "speed [m/s]"."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def words(self) -> str:
        """The name in words."""
        return self.name.replace("_", " ")

    @property
    def per_shown(self) -> float:
        """SI units in one display unit."""
        if self.shown_unit in PER_SHOWN:
            return PER_SHOWN[self.shown_unit]
        return unit_factor(self.name, self.shown_unit, self.unit)

    @property
    def display_unit(self) -> str:
        """Unit in pictures and on the command line."""
        return self.shown_unit or self.unit

    @property
    def whole(self) -> bool:
        """Whether the values are whole numbers, such as the number of one of several rails."""
        return False

    @property
    def attributes(self) -> dict[str, str]:
        """xarray attributes: unit and description."""
        return {"units": self.unit, "long_name": self.long_name}

    def shown(self, value: Any) -> Any:
        """Return a value in SI units [unit] converted to the display unit."""
        return value / self.per_shown

    def from_shown(self, value: Any) -> Any:
        """Return a value in the display unit converted to SI units [unit]."""
        return value * self.per_shown

    def named(self, value: Any) -> str:
        """Return the name with a value in SI units [unit], such as "clearance 1.5 mm"; the unit 1 is left out."""
        unit = "" if self.display_unit == "1" else f" {self.display_unit}"
        return f"{self.words} {self.shown(float(value)):.5g}{unit}"


@dataclass(frozen=True)
class ShownUnits:
    """Units that a user chooses for shown numbers, such as ft, thou, lbf and g."""

    units: Sequence[str] = ()
    """Each unit replaces the display unit of quantities of its kind; the first unit of a kind counts."""

    def __post_init__(self):
        listed = isinstance(self.units, tuple | list) and all(isinstance(unit, str) for unit in self.units)
        require(listed, "units", 'be a list of units, such as ["ft", "lbf"]', self.units)
        for unit in self.units:
            _kinds(unit)

    def of(self, q: Quantity) -> Quantity:
        """Return a quantity with the display unit that the user chose for it."""
        long = q.unit == "m" and q.per_shown > LONG
        implied = [unit for given, others in IMPLIED.items() if given in self.units for unit in others]
        for unit in (*self.units, *implied):
            kinds, is_long = _kinds(unit)
            if q.unit in kinds and is_long == long:
                return replace(q, shown_unit=unit)
        return q


@functools.cache
def _kinds(unit: str) -> tuple[list[str], bool]:
    """Return the SI units of the quantities that have a unit, and whether the unit is for distances along the rail.

    **Raises:** `ValueError` for a unit whose kind is not in `KINDS`.
    """
    for si in KINDS:
        # pint raises an error for a unit of another kind
        with suppress(ValueError):
            long = unit_factor("units", unit, si) > LONG and si == "m"
            # energies and moments have the same dimension; a single word such as kJ is of energies
            return ([si, "N m"] if si == "J" and " " in unit else [si]), long
    need = f"be units of {', '.join(KINDS.values())}, such as ft, lbf and g"
    raise ValueError(f"Argument `units` must {need}, but has {brief(unit)}.")


def _named(*quantities: Quantity) -> dict[str, Quantity]:
    return {q.name: q for q in quantities}


COORDINATES: dict[str, Quantity] = _named(
    Quantity("y", "m", "lateral displacement", "y", 1e-3, shown_unit="mm"),
    Quantity("z", "m", "vertical displacement", "z", 1e-3, shown_unit="mm"),
    Quantity("roll", "rad", "roll angle", "", 1e-2, shown_unit="mrad"),
    Quantity("pitch", "rad", "pitch angle", "", 1e-2, shown_unit="mrad"),
    Quantity("yaw", "rad", "yaw angle", "", 1e-2, shown_unit="mrad"),
    Quantity("v_y", "m/s", "lateral velocity", "V_Y"),
    Quantity("v_z", "m/s", "vertical velocity", "V_Z"),
    Quantity("w_x", "rad/s", "roll rate, slipper frame", r"\omega_X", 10.0),
    Quantity("w_y", "rad/s", "pitch rate, slipper frame", r"\omega_Y", 10.0),
    Quantity("w_z", "rad/s", "yaw rate, slipper frame", r"\omega_Z", 10.0),
)
"""The slipper's coordinates and velocities, in the order of every array of coordinates."""

COORDINATE_SCALES = np.array([q.scale for q in COORDINATES.values()])
"""Scales of `COORDINATES`: 1 mm, 10 mrad, 1 m/s and 10 rad/s. Scaled errors and distances are multiples of these."""

# a small rotation changes the quaternion's vector part by half its angle
_ATTITUDE: dict[str, Quantity] = {
    angle: Quantity(f"q_{axis}", "1", f"{axis} of the attitude quaternion", f"q_{axis}", COORDINATES[angle].scale / 2)
    for angle, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z"))
}
MOTION_NUMBERS: dict[str, Quantity] = _named(*(_ATTITUDE.get(name, q) for name, q in COORDINATES.items()))
"""The numbers of a `Motion`, in its order: `COORDINATES` with a quaternion for the attitude."""

PAYLOAD_NUMBERS: dict[str, Quantity] = _named(
    Quantity("payload_y", "m", "lateral displacement of the payload", "", 1e-3, shown_unit="mm"),
    Quantity("payload_z", "m", "vertical displacement of the payload", "", 1e-3, shown_unit="mm"),
    Quantity("payload_v_y", "m/s", "lateral velocity of the payload"),
    Quantity("payload_v_z", "m/s", "vertical velocity of the payload"),
)
"""The numbers of a `PayloadMotion`, a mass on the slipper."""

MODE_NUMBERS: tuple[Quantity, Quantity] = (
    Quantity("mode", "m kg^0.5", "coordinate of the elastic mode", "q", 1e-3),
    Quantity("mode_rate", "m kg^0.5/s", "rate of the elastic mode", r"\dot q"),
)
"""The numbers of each mode of a `ModalMotion`, of unit modal mass."""

ACCELERATIONS: dict[str, Quantity] = _named(
    Quantity("a_y", "m/s^2", "lateral acceleration", "A_Y"),
    Quantity("a_z", "m/s^2", "vertical acceleration", "A_Z"),
    Quantity("alpha_x", "rad/s^2", "roll acceleration, slipper frame", r"\alpha_X"),
    Quantity("alpha_y", "rad/s^2", "pitch acceleration, slipper frame", r"\alpha_Y"),
    Quantity("alpha_z", "rad/s^2", "yaw acceleration, slipper frame", r"\alpha_Z"),
)
"""The slipper's accelerations."""

REACTIONS: dict[str, Quantity] = _named(
    Quantity("contact_force", "N", "normal contact force on the slipper", "F", shown_unit="kN"),
    Quantity("gap", "m", "gap, negative where penetrating", "g", shown_unit="mm"),
    Quantity("drive_force", "N", "force along x that keeps the speed constant", "F_X"),
)
"""Forces and gaps."""

LOADS: dict[str, Quantity] = _named(
    Quantity("peak_force", "N", "highest normal force of a contact point", r"F_{\mathrm{max}}", shown_unit="kN"),
    Quantity("peak_period", "1", "forcing periods passed at the highest force of a contact point"),
    Quantity("impulse", "N s", "integral of the normal contact force over time", r"\int F\,dt"),
    Quantity("contact_fraction", "1", "share of the time in contact"),
    Quantity(
        "penetration",
        "m",
        "greatest penetration, negative in open gaps",
        r"d_{\mathrm{max}}",
        shown_unit="mm",
    ),
)
"""Loads of contact points, over every integration step of a run."""

SLIPPER_LOADS: dict[str, Quantity] = _named(
    Quantity("peak_slipper_force", "N", "greatest net force of a slipper", r"F_{\mathrm{net}}", shown_unit="kN"),
    Quantity("peak_slipper_moment", "N m", "greatest net moment of a slipper about its middle", r"M_{\mathrm{net}}"),
    Quantity("peak_slipper_distance", "m", "distance travelled at the greatest net force of a slipper"),
    Quantity("static_ratio", "1", "greatest vertical net force of a slipper over its static load"),
)
"""Net loads of slippers: sums over a slipper's contact points at one instant; the value of greatest magnitude."""

NET_DIMS = ("axis", "about")
"""Dimensions of slippers' net loads, which have signs, in datasets."""
POINT_DIMS = ("slipper", "end", "point", *NET_DIMS)
"""Dimensions of values of contact points and slippers in datasets; only values of a sled have one of slippers."""


def point_dims(values: Any) -> list[str]:
    """Return the dimensions of contact points and slippers that an `xarray.DataArray` has."""
    return [name for name in POINT_DIMS if name in values.dims]


def highest_of_points(values: Any) -> Any:
    """Return the highest value of all contact points, or the greatest magnitude of all net loads of slippers, of an
    `xarray.DataArray`; NaN where any value is NaN."""
    sizes = abs(values) if set(NET_DIMS) & set(values.dims) else values
    return sizes.max(point_dims(values), skipna=False)


SECTIONS = {"v_y": "y", "v_z": "z", "w_x": "roll", "w_y": "pitch", "w_z": "yaw"}
"""Poincare sections: the recorded velocity by name, and the coordinate whose upward zero crossing is the section."""
