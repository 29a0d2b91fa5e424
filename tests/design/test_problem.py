"""Problems of searches: cases, first designs, and bad questions, refused before anything is compiled."""

import re

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.checks import size_of
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import checked_problem, first_designs, spread_designs

BOX = {"clearance": (0.2e-3, 3e-3), "length": (0.12, 0.5)}
OVER = {"speed": [1000.0, 1600.0], "restitution": [0.8, 0.9, 1.0]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(objective="peak"), "Argument `objective` must be one of peak_slipper_force, "),
        (dict(variables={}), "Argument `variables` must name parameters with their bounds"),
        (dict(variables={"clearance": (3e-3, 1e-3)}), "Argument `clearance` must have a lower bound below the upper"),
        (dict(variables={"clearance": 1e-3}), "Argument `clearance` must be a lower and an upper bound"),
        (dict(variables={"gravity": (1.0, 10.0)}, over={"gravity": [5.0]}), "Argument `over` must name other"),
        (dict(constraints={"excursion_roll": (0.2, 0.1)}), "Argument `constraints` must have a highest value"),
        (dict(starts=[{"clearance": 1e-3}]), "Argument `starts` must be designs that give clearance, length"),
        (dict(starts=[{"clearance": 1e-3, "length": 5.0}]), "Argument `starts` must lie within the bounds"),
    ],
)
def test_a_bad_question_names_what_is_wrong(change, words):
    with pytest.raises(ValueError, match="^" + re.escape(words)):
        optimise_design(sj.paper_scene(), **dict(objective="peak_force", variables=BOX) | change)


def problem(**change):
    options = dict(over=OVER, robust="worst", constraints=None, transient=200, steps=None, solver=None, start=None)
    ensemble = sj.design.EnsembleSettings()
    return checked_problem(sj.paper_scene(), "peak_force", BOX, ensemble=ensemble, **options | change)


def test_the_cases_are_every_combination_with_the_steps_of_the_worst_corner():
    search = problem()
    assert search.count == 6
    np.testing.assert_array_equal(search.cases["speed"], [1000.0] * 3 + [1600.0] * 3)
    np.testing.assert_array_equal(search.cases["restitution"], OVER["restitution"] * 2)
    assert problem(over={"speed": [100.0, 1600.0]}).steps > search.steps
    assert problem(steps=123).steps == 123


def test_changes_count_over_the_magnitude_of_a_parameter():
    box = problem()
    assert size_of(box, "clearance", -0.2) == 0.2
    assert size_of(box, "speed", 3.0) == 3.0
    # zero has no magnitude
    assert size_of(box, "clearance", 0.0) == np.ptp(BOX["clearance"])
    with pytest.raises(ValueError, match="Argument `names` must be of variables, or of parameters that are not zero"):
        size_of(box, "speed", 0.0)


def test_searches_begin_with_the_scene_s_own_design_and_spread():
    search = problem()
    designs, count, fixed = first_designs(search, 2, 0)
    assert (count, fixed) == (2, 1)
    np.testing.assert_allclose(search.in_units(designs[0]), [1e-3, 0.2])
    assert set(map(tuple, designs[1:5])) == {(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)}
    for k in (0, 1):  # a Latin hypercube: one in each eighth
        assert len(set(np.floor(8 * designs[5:, k]))) == len(designs) - 5 == 8
    given, *counts = first_designs(search, [{"clearance": 1e-3, "length": 0.31}], 0)
    np.testing.assert_allclose(search.in_units(given), [[1e-3, 0.31]])
    assert counts == [1, 1]


@pytest.mark.parametrize(
    ("count", "fixed", "chosen"),
    # where fewer lie far apart, nearer ones are taken
    [(3, 1, [0, 2, 4]), (3, 0, [2, 4, 0]), (5, 1, [0, 2, 4, 5, 3]), (6, 1, [0, 2, 4, 5, 3, 1])],
)
def test_starts_are_the_best_that_lie_apart(count, fixed, chosen):
    designs = np.array([[0.5, 0.5], [0.0, 0.0], [0.05, 0.0], [0.0, 0.2], [1.0, 0.0], [0.9, 0.9]])
    # the best one first
    assert spread_designs(designs, [2, 1, 3, 4, 0, 5], count, fixed) == chosen
