"""Units: of numbers in texts, as pint knows them, and of objects that have their own unit.

Frequencies count cycles, and angular rates count radians. For pint both are the same: 1 Hz is 1 rad/s. Here 1 Hz is
2 pi rad/s, and the same holds for all units that differ by cycles and radians.
"""

import datetime
import functools
import math
import re
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from .texts import brief

_QUANTITY = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"  # a number,
    r"(?:/([1-9]\d*))?"  # or a fraction,
    r"(\s+\S.*?|[^\W\d_].*?|°)\s*"  # and a unit
)


def parsed(name: str, value: object, unit: str) -> float:
    """Return a text such as "1.5 mm" or "1/16 in" as a number in the SI unit `unit`.

    **Raises:** `ValueError` for other texts, and bare numbers.
    """
    words = _QUANTITY.fullmatch(value if isinstance(value, str) else "")
    if words is None:
        raise ValueError(f'`{name}` must be a number with a unit, as in "1.5 {unit}", but is {brief(value)}.')
    return _number(words) * unit_factor(name, words[3].strip(), unit)


def _number(words: re.Match[str]) -> float:
    """Return the number of a text, which may be a fraction."""
    return float(words[1]) / float(words[2] or 1)


MEANT = {("g", "m/s^2"): "g", ("g0", "m/s^2"): "g", ("mil", "m"): "thou", ("lb", "N"): "lbf", ("kg", "N"): "kgf"}
"""Units meant by other spellings, in small letters and without a plural, by spelling and SI unit."""
STANDARD_GRAVITY = 9.80665
"""g, the unit of accelerations [m/s^2]."""


def _as_pint_reads(unit: str) -> str:
    """Return a unit as pint spells it: "m s-1" and "m.s-1" are "m s**-1", and survey feet have one name."""
    unit = re.sub(r"(?<=[^\W_])\.(?=[^\W\d_])", " ", unit)
    # a number behind a letter is a power
    unit = re.sub(r"(?<=[^\W\d_])(-?\d)\b", r"**\1", unit)
    unit = re.sub(r"\blbm\b", "lb", unit)
    unit = re.sub(r"\brev\b", "revolution", unit)
    return re.sub(r"\b([uU][sS]_survey_foot|ftUS)\b", "survey_foot", unit)


def pint_unit(unit: str) -> str:
    """Return a unit in pint's spelling: "m^2 per cycle/m" is "(m^2)/(cycle/m)", and "1" is empty."""
    whole, per, part = unit.partition(" per ")
    if per:
        return f"({whole})/({part})"
    return "" if whole == "1" else whole


@functools.cache
def unit_factor(name: str, unit: str, si: str) -> float:
    """Return how many SI units one `unit` is; raises `ValueError` for a unit of another kind."""
    try:
        return _factor_of_text(unit, si)
    except TypeError as error:
        raise ValueError(f"`{name}` must be in a unit like {si}, but is in {brief(unit)}: {error}") from None


@functools.cache
def _factor_of_text(unit: str, si: str) -> float:
    """Return how many SI units one `unit` is; raises `TypeError` for a unit of another kind."""
    if unit == si or pint_unit(unit) == pint_unit(si):
        return 1.0
    if unit == "g" and si == "m/s^2":  # pint's g is gram
        return STANDARD_GRAVITY
    import pint  # here, because only files with other units need it

    try:
        # no powers of numbers, which could be of any size
        if not re.fullmatch(r"(?:[^\W\d]|[µ°%*/^().·\s-]|\d(?!\s*(?:\d|\*\*|\^))){1,40}", unit):
            raise ValueError("it is no product of units and small powers")
        return _factor(pint.Quantity(1.0, pint_unit(_as_pint_reads(unit))), si)
    except (KeyError, pint.PintError, ValueError, AssertionError) as error:
        # units to the power of zero are a `KeyError`
        why = "it is no product of units and small powers" if isinstance(error, KeyError) else str(error)
        meant = MEANT.get((unit.rstrip("s").lower(), si))
        raise TypeError(f"{why}. Did you mean {meant}?" if meant else why) from None


