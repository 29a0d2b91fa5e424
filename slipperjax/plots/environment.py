"""The page of a vibration environment, in g as in test reports."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes

from ..model.quantities import Quantity
from ..tools.checks import require, whole
from ..tools.units import STANDARD_GRAVITY
from .style import (
    COLORS,
    check_dataset,
    entitle,
    legend_above,
    line_color,
    name_statuses,
    page,
    set_log_ticks,
    shown_units,
)

SOURCE = "slipperjax.environment"
RMS = ("rms", "band_rms", "maximax_rms")
"""Root mean squares that the page states."""
DECADES = 6
"""Most decades of a density in a panel."""


def vibration(report: xr.Dataset, place: int = 0) -> np.ndarray:
    """Draw a page of the vibration environment of a place.

    Above are power spectral densities along x, y and z: each rail in grey, with their maximum, mean and 95/50 limit.
    Below are the shock response, with the greatest of all rails and the limit; the level over time of the rail with
    the highest level, shaded where it is within 6 dB of its highest value; and a table with the greatest of all
    rails.

    **Arguments:** `report`: of `slipperjax.environment`; `place`: the place's number, from 0.

    **Returns:** the Axes, in g, g^2/Hz, Hz and s, shape (2, 3).

    **Raises:** `ValueError` for another dataset, or a place that the dataset does not have.
    """
    places = places_of(report)
    whole("place", place, 0)
    require(place < len(places), "place", f"be below {len(places)}, the number of places", place)
    at = places[place]
    with page(2, 3, 5.0, report, full=False) as axes:
        for ax, direction in zip(axes[0], at["direction"].values, strict=True):
            _draw_density(ax, at.sel(direction=direction))
        _draw_shock(axes[1, 0], at)
        _draw_level(axes[1, 1], at)
        for ax in axes.flat:
            legend_above(ax)
        _draw_table(axes[1, 2], at)
        axes[0, 0].set_ylabel("power spectral density [g$^2$/Hz]")
        rails = at.sizes["rail"]
        entitle(axes[0, 0].figure, f"place {named_place(at)}, {rails} rail{'s' * (rails > 1)}")
        name_statuses(axes[0, 0].figure, report)
    # one scale for all directions
    densities = np.concatenate([line.get_ydata() for ax in axes[0] for line in ax.lines])
    positive = densities[densities > 0]
    if positive.size:
        most = positive.max()
        plt.setp(axes[0], ylim=(0.5 * max(positive.min(), most * 10.0**-DECADES), 2 * most))
    return axes


def named_place(at: xr.Dataset) -> str:
    """Return a place of a report as a text, in the units of its scene's file."""
    q = shown_units(at).of(Quantity("place", "m", "place on the body", shown_unit="m"))
    x, y, z = (float(q.shown(at[axis])) for axis in "xyz")
    return f"({x:.4g}, {y:.4g}, {z:.4g}) {q.display_unit}"


def three_digits(value: float) -> str:
    """Return a number with three significant digits, large numbers without a power of ten."""
    return f"{float(f'{value:.3g}'):g}"


def places_of(report: xr.Dataset) -> list[xr.Dataset]:
    """Return a report of each place, with accelerations in g and densities in g^2/Hz."""
    ds = in_g(check_dataset(report, SOURCE, "density_envelope", "shock_response", argument="report"))
    return [ds.isel(place=place) for place in range(ds.sizes["place"])]


