"""Surveyed rails: tables in CSV or netCDF files with units in their headers, as tracks that know their files."""

import codecs
import contextlib
import csv
import hashlib
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import numpy as np

from ..tools.checks import brief, number, positive, require, warn
from ..tools.fields import unit_of
from ..tools.files import content_of, readable, user_path
from ..tools.types import Real
from ..tools.units import unit_factor
from .rails import EQUAL_SPACING, SampledTrack

if TYPE_CHECKING:
    import xarray as xr

COLUMNS = {name: unit_of(SampledTrack, name) for name in ("distance", "lateral", "vertical", "roll")}
"""Columns of a survey, and their SI units."""
ALIASES = {"chainage": "distance", "station": "distance", "x": "distance", "y": "lateral", "z": "vertical"}
"""Other names of columns."""
STATIONS = {("m", 3): 1000.0, ("m", 4): 1000.0, ("ft", 2): 100.0}
"""What one counts before the plus of a station such as 129+773, in its unit, by that unit and the digits behind."""
MISSING = ("", "-9999", "-9999.0", "-99999", "-99999.0")
"""Cells that stand for no number."""
_HDF5 = b"\x89HDF"  # the beginning of netCDF files of version 4


class SurveyedTrack(SampledTrack):
    """A track of samples in a file, see `slipperjax.load_rail`.

    Descriptions of scenes hold the file's name and digest, and not the samples.
    """

    file: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """The file's path."""
    sha256: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """Digest of the file's content, its first 16 digits."""
    chord: float | None = eqx.field(static=True, metadata={"unit": "m"})  # pyright: ignore[reportGeneralTypeIssues]
    """Length of the chord by whose middle the rail was measured [m]; None for displacements from a line."""

    def __init__(
        self,
        file: str | Path,
        sha256: str | None = None,
        *,
        chord: float | None = None,
        ends: str = "straight",
        ramp: Real | None = None,
    ):
        """**Arguments:** as for `load_rail` and `SampledTrack`; `sha256`: digest that the file must have.

        **Raises:** `ValueError` for a file that is no survey, or has another digest; `OSError` for none.
        """
        path = user_path(file, "file")
        content = content_of(path)
        self.file = str(file)
        self.sha256 = hashlib.sha256(content).hexdigest()[:16]
        require(
            sha256 in (None, self.sha256),
            "sha256",
            "be the content with which the scene was made",
            shown=f"another one of {file} now",
        )
        columns = _read(path, content)
        self.chord = None if chord is None else number(positive, "chord", chord, "m")
        if self.chord is not None:
            columns = _from_chords(columns, self.chord)
        super().__init__(**columns, ends=ends, ramp=ramp)
        spacing = float(self.spacing)
        wave = float(self.shortest_wavelength)
        if wave < 4 * spacing:
            warn(
                f"Argument `file`, {self.file}, is sampled every {spacing:g} m, too coarsely for waves of {wave:.2g} "
                "m: what lies between the samples is made up."
            )


def load_rail(file: str | Path, *, chord: float | None = None, **options: object) -> SurveyedTrack:
    """Read a survey of a rail.

    A CSV file has a line of names with units in brackets, such as `chainage [ft], lateral [mm], vertical [mm]`, or
    with units in the line below, and a line for each sample; `roll` is optional. Lines above the names are left out,
    and what follows #. Columns stand between commas, or between semicolons or tabs, where decimals may have commas;
    distances may be stations such as 129+773 [m]. A netCDF file has variables of these names with an attribute
    `units`, packed or not. Lateral counts positive to the left, vertical upwards, roll about x.

    **Arguments:**

    - `file`: its path. Scenes and results hold the path and a digest, by which they find the samples again.
    - `chord`: length of a chord [m] where lateral and vertical are the distances of the rail from the middle of that
        chord (versines), and not displacements from a line. Waves that the chord shows by less than a tenth, such as
        those of half its length, are left out.
    - `options`: `ends` and `ramp` of `SampledTrack`.

    **Returns:** a `SurveyedTrack`, which is a `SampledTrack`.

    **Raises:** `ValueError` with file and line for names, units or numbers that are wrong, two columns of one
    meaning, marks of missing values such as -9999, distances that do not increase, and gaps; `OSError` for a file
    that cannot be read. A warning tells displacements that are implausible, such as a level above the sea.
    """
    return SurveyedTrack(file, chord=chord, **options)


class _Column(NamedTuple):
    """A column of a file, as it is written there."""

    where: str  # file, and line of the name
    written: str
    name: str  # that of `COLUMNS`
    unit: str
    values: np.ndarray  # in its unit; NaN where there is no number


Place = Callable[[int], str]
"""Names the line or the number of a sample."""


