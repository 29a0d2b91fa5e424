"""The command `new`: what it writes is complete, is what was asked for, is read without a warning, and runs."""

import re
import warnings
from itertools import pairwise

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.cli.new import RAILS
from slipperjax.cli.options import make_case
from slipperjax.cli.sweep import make_grid
from slipperjax.fitting.accelerations import read_record
from slipperjax.model.surveys import SurveyedRails, SurveyedTrack

from .commands import call, dataset, error_of, names


def written(tmp_path, capsys, *options):
    """Writes a file by the command, and gives its scene, which must be read without a warning."""
    file = tmp_path / "sled.toml"
    text, error = call(["new", file, "--force", *options], capsys)
    assert text == f"wrote {file}: look through it, and run it by slipperjax run {file}\n"
    assert not error
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return sj.load(file).scene


def test_what_is_not_given_is_the_paper_s(tmp_path, capsys):
    scene = written(tmp_path, capsys)
    paper = sj.paper_scene()
    for name in ("speed", "clearance", "length", "mass", "stiffness", "restitution"):
        assert float(scene.value(name)) == pytest.approx(float(paper.value(name)), rel=1e-12), name
    # the same points, with the paper's names
    for name in "ABCDEFGHIJ":
        here, there = (s.section.points[s.section.names.index(name)] for s in (scene, paper))
        np.testing.assert_allclose(here, there, rtol=1e-12)
    assert sj.load(tmp_path / "sled.toml").run == dict(length=500.0, window=1.0)
    # a box of 14 kg, 0.2 m long, 96 mm wide and 42 mm high
    box = 14.0 / 12 * np.array([0.096**2 + 0.042**2, 0.2**2 + 0.042**2, 0.2**2 + 0.096**2])
    np.testing.assert_allclose(scene.slipper.inertia, box, rtol=1e-5)


@pytest.mark.parametrize("body", [[], ["--sled"]])
def test_every_value_has_its_unit_and_a_remark(body, tmp_path, capsys):
    """Where tables of one kind follow each other, as those of mounts, the remarks of the first."""
    written(tmp_path, capsys, "--friction", 0.2, "--down", 800, "--drag-area", 0.02, "--end-speed", 900, *body)
    text = (tmp_path / "sled.toml").read_text()
    assert "# Coefficient of the force upwards [1].\nlift_coefficient = 0.0\n" in text
    pure = "clamp restitution coefficient drag_coefficient lift_coefficient side_coefficient seed roughness coherence"
    pure += " exponent"
    told = set()
    for above, line in pairwise(text.splitlines()):
        if found := re.match(r"(\w+) = ", line):
            assert above.startswith("# ") or found[1] in told, line
            assert "unit" in line or '"' in line or found[1] in pure.split(), line
            told.add(found[1])


def uncommented(text, chosen=""):
    """Gives a file whose tables behind # count: those with this header, or all."""
    head, *blocks = re.split(r"\n(?=#\[)", text)
    plain = lambda block: re.sub(r"(?m)^#(?! )|^#(?=    \[)", "", block)
    return "\n".join([head, *(plain(block) if block.startswith(f"#{chosen}") else block for block in blocks)])


@pytest.mark.parametrize("body", [[], ["--sled"]])
def test_each_table_behind_a_mark_loads_without_it(body, tmp_path, capsys):
    before = written(tmp_path, capsys, *body)
    file = tmp_path / "sled.toml"
    text = file.read_text()
    headers = re.findall(r"(?m)^#(\[.*\])$", text)
    names = ["friction", "load", "payload", "wear", "beam", "start", "environment", "loads", "track.faults"]
    assert [header.strip("[]") for header in headers] == names
    for header in headers:
        file.write_text(uncommented(text, header))
        assert file.read_text().count(f"\n{header}\n") == 1
        sj.load(file)
    file.write_text(uncommented(text))
    found = sj.load(file)
    for name in ("friction", "load", "payload", "wear", "beam"):
        assert getattr(before, name) is None
        assert getattr(found.scene, name) is not None
    assert float(found.start.v_y) == 0.5
    assert found.environment == dict(places=[[0.0, 0.0, 0.05]], margin=3.0)
    assert found.loads["means"] == [1e-3, 5e-3]
    assert float(found.scene.value("track.faults.0.height")) == -1e-3


def test_tables_that_options_give_have_no_example(tmp_path, capsys):
    written(tmp_path, capsys, "--friction", 0.3, "--down", 800)
    text = (tmp_path / "sled.toml").read_text()
    assert "#[friction]" not in text
    assert "#[[load]]" not in text


