"""The command line from outside: what it reads, computes, writes and prints."""

import math
import re
from types import SimpleNamespace

import equinox as eqx
import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb

import slipperjax as sj
from slipperjax.bench.work_precision import Point
from slipperjax.cli import main
from slipperjax.cli.options import CASE_OPTIONS, PAPER, make_case, make_grid, make_scene, make_solver
from slipperjax.cli.waiting import saying_compiling
from slipperjax.flow.status import Status
from slipperjax.model.quantities import PARAMETERS, SECTIONS
from slipperjax.plots.style import COLORS, REGIME_COLORS

DPI = 300


def run(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    found = capsys.readouterr()
    assert stopped.value.code == 0, found.err
    return found.out + found.err


def refused(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err.strip()
    assert stopped.value.code == 2
    assert error.count("\n") == 0
    return error


def dataset(out):
    with xr.open_dataset(f"{out}.nc", engine="h5netcdf") as ds:
        return ds.load()


def picture(out, width, height):
    """The pixels of a picture of `width` and `height` inches, (rows, columns, 3)."""
    pixels = matplotlib.image.imread(f"{out}.png")[..., :3]
    assert pixels.shape == (round(height * DPI), round(width * DPI), 3)
    return pixels


def share(pixels, color):
    """Share of pixels with a colour."""
    return float(np.mean(np.all(np.abs(pixels - np.array(to_rgb(color))) < 0.01, axis=-1)))


def equal(scene, other):
    return bool(eqx.tree_equal(scene, other, rtol=1e-14))


def same(found, wanted):
    """Equal in every variable, as far as one compiled program repeats itself."""
    xr.testing.assert_allclose(found.drop_attrs(), wanted.drop_attrs(), rtol=1e-12)


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
    ],
)
def test_axes_are_read_in_display_units(axis, values):
    assert make_grid(axis)[axis[0]] == pytest.approx(values)


def test_every_parameter_can_be_an_axis():
    for name in PARAMETERS:
        assert list(make_grid((name, 1.0, 2.0, 2))) == [name]
    grid = make_grid(("speed", 1.0, 2.0, 3), ("clearance", 1.0, 4.0, 2))
    assert list(grid) == ["speed", "clearance"]
    assert grid["clearance"] == pytest.approx([1e-3, 4e-3])


def test_options_in_display_units_make_the_scene():
    given = dict(speed=1000.0, clearance=2.0, length=0.3, stiffness=1e9, restitution=0.5)
    scene = make_scene(**given, wavelength=[8.0, 3.0], amplitude=1.5, roll_amplitude=0.1, memory="smooth")
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
    assert equal(scene, wanted)


def test_defaults_are_the_paper_s(monkeypatch, tmp_path, capsys):
    calls = []

    def simulate(scene, periods, **options):
        calls.append((scene, periods, options))
        raise ValueError("seen")

    monkeypatch.setattr("slipperjax.flow.simulate.simulate", simulate)
    with pytest.raises(SystemExit):
        main(["simulate", "--out", str(tmp_path / "run")])
    ((scene, periods, options),) = calls
    assert equal(scene, sj.paper_scene())
    assert periods == 60
    assert isinstance(options["solver"], sj.RK4)
    assert options["steps_per_period"] is options["saves_per_period"] is None
    assert capsys.readouterr().err == "simulating 60 periods of 6.4 ms ...\nerror: seen\n"


def test_help_names_the_paper_s_values():
    scene = sj.paper_scene()
    for name, value in PAPER.items():
        if name in PARAMETERS and name != "gravity":
            assert PARAMETERS[name].shown(float(scene.value(name))) == pytest.approx(value, rel=1e-12), name
    assert scene.gravity is None
    assert list(scene.track.wavelengths) == [PAPER["wavelength"]]
    assert PAPER["gravity"] == "none"
    assert PAPER["memory"] == "event"
    assert set(PAPER) | {"scene", "set", "solver"} == set(CASE_OPTIONS)


def test_options_override_the_scene_s_file(tmp_path, capsys):
    file = tmp_path / "scene.toml"
    file.write_text('base = "paper"\nspeed = "1000 m/s"\n[slipper]\nmass = "20 kg"\n[start]\nv_y = "1 m/s"\n')
    given = {"speed": 900.0, "set": ["section.play.2=0.4 mm", "slipper.inertia.1=0.07"], "gravity": 9.81}
    case = make_case(**(dict.fromkeys(CASE_OPTIONS) | {"solver": "Rodas4", "scene": file} | given))
    wanted = sj.paper_scene(900.0).replace(mass=20.0, gravity=9.81, inertia_y=0.07, **{"section.play.2": 4e-4})
    assert equal(case.scene, wanted)
    assert case.start.v_y == 1.0
    assert isinstance(case.solver, sj.Rodas4)


