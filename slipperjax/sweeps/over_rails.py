"""Quantiles over rails of a sweep, with their errors, and differences between cases on common rails."""

from collections.abc import Callable

import numpy as np
import scipy.stats
import xarray as xr

from ..analysis.quantiles import bootstrap, check_quantile
from ..flow.status import MEANINGS, with_accuracy
from ..tools.checks import instance, one_of, require, whole
from ..tools.columns import column


def over_rails(
    values: xr.DataArray,
    quantile: float | None = 0.99,
    *,
    dim: str = "track.seed",
    finer: xr.DataArray | None = None,
    resamples: int = 400,
    seed: int = 0,
) -> xr.Dataset:
    """Compute a quantile over rails, with its error, and the differences between cases on the same rails.

    ```python
    rails = dict(transient=5, periods=60, record="peak_force")  # on which 1000 m of rail suffice
    ds = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(400)}, **rails)
    over_rails(ds["peak_force"].max(("end", "point")), 0.99)
    ```

    With `finer`, results of some of the rails with more steps, it also says what the number of steps changes: chaotic
    runs differ with the steps, but the distribution over rails must stay the same.

    ```python
    fine = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(100)}, refine=2, **rails)
    ```

    **Arguments:** `values`: one number for each case and rail; `quantile`: the share of rails whose values lie below
    it [1], or None for the mean; `dim`: the dimension of the rails; `finer`: as `values`, on some of their rails;
    `resamples`, `seed`: number and random seed of the bootstrap's samples.

    **Returns:** an `xarray.Dataset` over the other dimensions, in the unit of `values` where no other is named, with

    - `value`, the quantile or the mean;
    - `low` and `high`, its 95 % confidence interval: for quantiles from order statistics, otherwise two standard
      errors on both sides;
    - `stderr`, a quarter of the interval;
    - `difference` from the first case along the other dimensions, and `difference_stderr` by the bootstrap;
    - with `finer`: `step_change` [1], the relative change from the same rails in `values`, its standard error
      `step_change_stderr`, and `status`, `Status.INACCURATE` where the change is above a tenth by more than twice its
      error.

    Values that are NaN, where a slipper was lost, count as greater than all others when quantiles are taken. A result
    that depends on them is NaN.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    instance("values", values, xr.DataArray, "an xarray.DataArray of a sweep")
    one_of("dim", dim, [str(name) for name in values.dims])
    others = [name for name in values.dims if name != dim]
    rows = values.transpose(dim, *others)
    numbers = _of_rails(rows, quantile)
    require(len(numbers) > 1, "values", "have two or more rails", shown=f"{len(numbers)}")
    check_quantile(quantile, len(numbers))
    draws = dict(resamples=whole("resamples", resamples, 2), seed=whole("seed", seed, 0))
    value, drawn = bootstrap(_fit(numbers, quantile), len(numbers), **draws)
    if quantile is None:
        stderr = drawn.std(axis=0, ddof=1)
        low = value - 2 * stderr
        high = value + 2 * stderr
    else:
        # true whatever the distribution, for as many values lie below as a binomial law says
        below = np.asarray(scipy.stats.binom.ppf([0.025, 0.975], len(numbers), quantile), int)
        places = below - np.array([1, 0])  # from 0 on
        ends = np.sort(numbers, axis=0)[np.clip(places, 0, len(numbers) - 1)]
        low, high = np.where(np.isfinite(ends), ends, np.nan)
        stderr = (high - low) / 4
    unit = values.attrs.get("units", "")
    # all cases of a resample have the same rails, so that what these have in common cancels
    difference_stderr = (drawn - drawn[:, :1]).std(axis=0, ddof=1)
    columns = {
        "value": (value, unit, "mean" if quantile is None else f"quantile {quantile:g}"),
        "stderr": (stderr, unit, "standard error"),
        "low": (low, unit, "lower end of the 95 % interval"),
        "high": (high, unit, "upper end of the 95 % interval"),
        "difference": (value - value[0], unit, "difference from the first case"),
        "difference_stderr": (difference_stderr, unit, "standard error of the difference"),
    }
    if finer is not None:
        # drawn together, so that both have the same rails in each resample
        fine, same = (_of_rails(part, quantile) for part in _same_rails(finer, rows, dim))
        check_quantile(quantile, len(fine))
        pairs = _fit(np.concatenate([fine, same], axis=1), quantile)
        change, drawn = bootstrap(
            lambda weights: np.divide(*np.split(pairs(weights), 2)) - 1,
            len(fine),
            **draws,
        )
        error = drawn.std(axis=0, ddof=1)
        columns["step_change"] = change, "1", "relative change by more steps"
        columns["step_change_stderr"] = error, "1", "standard error of the relative change"
    shape = [rows.sizes[name] for name in others]
    data = {name: column(others, array.reshape(shape), *words) for name, (array, *words) in columns.items()}
    if finer is not None:
        status = with_accuracy(
            np.zeros(shape, int),
            np.abs(data["step_change"][1]),
            data["step_change_stderr"][1],
        )
        data["status"] = column(others, status, "", "status", meaning=MEANINGS)
    coords = {name: values.coords[name] for name in others if name in values.coords}
    facts = dict(rails=len(numbers), quantile="none" if quantile is None else quantile)
    return xr.Dataset(data, coords, facts)


def _of_rails(rows: xr.DataArray, quantile: float | None) -> np.ndarray:
    """Return values of shape (rails, cases); for quantiles NaN becomes infinity, because lost slippers count most."""
    numbers = rows.values.reshape(len(rows), -1)
    return np.where(np.isnan(numbers) & (quantile is not None), np.inf, numbers)


def _fit(numbers: np.ndarray, quantile: float | None) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function of how often each rail was drawn, which gives the quantiles or means of the cases."""

    def fit(weights: np.ndarray) -> np.ndarray:
        drawn = numbers[np.repeat(np.arange(len(numbers)), weights.astype(int))]
        if quantile is None:
            return drawn.mean(axis=0)
        with np.errstate(invalid="ignore"):  # differences of infinite ones
            found = np.quantile(drawn, quantile, axis=0, method="median_unbiased")
        return np.where(np.isfinite(found), found, np.nan)

    return fit


def _same_rails(finer: xr.DataArray, rows: xr.DataArray, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return values with more steps, and those of the same rails in `rows`.

    **Raises:** `ValueError` where `finer` has other dimensions, or rails that are not in `rows`.
    """
    instance("finer", finer, xr.DataArray, "an xarray.DataArray of a sweep")
    need = f"have the dimensions {', '.join(map(str, rows.dims))}"
    require(set(finer.dims) == set(rows.dims), "finer", need, shown=", ".join(map(str, finer.dims)))
    fine = finer.transpose(*rows.dims)
    good = fine.shape[1:] == rows.shape[1:] and fine[dim].isin(rows[dim]).all()
    require(
        good,
        "finer",
        "be of the same cases, on rails that are among those of `values`",
        shown="of others",
    )
    return fine, rows.sel({dim: fine[dim]})
