"""`slipperjax continue`: what it reads, follows, writes and prints, and what an interrupt leaves."""

import os
import signal
import threading
import time

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax import plots
from slipperjax.cli import main
from slipperjax.cli.branch import make_bounds
from slipperjax.cli.interrupts import on_thread
from slipperjax.flow.status import ASKED, Status
from slipperjax.model.quantities import PARAMETERS
from slipperjax.orbits.branches import FINER, OrbitBranch

QUICK = ["--steps-per-period", "100"]


def call(arguments, capsys, code=0):
    with pytest.raises(SystemExit) as stopped:
        main(["continue", *map(str, arguments)])
    found = capsys.readouterr()
    assert stopped.value.code == code, found.err
    return found.out, found.err


def refused(arguments, capsys):
    _, error = call(arguments, capsys, 2)
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    return error


@pytest.fixture(scope="module")
def narrow():
    """A branch of three points and more."""
    return sj.continue_orbit(sj.paper_scene(), "speed", (1245.0, 1255.0), steps_per_period=100)


@pytest.fixture(scope="module")
def flip():
    """A branch with a flip at 1095.9 m/s."""
    return sj.continue_orbit(sj.paper_scene(1100.0), "speed", (1090.0, 1110.0), steps_per_period=100)


# bounds


@pytest.mark.parametrize(
    ("over", "low", "high"),
    [
        (("speed", 1200.0, 1300.0), 1200.0, 1300.0),
        (("clearance", 0.5, 1.5), 0.5e-3, 1.5e-3),
        (("roll_amplitude", 0.1, 0.3), np.radians(0.1), np.radians(0.3)),
        (("restitution", 0.9, 1.0), 0.9, 1.0),
        (("section.play.2", 1e-4, 1e-3), 1e-4, 1e-3),
    ],
)
def test_bounds_are_read_in_display_units(over, low, high):
    known, bounds = make_bounds(over, sj.paper_scene())
    assert known.name == over[0]
    assert bounds == pytest.approx((low, high))


def test_every_parameter_of_a_scene_can_be_followed():
    scene = sj.paper_scene().replace(gravity=9.81)
    for name, known in PARAMETERS.items():
        value = known.shown(float(scene.value(name)))
        found, _ = make_bounds((name, 0.9 * value, value), scene)
        assert found.name == name


def test_the_branch_of_a_file_needs_not_hold_the_case():
    assert make_bounds(("speed", 2000.0, 2100.0), sj.paper_scene(), "speed")[1] == (2000.0, 2100.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "Option --over must be given, or --from"),
        (["--over", "speed", 1300, 1200], "two bounds, the smaller first, but has 1300 to 1200 m/s"),
        (["--over", "speed", 1250, 1250], "two bounds, the smaller first"),
        (["--over", "speed", 1300, 1400], "must hold the case's speed, 1250 m/s, but is 1300 to 1400 m/s"),
        (["--over", "clearance", 2, 3], "must hold the case's clearance, 1 mm, but is 2 to 3 mm"),
        (["--over", "clearance", 2, 3, "--clearance", 4], "must hold the case's clearance, 4 mm"),
        (["--over", "foo", 1, 2], "must begin with one of speed, clearance"),
        (
            ["--over", "v_y", 0, 1],
            "must begin with one of speed, clearance",
        ),  # the start's, of which orbits have none
        (["--over", "section.foo", 0, 1], "`section.foo`"),
        (["--over", "section.play.9", 0, 1], "a number of 0 to 4 in place of '9'"),
        (["--over", "gravity", 0, 10], "the scene has no gravitational acceleration"),
        (["--over", "speed", "fast", 1300], "number"),
        (["--over", "speed", "nan", 1300], "`speed` must be positive, but is nan"),
        (["--over", "speed", 1200, "inf"], "`speed` must be positive, but is inf"),
        (["--over", "speed", -5, 1300], "`speed` must be positive, but is -5"),
        (["--over", "speed", 1200], "--over"),
        (["--over", "speed", 1200, 1300, "--over", "mass", 10, 20], "--over must be given once"),
        (["--over", "speed", 1200, 1300, "--points", 0], "`points` must be a whole number of 1 or more, but is 0"),
        (["--over", "speed", 1200, 1300, "--points", 2.5], "--points"),
        (["--over", "speed", 1200, 1300, "--period", 0], "`period` must be a whole number of 1 or more"),
        (["--over", "speed", 1200, 1300, "--transient", -1], "`transient` must be a whole number of 0 or more"),
        (["--over", "speed", 1200, 1300, "--steps-per-period", 0], "`steps_per_period` must be a whole number"),
        (["--over", "speed", 1200, 1300, "--switch", "GR"], "Option --switch must be PD or BP, but is 'GR'"),
        (["--over", "speed", 1200, 1300, "--quantity", "foo"], "`quantity` must be one of v_y, v_z"),
        (["--over", "speed", 1200, 1300, "--brute", "none.nc"], "none.nc"),
        (["--over", "speed", 1200, 1300, "--solver", "foo"], "foo"),
        (["--from", "none.nc"], "none.nc"),
    ],
)
def test_wrong_input_is_one_line(arguments, words, tmp_path, capsys):
    assert words in refused([*arguments, "--out", tmp_path / "run"], capsys)
    assert list(tmp_path.iterdir()) == []


