"""`slipperjax continue`: what it reads, follows, writes and prints, and what an interrupt leaves."""

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
from slipperjax.flow.status import ASKED, Status
from slipperjax.orbits.branches import FINER, OrbitBranch
from slipperjax.orbits.critical import OrbitCurve
from slipperjax.results.kinds import KINDS

from .commands import BRANCH, call, error_of, names, picture

OVER = ["continue", "--over", "speed", 1200, 1300, "--out"]
FROM = ["continue", "--from", BRANCH]
FOLLOW = "orbits.branches.continue_orbit"
SWITCH = "orbits.branches.OrbitBranch.switched"


@pytest.fixture(scope="module")
def branch():
    return sj.load(BRANCH)


@pytest.fixture
def room(branch, replaced):
    """The room below replaced: it finds the first orbit, and the branch of the file; it keeps what is asked of it."""
    orbit = SimpleNamespace(status=int(Status.FINITE), residual=0.5)
    find = replaced("orbits.periodic.periodic_orbit", return_value=orbit)
    replaced("orbits.branches.OrbitBranch.extended", return_value=branch)
    return SimpleNamespace(find=find, follow=replaced(FOLLOW, return_value=branch), orbit=orbit)


def interruption(branch):
    return sj.Interrupted(branch, branch.ds.sizes["point"], unit="points")


# bounds


def test_files_of_another_kind_are_refused(tmp_path, capsys):
    other = tmp_path / "other.nc"
    made = xr.Dataset({"v_z": (("clearance", "crossing"), [[1.0]])}, {"clearance": [1e-3]})
    made.assign_attrs(call='{"function": "sweep"}').to_netcdf(other)
    for arguments, words in (
        ([*OVER[:-1], "--brute", other], "`brute` must be swept over speed"),
        ([*OVER[:-1], "--brute", BRANCH], "`brute` must be"),
        ([*OVER[:-1], "--brute", other, "--quantity", "v_y"], "with `v_y`"),
        (["continue", "--from", other], "Option --from must name a file of slipperjax continue"),
        ([*FROM, "--over", "mass", 10, 20], "begin with speed, as in the file"),
        *(
            ([*FROM, name, value], f"Option {name} must not be given with --from")
            for name, value in (("--speed", 1000), ("--period", 1), ("--set", "mass=15"), ("--steps-per-period", 100))
        ),
    ):
        assert words in error_of([*arguments, "--out", tmp_path / "run"], capsys)


# following


@pytest.mark.full
def test_the_branch_of_a_file_is_followed_further(branch, tmp_path, capsys):
    """The one real run: a point more, beyond the bound of the file's branch, where the case need not be."""
    out = tmp_path / "run"
    text, error = call([*FROM, "--over", "speed", 1090, 1110.1, "--out", out], capsys)
    assert "\r" not in error  # a bar on terminals only, lines elsewhere
    assert error.splitlines()[-1].startswith("branch over speed: 1 points")
    found = sj.load(f"{out}.nc")
    case = f"clearance 1 mm, length 0.2 m, from {BRANCH}"
    assert text.splitlines() == [*found.summary(), case, f"wrote {out}.nc and {out}.png"]
    assert float(found.ds["speed"].max()) == pytest.approx(1110.1)
    assert [event.label for event in found.events] == ["EP", "PD", "EP"]
    np.testing.assert_allclose(found.ds["v_z"][:15], branch.ds["v_z"][:15], rtol=1e-13)  # measured 2e-16
    picture(out, 3.5, 2.9)


def test_branches_of_flips_are_written_and_drawn_over_a_diagram(
    branch, room, replaced, tmp_path, capsys, monkeypatch
):
    switched = replaced(SWITCH, return_value=OrbitBranch(branch.ds.assign_attrs(orbit_period=2)))
    drawn = []
    kind = KINDS["continue_orbit"]
    note = lambda ds, quantity, **more: drawn.append((quantity, more)) or kind.plot(ds, quantity, **more)
    monkeypatch.setitem(KINDS, "continue_orbit", kind._replace(plot=note))
    values = {"v_y": (("speed", "crossing"), [[2.2], [2.3]]), "status": ("speed", [0, 0])}
    brute = xr.Dataset(values, {"speed": [1090.0, 1110.0]}, {"call": '{"function": "sweep"}'})
    brute.to_netcdf(tmp_path / "brute.nc")
    out = tmp_path / "run"
    options = ["--switch", "PD", "--switch", "BP", "--points", 3, "--brute", tmp_path / "brute.nc"]
    text, error = call([*FROM, *options, "--quantity", "v_y", "--out", out], capsys)
    assert error == ""
    ((_, event), asked) = switched.call_args
    assert (event.label, asked["points"]) == ("PD", 3)
    assert f"wrote {out}.nc and {out}.png\nPD1 at 1095.9" in text
    assert text.endswith(f"wrote {out}_PD1.nc\nwrote {out}.png\n")
    assert names(tmp_path) == ["brute.nc", "run.nc", "run.png", "run_PD1.nc"]
    assert sj.load(f"{out}_PD1.nc").period == 2
    assert [(quantity, len(more.get("others", []))) for quantity, more in drawn] == [("v_y", 0), ("v_y", 1)]
    xr.testing.assert_identical(drawn[0][1]["brute"].load(), brute)


