"""The command line from outside: what it reads, computes, writes and prints."""

import math
import re
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.options import CASE, Measure, make_case
from slipperjax.cli.sweep import make_grid
from slipperjax.flow.status import Status
from slipperjax.model.parameters import PARAMETERS
from slipperjax.model.quantities import SECTIONS
from slipperjax.plots.style import COLORS

from ..orbits.nominal import STEPS
from .commands import TEN, call, dataset, error_of, names, picture, share

SCENE = sj.paper_scene()
NOTHING = dict.fromkeys(CASE) | {"set": (), "wavelength": (), "solver": "RK4"}


def equal(scene, other):
    return bool(eqx.tree_equal(scene, other, rtol=1e-14))


# reading


@pytest.mark.filterwarnings("always::slipperjax.ImplausibleWarning")
def test_a_table_without_readings_is_one_line_and_warnings_come_once(tmp_path, capsys):
    """Though scene, start and run are read from one file, and the survey with each of them."""
    rail, scene = tmp_path / "rail.csv", tmp_path / "sled.toml"
    rows = [f"{k},{'' if k in (5, 9) else 1},loose" for k in range(40)]
    rail.write_text("\n".join(["station [ft],lateral [mm],remark", *rows]))
    scene.write_text('base = "paper"\n[track]\nfile = "rail.csv"\n[run]\nlength = "1 m"\n')
    _, error = call(["run", scene, "--out", tmp_path / "run"], capsys, 2)
    assert error.splitlines() == [
        f"warning: File {rail} has columns that are not read: remark.",
        f"error: {rail}: no reading at 5 ft (line 7) and 9 ft (line 11): choose joints = one of "
        '"spline", "step", "hold".',
    ]
    # of a good one, until the first file that cannot be written; and the next command warns again
    rail.write_text(rail.read_text().replace(",,", ",1,"))
    for _ in range(2):
        _, error = call(["run", scene, "--out", rail / "run"], capsys, 2)
        assert error.count("warning: ") == 1


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # one is no stiffness
def test_axes_are_read_in_display_units():
    for axis, values in (
        (("roll_amplitude", 0.0, 180.0, 3), [0.0, math.pi / 2, math.pi]),
        (("mass", 10.0, 20.0, 1), [10.0]),
        (("section.play.2", "100 um", 1e-3, 2), [1e-4, 1e-3]),
        (("start_y", -0.1, 0.1, 3), [-1e-4, 0.0, 1e-4]),
        (("clearance", "1/16 in", "0.5 mm", 2), [1.5875e-3, 0.5e-3]),
        *(((name, 1.0, 1.0, 1), [q.from_shown(1.0)]) for name, q in PARAMETERS.items()),
    ):
        grid = make_grid(SCENE, axis)
        assert grid == {axis[0]: pytest.approx(values)}
    grid = make_grid(SCENE, ("speed", 100.0, 10000.0, 3), ("clearance", 1.0, 3.0, 3), log=["speed"])
    np.testing.assert_allclose(grid["speed"], [100.0, 1000.0, 10000.0])
    np.testing.assert_allclose(grid["clearance"], [1e-3, 2e-3, 3e-3])


def test_options_take_any_unit():
    for text, shown in (("1.5", 1.5), ("1.5 mm", 1.5), ("1500um", 1.5), ("1/16 in", 1.5875), ("5/127 ft", 12.0)):
        assert Measure(PARAMETERS["clearance"]).convert(text, None, None) == pytest.approx(shown, rel=1e-12)


def test_options_in_display_units_make_the_scene():
    given = dict(speed=1000.0, clearance=2.0, length=0.3, stiffness=1e9, restitution=0.5)
    more = dict(wavelength=(8.0, 3.0), amplitude=1.5, roll_amplitude=0.1, memory="smooth")
    si = dict(
        wavelengths=(8.0, 3.0), amplitude=1.5e-3, roll_amplitude=math.radians(0.1), memory=sj.model.SmoothSwitch()
    )
    wanted = sj.paper_scene(1000.0, 2e-3, 0.3, stiffness=1e9, restitution=0.5, **si)
    assert equal(make_case(**given, **more).scene, wanted)


def test_options_override_the_scene_s_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('base = "paper"\nspeed = "1000 m/s"\n[slipper]\nmass = "20 kg"\n[start]\nv_y = "1 m/s"\n')
    given = {"speed": 900.0, "set": ["section.play.2=0.4 mm", "slipper.inertia.1=0.07"], "gravity": 9.81}
    case = make_case(**NOTHING | {"solver": "Rodas4", "scene": file, "steps_per_period": 70} | given)
    wanted = sj.paper_scene(900.0).replace(mass=20.0, gravity=9.81, inertia_y=0.07, **{"section.play.2": 4e-4})
    assert equal(case.scene, wanted)
    assert case.start.v_y == 1.0
    assert isinstance(case.solver, sj.solvers.Rodas4)
    assert case.options == dict(start=case.start, solver=case.solver, steps_per_period=70)


