"""Scene files: units are needed and converted, errors name file and line, and a scene comes back to the last bit."""

import dataclasses
import itertools
import math
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.cli.options import FILE as FILE_OPTION
from slipperjax.model.quantities import ACCELERATIONS, COORDINATES, REACTIONS, Quantity, ShownUnits
from slipperjax.model.scene_files import scene_from_json, scene_from_toml, scene_to_json
from slipperjax.tools.checks import finite, positive
from slipperjax.tools.units import parsed

from ..common import fine

CORNERS = [(1.2, 0.9, "left"), (-1.2, 0.9, "left"), (1.2, -0.9, "right"), (-1.2, -0.9, "right")]


class Bump(sj.model.AbstractTrack):
    """A user's own track."""

    pitch: jnp.ndarray = eqx.field(converter=positive("pitch", "m"))
    heights: jnp.ndarray = eqx.field(converter=finite("heights", "m"))

    @property
    def wavelength(self):
        return self.pitch

    def irregularity(self, distance):
        bump = self.heights[0] * jnp.sin(2 * jnp.pi * distance / self.pitch)
        return sj.model.Irregularity(bump, self.heights[1] * bump, None)


def scenes():
    scene = sj.paper_scene(1234.5, 0.1 + 0.2e-3, 0.3, wavelengths=(8.0, 3.3))
    laws = (
        sj.model.HuntCrossley(1e9, 1 / 3, clamp=False),
        sj.model.HertzSpring(1e7),
        sj.model.ConstantDamping(1e8, 0.1),
    )
    memories = (
        sj.model.SmoothSwitch(),
        sj.model.SmoothSwitch(1e-6, relaxation=1e-7),
        sj.model.EventLatch(2e-3),
        sj.model.PeakRateLatch(2e-3),
    )
    parts = {"track": (sj.model.StraightTrack(), Bump(5.0, (1e-3, 0.3))), "contact": laws, "memory": memories}
    others = [dataclasses.replace(scene, **{name: part}) for name in parts for part in parts[name]]
    load, friction = (
        sj.model.AppliedLoad([0.0, 20.0, -500.0], [1.0, -2.0, 3.0]),
        sj.model.FadingFriction(0.3, 1e6, 0.5),
    )
    others += [dataclasses.replace(scene, load=load, friction=friction, payload=sj.model.Payload(100.0, [2e6, 8e6]))]
    others += [dataclasses.replace(scene, speed=sj.SpeedProgramme.over_distance([0.0, 16.0], [1200.0, 1300.0]))]
    others += [dataclasses.replace(scene, window=7.7)]
    others += [
        dataclasses.replace(
            scene, slipper=sled(), track=sj.model.TwoRails(scene.track, sj.model.StraightTrack(), gauge=1.8)
        )
    ]
    return [scene, scene.replace(gravity=9.81, **{"section.play.2": 1e-4 / 3}), *others]


def sled():
    """Four slippers, two of which have something of their own, and an elastic sled with a payload's place."""
    mounts = [sj.Mount(x, y, -0.2, rail=rail) for x, y, rail in CORNERS]
    mounts[1] = dataclasses.replace(mounts[1], section=sj.model.paper_section(1e-3 / 3), length=0.3, name="rear")
    mounts[2] = dataclasses.replace(mounts[2], x=None, play=np.arange(5) * 1e-4 / 3)
    places = [1.2, -1.2, 0.0, -1.2]
    modes = sj.model.Modes.beam(
        places, mass=400.0, length=3.0, stiffness=[5e6, 2e6], count=4, places=[[0.5, 0.0, 0.1]]
    )
    return sj.Sled(400.0, (150.0, 300.0, 350.0), mounts, modes=modes)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_scenes_come_back_to_the_last_bit_from_toml_and_json():
    for scene in scenes():
        assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)
        assert eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene)
        assert not eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene.replace(length=0.31))


