"""Percentiles of contact forces from counts in classes, of one size however long the run is."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..tools.checks import brief
from .recorders import Labelled, attributes, places
from .reducing import AbstractReducer, PeriodView, Stretch
from .status import Status

LEAST, MOST = 1.0, 2.0**28
"""Forces between which percentiles are resolved [N]: smaller ones count as zero, larger ones as infinite."""
BITS = 5
"""A class is told by so many leading bits of a number's fraction: its width is 1/64 to 1/32 of the force."""
_SHIFT = 52 - BITS


def _class_of(force: float) -> int:
    return int(np.float64(force).view(np.int64)) >> _SHIFT


CLASSES = _class_of(MOST) - _class_of(LEAST) + 2
"""Number of classes, the first for zero and the last for infinite forces."""


@dataclass(frozen=True)
class ForcePercentile(AbstractReducer):
    """Percentiles of the normal contact force over time, at each contact point [N]: of its values where steps end.

    Forces are counted in classes of their leading digits, and each is placed evenly in its class: a percentile is
    accurate to 1/32 of itself at worst, mostly to 0.5 %, and is 0 where a point is open for a larger share of the
    time. Between two forces it is interpolated as by `numpy.percentile`. While a case runs, its counts take
    72 kB.
    """

    percentiles: tuple[float, ...] = (99.0,)
    """One or several [%], 0 to 100."""

    def __post_init__(self):
        given = self.percentiles
        found = np.atleast_1d(np.asarray(given if np.size(given) else None, dtype=object))
        good = [isinstance(q, int | float | np.number) and not isinstance(q, bool) and 0 <= q <= 100 for q in found]
        if found.ndim != 1 or not all(good) or len(set(found.tolist())) < len(found):
            raise ValueError(
                f"Argument `percentiles` must be numbers from 0 to 100, each once, but is {brief(given)}."
            )
        object.__setattr__(self, "percentiles", tuple(float(q) for q in found))

    @property
    def name(self):
        return "contact_force_percentile"

    @property
    def variables(self):
        return (self.name,)

    @property
    def cost(self):
        return 1.0

    def values(self, periods):
        return 20 * len(self.percentiles)

    def begin(self, scene, state):
        return np.zeros((2, scene.points // 2, CLASSES), np.int32)

    def add(self, carried: Int[Array, "2 points classes"], period: PeriodView):
        bits = jax.lax.bitcast_convert_type(period.contact_force, jnp.int64)
        found = jnp.clip((bits >> _SHIFT) - (_class_of(LEAST) - 1), 0, CLASSES - 1)
        ends, points = (jnp.arange(n) for n in carried.shape[:2])
        one = period.over_steps(jnp.ones_like(found, jnp.int32), 0)
        return carried.at[ends[None, :, None], points[None, None, :], found].add(one)

    def finish(self, carried: Any, stretch: Stretch):
        place = np.array(self.percentiles) / 100 * (stretch.samples - 1)
        below = np.floor(place).astype(int)
        lower, upper = (np.asarray(_ranked(carried, np.minimum(k, stretch.samples - 1))) for k in (below, below + 1))
        with np.errstate(invalid="ignore"):
            found = np.where(lower == upper, lower, lower + (upper - lower) * (place - below))
        # a force that is no number is in the last class
        found[stretch.status == Status.NOT_FINITE] = np.nan
        return np.moveaxis(found, -1, 1)

    def label(self, scene, dims, found) -> Labelled:
        label = attributes("N", "percentile over time of the normal contact force, at the ends of steps")
        percentile = "percentile", np.array(self.percentiles), attributes("percent", "percentile")
        data = {self.name: ((*dims, "percentile", "end", "point"), found, label)}
        return data, places(scene) | {"percentile": percentile}


@jax.jit
def _ranked(
    counts: Int[Any, "*cases 2 points classes"], ranks: Int[Any, " percentiles"]
) -> Float[Array, "*cases 2 points percentiles"]:
    """The forces of some ranks, 0 for the smallest [N]."""
    edges = ((np.arange(CLASSES - 1) + _class_of(LEAST)) << _SHIFT).view(np.float64)
    low = jnp.array([0.0, *edges[:-1], np.inf])
    width = jnp.array([0.0, *np.diff(edges), 0.0])
    total = jnp.cumsum(counts, axis=-1)

    def one(rank):
        k = jnp.sum(total <= rank, axis=-1, keepdims=True)
        take = lambda a: jnp.take_along_axis(a, k, axis=-1)[..., 0]
        share = (rank - take(total) + take(counts) + 0.5) / take(counts)
        at = k[..., 0]
        return low[at] + width[at] * share

    return jnp.stack([one(rank) for rank in ranks], axis=-1)
