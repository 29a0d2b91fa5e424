"""Bad questions are refused in one line, before anything is compiled."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.design.checks import size_of
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import checked_problem, first_designs, spread_designs
from slipperjax.design.sensitivities import sensitivities

BOX = {"clearance": (0.2e-3, 3e-3), "length": (0.12, 0.5)}


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
    arguments = dict(objective="peak_force", variables=BOX) | change
    with pytest.raises(ValueError, match="^" + words.replace("(", r"\(")):
        optimise_design(sj.paper_scene(), **arguments)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(names=["gravity"]), "Argument `names` must be of numbers that the scene has"),
    ],
)
def test_bad_sensitivities_name_what_is_wrong(change, words):
    with pytest.raises(ValueError, match="^" + words):
        sensitivities(sj.paper_scene(), **(dict(objectives="peak_force") | change))


def problem(**change):
    arguments = dict(
        over={"speed": [1000.0, 1600.0], "restitution": [0.8, 0.9, 1.0]}, robust="worst", constraints=None
    )
    arguments |= dict(transient=200, ensemble=sj.design.EnsembleSettings())
    arguments |= dict(steps=None, solver=None, start=None)
    return checked_problem(sj.paper_scene(), "peak_force", BOX, **(arguments | change))


def test_the_cases_are_every_combination():
    search = problem()
    assert search.count == 6
    np.testing.assert_array_equal(search.cases["speed"], [1000.0] * 3 + [1600.0] * 3)
    np.testing.assert_array_equal(search.cases["restitution"], [0.8, 0.9, 1.0] * 2)


def test_changes_count_over_the_magnitude_of_a_parameter():
    box = problem()
    name, (low, high) = next(iter(box.bounds.items()))
    assert size_of(box, name, -0.2) == 0.2
    assert size_of(box, "speed", 3.0) == 3.0
    # zero has no magnitude
    assert size_of(box, name, 0.0) == high - low
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
    given, count, fixed = first_designs(search, [{"clearance": 1e-3, "length": 0.31}], 0)
    np.testing.assert_allclose(search.in_units(given), [[1e-3, 0.31]])
    assert (count, fixed) == (1, 1)


def test_starts_are_the_best_that_lie_apart():
    designs = np.array([[0.5, 0.5], [0.0, 0.0], [0.05, 0.0], [0.0, 0.2], [1.0, 0.0], [0.9, 0.9]])
    order = [2, 1, 3, 4, 0, 5]  # the best one first
    assert spread_designs(designs, order, 3, fixed=1) == [0, 2, 4]
    assert spread_designs(designs, order, 3, fixed=0) == [2, 4, 0]
    # where fewer lie far apart, nearer ones do
    assert spread_designs(designs, order, 5, fixed=1) == [0, 2, 4, 5, 3]
    assert sorted(spread_designs(designs, order, 6, fixed=1)) == list(range(6))


def test_steps_are_those_that_the_worst_corner_needs():
    slow = problem(over={"speed": [100.0, 1600.0]}).steps
    assert slow > problem().steps
    assert problem(steps=123).steps == 123
