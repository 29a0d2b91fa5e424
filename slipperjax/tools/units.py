"""Numbers with units in texts, as pint knows them."""

import functools
import re

from .checks import brief, pint_unit

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
    value = float(words[1]) / float(words[2] or 1)
    return value * unit_factor(name, words[3].strip(), unit)


STANDARD_GRAVITY = 9.80665
"""g, in which accelerations are given [m/s^2]."""


def _as_pint_reads(unit: str) -> str:
    """Return a unit as pint spells it: "m s-1" is "m s**-1", and survey feet have one name."""
    # a number behind a letter is a power
    unit = re.sub(r"(?<=[^\W\d_])(-?\d)\b", r"**\1", unit)
    unit = re.sub(r"\blbm\b", "lb", unit)
    return re.sub(r"\b([uU][sS]_survey_foot|ftUS)\b", "survey_foot", unit)


@functools.cache
def unit_factor(name: str, unit: str, si: str) -> float:
    """Return SI units in one `unit`; raises `ValueError` for a unit of another kind."""
    if unit == si:
        return 1.0
    if unit == "g" and si == "m/s^2":  # which pint takes for grams
        return STANDARD_GRAVITY
    import pint  # here, because only files with other units need it

    try:
        # no numbers to a power, which could be of any size
        if not re.fullmatch(r"(?:[^\W\d]|[µ°%*/^().·\s-]|\d(?!\s*(?:\d|\*\*|\^))){1,40}", unit):
            raise ValueError("it is no product of units and small powers")
        return float(pint.Quantity(1.0, pint_unit(_as_pint_reads(unit))).to(pint_unit(si)).magnitude)
    except (pint.PintError, ValueError, TypeError, AssertionError) as error:
        raise ValueError(f"`{name}` must be in a unit like {si}, but is in {brief(unit)}: {error}") from None
