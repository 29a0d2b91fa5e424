"""Measured accelerations along a run, from files and datasets."""

import os
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..model.sensors import Rig, Sensor
from ..model.surveys import ALIASES
from ..tools.checks import check_no_clock, require
from .measured import FEWEST, signals_of, timed_table

OVERSAMPLED = 4.0
"""Least sampling rate of a record over its highest frequency [1]: a cubic spline lacks 3 % of the power there."""


class Record(NamedTuple):
    """A measured acceleration, without missing samples."""

    time: Float[np.ndarray, " samples"]
    """Times since the sled passed the beginning of the run [s]."""
    value: Float[np.ndarray, " samples"]
    """Readings of the sensor [m/s^2]."""
    travel: Float[np.ndarray, " samples"] | None
    """Distances along the rail [m]; None where they follow from the run's speed."""

    @property
    def along(self) -> tuple[Float[np.ndarray, " samples"], str]:
        """What finds the place of each sample, and its unit: distances, or without them times."""
        return (self.time, "s") if self.travel is None else (self.travel, "m")

    def within(self, begin: float, end: float) -> "Record":
        """Return the part of the record between two times or distances of a run, see `along`.

        **Raises:** `ValueError` where too few samples are there.
        """
        values, unit = self.along
        inside = (values >= begin) & (values <= end)
        need = f"have {FEWEST} samples or more within the run, {begin:.4g} to {end:.4g} {unit}"
        require(
            inside.sum() >= FEWEST,
            "measured",
            need,
            shown=f"{inside.sum()}: {values[0]:.4g} to {values[-1]:.4g} {unit}",
        )
        return Record(*(None if part is None else part[inside] for part in self))


def read_record(
    measured: str | os.PathLike[str] | xr.Dataset, sensor: Sensor, high: float, begin: float = 0.0
) -> Record:
    """Return the measured acceleration of a sensor, as `slipperjax.fitting.telemetry` takes it.

    **Arguments:** `high`: highest frequency that the record must have [Hz]; `begin`: of the run along the rail [m].

    **Raises:** `ValueError` with all faults of a file, and for a record that is sampled too slowly.
    """
    if isinstance(measured, xr.Dataset):
        found = signals_of(measured, Rig((sensor,)))[0]
        require(found, "measured", f"have a signal of {sensor.name}", shown="none")
        columns = dict(zip(("time", "acceleration"), found[sensor.name], strict=True))
    else:
        columns = _columns(measured, sensor)
    good = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    require(good.sum() >= FEWEST, "measured", f"have {FEWEST} samples or more", shown=str(good.sum()))
    columns = {key: values[good] for key, values in columns.items()}
    time = columns["time"]
    check_no_clock("measured", time)
    rate = 1 / np.median(np.diff(time))
    need = f"have {OVERSAMPLED * high:g} samples a second or more for bands up to {high:g} Hz"
    require(rate >= OVERSAMPLED * high * (1 - 1e-6), "measured", need, shown=f"{rate:.6g}")
    travel = columns.get("distance")
    if travel is None and "speed" in columns:
        travel = begin + _travelled(time, columns["speed"])
    rises = travel is None or bool(np.all(np.diff(travel) >= 0))
    require(rises, "measured", "have distances that do not fall, and speeds of zero or more", shown="others")
    return Record(time, columns["acceleration"], travel)


def _columns(file: str | os.PathLike[str], sensor: Sensor) -> dict[str, np.ndarray]:
    """Return the columns of a file in SI units, time and the sensor's acceleration among them."""
    wanted = {"acceleration": sensor.unit, "distance": "m", "speed": "m/s"}
    others = {"velocity": "speed", "v": "speed"}
    others |= dict.fromkeys(("a", sensor.name.lower()), "acceleration")
    others |= {name: column for name, column in ALIASES.items() if column in wanted}
    table = timed_table(file, wanted, others)
    if "acceleration" not in table.columns:
        table.fault(f"must have a column `{sensor.name}` or `acceleration`")
    return table.si()


def _travelled(time: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return the distance travelled since time zero [m], also of a record that begins later, by its first speed."""
    from scipy.integrate import cumulative_trapezoid  # here, because importing it takes time

    since_first = cumulative_trapezoid(speed, time, initial=0.0)
    return since_first - np.interp(0.0, time, since_first) + speed[0] * max(time[0], 0.0)
