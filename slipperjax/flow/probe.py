"""The error of a run, measured: some of its periods repeated with half the step."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model import State, scaled_size
from ..tools import is_traced, jit, whole
from .period_map import Passage
from .stepping import AbstractStepping


class Probe(NamedTuple):
    """What half the step changes in some periods of a run, each repeated from the state at its start.

    The error of a whole run is larger where errors grow from period to period: slowly decaying motions keep them
    for as long as they decay, chaotic ones multiply them.
    """

    period: Float[Array, " probes"]
    """Number of the repeated forcing period, from 0."""
    error: Float[Array, " probes"]
    """Change of the motion at its end, in multiples of `slipperjax.model.COORDINATE_SCALES` [1]; NaN where lost."""
    peak_error: Float[Array, " probes"]
    """Relative change of its highest contact force [1]; NaN without contact or without loads."""


def check_probe(probe: Any, *values: Any) -> int:
    """The number of periods to repeat; raises `ValueError` where it is none, or positive under a transformation."""
    probe = whole("probe", probe, 0)
    if probe and is_traced(values):
        raise ValueError(f"Argument `probe` must be 0 under jit, vmap or grad, but is {probe}.")
    return probe


def probed(
    stepping: AbstractStepping,
    states: State,
    saves: int,
    count: int,
    run: Callable[[AbstractStepping, State, float], Passage],
) -> Probe:
    """Repeats `count` periods of a run, or all if there are fewer, the first and others at equal distances.

    **Arguments:** `states`: saved ones, `saves` per period; `run(stepping, state, epoch)`: runs one period.
    """
    periods = (len(states.motion.y) - 1) // saves
    chosen = np.unique(np.linspace(0, periods - 1, min(count, periods)).astype(int))
    errors, peaks = [], []
    for k in chosen:
        state = jax.tree.map(lambda a, at=k * saves: jnp.asarray(np.asarray(a)[at]), states)
        coarse, fine = (run(s, state, float(k)) for s in (stepping, stepping.finer()))
        errors.append(np.asarray(_difference(coarse.state, fine.state)))
        highest = [float(_highest(passage)) for passage in (coarse, fine)]
        peaks.append(abs(highest[0] - highest[1]) / highest[1] if highest[1] > 0 else np.nan)
    return Probe(*(jnp.asarray(np.asarray(found, float)) for found in (chosen, errors, peaks)))


@jit
def _difference(a: State, b: State) -> Array:
    return scaled_size(jax.tree.map(jnp.subtract, a.motion, b.motion))


def _highest(passage: Passage) -> Any:
    loads = passage.record[1] if isinstance(passage.record, tuple) else None
    return np.nan if loads is None else np.max(np.asarray(loads.peak_force))
