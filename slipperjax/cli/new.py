"""The command that writes a first scene file: every number with its unit and its meaning."""

import dataclasses
import json
import os
from pathlib import Path
from string import Template

import click
import numpy as np

from ..model.dang2024 import paper_scene
from ..model.parameters import PARAMETERS
from ..model.quantities import Quantity
from ..tools.checks import require
from ..tools.files import content_of, user_path, write_whole
from ..tools.units import STANDARD_GRAVITY
from .options import FILE, INPUT, Adds, Measure, app, flag, option

SCENE = Template("""\
# $what. Run it by
#     slipperjax run $name
# Every number has a unit, any of its kind, as "1.5 mm" or "1/16 in". What stands behind # is a remark.

gravity = "$gravity m/s^2"  # downwards
$speed

[slipper]
mass = "$mass kg"  # $whole
length = "$length m"  # of a slipper, from its front to its rear section
# moments of inertia about x (forwards), y (to the left) and z (upwards), $source
inertia = { values = [$inertia], unit = "kg m^2" }
$mounts
[section]  # of the slipper, the same at its front and its rear
clearance = "$clearance mm"  # total play of slipper and rail; half of it at each face
names = [$names]  # of the points
# two points for each face, clockwise with y to the right and z up
faces = [$faces]
points = { unit = "mm", values = [  # y (to the left) and z (upwards) of each, from the slipper's $middle
$points
] }

$track

[contact]
type = "Flores"  # or HuntCrossley, LankaraniNikravesh, HertzSpring, ConstantDamping
stiffness = "$stiffness N/m^1.5"  # Hertz's, of a corner; steel has 1.5e10 to 1.5e11
restitution = $restitution  # speed after an impact over that before it

$friction

$loads

[run]
length = "$travel m"  # of rail
window = "$window m"  # of the rail for which each number of the result stands
# begin = "$begin m"  # place of the rail; without this line where the rail begins
# steps_per_period = 400  # steps of integration in a window; without this line as many as impacts need

# [start]  # of the motion; without this table the $body is at rest on the rail
# z = "0 mm"  # also y; roll, pitch, yaw; v_y, v_z; w_x, w_y, w_z
""")

MOUNT = Template("""
[[mounts]]  # $name
x = "$x m"  # of the slipper's middle from the sled's centre of mass, forwards
y = "$y m"  # to the left
z = "$z m"  # upwards$rail
""")
MODES = """
# [modes]  # elastic modes; without this table the sled is rigid
# beam = { mass = "400 kg", length = "3 m", stiffness = "5e6 N m^2" }  # or file = "modes.csv", from finite elements
"""
OF_SLIPPER = {
    "what": "A slipper on a rail",
    "body": "slipper",
    "whole": "of the slipper alone; a sled on springs is a table [payload]",
    "middle": "centre of mass",
    "box": "section",
}
"""Texts for a file of one slipper."""
OF_SLED = {
    "what": "A sled on slippers",
    "body": "sled",
    "whole": "of the sled with its slippers",
    "middle": "middle",
    "box": "slippers",
}
"""Texts for a file of a sled."""
SLED = ((1.2, 0.9, -0.2), (-1.2, 0.9, -0.2), (1.2, -0.9, -0.2), (-1.2, -0.9, -0.2))
"""Places of the slippers of --sled [m]."""

CONSTANT = Template("""\
speed = "$speed m/s"  # constant""")
FROM_TO = Template("""
[speed]  # at constant acceleration between these places
distance = { values = [$begin, $end], unit = "m" }  # along the rail
speed = { values = [$speed, $end_speed], unit = "m/s" }  # there""")
HISTORY = Template("""
[speed]
file = $file  # columns time or distance, and speed, with their units
begin = "$begin m"  # where along the rail the sled is at the first time, or at distance zero of the file""")

TWO_RAILS = Template("""\
[track]
type = "TwoRails"
$gauge

$left

$right""")
RANDOM_RAILS = Template("""\
[track]
type = "RandomRails"
$gauge
coherence = 0.95  # of left and right, magnitude squared; a gauge that varies more than the play wedges the sled
seed = 0  # number of the pair of rails; each is another one

$rail""")
SURVEY = Template("""\
[$table]
${first}file = $file  # columns distance, lateral and vertical, with their units
ends = "straight"  # how the rail goes on beyond its survey; or "repeat", or "error" for none""")
RANDOM = Template("""\
[$table]  # a random rail, $words
$entries""")
REMARKS = {
    "lateral": "density of the displacement to the left by the wavenumber",
    "vertical": "and of that upwards",
    "band": "its shortest and its longest wave",
    "length": "of the rail",
    "seed": "number of the rail; each is another one",
    "roughness": "factor of all displacements",
    "ends": "how it goes on beyond its length",
    "ramp": "over which it becomes straight at its ends",
    "first": "where it begins",
}
"""Explanations of the values of a random rail."""

