"""Measured signals of runs, from datasets of xarray and from files, with units, gaps and different rates."""

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..model.parameters import PARAMETERS
from ..model.sensors import Rig, Sensor
from ..tools.checks import check_no_clock, finite, number, numbers, require, tuple_of, warn
from ..tools.files import content_of, user_path
from ..tools.tables import Table, without_marks

FEWEST = 8
"""Least number of samples of a signal."""


class Signal(NamedTuple):
    """Signal of a sensor in a run, without missing samples."""

    time: Float[np.ndarray, " samples"]
    """Times since the run was at its stated beginning [s]."""
    value: Float[np.ndarray, " samples"]
    """Values in the sensor's unit."""


NO_SIGNAL = Signal(np.empty(0), np.empty(0))


class MeasuredRun(NamedTuple):
    """The signals of a run, in the order of the sensors; `NO_SIGNAL` where a sensor has none."""

    signals: tuple[Signal, ...]
    settings: dict[str, float]
    """Known parameters of this run, such as its speed, by name [SI units]."""


def measured_runs(measured: object, rig: Rig) -> tuple[MeasuredRun, ...]:
    """Return measured runs from a dataset or a file, or several.

    **Raises:** `ValueError` for signals without a sensor, without units or times, and for sensors without any signal;
    `OSError` for files that cannot be read.
    """
    kinds = (xr.Dataset, str, os.PathLike)
    every = [measured] if isinstance(measured, kinds) else measured
    every = tuple_of("measured", every, kinds, "a dataset or a file, or a list of them")
    require(every, "measured", "have one run or more", shown="none")
    runs = []
    for one in every:
        signals, known = (signals_of if isinstance(one, xr.Dataset) else _of_file)(one, rig)
        found = [_signal(s, *signals[s.name]) if s.name in signals else NO_SIGNAL for s in rig.sensors]
        require(signals, "measured", f"have signals of the sensors {', '.join(rig.names)}", shown="none")
        runs.append(MeasuredRun(tuple(found), known))
    for k, sensor in enumerate(rig.sensors):
        has = any(run.signals[k].time.size for run in runs)
        require(has, "measured", f"have the signal of each sensor, such as {sensor.name}", shown="without it")
    return tuple(runs)


Found = tuple[dict[str, Sequence[np.ndarray]], dict[str, float]]
"""Times and values of sensors by name, and known parameters."""


def timed_table(file: str | os.PathLike[str], wanted: dict[str, str], others: dict[str, str] | None = None) -> Table:
    """Return the table of a file with times that rise, see `Table`; faults are still to be raised."""
    path = user_path(file, "measured")
    names = {"t": "time", "seconds": "time"} | (others or {})
    table = Table(path, content_of(path), wanted | {"time": "s"}, names, holes=True)
    if "time" in table.columns:
        table.check_rising("time")
    else:
        table.fault("must have a column `time`")
    return table


def _of_file(file: str | os.PathLike[str], rig: Rig) -> Found:
    """Read the signals of a CSV or netCDF file: a time, a column for each sensor, and columns of known parameters."""
    settings = {name: "" if q.unit == "1" else q.unit for name, q in PARAMETERS.items()}
    columns = timed_table(file, settings | {sensor.name: sensor.unit for sensor in rig.sensors}).si()
    known = {}
    for name, values in columns.items():
        if name in settings:
            found = np.unique(values[np.isfinite(values)])
            need = f"have one value of {name}, which a run keeps"
            require(len(found) == 1, "measured", need, shown=f"{len(found)} values")
            known[name] = float(found[0])
    return {name: (columns["time"], columns[name]) for name in rig.names if name in columns}, known


def signals_of(ds: xr.Dataset, rig: Rig) -> Found:
    """Read the signals of a dataset: a variable for each sensor, along a coordinate of times, and scalar coordinates
    of known parameters."""
    strange = [str(name) for name in ds.data_vars if name not in rig.names]
    need = f"have signals of the sensors {', '.join(rig.names)} alone"
    require(not strange, "measured", need, shown=f"{', '.join(strange)}, too")
    signals = {}
    for sensor in rig.sensors:
        if sensor.name in ds:
            array = ds[sensor.name]
            need = f"have {sensor.name} along one dimension, with a coordinate of times"
            require(array.ndim == 1 and array.dims[0] in ds.coords, "measured", need, shown=f"along {array.dims}")
            time = ds[array.dims[0]]
            values = [_in_si(part, unit) for part, unit in ((time, "s"), (array, sensor.unit))]
            require(
                np.all(np.diff(values[0]) > 0), "measured", f"have increasing times of {sensor.name}", shown="others"
            )
            signals[sensor.name] = values
    known = {}
    for name, q in PARAMETERS.items():
        if name in ds.coords and ds[name].ndim == 0:
            known[name] = number(finite, name, ds[name], q.unit)
    return signals, known


def _in_si(array: xr.DataArray, unit: str) -> np.ndarray:
    """Return the values of a variable that has an attribute `units`, or of durations, in an SI unit; NaN for marks of
    overload."""
    given = array.attrs.get("units") or array.dtype.kind in "mM" or hasattr(array.data, "magnitude")
    require(given, "measured", f"have an attribute `units` of {array.name}, such as {unit}", shown="without it")
    values = numbers(str(array.name), array, unit=unit).astype(float)
    return without_marks(values, f"Argument `measured`: {array.name}")


def _signal(sensor: Sensor, time: np.ndarray, value: np.ndarray) -> Signal:
    known = np.isfinite(value) & np.isfinite(time)
    good = known & (time >= 0)
    need = f"have {FEWEST} samples or more of {sensor.name} from zero seconds on"
    require(good.sum() >= FEWEST, "measured", need, shown=str(good.sum()))
    check_no_clock("measured", time[good])
    if np.any(known & ~good):
        warn(f"Argument `measured` has samples of {sensor.name} before zero seconds, which are left out.")
    return Signal(time[good], value[good])
