"""The command that writes a first scene file: every number with its unit and its meaning."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from string import ascii_uppercase

import click
import numpy as np

from ..model.beam import Beam
from ..model.dang2024 import paper_scene
from ..model.faults import Fault, FaultyTrack
from ..model.kinematics import Motion
from ..model.loads import AerodynamicLoad, AppliedLoad, Coulomb, TabulatedLoad
from ..model.parameters import PARAMETERS
from ..model.payload import Payload
from ..model.quantities import Quantity
from ..model.random_rails import RandomRails, RandomTrack
from ..model.scene import Scene
from ..model.scene_files import EnvironmentTable, LoadsTable, RunTable, scene_from_toml
from ..model.scene_text import Table, table_of, toml_lines
from ..model.section import Section
from ..model.sensors import Sensor
from ..model.sled import Mount, Sled
from ..model.slipper import Slipper
from ..model.surveys import JOINTS, SurveyedRails, SurveyedTrack, load_speed
from ..model.tracks import TwoRails
from ..model.travel import SpeedProgramme
from ..model.wear import Wear
from ..tools.checks import require
from ..tools.description import TYPE
from ..tools.files import content_of, user_path, write_whole
from ..tools.tables import Table as Columns
from ..tools.units import STANDARD_GRAVITY
from .options import FILE, INPUT, Adds, Measure, app, flag, option

SLED = ((1.2, 0.9, -0.2), (-1.2, 0.9, -0.2), (1.2, -0.9, -0.2), (-1.2, -0.9, -0.2))
"""Places of the slippers of --sled [m]."""
RAILS = ("sled", "german-low", "german-high", *(f"fra-{k}" for k in range(1, 7)))
"""Random rails: the constructor of `RandomTrack`, and its argument."""
WINDOW = 1.0
"""Window of the run [m]."""
TRAVEL = 500.0
"""Length of the run where no file gives it [m]."""
TEXTS = {
    "history": "Columns time or distance, and speed, with their units.",
    "begin": "Where along the rail the sled is at the first time, or at distance zero of the file.",
    "cutoff": "Frequency above which noise is removed; left out: none is.",
    "loads": "Columns time, distance or speed, and force_x (thrust), force_y, force_z, moment_x, ... with units.",
    "inertia": "About x, y and z [kg m^2], ESTIMATED: those of a box around the section, or the slippers of a sled.",
}
"""Remarks on values of the file that are no fields of the scene, or estimated."""
RECORD = """\
# Readings of the sensor box in {scene}: replace these rows, and lay the record over the model by
#     slipperjax run {scene} --measured {record}
# Time is zero where the run begins. Further columns may be distance [m] along the rail, or speed [m/s].
time [s], box [g]
0.0000, 0.0
0.0001, 0.0
"""
"""Template of a measured record."""


def _number(name: str, default: float | None, text: str) -> Adds:
    """Return an option for a number of the scene, by the name of its parameter."""
    q = PARAMETERS[name]
    return option(f"--{name}", Measure(q), f"{text} [{q.display_unit}].", default=default)


def _measure(name: str, unit: str, text: str) -> Adds:
    """Return an option for another number with a unit."""
    return option(f"--{name}", Measure(Quantity(name, unit, text)), f"{text[0].upper()}{text[1:]} [{unit}].")


_MILLIMETRES = Measure(Quantity("corner", "m", "place in the section", shown_unit="mm"))
METRES = Measure(Quantity("mount", "m", "place on the sled"))


@app.command()
@click.argument("file", type=FILE)
@option(
    "--section",
    INPUT,
    "Table of the section, or - for standard input: columns point (name), y (left), z (up), two rows for each face.",
)
@option(
    "--corner",
    (_MILLIMETRES, _MILLIMETRES),
    "A point of the section, without a table [mm]: y and z; repeat, two for each face, clockwise, y to the right.",
    multiple=True,
    metavar="Y Z",
)
@option(
    "--centre",
    (_MILLIMETRES, _MILLIMETRES),
    "The slipper's centre of mass among the points [mm].",
    default=(0.0, 0.0),
    metavar="Y Z",
)
@_number("clearance", 1.0, "Total play of slipper and rail")
@flag("--sled", "A sled on four slippers and two rails, instead of one slipper.")
@option(
    "--mount",
    (METRES, METRES, METRES),
    "Place of a sled's slipper from the sled's centre of mass [m]: x forwards, y to the left, z upwards; repeat for "
    "each. Slippers at y above 0 are on the left rail, below 0 on the right rail; if all are at 0, there is one.",
    multiple=True,
    metavar="X Y Z",
)
@_number("mass", None, "Mass of the slipper (default: 14), or of the sled with its slippers (default: 400)")
@option(
    "--inertia", (float, float, float), "Moments of inertia about x, y and z [kg m^2].", show_default="that of a box"
)
@_number("length", 0.2, "Distance between the front and the rear section")
@_number("stiffness", 1e8, "Contact stiffness")
@_number("restitution", 0.9, "Coefficient of restitution")
@_number("gravity", STANDARD_GRAVITY, "Gravitational acceleration")
@option("--friction", float, "Coefficient of friction of the contacts; default: none.")
@option(
    "--speed",
    str,
    "Travelling speed [m/s], or a table with its history: columns time or distance, and speed.",
    default="1250",
)
@_measure("cutoff", "Hz", "frequency above which noise is removed from a history over time")
@option("--end-speed", Measure(PARAMETERS["speed"]), "Speed at the end of the run [m/s]; default: constant speed.")
@option(
    "--rail",
    str,
    f"Survey of the rail, a table, or a random rail: {', '.join(RAILS)}.",
    default="sled",
    metavar="RAIL",
)
@option(
    "--right-rail",
    str,
    "The right rail, in the form of --rail; default: the same survey or spectrum.",
    metavar="RAIL",
)
@option("--joints", str, f"Places without a reading in a survey: {', '.join(JOINTS)}; default: an error.")
@_measure("down", "N", "force downwards on the slipper, such as a share of the sled's weight")
@_measure("drag-area", "m^2", "drag coefficient times area")
@option("--load", FILE, "Table of loads: columns time, distance or speed, and thrust, force_z, ...")
@_measure("travel", "m", "length of the run; default: as far as the tables of rail and speed go")
@option("--record", FILE, "Also write a template of a measured record to this file, and its sensor into the scene.")
@flag("--force", "Replace existing files.")
def new(
    file: Path,
    section: Path | None,
    corner: tuple[tuple[float, float], ...],
    centre: tuple[float, float],
    inertia: tuple[float, float, float] | None,
    friction: float | None,
    sled: bool,
    mount: tuple[tuple[float, float, float], ...],
    down: float | None,
    drag_area: float | None,
    load: Path | None,
    record: Path | None,
    force: bool,
    speed: str,
    cutoff: float | None,
    end_speed: float | None,
    rail: str,
    right_rail: str | None,
    joints: str | None,
    travel: float | None,
    **numbers: float,
) -> None:
    """Write a first scene: FILE, in TOML, with all numbers of the slipper or the sled, its rails and its run.

    All other values are those of the paper's slipper on a random sled track. Read the file, change it, and run it
    with `slipperjax run FILE`.
    """
    require(file.suffix.lower() == ".toml", "file", "end with .toml", shown=str(file))
    for path in filter(None, [file, record]):
        if path.exists() and not force:
            raise ValueError(f"{path} is there already: name another one, or replace it by --force.")
    is_sled = sled or bool(mount)
    places = np.vectorize(_plain)(mount or (SLED if sled else [[0.0, 0.0, 0.0]]))
    if numbers["mass"] is None:
        numbers["mass"] = 400.0 if is_sled else 14.0
    values = {name: _plain(PARAMETERS[name].from_shown(number)) for name, number in numbers.items()}
    own_section = _section(section, corner, centre)
    # of a box around all slippers and the centre of mass
    spans = np.ptp(np.append(places, [[0.0, 0.0, 0.0]], axis=0), axis=0)
    box = (spans + np.append(values["length"], np.ptp(own_section.points, axis=0))) ** 2
    moments = inertia or [float(f"{moment:.6g}") for moment in values["mass"] / 12 * (np.sum(box) - box)]
    body = dict(mass=values["mass"], inertia=moments, length=values["length"])
    if is_sled:
        # on a monorail all are in the middle
        sides = np.where(places[:, 1] > 0, "left", "right") if places[:, 1].any() else [""] * len(places)
        body["mounts"] = [Mount(*place, rail=str(side)) for place, side in zip(places, sides, strict=True)]
    slipper = Sled(**body) if is_sled else Slipper(**body)
    way = _way(places, speed, cutoff, end_speed, rail, right_rail, joints, travel)
    scene = dataclasses.replace(paper_scene(), slipper=slipper, section=own_section, track=way["track"])
    tables = {**table_of(scene.replace(**values)).values, **way}
    if inertia is None:
        tables["slipper"] = table_of(slipper, inertia=TEXTS["inertia"])
    if friction is not None:
        tables["friction"] = Coulomb(friction)
    loads = []
    if down is not None:
        loads.append(AppliedLoad([0.0, 0.0, -down]))
    if drag_area is not None:
        loads.append(AerodynamicLoad(drag_area, 1.0))
    if load is not None:
        of_file = {TYPE: TabulatedLoad.__name__, "file": str(load), "arm": [0.0, 0.0, 0.0]}
        loads.append(Table(TabulatedLoad, of_file, {"file": TEXTS["loads"]}))
    if loads:
        tables["load"] = loads
    if record is not None:
        sensor = Sensor("box")
        tables["sensors.box"] = Table(Sensor, {"place": sensor.place, "direction": "z"})
    optional = {name: part for name, part in _examples().items() if tables.get(name) is None}
    tables = {name: part for name, part in tables.items() if name not in optional}
    fault = Table(Fault, {"at": float(scene.track.origin) + 20.0, "height": -1e-3, "length": 0.5, "kind": "joint"})
    examples = [
        *toml_lines(Table(Scene, optional), remarks=True),
        *toml_lines(Table(FaultyTrack, {"faults": [fault]}), "track", remarks=True),
    ]
    text = [
        f"# A {'sled on slippers' if is_sled else 'slipper on a rail'}. Run it by",
        f"#     slipperjax run {file.name}",
        '# Every number has a unit, any of its kind, as "1.5 mm" or "1/16 in". What stands behind # is a remark;',
        "# tables at the end count without the # before their lines. The page docs/how_to/scenes.md shows all.",
        "",
        *toml_lines(Table(Scene, tables), remarks=True, folder=file.parent),
        *("#" * bool(re.match(r"[^#]", line)) + line for line in "\n".join(examples).splitlines()),
        "",
    ]
    # errors are found before anything is written
    scene_from_toml("\n".join(text), str(file))
    write_whole(file, "\n".join(text).encode())
    if record is not None:
        write_whole(record, RECORD.format(scene=file.name, record=record.name).encode())
        print(f"wrote {record}: replace its rows by a record of the sensor box")
    print(f"wrote {file}: look through it, and run it by slipperjax run {file}")


def _plain(value: float) -> float:
    """Return a number with nine digits, which a file shows without the rounding of units."""
    return float(f"{value:.9g}")


def _examples() -> dict[str, object]:
    """Return tables that a file may have, by name, with values to begin with."""
    return {
        "friction": Coulomb(0.2),
        "load": [Table(AppliedLoad, {TYPE: AppliedLoad.__name__, "force": [0.0, 0.0, -800.0]})],
        "payload": Table(Payload, {"mass": 100.0, "stiffness": [2e6, 8e6]}),
        "wear": Wear(1e-13),
        "beam": Beam((2.4e6, 6.3e6), 85.0, (1e8, 1e8), (3.7e3, 3.7e3)),
        "start": Table(Motion, {"v_y": 0.5, "z": 1e-4}),
        "environment": EnvironmentTable([[0.0, 0.0, 0.05]], margin=3.0),
        "loads": LoadsTable([1e-3, 5e-3]),
    }


def _section(table: Path | None, corners: Sequence[Sequence[float]], centre: Sequence[float]) -> Section:
    """Return the section of a table or of corners [mm], by default the paper's, without play.

    **Arguments:** `centre`: the slipper's centre of mass among the points [mm].
    """
    if table is not None and corners:
        raise ValueError("Option --corner must not be given with --section, which has all points.")
    option = "--corner" if table is None else "--section"
    points = np.array(corners)
    names = []
    if table is not None:
        read = Columns(table, content_of(table), {"y": "m", "z": "m"}, {}, labels="point")
        names = read.labels
        if len(read.columns) < 2:
            read.fault(f"must have y and z, but has {', '.join(read.columns)}")
        points = 1e3 * np.stack(list(read.si().values()), axis=1)
        if names:
            once = len(set(names)) == len(names) and all(names)
            require(once, option, "have another name for each point", shown=", ".join(names))
    require(len(points) % 2 == 0, option, "have two points for each face", shown=f"{len(points)} points")
    # from A to Z, then from A2 on
    names = names or [ascii_uppercase[k % 26] + (str(k // 26 + 1) if k > 25 else "") for k in range(len(points))]
    faces = tuple(zip(names[::2], names[1::2], strict=True))
    if not faces:
        paper = paper_scene().section
        points, names, faces = 1e3 * np.asarray(paper.points), paper.names, paper.faces
    # rounded in mm, in which they are written
    return Section(1e-3 * np.round(points - np.array(centre), 9), np.zeros(len(faces)), tuple(names), faces)


def _way(
    places: np.ndarray,
    speed: str,
    cutoff: float | None,
    end_speed: float | None,
    rail: str,
    right: str | None,
    joints: str | None,
    travel: float | None,
) -> dict[str, object]:
    """Return track, speed and run of slippers at places [m], from options."""
    y = places[:, 1]
    two = bool(y.any())
    require(two or right is None, "--right-rail", "come with --sled, or a --mount on it", right)
    require(y.all() or not two, "--mount", "have a y above or below 0 for each, or 0 for all", shown="0 for some")
    # places that are not symmetric give no gauge
    gauge = float(2 * abs(y[0])) if two and np.ptp(np.abs(y)) == 0 else None
    rails = {"--rail": rail} if right is None else {"--rail": rail, "--right-rail": right}
    surveys: dict[str, SurveyedTrack | SurveyedRails] = {}
    for name, text in rails.items():
        if text not in RAILS:
            path = _existing(name, text, f"one of {', '.join(RAILS)}")
            both = two and right is None
            surveys[name] = (
                SurveyedRails(path, gauge=gauge, joints=joints) if both else SurveyedTrack(path, joints=joints)
            )
    begin = max((float(survey.begin) for survey in surveys.values()), default=0.0)
    spans = [min(float(survey.extent) for survey in surveys.values()) - begin] if surveys else []
    history = None
    try:
        first = _plain(Measure(PARAMETERS["speed"]).convert(speed, None, None))
    except ValueError:
        history = load_speed(_existing("--speed", speed, "a speed"), cutoff=cutoff)
        if end_speed is not None:
            raise ValueError(f"Option --end-speed must not be given with the history {speed}.") from None
        spans.append(float(history.distance[-1] - history.distance[0]))
    require(history is not None or cutoff is None, "--cutoff", "come with a history of speeds", cutoff)
    length = WINDOW * max(1, int(min(spans, default=TRAVEL) / WINDOW)) if travel is None else _plain(travel)
    if history is not None:
        # distances of the rail stay unchanged; other distances begin with the rail
        start = float(history.distance[0])
        on_rail = begin <= start < begin + (spans[0] if surveys else length)
        shift = f"{0.0 if on_rail else begin - start:.9g} m"
        texts = {"file": TEXTS["history"], "begin": TEXTS["begin"], "cutoff": TEXTS["cutoff"]}
        of_file = {"file": str(user_path(speed)), "begin": shift}
        if cutoff is not None:
            of_file["cutoff"] = f"{cutoff:.9g} Hz"
        way = Table(SpeedProgramme, of_file, texts)
    elif end_speed is not None:
        way = Table(SpeedProgramme, {"distance": [begin, begin + length], "speed": [first, end_speed]})
    else:
        way = first
    tracks = [surveys.get(name) or _random(text, length, k) for k, (name, text) in enumerate(rails.items())]
    track = tracks[0]
    if right is not None:
        track = TwoRails(*tracks, gauge=gauge)
    elif two and not surveys:
        # a gauge that varies more than the play wedges the sled
        track = RandomRails(track, 0.95, gauge)
    return {"speed": way, "track": track, "run": RunTable(length, window=WINDOW)}


def _random(rail: str, length: float, seed: int) -> RandomTrack:
    """Return a random rail of at least some length [m]."""
    kind, _, which = rail.partition("-")
    of = [int(which) if which.isdecimal() else which] if which else []
    # rails are at least twice as long as their longest wave
    return getattr(RandomTrack, kind)(*of, length=max(length, 200.0), seed=seed)


def _existing(option: str, text: str, otherwise: str) -> Path:
    """Return the path of a file that an option names; raise `ValueError` where there is no file."""
    path = user_path(text)
    require(path.is_file(), option, f"be a file, or {otherwise}", text, names=RAILS if "rail" in option else ())
    return path
