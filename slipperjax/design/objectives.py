"""Objectives: records that make one number of a motion, on orbits, in runs and in ensembles alike."""

from typing import Any

from ..flow.records import POINTS, RECORDS, AbstractNumber, OnePoint, Record
from ..model.quantities import Quantity
from ..sweeps.records import LargestExponent
from ..tools.checks import brief

Objective = AbstractNumber | LargestExponent
"""A number that a motion is judged by. Equal ones share compiled programs."""


def _scalar(record: AbstractNumber) -> AbstractNumber:
    """Returns a record as one number: the greatest or least of all points."""
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


def objective_named(objective: Any) -> Objective:
    """Returns the objective of a name, a record, or a function of a course, averaged over periods.

    **Raises:** `ValueError` for anything else, with the names.
    """
    if isinstance(objective, LargestExponent):
        return objective
    if isinstance(objective, AbstractNumber) and not _scalar(objective).dims:
        return _scalar(objective)
    if isinstance(objective, str):
        if objective in OBJECTIVES:
            return OBJECTIVES[objective]
        for name in _NAMES:
            if RECORDS[name].dims == POINTS and objective.startswith(f"{name}_"):
                return OnePoint(RECORDS[name], objective.removeprefix(f"{name}_"))
    if callable(objective) and not isinstance(objective, type):
        name = getattr(objective, "__name__", "functional").strip("<>")
        return Record(Quantity(name, "1", name), objective, "mean")
    raise ValueError(
        f"Argument `objective` must be one of {', '.join(OBJECTIVES)}, a record of one number, or a function of a "
        f"course, but is {brief(objective)}."
    )
