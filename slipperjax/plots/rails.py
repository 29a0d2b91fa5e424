"""Pictures of rails: their displacement and spectrum, and a run's forces below them."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from ..analysis.spectra import power_spectral_density
from ..model.scene import Scene, check_scene
from ..tools.checks import number, positive
from .style import COLORS, axis_label, check_axes, check_dataset, legend_above, styled
from .trajectories import TRAJECTORY_SOURCE, most_loaded

SAMPLES = 4096
"""Places at which a rail is drawn."""
LOWEST = 1e-10
"""Least density drawn, over the greatest [1]."""


def rail(scene: Scene, ds: xr.Dataset | None = None, axes: Any = None, *, length: float | None = None) -> Any:
    """Draws the rail of a scene over distance, the contact forces of a run below it, and the rail's spectrum.

    The spectrum is that of the rail drawn. The band of the slipper is shaded: from waves as long as the slipper to
    those in which it crosses its play and back, twice the clearance over the rail's steepest slope.

    **Arguments:** `ds`: from `Trajectory.to_xarray`; default none, without forces. `axes`: Axes to draw into, two or
    with `ds` three; default those of a new figure. `length`: of the rail that is drawn [m], from where the run or the
    rail begins, default that of `ds`, or 25 reference lengths.

    **Returns:** the Axes, an array.
    """
    check_scene(scene)
    unit = float(scene.track.wavelength)
    if ds is not None:
        check_dataset(ds, TRAJECTORY_SOURCE, "period", "contact_force")
    first, last = (scene.track.origin, np.inf) if ds is None else unit * ds["period"].values[[0, -1]]
    most = 25 * unit if ds is None else float(last - first)
    most = most if length is None else number(positive, "length", length, "m")
    distance = first + np.arange(SAMPLES) * most / SAMPLES
    here = scene.track.irregularity(distance + 0 * scene.track.wavelength)
    with styled():
        if axes is None:
            rows = 2 if ds is None else 3
            _, axes = plt.subplots(rows, 1, figsize=(7.2, 2.0 * rows), layout="constrained")
        upper, *middle, lower = np.ravel(check_axes(axes, 2 if ds is None else 3))
        for name, color in (("lateral", "blue"), ("vertical", "red")):
            height = 1e3 * np.asarray(getattr(here, name))
            upper.plot(distance, height, lw=0.7, color=COLORS[color], label=name)
            spectrum = power_spectral_density(height, SAMPLES / most)
            seen = slice(1, SAMPLES // 4)  # finer waves are the drawing's
            lower.loglog(spectrum.frequency[seen], spectrum.density[seen] + 1e-300, lw=0.6, color=COLORS[color])
        upper.set(xlabel="distance [m]", ylabel="rail [mm]", xlim=(first, first + most))
        legend_above(upper, upper.get_legend_handles_labels()[0])
        slope, slipper = float(scene.track.steepest_slope), float(scene.slipper.length)
        if slope > 0:
            longest = 2 * float(scene.value("clearance")) / slope
            ends = 1 / max(longest, slipper), 1 / slipper
            lower.axvspan(*ends, color=COLORS["grey"], alpha=0.25, lw=0)
            at = dict(transform=lower.get_xaxis_transform(), ha="center", va="top", fontsize=7)
            lower.text(np.sqrt(ends[0] * ends[1]), 0.95, "band of\nthe slipper", **at)
        highest = max(line.get_ydata().max() for line in lower.lines)
        lower.set(xlabel="wavenumber [cycles/m]", ylabel="density [mm$^2$ m]", ylim=(LOWEST * highest, 5 * highest))
        for ax, run in zip(middle, [] if ds is None else [ds], strict=False):
            for line in most_loaded(run, 3):
                ax.plot(run["period"].values * unit, line.force, lw=0.7, label=line.name, **line.style)
            ax.set(xlabel="distance [m]", ylabel=axis_label("contact_force"), xlim=(first, first + most))
            legend_above(ax, ax.get_legend_handles_labels()[0])
    return np.ravel(axes)
