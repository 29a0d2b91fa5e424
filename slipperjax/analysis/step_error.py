"""Errors of results and of their derivatives, by the same results on more steps."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ..tools.checks import require, whole

FINER = 3, 6, 12
"""Multiples of the steps of a motion on which its derivatives are taken: they converge an order later than values, so
that with the default steps one in ten is wrong by a third."""


def with_step_error(
    function: Callable[[int], Any],
    steps: int,
    finer: Sequence[int] = FINER,
) -> tuple[Any, Any]:
    """Return a function of the number of steps with many of them, and its error by the difference to fewer.

    **Arguments:**

    - `function(steps)`: numbers or arrays as a pytree, such as derivatives of an orbit.
    - `steps`: per forcing period, times each of `finer`, which rise.

    **Returns:** what the function gives with the most steps, and the errors as a pytree of arrays: the last
    difference, and at least what errors of second order leave of the one before, which may be small by chance. They
    are meant as standard errors: nearly all true errors lie within three of them, see the pages on orbits and design.
    """
    require(callable(function), "function", "be a function of the number of steps", function)
    steps = whole("steps", steps, 1)
    results = [function(times * steps) for times in finer]
    ratio = (finer[-1] / finer[-2]) ** 2

    # of one leaf of the pytree, from its values with each number of steps
    def error(*values):
        *earlier, last = (np.abs(np.subtract(b, a)) for a, b in itertools.pairwise(values))
        return np.maximum(last, earlier[-1] / ratio) if earlier else last

    return results[-1], jax.tree.map(error, *results)