FRICTION = Template("""\
[friction]
type = "Coulomb"  # or FadingFriction, with power and exponent
coefficient = $value  # force along the rail over that across it""")
DOWN = Template("""\
[[load]]  # such as a share of the sled's weight
type = "AppliedLoad"
force = { values = [0, 0, -$value], unit = "N" }  # along x (forwards), y (left) and z (up)""")
DRAG = Template("""\
[[load]]  # drag of the air
type = "AerodynamicLoad"
area = "$value m^2"  # that the coefficients refer to
drag_coefficient = 1.0  # of that area; also lift_coefficient, side_coefficient, and tables of them by mach
arm = { values = [0, 0, 0], unit = "mm" }  # where it acts, from the $body's centre of mass""")
TABLE = Template("""\
[[load]]
type = "TabulatedLoad"
file = $value  # columns time, distance or speed, and force_x (thrust), force_y, force_z, moment_x, ...
arm = { values = [0, 0, 0], unit = "mm" }  # where the force acts, from the $body's centre of mass""")

RAILS = {
    "sled": "of a sled track's published spectrum",
    **{f"german-{name}": f"of German railways, {name} disturbance" for name in ("low", "high")},
    **{f"fra-{k}": f"of class {k} of the Federal Railroad Administration" for k in range(1, 7)},
}
"""Random rails by the names for --rail."""
WINDOW = 1.0
"""Window of the run [m]."""
TRAVEL = 500.0
"""Length of the run where no file gives it [m]."""


def _number(name: str, default: float | None, text: str) -> Adds:
    """Return an option for a number of the scene, by the name of its parameter."""
    q = PARAMETERS[name]
    return option(f"--{name}", Measure(q), f"{text} [{q.display_unit}].", default=default)


def _measure(name: str, unit: str, text: str, **more: object) -> Adds:
    """Return an option for another number with a unit."""
    return option(f"--{name}", Measure(Quantity(name, unit, text)), f"{text[0].upper()}{text[1:]} [{unit}].", **more)


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
@_measure("down", "N", "force downwards on the slipper, such as a share of the sled's weight")
@_measure("drag-area", "m^2", "drag coefficient times area")
@option("--load", FILE, "Table of loads: columns time, distance or speed, and thrust, force_z, ...")
@_measure("travel", "m", "length of the run; default: as far as the tables of rail and speed go")
@flag("--force", "Replace an existing file.")
def new(
    file: Path,
    section: Path | None,
    corner: tuple[tuple[float, float], ...],
    centre: tuple[float, float],
    inertia: tuple[float, float, float] | None,
    friction: float | None,
    speed: str,
    end_speed: float | None,
    rail: str,
    right_rail: str | None,
    sled: bool,
    mount: tuple[tuple[float, float, float], ...],
    down: float | None,
    drag_area: float | None,
    load: Path | None,
    travel: float | None,
    force: bool,
    **numbers: float,
) -> None:
    """Write a first scene: FILE, in TOML, with all numbers of the slipper or the sled, its rails and its run.

    All other values are those of the paper's slipper on a random sled track. Read the file, change it, and run it
    with `slipperjax run FILE`.
    """
    # here, because help does not need these
    from ..model.scene_files import scene_from_toml

    require(file.suffix.lower() == ".toml", "file", "end with .toml", shown=str(file))
    if file.exists() and not force:
        raise ValueError(f"{file} is there already: name another one, or replace it by --force.")
    points, names = _points(section, corner)
    points = points - np.array(centre)
    places = np.array(mount or (SLED if sled else [[0.0, 0.0, 0.0]]))
    is_sled = sled or bool(mount)
    words = OF_SLED if is_sled else OF_SLIPPER
    if numbers["mass"] is None:
        numbers["mass"] = 400.0 if is_sled else 14.0
    values = {name: f"{number:.9g}" for name, number in numbers.items()}
    # around all slippers and the centre of mass
    spans = np.ptp(np.append(places, [[0.0, 0.0, 0.0]], axis=0), axis=0)
    box = (spans + np.append(numbers["length"], 1e-3 * np.ptp(points, axis=0))) ** 2
    moments = numbers["mass"] / 12 * (np.sum(box) - box) if inertia is None else inertia
    quoted = [f'"{name}"' for name in names]
    values |= {
        "name": file.name,
        "inertia": ", ".join(f"{moment:.6g}" for moment in moments),
        **words,
        "source": f"ESTIMATED: those of a box around the {words['box']}" if inertia is None else "as given",
        "mounts": _mounts(places) if is_sled else "",
        "names": ", ".join(quoted),
        "faces": ", ".join(f"[{a}, {b}]" for a, b in zip(quoted[::2], quoted[1::2], strict=True)),
        "points": "\n".join(f"    [{y:.9g}, {z:.9g}]," for y, z in points),
        "window": f"{WINDOW:g}",
        **_way(file, speed, end_speed, _rails(places, rail, right_rail), _gauge(places), travel),
        "friction": _part(FRICTION, friction, 0.2),
    }
    loads = [
        _part(DOWN, down, 800.0),
        _part(DRAG, drag_area, 0.01, **words),
        _part(TABLE, None if load is None else _beside(file, load), _beside(file, Path("thrust.csv")), **words),
    ]
    values["loads"] = "\n\n".join(loads)
    text = SCENE.substitute(values)
    # errors are found before anything is written
    scene_from_toml(text, str(file))
    write_whole(file, text.encode())
    print(f"wrote {file}: look through it, and run it by slipperjax run {file}")


