"""Tables in files, CSV or netCDF: columns with units in their headers, and all faults of a file at once."""

import codecs
import contextlib
import csv
import io
import re
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .checks import brief, require, warn
from .files import content_of, listed, readable, user_path
from .units import unit_factor

if TYPE_CHECKING:
    import xarray as xr

MISSING = ("", "-", "nan", "na", "n/a", "#n/a", "null", "none", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind")
"""Cells that mean "no number", in small letters."""
MISSING_NUMBERS = (-9999.0, -99999.0)
"""Numbers that mean "no number"."""
OVERLOAD = ("ol", "ovl", "ovld", "over", "overload", "overrange", "inf", "+inf", "-inf", "1.#inf", "-1.#inf")
"""Cells that mean a number which the instrument could not measure, in small letters."""
OVERLOADED = 1e30
"""Magnitude from which a number means "not measured": instruments write 9.9E37, and netCDF files write 9.97e36 for a
missing number."""
STATION = r"(\d+)\+((\d+)([.,]\d*)?)"
"""Form of a station: counts, a plus, and the remaining distance."""
STATIONS = {(1.0, 3): 1000.0, (1.0, 4): 1000.0, (0.3048, 2): 100.0}
"""Value of one count before the plus of a station such as 129+773, in the station's unit, by this unit [m] and the
number of digits after the plus."""
MOST_SHOWN = 10
"""Number of faults, and of other names of columns, that an error shows."""
WAYS = {
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save its sheet as CSV"),
    **dict.fromkeys((".gz", ".zip", ".xz", ".7z"), "unpack it first"),
    **dict.fromkeys((".tdms", ".mf4", ".dat", ".rsp"), "export its channels as CSV, with units"),
    **dict.fromkeys((".unv", ".uff"), "load_modes reads its modes"),
    **dict.fromkeys((".f06", ".op2", ".rst", ".odb"), "export its modes as CSV, with the modal masses"),
}
"""Advice for files of other kinds, by their endings."""
Wanted = Mapping[str, str] | Callable[[Set[str]], Mapping[str, str]]
"""SI units of columns by name, or a function that returns the units for the names of all columns of a file."""
_HDF5 = b"\x89HDF"  # the beginning of netCDF files of version 4
_FILE = -1  # in place of a row: the file as a whole


def _count_of_station(name: str, unit: str, digits: int) -> float:
    """Return the value of one count before a station's plus, in the unit; NaN where it is unknown."""
    return STATIONS.get((round(unit_factor(name, unit, "m"), 4), digits), np.nan)


def station(name: str, text: str, unit: str) -> float:
    """Return the distance of a station such as 8+00 [m]; `unit`: of stations, ft or m.

    **Raises:** `ValueError` for a text that is no station in this unit.
    """
    match = re.fullmatch(STATION, text.strip())
    value = np.nan
    if match is not None:
        value = float(match[1]) * _count_of_station(name, unit, len(match[3])) + float(match[2].replace(",", "."))
    need = f"be a station in {unit}, such as 129+773 in m or 1297+73.5 in ft"
    require(np.isfinite(value), name, need, text)
    return value * unit_factor(name, unit, "m")


def without_marks(values: np.ndarray, name: str) -> np.ndarray:
    """Return numbers with NaN in place of marks of overload, with a warning; `name` is the numbers' name in it."""
    marks = np.abs(values) >= OVERLOADED
    if not marks.any():
        return values
    warn(f"{name} has marks of overload, such as {values[marks][0]:g}: {marks.sum()} samples count as missing.")
    return np.where(marks, np.nan, values)


class TableError(ValueError):
    """Faults of a table: one line for one fault; otherwise a line with their number, and a line for each."""


class Column(NamedTuple):
    """A column as it is in its file."""

    name: str
    unit: str | None
    """None where the file has none."""
    values: np.ndarray
    """Numbers in this unit; NaN where there is no number."""


class Table:
    """Columns of a file by the names under which they are wanted, and the faults found so far.

    A CSV file has a line of names and a line for each row. Units are in brackets after the names, such as
    `chainage [ft], lateral [mm]`, or in the line below the names. Lines above the names and text after # are ignored.
    Commas separate columns; so do semicolons or tabs, and then decimals may have commas. Distances may be stations
    such as 129+773 [m]. A netCDF file has variables of these names with an attribute `units`, packed or not. A MAT
    file has variables of these names, with units in a struct `units`, as in units.distance = 'ft'. Names may have
    capitals, and spaces or underscores between words. Columns that are not wanted are left out, and a warning names
    them.
    """

    def __init__(
        self,
        path: Path,
        content: bytes,
        wanted: Wanted,
        aliases: Mapping[str, str],
        *,
        holes: bool = False,
        labels: str = "",
    ):
        """**Arguments:** `content`: of the file `path`; `wanted`: SI units of the columns by name, "" for pure
        numbers, or a function that returns the units for the names in a file; `aliases`: names of columns by other
        names. All these names are in small letters, with underscores between words. `holes`: whether numbers may be
        missing; they are NaN then, and no fault. `labels`: name of a column of words that a text may have.

        **Raises:** `TableError` for a file without a table. `si` raises the other faults.
        """
        self.path = path
        self._wanted_of = wanted if callable(wanted) else lambda names: wanted
        self.wanted = self._wanted_of(frozenset())
        self.aliases = aliases
        self.holes = holes
        self.columns: dict[str, Column] = {}
        # name of the column of words, and its cells
        self._of_labels = labels
        self.labels: list[str] = []
        self.faults: list[tuple[int, str]] = []
        # the word for a row in errors, and the number of each row
        self.row = "line"
        self.numbers: list[int] = []
        # number of the line with the units
        self.header = _FILE
        read = self._read_text
        if content.startswith((_HDF5, b"CDF")):
            read = self._read_netcdf
        elif content.startswith(b"MATLAB"):
            read = self._read_mat
        unread = read(content)
        if unread:
            warn(f"File {path} has columns that are not read: {listed(unread)}.")

    def fault(self, text: str, number: int = _FILE) -> None:
        """Note a fault of the row with this number, or else of the file."""
        self.faults.append((number, text))

    def check_rising(self, name: str, *, also: str = "") -> None:
        """Note where a column does not increase.

        **Arguments:** `also`: advice in addition to reversing the rows of a column that falls.
        """
        column = self.columns[name]
        known = np.flatnonzero(np.isfinite(column.values))
        values = column.values[known]
        if len(values) < 2:
            return
        steps = np.diff(values)
        # the median, because a few faults do not change it
        if np.median(steps) < 0:
            self.fault(f"`{column.name}` falls from row to row: reverse the rows{also}")
            return
        unit = f" {column.unit}" if column.unit else ""
        numbers = [self.numbers[k] for k in known]
        for k in np.flatnonzero(steps <= 0):
            before = f"{values[k]:.10g}{unit}"
            text = f"{column.name} {values[k + 1]:.10g}{unit} does not exceed {before} of {self.row} {numbers[k]}"
            self.fault(text, numbers[k + 1])

    def si(self) -> dict[str, np.ndarray]:
        """Return the columns in SI units by the names under which they were wanted.

        **Raises:** `TableError` with all faults, if there are any.
        """
        found = {}
        for name, column in self.columns.items():
            # a column without a unit is a fault of its own, or has pure numbers
            try:
                factor = 1.0 if column.unit is None else unit_factor(column.name, column.unit, self.wanted[name])
                values = column.values
                if self.holes:
                    values = without_marks(values, f"File {self.path}: `{column.name}`")
                found[name] = values * factor
            except ValueError as error:
                self.fault(str(error), self.header)
        if self.faults:
            raise self._error()
        return found

    def _error(self) -> TableError:
        """Return the faults as an error, in the order of the file."""
        faults = sorted(self.faults, key=lambda fault: fault[0])
        texts = [f"{'' if k == _FILE else f', {self.row} {k}'}: {text.rstrip('.')}." for k, text in faults]
        if len(texts) == 1:
            return TableError(f"{self.path}{texts[0]}")
        lines = [f"{self.path} has {len(texts)} faults:", *(self.path.name + text for text in texts[:MOST_SHOWN])]
        if len(texts) > MOST_SHOWN:
            lines.append(f"and {len(texts) - MOST_SHOWN} more.")
        return TableError("\n  ".join(lines))

    def _plain(self, text: str) -> str:
        """Return a name in small letters with underscores between words, or the name of which it is an alias."""
        plain = "_".join(text.lower().replace("_", " ").split())
        return self.aliases.get(plain, plain)

    def _name(self, text: str) -> str:
        """Return the name under which a column is wanted; empty for another."""
        name = self._plain(text)
        return name if name in (*self.wanted, self._of_labels) else ""

    def _add(self, name: str, column: Column) -> None:
        """Add a column, unless there is already one of the same meaning."""
        if name in self.columns:
            self.fault(f"{self.columns[name].name} and {column.name} are both {name}: leave one out", self.header)
        else:
            self.columns[name] = column

    def _read_text(self, content: bytes) -> list[str]:
        """Read the columns of a text, and return the names of those that are not wanted."""
        lines = self._decoded(content).splitlines()
        above, delimiter, heads = self._heads(lines)
        # place in a row of each wanted column
        at = {i: head for i, head in enumerate(heads) if head.name in self.wanted}
        rows = []
        for k, line in enumerate(lines[above:], above + 1):
            sample = _REMARK.split(line, maxsplit=1)[0]
            # spreadsheets end with rows of empty cells
            if not sample.strip(f"{delimiter} \t"):
                continue
            row = _cells(sample, delimiter)
            self.numbers.append(k)
            words = zip(row, heads, strict=False)
            self.labels += [cell.strip() for cell, head in words if head.name and head.name not in self.wanted]
            # unwanted cells at the end of a row may be missing
            if max(at) < len(row) <= len(heads):
                rows.append({i: row[i].strip() for i in at})
                continue
            hint = "; decimal commas need semicolons between columns, remarks with commas quotes"
            self.fault(f"has {len(row)} values for {len(heads)} names{hint if delimiter == ',' else ''}", k)
            rows.append({})
        if not rows:
            raise TableError(f"{self.path} has no samples.")
        marks = "".join(cell for row in rows for cell in row.values())
        decimal = "," if delimiter != "," and marks.count(",") > marks.count(".") else "."
        for i, head in at.items():
            values = [self._number(head, row.get(i), decimal, k) for k, row in zip(self.numbers, rows, strict=True)]
            self._add(head.name, Column(head.written, head.unit, np.array(values)))
        return [head.written for head in heads if head.written and not head.name]

    def _decoded(self, content: bytes) -> str:
        """Return a text in UTF-8 or Windows-1252, or in UTF-16 with a byte order mark."""
        wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        # Windows-1252 (with Latin-1) accepts nearly any bytes, so that control characters show that a file is no text
        for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
            with contextlib.suppress(UnicodeDecodeError):
                text = content.decode(encoding)
                if not re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text):  # no table has these characters
                    return text
        kinds = "neither a text in UTF-8, UTF-16 or Windows-1252 nor a netCDF or MAT file"
        raise TableError(f"{self.path} is {kinds}{self._way()}.")

    def _heads(self, lines: list[str]) -> tuple[int, str, list["_Head"]]:
        """Return the number of lines above the rows, the mark between columns, and the heads of the columns.

        The line of names may come after lines of other words, and has the units, or the next line has them. The line
        of names may begin with # where no other line has names.
        """
        for behind_mark in (False, True):
            for k, line in enumerate(lines[:200], 1):
                words = line.lstrip(" \t#") if behind_mark else line
                delimiter = _delimiter(words)
                if delimiter is None or words.lstrip().startswith("#"):
                    continue
                written = [_written(cell) for cell in _cells(words, delimiter)]
                self.wanted = self._wanted_of({self._plain(name) for name, _ in written})
                heads = [_Head(self._name(name), name, unit) for name, unit in written]
                # other words above the table may be the name of one column by chance
                if sum(head.name != "" for head in heads) > 1:
                    below = _cells(lines[k].lstrip(" \t#"), delimiter) if k < len(lines) else []
                    with_units = self._with_units(heads, below, k)
                    return k + (with_units is not heads), delimiter, with_units
        need = f"names with units, such as {self._names()}, between commas, semicolons or tabs"
        others = f"; other names are {listed(list(self.aliases)[:MOST_SHOWN])}" if self.aliases else ""
        read = next((line for line in lines if _delimiter(line)), lines[0] if lines else "")
        begins = f"It begins with {brief(read.strip())}{self._way()}"
        raise TableError(f"{self.path} has no line of {need}{others}. {begins}.")

    def _way(self) -> str:
        """Return advice for a file that is no table, by its ending; empty where the ending is unknown."""
        way = WAYS.get(self.path.suffix.lower())
        return f": {way}" if way else ""

    def _with_units(self, heads: list["_Head"], below: list[str], k: int) -> list["_Head"]:
        """Return the heads with units from the cells `below` the k-th line, or `heads` where these are no units."""
        cells = [*below, *[""] * len(heads)]
        measured = [(head, cell) for head, cell in zip(heads, cells, strict=False) if self.wanted.get(head.name)]
        self.header = k
        if measured and all(head.unit is None and _UNIT.fullmatch(cell) for head, cell in measured):
            return [head._replace(unit=cell.strip(" []()")) for head, cell in zip(heads, cells, strict=False)]
        for head, _ in measured:
            if head.unit is None:
                self.fault(f"{brief(head.written)} is no name with a unit, such as {self._names()}", k)
        return heads

    def _names(self) -> str:
        return ", ".join(f"{name} [{unit}]" if unit else name for name, unit in self.wanted.items())

    def _number(self, head: "_Head", words: str | None, decimal: str, line: int) -> float:
        """Return the number in a cell, for a station by `STATIONS`; NaN where there is none, which is a fault unless
        there is no cell."""
        if words is None:
            return np.nan
        if words.lower() in MISSING:
            return self._none(head.written, line)
        if words.lower() in OVERLOAD:
            return self._overload(head.written, words, line)
        before = 0.0
        after = words
        hint = ""
        station = re.fullmatch(STATION, words)
        if station is not None:
            before = float(station[1]) * self._before_plus(head, len(station[3]))
            after = station[2]
            hint = ", or as 129+773 in m, or as 1297+73 in ft"
        other = "." if decimal == "," else ","
        if other in words:
            hint = f", with decimal {'commas' if decimal == ',' else 'points'}"
        with contextlib.suppress(ValueError):
            # Python reads an underscore as a mark of thousands
            value = before + float(after.replace(other, "?").replace(decimal, ".").replace("_", "?"))
            if value in MISSING_NUMBERS:
                return self._none(head.written, line)
            if abs(value) >= OVERLOADED:
                return self._overload(head.written, words, line)
            if np.isfinite(value):
                return value
        self.fault(f"`{head.written}` must be a number{hint}, but is {brief(words)}", line)
        return np.nan

    def _none(self, name: str, number: int) -> float:
        """Return NaN for a number that is missing in a row, which is a fault unless `holes`."""
        if not self.holes:
            self.fault(f"`{name}` has no number", number)
        return np.nan

    def _overload(self, name: str, shown: object, number: int) -> float:
        """Return infinity for a mark of overload in a row, which is a fault unless `holes`."""
        if not self.holes:
            self.fault(f"`{name}` has a mark of overload, {shown}, and no number", number)
        return np.inf

    def _before_plus(self, head: "_Head", digits: int) -> float:
        """Return the value of one count before a station's plus, in the column's unit; NaN where it is unknown."""
        with contextlib.suppress(ValueError):
            return _count_of_station(head.written, head.unit or "", digits)
        return np.nan

    def _read_netcdf(self, content: bytes) -> list[str]:
        """Read the variables of a netCDF file, unpacked, and return the names of those that are not wanted."""
        import xarray as xr  # here, because importing it takes time

        engine = {"engine": "h5netcdf", "phony_dims": "sort"} if content.startswith(_HDF5) else {"engine": "scipy"}
        with readable(self.path, "netCDF file"):
            # from `content`, because the file may have changed since
            ds = xr.open_dataset(io.BytesIO(content), decode_times=False, **engine)
        return self._take({str(key): ds[key] for key in ds.variables})

    def _read_mat(self, content: bytes) -> list[str]:
        """Read the variables of a MAT file of MATLAB 5 to 7, and return the names of those that are not wanted."""
        import scipy.io  # here, because importing them takes time
        import xarray as xr

        with readable(self.path, "MAT file of MATLAB 5 to 7, as save writes it with -v7,"):
            found = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True)
        own = found.pop("units", np.zeros((), []))
        units = {self._plain(key): str(own[key].item()) for key in own.dtype.names or ()}
        unit_of = lambda key: {"units": units.get(self._plain(key), "")}
        return self._take(
            {
                key: xr.DataArray(np.atleast_1d(array), attrs=unit_of(key))
                for key, array in found.items()
                if not key.startswith("__")
            }
        )

    def _take(self, named: Mapping[str, "xr.DataArray"]) -> list[str]:
        """Take columns from the arrays of a file, which have an attribute `units`, by the arrays' names; return the
        names of those that are not wanted."""
        self.row = "sample"
        self.wanted = self._wanted_of({self._plain(key) for key in named})
        with readable(self.path, "netCDF file"):
            arrays = {key: array.load() for key, array in named.items() if self._name(key)}
        for key, array in arrays.items():
            fault = self._fault_of(self._name(key), array)
            if fault:
                self.fault(f"`{key}` must {fault}")
        if len({array.size for array in arrays.values()}) > 1:
            self.fault(f"{', '.join(arrays)} must have one length")
        # without columns there are no other faults to find
        if self.faults:
            raise self._error()
        for key, array in arrays.items():
            values = np.asarray(array.values, float)
            self.numbers = list(range(len(values)))
            values = np.where(np.isin(values, MISSING_NUMBERS), np.nan, values)
            for k in np.flatnonzero(np.isnan(values)):
                self._none(key, int(k))
            for k in np.flatnonzero(np.abs(values) >= OVERLOADED):
                self._overload(key, f"{values[k]:g}", int(k))
            self._add(self._name(key), Column(key, array.attrs.get("units"), values))
        return [key for key in named if key not in arrays]

    def _fault_of(self, name: str, array: "xr.DataArray") -> str:
        """Return what is wrong with a variable of a netCDF file; empty where it is good."""
        if self.wanted[name] and not array.attrs.get("units"):
            return "have an attribute `units`, but has none"
        if array.ndim != 1 or not array.size or array.dtype.kind not in "fiu":
            return f"be numbers along one dimension, but is {array.dtype} of shape {array.shape}"
        if array.attrs.get("positive") == "down":
            return "be positive upwards, but is downwards: change its signs and the attribute"
        return ""


