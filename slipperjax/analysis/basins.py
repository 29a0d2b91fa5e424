"""Basins of attraction: the shares of starts that lead to each attractor of a map, over a parameter."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..tools.checks import numbers, require, whole
from ..tools.compile import call_compiled
from ..tools.types import Numbers
from .lyapunov import Step


class Basins(NamedTuple):
    """To which attractor each start leads. Attractors are numbered from the largest basin to the smallest."""

    number: Int[np.ndarray, "*values starts"]
    """Of each start's attractor, -1 where its motion is not finite."""
    period: Int[np.ndarray, " attractors"]
    """Intervals after which the attractor recurs, 0 where it does not."""
    share: Float[np.ndarray, "*values attractors"]
    """Share of the starts [1]."""
    stderr: Float[np.ndarray, "*values attractors"]
    """Standard error of a share of random starts [1]: of the binomial distribution, above zero for shares of 0 and 1,
    too."""


def map_basins(
    family: Callable[..., Step],
    starts: Numbers,
    values: Numbers,
    *,
    transient: int = 1000,
    last: int = 64,
    scales: Numbers = 1.0,
    tolerance: float = 0.05,
    reach: float = 0.5,
) -> Basins:
    """Return the shares of starts that lead to each attractor of a map, over a parameter.

    **Arguments:** `family`: function from the parameter's value to the map; `starts`: states, of shape (starts,
    numbers), random ones for the standard errors to hold; `values`: of the parameter, in an order in which attractors
    move little; `transient`: intervals before the `last` ones, from which attractors are told apart, see `matched`;
    `scales`: divisors of the states, in their units.

    **Raises:** `ValueError` for starts of another shape.
    """
    starts = numbers("starts", starts)
    values = numbers("values", values)
    require(starts.ndim == 2, "starts", "be of shape (starts, numbers)", shown=f"of shape {starts.shape}")
    static = whole("transient", transient, 0), whole("last", last, 2)
    states = call_compiled(_iterated, family, static, jnp.asarray(starts), jnp.asarray(values, float))
    return matched(np.asarray(states) / np.asarray(scales), tolerance, reach)


def _iterated(family: Callable[..., Step], static: tuple, starts: Array, values: Array) -> Array:
    run = lambda value, state: last_states(family(value), state, *static)
    return jax.vmap(lambda value: jax.vmap(lambda state: run(value, state))(starts))(values)


def last_states(step: Step, state: PyTree, transient: int, last: int) -> PyTree:
    """Return the `last` states of a motion after the `transient` intervals. Pure."""
    state = jax.lax.fori_loop(0, transient, lambda k, s: step(s, 1.0 * k), state)
    return jax.lax.scan(lambda s, k: (step(s, k), s), state, transient + jnp.arange(float(last)))[1]


def matched(states: Float[np.ndarray, "*values starts intervals numbers"], tolerance: float, reach: float) -> Basins:
    """Return the basins of motions from their scaled states at the end, over any parameters.

    Two motions are on one attractor where their states recur after the same n intervals, within a tenth of
    `tolerance`, and mean and standard deviation agree within `tolerance`. Over parameters an attractor keeps its
    number from one value to the next where its n stays and these change by at most `reach`. All motions that do not
    recur count as one attractor.
    """
    marks, periods = recurrences(states.reshape(-1, *states.shape[-2:]), tolerance / 10)
    found, kinds = _numbered(
        marks.reshape(*states.shape[:-2], -1), periods.reshape(states.shape[:-2]), tolerance, reach
    )
    sizes = np.bincount(found[found >= 0], minlength=len(kinds))
    order = np.argsort(-sizes, kind="stable")
    rank = np.append(np.argsort(order), -1)  # whose last entry keeps -1, as it is the entry at -1
    ranked = rank[found]
    rows = ranked.reshape(-1, ranked.shape[-1])
    counts = np.array([np.bincount(row[row >= 0], minlength=len(kinds)) for row in rows])
    counts = counts.reshape(*ranked.shape[:-1], len(kinds))
    starts = rows.shape[1]
    # standard deviation of the share, given the count, if all shares are equally likely before
    stderr = np.sqrt((counts + 1) * (starts - counts + 1) / (starts + 3)) / (starts + 2)
    return Basins(ranked, np.array(kinds, int)[order], counts / starts, stderr)


