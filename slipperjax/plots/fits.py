"""Fits: signals of model and record, their differences, their spectra, and what is known about the parameters."""

import textwrap

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from ..tools.checks import one_of
from .style import (
    COLORS,
    check_dataset,
    entitle,
    legend_above,
    line_color,
    page,
    plain_number,
    typeset,
    with_unit,
)

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
            _draw_signal(axes[0, 0], at.isel(window=0))
            _draw_left(axes[0, 1], at)
        else:
            _draw_features(axes[0, 0], ds)
            _draw_misfit(axes[0, 1], ds)
        _draw_densities(axes[1, 0], at)
        _draw_parameters(axes[1, 1], ds)
        for ax in axes.flat:
            legend_above(ax)
        said = [f"fit: {ds.attrs['status']}", ds.attrs["not_identified"], ds.attrs["misfit"]]
        entitle(axes[0, 0].figure, *textwrap.wrap("; ".join(filter(None, said)), 120))
    return axes


def _draw_signal(ax: Axes, at: xr.Dataset) -> None:
    at = at.dropna("sample", subset=["measured"]).isel(sample=slice(SHOWN))
    time = 1e3 * at["seconds"]
    blue = line_color(0)
    ax.plot(time, at["measured"], ".", ms=2.5, color=COLORS["grey"], label="measured")
    likely = dict(color=blue, alpha=0.25, lw=0, label="90 % of likely ones")
    ax.fill_between(time, at["fitted_low"], at["fitted_high"], **likely)
    ax.plot(time, at["fitted"], lw=0.8, color=blue, label="model")
    sensor = with_unit(str(at["sensor"].item()), at["sensor_unit"].item(), brackets=True)
    ax.set(xlabel="time [ms]", ylabel=sensor)


def _draw_left(ax: Axes, at: xr.Dataset) -> None:
    left = (at["measured"] - at["fitted"]).values.ravel()
    left = left[np.isfinite(left)]
    x = left - left.mean()
    lags = np.arange(1, min(LAGS, len(x) - 1) + 1)
    correlation = [x[k:] @ x[:-k] / (x @ x) for k in lags]
    _draw_sticks(ax, lags, correlation, 1.96 / np.sqrt(len(x)), "95 % of white noise", "what is left")
    limit = max(0.3, 1.1 * float(np.abs(correlation).max()))
    ax.set(xlabel="lag [samples]", ylabel=f"autocorrelation, p = {float(at['whiteness']):.2g}", ylim=(-limit, limit))


def _draw_sticks(ax: Axes, x: np.ndarray, heights: object, reach: float, band: str, text: str) -> None:
    """Draw vertical lines from zero, over a band that reaches as far to both sides of zero."""
    ax.axhspan(-reach, reach, color=COLORS["grey"], alpha=0.3, lw=0, label=band)
    ax.vlines(x, 0, heights, color=line_color(1), lw=1.2, label=text)
    ax.axhline(0, lw=0.5, color="black")


def _draw_features(ax: Axes, ds: xr.Dataset) -> None:
    x = np.arange(ds.sizes["feature"])
    blue = line_color(0)
    ax.plot(x, ds["measured_feature"], ".", color=COLORS["grey"], label="measured")
    ax.plot(x, ds["fitted_feature"], ".", color=blue, label="model")
    ax.errorbar(x, ds["fitted_feature"], 1.645 * ds["feature_stderr"], fmt="none", lw=0.8, color=blue)
    ax.set(xlabel="number of the feature", ylabel="feature, with 90 % of such records")


def _draw_misfit(ax: Axes, ds: xr.Dataset) -> None:
    away = (ds["measured_feature"] - ds["fitted_feature"]) / ds["feature_stderr"]
    _draw_sticks(ax, np.arange(ds.sizes["feature"]), away, 1.645, "90 %", "measured - model")
    ax.set(xlabel="number of the feature", ylabel="difference [standard deviations]")


def _draw_densities(ax: Axes, at: xr.Dataset) -> None:
    x = at["frequency"].values
    likely = dict(color=line_color(0), alpha=0.25, lw=0, label="90 % of likely ones")
    ax.fill_between(x, at["density_low"], at["density_high"], **likely)
    ax.plot(x, at["density"], lw=0.8, color=line_color(0), label="model")
    ax.plot(x, at["measured_density"], ".-", ms=3, lw=0.6, color=COLORS["grey"], label="measured")
    unit = at["sensor_unit"].item()
    # only a single unit is squared without brackets
    square = f"{unit}^2" if unit.isalpha() else f"({unit})^2"
    text = f"density of {at['sensor'].item()} [{typeset(f'{square}/Hz')}]"
    ax.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel=text)


def _draw_parameters(ax: Axes, ds: xr.Dataset) -> None:
    quantities = fit_quantities(ds)
    for row, q in enumerate(quantities):
        one = ds.sel(parameter=q.name)
        stated = [one[name] for name in ("estimate", "low", "high")]
        values = np.hstack([one["prior_low"], one["prior_high"], *stated, one["minimum"]])
        # bounds far apart are compared by their logarithms
        if 0 < values[0] < values[1] / 5:
            values = np.log(values)
        estimate, low, high, *others = (values[2:] - values[0]) / (values[1] - values[0])
        style = dict(lw=4, alpha=0.35, color=line_color(0), solid_capstyle="butt", label="interval")
        ax.plot([low, high], [row, row], **style)
        ax.plot(estimate, row, "o", ms=4, color=line_color(0), label="estimate")
        for other in others:
            ax.plot(other, row, "x", ms=4, color=line_color(1), label="another minimum")
        value, low, high = (plain_number(q.shown(float(number))) for number in stated)
        text = with_unit(f"{value} ({low} to {high})", q.display_unit)
        ax.text(0.5, row - 0.28, text, ha="center", va="center", fontsize=6)
    ax.set_yticks(range(len(quantities)), [q.words for q in quantities])
    ax.set(xlim=(0, 1), ylim=(len(quantities) - 0.5, -0.6), xlabel="within 98 % of what was expected before")


def fit_quantities(ds: xr.Dataset) -> list[Quantity]:
    """Return the quantities of the fitted parameters; the quantity of a sensor has the unit of the file."""
    units = dict(zip(ds["parameter"].values.tolist(), ds["unit"].values.tolist(), strict=True))
    return [PARAMETERS.get(name) or Quantity(name, unit, name) for name, unit in units.items()]
