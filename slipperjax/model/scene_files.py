"""Scenes as TOML text with units, and as plain data: complete, exact, and read without running code.

    speed = "1250 m/s"

    [slipper]
    mass = "14 kg"
    inertia = { values = [0.051, 0.060, 0.086], unit = "kg m^2" }
    length = "200 mm"

With `base = "paper"` everything that a file leaves out is that of `slipperjax.paper_scene()`.
"""

import json
import re
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..tools.checks import brief, finite, instance, number, positive, unit_of
from ..tools.description import TYPE, build, describe, known_type, type_name
from ..tools.files import user_path
from ..tools.units import parsed
from .dang2024 import paper_scene
from .kinematics import Motion, check_motion
from .quantities import half_play
from .random_rails import AbstractSpectrum
from .scene import NUMBERS, PARTS, QUATERNION, START_UNITS, UNITS, Scene, Slipper
from .section import Section
from .sled import SledMass
from .step_size import given_steps
from .surveys import SurveyedTrack
from .tracks import AbstractTrack
from .travel import STAGE_UNITS, SpeedProgramme, Stage

SINGLE = (Slipper, Section, SledMass)
"""Classes without alternatives, whose tables need no type."""
INNER = (AbstractTrack, AbstractSpectrum)
"""Bases of classes within parts of a scene."""


RUN = {"length": (positive, "m"), "begin": (finite, "m"), "window": (positive, "m")}
"""Checks and units of the numbers in the table `run`."""


class SceneFile(NamedTuple):
    """Contents of a scene's file."""

    scene: Scene
    start: Motion | None
    """The motion at time zero; None where the file has none."""
    run: dict[str, Any] | None
    """Arguments of `slipperjax.run` [SI unit]; None where the file has none."""


def scene_to_json(scene: Scene) -> str:
    """Returns a scene as JSON, exact to the last bit; see `scene_from_json`."""
    instance("scene", scene, Scene, "a slipperjax.Scene")
    return json.dumps(describe(scene))


def scene_from_json(text: str) -> Scene:
    """Returns the scene of `scene_to_json`.

    **Raises:** `ValueError` for a text that describes none, or a class that is not defined in this process.
    """
    try:
        description = json.loads(instance("text", text, str, "JSON of a scene"))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"Argument `scene` must be JSON of a scene, but is {brief(text)}: {error}.") from None
    scene = build(description, (Scene, SpeedProgramme, *(kind for kind, _ in PARTS.values()), *INNER), "scene")
    return instance("scene", scene, Scene, "JSON of a scene")


def scene_from_toml(text: str, file: str = "scene") -> SceneFile:
    """Returns the scene of a TOML text, and its start.

    Quantities have units, as in "1250 m/s"; `values` with one `unit` make an array. The table `section` takes
    `clearance` in place of the `play` of each face; `start` takes y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z;
    `run` takes length, begin, window, steps_per_period and solver.

    **Arguments:** `file`: its name, for errors.

    **Raises:** `ValueError` with file and line for a syntax error, an unknown name, a value without a unit or with
    one of another kind, or a value out of range.
    """
    instance("text", text, str, "TOML text of a scene")
    instance("file", file, str, "a file's name")
    try:
        try:
            tables = tomllib.loads(text.removeprefix("\ufeff"))
        except ValueError as error:  # also of whole numbers with thousands of digits
            raise ValueError(f"{file}: {error}.") from None
        return _Reader(text, file, tables).read()
    except RecursionError:
        raise ValueError(f"{file}: has tables in tables too deeply.") from None


