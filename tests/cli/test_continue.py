"""`slipperjax continue`: what it reads, follows, writes and prints, and what an interrupt leaves."""

import importlib
import os
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.cli.interrupts import on_thread
from slipperjax.cli.options import make_bounds
from slipperjax.flow.status import ASKED, Status
from slipperjax.model.quantities import PARAMETERS
from slipperjax.orbits.branches import FINER, OrbitBranch

from .commands import BRANCH, call, names, picture

OVER = ["--over", "speed", 1200, 1300]


@pytest.fixture(scope="module")
def branch():
    return sj.load_branch(BRANCH)


@pytest.fixture
def room(branch, monkeypatch):
    """The room below replaced: it finds the first orbit, and the branch of the file; it keeps what is asked of it."""
    asked = {}
    orbit = SimpleNamespace(status=int(Status.FINITE), residual=0.5)

    def periodic_orbit(scene, period, **options):
        asked["orbit"] = scene, period, options
        return orbit

    def continue_orbit(scene, name, bounds, **options):
        asked["branch"] = scene, name, bounds, options
        return branch

    monkeypatch.setattr("slipperjax.orbits.periodic.periodic_orbit", periodic_orbit)
    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", continue_orbit)
    monkeypatch.setattr(OrbitBranch, "extended", lambda self, bounds, **options: branch)
    return SimpleNamespace(asked=asked, orbit=orbit)


def interrupting(branch):
    def call(*arguments, **options):
        raise sj.Interrupted(branch, branch.points.sizes["point"], unit="points")

    return call


# bounds


@pytest.mark.parametrize(
    ("over", "low", "high"),
    [
        (("speed", 1200.0, 1300.0), 1200.0, 1300.0),
        (("clearance", 0.5, 1.5), 0.5e-3, 1.5e-3),
        (("roll_amplitude", 0.1, 0.3), np.radians(0.1), np.radians(0.3)),
        (("section.play.2", 1e-4, 1e-3), 1e-4, 1e-3),
        *(((name, 0.5, 0.6), 0.5 * q.per_shown, 0.6 * q.per_shown) for name, q in PARAMETERS.items()),
    ],
)
@pytest.mark.filterwarnings("ignore::slipperjax.tools.checks.ImplausibleWarning")
def test_bounds_are_read_in_display_units(over, low, high):
    known, bounds = make_bounds("--over", sj.paper_scene(), *over)
    assert known.name == over[0]
    assert bounds == pytest.approx((low, high))


def test_files_of_another_kind_are_refused(tmp_path, capsys):
    other = tmp_path / "other.nc"
    xr.Dataset({"v_z": (("clearance", "crossing"), [[1.0]])}, {"clearance": [1e-3]}).to_netcdf(other)
    for arguments, words in (
        ([*OVER, "--brute", other], "`brute` must be swept over speed"),
        ([*OVER, "--brute", BRANCH], "`brute` must be"),
        ([*OVER, "--brute", other, "--quantity", "v_y"], "with `v_y`"),
        (["--from", other], "Option --from must name a file of slipperjax continue"),
        (["--from", BRANCH, "--over", "mass", 10, 20], "begin with speed, as in the file"),
        *(
            (["--from", BRANCH, *more], f"Option {more[0]} must not be given with --from")
            for more in (["--speed", 1], ["--period", 1], ["--solver", "RK4"], ["--set", "mass=15"])
        ),
        (["--from", BRANCH, "--steps-per-period", 100], "Option --steps-per-period must not be given with --from"),
    ):
        _, error = call(["continue", *arguments, "--out", tmp_path / "run"], capsys, 2)
        assert words in error
        assert error.startswith("error: ")
        assert error.count("\n") == 1


# following


def test_the_branch_of_a_file_is_followed_further(branch, tmp_path, capsys):
    """The one real run: a point more, beyond the bound of the file's branch, where the case need not be."""
    out = tmp_path / "run"
    text, error = call(["continue", "--from", BRANCH, "--over", "speed", 1090, 1110.1, "--out", out], capsys)
    assert error == ""  # a bar on terminals only
    found = sj.load_branch(f"{out}.nc")
    assert text == f"{found.summary()}\nwrote {out}.nc and {out}.png\n"
    assert float(found.points["speed"].max()) == pytest.approx(1110.1)
    assert [event.label for event in found.events] == ["EP", "PD", "EP"]
    np.testing.assert_array_equal(found.points["v_z"][:15], branch.points["v_z"][:15])
    picture(out, 3.5, 2.9)


@pytest.mark.slow
def test_the_branch_of_a_flip_is_followed(tmp_path, capsys):
    out = tmp_path / "run"
    text, _ = call(["continue", "--from", BRANCH, "--switch", "PD", "--points", 3, "--out", out], capsys)
    assert "OrbitBranch of period 2 over speed" in text
    found = sj.load_branch(f"{out}_PD1.nc")
    assert found.period == 2
    assert np.all(found.points["stable"])


