"""Scenes as TOML text with units, and as plain data: complete, exact, and read without running code.

    speed = "1250 m/s"

    [slipper]
    mass = "14 kg"
    inertia = { values = [0.051, 0.060, 0.086], unit = "kg m^2" }
    length = "200 mm"

With `base = "paper"` everything that a file leaves out is as in `slipperjax.paper_scene()`.
"""

import dataclasses
import inspect
import json
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..tools.checks import brief, finite, hint, instance, positive, require
from ..tools.description import TYPE, arguments_of, build, describe, known_type, type_name
from ..tools.fields import ShapeChecked, field, unit_of
from ..tools.files import user_path
from ..tools.tables import TableError, station
from ..tools.units import parsed
from .dang2024 import paper_scene
from .faults import Fault, FaultyTrack
from .kinematics import Motion, check_motion
from .loads import SumLoad, TabulatedLoad
from .modes import Modes, load_modes
from .parameters import DIRECTIONS, PARAMETERS
from .quantities import ShownUnits
from .scene import INNER, NUMBERS, PARTS, START, Scene
from .section import Section
from .sensors import UNITS, Sensor
from .sled import Cut, Mount, Sled
from .slipper import AbstractBody, Slipper
from .starts import AtRest
from .step_size import given_steps
from .surveys import SurveyedRails, SurveyedTrack, load_rail, load_speed
from .thrust import RocketSled, WaterBrake, read_thrust
from .tracks import AbstractTrack, StraightTrack
from .travel import SpeedProgramme, Stage

BODY = ("slipper", "mounts", "modes")
"""Tables of the body: a sled has its own tables for mounts and modes."""
BEAM = {"mass": "kg", "length": "m", "stiffness": "N m^2", "count": "", "damping": "", "places": "m"}
"""Arguments of `Modes.beam` with their units."""
SPEEDS = ("file", "cutoff", "stages", "start", "distance", "speed", "scale", "source", *arguments_of(RocketSled))
"""Names in the table of a speed that changes."""
UNITS_OF_SPEEDS = {"begin": "m", "cutoff": "Hz", "start": "m/s", "time": "s", "distance": "m", "speed": "m/s"}
"""Units of arguments of functions that return a `SpeedProgramme`."""
PLACES = ("at", "begin", "end", "distance")
"""Names of distances along the rail, which may be stations such as 8+00."""
Table = dict[str, Any]
"""A table of TOML: values of any kind by their names."""
Part = TypeVar("Part", bound=eqx.Module)


class RunTable(ShapeChecked):
    """The table `run` of a scene's file: arguments of `slipperjax.run`, and the `units` of its report."""

    length: Float[Array, ""] = field("m", positive)
    """Length of rail [m]."""
    begin: Float[Array, ""] | None = field("m", finite, default=None)
    """Place of the rail at which the run begins [m], also a station such as 8+00; None: where the rail begins."""
    window: Float[Array, ""] | None = field("m", positive, default=None)
    """Length of the rail for which each number of the result stands [m]; None: 1 m."""
    steps_per_period: int | None = None
    """Steps of integration in a forcing period; None: as many as impacts need."""
    solver: str | None = None
    """Name of the integration method; None: the one that suits the scene."""
    units: tuple[str, ...] | None = None
    """Units in which results are shown, such as ["ft", "lbf", "g"]; None: SI units."""

    def __check_init__(self):
        if self.units is not None:
            ShownUnits(self.units)
        if self.steps_per_period is not None:
            given_steps(self.steps_per_period)


class EnvironmentTable(ShapeChecked):
    """The vibration environment of places on the sled: arguments of `slipperjax.environment` other than its runs."""

    places: Float[Array, "places 3"] = field("m", finite)
    """x, y and z of each place from the centre of mass [m]."""
    window: Float[Array, ""] | None = field("s", positive, default=None)
    low: Float[Array, ""] | None = field("Hz", positive, default=None)
    high: Float[Array, ""] | None = field("Hz", positive, default=None)
    quality: Float[Array, ""] | None = field("", positive, default=None)
    margin: Float[Array, ""] | None = field("", finite, default=None)
    """Margin of the specification over the greatest density [dB]."""

    def __check_init__(self):
        if self.low is not None and self.high is not None:
            require(self.low < self.high, "low", f"be below {self.high:g} Hz", shown=f"{self.low:g} Hz")


