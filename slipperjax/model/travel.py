"""Travel: the slipper's speed along the rail, constant or by a programme."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ..tools.checks import check_no_clock, finite, instance, not_negative, number, positive, require, tuple_of
from ..tools.compile import at_once
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from ..tools.units import in_unit

LEAST_SPEED = 1.0
"""Least speed of histories and stages [m/s]. Where the sled is slower or at rest, runs pass at this speed, because a
distance at speed zero would take infinitely many steps."""


class Travel(NamedTuple):
    """Speed, and length of a forcing period, at a time given in forcing periods since the start."""

    speed: Array
    """Travelling speed [m/s]."""
    wavelength: Array
    """Distance of a forcing period [m]."""
    acceleration: Array | None = None
    """Travelling acceleration [m/s^2]; None where the speed is constant."""
    phase: Real | None = None
    """Forcing periods since distance zero [1]; None where there is no particular place."""
    programme: "SpeedProgramme | None" = None
    """Programme of the speed; None where the speed is constant."""

    @property
    def distance(self) -> Array:
        """Distance along the rail [m]."""
        assert self.phase is not None  # of every place
        return self.phase * self.wavelength

    @property
    def seconds(self) -> Array:
        """Time [s] by the programme, or at constant speed since distance zero."""
        if self.programme is None:
            return self.distance / self.speed
        return self.programme.seconds(self.distance)

    @property
    def period(self) -> Array:
        """Duration of a forcing period at this speed [s]."""
        return self.wavelength / self.speed


class Stage(ShapeChecked):
    """A part of a run at constant acceleration, which ends after a length, after a duration, or at a speed.

    Where several of these are given, the first in this order counts.
    """

    acceleration: Float[Array, ""] = field("m/s^2", finite)
    """Travelling acceleration [m/s^2]: thrust above zero, a brake below, coasting at zero."""
    length: Float[Array, ""] | None = field("m", positive, default=None)
    """Length of travel [m]."""
    duration: Float[Array, ""] | None = field("s", positive, default=None)
    """Duration [s]."""
    speed: Float[Array, ""] | None = field("m/s", not_negative, default=None)
    """Speed at the end [m/s]."""

    def after(self, speed: float) -> tuple[float, float, float]:
        """Return the length of the stage [m], the speed at its end [m/s] and its duration [s], from the speed at its
        beginning [m/s]."""
        acceleration = float(self.acceleration)
        if self.length is not None:
            length = float(self.length)
            square = speed**2 + 2 * acceleration * length
            need = f"go on to their ends from {speed:g} m/s, and not stop before"
            require(square >= 0 and speed + square > 0, "stages", need, self)
            end = float(np.sqrt(square))
            return length, end, 2 * length / (speed + end)
        # the length follows from the mean speed
        if self.duration is not None:
            duration = float(self.duration)
            end = speed + acceleration * duration
            require(end >= 0, "stages", f"not turn back from {speed:g} m/s", self)
            return duration * (speed + end) / 2, end, duration
        require(self.speed is not None, "stages", "have a length, a duration or a speed each", self)
        end = float(self.speed)
        require((end - speed) * acceleration > 0, "stages", f"reach their speed from {speed:g} m/s", self)
        return (end**2 - speed**2) / (2 * acceleration), end, (end - speed) / acceleration


class SpeedProgramme(ShapeChecked):
    """A travelling speed that changes along the run, at constant acceleration from each place to the next.

    ```python
    fast = sj.SpeedProgramme.stages([sj.Stage(200.0, speed=900.0), sj.Stage(0.0, length=500.0)], start=50.0)
    ```

    Before the first place and after the last place the speed is constant. Where a history or a stage is slower than
    `LEAST_SPEED`, or at rest, the programme passes at that speed, and `time` keeps the true duration.
    """

    distance: Float[Array, " places"] = field("m", finite)
    """Distances along the rail, increasing [m]."""
    speed: Float[Array, " places"] = field("m/s", positive)
    """Speeds at these distances [m/s]."""
    scale: Float[Array, ""] = field("", positive, default=1.0)
    """Factor of all speeds [1], for sweeps and derivatives."""
    time: Float[Array, " places"] | None = field("s", finite, default=None)
    """Times at these distances [s]; None where they follow from the speeds, from zero at the first place."""
    source: str = eqx.field(static=True, default="")
    """The file that the speeds were read from, with its digest; empty: none."""

    @classmethod
    def over_distance(cls, distance: Numbers, speed: Numbers) -> "SpeedProgramme":
        """Return a programme from speeds [m/s] of zero or more at some distances [m]."""
        if is_traced((distance, speed)):
            return cls(distance, speed)
        distance, speed = _history("distance", "m", distance, speed)
        # the time between two places follows from the mean speed
        means = (speed[1:] + speed[:-1]) / 2
        require(np.all(means > 0), "speed", "not be zero at two places one after the other", speed)
        return cls.passing(distance, speed, np.append(0.0, np.cumsum(np.diff(distance) / means)))

    @classmethod
    def over_time(cls, time: Numbers, speed: Numbers, *, begin: float = 0.0) -> "SpeedProgramme":
        """Return a programme from speeds [m/s] at some increasing times [s]; between two times the speed is linear in
        time. At the first time the sled is at `begin` [m] along the rail.

        For a sled at rest, a measured speed may be below zero by less than `LEAST_SPEED`; it counts as zero.
        """
        time, speed = _history("time", "s", time, speed)
        # the mean speed between two times is the mean of both speeds
        way = np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)
        distance = number(finite, "begin", begin, "m") + np.append(0.0, way)
        return cls.passing(distance, speed, time, timed=True)

    @classmethod
    def stages(cls, stages: Sequence[Stage], *, start: float, begin: float = 0.0) -> "SpeedProgramme":
        """Return a programme of stages, each with one acceleration.

        **Arguments:** `start`: speed at the beginning [m/s]; `begin`: place of the beginning along the rail [m].

        **Raises:** `ValueError` that shows the wrong stage: a stage without an end, or one that does not reach its
        speed.
        """
        rows = [(number(finite, "begin", begin, "m"), number(not_negative, "start", start, "m/s"), 0.0)]
        given = tuple_of("stages", stages, Stage, "a list of slipperjax.Stage")
        require(given, "stages", "have one stage or more", shown="none")
        # each stage begins where the stage before ended
        for stage in given:
            place, speed, time = rows[-1]
            length, end, duration = stage.after(speed)
            rows.append((place + length, end, time + duration))
        return cls.passing(*np.array(rows).T)

    @classmethod
    def passing(
        cls, distance: np.ndarray, speed: np.ndarray, time: np.ndarray, *, timed: bool = False
    ) -> "SpeedProgramme":
        """Return the programme of a history [m], [m/s], [s]; it passes at `LEAST_SPEED` where the history is slower.

        **Arguments:** `timed`: whether times are kept although they follow from the speeds.
        """
        # an end at the least speed may be slower by rounding
        slow = speed < LEAST_SPEED * (1 - 1e-6)
        if not np.any(slow):
            return cls(distance, speed, time=time if timed else None)
        require(not np.all(slow), "speed", f"reach {LEAST_SPEED:g} m/s", speed)
        # places where the sled crosses the least speed, at constant acceleration
        k = np.flatnonzero(slow[1:] != slow[:-1])
        before, after = speed[k], speed[k + 1]
        share_of_time = (LEAST_SPEED - before) / (after - before)
        share_of_way = (LEAST_SPEED**2 - before**2) / (after**2 - before**2)
        # the ends of the history remain, even where they are slow
        kept = ~slow
        kept[[0, -1]] = True
        time = np.append(time[kept], time[k] + share_of_time * np.diff(time)[k])
        distance = np.append(distance[kept], distance[k] + share_of_way * np.diff(distance)[k])
        speed = np.append(np.maximum(speed[kept], LEAST_SPEED), np.full(len(k), LEAST_SPEED))
        order = np.argsort(time)
        return cls(distance[order], speed[order], time=time[order])

    def __check_init__(self):
        instance("source", self.source, str, "the name of a file, or empty")
        check_table(self, "distance", "speed", least=2)
        if self.time is not None and not is_traced(self.time):
            increasing = self.time.shape == self.distance.shape and np.all(np.diff(np.asarray(self.time)) > 0)
            require(increasing, "time", "increase, one value per distance", self.time)

    @at_once
    def at(self, distance: ArrayLike) -> Float[Array, "*places"]:
        """Return the speed [m/s] at some distances from the start [m], of shape (*places,)."""
        return self.scale * self._place(jnp.asarray(distance, float))[2]

    @at_once
    def least(self, begin: Real, end: Real) -> Float[Array, ""]:
        """Return the least speed [m/s] between two distances from the start [m]."""
        # the least speed is at one of both ends or at a place between them
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
        # acceleration is half the slope of the squared speed
        slope = (square[k + 1] - square[k]) / (self.distance[k + 1] - self.distance[k])
        return jnp.where(inside, 0.5 * self.scale**2 * slope, 0.0)

    @at_once
    def seconds(self, distance: ArrayLike) -> Float[Array, "*places"]:
        """Return the time [s] at which some distances are reached: by `time`, or since the first place."""
        distance = jnp.asarray(distance, float)
        k, share, here = self._place(distance)
        passing, durations = self._durations
        before = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)])
        # lengths divided by the mean of the speeds at both ends
        within = 2 * share * jnp.diff(self.distance)[k] / (self.speed[k] + here)
        if self.time is not None:
            within = within * (durations / passing)[k]
        # before the first place and after the last the speed is constant
        beyond = jnp.minimum(distance - self.distance[0], 0.0) + jnp.maximum(distance - self.distance[-1], 0.0)
        since_first = (before[k] + within + beyond / here) / self.scale
        return since_first if self.time is None else self.time[0] + since_first

    @at_once
    def stands(self, begin: ArrayLike, end: ArrayLike) -> Bool[Array, "*places"]:
        """Return whether the sled is at rest or slower than `LEAST_SPEED` somewhere between two distances [m]."""
        before = jnp.concatenate([jnp.zeros(1, int), jnp.cumsum(self._slow)])
        # over the stretches between places, from the stretch of `begin` to the one which ends at or after `end`
        first = self._place(jnp.asarray(begin, float))[0]
        last = jnp.searchsorted(self.distance, jnp.asarray(end, float), side="left")
        return before[jnp.clip(last, 1, len(self.distance) - 1)] > before[first]

    @property
    def stops(self) -> list[tuple[float, float, float]]:
        """Lengths of rail where the sled is slower than `LEAST_SPEED`: both ends [m], and the duration [s]."""
        times = np.asarray(self.seconds(self.distance))
        places = np.asarray(self.distance)
        return [(*places[[k, k + 1]].tolist(), float(times[k + 1] - times[k])) for k in np.flatnonzero(self._slow)]

    @property
    def _slow(self) -> Bool[Array, " stretches"]:
        """Whether the way between two places takes longer than at the least speed; then runs pass at that speed."""
        passing, durations = self._durations
        fast = jnp.maximum(self.speed[1:], self.speed[:-1]) > LEAST_SPEED * (1 + 1e-9)
        return ~fast & (durations > passing * (1 + 1e-6))

    @property
    def _durations(self) -> tuple[Array, Array]:
        """Times between places over the scale [s]: at the speeds of the programme, and the true times."""
        passing = 2 * jnp.diff(self.distance) / (self.speed[1:] + self.speed[:-1])
        return passing, passing if self.time is None else jnp.diff(self.time)

    def _place(self, distance: Array) -> tuple[Array, Array, Array]:
        """Return the number of the stretch between places, the travelled share of the stretch [1], and the speed
        there over the scale [m/s]."""
        last = len(self.distance) - 2
        k = jnp.clip(jnp.searchsorted(self.distance, distance, side="right") - 1, 0, last)
        share = (distance - self.distance[k]) / (self.distance[k + 1] - self.distance[k])
        # exactly at the ends the derivative is that of the inside
        inside = (distance >= self.distance[0]) & (distance <= self.distance[-1])
        share = jnp.where(inside, share, jnp.clip(share, 0.0, 1.0))
        # at constant acceleration the square of the speed is linear in distance
        square = self.speed**2
        here = jnp.sqrt(square[k] + share * (square[k + 1] - square[k]))
        return k, share, here


def _history(name: str, unit: str, values: Numbers, speed: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """Return times or distances, checked, and the speeds there [m/s]; noise below zero becomes zero.

    **Raises:** `ValueError` for lists of different lengths, values that do not increase, or a sled that moves back.
    """
    finite(name, unit)(values)
    finite("speed", "m/s")(speed)
    values = np.asarray(in_unit(values, unit), float)
    speed = np.asarray(in_unit(speed, "m/s"), float)
    alike = values.ndim == 1 and values.shape == speed.shape and len(values) > 1
    need = f"have one value for each of two or more {name}s"
    require(alike, "speed", need, shown=f"shape {speed.shape} for {values.shape}")
    require(np.all(np.diff(values) > 0), name, "increase", values)
    if name == "time":
        check_no_clock(name, values)
    least = int(np.argmin(speed))
    shown = f"{speed[least]:g} m/s at {name} {values[least]:.10g} {unit}"
    need = f"not be below -{LEAST_SPEED:g} m/s, which is noise that the `cutoff` of a file removes"
    require(speed[least] > -LEAST_SPEED, "speed", need, shown=shown)
    return values, np.maximum(speed, 0.0)
