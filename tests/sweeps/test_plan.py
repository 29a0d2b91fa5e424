"""Plans: each case's own steps, in chunks that change no result."""

import diffrax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.record import History, RecordSet
from slipperjax.flow.stepping import ROOM, calls_of
from slipperjax.sweeps.call import Call
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.plan import make_plan
from slipperjax.sweeps.schedule import Schedule, Span, joint_profiles

HISTORY = RecordSet((History(),))


def plan_of(grid, **options):
    scene = sj.paper_scene()
    records, options = options.pop("records", RecordSet()), dict(settled=25, measured=100) | options
    return make_plan(Grid(scene, grid), sj.table_2_start(), Call(**options), records)


def test_each_case_gets_the_steps_that_it_needs_alone():
    speeds = np.linspace(100, 2500, 25)
    plan = plan_of({"speed": speeds})
    alone = [sj.model.default_steps_per_period(sj.paper_scene(speed=v)) for v in speeds]
    assert plan.steps.tolist() == alone
    assert plan.steps.max() == 160
    assert len(set(alone)) <= 5
    assert plan_of({"speed": speeds}, steps_per_period=70).steps.tolist() == [70] * 25
    assert plan_of({"start_v_y": [0.5, -0.5]}).steps.tolist() == [40, 40]


def test_step_counts_are_few_over_many_orders_of_stiffness():
    steps = plan_of({"stiffness": np.geomspace(1e7, 1e13, 241)}).steps
    assert steps.min() == 40
    assert steps.max() > 1900
    assert len(set(steps)) < 24
    assert np.all(np.diff(steps) >= 0)
    assert np.all(steps % 40 == 0)


def test_saves_divide_every_cases_steps_which_may_stand_in_a_list_or_in_the_grid():
    two, three = {"speed": [400.0, 1250.0]}, {"length": [0.1, 0.2, 0.3]}
    plan = lambda grid, steps=None, **options: plan_of(grid, steps_per_period=steps, records=HISTORY, **options)
    assert plan({"speed": [100.0, 1250.0]}, saves_per_period=30).steps.tolist() == [180, 60]
    assert plan(two, [200, 100]).steps.tolist() == [200, 100]
    assert plan(two, [200, 100]).records == RecordSet((History(50),))
    assert plan(two, np.array([60, 90])).records == RecordSet((History(30),))
    assert plan(two | three, np.arange(1, 7).reshape(2, 3)).steps.tolist() == [1, 2, 3, 4, 5, 6]


def test_wrong_steps_of_cases_are_refused():
    for steps, saves, words in (
        ([100], None, r"must have one number or one for each case, \(2,\), but has shape \(1,\)"),
        ([[100, 50]], None, r"must have one number or .* but has shape \(1, 2\)"),
        ([100, 90], 50, "must divide steps_per_period = 90, but is 50"),
    ):
        with pytest.raises(ValueError, match=f"`(steps|saves)_per_period` {words}"):
            sj.sweep(sj.paper_scene(), {"speed": [400.0, 1250.0]}, steps_per_period=steps, saves_per_period=saves)


def test_chunks_hold_every_case_once_with_its_own_steps():
    plan = plan_of({"speed": np.linspace(100, 2500, 53)})
    for how in ((None, None), (None, 1), (5, 2), (64, 3)):
        chunks, threads = plan.chunks(*how)
        assert sorted(np.concatenate([c.index[: c.cases] for c in chunks])) == list(range(53))
        assert len({len(c.index) for c in chunks}) == 1  # one compiled program
        assert len(chunks[0].index) % 8 == 0
        assert all(np.all(plan.steps[c.index] == c.schedule.steps) for c in chunks)
        steps = [c.schedule.steps for c in chunks]
        assert steps == sorted(steps, reverse=True)
        assert threads == min(len(chunks), threads)


def test_calls_make_up_each_span():
    plan = plan_of({"speed": [1250.0]})
    assert (plan.settled, plan.recorded, plan.periods) == (25, 100, 125)
    # no period is left out, and none is added, of a prime number either
    for periods in (0, 3, 40, 997):
        calls = calls_of(periods)
        assert sum(calls) == periods
        assert max(calls, default=0) <= ROOM
    assert plan_of({"speed": [1250.0]}, solver=diffrax.Kvaerno3()).chunks(8, 2)[1] == 1


def test_programs_serve_steps_that_differ_eightfold():
    inside = RecordSet((History(),))
    steps = plan_of({"speed": [100.0, 1250.0]}, steps_per_period=[400, 40], records=inside, measured=1000)
    assert [steps.stepping(number, inside).most for number in (400, 40)] == [400, 50]
    # one number of steps is part of the program, and a few periods take a larger program
    assert plan_of({"speed": [1250.0]}, steps_per_period=40, records=inside).stepping(40, inside).steps is None
    few = plan_of({"speed": [100.0, 1250.0]}, steps_per_period=[400, 40], records=inside, measured=2)
    assert few.stepping(40, inside).most == 400


def test_schedules_of_runs_have_stretches_of_equal_steps():
    schedule = Schedule.of_profile(np.array([10, 10, 20, 20, 20]), 3, [1], 4)
    first, second = schedule.stretches
    assert first == (Span(2, 10), Span(1, 20))
    assert second == (Span(2, 20, probed=4),)
    assert (schedule.periods, schedule.work, schedule.profile) == (5, 80, [10, 10, 20, 20, 20])
    # of a probe beyond the end the last steps go on
    assert schedule.following(1, 4) == [(20, 1), (20, 2), (20, 1)]


def test_profiles_are_joined_where_that_saves_time():
    # three runs of eight cases, two of them nearly alike
    profiles = np.array([[100, 100], [10, 12], [11, 10]])
    joint, which = joint_profiles(profiles, np.repeat([0, 1, 2], 8))
    assert joint.tolist() == [[11, 12], [100, 100]]
    assert which.tolist() == [1] * 8 + [0] * 16
    # of single cases each would fill a batch of eight lanes with copies
    joint, which = joint_profiles(profiles, np.arange(3))
    assert joint.tolist() == [[100, 100]]
