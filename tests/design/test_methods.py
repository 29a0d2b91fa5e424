"""How designs move, on functions whose optima are known."""

from typing import NamedTuple

import numpy as np
import pytest

from slipperjax.design.methods import CaseValues, Descent, TrustRegion


class End(NamedTuple):
    """The last design that was taken, its values, and the number of trials."""

    at: np.ndarray
    values: CaseValues
    trials: int


def minimise(method, function, first, most=200):
    """Runs one start to its end; `function(x)` gives values and slopes, and maybe excess, its slopes, and weights."""

    def values_of(x):
        made = function(x)
        return CaseValues(*made, *(np.empty(0), np.empty((0, len(x))), None)[len(made) - 2 :])

    end = End(np.asarray(first, float), values_of(np.asarray(first, float)), 0)
    moves = method.moves(end.at, end.values)
    while end.trials < most and (at := next(moves, None)) is not None:
        values = values_of(at)
        taken = moves.send(values)
        end = End(at, values, end.trials + 1) if taken else end._replace(trials=end.trials + 1)
    return end


def test_the_worst_of_linear_functions_is_least_where_they_meet():
    """A linear program: x + y = 1 - 2x = 1 - y at x = 1/5, y = 2/5, value 3/5."""
    slopes = np.array([[1.0, 1.0], [-2.0, 0.0], [0.0, -1.0]])
    move = minimise(TrustRegion(least=1e-9), lambda x: (np.array([0.0, 1.0, 1.0]) + slopes @ x, slopes), [0.9, 0.9])
    np.testing.assert_allclose(move.at, [0.2, 0.4], atol=1e-9)
    assert move.values.total == pytest.approx(0.6, abs=1e-9)


def bowls(x):
    """The worst of two bowls around (0.2, 0.5) and (0.8, 0.5): least between them, at (0.5, 0.5)."""
    away = x - np.array([[0.2, 0.5], [0.8, 0.5]])
    return 1 + np.sum(away**2, axis=1), 2 * away


def test_a_ridge_of_two_curved_cases_is_followed_to_its_end():
    move = minimise(TrustRegion(least=1e-5), bowls, [0.1, 0.05])
    np.testing.assert_allclose(move.at, [0.5, 0.5], atol=2e-3)
    assert move.trials < 60  # 26


@pytest.mark.parametrize("method", [TrustRegion(least=1e-4), Descent(steps=200)])
def test_a_mean_has_its_least_inside(method):
    mean = lambda x: (*bowls(x), np.empty(0), np.empty((0, 2)), np.array([0.25, 0.75]))
    np.testing.assert_allclose(minimise(method, mean, [0.9, 0.1]).at, [0.65, 0.5], atol=5e-3)


def test_the_bounds_of_the_box_hold():
    linear = lambda x: (np.array([x[0] - x[1] + 5]), np.array([[1.0, -1.0]]))
    np.testing.assert_array_equal(minimise(TrustRegion(), linear, [0.5, 0.5]).at, [0.0, 1.0])


def test_a_constraint_is_kept_where_the_objective_is_lower_beyond():
    """x + y is least at the origin, but x y >= 0.04 is asked: (0.2, 0.2)."""

    def limited(x):
        excess = np.array([0.04 - x[0] * x[1]]) / 0.04
        return np.array([x.sum()]), np.ones((1, 2)), excess, -np.array([[x[1], x[0]]]) / 0.04

    move = minimise(TrustRegion(least=1e-6), limited, [0.9, 0.3])
    assert move.values.violation < 1e-4
    np.testing.assert_allclose([move.at.prod(), move.values.total], [0.04, 0.4], rtol=1e-3)


def test_from_a_forbidden_design_the_way_leads_out():
    limited = lambda x: (np.array([1 + x[0]]), np.ones((1, 1)), np.array([0.5 - x[0]]), -np.ones((1, 1)))
    np.testing.assert_allclose(minimise(TrustRegion(), limited, [0.05]).at, 0.5, atol=1e-6)


def test_a_trial_that_leaves_the_rail_is_not_taken():
    """Beyond 0.6 there is no motion: the search ends at the edge."""
    falling = lambda x: (np.array([np.nan if x[0] > 0.6 else 1 - x[0]]), np.array([[-1.0]]))
    assert 0.59 < minimise(TrustRegion(), falling, [0.1]).at[0] <= 0.6


def test_a_jump_down_is_taken_and_a_jump_up_is_not():
    stairs = lambda x: (np.array([1 + 0.1 * x[0] + (0.5 if 0.3 < x[0] < 0.5 else 0.0)]), np.array([[0.1]]))
    up, down = (minimise(TrustRegion(radius=0.05, least=1e-3), stairs, [first]) for first in (0.55, 0.4))
    assert 0.5 <= up.at[0] < 0.505  # at the foot of the step
    assert down.at[0] == 0.0