@pytest.mark.filterwarnings("ignore:Argument `band` has no waves below")
def test_a_sled_on_two_rails(tmp_path, capsys):
    scene = written(tmp_path, capsys, "--sled", "--mass", "900 lb")
    assert scene.slipper.names == ("left1", "left2", "right1", "right2")
    places = [[float(mount.x), float(mount.y), float(mount.z)] for mount in scene.slipper.mounts]
    assert places == [[1.2, 0.9, -0.2], [-1.2, 0.9, -0.2], [1.2, -0.9, -0.2], [-1.2, -0.9, -0.2]]
    assert float(scene.track.gauge) == 1.8
    # of one spectrum, so coherent that the play takes what their gauge varies by
    assert isinstance(scene.track, sj.model.RandomRails)
    assert float(scene.track.coherence) == 0.95
    # a box 2.6 m long, 1.896 m wide and 0.242 m high
    mass = 900 * 0.45359237
    box = mass / 12 * np.array([1.896**2 + 0.242**2, 2.6**2 + 0.242**2, 2.6**2 + 1.896**2])
    np.testing.assert_allclose(scene.slipper.inertia, box, rtol=1e-5)
    case = make_case(scene=tmp_path / "sled.toml")
    grid = make_grid(case.scene, ("slipper.mounts.left2.x", "-120 cm", -1.1, 3))
    np.testing.assert_allclose(grid["slipper.mounts.left2.x"], [-1.2, -1.15, -1.1], rtol=1e-15)
    # places of slippers on one rail, and at no gauge
    scene = written(tmp_path, capsys, "--mount", "4ft", 0, 0, "--mount", -1, 0, 0)
    assert [float(mount.x) for mount in scene.slipper.mounts] == pytest.approx([1.2192, -1.0])
    assert scene.track.rails == {}
    mounts = ["--mount", 1, 0.9, 0, "--mount", -1, -0.8, 0]
    call(["new", tmp_path / "sled.toml", "--force", *mounts, "--right-rail", "german-low"], capsys)
    assert sj.load(tmp_path / "sled.toml").scene.track.gauge is None


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:File .* has columns that are not read")
def test_surveys_of_two_rails(tables, tmp_path, capsys):
    file = tmp_path / "sled.toml"
    call(["new", file, "--sled", "--rail", tables / "rail.csv", "--right-rail", tables / "rail.csv"], capsys)
    rails = sj.load(file).scene.track.rails.values()
    assert [type(rail) for rail in rails] == [SurveyedTrack] * 2
    assert sj.load(file).run["length"] == 61.0
    rows = "\n".join(f"{k}, 0, {np.sin(k):.4f}, 0, {np.cos(k):.4f}" for k in range(40))
    head = "distance [m], left lateral [mm], left vertical [mm], right lateral [mm], right vertical [mm]"
    (tables / "both.csv").write_text(f"{head}\n{rows}\n")
    call(["new", file, "--sled", "--rail", tables / "both.csv", "--force"], capsys)
    track = sj.load(file).scene.track
    assert (type(track), float(track.gauge)) == (SurveyedRails, 1.8)
    assert sj.load(file).run["length"] == 39.0
    words = "rail.csv has no line of names with units, such as distance [m], left_lateral [m]"
    assert words in error_of(["new", file, "--sled", "--rail", tables / "rail.csv", "--force"], capsys)


def test_choices_are_written(tmp_path, capsys):
    slipper = ["--mass", 9, "--length", "8in", "--stiffness", 1e9, "--restitution", 0.6, "--friction", 0.2]
    others = ["--clearance", 0.8, "--gravity", 9.81, "--speed", 50, "--end-speed", 900, "--down", "180lbf"]
    more = ["--drag-area", 0.02, "--travel", 400, "--inertia", 0.01, 0.03, 0.04]
    scene = written(tmp_path, capsys, *slipper, *others, *more)
    values = dict(mass=9.0, length=0.2032, stiffness=1e9, restitution=0.6, clearance=0.8e-3, gravity=9.81)
    values |= dict(inertia_x=0.01, inertia_y=0.03, inertia_z=0.04)
    for name, value in values.items():
        assert float(scene.value(name)) == pytest.approx(value, rel=1e-8), name
    np.testing.assert_allclose([scene.speed.distance, scene.speed.speed], [[0.0, 400.0], [50.0, 900.0]])
    down, drag = scene.load.loads
    np.testing.assert_allclose(down.force, [0.0, 0.0, -180 * 0.45359237 * 9.80665], rtol=1e-8)
    assert float(drag.area) == 0.02
    assert float(scene.friction.coefficient) == 0.2


