"""The scene: slipper, section, track, contact and speed. Plain pytrees in SI units, checked on construction."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import (
    ShapeChecked,
    instance,
    not_negative,
    optional,
    positive,
    require,
    shown_number,
    unless_traced,
    warn_unless_within,
)
from ..tools.compile import is_traced
from ..tools.files import write_whole
from .contact import AbstractContactLaw, AbstractMemory, EventLatch
from .paths import parameter, refuse_undone
from .quantities import PARAMETERS, Parameter
from .section import Section
from .tracks import AbstractTrack
from .travel import Travel


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


class Scene(ShapeChecked):
    """Everything that defines one case. Parts set to None are omitted; they add no state and no operations."""

    speed: Float[Array, ""] = eqx.field(converter=positive("speed", "m/s"))
    """Travelling speed V [m/s]."""
    slipper: Slipper
    section: Section
    track: AbstractTrack
    contact: AbstractContactLaw
    memory: AbstractMemory = EventLatch()
    """Model of the contact memory, for laws that have one."""
    gravity: Float[Array, ""] | None = eqx.field(converter=optional(not_negative("gravity", "m/s^2")), default=None)
    """Gravitational acceleration along -z [m/s^2]."""

    def __check_init__(self):
        parts = {
            "slipper": (Slipper, "a slipperjax.Slipper"),
            "section": (Section, "a slipperjax.Section"),
            "track": (AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)"),
            "contact": (AbstractContactLaw, "a contact law such as slipperjax.Flores(...)"),
            "memory": (AbstractMemory, "slipperjax.EventLatch() or slipperjax.SmoothSwitch()"),
        }
        for name, (kind, text) in parts.items():
            instance(name, getattr(self, name), kind, text)
        self.warn_unless_plausible(PARAMETERS.values())

    def __repr__(self) -> str:
        head = [f"speed={shown_number(self.speed)} m/s"]
        if self.gravity is not None:
            head.append(f"gravity={shown_number(self.gravity)} m/s^2")
        parts = (self.slipper, self.section, self.track, self.contact, self.memory)
        return "\n  ".join([f"Scene({', '.join(head)},", *(f"{part!r}," for part in parts)])[:-1] + ")"

    def warn_unless_plausible(self, parameters: Iterable[Parameter]) -> None:
        """Gives an `ImplausibleWarning` where a parameter is far from what is usual. Traced ones are let through."""
        for p in parameters:
            if not is_traced(p.leaf(self)):
                p.warn_unless_plausible(p.of(self))
        if any(p.name == "clearance" for p in parameters) and not is_traced(self.section):
            points, clearance = np.asarray(self.section.points), 2 * np.max(np.asarray(self.section.play))
            smallest = float(np.min(np.ptp(points, axis=0)))
            # with more play than half its head on each side, the slipper can leave the rail
            warn_unless_within("clearance", clearance, 0, smallest, "m")

    @property
    def period(self) -> Float[Array, ""]:
        """The forcing period [s]: the time to travel the track's (first) wavelength."""
        return self.travel(0.0).period

    def travel(self, phase: Any) -> Travel:
        """Returns speed and pace after `phase` forcing periods: the same everywhere at constant speed."""
        del phase
        return Travel(self.speed, self.track.wavelength)

    @property
    def points(self) -> int:
        """Number of contact points at both ends together."""
        return 2 * len(self.section.names)

    def replace(self, **values: Any) -> "Scene":
        """Returns a copy with other values of named parameters; see `PARAMETERS` for the names and units.

        Other numbers are named by their path, as in `replace(**{"section.play.2": 4e-4})`, see `parameter`. A part
        that is None, such as gravity, is added.

        Values may have leading axes of cases. Traced ones are not checked, so that this works inside batched
        functions.

        **Raises:** `ValueError` for an unknown name, a value that is out of range, a value that a later one would
        undo, or if the scene has no such part.
        """
        scene, parameters = self, [parameter(name, self) for name in values]
        refuse_undone(parameters, self)
        for p, value in zip(parameters, values.values(), strict=True):
            require(np.size(value) != 0, p.name, "be one or more values", value)
            scene = p.replaced(scene, unless_traced(p.check(p.name, p.unit), value))
        scene.warn_unless_plausible(parameters)
        return scene

    def to_toml(self, file: Any = None, *, start: Any = None) -> str:
        """Returns the scene as TOML text, exact to the last bit, which `slipperjax.load_scene` reads.

        **Arguments:** `file`: where to write it, too; default nowhere. `start`: a motion to add.

        **Raises:** `ValueError` for a part that plain text cannot hold; `OSError` where the file cannot be written.
        """
        from .scene_files import scene_to_toml  # which needs this module

        text = scene_to_toml(self, start)
        if file is not None:
            write_whole(Path(file), text.encode())
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
    """Returns `scene`; raises `ValueError` where it is none."""
    return instance("scene", scene, Scene, "a slipperjax.Scene")
