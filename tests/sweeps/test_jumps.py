"""Attractors of sweeps: grouped, numbered, and followed to where they jump."""

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.status import Status
from slipperjax.sweeps.attractors import attractors, groups
from slipperjax.sweeps.engine import PartRun
from slipperjax.sweeps.follow import find_jump

from ..common import SCALES, growth


def dataset(states, dims):
    return xr.Dataset({"strobe": ((*dims, "strobe_period", "coordinate"), states)})


def test_groups_are_numbered_by_the_size_of_their_basins():
    rng = np.random.default_rng(0)
    kind = np.array([[1, 1, 0], [1, 0, 2], [1, 1, 1]])
    states = 3e-4 * kind[..., None, None] + 1e-6 * rng.standard_normal((3, 3, 30, 10))
    states[2, 2] = np.nan
    found = groups(dataset(states, ("a", "b")))
    assert found["basin"].values.tolist() == [[0, 0, 1], [0, 1, 2], [0, 0, -1]]
    derailed = dataset(states, ("a", "b")).assign(status=(("a", "b"), np.where(kind == 2, int(Status.DERAILED), 0)))
    assert groups(derailed)["basin"].values.tolist() == [[0, 0, 1], [0, 1, -1], [0, 0, -1]]
    named = attractors(derailed)
    assert named.kind[1, 2] == "unresolved"
    assert "derailed" in str(named.evidence[1, 2])


def test_the_largest_basin_comes_first_wherever_it_is_met():
    kind = np.array([0, 0, 1, 2, 2, 2])
    found = groups(dataset(3e-4 * np.tile(kind[:, None, None], (1, 30, 10)), ("a",)))
    assert found["basin"].values.tolist() == [1, 1, 2, 0, 0, 0]
    assert found["share"].values == pytest.approx([3 / 6, 2 / 6, 1 / 6])


def test_motions_on_one_orbit_share_a_group_whatever_their_phase():
    """Seven orbits of period 3, each met in its three phases, and one of period 1."""
    rng = np.random.default_rng(0)
    orbits = rng.uniform(-1, 1, (7, 3, 10))
    lanes = [np.tile(np.roll(orbit, phase, axis=0), (10, 1)) for orbit in orbits for phase in range(3)]
    lanes.append(np.tile(rng.uniform(-1, 1, 10), (30, 1)))
    ds = groups(dataset(1e-3 * np.array(lanes), ("a",)))
    found = ds["basin"].values
    assert ds["basin_period"].values.tolist() == [3] * 7 + [1]
    assert ds["share"].values == pytest.approx([3 / 22] * 7 + [1 / 22])
    assert [len(set(found[3 * k : 3 * k + 3])) for k in range(7)] == [1] * 7
    assert sorted(set(found.tolist())) == list(range(8))


def test_an_attractor_keeps_its_number_over_speeds_and_chaos_is_one():
    """Two orbits that move by less than they are apart, one of which ends; and chaos at every second speed."""
    speeds, starts = np.linspace(1000.0, 1080.0, 9), np.linspace(0.0, 1.0, 20)
    level = 0.02 * np.arange(9)[:, None] + np.where(np.arange(20) < 12, 0.0, 1.0)
    level[5:, :12] += 1.0  # on the second one, too
    states = 1e-3 * np.tile(level[..., None, None], (1, 1, 30, 10))
    rng = np.random.default_rng(0)
    states[::2, 15:] = rng.uniform(-1e-3, 1e-3, (5, 5, 30, 10))
    coords = {"speed": speeds, "start_v_y": starts}
    # in any order of dimensions
    ds = dataset(states, ("speed", "start_v_y")).assign_coords(coords)
    for found in (groups(ds), groups(ds.transpose("start_v_y", ...))):
        assert found["basin"].dims[:1] != ("attractor",)
        basin = found["basin"].transpose("speed", "start_v_y").values
        first, second, chaos = basin[0, 0], basin[0, 12], basin[0, 19]
        assert (first, second, chaos) == (1, 0, 2)
        assert np.all(basin[:5, :12] == first)
        assert np.all(basin[5:, :12] == second)
        assert np.all(basin[:, 12:15] == second)
        assert np.all(basin[::2, 15:] == chaos)
        assert found["basin_period"].values.tolist() == [1, 1, 0]
        share = found["share"].transpose("speed", "attractor").values
        np.testing.assert_allclose(share[[0, 1, 8]], [[0.15, 0.6, 0.25], [0.4, 0.6, 0.0], [0.75, 0.0, 0.25]])


