"""The command line from outside: what it reads, computes, writes and prints."""

import math
import re
from types import SimpleNamespace

import equinox as eqx
import matplotlib
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.bench.work_precision import Point
from slipperjax.cli import main
from slipperjax.cli.options import CASE, PAPER, make_case, make_grid, make_scene
from slipperjax.flow.status import Status
from slipperjax.model.quantities import PARAMETERS, SECTIONS
from slipperjax.plots.style import COLORS, REGIME_COLORS

from .commands import call, dataset, names, picture, share

SCENE = sj.paper_scene()
NOTHING = dict.fromkeys(CASE) | {"set": (), "wavelength": (), "solver": "RK4"}


def equal(scene, other):
    return bool(eqx.tree_equal(scene, other, rtol=1e-14))


# reading


@pytest.mark.parametrize(
    ("axis", "values"),
    [
        (("speed", 900.0, 2300.0, 3), [900.0, 1600.0, 2300.0]),
        (("clearance", 0.5, 1.5, 3), [0.5e-3, 1e-3, 1.5e-3]),
        (("amplitude", 1.0, 2.0, 2), [1e-3, 2e-3]),
        (("roll_amplitude", 0.0, 180.0, 3), [0.0, math.pi / 2, math.pi]),
        (("mass", 10.0, 20.0, 1), [10.0]),
        (("restitution", 0.5, 1.0, 2), [0.5, 1.0]),
        (("section.play.2", 1e-4, 1e-3, 2), [1e-4, 1e-3]),
        (("y", -0.1, 0.1, 3), [-1e-4, 0.0, 1e-4]),
        (("v_y", 0.5, 0.4, 2), [0.5, 0.4]),
        *(((name, 1.0, 1.0, 1), [q.from_shown(1.0)]) for name, q in PARAMETERS.items()),
    ],
)
def test_axes_are_read_in_display_units(axis, values):
    grid = make_grid(SCENE, axis)
    assert list(grid) == [axis[0]]
    assert grid[axis[0]] == pytest.approx(values)


def test_several_axes_make_a_grid_and_some_are_logarithmic():
    grid = make_grid(SCENE, ("speed", 100.0, 10000.0, 3), ("clearance", 1.0, 3.0, 3), log=["speed"])
    assert list(grid) == ["speed", "clearance"]
    np.testing.assert_allclose(grid["speed"], [100.0, 1000.0, 10000.0])
    np.testing.assert_allclose(grid["clearance"], [1e-3, 2e-3, 3e-3])


def test_options_in_display_units_make_the_scene():
    given = dict(speed=1000.0, clearance=2.0, length=0.3, stiffness=1e9, restitution=0.5)
    more = dict(wavelength=(8.0, 3.0), amplitude=1.5, roll_amplitude=0.1, memory="smooth")
    wanted = sj.paper_scene(
        1000.0,
        2e-3,
        0.3,
        stiffness=1e9,
        restitution=0.5,
        wavelengths=(8.0, 3.0),
        amplitude=1.5e-3,
        roll_amplitude=math.radians(0.1),
        memory=sj.SmoothSwitch(),
    )
    assert equal(make_scene(SCENE, **given, **more), wanted)


def test_options_override_the_scene_s_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('base = "paper"\nspeed = "1000 m/s"\n[slipper]\nmass = "20 kg"\n[start]\nv_y = "1 m/s"\n')
    given = {"speed": 900.0, "set": ["section.play.2=0.4 mm", "slipper.inertia.1=0.07"], "gravity": 9.81}
    case = make_case(**NOTHING | {"solver": "Rodas4", "scene": file, "steps_per_period": 70} | given)
    wanted = sj.paper_scene(900.0).replace(mass=20.0, gravity=9.81, inertia_y=0.07, **{"section.play.2": 4e-4})
    assert equal(case.scene, wanted)
    assert case.start.v_y == 1.0
    assert isinstance(case.solver, sj.Rodas4)
    assert case.options == dict(start=case.start, solver=case.solver, steps_per_period=70)