@pytest.mark.parametrize("rail", RAILS)
@pytest.mark.filterwarnings("ignore:Argument `band` has no waves below")
def test_random_rails(rail, tmp_path, capsys):
    file = tmp_path / "sled.toml"
    call(["new", file, "--rail", rail, "--travel", 5000], capsys)
    kind, _, which = rail.partition("-")
    of = [int(which) if which.isdecimal() else which] if which else []
    expected = getattr(sj.RandomTrack, kind)(*of, length=5000.0)
    np.testing.assert_array_equal(sj.load(file).scene.track.rms().vertical, expected.rms().vertical)


@pytest.fixture
def tables(tmp_path):
    """Files of an engineer, in a folder of their own."""
    folder = tmp_path / "data"
    folder.mkdir()
    feet = np.arange(0, 201, 0.5)
    rows = [f"{1000 + x:.1f},{0.2 * np.sin(x / 3):.4f},{0.3 * np.cos(x / 4):.4f},joint" for x in feet]
    (folder / "rail.csv").write_text("chainage [ft],lateral [mm],vertical [mm],remark\n" + "\n".join(rows))
    (folder / "speed.csv").write_text("time [s],velocity [ft/s]\n0,1000\n0.1,1100\n0.2,1000\n")
    corners = [(-40, 10), (40, 10), (50, 0), (50, -20), (30, -30), (-30, -30), (-50, -20), (-50, 0)]
    (folder / "section.csv").write_text("y [mm],z [mm]\n" + "\n".join(f"{y},{z + 100}" for y, z in corners))
    (folder / "loads.csv").write_text("time [s],thrust [lbf],force_z [lbf]\n0,2000,-50\n0.2,0,-60\n")
    return folder


def test_points_keep_their_names(tables, tmp_path, capsys):
    section = tables / "section.csv"
    rows = section.read_text().splitlines()
    name = lambda letters: "\n".join(["point," + rows[0], *map(",".join, zip(letters, rows[1:], strict=True))])
    section.write_text(name("QABCDEFG"))
    call(["new", tmp_path / "sled.toml", f"--section={section}", "--centre", 0, 100], capsys)
    assert sj.load(tmp_path / "sled.toml").scene.section.names == tuple("QABCDEFG")
    section.write_text(name("QABCDEFF"))
    error = error_of(["new", tmp_path / "other.toml", f"--section={section}"], capsys)
    assert "must have another name for each point, but has Q, A, B" in error


def test_noise_of_speeds_is_filtered_and_units_leave_no_rounding(tmp_path, capsys):
    time = np.arange(0.0, 2.0, 0.005)
    speed = np.where(time < 0.5, 0.0, 600 * (time - 0.5)) + np.random.default_rng(0).normal(0.0, 5.0, time.size)
    rows = [f"{t:.3f},{v:.2f}" for t, v in zip(time, speed, strict=True)]
    (tmp_path / "speed.csv").write_text("\n".join(["time [s],velocity [ft/s]", *rows]))
    scene = written(tmp_path, capsys, "--speed", tmp_path / "speed.csv", "--cutoff", 5, "--travel", "300 ft")
    assert "low-pass 5 Hz" in scene.speed.source
    assert float(scene.speed.speed[-1]) == pytest.approx(900 * 0.3048, rel=0.02)
    assert 'length = "91.44 m"' in (tmp_path / "sled.toml").read_text()


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:File .* has columns that are not read")
def test_her_own_files_run(tables, tmp_path, capsys):
    files = [f"--{name}={tables / name}.csv" for name in ("rail", "speed", "section")]
    options = [*files, f"--load={tables / 'loads.csv'}", "--centre", 0, 100, "--mass", 9, "--friction", 0.2]
    file = tmp_path / "sled.toml"
    call(["new", file, *options], capsys)
    assert names(tmp_path) == ["data", "sled.toml"]
    scene = sj.load(file).scene
    assert isinstance(scene.track, SurveyedTrack)
    # the history begins where the rail does
    np.testing.assert_allclose(scene.speed.distance[0], 1000 * 0.3048)
    np.testing.assert_allclose(scene.speed.speed[0], 1000 * 0.3048)
    # 200.5 feet of rail, and 210 of history
    assert sj.load(file).run == dict(length=61.0, window=1.0)
    assert scene.section.names == tuple("ABCDEFGH")
    np.testing.assert_allclose(scene.section.points[2], [0.05, 0.0], rtol=0, atol=1e-15)
    assert isinstance(scene.load, sj.model.SumLoad)
    text, _ = call(["run", file, "--out", tmp_path / "run"], capsys)
    assert "status: finite" in text
    ds = dataset(tmp_path / "run")
    assert float(ds["distance"][-1]) == pytest.approx(1000 * 0.3048 + 61.0)


