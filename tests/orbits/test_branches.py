"""Branches of orbits of slippers: events, files, switching, and critical orbits with their derivatives."""

from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status, Stop
from slipperjax.orbits.critical import OrbitCurve, continue_event, critical_orbit, orbit_form

from .nominal import SCENE, STEPS

DATA = Path(__file__).parents[1] / "data" / "branch.nc"


def followed(scene=SCENE, bounds=(1050.0, 1270.0), **options):
    return sj.continue_orbit(scene, "speed", bounds, steps_per_period=STEPS, **options)


@pytest.fixture(scope="module")
def branch():
    """From the nominal orbit down through two grazings and the flip."""
    return followed()


def labels(branch):
    return [event.label for event in branch.events]


@pytest.mark.full
def test_points_are_orbits_of_their_scenes(branch):
    ds = branch.ds
    assert float(ds["residual"].max()) < 1e-10
    for k in (0, ds.sizes["point"] // 2):
        orbit = branch.orbit(k)
        found = sj.periodic_orbit(orbit.scene, start=orbit.state, steps_per_period=STEPS)
        assert int(found.status) == Status.FINITE
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-9), found.state, orbit.state)
        largest = lambda one: np.sort(np.abs(one.multipliers))[-4:]
        np.testing.assert_allclose(largest(found), largest(orbit), rtol=0, atol=1e-6)  # measured: 5e-11
        assert " ".join(orbit.signature.points) == str(ds["signature"][k].values)


@pytest.mark.full
def test_the_flip_and_the_grazings_are_located(branch):
    assert labels(branch) == ["EP", "GR", "GR", "PD", "EP"]
    _, *grazings, flip, _ = branch.events
    np.testing.assert_allclose(flip.multiplier, -1, rtol=0, atol=1e-8)
    for event in branch.events:
        assert event.converged
        assert event.low <= event.value <= event.high
        assert event.high - event.low < 1e-6
    # at 200 and 400 steps 1095.9138 and 1095.9042 m/s; measured at 96: 1096.00
    np.testing.assert_allclose(flip.value, 1095.91, rtol=2e-4)
    stable = branch.ds["stable"].values
    beyond = branch.ds["speed"].values > flip.value + 1e-6
    assert stable[beyond].all()
    assert not stable[~beyond & (branch.ds["label"].values != "PD")].any()
    # a touchdown comes with each, of zero speed, and its gap's extreme is zero
    for event in grazings:
        before, after = (branch.ds.isel(point=event.point + k) for k in (-1, 1))
        assert abs(int(after["touchdowns"].sum()) - int(before["touchdowns"].sum())) == 1
        assert float(branch.ds["grazing_gap"][event.point]) < 1e-10
        assert "touches once" in event.note


@pytest.mark.full
def test_grazings_are_those_of_fine_trajectories(branch):
    event = branch.events_named("GR")[0]
    point = event.note.split()[0]
    place = [f"{name}{end}" for end in (1, 2) for name in SCENE.section.names].index(point)
    gap = np.asarray(branch.orbit(event).trajectory().reactions.gap).reshape(STEPS + 1, -1)
    # the least open gap of that point is where the parabola through its neighbours touches zero; measured: 2e-8 m
    gap = gap[:, place]
    lows = 1 + np.flatnonzero((gap[1:-1] <= np.minimum(gap[:-2], gap[2:])) & (np.abs(gap[1:-1]) < 1e-4))
    low = lows[np.argmin(np.abs(gap[lows]))]
    a, b, c = gap[low - 1 : low + 2]
    assert abs(b - (a - c) ** 2 / (8 * (a + c - 2 * b))) < 1e-6


def test_tables_of_a_branch_and_a_curve_have_a_row_for_each_point_and_event():
    branch = sj.load(DATA)
    rows, events = branch.tables().values()
    assert (len(rows), len(events)) == (branch.ds.sizes["point"], len(branch.events)) == (16, 3)
    np.testing.assert_array_equal(rows["state_3"], branch.ds["state"][:, 3])
    assert events["label"].tolist() == ["EP", "PD", "EP"]
    clearance = ("point", np.linspace(1e-3, 2e-3, len(rows)))
    points = branch.ds.assign_coords(clearance=clearance).assign_attrs(varied='["speed", "clearance"]')
    rows = OrbitCurve(points.assign_attrs(call='{"function": "continue_event"}')).tables()["points"]
    np.testing.assert_array_equal(rows["clearance"], clearance[1])


@pytest.mark.full
def test_a_branch_goes_through_a_file_and_on(branch, tmp_path):
    branch.write(tmp_path / "branch.nc")
    read = sj.load(tmp_path / "branch.nc")
    assert read.summary() == branch.summary()
    wider = read.extended((1045.0, 1270.0))
    assert wider.ds["speed"].values[0] == 1045.0
    assert labels(wider) == ["EP", "GR", "GR", "PD", "EP"]
    same = wider.ds.isel(point=slice(-5, None))
    np.testing.assert_allclose(same["state"], branch.ds["state"][-5:], rtol=0, atol=1e-12)
    scene = sj.load(read.ds.isel(point=3)).scene
    np.testing.assert_allclose(float(scene.speed), read.ds["speed"][3])


