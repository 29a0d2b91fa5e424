"""The registry of quantities: name, unit, symbol, scale, display unit and check of each named quantity.

Checks, datasets, plots, the command line and the solvers look up parameters of a scene, coordinates of a start,
outputs and sections here.
"""

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, fraction, instance, not_negative, positive, warn_unless_within
from ..tools.compile import as_argument, is_traced


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
    per_shown: float = 1.0
    """SI units in one display unit."""

    @property
    def display_unit(self) -> str:
        """Unit in pictures and on the command line."""
        return self.shown_unit or self.unit

    @property
    def whole(self) -> bool:
        """Whether the values are whole numbers, such as choose one of several rails."""
        return False

    @property
    def attributes(self) -> dict[str, str]:
        """xarray attributes: unit and description."""
        return {"units": self.unit, "long_name": self.long_name}

    def shown(self, value: Any) -> Any:
        """Returns a value in SI units [unit] converted to the display unit."""
        return value / self.per_shown

    def from_shown(self, value: Any) -> Any:
        """Returns a value in the display unit converted to SI units [unit]."""
        return value * self.per_shown


@dataclass(frozen=True)
class Parameter(Quantity):
    """A scalar parameter, with its place in a `Scene`."""

    where: Callable[[Any], Any] = lambda scene: None
    """The leaf of a scene that holds it."""
    check: Callable[[str, str], Callable[[Any], jax.Array]] = finite
    """Makes the check of values from name and unit, see `slipperjax.tools.checks`."""
    read: Callable[[Any], Any] = lambda leaf: leaf
    """The value [unit] from the leaf."""
    write: Callable[[Array, Any], Array] = lambda value, leaf: value
    """The leaf from the value, of shape (*cases,), and the leaf before."""
    plausible: tuple[float, float] = (-np.inf, np.inf)
    """Values outside this range [unit] are allowed, with a warning that the unit may be wrong."""

    def checked(self, value: Any) -> jax.Array:
        """Makes `value` [unit] an array; raises `ValueError` where out of range, warns where implausible."""
        array = self.check(self.name, self.unit)(value)
        self.warn_unless_plausible(array)
        return array

    def warn_unless_plausible(self, value: Any) -> None:
        """Gives an `ImplausibleWarning` where `value` [unit], one or more, lies outside `plausible`."""
        warn_unless_within(self.name, value, *self.plausible, self.unit)

    def leaf(self, scene: Any) -> Any:
        """Returns the leaf in a scene; None where the scene has no such part, or does without it."""
        try:
            return self.where(scene)
        except AttributeError:
            return None

    def of(self, scene: Any) -> Any:
        """Returns the value in a scene [unit]; None where the scene has no such part, or does without it."""
        leaf = self.leaf(scene)
        return None if leaf is None else self.read(leaf)

    def check_exists(self, scene: Any) -> None:
        """Raises `ValueError` where a scene has no such part; a part that is None can be set."""
        try:
            self.where(scene)
        except AttributeError:
            raise ValueError(f"Argument `{self.name}` cannot be set: the scene has no {self.long_name}.") from None

    @property
    def whole(self) -> bool:
        return getattr(self.check(self.name, self.unit), "whole", False)

    def check_varies(self) -> None:
        """Raises `ValueError` where the values are whole numbers, by which nothing can be differentiated."""
        if self.whole:
            raise ValueError(f"Argument `{self.name}` cannot be varied by little: it is a whole number, of no slope.")

    def replaced(self, scene: Any, value: Any) -> Any:
        """Returns a copy of `scene` with another value, unchecked; `value` may have leading axes of cases.

        **Raises:** `ValueError` where the scene has no such part.
        """
        self.check_exists(scene)
        written = self.write(as_argument(value), self.where(scene))
        return eqx.tree_at(self.where, scene, written, is_leaf=lambda x: x is None)


def half_play(clearance: jax.Array, faces: int) -> Float[Array, "*cases faces"]:
    """Returns a total play of `clearance` [m], shape (*cases,), as the play of each face [m]."""
    if not is_traced(clearance):  # on the host, where nothing is compiled
        half = np.asarray(clearance)[..., None] / 2
        return jnp.asarray(np.broadcast_to(half, (*half.shape[:-1], faces)))
    return jnp.broadcast_to(clearance[..., None] / 2, (*clearance.shape, faces))


