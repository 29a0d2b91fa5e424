"""What was measured on a track: surveys of rails, as tracks that know their files, and histories of speeds."""

import hashlib
from pathlib import Path

import equinox as eqx
import numpy as np

from ..tools.checks import finite, number, positive, require, warn
from ..tools.fields import unit_of
from ..tools.files import content_of, user_path
from ..tools.tables import Table, read_rows
from ..tools.types import Real
from .rails import EQUAL_SPACING, SampledTrack
from .travel import SpeedProgramme

COLUMNS = {name: unit_of(SampledTrack, name) for name in ("distance", "lateral", "vertical", "roll")}
"""Columns of a survey, and their SI units."""
ALIASES = {"chainage": "distance", "station": "distance", "x": "distance", "y": "lateral", "z": "vertical"}
"""Other names of columns."""


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
    distance_unit: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """Unit in which the file has its distances, such as ft."""

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
        columns, self.distance_unit = _read(path, content)
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
    what follows #, and columns of remarks. Columns stand between commas, or between semicolons or tabs, where
    decimals may have commas; distances may be stations such as 129+773 [m]. A netCDF file has variables of these
    names with an attribute `units`, packed or not. Lateral counts positive to the left, vertical upwards, roll about
    x.

    **Arguments:**

    - `file`: its path. Scenes and results hold the path and a digest, by which they find the samples again.
    - `chord`: length of a chord [m] where lateral and vertical are the distances of the rail from the middle of that
        chord (versines), and not displacements from a line. Waves that the chord shows by less than a tenth, such as
        those of half its length, are left out.
    - `options`: `ends` and `ramp` of `SampledTrack`.

    **Returns:** a `SurveyedTrack`, which is a `SampledTrack`.

    **Raises:** `ValueError` with all faults of the file by their lines: names, units or numbers that are wrong, two
    columns of one meaning, marks of missing values such as -9999, distances that do not increase, and gaps; `OSError`
    for a file that cannot be read. A warning tells displacements that are implausible, such as a level above the sea.
    """
    return SurveyedTrack(file, chord=chord, **options)


def _read(path: Path, content: bytes) -> tuple[dict[str, np.ndarray], str]:
    """Return the columns of a survey by name, in SI units, and the unit in which its distances are written."""
    table = Table(path, content, COLUMNS, ALIASES)
    found = table.columns
    if "distance" not in found or not {"lateral", "vertical"} & set(found):
        table.fault(f"must have distance, and lateral or vertical, but has {', '.join(found) or 'neither'}")
    else:
        signs = ", and change the signs of lateral and roll if left was left along the falling distance"
        table.check_rising("distance", gaps=True, also=signs)
    columns = table.si()
    zero = np.zeros_like(columns["distance"])
    return {"lateral": zero, "vertical": zero} | columns, found["distance"].unit or "m"


def load_speed(file: str | Path, begin: Real = 0.0) -> SpeedProgramme:
    """Read a measured history of speeds.

    A CSV or netCDF file as for `load_rail` has columns `speed` (or velocity) and `distance` (chainage, station) or
    `time`, such as `time [s], velocity [ft/s]`; one with both is read by distance.

    **Arguments:** `begin`: where along the rail the sled is at the first time, or at distance zero of the file [m].

    **Raises:** `ValueError` with all faults of the file by their lines; `OSError` for a file that cannot be read.
    """
    aliases = ALIASES | {"velocity": "speed", "v": "speed", "t": "time"}
    along, columns = read_rows(file, {"distance": "m", "time": "s"}, {"speed": "m/s"}, aliases)
    begin = number(finite, "begin", begin, "m")
    if along == "time":
        return SpeedProgramme.over_time(columns["time"], columns["speed"], begin=begin)
    return SpeedProgramme.over_distance(begin + columns["distance"], columns["speed"])


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