@pytest.mark.filterwarnings("ignore:File .* has columns that are not read")
def test_paths_are_written_as_seen_from_the_file(tables, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tables)
    (tmp_path / "runs").mkdir()
    call(["new", "../runs/sled.toml", "--rail", "rail.csv"], capsys)
    assert 'file = "../data/rail.csv"' in (tmp_path / "runs" / "sled.toml").read_text()
    # so does a scene from Python, though it knows the path as seen from here
    sj.load("../runs/sled.toml").scene.to_toml("../runs/again.toml")
    for name in ("sled.toml", "again.toml"):
        assert isinstance(sj.load(tmp_path / "runs" / name).scene.track, SurveyedTrack)


def test_corners_of_a_drawing(tmp_path, capsys):
    corners = [(-40, 10), (40, 10), (30, -30), (-30, -30)]
    words = [word for y, z in corners for word in ("--corner", y, f"{z / 10} cm")]
    scene = written(tmp_path, capsys, *words)
    np.testing.assert_allclose(1e3 * np.asarray(scene.section.points), corners, rtol=0, atol=1e-12)
    assert scene.section.faces == (("A", "B"), ("C", "D"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--rail", "sledd"], "Option --rail must be a file, or one of sled, german-low"),
        (["--rail", "sledd"], "Did you mean sled?"),
        (["--right-rail", "sled"], "Option --right-rail must come with --sled, or a --mount on it"),
        (["--sled", "--right-rail", "sledd"], "Option --right-rail must be a file, or one of sled"),
        (["--mount", 1, 0, 0, "--mount", -1, 1, 0], "Option --mount must have a y above or below 0 for each"),
        (["--cutoff", 5], "Option --cutoff must come with a history of speeds, but is 5"),
        (["--speed", "none.csv"], "Option --speed must be a file, or a speed, but is 'none.csv'"),
        (["--corner", 1, 2], "Option --corner must have two points for each face, but has 1 points"),
        (["--friction", -1], "Argument `coefficient` must be zero or positive, but is -1"),
        (["--mass", "5 mm"], "`mass` must be in a unit like kg"),
        (["--corner", 1, 2, "--corner", 3, 4, "--section", "a.csv"], "--corner must not be given with --section"),
    ],
)
def test_what_is_wrong_is_one_line_and_writes_nothing(options, words, tmp_path, capsys):
    assert words in error_of(["new", tmp_path / "sled.toml", *options], capsys)
    assert names(tmp_path) == []


@pytest.mark.full
def test_joints_without_a_reading_are_as_chosen(tmp_path, capsys):
    rows = [f"{k / 4},0,{'' if k == 8 else 0.01 * (k > 8)}" for k in range(400)]
    (tmp_path / "rail.csv").write_text("\n".join(["distance [m],lateral [mm],vertical [mm]", *rows]))
    scene = written(tmp_path, capsys, "--rail", tmp_path / "rail.csv", "--joints", "hold")
    assert scene.track.joints == "hold"
    assert float(scene.track.vertical[8]) == 0.0


def test_a_file_that_is_there_stays(tmp_path, capsys):
    file = tmp_path / "sled.toml"
    file.write_text("hers")
    assert "sled.toml is there already: name another one, or replace it by --force" in error_of(["new", file], capsys)
    assert file.read_text() == "hers"
    call(["new", file, "--force"], capsys)
    assert "gravity" in file.read_text()
    assert "`file` must end with .toml" in error_of(["new", tmp_path / "sled.txt"], capsys)


def test_a_template_of_a_record_fits_the_scene(tmp_path, capsys):
    file, record = tmp_path / "sled.toml", tmp_path / "record.csv"
    text, _ = call(["new", file, "--record", record, "--speed", "300"], capsys)
    assert text.startswith(f"wrote {record}: replace its rows")
    scene = sj.load(file)
    (sensor,) = scene.sensors
    # the table is read, and needs more rows
    with pytest.raises(ValueError, match="`measured` must have 8 samples or more, but has 2"):
        read_record(record, sensor, 2000.0)
    head, rows = record.read_text().split("0.0000, 0.0\n")
    record.write_text(head + "\n".join(f"{k * 1e-4:.4f}, {k % 2}" for k in range(10)) + rows[-1])
    assert len(read_record(record, sensor, 2000.0).time) == 10
    assert f"{record} is there already" in error_of(["new", tmp_path / "other.toml", "--record", record], capsys)
