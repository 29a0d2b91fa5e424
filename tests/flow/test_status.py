"""Failures are marked, and stay marked."""

import dataclasses
import pickle

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.status import Status, first_problem, is_lost, with_loads, with_resolution, without_lost

RAIL = sj.RandomTrack.sled(length=250.0)


def test_every_status_has_a_meaning_and_what_to_do():
    assert [int(s) for s in Status] == list(range(12))
    assert str(Status.FINITE) == "finite"
    for status in list(Status)[1:]:
        assert status.meaning
        assert status.remedy
        assert str(Status(int(status))) == f"{status.meaning}; {status.remedy}"


@pytest.mark.full
def test_numbers_of_lost_cases_mean_nothing():
    codes = np.arange(10).reshape(2, 5)
    assert is_lost(codes).tolist() == [[False, True, True, True, True], [False, False, True, True, False]]
    assert is_lost(Status.DERAILED)
    assert not is_lost(Status.INACCURATE)
    run = sj.simulate(sj.paper_scene(), 1, steps_per_period=50)
    assert "status 0: finite, highest single contact point" in repr(run)
    for status in (Status.DERAILED, Status.PRESSED_IN, Status.TOO_FEW_STEPS):
        lost = dataclasses.replace(run, status=jnp.asarray(int(status)))
        assert repr(lost).endswith(f"50 steps per period, status {int(status)}: {status})")


def test_lost_motions_have_no_numbers():
    status = np.arange(len(Status))
    values = (np.ones((len(Status), 2)), np.ones(len(Status), int), np.zeros(len(Status), np.float32))
    forces, counts, zeros = without_lost(values, status)
    # whether there is an orbit, and what was not reached, is no matter of the motion
    assert np.flatnonzero(np.isnan(forces).all(axis=1)).tolist() == [1, 2, 3, 4]
    assert np.flatnonzero(np.isnan(forces).any(axis=1)).tolist() == [1, 2, 3, 4]
    assert np.isnan(zeros).sum() == 4
    assert zeros.dtype == np.float32
    assert counts.all()
    assert without_lost(values, 0 * status)[0] is values[0]


def test_the_first_problem_stays_but_lost_numbers_come_before_coarse_steps():
    earlier = np.array([0, 0, 1, 2, 3, 3])
    later = np.array([0, 2, 3, 1, 1, 2])
    assert first_problem(earlier, later).tolist() == [0, 2, 1, 2, 1, 3]


@pytest.mark.full
@pytest.mark.parametrize("memory", [sj.model.EventLatch(), sj.model.PeakRateLatch()])
def test_damping_that_dwarfs_the_elastic_force_is_doubted_on_rough_rails(memory):
    scene = dataclasses.replace(sj.paper_scene(1000.0, restitution=0.5, memory=memory), track=RAIL)
    options = dict(transient=1, periods=4, record="damping_ratio", product=False, progress=False)
    ds = sj.sweep(scene, {"track.seed": np.arange(8.0)}, **options)
    highest = ds["damping_ratio"].max(("end", "point")).values
    if isinstance(memory, sj.model.PeakRateLatch):
        # as at a touchdown, c of Eq. (12)
        np.testing.assert_allclose(highest, float(scene.contact.factor), rtol=1e-9)
    else:
        assert np.mean(highest > 3) > 0.5
    np.testing.assert_array_equal(ds["status"] == Status.DAMPED, highest > 3)
    assert not is_lost(Status.DAMPED)


def test_damping_on_the_papers_rail_is_not_doubted():
    """Where the law itself has more than three times at each touchdown it is none on rough ones, either."""
    code = eqx.filter_jit(
        lambda scene, ratio: with_loads(np.zeros((), int), np.ones(()), *np.zeros(2), ratio, scene, 5.0)
    )
    run = sj.simulate(sj.paper_scene(), 1, steps_per_period=40)
    assert run.loads is not None
    assert float(np.max(run.loads.damping_ratio)) == 0.0
    assert int(run.status) == Status.FINITE
    of = lambda scene, ratio: int(code(scene, np.float64(ratio)))
    rough = dataclasses.replace(sj.paper_scene(), track=RAIL)
    law = sj.model.Flores(1e8, 0.3)  # c is 3.73
    assert [of(rough, ratio) for ratio in (2.9, 3.1)] == [Status.FINITE, Status.DAMPED]
    assert [of(dataclasses.replace(rough, contact=law), ratio) for ratio in (3.7, 3.8)] == [0, Status.DAMPED]
    constant = dataclasses.replace(rough, contact=sj.model.ConstantDamping(1e8, 0.5))
    assert of(constant, 3.1) == Status.DAMPED


