"""Titles that state the case: the fixed parameters of a dataset, in display units."""

from typing import Any

import numpy as np
import xarray as xr

from ..model import PARAMETERS
from .style import typeset

_SHORT = ("speed", "clearance", "length")
_LONG = (
    (*_SHORT, "mass", "gravity"),
    ("stiffness", "restitution", "amplitude", "roll_amplitude"),
)
_SIGNS = {"degrees": "°"}


def case_title(ds: xr.Dataset, *, full: bool = False) -> str:
    """The fixed parameters of a dataset, as in "V = 1250 m/s, C = 1 mm, L = 0.2 m" with typeset symbols.

    Parameters are read from the attributes, and from coordinates with one value, such as those of one case of a
    sweep. Those that vary or are not known are left out.

    **Arguments:** `ds`: of any run; `full`: all parameters and wavelengths, in two lines.

    **Returns:** the text, empty where no parameter is known.
    """
    found = {name: _number(ds, name) for name in PARAMETERS}
    lines = [
        [_stated(n, found[n]) for n in names if found[n] is not None] for names in (_LONG if full else (_SHORT,))
    ]
    waves = np.ravel(ds.attrs.get("wavelengths [m]", []))
    if full and len(waves):
        lines[-1].append(f"$L_X$ = {' and '.join(_digits(float(w)) for w in waves)} m")
    return "\n".join(", ".join(line) for line in lines if line)


def name_case(figure: Any, ds: xr.Dataset, *, full: bool = False) -> None:
    """Writes the case above a figure."""
    text = case_title(ds, full=full)
    if text:
        figure.suptitle(text, fontsize=7)


def _number(ds: xr.Dataset, name: str) -> float | None:
    """A parameter's one value [SI unit]; None where it has several, or is not known."""
    if name in ds.coords:
        return ds[name].item() if ds[name].size == 1 else None
    unit = PARAMETERS[name].unit
    value = ds.attrs.get(name if unit == "1" else f"{name} [{unit}]")
    return float(value) if np.size(value) == 1 and value is not None else None


def _stated(name: str, value: float) -> str:
    """A parameter as symbol, number and display unit."""
    q = PARAMETERS[name]
    unit = _SIGNS.get(q.display_unit, "" if q.display_unit == "1" else f" {typeset(q.display_unit)}")
    return f"${q.symbol}$ = {_digits(float(q.shown(value)))}{unit}"


def _digits(value: float) -> str:
    """A number with four digits; large and small ones with a power of ten."""
    text = f"{value:.4g}"
    mantissa, _, power = text.partition("e")
    if not power:
        return text
    factor = "" if mantissa == "1" else rf"{mantissa}\cdot"
    return rf"${factor}10^{{{int(power)}}}$"
