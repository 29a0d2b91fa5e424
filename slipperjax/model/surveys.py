"""Surveyed rails: tables in CSV or netCDF files with units in their headers, as tracks that know their files."""

import codecs
import contextlib
import csv
import hashlib
import io
import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ..tools.checks import brief, number, numbers, positive, require, shown_number, warn
from ..tools.files import content_of, readable, user_path
from ..tools.units import unit_factor
from .rails import EQUAL_SPACING, SampledTrack

COLUMNS = {"distance": "m", "lateral": "m", "vertical": "m", "roll": "rad"}
"""Columns of a survey, and the kinds of their units."""
ALIASES = {"chainage": "distance", "station": "distance", "x": "distance", "y": "lateral", "z": "vertical"}
"""Other names of columns."""
PLAUSIBLE = {"lateral": 1.0, "vertical": 1.0, "roll": 0.5}
"""Greatest plausible magnitudes of columns [m, m, rad]: a level above the sea is no displacement."""
MISSING = (-9999.0, -99999.0)
"""Numbers that stand for none in many files, whatever the unit."""
STATIONS = {("m", 3): 1000.0, ("m", 4): 1000.0, ("ft", 2): 100.0}
"""What a distance such as 129+773 counts before its plus, by its unit and the digits after: kilometres, or feet."""
NAMED = r"\s*([A-Za-z_]+)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*"
"""A name, and a unit if any."""
UNIT = r"\s*[\[(]?\s*(?:[^\W\d_]+|°)\s*[\])]?\s*"
"""A unit in a line of units."""
CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")
"""Characters that are in no table."""
NETCDF = (b"\x89HDF", b"CDF")
"""Beginnings of netCDF files: of version 4, and of those before."""
MOST_LINES_BEFORE = 200
"""Lines within which the names must stand."""
MOST_SAMPLES = 50_000_000
"""Most samples of a survey."""
LARGEST_GAP = 3.0
"""Distance between neighbours that is a gap, over the median of all."""
COARSE = 4.0
"""Samples per typical wavelength below which a survey is too coarse."""
LEAST_GAIN = 0.1
"""Share of a wave that chords must show for the wave to be recovered from them."""


class SurveyedTrack(SampledTrack):
    """A track of samples in a file, see `slipperjax.load_rail`.

    Descriptions of scenes hold the file's name and digest, and not the samples.
    """

    file: str = eqx.field(static=True)
    """The file's path."""
    sha256: str = eqx.field(static=True)
    """Digest of the file's content, its first 16 digits."""
    chord: float | None = eqx.field(static=True, metadata={"unit": "m"})
    """Length of the chord by whose middle the rail was measured [m]; None for displacements from a line."""

    def __init__(
        self,
        file: Any,
        sha256: str | None = None,
        *,
        chord: float | None = None,
        ends: str = "straight",
        ramp: Any = None,
        reference_length: Any = None,
    ):
        """**Arguments:** as for `load_rail` and `SampledTrack`; `sha256`: digest that the file must have.

        **Raises:** `ValueError` for a file that is no survey, or has another digest; `OSError` for none.
        """
        path = user_path(file, "file")
        content = content_of(path)
        self.file, self.sha256 = str(file), hashlib.sha256(content).hexdigest()[:16]
        need = "be the content with which the scene was made"
        require(sha256 in (None, self.sha256), "sha256", need, shown=f"another one of {file} now")
        columns = _read(path, content)
        self.chord = None if chord is None else number(positive, "chord", chord, "m")
        if self.chord is not None:
            columns = _from_chords(columns, self.chord)
        super().__init__(**columns, ends=ends, ramp=ramp, reference_length=reference_length)
        _check_sampling(self)

    def __repr__(self) -> str:
        ends = f"{shown_number(self.distance)} m, {len(self.lateral)} samples, ends='{self.ends}'"
        return f"SurveyedTrack('{self.file}', {ends})"


def load_rail(file: Any, *, chord: float | None = None, **options: Any) -> SurveyedTrack:
    """Reads a survey of a rail.

    A CSV file has a line of names with units in brackets, such as `chainage [ft], lateral [mm], vertical [mm]`, or
    with units in the line below, and a line for each sample; `roll` is optional. Lines above the names are left out,
    and lines that begin with #. Columns stand between commas, or between semicolons or tabs, where decimals may have
    commas; distances may be stations such as 129+773 [m]. A netCDF file has variables of these names with an
    attribute `units`, packed or not. Lateral counts positive to the left, vertical upwards, roll about x.

    **Arguments:**

    - `file`: its path. Scenes and results hold the path and a digest, by which they find the samples again.
    - `chord`: length of a chord [m] where lateral and vertical are the distances of the rail from the middle of that
        chord (versines), and not displacements from a line. Waves that the chord shows by less than a tenth, such as
        those of half its length, are left out.
    - `options`: `ends`, `ramp` and `reference_length` of `SampledTrack`.

    **Returns:** a `SurveyedTrack`, which is a `SampledTrack`.

    **Raises:** `ValueError` with file and line for names, units or numbers that are wrong, two columns of one
    meaning, marks of missing values such as -9999, distances that do not increase, and gaps; `OSError` for a file
    that cannot be read. A warning names the line of a displacement that is implausible, such as a level of the sea.
    """
    return SurveyedTrack(file, chord=chord, **options)