def test_solvers_are_found_by_name():
    solver = lambda name: make_case(**NOTHING | {"solver": name}).solver
    assert isinstance(solver("Rodas4"), sj.Rodas4)
    assert type(solver("Tsit5")) is sj.Tsit5  # the one that latches, not diffrax's
    assert type(solver("Dopri8").solver).__module__.startswith("diffrax")  # inside Latching


def test_defaults_are_the_paper_s(monkeypatch, tmp_path, capsys):
    calls = []

    def simulate(scene, periods, **options):
        calls.append((scene, periods, options))
        raise ValueError("seen")

    monkeypatch.setattr("slipperjax.flow.simulate.simulate", simulate)
    out, error = call(["simulate", "--out", tmp_path / "run"], capsys, 2)
    assert (out, error) == ("", "simulating 60 periods of 6.4 ms ...\nerror: seen\n")
    ((scene, periods, options),) = calls
    assert equal(scene, SCENE)
    assert periods == 60
    assert isinstance(options.pop("solver"), sj.RK4)
    assert options == dict(start=None, steps_per_period=None, saves_per_period=None, probe=4)


def test_help_names_the_paper_s_values():
    for name, value in PAPER.items():
        if name in PARAMETERS and name != "gravity":
            assert PARAMETERS[name].shown(float(SCENE.value(name))) == pytest.approx(value, rel=1e-12), name
    assert SCENE.gravity is None
    assert list(SCENE.track.wavelengths) == [PAPER["wavelength"]]
    assert PAPER["gravity"] == "none"
    assert PAPER["memory"] == "event"
    assert set(PAPER) | {"scene", "set", "solver", "steps_per_period"} == set(CASE)


@pytest.mark.parametrize("command", ["bifurcation", "lyapunov", "simulate"])
def test_help_names_units(command, capsys):
    text, _ = call([command, "--help"], capsys)
    for option, unit in (("--speed", "[m/s]"), ("--clearance", "[mm]"), ("--length", "[m]"), ("--amplitude", "[mm]")):
        assert re.search(rf"{option} [^-]*{re.escape(unit)}", text), option
    if command != "simulate":
        assert "mass [kg]" in re.sub(r"\s+", " ", text)  # of --over


def test_no_arguments_ask_for_help(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["slipperjax"])
    texts = [call(arguments, capsys)[0] for arguments in ([], ["--help"])]
    with pytest.raises(SystemExit):
        main()
    assert {*texts, capsys.readouterr().out} == {texts[0]}
    named = set(re.findall(r"^  (\w+) ", texts[0], re.MULTILINE))
    assert named >= {"simulate", "orbit", "continue", "design", "bifurcation", "lyapunov", "sweep", "store"}
    assert named >= {"reproduce", "bench", "throughput"}


def test_versions_are_printed(capsys):
    assert call(["--version"], capsys)[0].startswith(f"slipperjax {sj.__version__} (python 3")


# each command once, with as little to compute as there can be


@pytest.fixture
def file(tmp_path):
    """A scene's file, with a start, and the options by which it is taken with another mass."""
    path = tmp_path / "scene.toml"
    sj.paper_scene(1000.0).replace(mass=20.0).to_toml(path, start=sj.Motion(v_y=0.3))
    return ["--scene", path, "--mass", 21, "--steps-per-period", 50]


def check_repeated(out):
    """That a result is computed again to the same bits from its file."""
    first, again = dataset(out), sj.repeat(f"{out}.nc")
    for name in first.variables:
        np.testing.assert_array_equal(first[name].values, again[name].values, err_msg=str(name))
    return first