def test_files_of_another_kind_are_refused(narrow, tmp_path, capsys):
    branch, other = tmp_path / "branch.nc", tmp_path / "other.nc"
    narrow.to_netcdf(branch)
    xr.Dataset({"v_z": (("clearance", "crossing"), [[1.0]])}, {"clearance": [1e-3]}).to_netcdf(other)
    over, out = ["--over", "speed", 1200, 1300], ["--out", tmp_path / "run"]
    assert "`brute` must be swept over speed" in refused([*over, "--brute", other, *out], capsys)
    assert "`brute` must be" in refused([*over, "--brute", branch, *out], capsys)
    assert "with `v_y`" in refused([*over, "--brute", other, "--quantity", "v_y", *out], capsys)
    assert "Option --from must name a file of slipperjax continue" in refused(["--from", other, *out], capsys)
    of_file = ["--from", branch, *out]
    assert "begin with speed, as in the file" in refused([*of_file, "--over", "mass", 10, 20], capsys)
    for more in (["--speed", 1200], ["--period", 1], ["--solver", "RK4"], ["--set", "mass=15"], QUICK):
        assert f"Option {more[0]} must not be given with --from" in refused([*of_file, *more], capsys)


# following


def test_a_branch_is_followed_written_and_drawn(narrow, tmp_path, capsys):
    out = tmp_path / "run"
    text, error = call(["--over", "speed", 1245, 1255, *QUICK, "--out", out], capsys)
    assert error == ""  # a bar on terminals only
    found = sj.load_branch(f"{out}.nc")
    assert text == f"{found.summary()}\nwrote {out}.nc and {out}.png\n"
    np.testing.assert_allclose(found.points["speed"], narrow.points["speed"], rtol=1e-9)
    np.testing.assert_allclose(found.points["v_z"], narrow.points["v_z"], rtol=1e-7)
    assert [event.label for event in found.events] == ["EP", "EP"]
    assert matplotlib.image.imread(f"{out}.png").shape[:2] == (870, 1050)
    call(["--from", f"{out}.nc", "--over", "speed", 1244, 1255, "--out", out], capsys)
    wider = sj.load_branch(f"{out}.nc")
    assert float(wider.points["speed"].min()) == pytest.approx(1244)
    assert float(wider.points["speed"].max()) == pytest.approx(1255)


@pytest.mark.slow
def test_the_branch_of_a_flip_is_followed(flip, tmp_path, capsys):
    file, out = tmp_path / "before.nc", tmp_path / "run"
    flip.to_netcdf(file)
    text, _ = call(["--from", file, "--switch", "PD", "--points", 3, "--out", out], capsys)
    assert "OrbitBranch of period 2 over speed" in text
    found = sj.load_branch(f"{out}_PD1.nc")
    assert found.period == 2
    assert np.all(found.points["stable"])


def test_branches_of_flips_are_written_and_drawn_over_a_diagram(flip, monkeypatch, tmp_path, capsys):
    asked, drawn = [], []

    def switched(self, event, **options):
        asked.append((event.label, options["points"]))
        return OrbitBranch(flip.points.assign_attrs(orbit_period=2))

    draw = plots.branches
    monkeypatch.setattr(plots, "branches", lambda ds, *more: drawn.append((len(ds), *more)) or draw(ds, *more))
    monkeypatch.setattr(OrbitBranch, "switched", switched)
    values = {"v_y": (("speed", "crossing"), [[2.2], [2.3]]), "status": ("speed", [0, 0])}
    brute = xr.Dataset(values, {"speed": [1090.0, 1110.0]})
    brute.to_netcdf(tmp_path / "brute.nc")
    flip.to_netcdf(tmp_path / "before.nc")
    out = tmp_path / "run"
    options = ["--switch", "PD", "--switch", "BP", "--points", 3, "--brute", tmp_path / "brute.nc"]
    # from a file that needs no more points
    text, error = call(["--from", tmp_path / "before.nc", *options, "--quantity", "v_y", "--out", out], capsys)
    assert error == ""
    assert asked == [("PD", 3)]
    assert f"wrote {out}.nc and {out}.png\nPD1 at 1095.9" in text
    assert text.endswith(f"wrote {out}_PD1.nc and replaced {out}.png\n")
    found = sorted(path.name for path in tmp_path.iterdir())
    assert found == ["before.nc", "brute.nc", "run.nc", "run.png", "run_PD1.nc"]
    assert sj.load_branch(f"{out}_PD1.nc").period == 2
    assert [one[:2] for one in drawn] == [(1, "v_y"), (2, "v_y")]
    xr.testing.assert_identical(drawn[0][2].load(), brute)


# with the room below replaced