@pytest.mark.full
def test_starts_come_back_too():
    start = sj.Motion.from_euler(y=1e-4 / 3, roll=1e-3, v_z=-0.7)
    found = scene_from_toml(sj.paper_scene().to_toml(start=start)).start
    assert vars(found) == vars(start)
    assert scene_from_toml(sj.paper_scene().to_toml()).start is None
    run = fine(sj.paper_scene())
    assert float(scene_from_toml(sj.paper_scene().to_toml(start=run.end.motion)).start.y) == float(run.end.motion.y)
    moving = sj.Motion(y=1e-4, payload=sj.model.PayloadMotion(z=1e-3))
    with pytest.raises(ValueError, match="`start` must have no motion of the payload in TOML, but has PayloadMotion"):
        sj.paper_scene().to_toml(start=moving)
    for wrong in (run, run.end, {"y": 1e-4}):
        with pytest.raises(ValueError, match=r"`start` must be a slipperjax.Motion in TOML, .* run\.end"):
            sj.paper_scene().to_toml(start=wrong)


FILE = """
base = "paper"       # everything else is the paper's
speed = "4500 km/h"

[slipper]
mass = "15000 g"
inertia = { values = [51, 60, 86], unit = "g m^2" }
length = "20 cm"

[section]
clearance = "1.5 mm"

[track]
wavelengths = ["800 cm"]
roll_amplitude = "0.2 degrees"

[contact]
type = "HuntCrossley"

[start]
v_y = "50 cm/s"
pitch = "1 mrad"
"""


def test_units_are_converted_and_the_rest_is_the_base_s():
    found = scene_from_toml(FILE)
    scene = found.scene
    values = dict(speed=1250.0, mass=15.0, inertia_x=0.051, inertia_y=0.060, inertia_z=0.086, length=0.2)
    values |= {"clearance": 1.5e-3, "track.wavelengths.0": 8.0, "roll_amplitude": math.radians(0.2)}
    for name, value in values.items():
        np.testing.assert_allclose(scene.value(name), value, rtol=1e-15, err_msg=name)
    assert type(scene.contact) is sj.model.HuntCrossley
    assert float(scene.contact.stiffness) == 1e8
    assert eqx.tree_equal(scene.section.points, sj.model.paper_section(1e-3).points)
    for text in ("0.2°", "0.2 °", "0.2 degrees", "0.2deg"):
        np.testing.assert_allclose(parsed("roll_amplitude", text, "rad"), math.radians(0.2), rtol=1e-15)
    np.testing.assert_allclose(found.start.v_y, 0.5, rtol=1e-15)
    np.testing.assert_allclose(found.start.q_y, math.sin(0.5e-3), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "si", "exact"),
    [
        ("20 standard_gravity", "m/s^2", 196.133),
        ("20 g", "m/s^2", 196.133),
        ("50 m s-1", "m/s", 50.0),
        ("3937 us_survey_foot", "m", 1200.0),
        ("30 lbm", "kg", 13.6077711),
        ("2 mm^2 per cycle/m", "m^2 per cycle/m", 2e-6),
    ],
)
def test_units_of_engineers_and_of_netcdf_files(text, si, exact):
    np.testing.assert_allclose(parsed("name", text, si), exact, rtol=1e-12)


@pytest.mark.parametrize("text", ["1 m^2", "1 m**9**9**9", "1 m s-"])
def test_units_of_another_kind_are_one_line(text):
    with pytest.raises(ValueError, match=r"`name` must be in a unit like m.2 per cycle/m, but is in"):
        parsed("name", text, "m^2 per cycle/m")