def test_a_trajectory_is_written_drawn_and_repeated(file, tmp_path, capsys):
    out = tmp_path / "run"
    words = ["simulate", *file, "--periods", 3, "--saves-per-period", 50, "--probe", 1, "--out", out]
    text, error = call(words, capsys)
    ds = check_repeated(out)
    assert ds.sizes["time"] == 151
    assert ds.attrs["mass [kg]"] == 21
    assert 0 < ds.attrs["probe_error [scales]"] < 0.1
    assert equal(sj.load_scene(f"{out}.nc"), sj.paper_scene(1000.0).replace(mass=21.0))
    assert sj.load_start(f"{out}.nc").motion.v_y == 0.3
    peak = ds["peak_force"].values
    end, point = np.argwhere(peak == peak.max())[0]
    name, when = f"{'ABCDEFGHIJ'[point]}{end + 1}", float(ds["peak_period"].values[end, point])
    assert error == "simulating 3 periods of 8 ms ...\n"
    assert text.startswith(f"wrote {out}.nc and {out}.png\n50 steps per period; highest contact force ")
    assert f" {peak.max():.0f} N at {name}, period {when:.3f}; half the step changes a period by " in text
    assert text.endswith(" of it; status: finite\n")
    assert share(picture(out, 7.2, 9.4), COLORS["blue"]) > 1e-3
    # a bad one is said without its force, by the same program
    text, error = call([*words, "--stiffness", "1e13"], capsys, 1)
    assert f"{out}.nc and {out}.png will be replaced\n" in error
    assert text.endswith(f"\n50 steps per period; status: {Status.NOT_FINITE}\n")
    assert dataset(out).attrs["status"] == Status.NOT_FINITE
    assert share(picture(out, 7.2, 9.4), COLORS["red"]) > 1e-4  # of the title


def test_sections_are_written_drawn_and_repeated_in_a_new_folder(file, tmp_path, capsys):
    out = tmp_path / "deep" / "fig"
    over = ["--over", "section.play.2", 4e-4, 5e-4, 2, "--transient", 2, "--periods", 2]
    text, _ = call(["bifurcation", *over, *file, "--out", out], capsys)
    assert "2 cases, 2 + 2 periods, 50 steps per period: " in text
    assert text.endswith(" s with compiling; 0 cases flagged\n")
    ds = check_repeated(out)
    assert ds["section_play_2" if "section_play_2" in ds.coords else "section.play.2"].values.tolist() == [4e-4, 5e-4]
    assert sj.load_start(f"{out}.nc").v_y == 0.3
    one = {"section.play.2": 4e-4}
    assert equal(sj.load_scene(f"{out}.nc", **one), sj.paper_scene(1000.0).replace(mass=21.0, **one))
    assert share(picture(out, 3.5, 7.9), COLORS["blue"]) > 0


def test_exponents_are_written_drawn_and_repeated(file, tmp_path, capsys):
    out = tmp_path / "exponents"
    over = ["--over", "speed", 1250, 1500, 2, "--transient", 20, "--periods", 10, "--no-certify", "--no-orbits"]
    text, _ = call(["lyapunov", *over, *file, "--out", out], capsys)
    ds = check_repeated(out)
    assert "resolved" not in ds
    kinds, counts = np.unique(ds["regime"].values, return_counts=True)
    found = dict(zip(kinds, counts, strict=True))
    assert f"; {', '.join(f'{found.get(name, 0)} {name}' for name in REGIME_COLORS)}; 0 cases flagged\n" in text
    pixels = picture(out, 3.5, 2.8)
    assert all(share(pixels, REGIME_COLORS[name]) > 0 for name in found)


def test_an_orbit_is_written(tmp_path, capsys):
    out = tmp_path / "orbit"
    text, _ = call(["orbit", "--steps-per-period", 200, "--out", out], capsys)  # as in tests/orbits
    assert f"wrote {out}.nc and {out}.png\nperiod 1, stable, largest exponent -0.04" in text
    ds = dataset(out)
    assert ds.attrs["stable"] == 1
    np.testing.assert_allclose(ds["y"][-1], ds["y"][0], rtol=1e-9)


