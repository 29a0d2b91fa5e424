"""Loads on the slipper besides contacts, and friction in the contacts. All are None by default, and cost nothing."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.checks import finite, not_negative, positive
from ..tools.fields import ShapeChecked, check_table, field

Vector = Float[Array, "3"]


class AbstractLoad(ShapeChecked):
    """A force and a moment on the slipper that depend on the travelling speed."""

    @abc.abstractmethod
    def wrench(self, speed: Float[Array, ""]) -> tuple[Vector, Vector]:
        """Return the force along the track's x, y and z [N], and the moment about the slipper's axes [N m].

        **Arguments:** `speed` [m/s]. The force along x acts on what drives the slipper.
        """


class AppliedLoad(AbstractLoad):
    """Constant loads, such as a share of the sled's weight, and lift and drag by the square of the speed.

    ```python
    load = sj.AppliedLoad(force=[0.0, 0.0, -800.0], force_by_square=[-0.02, 0.0, 0.01])
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

    def wrench(self, speed):
        # lift and drag grow with the dynamic pressure
        square = speed**2
        return self.force + square * self.force_by_square, self.moment + square * self.moment_by_square


class TabulatedLoad(AbstractLoad):
    """Loads from a table by the speed, linear between its rows, and constant beyond its ends."""

    speed: Float[Array, " rows"] = field("m/s", not_negative)
    """Speeds of the rows, increasing [m/s]."""
    force: Float[Array, "rows 3"] = field("N", finite)
    """Forces along the track's x, y and z [N]."""
    moment: Float[Array, "rows 3"] = field("N m", finite)
    """Moments about the slipper's x, y and z [N m]."""

    def __check_init__(self):
        check_table(self, "speed", "force", "moment")

    def wrench(self, speed):
        # `interp` takes one component at a time
        row = lambda table: jnp.stack([jnp.interp(speed, self.speed, table[:, k]) for k in range(3)])
        return row(self.force), row(self.moment)


class AbstractFriction(ShapeChecked):
    """Friction of sliding contacts: a traction against the sliding, of the normal force times a coefficient.

    Contacts slide at the travelling speed along the rail and at some metres per second across it, so that they never
    stick, and the direction needs no regularisation.
    """

    @abc.abstractmethod
    def coefficient_at(self, force: Array, sliding: Array) -> Array:
        """Return the coefficient of friction [1] from normal force [N] and sliding speed [m/s] of each point."""


class Coulomb(AbstractFriction):
    """Coulomb's friction, the same coefficient everywhere."""

    coefficient: Float[Array, ""] = field("", not_negative)
    """mu [1]."""

    def coefficient_at(self, force, sliding):
        return self.coefficient


class FadingFriction(AbstractFriction):
    """Friction that fades with the power that heats the contact, as steel's does at high speed:
    mu (1 + sliding speed x normal force / power)^-exponent."""

    coefficient: Float[Array, ""] = field("", not_negative)
    """mu of slow sliding [1]."""
    power: Float[Array, ""] = field("W", positive)
    """Sliding speed times normal force at which it has faded to mu / 2^exponent [W]."""
    exponent: Float[Array, ""] = field("", positive)
    """Exponent [1]."""

    def coefficient_at(self, force, sliding):
        return self.coefficient * (1 + force * sliding / self.power) ** -self.exponent
