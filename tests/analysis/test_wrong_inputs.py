"""Texts and None in place of arrays, maps and branches are answered in one line that names the argument."""

import inspect

import numpy as np
import pytest

import slipperjax as sj
from slipperjax import analysis

plain = inspect.unwrap  # the tests' own checks of types would answer first
OF_NUMBERS = {
    "strobe": [analysis.classify, analysis.recurrence],
    "residual": [analysis.decay_rate],
    "series": [analysis.zero_one_test],
    "exponents": [analysis.kaplan_yorke],
    "history": [
        analysis.weighted_mean,
        analysis.standard_error,
        analysis.one_motion_standard_error,
        analysis.pooled_standard_error,
    ],
    "matrices": [plain(analysis.multipliers), lambda matrices: analysis.largest_exponent(matrices, 2)],
    "x": [lambda x: plain(analysis.regions)(x, [1.0, 2.0], [])],
    "least_mean_life": [lambda life: analysis.lasting("chaotic", life)],
}
OTHERS = {
    "spectrum": [plain(analysis.spectral_lines), lambda spectrum: plain(analysis.find_line)(spectrum, 3.0)],
    "equations": [lambda equations: plain(analysis.continue_motion)(equations, (0.0, 1.0), (0.0, 2.0))],
    "branch": [
        lambda branch: plain(analysis.extend_motion)(branch, (0.0, 1.0)),
        lambda branch: plain(analysis.switch)(branch, None),
    ],
    "function": [lambda function: plain(analysis.with_step_error)(function, 3)],
    "steps": [lambda steps: plain(analysis.with_step_error)(lambda n: n, steps)],
}


@pytest.mark.parametrize("wrong", [None, "text", [[1.0], [1.0, 2.0]], object()])
@pytest.mark.parametrize(("name", "function"), [(n, f) for n, all_of in OF_NUMBERS.items() for f in all_of])
def test_what_is_no_numbers(name, function, wrong):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be .*numbers") as told:
        function(wrong)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("wrong", [None, "text", 3.5])
@pytest.mark.parametrize(("name", "function"), [(n, f) for n, all_of in OTHERS.items() for f in all_of])
def test_what_is_of_another_kind(name, function, wrong):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be"):
        function(wrong)


def test_an_array_of_too_few_axes_and_other_wrong_inputs():
    for function, axes in (
        (analysis.kaplan_yorke, 1),
        (analysis.standard_error, 2),
        (analysis.pooled_standard_error, 3),
        (plain(analysis.multipliers), 3),
    ):
        with pytest.raises(ValueError, match=r"must be numbers .*, but is of shape"):
            function(np.ones((2,) * (axes - 1)))
    scene = sj.paper_scene()
    for call, words in (
        (lambda: sj.simulate(scene, 2, steps_per_period=[40, 80]), "`steps_per_period` must be a whole number"),
        (lambda: sj.Store(None), "`store` must be a path that ends in .zarr"),
        (lambda: sj.model.parameter("memory.slowest", scene), "EventLatch has no numbers, and so not 'slowest'"),
    ):
        with pytest.raises(ValueError, match=words):
            call()