def test_paths_begin_in_the_user_s_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    rows = "\n".join(f"{0.25 * k}, {np.sin(k / 8)}, 0.5" for k in range(65))
    (tmp_path / "survey.csv").write_text(f"distance [m], lateral [mm], vertical [mm]\n{rows}\n")
    track = sj.load_rail("~/survey.csv")
    scene = dataclasses.replace(sj.paper_scene(), track=track)
    assert scene_from_json(scene_to_json(scene)).track == track
    (tmp_path / "deep").mkdir()
    for file in ("scene.toml", "deep/scene.toml"):
        (tmp_path / file).write_text('base = "paper"\n[track]\nfile = "~/survey.csv"\n')
        assert eqx.tree_equal(sj.load(f"~/{file}").scene.track.lateral, track.lateral)
    scene.to_toml("~/again.toml")
    assert (tmp_path / "again.toml").is_file()
    with pytest.raises(ValueError, match=f"{tmp_path}/none.zarr: must be a store of slipperjax"):
        sj.load("~/none.zarr")
    assert sj.sweeps.Store("~/none.zarr").path == tmp_path / "none.zarr"
    assert FILE_OPTION.convert("~/run", None, None) == tmp_path / "run"


@pytest.mark.full
def test_what_is_no_file_and_what_is_too_deep_is_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    for name, load in itertools.product(("pipe.toml", "zero.toml"), (sj.load, sj.load_rail)):
        with pytest.raises(ValueError, match=f"{name} must be a file, but is a folder, a device or a pipe"):
            load(tmp_path / name)
    for name, load in itertools.product(("pipe", "zero"), (sj.load, sj.load_rail)):
        link = tmp_path / f"{name}.nc"
        link.unlink(missing_ok=True)
        link.symlink_to(tmp_path / f"{name}.toml")
        with pytest.raises(ValueError, match="must be a file, but is a folder, a device or a pipe"):
            load(link)
    for text in (".".join("a" * 20_000) + " = 1", f"a = {'[' * 20_000}{']' * 20_000}", "a = " + "{a=" * 9999):
        with pytest.raises(ValueError, match=r"^scene\.toml: "):
            scene_from_toml(text, "scene.toml")
    with pytest.raises(ValueError, match="`scene` must be JSON of a scene"):
        scene_from_json("[" * 100_000)


