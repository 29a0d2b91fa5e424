"""Sensors on a slipper or a sled: their readings of its motion, with gain, bias, delay and filter."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, number, one_of, positive, require, tuple_of
from ..tools.compile import as_argument
from ..tools.fields import ShapeChecked, field
from ..tools.tracing import is_traced
from ..tools.types import AnyArray, Real
from .dynamics import Args, State, forces_at, newton_euler, resultants, wrench_directions
from .kinematics import Motion, RailFrame, body_numbers, contacts, rotation
from .modes import Modes

AXES = ("x", "y", "z")
UNITS = {"acceleration": "m/s^2", "displacement": "m", "angular_velocity": "rad/s", "force": "N"}
"""Units of what a sensor can measure."""


def _direction(value: object) -> Array:
    """Return a direction as a vector, from the name of an axis or three numbers."""
    if isinstance(value, str):
        return as_argument(np.eye(3)[AXES.index(one_of("direction", value, AXES))])
    return finite("direction")(value)


def _noise(value: object) -> float | None:
    return None if value is None else number(positive, "noise", value)


class Channels(NamedTuple):
    """Motion, acceleration and load of the body at some instants, from which the signals of all sensors are made."""

    motion: Float[AnyArray, "*instants 10"]
    """The numbers of `Motion`, in SI units."""
    acceleration: Float[AnyArray, "*instants 5"]
    """Accelerations of the centre along y and z [m/s^2], and about the body's x, y and z [rad/s^2]."""
    force: Float[AnyArray, "*instants 2"]
    """Force of all contacts together along y and z [N]."""
    modal: Float[AnyArray, "*instants 2 modes"]
    """Coordinates [m kg^0.5] and accelerations [m kg^0.5/s^2] of the modes."""


def channels(args: Args, t: Real, state: State, frame: RailFrame | None = None) -> Channels:
    """Return the channels of a state at time `t` [forcing periods]. **Arguments:** `frame`: `args.frame(t)`."""
    scene, motion = args.scene, state.motion
    frame = args.frame(t) if frame is None else frame
    at = forces_at(scene, frame, contacts(frame, motion), state)
    travel = args.travel(t)
    wrench, _ = resultants(frame, [at.force * way for way in wrench_directions(scene, at, travel)])
    rates = newton_euler(scene, motion, wrench, travel)
    modal = jnp.zeros((2, 0))
    if motion.modes is not None and rates.modes is not None:
        modal = jnp.stack([motion.modes.coordinate, rates.modes.rate])
    return Channels(
        jnp.stack(body_numbers(motion)),
        jnp.stack(body_numbers(rates)[5:]),
        jnp.stack(wrench[:2]),
        modal,
    )


