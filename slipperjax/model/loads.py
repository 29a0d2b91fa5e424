"""Loads on the slipper other than contacts, and friction in contacts. All are None by default, and cost nothing."""

import abc
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import finite, not_negative, positive, require, tuple_of
from ..tools.fields import ShapeChecked, check_table, field, unit_of
from ..tools.tables import read_rows
from ..tools.types import Numbers
from .travel import Travel

Vector = Float[Array, "3"]
Rows = Float[Array, " rows"] | None
Coefficient = Float[Array, ""] | Float[Array, " rows"]
COEFFICIENTS = ("drag_coefficient", "lift_coefficient", "side_coefficient")


class AbstractLoad(ShapeChecked):
    """A force and a moment on the slipper that depend on its speed, its place and the time."""

    @abc.abstractmethod
    def wrench(self, travel: Travel) -> tuple[Vector, Vector]:
        """Return the force along the track's x, y and z [N], and the moment about the slipper's axes [N m].

        **Arguments:** `travel`: has the `speed` [m/s], the `distance` along the rail [m], and the `seconds` [s]. The
        force along x acts on the drive.
        """

    @property
    def by_speed(self) -> bool:
        """Whether the load depends on the speed alone, so that it recurs with the rail."""
        return True


class AppliedLoad(AbstractLoad):
    """Constant loads, such as a share of the sled's weight, plus lift and drag by the square of the speed.

    ```python
    load = sj.model.AppliedLoad(force=[0.0, 0.0, -800.0], force_by_square=[-0.02, 0.0, 0.01])
    ```
    """

    force: Vector = field("N", finite, default=(0.0, 0.0, 0.0))
    """Force along the track's x, y and z [N]."""
    moment: Vector = field("N m", finite, default=(0.0, 0.0, 0.0))
    """Moment about the slipper's x, y and z [N m]."""
    force_by_square: Vector = field("N s^2/m^2", finite, default=(0.0, 0.0, 0.0))
    """Force over the square of the speed [N s^2/m^2]: drag below zero along x, lift above zero along z."""
    moment_by_square: Vector = field("N s^2/m", finite, default=(0.0, 0.0, 0.0))
    """Moment over the square of the speed [N s^2/m]."""
    arm: Vector | None = field("m", finite, default=None)
    """Where the forces act: x, y and z from the centre of mass [m]; None: at the centre of mass."""

    def wrench(self, travel):
        # lift and drag grow with the dynamic pressure
        square = travel.speed**2
        force = self.force + square * self.force_by_square
        moment = self.moment + square * self.moment_by_square
        return force, moment if self.arm is None else moment + jnp.cross(self.arm, force)


class AerodynamicLoad(AbstractLoad):
    """Drag, lift and side force of the air: dynamic pressure times area times a coefficient.

    Coefficients are numbers, or tables by the Mach number, linear between rows and constant beyond the ends.

    ```python
    load = sj.model.AerodynamicLoad(area=0.5, drag_coefficient=[0.4, 0.9, 0.7], mach=[0.8, 1.1, 2.6])
    ```
    """

    area: Float[Array, ""] = field("m^2", positive)
    """Area that the coefficients refer to [m^2]."""
    drag_coefficient: Coefficient = field("", finite, default=0.0)
    """Coefficient of the force against the travel [1]."""
    lift_coefficient: Coefficient = field("", finite, default=0.0)
    """Coefficient of the force upwards [1]."""
    side_coefficient: Coefficient = field("", finite, default=0.0)
    """Coefficient of the force to the left [1]."""
    mach: Float[Array, " rows"] | None = field("", not_negative, default=None)
    """Mach numbers of the rows of tables, increasing [1]."""
    arm: Vector = field("m", finite, default=(0.0, 0.0, 0.0))
    """Where the force acts: x, y and z from the slipper's centre of mass [m]."""
    density: Float[Array, ""] = field("kg/m^3", positive, default=1.225)
    """Density of the air [kg/m^3]."""
    sound_speed: Float[Array, ""] = field("m/s", positive, default=340.3)
    """Speed of sound in the air [m/s]."""

    def __check_init__(self):
        tables = [name for name in COEFFICIENTS if getattr(self, name).ndim]
        if self.mach is not None:
            check_table(self, "mach", *tables)
        elif tables:
            raise ValueError(f"Argument `{tables[0]}` must be one number, or have `mach` numbers of its rows.")

    def wrench(self, travel):
        mach = travel.speed / self.sound_speed
        of_air = [getattr(self, name) for name in COEFFICIENTS]
        drag, lift, side = (jnp.interp(mach, self.mach, c) if c.ndim else c for c in of_air)
        pressure = 0.5 * self.density * travel.speed**2
        force = pressure * self.area * jnp.stack([-drag, side, lift])
        return force, jnp.cross(self.arm, force)


