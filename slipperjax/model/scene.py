"""The scene: slipper, section, track, contact and speed. Plain pytrees in SI units, checked when made."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import not_negative, optional, positive
from .contact import AbstractContactLaw, AbstractMemory, EventLatch, Flores
from .section import Section, half_play, paper_section
from .track import AbstractTrack, HarmonicTrack


class Slipper(eqx.Module):
    """A rigid slipper."""

    mass: Float[Array, ""] = eqx.field(converter=positive("mass", "kg"))
    """Mass [kg]."""
    inertia: Float[Array, "3"] = eqx.field(converter=positive("inertia", "kg m^2"))
    """Principal moments of inertia about x, y and z of the slipper's frame [kg m^2]."""
    length: Float[Array, ""] = eqx.field(converter=positive("length", "m"))
    """Distance between the front and the rear section [m]."""

    def __check_init__(self):
        if self.inertia.shape[-1:] != (3,):
            raise ValueError(f"Argument `inertia` must have 3 entries, but has shape {self.inertia.shape}.")


class Scene(eqx.Module):
    """Everything that defines one case. What is None is not there: it costs no state and no operation."""

    speed: Float[Array, ""] = eqx.field(converter=positive("speed", "m/s"))
    """Travelling speed V [m/s]."""
    slipper: Slipper
    section: Section
    track: AbstractTrack
    contact: AbstractContactLaw
    memory: AbstractMemory = EventLatch()
    """How the contact's memory is carried, if its law has one."""
    gravity: Float[Array, ""] | None = eqx.field(converter=optional(not_negative("gravity", "m/s^2")), default=None)
    """Gravitational acceleration along -z [m/s^2]."""

    @property
    def period(self) -> Float[Array, ""]:
        """The forcing period [s]: the time to travel the track's (first) wavelength."""
        return self.track.wavelength / self.speed

    @property
    def points(self) -> int:
        """Number of contact points at both ends together."""
        return 2 * len(self.section.names)

    def replace(self, **values: Any) -> "Scene":
        """A copy with other values of named parameters; see `PARAMETERS` for the names and units.

        Unlike making a scene anew, this checks nothing but the names, so that it can stand in a batched function.
        """
        scene = self
        for name, value in values.items():
            scene = _setter(self, name)(scene, value)
        return scene

    def settled(self) -> "Scene":
        """A copy whose contact memory has the numbers that it leaves to the scene, see `SmoothSwitch`."""
        memory = self.memory.scaled(contact_depth(self), contact_duration(self), self.period)
        return self if memory is self.memory else eqx.tree_at(lambda s: s.memory, self, memory)

    def value(self, name: str) -> Array:
        """The present value of a named parameter, see `PARAMETERS`."""
        _setter(self, name)
        return _GETTERS[name](self)


_GETTERS = {
    "speed": lambda s: s.speed,
    "clearance": lambda s: 2 * jnp.mean(s.section.play),
    "length": lambda s: s.slipper.length,
    "mass": lambda s: s.slipper.mass,
    "stiffness": lambda s: s.contact.stiffness,
    "restitution": lambda s: s.contact.restitution,
    "amplitude": lambda s: s.track.amplitude,
    "roll_amplitude": lambda s: s.track.roll_amplitude,
    "gravity": lambda s: s.gravity,
}

PARAMETERS = {
    "speed": ("m/s", "travelling speed", positive("speed", "m/s")),
    "clearance": ("m", "total play of slipper and rail", not_negative("clearance", "m")),
    "length": ("m", "slipper length", positive("length", "m")),
    "mass": ("kg", "slipper mass", positive("mass", "kg")),
    "stiffness": ("N/m^1.5", "contact stiffness", positive("stiffness", "N/m^1.5")),
    "restitution": ("1", "coefficient of restitution", None),
    "amplitude": ("m", "irregularity amplitude", not_negative("amplitude", "m")),
    "roll_amplitude": ("rad", "irregularity roll amplitude", not_negative("roll_amplitude", "rad")),
    "gravity": ("m/s^2", "gravitational acceleration", not_negative("gravity", "m/s^2")),
}
"""Unit, description and check of the parameters that `Scene.replace`, `sweep` and the design tools know by name."""


