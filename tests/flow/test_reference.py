"""States against an independent C++ code and against MBDyn."""

import numpy as np
import pytest

import slipperjax as sj

from ..common import PERIODS, SCALES, STEPS, cases, columns, fine, in_lanes, lane_of, scaled_errors, scene_of

REFERENCE = cases("reference_states")
SOFT = [case for case in REFERENCE if case["stiffness"] < 1e9]
SINGLE = [case for case in SOFT if not case["wavelength2"]]
(STIFF,) = (case for case in REFERENCE if case["stiffness"] > 1e9)
(DOUBLE,) = (case for case in SOFT if case["wavelength2"])


def name(case):
    return f"V{case['speed']}-C{case['clearance']}-L{case['length']}"


@pytest.mark.parametrize("case", SINGLE, ids=name)
def test_states_at_200_steps(case):
    errors = scaled_errors(fine(scene_of(case)), case, STEPS)
    # Measured: 1e-5 .. 5e-5, but 6.7e-3 at C = 4 mm, where near-grazing touchdowns magnify the error 100-fold.
    assert errors.max() < (1e-2 if case["clearance"] > 2e-3 else 1e-4)
    assert errors[:4].max() < 1e-3


def test_two_wavelengths_without_loads():
    run = sj.simulate(scene_of(DOUBLE), PERIODS, steps_per_period=STEPS, saves_per_period=1, loads=False)
    assert scaled_errors(run, DOUBLE, 1).max() < 1e-4
    assert columns(run).shape == (PERIODS + 1, 10)
    assert run.loads is None
    assert "peak_force" not in run.ds
    with pytest.raises(ValueError, match="`loads` must be True"):
        _ = run.peak


def lane_errors(cases, steps):
    """Worst scaled errors of cases over the periods that are known."""
    states, code = in_lanes(list(map(lane_of, cases)), steps)
    assert np.all(code == 0)
    known = [np.array(case["states"]) for case in cases]
    return np.array([np.max(np.abs(a[: len(b)] - b) / SCALES) for a, b in zip(states, known, strict=True)])


@pytest.fixture(scope="module")
def by_steps():
    """Worst scaled errors over 6 periods, by steps per period and case."""
    return {steps: lane_errors(SINGLE, steps) for steps in (100, 400)}


@pytest.mark.full
def test_wide_clearance_at_400_steps(by_steps):
    assert by_steps[400].max() < 1e-3  # measured 8.5e-4, at C = 4 mm


@pytest.mark.full
def test_order_is_two_or_better(by_steps):
    order = np.log(by_steps[100] / by_steps[400]) / np.log(4)
    # measured 1.3 (C = 4 mm, where it is erratic) to 2.6, 2.1 in the median
    assert np.median(order) > 1.9
    assert order.min() > 1.0


@pytest.mark.full
def test_stiff_contact():
    assert lane_errors([STIFF], 3200).max() < 2e-3  # measured 3.3e-5, over two periods


# MBDyn's own error over these six periods at the paper's settings: its distance from the independent C++ code at
# 12,800 steps per period. At L = 0.1 m and at C = 4 mm errors grow fast.
MBDYN_ERROR = dict(A=5.9e-3, V900=7.3e-3, V1500=5.1e-3, V2300=6.8e-3, C4=4.6e-2, L01=3.4e-2, L04=5.2e-3)


@pytest.mark.parametrize("case", cases("mbdyn_states"), ids=lambda case: case["name"])
def test_mbdyn_within_its_own_error(case):
    errors = scaled_errors(fine(scene_of(case)), case, STEPS)
    assert errors[:PERIODS].max() < 1.1 * MBDYN_ERROR[case["name"]]  # measured: 1.00 to 1.04 times
