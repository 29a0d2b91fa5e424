"""Plans: each case's own steps, in chunks that change no result."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.record import History, RecordSet
from slipperjax.sweeps.call import Call, make_plan
from slipperjax.sweeps.grid import Grid, batch_size
from slipperjax.sweeps.schedule import joint_profiles


def plan_of(grid, steps=None, *, scene=None, **options):
    call = Call(25, 100, steps_per_period=steps, **options)
    return make_plan(Grid(scene or sj.paper_scene(), grid), sj.table_2_start(), call, RecordSet((History(),)))


def test_each_case_gets_the_steps_that_it_needs_alone_and_few_numbers_of_steps_serve_all():
    speeds = np.linspace(100, 2500, 25)
    steps = plan_of({"speed": speeds}).steps
    assert steps.tolist() == [sj.model.default_steps_per_period(sj.paper_scene(speed=v)) for v in speeds]
    assert steps.max() == 160
    assert len(set(steps)) <= 5
    assert plan_of({"start_v_y": [0.5, -0.5]}).steps.tolist() == [40, 40]
    # over many orders of stiffness
    steps = plan_of({"stiffness": np.geomspace(1e7, 1e13, 241)}).steps
    assert (steps.min(), steps.max() > 1900) == (40, True)
    assert len(set(steps)) < 24
    assert np.all(np.diff(steps) >= 0)
    assert np.all(steps % 40 == 0)


def test_saves_divide_every_cases_steps_which_may_be_a_list_or_an_array_of_the_grid():
    two, three = {"speed": [400.0, 1250.0]}, {"length": [0.1, 0.2, 0.3]}
    assert plan_of({"speed": [100.0, 1250.0]}, saves_per_period=30).steps.tolist() == [180, 60]
    assert plan_of(two, [200, 100]).steps.tolist() == [200, 100]
    assert plan_of(two, [200, 100]).records == RecordSet((History(50),))
    assert plan_of(two, np.array([60, 90])).records == RecordSet((History(30),))
    assert plan_of(two | three, np.arange(1, 7).reshape(2, 3)).steps.tolist() == [1, 2, 3, 4, 5, 6]


def test_sizes_of_batches_are_few_and_avoid_multiples_of_128():
    sizes = [batch_size(count) for count in range(1, 1025)]
    assert sizes[:129:16] == [8, 24, 40, 56, 80, 96, 112, 124, 160]
    assert sizes[124:128] == [132] * 4
    assert all(batch_size(size) == size >= count for count, size in enumerate(sizes, 1))
    assert not any(size % 128 == 0 for size in sizes)
    assert len(set(sizes)) <= 8 * np.log2(1024)


@pytest.mark.parametrize(("beam", "largest"), [(None, 124), (sj.Beam.crane_rail(), 32)])
def test_chunks_are_smaller_on_rails_that_bend(beam, largest):
    """Their waves fill the cache of a core."""
    scene = dataclasses.replace(sj.paper_scene(), beam=beam)
    chunks, _ = plan_of({"speed": np.linspace(1000, 1100, 241)}, 40, scene=scene).chunks(workers=2)
    assert max(len(chunk.index) for chunk in chunks) == largest


def test_wrong_steps_of_cases_are_refused():
    for steps, saves, words in (
        ([100], None, r"must have one number or one for each case, \(2,\), but has shape \(1,\)"),
        ([[100, 50]], None, r"must have one number or .* but has shape \(1, 2\)"),
        ([100, 90], 50, "must divide steps_per_period = 90, but is 50"),
    ):
        with pytest.raises(ValueError, match=f"`(steps|saves)_per_period` {words}"):
            sj.sweep(sj.paper_scene(), {"speed": [400.0, 1250.0]}, steps_per_period=steps, saves_per_period=saves)


def test_runs_share_the_larger_number_of_steps_where_that_saves_time():
    # three runs of eight cases, two of them nearly alike
    profiles = np.array([[100, 100], [10, 12], [11, 10]])
    joint, which = joint_profiles(profiles, np.repeat([0, 1, 2], 8))
    assert joint.tolist() == [[11, 12], [100, 100]]
    assert which.tolist() == [1] * 8 + [0] * 16
    # of single cases each would fill a batch of eight lanes with copies
    joint, _ = joint_profiles(profiles, np.arange(3))
    assert joint.tolist() == [[100, 100]]