class _Column(NamedTuple):
    """A column of a file, as it is written there."""

    written: str  # its name in the file
    name: str  # that of `COLUMNS`
    unit: str
    values: np.ndarray  # in its unit; NaN where there is no number


def _read(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """Returns the columns of a file by name, in SI units."""
    is_netcdf = content.startswith(NETCDF)
    columns, place = _from_netcdf(path, content) if is_netcdf else _from_csv(path, content)
    for k, one in enumerate(columns):
        for other in columns[:k]:
            if other.name == one.name:
                raise ValueError(f"{path}: {other.written} and {one.written} are both {one.name}: leave one out.")
    si = {}
    for one in columns:
        for bad, words in ((~np.isfinite(one.values), "no number"), (np.isin(one.values, MISSING), "a mark of none")):
            if np.any(bad):
                raise ValueError(f"{path}, {place(int(np.argmax(bad)))}: `{one.name}` has {words}.")
        si[one.name] = one.values * unit_factor(one.name, one.unit, COLUMNS[one.name])
        far = np.abs(si[one.name]) - PLAUSIBLE.get(one.name, np.inf)
        if np.max(far) > 0:
            k = int(np.argmax(far))
            warn(
                f"{path}, {place(k)}: `{one.name}` is {one.values[k]:g} {one.unit}; plausible are displacements of "
                f"{PLAUSIBLE[one.name]:g} {COLUMNS[one.name]} at most. Are the unit and the column right?"
            )
    if "distance" not in si or not {"lateral", "vertical"} & set(si):
        found = ", ".join(si) or "neither"
        raise ValueError(f"{path} must have distance, and lateral or vertical, but has {found}.")
    _check_distances(path, si["distance"], place)
    zero = np.zeros_like(si["distance"])
    return {"lateral": zero, "vertical": zero} | si


def _check_distances(path: Path, distance: np.ndarray, place: Callable[[int], str]) -> None:
    """Raises `ValueError` for distances that do not increase, and for gaps."""
    steps = np.diff(distance)
    if len(steps) and np.all(steps < 0):
        raise ValueError(
            f"{path}: distances fall, and slippers go the way they rise: reverse the rows, and change the signs of "
            "lateral and roll if left was left along the falling distance."
        )
    back = np.flatnonzero(steps <= 0)
    if len(back):
        k = int(back[0])
        shown = f"distance {distance[k + 1]:.10g} m does not exceed {distance[k]:.10g} m"
        raise ValueError(f"{path}, {place(k + 1)}: {shown}.")
    wide = np.flatnonzero(steps > LARGEST_GAP * np.median(steps)) if len(steps) else steps
    if len(wide):
        k = int(wide[0])
        shown = f"a gap of {steps[k]:g} m after {distance[k]:.10g} m, in samples every {np.median(steps):g} m"
        raise ValueError(f"{path}, {place(k + 1)}: {shown}.")


# --- CSV ------------------------------------------------------------------------------------------------------------


class _Header(NamedTuple):
    """The lines of a file above its samples."""

    lines: int  # how many there are
    delimiter: str
    columns: list[tuple[str, str, str]]  # as written, by name, and the unit


def _from_csv(path: Path, content: bytes) -> tuple[list[_Column], Callable[[int], str]]:
    """Returns the columns of a text, and a function that names the line of a sample."""
    import pandas as pd  # here, because importing it takes time

    text = _decoded(path, content)
    header = _header(path, text)
    body = io.StringIO(text, newline=None)
    for _ in range(header.lines):
        body.readline()
    samples = re.sub("#.*", "", body.read())
    decimal = "." if header.delimiter == "," or "," not in samples else ","
    if decimal == "," and "." in samples:
        raise ValueError(f"{path}: has commas and points in its numbers: write one of them, for decimals.")
    options = dict(sep=header.delimiter, decimal=decimal, header=None, skipinitialspace=True)
    options |= dict(keep_default_na=False, na_values=[""])
    try:
        table = pd.read_csv(io.StringIO(samples), **options)  # pyright: ignore[reportArgumentType, reportCallIssue]
    except pd.errors.EmptyDataError:
        raise ValueError(f"{path} has no samples.") from None
    except pd.errors.ParserError as error:
        words = re.search(r"in line (\d+), saw (\d+)", str(error))
        if words is None:
            raise ValueError(f"{path} is no table: {error}") from None
        raise _wrong_count(path, header.lines + int(words[1]), int(words[2]), header) from None

    def place(sample: int) -> str:
        shown = (k for k, line in enumerate(samples.split("\n"), 1) if line.strip())
        return f"line {header.lines + next(itertools.islice(shown, sample, None))}"

    if table.shape[1] != len(header.columns):
        raise _wrong_count(path, int(place(0).split()[1]), table.shape[1], header)
    columns = []
    for (written, name, unit), (_, cells) in zip(header.columns, table.items(), strict=True):
        columns.append(_Column(written, name, unit, _numbers(path, name, unit, cells, decimal, place)))
    return columns, place


def _wrong_count(path: Path, line: int, found: int, header: _Header) -> ValueError:
    hint = "; decimal commas need semicolons between columns" if header.delimiter == "," else ""
    return ValueError(f"{path}, line {line}: has {found} values for {len(header.columns)} names{hint}.")


def _decoded(path: Path, content: bytes) -> str:
    """Returns the text of a file in UTF-8 or Latin-1, or in UTF-16 that says so."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ("utf-16",)
    else:
        encodings = ("utf-8-sig", "latin-1")
    for encoding in encodings:
        with contextlib.suppress(UnicodeDecodeError):
            text = content.decode(encoding)
            if not CONTROL.search(text):
                return text
    raise ValueError(f"{path} is neither a text in UTF-8, UTF-16 or Latin-1 nor a netCDF file.")


def _header(path: Path, text: str) -> _Header:
    """Finds the line of names, after lines of other words if any, and the units there or in the line below."""
    delimiter, lines = None, list(itertools.islice(io.StringIO(text, newline=None), MOST_LINES_BEFORE))
    for k, line in enumerate(lines, 1):
        told = re.fullmatch(r'\s*"?sep=(.)"?\s*', line, re.IGNORECASE)
        delimiter = told[1] if told else delimiter
        if told or line.lstrip().startswith("#"):
            continue
        mark = delimiter or next((d for d in ("\t", ";", ",") if d in line), None)
        cells = [] if mark is None else _cells(line, mark)
        found = [re.fullmatch(NAMED, cell) for cell in cells]
        known = [match is not None and _name(match[1]) in COLUMNS for match in found]
        if mark is None or sum(known) < 2:
            continue
        units = [match and match[2] for match in found]
        below = _cells(lines[k], mark) if k < len(lines) else []
        in_line_below = not any(units) and len(below) == len(cells) and all(re.fullmatch(UNIT, c) for c in below)
        if in_line_below:
            units = [cell.strip().strip("[]()") for cell in below]
        columns = [_column(path, k, *one) for one in zip(cells, found, units, strict=True)]
        return _Header(k + in_line_below, mark, columns)
    names = ", ".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())
    raise ValueError(f"{path} has no line of names with units, such as {names}, between commas, semicolons or tabs.")


def _cells(line: str, delimiter: str) -> list[str]:
    """Returns the cells of a line; none where one is longer than any name."""
    with contextlib.suppress(csv.Error):
        return next(csv.reader([line.strip("\r\n")], delimiter=delimiter), [])
    return []


def _name(text: str) -> str:
    return ALIASES.get(text.lower(), text.lower())


def _column(path: Path, line: int, cell: str, match: re.Match | None, unit: str | None) -> tuple[str, str, str]:
    """Returns a column as it is written, its name and its unit."""
    name = "" if match is None else _name(match[1])
    if match is None or unit is None or name not in COLUMNS:
        names = ", ".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())
        raise ValueError(f"{path}, line {line}: {brief(cell.strip())} is no name with a unit, such as {names}.")
    try:
        unit_factor(name, unit, COLUMNS[name])
    except ValueError as error:
        raise ValueError(f"{path}, line {line}: {error}") from None
    return cell.strip(), name, unit


def _numbers(path: Path, name: str, unit: str, cells: Any, decimal: str, place: Callable[[int], str]) -> np.ndarray:
    """Returns the cells of a column as numbers, those with a plus inside as `STATIONS` says."""
    refused = lambda k, shown, also="": ValueError(
        f"{path}, {place(k)}: `{name}` must be a number{also}, but is {shown}."
    )
    if cells.isna().any():
        raise refused(int(np.argmax(cells.isna())), "missing")
    if cells.dtype.kind in "fiu":
        return cells.to_numpy(float)
    values = np.empty(len(cells))
    for k, cell in enumerate(cells):
        words = str(cell).replace(decimal, ".").strip()
        station = re.fullmatch(r"(\d+)\+(\d+)(\.\d*)?", words) if name == "distance" else None
        if station is not None and (unit, len(station[2])) not in STATIONS:
            raise refused(k, brief(cell), ", or as 129+773 in m, or as 1297+73 in ft")
        try:
            if "_" in words:  # which Python reads as thousands
                raise ValueError
            values[k] = float(words if station is None else station[2] + (station[3] or ""))
        except ValueError:
            raise refused(k, brief(cell)) from None
        if station is not None:
            values[k] += STATIONS[unit, len(station[2])] * int(station[1])
    return values


# --- netCDF ---------------------------------------------------------------------------------------------------------


def _from_netcdf(path: Path, content: bytes) -> tuple[list[_Column], Callable[[int], str]]:
    """Returns the columns of a netCDF file, unpacked, and a function that names a sample."""
    import xarray as xr  # here, because importing it takes time

    how: dict[str, Any] = dict(engine="h5netcdf", phony_dims="sort")
    # scipy maps files into memory, and cannot close those that it fails to read
    source, how = (path, how) if content.startswith(NETCDF[0]) else (io.BytesIO(content), dict(engine="scipy"))
    with readable(path, "netCDF file"):
        ds = xr.open_dataset(source, decode_times=False, **how)
    with ds:
        columns = [_variable(path, key, ds[key]) for key in map(str, ds.variables) if _name(key) in COLUMNS]
    if len({len(one.values) for one in columns}) > 1:
        raise ValueError(f"{path}: {', '.join(one.written for one in columns)} must have one length.")
    return columns, lambda sample: f"sample {sample}"


def _variable(path: Path, key: str, array: Any) -> _Column:
    """Returns a variable of a netCDF file as a column."""
    unit = str(array.attrs.get("units", ""))
    require(unit, f"{path}: {key}", "have an attribute `units`", shown="none")
    good = array.ndim == 1 and 0 < array.size <= MOST_SAMPLES and array.dtype.kind in "fiu"
    need = f"be numbers along one dimension, {MOST_SAMPLES} at most"
    require(good, f"{path}: {key}", need, shown=f"{array.dtype} of shape {array.shape}")
    down = array.attrs.get("positive", "up") == "down"
    require(not down, f"{path}: {key}", "be positive upwards: change its signs and the attribute", shown="downwards")
    with readable(path, "netCDF file"):
        values = np.asarray(array.values, float)
    low, high = _valid(path, key, array)
    return _Column(key, _name(key), unit, np.where((low <= values) & (values <= high), values, np.nan))


def _valid(path: Path, key: str, array: Any) -> tuple[float, float]:
    """Returns the ends of the valid range of a variable, which files give for packed numbers."""
    ends = [array.attrs.get("valid_min", -np.inf), array.attrs.get("valid_max", np.inf)]
    packed = numbers(f"valid range of {key}", array.attrs.get("valid_range", ends), 1)
    require(packed.shape == (2,), f"valid range of {key}", "be two numbers", packed)
    low, high = np.sort(array.encoding.get("scale_factor", 1.0) * packed + array.encoding.get("add_offset", 0.0))
    return float(low), float(high)


# --- chords ---------------------------------------------------------------------------------------------------------


def _from_chords(columns: dict[str, np.ndarray], chord: float) -> dict[str, np.ndarray]:
    """Returns displacements from distances to the middle of a chord, see `load_rail`."""
    distance = columns["distance"]
    steps = np.diff(distance)
    even = np.ptp(steps) <= 2 * EQUAL_SPACING * steps.mean()
    require(even, "chord", "be None where samples are not equally spaced", chord)
    count = 2 * len(steps)
    k = np.fft.rfftfreq(count, steps.mean())
    gain = 1 - np.cos(np.pi * k * chord)
    seen = gain > LEAST_GAIN
    out = dict(columns)
    for name in ("lateral", "vertical"):
        # less the line through both ends, which no chord shows, and continued oddly, so that both ends meet
        odd = columns[name] - np.linspace(columns[name][0], columns[name][-1], len(distance))
        waves = np.fft.rfft(np.append(odd[:-1], -odd[:0:-1]))
        found = np.fft.irfft(np.where(seen, waves / np.where(seen, gain, 1.0), 0.0), n=count)
        out[name] = np.append(found, found[:1])[: len(distance)]
    return out


def _check_sampling(track: SurveyedTrack) -> None:
    """Warns where the samples are too far apart for what they show."""
    spacing, wave = float(track.spacing), float(track.shortest_wavelength)
    if wave < COARSE * spacing:
        warn(
            f"Argument `file`, {track.file}, is sampled every {spacing:g} m, too coarsely for waves of {wave:.2g} m: "
            f"what lies between the samples is made up."
        )
