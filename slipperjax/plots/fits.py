"""Fits: signals of model and record, their differences, their spectra, and what is known about the parameters."""

import textwrap

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from ..tools.checks import one_of
from .style import COLORS, check_dataset, entitle, legend_above, line_color, page, typeset, with_unit

SOURCE = "slipperjax.fit"
SHOWN = 150
"""Samples of a record in a picture."""
LAGS = 40
"""Lags of the residuals' autocorrelation in a picture."""


def fit_overview(result: object, sensor: str | None = None) -> np.ndarray:
    """Draw a page of a fit.

    For trajectories: the beginning of a sensor's record with the model's signal and its 90 % band; the
    autocorrelation of the residuals, with the band of white noise; power spectral densities of record and model; and
    the intervals of the parameters within their prior ranges. For features: the features in place of the signal and
    the residuals.

    **Arguments:** `result`: a `Fit`, or its dataset; `sensor`: by default the first.

    **Returns:** the Axes, shape (2, 2).

    **Raises:** `ValueError` for another dataset, or a sensor that the dataset does not have.
    """
    ds = check_dataset(result, SOURCE, "estimate", "prior_low", argument="result")
    sensors = [str(name) for name in ds["sensor"].values]
    at = ds.sel(sensor=sensors[0] if sensor is None else one_of("sensor", sensor, sensors))
    with page(2, 2, 5.2, ds, full=False) as axes:
        if "measured" in ds:
            _draw_signal(axes[0, 0], at)
            _draw_left(axes[0, 1], at)
        else:
            _draw_features(axes[0, 0], ds)
            _draw_misfit(axes[0, 1], ds)
        _draw_densities(axes[1, 0], at)
        _draw_parameters(axes[1, 1], ds)
        figure = axes[0, 0].figure
        said = [ds.attrs[name] for name in ("not_identified", "misfit") if ds.attrs[name]]
        words = textwrap.wrap("; ".join([f"fit: {ds.attrs['status']}", *said]), 120)
        entitle(figure, "\n".join(filter(None, [figure.get_suptitle(), *words])))
    return axes


def _label(at: xr.Dataset) -> str:
    return with_unit(str(at["sensor"].item()), at["sensor_unit"].item(), brackets=True)


def _draw_signal(ax: Axes, at: xr.Dataset) -> None:
    first = at.isel(window=0)
    known = np.isfinite(first["measured"].values)
    shown = {name: first[name].values[known][:SHOWN] for name in ("seconds", "measured", "fitted")}
    low, high = (first[f"fitted_{end}"].values[known][:SHOWN] for end in ("low", "high"))
    time = 1e3 * shown["seconds"]
    ax.plot(time, shown["measured"], ".", ms=2.5, color=COLORS["grey"], label="measured")
    ax.fill_between(time, low, high, color=line_color(0), alpha=0.25, lw=0, label="90 % of likely ones")
    ax.plot(time, shown["fitted"], lw=0.8, color=line_color(0), label="model")
    ax.set(xlabel="time [ms]", ylabel=_label(at))
    legend_above(ax)


def _draw_left(ax: Axes, at: xr.Dataset) -> None:
    left = (at["measured"] - at["fitted"]).values.ravel()
    left = left[np.isfinite(left)]
    x = left - left.mean()
    lags = np.arange(1, min(LAGS, len(x) - 1) + 1)
    correlation = [x[k:] @ x[:-k] / (x @ x) for k in lags]
    reach = 1.96 / np.sqrt(len(x))
    ax.axhspan(-reach, reach, color=COLORS["grey"], alpha=0.3, lw=0, label="95 % of white noise")
    ax.vlines(lags, 0, correlation, color=line_color(1), lw=1.2, label="what is left")
    ax.axhline(0, lw=0.5, color="black")
    limit = max(0.3, 1.1 * float(np.abs(correlation).max()))
    ax.set(xlabel="lag [samples]", ylabel=f"autocorrelation, p = {float(at['whiteness']):.2g}", ylim=(-limit, limit))
    legend_above(ax)