@pytest.mark.parametrize("command", ["simulate", "bifurcation", "lyapunov"])
def test_a_result_is_run_again_from_its_file(command, tmp_path, capsys):
    """Each command's file holds its scene, start and solver: as `--scene`, and for `repeat` to the same bits."""
    out = tmp_path / "run"
    over = [] if command == "simulate" else ["--over", "section.play.2", "4e-4", "5e-4", "2", "--transient", "20"]
    file = tmp_path / "scene.toml"
    sj.paper_scene(1000.0).replace(mass=20.0).to_toml(file, start=sj.Motion(v_y=0.3))
    more = ["--periods", "3", "--steps-per-period", "50", *(["--no-certify"] if command == "lyapunov" else [])]
    run([command, *over, *more, "--scene", str(file), "--mass", "21", "--solver", "Tsit5", "--out", str(out)], capsys)
    first, again = dataset(out), sj.repeat(f"{out}.nc")
    for name in first.variables:
        np.testing.assert_array_equal(first[name].values, again[name].values, err_msg=str(name))
    assert first.attrs["solver"] == "Tsit5" if over else True
    chosen = {"section.play.2": 4e-4} if over else {}
    assert equal(sj.load_scene(f"{out}.nc", **chosen), sj.paper_scene(1000.0).replace(mass=21.0, **chosen))
    assert sj.load_start(f"{out}.nc").motion.v_y == 0.3 if not over else sj.load_start(f"{out}.nc").v_y == 0.3


def test_orbits_are_written_and_failures_are_not(tmp_path, capsys):
    out = tmp_path / "orbit"
    text = run(["orbit", "--steps-per-period", "50", "--out", str(out)], capsys)
    assert "period 1, stable, largest exponent -0.046" in text
    ds = dataset(out)
    assert ds.attrs["stable"] == 1
    np.testing.assert_allclose(ds["y"][-1], ds["y"][0], rtol=1e-9)
    with pytest.raises(SystemExit) as stopped:
        main(["orbit", "--speed", "100", "--steps-per-period", "20", "--out", str(tmp_path / "none")])
    assert stopped.value.code == 1
    assert "no file is written" in capsys.readouterr().out
    assert not (tmp_path / "none.nc").exists()


def test_coordinates_of_the_start_are_axes_too():
    grid = make_grid(("y", -0.1, 0.1, 3), ("v_y", 0.4, 0.5, 2))
    np.testing.assert_allclose(grid["y"], [-1e-4, 0.0, 1e-4])
    np.testing.assert_allclose(grid["v_y"], [0.4, 0.5])


def test_logarithmic_axes():
    grid = make_grid(("speed", 100.0, 10000.0, 3), ("clearance", 1.0, 3.0, 3), log=["speed"])
    np.testing.assert_allclose(grid["speed"], [100.0, 1000.0, 10000.0])
    np.testing.assert_allclose(grid["clearance"], [1e-3, 2e-3, 3e-3])


def test_versions_are_printed(capsys):
    assert run(["--version"], capsys).startswith(f"slipperjax {sj.__version__} (python 3")


def test_solvers_are_found_by_name():
    scene = sj.paper_scene()
    assert isinstance(make_solver("Rodas4", scene), sj.Rodas4)
    assert type(make_solver("Tsit5", scene)) is sj.Tsit5  # the one that latches, not diffrax's
    assert type(make_solver("Dopri8", scene).solver).__module__.startswith("diffrax")  # inside Latching


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["lyapunov", "--over", "speed", "1", "2", "2", "--by", "width", "1", "2", "2"], "--by must begin with one"),
        (
            ["lyapunov", "--over", "speed", "1", "2", "2", "--by", "mass", "1", "2", "0"],
            "--by must end with a number",
        ),
        (["lyapunov", "--over", "speed", "1", "2", "2", "--by", "speed", "1", "2", "2"], "--by must name another"),
        (["bifurcation", "--over", "gravity", "-9", "10", "2"], "`gravity` must be zero or positive, but is -9"),
        (
            ["bifurcation", "--over", "clearance", "-1", "2", "2"],
            "`clearance` must be zero or positive, but is -0.001",
        ),
        (["simulate", "--solver", "Latching"], "`solver` must be one of RK4"),
        (["simulate", "--periods", "0"], "`periods` must be a whole number of 1 or more, but is 0"),
        (["simulate", "--steps-per-period", "50", "--saves-per-period", "7"], "`saves_per_period` must divide"),
        (["bifurcation", "--over", "speed", "1", "2"], "--over"),
    ],
)
def test_bad_input_is_one_line_and_code_2(arguments, words, tmp_path, capsys):
    assert words in refused([*arguments, "--out", str(tmp_path / "run")], capsys)


