"""Measurements on a track: surveys of rails, as tracks that know their files, and histories of speeds."""

import contextlib
import functools
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ..tools.checks import finite, number, one_of, positive, require, shown_number, warn
from ..tools.fields import unit_of
from ..tools.files import content_of, first_ones, listed, user_path
from ..tools.tables import Table, TableError, read_rows
from ..tools.types import Real
from .rails import EQUAL_SPACING, SampledTrack
from .tracks import PLAUSIBLE_GAUGES, AbstractTwoRails
from .travel import SpeedProgramme

COLUMNS = {name: unit_of(SampledTrack, name) for name in ("distance", "lateral", "vertical", "roll")}
"""Columns of a survey, and their SI units."""
SIDES = ("left_", "right_")
"""First words of the columns of two rails."""
OF_SIDES = {side + name: unit for side in SIDES for name, unit in COLUMNS.items() if name != "distance"}
"""Columns of two rails, and their SI units."""
_OTHERS = {
    **dict.fromkeys(("offset", "lat", "y"), "lateral"),
    **dict.fromkeys(("elevation", "elev", "vert", "z"), "vertical"),
}
ALIASES = {
    **dict.fromkeys(("chainage", "station", "sta", "x"), "distance"),
    **{side + other: side + name for side in ("", *SIDES) for other, name in _OTHERS.items()},
}
"""Other names of columns."""

DAMPING = 0.03
"""Damping of the waves that follow from versines, over the height that a chord shows of them, at most 2 [1]."""

GAP = 3.0
"""Distance between samples over the usual distance from which a place between them is without a reading [1]."""


def _across(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline  # here, because importing it takes time

    return CubicSpline(x, y)(at)


# a nanometre, so that rounding does not decide
JOINTS = {
    "spline": _across,
    "step": lambda x, y, at: y[np.searchsorted((x[1:] + x[:-1]) / 2, at - 1e-9)],
    "hold": lambda x, y, at: y[np.searchsorted(x, at + 1e-9) - 1],
}
"""How places without a reading are filled: by a spline through the others, by a step in the middle between the
readings on both sides, by the last reading. A step is as long as the distance between samples."""

_GAUGE = functools.partial(positive, plausible=PLAUSIBLE_GAUGES)


class _TwoRailsFound(ValueError):
    """A file has two rails in place of one."""


class SurveyedTrack(SampledTrack):
    """A track of samples in a file, see `slipperjax.load_rail`.

    Descriptions of scenes hold the file's name and digest, and not the samples.
    """

    file: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """The file's path."""
    sha256: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """Digest of the file's content, its first 16 digits."""
    chord: float | None = eqx.field(static=True, metadata={"unit": "m"})  # pyright: ignore[reportGeneralTypeIssues]
    """Length of the chord at whose middle the rail was measured [m]; None for displacements from a line."""
    joints: str | None = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """How places without a reading are filled, one of `JOINTS`; None: there are none."""
    distance_unit: str = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]
    """Unit of the file's distances, such as ft."""

    def __init__(
        self,
        file: str | Path,
        sha256: str | None = None,
        *,
        chord: float | None = None,
        joints: str | None = None,
        ends: str = "straight",
        ramp: Real | None = None,
    ):
        """**Arguments:** as for `load_rail` and `SampledTrack`; `sha256`: digest that the file must have.

        **Raises:** `ValueError` for a file that is no survey, or has another digest; `OSError` where there is no
        file.
        """
        self.file = str(file)
        self.chord = _chord(chord)
        self.joints = _joints(joints, self.chord)
        self.sha256, self.distance_unit, (rail,) = _read(file, sha256, self.chord, self.joints)
        super().__init__(**rail, ends=ends, ramp=ramp)
        _warn_if_coarse(self.file, self)


