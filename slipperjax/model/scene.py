"""The scene: slipper, section, track, contact and speed. Plain pytrees in SI units, checked on construction."""

import dataclasses
import json
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import (
    ShapeChecked,
    instance,
    known,
    not_negative,
    optional,
    positive,
    require,
    shown_number,
    unit_of,
    warn,
    warn_unless_within,
)
from ..tools.code import heed_new_code
from ..tools.compile import is_traced, need_64_bits
from ..tools.description import TYPE, describe
from ..tools.files import user_path, write_whole
from ..tools.html import repr_html
from .contact import AbstractContactLaw, AbstractMemory, EventLatch
from .loads import AbstractFriction, AbstractLoad
from .paths import parameter, refuse_undone
from .quantities import COORDINATES, PARAMETERS, Parameter
from .section import Section
from .sled import SledMass
from .tracks import AbstractTrack
from .travel import SpeedProgramme, Travel
from .wear import AbstractWear


class Slipper(ShapeChecked):
    """A rigid slipper."""

    mass: Float[Array, ""] = eqx.field(converter=positive("mass", "kg"))
    """Mass [kg]."""
    inertia: Float[Array, "3"] = eqx.field(converter=positive("inertia", "kg m^2"))
    """Principal moments of inertia about x, y and z of the slipper's frame [kg m^2]."""
    length: Float[Array, ""] = eqx.field(converter=positive("length", "m"))
    """Distance between the front and the rear section [m]."""

    def __check_init__(self):
        warn_unless_within("inertia", self.inertia, 1e-9, 1e4, "kg m^2")


UNITS = {"speed": "m/s", "gravity": "m/s^2"}
"""Units of the numbers of the scene itself."""
NUMBERS = tuple(UNITS)
"""Their names."""
PARTS: dict[str, tuple[type, str]] = {
    "slipper": (Slipper, "a slipperjax.Slipper"),
    "section": (Section, "a slipperjax.Section"),
    "track": (AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)"),
    "contact": (AbstractContactLaw, "a contact law such as slipperjax.Flores(...)"),
    "memory": (AbstractMemory, "slipperjax.EventLatch() or slipperjax.SmoothSwitch()"),
    "load": (AbstractLoad, "a load such as slipperjax.AppliedLoad(...)"),
    "sled": (SledMass, "a slipperjax.SledMass"),
    "wear": (AbstractWear, "a law of wear such as slipperjax.Wear(...)"),
    "friction": (AbstractFriction, "a friction law such as slipperjax.Coulomb(...)"),
}
"""Parts of a scene, a table each in its file: their classes, and what must be given."""
OPTIONAL = ("load", "friction", "sled", "wear")
"""Parts that may be None."""
QUATERNION = ("q_x", "q_y", "q_z")
START_UNITS: dict[str, str] = {name: q.unit for name, q in COORDINATES.items()} | dict.fromkeys(QUATERNION, "")
"""Units of the coordinates at the start; the attitude's quaternion has none."""


LEAST_CLEARANCE = 5e-6
"""Smaller ones that are not zero [m] are below what is made and measured: allowed with a warning."""
SMALLEST_RADIUS, LARGEST_RADIUS = 0.02, 2.0
"""Radii of gyration beyond these, over the greatest size of the slipper [1], are allowed with a warning."""


def _speed(value: Any) -> Any:
    """Returns a travelling speed as an array, or its programme."""
    return value if isinstance(value, SpeedProgramme) else positive("speed", "m/s")(value)