def recurrences(states: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and spread of scaled states (cases, periods, numbers) over whole recurrences, and the
    number of periods of a recurrence: 0 for motions that do not recur, -1 for motions that are not finite."""
    periods = states.shape[1]
    marks = np.concatenate([states.mean(axis=1), states.std(axis=1)], axis=-1)
    found = np.where(np.isfinite(marks).all(axis=-1), 0, -1)
    for n in range(1, periods // 2 + 1):
        open_ = np.flatnonzero(found == 0)
        of = states[open_]
        recurs = np.max(np.abs(of[:, n:] - of[:, :-n]), axis=(1, 2)) < near
        # the latest states, over whole multiples of n
        used = of[recurs, periods % n :]
        marks[open_[recurs]] = np.concatenate([used.mean(axis=1), used.std(axis=1)], axis=-1)
        found[open_[recurs]] = n
    return marks, found


class _Basin(NamedTuple):
    """An attractor at one value of the parameters, and the cases that lead to it."""

    period: int
    mark: Float[np.ndarray, " marks"]
    cases: Int[np.ndarray, " some"]


def _numbered(
    marks: np.ndarray, periods: np.ndarray, tolerance: float, reach: float
) -> tuple[Int[np.ndarray, "*parameters starts"], list[int]]:
    """Return the number of each case's attractor, -1 for none, and the period of each number.

    **Arguments:** `marks`, `periods`: as of `recurrences`, (*parameters, starts, ...).
    """
    numbers = np.full(periods.shape, -1)
    kinds: list[int] = []
    found: dict[tuple[int, ...], dict[int, _Basin]] = {}
    for at in np.ndindex(periods.shape[:-1]):
        # attractors at the previous value of each parameter
        before = [found.get(tuple(np.subtract(at, step)), {}) for step in np.eye(len(at), dtype=int)]
        known = [pair for basins in before for pair in basins.items()]
        found[at] = _named(_basins(marks[at], periods[at], tolerance), known, kinds, reach)
        for number, basin in found[at].items():
            numbers[at][basin.cases] = number
    return numbers, kinds


def _basins(marks: np.ndarray, periods: np.ndarray, tolerance: float) -> list[_Basin]:
    """Return the attractors of some cases, in the order of their first cases."""
    found = []
    for n in np.unique(periods[periods >= 0]):
        left = np.flatnonzero(periods == n)
        while len(left):
            first = marks[left[0]]
            near = np.max(np.abs(marks[left] - first), axis=-1) < (tolerance if n else np.inf)
            found.append(_Basin(int(n), first, left[near]))
            left = left[~near]
    return sorted(found, key=lambda basin: basin.cases[0])


def _named(here: list[_Basin], known: list[tuple[int, _Basin]], kinds: list[int], reach: float) -> dict[int, _Basin]:
    """Return attractors by number, the nearest known attractors first; new ones are added to `kinds`."""
    near = []
    for i, basin in enumerate(here):
        # the marks of motions that do not recur mean nothing
        alike = [pair for pair in known if pair[1].period == basin.period > 0]
        marks = np.reshape([other.mark for _, other in alike], (-1, basin.mark.size))
        apart = np.max(np.abs(marks - basin.mark), axis=1)
        near += [(apart[k], i, alike[k][0]) for k in np.flatnonzero(apart <= reach)]
    numbers: dict[int, int] = {}
    for _, i, number in sorted(near):
        if i not in numbers and number not in numbers.values():
            numbers[i] = number
    for i, basin in enumerate(here):
        if i not in numbers and basin.period == 0 and 0 in kinds:
            # all motions that do not recur are one attractor everywhere
            numbers[i] = kinds.index(0)
        elif i not in numbers:
            numbers[i] = len(kinds)
            kinds.append(basin.period)
    return {numbers[i]: basin for i, basin in enumerate(here)}