BASE = 'base = "paper"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('speed = "1250 m/s"', "scene.toml: `slipper` is missing"),
        (BASE + "speed = 1250", 'line 2: `speed` must be a number with a unit, as in "1.5 m/s", but is 1250'),
        (BASE + 'speed = "12 kg"', "line 2: `speed` must be in a unit like m/s, but is in 'kg'"),
        *(
            (BASE + f'speed = "1 {unit}"', "line 2: `speed` must be in a unit like m/s, but is in")
            for unit in ("m**9**9**9", "m*(9**9)**9", "m^9^9^9", "m" * 10**6, "(" * 10**4 + "m")
        ),
        (BASE + f'speed = "{"9" * 400} m/s"', "line 2: Argument `speed` must be positive, but is inf"),
        (BASE + "\n\nspeed = '-12 m/s'", "line 4: Argument `speed` must be positive, but is -12 m/s"),
        (BASE + '[contact]\nstiffness = "1e8 N/m"', "line 3: `stiffness` must be in a unit like N/m^1.5"),
        (BASE + "[contact]\nrestitution = 1.5", "line 3: Argument `restitution` must be above 0 and at most 1"),
        (BASE + '[contact]\ntype = "Foo"', "line 3: Argument `contact.type` must be one of ConstantDamping, Flores"),
        (BASE + '[slipper]\nmas = "3 kg"', "line 3: Argument `slipper` must have only mass, inertia, length"),
        (BASE + "slipper = 3", "line 2: `slipper` must be a table"),
        (BASE + "load = [5]", "line 2: `load` must be a table, [load], but is [5]"),
        (BASE + "track = [{}]", "line 2: `track` must be a table, [track], but is [{}]"),
        (BASE + "load = []", "line 2: `load` must be a table, [load], but is []"),
        (BASE + '[slipper]\ntype = "Sld"', "line 3: Argument `slipper.type` must be one of Sled, Slipper"),
        (BASE + '[section]\ntype = "Sled"', "line 3: Argument `section.type` must be one of Section, but is 'Sled'"),
        (BASE + '[slipper]\ntype = "Sled"', "line 2: Argument `slipper` must have `mounts`"),
        (BASE + "[mounts]\n", "line 2: `mounts` must be a table, [[mounts]], for each slipper"),
        (BASE + '[modes]\nfile = "fe.npz"', "line 2: Argument `slipper` must be a sled with tables [[mounts]]"),
        (BASE + "[environment]\nplaces = 3", "line 3: `places` must be a number with a unit"),
        (BASE + '[section]\npoints = { values = [[1, 2]], unit = "mm" }', "line 3: Argument `points` must have two"),
        (BASE + '[section]\nclearance = "1 mm"\nplay = { values = [1], unit = "mm" }', "`play` must not both be"),
        (BASE + '[start]\nvy = "1 m/s"', "line 3: `vy` is none of y, z, roll"),
        (BASE + '[start]\nq_x = 0.1\nroll = "1 mrad"', "`roll` and `q_x` must not both be given"),
        (BASE + "[strat]\n", "line 2: `strat` is none of base, speed"),
        ('base = "mine"', "line 1: `base` must be one of paper, but is 'mine'"),
        (BASE + f"speed = {'1' * 5000}", "scene.toml: Exceeds the limit"),
        (BASE + '"a\\nb" = 1', "`a b` is none of base, speed"),
        (
            BASE + "[start]\nq_x = { values = [1.0], unit = 3 }",
            "line 2: Argument `start` must have one finite number for each coordinate, but its q_x",
        ),
        (BASE + '[track]\ntype = "TrackSet"\ntracks = 1979-05-27', "line 4: Argument `tracks` must be rails such as"),
        (BASE + f'[track]\ntype = "{"a" * 9999}"', "line 3: Argument `track.type` must be one of"),
    ],
)
def test_errors_name_file_and_line(text, words):
    with pytest.raises(ValueError, match=r"scene\.toml") as caught:
        scene_from_toml(text, "scene.toml")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_files_are_written_and_read(tmp_path):
    scene, start = sj.paper_scene(900.0), sj.Motion(v_y=0.1)
    text = scene.to_toml(tmp_path / "a.toml", start=start)
    assert (tmp_path / "a.toml").read_text() == text
    (tmp_path / "bom.toml").write_text("\ufeff" + text, encoding="utf-8")
    for file in ("a.toml", "bom.toml"):
        assert eqx.tree_equal(sj.load(tmp_path / file).scene, scene)
    assert eqx.tree_equal(sj.load(str(tmp_path / "a.toml")).start, start)
    (tmp_path / "bad.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"bad\.toml is no TOML file in UTF-8"):
        _ = sj.load(tmp_path / "bad.toml").scene


LOADS = (
    BASE
    + """
[[load]]
type = "AppliedLoad"
force = { values = [0, 0, -800], unit = "N" }

[[load]]
type = "AerodynamicLoad"
area = "500 cm^2"
drag_coefficient = [0.4, 0.8]
mach = [0.8, 1.2]
"""
)


def test_several_loads_are_several_tables():
    scene = scene_from_toml(LOADS).scene
    weight, air = scene.load.loads
    assert eqx.tree_equal(weight, sj.model.AppliedLoad([0.0, 0.0, -800.0]))
    assert eqx.tree_equal(air, sj.model.AerodynamicLoad(0.05, [0.4, 0.8], mach=[0.8, 1.2]))
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)
    assert eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("500 cm^2", "-5 m^2", "line 9: Argument `area` must be positive"),
        ("-800]", "-800, 1]", "line 5: Argument `force` must be of shape (3)"),
        ("mach = [0.8, 1.2]", "", "line 10: Argument `drag_coefficient` must be one number"),
        ('type = "AppliedLoad"\n', "", "line 3: `type` is missing"),
        ('type = "AerodynamicLoad"\n', "", "line 7: `type` is missing"),
    ],
)
def test_errors_name_the_right_one_of_several_tables(old, new, words):
    with pytest.raises(ValueError, match=r"scene\.toml") as caught:
        scene_from_toml(LOADS.replace(old, new), "scene.toml")
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("[frction]\n", "friction"),
        ('[slipper]\nmas = "3 kg"', "mass"),
        ('[section]\nclearence = "1 mm"', "clearance"),
        ('[load]\ntype = "aplliedload"', "AppliedLoad"),
        ('[start]\nptich = "1 mrad"', "pitch"),
        ('[run]\nlenght = "5 m"', "length"),
        ('[speed]\nstagse = "5 m"', "stages"),
    ],
)
def test_a_name_that_is_misspelt_is_guessed(text, meant):
    with pytest.raises(ValueError, match=rf"Did you mean {meant}\?"):
        scene_from_toml(BASE + text)


