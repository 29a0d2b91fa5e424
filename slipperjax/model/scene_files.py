"""Scenes as TOML text with units, and as plain data: complete, exact, and read without running code.

    speed = "1250 m/s"

    [slipper]
    mass = "14 kg"
    inertia = { values = [0.051, 0.060, 0.086], unit = "kg m^2" }
    length = "200 mm"

With `base = "paper"` everything that a file leaves out is that of `slipperjax.paper_scene()`.
"""

import functools
import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any, NamedTuple

from ..tools.checks import brief, unit_of
from ..tools.description import TYPE, build, check_fields, describe, known_type, type_name
from .contact import AbstractContactLaw, AbstractMemory
from .dang2024 import paper_scene
from .kinematics import Motion
from .quantities import half_play
from .scene import Scene, Slipper
from .scene_text import NUMBERS, START_UNITS, TABLES
from .section import Section
from .tracks import AbstractTrack

PARTS: dict[str, type] = dict(
    zip(TABLES, (Slipper, Section, AbstractTrack, AbstractContactLaw, AbstractMemory), strict=True)
)
"""The tables of a scene's file, and the classes of what they describe."""
SINGLE = (Slipper, Section)
"""Classes without alternatives, whose tables need no type."""
ANGLES, QUATERNION = ("roll", "pitch", "yaw"), ("q_x", "q_y", "q_z")
"""Two ways to give the attitude at the start."""
BASES = {"paper": paper_scene}
"""Scenes that a file may be based on."""


class SceneFile(NamedTuple):
    """Contents of a scene's file."""

    scene: Scene
    start: Motion | None
    """The motion at time zero; None where the file has none."""


def scene_to_json(scene: Scene) -> str:
    """Returns a scene as JSON, exact to the last bit; see `scene_from_json`."""
    return json.dumps(describe(scene))


def scene_from_json(text: str) -> Scene:
    """Returns the scene of `scene_to_json`.

    **Raises:** `ValueError` for a text that describes none, or a class that is not defined in this process.
    """
    try:
        description = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"Argument `scene` must be JSON of a scene, but is {brief(text)}: {error}.") from None
    return build(description, (Scene, *PARTS.values()), "scene")


def motion_from(values: Mapping[str, Any]) -> Motion:
    """Returns a motion from its fields, or from coordinates with Euler angles, see `Motion.from_euler`."""
    angles, quaternion = ([name for name in names if name in values] for names in (ANGLES, QUATERNION))
    if angles and quaternion:
        raise ValueError(f"`{angles[0]}` and `{quaternion[0]}` must not both be given.")
    return Motion.from_euler(**values) if angles else Motion(**values)


def scene_from_toml(text: str, file: str = "scene") -> SceneFile:
    """Returns the scene of a TOML text, and its start.

    Quantities have units, as in "1250 m/s"; `values` with one `unit` make an array. The table `section` takes
    `clearance` in place of the `play` of each face; `start` takes y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z.

    **Arguments:** `file`: its name, for errors.

    **Raises:** `ValueError` with file and line for a syntax error, an unknown name, a value without a unit or with
    one of another kind, or a value out of range.
    """
    try:
        tables = tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: {error}.") from None
    return _Reader(text, file, tables).read()


