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


def planes(x):
    """A linear program: x + y, 1 - 2x and 1 - y are equal at x = 1/5, y = 2/5, with the value 3/5."""
    slopes = np.array([[1.0, 1.0], [-2.0, 0.0], [0.0, -1.0]])
    return np.array([0.0, 1.0, 1.0]) + slopes @ x, slopes


def bowls(x):
    """The worst of two bowls around (0.2, 0.5) and (0.8, 0.5): least between them, at (0.5, 0.5)."""
    away = x - np.array([[0.2, 0.5], [0.8, 0.5]])
    return 1 + np.sum(away**2, axis=1), 2 * away


def product(x):
    """x + y is least at the origin, but x y >= 0.04 is asked: (0.2, 0.2) is one of the best."""
    excess = np.array([0.04 - x[0] * x[1]]) / 0.04
    return np.array([x.sum()]), np.ones((1, 2)), excess, -np.array([[x[1], x[0]]]) / 0.04


mean = lambda x: (*bowls(x), np.empty(0), np.empty((0, 2)), np.array([0.25, 0.75]))
falling = lambda x: (np.array([x[0] - x[1] + 5]), np.array([[1.0, -1.0]]))
forbidden = lambda x: (np.array([1 + x[0]]), np.ones((1, 1)), np.array([0.5 - x[0]]), -np.ones((1, 1)))
ENDS = {
    "the worst of linear functions is least where they meet": (planes, [0.9, 0.9], [0.2, 0.4], 0.6, 1e-9),
    "a ridge of two curved cases is followed to its end": (bowls, [0.1, 0.05], [0.5, 0.5], 1.09, 2e-3),
    "a mean has its least inside": (mean, [0.9, 0.1], [0.65, 0.5], 1.0675, 5e-3),
    "the bounds of the box hold": (falling, [0.5, 0.5], [0.0, 1.0], 4.0, 0.0),
    "a constraint is kept where the objective is lower beyond": (product, [0.9, 0.3], None, 0.4, 4e-4),
    "from a forbidden design the way leads out": (forbidden, [0.05], [0.5], 1.5, 1e-6),
}


@pytest.mark.parametrize("case", ENDS)
def test_a_search_ends_at_the_optimum(case):
    function, first, at, total, within = ENDS[case]
    move = minimise(TrustRegion(least=1e-9 if function is planes else 1e-5), function, first)
    if at is not None:
        np.testing.assert_allclose(move.at, at, rtol=0, atol=within)
    assert move.values.total == pytest.approx(total, abs=within)
    assert move.values.violation < 1e-4
    assert move.trials < 60 or function is not bowls  # 26


def test_a_descent_ends_at_the_optimum_of_a_mean():
    np.testing.assert_allclose(minimise(Descent(steps=200), mean, [0.9, 0.1]).at, [0.65, 0.5], atol=5e-3)


def test_a_trial_that_leaves_the_rail_is_not_taken():
    """Beyond 0.6 there is no motion: the search ends at the edge."""
    edge = lambda x: (np.array([np.nan if x[0] > 0.6 else 1 - x[0]]), np.array([[-1.0]]))
    assert 0.59 < minimise(TrustRegion(), edge, [0.1]).at[0] <= 0.6


def test_a_jump_down_is_taken_and_a_jump_up_is_not():
    stairs = lambda x: (np.array([1 + 0.1 * x[0] + (0.5 if 0.3 < x[0] < 0.5 else 0.0)]), np.array([[0.1]]))
    up, down = (minimise(TrustRegion(radius=0.05, least=1e-3), stairs, [first]) for first in (0.55, 0.4))
    assert 0.5 <= up.at[0] < 0.505  # at the foot of the step
    assert down.at[0] == 0.0