def _points(section: Path | None, corners: tuple[tuple[float, float], ...]) -> tuple[np.ndarray, list[str]]:
    """Return the points of the section [mm] and their names, two successive points for each face."""
    from ..tools.tables import Table

    if section is not None and corners:
        raise ValueError("Option --corner must not be given with --section, which has all points.")
    if section is None and not corners:
        paper = paper_scene().section
        names = [name for face in paper.faces for name in face]
        return 1e3 * np.asarray(paper.points)[[paper.names.index(name) for name in names]], names
    points = np.array(corners)
    named: list[str] = []
    if section is not None:
        table = Table(section, content_of(section), {"y": "m", "z": "m"}, {}, labels="point")
        named = table.labels
        if len(table.columns) < 2:
            table.fault(f"must have y and z, but has {', '.join(table.columns)}")
        points = 1e3 * np.stack(list(table.si().values()), axis=1)
    option = "--corner" if section is None else "--section"
    require(len(points) % 2 == 0, option, "have two points for each face", shown=f"{len(points)} points")
    if named:
        once = len(set(named)) == len(named) and all(named)
        require(once, option, "have another name for each point", shown=", ".join(named))
        return points, named
    # from A to Z, then from A2 on
    names = [chr(ord("A") + k % 26) + (str(k // 26 + 1) if k >= 26 else "") for k in range(len(points))]
    return points, names


def _rails(places: np.ndarray, rail: str, right: str | None) -> dict[str, str]:
    """Return the rails for slippers at places [m], by the tables of the file: "track" is a single rail, "track.rail"
    means two rails of one survey or spectrum."""
    y = places[:, 1]
    if not y.any():
        require(right is None, "--right-rail", "come with --sled, or a --mount on it", right)
        return {"track": rail}
    require(y.all(), "--mount", "have a y above or below 0 for each, or 0 for all", shown="0 for some")
    return {"track.rail": rail} if right is None else {"track.left": rail, "track.right": right}


def _gauge(places: np.ndarray) -> float | None:
    """Return the distance between two rails [m]; None where the places of slippers [m] do not give it."""
    beside = np.abs(places[:, 1])
    return float(2 * beside[0]) if beside.all() and np.ptp(beside) == 0 else None


def _mounts(places: np.ndarray) -> str:
    """Return the tables of slippers at places [m]."""
    two = places[:, 1].any()
    tables = []
    counts = {"left": 0, "right": 0}
    for x, y, z in places:
        side = "left" if y >= 0 else "right"
        counts[side] += 1
        name = f"{side}{counts[side]}" if two else f"slipper {counts[side]}"
        rail = f'\nrail = "{side}"  # on which it is' if two else ""
        tables.append(MOUNT.substitute(name=name, x=f"{x:.9g}", y=f"{y:.9g}", z=f"{z:.9g}", rail=rail))
    return "".join([*tables, MODES])


def _way(
    file: Path, speed: str, end_speed: float | None, rails: dict[str, str], gauge: float | None, travel: float | None
) -> dict[str, str]:
    """Return the template's texts for rails, speed and length of the run, from options."""
    from ..model.surveys import SurveyedRails, SurveyedTrack, load_speed

    surveys = []
    for name, (table, rail) in zip(("--rail", "--right-rail"), rails.items(), strict=False):
        if rail not in RAILS:
            path = _existing(name, rail, f"one of {', '.join(RAILS)}")
            surveys.append(SurveyedRails(path, gauge=gauge) if table == "track.rail" else SurveyedTrack(path))
    history = None
    try:
        first = float(Measure(PARAMETERS["speed"]).convert(speed, None, None))
    except ValueError:
        history = load_speed(_existing("--speed", speed, "a speed"))
        if end_speed is not None:
            raise ValueError(f"Option --end-speed must not be given with the history {speed}.") from None
    begin = 0.0
    spans = []
    if surveys:
        begin = max(float(survey.begin) for survey in surveys)
        spans.append(min(float(survey.extent) for survey in surveys) - begin)
    if history is not None:
        spans.append(float(history.distance[-1] - history.distance[0]))
    length = WINDOW * max(1, int(min(spans, default=TRAVEL) / WINDOW)) if travel is None else travel
    way = {"begin": f"{begin:.9g}", "travel": f"{length:.9g}", "track": _track(file, rails, gauge, length)}
    if history is not None:
        # distances of the rail stay unchanged; other distances begin with the rail
        start = float(history.distance[0])
        on_rail = begin <= start < begin + (spans[0] if surveys else length)
        shift = f"{0.0 if on_rail else begin - start:.9g}"
        way["speed"] = HISTORY.substitute(file=_beside(file, user_path(speed)), begin=shift)
    elif end_speed is None:
        way["speed"] = CONSTANT.substitute(speed=f"{first:.9g}")
    else:
        ends = {"end": f"{begin + length:.9g}", "end_speed": f"{end_speed:.9g}"}
        way["speed"] = FROM_TO.substitute(begin=way["begin"], speed=f"{first:.9g}", **ends)
    return way


def _track(file: Path, rails: dict[str, str], gauge: float | None, length: float) -> str:
    """Return the tables of the rails for a run of some length [m]; rails that are not random are surveys."""
    between = f'gauge = "{gauge or 1.8:.9g} m"  # between the axes of the rails; without it each is at its mounts'
    between = between if gauge else f"# {between}"
    tables = []
    for seed, (table, rail) in enumerate(rails.items()):
        alike = table == "track.rail"
        if rail in RAILS:
            # for two similar rails the pair has the seed
            one = _random(rail, length, table, None if alike else seed)
            tables.append(RANDOM_RAILS.substitute(gauge=between, rail=one) if alike else one)
        else:
            # a survey is known by its file, except in a table within the track's table
            first = {"track": "", "track.rail": f"{between}\n"}.get(table, 'type = "SurveyedTrack"\n')
            path = _beside(file, user_path(rail))
            tables.append(SURVEY.substitute(table=table.removesuffix(".rail"), first=first, file=path))
    if len(tables) == 1:
        return tables[0]
    left, right = tables
    return TWO_RAILS.substitute(gauge=between, left=left, right=right)


def _random(rail: str, length: float, table: str, seed: int | None) -> str:
    """Return the table of a random rail of at least some length [m]; without a seed where it is None."""
    from ..model.random_rails import RandomTrack

    kind, _, which = rail.partition("-")
    make = {"sled": RandomTrack.sled, "german": RandomTrack.german, "fra": RandomTrack.fra}[kind]
    of = [int(which) if which.isdecimal() else which] if which else []
    # rails are at least twice as long as their longest wave
    track = make(*of, length=max(length, 200.0), seed=seed or 0)
    text = dataclasses.replace(paper_scene(), track=track).to_toml()
    lines = []
    for line in text.partition("[track]\n")[2].partition("\n\n")[0].splitlines():
        name = line.partition(" ")[0]
        if name != "seed" or seed is not None:
            lines.append(f"{line}  # {REMARKS[name]}" if name in REMARKS else line)
    return RANDOM.substitute(table=table, words=RAILS[rail], entries="\n".join(lines))


def _existing(option: str, text: str, otherwise: str) -> Path:
    """Return the path of a file that an option names; raise `ValueError` where there is no file."""
    path = user_path(text)
    require(path.is_file(), option, f"be a file, or {otherwise}", text, names=RAILS if "rail" in option else ())
    return path


def _beside(file: Path, other: Path) -> str:
    """Return the path of another file relative to the folder of a file, as a text of TOML."""
    return json.dumps((other if other.is_absolute() else Path(os.path.relpath(other, file.parent))).as_posix())


def _part(template: Template, value: float | str | None, example: float | str, **words: str) -> str:
    """Return a part of the file; if it has no value, as remarks with an example."""
    given = example if value is None else value
    text = template.substitute(words, value=given if isinstance(given, str) else f"{given:.9g}")
    return "\n".join(f"# {line}" for line in text.splitlines()) if value is None else text
