"""Pictures of one trajectory: histories, contact forces, phase portraits and spectra."""

import textwrap
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from ..flow import Status
from ..model import quantity
from .style import COLORS, STYLE, axis_label, new_axes, shown, typeset

TIME_LABEL = "time [forcing periods]"


def history(ds: xr.Dataset, name: str, ax: Any = None) -> Any:
    """One output over time.

    **Arguments:**

    - `ds`: from `Trajectory.to_xarray`, or one case of `sweep(..., record="history")`.
    - `name`: a variable over time, in SI units; drawn in its display unit, as in mm or mrad.
    - `ax`: the Axes to draw into; default those of a new figure.

    **Returns:** the Axes, with time in forcing periods.
    """
    ax = new_axes() if ax is None else ax
    ax.plot(ds["period"].values, shown(ds, name), lw=0.7, color=COLORS["blue"])
    ax.set(xlabel=TIME_LABEL, ylabel=axis_label(name))
    return ax


def contact_forces(ds: xr.Dataset, ax: Any = None, *, most: int = 4) -> Any:
    """The contact forces [kN] of the points with the highest peaks over time.

    A dot marks the highest force of each over every integration step, which the saved states may miss.

    **Arguments:** `ds`, `ax`: as for `history`; `most`: number of points.

    **Returns:** the Axes. Points are named by their letter and 1 at the front or 2 at the rear.
    """
    ax = new_axes() if ax is None else ax
    peaks = (ds["peak_force"] if "peak_force" in ds else ds["contact_force"].max("time")).stack(at=("end", "point"))
    for end, point in peaks.sortby(peaks, ascending=False)["at"].values[:most]:
        here = ds.sel(end=end, point=point)
        (line,) = ax.plot(
            ds["period"].values, shown(here, "contact_force"), lw=0.7, label=f"{point}{1 if end == 'front' else 2}"
        )
        if "peak_force" in ds:
            peak = quantity("peak_force").shown(here["peak_force"])
            ax.plot(here["peak_period"], peak, "o", ms=2.5, mew=0, color=line.get_color())
    ax.set(xlabel=TIME_LABEL, ylabel=axis_label("contact_force"))
    ax.legend(fontsize=6, ncols=4, loc="upper right")
    return ax


def overview(ds: xr.Dataset, axes: Any = None) -> Any:
    """A trajectory on one page: displacements [mm], angles [mrad], velocities, contact forces and drive force.

    A status other than 0 is named in the figure's title.

    **Arguments:** `ds`: from `Trajectory.to_xarray`; `axes`: 6 x 2 Axes; default those of a new figure.

    **Returns:** the Axes, an array.
    """
    with plt.rc_context(STYLE):
        if axes is None:
            _, axes = plt.subplots(6, 2, figsize=(7.2, 8.2), sharex=True, layout="constrained")
        names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z")
        for name, ax in zip(names, axes.flat, strict=False):
            history(ds, name, ax).set_xlabel("")
        contact_forces(ds, axes[5, 0])
        history(ds, "drive_force", axes[5, 1])
        status = Status(int(ds.attrs.get("status", Status.FINITE)))
        if status != Status.FINITE:
            axes[0, 0].figure.suptitle(textwrap.fill(f"status: {status}", 90), color=COLORS["red"])
    return axes


def phase_portrait(ds: xr.Dataset, coordinate: str, velocity: str, ax: Any = None) -> Any:
    """The orbit in the plane of a coordinate and its velocity, in red its section by upward zero crossings.

    **Arguments:** `ds`, `ax`: as for `history`; `coordinate`, `velocity`: variables, drawn in their display units.

    **Returns:** the Axes.
    """
    ax = new_axes(3.5, 3.0) if ax is None else ax
    q, v = shown(ds, coordinate), shown(ds, velocity)
    ax.plot(q, v, lw=0.35, color=COLORS["blue"])
    at = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
    share = q[at] / (q[at] - q[at + 1])
    ax.plot(0 * at, v[at] + share * (v[at + 1] - v[at]), ".", color=COLORS["red"], ms=4, mew=0)
    ax.set(xlabel=axis_label(coordinate), ylabel=axis_label(velocity))
    return ax


def spectrum(frequency: Any, density: Any, ax: Any = None, *, unit: str = "", highest: float | None = None) -> Any:
    """A power spectral density over frequency, with a logarithmic scale.

    **Arguments:**

    - `frequency`: [Hz], of which those above zero are drawn; `density`: [`unit`], of the same shape.
    - `ax`: the Axes to draw into; default those of a new figure.
    - `unit`: of the density, as datasets write it, as in (rad/s^2)^2/Hz.
    - `highest`: the highest frequency drawn [Hz]; default all.

    **Returns:** the Axes.
    """
    ax = new_axes() if ax is None else ax
    frequency, density = np.asarray(frequency), np.asarray(density)
    drawn = (frequency > 0) & (frequency <= (np.inf if highest is None else highest))
    ax.semilogy(frequency[drawn], density[drawn], lw=0.6, color=COLORS["blue"])
    ax.set(xlabel="frequency [Hz]", ylabel=f"PSD [{typeset(unit)}]" if unit else "PSD")
    return ax