class LoadsTable(ShapeChecked):
    """The loads that size parts: arguments of `slipperjax.sweeps.loads` other than its runs."""

    means: Float[Array, " means"] = field("s", positive, default=())
    """Times over which loads are averaged [s]."""
    quantiles: tuple[float, ...] | None = None


class SceneFile(NamedTuple):
    """Contents of a scene's file."""

    scene: Scene
    start: Motion | None
    """The motion at time zero; None where the file has none."""
    run: dict[str, Any] | None
    """Arguments of `slipperjax.run` [SI unit]; None where the file has none."""
    units: tuple[str, ...]
    """Units in which results are shown, such as "ft" and "lbf"."""
    environment: dict[str, Any] | None
    """Arguments of `slipperjax.environment` other than its runs [SI unit]; None where the file has none."""
    loads: dict[str, Any] | None
    """Arguments of `slipperjax.sweeps.loads` other than its runs [SI unit]; None where the file has none."""
    sensors: list[Sensor]
    """The sensors of the file's tables `sensors`."""


def scene_to_json(scene: Scene) -> str:
    """Return a scene as JSON, exact to the last bit; see `scene_from_json`."""
    instance("scene", scene, Scene, "a slipperjax.Scene")
    return json.dumps(describe(scene))


def scene_from_json(text: str) -> Scene:
    """Return the scene of `scene_to_json`.

    **Raises:** `ValueError` for a text that describes no scene, or a class that is not defined in this process.
    """
    try:
        description = json.loads(instance("text", text, str, "JSON of a scene"))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"Argument `scene` must be JSON of a scene, but is {brief(text)}: {error}.") from None
    scene = build(description, (Scene, SpeedProgramme, *(kind for kind, _ in PARTS.values()), *INNER), "scene")
    return instance("scene", scene, Scene, "JSON of a scene")


def scene_from_toml(text: str, file: str = "scene") -> SceneFile:
    """Return the scene of a TOML text, and its start.

    Quantities have units, as in "1250 m/s"; `values` with one `unit` make an array. The table `section` takes
    `clearance`, or `play = { vertical = ..., lateral = ... }`, in place of the `play` of each face; `track` takes the
    `file` of a survey, and `speed` the `file` of a history; `start` takes y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y,
    w_z; `run` takes length, begin, window, steps_per_period, solver and units.
    A sled's slippers are tables `[[mounts]]`. Each may have a `clearance` and a `section`; values that this section
    leaves out are those of the scene's section. `modes` takes the `file` of modes, or a `beam`, see `Modes.beam`;
    `environment` takes places, window, low, high, quality and margin [dB]; `loads` takes means, quantiles and tables
    `[[loads.cuts]]` with the fields of `Cut`; tables `[sensors.NAME]` have the fields of `Sensor`.

    **Arguments:** `file`: its name, for errors.

    **Raises:** `ValueError` with file and line for a syntax error, an unknown name, a value without a unit or with a
    unit of another kind, or a value out of range.
    """
    instance("text", text, str, "TOML text of a scene")
    instance("file", file, str, "a file's name")
    try:
        try:
            # some editors begin a file with a byte order mark
            tables = tomllib.loads(text.removeprefix("\ufeff"))
        except ValueError as error:  # also of whole numbers with thousands of digits
            hint = " Paths on Windows go with / or between single quotes." if "\\" in str(error) else ""
            raise ValueError(f"{file}: {error}.{hint}") from None
        return _Reader(text, file, tables).read()
    except RecursionError:
        raise ValueError(f"{file}: has tables in tables too deeply.") from None