class SurveyedRails(AbstractTwoRails):
    """A track of two rails whose samples are in one file, see `slipperjax.load_rail`.

    Descriptions of scenes hold the file's name and digest, and not the samples.
    """

    left: SampledTrack
    """The rail on the side of positive y."""
    right: SampledTrack
    """The rail on the side of negative y."""
    file: str = eqx.field(static=True)
    """The file's path."""
    sha256: str = eqx.field(static=True)
    """Digest of the file's content, its first 16 digits."""
    chord: float | None = eqx.field(static=True, metadata={"unit": "m"})
    """Length of the chord at whose middle the rails were measured [m]; None for displacements from a line."""
    joints: str | None = eqx.field(static=True)
    """How places without a reading are filled, one of `JOINTS`; None: there are none."""
    ends: str = eqx.field(static=True)
    """How both rails continue beyond their ends, see `SampledTrack`."""
    ramp: float = eqx.field(static=True, metadata={"unit": "m"})
    """Length of the ramps of both rails [m], see `SampledTrack`."""
    distance_unit: str = eqx.field(static=True)
    """Unit of the file's distances, such as ft."""
    # the default replaces the property that all tracks have
    gauge: float | None = eqx.field(static=True, metadata={"unit": "m"}, default=None)
    """Distance between the axes of the undisturbed rails [m]; None: each rail is where its mounts are."""

    def __init__(
        self,
        file: str | Path,
        sha256: str | None = None,
        *,
        chord: float | None = None,
        gauge: float | None = None,
        joints: str | None = None,
        ends: str = "straight",
        ramp: Real | None = None,
    ):
        """**Arguments:** as for `load_rail` and `SampledTrack`; `sha256`: digest that the file must have.

        **Raises:** `ValueError` for a file that is no survey of two rails, or has another digest; `OSError` where
        there is no file.
        """
        self.file = str(file)
        self.chord = _chord(chord)
        self.joints = _joints(joints, self.chord)
        self.gauge = None if gauge is None else number(_GAUGE, "gauge", gauge, "m")
        self.sha256, self.distance_unit, rails = _read(file, sha256, self.chord, self.joints, SIDES, self.gauge)
        self.left, self.right = (SampledTrack(**rail, ends=ends, ramp=ramp) for rail in rails)
        self.ends = self.left.ends
        self.ramp = float(self.left.ramp)
        _warn_if_coarse(self.file, self.left, self.right)

    def __repr__(self) -> str:
        gauge = "" if self.gauge is None else f", gauge={shown_number(self.gauge)} m"
        return f"SurveyedRails({self.file!r}, left={self.left!r}, right={self.right!r}{gauge})"


def load_rail(
    file: str | Path, *, chord: float | None = None, gauge: float | None = None, **options: object
) -> SurveyedTrack | SurveyedRails:
    """Read a survey of one rail, or of two rails.

    A CSV file has a line of names and a line for each sample. Units are in brackets after the names, such as
    `chainage [ft], lateral [mm], vertical [mm]`, or in the line below the names; `roll` is optional. Lines above the
    names, text after # and columns of remarks are ignored. Commas separate columns; so do semicolons or tabs, and
    then decimals may have commas. Distances may be stations such as 129+773 [m]. A netCDF file has variables of these
    names with an attribute `units`, packed or not. Lateral is positive to the left, vertical upwards, roll about x.

    A file of two rails has columns `left lateral`, `left vertical`, `right lateral`, `right vertical`, optionally
    `left roll` and `right roll`, with each rail's displacements from its own line; in netCDF files `left_lateral`. In
    place of one rail's lateral the file may have `gauge`, the distance between both rails: right lateral is left
    lateral minus the excess of the gauge over its nominal value.

    **Arguments:**

    - `file`: its path. Scenes and results hold the path and a digest, and read the samples again from there.
    - `chord`: length of a chord [m] where lateral and vertical are distances of the rail from the middle of this
        chord (versines), and not displacements from a line. Waves that the chord shows by less than a tenth, such as
        waves of half its length, are left out, and so is a line of the versines. A column of the gauge is no versine.
    - `gauge`: nominal distance between the axes of two rails [m], which a column of the gauge needs; None: each rail
        is where its mounts are.
    - `options`: of both rails, `ends` and `ramp` of `SampledTrack`; and `joints`, which fills places without a
        reading: empty cells, and gaps above three spacings. "spline" joins the readings smoothly, "step" has a step
        in the middle between them, "hold" keeps the last reading up to the next one. Versines take "spline" alone.

    **Returns:** a `SurveyedTrack`, which is a `SampledTrack`; for a file with columns of both a left and a right rail
    a `SurveyedRails`, whose `left` and `right` are such tracks.

    **Raises:** `ValueError` with all faults of the file by their lines: wrong names, units or numbers, two columns of
    one meaning, distances that do not increase, and without `joints` places without a reading; `OSError` for a file
    that cannot be read. A warning names implausible displacements, such as a level above the sea.
    """
    with contextlib.suppress(_TwoRailsFound):
        track = SurveyedTrack(file, chord=chord, **options)
        require(gauge is None, "gauge", "be None for a file of one rail", gauge)
        return track
    return SurveyedRails(file, chord=chord, gauge=gauge, **options)