def test_defaults_are_the_paper_s(replaced, tmp_path, capsys):
    simulate = replaced("orbits.simulate.simulate", side_effect=ValueError("seen"))
    out, error = call(["simulate", "--out", tmp_path / "run"], capsys, 2)
    assert (out, error) == ("", "error: seen\n")
    (scene, periods), options = simulate.call_args
    assert equal(scene, SCENE)
    assert periods == 60
    assert isinstance(options.pop("solver"), sj.solvers.ImpulseRK4)
    assert options == dict(start=None, steps_per_period=None, saves_per_period=None, probe=4, begin=None)


def test_no_arguments_ask_for_help(capsys):
    text = call([], capsys)[0]
    assert text == call(["--help"], capsys)[0]
    named = set(re.findall(r"^  (\w+) ", text, re.MULTILINE))
    assert named >= {"simulate", "orbit", "continue", "design", "bifurcation", "lyapunov", "sweep", "store"}
    assert named >= {"reproduce", "fit", "run", "explore", "new", "cache"}
    assert call(["--version"], capsys)[0].startswith(f"slipperjax {sj.__version__} (python 3")


# each command once, with as little to compute as there can be


@pytest.fixture
def file(tmp_path):
    """A scene's file, with a start, and the options by which it is taken with another mass."""
    path = tmp_path / "scene.toml"
    sj.paper_scene(1000.0).replace(mass=20.0).to_toml(path, start=sj.Motion(v_y=0.3))
    return ["--scene", path, "--mass", 21]


@pytest.mark.full
def test_a_trajectory_is_written_and_drawn(file, tmp_path, capsys):
    out = tmp_path / "run"
    words = ["simulate", *file, "--periods", 3, "--steps-per-period", 50, "--probe", 1, "--out", out]
    text, error = call(words, capsys)
    ds = dataset(out)
    assert ds.sizes["time"] == 151
    assert 0 < ds.attrs["probe_error [scales]"] < 0.1
    assert equal(sj.load(f"{out}.nc").scene, sj.paper_scene(1000.0).replace(mass=21.0))
    assert sj.load(f"{out}.nc").start.motion.v_y == 0.3
    peak = ds["peak_force"].values
    end, point = np.argwhere(peak == peak.max())[0]
    name, when = f"{'ABCDEFGHIJ'[point]}{end + 1}", float(ds["peak_period"].values[end, point])
    assert error == ""
    case = "speed 1000 m/s, clearance 1 mm, length 0.2 m, from the scene file's start"
    assert text.startswith(f"wrote {out}.nc and {out}.png\n{case}\nstatus: finite\n50 steps per period\n")
    force = f"highest single contact point {peak.max() / 1e3:.4g} kN at {name}, forcing period {when:.2f}\n"
    assert f"{force}half the step changes the motion by " in text
    assert share(picture(out, 7.2, 9.4), COLORS["blue"]) > 1e-3
    # a bad one is said without its force, by the same program
    text, error = call([*words, "--stiffness", "1e13"], capsys, 1)
    assert f"{out}.nc and {out}.png will be replaced\n" in error
    assert text.endswith(f"\nstatus: {Status.NOT_FINITE}\n50 steps per period\n")
    # a rail without waves has no periods, but places
    rail = tmp_path / "rail.csv"
    rows = [f"{k / 2},{np.sin(k / 4):.4f}" for k in range(40, 130)]
    rail.write_text("\n".join(["distance [m],vertical [mm]", *rows]))
    text, _ = call([*words, "--rail", rail], capsys)
    words = r"\n50 steps per 8 m\n.* kN at \w\d, [234]\d\.\d* m\nhalf the step changes the motion by \S+ per 8 m"
    assert re.search(words, text)


@pytest.mark.full
def test_sections_are_written_and_drawn_in_a_new_folder(file, tmp_path, capsys):
    out = tmp_path / "deep" / "fig"
    text, _ = call(["bifurcation", "--over", "speed", 900, 1000, 2, *file, *TEN, "--out", out], capsys)
    case = "clearance 1 mm, length 0.2 m, from the scene file's start"
    assert f"\n{case}\n2 cases, 10 + 10 periods, 100 steps per period\n0 cases flagged\n" in text
    assert re.search(r"\nhalf the step changes the motion by \S+ scales at most\n\S+ s with compiling\n$", text)
    assert dataset(out)["speed"].values.tolist() == [900, 1000]
    assert equal(sj.load(f"{out}.nc").sel(speed=900.0).scene, sj.paper_scene(900.0).replace(mass=21.0))
    assert share(picture(out, 7.2, 4.6), COLORS["blue"]) > 0


