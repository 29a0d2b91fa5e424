"""Surveyed rails: tables in CSV or netCDF files with units in their headers, as tracks that know their files."""

import csv
import hashlib
import re
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ..tools.checks import brief, number, positive, require, shown_number, warn
from ..tools.units import unit_factor
from .rails import EQUAL_SPACING, SampledTrack

COLUMNS = {"distance": "m", "lateral": "m", "vertical": "m", "roll": "rad"}
"""Columns of a survey, and the kinds of their units."""
ALIASES = {"chainage": "distance", "station": "distance", "x": "distance", "y": "lateral", "z": "vertical"}
"""Other names of columns."""
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
        if not Path(file).is_file():
            raise FileNotFoundError(f"No such file: {file}")
        content = Path(file).read_bytes()
        self.file, self.sha256 = str(file), hashlib.sha256(content).hexdigest()[:16]
        need = "be the content with which the scene was made"
        require(sha256 in (None, self.sha256), "sha256", need, shown=f"another one of {file} now")
        columns = _read(Path(file), content)
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

    A CSV file has a line of names with units in brackets, such as `chainage [ft], lateral [mm], vertical [mm]`, and a
    line for each sample; `roll` is optional, and lines that begin with # are left out. A netCDF-4 file has variables
    of these names with an attribute `units`. Lateral counts positive to the left, vertical upwards, roll about x.

    **Arguments:**

    - `file`: its path. Scenes and results hold the path and a digest, by which they find the samples again.
    - `chord`: length of a chord [m] where lateral and vertical are the distances of the rail from the middle of that
        chord (versines), and not displacements from a line. Waves that the chord shows by less than a tenth, such as
        those of half its length, are left out.
    - `options`: `ends`, `ramp` and `reference_length` of `SampledTrack`.

    **Returns:** a `SurveyedTrack`, which is a `SampledTrack`.

    **Raises:** `ValueError` with file and line for names, units or numbers that are wrong, distances that do not
    increase, and gaps; `OSError` for a file that cannot be read.
    """
    return SurveyedTrack(file, chord=chord, **options)


def _read(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """Returns the columns of a file by name, in SI units."""
    columns = _from_netcdf(path) if content.startswith(b"\x89HDF") else _from_csv(path, content)
    distance = columns["distance"]
    steps, line = np.diff(distance), lambda k: columns["line"][k] if "line" in columns else k
    back = np.flatnonzero(steps <= 0)
    if len(back):
        k = back[0]
        raise ValueError(
            f"{path}, line {line(k + 1):g}: distance {distance[k + 1]:g} m does not exceed {distance[k]:g} m."
        )
    wide = np.flatnonzero(steps > LARGEST_GAP * np.median(steps)) if len(steps) else steps
    if len(wide):
        k = wide[0]
        raise ValueError(
            f"{path}, line {line(k + 1):g}: a gap of {steps[k]:g} m after {distance[k]:g} m, in samples every "
            f"{np.median(steps):g} m."
        )
    columns.pop("line", None)
    return columns


def _from_csv(path: Path, content: bytes) -> dict[str, np.ndarray]:
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path} is neither a text in UTF-8 nor a netCDF-4 file.") from None
    rows = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise ValueError(f"{path} has no lines.")
    (header_line, header), *rows = rows
    delimiter = next((d for d in ("\t", ";", ",") if d in header), None)
    if delimiter is None:
        raise ValueError(f"{path}, line {header_line}: names must be separated by commas, semicolons or tabs.")
    names = [_column(path, header_line, text) for text in next(csv.reader([header], delimiter=delimiter))]
    values = np.empty((len(rows), len(names)))
    for k, (line, text) in enumerate(rows):
        cells = next(csv.reader([text], delimiter=delimiter))
        if len(cells) != len(names):
            raise ValueError(f"{path}, line {line}: has {len(cells)} values for {len(names)} names.")
        for j, (cell, (name, _)) in enumerate(zip(cells, names, strict=True)):
            try:
                values[k, j] = float(cell)
            except ValueError:
                shown = brief(cell) if cell.strip() else "missing"
                raise ValueError(f"{path}, line {line}: `{name}` must be a number, but is {shown}.") from None
        if not np.all(np.isfinite(values[k])):
            raise ValueError(f"{path}, line {line}: has a number that is not finite.")
    columns = {name: factor * values[:, j] for j, (name, factor) in enumerate(names)}
    return _complete(path, columns) | {"line": np.array([line for line, _ in rows], float)}


def _column(path: Path, line: int, text: str) -> tuple[str, float]:
    """Returns the name of a column, and the SI units in one of its units."""
    match = re.fullmatch(r"\s*([A-Za-z_]+)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*", text)
    name = "" if match is None else ALIASES.get(match[1].lower(), match[1].lower())
    if match is None or name not in COLUMNS:
        names = ", ".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())
        raise ValueError(f"{path}, line {line}: {brief(text.strip())} is no name with a unit, such as {names}.")
    try:
        return name, unit_factor(name, match[2], COLUMNS[name])
    except ValueError as error:
        raise ValueError(f"{path}, line {line}: {error}") from None


def _from_netcdf(path: Path) -> dict[str, np.ndarray]:
    import h5py  # here, because importing it takes time that other files need not spend

    columns = {}
    with h5py.File(path, "r") as file:
        for key in map(str, file):
            name = ALIASES.get(key.lower(), key.lower())
            if name in COLUMNS:
                unit = file[key].attrs.get("units", b"")
                unit = unit.decode() if isinstance(unit, bytes) else str(unit)
                require(unit, f"{path}: {key}", "have an attribute `units`", shown="none")
                columns[name] = np.asarray(file[key], float) * unit_factor(name, unit, COLUMNS[name])
    for name, array in columns.items():
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise ValueError(f"{path}: `{name}` has no number at sample {bad[0]}.")
    return _complete(path, columns)


def _complete(path: Path, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns columns with zeros for one direction that a file leaves out."""
    if "distance" not in columns or not {"lateral", "vertical"} & set(columns):
        raise ValueError(
            f"{path} must have distance, and lateral or vertical, but has {', '.join(columns) or 'neither'}."
        )
    zero = np.zeros_like(columns["distance"])
    return {"lateral": zero, "vertical": zero} | columns


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
