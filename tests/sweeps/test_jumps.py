"""Sweeps' attractors told, grouped and followed to where they jump."""

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.recorders import StrobeRecord
from slipperjax.flow.status import Status
from slipperjax.sweeps.attractors import attractors, groups, strobe_states
from slipperjax.sweeps.executors import ChunkRun
from slipperjax.sweeps.follow import find_jump

from ..common import SCALES


def dataset(states, dims):
    return xr.Dataset({"strobe": ((*dims, "period", "coordinate"), states)})


def test_groups_are_numbered_by_the_size_of_their_basins():
    rng = np.random.default_rng(0)
    kind = np.array([[1, 1, 0], [1, 0, 2], [1, 1, 1]])
    centre = np.array([0.0, 0.3, 0.6])[kind]
    states = 1e-3 * (centre[..., None, None] + 1e-3 * rng.standard_normal((3, 3, 30, 10)))
    states[2, 2] = np.nan
    found = groups(dataset(states, ("a", "b")))
    assert found.tolist() == [[0, 0, 1], [0, 1, 2], [0, 0, -1]]
    derailed = dataset(states, ("a", "b")).assign(status=(("a", "b"), np.where(kind == 2, int(Status.DERAILED), 0)))
    assert groups(derailed).tolist() == [[0, 0, 1], [0, 1, -1], [0, 0, -1]]
    named = attractors(derailed)
    assert named.kind[1, 2] == "unresolved"
    assert "derailed" in str(named.evidence[1, 2])


def test_motions_on_one_orbit_share_a_group_whatever_their_phase():
    """Seven orbits of period 3, each met in its three phases, and one of period 1."""
    rng = np.random.default_rng(0)
    orbits = rng.uniform(-1, 1, (7, 3, 10))
    lanes = [np.tile(np.roll(orbit, phase, axis=0), (10, 1)) for orbit in orbits for phase in range(3)]
    lanes.append(np.tile(rng.uniform(-1, 1, 10), (30, 1)))
    found = groups(dataset(1e-3 * np.array(lanes), ("a",)))
    assert [len(set(found[3 * k : 3 * k + 3])) for k in range(7)] == [1] * 7
    assert sorted(set(found.tolist())) == list(range(8))


OPTIONS = dict(periods=10, steps_per_period=50)  # one compiled program, shared with test_sweep


@pytest.mark.slow
def test_a_settled_case_is_period_1_from_sections_and_from_strobes():
    grid = {"speed": [1250.0, 1500.0]}
    sections = sj.sweep(sj.paper_scene(), grid, transient=300, **OPTIONS)
    assert strobe_states(sections).shape == (2, 310, 10)
    strobe = sj.sweep(sj.paper_scene(), grid, record="strobe", transient=300, **OPTIONS)
    # both are the state at the end of a period; measured 1e-13, two programs sum in other orders
    np.testing.assert_allclose(strobe_states(sections, 10), strobe_states(strobe), rtol=1e-8, atol=1e-12)
    found = attractors(sections, 40)
    assert found.period.tolist() == [1, 1], found.evidence


@pytest.mark.parametrize(("direction", "leaves"), [("up", 1913.3), ("down", 1620.7)])
def test_jumps_are_told_from_gradual_changes(monkeypatch, direction, leaves):
    """On a made-up motion with two branches, whose steady growth from one speed to the next is larger than a jump."""

    def run_chunk(plan, scenes, states, steps, on_progress, epoch):
        speed = float(scenes.varied.speed[0])
        high = speed < leaves if direction == "up" else speed < 1620.7
        level = 0.01 * speed + (5.0 if high else 0.0)
        return ChunkRun(states, np.zeros(8, int), StrobeRecord(np.full((8, 3, 10), level) * SCALES))

    monkeypatch.setattr("slipperjax.sweeps.follow.run_chunk", run_chunk)
    found = find_jump(sj.paper_scene(), {"speed": np.linspace(1500, 2200, 8)}, direction=direction, within=0.5)
    assert min(found.before, found.after) < leaves <= max(found.before, found.after)
    assert abs(found.before - found.after) <= 0.5
    assert found.size == pytest.approx(5.0, abs=0.1)
    gentle = find_jump(sj.paper_scene(), {"speed": [2000.0, 2100.0, 2200.0]}, direction="up")
    assert not gentle.found
    assert gentle.status == Status.FINITE


def test_a_motion_that_breaks_down_is_no_calm_one(monkeypatch):
    """The search ends where the motion does, and says why."""

    def run_chunk(plan, scenes, states, steps, on_progress, epoch):
        lost = float(scenes.varied.speed[0]) > 1750
        strobe = np.full((8, 3, 10), np.nan if lost else 0.0)
        return ChunkRun(states, np.full(8, int(Status.NOT_FINITE) if lost else 0), StrobeRecord(strobe))

    monkeypatch.setattr("slipperjax.sweeps.follow.run_chunk", run_chunk)
    found = find_jump(sj.paper_scene(), {"speed": [1500.0, 1700.0, 1800.0, 1900.0]})
    assert not found.found
    assert found.status == Status.NOT_FINITE
    assert (found.before, found.after) == (1700.0, 1800.0)


def test_paths_are_checked():
    with pytest.raises(ValueError, match="`path` must name one parameter with increasing values"):
        find_jump(sj.paper_scene(), {"speed": [1900.0, 1800.0]})
    with pytest.raises(ValueError, match="`direction` must be one of up, down"):
        find_jump(sj.paper_scene(), {"speed": [1800.0, 1900.0]}, direction="left")
    with pytest.raises(ValueError, match="`path` must name one parameter"):
        sj.follow(sj.paper_scene(), {"speed": [1.0, 2.0], "length": [0.2]})


@pytest.mark.slow
def test_cases_side_by_side():
    grid = {"speed": [1250.0, 1500.0], "length": [0.2, 0.3]}
    options = dict(record="strobe", transient=0, **OPTIONS)
    listed = sj.sweep(sj.paper_scene(), grid, product=False, **options)
    assert listed["v_y"].dims == ("case", "period")
    assert listed["length"].dims == ("case",)
    product = sj.sweep(sj.paper_scene(), grid, **options)
    diagonal = np.stack([product["v_y"].values[k, k] for k in range(2)])
    np.testing.assert_array_equal(listed["v_y"].values, diagonal)
    with pytest.raises(ValueError, match="lists of one length"):
        sj.sweep(sj.paper_scene(), {"speed": [1.0, 2.0], "length": [0.2]}, product=False)
