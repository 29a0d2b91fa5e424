"""Attractors of the cases of a sweep, and which starts share a basin of attraction."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.attractor import Attractors, classify
from ..analysis.kinds import Regime
from ..flow.status import Status
from ..model.parameters import STARTS
from ..model.quantities import COORDINATE_SCALES
from ..tools.checks import require, whole
from ..tools.columns import column
from ..tools.types import AnyArray

FLOOR = 1e-5
"""Distances below it count as zero in classification, in multiples of `COORDINATE_SCALES`: 10 nm."""
LAST = 200
"""Forcing periods at the end of a record from which a motion is classified."""


class Motions(NamedTuple):
    """Kinds and periods of motions."""

    kind: Int[AnyArray, "*cases"]  # numbers of `slipperjax.analysis.Regime`
    period: Int[AnyArray, "*cases"]


def classify_motions(
    strobe: Float[np.ndarray, "cases periods coordinates"], status: Int[np.ndarray, " cases"]
) -> Motions:
    """Return kinds and periods of motions from their states once per period; those with a status are unresolved."""
    finite = (status == Status.FINITE)[:, None, None]
    motions = classify(np.where(finite, strobe, np.nan), scales=COORDINATE_SCALES, floor=FLOOR)
    return Motions(Regime.codes(motions.kind), np.asarray(motions.period, int))


def strobe_states(ds: xr.Dataset, last: int | None = None) -> Float[np.ndarray, "*cases periods coordinates"]:
    """Return the states of a sweep once per forcing period; NaN for all cases with a status other than 0.

    **Arguments:** `ds`: of `sweep` or `follow` with record "sections" or "strobe"; `last`: periods at
    the end that are wanted, by default all.

    **Raises:** `ValueError` for other datasets.
    """
    require(
        isinstance(ds, xr.Dataset) and "strobe" in ds,
        "ds",
        "come from a sweep that recorded sections or strobe",
        shown="another dataset",
    )
    states = ds["strobe"].values
    if "status" in ds:
        states = np.where(ds["status"].values[..., None, None] == Status.FINITE, states, np.nan)
    return states if last is None else states[..., -whole("last", last, 1) :, :]


def attractors(ds: xr.Dataset, last: int = LAST, floor: float = FLOOR, **options: object) -> Attractors:
    """Classify the motion that each case of a sweep settled to, from its `last` strobe states.

    See `slipperjax.analysis.attractor`.

    Cases with a status other than 0 are "unresolved", and their evidence is the status. Whether a periodic motion is
    on an exact orbit of that period, `slipperjax.lyapunov_sweep` tells.

    **Arguments:** `floor`: distances below it are zero, in multiples of `slipperjax.model.COORDINATE_SCALES`: by
    default 10 nm.
    """
    motions = classify(strobe_states(ds, last), scales=COORDINATE_SCALES, floor=floor, **options)
    if "status" not in ds:
        return motions
    # as objects, so that a longer text is not cut off
    evidence = np.asarray(motions.evidence, dtype=object)
    for place in np.argwhere(ds["status"].values != Status.FINITE):
        evidence[tuple(place)] = f"status {Status(int(ds['status'].values[tuple(place)]))}"
    return motions._replace(evidence=evidence.astype(str))


def groups(ds: xr.Dataset, last: int = 20, tolerance: float = 0.05, reach: float = 0.5) -> xr.Dataset:
    """Number the attractors that a grid of starts leads to: 0, 1, ... from the largest basin to the smallest.

    Two cases are on one periodic attractor where their last strobe states recur after the same n periods, within a
    tenth of `tolerance`, and mean and standard deviation of these agree within `tolerance`, in multiples of
    `slipperjax.model.COORDINATE_SCALES`. They are taken over whole multiples of n periods, which makes them
    independent of the phase. All motions that do not recur, chaotic ones above all, count as one attractor.

    Over parameters, such as the speed, an attractor keeps its number from one value to the next where its period
    stays and mean and standard deviation change by `reach` at most.

    **Arguments:** `ds`: as for `strobe_states`; `last`: periods at its end that are used, twice the longest n;
    `tolerance`, `reach` [1].

    **Returns:** an `xarray.Dataset`, which `slipperjax.plots.basin_map` draws: `basin`, the number of each case's
    attractor, -1 for cases with a status other than 0; for each `attractor`, `basin_period`, the forcing periods
    after which it recurs, 0 if it does not, and `share` of the cases [1], at each value of the parameters.
    """
    states = strobe_states(ds, last) / COORDINATE_SCALES
    strobe = ds["strobe"].isel(strobe_period=0, coordinate=0, drop=True)
    # what is not of the start: an attractor is looked for at each value of these
    over = [d for d in strobe.dims if d in ds.coords and d not in (*STARTS, "direction")]
    # places of the cases in the flat list, one row for each value of the parameters
    place = strobe.copy(data=np.arange(strobe.size).reshape(strobe.shape)).transpose(*over, ...).values
    outer = place.shape[: len(over)]
    place = place.reshape(int(np.prod(outer)), -1)
    marks, periods = _marks(states.reshape(-1, *states.shape[-2:]), tolerance / 10)
    numbers, kinds = _numbered(marks[place], periods[place], outer, tolerance, reach)
    sizes = np.bincount(numbers[numbers >= 0], minlength=len(kinds))
    order = np.argsort(-sizes, kind="stable")
    rank = np.append(np.argsort(order), -1)  # whose last entry keeps -1, as it is the entry at -1
    ranked = rank[numbers]
    basin = np.empty(strobe.shape, int)
    np.put(basin, place, ranked)
    counts = [np.bincount(at_one[at_one >= 0], minlength=len(kinds)) for at_one in ranked]
    share = np.reshape(counts, (*outer, len(kinds))) / ranked.shape[1]
    text = "attractor, by falling size of its basin; -1 for cases with a status"
    data = {
        "basin": column(strobe.dims, basin, "", text),
        "basin_period": column("attractor", np.array(kinds, int)[order], "1", "forcing periods"),
        "share": column((*over, "attractor"), share, "1", "share of the cases"),
    }
    made = xr.Dataset(data, strobe.coords, ds.attrs)
    return made if "status" not in ds else made.assign(status=ds["status"])


def _marks(states: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and spread of scaled states (cases, periods, 10) over whole recurrences, (cases, 20), and the
    periods of these, 0 for motions that do not recur, -1 for those that are not finite."""
    periods = states.shape[1]
    marks = np.concatenate([states.mean(axis=1), states.std(axis=1)], axis=-1)
    found = np.where(np.isfinite(marks).all(axis=-1), 0, -1)
    for n in range(1, periods // 2 + 1):
        open_ = np.flatnonzero(found == 0)
        of = states[open_]
        recurs = np.max(np.abs(of[:, n:] - of[:, :-n]), axis=(1, 2)) < near
        # the latest states, as many as whole multiples of n
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
    marks: np.ndarray, periods: np.ndarray, outer: tuple[int, ...], tolerance: float, reach: float
) -> tuple[Int[np.ndarray, "values starts"], list[int]]:
    """Return the number of each case's attractor, -1 for none, and the period of each number.

    **Arguments:** `marks`, `periods`: as of `_marks`, at each value of the parameters; `outer`: how many values of
    each parameter there are.
    """
    numbers = np.full(periods.shape, -1)
    kinds: list[int] = []
    found: list[dict[int, _Basin]] = []
    for k in range(len(marks)):
        # attractors at the value before, along each of the parameters
        before = [np.subtract(np.unravel_index(k, outer), step) for step in np.eye(len(outer), dtype=int)]
        known = [found[np.ravel_multi_index(tuple(at), outer)] for at in before if at.min() >= 0]
        here = _basins(marks[k], periods[k], tolerance)
        found.append(_named(here, [pair for basins in known for pair in basins.items()], kinds, reach))
        for number, basin in found[-1].items():
            numbers[k, basin.cases] = number
    return numbers, kinds


def _basins(marks: np.ndarray, periods: np.ndarray, tolerance: float) -> list[_Basin]:
    """Return the attractors of some cases, in the order in which they are met."""
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
    """Return attractors by their numbers, the nearest known ones first; those of new ones are added to `kinds`."""
    near = []
    for i, basin in enumerate(here):
        # marks say nothing of what does not recur
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
            # what does not recur is one, wherever it is met
            numbers[i] = kinds.index(0)
        elif i not in numbers:
            numbers[i] = len(kinds)
            kinds.append(basin.period)
    return {numbers[i]: basin for i, basin in enumerate(here)}