@pytest.mark.full
def test_a_branch_that_is_interrupted_goes_on(branch, nominal, monkeypatch):
    # asked to end at the third point
    asked = iter([False, False, True])
    monkeypatch.setattr(Stop, "here", lambda: SimpleNamespace(is_set=lambda: next(asked, False)))
    with pytest.raises(sj.Interrupted) as stop:
        followed(start=nominal, until=("PD",))
    part = stop.value.result
    assert part.ds.attrs["ended"] == ["count", "interrupted"]
    assert stop.value.finished == part.ds.sizes["point"] < branch.ds.sizes["point"]
    part = part.extended(until=("PD",))
    assert part.ds.attrs["ended"] == ["event", "bound"]
    # what else lies within the last step is kept: here a grazing
    assert labels(part) == ["GR", "PD", "EP"]
    whole = part.extended()
    # measured: equal to the last bit
    np.testing.assert_allclose(whole.ds["speed"], branch.ds["speed"], rtol=1e-12)
    np.testing.assert_allclose(whole.ds["state"], branch.ds["state"], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_flip_s_value_has_derivatives(branch):
    flip = branch.events_named("PD")[0]
    orbit = branch.orbit(flip)
    exact = critical_orbit(SCENE, "speed", "PD", orbit)
    np.testing.assert_allclose(float(exact.value), flip.value, rtol=1e-9)
    assert float(exact.residual) < 1e-10
    of_clearance = lambda c: critical_orbit(SCENE.replace(clearance=c), "speed", "PD", orbit).value
    slope = jax.jacfwd(of_clearance)(1e-3)
    difference = (of_clearance(1e-3 + 1e-8) - of_clearance(1e-3 - 1e-8)) / 2e-8
    # measured: 1e-7 of it
    np.testing.assert_allclose(slope, difference, rtol=1e-4)


@pytest.mark.slow
def test_the_doubled_branch_leaves_at_the_flip(branch):
    flip = branch.events_named("PD")[0]
    doubled = branch.switched(flip, points=8)
    assert doubled.period == 2
    orbit = doubled.orbit(0)
    once = sj.period_map(orbit.scene, orbit.state, steps_per_period=STEPS)
    twice = sj.period_map(orbit.scene, once, steps_per_period=STEPS)
    assert abs(float(once.motion.v_y - orbit.state.motion.v_y)) > 1e-4
    np.testing.assert_allclose(float(twice.motion.v_y), float(orbit.state.motion.v_y), atol=1e-9)
    with pytest.raises(ValueError, match="must be a flip"):
        branch.switched(branch.events_named("GR")[0])


@pytest.mark.slow
def test_curves_of_the_flip_and_of_a_grazing(branch):
    flip, touch = branch.events_named("PD")[0], branch.events_named("GR")[0]
    curve = continue_event(branch, flip, "clearance", (0.95e-3, 1.05e-3))
    speeds, clearances = curve.ds["speed"].values, curve.ds["clearance"].values
    assert {round(c, 9) for c in clearances[[0, -1]]} == {0.95e-3, 1.05e-3}
    order = np.argsort(clearances)
    np.testing.assert_allclose(np.interp(1e-3, clearances[order], speeds[order]), flip.value, rtol=1e-4)
    again = followed(SCENE.replace(clearance=clearances[-1], speed=1150.0), (1050.0, 1200.0))
    np.testing.assert_allclose(again.events_named("PD")[0].value, speeds[-1], rtol=1e-4)
    grazing = continue_event(branch, touch, "clearance", (0.99e-3, 1.01e-3))
    clearance = grazing.ds["clearance"].values[-1]
    again = followed(SCENE.replace(clearance=clearance, speed=1150.0), (1040.0, 1200.0))
    nearest = min(abs(event.value - grazing.ds["speed"].values[-1]) for event in again.events_named("GR"))
    assert nearest < 1e-3  # measured: 1e-6 m/s


@pytest.mark.full
def test_wrong_arguments_are_named(nominal):
    for bounds, until, words in (
        ((1300.0, 1200.0), (), "`bounds` must be two values of speed"),
        ((1300.0, 1400.0), (), "`speed` must lie within the bounds 1300 and 1400, but is 1250"),
        ((1200.0, 1300.0), ("EP",), "`until` must be a tuple of labels of LP, BP, PD, NS, GR, but is"),
    ):
        with pytest.raises(ValueError, match=words):
            sj.continue_orbit(SCENE, "speed", bounds, until=until)
    with pytest.raises(ValueError, match="`start` must be near a periodic motion"):
        sj.continue_orbit(SCENE.replace(speed=100.0), "speed", (90.0, 120.0), start=nominal, steps_per_period=20)


def test_normal_forms_are_those_of_folds_flips_and_neimark_sackers():
    branch = sj.load(DATA)
    with pytest.raises(ValueError, match="`event` must be one of LP, PD, NS, but is 'EP'"):
        orbit_form(branch, branch.events_named("EP")[0])
