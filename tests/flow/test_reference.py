"""States against an independent C++ code and against MBDyn."""

import numpy as np
import pytest

import slipperjax as sj

from ..common import PERIODS, STEPS, cases, fine, scaled_errors, scene_of

REFERENCE = cases("reference_states")
SOFT = [c for c in REFERENCE if c["stiffness"] < 1e9]


def name(case):
    return f"V{case['speed']}-C{case['clearance']}-L{case['length']}-{case.get('wavelength2')}"


@pytest.mark.parametrize("case", SOFT, ids=name)
def test_states_at_200_steps(case):
    errors = scaled_errors(fine(scene_of(case)), case, STEPS)
    # Measured: 1e-5 .. 5e-5, but 6.7e-3 at C = 4 mm, where near-grazing touchdowns magnify the error 100-fold.
    assert errors.max() < (1e-2 if case["clearance"] > 2e-3 else 1e-4)
    assert errors[:4].max() < 1e-3


@pytest.fixture(scope="module")
def by_steps():
    """Worst scaled errors over 6 periods, by steps per period and case."""
    single = [c for c in SOFT if not c["wavelength2"]]
    return {
        n: np.array(
            [
                scaled_errors(sj.simulate(scene_of(c), 6, steps_per_period=n, saves_per_period=1), c, 1).max()
                for c in single
            ]
        )
        for n in (100, 400)
    }


def test_wide_clearance_at_400_steps(by_steps):
    assert by_steps[400].max() < 1e-3  # measured 8.5e-4, at C = 4 mm


def test_order_is_two_or_better(by_steps):
    order = np.log(by_steps[100] / by_steps[400]) / np.log(4)
    # measured 1.3 (C = 4 mm, where it is erratic) to 2.6, 2.1 in the median
    assert np.median(order) > 1.9
    assert order.min() > 1.0


def test_stiff_contact():
    (case,) = (c for c in REFERENCE if c["stiffness"] > 1e9)
    # two periods are compared; runs of six share the compiled program of the tests above
    trajectory = sj.simulate(scene_of(case), 6, steps_per_period=3200, saves_per_period=1)
    assert scaled_errors(trajectory, case, 1).max() < 2e-3  # measured 3.3e-5


# MBDyn's own error over these six periods at the paper's settings: its distance from the independent C++ code at
# 12,800 steps per period. At L = 0.1 m and at C = 4 mm errors grow fast.
MBDYN_ERROR = dict(A=5.9e-3, V900=7.3e-3, V1500=5.1e-3, V2300=6.8e-3, C4=4.6e-2, L01=3.4e-2, L04=5.2e-3)


@pytest.mark.parametrize("case", cases("mbdyn_states"), ids=lambda c: c["name"])
def test_mbdyn_within_its_own_error(case):
    errors = scaled_errors(fine(scene_of(case)), case, STEPS)
    assert errors[:PERIODS].max() < 1.1 * MBDYN_ERROR[case["name"]]  # measured: 1.00 to 1.04 times