class _Reader:
    """One file: its text, and its tables. Errors name the line."""

    def __init__(self, text: str, file: str, tables: dict[str, Any]):
        self.lines, self.file, self.tables = text.splitlines(), file, tables

    def read(self) -> SceneFile:
        """Returns the scene and its start."""
        names = ("base", *NUMBERS, *PARTS, "start", "run")
        with self.placed(""):
            for name, value in self.tables.items():
                if name not in names:
                    raise ValueError(f"`{name}` is none of {', '.join(names)}.")
                if name in (*PARTS, "start", "run") and not isinstance(value, dict):
                    raise ValueError(f"`{name}` must be a table, [{name}], but is {brief(value)}.")
                if name == "gravity" and isinstance(value, dict):
                    raise ValueError(f"`{name}` must be a number with a unit, but is {brief(value)}.")
            base = self.tables.get("base")
            if base not in (None, "paper"):
                raise ValueError(f"`base` must be one of paper, but is {brief(base)}.")
            known = {} if base is None else describe(paper_scene())
            inherited = {name: value for name, value in known.items() if value is not None}
            values = {name: inherited[name] for name in NUMBERS if name in inherited}
            for name in set(NUMBERS) & set(self.tables):
                if not isinstance(self.tables[name], dict):
                    values[name] = quantity(name, self.tables[name], UNITS[name])
        if isinstance(self.tables.get("speed"), dict):
            values["speed"] = self.programme()
        parts = [name for name in PARTS if name in self.tables or name in inherited]
        values |= {name: self.part(name, inherited.get(name, {})) for name in parts}
        for name in ("speed", "slipper", "section", "track", "contact"):
            if name not in values:
                raise ValueError(f'{self.file}: `{name}` is missing; or write base = "paper" at the top.')
        with self.placed(""):
            scene = Scene(**values)
        others = {"start": self.start, "run": self.run}
        return SceneFile(scene, *(read() if name in self.tables else None for name, read in others.items()))

    def part(self, name: str, inherited: dict[str, Any]) -> Any:
        """Returns one part of the scene, from its table and the description that it inherits."""
        (kind, _), table = PARTS[name], dict(self.tables.get(name, {}))
        with self.placed(name):
            if kind not in SINGLE:
                of_file = SurveyedTrack.__name__ if name == "track" and "file" in table else inherited.get(TYPE)
                named = table.pop(TYPE, of_file)
                if named is None:
                    raise ValueError(f"`{TYPE}` is missing.")
                kind = known_type(str(named), (kind,), name)
            elif TYPE in table:
                raise ValueError(f"`{TYPE}` must not be given: there is one kind of {name}.")
            written = self.written(kind, table)
            values = {field: v for field, v in inherited.items() if field in kind.__dataclass_fields__} | written
            if kind is Section and "clearance" in written:
                if "play" in written:
                    raise ValueError("`clearance` and `play` must not both be given.")
                faces = len(values.get("faces", Section.faces))
                values["play"] = half_play(np.asarray(values.pop("clearance")), faces)
            return build({TYPE: type_name(kind), **values}, (kind, *INNER), name)

    def programme(self) -> SpeedProgramme:
        """Returns the programme of speeds in the table `speed`: places, times or stages."""
        table = dict(self.tables["speed"])
        with self.placed("speed"):
            begin = {"begin": quantity("begin", table.pop("begin"), "m")} if "begin" in table else {}
            if "stages" in table:
                start, rows = quantity("start", table.pop("start", None), "m/s"), table.pop("stages")
                if not (isinstance(rows, list) and all(isinstance(row, dict) for row in rows)):
                    raise ValueError(f"`stages` must be a list of tables, but is {brief(rows)}.")
                made = SpeedProgramme.stages([self.stage(row) for row in rows], start=start, **begin)
            elif "time" in table:
                time, speed = (quantity(n, table.pop(n, None), u) for n, u in (("time", "s"), ("speed", "m/s")))
                made = SpeedProgramme.over_time(time, speed, **begin)
            else:
                values = self.written(SpeedProgramme, table) | begin
                return build({TYPE: type_name(SpeedProgramme), **values}, (SpeedProgramme,), "speed")
            if table:
                raise ValueError(f"`{next(iter(table))}` must not be given here.")
            return made

    def stage(self, row: dict[str, Any]) -> Stage:
        """Returns a stage of a programme."""
        for name in row:
            if name not in STAGE_UNITS:
                raise ValueError(f"`stages` must have only {', '.join(STAGE_UNITS)}, but has `{name}`.")
        if "acceleration" not in row:
            raise ValueError("`stages` must have an `acceleration` each.")
        return Stage(**{name: quantity(name, value, STAGE_UNITS[name]) for name, value in row.items()})

    def written(self, kind: type, table: dict[str, Any]) -> dict[str, Any]:
        """Returns the values of a table for a class in SI units, those of tables within it too."""
        values: dict[str, Any] = {}
        is_table = lambda value: isinstance(value, dict) and TYPE in value

        def inner(field: str, value: dict[str, Any]) -> dict[str, Any]:
            kind = known_type(str(value[TYPE]), INNER, field)
            return {TYPE: type_name(kind)} | self.written(kind, {n: v for n, v in value.items() if n != TYPE})

        for field, value in table.items():
            if is_table(value):
                values[field] = inner(field, value)
            elif isinstance(value, list) and value and all(map(is_table, value)):
                values[field] = [inner(field, one) for one in value]
            else:
                values[field] = quantity(field, value, unit_of(kind, field) or ("m" if field == "clearance" else ""))
        if issubclass(kind, SurveyedTrack) and "file" in values:  # beside the scene's file
            values["file"] = str(Path(self.file).parent / user_path(str(values["file"])))
        return values

    def start(self) -> Motion:
        """Returns the motion at time zero, whose attitude is given as Euler angles or as a quaternion."""
        table = self.tables["start"]
        with self.placed("start"):
            for name in table:
                if name not in START_UNITS:
                    raise ValueError(f"`{name}` is none of {', '.join(START_UNITS)}.")
            values = {name: quantity(name, value, START_UNITS[name]) for name, value in table.items()}
            angles, quaternion = (
                [n for n in names if n in table] for names in (("roll", "pitch", "yaw"), QUATERNION)
            )
            if angles and quaternion:
                raise ValueError(f"`{angles[0]}` and `{quaternion[0]}` must not both be given.")
            return check_motion("start", Motion.from_euler(**values) if angles else Motion(**values))

    def run(self) -> dict[str, Any]:
        """Returns the arguments of a run."""
        table = self.tables["run"]
        with self.placed("run"):
            for name in table:
                if name not in (*RUN, "steps_per_period", "solver"):
                    raise ValueError(f"`{name}` is none of {', '.join(RUN)}, steps_per_period, solver.")
            if "length" not in table:
                raise ValueError("`length` is missing.")
            if "steps_per_period" in table:
                given_steps(table["steps_per_period"])
            given = {name: of for name, of in RUN.items() if name in table}
            return table | {n: number(c, n, quantity(n, table[n], unit), unit) for n, (c, unit) in given.items()}

    @contextmanager
    def placed(self, table: str) -> Iterator[None]:
        """Adds file and line to errors: the line of the name that an error mentions, or of the table."""
        try:
            yield
        except ValueError as error:
            names = self.tables.get(table, {}) if table else self.tables
            mentioned = re.findall(r"`(?:\w+\.)*(\w+)`", str(error))
            line = self.line_of(table, next((name for name in mentioned if name in names), ""))
            words = " ".join(str(error).split())  # keys may have line breaks
            raise ValueError(f"{self.file}{'' if line is None else f', line {line}'}: {words}") from None

    def line_of(self, table: str, name: str) -> int | None:
        """Returns the line where a name gets its value, or else where its table begins."""
        path = ".".join(filter(None, (table, name)))
        now, header = "", None
        for at, line in enumerate(self.lines, 1):
            match = re.match(r"""\s*(\[?)\s*([\w."']+)\s*[]=]""", line)  # a header, or a key before its value
            if match:
                key = re.sub("[\"']", "", match[2])
                now = key if match[1] else now
                here = key if match[1] else ".".join(filter(None, (now, key)))
                if here == path:
                    return at
                header = at if here == table else header
        return header


def quantity(name: str, value: Any, unit: str) -> Any:
    """Returns a number, or nested lists of numbers, in the SI unit `unit`; a value without unit as it is."""
    if not unit:
        return value
    if isinstance(value, dict):
        if set(value) != {"values", "unit"}:
            raise ValueError(f"`{name}` must have `values` and `unit`, but has {', '.join(value) or 'nothing'}.")
        return _each(value["values"], lambda number: parsed(name, f"{number!r} {value['unit']}", unit))
    return _each(value, lambda text: parsed(name, text, unit))


def _each(value: Any, convert: Callable[[Any], float]) -> Any:
    return [_each(v, convert) for v in value] if isinstance(value, list) else convert(value)
