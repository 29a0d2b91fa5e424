"""Texts, tables and pictures of runs over a length of rail."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import scene_attributes
from ..flow.status import counted, is_lost, step_error
from ..model.dynamics import static_loads
from ..model.parameters import PARAMETERS
from ..model.quantities import ACCELERATIONS, Quantity
from ..model.scene import PARTS, Scene
from ..model.travel import LEAST_SPEED, SpeedProgramme
from ..plots.runs import PEAKS, RunView, edges_of, in_hundredths, main_peak, peak_of, run_overview, speed_name
from ..plots.style import AXES, shown_columns
from ..plots.sweeps import of_sweep
from ..tools.units import STANDARD_GRAVITY
from .kind import Kind, Units
from .run_tables import APART, tables, words

LENGTHS = 8
"""Most lengths of rail in a list with their status."""
NET = "peak_slipper_force"


class RunKind(Kind):
    """One run over a length of rail, or several over parameters."""

    title = "Run over a rail"
    reports = True

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        if ds["status"].ndim:
            return summary_of_runs(ds)
        return summary(RunView.of(ds, units=units))

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        if ds["status"].ndim:
            return {"runs": shown_columns(ds, *map(str, ds["status"].dims), units=units)}
        return tables(RunView.of(ds, units=units))

    def plot(self, ds: xr.Dataset, **options: Any) -> Any:
        return of_sweep(ds, **options) if ds["status"].ndim else run_overview(ds, **options)

    def report(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        view = RunView.of(ds, units=units)
        text = summary(view)
        worst = self.tables(ds, units)["worst places"]
        if len(worst):
            text += ["", f"Worst places, {_said(view.quantity('distance'), APART)} apart or more", ""]
            text += worst.to_string(index=False, float_format="{:.2f}".format).splitlines()
        return [*text, "", "Scene", "", *described(view)]


def summary_of_runs(ds: xr.Dataset) -> list[str]:
    """Return several runs as a text: their number, and how many are lost."""
    status = ds["status"].values
    lines = [f"{status.size} runs over {', '.join(map(str, ds['status'].dims))}"]
    return lines + [f"{n} runs: {meaning}" for meaning, n in counted(status).items()]


def summary(view: RunView) -> list[str]:
    """Return a run as a text, a line for each result: first its status, and nothing else where the run is lost."""
    lines = [f"status: {view.status}"]
    lengths = [f"{_from_to(view, *ends)}: {words(status)}" for *ends, status in view.flagged]
    lines += lengths[:LENGTHS]
    if len(lengths) > LENGTHS:
        lines.append(f"and {len(lengths) - LENGTHS} further lengths with a status")
    # numbers of a lost run mean nothing
    lost = is_lost(view.status) or is_lost(view.codes).all()
    return lines if lost else [*lines, *_results(view)]


def _results(view: RunView) -> Iterator[str]:
    """Yield the results of a run as texts."""
    ds = view.ds
    speed = view.quantity("speed")
    values = speed.shown(ds[speed_name(ds)].values)
    # a single speed where it does not change
    speeds = " to ".join(dict.fromkeys((f"{values.min():.4g}", f"{values.max():.4g}")))
    seconds = float(np.ptp(view.times))
    ends = edges_of(ds, "distance")[[0, -1]]
    yield f"{_from_to(view, *ends)} in {seconds:.4g} s, speed {speeds} {speed.display_unit}"
    programme = None if view.scene is None else view.scene.speed
    stops = programme.stops if isinstance(programme, SpeedProgramme) else []
    slow = [stop for stop in stops if stop[0] < ends[1] and stop[1] > ends[0]]
    if slow:
        where = f"from {_from_to(view, *slow[0][:2])}" + f" and at {len(slow) - 1} further places" * (len(slow) > 1)
        duration = sum(seconds for *_, seconds in slow)
        yield f"slower than {_said(speed, LEAST_SPEED)} {where}, for {duration:.3g} s: passed at that speed"
    lost = is_lost(view.codes)
    if lost.any():
        yield "without the lengths that have no meaning:"
    if NET in ds:
        yield from _net_loads(view)
    if "peak_force" in ds:
        at = peak_of(ds)
        point = f"{at['contact'].item()} ({at['end'].item()})"
        yield from _peak(view, "peak_force", "highest single contact point", point, at)
    if "impacts" in ds:
        impacts = float(ds["impacts"].sum())
        seconds = float(np.diff(view.times)[~lost].sum())
        yield f"{impacts:.0f} impacts, {impacts / seconds:.4g} per second"
    known = [name for name in ACCELERATIONS if f"peak_{name}" in ds]
    if known:
        most = [f"{name} {_said(view.quantity(name), ds[f'peak_{name}'].max())}" for name in known]
        yield f"greatest accelerations: {', '.join(most)}"
    # recorded only where the scene has friction
    if "friction_work" in ds:
        heat = view.units.of(Quantity("friction_work", "J", "heat", shown_unit="kJ"))
        yield f"friction work {_said(heat, ds['friction_work'].sum())}"
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
                load = _said(view.quantity(NET), static)
                times = f": {abs(float(at[NET])) / static:.3g} times its static load of {load}"
        yield from _peak(view, NET, f"greatest net {AXES[axis]} force of a slipper", slipper, at, times)
    if "peak_slipper_moment" in ds:
        moment = abs(ds["peak_slipper_moment"])
        most = moment.max([dim for dim in moment.dims if dim != "about"])
        q = view.quantity("peak_slipper_moment")
        each = [f"{about} {_said(q, value)}" for about, value in zip(most["about"].values, most, strict=True)]
        yield f"greatest net moments of a slipper about its middle: {', '.join(each)}"


def _peak(view: RunView, name: str, text: str, at_what: str, at: xr.Dataset, times: str = "") -> Iterator[str]:
    """Yield a text on a force of `PEAKS`, which `at` has, and its place, unless nothing touched."""
    force = float(at[name])
    # NaN is also no force
    if not abs(force) > 0:
        return
    distance = view.quantity("distance")
    where = f"{in_hundredths(distance.shown(float(at[PEAKS[name].place])))} {distance.display_unit}"
    place = f"{where} and {_said(view.quantity('speed'), at[speed_name(view.ds)])}"
    yield f"{text} {_said(view.quantity(name), force)} at {f'{at_what}, ' * bool(at_what)}{place}{times}"


def _worst(view: RunView, text: str, name: str, values: xr.DataArray) -> Iterator[str]:
    """Yield a text on the largest value of all stretches, and its stretch; nothing where no value is known."""
    # stretches with lost windows are NaN
    k = int(values.fillna(-np.inf).values.argmax())
    if np.isfinite(values[k]):
        stretch = _from_to(view, *edges_of(view.ds, "stretch")[k : k + 2])
        yield f"worst {text}: {_said(view.quantity(name), values[k])} from {stretch}"


def _said(q: Quantity, value: Any) -> str:
    """Return a value [SI unit] of a quantity as a text, in its display unit; an acceleration in m/s^2 also in g."""
    text = f"{q.shown(float(value)):.4g} {q.display_unit}"
    return f"{text} ({float(value) / STANDARD_GRAVITY:.3g} g)" if q.display_unit == "m/s^2" else text


def _from_to(view: RunView, begin: float, end: float) -> str:
    """Return a length of rail [m] as a text."""
    ends = " to ".join(map(in_hundredths, view.places([begin, end]).tolist()))
    return f"{ends} {view.quantity('distance').display_unit}"


def static_load(scene: Scene, slipper: str, distance: float) -> float:
    """Return the share of a slipper ("" for a single slipper) in the weight and the load along z at a place [N]."""
    loads = np.ravel(static_loads(scene, scene.travel(scene.epoch_at(distance))))
    return float(loads[scene.slipper.names.index(slipper) if slipper else 0])


def described(view: RunView) -> list[str]:
    """Return the scene of a run as a text: its named numbers, and a line for each part."""
    scene = view.scene
    if scene is None:
        return []
    known = scene_attributes(scene)
    numbers = []
    for q in PARAMETERS.values():
        value = known.get(q.name if q.unit == "1" else f"{q.name} [{q.unit}]")
        if value is not None:
            numbers.append(view.units.of(q).named(value).replace("_", " "))
    parts = [f"{name}: {getattr(scene, name)!r}" for name in (*PARTS, "speed") if getattr(scene, name) is not None]
    return [", ".join(numbers), *parts]
