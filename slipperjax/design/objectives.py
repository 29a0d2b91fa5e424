"""Objectives: records that make one number of a motion, on orbits, in runs and in ensembles alike."""

from typing import Any

from ..flow.records import POINTS, RECORDS, AbstractNumber, OnePoint, Record
from ..model.quantities import Quantity
from ..sweeps.records import LargestExponent
from ..tools.checks import brief

Objective = AbstractNumber | LargestExponent
"""A number that a motion is judged by. Equal ones share compiled programs."""


def _scalar(record: AbstractNumber) -> AbstractNumber:
    """A record as one number: the greatest or least of all points."""
    of_points = isinstance(record, Record) and record.dims == POINTS and record.over in ("max", "min")
    return OnePoint(record) if of_points else record


_NAMES = (
    "peak_force",
    *(name for name in RECORDS if name.startswith("rms_")),
    "impact_impulse",
    "contact_load",
    "contact_work",
    "drive_force",
    *(f"excursion_{name}" for name in ("y", "z", "roll", "pitch", "yaw")),
    "grazing_distance",
)
OBJECTIVES: dict[str, Objective] = {name: _scalar(RECORDS[name]) for name in _NAMES} | {"exponent": LargestExponent()}
"""Objectives by name; with a point behind, such as peak_force_A1, of one contact point."""


def objective_named(given: Any) -> Objective:
    """An objective from a record, its name, or a function of a course, of which the mean over periods is taken.

    **Raises:** `ValueError` for anything else, with the names.
    """
    if isinstance(given, LargestExponent):
        return given
    if isinstance(given, AbstractNumber) and not (found := _scalar(given)).dims:
        return found
    if isinstance(given, str):
        of_point = [n for n in _NAMES if RECORDS[n].dims == POINTS and given.startswith(f"{n}_")]
        if of_point:
            return OnePoint(RECORDS[of_point[0]], given.removeprefix(f"{of_point[0]}_"))
        if given in OBJECTIVES:
            return OBJECTIVES[given]
    if callable(given) and not isinstance(given, type):
        name = getattr(given, "__name__", "functional").strip("<>")
        return Record(Quantity(name, "1", name), given, "mean")
    raise ValueError(
        f"Argument `objective` must be one of {', '.join(OBJECTIVES)}, a record of one number, or a function of a "
        f"course, but is {brief(given)}."
    )
