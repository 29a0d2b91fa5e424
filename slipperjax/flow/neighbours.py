"""Slopes of a quantity at the ends of steps from its values at neighbouring ends.

Slopes along the motion would need the derivatives of rail and contacts, which cost as much as all else. Central
differences over five ends are fourth order in the step too, like the solution.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

MARGIN = 2
"""Values that a central difference needs before and after its place."""

_NEXT = {2: (-1, 2), 3: (1, -3, 3), 4: (-1, 4, -6, 4)}
"""Weights of equidistant values in the next one of the polynomial through them."""


def continued(values: Float[Array, "ends ..."], steps: Any) -> Float[Array, "ends+4 ..."]:
    """Values at the ends of steps, of which the first `steps` + 1 count, with two before and two after those.

    Before and after the period, values go on as the cubics through the nearest four.
    """
    last, few = jnp.asarray(steps, int), min(len(values), 4)
    earlier = _two_more(values[few - 1 :: -1])[::-1]
    later = _two_more(jax.lax.dynamic_slice_in_dim(values, last + 1 - few, few))
    values = jnp.concatenate([earlier, values, later])
    return jax.lax.dynamic_update_slice_in_dim(values, later, last + 1 + MARGIN, 0)


def central_difference(a: Array, b: Array, c: Array, d: Array) -> Array:
    """The slope [per step] amid four values: two samples before the place and two after it."""
    return (8 * (c - b) + a - d) / 12


def slopes(values: Float[Array, "ends ..."], steps: Any) -> Float[Array, "ends ..."]:
    """Slopes [per step] at the ends of steps, of which the first `steps` + 1 count."""
    a, b, _, c, d = (continued(values, steps)[k : k + len(values)] for k in range(2 * MARGIN + 1))
    return central_difference(a, b, c, d)


def _two_more(values: Array) -> Array:
    """The next two values of the polynomial through two to four equidistant ones, along the first axis."""
    weights = np.array(_NEXT[len(values)])
    following = lambda v: jnp.tensordot(weights, v[-len(weights) :], 1)
    values = jnp.stack([*values, following(values)])
    return jnp.stack([values[-1], following(values)])
