"""The model's runs beside a record: windows, derivatives against finer steps, and shooting."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.fitting.course import SIZES, Model, Windows
from slipperjax.fitting.measured import measured_runs
from slipperjax.fitting.method import Problem, unknowns_of
from slipperjax.model.layout import StateLayout
from slipperjax.model.sensors import Rig

from .records import record

SCENE = sj.paper_scene(1250.0)
SENSORS = [sj.model.Sensor("az"), sj.model.Sensor("ay", direction="y", place=(0.05, 0.0, 0.0), delay=2e-5)]
PRIORS = {"stiffness": (3e7, 3e8), "restitution": (0.5, 0.99), "sensors.ay.gain": (0.5, 1.5)}
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def clean():
    return record(SCENE, SENSORS, 4)


def problem_of(measured, lead=1) -> Problem:
    rig = Rig.of(SENSORS)
    how = dict(unknowns=unknowns_of(SCENE, rig, PRIORS), runs=measured_runs(measured, rig), solver=sj.solvers.RK4())
    return Problem(scene=SCENE, rig=rig, origin=0.0, lead=lead, steps=None, start=sj.table_2_start(), seed=0, **how)


def guessed(problem, window=None) -> tuple[Model, np.ndarray]:
    """The model with the user's values, and its motion that is most like the record, as a point of the search."""
    model = Model.of(problem, Windows.of(problem, window))
    guess, far = model.guesses(problem.own[None], 150, np.array([10.0, 10.0]))
    assert np.isfinite(far).all()
    return model, np.hstack([problem.own[None], guess.reshape(1, -1)])


def test_windows_share_out_all_samples(clean):
    problem = problem_of([clean, clean.isel(time=slice(None, None, 3))])
    whole, cut = Windows.of(problem), Windows.of(problem, 3)
    assert (whole.count, whole.periods) == (2, 4)
    assert whole.known.sum(axis=(1, 2)).tolist() == [240, 80]
    assert (cut.run.tolist(), cut.lag.tolist()) == ([0, 0, 1, 1], [0, 3, 0, 3])
    assert cut.known.sum(axis=(1, 2)).tolist() == [180, 60, 60, 20]
    period = float(SCENE.period)
    at = cut.time[1][cut.known[1] > 0]
    np.testing.assert_allclose([at.min(), at.max()], [3 * period, 4 * period - period / 30])


def test_a_guess_is_the_motion_of_the_record_and_windows_end_where_the_next_ones_begin(clean):
    problem = problem_of(clean)
    model, point = guessed(problem)
    course = model.course(point)
    # 0.8 and 1.0 % of the signals with default steps of RK4, beside 160 of ImpulseRK4
    for reading, name in zip(course.reading[0, 0], ("az", "ay"), strict=True):
        assert (reading - clean[name].values).std() < 0.03 * clean[name].values.std()
    halves = Model.of(problem, Windows.of(problem, 2))
    levels, start = point[:, :3], point[:, 3:]
    first = halves.course(np.hstack([levels, start, start]))
    # with the memory of contacts that are closed there
    second = halves.course(np.hstack([levels, start, first.end[:, 0]]), halves.carried(first.last[:, [0, 0]]))
    np.testing.assert_allclose(second.end[0, 1], course.end[0, 0], atol=1e-9)


def test_derivatives_are_those_of_a_finer_run(clean):
    # by differences of runs of `simulate` with ten times the steps, of another solver
    problem = problem_of(clean, lead=0)
    model, point = guessed(problem)
    course = model.with_samples(160).course(point)

    def read(values, numbers):
        scene = SCENE.replace(stiffness=values[0], restitution=values[1])
        sensors = [SENSORS[0], dataclasses.replace(SENSORS[1], gain=values[2])]
        ds = record(scene, sensors, 4, steps=400, settled=0, start=sj.Motion(*(numbers * SIZES)))
        return np.stack([ds["az"].values, ds["ay"].values])

    values, numbers = problem.values(point[0, :3]), point[0, 3:]
    steps = {0: 1e-4 * values[0], 1: 1e-4, 2: 1e-4, 3: 1e-3, 4: 1e-3, 7: 1e-3, 9: 1e-3, 12: 1e-3}
    for k, step in steps.items():
        change = step * np.eye(13)[k]
        both = [read(values + sign * change[:3], numbers + sign * change[3:]) for sign in (1, -1)]
        difference = (both[0] - both[1]) / (2 * step)
        error = course.slope[0, 0, ..., k] - difference
        # 0.006 to 0.012 with 160 instants a period, 0.022 to 0.034 with 40: cubics pass over kinks at touchdowns
        assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(difference**2)), k


def test_a_run_that_begins_at_rest_rests_on_the_rail(clean):
    scene = dataclasses.replace(SCENE, gravity=9.81)
    problem = dataclasses.replace(problem_of(clean, lead=0), scene=scene, start=sj.AtRest())
    begun = Model.of(problem, Windows.of(problem)).begun(problem.own[None])[0, 0]
    rest = StateLayout.pack(sj.initial_state(scene, sj.AtRest()))
    # half a millimetre of play below the middle
    assert rest[1] < -4e-4
    np.testing.assert_allclose(begun, rest, rtol=1e-9, atol=1e-12)


def test_a_start_has_the_parts_and_the_memory_with_which_its_run_begins(clean):
    payload = sj.model.Payload(mass=4.0, stiffness=[1e6, 1e6])
    scene = dataclasses.replace(SCENE, payload=payload)
    state = sj.initial_state(scene, sj.Motion(z=-6e-4, v_z=0.2, payload=sj.model.PayloadMotion(z=-7e-4, v_y=0.1)))
    problem = dataclasses.replace(problem_of(clean), scene=scene, start=state)
    model = Model.of(problem, Windows.of(problem))
    row = StateLayout.pack(state)
    # of closed contacts
    assert row[-scene.points :].any()
    known = model.carried(row[None, None])[0, 0]
    numbers = 2 * row[:10] / SIZES
    np.testing.assert_allclose(StateLayout.pack(model.start(numbers, known)), [*2 * row[:10], *row[10:]], rtol=1e-14)
    # where closed contacts begin anew
    motion = model.start(numbers, np.full_like(row, np.nan))
    np.testing.assert_allclose(StateLayout.pack(sj.State(motion, None)), [*2 * row[:10], *row[10:14]], rtol=1e-14)
