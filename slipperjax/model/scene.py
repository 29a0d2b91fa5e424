"""The scene: slipper, section, track, contact and speed. Plain pytrees in SI units, checked on construction."""

import dataclasses
import functools
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import instance, known, positive, require, shown_number, warn
from ..tools.code import classes_of
from ..tools.compile import need_64_bits
from ..tools.description import build, describe
from ..tools.fields import ShapeChecked, field, with_static_functions
from ..tools.files import user_path, write_whole
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Numbers, Real
from .beam import Beam
from .contact import AbstractContactLaw, AbstractMemory, EventLatch, PeakRateLatch
from .loads import AbstractFriction, AbstractLoad, SumLoad
from .modes import Modes
from .parameters import PARAMETERS, check_no_overlap, parameter
from .payload import Payload
from .quantities import COORDINATES, MOTION_NUMBERS
from .random_rails import AbstractSpectrum
from .scene_text import Table, table_of, toml_lines
from .section import Section
from .sled import Mount, Sled
from .slipper import AbstractBody, Mounted, side_by_side
from .tracks import PLAUSIBLE_LENGTHS, AbstractTrack, least_common_count
from .travel import SpeedProgramme, Travel
from .wear import AbstractWear

PARTS: dict[str, tuple[type, str]] = {
    "slipper": (AbstractBody, "a slipperjax.Slipper or a slipperjax.Sled"),
    "section": (Section, "a slipperjax.Section"),
    "track": (AbstractTrack, "a track such as slipperjax.HarmonicTrack(...)"),
    "contact": (AbstractContactLaw, "a contact law such as slipperjax.model.Flores(...)"),
    "memory": (
        AbstractMemory,
        "slipperjax.model.EventLatch(), slipperjax.model.PeakRateLatch() or slipperjax.model.SmoothSwitch()",
    ),
    "load": (AbstractLoad, "a load such as slipperjax.model.AppliedLoad(...)"),
    "payload": (Payload, "a slipperjax.model.Payload"),
    "wear": (AbstractWear, "a law of wear such as slipperjax.model.Wear(...)"),
    "friction": (AbstractFriction, "a friction law such as slipperjax.model.Coulomb(...)"),
    "beam": (Beam, "a slipperjax.Beam"),
}
"""Parts of a scene, each a table in its file: their classes, and the values that must be given."""
INNER = (AbstractTrack, AbstractSpectrum, AbstractLoad, Mount, Modes)
"""Bases of classes within parts of a scene."""
NUMBERS = ("speed", "gravity", "window")
"""Numbers of the scene itself."""


def _speed(value: object) -> Array | SpeedProgramme:
    """Return a travelling speed as an array, or its programme."""
    return value if isinstance(value, SpeedProgramme) else PARAMETERS["speed"].check(value)