def test_a_part_that_is_absent_is_told():
    with pytest.raises(ValueError, match="leads to no number: friction is absent from the scene"):
        sj.paper_scene().replace(**{"friction.coefficient": 0.2})


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        (lambda scene: scene.replace(clearence=1e-3), "clearance"),
        (lambda scene: scene.replace(**{"slipper.lenght": 1.0}), "length"),
        (lambda scene: sj.sweep(scene, {"speeed": [900.0]}), "speed"),
        (lambda scene: sj.sweep(scene, {"speed": [900.0]}, record="peak_forces"), "peak_force"),
        (lambda scene: sj.run(scene, length=8.0, record="peak_forces"), "peak_force"),
        (lambda scene: sj.simulate(scene, 1, solver="Rodas3"), "Rodas4"),
        (lambda scene: sj.simulate(scene, 1, solver="kvaerno5"), "Kvaerno5"),
        (lambda scene: sj.model.LocalTrack([1.0], [1e-3], 1.0, shape="jont"), "joint"),
    ],
)
def test_a_name_in_a_call_is_guessed(call, meant):
    with pytest.raises(ValueError, match=rf"Did you mean {meant}\?$"):
        call(sj.paper_scene())
    # and nothing where nothing is similar
    with pytest.raises(ValueError, match=r"slipper.inertia.1\.$"):
        sj.paper_scene().replace(xyz=1.0)


SLED = """
base = "paper"
[slipper]
mass = "400 kg"
inertia = { unit = "kg m^2", values = [150, 300, 350] }

[[mounts]]
x = "120 cm"
y = "0.9 m"
rail = "left"
clearance = "2 mm"

[[mounts]]
x = "-1.2 m"
rail = "right"
name = "rear"
y = "-900 mm"
length = "1 ft"
[mounts.section]
clearance = "1.5 mm"

[modes]
beam = { mass = "400 kg", length = "3 m", stiffness = "5 kN m^2", count = 2, damping = 0.02 }

[track]
type = "TwoRails"
gauge = "1.8 m"
left = { type = "HarmonicTrack", wavelengths = { unit = "m", values = [8] }, amplitude = "1 mm" }
right = { type = "StraightTrack" }

[environment]
places = { unit = "mm", values = [[500, 0, 400]] }
high = "1 kHz"
quality = 25
"""