@pytest.mark.full
def test_an_orbit_is_written(tmp_path, capsys):
    out = tmp_path / "orbit"
    text, _ = call(["orbit", "--steps-per-period", STEPS, "--out", out], capsys)  # by the programs of tests/orbits
    case = "speed 1250 m/s, clearance 1 mm, length 0.2 m, from Table 2's start"
    assert f"wrote {out}.nc and {out}.png\n{case}\nperiod 1, stable, largest exponent -0.04" in text
    ds = dataset(out)
    assert ds.attrs["stable"] == 1
    np.testing.assert_allclose(ds["y"][-1], ds["y"][0], rtol=1e-9)


# with the rooms below replaced


def test_flagged_cases_are_named(replaced, tmp_path, capsys):
    values = [4e-4, 5e-4, 6e-4, 7e-4]
    data = {name: (("section.play.2", "crossing"), np.ones((4, 2))) for name in SECTIONS}
    data |= {f"{name}_period": v for name, v in data.items()}
    data |= {"status": ("section.play.2", [0, 1, 3, 3]), "steps_per_period": ("section.play.2", [50, 50, 100, 150])}
    call_made = {"call": '{"function": "sweep"}'}
    made = xr.Dataset(data, {"section.play.2": values}, call_made | {"settled": 310, "measured": 10})
    sweep = replaced("sweeps.sweep.sweep", return_value=sj.Result(made))
    out = tmp_path / "fig"
    words = ["bifurcation", "--over", "section.play.2", 4e-4, 7e-4, 4, "--out", out]
    text, _ = call(words, capsys)
    (_, grid), options = sweep.call_args
    assert grid == {"section.play.2": pytest.approx(values)}
    assert (options["transient"], options["periods"]) == (300, 10)
    # clearance and vertical play depend on what is varied
    case = "speed 1250 m/s, lateral play 1 mm, length 0.2 m, from Table 2's start"
    assert f"\n{case}\n4 cases, 310 + 10 periods, 50 to 150 steps per period\n" in text
    assert f"\n3 cases flagged (1 {Status.NOT_FINITE} and 2 {Status.TOO_FEW_STEPS})\n" in text
    xr.testing.assert_identical(dataset(out), made)
    made["status"][:] = int(Status.NOT_FINITE)
    assert "4 cases flagged" in call(words, capsys, 1)[0]
    # no orbit is no file
    lost = SimpleNamespace(status=int(Status.NO_ORBIT), residual=0.5)
    replaced("orbits.periodic.periodic_orbit", return_value=lost)
    text, _ = call(["orbit", "--out", tmp_path / "none"], capsys, 1)
    assert text == f"no file is written; status: {Status.NO_ORBIT}\n"
    assert names(tmp_path) == ["fig.nc", "fig.png"]


def test_two_parameters_make_a_regime_map(replaced, tmp_path, capsys):
    dims, shape = ("speed", "roll_amplitude"), (2, 2)
    data = {
        "exponent": ((*dims, "count"), np.reshape([-0.1, 0.2, 0.3, np.nan], (*shape, 1))),
        "stderr": ((*dims, "count"), np.full((*shape, 1), 0.01)),
        "regime": (dims, np.reshape(["periodic", "chaotic", "chaotic", "unresolved"], shape)),
        "status": (dims, np.reshape([0, 0, 0, 1], shape)),
        "steps_per_period": (dims, np.reshape([50, 100, 250, 50], shape)),
    }
    axes_made = {"speed": [10.0, 20.0], "roll_amplitude": np.radians([0.1, 0.2])}
    made = xr.Dataset(data, axes_made, {"call": '{"function": "sweep"}'})
    sweep = replaced("sweeps.sweep.lyapunov_sweep", return_value=sj.Result(made))
    out = tmp_path / "map"
    axes = ["--over", "speed", 10, 20, 2, "--by", "roll_amplitude", 0.1, 0.2, 2]
    text, _ = call(["lyapunov", *axes, "--count", 2, "--periods", 40, "--out", out], capsys)
    (_, grid), options = sweep.call_args
    assert grid["roll_amplitude"] == pytest.approx(np.radians([0.1, 0.2]))
    wanted = dict(count=2, transient=300, periods=40, certify=True, orbits=True, steps_per_period=None)
    assert {name: options[name] for name in wanted} == wanted
    assert "\nclearance 1 mm, length 0.2 m, from Table 2's start\n4 cases, 50 to 250 steps per period\n" in text
    assert "\n1 cases flagged (1 not finite" in text
    assert "\n1 periodic, 0 regular, 2 chaotic, 1 unresolved, 0 transient chaos\n" in text
    xr.testing.assert_identical(dataset(out), made)
    # the case without an exponent, a quarter of the map
    assert share(picture(out, 3.5, 3.3), COLORS["grey"]) > 0.02


