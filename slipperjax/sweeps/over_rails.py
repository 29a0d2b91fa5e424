"""Quantiles over rails of a sweep, with their errors, and differences between cases on common rails."""

import numpy as np
import scipy.stats
import xarray as xr

from ..analysis.quantiles import bootstrap, check_quantile
from ..tools.checks import instance, one_of, require, whole


def over_rails(
    values: xr.DataArray,
    quantile: float | None = 0.99,
    *,
    dim: str = "track.seed",
    resamples: int = 400,
    seed: int = 0,
) -> xr.Dataset:
    """Computes a quantile over rails, with its error, and how it differs between cases on the same rails.

    ```python
    ds = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(400)}, record="peak_force")
    over_rails(ds["peak_force"].max(("end", "point")), 0.99)
    ```

    **Arguments:** `values`: of one number in each case; `quantile`: the share of rails that lies below [1], or None
    for the mean; `dim`: the dimension of the rails; `resamples`, `seed`: of the bootstrap.

    **Returns:** an `xarray.Dataset` over the other dimensions, all in the unit of `values`: `value`; `low` and
    `high`, between which it lies in 95 % of all cases, for quantiles those of order statistics; `stderr`, a quarter
    of that; `difference` from the first case along the other dimensions, and `difference_stderr` by the bootstrap.
    Values that are NaN, where a slipper was lost, count as greater than all others: what they leave undetermined is
    NaN, too.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    instance("values", values, xr.DataArray, "an xarray.DataArray of a sweep")
    one_of("dim", dim, [str(name) for name in values.dims])
    others = [name for name in values.dims if name != dim]
    rows = values.transpose(dim, *others)
    numbers = rows.values.reshape(rows.sizes[dim], -1)
    require(len(numbers) > 1, "values", "have two or more rails", shown=f"{len(numbers)}")
    check_quantile(quantile, len(numbers))
    numbers = np.where(np.isnan(numbers) & (quantile is not None), np.inf, numbers)

    def fit(weights: np.ndarray) -> np.ndarray:
        drawn = numbers[np.repeat(np.arange(len(numbers)), weights.astype(int))]
        if quantile is None:
            return drawn.mean(axis=0)
        with np.errstate(invalid="ignore"):  # differences of infinite ones
            found = np.quantile(drawn, quantile, axis=0, method="median_unbiased")
        return np.where(np.isfinite(found), found, np.nan)

    value, drawn = bootstrap(
        fit, len(numbers), resamples=whole("resamples", resamples, 2), seed=whole("seed", seed, 0)
    )
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
    coords = {name: values.coords[name] for name in others if name in values.coords}
    facts = dict(rails=len(numbers), quantile="none" if quantile is None else quantile)
    return xr.Dataset(data, coords, facts)