def test_a_sled_has_mounts_and_modes_in_tables_of_their_own():
    found = scene_from_toml(SLED)
    scene, body = found.scene, found.scene.slipper
    front, rear = body.mounts
    assert body.names == ("left1", "rear")
    assert [float(mount.x) for mount in body.mounts] == [1.2, -1.2]
    assert (float(rear.y), front.z, float(rear.length)) == (-0.9, None, pytest.approx(0.3048))
    np.testing.assert_allclose(front.play, 1e-3)
    # the section is that of the scene but for its clearance
    np.testing.assert_allclose(rear.section.play, 0.75e-3)
    assert eqx.tree_equal(rear.section.points, scene.section.points)
    assert eqx.tree_equal(
        body.modes, sj.model.Modes.beam([1.2, -1.2], mass=400, length=3, stiffness=5e3, count=2, damping=0.02)
    )
    assert float(scene.track.gauge) == 1.8
    assert found.environment == {"places": [[0.5, 0.0, 0.4]], "high": 1e3, "quality": 25.0}
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)


def test_sensors_are_tables_whose_bias_has_the_unit_of_the_signal():
    text = (
        BASE
        + """
[sensors.front]
place = { values = [0.5, 0, 0], unit = "m" }
bias = "0.1 g"
noise = "1 g"
cutoff = "2 kHz"

[sensors.lift]
measures = "displacement"
noise = "0.01 mm"
delay = "1 ms"
"""
    )
    front, lift = scene_from_toml(text).sensors
    assert (front.name, front.measures, lift.name, lift.measures) == ("front", "acceleration", "lift", "displacement")
    np.testing.assert_allclose([front.bias, front.noise, front.cutoff], [0.980665, 9.80665, 2e3])
    np.testing.assert_allclose([lift.noise, lift.delay], [1e-5, 1e-3])
    for wrong, words in (
        ('bias = "1 kg"', "^scene, line 3: `bias` must be in a unit like m/s"),
        ("gian = 2", "`gian` is none"),
    ):
        with pytest.raises(ValueError, match=words):
            scene_from_toml(BASE + "[sensors.a]\n" + wrong)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('x = "-1.2 m"', 'x = "-1.2 kg"', "line 14: `x` must be in a unit like m"),
        ('name = "rear"', 'nam = "rear"', "line 16: `nam` is none of clearance, x, y"),
        ('clearance = "2 mm"', 'clearance = "-2 mm"', "line 11: Argument `clearance` must be zero or positive"),
        ('clearance = "2 mm"', 'clearance = "2 mm"\nplay = "1 mm"', "`clearance` and `play` must not both be given"),
        ('[mounts.section]\nclearance = "1.5 mm"', "section = 3", "line 19: `section` must be a table, but is 3"),
        ('name = "rear"', 'name = "left1"', "line 3: Argument `mounts` must have different names"),
        ('y = "-900 mm"', 'y = "900 mm"', "`mounts` must be within their play"),
        ('length = "3 m"', 'length = "2 m"', "line 22: Argument `places_of_mounts` must lie on the beam"),
        (', length = "3 m"', "", "line 22: `length` must be a number with a unit"),
        ("damping = 0.02", "daming = 0.02", "Did you mean damping?"),
        (
            "quality = 25",
            'low = "2 kHz"',
            "line 34: Argument `low` must be below 1000 Hz, but is 2000 Hz",
        ),
        ("beam =", "bem =", "line 23: Argument `modes` must have only frequency, damping, shapes"),
    ],
)
def test_errors_of_a_sled_name_the_line(old, new, words):
    assert old in SLED
    with pytest.raises(ValueError, match=r"^scene\.toml, line ") as caught:
        scene_from_toml(SLED.replace(old, new), "scene.toml")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_modes_in_a_file_are_those_at_the_mounts_by_name(tmp_path):
    shapes = np.arange(6.0).reshape(1, 2, 3) / 100
    np.savez(tmp_path / "fe.npz", frequency=[50.0], damping=[0.01], shapes=shapes, mounts=["rear", "left1"])
    head, _, tail = SLED.partition("beam = ")
    text = f'{head}file = "fe.npz"\n{tail.partition("}")[2]}'
    scene = scene_from_toml(text, str(tmp_path / "scene.toml")).scene
    np.testing.assert_array_equal(scene.slipper.modes.shapes, shapes[:, ::-1])
    # the scene holds the numbers, and not the file
    (tmp_path / "fe.npz").unlink()
    assert eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene)


