"""The picture of a record over the model, in g as in test reports."""

import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..model.quantities import Quantity
from .environment import finish_spectrum, in_g
from .style import (
    Units,
    check_dataset,
    entitle,
    legend_above,
    line_color,
    name_statuses,
    page,
    set_log_ticks,
    shown_units,
)

SOURCE = "slipperjax.fitting.telemetry"
DISTANCE = Quantity("distance", "m", "distance travelled")


class Compared(NamedTuple):
    """What a record and the model are compared by."""

    name: str
    """Variable of the model; the others are named after it."""
    text: str
    unit: str
    """Unit in which it is shown."""
    along: str
    """Dimension."""


COMPARED = {
    "bands": Compared("density", "power spectral density", "g^2/Hz", "frequency"),
    "frequencies": Compared("shock_response", "shock response", "g", "natural_frequency"),
    "windows": Compared("rms", "RMS in windows", "g", "distance"),
}
"""What is compared, by panel and table."""


class Sides(NamedTuple):
    """A record and the model at the same places or frequencies, in shown units."""

    of: Compared
    at: Quantity
    """Distance or frequency."""
    places: np.ndarray
    record: np.ndarray
    model: np.ndarray
    """Quantiles over rails, shape (quantiles, places)."""
    ratio: np.ndarray
    """Record over the middle of the model [dB]."""


def sides_of(report: object, units: Units = None) -> Iterator[tuple[str, Sides]]:
    """Yield what a result of `slipperjax.fitting.telemetry` compares, with the name of its table."""
    ds = check_dataset(report, SOURCE, "measured_density", "total_rms", argument="report")
    shown = in_g(ds)
    for name, of in COMPARED.items():
        text = of.along.replace("_", " ")
        at = shown_units(ds, units).of(DISTANCE) if of.along == "distance" else Quantity(of.along, "Hz", text)
        parts = (shown[part].values for part in (f"measured_{of.name}", of.name, f"{of.name}_ratio"))
        yield name, Sides(of, at, at.shown(ds[of.along].values), *parts)


def record_over_model(report: xr.Dataset, units: Units = None) -> np.ndarray:
    """Draw a record over the model: power spectral density, shock response, and RMS over distance.

    The record is a red line. The model is a blue line, with many rails the median, and the band of 5 to 95 % of the
    rails is shaded.

    **Arguments:** `report`: of `slipperjax.fitting.telemetry`; `units`: such as ("ft",), for distances; by default
    the units of the scene's file.

    **Returns:** an array of three Axes, in g, g^2/Hz and Hz.

    **Raises:** `ValueError` for another dataset.
    """
    every = [sides for _, sides in sides_of(report, units)]
    with page(1, 3, 2.6, report, full=False) as axes:
        for ax, sides in zip(axes, every, strict=True):
            _draw(ax, sides)
        legend_above(axes[0])
        rails = report.attrs["rails"]
        of_model = f"model on {rails} rails: median, and 5 to 95 % shaded" if rails > 1 else "model on one rail"
        entitle(axes[0].figure, f"sensor {json.loads(report.attrs['call'])['sensor']['name']}, {of_model}")
        name_statuses(axes[0].figure, report)
    return axes


def _draw(ax: Axes, sides: Sides) -> None:
    middle = sides.model[len(sides.model) // 2]
    if len(sides.model) > 1:
        ends = sides.model[[0, -1]]
        ax.fill_between(sides.places, *ends, color=line_color(0), alpha=0.2, lw=0)
    ax.plot(sides.places, middle, color=line_color(0), lw=1.0, label="model")
    ax.plot(sides.places, sides.record, color=line_color(1), lw=1.0, label="record")
    if sides.of.along == "distance":
        ax.set_ylim(bottom=0.0)
    else:
        finish_spectrum(ax, sides.places)
    if sides.of.unit == "g" and ax.get_yscale() == "log":
        set_log_ticks(ax.yaxis)
    ax.set_xlabel(f"{sides.at.long_name} [{sides.at.display_unit}]")
    ax.set_ylabel(f"{sides.of.text} [{sides.of.unit.replace('^2', '$^2$')}]")