@pytest.mark.parametrize("command", ["bifurcation", "lyapunov", "simulate"])
def test_help_names_units(command, capsys):
    text = run([command, "--help"], capsys)
    for option, unit in (("--speed", "[m/s]"), ("--clearance", "[mm]"), ("--length", "[m]"), ("--amplitude", "[mm]")):
        assert re.search(rf"{option} [^-]*{re.escape(unit)}", text), option
    if command != "simulate":
        assert "mass [kg]" in re.sub(r"\s+", " ", text)  # of --over


def test_no_arguments_ask_for_help(monkeypatch, capsys):
    texts = []
    for arguments in ([], None, ["--help"]):
        monkeypatch.setattr("sys.argv", ["slipperjax"])
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        found = capsys.readouterr()
        assert ended.value.code == 0
        assert not found.err
        texts.append(found.out)
    assert len(set(texts)) == 1


def test_help_lists_the_commands(capsys):
    text = run(["--help"], capsys)
    for command in ("simulate", "bifurcation", "lyapunov", "reproduce", "bench"):
        assert re.search(rf"^  {command} ", text, re.MULTILINE)


# computing and writing


def test_simulate_writes_its_trajectory(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--periods", "6", "--steps-per-period", "200", "--saves-per-period", "200", "--solver", "RK4"]
    text = run(["simulate", *options, "--clearance", "1.5", "--out", str(out)], capsys)
    ds = dataset(out)
    assert ds.sizes["time"] == 1201
    assert ds.attrs["clearance [m]"] == pytest.approx(1.5e-3)
    scene = sj.paper_scene(clearance=1.5e-3)
    same(ds, sj.simulate(scene, 6, steps_per_period=200, saves_per_period=200, probe=4).to_xarray())
    peak = ds["peak_force"].values
    end, point = np.argwhere(peak == peak.max())[0]
    when = float(ds["peak_period"].values[end, point])
    name = f"{'ABCDEFGHIJ'[point]}{end + 1}"
    assert (
        f"200 steps per period; highest contact force {peak.max():.0f} N at {name}, period {when:.3f}; half" in text
    )
    assert " of it; status: finite\n" in text
    assert ds.attrs["probe_error [scales]"] < 1e-3
    assert share(picture(out, 7.2, 9.4), COLORS["blue"]) > 1e-3


def test_bifurcation_writes_sections_in_a_new_folder(tmp_path, capsys):
    out = tmp_path / "deep" / "fig"
    options = ["--transient", "2", "--periods", "2", "--steps-per-period", "50", "--out", str(out)]
    text = run(["bifurcation", "--over", "clearance", "0.5", "1.5", "3", *options], capsys)
    assert "3 cases, 2 + 2 periods, 50 steps per period: " in text
    assert "; 0 cases flagged\n" in text
    ds = dataset(out)
    assert ds["clearance"].values == pytest.approx([0.5e-3, 1e-3, 1.5e-3])
    assert ds["clearance"].attrs["units"] == "m"
    assert ds["steps_per_period"].values.tolist() == [50] * 3
    grid = {"clearance": np.linspace(0.5, 1.5, 3) * 1e-3}
    same(ds, sj.sweep(sj.paper_scene(), grid, transient=2, periods=2, steps_per_period=50))
    assert share(picture(out, 3.5, 7.9), COLORS["blue"]) > 0


def test_lyapunov_writes_exponents_and_counts_regimes(tmp_path, capsys):
    out = tmp_path / "exponents"
    options = ["--transient", "20", "--periods", "20", "--no-certify", "--out", str(out)]
    text = run(["lyapunov", "--over", "speed", "1250", "1500", "2", *options], capsys)
    ds = dataset(out)
    wanted = sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1250.0, 1500.0]}, transient=20, periods=20, certify=False)
    same(ds, wanted)
    assert "resolved" not in ds
    assert np.all(ds["exponent"] < 0)
    names, counts = np.unique(ds["regime"].values, return_counts=True)
    found = dict(zip(names, counts, strict=True))
    shares = ", ".join(f"{found.get(name, 0)} {name}" for name in REGIME_COLORS)
    assert f"2 cases: {shares}; 50 steps per period, " in text
    assert "; 0 cases flagged\n" in text
    pixels = picture(out, 3.5, 2.8)
    assert all(share(pixels, REGIME_COLORS[name]) > 0 for name in found)