def _chord(chord: object) -> float | None:
    return None if chord is None else number(positive, "chord", chord, "m")


def _joints(joints: object, chord: float | None) -> str | None:
    if joints is None:
        return None
    # a step of versines is no step of the rail
    return one_of("joints", joints, JOINTS if chord is None else ("spline",))


def _warn_if_coarse(file: str, *rails: SampledTrack) -> None:
    """Warn where a rail has waves that are hardly longer than the distance between its samples."""
    spacing = float(rails[0].spacing)
    wave = min(float(rail.shortest_wavelength) for rail in rails)
    if wave < 4 * spacing:
        warn(
            f"Argument `file`, {file}, is sampled every {spacing:g} m, too coarsely for waves of {wave:.2g} "
            "m: what lies between the samples is made up."
        )


def _read(
    file: str | Path,
    sha256: str | None,
    chord: float | None,
    joints: str | None,
    sides: Sequence[str] = ("",),
    gauge: float | None = None,
) -> tuple[str, str, list[dict[str, np.ndarray]]]:
    """Return the first digits of the digest of a survey's file, the unit of its distances, and the columns of each
    rail in SI units, as displacements.

    **Arguments:** `sides`: those of two rails, or for one rail an empty one; `gauge`: nominal gauge of two rails [m].

    **Raises:** `_TwoRailsFound` for names of columns of both a left and a right rail where one rail is wanted.
    """
    path = user_path(file, "file")
    content = content_of(path)
    digest = _digest(content)
    need = "be the content with which the scene was made"
    require(sha256 in (None, digest), "sha256", need, shown=f"another one of {file} now")
    wanted = {"distance": "m", **OF_SIDES, "gauge": "m"} if sides == SIDES else _columns_of_one
    table = Table(path, content, wanted, ALIASES, holes=True)
    found = table.columns
    if "distance" in found and all({f"{side}lateral", f"{side}vertical"} & set(found) for side in sides):
        signs = "the signs of lateral and roll, of two rails also sides, if left was left along the falling distance"
        table.check_rising("distance", also=f", and change {signs}")
        _check_readings(table, joints)
    else:
        of_rails = " of the left and of the right rail" if sides == SIDES else ""
        has = ", ".join(found) or "neither"
        table.fault(f"must have distance, and lateral or vertical{of_rails}, but has {has}")
    if "gauge" in found:
        _check_gauge(table, gauge)
    columns = table.si()
    if joints is not None:
        columns = _filled(columns, JOINTS[joints])
    offsets = [column.name for column in found.values() if "offset" in column.name.lower()]
    if offsets:
        # road surveys count offsets positive to the right
        warn(f"File {path}: {listed(offsets)} counts as lateral, positive to the left along the distance.")
    distance = columns["distance"]
    rails = []
    for side in sides:
        own = {name: columns[side + name] for name in ("lateral", "vertical", "roll") if side + name in columns}
        rails.append(own if chord is None else _from_chords(distance, own, chord))
    if "gauge" in columns and gauge is not None:
        mean = np.mean(columns["gauge"])
        if abs(mean / gauge - 1) > 0.1:
            shown = f"{mean:g} m on average, far from the nominal {gauge:g} m"
            raise TableError(
                f"{path}: `{found['gauge'].name}` must be the distance between both rails, but is {shown}."
            )
        # the gauge is left minus right
        left, right = rails
        wider = columns["gauge"] - gauge
        if "lateral" in left:
            right["lateral"] = left["lateral"] - wider
        else:
            left["lateral"] = right["lateral"] + wider
    # a missing column is zero, and both rails roll if one does
    usual = dict.fromkeys({"lateral", "vertical"}.union(*rails), np.zeros_like(distance)) | {"distance": distance}
    return digest, found["distance"].unit or "m", [usual | rail for rail in rails]