class _Reader:
    """One file: its text, and its tables. Errors name the line."""

    def __init__(self, text: str, file: str, tables: dict[str, Any]):
        self.lines, self.file, self.tables = text.splitlines(), file, tables

    def read(self) -> SceneFile:
        names = ("base", *NUMBERS, *PARTS, "start")
        for name in self.tables:
            if name not in names:
                raise self.error("", name, f"`{name}` is none of {', '.join(names)}.")
        base = self.base()
        values = {name: self.quantity("", name, unit_of(Scene, name)) for name in NUMBERS if name in self.tables}
        parts = {name: self.part(name, base.get(name)) for name in PARTS if name in self.tables or name in base}
        missing = [
            name
            for name in ("speed", "slipper", "section", "track", "contact")
            if name not in {**base, **values, **parts}
        ]
        if missing:
            raise ValueError(f'{self.file}: `{missing[0]}` is missing; or write base = "paper" at the top.')
        inherited = {name: base[name] for name in NUMBERS if name in base and name not in values}
        try:
            scene = Scene(**(inherited | values | parts))
        except ValueError as error:
            raise self.placed("", error) from None
        return SceneFile(scene, self.start() if "start" in self.tables else None)

    def base(self) -> dict[str, Any]:
        """Returns the description of the scene that the file is based on, empty without one."""
        name = self.tables.get("base")
        if name is None:
            return {}
        if not isinstance(name, str) or name not in BASES:
            raise self.error("", "base", f"`base` must be one of {', '.join(BASES)}, but is {brief(name)}.")
        return describe(BASES[name]())

    def part(self, name: str, inherited: dict[str, Any] | None) -> Any:
        """Returns one part of the scene, from its table and what it inherits."""
        kind, table = PARTS[name], dict(self.table(name))
        try:
            if kind not in SINGLE:
                named = table.pop(TYPE, (inherited or {}).get(TYPE))
                if named is None:
                    raise ValueError(f"`{TYPE}` is missing.")
                kind = known_type(str(named), (kind,), name)
            elif TYPE in table:
                raise ValueError(f"`{TYPE}` must not be given: there is one kind of {name}.")
            fields = {f for f in kind.__dataclass_fields__}
            written = {k: self.value(name, k, unit_of(kind, k) or ("m" if k == "clearance" else "")) for k in table}
            values = {k: v for k, v in (inherited or {}).items() if k in fields} | written
            if kind is Section and "clearance" in written:
                if "play" in table:
                    raise ValueError("`clearance` and `play` must not both be given.")
                play = half_play(values.pop("clearance"), len(values.get("faces", Section.faces)))
                values["play"] = play
            check_fields({TYPE: type_name(kind), **values}, kind, name)
            return kind(**{k: _tuples(v) for k, v in values.items()})
        except _PlacedError:
            raise
        except ValueError as error:
            raise self.placed(name, error) from None

    def start(self) -> Motion:
        """Returns the motion at time zero."""
        table = self.table("start")
        for name in table:
            if name not in START_UNITS:
                raise self.error("start", name, f"`{name}` is none of {', '.join(START_UNITS)}.")
        try:
            return motion_from({name: self.value("start", name, START_UNITS[name]) for name in table})
        except _PlacedError:
            raise
        except (ValueError, TypeError) as error:
            raise self.placed("start", error) from None

    def table(self, name: str) -> Mapping[str, Any]:
        table = self.tables.get(name, {})
        if not isinstance(table, dict):
            raise self.error("", name, f"`{name}` must be a table, [{name}], but is {brief(table)}.")
        return table

    def value(self, table: str, name: str, unit: str) -> Any:
        return self.quantity(table, name, unit) if unit else self.table(table)[name]

    def quantity(self, table: str, name: str, unit: str) -> Any:
        """Returns a number, or nested lists of numbers, in the SI unit `unit`."""
        raw = (self.table(table) if table else self.tables)[name]
        try:
            if isinstance(raw, dict):
                if set(raw) != {"values", "unit"}:
                    raise ValueError(
                        f"`{name}` must have `values` and `unit`, but has {', '.join(raw) or 'nothing'}."
                    )
                return _each(raw["values"], lambda v: in_si(name, _number(name, v), str(raw["unit"]), unit))
            return _each(raw, lambda v: parsed(name, v, unit))
        except ValueError as error:
            raise self.error(table, name, str(error)) from None

    def error(self, table: str, name: str, text: str) -> "_PlacedError":
        line = self.line_of(table, name)
        return _PlacedError(f"{self.file}{'' if line is None else f', line {line}'}: {text}")

    def placed(self, table: str, error: Exception) -> "_PlacedError":
        """Returns an error with the line of the name that it mentions, or of the table."""
        named = re.findall(r"`(?:\w+\.)*(\w+)`", str(error))
        present = [name for name in named if name in (self.table(table) if table else self.tables)]
        return self.error(table, present[0] if present else "", str(error))

    def line_of(self, table: str, name: str) -> int | None:
        """Returns the line where a name gets its value, or else where its table begins."""
        now, header = "", None
        for number, line in enumerate(self.lines, 1):
            title = re.match(r"\s*\[\s*([\w.\"']+)\s*\]", line)
            if title:
                now = title.group(1).strip("\"'")
                header = number if now == table else header
                if name == now and not table:
                    return number
            path = f"{now}.{name}" if now == table and table else name
            key = re.match(r"\s*([\w.\"']+)\s*=", line)
            if key:
                full = ".".join(filter(None, [now, key.group(1).replace('"', "").replace("'", "")]))
                if full == ".".join(filter(None, [table, name])) or full == path:
                    return number
        return header


class _PlacedError(ValueError):
    """An error that names its file and line."""


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


def _each(value: Any, convert: Any) -> Any:
    return [_each(v, convert) for v in value] if isinstance(value, list) else convert(value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"`{name}` must be a number, but is {brief(value)}.")
    return float(value)


def parsed(name: str, value: Any, unit: str) -> float:
    """Reads a text such as "1.5 mm" in the SI unit `unit`; raises `ValueError` for others, and bare numbers."""
    text = value if isinstance(value, str) else ""
    words = re.fullmatch(r"\s*([-+]?[\d_.]+(?:[eE][-+]?\d+)?)(\s+\S.*?|[^\W\d_].*?|°)\s*", text)
    try:
        number = float(words.group(1)) if words else None
    except ValueError:
        number = None
    if words is None or number is None:
        raise ValueError(f'`{name}` must be a number with a unit, as in "1.5 {unit}", but is {brief(value)}.')
    return in_si(name, number, words.group(2).strip(), unit)


def in_si(name: str, number: float, unit: str, si: str) -> float:
    """Returns a number in a unit, converted to the SI unit `si`; raises `ValueError` for a unit of another kind."""
    return number if unit == si else number * _factor(name, unit, si)


@functools.cache
def _factor(name: str, unit: str, si: str) -> float:
    import pint  # here, because only files with other units need it

    try:
        return float(_units().Quantity(1.0, unit).to(si).magnitude)
    except (pint.PintError, ValueError, TypeError, AssertionError) as error:
        raise ValueError(f"`{name}` must be in a unit like {si}, but is in {brief(unit)}: {error}") from None


@functools.cache
def _units() -> Any:
    import pint

    return pint.UnitRegistry()
