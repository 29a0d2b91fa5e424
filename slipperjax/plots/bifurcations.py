"""Figures. Every function takes `ax=None` and returns the Axes."""

import re
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
STYLE = {"font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7, "axes.grid": True}
STYLE |= {"grid.alpha": 0.25, "grid.linewidth": 0.4, "axes.linewidth": 0.6}


def bifurcation(ds: xr.Dataset, section: str, ax: Any = None, **style: Any) -> Any:
    """One bifurcation diagram: a section's velocities over the swept parameter.

    **Arguments:** `ds`: from `sweep(..., record="sections")` over one parameter; `section`: v_y, v_z, w_x, w_y, w_z;
    `style`: of the dots, for `Axes.plot`.
    """
    ax = plt.gca() if ax is None else ax
    (over,) = (d for d in ds[section].dims if d != "crossing")
    label, scale = _AXES.get(str(over), (f"{over} [{typeset(ds[over].attrs['units'])}]", 1.0))
    values = ds[section].transpose(over, "crossing").values
    x = np.broadcast_to(ds[over].values[:, None] * scale, values.shape)
    style = {"ms": 1.6, "mew": 0, "color": "#12355b", "rasterized": True} | style
    ax.plot(x.ravel(), values.ravel(), ".", **style)
    ax.set_ylabel(_SYMBOLS[section])
    ax.set_xlabel(label)
    ax.set_xlim(x.min(), x.max()) if x.min() < x.max() else None
    return ax


def bifurcations(
    ds: xr.Dataset, axes: Sequence[Any] | None = None, followed: xr.Dataset | None = None
) -> Sequence[Any]:
    """All five bifurcation diagrams above each other, at column width, as in Figs. 5, 8 and 10 of the paper.

    `followed`, from `follow`, is drawn beneath: the motions that are met when the parameter is raised and lowered.
    """
    with plt.rc_context(STYLE):
        if axes is None:
            _, axes = plt.subplots(5, 1, figsize=(3.5, 7.6), sharex=True, layout="constrained")
        assert axes is not None
        for tag, section, ax in zip("abcde", SECTIONS, axes, strict=True):
            for way, color in (("up", "#e07a1f"), ("down", "#2a9d6f")):
                if followed is not None and way in followed["direction"]:
                    bifurcation(
                        followed.sel(direction=way), section, ax, ms=2.6, color=color, label=f"followed {way}"
                    )
            bifurcation(ds, section, ax, label="from one start")
            ax.text(0.012, 0.94, f"({tag})", transform=ax.transAxes, va="top", fontsize=8)
            if ax is not axes[-1]:
                ax.set_xlabel("")
        if followed is not None:
            axes[0].legend(fontsize=6, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), markerscale=3)
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
    with plt.rc_context(STYLE):
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


def phase_portrait(ds: xr.Dataset, coordinate: str, velocity: str, ax: Any = None) -> Any:
    """The orbit in the plane of a coordinate and its velocity, with its section by upward zero crossings in red."""
    ax = plt.gca() if ax is None else ax
    scale = 1e3
    q, v = ds[coordinate].values * scale, ds[velocity].values
    ax.plot(q, v, lw=0.35, color="#12355b")
    at = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
    share = q[at] / (q[at] - q[at + 1])
    ax.plot(0 * at, v[at] + share * (v[at + 1] - v[at]), ".", color="#c1121f", ms=4, mew=0)
    ax.set_xlabel(_SYMBOLS[coordinate])
    ax.set_ylabel(_SYMBOLS[velocity])
    return ax


def typeset(unit: str) -> str:
    """A unit of a dataset, as in m/s^2, with its exponents raised."""
    return re.sub(r"\^(-?[\d.]+)", r"$^{\1}$", unit)


def spectrum(frequency: Any, density: Any, ax: Any = None, *, unit: str = "", highest: float | None = None) -> Any:
    """A power spectral density over frequency [Hz], logarithmic; `unit`: of the density, as datasets write it."""
    ax = plt.gca() if ax is None else ax
    shown = np.asarray(frequency) > 0
    if highest is not None:
        shown &= np.asarray(frequency) <= highest
    ax.semilogy(np.asarray(frequency)[shown], np.asarray(density)[shown], lw=0.6, color="#12355b")
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"PSD [{typeset(unit)}]" if unit else "PSD")
    return ax


def regimes(ds: xr.Dataset) -> np.ndarray:
    """0 periodic, 1 regular but not periodic, 2 chaotic, 3 unresolved: from `lyapunov_sweep`, for colours."""
    exponent, error = ds["exponent"].isel(count=0).values, ds["stderr"].isel(count=0).values
    found = np.where(exponent > np.maximum(3 * error, 1e-3), 2, np.where(ds["kind"].values == "period", 0, 1))
    good = ds["resolved"].values if "resolved" in ds else np.isfinite(exponent)
    return np.where(good, found, 3)


REGIMES = (("periodic", "#12355b"), ("regular", "#2a9d6f"), ("chaotic", "#c1121f"), ("unresolved", "#a0a0a0"))


def exponents(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent over one parameter, with three standard errors, coloured by regime.

    **Arguments:** `ds`: from `lyapunov_sweep` over one parameter.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(3.5, 2.4), layout="constrained")
    (over,) = ds["kind"].dims
    label, scale = _AXES.get(str(over), (f"{over} [{typeset(ds[over].attrs.get('units', '1'))}]", 1.0))
    x, y, kinds = ds[over].values * scale, ds["exponent"].isel(count=0).values, regimes(ds)
    ax.axhline(0, lw=0.5, color="black")
    ax.plot(x, y, lw=0.3, color="#a0a0a0", zorder=1)
    for k, (name, color) in enumerate(REGIMES):
        at = kinds == k
        error = 3 * ds["stderr"].isel(count=0).values[at]
        ax.errorbar(x[at], y[at], error, fmt=".", ms=2, mew=0, lw=0.6, color=color, label=name)
    ax.set_xlabel(label)
    ax.set_ylabel("largest exponent [1/period]")
    ax.legend(fontsize=6, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return ax


def regime_map(ds: xr.Dataset, ax: Any = None) -> Any:
    """The largest Lyapunov exponent over two parameters: red chaotic, blue regular; crosses where unresolved."""
    if ax is None:
        _, ax = plt.subplots(figsize=(3.5, 3.0), layout="constrained")
    over_y, over_x = (str(d) for d in ds["kind"].dims)
    (x_label, x_scale), (y_label, y_scale) = (_AXES.get(d, (d, 1.0)) for d in (over_x, over_y))
    values = ds["exponent"].isel(count=0).transpose(over_y, over_x).values
    most = float(np.nanmax(np.abs(values)))
    x, y = ds[over_x].values * x_scale, ds[over_y].values * y_scale
    mesh = ax.pcolormesh(x, y, values, cmap="RdBu_r", vmin=-most, vmax=most)
    ax.figure.colorbar(mesh, ax=ax, label="largest exponent [1/period]")
    lost = regimes(ds) == 3
    if lost.any():
        ax.plot(*(a[lost] for a in np.meshgrid(x, y)), "x", ms=2, mew=0.4, color="black")
    ax.set(xlabel=x_label, ylabel=y_label)
    return ax
