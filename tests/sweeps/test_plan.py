"""Plans: each case's own steps, in chunks that change no result."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.record import History, RecordSet
from slipperjax.sweeps.call import Call
from slipperjax.sweeps.grid import Grid
from slipperjax.sweeps.plan import make_plan

HISTORY = RecordSet((History(),))


def plan_of(grid, **options):
    scene = sj.paper_scene()
    records, options = options.pop("records", RecordSet()), dict(settled=25, measured=100) | options
    return make_plan(Grid(scene, grid), sj.table_2_start(), Call(**options), records)


def test_each_case_gets_the_steps_that_it_needs_alone():
    speeds = np.linspace(100, 2500, 25)
    plan = plan_of({"speed": speeds})
    alone = [sj.default_steps_per_period(sj.paper_scene(speed=v)) for v in speeds]
    assert plan.steps.tolist() == alone
    assert plan.most_steps == 160
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
