"""Texts and tables of a run over a length of rail."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import named_parameters, scene_attributes
from ..flow.status import is_lost, step_error
from ..model.dynamics import static_loads
from ..model.quantities import ACCELERATIONS, Quantity
from ..model.scene import PARTS, Scene
from ..model.travel import LEAST_SPEED, SpeedProgramme
from ..plots.runs import PEAKS, RunView, edges_of, main_peak, peak_of, speed_name
from ..plots.style import AXES, Units
from . import run_tables
from .run_tables import APART, words

LENGTHS = 8
"""Most lengths of rail in a list with their status."""
NET = "peak_slipper_force"


def summary(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return a run as a text, a line for each result: first its status, and nothing else where the run is lost."""
    return list(_summary(RunView.of(ds, units=units)))


def tables(ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
    """Return the windows of a run, its hundreds of metres and its worst places as tables."""
    return run_tables.tables(RunView.of(ds, units=units))


def report(ds: xr.Dataset, units: Units = None) -> list[str]:
    """Return the text of a report: summary, worst places and scene."""
    view = RunView.of(ds, units=units)
    text = list(_summary(view))
    worst = run_tables.tables(view)["worst places"]
    if len(worst):
        text += ["", f"Worst places, {view.said('distance', APART)} apart or more", ""]
        text += run_tables.lines_of(worst, "{:.2f}")
    return [*text, "", "Scene", "", *_described(view)]


def _summary(view: RunView) -> Iterator[str]:
    yield f"status: {view.status}"
    flagged = view.flagged
    for *ends, status in flagged[:LENGTHS]:
        yield f"{view.where(*ends)}: {words(status)}"
    if len(flagged) > LENGTHS:
        yield f"and {len(flagged) - LENGTHS} further lengths with a status"
    # numbers of a lost run mean nothing
    if not (is_lost(view.status) or is_lost(view.codes).all()):
        yield from _results(view)


def _results(view: RunView) -> Iterator[str]:
    """Yield the results of a run as texts."""
    ds = view.ds
    speed = view.quantity("speed")
    values = speed.shown(ds[speed_name(ds)].values)
    # a single speed where it does not change
    speeds = " to ".join(dict.fromkeys((f"{values.min():.4g}", f"{values.max():.4g}")))
    ends = edges_of(ds, "distance")[[0, -1]]
    yield f"{view.where(*ends)} in {float(np.ptp(view.times)):.4g} s, speed {speeds} {speed.display_unit}"
    programme = None if view.scene is None else view.scene.speed
    stops = programme.stops if isinstance(programme, SpeedProgramme) else []
    slow = [stop for stop in stops if stop[0] < ends[1] and stop[1] > ends[0]]
    if slow:
        least = view.said("speed", LEAST_SPEED)
        where = view.where(*slow[0][:2]) + f" and at {len(slow) - 1} further places" * (len(slow) > 1)
        duration = sum(seconds for *_, seconds in slow)
        yield f"slower than {least} from {where}, for {duration:.3g} s: passed at that speed"
    lost = is_lost(view.codes)
    if lost.any():
        yield "without the lengths that have no meaning:"
    if NET in ds:
        yield from _net_loads(view)
    if "peak_force" in ds:
        at = peak_of(ds)
        point = f"{at['contact'].item()} ({at['end'].item()}), "
        yield from _peak(view, "peak_force", "highest single contact point", at, point)
    if "impacts" in ds:
        impacts = float(ds["impacts"].sum())
        seconds = float(np.diff(view.times)[~lost].sum())
        yield f"{impacts:.0f} impacts, {impacts / seconds:.4g} per second"
    known = [name for name in ACCELERATIONS if f"peak_{name}" in ds]
    if known:
        most = [f"{name} {view.said(name, ds[f'peak_{name}'].max())}" for name in known]
        yield f"greatest accelerations: {', '.join(most)}"
    # recorded only where the scene has friction
    if "friction_work" in ds:
        heat = view.units.of(Quantity("friction_work", "J", "heat", shown_unit="kJ"))
        yield f"friction work {heat.shown(float(ds['friction_work'].sum())):.4g} {heat.display_unit}"
    name = main_peak(ds)
    if f"{name}_percentile" in ds:
        text = f"99th percentile of a window's {view.quantity(name).long_name}"
        yield from _worst(view, text, name, ds[f"{name}_percentile"].sel(percentile=99))
    if "rms_a_z" in ds:
        yield from _worst(view, "RMS of a_z", "a_z", ds["rms_a_z"])
    if "probe_error" in ds and view.scene is not None:
        yield step_error(view.scene, ds["probe_error"].values, ds["probe_error"].attrs.get("over", ""))


def _net_loads(view: RunView) -> Iterator[str]:
    """Yield the greatest net forces of slippers, vertical and lateral, their places, and the greatest moments."""
    ds = view.ds
    for axis in ("z", "y"):
        at = peak_of(ds.sel(axis=[axis]), NET)
        slipper = at["slipper"].item() if "slipper" in at.coords else ""
        times = ""
        # ratio to the force at rest; without gravity and load there is no force at rest
        if axis == "z" and view.scene is not None:
            static = static_load(view.scene, slipper, float(at["peak_slipper_distance"]))
            if static > 0:
                load = view.said(NET, static)
                times = f": {abs(float(at[NET])) / static:.3g} times its static load of {load}"
        text = f"greatest net {AXES[axis]} force of a slipper"
        yield from _peak(view, NET, text, at, f"{slipper}, " if slipper else "", times)
    if "peak_slipper_moment" in ds:
        moment = abs(ds["peak_slipper_moment"])
        most = moment.max([dim for dim in moment.dims if dim != "about"])
        each = [f"{one['about'].item()} {view.said('peak_slipper_moment', one)}" for one in most]
        yield f"greatest net moments of a slipper about its middle: {', '.join(each)}"


def _peak(view: RunView, name: str, text: str, at: xr.Dataset, of: str, times: str = "") -> Iterator[str]:
    """Yield a text on a force of `PEAKS`, which `at` has, and its place, unless nothing touched."""
    # NaN is also no force
    if abs(at[name]) > 0:
        place = f"{view.where(at[PEAKS[name].place].item())} and {view.said('speed', at[speed_name(view.ds)])}"
        yield f"{text} {view.said(name, at[name])} at {of}{place}{times}"


def _worst(view: RunView, text: str, name: str, values: xr.DataArray) -> Iterator[str]:
    """Yield a text on the largest value of all stretches, and its stretch; nothing where no value is known."""
    # stretches with lost windows are NaN
    k = int(values.fillna(-np.inf).values.argmax())
    if np.isfinite(values[k]):
        stretch = view.where(*edges_of(view.ds, "stretch")[k : k + 2])
        yield f"worst {text}: {view.said(name, values[k])} from {stretch}"


def static_load(scene: Scene, slipper: str, distance: float) -> float:
    """Return the share of a slipper ("" for a single slipper) in the weight and the load along z at a place [N]."""
    loads = np.ravel(static_loads(scene, scene.travel(scene.epoch_at(distance))))
    return float(loads[scene.slipper.names.index(slipper) if slipper else 0])


def _described(view: RunView) -> list[str]:
    """Return the scene of a run as a text: its named numbers, and a line for each part."""
    scene = view.scene
    if scene is None:
        return []
    numbers = named_parameters(scene_attributes(scene), view.units).values()
    parts = [f"{name}: {getattr(scene, name)!r}" for name in (*PARTS, "speed") if getattr(scene, name) is not None]
    return [", ".join(numbers), *parts]