class _Reader:
    """One file: its text, and its tables. Errors name the line."""

    def __init__(self, text: str, file: str, tables: Table):
        self.lines = text.splitlines()
        self.file = file
        self.tables = tables
        # unit of stations, which a survey replaces by its own
        self.unit = "m"

    def read(self) -> SceneFile:
        """Return the scene, its start, its run and its environment."""
        with self.placed(""):
            self.check_names()
        # the base gives what the file leaves out
        values = dict(vars(paper_scene())) if "base" in self.tables else {}
        for name in ("speed", "slipper", "section", "track", "contact"):
            if name not in values and name not in self.tables:
                raise ValueError(f'{self.file}: `{name}` is missing; or write base = "paper" at the top.')
        start = run = environment = loads = None
        sensors: list[Sensor] = []
        # the track comes first, because its survey gives the unit of stations
        for name in sorted(self.tables, key=lambda name: name != "track"):
            value = self.tables[name]
            if name in BODY:
                continue
            if isinstance(value, list):
                values[name] = SumLoad([self.load(row, k) for k, row in enumerate(value)])
                continue
            with self.placed(name if isinstance(value, dict) else ""):
                if name == "track":
                    values[name] = self.track(dict(value), values.get(name))
                elif name in PARTS:
                    values[name] = self.part(name, dict(value), values.get(name))
                elif name == "start":
                    start = self.start(dict(value))
                elif name == "run":
                    run = self.arguments(RunTable, value, name)
                elif name == "environment":
                    environment = self.arguments(EnvironmentTable, value, name)
                elif name == "loads":
                    loads = self.loads(dict(value))
                elif name == "sensors":
                    sensors = [self.sensor(*one) for one in value.items()]
                elif name == "speed" and isinstance(value, dict):
                    values[name] = self.programme(dict(value))
                elif name in NUMBERS:
                    values[name] = quantity(name, value, unit_of(Scene, name))
        # after the section, because slippers use it
        if not self.tables.keys().isdisjoint(BODY):
            values["slipper"] = self.body(values.get("slipper"), values["section"])
        with self.placed(""):
            units = () if run is None else run.pop("units", ())
            return SceneFile(Scene(**values), start, run, units, environment, loads, sensors)

    def check_names(self) -> None:
        """Raise `ValueError` for unknown names, and for values in place of tables."""
        tables = (*PARTS, "mounts", "modes", "start", "run", "environment", "loads", "sensors")
        check_known(self.tables, ("base", *NUMBERS, *tables))
        for name, value in self.tables.items():
            several = isinstance(value, list) and value and all(isinstance(row, dict) for row in value)
            if name == "mounts" and not several:
                raise ValueError(f"`{name}` must be a table, [[{name}]], for each slipper, but is {brief(value)}.")
            if name in tables and not isinstance(value, dict) and not (several and name in ("load", "mounts")):
                raise ValueError(f"`{name}` must be a table, [{name}], but is {brief(value)}.")
        base = self.tables.get("base", "paper")
        if base != "paper":
            raise ValueError(f"`base` must be one of paper, but is {brief(base)}.")

    def load(self, table: Table, number: int) -> eqx.Module:
        """Return one of several loads, by its number."""
        with self.placed("load", number):
            return self.part("load", dict(table), None)

    def loads(self, table: Table) -> dict[str, Any]:
        """Return the arguments of `slipperjax.sweeps.loads`; each cut is a table [[loads.cuts]]."""
        cuts = self.rows(Cut, "cuts", table.pop("cuts", []))
        return self.arguments(LoadsTable, table, "loads") | {"cuts": cuts}

    def body(self, inherited: eqx.Module | None, section: Section) -> eqx.Module:
        """Return the slipper, or the sled on mounts, from their tables and the body and the section of the scene."""
        table = dict(self.tables.get("slipper", {}))
        if "mounts" in self.tables:
            table["mounts"] = [self.mount(row, k, section) for k, row in enumerate(self.tables["mounts"])]
        with self.placed("slipper"):
            body = self.part("slipper", table, inherited)
        if "modes" not in self.tables:
            return body
        with self.placed("modes"):
            return dataclasses.replace(body, modes=self.modes(dict(self.tables["modes"]), body))

    def mount(self, table: Table, number: int, section: Section) -> Mount:
        """Return a slipper's place on the sled; the scene's section gives what the slipper's section leaves out."""
        with self.placed("mounts", number):
            check_known(table, ("clearance", *arguments_of(Mount)))
            own = table.get("section", {})
            if not isinstance(own, dict):
                raise ValueError(f"`section` must be a table, but is {brief(own)}.")
            values = {"section": self.part("section", dict(own), section)} if own else {}
            return self.made(Mount, self.with_play(table | values, values.get("section", section)), "mounts")

    def modes(self, table: Table, body: eqx.Module) -> Modes:
        """Return the elastic modes of a sled: from a file, of a beam, or from the table's numbers."""
        sled = instance("slipper", body, Sled, "a sled with tables [[mounts]] to have modes")
        source = next((name for name in ("file", "beam") if name in table), None)
        if source is None:
            return self.made(Modes, table, "modes")
        check_known(table, (source,))
        given = table[source]
        if source == "file":
            return load_modes(self.beside(given), sled.names)
        instance("beam", given, dict, "a table")
        check_known(given, BEAM)
        places = [0.0 if mount.x is None else mount.x for mount in sled.mounts]
        return Modes.beam(**arguments_from(Modes.beam, given, BEAM) | {"places_of_mounts": places})

    def sensor(self, name: str, table: Table) -> Sensor:
        """Return the sensor of a table; bias and noise have the unit of the sensor's signal."""
        with self.placed(f"sensors.{name}"):
            instance("sensors", table, dict, f"a table, [sensors.{name}], for each sensor")
            check_known(table, [field for field in arguments_of(Sensor) if field != "name"])
            signal = UNITS.get(table.get("measures", "acceleration"), "")
            units = {"bias": signal, "noise": signal}
            values = {key: quantity(key, value, units.get(key, unit_of(Sensor, key))) for key, value in table.items()}
            return Sensor(name, **values)

    def with_play(self, table: Table, section: Section) -> Table:
        """Return a table with the play of each face of a section, in place of a `clearance`, of which each face has
        half, or in place of a vertical and a lateral play."""
        play = table.get("play")
        along = isinstance(play, dict) and not {"values", "unit"} & set(play)
        if "clearance" not in table and not along:
            return table
        if "clearance" in table and play is not None:
            raise ValueError("`clearance` and `play` must not both be given.")
        rest = {name: value for name, value in table.items() if name not in ("clearance", "play")}
        total = {"clearance": table.get("clearance")}
        if along:
            assert isinstance(play, dict)
            check_known(play, DIRECTIONS)
            total = {f"play.{name}": play.get(name) for name in DIRECTIONS}
        of_faces = np.empty(len(section.faces))
        for name, value in total.items():
            p = PARAMETERS[name]
            given = quantity(name, value, p.unit)
            mine = slice(None) if p.direction is None else np.asarray(section.directions) == p.direction
            of_faces[mine] = np.asarray(p.check(given)) / 2
        return rest | {"play": {"values": of_faces.tolist(), "unit": "m"}}

    def part(self, name: str, table: Table, inherited: eqx.Module | None) -> eqx.Module:
        """Return one part of the scene, from its table and the part that it inherits."""
        # the base gives what the table leaves out
        described = {} if inherited is None else describe(inherited)
        kind, _ = PARTS[name]
        # a track with a file is a survey, of one rail or of two rails
        if name == "track" and "file" in table and TYPE not in table:
            check_known(table, arguments_of(SurveyedRails))
            survey = self.described(SurveyedRails, table)
            return load_rail(**{field: v for field, v in survey.items() if field != TYPE})
        usual = described.get(TYPE)
        if kind is AbstractBody:
            usual = (Sled if "mounts" in table else Slipper).__name__
        elif not kind.__name__.startswith("Abstract"):
            usual = kind.__name__
        named = table.pop(TYPE, usual)
        if named is None:
            raise ValueError(f"`{TYPE}` is missing.")
        kind = known_type(str(named), (kind,), name)
        values = {field: v for field, v in described.items() if field in kind.__dataclass_fields__}
        # `clearance` is the only name in a file that is not a field of its part
        if kind is Section:
            check_known(table, ("clearance", *arguments_of(kind)))
            rest = {field: value for field, value in table.items() if field not in ("clearance", "play")}
            # the directions of faces do not depend on the play
            faces = len(table.get("faces", values.get("faces", Section.faces)))
            shape = self.made(kind, rest, name, **values | {"play": np.zeros(faces)})
            table = self.with_play(table, shape)
        return self.made(kind, table, name, **values)

    def track(self, table: Table, inherited: AbstractTrack | None) -> AbstractTrack:
        """Return the track, with the faults that the table adds: to all rails, or to the left or the right rail."""
        # as `Scene.to_toml` writes it, with a type in each table
        whole = table.get(TYPE) == FaultyTrack.__name__
        of_all = [] if whole else table.pop("faults", [])
        of_one = {side: [] if whole else _taken(table, side, "faults") for side in ("left", "right")}
        track = self.part("track", table, inherited)
        assert isinstance(track, AbstractTrack)
        self.unit = getattr(track, "distance_unit", self.unit)
        if not of_all and not any(of_one.values()):
            return track
        made = lambda rows, place: [self.fault(row, f"{place}.faults", k) for k, row in enumerate(rows)]
        require(
            track.rails or not any(of_one.values()), "faults", "be [[track.faults]] on one rail", shown="of a side"
        )
        sides = {
            side: FaultyTrack(StraightTrack(), made(rows, f"track.{side}")) for side, rows in of_one.items() if rows
        }
        return FaultyTrack(track, made(of_all, "track"), **sides)

    def fault(self, row: object, place: str, number: int) -> Fault:
        """Return a fault of a rail from its table.

        **Arguments:** `place`, `number`: of the table, for errors.
        """
        with self.placed(place, number):
            table = instance("faults", row, dict, "a table, [[track.faults]], for each fault")
            return self.made(Fault, table, "faults")

    def programme(self, table: Table) -> SpeedProgramme:
        """Return the programme of speeds in the table `speed`: stages, a file, times or places."""
        check_known(table, SPEEDS)
        if "stages" in table:
            function = SpeedProgramme.stages
            table["stages"] = self.rows(Stage, "stages", table["stages"])
        elif "file" in table:
            function = load_speed
            table["file"] = self.beside(table["file"])
        elif "thrust" in table:
            return self.thrust(table).programme()
        elif "time" in table and "distance" not in table:
            function = SpeedProgramme.over_time
        elif set(table) == {"distance", "speed"}:
            function = SpeedProgramme.over_distance
        else:
            return self.made(SpeedProgramme, table, "speed")
        values = arguments_from(function, without_stations(table, self.unit), UNITS_OF_SPEEDS)
        for name in table:
            if name not in values:
                raise ValueError(f"`{name}` must not be given here.")
        return function(**values)

    def thrust(self, table: Table) -> RocketSled:
        """Return the sled in a table `speed` with a thrust; the thrust may be a file."""
        values: dict[str, Any] = {"brakes": self.rows(WaterBrake, "brakes", table.pop("brakes", []))}
        if isinstance(table["thrust"], str):
            values |= read_thrust(self.beside(table.pop("thrust")))
        return self.made(RocketSled, table, "speed", **values)

    def rows(self, kind: type[Part], name: str, value: object) -> list[Part]:
        """Return the modules of a list of tables."""
        if not (isinstance(value, list) and all(isinstance(row, dict) for row in value)):
            raise ValueError(f"`{name}` must be a list of tables, but is {brief(value)}.")
        return [self.made(kind, row, name) for row in value]

    def made(self, kind: type[Part], table: Table, name: str, **values: object) -> Part:
        """Return the module of a class from a table with this name; `values` replace what the table leaves out."""
        return build(values | self.described(kind, table), (kind, *INNER), name)

    def described(self, kind: type, table: Table) -> Table:
        """Return the description of a table for a class, in SI units, including the tables within it."""
        values = {}
        for name, value in without_stations(table, self.unit).items():
            # modules within this one: one table with a type, or a list of them
            rows: list[Any] = value if isinstance(value, list) and value else [value]
            if all(isinstance(row, dict) and TYPE in row for row in rows):
                inner = [self.described(known_type(str(row[TYPE]), INNER, name), row) for row in rows]
                values[name] = inner if rows is value else inner[0]
            else:
                values[name] = quantity(name, value, unit_of(kind, name))
        if issubclass(kind, SurveyedTrack | SurveyedRails) and "file" in values:
            values["file"] = self.beside(values["file"])
        if issubclass(kind, TabulatedLoad) and "file" in values:
            values = describe(kind.from_file(self.beside(values.pop("file")))) | values
        return values | {TYPE: type_name(kind)}

    def beside(self, file: object) -> str:
        """Return the path of a file, relative to the folder of the scene's file."""
        return str(Path(self.file).parent / user_path(str(file)))

    def start(self, table: Table) -> Motion:
        """Return the motion at time zero, with its attitude as Euler angles or as a quaternion; for the type `AtRest`
        the motion that is added to the equilibrium."""
        kind = known_type(str(table.pop(TYPE, Motion.__name__)), (Motion, AtRest), "start")
        values = {}
        check_known(table, START)
        for name, value in table.items():
            values[name] = quantity(name, value, START[name].unit)
        # Euler angles and the quaternion are two forms of one attitude
        angles = [name for name in table if START[name].unit == "rad"]
        quaternion = [name for name in table if START[name].unit == "1"]
        if angles and quaternion:
            raise ValueError(f"`{angles[0]}` and `{quaternion[0]}` must not both be given.")
        motion = Motion.from_euler(**values) if angles else Motion(**values)
        return check_motion("start", kind(**vars(motion)))

    def arguments(self, kind: type, table: Table, name: str) -> dict[str, Any]:
        """Return the arguments that a table with this name gives, in SI units."""
        # checked as fields, which make numbers arrays
        given = {name: value for name, value in vars(self.made(kind, table, name)).items() if value is not None}
        return {name: value.tolist() if isinstance(value, Array) else value for name, value in given.items()}

    @contextmanager
    def placed(self, table: str, number: int = 0) -> Iterator[None]:
        """Add file and line to errors: the line of the name in the error, or of the table.

        **Arguments:** `number`: number of the table among tables of one name.
        """
        try:
            yield
        except TableError:  # this error names its own file
            raise
        except ValueError as error:
            if str(error).startswith(f"{self.file}, line "):
                raise  # this error has its line
            names: Any = self.tables
            for word in filter(None, table.split(".")):
                names = names.get(word, {}) if isinstance(names, dict) else {}
            if isinstance(names, list):
                names = names[number]
            mentioned = re.findall(r"`(?:\w+\.)*(\w+)`", str(error))
            # the first name in the error that is in the table
            line = self.line_of(table, next((name for name in mentioned if name in names), ""), number)
            words = " ".join(str(error).split())  # keys may have line breaks
            raise ValueError(f"{self.file}{'' if line is None else f', line {line}'}: {words}") from None

    def line_of(self, table: str, name: str, number: int) -> int | None:
        """Return the line where a name gets its value, or else where its table begins."""
        path = ".".join(filter(None, (table, name)))
        now = ""
        header = None
        left = number  # number of tables of this name that come first
        # a key belongs to the last header before it
        for at, line in enumerate(self.lines, 1):
            match = re.match(r"""\s*(\[*)\s*([\w."']+)\s*[]=]""", line)  # a header, or a key before its value
            if match:
                key = re.sub("[\"']", "", match[2])
                now = key if match[1] else now
                here = key if match[1] else ".".join(filter(None, (now, key)))
                left -= bool(match[1]) and key == table
                wanted = left < 0 or left == number  # or no table has begun
                if wanted and here == path:
                    return at
                if wanted and here == table:
                    header = header or at
        return header