class Scene(ShapeChecked):
    """Everything that defines one case. Parts set to None are omitted; they add no state and no operations."""

    speed: Float[Array, ""] | SpeedProgramme = eqx.field(converter=_speed)
    """Travelling speed V [m/s], or a programme of it."""
    slipper: Slipper
    section: Section
    track: AbstractTrack
    contact: AbstractContactLaw
    memory: AbstractMemory = EventLatch()
    """Model of the contact memory, for laws that have one."""
    gravity: Float[Array, ""] | None = eqx.field(converter=optional(not_negative("gravity", "m/s^2")), default=None)
    """Gravitational acceleration along -z [m/s^2]."""
    load: AbstractLoad | None = None
    """Force and moment besides contacts and gravity."""
    friction: AbstractFriction | None = None
    """Friction in the contacts."""
    sled: SledMass | None = None
    """A mass on a spring on the slipper."""
    wear: AbstractWear | None = None
    """Law by which the play opens along a run, see `slipperjax.run`."""

    def __check_init__(self):
        for name, (kind, text) in PARTS.items():
            if getattr(self, name) is not None or name not in OPTIONAL:
                instance(name, getattr(self, name), kind, text)
        self.warn_unless_plausible(PARAMETERS.values())
        if not is_traced((self.track, self.slipper.length)):
            with jax.ensure_compile_time_eval():  # inside jit, too
                shortest = float(self.track.shortest_wavelength)
            length = float(np.max(np.asarray(self.slipper.length)))
            if shortest < length:
                warn(
                    f"Argument `track` has waves of {shortest:g} m, shorter than the slipper of {length:g} m, which "
                    "feels the rail at its two ends only."
                )

    _repr_html_ = repr_html

    def __repr__(self) -> str:
        changes = isinstance(self.speed, SpeedProgramme)
        head = [f"speed={self.speed!r}" if changes else f"speed={shown_number(self.speed)} m/s"]
        if self.gravity is not None:
            head.append(f"gravity={shown_number(self.gravity)} m/s^2")
        return "\n  ".join([f"Scene({', '.join(head)},", *(f"{part!r}," for part in self.parts.values())])[:-1] + ")"

    def warn_unless_plausible(self, parameters: Iterable[Parameter]) -> None:
        """Gives an `ImplausibleWarning` where a parameter is far from what is usual. Traced ones are let through."""
        for p in parameters:
            if not is_traced(p.leaf(self)):
                p.warn_unless_plausible(p.of(self))
        if any(p.name == "clearance" for p in parameters) and not is_traced(self.section):
            points, clearance = np.asarray(self.section.points), 2 * np.max(np.asarray(self.section.play))
            smallest = float(np.min(np.ptp(points, axis=0)))
            # with more play than half its head on each side, the slipper can leave the rail
            warn_unless_within("clearance", clearance, LEAST_CLEARANCE if clearance else 0, smallest, "m")
        if any(p.name in ("length", "mass") or p.name.startswith("inertia") for p in parameters):
            self._warn_unless_inertia_is_plausible()

    def _warn_unless_inertia_is_plausible(self) -> None:
        """Gives an `ImplausibleWarning` for moments of inertia that no body of the slipper's size and mass has."""
        if is_traced((self.slipper, self.section)):
            return
        mass, length = (np.asarray(number)[..., None] for number in (self.slipper.mass, self.slipper.length))
        inertia, size = np.asarray(self.slipper.inertia), np.ptp(np.asarray(self.section.points))
        radii = np.sqrt(inertia / mass) / np.maximum(length, size)
        if np.any((radii < SMALLEST_RADIUS) | (radii > LARGEST_RADIUS)):
            worst = radii.flat[np.argmax(np.abs(np.log(radii)))]
            warn(f"Argument `inertia` has a radius of gyration of {worst:g} slipper sizes. Are the units right?")
        if np.any(2 * np.max(inertia, axis=-1) > np.sum(inertia, axis=-1) * (1 + 1e-9)):
            warn("Argument `inertia` has a moment greater than the sum of the others, which no body has.")

    @property
    def period(self) -> Float[Array, ""]:
        """The forcing period [s]: the time to travel the track's (first) wavelength, at the start's speed."""
        return self.travel(0.0).period

    def travel(self, phase: Any) -> Travel:
        """Returns speed and pace after `phase` forcing periods: the same everywhere at constant speed."""
        if not isinstance(self.speed, SpeedProgramme):
            return Travel(self.speed, self.track.wavelength)
        distance = jnp.asarray(phase, float) * self.track.wavelength
        return Travel(self.speed.at(distance), self.track.wavelength, self.speed.acceleration(distance))

    @property
    def slowest(self) -> Travel:
        """Travel at the least speed of all, where impacts take the least way; of a stretch see `slowest_between`."""
        if not isinstance(self.speed, SpeedProgramme):
            return self.travel(0.0)
        return Travel(self.speed.scale * jnp.min(self.speed.speed), self.track.wavelength)

    def slowest_between(self, phase: Any, later: Any) -> Travel:
        """Returns the travel at the least speed between `phase` and `later` forcing periods."""
        if not isinstance(self.speed, SpeedProgramme):
            return self.travel(phase)
        begin, end = (jnp.asarray(p, float) * self.track.wavelength for p in (phase, later))
        return Travel(self.speed.least(begin, end), self.track.wavelength)

    def epoch_at(self, distance: Any) -> Any:
        """Returns forcing periods from distance zero to another one [m]; on the host where nothing is traced."""
        if is_traced((distance, self.track)):
            return distance / self.track.wavelength
        return float(distance) / float(np.asarray(self.track.wavelength)) if distance else 0.0

    def seconds(self, phase: Any) -> Any:
        """Returns the time [s] after `phase` forcing periods from the start."""
        if not isinstance(self.speed, SpeedProgramme):
            return phase * self.period
        return self.speed.seconds(jnp.asarray(phase, float) * self.track.wavelength)

    @property
    def parts(self) -> dict[str, Any]:
        """The parts that the scene has, by name."""
        return {name: getattr(self, name) for name in PARTS if getattr(self, name) is not None}

    @property
    def points(self) -> int:
        """Number of contact points at both ends together."""
        return 2 * len(self.section.names)

    def replace(self, **values: Any) -> "Scene":
        """Returns a copy with other values of named parameters; see `PARAMETERS` for the names and units.

        Other numbers are named by their path, as in `replace(**{"section.play.2": 4e-4})`, see `parameter`. A part
        that is None, such as gravity, is added.

        Values may have leading axes of cases. Traced ones that are out of range become NaN.

        **Raises:** `ValueError` for an unknown name, a value that is out of range, a value that a later one would
        undo, or if the scene has no such part.
        """
        scene, parameters = self, [parameter(name, self) for name in values]
        refuse_undone(parameters, self)
        for p, value in zip(parameters, values.values(), strict=True):
            checked = p.check(p.name, p.unit)(value)
            require(np.size(checked) != 0, p.name, "be one or more values", value)
            scene = p.replaced(scene, checked)
        scene.warn_unless_plausible(parameters)
        return scene

    def to_toml(self, file: Any = None, *, start: Any = None) -> str:
        """Returns the scene as TOML text, exact to the last bit, which `slipperjax.load_scene` reads.

        **Arguments:** `file`: where to write it, too; default nowhere. `start`: a motion to add.

        **Raises:** `ValueError` for a part that plain text cannot hold; `OSError` where the file cannot be written.
        """
        text = scene_to_toml(self, start)
        if file is not None:
            write_whole(user_path(file, "file"), text.encode())
        return text

    def value(self, name: str) -> Array:
        """Returns the value of a named parameter; see `PARAMETERS` for the names and units.

        **Raises:** `ValueError` for an unknown name, or if the scene has no such part.
        """
        p = parameter(name, self)
        p.check_exists(self)
        value = p.of(self)
        if value is None:
            raise ValueError(f"Argument `{name}` has no value: the scene has no {p.long_name}.")
        return jnp.asarray(value)