class Sensor(ShapeChecked):
    """A sensor on the body: an accelerometer, a displacement gauge, a gyroscope, or load cells under all slippers.

    Its reading is gain (signal + bias), delayed by `delay`, after a low-pass filter where it has a `cutoff`.
    `slipperjax.fit` may find all of its numbers, by paths such as "sensors.front.gain".
    """

    name: str = eqx.field(static=True)
    """Name of the sensor's signal among the measured signals."""
    measures: str = eqx.field(static=True, default="acceleration")
    """ "acceleration" of the place, without gravity [m/s^2]; "displacement" of the place from the middle of the play
    on an undisturbed rail [m]; "angular_velocity" [rad/s]; "force" of all contacts together [N]."""
    place: Float[Array, "3"] = field("m", finite, default=(0.0, 0.0, 0.0))
    """Place from the centre of mass [m]; on an elastic body one of its modes' places."""
    direction: Float[Array, "3"] = eqx.field(converter=_direction, default="z")
    """Axis of the body, or a vector of any length."""
    gain: Float[Array, ""] = field("1", finite, default=1.0)
    bias: Float[Array, ""] = field("", finite, default=0.0)
    """Bias, in the unit of the signal."""
    delay: Float[Array, ""] = field("s", finite, default=0.0)
    cutoff: Float[Array, ""] | None = field("Hz", positive, default=None)
    """Frequency above which a Butterworth filter of second order suppresses the signal [Hz]."""
    noise: float | None = eqx.field(static=True, converter=_noise, default=None)
    """Standard deviation of the noise, in the unit of the signal; None: the part that the model does not explain."""

    def __check_init__(self):
        require(isinstance(self.name, str) and self.name.isidentifier(), "name", "be a word", self.name)
        one_of("measures", self.measures, UNITS)
        if is_traced(self.direction):
            return
        length = np.linalg.norm(np.asarray(self.direction))
        require(length > 0, "direction", "be a vector", shown="zero")
        across = self.measures not in ("displacement", "force") or self.direction[0] == 0
        need = f"be across the rail for a {self.measures}, such as y or z"
        require(across, "direction", need, np.asarray(self.direction))

    @property
    def unit(self) -> str:
        """Unit of the signal."""
        return UNITS[self.measures]

    def signal(self, seen: Channels, modes: Modes | None = None) -> Float[Array, ""]:
        """Return the signal at an instant, without gain, bias, delay and filter [`unit`]."""
        axis = self.direction / jnp.linalg.norm(self.direction)
        motion = Motion(*seen.motion)
        spin = jnp.stack([motion.w_x, motion.w_y, motion.w_z])
        if self.measures == "angular_velocity":
            return jnp.dot(axis, spin)
        if self.measures == "force":
            return jnp.dot(axis[1:], seen.force)
        shape = jnp.zeros((seen.modal.shape[-1], 3)) if modes is None else modes.shape_at(self.place)
        deflection, modal = seen.modal @ shape
        # the motion along x is prescribed
        if self.measures == "displacement":
            turned = jnp.array(rotation(motion)) @ (self.place + deflection) - self.place
            return jnp.dot(axis, turned + jnp.stack([jnp.zeros(()), motion.y, motion.z]))
        of_centre = jnp.concatenate([jnp.zeros(1), seen.acceleration[:2]])
        turning = jnp.cross(seen.acceleration[2:], self.place) + jnp.cross(spin, jnp.cross(spin, self.place))
        return jnp.dot(axis, of_centre + turning + modal)

    def read(
        self,
        seen: Channels,
        time: Float[Array, " instants"],
        at: Float[Array, " samples"],
        modes: Modes | None = None,
    ) -> Float[Array, " samples"]:
        """Return the readings at some times.

        **Arguments:** `seen`: channels at equally spaced instants; `time`: of these instants [s]; `at`: times of the
        readings, from the same zero [s].
        """
        return self.reading(jax.vmap(lambda now: self.signal(now, modes))(seen), time, at)

    def reading(
        self, signal: Float[Array, " instants"], time: Float[Array, " instants"], at: Float[Array, " samples"]
    ) -> Float[Array, " samples"]:
        """Return the readings of a signal [`unit`] with gain, bias, delay and filter; arguments as of `read`."""
        if self.cutoff is not None:
            last = time.shape[0] - 1
            signal = low_pass(signal, self.cutoff * (time[last] - time[0]) / last)
        at = at - self.delay
        # the place of each sample, in instants
        before = jnp.clip(
            jnp.searchsorted(jax.lax.stop_gradient(time), jax.lax.stop_gradient(at)) - 1, 0, len(time) - 2
        )
        place = before + (at - time[before]) / (time[before + 1] - time[before])
        return self.gain * (interpolated(signal, place) + self.bias)


def interpolated(values: Float[Array, " instants"], place: Float[Array, " samples"]) -> Float[Array, " samples"]:
    """Return values at places given in instants, by the cubic through the four instants around each place."""
    last = values.shape[0] - 1
    first = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)).astype(int) - 1, 0, last - 3)
    x = place - first
    a, b, c, d = (values[first + k] for k in range(4))
    # Lagrange's polynomials on 0, 1, 2 and 3
    outer = (1 - x) * (2 - x) / 6
    inner = x * (3 - x) / 2
    return a * outer * (3 - x) + b * inner * (2 - x) - c * inner * (1 - x) + d * outer * x


def low_pass(signal: Float[Array, " instants"], cutoff: Real) -> Float[Array, " instants"]:
    """Return a signal after a Butterworth filter of second order, made by the bilinear transformation.

    The filter begins as if the first value had lasted. **Arguments:** `cutoff`: frequency times the step [1], below
    1/2.
    """
    warped = jnp.tan(jnp.pi * cutoff)
    scale = 1 / (1 + np.sqrt(2.0) * warped + warped**2)
    ahead = warped**2 * scale
    back_1 = 2 * (warped**2 - 1) * scale
    back_2 = (1 - np.sqrt(2.0) * warped + warped**2) * scale

    def step(last, x):
        (x_1, x_2), (y_1, y_2) = last
        y = ahead * (x + 2 * x_1 + x_2) - back_1 * y_1 - back_2 * y_2
        return ((x, x_1), (y, y_1)), y

    begin = (signal[0], signal[0])
    return jax.lax.scan(step, (begin, begin), signal)[1]


class Rig(eqx.Module):
    """Sensors as one module, whose numbers have paths such as "sensors.front.gain"."""

    sensors: tuple[Sensor, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sensor.name for sensor in self.sensors)

    @classmethod
    def of(cls, sensors: object) -> "Rig":
        """Return sensors as one module; raises `ValueError` unless they are a list with different names."""
        rig = cls(tuple_of("sensors", sensors, Sensor, "a list of slipperjax.model.Sensor"))
        require(rig.sensors, "sensors", "have one or more", shown="none")
        require(len(set(rig.names)) == len(rig.names), "sensors", "have different names", ", ".join(rig.names))
        return rig
