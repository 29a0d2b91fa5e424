"""The model's runs beside a record: windows, derivatives against finer steps, and shooting."""

import dataclasses

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.fitting.course import SIZES, Model, Windows
from slipperjax.fitting.measured import measured_runs
from slipperjax.fitting.method import Problem, unknowns_of
from slipperjax.model.sensors import Rig

from .records import record

SCENE = sj.paper_scene(1250.0)
SENSORS = [sj.model.Sensor("az"), sj.model.Sensor("ay", direction="y", place=(0.05, 0.0, 0.0), delay=2e-5)]
PRIORS = {"stiffness": (3e7, 3e8), "restitution": (0.5, 0.99), "sensors.ay.gain": (0.5, 1.5)}


@pytest.fixture(scope="module")
def clean():
    return record(SCENE, SENSORS, 4)


def problem_of(measured, *, solver=None, steps=None) -> Problem:
    rig = Rig.of(SENSORS)
    return Problem(
        scene=SCENE,
        rig=rig,
        unknowns=unknowns_of(SCENE, rig, PRIORS),
        runs=measured_runs(measured, rig),
        origin=0.0,
        lead=1,
        steps=steps,
        solver=sj.solvers.RK4() if solver is None else solver,
        start=sj.table_2_start(),
        seed=0,
    )


def model_of(problem: Problem, window=None) -> Model:
    return Model.of(problem, Windows.of(problem.runs, problem.scenes, problem.origin, window))


@pytest.mark.full
def test_windows_share_out_all_samples(clean):
    problem = problem_of([clean, clean.isel(time=slice(None, None, 3))])
    whole = Windows.of(problem.runs, problem.scenes, 0.0, None)
    assert (whole.count, whole.periods) == (2, 4)
    assert whole.known.sum(axis=(1, 2)).tolist() == [240, 80]
    cut = Windows.of(problem.runs, problem.scenes, 0.0, 3)
    assert cut.run.tolist() == [0, 0, 1, 1]
    assert cut.lag.tolist() == [0, 3, 0, 3]
    assert cut.known.sum(axis=(1, 2)).tolist() == [180, 60, 60, 20]
    period = float(SCENE.period)
    at = cut.time[1][cut.known[1] > 0]
    np.testing.assert_allclose([at.min(), at.max()], [3 * period, 4 * period - period / 30])


@pytest.mark.full
def test_a_guess_is_the_motion_of_the_record(clean):
    problem = problem_of(clean)
    model = model_of(problem)
    noise = np.array([10.0, 10.0])
    guess, far = model.guesses(problem.own[None], 150, noise)
    reading = model.course(problem.own[None], guess).reading[0]
    # 0.8 and 1.0 % of the signals with default steps of RK4, beside 160 of ImpulseRK4
    for k, name in enumerate(("az", "ay")):
        left = reading[0, k] - clean[name].values
        assert left.std() < 0.03 * clean[name].values.std()
    assert np.isfinite(far).all()


@pytest.mark.full
def test_derivatives_are_those_of_a_finer_run(clean):
    # by differences of runs of `simulate` with ten times the steps, of another solver
    problem = dataclasses.replace(problem_of(clean), lead=0)
    model = model_of(problem)
    levels = problem.own[None]
    guess, _ = model.guesses(levels, 150, np.array([10.0, 10.0]))
    course = model.with_samples(160).course(levels, guess)

    def read(values, numbers):
        scene = SCENE.replace(stiffness=values[0], restitution=values[1])
        sensors = [SENSORS[0], dataclasses.replace(SENSORS[1], gain=values[2])]
        start = sj.Motion(*(numbers * SIZES))
        ds = record(scene, sensors, 4, steps=400, settled=0, start=start)
        return np.stack([ds["az"].values, ds["ay"].values])

    values, numbers = problem.values(levels[0]), guess[0, 0]
    steps = {0: 1e-4 * values[0], 1: 1e-4, 2: 1e-4, 3: 1e-3, 4: 1e-3, 7: 1e-3, 9: 1e-3, 12: 1e-3}
    for k, step in steps.items():
        change = step * np.eye(13)[k]
        both = [read(values + sign * change[:3], numbers + sign * change[3:]) for sign in (1, -1)]
        difference = (both[0] - both[1]) / (2 * step)
        error = course.slope[0, 0, ..., k] - difference
        # 0.006 to 0.012 with 160 instants a period, 0.022 to 0.034 with 40: cubics pass over kinks at touchdowns
        assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(difference**2)), k


@pytest.mark.full
def test_windows_end_where_the_next_ones_begin(clean):
    problem = problem_of(clean)
    whole = model_of(problem)
    levels = problem.own[None]
    guess, _ = whole.guesses(levels, 150, np.array([10.0, 10.0]))
    end = whole.course(levels, guess).end[0, 0]
    halves = model_of(problem, 2)
    first = halves.course(levels, np.repeat(guess, 2, axis=1)).end[:, :1]
    second = halves.course(levels, np.concatenate([guess, first], axis=1))
    # memory of contacts that are closed there begins anew: 4e-3 scales
    np.testing.assert_allclose(second.end[0, 1], end, atol=0.05)
