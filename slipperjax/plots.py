"""Figures. Every function takes `ax=None` and returns the Axes."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from .analysis.poincare import SECTIONS

_SYMBOLS = {
    "v_y": "$V_Y$ [m/s]",
    "v_z": "$V_Z$ [m/s]",
    "w_x": r"$\omega_X$ [rad/s]",
    "w_y": r"$\omega_Y$ [rad/s]",
    "w_z": r"$\omega_Z$ [rad/s]",
    "y": "$y$ [mm]",
    "z": "$z$ [mm]",
    "roll": "roll [mrad]",
    "pitch": "pitch [mrad]",
    "yaw": "yaw [mrad]",
}
_AXES = {
    "speed": ("speed $V$ [m/s]", 1.0),
    "clearance": ("clearance $C$ [mm]", 1e3),
    "length": ("length $L$ [m]", 1.0),
}
_STYLE = {"font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7, "axes.grid": True}
_STYLE |= {"grid.alpha": 0.25, "grid.linewidth": 0.4, "axes.linewidth": 0.6}


def bifurcation(ds: xr.Dataset, section: str, ax: Any = None) -> Any:
    """One bifurcation diagram: a section's velocities over the swept parameter.

    **Arguments:** `ds`: from `sweep(..., record="sections")` over one parameter; `section`: v_y, v_z, w_x, w_y, w_z.
    """
    ax = plt.gca() if ax is None else ax
    (over,) = (d for d in ds[section].dims if d != "crossing")
    label, scale = _AXES.get(str(over), (f"{over} [{ds[over].attrs['units']}]", 1.0))
    values = ds[section].transpose(over, "crossing").values
    x = np.broadcast_to(ds[over].values[:, None] * scale, values.shape)
    ax.plot(x.ravel(), values.ravel(), ".", ms=1.6, mew=0, color="#12355b", rasterized=True)
    ax.set_ylabel(_SYMBOLS[section])
    ax.set_xlabel(label)
    ax.set_xlim(x.min(), x.max()) if x.min() < x.max() else None
    return ax


def bifurcations(ds: xr.Dataset, axes: Sequence[Any] | None = None) -> Sequence[Any]:
    """All five bifurcation diagrams above each other, at column width, as in Figs. 5, 8 and 10 of the paper."""
    with plt.rc_context(_STYLE):
        if axes is None:
            _, axes = plt.subplots(5, 1, figsize=(3.5, 7.6), sharex=True, layout="constrained")
        assert axes is not None
        for tag, section, ax in zip("abcde", SECTIONS, axes, strict=True):
            bifurcation(ds, section, ax)
            ax.text(0.012, 0.94, f"({tag})", transform=ax.transAxes, va="top", fontsize=8)
            if ax is not axes[-1]:
                ax.set_xlabel("")
    return axes


def history(ds: xr.Dataset, name: str, ax: Any = None) -> Any:
    """One output over time in forcing periods; lengths in mm, angles in mrad."""
    ax = plt.gca() if ax is None else ax
    scale = 1e3 if name in ("y", "z", "roll", "pitch", "yaw") else 1.0
    ax.plot(ds["period"].values, ds[name].values * scale, lw=0.7, color="#12355b")
    ax.set_xlabel("time [forcing periods]")
    ax.set_ylabel(_SYMBOLS[name])
    return ax


def contact_forces(ds: xr.Dataset, ax: Any = None, *, most: int = 4) -> Any:
    """Contact force over time of the points with the highest peaks."""
    ax = plt.gca() if ax is None else ax
    peaks = ds["contact_force"].max("time").stack(at=("end", "point"))
    for end, point in peaks.sortby(peaks, ascending=False)["at"].values[:most]:
        force = ds["contact_force"].sel(end=end, point=point)
        ax.plot(ds["period"].values, force.values / 1e3, lw=0.7, label=f"{point}{1 if end == 'front' else 2}")
    ax.set_xlabel("time [forcing periods]")
    ax.set_ylabel("contact force [kN]")
    ax.legend(fontsize=6, ncols=4, loc="upper right")
    return ax


def overview(ds: xr.Dataset, axes: Any = None) -> Any:
    """A trajectory on one page: displacements, angles, velocities and contact forces."""
    with plt.rc_context(_STYLE):
        if axes is None:
            _, axes = plt.subplots(6, 2, figsize=(7.2, 8.2), sharex=True, layout="constrained")
        names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z")
        for name, ax in zip(names, axes.flat, strict=False):
            history(ds, name, ax).set_xlabel("")
        contact_forces(ds, axes[5, 0])
        ax = axes[5, 1]
        ax.plot(ds["period"].values, ds["drive_force"].values, lw=0.7, color="#12355b")
        ax.set_ylabel("drive force [N]")
        ax.set_xlabel("time [forcing periods]")
    return axes