class Scene(ShapeChecked):
    """Everything that defines one case. Parts set to None are omitted; they add no state and no operations."""

    speed: Float[Array, ""] | SpeedProgramme = eqx.field(converter=_speed, metadata={"unit": "m/s"})
    """Travelling speed V [m/s], or a programme of speeds."""
    slipper: AbstractBody
    """The slipper, or a sled on several slippers."""
    section: Section
    track: AbstractTrack
    contact: AbstractContactLaw
    memory: AbstractMemory | None = None
    """Model of the contact memory, for laws with memory; None: see `contact_memory`."""
    gravity: Float[Array, ""] | None = eqx.field(
        converter=dataclasses.replace(PARAMETERS["gravity"].check, optional=True), default=None
    )
    """Gravitational acceleration along -z [m/s^2]."""
    load: AbstractLoad | None = None
    """Force and moment in addition to contacts and gravity."""
    friction: AbstractFriction | None = None
    """Friction in the contacts."""
    payload: Payload | None = None
    """A mass on a spring on the slipper."""
    wear: AbstractWear | None = None
    """Law by which the play opens along a run, see `slipperjax.run`."""
    window: Float[Array, ""] | None = field("m", positive, plausible=PLAUSIBLE_LENGTHS, default=None)
    """Length of travel that counts as a forcing period [m]; None for the track's first wavelength."""
    beam: Beam | None = None
    """How the rails bend; None: they are rigid."""

    def __check_init__(self):
        for name, (kind, text) in PARTS.items():
            part = getattr(self, name)
            # these parts may be None
            if part is not None or name not in ("memory", "load", "friction", "payload", "wear", "beam"):
                instance(name, part, kind, text)
        _check_mounts(self)
        if is_traced((self.track, self.slipper.length)):
            return
        with jax.ensure_compile_time_eval():  # inside jit, too
            shortest = float(self.track.shortest_wavelength)
        length = float(np.max(np.asarray(self.slipper.length)))
        if shortest < length:
            warn(
                f"Argument `track` has waves of {shortest:g} m, shorter than the slipper of {length:g} m, which "
                "feels the rail at its two ends only."
            )

    def __repr__(self) -> str:
        changes = isinstance(self.speed, SpeedProgramme)
        head = [f"speed={self.speed!r}" if changes else f"speed={shown_number(self.speed)} m/s"]
        if self.gravity is not None:
            head.append(f"gravity={shown_number(self.gravity)} m/s^2")
        if self.window is not None:
            head.append(f"window={shown_number(self.window)} m")
        parts = self.parts | {"memory": self.contact_memory}
        rows = ",\n  ".join([", ".join(head), *(repr(parts[name]) for name in PARTS if name in parts)])
        return f"Scene({rows})"

    @property
    def wavelength(self) -> Float[Array, ""]:
        """Length of travel that counts as a forcing period [m]."""
        return self.track.wavelength if self.window is None else self.window

    @property
    def recurrence(self) -> Float[Array, ""]:
        """Number of forcing periods after which rail and load recur [1]; infinite where they do not."""
        if self.load is not None and not self.load.by_speed:
            return jnp.asarray(jnp.inf)
        return least_common_count(self.wavelength, self.track.recurrence)

    @property
    def period(self) -> Float[Array, ""]:
        """The forcing period [s]: the time to travel its wavelength at the start's speed."""
        return self.travel(0.0).period

    def travel(self, phase: Real) -> Travel:
        """Return speed and pace after `phase` forcing periods; both are constant at constant speed."""
        if not isinstance(self.speed, SpeedProgramme):
            return Travel(self.speed, self.wavelength, None, phase)
        # a programme depends on the distance
        distance = jnp.asarray(phase, float) * self.wavelength
        of = self.speed
        return Travel(of.at(distance), self.wavelength, of.acceleration(distance), phase, of)

    @property
    def slowest_travel(self) -> Travel:
        """Travel at the least speed of all, where an impact takes the shortest way; see also `slowest_between`."""
        if not isinstance(self.speed, SpeedProgramme):
            return self.travel(0.0)
        # a speed between two places is between the speeds at the places
        return Travel(self.speed.scale * jnp.min(self.speed.speed), self.wavelength)

    @property
    def fastest_travel(self) -> Travel:
        """Travel at the highest speed of all."""
        if not isinstance(self.speed, SpeedProgramme):
            return self.travel(0.0)
        return Travel(self.speed.scale * jnp.max(self.speed.speed), self.wavelength)

    def slowest_between(self, phase: Real, later: Real) -> Travel:
        """Return the travel at the least speed between `phase` and `later` forcing periods."""
        if not isinstance(self.speed, SpeedProgramme):
            return self.travel(phase)
        begin, end = (jnp.asarray(p, float) * self.wavelength for p in (phase, later))
        return Travel(self.speed.least(begin, end), self.wavelength)

    def epoch_at(self, distance: Real) -> Real:
        """Return forcing periods from distance zero to a distance [m]; on the host where nothing is traced."""
        if is_traced((distance, self.track)):
            return distance / self.wavelength
        # distance zero needs no wavelength, because the wavelength may be traced
        return float(distance) / float(np.asarray(self.wavelength)) if distance else 0.0

    def seconds(self, phase: Real) -> Array:
        """Return the time [s] after `phase` forcing periods from the start."""
        if not isinstance(self.speed, SpeedProgramme):
            return phase * self.period
        return self.speed.seconds(jnp.asarray(phase, float) * self.wavelength)

    @property
    def parts(self) -> dict[str, eqx.Module]:
        """The parts that the scene has, by name."""
        return {name: getattr(self, name) for name in PARTS if getattr(self, name) is not None}

    @property
    def contact_memory(self) -> AbstractMemory:
        """The model of the contact memory: `memory`, or by default `PeakRateLatch` on surveyed and random rails and
        over joints, and on other tracks `EventLatch`, as in the paper."""
        if self.memory is not None:
            return self.memory
        return PeakRateLatch() if self.track.is_rough else EventLatch()

    @property
    def latches_memory(self) -> bool:
        """Whether contacts have a memory that changes only between steps."""
        return self.contact.has_memory and not self.contact_memory.integrated

    @property
    def integrates_memory(self) -> bool:
        """Whether contacts have a memory that is integrated with the motion."""
        return self.contact.has_memory and self.contact_memory.integrated

    @property
    def mounted(self) -> tuple[Mounted, ...]:
        """The slippers where they are on the body."""
        return self.slipper.mounted(self.section)

    @property
    def ahead(self) -> Array | np.ndarray | float:
        """How far the foremost end of a slipper is ahead of the counted distance [m]."""
        ahead = [jnp.asarray(slipper.ahead) for slipper in self.mounted if slipper.ahead is not None]
        # the front end of a slipper in the middle is at the counted distance
        most = jnp.maximum if is_traced(ahead) else np.maximum
        return functools.reduce(most, ahead, 0.0)

    @property
    def arms(self) -> list[Float[AnyArray, " points"]]:
        """x, y and z of all contact points in the body's frame [m], of each slipper first the front ones."""
        return [side_by_side(along) for along in zip(*(slipper.arms for slipper in self.mounted), strict=True)]

    @property
    def reach(self) -> Float[Array, ""]:
        """Greatest distance of contact points from the body's x axis, along y or z [m]."""
        _, *across = self.arms
        return jnp.max(jnp.abs(jnp.stack(across)))

    @property
    def half_length(self) -> Float[Array, ""]:
        """Greatest distance of contact points from the centre of mass along x [m]."""
        return jnp.max(jnp.abs(self.arms[0]))

    @property
    def play(self) -> Float[AnyArray, "*slippers faces"]:
        """Play of each face [m], for a sled of each slipper."""
        plays = [slipper.section.play for slipper in self.mounted]
        return jnp.stack(plays, axis=-2) if self.slipper.names else plays[0]

    def with_play(self, play: Float[AnyArray, "... faces"] | None) -> "Scene":
        """Return a copy with another `play`, which is not checked; None removes the play."""
        where = lambda scene: scene.section.play
        value = play
        if isinstance(self.slipper, Sled):
            # from the mounts' own sections, because several mounts may share the scene's section
            where = lambda scene: [mount.play for mount in scene.slipper.mounts]
            value = [None if play is None else play[..., k, :] for k in range(len(self.slipper.mounts))]
        return eqx.tree_at(where, self, value, is_leaf=lambda leaf: leaf is None)

    @property
    def point_labels(self) -> dict[str, list[str]]:
        """The dimensions of values of contact points, with their labels: end and point, for a sled first slipper."""
        names = self.slipper.names
        ends = {"end": ["front", "rear"], "point": list(self.section.names)}
        return {"slipper": list(names), **ends} if names else ends

    @property
    def point_shape(self) -> tuple[int, ...]:
        """Shape of values of contact points, in the order of `point_labels`."""
        return tuple(map(len, self.point_labels.values()))

    @property
    def point_names(self) -> list[str]:
        """Names of all contact points: A1 at the front, A2 at the rear, left2_A1 of a sled's slipper."""
        names = [f"{point}{end}" for end in (1, 2) for point in self.section.names]
        slippers = self.slipper.names
        return [f"{slipper}_{name}" for slipper in slippers for name in names] if slippers else names

    @property
    def nodes(self) -> tuple[int, int]:
        """Numbers of rails, and of track nodes under the ends of all slippers."""
        return len(self.track.rails or [""]), 2 * len(self.mounted)

    @property
    def points(self) -> int:
        """Number of all contact points."""
        return math.prod(self.point_shape)

    def replace(self, **values: Real | Numbers) -> "Scene":
        """Return a copy with other values of named parameters; see `PARAMETERS` for the names and units.

        Other numbers are named by their path, as in `replace(**{"section.play.2": 4e-4})`, see `parameter`. A part
        that is None, such as gravity, is added.

        Values may have leading axes of cases. Traced values that are out of range become NaN.

        **Raises:** `ValueError` for an unknown name, a value out of range, a value that a later one would undo, or if
        the scene has no such part.
        """
        scene = self
        parameters = [parameter(name, self) for name in values]
        check_no_overlap(parameters, self)
        # one after the other, so that a part may follow the whole array
        for p, value in zip(parameters, values.values(), strict=True):
            checked = p.check(value)
            require(np.size(checked) != 0, p.name, "be one or more values", value)
            scene = p.replaced(scene, checked)
        return scene

    def to_toml(
        self, file: str | Path | None = None, *, start: eqx.Module | None = None, remarks: bool = False
    ) -> str:
        """Return the scene as TOML text, exact to the last bit, which `slipperjax.load` reads.

        **Arguments:** `file`: path to which the text is also written, with paths of surveys relative to its folder;
        default none. `start`: a motion to add, of the slipper or a rigid sled. `remarks`: whether the
        meaning of each value is written above it, and of each value that may be added. Digests of surveys are left
        out then, so that the surveys may change.

        **Raises:** `ValueError` for a part that plain text cannot hold; `OSError` where the file cannot be written.
        """
        known("scene", self)
        for name, own in {"speed": self.speed, **self.parts}.items():
            if any(classes_of(own)):  # parts of this package can be read back
                _check_readable(name, own)
        values = dict(table_of(self).values)
        if isinstance(self.load, SumLoad):
            values["load"] = self.load.loads
        if start is not None:
            # by its name, because its module imports this module
            need = "be a slipperjax.Motion in TOML, such as run.end.motion"
            kind = type(start).__name__
            require(kind in ("Motion", "AtRest"), "start", need, start)
            for name in ("payload", "modes"):
                part = getattr(start, name)
                require(part is None, "start", f"have no motion of the {name} in TOML", part)
            moving = {name: value for name, value in table_of(start).values.items() if np.any(value != 0)}
            values["start"] = Table(type(start), moving)
        path = None if file is None else user_path(file, "file")
        lines = toml_lines(Table(Scene, values), remarks=remarks, folder=path and path.parent)
        text = "\n".join(lines) + "\n"
        if path is not None:
            write_whole(path, text.encode())
        return text

    def value(self, name: str) -> Array:
        """Return the value of a named parameter; see `PARAMETERS` for the names and units.

        **Raises:** `ValueError` for an unknown name, or if the scene has no such part.
        """
        p = parameter(name, self)
        p.check_exists(self)
        value = p.of(self)
        if value is None:
            raise ValueError(f"Argument `{name}` has no value: the scene has no {p.long_name}.")
        return jnp.asarray(value)


