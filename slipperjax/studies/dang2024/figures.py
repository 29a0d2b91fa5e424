"""The paper's figures in the paper's layout, from the runs of `reproduce`."""

import functools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ...analysis.spectra import power_spectral_density
from ...flow.status import Status
from ...model.parameters import PARAMETERS
from ...model.quantities import SECTIONS
from ...plots.branches import branches
from ...plots.maps import bifurcations, exponents
from ...plots.style import png, styled
from ...plots.trajectories import phase_portrait, spectrum
from ...sweeps.loading import load
from ...tools.files import write_each
from .claims import DUAL_LINES
from .runs import Data, Finished

_COLORS = {"A": "#12355b", "C": "#c1121f", "J": "#2a9d6f"}


def write_figures(done: Finished, out: Path) -> None:
    """Draw the figures of a run; write them, its datasets and the events of its branches into a folder."""
    contents: dict[Path, Callable] = {}
    for name, ds in done.data.items():
        contents[out / f"{name}.nc"] = functools.partial(ds.to_netcdf, engine="h5netcdf")
        # a branch also has a table of its events, as text
        if "orbit_period" in ds.attrs:
            contents[out / f"{name}.txt"] = "\n".join(load(ds).summary()).encode
    for figure in done.figures:
        contents[out / f"fig{figure}.png"] = functools.partial(_picture, figure, done.data)
    write_each(contents)


def _picture(figure: str, data: Data) -> bytes:
    with styled():
        drawn = _DRAW[figure](data)
    return png(drawn, 200)


def _cases(
    data: Data,
    numbers: Iterable[int],
    panels: np.ndarray,
) -> Iterator[tuple[xr.Dataset, np.ndarray]]:
    """Yield single cases by number, each with its row of panels, which get a title; skip flagged cases."""
    for number, row in zip(numbers, panels, strict=True):
        case = data["histories"].isel(case=number)
        speed, clearance, length = (float(case[name]) for name in ("speed", "clearance", "length"))
        row[0].set_title(
            f"{speed:.0f} m/s, {clearance * 1e3:.0f} mm, {length:.1f} m",
            fontsize=8,
            loc="left",
        )
        if not _flagged(case, row):
            yield case, row


def _figure_4(data: Data) -> Figure:
    figure, axes = plt.subplots(3, 3, figsize=(7.2, 6.0), layout="constrained")
    for case, row in _cases(data, range(3), axes):
        # the wavelength of the paper's rail is 8 m
        forcing = float(case["speed"]) / 8
        time = case["period"].values - case["period"].values[0]
        row[0].plot(time, case["alpha_x"].values / 1e3, lw=0.5, color=_COLORS["A"])
        row[0].set(xlim=(0, 12), xlabel="time [forcing periods]", ylabel=r"$\alpha_X$ [krad/s$^2$]")
        # histories have 50 samples per forcing period
        density = power_spectral_density(case["alpha_x"].values, 50 * forcing)
        spectrum(density.frequency / forcing, density.density, row[1], unit="(rad/s^2)^2/Hz", highest=4)
        top = float(np.max(density.density))
        row[1].set(
            xlabel="frequency / $f$",
            ylim=(top * 1e-10, top * 10),
        )  # what is below this is rounding
        phase_portrait(case, "roll", "w_x", row[2])
    return figure


def _flagged(case: xr.Dataset, axes: np.ndarray) -> bool:
    """Return whether a case is flagged; if so, write this into its panels."""
    status = Status(int(case["status"]))
    for ax in axes:
        if status != Status.FINITE:
            ax.text(0.5, 0.5, f"flagged: {status.name}", transform=ax.transAxes, ha="center", va="center")
    return status != Status.FINITE


def _figure_7(data: Data) -> Figure:
    figure, axes = plt.subplots(2, 3, figsize=(7.2, 4.2), layout="constrained")
    for case, row in _cases(data, (3, 4), axes):
        row[0].plot(case["y"].values * 1e3, case["z"].values * 1e3, lw=0.35, color=_COLORS["A"])
        row[0].set(xlabel="$y$ [mm]", ylabel="$z$ [mm]")
        phase_portrait(case, "y", "v_y", row[1])
        phase_portrait(case, "z", "v_z", row[2])
    return figure


def _figure_12(data: Data) -> Figure:
    figure, axes = plt.subplots(2, 1, figsize=(3.5, 4.2), sharex=True, layout="constrained")
    for case, (ax,) in _cases(data, (5, 6), axes[:, None]):
        time = case["period"].values - case["period"].values[0]
        # Solid: forces at saved states in the first 12 periods. Dashed: peaks over all periods and
        # inside every step, as in the claims.
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


def _figure_13(data: Data) -> Figure:
    case = data["dual"].isel(speed=0)
    figure, axes = plt.subplots(3, 1, figsize=(3.5, 5.4), sharex=True, layout="constrained")
    # the spectrum of a flagged case means nothing
    if _flagged(case, axes):
        return figure
    labels = {"a_z": "A_Z", "alpha_x": r"\alpha_X", "alpha_y": r"\alpha_Y"}
    for ax, (name, label) in zip(axes, labels.items(), strict=True):
        density = power_spectral_density(case[name].values, 50 * DUAL_LINES["f1"])
        spectrum(density.frequency, density.density, ax, unit=f"({case[name].units})^2/Hz", highest=520)
        top = float(np.max(density.density))
        # the lines that the paper names
        for text, frequency in DUAL_LINES.items():
            ax.annotate(text, (frequency, top * 3), rotation=90, fontsize=4.5, ha="center", va="bottom")
        ax.set(ylim=(top * 1e-8, top * 300), title=f"${label}$", xlabel="")
    axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _diagram(name: str, data: Data) -> Figure:
    """Draw a diagram over a parameter, with branches of orbits over its dots."""
    followed = [ds for key, ds in data.items() if key.startswith(f"{name}_branch")]
    # an interrupted run has no branches yet
    if not followed:
        return bifurcations(data[name])[0].figure
    figure, axes = plt.subplots(3, 2, figsize=(7.2, 6.6), sharex=True, layout="constrained")
    # five sections and six panels: the second panel is for the legend
    first, spare, *others = axes.flat
    panels = [first, *others]
    handles = {}
    for section, ax in zip(SECTIONS, panels, strict=True):
        branches(followed, section, brute=data[name], ax=ax)
        # one legend for all panels, because an event appears only in panels where its orbit crosses the section
        found, labels = ax.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
        ax.get_legend().remove()
    # only the lowest panels label the common axis
    plt.setp(panels[:3], xlabel="")
    # limits of the whole diagram, because a branch covers only a part
    first.set_xlim(PARAMETERS[name].shown(data[name][name].values[[0, -1]]))
    spare.legend(list(handles.values()), list(handles), loc="center", ncols=2, frameon=False)
    spare.axis("off")
    return figure


_DRAW = {
    "4": _figure_4,
    "5": functools.partial(_diagram, "speed"),
    "6": lambda data: exponents(data["speed_exponents"]).figure,
    "7": _figure_7,
    "8": functools.partial(_diagram, "clearance"),
    "9": lambda data: exponents(data["clearance_exponents"]).figure,
    "11": lambda data: exponents(data["length_exponents"]).figure,
    "10": functools.partial(_diagram, "length"),
    "12": _figure_12,
    "13": _figure_13,
}
