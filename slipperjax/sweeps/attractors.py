"""Attractors of the cases of a sweep, and which starts share a basin of attraction."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.attractor import Attractors, classify
from ..analysis.kinds import Regime
from ..flow.status import Status
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
        "strobe" in ds,
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


def groups(ds: xr.Dataset, last: int = 20, tolerance: float = 0.05) -> xr.Dataset:
    """Number the attractors that a grid of starts leads to: 0, 1, ... from the largest basin to the smallest.

    Two cases are on one attractor where mean and standard deviation of their last strobe states agree within
    `tolerance`, in multiples of `slipperjax.model.COORDINATE_SCALES`. If a motion recurs after n periods, within a
    tenth of `tolerance`, they are taken over whole multiples of n periods, which makes them independent of its phase.
    Reliable for periodic attractors; a chaotic one may be numbered as several.

    **Arguments:** `ds`: as for `strobe_states`; `last`: periods at its end that are used; `tolerance` [1].

    **Returns:** an `xarray.Dataset`, which `slipperjax.plots.basin_map` draws: `basin`, the number of each case's
    attractor, -1 for cases with a status other than 0; for each `attractor`, `basin_period`, the forcing periods
    after which it recurs, 0 if it does not, and `share` of the cases [1].
    """
    states = strobe_states(ds, last) / COORDINATE_SCALES
    marks = [_mark(case, tolerance / 10) for case in states.reshape(-1, *states.shape[-2:])]
    numbers = np.full(len(marks), -1)
    centres: list[np.ndarray] = []
    periods: list[int] = []
    # a case joins the nearest attractor within the tolerance, or begins a new one
    for k, (mark, period) in enumerate(marks):
        if not np.all(np.isfinite(mark)):
            continue
        near = [np.max(np.abs(mark - c)) for c in centres]
        if near and min(near) < tolerance:
            numbers[k] = int(np.argmin(near))
        else:
            numbers[k] = len(centres)
            centres.append(mark)
            periods.append(period)
    sizes = np.bincount(numbers[numbers >= 0], minlength=len(centres))
    order = np.argsort(-sizes, kind="stable")
    rank = np.append(np.argsort(order), -1)  # whose last entry keeps -1, as it is the entry at -1
    strobe = ds["strobe"].isel(strobe_period=0, coordinate=0, drop=True)
    basin = rank[numbers].reshape(strobe.shape)
    share = sizes[order] / max(len(numbers), 1)
    text = "attractor, by falling size of its basin; -1 for cases with a status"
    data = {
        "basin": column(strobe.dims, basin, "", text),
        "basin_period": column("attractor", np.array(periods, int)[order], "1", "forcing periods"),
        "share": column("attractor", share, "1", "share of the cases"),
    }
    made = xr.Dataset(data, strobe.coords, ds.attrs)
    return made if "status" not in ds else made.assign(status=ds["status"])


def _mark(states: np.ndarray, near: float) -> tuple[np.ndarray, int]:
    """Return mean and spread of scaled states (periods, 10) over whole recurrences, and the period of these, or 0."""
    periods = len(states)
    recurs = (n for n in range(1, periods // 2 + 1) if np.max(np.abs(states[n:] - states[:-n])) < near)
    n = next(recurs, 0)
    # the latest states, as many as whole multiples of n
    used = states[periods % n :] if n else states
    return np.concatenate([used.mean(axis=0), used.std(axis=0)]), n