def read_rows(
    file: str | Path,
    axes: Mapping[str, str],
    values: Mapping[str, str],
    aliases: Mapping[str, str],
    content: bytes | None = None,
) -> tuple[str, dict[str, np.ndarray]]:
    """Read a table whose rows go along one of several axes: the first axis that it has, which must increase.

    **Arguments:** `axes`, `values`: SI units of the columns by name; one column of `values` is enough; `aliases`: as
    for `Table`; `content`: of the file, where it has been read.

    **Returns:** the axis and the columns.

    **Raises:** `TableError` with all faults of the file; `OSError` for a file that cannot be read.
    """
    path = user_path(file, "file")
    table = Table(path, content_of(path) if content is None else content, {**axes, **values}, aliases)
    found = [name for name in axes if name in table.columns]
    if found and set(values) & set(table.columns):
        table.check_rising(found[0])
    else:
        of = " or ".join(axes), " or ".join(values), ", ".join(table.columns) or "neither"
        table.fault("must have {}, and {}, but has {}".format(*of))
    columns = table.si()
    return found[0], columns


class _Head(NamedTuple):
    """The head of a column."""

    name: str  # name under which the column is wanted; empty for others
    written: str
    unit: str | None


def _written(cell: str) -> tuple[str, str | None]:
    """Return the name of a column, and its unit if any, from a cell such as left lateral [mm]."""
    match = re.fullmatch(r"\s*([A-Za-z_]\w*(?: +\w+)*)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*", cell)
    return (cell.strip(), None) if match is None else (match[1], match[2])


_REMARK = re.compile(r"(?<!1\.)#(?!N/A)")
"""The mark of remarks; # in 1.#INF and #N/A is no such mark."""
_UNIT = re.compile(r"\s*[\[(]?\s*(?:[^\W\d_][\w/^*.·\s-]*|°)\s*[\])]?\s*")
"""A cell of the line of units."""


def _delimiter(line: str) -> str | None:
    """Return the mark between the columns of a line; None where it has one column."""
    return next((mark for mark in ("\t", ";", ",") if mark in line), None)


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; no cells where one is longer than any name."""
    with contextlib.suppress(csv.Error):
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return []