def test_reproduce_writes_each_run_when_it_is_done(replaced, tmp_path, capsys):
    answers = {"A1": SimpleNamespace(good=True)}, {"A2": SimpleNamespace(good=False)}
    one = lambda name, answers: SimpleNamespace(name=name, figures=["5"], seconds=1.5, answers=answers)
    done = [one(*pair) for pair in zip("ab", answers, strict=True)]
    reports = []

    def write_report(out, answers, seconds, table, name="claims"):
        reports.append((sorted(answers), name, table))
        return out / "report.md", out / "report.json"

    room = "studies.dang2024"
    reproduce = replaced(f"{room}.runs.reproduce", side_effect=lambda *given, **options: iter(done))
    replaced(f"{room}.runs.readings", return_value="table")
    replaced(f"{room}.claims.write_report", side_effect=write_report)
    draw = replaced(f"{room}.figures.write_figures", return_value=[])
    out = tmp_path / "study"
    text, _ = call(["reproduce", "5", "8", "--transient", 100, "--out", out], capsys)
    (figures,), options = reproduce.call_args
    assert (tuple(figures), options["quick"], options["transient"]) == (("5", "8"), False, 100)
    assert [drawn.args for drawn in draw.call_args_list] == [(one, out) for one in done]
    both = ["A1", "A2"]
    assert reports == [(["A1"], "claims_partial", []), (both, "claims_partial", []), (both, "claims", [])]
    assert "a: figure 5 in 1.5 s" in text
    assert f"1 of 2 claims reproduced, 1 differ: see {out / 'report.md'}" in text
    call(["reproduce", "--out", out], capsys)  # all figures: with the readings of the whole study
    assert reports[-1][2] == "table"


@pytest.mark.parametrize(
    ("words", "function"),
    [
        (["simulate"], "orbits.simulate.simulate"),
        (["bifurcation", "--over", "speed", 900, 1000, 2], "sweeps.sweep.sweep"),
        (["lyapunov", "--over", "speed", 900, 1000, 2], "sweeps.sweep.lyapunov_sweep"),
        (["sweep", "--over", "speed", 900, 1000, 2], "sweeps.sweep.sweep"),
        (["sweep", "--over", "speed", 900, 1000, 2, "--explain"], "sweeps.explain.explain"),
        (["run", "FILE"], "sweeps.runs.run"),
    ],
)
def test_commands_that_travel_begin_where_they_are_told(words, function, replaced, tmp_path, capsys):
    (tmp_path / "FILE.toml").write_text('base = "paper"\n[run]\nlength = "8 m"\nbegin = "8 m"\n')
    words = [tmp_path / "FILE.toml" if word == "FILE" else word for word in words]
    called = replaced(function, side_effect=ValueError("seen"))
    out = [] if "--explain" in words else ["--out", tmp_path / "out"]
    for more, place in (([], 8.0 if words[0] == "run" else None), (["--begin", "0.3 km"], 300.0)):
        assert call([*words, *out, *more], capsys, 2)[1].endswith("error: seen\n")
        assert called.call_args[1]["begin"] == place


@pytest.mark.full
def test_laws_of_ones_own_are_imported(tmp_path, monkeypatch, capsys):
    force = "    def force(self, *given):\n        return 2 * super().force(*given)\n"
    law = f"class Doubled(sj.model.HertzSpring):\n{force}"
    (tmp_path / "own_laws.py").write_text(f"import slipperjax as sj\n{law}")
    scene = tmp_path / "scene.toml"
    scene.write_text('base = "paper"\n[contact]\ntype = "Doubled"\nstiffness = "1e8 N/m^1.5"\n')
    monkeypatch.chdir(tmp_path)
    command = ["simulate", "--scene", scene, "--periods", 1, "--probe", 0, "--out", tmp_path / "own"]
    assert "imported before, on the command line by --import" in error_of(command, capsys)
    call(["--import", "own_laws", *command], capsys)
    assert type(sj.load(dataset(tmp_path / "own")).scene.contact).__name__ == "Doubled"
    assert "--import must be a Python module" in error_of(["--import", "no_such_module", *command], capsys)
