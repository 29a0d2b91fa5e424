"""Reducers inside programs: functions of instants, extremes of curves, several at once, under jit and vmap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.course import Courses
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.reducers import Extremes, PointLoad, Reduced
from slipperjax.flow.reducing import Combined
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.quantities import COORDINATES

PERIODS, STEPS = 3, 50
SPEEDS = np.array([1000.0, 1250.0])


def force(t, state, args):
    return sj.reactions(t, state, args).drive_force


def forces(t, state, args):
    return sj.reactions(t, state, args).contact_force


WAYS = ("max", "min", "sum", "mean")
COMBINED = Combined(
    (
        *(Reduced(force, name=over, units="N", over=over) for over in WAYS),
        Reduced(forces, name="forces", units="N"),
        Reduced(lambda t, state, args: t + args.epoch, name="latest"),
        PointLoad("peak_force"),
        Extremes(),
    )
)


def started(speed):
    scene = sj.paper_scene(speed)
    return scene, sj.initial_state(scene, sj.table_2_start())


@pytest.fixture(scope="module")
def carried():
    """What is carried through the periods, of both speeds in one batch."""

    @sj.jit
    @jax.vmap
    def run(speed):
        scene, state = started(speed)
        # room for more steps and periods than there are
        stepping = ConstantSteps(STEPS + 20, jnp.asarray(float(STEPS)))
        options = dict(periods=PERIODS + 1, recorder=COMBINED, used=PERIODS)
        return PeriodMap(scene, stepping).run(state, 5.0, **options).carried

    return jax.tree.map(np.asarray, run(jnp.asarray(SPEEDS)))


@pytest.fixture(scope="module")
def curves():
    """The values at the ends of steps and the greatest and least coordinates between, of the first speed."""
    functions = (
        lambda course: course.drive_force.values[1:],
        lambda course: course.force.values[1:],
        lambda course: course.greatest(course.coordinates),
        lambda course: course.least(course.coordinates),
    )
    scene, state = started(SPEEDS[0])
    run = lambda: PeriodMap(scene, STEPS).run(state, 5.0, periods=PERIODS, recorder=Courses(functions)).record
    return jax.tree.map(np.asarray, sj.jit(run)())


def test_functions_of_an_instant_are_reduced_over_all_steps(carried, curves):
    drive, contact = (a.reshape(-1, *a.shape[2:]) for a in curves[:2])
    of_each = dict(zip([r.name for r in COMBINED.reducers], carried.each, strict=True))
    for over in WAYS:
        exact = drive.sum() if over == "mean" else getattr(drive, over)()  # divided by the steps at the end
        np.testing.assert_allclose(of_each[over][0], exact, rtol=1e-10, err_msg=over)  # measured 1e-13
    np.testing.assert_allclose(of_each["forces"][0], contact.max(axis=0), rtol=1e-10)
    # time counts from the start of the run, and steps that there is only room for are left out
    assert of_each["latest"].tolist() == [5.0 + PERIODS, 5.0 + PERIODS]


def test_loads_and_extremes_see_what_lies_between_the_steps(carried, curves):
    _, contact, greatest, least = curves
    # measured 1e-14
    np.testing.assert_allclose(carried.each[-1][0], [greatest.max(axis=0), -least.min(axis=0)], rtol=1e-10)
    assert carried.each[-1].shape == (2, 2, len(COORDINATES))
    assert carried.each[-2] is None
    assert np.all(carried.loads.peak_force[0] >= contact.max(axis=(0, 1)))
    assert np.any(carried.loads.peak_force[0] > 1.001 * contact.max(axis=(0, 1)))


def test_equal_ones_share_a_program():
    again = Combined(tuple(Reduced(force, name=over, units="N", over=over) for over in WAYS))
    assert again == Combined(COMBINED.reducers[:4])
    assert hash(again) == hash(Combined(COMBINED.reducers[:4]))
    assert again != Combined(COMBINED.reducers[:3])
