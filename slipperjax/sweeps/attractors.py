"""Attractors of the cases of a sweep, and which starts share a basin of attraction."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.attractor import Attractors, classify
from ..analysis.basins import matched
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
    after which it recurs, 0 if it does not, and `share` of the cases [1], with `share_stderr`, at each value of the
    parameters.
    """
    states = strobe_states(ds, last) / COORDINATE_SCALES
    strobe = ds["strobe"].isel(strobe_period=0, coordinate=0, drop=True)
    # dimensions other than the start: attractors are found separately at each of their values
    over = [d for d in strobe.dims if d in ds.coords and d not in (*STARTS, "direction")]
    # places of the cases in the flat list, (*parameters, starts)
    place = strobe.copy(data=np.arange(strobe.size).reshape(strobe.shape)).transpose(*over, ...).values
    outer = place.shape[: len(over)]
    place = place.reshape(*outer, -1)
    found = matched(states.reshape(-1, *states.shape[-2:])[place], tolerance, reach)
    basin = np.empty(strobe.shape, int)
    np.put(basin, place, found.number)
    text = "attractor, by falling size of its basin; -1 for cases with a status"
    data = {
        "basin": column(strobe.dims, basin, "", text),
        "basin_period": column("attractor", found.period, "1", "forcing periods"),
        "share": column((*over, "attractor"), found.share, "1", "share of the cases"),
        "share_stderr": column((*over, "attractor"), found.stderr, "1", "standard error of a share of random starts"),
    }
    kept = {name: ds[name] for name in ("status", "steps_per_period", *STARTS) if name in ds.data_vars}
    return xr.Dataset(data | kept, strobe.coords, ds.attrs)