def test_units_of_reports_are_no_arguments_of_a_run(tmp_path):
    file = tmp_path / "sled.toml"
    file.write_text('base = "paper"\n[run]\nlength = "1 km"\nunits = ["ft", "g"]\n')
    assert sj.load(file).units == ("ft", "g")
    assert sj.load(file).run == {"length": 1000.0}
    file.write_text('base = "paper"\n[run]\nlength = "1 km"\n')
    assert sj.load(file).units == ()


def test_each_unit_is_for_its_kind_of_quantity():
    """Lengths have two: those of distances, and of displacements; g is of accelerations, not of masses."""
    distance = Quantity("distance", "m", "distance")
    mass = Quantity("mass", "kg", "mass")
    moment, heat = Quantity("moment", "N m", "moment"), Quantity("friction_work", "J", "heat")
    wanted = {"distance": "ft", "y": "thou", "a_z": "g", "drive_force": "lbf", "mass": "lb", "v_y": "ft/s"}
    wanted |= {"moment": "ft lbf", "friction_work": "kJ"}
    units = ShownUnits(("ft", "g", "thou", "lbf", "km", "kJ"))
    quantities = [distance, mass, moment, heat, *(REACTIONS | ACCELERATIONS | COORDINATES).values()]
    shown = {q.name: units.of(q) for q in quantities}
    assert {name: shown[name].display_unit for name in wanted} == wanted
    # one foot, a thousandth of an inch, standard gravity
    found = [
        float(shown[name].shown(value)) for name, value in (("distance", 0.3048), ("y", 2.54e-5), ("a_z", 9.80665))
    ]
    assert found == pytest.approx([1.0] * 3, rel=1e-15)
    assert ShownUnits().of(distance) is distance


class Learned(sj.model.AbstractContactLaw):
    """F = K d^1.5 (1 + a network of the approach speed)."""

    net: eqx.nn.MLP
    clamp: bool = eqx.field(static=True, default=True)

    def damping(self, rate, rate_ratio):
        return jnp.vectorize(lambda v: self.net(v[None])[0])(rate)


class Drawn(sj.model.AbstractContactLaw):
    """A law that draws its numbers when it is made."""

    seed: int = eqx.field(static=True)
    loss: jnp.ndarray
    clamp: bool = eqx.field(static=True, default=True)

    def __init__(self, stiffness, seed):
        self.stiffness = stiffness
        self.seed = seed
        self.loss = jnp.asarray(np.random.default_rng(seed).uniform(size=3))

    def damping(self, rate, rate_ratio):
        return self.loss[0]


def test_laws_that_a_file_cannot_bring_back_are_refused(tmp_path):
    scene = sj.paper_scene()
    drawn = dataclasses.replace(scene, contact=Drawn(1e8, 3))
    _ = sj.load(drawn.to_toml(tmp_path / "drawn.toml") and tmp_path / "drawn.toml").scene
    trained = eqx.tree_at(lambda s: s.contact.loss, drawn, jnp.ones(3))
    nets = [eqx.nn.MLP(1, 1, 2, 1, key=jax.random.key(k)) for k in (0, 1)]
    learned = [dataclasses.replace(scene, contact=Learned(1e8, net)) for net in nets]
    for one, words in ((trained, "Drawn"), (learned[0], "Learned")):
        with pytest.raises(ValueError, match=f"`contact` must be one that a file can hold, but is {words}"):
            one.to_toml(tmp_path / "none.toml")
        with pytest.raises(ValueError, match=r"`scene\.contact.*` cannot be rebuilt"):
            scene_from_json(scene_to_json(one))
    assert not (tmp_path / "none.toml").exists()
    # stores tell networks apart
    assert scene_to_json(learned[0]) != scene_to_json(learned[1])