def first(status=Status.FINITE):
    return lambda *arguments, **options: type("Orbit", (), {"status": int(status), "residual": 0.5})()


def test_options_reach_the_branch(narrow, monkeypatch, tmp_path, capsys):
    asked = []

    def continue_orbit(scene, name, bounds, **options):
        asked.append((float(scene.speed), name, bounds, options))
        return narrow

    def periodic_orbit(scene, period, **options):
        asked.append((period, options))
        return first()()

    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", continue_orbit)
    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", periodic_orbit)
    options = ["--speed", 1240, "--period", 2, "--transient", 7, "--points", 9, "--out", tmp_path / "run.nc"]
    call(["--over", "clearance", 0.5, 2, *options], capsys)
    (period, how), (speed, name, bounds, more) = asked
    assert (period, how["transient"], how["start"]) == (2, 7, None)
    assert (speed, name, more["points"], more["progress"]) == (1240.0, "clearance", 9, False)
    assert bounds == pytest.approx((0.5e-3, 2e-3))
    # the more demanding bound's, for both
    most = max(sj.default_steps_per_period(sj.paper_scene(1240.0, c)) for c in (0.5e-3, 1e-3, 2e-3))
    assert how["steps_per_period"] == more["steps_per_period"] == FINER * most
    assert (tmp_path / "run.nc").exists()


def test_no_first_motion_is_exit_code_1(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", first(Status.NO_ORBIT))
    text, _ = call(["--over", "speed", 1200, 1300, "--out", tmp_path / "run"], capsys, 1)
    assert text == f"no file is written; residual 0.5; status: {Status.NO_ORBIT}\n"
    assert list(tmp_path.iterdir()) == []


def test_flips_without_a_branch_are_said_and_the_rest_goes_on(flip, monkeypatch, tmp_path, capsys):
    def switched(self, event, **options):
        raise ValueError("none was found at PD")

    monkeypatch.setattr(OrbitBranch, "extended", lambda self, bounds, **options: flip)
    monkeypatch.setattr(OrbitBranch, "switched", switched)
    flip.to_netcdf(tmp_path / "before.nc")
    out = tmp_path / "run"
    _, error = call(["--from", tmp_path / "before.nc", "--switch", "PD", "--out", out], capsys)
    assert error.startswith("PD1 at 1095.9")
    assert error.endswith(" m/s: none was found at PD\n")
    assert not (tmp_path / "run_PD1.nc").exists()


def test_an_interrupted_branch_gets_a_name_of_its_own(narrow, monkeypatch, tmp_path, capsys):
    def continue_orbit(*arguments, **options):
        raise sj.Interrupted(narrow, narrow.points.sizes["point"], unit="points")

    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", continue_orbit)
    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", first())
    out = tmp_path / "run"
    (tmp_path / "run.nc").write_bytes(b"old")
    _, error = call(["--over", "speed", 1200, 1300, "--out", out], capsys, 130)
    count = narrow.points.sizes["point"]
    assert error == (
        f"{out}.nc will be replaced\n{count} points were found: wrote {out}_partial.nc and {out}_partial.png\n"
        "interrupted\n"
    )
    assert (tmp_path / "run.nc").read_bytes() == b"old"
    kept = sj.load_branch(f"{out}_partial.nc").points
    xr.testing.assert_identical(kept.load().drop_attrs(), narrow.points.drop_attrs())


def test_an_interrupted_switch_keeps_the_branch_before(flip, monkeypatch, tmp_path, capsys):
    def switched(self, event, **options):
        raise sj.Interrupted(flip, flip.points.sizes["point"], unit="points")

    monkeypatch.setattr(OrbitBranch, "extended", lambda self, bounds, **options: flip)
    monkeypatch.setattr(OrbitBranch, "switched", switched)
    flip.to_netcdf(tmp_path / "before.nc")
    call(["--from", tmp_path / "before.nc", "--switch", "PD", "--out", tmp_path / "run"], capsys, 130)
    found = sorted(path.name for path in tmp_path.iterdir())
    assert found == ["before.nc", "run.nc", "run.png", "run_PD1_partial.nc", "run_PD1_partial.png"]


def test_a_signal_while_points_are_computed_is_heard_at_the_next(narrow, monkeypatch, tmp_path, capsys):
    def continue_orbit(*arguments, **options):
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        assert ASKED.wait(10)
        time.sleep(0.7)  # the rest of the point
        raise sj.Interrupted(narrow, narrow.points.sizes["point"], unit="points")

    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", continue_orbit)
    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", first())
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        _, error = call(["--over", "speed", 1200, 1300, "--out", tmp_path / "run"], capsys, 130)
    finally:
        signal.signal(signal.SIGINT, before)
    assert "points were found: wrote" in error
    assert error.startswith("waiting at most 10 s for what is being computed\n")
    assert error.endswith("\ninterrupted\n")


def test_a_signal_while_nothing_is_found_is_not_waited_for_long():
    begin = time.perf_counter()
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            on_thread(lambda: time.sleep(4), patience=0.5)
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.perf_counter() - begin < 3.5