def _check_readings(table: Table, joints: str | None) -> None:
    """Note distances without a number, and places without a reading; with `joints` only those at the rail's ends."""
    along = table.columns["distance"]
    others = [column.values for name, column in table.columns.items() if name != "distance"]
    seen = np.isfinite(along.values)
    known = np.flatnonzero(seen)
    # what is no number has been told
    told = np.isin(table.numbers, [number for number, _ in table.faults])
    for k in np.flatnonzero(~seen & ~told):
        table.fault(f"`{along.name}` has no number", table.numbers[k])
    empty = np.flatnonzero(~np.isfinite(others).all(axis=0) & seen & ~told)
    if joints is not None:
        if {*empty} & {0, len(seen) - 1}:
            table.fault("must begin and end with a reading")
        return
    unit = f" {along.unit}" if along.unit else ""
    places = {k: f"{along.values[k]:.10g}{unit} ({table.row} {table.numbers[k]})" for k in empty}
    for k in np.flatnonzero(_is_wide(np.diff(along.values[known]) / np.diff(known))):
        first, last = known[k : k + 2]
        places[last] = (
            f"{along.values[first]:.10g} to {along.values[last]:.10g}{unit} ({table.row} {table.numbers[last]})"
        )
    if places:
        choice = ", ".join(f'"{name}"' for name in JOINTS)
        table.fault(
            f"no reading at {first_ones([places[k] for k in sorted(places)])}: choose joints = one of {choice}"
        )


def _is_wide(steps: np.ndarray) -> np.ndarray:
    """Return which steps from sample to sample are gaps."""
    # the median, because a few gaps do not change it; the way back from a distance that fell is no gap
    usual = np.median(steps) if len(steps) else 0.0
    return (steps > GAP * usual) & (np.append(usual, steps[:-1]) > 0)


def _filled(columns: Mapping[str, np.ndarray], fill: Callable) -> dict[str, np.ndarray]:
    """Return the columns of a survey [SI units] with values at places without a reading, and further rows in gaps."""
    distance = columns["distance"]
    steps = np.diff(distance)
    rows = np.cumsum(np.append(0.0, np.where(_is_wide(steps), np.round(steps / np.median(steps)), 1.0)))
    # a wrong distance would fill the memory
    need = "fill less rail than has readings"
    require(rows[-1] < 2 * len(distance), "joints", need, shown=f"given for {len(distance)} of {rows[-1]:g} samples")
    at = np.interp(np.arange(rows[-1] + 1), rows, distance)
    filled = {"distance": at}
    for name, values in columns.items():
        known = np.isfinite(values)
        if name != "distance":
            filled[name] = fill(distance[known], values[known], at)
    return filled


def _digest(content: bytes) -> str:
    """Return the first digits of the digest of a file's content."""
    return hashlib.sha256(content).hexdigest()[:16]


def _columns_of_one(names: Set[str]) -> Mapping[str, str]:
    """Return the columns of a survey; raise `_TwoRailsFound` for names of columns of both a left and a right rail."""
    if all(any(name.startswith(side) for name in names & set(OF_SIDES)) for side in SIDES):
        raise _TwoRailsFound(
            "Argument `file` must be a survey of one rail, but is one of two: slipperjax.load_rail reads both."
        )
    return COLUMNS


def _check_gauge(table: Table, gauge: float | None) -> None:
    """Note where a column of the gauge is not in place of one rail's lateral, or has no nominal gauge."""
    name = table.columns["gauge"].name
    laterals = [column.name for key, column in table.columns.items() if key.endswith("_lateral")]
    if len(laterals) != 1:
        have = f"`{name}` stands in place of one rail's lateral"
        table.fault(f"{have}, but the file has {' and '.join(laterals) or 'neither of them'}")
    if gauge is None:
        table.fault(f'`{name}` needs the nominal gauge, such as gauge=1.435, or gauge = "1.435 m"')


