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
"""Distances below this count as zero in classification, in multiples of `COORDINATE_SCALES`: 10 nm."""
LAST = 200
"""Forcing periods at the end of a record from which a motion is classified."""


class Motions(NamedTuple):
    """Kinds and periods of motions."""

    kind: Int[AnyArray, "*cases"]  # numbers of `slipperjax.analysis.Regime`
    period: Int[AnyArray, "*cases"]


def classify_motions(
    strobe: Float[np.ndarray, "cases periods coordinates"], status: Int[np.ndarray, " cases"]
) -> Motions:
    """Return kinds and periods of motions from their states once per period; cases with a status are unresolved."""
    finite = (status == Status.FINITE)[:, None, None]
    motions = classify(np.where(finite, strobe, np.nan), scales=COORDINATE_SCALES, floor=FLOOR)
    return Motions(Regime.codes(motions.kind), np.asarray(motions.period, int))


def strobe_states(ds: xr.Dataset, last: int | None = None) -> Float[np.ndarray, "*cases periods coordinates"]:
    """Return the states of a sweep once per forcing period; NaN for all cases with a status other than 0.

    **Arguments:** `ds`: of `sweep` or `follow` with record "sections" or "strobe"; `last`: number of periods at the
    end, by default all.

    **Raises:** `ValueError` for other datasets.
    """
    ds = getattr(ds, "ds", ds)
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

    Cases with a status other than 0 are "unresolved", and their evidence is the status. `slipperjax.lyapunov_sweep`
    shows whether a periodic motion is on an exact orbit of its period.

    **Arguments:** `floor`: distances below this are zero, in multiples of `slipperjax.model.COORDINATE_SCALES`: by
    default 10 nm.
    """
    motions = classify(strobe_states(ds, last), scales=COORDINATE_SCALES, floor=floor, **options)
    if "status" not in ds:
        return motions
    # as objects, so that longer texts are not cut off
    evidence = np.asarray(motions.evidence, dtype=object)
    for place in np.argwhere(ds["status"].values != Status.FINITE):
        evidence[tuple(place)] = f"status {Status(int(ds['status'].values[tuple(place)]))}"
    return motions._replace(evidence=evidence.astype(str))


def groups(ds: xr.Dataset, last: int = 20, tolerance: float = 0.05, reach: float = 0.5) -> xr.Dataset:
    """Number the attractors to which a grid of starts leads: 0, 1, ... from the largest basin to the smallest.

    Two cases are on one periodic attractor where their last strobe states recur after the same n periods, within a
    tenth of `tolerance`, and where mean and standard deviation of these states agree within `tolerance`, in multiples
    of `slipperjax.model.COORDINATE_SCALES`. Mean and standard deviation are over whole multiples of n periods, so
    that they do not depend on the phase. All motions that do not recur, mainly chaotic motions, count as one
    attractor.

    Over parameters, such as the speed, an attractor keeps its number from one value to the next where its period
    stays and mean and standard deviation change by at most `reach`.

    **Arguments:** `ds`: as for `strobe_states`; `last`: number of periods used at its end, twice the longest n;
    `tolerance`, `reach` [1].

    **Returns:** an `xarray.Dataset`, which `slipperjax.plots.basin_map` draws: `basin`, the number of each case's
    attractor, -1 for cases with a status other than 0; for each `attractor`, `basin_period`, the forcing periods
    after which it recurs, 0 if it does not, and `share` of the cases [1], at each value of the parameters.
    """
    states = strobe_states(ds, last) / COORDINATE_SCALES
    strobe = ds["strobe"].isel(strobe_period=0, coordinate=0, drop=True)
    # dimensions other than the start: attractors are found separately at each of their values
    over = [d for d in strobe.dims if d in ds.coords and d not in (*STARTS, "direction")]
    # places of the cases in the flat list, (*parameters, starts)
    place = strobe.copy(data=np.arange(strobe.size).reshape(strobe.shape)).transpose(*over, ...).values
    outer = place.shape[: len(over)]
    place = place.reshape(*outer, -1)
    marks, periods = _marks(states.reshape(-1, *states.shape[-2:]), tolerance / 10)
    numbers, kinds = _numbered(marks[place], periods[place], tolerance, reach)
    sizes = np.bincount(numbers[numbers >= 0], minlength=len(kinds))
    order = np.argsort(-sizes, kind="stable")
    rank = np.append(np.argsort(order), -1)  # whose last entry keeps -1, as it is the entry at -1
    ranked = rank[numbers]
    basin = np.empty(strobe.shape, int)
    np.put(basin, place, ranked)
    rows = ranked.reshape(-1, ranked.shape[-1])
    counts = [np.bincount(at_one[at_one >= 0], minlength=len(kinds)) for at_one in rows]
    share = np.reshape(counts, (*outer, len(kinds))) / rows.shape[1]
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

    **Arguments:** `marks`, `periods`: as of `_marks`, (*parameters, starts, ...).
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
