"""A mass on a spring and a damper on the slipper or sled; it adds states only where a scene has one."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tools.checks import not_negative, positive
from ..tools.fields import ShapeChecked, field

Pair = Float[Array, "2"]


class Payload(ShapeChecked):
    """A mass that moves laterally and vertically, on a spring and a damper at the slipper's centre.

    The mass travels with the slipper, so that the drive also accelerates the mass. A run that begins with a `Motion`
    begins with the mass at rest on its spring, moving like the slipper.
    """

    mass: Float[Array, ""] = field("kg", positive)
    """Mass [kg]."""
    stiffness: Pair = field("N/m", positive)
    """Stiffness of the lateral and the vertical spring [N/m]."""
    damping: Pair = field("N s/m", not_negative, default=(0.0, 0.0))
    """Damping of the lateral and the vertical damper [N s/m]."""
    travel: Pair | None = field("m", positive, default=None)
    """Deflection of the springs at which stops begin to act [m]; None: there are no stops."""
    stop_stiffness: Pair | None = field("N/m", positive, default=None)
    """Stiffness of the stops [N/m]."""

    def __check_init__(self):
        if (self.travel is None) != (self.stop_stiffness is None):
            raise ValueError("Arguments `travel` and `stop_stiffness` must be given together.")

    def force(self, deflection: Pair, rate: Pair) -> Pair:
        """Return the lateral and the vertical force on the slipper [N].

        **Arguments:** `deflection`: displacement of the mass minus that of the slipper [m]; `rate`: its rate [m/s].
        """
        force = self.stiffness * deflection + self.damping * rate
        if self.travel is None or self.stop_stiffness is None:
            return force
        # the stops act in addition to the springs, on both sides of the free travel
        beyond = jnp.maximum(deflection - self.travel, 0.0) + jnp.minimum(deflection + self.travel, 0.0)
        return force + self.stop_stiffness * beyond

    def fastest(self, body: Array) -> Array:
        """Return the greatest rate of springs, stops and dampers [1/s]; `body`: mass of the body under them [kg]."""
        stiffness = self.stiffness if self.stop_stiffness is None else self.stiffness + self.stop_stiffness
        per_mass = 1 / self.mass + 1 / body
        return jnp.max(jnp.maximum(jnp.sqrt(stiffness * per_mass), self.damping * per_mass))

    def sag(self, gravity: Array | None) -> Array:
        """Return the vertical deflection at rest [m], negative; `gravity` [m/s^2], or None."""
        if gravity is None:
            return jnp.zeros(())
        weight = self.mass * gravity
        spring = self.stiffness[1]
        free = weight / spring
        if self.travel is None or self.stop_stiffness is None:
            return -free
        # the spring carries what it can within the free travel; spring and stop together carry the rest
        travel = self.travel[1]
        stop = self.stop_stiffness[1]
        return -jnp.where(free <= travel, free, (weight + stop * travel) / (spring + stop))
