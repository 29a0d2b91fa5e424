"""Pictures of rails: their displacement and spectrum, and a run's forces below them."""

import numpy as np

from ..analysis.spectra import power_spectral_density
from ..model.scene import Scene, check_scene
from .runs import DISPLACEMENT, DISTANCE, draw_irregularity, units_along
from .style import COLORS, OWN_UNITS, check_dataset, label, legend_above, page, shown, typeset, with_unit
from .trajectories import TRAJECTORY_SOURCE, most_loaded


def rail(scene: Scene, ds: object = None) -> np.ndarray:
    """Draw the rail of a scene over distance, the contact forces of a run below it, and the rail's spectrum.

    Both rails of a track with two rails are drawn. Distances are in the unit of the survey, if the rail is a survey.

    The spectrum is that of the drawn rail. The band of the slipper is shaded: from waves as long as the slipper to
    waves in which it crosses its play and back, twice the clearance over the rail's steepest slope.

    **Arguments:** `ds`: a `Trajectory` or its dataset, whose rail is drawn; default none, without forces, and 25
    reference lengths from the beginning of the rail.

    **Returns:** the Axes, an array.
    """
    scene = check_scene(scene)
    unit = float(scene.wavelength)
    # without a run 25 reference lengths from the rail's beginning
    first = scene.track.origin
    extent = 25 * unit
    if ds is not None:
        ds = check_dataset(ds, TRAJECTORY_SOURCE, "period", "contact_force")
        first, last = unit * ds["period"].values[[0, -1]]
        extent = float(last - first)
    places = 4096
    units = units_along(scene, OWN_UNITS)
    along, height = units.of(DISTANCE), units.of(DISPLACEMENT)
    rate = places / along.shown(extent)
    heights = [0.6, 0.6, 1.0] + [1.0] * (ds is not None)
    with page(len(heights), 1, 2.0 * sum(heights), height_ratios=heights) as axes:
        *over_distance, lower = axes
        draw_irregularity(axes[:2], scene, first + np.arange(places) * extent / places, units)
        # spectra in the colours of the displacements
        for width, ax in zip((1.6, 0.6), axes, strict=False):
            for line in ax.lines:
                spectrum = power_spectral_density(line.get_ydata(), rate)
                seen = slice(1, places // 4)  # finer waves come only from the drawing
                # zeros, which a logarithmic axis cannot show, are raised
                density = spectrum.density[seen] + 1e-300
                # the lower line is wider, so that equal lines do not hide each other
                style = dict(lw=width, color=line.get_color(), label=line.get_label())
                lower.loglog(spectrum.frequency[seen], density, **style)
        top = lower.dataLim.ymax
        slope = float(scene.track.steepest_slope)
        # the wavenumbers to which the slipper responds, unless the rail is straight
        if slope > 0:
            slipper = along.shown(float(scene.slipper.length))
            longest = max(along.shown(2 * float(scene.value("clearance")) / slope), slipper)
            lower.axvspan(1 / longest, 1 / slipper, color=COLORS["grey"], alpha=0.25, lw=0)
            middle = 1 / np.sqrt(longest * slipper)
            across = lower.get_xaxis_transform()  # heights as shares of the axes
            lower.text(middle, 0.95, "band of\nthe slipper", transform=across, ha="center", va="top", fontsize=7)
        distance = along.display_unit
        density = typeset(f"density [{height.display_unit}^2 {distance}]")
        lower.set(xlabel=f"wavenumber [cycles/{distance}]", ylabel=density, ylim=(1e-10 * top, 5 * top))
        if ds is not None:
            # forces over the same distance
            for line in most_loaded(ds, 3):
                axes[2].plot(along.shown(ds["period"] * unit), line.force, lw=0.7, label=line.name, **line.style)
            axes[2].set_ylabel(label(shown(ds, "contact_force")))
            legend_above(axes[2])
        legend_above(lower)
        for ax in over_distance:
            ax.set_xlim(along.shown(np.array([first, first + extent])))
            ax.tick_params(labelbottom=ax is over_distance[-1])
        over_distance[-1].set_xlabel(with_unit("distance", distance, brackets=True))
    return axes