def load_speed(file: str | Path, begin: Real = 0.0, cutoff: Real | None = None) -> SpeedProgramme:
    """Read a measured history of speeds.

    A CSV or netCDF file as for `load_rail` has columns `speed` (or velocity) and `distance` (chainage, station) or
    `time`, such as `time [s], velocity [ft/s]`; a file with both is read by distance.

    **Arguments:** `begin`: place of the sled along the rail at the first time, or at distance zero of the file [m];
    `cutoff`: frequency above which noise is removed from speeds over time [Hz], by a Butterworth filter of fourth
    order, forwards and backwards, so that nothing is delayed; None: no filter.

    **Raises:** `ValueError` with all faults of the file by their lines; `OSError` for a file that cannot be read.
    """
    aliases = ALIASES | {"velocity": "speed", "v": "speed", "t": "time"}
    content = content_of(user_path(file, "file"))
    along, columns = read_rows(file, {"distance": "m", "time": "s"}, {"speed": "m/s"}, aliases, content)
    begin = number(finite, "begin", begin, "m")
    speed = columns["speed"]
    try:
        if cutoff is not None:
            require(along == "time", "cutoff", "be None for speeds over distance", cutoff)
            speed = _without_noise(columns["time"], speed, number(positive, "cutoff", cutoff, "Hz"))
        if along == "time":
            programme = SpeedProgramme.over_time(columns["time"], speed, begin=begin)
        else:
            programme = SpeedProgramme.over_distance(begin + columns["distance"], speed)
    except ValueError as error:
        raise TableError(f"{file}: {error}") from None
    filtered = "" if cutoff is None else f", low-pass {cutoff:g} Hz"
    return replace(programme, source=f"{file}, sha256 {_digest(content)}{filtered}")


def _without_noise(time: np.ndarray, speed: np.ndarray, cutoff: float) -> np.ndarray:
    """Return speeds [m/s] at equal times [s] without their parts above a frequency [Hz]; none is negative."""
    from scipy.signal import butter, sosfiltfilt

    step = np.diff(time)
    require(np.ptp(step) < 1e-3 * step.mean(), "cutoff", "be None for unequal intervals of time", cutoff)
    need = f"be below half of the sampling rate, {0.5 / step.mean():g} Hz"
    require(cutoff < 0.5 / step.mean(), "cutoff", need, cutoff)
    smooth = sosfiltfilt(butter(4, cutoff, fs=1 / step.mean(), output="sos"), speed)
    return np.maximum(smooth, 0.0)


def _from_chords(distance: np.ndarray, columns: dict[str, np.ndarray], chord: float) -> dict[str, np.ndarray]:
    """Return displacements from distances to the middle of a chord, see `load_rail`: the smallest waves with these
    distances, by least squares, without waves that the chord hardly shows."""
    from scipy.sparse.linalg import LinearOperator, lsqr  # here, because importing it takes time

    steps = np.diff(distance)
    require(
        np.ptp(steps) <= 2 * EQUAL_SPACING * steps.mean(),
        "chord",
        "be None where samples are not equally spaced",
        chord,
    )
    # displacements beyond both ends, where the outer chords end, are free
    samples = len(distance)
    room = math.ceil(2 * chord / steps.mean())
    size = 1 << (samples + 2 * room).bit_length()
    # height of the chord's middle for a sine of amplitude one
    gain = 1 - np.cos(np.pi * np.fft.rfftfreq(size, steps.mean()) * chord)
    gain[gain < 0.1] = 0.0  # waves that the chord hardly shows would be noise
    middles = lambda waves: np.fft.irfft(np.fft.rfft(waves) * gain, size)
    # a line of the versines would be a curve that no such wave makes
    lines, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, samples), 2))
    about_line = lambda versines: versines - lines @ (lines.T @ versines)
    within = slice(room, room + samples)
    outside = (room, size - samples - room)
    both: Any = {
        "matvec": lambda waves: about_line(middles(waves.ravel())[within]),
        "rmatvec": lambda versines: middles(np.pad(about_line(versines.ravel()), outside)),
    }
    seen = LinearOperator((samples, size), **both)
    out = dict(columns)
    for name in {"lateral", "vertical"} & set(columns):
        waves, *_ = lsqr(seen, about_line(columns[name]), damp=DAMPING, atol=1e-9, btol=1e-9)
        out[name] = waves[within]
    return out