def _check_mounts(scene: Scene) -> None:
    """Raise `ValueError` where the slippers do not fit the rails or each other."""
    rails = scene.track.rails
    if not isinstance(scene.slipper, Sled):
        need = f"be one rail for a {type(scene.slipper).__name__}; a slipperjax.Sled has mounts on two"
        require(not rails, "track", need, shown=type(scene.track).__name__)
        return
    for name, slipper in zip(scene.slipper.names, scene.mounted, strict=True):
        known_rail = not rails or slipper.rail in rails
        need = f"be on the rails {', '.join(rails)}"
        require(known_rail, "mounts", need, shown=f"{name} on {slipper.rail or 'a rail without name'!r}")
        alike = (slipper.section.names, slipper.section.faces) == (scene.section.names, scene.section.faces)
        require(alike, "mounts", "have the points and faces of the scene's section", shown=f"others at {name}")
        _check_on_rail(scene, name, slipper)


def _check_on_rail(scene: Scene, name: str, slipper: Mounted) -> None:
    """Raise `ValueError` for a slipper that is outside its rail."""
    y = slipper.place[1]
    gauge = scene.track.gauge
    if not scene.track.rails or is_traced((y, gauge, slipper.section.play)):
        return
    across = 0.0 if y is None else float(y)
    side = 1.0 if slipper.rail == "left" else -1.0
    inside = side * across >= 0
    need = "be on the side of their rail, left at y > 0"
    if gauge is not None:
        play = float(np.max(np.asarray(slipper.section.play)))
        inside = abs(across - 0.5 * side * float(gauge)) <= play
        need = f"be within their play, {play:g} m, of the rails, whose gauge is {float(gauge):g} m"
    require(inside, "mounts", need, shown=f"{name} at y = {across:g} m")