def _draw_features(ax: Axes, ds: xr.Dataset) -> None:
    x = np.arange(ds.sizes["feature"])
    for name, color in (("measured_feature", COLORS["grey"]), ("fitted_feature", line_color(0))):
        ax.plot(x, ds[name], ".", color=color, label=name.replace("_feature", "").replace("fitted", "model"))
    ax.errorbar(x, ds["fitted_feature"], 1.645 * ds["feature_stderr"], fmt="none", lw=0.8, color=line_color(0))
    ax.set(xlabel="number of the feature", ylabel="feature, with 90 % of such records")
    legend_above(ax)


def _draw_misfit(ax: Axes, ds: xr.Dataset) -> None:
    x = np.arange(ds.sizes["feature"])
    away = (ds["measured_feature"] - ds["fitted_feature"]) / ds["feature_stderr"]
    ax.axhspan(-1.645, 1.645, color=COLORS["grey"], alpha=0.3, lw=0, label="90 %")
    ax.vlines(x, 0, away, color=line_color(1), lw=1.5, label="measured - model")
    ax.axhline(0, lw=0.5, color="black")
    ax.set(xlabel="number of the feature", ylabel="difference [standard deviations]")
    legend_above(ax)


def _draw_densities(ax: Axes, at: xr.Dataset) -> None:
    x = at["frequency"].values
    ax.fill_between(
        x, at["density_low"], at["density_high"], color=line_color(0), alpha=0.25, lw=0, label="90 % of likely ones"
    )
    ax.plot(x, at["density"], lw=0.8, color=line_color(0), label="model")
    ax.plot(x, at["measured_density"], ".-", ms=3, lw=0.6, color=COLORS["grey"], label="measured")
    ax.set(xscale="log", yscale="log", xlabel="frequency [Hz]")
    unit = typeset(at["sensor_unit"].item())
    ax.set_ylabel(f"density of {at['sensor'].item()} [({unit})$^2$/Hz]")
    legend_above(ax)


def _draw_parameters(ax: Axes, ds: xr.Dataset) -> None:
    names = [str(name) for name in ds["parameter"].values]
    for row, name in enumerate(names):
        one = ds.sel(parameter=name)
        low, high = float(one["prior_low"]), float(one["prior_high"])
        # bounds far apart are compared by their logarithms
        scale = np.log if low > 0 and high > 5 * low else float
        begin, width = scale(low), scale(high) - scale(low)
        share = lambda value, begin=begin, width=width, scale=scale: (scale(value) - begin) / width
        ends = share(float(one["low"])), share(float(one["high"]))
        at = share(float(one["estimate"]))
        ax.plot(ends, [row, row], lw=4, alpha=0.35, color=line_color(0), solid_capstyle="butt", label="interval")
        ax.plot(at, row, "o", ms=4, color=line_color(0), label="estimate")
        for other in ds["minimum"].sel(parameter=name).values:
            ax.plot(share(float(other)), row, "x", ms=4, color=line_color(1), label="another minimum")
        ax.text(0.5, row - 0.28, _stated(name, one), ha="center", va="center", fontsize=6)
    ax.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    ax.set(xlim=(0, 1), ylim=(len(names) - 0.5, -0.6), xlabel="within 98 % of what was expected before [1]")
    legend_above(ax)


def _stated(name: str, one: xr.Dataset) -> str:
    """Return an estimate with its interval as a text."""
    q = fit_quantity(one, name)
    value, low, high = (float(q.shown(float(one[key]))) for key in ("estimate", "low", "high"))
    return with_unit(f"{value:.5g} ({low:.5g} to {high:.5g})", q.display_unit)


def fit_quantity(ds: xr.Dataset, name: str) -> Quantity:
    """Return the quantity of a fitted parameter; the quantity of a sensor has the unit of the file."""
    if name in PARAMETERS:
        return PARAMETERS[name]
    unit = ds["unit"] if ds["unit"].ndim == 0 else ds["unit"].sel(parameter=name)
    return Quantity(name, str(unit.item()), name)