def in_g(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with accelerations in g and densities in g^2/Hz."""
    factors = {"m/s^2": 1 / STANDARD_GRAVITY, "m^2/s^4/Hz": 1 / STANDARD_GRAVITY**2}
    return ds.map(lambda values: values * factors.get(values.attrs.get("units"), 1))


def greatest_of_rails(at: xr.Dataset) -> pd.DataFrame:
    """Return RMS, RMS in the bands, shock response [g] and duration [s], the greatest of all rails, by direction."""
    names = [*RMS, "shock_response", "duration"]
    return at[names].max(["rail", "natural_frequency"]).to_dataframe().loc[:, names]


def _draw_density(ax: Axes, at: xr.Dataset) -> None:
    edges = np.append(at["low"].values, at["high"].values[-1])
    rails = at["density"].values
    if len(rails) == 1:
        ax.plot(at["frequency"], rails[0], lw=1.0, color=line_color(0))
    else:
        ax.plot(at["frequency"], rails.T, color=COLORS["grey"], lw=0.3, alpha=max(0.1, 1 / len(rails) ** 0.5))
        # lines that summarise rails
        for name, text, color, dashes in (
            ("maximum", "maximum", line_color(0), "-"),
            ("mean", "mean", line_color(2), "--"),
            ("limit", "95/50", line_color(1), "-"),
        ):
            envelope = at["density_envelope"].sel(summary=name)
            ax.plot(at["frequency"], envelope, lw=1.0, color=color, ls=dashes, label=text)
    if "specification_frequency" in at:
        lines = at["specification_frequency"].values, at["specification_density"].values
        ax.plot(*lines, color="black", lw=0.8, ls=":", label="specification")
    finish_spectrum(ax, edges)
    ax.set_xlabel(f"frequency [Hz], along {at['direction'].item()}")


def _draw_shock(ax: Axes, at: xr.Dataset) -> None:
    natural = at["natural_frequency"].values
    rails = at.sizes["rail"]
    for k, direction in enumerate(at["direction"].values):
        of_all = at["shock_envelope"].sel(direction=direction)
        ax.plot(natural, of_all.sel(summary="maximum"), color=line_color(k), lw=1.0, label=str(direction))
        if rails > 1:
            ax.plot(natural, of_all.sel(summary="limit"), color=line_color(k), lw=0.7, ls="--")
    finish_spectrum(ax, natural)
    ax.set(xlabel="natural frequency [Hz]", ylabel="shock response [g]" + ", dashed 95/50" * (rails > 1))


def finish_spectrum(ax: Axes, edges: np.ndarray) -> None:
    """Make the axes of a panel over frequency logarithmic, between the outer edges of its bands [Hz]."""
    ax.set_xscale("log")
    # along x the centre of mass has no acceleration
    if any(np.any(np.asarray(line.get_ydata()) > 0) for line in ax.lines):
        ax.set_yscale("log")
    ax.set_xlim(edges[0], edges[-1])
    # the labels 1000 and 2000 would touch each other
    set_log_ticks(ax.xaxis, fine=(2, 5))


def _draw_level(ax: Axes, at: xr.Dataset) -> None:
    seconds = at["seconds"].values
    for k, direction in enumerate(at["direction"].values):
        levels = at["level"].sel(direction=direction).values
        level = levels[np.argmax(levels.max(axis=1))]
        ax.plot(seconds, level, color=line_color(k), lw=1.0, label=str(direction))
        near = level >= 10 ** (-6 / 20) * level.max()
        ax.fill_between(seconds, level, where=near.tolist(), color=line_color(k), alpha=0.15, lw=0)
    ax.set(xlim=seconds[[0, -1]], xlabel="time [s]", ylabel="level [g], within 6 dB shaded")
    ax.set_ylim(bottom=0.0)


def _draw_table(ax: Axes, at: xr.Dataset) -> None:
    ax.axis("off")
    low, high = float(at["low"][0]), float(at["high"][-1])
    greatest = greatest_of_rails(at)
    bands = f"g-RMS, {low:g}\nto {high:g} Hz"
    heads = ["g-RMS", bands, f"{bands},\nloudest", "highest shock\nresponse [g]", "within\n6 dB [s]"]
    cells = greatest.T.map(three_digits).values
    table = ax.table(
        cells, rowLabels=heads, colLabels=list(greatest.index), cellLoc="center", bbox=(0.35, 0.2, 0.65, 0.7)
    )
    table.auto_set_font_size(False)
    table.set_fontsize(6.5)
    for (row, _), cell in table.get_celld().items():
        cell.set_linewidth(0.4)
        # the box keeps the ratios of heights
        cell.set_height(1.4 + (heads[row - 1].count("\n") if row else 0))
