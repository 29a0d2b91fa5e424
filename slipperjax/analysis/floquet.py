"""Floquet multipliers of periodic motions, from the Jacobians of successive maps."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from ..tools import call_compiled, finite, is_traced, unless_traced, whole
from .lyapunov import Step, check_functions, check_state


def jacobians(step: Step, state: Any, intervals: int, *, index: Any = 0.0) -> Float[Array, "intervals size size"]:
    """Jacobians of `intervals` successive applications of `step`, along the motion from `state`. Pure.

    **Arguments:** `step(state, k)`: the state one interval later, differentiable in forward mode; `state`: a pytree
    of floats with `size` values in all; `index`: index of the first interval.
    """
    flat, unravel = ravel_pytree(state)

    def interval(x, k):
        flow = lambda x: ravel_pytree(step(unravel(x), k))[0]
        return jax.vmap(lambda t: jax.jvp(flow, (x,), (t,)), out_axes=(None, 1))(jnp.eye(x.size))

    return jax.lax.scan(interval, flat, index + jnp.arange(float(intervals)))[1]


def multipliers(
    matrices: Float[Array | np.ndarray, "intervals size size"],
) -> Complex[Array | np.ndarray, " size"]:
    """Eigenvalues of the product of successive Jacobians, the largest modulus first."""
    xp = jnp if is_traced(matrices) else np
    product = functools.reduce(lambda total, matrix: matrix @ total, xp.asarray(matrices))
    found = xp.linalg.eigvals(product).astype(complex)
    return found[xp.argsort(-xp.abs(found))]


def largest_exponent(matrices: Any, period: int) -> float:
    """ln |largest Floquet multiplier| per interval of a motion that recurs after `period` intervals.

    **Arguments:** `matrices`: Jacobians of `period` or more successive intervals, (intervals, size, size).
    """
    return float(np.log(np.abs(multipliers(np.asarray(matrices)[:period])[0])) / period)


def floquet(step: Step, state: Any, *, index: Any = 0.0, intervals: int = 1) -> Complex[Array | np.ndarray, " size"]:
    """Floquet multipliers of a motion that recurs after `intervals` intervals of `step`, the largest modulus first.

    The logarithms of their moduli, divided by `intervals`, are the exponents per interval.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    check_functions(step, None)
    state, count = check_state(state), whole("intervals", intervals, 1)
    return multipliers(call_compiled(_jacobians, step, (count,), state, unless_traced(finite("index"), index)))


def _jacobians(step, static, state, index):
    return jacobians(step, state, *static, index=index)