def entry(*index: int) -> dict[str, Callable]:
    """Returns `read` and `write` of a `Parameter` that is one entry of an array; both may have axes of cases."""

    def write(value: Any, array: Any) -> jax.Array:
        shape, axes = np.shape(array), np.ndim(array) - len(index)
        cases = jnp.broadcast_shapes(np.shape(value), shape[:axes])
        return jnp.broadcast_to(array, (*cases, *shape[axes:])).at[(..., *index)].set(value)

    return dict(read=lambda array: (array if is_traced(array) else np.asarray(array))[(..., *index)], write=write)


def _named(*quantities: Any) -> dict[str, Any]:
    return {q.name: q for q in quantities}


_MM = dict(shown_unit="mm", per_shown=1e-3)
_MRAD = dict(shown_unit="mrad", per_shown=1e-3)


def _parameter(path: str, unit: str, text: str, symbol: str, check: Any, *plausible: float, **more: Any) -> Parameter:
    """Returns the parameter at a path of fields in a scene, by the last of which it is named."""
    more |= dict(where=operator.attrgetter(path), check=check) | (dict(plausible=plausible) if plausible else {})
    return Parameter(path.rpartition(".")[2], unit, text, symbol, **more)


def _constant_speed(scene: Any) -> Any:
    if isinstance(scene.speed, eqx.Module):
        raise AttributeError("a programme of speeds")
    return scene.speed


_DEGREES = dict(shown_unit="degrees", per_shown=np.pi / 180)

PARAMETERS: dict[str, Parameter] = _named(
    Parameter(
        "speed", "m/s", "constant travelling speed", "V", where=_constant_speed, check=positive, plausible=(5, 1e4)
    ),
    Parameter(
        "clearance",
        "m",
        "total play of slipper and rail",
        "C",
        **_MM,
        where=lambda s: s.section.play,
        check=not_negative,
        read=lambda play: 2 * (jnp.mean(play) if is_traced(play) else np.mean(np.asarray(play))),
        write=lambda clearance, play: half_play(clearance, play.shape[-1]),
    ),
    _parameter("slipper.length", "m", "slipper length", "L", positive, 0.005, 20),
    _parameter("slipper.mass", "kg", "slipper mass", "m", positive, 0.1, 1e4),
    *(
        Parameter(
            f"inertia_{axis}",
            "kg m^2",
            f"moment of inertia about {axis}",
            f"J_{axis}",
            where=lambda s: s.slipper.inertia,
            check=positive,
            plausible=(1e-9, 1e4),
            **entry(k),
        )
        for k, axis in enumerate("xyz")
    ),
    _parameter("contact.stiffness", "N/m^1.5", "contact stiffness", "K", positive, 1e4, 1e14),
    _parameter("contact.restitution", "1", "coefficient of restitution", "c_r", fraction),
    _parameter("track.amplitude", "m", "irregularity amplitude", "A", not_negative, 0, 0.1, **_MM),
    _parameter("track.roll_amplitude", "rad", "irregularity roll amplitude", "A_R", not_negative, 0, 0.1, **_DEGREES),
    _parameter("gravity", "m/s^2", "gravitational acceleration", "g", not_negative, 0, 1e3),
)
"""The parameters of a scene by name, for `Scene.replace` and `sweep`."""

COORDINATES: dict[str, Quantity] = _named(
    Quantity("y", "m", "lateral displacement", "y", 1e-3, **_MM),
    Quantity("z", "m", "vertical displacement", "z", 1e-3, **_MM),
    Quantity("roll", "rad", "roll angle", "", 1e-2, **_MRAD),
    Quantity("pitch", "rad", "pitch angle", "", 1e-2, **_MRAD),
    Quantity("yaw", "rad", "yaw angle", "", 1e-2, **_MRAD),
    Quantity("v_y", "m/s", "lateral velocity", "V_Y"),
    Quantity("v_z", "m/s", "vertical velocity", "V_Z"),
    Quantity("w_x", "rad/s", "roll rate, slipper frame", r"\omega_X", 10.0),
    Quantity("w_y", "rad/s", "pitch rate, slipper frame", r"\omega_Y", 10.0),
    Quantity("w_z", "rad/s", "yaw rate, slipper frame", r"\omega_Z", 10.0),
)
"""The slipper's coordinates and velocities, in the order of every array of coordinates."""

