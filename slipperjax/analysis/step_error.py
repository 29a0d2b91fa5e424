"""Errors of results and of their derivatives, from the same results with more steps."""

import itertools
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import PyTree

from ..tools.checks import require, tuple_of, whole

FINER = 3, 6, 12
"""Multiples of a motion's steps with which its derivatives are computed. Derivatives converge one order later than
values: with the default steps one in ten is wrong by a third."""


def with_step_error(
    function: Callable[[int], PyTree],
    steps: int,
    finer: Sequence[int] = FINER,
) -> tuple[PyTree, PyTree]:
    """Return the result of a function of the number of steps with many steps, and its error from results with fewer.

    **Arguments:**

    - `function(steps)`: numbers or arrays as a pytree, such as derivatives of an orbit.
    - `steps`: steps per forcing period, which are multiplied by each of `finer`, in rising order.

    **Returns:** the result with the most steps, and its errors as a pytree of arrays. The error is the greater of two
    numbers: the last difference of results, which may be small by chance, and the difference before it, divided by
    the square of the ratio of steps. Read them as standard errors: nearly all true errors are within three of them,
    see the pages on orbits and design.

    **Raises:** `ValueError` that names the wrong argument.
    """
    require(callable(function), "function", "be a function of the number of steps", function)
    steps = whole("steps", steps, 1)
    need = "two whole numbers or more in rising order"
    finer = [int(number) for number in tuple_of("finer", finer, (int, np.integer), need)]
    rises = len(finer) > 1 and finer[0] > 0 and all(a < b for a, b in itertools.pairwise(finer))
    require(rises, "finer", f"be {need}", finer)
    results = [function(times * steps) for times in finer]
    # errors of second order fall by this ratio from one difference to the next
    ratio = (finer[-1] / finer[-2]) ** 2

    # the error of one leaf of the pytree, from its values with each number of steps
    def error(*values):
        *earlier, last = (np.abs(np.subtract(b, a)) for a, b in itertools.pairwise(values))
        return np.maximum(last, earlier[-1] / ratio) if earlier else last

    return results[-1], jax.tree.map(error, *results)
