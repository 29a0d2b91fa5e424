"""Pictures of one trajectory: histories, contact forces, phase portraits and spectra."""

import textwrap
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from ..flow.status import Status
from ..model.quantities import quantity
from .style import (
    COLORS,
    POINT_COLORS,
    axis_label,
    check_dataset,
    legend_above,
    legends_above,
    name_case,
    new_axes,
    shown,
    styled,
    typeset,
)

TIME_LABEL = "time [forcing periods]"
SOURCE = "one case over time, such as run.to_xarray()"
"""What makes the datasets drawn here, for errors."""
LAST = 4.0
"""Forcing periods at the end of a run in which single impacts are drawn."""


def history(ds: xr.Dataset, name: str, ax: Any = None) -> Any:
    """One output over time.

    **Arguments:**

    - `ds`: from `Trajectory.to_xarray`, or one case of `sweep(..., record="history")`.
    - `name`: a variable over time, in SI units; drawn in its display unit, as in mm or mrad.
    - `ax`: the Axes to draw into; default those of a new figure, with the case as its title.

    **Returns:** the Axes, with time in forcing periods.
    """
    check_dataset(ds, SOURCE, "period", name)
    ax = _axes_of(ds) if ax is None else ax
    ax.plot(ds["period"].values, shown(ds, name), lw=0.7, color=COLORS["blue"])
    ax.set(xlabel=TIME_LABEL, ylabel=axis_label(name, ds))
    ax.margins(x=0.01)
    return ax


def contact_forces(ds: xr.Dataset, ax: Any = None, *, most: int = 4, last: float | None = LAST) -> Any:
    """The contact forces [kN] of the points with the highest peaks over time: front ones solid, rear ones dashed.

    The legend gives the highest force of each in the whole run, over every integration step where `ds` has that, and
    its instant; a dot marks it where it lies in what is drawn. The saved states may miss it.

    **Arguments:** `ds`, `ax`: as for `history`; `most`: number of points; `last`: forcing periods at the end of the
    run that are drawn, None for all.

    **Returns:** the Axes. Points are named by their letter and 1 at the front or 2 at the rear.
    """
    check_dataset(ds, SOURCE, "period", "contact_force")
    ax = _axes_of(ds) if ax is None else ax
    legend_above(ax, _draw_contact_forces(ds, ax, most, last))
    return ax


def _draw_contact_forces(ds: xr.Dataset, ax: Any, most: int = 4, last: float | None = LAST) -> list[Any]:
    """Draws them, and gives the entries of a legend."""
    peaks, when = _peaks(ds)
    period = ds["period"].values
    drawn = period >= (-np.inf if last is None else period[-1] - last - 1e-9)
    for end, point in _most_loaded(peaks, most):
        here, style = ds.sel(end=end, point=point), _line_of(ds, end, point)
        peak = float(quantity("peak_force").shown(peaks.sel(end=end, point=point)))
        at = float(when.sel(end=end, point=point))
        label = f"{style.pop('label')}, peak {peak:.3g} kN" + (f" at {at:.4g}" if np.isfinite(at) else "")
        ax.plot(period[drawn], shown(here, "contact_force")[drawn], lw=0.9, label=label, **style)
        if np.any(drawn) and period[drawn][0] <= at <= period[-1]:
            ax.plot(at, peak, "o", ms=3, mew=0, color=style["color"])
    ax.set(xlabel=TIME_LABEL, ylabel=axis_label("contact_force"))
    ax.margins(x=0.01)
    return ax.get_legend_handles_labels()[0]


def highest_forces(ds: xr.Dataset, ax: Any = None, *, most: int = 4) -> Any:
    """The highest contact force [kN] of each forcing period, of the points with the highest peaks.

    It is found among the saved states; a dot marks the highest force of each point over every integration step. Lines
    as in `contact_forces`.

    **Arguments:** `ds`, `ax`, `most`: as for `contact_forces`.

    **Returns:** the Axes.
    """
    check_dataset(ds, SOURCE, "period", "contact_force")
    ax = _axes_of(ds) if ax is None else ax
    legend_above(ax, _draw_highest_forces(ds, ax, most))
    return ax


