"""The slipper: a rigid body."""

import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import positive, warn
from ..tools.compile import is_traced
from ..tools.fields import ShapeChecked, field


class Slipper(ShapeChecked):
    """A rigid slipper."""

    mass: Float[Array, ""] = field("kg", positive, plausible=(0.1, 1e4), symbol="m")
    """Mass [kg]."""
    inertia: Float[Array, "3"] = field("kg m^2", positive, plausible=(1e-9, 1e4), symbol="J")
    """Principal moments of inertia about x, y and z of the slipper's frame [kg m^2]."""
    length: Float[Array, ""] = field("m", positive, plausible=(0.005, 20.0), symbol="L")
    """Distance between the front and the rear section [m]."""

    def __check_init__(self):
        if is_traced(self) or self.inertia.shape != (3,):
            return
        inertia = np.asarray(self.inertia)
        # radii of gyration over the length, which wrong units make implausible
        radii = np.sqrt(inertia / np.asarray(self.mass)) / np.asarray(self.length)
        if np.min(radii) < 0.01 or np.max(radii) > 2:
            worst = radii[np.argmax(np.abs(np.log(radii)))]
            warn(f"Argument `inertia` has a radius of gyration of {worst:.3g} slipper lengths. Are the units right?")
        # in a plate both sides are equal, up to rounding
        if 2 * np.max(inertia) > np.sum(inertia) * (1 + 1e-9):
            warn("Argument `inertia` has a moment greater than the sum of the others, which no body has.")
