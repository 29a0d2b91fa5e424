"""Records inside programs: joined periods, extremes of curves, percentiles, several at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import slipperjax as sj
from slipperjax.flow.course import Loads, over_periods
from slipperjax.flow.numbers import ALIASES, RECORDS, Record
from slipperjax.flow.period_map import PeriodMap
from slipperjax.flow.record import PoincareSections, RecordedSpan, RecordSet, Samples, Strobe
from slipperjax.flow.status import Status
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.model.layout import coordinate_rows
from slipperjax.model.quantities import COORDINATES, Quantity
from slipperjax.sweeps.windows import PEAK_DISTANCE

from ..common import STEPS, fine, growth
from .made_up import made_up_course

PERIODS, EPOCH = 3, 5.0
SPEEDS = (1000.0, 1250.0)


def velocity(over, rest):
    """The lateral velocity at the ends of steps, joined within a period and over periods."""
    within = getattr(jnp, "sum" if over == "mean" else over)
    function = lambda c: within(c.counted(c.coordinates.values[1:, 5], rest))
    return Record(Quantity(over, "m/s", "lateral velocity"), function, over)


WAYS = {"max": -jnp.inf, "min": jnp.inf, "sum": 0.0, "mean": 0.0}
SEVERAL = RecordSet(
    (
        *(velocity(over, rest) for over, rest in WAYS.items()),
        RECORDS["peak_force"],
        *(RECORDS[name] for name in ALIASES["extremes"]),
    )
)


@pytest.fixture(scope="module")
def carried():
    """The carries of several records by name, by speed."""

    @sj.jit
    def run(speed):
        scene = sj.paper_scene(speed)
        state = sj.initial_state(scene, sj.table_2_start())
        # room for more steps and periods than there are
        stepping = ConstantSteps(STEPS + 20, jnp.asarray(float(STEPS)))
        options = dict(periods=PERIODS + 1, records=SEVERAL, used=PERIODS)
        return PeriodMap(scene, stepping).run(state, EPOCH, **options).carried

    names = [record.name for record in SEVERAL.records]
    return {v: dict(zip(names, map(np.asarray, run(v)), strict=True)) for v in SPEEDS}


@sj.jit
def coordinates_and_slopes(scene, periods, states):
    """Of saved states: the ten coordinates, and their derivatives by the vector field [per forcing period]."""

    def one(period, state):
        rates = sj.model.vector_field(scene).evaluate(0.0, state, sj.model.Args(scene, period)).motion
        return jax.jvp(lambda m: coordinate_rows(sj.State(m, None)), (state.motion,), (rates,))

    return jax.vmap(one)(periods, states)


@pytest.mark.parametrize("speed", SPEEDS)
def test_functions_of_a_course_are_joined_over_all_periods(carried, speed):
    seen = np.asarray(fine(sj.paper_scene(speed)).state.motion.v_y)[1 : PERIODS * STEPS + 1]
    for over in WAYS:
        exact = seen.sum() if over == "mean" else getattr(seen, over)()  # divided by the periods at the end
        np.testing.assert_allclose(carried[speed][over], exact, rtol=1e-10, err_msg=over)  # measured 1e-13


@pytest.mark.full
def test_loads_and_extremes_see_what_lies_between_the_steps(carried):
    found, run = carried[SPEEDS[0]], fine(sj.paper_scene(SPEEDS[0]))
    contact = np.asarray(run.reactions.contact_force)[1 : PERIODS * STEPS + 1].max(axis=0)
    assert np.all(found["peak_force"] >= contact)
    assert np.any(found["peak_force"] > 1.00001 * contact)
    # the extremes of the cubics through the ends of the steps, where the slope changes its sign
    values, slopes = (np.asarray(a) for a in coordinates_and_slopes(run.scene, run.period, run.state))
    upto = slice(PERIODS * STEPS + 1)
    for k, name in enumerate(COORDINATES):
        ends, value, slope = run.period[upto], values[upto, k], slopes[upto, k]
        curve = CubicHermiteSpline(ends, value, slope)
        turns = curve.derivative().roots(discontinuity=False, extrapolate=False)
        turns = turns[(turns > ends[0]) & (turns < ends[-1])]  # without NaN
        step = np.searchsorted(ends, turns) - 1
        seen = np.append(value, curve(turns[slope[step] * slope[step + 1] < 0]))
        both = found[f"largest_{name}"], found[f"smallest_{name}"]
        np.testing.assert_allclose(both, (seen.max(), seen.min()), rtol=1e-10, err_msg=name)


def span(periods, steps, cases=1):
    return RecordedSpan(periods, steps, 0.0, np.zeros(cases, int))


def test_crossings_beyond_the_capacity_are_counted_and_flagged():
    """Three crossings in a period, of which two are kept."""
    record = PoincareSections(2)
    time = np.full((5, 64), np.nan)
    time[:, [5, 20, 40]] = [0.1, 0.3, 0.6]
    course = made_up_course(64, crossings=(jnp.asarray(time), jnp.asarray(10 * time)))
    found, carried = jax.jit(
        lambda: (record.sample(course), record.add(record.begin(sj.paper_scene(), None), course))
    )()
    np.testing.assert_array_equal(found.time[0], [0.1, 0.3])
    np.testing.assert_array_equal(found.velocity[4], [1.0, 3.0])
    assert found.count.tolist() == [3] * 5
    status = record.judge(np.array([int(carried), 2]), np.zeros(2, int), None, None)
    assert status.tolist() == [Status.POINTS_DROPPED, 0]


AT_PEAK = {"peak_period": (RECORDS["peak_period"], 1.0), "peak_distance": (PEAK_DISTANCE, 8.0)}


@pytest.mark.parametrize(("record", "per_period"), AT_PEAK.values(), ids=AT_PEAK)
def test_what_is_told_of_a_peak_is_of_the_highest_of_all_periods(record, per_period):
    """Of points whose force is highest in the first, the second and the last of three periods, equal, and zero."""
    forces = np.array([[5.0, 2.0, 1.0, 4.0, 0.0], [1.0, 6.0, 2.0, 4.0, 0.0], [3.0, 5.0, 7.0, 4.0, 0.0]])
    when = np.where(forces > 0, EPOCH + np.arange(3.0)[:, None] + np.linspace(0.1, 0.9, 5), np.nan)
    loads = over_periods(Loads(*[jnp.zeros((1, 2, 5))] * 5, *[jnp.zeros(1)] * 2))
    carried = jnp.zeros((2, 5)), jnp.full((2, 5), jnp.nan)
    for force, instant in zip(forces, when, strict=True):
        course = made_up_course()
        both = (jnp.broadcast_to(row, (2, 5)) for row in (force, instant))
        course.loads = loads._replace(**dict(zip(("peak_force", "peak_period"), both, strict=True)))
        carried = record.add(carried, course)
    wanted = per_period * when[[0, 1, 2, 0, 0], np.arange(5)]
    found = record.finish(jax.tree.map(lambda a: np.asarray(a)[None], carried), None, span(3, STEPS))
    np.testing.assert_allclose(found, np.broadcast_to(wanted, (1, 2, 5)), rtol=1e-14)


@pytest.mark.full
def test_a_sweep_tells_where_its_highest_forces_were():
    grid = {"speed": [1250.0, 2100.0]}
    record = ["peak_force", "peak_period", PEAK_DISTANCE]
    ds = sj.sweep(sj.paper_scene(), grid, record=record, transient=2, periods=6, steps_per_period=STEPS)
    np.testing.assert_allclose(ds["peak_distance"], 8.0 * ds["peak_period"], rtol=1e-12)
    assert ds["peak_distance"].attrs["units"] == "m"


@pytest.mark.parametrize("from_start", [False, True])
def test_samples_of_twice_as_many_calls_are_twice_the_work(from_start):
    records = RecordSet((Strobe(from_start),))

    def of_calls(count):
        samples = Samples(records, 3 * count // 2)
        for call in range(count):
            samples.add(records, (np.full((2, 3, 10), float(call)),))
        return samples

    # the last half of the calls, or all
    (kept,) = of_calls(40).joined()
    expected = np.repeat(np.arange(0 if from_start else 20, 40), 3)
    np.testing.assert_array_equal(kept[1, :, 0], expected)
    # measured 2.00
    assert growth(lambda count: of_calls(count).joined(), 100) < 2.2