class TabulatedLoad(AbstractLoad):
    """Loads from a table by speed, time or distance, linear between its rows, and constant beyond its ends.

    ```python
    thrust = sj.model.TabulatedLoad([[9e4, 0, 0], [8e4, 0, 0], [0, 0, 0]], time=[0.0, 1.5, 1.6], arm=[0, 0, 0.4])
    ```
    """

    force: Float[Array, "rows 3"] = field("N", finite)
    """Forces along the track's x, y and z [N]."""
    moment: Float[Array, "rows 3"] | None = field("N m", finite, default=None)
    """Moments about the slipper's x, y and z, in addition to the moments of the force [N m]; None: no moments."""
    speed: Rows = field("m/s", not_negative, default=None)
    """Speeds of the rows, increasing [m/s]."""
    time: Rows = field("s", finite, default=None)
    """Times of the rows, increasing [s]: from the first place of a speed programme, or else from distance zero."""
    distance: Rows = field("m", finite, default=None)
    """Distances of the rows along the rail, increasing [m]."""
    arm: Vector = field("m", finite, default=(0.0, 0.0, 0.0))
    """Where the force acts: x, y and z from the slipper's centre of mass [m]."""

    @classmethod
    def from_file(cls, file: str | Path, arm: Numbers = (0.0, 0.0, 0.0)) -> "TabulatedLoad":
        """Read a table of loads.

        A CSV or netCDF file as for `load_rail` has a column `distance`, `time` or `speed`, of which the first counts,
        and some of the columns `force_x` (or thrust), `force_y`, `force_z`, `moment_x`, `moment_y` and `moment_z`,
        such as `time [s], thrust [lbf]`. Absent forces and moments are zero.

        **Raises:** `ValueError` with all faults of the file by their lines; `OSError` for a file that cannot be read.
        """
        units = {"force": "N", "moment": "N m"}
        names = {f"{name}_{k}": unit for name, unit in units.items() for k in "xyz"}
        axis, columns = read_rows(file, {name: unit_of(cls, name) for name in AXES}, names, ALIASES)
        zero = np.zeros_like(columns[axis])
        force, moment = (np.stack([columns.get(f"{name}_{k}", zero) for k in "xyz"], 1) for name in units)
        return cls(force, moment if np.any(moment) else None, **{axis: columns[axis]}, arm=arm)

    def __check_init__(self):
        given = [name for name in AXES if getattr(self, name) is not None]
        require(len(given) == 1, "force", f"go by one of {', '.join(AXES)}", shown=f"by {', '.join(given) or 'none'}")
        check_table(self, given[0], "force", *(["moment"] if self.moment is not None else []))

    @property
    def by_speed(self):
        return self.speed is not None

    def wrench(self, travel):
        name = next(name for name in AXES if getattr(self, name) is not None)
        here = getattr(travel, AXES[name])
        # `interp` takes only one component at a time
        row = lambda table: jnp.stack([jnp.interp(here, getattr(self, name), table[:, k]) for k in range(3)])
        force = row(self.force)
        moment = jnp.cross(self.arm, force)
        return force, moment if self.moment is None else moment + row(self.moment)


AXES = {"distance": "distance", "time": "seconds", "speed": "speed"}
"""Axis of a table's rows, and its name in `Travel`."""
ALIASES = {"thrust": "force_x", "t": "time", "velocity": "speed", "v": "speed", "chainage": "distance"}
"""Other names of the columns of a file."""


class SumLoad(AbstractLoad):
    """Several loads at once, such as weight, lift and thrust."""

    loads: tuple[AbstractLoad, ...] = eqx.field(
        converter=lambda loads: tuple_of(
            "loads", loads, AbstractLoad, "loads such as slipperjax.model.AppliedLoad(...)"
        )
    )
    """Loads, whose forces and moments are added."""

    def __check_init__(self):
        require(self.loads, "loads", "be one or more loads", self.loads)

    def __repr__(self) -> str:
        return f"SumLoad({list(self.loads)!r})"

    @property
    def by_speed(self):
        return all(load.by_speed for load in self.loads)

    def wrench(self, travel):
        forces, moments = zip(*(load.wrench(travel) for load in self.loads), strict=True)
        return sum(forces), sum(moments)


class AbstractFriction(ShapeChecked):
    """Friction of sliding contacts: a traction against the sliding, equal to a coefficient times the normal force.

    Contacts slide along the rail at the travelling speed and across it at some metres per second. Therefore they
    never stick, and the direction of the traction needs no regularisation.
    """

    @abc.abstractmethod
    def coefficient_at(self, force: Array, sliding: Array) -> Array:
        """Return the coefficient of friction [1] of each point, from its normal force [N] and sliding speed [m/s]."""


class Coulomb(AbstractFriction):
    """Coulomb's friction, with the same coefficient everywhere."""

    coefficient: Float[Array, ""] = field("", not_negative)
    """Coefficient of friction mu [1]."""

    def coefficient_at(self, force, sliding):
        return self.coefficient


class FadingFriction(AbstractFriction):
    """Friction that decreases with the power that heats the contact, as for steel at high speed:
    mu (1 + sliding speed x normal force / power)^-exponent."""

    coefficient: Float[Array, ""] = field("", not_negative)
    """Coefficient of friction mu for slow sliding [1]."""
    power: Float[Array, ""] = field("W", positive)
    """Sliding speed times normal force at which friction has decreased to mu / 2^exponent [W]."""
    exponent: Float[Array, ""] = field("", positive)
    """Exponent [1]."""

    def coefficient_at(self, force, sliding):
        return self.coefficient * (1 + force * sliding / self.power) ** -self.exponent
