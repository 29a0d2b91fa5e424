"""The picture of loads that size parts, and each load of its table."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from ..flow.datasets import SCENE_NUMBER
from ..model.quantities import Quantity, ShownUnits
from .comparisons import of_runs
from .style import (
    AXES,
    Units,
    check_dataset,
    legend_above,
    line_color,
    name_and_symbol,
    page,
    quantity_of,
    shown_units,
    with_unit,
)

SOURCE = "slipperjax.sweeps.loads"
KINDS = {"forces": "force", "moments": "moment"}
"""Endings of the names of loads, by panel and table."""
OWN_UNITS = {"force": "kN", "moment": ""}
"""Display units of loads unless a user chose others; empty for the SI unit."""


class Load(NamedTuple):
    """A load of one part of the sled along one axis, averaged over one interval of time: the greatest of all runs."""

    part: str
    """The slipper or the cut; empty for a single slipper."""
    axis: str
    """Such as "vertical", or "about y"."""
    mean: float
    """Length of the interval of time [s]."""
    value: float
    """Greatest magnitude of all runs, with its sign [N] or [N m]; NaN if all runs are lost."""
    distance: float
    """Distance travelled [m]."""
    speed: float
    """[m/s]"""
    run: str
    """Parameters of the run with this load; empty for a single run."""
    status: int
    """`Status` code of this run."""
    quantiles: np.ndarray
    """Quantiles of the magnitude over independent runs, their standard errors, and both ends of their 95 % intervals,
    shape (quantiles, 4); no rows without such runs."""


def loads_of(ds: xr.Dataset, kind: str) -> Iterator[Load]:
    """Yield the forces or the moments of a result of `slipperjax.sweeps.loads`; `kind`: "force" or "moment"."""
    for of, along in ((of, along) for of in ("slipper", "cut") for along in ("axis", "about")):
        name = f"{of}_{kind}"
        if name not in ds or along not in ds[name].dims:
            continue
        parts = ds[of].values if of in ds.dims else [""]
        for part in parts:
            for axis in ds[along].values:
                for mean in ds["mean"].values:
                    at = {along: axis, "mean": mean} | ({of: part} if part else {})
                    yield _load(
                        ds.sel(at), name, str(part), AXES.get(axis, axis) if along == "axis" else f"about {axis}"
                    )


def _load(at: xr.Dataset, name: str, part: str, axis: str) -> Load:
    dims = at["status"].dims
    values = np.ravel(at[name].transpose(*dims).values)
    known = np.where(np.isnan(values), -np.inf, np.abs(values))
    k = int(np.argmax(known))
    where = dict(zip(dims, np.unravel_index(k, at["status"].shape), strict=True))
    one = at.isel(where)
    varied = [str(c) for c in at.coords if c != SCENE_NUMBER and set(at[c].dims) & set(dims)]
    named = [quantity_of(c, at).named(float(one[c])) for c in varied]
    if len(varied) > len(dims):
        # lists side by side are named by their number
        named = [f"{dim} {number}" for dim, number in where.items()]
    quantiles = np.zeros((0, 4))
    if f"{name}_value" in at:
        parts = [at[f"{name}_{of}"].values for of in ("value", "stderr", "low", "high")]
        quantiles = np.stack(parts, axis=-1)
    # a load that never acts has no place
    place, speed = (float(one[f"{name}_{of}"]) if values[k] else np.nan for of in ("distance", "speed"))
    return Load(
        part, axis, float(at["mean"]), float(values[k]), place, speed, ", ".join(named), int(one["status"]), quantiles
    )


def load_quantity(kind: str, units: ShownUnits) -> Quantity:
    """Return the quantity of forces or moments in a user's unit."""
    unit = {"force": "N", "moment": "N m"}[kind]
    return units.of(Quantity(f"greatest {kind}", unit, kind, shown_unit=OWN_UNITS[kind]))


def greatest_loads(ds: object, units: Units = None) -> np.ndarray:
    """Draw the greatest forces and moments of each part, for each interval of time over which they are averaged.

    Bars are the greatest of all runs. With quantiles over independent runs, dots are the quantiles, with their 95 %
    intervals.

    **Arguments:** `ds`: of `slipperjax.sweeps.loads`; `units`: such as ("ft", "lbf"), each for the quantities of its
    kind; by default the units of the scene's file.

    **Returns:** an array of two Axes.

    **Raises:** `ValueError` for another dataset.
    """
    ds = check_dataset(ds, SOURCE, "slipper_force", "slipper_moment")
    chosen = shown_units(ds, units)
    found = {kind: list(loads_of(ds, kind)) for kind in KINDS.values()}
    rows = max(len({(load.part, load.axis) for load in of_kind}) for of_kind in found.values())
    means = [float(mean) for mean in ds["mean"].values]
    with page(1, 2, 1.0 + 0.09 * rows * (0.7 + len(means)), ds, full=False) as axes:
        for ax, (kind, of_kind) in zip(axes, found.items(), strict=True):
            q = load_quantity(kind, chosen)
            names = list(dict.fromkeys(f"{load.part} {load.axis}".strip() for load in of_kind))
            thickness = 0.8 / len(means)
            for k, mean in enumerate(means):
                mine = [load for load in of_kind if load.mean == mean]
                heights = np.arange(len(mine)) + (k - (len(means) - 1) / 2) * thickness
                label = f"mean over {1e3 * mean:g} ms" if mean else "peak"
                sizes = q.shown(np.abs([load.value for load in mine]))
                ax.barh(heights, sizes, thickness, color=line_color(k), label=label, alpha=0.6)
                values, _, lows, highs = q.shown(np.stack([load.quantiles for load in mine])).T
                shares = ds["quantile"].values if "quantile" in ds.coords else []
                for share, value, low, high in zip(shares, values, lows, highs, strict=True):
                    # stated once, and not for a quantile for which there are too few runs
                    said = "" if k or np.isnan(value).all() else f"{of_runs(share)}, 95 % interval"
                    ends = np.stack([value - low, high - value])
                    ax.errorbar(value, heights, xerr=ends, fmt="o", ms=2, lw=0.8, color="black", label=said or None)
            ax.set_yticks(range(len(names)), names)
            ax.invert_yaxis()
            ax.set_xlabel(with_unit(name_and_symbol(q), q.display_unit, brackets=True))
            legend_above(ax)
    return axes
