"""Travel: how fast the slipper moves along the rail, the same all the way or by a programme."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..tools.checks import finite, in_unit, instance, number, positive, require
from ..tools.compile import at_once, is_traced
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.types import Numbers, Real

LEAST_SPEED = 1.0
"""Least speed of a programme [m/s]: a sled that stands still on its way never arrives."""


class Travel(NamedTuple):
    """Speed, and length of a forcing period, at a time given in forcing periods since the start."""

    speed: Array
    """Travelling speed [m/s]."""
    wavelength: Array
    """Distance that counts as a forcing period [m]."""
    acceleration: Array | None = None
    """Travelling acceleration [m/s^2]; None where the speed is constant."""

    @property
    def period(self) -> Array:
        """Time that a forcing period takes at this speed [s]."""
        return self.wavelength / self.speed


class Stage(ShapeChecked):
    """A part of a run at constant acceleration, which ends after a length, or a duration, or at a speed.

    Where several are given, the first of these counts.
    """

    acceleration: Float[Array, ""] = field("m/s^2", finite)
    """Travelling acceleration [m/s^2]: thrust above zero, a brake below, coasting at zero."""
    length: Float[Array, ""] | None = field("m", positive, default=None)
    """Length of travel [m]."""
    duration: Float[Array, ""] | None = field("s", positive, default=None)
    """Time that it takes [s]."""
    speed: Float[Array, ""] | None = field("m/s", positive, default=None)
    """Speed at its end [m/s]."""

    def after(self, speed: float) -> tuple[float, float]:
        """Return the length of the stage [m] and the speed at its end [m/s], from that at its beginning [m/s]."""
        acceleration = float(self.acceleration)
        if self.length is not None:
            length = float(self.length)
            # what would turn back ends at zero, which no programme may have
            return length, float(np.sqrt(max(speed**2 + 2 * acceleration * length, 0.0)))
        # the way is that of the mean speed
        if self.duration is not None:
            end = speed + acceleration * float(self.duration)
            return float(self.duration) * (speed + end) / 2, end
        require(self.speed is not None, "stages", "have a length, a duration or a speed each", self)
        end = float(self.speed)
        require((end - speed) * acceleration > 0, "stages", f"reach their speed from {speed:g} m/s", self)
        return (end**2 - speed**2) / (2 * acceleration), end


class SpeedProgramme(ShapeChecked):
    """A travelling speed that changes along the run, at constant acceleration from each place to the next.

    ```python
    fast = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0), sj.Stage(0.0, length=500.0)], start=50.0)
    ```

    Before the first place and after the last the speed is constant.
    """

    distance: Float[Array, " places"] = field("m", finite)
    """Distances along the rail, increasing [m]."""
    speed: Float[Array, " places"] = field("m/s", positive)
    """Speeds there [m/s], `LEAST_SPEED` at least."""
    scale: Float[Array, ""] = field("", positive, default=1.0)
    """Factor of all speeds [1], for sweeps and derivatives."""

    @classmethod
    def over_distance(cls, distance: Numbers, speed: Numbers) -> "SpeedProgramme":
        """Return a programme from speeds [m/s] at some distances [m]."""
        return cls(distance, speed)

    @classmethod
    def over_time(cls, time: Numbers, speed: Numbers, *, begin: float = 0.0) -> "SpeedProgramme":
        """Return a programme from speeds [m/s] at some times [s], increasing; between them the speed is linear in
        time. At the first one the sled is at `begin` [m] along the rail."""
        finite("time", "s")(time)
        positive("speed", "m/s")(speed)
        time = np.asarray(in_unit(time, "s"), float)
        speed = np.asarray(in_unit(speed, "m/s"), float)
        require(
            time.ndim == 1 and time.shape == speed.shape,
            "speed",
            f"have one value per time, {time.shape}",
            shown=f"shape {speed.shape}",
        )
        require(np.all(np.diff(time) > 0), "time", "increase", time)
        # between two times the mean speed is that of both ends
        way = np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)
        return cls(number(finite, "begin", begin, "m") + np.concatenate([[0.0], way]), speed)

    @classmethod
    def stages(cls, stages: Sequence[Stage], *, start: float, begin: float = 0.0) -> "SpeedProgramme":
        """Return a programme of stages with one acceleration each.

        **Arguments:** `start`: speed at the beginning [m/s]; `begin`: where that is along the rail [m].

        **Raises:** `ValueError` that shows the stage which is wrong: one without an end, or that misses its speed.
        """
        instance("stages", stages, Sequence, "a list of slipperjax.Stage")
        distance = [number(finite, "begin", begin, "m")]
        speed = [number(positive, "start", start, "m/s")]
        # each stage begins where the one before ended
        for stage in stages:
            length, end = instance("stages", stage, Stage, "a list of slipperjax.Stage").after(speed[-1])
            distance.append(distance[-1] + length)
            speed.append(end)
        return cls(distance, speed)

    def __check_init__(self):
        check_table(self, "distance", "speed", least=2)
        if not is_traced((self.speed, self.scale)):
            scale = np.min(np.asarray(self.scale), initial=np.inf)
            least = float(np.min(np.asarray(self.speed)) * scale)
            require(least >= LEAST_SPEED * (1 - 1e-9), "speed", f"be {LEAST_SPEED:g} m/s or more", least)

    @at_once
    def at(self, distance: ArrayLike) -> Float[Array, "*places"]:
        """Return the speed [m/s] at some distances from the start [m], of shape (*places,)."""
        return self.scale * self._place(jnp.asarray(distance, float))[2]

    @at_once
    def least(self, begin: Real, end: Real) -> Float[Array, ""]:
        """Return the least speed [m/s] between two distances from the start [m]."""
        # the least is at one of both ends or at a place between them
        between = (self.distance > begin) & (self.distance < end)
        inside = self.scale * jnp.min(jnp.where(between, self.speed, jnp.inf))
        return jnp.minimum(inside, jnp.minimum(self.at(begin), self.at(end)))

    @at_once
    def acceleration(self, distance: ArrayLike) -> Float[Array, "*places"]:
        """Return the travelling acceleration [m/s^2] at some distances [m]; zero beyond the ends."""
        distance = jnp.asarray(distance, float)
        k, _, _ = self._place(distance)
        square = self.speed**2
        inside = (distance >= self.distance[0]) & (distance < self.distance[-1])
        # half the slope of the speed's square is the acceleration
        slope = (square[k + 1] - square[k]) / (self.distance[k + 1] - self.distance[k])
        return jnp.where(inside, 0.5 * self.scale**2 * slope, 0.0)

    @at_once
    def seconds(self, distance: ArrayLike) -> Float[Array, "*places"]:
        """Return the time [s] in which some distances [m] are reached from distance zero."""
        return self._since_first(jnp.asarray(distance, float)) - self._since_first(jnp.zeros(()))

    def _since_first(self, distance: Array) -> Array:
        """Return the time since the first place [s]: lengths over the mean of the speeds at their ends."""
        k, share, here = self._place(distance)
        lengths = jnp.diff(self.distance)
        durations = 2 * lengths / (self.speed[1:] + self.speed[:-1])
        before = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)])
        # before the first place and after the last the speed is constant
        beyond = jnp.minimum(distance - self.distance[0], 0.0) + jnp.maximum(distance - self.distance[-1], 0.0)
        time = before[k] + 2 * share * lengths[k] / (self.speed[k] + here) + beyond / here
        return time / self.scale

    def _place(self, distance: Array) -> tuple[Array, Array, Array]:
        """Return the number of the stretch between places, the share of it that is behind [1], and the speed there
        over the scale [m/s]."""
        last = len(self.distance) - 2
        k = jnp.clip(jnp.searchsorted(self.distance, distance, side="right") - 1, 0, last)
        share = (distance - self.distance[k]) / (self.distance[k + 1] - self.distance[k])
        # at the very ends the derivative is that of the inside
        inside = (distance >= self.distance[0]) & (distance <= self.distance[-1])
        share = jnp.where(inside, share, jnp.clip(share, 0.0, 1.0))
        # at constant acceleration the square of the speed is linear in distance
        square = self.speed**2
        here = jnp.sqrt(square[k] + share * (square[k + 1] - square[k]))
        return k, share, here