def test_work_grows_as_the_number_of_attractors():
    """Each start is on an attractor of its own, at each of three speeds."""

    def of_starts(count):
        level = np.random.default_rng(0).uniform(-100.0, 100.0, (1, count, 1, 10))
        states = np.tile(level, (3, 1, 4, 1)) * SCALES
        ds = dataset(states, ("speed", "start_y")).assign_coords(speed=[1e3, 2e3, 3e3], start_y=np.arange(count))
        found = groups(ds, last=4)
        # each keeps its number
        assert np.all(np.diff(found["basin"].values, axis=0) == 0)
        assert found["share"].values == pytest.approx(1 / count)

    assert growth(of_starts, 50) < 2.2  # measured 2.00


@pytest.fixture
def motion(monkeypatch):
    """Replaces what a follower computes by a made-up level of its motion and a status at each speed."""

    def made_up(level, status=lambda speed: 0):
        def run_part(part, states, epoch):
            speed = float(part.scenes.varied.speed[0])
            strobe = np.broadcast_to(level(speed), (8, 3, 10)) * SCALES
            return PartRun(states, np.full(8, int(status(speed))), (strobe,), np.empty((8, 0)))

        monkeypatch.setattr("slipperjax.sweeps.follow.run_part", run_part)

    return made_up


@pytest.mark.parametrize(("direction", "leaves"), [("up", 1913.3), ("down", 1620.7)])
def test_jumps_are_told_from_gradual_changes(motion, direction, leaves):
    """On a motion with two branches, whose steady growth from one speed to the next is larger than a jump."""
    motion(lambda speed: 0.01 * speed + (5.0 if speed < leaves else 0.0))
    found = find_jump(sj.paper_scene(), {"speed": np.linspace(1500, 2200, 8)}, direction=direction, within=0.5)
    assert min(found.before, found.after) < leaves <= max(found.before, found.after)
    assert abs(found.before - found.after) <= 0.5
    assert found.size == pytest.approx(5.0, abs=0.1)
    gentle = find_jump(sj.paper_scene(), {"speed": [2000.0, 2100.0, 2200.0]}, direction="up")
    assert (gentle.found, gentle.status) == (False, Status.FINITE)


@pytest.mark.parametrize("recurs", [True, False])
def test_an_escape_from_motions_that_do_not_recur_is_told(motion, recurs):
    rng = np.random.default_rng(0)
    moves = lambda: 0.0 if recurs else rng.uniform(-1, 1, (1, 3, 10))
    motion(lambda speed: 5.0 + (moves() if speed > 1700 else 4.0))
    found = find_jump(sj.paper_scene(), {"speed": [1600.0, 1800.0]}, direction="down", within=200.0, threshold=2.0)
    assert (found.found, found.recurs) == (True, recurs)


def test_a_motion_that_breaks_down_is_no_calm_one(motion):
    """The search ends where the motion does, and says why."""
    lost = lambda speed: speed > 1750
    motion(lambda speed: np.nan if lost(speed) else 0.0, lambda speed: Status.NOT_FINITE if lost(speed) else 0)
    found = find_jump(sj.paper_scene(), {"speed": [1500.0, 1700.0, 1800.0, 1900.0]})
    assert (found.found, found.status) == (False, Status.NOT_FINITE)
    assert (found.before, found.after) == (1700.0, 1800.0)
