"""Basins of attraction of a scene: the shares of starts that lead to each attractor, over parameters."""

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr

from ..model.parameters import STARTS
from ..model.scene import Scene
from ..results.result import Result
from ..tools.checks import instance, require, whole
from .attractors import groups
from .grid import Grid
from .sweep import sweep


def basins(
    scene: Scene,
    starts: Mapping[str, object],
    over: Mapping[str, object] | None = None,
    *,
    count: int | None = None,
    seed: int = 0,
    tolerance: float = 0.05,
    reach: float = 0.5,
    transient: int = 300,
    last: int = 20,
    **options: object,
) -> Result:
    """Simulate many starts, and return which share of them leads to each attractor, over parameters.

    ```python
    starts = {"start_y": (-1e-3, 1e-3), "start_v_y": (-0.5, 0.5)}
    found = sj.basins(scene, starts, over={"clearance": [3.8e-3, 4e-3]}, count=500)
    ```

    **Arguments:**

    - `starts`: values by coordinate of the start, of which every combination is a start; with `count`, the first and
        the last bound of random starts.
    - `over`: values by parameter, of which every combination gets the same starts; default the scene alone.
    - `count`: number of random starts, uniform within the bounds; `seed`: of these.
    - `tolerance`, `reach`, `last`: how attractors are told apart, and matched between values, as for
        `slipperjax.sweeps.groups`.
    - `transient`: forcing periods before the `last` ones; `options`: as for `sweep`.

    **Returns:** a `Result`: `basin`, the number of the attractor of each start, -1 for starts with a status; for each
    `attractor` `basin_period`, and `share` with `share_stderr` [1] at each value. The standard errors hold for random
    starts. Its picture shows the shares over one parameter, or a map of starts over two coordinates.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C.
    """
    instance("starts", starts, Mapping, "values by coordinate of the start")
    known = bool(starts) and set(starts) <= set(STARTS)
    require(known, "starts", f"name some of {', '.join(STARTS)}", list(starts))
    over = dict(over or {})
    require(not set(over) & set(STARTS), "over", "name parameters, not coordinates of the start", list(over))
    own: dict[str, object] = {"function": "basins", "tolerance": tolerance, "reach": reach}
    kept = dict(record="strobe", periods=last, transient=transient, **options)
    if count is None:
        ds = sweep(scene, {**over, **starts}, **kept).ds
    else:
        count = whole("count", count, 1)
        own |= {"count": count, "seed": whole("seed", seed, 0)}
        ds = _random(scene, starts, over, count, seed, kept)
    found = groups(ds, last, tolerance, reach)
    return Result(found.assign_attrs(call=json.dumps(json.loads(ds.attrs["call"]) | own)))


def _random(
    scene: Scene, starts: Mapping[str, object], over: Mapping[str, object], count: int, seed: int, kept: dict
) -> xr.Dataset:
    """Return a sweep of random starts along `start`, behind the parameters."""
    generator = np.random.default_rng(seed)
    bounds = Grid(scene, starts).axes
    drawn = {name: generator.uniform(ends.min(), ends.max(), count) for name, ends in bounds.items()}
    axes = Grid(scene, over).axes if over else {}
    shape = tuple(map(len, axes.values()))
    places = np.meshgrid(*axes.values(), indexing="ij")
    rows = {name: np.repeat(place.ravel(), count) for name, place in zip(axes, places, strict=True)}
    rows |= {name: np.tile(values, int(np.prod(shape))) for name, values in drawn.items()}
    ds = sweep(scene, rows, product=False, **kept).ds
    dims = (*axes, "start")
    cases = xr.Dataset(attrs=ds.attrs)
    for name in ("strobe", "status", "steps_per_period"):
        of = ds[name]
        cases[name] = ((*dims, *of.dims[1:]), of.values.reshape(*shape, count, *of.shape[1:]), of.attrs)
    for name, values in axes.items():
        cases = cases.assign_coords({name: (name, values, ds[name].attrs)})
    # numbers of the starts, which are no coordinates of the cases
    return cases.assign({name: ("start", values, ds[name].attrs) for name, values in drawn.items()})