def _taken(table: Table, name: str, inner: str) -> list[Any]:
    """Remove a value of a table within a table, and the table where nothing is left; return the value."""
    part = table.get(name)
    if not isinstance(part, dict) or inner not in part:
        return []
    rest = {key: value for key, value in part.items() if key != inner}
    if rest:
        table[name] = rest
    else:
        del table[name]
    return part[inner]


def check_known(names: Iterable[str], known: Collection[str]) -> None:
    """Raise `ValueError` for the first name that is not known."""
    for name in names:
        if name not in known:
            raise ValueError(f"`{name}` is none of {', '.join(known)}.{hint(name, known)}")


def without_stations(table: Table, unit: str) -> Table:
    """Return a table whose places along the rail are distances with a unit; `unit`: of stations."""
    return table | {name: _from_station(name, table[name], unit) for name in PLACES if name in table}


def _from_station(name: str, value: object, unit: str) -> object:
    """Return a station, such as 8+00, as a distance with a unit, also in lists; other values unchanged."""
    if isinstance(value, list):
        return [_from_station(name, part, unit) for part in value]
    if isinstance(value, str) and re.match(r"\s*\d+\s*\+", value):
        return f"{station(name, value, unit)!r} m"
    return value


def arguments_from(function: Callable, table: Table, units: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of a function that a table gives, in SI units; those without a default must be there."""
    parameters = inspect.signature(function).parameters.values()
    names = [one.name for one in parameters if one.name in table or one.default is one.empty]
    return {name: quantity(name, table.get(name), units.get(name, "")) for name in names}


def quantity(name: str, value: object, unit: str) -> Any:
    """Return a number, or nested lists of numbers, in the SI unit `unit`; a value without a unit unchanged."""
    if unit in ("", "1"):
        return value
    if not isinstance(value, dict):
        return _parsed(name, value, "", unit)
    if set(value) != {"values", "unit"}:
        raise ValueError(f"`{name}` must have `values` and `unit`, but has {', '.join(value) or 'nothing'}.")
    return _parsed(name, value["values"], str(value["unit"]), unit)


def _parsed(name: str, value: object, written: str, unit: str) -> Any:
    """Return texts with units, or numbers with the unit `written`, in nested lists, as numbers in `unit`."""
    if isinstance(value, list):
        return [_parsed(name, part, written, unit) for part in value]
    return parsed(name, f"{value!r} {written}" if written else value, unit)
