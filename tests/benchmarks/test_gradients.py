"""The bench of gradients: its exact answers by other means, and the rows of slipperjax within what they promise."""

import re
import runpy
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ..pages import ROOT
from . import exact, gradients, landed
from .gradients import BALL, BALLS, PLAY, RIGID, SLIPPERS, STOP, TABLE, error

pytestmark = pytest.mark.full


def ball(u):
    """The closed form of the bouncing ball, for JAX."""
    height, restitution = u * jnp.array(BALL.at)
    speed = jnp.sqrt(2 * gradients.G * height)
    last = speed / gradients.G * (1 + 2 * jnp.sum(restitution ** jnp.arange(1.0, 5.0)))
    since, up = BALL.end - last, restitution**5 * speed
    return jnp.stack([up * since - gradients.G * since**2 / 2, up - gradients.G * since, last])


def test_exact_answers_of_the_ball_are_those_of_its_closed_form_in_jax():
    functions = ball, jax.jacfwd(ball), jax.hessian(ball)
    for part, function in zip(BALL.exact, functions, strict=True):
        np.testing.assert_allclose(part, function(jnp.ones(2)), rtol=1e-12)  # measured: 2e-14


@pytest.mark.parametrize("problem", RIGID, ids=lambda problem: problem.name)
def test_exact_answers_are_those_of_scipy_with_events(problem):
    found = gradients.by_differences(gradients.by_scipy, problem).found
    # measured, the worst: 8e-10 of play, 1e-6 of table, 4e-6 of play
    for part, most in zip(exact.Exact._fields, (8e-9, 1e-5, 4e-5), strict=True):
        assert error(getattr(found, part), getattr(problem.exact, part)) < most


def test_differences_in_many_digits_do_not_depend_on_their_step(monkeypatch):
    monkeypatch.setattr(exact, "STEP", exact.STEP * 10**4)
    for part, again in zip(BALLS.exact, exact.exact(exact.balls, BALLS.at), strict=True):
        np.testing.assert_allclose(again, part, rtol=1e-15)


# measured: 1e-14, 4e-14, 9e-15; 2e-10, 1e-9, 3e-8; 4e-13, 2e-13, 4e-13; 2e-14, 3e-14, 2e-14
MOST = {"ball": (1e-12,) * 3, "stop": (2e-9, 1e-8, 3e-7), "table": (4e-12,) * 3, "balls": (1e-12,) * 3}
"""Greatest errors of value, first and second derivative by `impact_step`."""


BY_IMPACT_STEP = BALL, STOP, TABLE, pytest.param(BALLS, marks=pytest.mark.slow)


@pytest.mark.parametrize("problem", BY_IMPACT_STEP, ids=lambda problem: problem.name)
def test_impact_step_has_first_and_second_derivatives(problem):
    found = gradients.by_forward(gradients.by_impact_step, problem).found
    for part, most in zip(exact.Exact._fields, MOST[problem.name], strict=True):
        assert error(getattr(found, part), getattr(problem.exact, part)) < most


@pytest.mark.slow
def test_switched_step_has_first_and_second_derivatives():
    found = gradients.by_forward(gradients.by_switched_step, PLAY).found
    for part, most in zip(exact.Exact._fields, (3e-6, 1e-6, 7e-5), strict=True):
        # measured: 3e-7, 1e-7, 7e-6
        assert error(getattr(found, part), getattr(PLAY.exact, part)) < most


def test_stored_answers_for_the_slipper_are_those_of_other_steps(tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    program = landed.built(str(tmp_path))
    found = landed.states(program, *SLIPPERS[0].at, steps=500, periods=3)[-1]
    assert error(found, SLIPPERS[0].exact.value) < 1e-6  # measured: 3e-8


def test_a_slipper_has_first_derivatives():
    function = lambda u: gradients.by_period_map(SLIPPERS[0], *(u * jnp.array(SLIPPERS[0].at)))
    value, first = jax.jit(lambda u: (function(u), jax.jacfwd(function)(u)))(jnp.ones(2))
    assert error(value, SLIPPERS[0].exact.value) < 5e-5  # measured: 1.2e-5
    assert error(first, SLIPPERS[0].exact.first) < 5e-3  # measured: 1.3e-3


def test_a_row_of_a_reader(capsys, monkeypatch, tmp_path):
    """The page's example is an additional row."""
    monkeypatch.setattr(gradients, "ROWS", [])
    (example,) = re.findall("```py\n(.*?)```", (ROOT / "docs/lab/gradients.md").read_text(), re.DOTALL)
    (tmp_path / "mine.py").write_text(example)
    runpy.run_path(str(tmp_path / "mine.py"))
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ball")]
    errors = [float(cell) for cell in line.split("|")[3:6]]
    assert max(errors) < 1e-12