def _read(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """Return the columns of a file by name, in SI units."""
    is_netcdf = content.startswith((_HDF5, b"CDF"))
    columns, place = _from_netcdf(path, content) if is_netcdf else _from_csv(path, content)
    written: dict[str, str] = {}
    si = {}
    for one in columns:
        if one.name in written:
            raise ValueError(f"{path}: {written[one.name]} and {one.written} are both {one.name}: leave one out.")
        written[one.name] = one.written
        good = np.isfinite(one.values)
        if not np.all(good):
            raise ValueError(f"{path}, {place(int(np.argmin(good)))}: `{one.name}` has no number.")
        try:
            si[one.name] = one.values * unit_factor(one.name, one.unit, COLUMNS[one.name])
        except ValueError as error:
            raise ValueError(f"{one.where}: {error}") from None
    if "distance" not in si or not {"lateral", "vertical"} & set(si):
        raise ValueError(f"{path} must have distance, and lateral or vertical, but has {', '.join(si) or 'neither'}.")
    _check_distances(path, si["distance"], place)
    zero = np.zeros_like(si["distance"])
    return {"lateral": zero, "vertical": zero} | si


def _check_distances(path: Path, distance: np.ndarray, place: Place) -> None:
    """Raise `ValueError` for distances that do not increase, and for gaps."""
    steps = np.diff(distance)
    if not len(steps):
        return
    if np.all(steps < 0):
        raise ValueError(
            f"{path}: distances fall, and slippers go the way they rise: reverse the rows, and change the signs of "
            "lateral and roll if left was left along the falling distance."
        )
    # the median, which a few gaps do not change
    typical = np.median(steps)
    for k, step in enumerate(steps):
        shown = ""
        if step <= 0:
            shown = f"distance {distance[k + 1]:.10g} m does not exceed {distance[k]:.10g} m"
        elif step > 3 * typical:
            shown = f"a gap of {step:g} m after {distance[k]:.10g} m, in samples every {typical:g} m"
        if shown:
            raise ValueError(f"{path}, {place(k + 1)}: {shown}.")


def _from_csv(path: Path, content: bytes) -> tuple[list[_Column], Place]:
    """Return the columns of a text, and the place of a sample."""
    lines = _decoded(path, content).splitlines()
    above, delimiter, columns = _header(path, lines)
    rows = {}  # cells of the samples, by the number of their line
    for k, line in enumerate(lines[above:], above + 1):
        sample = line.partition("#")[0]
        if sample.strip():
            rows[k] = _cells(sample, delimiter)
    if not rows:
        raise ValueError(f"{path} has no samples.")
    marks = {mark for row in rows.values() for cell in row for mark in cell}
    decimal = "," if delimiter != "," and "," in marks else "."
    if decimal == "," and "." in marks:
        raise ValueError(f"{path}: has commas and points in its numbers: write one of them, for decimals.")
    table = []
    for k, row in rows.items():
        if len(row) != len(columns):
            hint = "; decimal commas need semicolons between columns" if delimiter == "," else ""
            raise ValueError(f"{path}, line {k}: has {len(row)} values for {len(columns)} names{hint}.")
        words = [cell.replace(decimal, ".").strip() for cell in row]
        table.append([_number(f"{path}, line {k}", *pair) for pair in zip(columns, words, strict=True)])
    at = list(rows)
    values = np.array(table).T
    return [one._replace(values=v) for one, v in zip(columns, values, strict=True)], lambda k: f"line {at[k]}"


def _decoded(path: Path, content: bytes) -> str:
    """Return the text of a file in UTF-8 or Latin-1, or in UTF-16 that says so."""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    # Latin-1 takes any bytes: control characters show what is no text
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        with contextlib.suppress(UnicodeDecodeError):
            text = content.decode(encoding)
            if not re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text):  # which are in no table
                return text
    raise ValueError(f"{path} is neither a text in UTF-8, UTF-16 or Latin-1 nor a netCDF file.")