def test_branches_of_flips_are_written_and_drawn_over_a_diagram(branch, room, monkeypatch, tmp_path, capsys):
    asked, drawn = [], []

    def switched(self, event, **options):
        asked.append((event.label, options["points"]))
        return OrbitBranch(branch.points.assign_attrs(orbit_period=2))

    plots = importlib.import_module("slipperjax.plots.branches")  # whose name in the package is the function's
    draw = plots.branches
    monkeypatch.setattr(plots, "branches", lambda ds, *more: drawn.append((len(ds), *more)) or draw(ds, *more))
    monkeypatch.setattr(OrbitBranch, "switched", switched)
    values = {"v_y": (("speed", "crossing"), [[2.2], [2.3]]), "status": ("speed", [0, 0])}
    brute = xr.Dataset(values, {"speed": [1090.0, 1110.0]})
    brute.to_netcdf(tmp_path / "brute.nc")
    out = tmp_path / "run"
    options = ["--switch", "PD", "--switch", "BP", "--points", 3, "--brute", tmp_path / "brute.nc"]
    text, error = call(["continue", "--from", BRANCH, *options, "--quantity", "v_y", "--out", out], capsys)
    assert error == ""
    assert asked == [("PD", 3)]
    assert f"wrote {out}.nc and {out}.png\nPD1 at 1095.9" in text
    assert text.endswith(f"wrote {out}_PD1.nc and replaced {out}.png\n")
    assert names(tmp_path) == ["brute.nc", "run.nc", "run.png", "run_PD1.nc"]
    assert sj.load_branch(f"{out}_PD1.nc").period == 2
    assert [one[:2] for one in drawn] == [(1, "v_y"), (2, "v_y")]
    xr.testing.assert_identical(drawn[0][2].load(), brute)


def test_options_reach_the_branch(room, tmp_path, capsys):
    options = ["--speed", 1240, "--period", 2, "--transient", 7, "--points", 9, "--out", tmp_path / "run.nc"]
    call(["continue", "--over", "clearance", 0.5, 2, *options], capsys)
    _, period, how = room.asked["orbit"]
    scene, name, bounds, more = room.asked["branch"]
    assert (period, how["transient"], how["start"]) == (2, 7, None)
    assert more["start"] is room.orbit
    assert (float(scene.speed), name, more["points"], more["progress"]) == (1240.0, "clearance", 9, False)
    assert bounds == pytest.approx((0.5e-3, 2e-3))
    # the more demanding bound's, for both
    most = max(sj.default_steps_per_period(sj.paper_scene(1240.0, c)) for c in (0.5e-3, 1e-3, 2e-3))
    assert how["steps_per_period"] == more["steps_per_period"] == FINER * most
    assert names(tmp_path) == ["run.nc", "run.png"]


def test_no_first_motion_is_exit_code_1(room, tmp_path, capsys):
    room.orbit.status = int(Status.NO_ORBIT)
    text, _ = call(["continue", *OVER, "--out", tmp_path / "run"], capsys, 1)
    assert text == f"no file is written; residual 0.5; status: {Status.NO_ORBIT}\n"
    assert names(tmp_path) == []


def test_flips_without_a_branch_are_said_and_the_rest_goes_on(room, monkeypatch, tmp_path, capsys):
    def switched(self, event, **options):
        raise ValueError("none was found at PD")

    monkeypatch.setattr(OrbitBranch, "switched", switched)
    _, error = call(["continue", "--from", BRANCH, "--switch", "PD", "--out", tmp_path / "run"], capsys)
    assert error.startswith("PD1 at 1095.9")
    assert error.endswith(" m/s: none was found at PD\n")
    assert names(tmp_path) == ["run.nc", "run.png"]


# interrupts


def test_an_interrupted_branch_gets_a_name_of_its_own(branch, room, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", interrupting(branch))
    out = tmp_path / "run"
    (tmp_path / "run.nc").write_bytes(b"old")
    _, error = call(["continue", *OVER, "--out", out], capsys, 130)
    kept = f"{branch.points.sizes['point']} points were finished: wrote {out}_partial.nc and {out}_partial.png"
    assert error == f"{out}.nc will be replaced\n{kept}\ninterrupted\n"
    assert (tmp_path / "run.nc").read_bytes() == b"old"
    kept = sj.load_branch(f"{out}_partial.nc").points
    xr.testing.assert_identical(kept.load().drop_attrs(), branch.points.load().drop_attrs())


def test_an_interrupted_switch_keeps_the_branch_before(branch, room, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(OrbitBranch, "switched", interrupting(branch))
    call(["continue", "--from", BRANCH, "--switch", "PD", "--out", tmp_path / "run"], capsys, 130)
    assert names(tmp_path) == ["run.nc", "run.png", "run_PD1_partial.nc", "run_PD1_partial.png"]


@pytest.fixture
def python_s_own_interrupts():
    """Interrupts that reach this process as those of a terminal do, whatever started it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt_soon():
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_a_signal_while_points_are_computed_is_heard_at_the_next(branch, room, monkeypatch, tmp_path, capsys):
    def continue_orbit(*arguments, **options):
        interrupt_soon()
        assert ASKED.wait(10)
        time.sleep(0.7)  # the rest of the point
        interrupting(branch)()

    monkeypatch.setattr("slipperjax.orbits.branches.continue_orbit", continue_orbit)
    _, error = call(["continue", *OVER, "--out", tmp_path / "run"], capsys, 130)
    assert "points were finished: wrote" in error
    assert error.startswith("waiting at most 10 s for what is being computed\n")
    assert error.endswith("\ninterrupted\n")


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_a_signal_while_nothing_is_found_is_not_waited_for_long():
    begin = time.perf_counter()
    interrupt_soon()
    with pytest.raises(KeyboardInterrupt):
        on_thread(lambda: time.sleep(4), patience=0.5)
    assert time.perf_counter() - begin < 3.5
