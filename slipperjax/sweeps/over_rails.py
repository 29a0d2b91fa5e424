"""Quantiles over rails of a sweep, with their errors, and differences between cases on common rails."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.stats
import xarray as xr

from ..analysis.quantiles import bootstrap, check_quantile
from ..flow.status import MEANINGS, Status, with_accuracy
from ..tools.checks import instance, one_of, require, whole


def over_rails(
    values: xr.DataArray,
    quantile: float | None = 0.99,
    *,
    dim: str = "track.seed",
    finer: xr.DataArray | None = None,
    resamples: int = 400,
    seed: int = 0,
) -> xr.Dataset:
    """Computes a quantile over rails, with its error, and how it differs between cases on the same rails.

    ```python
    rails = dict(transient=5, periods=60, record="peak_force")  # on which 1000 m of rail suffice
    ds = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(400)}, **rails)
    over_rails(ds["peak_force"].max(("end", "point")), 0.99)
    ```

    With `finer`, the same of some of the rails with more steps, it says what the steps change: in chaos the runs are
    others, but their distribution must be the same.

    ```python
    fine = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(100)}, refine=2, **rails)
    ```

    **Arguments:** `values`: of one number in each case; `quantile`: the share of rails that lies below [1], or None
    for the mean; `dim`: the dimension of the rails; `finer`: as `values`, of rails that are among theirs;
    `resamples`, `seed`: of the bootstrap.

    **Returns:** an `xarray.Dataset` over the other dimensions, all in the unit of `values`: `value`; `low` and
    `high`, between which it lies in 95 % of all cases, for quantiles those of order statistics; `stderr`, a quarter
    of that; `difference` from the first case along the other dimensions, and `difference_stderr` by the bootstrap.
    With `finer`: `step_change`, the quantile of `finer` over that of the same rails in `values`, less one [1], its
    error `step_change_stderr`, and `status`, `Status.INACCURATE` where the change is above a tenth by more than
    twice its error. Values that are NaN, where a slipper was lost, count as greater than all others: what they leave
    undetermined is NaN, too.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    instance("values", values, xr.DataArray, "an xarray.DataArray of a sweep")
    one_of("dim", dim, [str(name) for name in values.dims])
    others = [name for name in values.dims if name != dim]
    rows = values.transpose(dim, *others)
    lost_last = lambda values: np.where(np.isnan(values) & (quantile is not None), np.inf, values)
    numbers = lost_last(rows.values.reshape(rows.sizes[dim], -1))
    require(len(numbers) > 1, "values", "have two or more rails", shown=f"{len(numbers)}")
    check_quantile(quantile, len(numbers))

    def of(numbers: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        def fit(weights: np.ndarray) -> np.ndarray:
            drawn = numbers[np.repeat(np.arange(len(numbers)), weights.astype(int))]
            if quantile is None:
                return drawn.mean(axis=0)
            with np.errstate(invalid="ignore"):  # differences of infinite ones
                found = np.quantile(drawn, quantile, axis=0, method="median_unbiased")
            return np.where(np.isfinite(found), found, np.nan)

        return fit

    draws = dict(resamples=whole("resamples", resamples, 2), seed=whole("seed", seed, 0))
    value, drawn = bootstrap(of(numbers), len(numbers), **draws)
    if quantile is None:
        stderr = drawn.std(axis=0, ddof=1)
        low, high = value - 2 * stderr, value + 2 * stderr
    else:
        # true whatever the distribution, for as many values lie below as a binomial law says
        places = scipy.stats.binom.ppf([0.025, 0.975], len(numbers), quantile).astype(int) - [1, 0]
        ranked = np.sort(numbers, axis=0)
        ends = [ranked[k] for k in np.clip(places, 0, len(numbers) - 1).tolist()]
        low, high = (np.where(np.isfinite(end), end, np.nan) for end in ends)
        stderr = (high - low) / 4
    columns = {
        "value": (value, "mean" if quantile is None else f"quantile {quantile:g}"),
        "stderr": (stderr, "standard error"),
        "low": (low, "lower end of the 95 % interval"),
        "high": (high, "upper end of the 95 % interval"),
        "difference": (value - value[0], "difference from the first case"),
        "difference_stderr": ((drawn - drawn[:, :1]).std(axis=0, ddof=1), "standard error of the difference"),
    }
    shape = [rows.sizes[name] for name in others]
    words = lambda text: {"units": values.attrs.get("units", ""), "long_name": text}
    data = {name: (others, column.reshape(shape), words(text)) for name, (column, text) in columns.items()}
    if finer is not None:
        fine, same = _same_rails(finer, rows, dim)
        check_quantile(quantile, len(fine))
        pairs = of(lost_last(np.concatenate([fine, same], axis=1)))
        halves = lambda weights: np.split(pairs(weights), 2)
        change, drawn = bootstrap(lambda weights: np.divide(*halves(weights)) - 1, len(fine), **draws)
        data |= _changes(others, change.reshape(shape), drawn.std(axis=0, ddof=1).reshape(shape))
    coords = {name: values.coords[name] for name in others if name in values.coords}
    facts = dict(rails=len(numbers), quantile="none" if quantile is None else quantile)
    return xr.Dataset(data, coords, facts)


def _same_rails(finer: xr.DataArray, rows: xr.DataArray, dim: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns values with more steps, and those of the same rails in `rows`, both of shape (rails, cases).

    **Raises:** `ValueError` where `finer` has other dimensions, or rails that are not in `rows`.
    """
    instance("finer", finer, xr.DataArray, "an xarray.DataArray of a sweep")
    alike = set(finer.dims) == set(rows.dims)
    require(
        alike, "finer", f"have the dimensions {', '.join(map(str, rows.dims))}", shown=", ".join(map(str, finer.dims))
    )
    fine = finer.transpose(*rows.dims)
    places = [np.flatnonzero(rows[dim].values == number) for number in fine[dim].values]
    good = all(len(found) == 1 for found in places) and fine.shape[1:] == rows.shape[1:]
    require(good, "finer", "be of the same cases, on rails that are among those of `values`", shown="of others")
    flat = lambda array: array.values.reshape(len(places), -1)
    return flat(fine), flat(rows.isel({dim: np.concatenate(places)}))


def _changes(dims: list, change: np.ndarray, stderr: np.ndarray) -> dict[str, Any]:
    """Returns the variables of what steps change [1]."""
    status = with_accuracy(np.full(change.shape, int(Status.FINITE)), np.abs(change), stderr)
    words = lambda text: {"units": "1", "long_name": text}
    return {
        "step_change": (dims, change, words("relative change by more steps")),
        "step_change_stderr": (dims, stderr, words("standard error of the relative change")),
        "status": (dims, status, {"meaning": MEANINGS}),
    }