def travel_unit(scene: Scene) -> str:
    """Return the name of a forcing period: "period", or its length where the rail has no waves, as in "8 m"."""
    return "period" if hasattr(scene.track, "wavelengths") else f"{float(scene.wavelength):g} m"


def check_scene(scene: object) -> Scene:
    """Return `scene`; raise `ValueError` where it is no scene, or if JAX runs with 32-bit numbers."""
    need_64_bits()
    # values from `equinox.tree_at` were not checked by a constructor
    return with_static_functions(instance("scene", scene, Scene, "a slipperjax.Scene"))


def check_steady(scene: object) -> Scene:
    """Return a scene whose motion may continue for ever; raises `ValueError` for wear, a programme of speeds, and
    loads that depend on time or distance."""
    scene = check_scene(scene)
    by_speed = scene.load is None or scene.load.by_speed
    require(by_speed, "scene", "have a load by the speed alone here", scene.load)
    require(scene.wear is None, "scene", "have no wear here, which slipperjax.run follows alone", scene.wear)
    if isinstance(scene.speed, SpeedProgramme):
        raise ValueError("Argument `scene` must have a constant speed, but has one with a programme of speeds.")
    return scene


def at_speed(scene: object, speed: Real | SpeedProgramme | None) -> Scene:
    """Return a checked scene at another speed or programme; with None at its own speed."""
    scene = check_scene(scene)
    return scene if speed is None else dataclasses.replace(scene, speed=speed)


START = COORDINATES | MOTION_NUMBERS
"""The numbers of a start in a file, which gives the attitude as Euler angles or as a quaternion."""


def _check_readable(name: str, part: eqx.Module) -> None:
    """Raise `ValueError` for a part of a scene that a file cannot restore, such as a law with a network."""
    why = "It would be read back with other numbers."
    try:
        own, again = map(jax.tree.leaves, (part, build(describe(part), (type(part), *INNER), name)))
        same = len(own) == len(again) and all(map(np.array_equal, own, again))
    except (TypeError, ValueError) as error:
        same = False
        why = str(error)
    require(same, name, "be one that a file can hold", shown=f"{type(part).__name__}. {why}")