# the commands' own parts, with the rooms below replaced


def made(status, steps=(50, 100, 250, 50)):
    """A result of `lyapunov_sweep` over speed and roll amplitude."""
    dims, shape = ("speed", "roll_amplitude"), (2, 2)
    data = {
        "exponent": ((*dims, "count"), np.reshape([-0.1, 0.2, 0.3, np.nan], (*shape, 1))),
        "stderr": ((*dims, "count"), np.full((*shape, 1), 0.01)),
        "regime": (dims, np.reshape(["periodic", "chaotic", "chaotic", "unresolved"], shape)),
        "status": (dims, np.reshape(status, shape)),
        "steps_per_period": (dims, np.reshape(steps, shape)),
    }
    return xr.Dataset(data, {"speed": [1.0, 2.0], "roll_amplitude": np.radians([0.1, 0.2])})


def test_bifurcation_names_what_is_wrong_with_flagged_cases(monkeypatch, tmp_path, capsys):
    status, steps = [0, 1, 3, 3], [50, 50, 100, 150]
    data = {name: (("stiffness", "crossing"), np.ones((4, 2))) for name in SECTIONS}
    data |= {"status": ("stiffness", status), "steps_per_period": ("stiffness", steps)}
    made = xr.Dataset(data, {"stiffness": [1.0, 2.0, 3.0, 4.0]}, {"transient": 310})
    monkeypatch.setattr("slipperjax.sweeps.sweep.sweep", lambda scene, grid, **options: made)
    out = tmp_path / "fig"
    text = run(["bifurcation", "--over", "stiffness", "1", "4", "4", "--out", str(out)], capsys)
    assert "4 cases, 310 + 10 periods, 50 to 150 steps per period: " in text
    found = re.search(r"3 cases flagged \((.*) and (.*)\)$", text.strip())
    assert found[1] == f"1 {Status.NOT_FINITE}"
    assert found[2] == f"2 {Status.UNRESOLVED}"
    xr.testing.assert_identical(dataset(out), made)
    assert share(picture(out, 3.5, 7.9), COLORS["grey"]) > 0


def test_two_parameters_make_a_regime_map(monkeypatch, tmp_path, capsys):
    calls = []

    def lyapunov_sweep(scene, grid, **options):
        calls.append((grid, options))
        return made([0, 0, 0, 1])

    monkeypatch.setattr("slipperjax.sweeps.exponents.lyapunov_sweep", lyapunov_sweep)
    out = tmp_path / "map"
    axes = ["--over", "speed", "1", "2", "2", "--by", "roll_amplitude", "0.1", "0.2", "2"]
    text = run(["lyapunov", *axes, "--count", "2", "--periods", "40", "--out", str(out)], capsys)
    ((grid, options),) = calls
    assert list(grid) == ["speed", "roll_amplitude"]
    assert grid["roll_amplitude"] == pytest.approx(np.radians([0.1, 0.2]))
    wanted = dict(count=2, transient=300, periods=40, certify=True, steps_per_period=None)
    assert {name: options[name] for name in wanted} == wanted
    shares = "1 periodic, 0 regular, 2 chaotic, 1 unresolved, 0 transient chaos"
    assert f"4 cases: {shares}; 50 to 250 steps per period, " in text
    assert "1 cases flagged (1 not finite: " in text
    xr.testing.assert_identical(dataset(out), made([0, 0, 0, 1]))
    pixels = picture(out, 3.5, 3.3)
    assert share(pixels, "#d0d0d0") > 0.02  # the case without an exponent, a quarter of the map
    assert share(pixels, matplotlib.colormaps["RdBu_r"](1.0)[:3]) > 0.02  # and the highest exponent


