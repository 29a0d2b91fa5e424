"""Batches: equal to one by one, whatever the order and threads; failing cases apart; labelled results."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.course import over_periods
from slipperjax.flow.status import Status
from slipperjax.model.quantities import COORDINATES

from ..common import columns
from ..families import SPEEDS, STEPS, settling, swept

LOADS = ("peak_force", "impulse", "contact_fraction", "penetration")
OPTIONS = dict(transient=10, periods=10, steps_per_period=STEPS)


@jax.jit
def last_ten(loads):
    """Loads of the last ten of twenty periods."""
    return over_periods(jax.tree.map(lambda a: a[10:], loads))


@pytest.fixture(scope="module")
def several():
    return swept()


def test_batch_equals_one_by_one(several):
    assert several.attrs["settled"] == 10
    assert several["strobe"].dims == ("speed", "strobe_period", "coordinate")
    assert several["peak_force"].dims == ("speed", "end", "point")
    assert several["coordinate"].values.tolist() == list(COORDINATES)
    assert "w_x [rad/s]" in several["strobe"].attrs["long_name"]
    for k in (1, 3):
        case, run = several.isel(speed=k), settling(SPEEDS[k])
        # measured 9e-10: sums are reassociated differently in a batch, and rounding grows at every touchdown
        np.testing.assert_allclose(case["strobe"], columns(run)[550::50], rtol=1e-7, atol=1e-9)
        labels, loads = run.ds, last_ten(run.loads)
        for name in LOADS:
            np.testing.assert_allclose(case[name], getattr(loads, name), rtol=1e-7, atol=1e-12, err_msg=name)
            assert case[name].attrs == labels[name].attrs


def test_threads_and_the_order_of_cases_change_no_bit(several):
    turned = swept(SPEEDS[::-1], workers=1)
    for name in several.data_vars:
        np.testing.assert_array_equal(turned[name].values[::-1], several[name].values, err_msg=name)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")  # on purpose
def test_a_failing_case_is_flagged_and_leaves_the_others_untouched(several):
    # a period of hours in 50 steps: the first contact throws it out of the finite numbers
    with_failure = swept(np.where(SPEEDS == 1100.0, 1e-3, SPEEDS))
    good = SPEEDS != 1100.0
    np.testing.assert_array_equal(with_failure["status"].values, np.where(good, 0, 1))
    np.testing.assert_array_equal(with_failure["strobe"].values[good], several["strobe"].values[good])
    assert "raise steps_per_period" in with_failure["status"].attrs["meaning"]


@pytest.mark.full
def test_sections_are_those_of_a_fine_trajectory():
    """Of a case with half of the steps for which the program has room."""
    options = dict(OPTIONS, transient=0, steps_per_period=[STEPS, 2 * STEPS])
    ds = sj.sweep(sj.paper_scene(), {"speed": [1250.0, 1500.0]}, **options)
    assert ds["v_y"].dims == ("speed", "crossing")
    assert ds["steps_per_period"].values.tolist() == [50, 100]
    assert np.all(ds["status"].values == 0)
    case, one = ds.sel(speed=1250.0), settling()
    np.testing.assert_allclose(case["strobe"].values, columns(one)[50:501:50], rtol=1e-9, atol=1e-11)
    y, v = np.asarray(one.state.motion.y)[:501], np.asarray(one.state.motion.v_y)[:501]
    at = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    found = case["v_y"].values[~np.isnan(case["v_y"].values)]
    assert len(found) == len(at) >= 9
    low, high = np.minimum(v[at], v[at + 1]), np.maximum(v[at], v[at + 1])
    assert np.all((found > low - 1e-2) & (found < high + 1e-2))


@pytest.mark.full
def test_cases_of_several_step_counts_are_those_of_each_alone():
    """Histories, whose program has room for 100 steps; those of test_records take it, too."""
    speeds = [400.0, 1250.0, 450.0]
    options = dict(transient=0, periods=20, saves_per_period=STEPS)
    ds = sj.sweep(sj.paper_scene(), {"speed": speeds}, record="history", **options)
    assert ds["steps_per_period"].values.tolist() == [100, 50, 100]
    options = dict(record="strobe", transient=0, periods=10, steps_per_period=100)
    alone = sj.sweep(sj.paper_scene(), {"speed": speeds}, **options)
    for name in ("y", "roll", "v_y", "w_z"):
        # another order of sums; rounding grows at every touchdown
        found, exact = ds[name].values[::2, 49:100:50], alone["strobe"].sel(coordinate=name).values[::2, :2]
        np.testing.assert_allclose(found, exact, rtol=1e-7, atol=1e-8, err_msg=name)
    one, same = settling().ds.isel(time=slice(1, 101)), ds.isel(speed=1, time=slice(100))
    np.testing.assert_allclose(same["period"].values, one["period"].values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(same["y"].values, one["y"].values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(same["contact_force"].values, one["contact_force"].values, rtol=0, atol=1e-6)
    assert one["contact_force"].dims == ("time", "end", "point")
    assert one["time"].attrs["units"] == "s"


@pytest.mark.full
def test_following_a_branch_starts_each_case_where_its_neighbour_ended():
    speeds = [1240.0, 1250.0, 1260.0]
    ds = sj.follow(sj.paper_scene(), {"speed": speeds}, record="strobe", **OPTIONS)
    assert ds["strobe"].dims == ("direction", "speed", "strobe_period", "coordinate")
    assert ds["steps_per_period"].values.tolist() == [[STEPS] * 3] * 2
    assert np.all(ds["status"].values == 0)
    for direction, order in (("up", speeds), ("down", speeds[::-1])):
        end = None
        for speed in order:  # 20 periods: the transient, and what is recorded
            end = settling(speed, end)
            found = float(ds["strobe"].sel(direction=direction, speed=speed, coordinate="v_y")[-1])
            assert found == pytest.approx(float(end.end.motion.v_y), rel=1e-8), speed  # measured 1e-12


def test_starts_can_be_varied_and_lists_be_read_side_by_side():
    grid = [1250.0, 1500.0], [0.5, -0.5], [1e-4, 2e-4]
    product, listed = (swept(*grid, product=how) for how in (True, False))
    assert product["strobe"].dims == ("speed", "start_v_y", "start_z", "strobe_period", "coordinate")
    assert product["start_z"].attrs["units"] == "m"
    start = sj.Motion(v_y=-0.5, z=1e-4, v_z=0.5, w_x=0.2, w_y=0.3, w_z=0.4)
    y = columns(settling(start=start))[550::50, 0]
    # as of a batch, beside one by one
    np.testing.assert_allclose(product["strobe"].sel(coordinate="y").values[0, 1, 0], y, rtol=1e-7, atol=1e-9)
    assert listed["strobe"].dims == ("case", "strobe_period", "coordinate")
    assert listed["speed"].dims == listed["start_z"].dims == ("case",)
    np.testing.assert_array_equal(listed["strobe"].values, [product["strobe"].values[k, k, k] for k in range(2)])
    with pytest.raises(ValueError, match="lists of one length"):
        swept([1e3, 2e3], product=False)


@pytest.mark.full
def test_sweeps_say_what_half_the_step_changes():
    few, more = (swept(steps_per_period=steps, probe=True) for steps in (25, 100))
    assert np.all((more["probe_error"] > 0) & (more["probe_error"] < 2e-3))  # measured 6e-6 to 5e-4
    assert more["probe_error"].median() < 0.1 * few["probe_error"].median()
    np.testing.assert_array_equal(more["strobe"], swept(steps_per_period=100)["strobe"])
    # by default where it costs a tenth at most, and there is a program for it
    assert "probe_error" in swept(steps_per_period=100, probe=None)
    assert "probe_error" not in swept(steps_per_period=100, transient=0, probe=None)
    assert "probe_error" not in swept(steps_per_period=100)


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_inaccurate_cases_are_marked():
    ds = swept(steps_per_period=7, probe=True)
    wrong = ds["probe_error"].values > 0.1
    assert 0 < wrong.sum() < len(SPEEDS)
    known = ds["status"].isin([Status.FINITE, Status.INACCURATE]).values
    np.testing.assert_array_equal((ds["status"] == Status.INACCURATE).values, wrong & known)


@pytest.mark.full
def test_default_steps_may_be_refined():
    once, twice = (swept(SPEEDS[SPEEDS > 850], steps_per_period=None, refine=k) for k in (1, 2))
    np.testing.assert_array_equal(twice["steps_per_period"], 2 * once["steps_per_period"])


@pytest.mark.parametrize(("steps", "refine", "words"), [(None, 0, "1 or more"), (50, 2, "be 1 where steps_per_p")])
def test_refinements_that_cannot_be_are_named(steps, refine, words):
    with pytest.raises(ValueError, match=f"Argument `refine` must .*{words}"):
        swept(steps_per_period=steps, refine=refine)
