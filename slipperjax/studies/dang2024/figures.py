"""The paper's figures in the paper's layout, from the runs of `reproduce`."""

import functools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.lines import Line2D

from ...analysis.spectra import power_spectral_density
from ...flow.status import Status
from ...model.quantities import SECTIONS
from ...plots.branches import branches
from ...plots.maps import basin_map, bifurcations, exponents
from ...plots.style import COLORS, png, styled
from ...plots.trajectories import phase_portrait, spectrum
from ...tools.files import write_each
from .runs import Finished
from .verdicts import DUAL_LINES, F1, F2

_COLORS = {"A": "#12355b", "C": "#c1121f", "J": "#2a9d6f"}


def write_figures(done: Finished, out: Path) -> list[Path]:
    """Draws a run's figures, and writes them and the run's data into the folder `out`; gives the paths."""
    contents: dict[Path, Any] = {}
    for name, ds in done.data.items():
        contents[out / f"{name}.nc"] = functools.partial(ds.to_netcdf, engine="h5netcdf")
    for figure in done.figures:
        path = out / (f"fig{figure}.png" if figure.isdigit() else f"{figure}.png")
        contents[path] = functools.partial(_picture, figure, done.data)
    return list(write_each(contents))


def _picture(figure: str, data: dict[str, xr.Dataset]) -> bytes:
    with styled():
        drawn = _DRAW[figure](data)
    return png(drawn, 200)


def _cases(
    data: dict[str, xr.Dataset], numbers: Iterable[int], panels: Iterable[Any], title: Callable[[xr.Dataset], str]
) -> Iterator[tuple[xr.Dataset, Any]]:
    """Titles the panels of single cases, and yields each case with its panels; of a flagged one they say so."""
    for number, row in zip(numbers, panels, strict=True):
        case = data["histories"].isel(case=number)
        row[0].set_title(title(case), fontsize=8, loc="left")
        if not _flagged(case, row):
            yield case, row


def _figure_4(data: dict[str, xr.Dataset]) -> Any:
    figure, axes = plt.subplots(3, 3, figsize=(7.2, 6.0), layout="constrained")
    for case, row in _cases(data, range(3), axes, lambda case: f"V = {float(case['speed']):.0f} m/s"):
        forcing = float(case["speed"]) / 8
        time = case["period"].values - case["period"].values[0]
        row[0].plot(time, case["alpha_x"].values / 1e3, lw=0.5, color=_COLORS["A"])
        row[0].set(xlim=(0, 12), xlabel="time [forcing periods]", ylabel=r"$\alpha_X$ [krad/s$^2$]")
        density = power_spectral_density(case["alpha_x"].values, 50 * forcing)
        spectrum(density.frequency / forcing, density.density, row[1], unit="(rad/s^2)^2/Hz", highest=4)
        top = float(np.max(density.density))
        row[1].set(xlabel="frequency / $f$", ylim=(top * 1e-10, top * 10))  # what is below this is rounding
        phase_portrait(case, "roll", "w_x", row[2])
    return figure


def _flagged(case: xr.Dataset, axes: Any) -> bool:
    """Whether a case is flagged, which is then written into its panels."""
    status = Status(int(case["status"]))
    for ax in axes:
        if status != Status.FINITE:
            ax.text(0.5, 0.5, f"flagged: {status.name}", transform=ax.transAxes, ha="center", va="center")
    return status != Status.FINITE


def _figure_7(data: dict[str, xr.Dataset]) -> Any:
    figure, axes = plt.subplots(2, 3, figsize=(7.2, 4.2), layout="constrained")
    for case, row in _cases(data, (3, 4), axes, lambda case: f"C = {float(case['clearance']) * 1e3:.0f} mm"):
        row[0].plot(case["y"].values * 1e3, case["z"].values * 1e3, lw=0.35, color=_COLORS["A"])
        row[0].set(xlabel="$y$ [mm]", ylabel="$z$ [mm]")
        phase_portrait(case, "y", "v_y", row[1])
        phase_portrait(case, "z", "v_z", row[2])
    return figure