def _draw_highest_forces(ds: xr.Dataset, ax: Any, most: int = 4) -> list[Any]:
    """Draws them, and gives the entries of a legend."""
    peaks, when = _peaks(ds)
    number = np.maximum(np.ceil(ds["period"].values - 1e-9), 1)  # a period has its end, not its beginning
    starts = np.flatnonzero(np.diff(number, prepend=-np.inf))
    for end, point in _most_loaded(peaks, most):
        style, here = _line_of(ds, end, point), {"end": end, "point": point}
        highest = np.maximum.reduceat(shown(ds.sel(here), "contact_force"), starts)
        ax.plot(number[starts] - 0.5, highest, lw=0.9, **style)
        peak = quantity("peak_force").shown(peaks.sel(here))
        ax.plot(float(when.sel(here)), float(peak), "o", ms=3, mew=0, color=style["color"])
    period, room = ds["period"].values, 0.01 * np.ptp(ds["period"].values)
    ax.margins(y=0.1)
    ax.set(xlabel=TIME_LABEL, ylabel="peak force $F$ [kN]", ylim=(0, None))
    ax.set_xlim(period[0] - room, period[-1] + room)  # as that of histories
    return ax.get_legend_handles_labels()[0]


def overview(ds: xr.Dataset, axes: Any = None) -> Any:
    """A trajectory on one page: displacements [mm], angles [mrad], velocities, contact forces and drive force.

    The title states the case; a status other than 0 is named in it. The last two panels show the last periods only.

    **Arguments:** `ds`: from `Trajectory.to_xarray`; `axes`: 7 x 2 Axes; default those of a new figure.

    **Returns:** the Axes, an array.
    """
    check_dataset(ds, SOURCE, "period", "contact_force")
    with styled():
        if axes is None:
            figure, axes = plt.subplots(7, 2, figsize=(7.2, 9.4), layout="constrained")
            name_case(figure, ds, full=True)
        names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z")
        for name, ax in zip(names, axes.flat, strict=False):
            history(ds, name, ax).set_xlabel("")
            ax.tick_params(labelbottom=False)
        forces = [
            draw(ds, ax) for draw, ax in zip((_draw_highest_forces, _draw_contact_forces), axes[5], strict=True)
        ]
        for ax in axes[5]:
            ax.set_xlabel("")
        history(ds, "drive_force", axes[6, 0])
        period = ds["period"].values
        history(ds.isel(time=period >= period[-1] - LAST - 1e-9), "drive_force", axes[6, 1])
        legends_above(list(zip(axes[5], forces, strict=True)))
        status = Status(int(ds.attrs.get("status", Status.FINITE)))
        if status != Status.FINITE:
            _warn_of(axes[0, 0].figure, status)
    return axes


def _warn_of(figure: Any, status: Status) -> None:
    """Adds a status to a figure's title, in red."""
    lines = [figure.get_suptitle(), textwrap.fill(f"status: {status}", 90)]
    figure.suptitle("\n".join(line for line in lines if line), color=COLORS["red"], fontsize=7)


def _axes_of(ds: xr.Dataset, *size: float) -> Any:
    """The Axes of a new figure, with the case as its title."""
    ax = new_axes(*size)
    name_case(ax.figure, ds)
    return ax


def _peaks(ds: xr.Dataset) -> tuple[xr.DataArray, xr.DataArray]:
    """The highest force [N] of each point and its instant [forcing periods], of the saved states if need be."""
    if "peak_force" in ds:
        return ds["peak_force"], ds["peak_period"] if "peak_period" in ds else np.nan * ds["peak_force"]
    force = ds["contact_force"].fillna(-np.inf)
    return force.max("time"), ds["period"].isel(time=force.argmax("time"))


def _most_loaded(peaks: xr.DataArray, most: int) -> list[tuple[str, str]]:
    """End and name of the points with the highest peaks, the highest first."""
    stacked = peaks.stack(at=("end", "point"))
    return list(stacked.sortby(stacked, ascending=False)["at"].values[:most])


def _line_of(ds: xr.Dataset, end: str, point: str) -> dict[str, Any]:
    """Colour, dashes and name of a point's line, the same in every picture."""
    color = POINT_COLORS[list(ds["point"].values).index(point) % len(POINT_COLORS)]
    front = end == "front"
    return {"color": color, "ls": "-" if front else (0, (3, 1.5)), "label": f"{point}{1 if front else 2}"}


def phase_portrait(ds: xr.Dataset, coordinate: str, velocity: str, ax: Any = None) -> Any:
    """The orbit in the plane of a coordinate and its velocity, in red its section by upward zero crossings.

    **Arguments:** `ds`, `ax`: as for `history`; `coordinate`, `velocity`: variables, drawn in their display units.

    **Returns:** the Axes.
    """
    check_dataset(ds, SOURCE, coordinate, velocity)
    ax = _axes_of(ds, 3.5, 3.0) if ax is None else ax
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
