"""Pictures of one trajectory: histories, contact forces, phase portraits and spectra."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..flow.status import Status
from ..tools.checks import number, numbers, positive, require, whole
from ..tools.types import Numbers
from .style import (
    by_contact,
    check_dataset,
    drawing,
    label,
    label_axes,
    label_lowest,
    line_color,
    lost,
    name_status,
    page,
    quantity_of,
    shown,
    typeset,
    with_unit,
)

Run = Any
"""One case over time: a trajectory, or a dataset."""
TRAJECTORY_SOURCE = "one case over time, such as of sj.simulate"
"""Kind of the datasets drawn here, for errors."""


class Along(NamedTuple):
    """Horizontal axis of pictures of trajectories."""

    unit: float
    """A forcing period in the unit of the axis [unit/period]."""
    label: str
    words: str
    """Text for an instant, with a place for its number."""
    brief: str
    """The same text in a legend."""

    @classmethod
    def of(cls, ds: xr.Dataset) -> "Along":
        """Return time in forcing periods; on rails without waves, whose periods are arbitrary, distance [m]."""
        wave = ds.attrs.get("wavelength [m]")
        if wave is None:
            return cls(1.0, "time [forcing periods]", "forcing period {:.2f}", "{:.4g}")
        # stations have many digits before the point
        return cls(np.ravel(wave)[0], "distance [m]", "{:.2f} m", "{:.2f} m")


def history(ds: Run, name: str, ax: Axes | None = None) -> Axes:
    """Draw one output over time.

    **Arguments:**

    - `ds`: a `Trajectory`, its dataset, or one case of `sweep(..., record="history")`.
    - `name`: a variable over time, in SI units; drawn in its display unit, as in mm or mrad.
    - `ax`: the Axes to draw into; default the Axes of a new figure, with the case as its title.

    **Returns:** the Axes, with time in forcing periods, or with distance on rails without waves.
    """
    ds = check_dataset(ds, TRAJECTORY_SOURCE, "period", name)
    along = Along.of(ds)
    with drawing(ax, ds, full=False) as ax:
        values = shown(ds, name)
        ax.plot(along.unit * ds["period"].values, values, lw=0.7, color=line_color(0))
        ax.set(xlabel=along.label, ylabel=label(values))
        ax.margins(x=0.01)
    return ax


def contact_forces(
    ds: Run,
    ax: Axes | None = None,
    *,
    most: int = 4,
    last: float | None = 4.0,
) -> Axes:
    """Draw the contact forces of the points with the highest peaks: front points solid, rear points dashed.

    The legend has the peak force of each point and its time or place, unless the status says that numbers mean
    nothing; a dot marks the peak if it is in the drawn part. It is the peak over every integration step where `ds`
    has `peak_force`. A part of a run, as by `ds.isel(time=...)`, that excludes the run's peak has the peak of its
    saved states, which may be lower. Where `ds` has no time of a peak, the legend says "in the whole run".

    **Arguments:** `ds`, `ax`: as for `history`; `most`: number of points; `last`: number of drawn forcing periods at
    the end of the run, None for all.

    **Returns:** the Axes. Points are named by their letter and 1 at the front or 2 at the rear, for a sled after the
    name of their slipper, as left2_A1.
    """
    ds = check_dataset(ds, TRAJECTORY_SOURCE, "period", "contact_force")
    period = ds["period"].values
    along = Along.of(ds)
    # rounding must not cut off the first saved state
    begin = -np.inf if last is None else period[-1] - number(positive, "last", last) - 1e-9
    drawn = period >= begin
    unit = quantity_of("contact_force", ds).display_unit
    with drawing(ax, ds, full=False) as ax:
        for line in most_loaded(ds, most):
            text = line.name
            if not lost(ds):
                text += f", peak {with_unit(f'{line.peak:.3g}', unit)}"
                if np.isfinite(line.instant):
                    text += f" at {along.brief.format(along.unit * line.instant)}"
                elif line.peak > 0:
                    text += " in the whole run"
            ax.plot(along.unit * period[drawn], line.force[drawn], lw=0.9, label=text, **line.style)
            # the peak may be before the drawn part
            if np.any(drawn) and period[drawn][0] <= line.instant <= period[-1]:
                ax.plot(along.unit * line.instant, line.peak, "o", ms=3, mew=0, color=line.style["color"])
        ax.set(xlabel=along.label, ylabel=label(shown(ds, "contact_force")))
        ax.margins(x=0.01)
    return ax


class PointForce(NamedTuple):
    """Contact force of one point in its display unit: in the saved states, and its peak over every step where this is
    known."""

    name: str
    """Name as in `Scene.point_names`."""
    force: np.ndarray
    peak: float
    instant: float
    """Time of the peak [forcing periods], NaN without contact or where the dataset has no such time."""
    style: dict[str, object]
    """Colour and dashes in all pictures."""


def most_loaded(ds: xr.Dataset, most: int, slipper: str = "") -> list[PointForce]:
    """Return the forces of the `most` points with the highest peaks in a dataset, the highest first.

    **Arguments:** `slipper`: name of one slipper of a sled; empty for all slippers.
    """
    most = whole("most", most, 1)
    period = ds["period"].values
    force = ds["contact_force"].fillna(-np.inf).compute()
    # of the saved states
    peaks = force.max("time")
    instants = ds["period"].isel(time=force.argmax("time")).where(peaks > 0)
    # of every step, where the peak is in this part of the run
    if "peak_force" in ds:
        when = ds.get("peak_period", np.nan * ds["peak_force"])
        # a record begins one interval before its first saved state
        within = (when > 2 * period[0] - period[:2][-1]) & (when <= period[-1]) | np.isnan(when)
        peaks, instants = ds["peak_force"].where(within, peaks), when.where(within, instants)
    flat = by_contact(ds[["contact_force"]].assign(peak_force=peaks, instant=instants))
    if slipper:
        flat = flat.isel(contact=np.flatnonzero(flat["slipper"] == slipper))
    flat = flat.assign({name: shown(flat, name) for name in ("contact_force", "peak_force")})
    lines = []
    # the points with the highest peaks first
    for k in np.argsort(flat["peak_force"].values, kind="stable")[::-1][:most]:
        at = flat.isel(contact=k)
        style = {"color": at["color"].item(), "ls": (0, (3, 1.5)) if at["end"] == "rear" else "-"}
        peak, instant = float(at["peak_force"]), float(at["instant"])
        lines.append(PointForce(at["contact"].item(), at["contact_force"].values, peak, instant, style))
    return lines


def overview(ds: Run) -> np.ndarray:
    """Draw a trajectory on one page: displacements [mm], angles [mrad], velocities, contact forces and drive force.

    The title states the case, and a status other than 0. The last two panels show only the last periods.

    **Arguments:** `ds`: a `Trajectory`, or its dataset.

    **Returns:** the Axes, an array (7, 2).
    """
    ds = check_dataset(ds, TRAJECTORY_SOURCE, "period", "contact_force")
    with page(7, 2, 9.4, ds) as panels:
        # coordinates on the left, their velocities on the right
        names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z")
        for name, ax in zip(names, panels.ravel(), strict=False):
            history(ds, name, ax)
        last = 4.0  # number of forcing periods in which single impacts are visible
        contact_forces(ds, panels[5, 0], last=None)
        contact_forces(ds, panels[5, 1], last=last)
        period = ds["period"].values
        history(ds, "drive_force", panels[6, 0])
        history(ds.isel(time=period >= period[-1] - last - 1e-9), "drive_force", panels[6, 1])
        label_lowest(panels)
        name_status(panels[0, 0].figure, int(ds.attrs.get("status", Status.FINITE)))
    return panels


def phase_portrait(ds: Run, coordinate: str, velocity: str, ax: Axes | None = None) -> Axes:
    """Draw the orbit in the plane of a coordinate and its velocity, with its section by upward zero crossings in red.

    **Arguments:** `ds`, `ax`: as for `history`; `coordinate`, `velocity`: variables, drawn in their display units.

    **Returns:** the Axes.
    """
    ds = check_dataset(ds, TRAJECTORY_SOURCE, coordinate, velocity)
    x, y = (shown(ds, name) for name in (coordinate, velocity))
    q, v = x.values, y.values
    # upward zero crossings, interpolated between saved states
    at = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
    share = q[at] / (q[at] - q[at + 1])
    crossed = v[at] + share * (v[at + 1] - v[at])
    with drawing(ax, ds, 3.5, 3.0, full=False) as ax:
        ax.plot(q, v, lw=0.35, color=line_color(0))
        ax.plot(0 * at, crossed, ".", color=line_color(1), ms=4, mew=0)
        label_axes(ax, x, y)
    return ax


def spectrum(
    frequency: Numbers,
    density: Numbers,
    ax: Axes | None = None,
    *,
    unit: str = "",
    highest: float | None = None,
) -> Axes:
    """Draw a power spectral density over frequency, with a logarithmic scale.

    **Arguments:**

    - `frequency`: [Hz]; frequencies above zero are drawn; `density`: [`unit`], of the same shape.
    - `ax`: the Axes to draw into; default the Axes of a new figure.
    - `unit`: of the density, in the form of datasets, as in (rad/s^2)^2/Hz.
    - `highest`: the highest frequency drawn [Hz]; default all frequencies.

    **Returns:** the Axes.
    """
    frequency = numbers("frequency", frequency, unit="Hz").astype(float)
    density = numbers("density", density).astype(float)
    good = frequency.ndim == 1 and frequency.shape == density.shape
    need = "be of the shape of `frequency`, along one axis"
    require(good, "density", need, shown=f"of shape {density.shape}")
    end = np.inf if highest is None else number(positive, "highest", highest, "Hz")
    drawn = (frequency > 0) & (frequency <= end)
    with drawing(ax) as ax:
        ax.semilogy(frequency[drawn], density[drawn], lw=0.6, color=line_color(0))
        ax.set(xlabel="frequency [Hz]", ylabel=f"PSD [{typeset(unit)}]" if unit else "PSD")
    return ax