def _factor(one: Any, si: str) -> float:
    """Return how many SI units the unit of a quantity of pint is, whose magnitude is one.

    **Raises:** `TypeError` for a unit of another kind.
    """
    wanted = type(one)(1.0, pint_unit(si))
    factor = float(one.to(wanted.units).magnitude)
    angles, cycles = _angles(one)
    angles_wanted, cycles_wanted = _angles(wanted)
    if not angles_wanted:
        return factor  # such as an arc, or a speed from wavelength and frequency
    if angles == angles_wanted:
        return factor * math.tau ** (cycles - cycles_wanted)
    # 1/s may mean Hz (cycles) or rad/s (radians), and 1/m may count either
    if angles or "turn" in dict(wanted.unit_items()):
        raise TypeError("it must say whether it counts cycles or radians")
    return factor


def _angles(one: Any) -> tuple[float, float]:
    """Return the power of angles in the unit of a quantity of pint, and the power of the angles that pint does not
    count: the cycles in Hz, because pint takes Hz as 1/s."""
    cycles = float(sum(power for name, power in one.unit_items() if name.endswith("hertz")))
    return cycles + dict(one.to_root_units().unit_items()).get("radian", 0), cycles


def in_unit(value: Any, unit: str) -> Any:
    """Return values that have their own unit as numbers in `unit`, also in lists; other values unchanged.

    Texts such as "1.5 mm" have units, and so have quantities of pint and of similar libraries. `xarray.DataArray`
    and series of pandas have an attribute `units`. Durations of Python, NumPy and pandas are in seconds. Masked
    numbers of a masked array become NaN.

    **Raises:** `TypeError` for a quantity of another kind, and for dates.
    """
    if type(value) in (list, tuple):
        return type(value)(in_unit(part, unit) for part in value)
    if isinstance(value, str):
        words = _QUANTITY.fullmatch(value)
        return value if words is None else _number(words) * _factor_of_text(words[3].strip(), unit)
    plain, own = _parted(value)
    if own is None:
        return unmasked(plain)
    is_pint = hasattr(own, "dimensionality")
    factor = _factor(1.0 * own, unit) if is_pint else _factor_of_text(str(own), unit)
    plain = unmasked(plain)
    return plain if factor == 1 else plain * factor


def unmasked(value: Any) -> Any:
    """Return a masked array of numbers with NaN under its mask, also in lists; other values unchanged."""
    if type(value) in (list, tuple):
        return type(value)(map(unmasked, value))
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "iuf":
        return value.astype(float).filled(np.nan)
    return value


def _parted(value: Any) -> tuple[Any, Any]:
    """Return the numbers of a value, and their unit, as a text or an object of pint; None where there is no unit.

    **Raises:** `TypeError` for dates.
    """
    # recognised by their attributes, because the libraries take long to import
    if isinstance(value, datetime.timedelta):  # durations of pandas, too
        return value.total_seconds(), "s"
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if kind == "m":
        return np.asarray(value) / np.timedelta64(1, "s"), "s"
    if kind == "M" or isinstance(value, datetime.date):
        raise TypeError("dates have no beginning: subtract the first one")
    if isinstance(value, jax.Array):
        return value, None
    if isinstance(attributes := getattr(value, "attrs", None), Mapping):
        inner = getattr(value, "data", None)  # `data` may be a quantity of pint
        if hasattr(inner, "magnitude"):
            return _parted(inner)
        own = attributes.get("units") or None
        return value if own is None else np.asarray(value), own
    for number, unit in (("magnitude", "units"), ("value", "unit"), ("value", "units")):
        if hasattr(value, number) and hasattr(value, unit):
            return getattr(value, number), getattr(value, unit)
    return value, None