def test_reproduce_writes_each_run_when_it_is_done(monkeypatch, tmp_path, capsys):
    answers = {"A1": SimpleNamespace(good=True), "A2": SimpleNamespace(good=False)}
    done = [
        SimpleNamespace(
            name="speed", figures=["5"], seconds=1.5, outcome=SimpleNamespace(answers={"A1": answers["A1"]})
        ),
        SimpleNamespace(
            name="length", figures=["8"], seconds=2.5, outcome=SimpleNamespace(answers={"A2": answers["A2"]})
        ),
    ]
    asked, reports, drawn = [], [], []

    def reproduce(figures, **options):
        asked.append((tuple(figures), options["quick"], options["transient"]))
        return iter(done)

    def write_report(out, answers, seconds, table, name="claims"):
        reports.append((dict(answers), dict(seconds), table, name))
        return out / "report.md", out / "report.json"

    room = "slipperjax.studies.dang2024"
    monkeypatch.setattr(f"{room}.reproduce", reproduce)
    monkeypatch.setattr(f"{room}.write_report", write_report)
    monkeypatch.setattr(f"{room}.write_figures", lambda done, out: drawn.append((done.name, out)) or [])
    monkeypatch.setattr(f"{room}.readings", lambda effort, options: "table")
    out = tmp_path / "study"
    text = run(["reproduce", "5", "8", "--transient", "100", "--out", str(out)], capsys)
    assert asked == [(("5", "8"), False, 100)]
    assert out.is_dir()
    assert drawn == [("speed", out), ("length", out)]
    both = ["A1", "A2"]
    named = [(["A1"], "claims_partial"), (both, "claims_partial"), (both, "claims")]
    assert [(sorted(found), name) for found, _, _, name in reports] == named
    assert reports[-1][1:3] == ({"speed": 1.5, "length": 2.5}, [])
    assert "speed: figures 5 in 1.5 s" in text
    assert f"1 of 2 claims reproduced, 1 differ: see {out / 'report.md'}" in text
    run(["reproduce", "--out", str(out)], capsys)  # all figures: with the readings of the whole study
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

    def bench(*, report, **options):
        asked.append(options)
        for point in points:
            report(point)
        yield points[:2], (8,)
        assert "| nominal |" in (tmp_path / "deep" / "costs_partial.md").read_text()
        assert not (tmp_path / "deep" / "costs.md").exists()
        yield points, (8,)

    monkeypatch.setattr("slipperjax.bench.measure.bench", bench)
    out = tmp_path / "deep" / "costs"
    text = run(["bench", "--quick", "--batch", "8", "--method", "RK4", "--out", str(out)], capsys)
    assert asked == [dict(quick=True, repeats=None, cases=None, methods=["RK4"], batches=[8])]
    assert "nominal: RK4, 400 steps: error 1.0e-03, 4 us at 8" in text
    assert text.count(f"wrote {out}_partial.md, {out}_partial.png and {out}_partial_all.png\n") == 2
    assert f"wrote {out}.md, {out}.png and {out}_all.png\n" in text
    assert sorted(p.name for p in out.parent.iterdir()) == ["costs.md", "costs.png", "costs_all.png"]
    assert "| K = 1e10 |" in (tmp_path / "deep" / "costs.md").read_text()
    assert matplotlib.image.imread(f"{out}.png").ndim == 3


def test_an_interrupt_is_one_line(monkeypatch, tmp_path, capsys):
    def simulate(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("slipperjax.flow.simulate.simulate", simulate)
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "--out", str(tmp_path / "run")])
    assert stopped.value.code == 130
    assert capsys.readouterr().err.strip().endswith("interrupted")


def test_a_bad_trajectory_is_reported_without_its_force(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--stiffness", "1e13", "--periods", "6", "--steps-per-period", "200", "--saves-per-period", "200"]
    with pytest.raises(SystemExit) as ended:
        main(["simulate", *options, "--out", str(out)])
    assert ended.value.code == 1
    assert f"\n200 steps per period; status: {Status.NOT_FINITE}\n" in capsys.readouterr().out
    assert dataset(out).attrs["status"] == Status.NOT_FINITE
    assert share(picture(out, 7.2, 9.4), COLORS["red"]) > 1e-4  # of the title


def test_compiling_is_said_once_and_only_while_a_command_waits(capsys):
    fresh = lambda k: sj.jit(lambda x: x + k)(1.0)
    with saying_compiling():
        fresh(1)
        fresh(2)
    fresh(3)
    assert capsys.readouterr().err == "compiling ...\n"