def check_scene(scene: Any) -> Scene:
    """Returns `scene`, after which programs of replaced code are not used.

    **Raises:** `ValueError` where it is none, or if JAX runs with 32-bit numbers.
    """
    need_64_bits()
    instance("scene", scene, Scene, "a slipperjax.Scene")
    heed_new_code(scene)
    return scene


def check_steady(scene: Any) -> Scene:
    """Returns a scene whose motion may go on for ever; raises `ValueError` for wear and for a programme of speeds."""
    scene = check_scene(scene)
    require(scene.wear is None, "scene", "have no wear here, which slipperjax.run follows alone", scene.wear)
    steady = not isinstance(scene.speed, SpeedProgramme)
    require(steady, "scene", "have a constant speed", shown="one with a programme of speeds")
    return scene


def at_speed(scene: Any, speed: Any) -> Scene:
    """Returns a scene, checked, at another speed or programme; with None at its own."""
    scene = check_scene(scene)
    return scene if speed is None else dataclasses.replace(scene, speed=speed)


def scene_to_toml(scene: Scene, start: Any = None) -> str:
    """Returns a scene, and a motion at the start if given, as TOML text in SI units, exact to the last bit.

    **Raises:** `ValueError` for a part that has parts of its own, or holds what is no plain value.
    """
    known("scene", instance("scene", scene, Scene, "a slipperjax.Scene"))
    numbers, lines = describe(scene), []
    for name in NUMBERS:
        if not isinstance(numbers[name], dict):
            lines += _line(name, numbers[name], UNITS[name])
    if isinstance(scene.speed, SpeedProgramme):
        lines += ["", "[speed]", *_entries(scene.speed)[1:]]
    for name, own in scene.parts.items():
        part = _entries(own)
        single = PARTS[name][0] is type(own)  # there is one kind of it
        lines += ["", f"[{name}]", *(part[1:] if single else part)]
    if start is not None:
        is_motion = type(start).__name__ == "Motion"  # whose module needs this one
        require(is_motion, "start", "be a slipperjax.Motion in TOML, such as run.end.motion", start)
        moving = {name: value for name, value in describe(start).items() if name != TYPE and value != 0}
        lines += ["", "[start]", *(line for name in moving for line in _line(name, moving[name], START_UNITS[name]))]
    return "\n".join(lines) + "\n"


def _entries(part: Any) -> list[str]:
    """Returns the lines of TOML of a module: its type, and each value that is not None."""
    lines = []
    for name, value in describe(part).items():
        inner = getattr(part, name, None)
        table = lambda module: f"{{ {', '.join(_entries(module))} }}"
        if isinstance(inner, eqx.Module):
            lines.append(f"{name} = {table(inner)}")
        elif isinstance(inner, tuple) and inner and isinstance(inner[0], eqx.Module):
            lines.append(f"{name} = [{', '.join(map(table, inner))}]")
        else:
            lines += _line(name, value, unit_of(type(part), name))
    return lines


def _line(name: str, value: Any, unit: str) -> list[str]:
    """Returns a value as a line of TOML: with a unit a text for a number, and an inline table for an array."""
    if value is None:
        return []
    require(not isinstance(value, dict), "scene", "have no functions in TOML", value)
    if unit and isinstance(value, list):
        return [f"{name} = {{ unit = {json.dumps(unit)}, values = {json.dumps(value)} }}"]
    return [f"{name} = {json.dumps(f'{value!r} {unit}' if unit else value)}"]
