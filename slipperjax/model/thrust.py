"""Speeds that follow from forces along the rail: thrust, drag, friction and water brakes."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, not_negative, positive, require, tuple_of
from ..tools.fields import ShapeChecked, check_table, field
from ..tools.files import content_of, readable, user_path
from ..tools.tables import read_rows
from ..tools.units import STANDARD_GRAVITY
from .travel import LEAST_SPEED, SpeedProgramme

PLACES = 500
"""Number of places of a programme at equal times, and at equal distances, in each of its phases: thrust, coasting,
and every brake."""
NOISE = 0.02
"""Greatest value below zero of a measured thrust, over the greatest thrust [1]."""
ACCURACY = 1e-9
"""Relative tolerance of the integration, and absolute tolerance [m], [m/s]."""


class WaterBrake(ShapeChecked):
    """A scoop that dips into a trough of water between two distances, and turns the water that it takes up.

    The force is the water's change of momentum along the rail, rho A V^2 (1 - cos(turn)), as for the rocket sled with
    a scoop in F. M. White, Fluid Mechanics, chapter 3.
    """

    begin: Float[Array, ""] = field("m", finite)
    """Distance along the rail where the scoop dips in [m]."""
    end: Float[Array, ""] = field("m", finite)
    """Distance along the rail where the scoop leaves the water [m]."""
    area: Float[Array, ""] = field("m^2", positive)
    """Area of the scoop in the water [m^2]."""
    turn: Float[Array, ""] = field("rad", positive, default=math.pi / 2)
    """Angle by which the scoop turns the water [rad]: 90 degrees sends the water sideways, 180 degrees forwards."""
    density: Float[Array, ""] = field("kg/m^3", positive, default=1000.0)
    """Density of the water [kg/m^3]."""

    def __check_init__(self):
        require(self.begin < self.end, "end", f"lie beyond `begin`, {float(self.begin):g} m", float(self.end))

    @property
    def force_by_square(self) -> float:
        """Force over the square of the speed [N s^2/m^2]."""
        return float(self.density * self.area * (1 - np.cos(self.turn)))


class RocketSled(ShapeChecked):
    """A whole sled with its forces along the rail, from which the programme of its speed follows.

    ```python
    of_sled = dict(mass=300.0, propellant=80.0, drag_area=0.1, friction=0.2)
    sled = sj.model.RocketSled([0.0, 2.0, 2.1], [9e4, 8e4, 0.0], **of_sled)
    scene = dataclasses.replace(scene, speed=sled.programme())
    ```
    """

    time: Float[Array, " rows"] = field("s", finite)
    """Times of the thrust, increasing [s]. At the first time the sled is at rest."""
    thrust: Float[Array, " rows"] = field("N", not_negative)
    """Thrust at these times, linear between them [N]; zero after the last time."""
    mass: Float[Array, ""] = field("kg", positive)
    """Mass at the beginning, including propellant [kg]."""
    propellant: Float[Array, ""] = field("kg", not_negative, default=0.0)
    """Mass that burns, in proportion to the impulse of the thrust [kg]."""
    drag_area: Float[Array, ""] = field("m^2", not_negative, default=0.0)
    """Drag coefficient times area [m^2]."""
    density: Float[Array, ""] = field("kg/m^3", positive, default=1.225)
    """Density of the air [kg/m^3]."""
    friction: Float[Array, ""] = field("", not_negative, default=0.0)
    """Friction on the rail over the weight [1]."""
    brakes: tuple[WaterBrake, ...] = eqx.field(
        converter=lambda brakes: tuple_of("brakes", brakes, WaterBrake, "a list of slipperjax.model.WaterBrake(...)"),
        default=(),
    )
    """Water brakes along the rail."""
    begin: Float[Array, ""] = field("m", finite, default=0.0)
    """Distance along the rail of the sled at the beginning [m]."""
    length: Float[Array, ""] = field("m", positive, default=1e5)
    """Length of travel after which the programme ends if the sled has not stopped [m]."""

    @classmethod
    def from_file(cls, file: str | Path, **more: object) -> "RocketSled":
        """Read the thrust from a file, a table as for `load_rail` with columns `time` and `thrust`, or a motor in
        RASP's format, .eng; see `RocketSled` for the other arguments.

        **Raises:** `ValueError` with all faults of the file by their lines; `OSError` for a file that cannot be read.
        """
        return cls(**read_thrust(file), **more)

    def __check_init__(self):
        check_table(self, "time", "thrust", least=2)
        require(self.propellant < self.mass, "propellant", "be less than the mass", float(self.propellant))

    def programme(self) -> SpeedProgramme:
        """Return the programme of speeds, until the sled is slower than `LEAST_SPEED` without thrust, or has
        travelled `length`.

        **Raises:** `ValueError` where the thrust does not move the sled.
        """
        from scipy.integrate import solve_ivp  # here, because importing it takes time

        begin = float(self.begin)
        far = begin + float(self.length)
        start = float(self.time[0])
        burnout = float(self.time[-1])
        # after the last time with thrust, or after a pause, a slow sled stays slow
        pushed = np.asarray(self.time)[1:][np.asarray(self.thrust[1:] + self.thrust[:-1]) > 0]
        last_push = float(pushed[-1]) if len(pushed) else start
        # forces have no jumps between these distances
        edges = sorted(x for b in self.brakes for x in (float(b.begin), float(b.end)) if begin < x < far)
        edges.append(far)
        # so that no step passes over a row of the thrust
        row = max(float(np.min(np.diff(self.time))), (burnout - start) / 1000)
        t, x, v = start, begin, 0.0
        rows = []
        moves = True
        while moves and x < far:
            burns = t < burnout
            edge = next(place for place in edges if place > x)
            found = solve_ivp(
                self._rates(sum(b.force_by_square for b in self.brakes if b.begin <= x < b.end), burns),
                (t, burnout if burns else t + (edge - x) / LEAST_SPEED),
                (x, v),
                method="DOP853",
                events=(
                    _falls(lambda t, y: y[1] - LEAST_SPEED if t >= last_push else 1.0),
                    _falls(lambda _, y, edge=edge: edge - y[0]),
                ),
                dense_output=True,
                rtol=ACCURACY,
                atol=ACCURACY,
                max_step=row if burns else np.inf,
            )
            times, places, speeds = _sampled(found)
            # a phase begins where the phase before ended
            rows.append(np.stack([places, speeds, times])[:, 1 if rows else 0 :])
            slow, reached = (len(hits) > 0 for hits in found.t_events)
            t, v = float(found.t[-1]), float(speeds[-1])
            x = edge if reached else float(places[-1])
            moves = not slow and (burns or v > LEAST_SPEED)
        places, speeds, times = np.concatenate(rows, axis=1)
        need = "move the sled against its friction"
        require(np.max(speeds) > LEAST_SPEED, "thrust", need, float(np.max(self.thrust)))
        rises = np.append(True, np.diff(np.maximum.accumulate(places)) > 0)
        return SpeedProgramme.passing(places[rises], speeds[rises], times[rises], timed=True)

    def _rates(self, brake: float, burns: bool) -> Callable[[float, np.ndarray], tuple[float, float]]:
        """Return the derivatives of distance and speed, as a function of time and of both.

        **Arguments:** `brake`: force of water brakes over the square of the speed [N s^2/m^2]; `burns`: whether there
        is thrust.
        """
        time = np.asarray(self.time)
        thrust = np.asarray(self.thrust)
        impulses = np.append(0.0, np.cumsum(np.diff(time) * (thrust[1:] + thrust[:-1]) / 2))
        mass = float(self.mass)
        per_impulse = float(self.propellant) / impulses[-1] if impulses[-1] else 0.0
        drag = 0.5 * float(self.density * self.drag_area) + brake
        friction = float(self.friction) * STANDARD_GRAVITY

        def rates(t: float, y: np.ndarray) -> tuple[float, float]:
            v = y[1]
            push = 0.0
            burnt = impulses[-1]
            if burns:
                # the thrust is linear between its rows, and the burnt mass is its integral
                k = min(max(int(np.searchsorted(time, t, side="right")) - 1, 0), len(time) - 2)
                since = t - time[k]
                push = thrust[k] + since * (thrust[k + 1] - thrust[k]) / (time[k + 1] - time[k])
                burnt = impulses[k] + since * (thrust[k] + push) / 2
            a = (push - drag * v * abs(v)) / (mass - per_impulse * burnt) - friction
            # a sled at rest is not pushed backwards
            return v, a if v > 0 else max(a, 0.0)

        return rates


def _sampled(found: Any) -> np.ndarray:
    """Return times, distances and speeds of a solution of `solve_ivp` at `PLACES` equal times and equal distances.

    Equal times are close together at the beginning, equal distances at high speeds.
    """
    steps = len(found.t) - 1
    finely = np.interp(np.arange(steps * 200 + 1) / 200, np.arange(steps + 1), found.t)
    solution = found.sol(finely)
    rows = (finely, solution[0])
    kept = np.concatenate([np.searchsorted(row, np.linspace(row[0], row[-1], PLACES)) for row in rows])
    at = np.unique(np.clip(kept, 0, len(finely) - 1))
    return np.vstack([finely[at], solution[:, at]])


def _falls(value: Any) -> Any:
    """Return an event that ends `solve_ivp` where a value changes from positive to negative."""
    value.terminal = True
    value.direction = -1
    return value


def _of_motor(path: Path) -> dict[str, np.ndarray]:
    """Return the thrust of a motor in RASP's format: remarks after ;, a line of seven words, and rows of time [s] and
    thrust [N] up to a row with zero thrust; the file has no row for the beginning."""
    with readable(path, "RASP file"):
        lines = [line.split(";")[0].split() for line in content_of(path).decode("cp1252").splitlines()]
        head, *rows = [words for words in lines if words]
        ends = [k for k, row in enumerate(rows) if float(row[1]) == 0]
        require(len(head) >= 7 and ends, "file", "have a line of seven words, and a thrust that ends with zero", path)
        require(ends[0] == len(rows) - 1, "file", "have one motor", shown="several")
        time, thrust = np.array(rows, float).T
    if time[0] > 0:
        time, thrust = np.append(0.0, time), np.append(0.0, thrust)
    return {"time": time, "thrust": thrust}


def read_thrust(file: str | Path) -> dict[str, np.ndarray]:
    """Return the time [s] and the thrust [N] of a file, see `RocketSled.from_file`."""
    path = user_path(file, "file")
    if path.suffix.lower() == ".eng":
        return _of_motor(path)
    _, columns = read_rows(file, {"time": "s"}, {"thrust": "N"}, {"t": "time"})
    thrust = columns["thrust"]
    # values of a load cell below zero are noise
    noise = (thrust < 0) & (thrust > -NOISE * thrust.max())
    return columns | {"thrust": np.where(noise, 0.0, thrust)}