def _setter(scene: Scene, name: str):
    if name not in PARAMETERS:
        raise ValueError(f"Argument `{name}` is no parameter; the names are {', '.join(PARAMETERS)}.")
    try:
        present = _GETTERS[name](scene) is not None
    except AttributeError:
        present = False
    if not present:
        raise ValueError(f"Argument `{name}` cannot be set: the scene has no {PARAMETERS[name][1]}.")
    if name == "clearance":
        return lambda s, v: eqx.tree_at(
            lambda s: s.section.play, s, half_play(jnp.asarray(v, float), len(s.section.faces))
        )
    return lambda s, v: eqx.tree_at(_GETTERS[name], s, jnp.asarray(v, float))


def paper_scene(
    speed: Any = 1250.0,
    clearance: Any = 1e-3,
    length: Any = 0.2,
    *,
    stiffness: Any = 1e8,
    restitution: Any = 0.9,
    wavelengths: Sequence[float] = (8.0,),
    amplitude: Any = 1e-3,
    roll_amplitude: Any = math.radians(0.2),
    clamp: bool = True,
    memory: AbstractMemory | None = None,
) -> Scene:
    """The system of Dang et al. 2024, Tables 1 to 3.

    **Arguments:**

    - `speed`: travelling speed V [m/s].
    - `clearance`: total play C of slipper and rail [m]; each face has half of it.
    - `length`: slipper length L_S [m].
    - `stiffness`: contact stiffness K [N/m^1.5]. `restitution`: coefficient c_r [1].
    - `wavelengths`: one or more wavelengths L_X of the irregularity [m].
    - `amplitude`, `roll_amplitude`: amplitudes of the irregularity [m] and [rad].
    - `clamp`: whether a contact may only push. `memory`: how it remembers its touchdown, default `EventLatch()`.

    **Returns:** a `Scene`.

    **Raises:** `ValueError` that names the argument which is out of range.
    """
    return Scene(
        speed=speed,
        slipper=Slipper(mass=14.0, inertia=(0.051, 0.060, 0.086), length=length),
        section=paper_section(clearance),
        track=HarmonicTrack(wavelengths, amplitude, roll_amplitude),
        contact=Flores(stiffness, restitution, clamp),
        memory=EventLatch() if memory is None else memory,
    )


def contact_duration(scene: Scene) -> Float[Array, ""]:
    """How long a typical impact lasts [s], from Hertz's theory without damping.

    The approach speed is the track's peak lateral speed (0.1 m/s at least); the mass is what a corner presents,
    translation and rotation together. Serves to choose step sizes and the smooth switch, nothing else.
    """
    return 2.94 * contact_depth(scene) / _approach(scene)


@jax.jit  # one small program, where each of the operations would be one
def impacts_per_period(scene: Scene) -> Float[Array, ""]:
    """How many typical impacts, one after the other, would fill a forcing period [1]: see `contact_duration`."""
    return scene.period / contact_duration(scene)


def contact_depth(scene: Scene) -> Float[Array, ""]:
    """How deep a typical impact goes [m]: see `contact_duration`."""
    slipper = scene.slipper
    reach = jnp.max(jnp.abs(scene.section.points))
    mass = 1 / (1 / slipper.mass + reach**2 / slipper.inertia[0] + slipper.length**2 / 4 / slipper.inertia[1])
    return (1.25 * mass * _approach(scene) ** 2 / scene.contact.stiffness) ** 0.4


def _approach(scene: Scene) -> Float[Array, ""]:
    amplitude = getattr(scene.track, "amplitude", 0.0)
    return jnp.maximum(2 * jnp.pi * jnp.abs(amplitude) * scene.speed / scene.track.wavelength, 0.1)


def default_steps_per_period(scene: Scene, *, per_contact: int = 15, least: int = 50) -> int:
    """Steps per forcing period such that a typical impact takes `per_contact` steps, and `least` at least.

    Takes the most demanding case where the scene's leaves are batched. Rounded up to a multiple of 50.
    """
    ratio = jnp.max(impacts_per_period(scene))
    if isinstance(ratio, jax.core.Tracer):
        raise ValueError("Argument `steps_per_period` must be given where the scene is traced (jit, grad, vmap).")
    steps = max(least, per_contact * float(ratio))
    return 50 * math.ceil(steps / 50)