def test_options_reach_the_branch(room, tmp_path, capsys):
    options = ["--speed", 1240, "--period", 2, "--transient", 7, "--points", 9, "--out", tmp_path / "run.nc"]
    call(["continue", "--over", "clearance", 0.5, 2, *options], capsys)
    (_, period), how = room.find.call_args
    (scene, name, bounds), more = room.follow.call_args
    assert (period, how["transient"], how["start"]) == (2, 7, None)
    assert more["start"] is room.orbit
    assert (float(scene.speed), name, more["points"], more["progress"]) == (1240.0, "clearance", 9, True)
    assert bounds == pytest.approx((0.5e-3, 2e-3))
    # the more demanding bound's, for both
    most = max(sj.model.default_steps_per_period(sj.paper_scene(1240.0, c)) for c in (0.5e-3, 1e-3, 2e-3))
    assert how["steps_per_period"] == more["steps_per_period"] == FINER * most
    assert names(tmp_path) == ["run.nc"]


def test_no_first_motion_is_exit_code_1(room, tmp_path, capsys):
    room.orbit.status = int(Status.NO_ORBIT)
    text, _ = call([*OVER, tmp_path / "run"], capsys, 1)
    assert text == f"no file is written; status: {Status.NO_ORBIT}\n"
    assert names(tmp_path) == []


def test_flips_without_a_branch_are_said_and_the_rest_goes_on(room, replaced, tmp_path, capsys):
    replaced(SWITCH, side_effect=ValueError("none was found at PD"))
    _, error = call([*FROM, "--switch", "PD", "--out", tmp_path / "run"], capsys)
    assert error.startswith("PD1 at 1095.9")
    assert error.endswith(" m/s: none was found at PD\n")
    assert names(tmp_path) == ["run.nc", "run.png"]


# interrupts


def test_an_interrupted_switch_keeps_the_branch_before(branch, room, replaced, tmp_path, capsys):
    replaced(SWITCH, side_effect=interruption(branch))
    call([*FROM, "--switch", "PD", "--out", tmp_path / "run"], capsys, 130)
    assert names(tmp_path) == ["run.nc", "run.png", "run_PD1_partial.nc", "run_PD1_partial.png"]


def interrupt_soon():
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_a_signal_while_points_are_computed_is_heard_at_the_next(branch, room, tmp_path, capsys):
    """The interrupted branch gets a name of its own."""

    def follow(*arguments, **options):
        interrupt_soon()
        assert ASKED.wait(10)
        time.sleep(0.7)  # the rest of the point
        raise interruption(branch)

    room.follow.side_effect = follow
    out = tmp_path / "run"
    (tmp_path / "run.nc").write_bytes(b"old")
    _, error = call([*OVER, out], capsys, 130)
    waited = "waiting at most 10 s for what is being computed"
    kept = f"{branch.ds.sizes['point']} points were finished: wrote {out}_partial.nc and {out}_partial.png"
    assert error == f"{out}.nc will be replaced\n{waited}\n{kept}\ninterrupted\n"
    assert (tmp_path / "run.nc").read_bytes() == b"old"
    kept = sj.load(f"{out}_partial.nc").ds
    xr.testing.assert_identical(kept.load().drop_attrs(), branch.ds.load().drop_attrs())


@pytest.mark.usefixtures("python_s_own_interrupts")
def test_a_signal_while_nothing_is_found_is_not_waited_for_long():
    begin = time.perf_counter()
    interrupt_soon()
    with pytest.raises(KeyboardInterrupt):
        on_thread(lambda: time.sleep(4), patience=0.5)
    assert time.perf_counter() - begin < 3.5


def test_events_are_followed_over_a_second_parameter(room, branch, replaced, tmp_path, capsys):
    """The curve of the file's flip, made by hand, with a point of codimension two."""
    texts = {"label": ["EP", "GPD"], "point": [0, 1], "note": ["", ""]}
    texts["coefficients"] = ["{}", '{"e": [-0.125, 0.0, 0.01]}']
    texts["stderr"] = ["{}", "{}"]
    columns = {f"event_{name}": ("event", list(values)) for name, values in texts.items()}
    coords = {"speed": ("point", [1090.0, 1100.0]), "clearance": ("point", [1e-3, 2e-3])}
    attrs = dict(label="PD", varied='["speed", "clearance"]', ended=["bound", "bound"], orbit_period=1)
    attrs["call"] = '{"function": "continue_event"}'
    curve = OrbitCurve(xr.Dataset(columns | {"outside": ("point", [0, 0])}, coords, attrs))
    follow = replaced("orbits.critical.continue_event", return_value=curve)
    out, _ = call([*OVER, tmp_path / "own.nc", "--two", "clearance", 0.5, 2], capsys)
    (_, event, name, bounds), options = follow.call_args
    assert (event.label, name, bounds) == ("PD", "clearance", (0.5e-3, 2e-3))
    assert options["progress"]
    assert "GPD at (1100, 0.002): e = -0.125 +- 0.01" in out
    assert names(tmp_path) == ["own.nc", "own_PD1.nc"]
    words = "Option --two must have two bounds, the smaller first"
    assert words in error_of([*OVER, tmp_path / "own.nc", "--two", "clearance", 2, 1], capsys)