def _header(path: Path, lines: list[str]) -> tuple[int, str, list[_Column]]:
    """Return the number of lines above the samples, the mark between columns, and these, still without values.

    The line of names may come after lines of other words, and has the units, or the line below it.
    """
    names = ", ".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())
    for k, line in enumerate(lines[:200], 1):
        delimiter = next((mark for mark in ("\t", ";", ",") if mark in line), None)
        if delimiter is None or line.lstrip().startswith("#"):
            continue
        cells = _cells(line, delimiter)
        # a name, and a unit if any
        found = [re.fullmatch(r"\s*([A-Za-z_]+)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*", cell) for cell in cells]
        known = ["" if match is None else _name(match[1]) for match in found]
        # other words above the samples may name one column by chance
        if sum(name in COLUMNS for name in known) < 2:
            continue
        units = [match and match[2] for match in found]
        below = _cells(lines[k], delimiter) if k < len(lines) else []
        is_unit = lambda cell: re.fullmatch(r"\s*[\[(]?\s*(?:[^\W\d_]+|°)\s*[\])]?\s*", cell)
        in_line_below = not any(units) and len(below) == len(cells) and all(map(is_unit, below))
        if in_line_below:
            units = [cell.strip().strip("[]()") for cell in below]
        where = f"{path}, line {k}"
        columns = []
        for cell, name, unit in zip(cells, known, units, strict=True):
            if unit is None or name not in COLUMNS:
                raise ValueError(f"{where}: {brief(cell.strip())} is no name with a unit, such as {names}.")
            columns.append(_Column(where, cell.strip(), name, unit, np.empty(0)))
        return k + in_line_below, delimiter, columns
    raise ValueError(f"{path} has no line of names with units, such as {names}, between commas, semicolons or tabs.")


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; none where one is longer than any name."""
    with contextlib.suppress(csv.Error):
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return []


def _name(text: str) -> str:
    return ALIASES.get(text.lower(), text.lower())


def _number(where: str, column: _Column, words: str) -> float:
    """Return the number in a cell, NaN for a mark of none; a distance with a plus inside as `STATIONS` says."""
    if words in MISSING:
        return np.nan
    station = re.fullmatch(r"(\d+)\+((\d+)(\.\d*)?)", words) if column.name == "distance" else None
    before = 0.0
    after = words
    also = ""
    if station is not None:
        before = float(station[1]) * STATIONS.get((column.unit, len(station[3])), np.nan)
        after = station[2]
        also = ", or as 129+773 in m, or as 1297+73 in ft"
    try:
        # Python reads an underscore as a mark of thousands
        value = before + float(after.replace("_", "?"))
    except ValueError:
        value = np.nan
    if np.isnan(value):
        raise ValueError(f"{where}: `{column.name}` must be a number{also}, but is {brief(words)}.")
    return value


def _from_netcdf(path: Path, content: bytes) -> tuple[list[_Column], Place]:
    """Return the columns of a netCDF file, unpacked, and the place of a sample."""
    import xarray as xr  # here, because importing it takes time

    is_hdf5 = content.startswith(_HDF5)
    engine = dict(engine="h5netcdf", phony_dims="sort") if is_hdf5 else dict(engine="scipy")
    # the bytes that have the digest, and not the file again
    with readable(path, "netCDF file"), xr.open_dataset(io.BytesIO(content), decode_times=False, **engine) as ds:
        found = {str(key): ds[key].load() for key in ds.variables if _name(str(key)) in COLUMNS}
    columns = [_variable(path, key, array) for key, array in found.items()]
    if len({len(one.values) for one in columns}) > 1:
        raise ValueError(f"{path}: {', '.join(found)} must have one length.")
    return columns, lambda sample: f"sample {sample}"


def _variable(path: Path, key: str, array: "xr.DataArray") -> _Column:
    """Return a variable of a netCDF file as a column."""
    where = f"{path}: {key}"
    unit = str(array.attrs.get("units", ""))
    require(unit, where, "have an attribute `units`", shown="none")
    require(
        array.ndim == 1 and array.size > 0 and array.dtype.kind in "fiu",
        where,
        "be numbers along one dimension",
        shown=f"{array.dtype} of shape {array.shape}",
    )
    require(
        array.attrs.get("positive") != "down",
        where,
        "be positive upwards: change its signs and the attribute",
        shown="downwards",
    )
    return _Column(where, key, _name(key), unit, np.asarray(array.values, float))


def _from_chords(columns: dict[str, np.ndarray], chord: float) -> dict[str, np.ndarray]:
    """Return displacements from distances to the middle of a chord, see `load_rail`."""
    distance = columns["distance"]
    steps = np.diff(distance)
    require(
        np.ptp(steps) <= 2 * EQUAL_SPACING * steps.mean(),
        "chord",
        "be None where samples are not equally spaced",
        chord,
    )
    count = 2 * len(steps)
    k = np.fft.rfftfreq(count, steps.mean())
    # a sine of amplitude one has middles of chords as high as this
    gain = 1 - np.cos(np.pi * k * chord)
    seen = gain > 0.1  # waves that the chord hardly shows would be noise
    inverse = np.where(seen, 1 / np.where(seen, gain, 1.0), 0.0)
    out = dict(columns)
    for name in ("lateral", "vertical"):
        # less the line through both ends, which no chord shows, and continued oddly, so that both ends meet
        odd = columns[name] - np.linspace(columns[name][0], columns[name][-1], len(distance))
        waves = np.fft.rfft(np.append(odd[:-1], -odd[:0:-1]))
        found = np.fft.irfft(waves * inverse, n=count)
        out[name] = np.append(found, found[:1])[: len(distance)]
    return out