def _figure_12(data: dict[str, xr.Dataset]) -> Any:
    figure, axes = plt.subplots(2, 1, figsize=(3.5, 4.2), sharex=True, layout="constrained")
    title = lambda case: f"L = {float(case['length']):.1f} m; dashed: peaks of the whole run"
    for case, (ax,) in _cases(data, (5, 6), axes[:, None], title):
        time = case["period"].values - case["period"].values[0]
        # of all periods and inside every step, as in the claims; the lines drawn are the saved states of the first 12
        peaks = case["peak_force"].sel(end="rear", point=list(_COLORS))
        for point, color in _COLORS.items():
            force = case["contact_force"].sel(end="rear", point=point).values
            peak = float(peaks.sel(point=point))
            ax.plot(time, force / 1e3, lw=0.6, color=color, label=f"{point}2: peak {peak:.0f} N")
            ax.axhline(peak / 1e3, lw=0.6, ls=(0, (4, 3)), color=color)
        ax.set(xlim=(0, 12), ylabel="contact force [kN]", ylim=(None, 1.3 * float(peaks.max()) / 1e3))
        ax.legend(fontsize=6, ncols=3, loc="upper center", handlelength=1.0, columnspacing=1.0)
    axes[-1].set_xlabel("time [forcing periods]")
    return figure


def _figure_13(data: dict[str, xr.Dataset]) -> Any:
    ds = data["dual"]
    figure, axes = plt.subplots(3, 1, figsize=(3.5, 5.4), sharex=True, layout="constrained")
    if _flagged(ds.isel(speed=0), axes):
        return figure
    for ax, name, label in zip(axes, ("a_z", "alpha_x", "alpha_y"), ("A_Z", r"\alpha_X", r"\alpha_Y"), strict=True):
        spectrum(ds["frequency"], ds[f"{name}_density"], ax, unit=ds[f"{name}_density"].units, highest=520)
        top = float(np.max(ds[f"{name}_density"]))
        for text, (m, n) in DUAL_LINES.items():
            ax.annotate(text, (F1 * m + F2 * n, top * 3), rotation=90, fontsize=4.5, ha="center", va="bottom")
        ax.set(ylim=(top * 1e-8, top * 300), title=f"${label}$", xlabel="")
    axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _basins(data: dict[str, xr.Dataset]) -> Any:
    return basin_map(data["basins"]).figure


def _exponents(name: str, data: dict[str, xr.Dataset]) -> Any:
    figure, ax = plt.subplots(figsize=(3.5, 2.4), layout="constrained")
    exponents(data[name], ax)
    return figure


def _diagram(name: str, data: dict[str, xr.Dataset]) -> Any:
    """Bifurcation diagrams over a parameter, with the branches of orbits drawn over their dots."""
    axes = bifurcations(data[name], followed=data.get(f"{name}_followed"))
    followed = [ds for key, ds in data.items() if key.startswith(f"{name}_") and "orbit_period" in ds.attrs]
    if followed:
        _draw_branches(axes, followed)
    return axes[0].figure


def _draw_branches(axes: Any, followed: list[xr.Dataset]) -> None:
    """Branches over the dots of bifurcation diagrams, with one legend for all."""
    own = axes[0].get_legend()
    texts = own.get_texts() if own else []
    handles = dict(zip([t.get_text() for t in texts], own.legend_handles if own else [], strict=True))
    for ax in axes:
        for line in ax.lines:
            if line.get_label() == FROM_START:  # the branches have the colour of these dots
                line.set_color(COLORS["grey"])
    handles[FROM_START] = Line2D([], [], ls="", marker=".", ms=5, mew=0, color=COLORS["grey"])
    for section, ax in zip(SECTIONS, axes, strict=True):
        label = ax.get_xlabel()
        branches(followed, section, ax=ax)
        ax.set_xlabel(label)
        legend = ax.get_legend()
        # the events of a section are those that its crossings have
        handles |= dict(zip([t.get_text() for t in legend.get_texts()], legend.legend_handles, strict=True))
        legend.remove()
    style = dict(fontsize=6.5, ncols=3, frameon=False, handletextpad=0.4, columnspacing=1.2, handlelength=1.6)
    axes[0].figure.legend(list(handles.values()), list(handles), loc="outside lower center", **style)


FROM_START = "from one start"
"""The label of the dots that are no followed motions."""

_DRAW = {
    "4": _figure_4,
    "5": functools.partial(_diagram, "speed"),
    "6": functools.partial(_exponents, "speed_exponents"),
    "7": _figure_7,
    "8": functools.partial(_diagram, "clearance"),
    "9": functools.partial(_exponents, "clearance_exponents"),
    "11": functools.partial(_exponents, "length_exponents"),
    "10": functools.partial(_diagram, "length"),
    "12": _figure_12,
    "13": _figure_13,
    "basins": _basins,
}
