"""Reducers inside programs: functions of instants, extremes of curves, several at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.recorders import stacked
from slipperjax.flow.reducers import Extremes, PointLoad, Reduced
from slipperjax.flow.reducing import Combined
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.quantities import COORDINATES

from ..common import STEPS, fine

PERIODS, EPOCH = 3, 5.0
SPEEDS = (1000.0, 1250.0)


def velocity(t, state, args):
    return state.motion.v_y


def forces(t, state, args):
    return sj.reactions(t, state, args).contact_force


WAYS = ("max", "min", "sum", "mean")
COMBINED = Combined(
    (
        *(Reduced(velocity, name=over, units="m/s", over=over) for over in WAYS),
        Reduced(forces, name="forces", units="N"),
        Reduced(lambda t, state, args: t + args.epoch, name="latest"),
        PointLoad("peak_force"),
        Extremes(),
    )
)


@pytest.fixture(scope="module")
def carried():
    """What is carried through the periods, by speed."""

    @sj.jit
    def run(speed):
        scene = sj.paper_scene(speed)
        state = sj.initial_state(scene, sj.table_2_start())
        # room for more steps and periods than there are
        stepping = ConstantSteps(STEPS + 20, jnp.asarray(float(STEPS)))
        options = dict(periods=PERIODS + 1, recorder=COMBINED, used=PERIODS)
        return PeriodMap(scene, stepping).run(state, EPOCH, **options).carried

    return {speed: jax.tree.map(np.asarray, run(speed)) for speed in SPEEDS}


@sj.jit
def coordinates_and_slopes(scene, periods, states):
    """Of saved states: the ten coordinates, and their derivatives by the vector field [per forcing period]."""

    def one(period, state):
        rates = sj.vector_field(scene)(0.0, state, sj.Args(scene, period)).motion
        return jax.jvp(lambda m: stacked(sj.State(m, None)), (state.motion,), (rates,))

    return jax.vmap(one)(periods, states)


@pytest.mark.parametrize("speed", SPEEDS)
def test_functions_of_an_instant_are_reduced_over_all_steps(carried, speed):
    run, last = fine(sj.paper_scene(speed)), PERIODS * STEPS
    of_each = dict(zip([r.name for r in COMBINED.reducers], carried[speed].each, strict=True))
    seen = np.asarray(run.state.motion.v_y)[1 : last + 1]
    for over in WAYS:
        exact = seen.sum() if over == "mean" else getattr(seen, over)()  # divided by the steps at the end
        np.testing.assert_allclose(of_each[over], exact, rtol=1e-10, err_msg=over)  # measured 1e-13
    contact = np.asarray(run.reactions.contact_force)[1 : last + 1]
    np.testing.assert_allclose(of_each["forces"], contact.max(axis=0), rtol=1e-10)
    # time counts from the start of the run, and steps that there is only room for are left out
    assert of_each["latest"] == EPOCH + PERIODS


def test_loads_and_extremes_see_what_lies_between_the_steps(carried):
    found, run = carried[SPEEDS[0]], fine(sj.paper_scene(SPEEDS[0]))
    assert found.each[-2] is None
    contact = np.asarray(run.reactions.contact_force)[1 : PERIODS * STEPS + 1].max(axis=0)
    assert np.all(found.loads.peak_force >= contact)
    assert np.any(found.loads.peak_force > 1.00001 * contact)
    # the extremes of the cubics through the ends of the steps, where the slope changes its sign
    assert found.each[-1].shape == (2, len(COORDINATES))
    values, slopes = (np.asarray(a) for a in coordinates_and_slopes(run.scene, run.period, run.state))
    upto = slice(PERIODS * STEPS + 1)
    for k, name in enumerate(COORDINATES):
        ends, value, slope = run.period[upto], values[upto, k], slopes[upto, k]
        curve = CubicHermiteSpline(ends, value, slope)
        turns = curve.derivative().roots(discontinuity=False, extrapolate=False)
        turns = turns[(turns > ends[0]) & (turns < ends[-1])]  # without NaN
        step = np.searchsorted(ends, turns) - 1
        seen = np.append(value, curve(turns[slope[step] * slope[step + 1] < 0]))
        np.testing.assert_allclose(found.each[-1][:, k], (seen.max(), -seen.min()), rtol=1e-10, err_msg=name)


def test_equal_ones_share_a_program():
    again = Combined(tuple(Reduced(velocity, name=over, units="m/s", over=over) for over in WAYS))
    assert again == Combined(COMBINED.reducers[:4])
    assert hash(again) == hash(Combined(COMBINED.reducers[:4]))
    assert again != Combined(COMBINED.reducers[:3])
