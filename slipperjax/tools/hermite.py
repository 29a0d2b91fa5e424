"""Cubics on the unit interval through values and slopes at both ends (Hermite interpolation)."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Cubic(NamedTuple):
    """Cubics ((cube x + square) x + slope) x + start of x from 0 to 1; arrays of one shape, of NumPy or JAX."""

    start: Any
    slope: Any
    """At x = 0."""
    square: Any
    cube: Any

    @classmethod
    def through(cls, start: Any, slope: Any, end: Any, end_slope: Any) -> "Cubic":
        """Makes the cubics with these values and slopes at 0 and 1."""
        cube, square = 2 * (start - end) + slope + end_slope, 3 * (end - start) - 2 * slope - end_slope
        return cls(start, slope, square, cube)

    def value(self, x: Any) -> Any:
        """Gives the values at x."""
        return ((self.cube * x + self.square) * x + self.slope) * x + self.start

    def slope_at(self, x: Any) -> Any:
        """Gives the first derivatives at x."""
        return (3 * self.cube * x + 2 * self.square) * x + self.slope

    def curvature(self, x: Any) -> Any:
        """Gives the second derivatives at x."""
        return 6 * self.cube * x + 2 * self.square

    def turn(self, sign: Any) -> Array:
        """Gives the x at which slopes change their sign within the interval. Pure.

        **Arguments:** `sign`: 1 where the slope falls through zero, at a greatest value, -1 where it rises.
        """
        root = jnp.sqrt(jnp.maximum(self.square**2 - 3 * self.cube * self.slope, 0.0))
        return jnp.clip(self.slope / (sign * root - self.square), 0.0, 1.0)

    def extremes(self) -> Float[np.ndarray, "2 ..."]:
        """Gives the x of all extremes within the interval in their order, NaN where there is none. NumPy only."""
        a, b, c = 3 * self.cube, 2 * self.square, self.slope
        with np.errstate(all="ignore"):
            q = -(b + np.where(b >= 0, 1, -1) * np.sqrt(b * b - 4 * a * c)) / 2
            both = np.stack([q / a, c / q])
            return np.sort(np.where((both > 0) & (both < 1), both, np.nan), axis=0)


def highest_point(start: Array, slope: Array, end: Array, end_slope: Array) -> tuple[Array, Array]:
    """Gives x from 0 to 1 and value of the highest point of `Cubic.through` these values and slopes. Pure."""
    cubic = Cubic.through(start, slope, end, end_slope)
    inside = (slope > 0) & (end_slope < 0)
    # zero of the slope; real, as the slope changes its sign
    root = jnp.sqrt(jnp.where(inside, cubic.square * cubic.square - 3 * cubic.cube * slope, 1.0))
    x = jnp.where(inside, slope / jnp.where(inside, root - cubic.square, 1.0), jnp.where(end > start, 1.0, 0.0))
    return x, jnp.where(inside, cubic.value(x), jnp.maximum(start, end))