# with the rooms below replaced


def test_no_orbit_is_exit_code_1_and_no_file(monkeypatch, tmp_path, capsys):
    lost = SimpleNamespace(status=int(Status.NO_ORBIT), residual=0.5)
    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", lambda *arguments, **options: lost)
    text, _ = call(["orbit", "--out", tmp_path / "none"], capsys, 1)
    assert text == f"no file is written; residual 0.5; status: {Status.NO_ORBIT}\n"
    assert names(tmp_path) == []


def test_flagged_cases_are_named(monkeypatch, tmp_path, capsys):
    status, steps = [0, 1, 3, 3], [50, 50, 100, 150]
    data = {name: (("stiffness", "crossing"), np.ones((4, 2))) for name in SECTIONS}
    data |= {f"{name}_period": v for name, v in data.items()}
    data |= {"status": ("stiffness", status), "steps_per_period": ("stiffness", steps)}
    made = xr.Dataset(data, {"stiffness": [1.0, 2.0, 3.0, 4.0]}, {"transient": 310, "periods": 10})
    monkeypatch.setattr("slipperjax.sweeps.sweep.sweep", lambda scene, grid, **options: made)
    out = tmp_path / "fig"
    words = ["bifurcation", "--over", "stiffness", 1, 4, 4, "--out", out]
    text, _ = call(words, capsys)
    assert "4 cases, 310 + 10 periods, 50 to 150 steps per period: " in text
    assert text.endswith(f"; 3 cases flagged (1 {Status.NOT_FINITE} and 2 {Status.UNRESOLVED})\n")
    xr.testing.assert_identical(dataset(out), made)
    assert share(picture(out, 3.5, 7.9), COLORS["grey"]) > 0
    made["status"][:] = int(Status.NOT_FINITE)
    assert "4 cases flagged" in call(words, capsys, 1)[0]


def test_two_parameters_make_a_regime_map(monkeypatch, tmp_path, capsys):
    dims, shape, calls = ("speed", "roll_amplitude"), (2, 2), []
    data = {
        "exponent": ((*dims, "count"), np.reshape([-0.1, 0.2, 0.3, np.nan], (*shape, 1))),
        "stderr": ((*dims, "count"), np.full((*shape, 1), 0.01)),
        "regime": (dims, np.reshape(["periodic", "chaotic", "chaotic", "unresolved"], shape)),
        "status": (dims, np.reshape([0, 0, 0, 1], shape)),
        "steps_per_period": (dims, np.reshape([50, 100, 250, 50], shape)),
    }
    made = xr.Dataset(data, {"speed": [1.0, 2.0], "roll_amplitude": np.radians([0.1, 0.2])})

    def lyapunov_sweep(scene, grid, **options):
        calls.append((grid, options))
        return made

    monkeypatch.setattr("slipperjax.sweeps.exponents.lyapunov_sweep", lyapunov_sweep)
    out = tmp_path / "map"
    axes = ["--over", "speed", 1, 2, 2, "--by", "roll_amplitude", 0.1, 0.2, 2]
    text, _ = call(["lyapunov", *axes, "--count", 2, "--periods", 40, "--out", out], capsys)
    ((grid, options),) = calls
    assert list(grid) == ["speed", "roll_amplitude"]
    assert grid["roll_amplitude"] == pytest.approx(np.radians([0.1, 0.2]))
    wanted = dict(count=2, transient=300, periods=40, certify=True, orbits=True, steps_per_period=None)
    assert {name: options[name] for name in wanted} == wanted
    assert "4 cases, 50 to 250 steps per period: " in text
    assert (
        "; 1 periodic, 0 regular, 2 chaotic, 1 unresolved, 0 transient chaos; 1 cases flagged (1 not finite" in text
    )
    xr.testing.assert_identical(dataset(out), made)
    pixels = picture(out, 3.5, 3.3)
    assert share(pixels, "#d0d0d0") > 0.02  # the case without an exponent, a quarter of the map
    assert share(pixels, matplotlib.colormaps["RdBu_r"](1.0)[:3]) > 0.02  # and the highest exponent