COORDINATE_SCALES = np.array([q.scale for q in COORDINATES.values()])
"""Scales of `COORDINATES`: 1 mm, 10 mrad, 1 m/s and 10 rad/s. Scaled errors and distances are multiples of them."""

# a small rotation changes the quaternion's vector part by half its angle
_ATTITUDE: dict[str, Quantity] = {
    angle: Quantity(f"q_{axis}", "1", f"{axis} of the attitude quaternion", f"q_{axis}", COORDINATES[angle].scale / 2)
    for angle, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z"))
}
MOTION_NUMBERS: dict[str, Quantity] = _named(*(_ATTITUDE.get(name, q) for name, q in COORDINATES.items()))
"""The numbers of a `Motion`, in its order: `COORDINATES` with a quaternion for the attitude."""

SLED_NUMBERS: dict[str, Quantity] = _named(
    Quantity("sled_y", "m", "lateral displacement of the sled", "", 1e-3, **_MM),
    Quantity("sled_z", "m", "vertical displacement of the sled", "", 1e-3, **_MM),
    Quantity("sled_v_y", "m/s", "lateral velocity of the sled"),
    Quantity("sled_v_z", "m/s", "vertical velocity of the sled"),
)
"""The numbers that a `SledMotion` has besides."""

ACCELERATIONS: dict[str, Quantity] = _named(
    Quantity("a_y", "m/s^2", "lateral acceleration", "A_Y"),
    Quantity("a_z", "m/s^2", "vertical acceleration", "A_Z"),
    Quantity("alpha_x", "rad/s^2", "roll acceleration, slipper frame", r"\alpha_X"),
    Quantity("alpha_y", "rad/s^2", "pitch acceleration, slipper frame", r"\alpha_Y"),
    Quantity("alpha_z", "rad/s^2", "yaw acceleration, slipper frame", r"\alpha_Z"),
)
"""The slipper's accelerations."""

REACTIONS: dict[str, Quantity] = _named(
    Quantity("contact_force", "N", "normal contact force on the slipper", "F", shown_unit="kN", per_shown=1e3),
    Quantity("gap", "m", "gap, negative where penetrating", "g", **_MM),
    Quantity("drive_force", "N", "force along x that keeps the speed constant", "F_X"),
)
"""Forces and gaps."""

LOADS: dict[str, Quantity] = _named(
    Quantity("peak_force", "N", "highest normal contact force", r"F_{\mathrm{max}}", shown_unit="kN", per_shown=1e3),
    Quantity("peak_period", "1", "forcing periods passed at the highest contact force"),
    Quantity("impulse", "N s", "integral of the normal contact force over time", r"\int F\,dt"),
    Quantity("contact_fraction", "1", "share of the time in contact"),
    Quantity(
        "penetration", "m", "greatest penetration, negative where the gap stays open", r"d_{\mathrm{max}}", **_MM
    ),
)
"""Loads of contact points, over every integration step of a run."""

_FARTHEST = {"m": 0.02, "m/s": 100.0, "rad/s": 1e3}
"""Greatest plausible magnitudes at the start, by unit."""


def _at_start(q: Quantity) -> Parameter:
    far, text = _FARTHEST[q.unit], f"{q.long_name.split(',')[0]} at the start"
    return Parameter(**vars(q) | dict(long_name=text, plausible=(-far, far)))


STARTS: dict[str, Parameter] = {
    name: _at_start(q) for name, q in COORDINATES.items() if name not in ("roll", "pitch", "yaw")
}
"""The coordinates of the start that a grid may vary besides `PARAMETERS`, for basins of attraction."""

SECTIONS = {"v_y": "y", "v_z": "z", "w_x": "roll", "w_y": "pitch", "w_z": "yaw"}
"""Poincare sections: the recorded velocity by name, and the coordinate whose upward zero crossing is the section."""


def quantity(name: str) -> Quantity:
    """Returns a quantity by its name in datasets, where a start's coordinate x is `start_x`.

    **Raises:** `KeyError` for an unknown name, `ValueError` for what is no name.
    """
    instance("name", name, str, "the name of a quantity")
    if name.startswith("start_"):
        return STARTS[name.removeprefix("start_")]
    for quantities in (PARAMETERS, COORDINATES, ACCELERATIONS, REACTIONS, LOADS):
        if name in quantities:
            return quantities[name]
    raise KeyError(name)