def test_an_interrupt_says_what_it_left():
    where = ", see the attribute `result` of this exception"
    assert str(sj.Interrupted("a dataset", 8, 10)) == f"8 of 10 cases were finished{where}"
    assert str(sj.Interrupted("a branch", 12, unit="points")) == f"12 points were finished{where}"
    kept = pickle.loads(pickle.dumps(sj.Interrupted("a design", 3, unit="trials")))  # as from another process
    assert (kept.result, kept.finished, kept.of, kept.unit) == ("a design", 3, None, "trials")
    assert isinstance(kept, KeyboardInterrupt)  # `except Exception` does not catch it


# braked to 50 m/s for one forcing period, the 103rd
DIP = sj.SpeedProgramme.over_distance([0.0, 800.0, 816.0, 824.0, 840.0], [1000.0, 1000.0, 50.0, 50.0, 1000.0])
BRAKED = dataclasses.replace(sj.paper_scene(), speed=DIP)


@jax.jit
def judged(steps, begin):
    return with_resolution(int(Status.FINITE), BRAKED, steps, begin)


@pytest.mark.parametrize(
    ("begin", "steps", "code"),
    [
        (0, [40] * 100, Status.FINITE),  # far from the slow place
        (0, [40] * 102, Status.TOO_FEW_STEPS),
        (102, [320], Status.FINITE),
        (102, [40], Status.TOO_FEW_STEPS),
        (101, [320] * 3, Status.FINITE),
        (99, [40, 320, 320, 320, 320, 40], Status.FINITE),  # as of adaptive steps: each period has its own
        (99, [320, 320, 320, 40, 320, 320], Status.TOO_FEW_STEPS),
        (105, [40] * 100, Status.FINITE),  # behind it
        (0, [40] * 200, Status.TOO_FEW_STEPS),  # fast at both ends
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_steps_are_judged_where_they_are(begin, steps, code):
    # in one program, with room for 200 periods
    room = np.append(np.array(steps, float), np.full(200 - len(steps), np.inf))
    assert int(judged(room, float(begin))) == code


@pytest.mark.full
@pytest.mark.parametrize(
    ("begin", "periods", "code"),
    [
        (784.0, 3, Status.FINITE),  # a program of four periods, the last of which is slower
        (784.0, 4, Status.TOO_FEW_STEPS),
        (848.0, 3, Status.FINITE),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_runs_are_judged_over_their_stretch_alone(begin, periods, code):
    run = sj.simulate(BRAKED, periods, begin=begin, steps_per_period=40, loads=False)
    assert int(run.status) == code
    by_default = sj.simulate(BRAKED, periods, begin=begin, loads=False)
    slowest = DIP.at(np.linspace(begin, begin + 8.0 * periods, 1001)).min()
    assert by_default.steps_per_period == sj.model.default_steps_per_period(sj.paper_scene(speed=slowest))
    assert int(by_default.status) == Status.FINITE


class GivesUp(sj.solvers.Latching):
    """Euler's method, whose step fails from some time on."""

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        *found, _ = super().step(terms, t0, t1, y0, args, solver_state, made_jump)
        lost = diffrax.RESULTS.nonlinear_max_steps_reached
        return *found, diffrax.RESULTS.where(t1 > 0.99, lost, diffrax.RESULTS.successful)


@pytest.mark.full
@pytest.mark.parametrize("saves", [1, 50])
def test_a_solver_that_gives_up_is_seen_in_its_last_period_too(saves):
    plain = sj.paper_scene()
    scene = sj.Scene(plain.speed, plain.slipper, plain.section, sj.model.StraightTrack(), sj.model.HertzSpring(1e8))
    options = dict(steps_per_period=50, saves_per_period=saves, loads=False)
    found = sj.simulate(scene, 1, solver=GivesUp(diffrax.Euler()), **options)
    assert int(found.status) == Status.NOT_FINITE
    assert np.isnan(found.state.motion.v_y[-1])