def test_reproduce_writes_each_run_when_it_is_done(monkeypatch, tmp_path, capsys):
    finished = lambda name, figure, seconds, **answers: SimpleNamespace(
        name=name, figures=[figure], seconds=seconds, outcome=SimpleNamespace(answers=answers)
    )
    done = [
        finished("speed", "5", 1.5, A1=SimpleNamespace(good=True)),
        finished("length", "8", 2.5, A2=SimpleNamespace(good=False)),
    ]
    asked, reports, drawn = [], [], []

    def reproduce(figures, **options):
        asked.append((tuple(figures), options["quick"], options["transient"]))
        return iter(done)

    def write_report(out, answers, seconds, table, name="claims"):
        reports.append((dict(answers), dict(seconds), table, name))
        return out / "report.md", out / "report.json"

    room = "slipperjax.studies.dang2024"
    monkeypatch.setattr(f"{room}.runs.reproduce", reproduce)
    monkeypatch.setattr(f"{room}.runs.readings", lambda effort, options: "table")
    monkeypatch.setattr(f"{room}.claims.write_report", write_report)
    monkeypatch.setattr(f"{room}.figures.write_figures", lambda done, out: drawn.append((done.name, out)) or [])
    out = tmp_path / "study"
    text, _ = call(["reproduce", "5", "8", "--transient", 100, "--out", out], capsys)
    assert asked == [(("5", "8"), False, 100)]
    assert out.is_dir()
    assert drawn == [("speed", out), ("length", out)]
    both = ["A1", "A2"]
    named = [(["A1"], "claims_partial"), (both, "claims_partial"), (both, "claims")]
    assert [(sorted(found), name) for found, _, _, name in reports] == named
    assert reports[-1][1:3] == ({"speed": 1.5, "length": 2.5}, [])
    assert "speed: figures 5 in 1.5 s" in text
    assert f"1 of 2 claims reproduced, 1 differ: see {out / 'report.md'}" in text
    call(["reproduce", "--out", out], capsys)  # all figures: with the readings of the whole study
    assert len(asked[-1][0]) > 5
    assert reports[-1][2] == "table"


def test_bench_writes_after_each_scene(monkeypatch, tmp_path, capsys):
    costs = {1e-2: 2.0, 1e-3: 4.0}
    points = [
        Point(case, "RK4", f"{100 * cost:g} steps", error, {8: (cost, 1.1 * cost)})
        for case in ("nominal", "K = 1e10")
        for error, cost in costs.items()
    ]
    asked = []
    out = tmp_path / "deep" / "costs"

    def bench(*, report, **options):
        asked.append(options)
        for point in points:
            report(point)
        yield points[:2], (8,)
        assert "| nominal |" in (out.parent / "costs_partial.md").read_text()
        assert not (out.parent / "costs.md").exists()
        yield points, (8,)

    monkeypatch.setattr("slipperjax.bench.measure.bench", bench)
    text, _ = call(["bench", "--quick", "--batch", 8, "--method", "RK4", "--out", out], capsys)
    assert asked == [dict(quick=True, repeats=None, cases=None, methods=("RK4",), batches=(8,))]
    assert "nominal: RK4, 400 steps: error 1.0e-03, 4 us at 8" in text
    assert text.count(f"wrote {out}_partial.md, {out}_partial.png and {out}_partial_all.png\n") == 2
    assert f"wrote {out}.md, {out}.png and {out}_all.png\n" in text
    assert names(out.parent) == ["costs.md", "costs.png", "costs_all.png"]
    assert "| K = 1e10 |" in (out.parent / "costs.md").read_text()
    assert matplotlib.image.imread(f"{out}.png").ndim == 3
