"""Branches of periodic motions: events of textbook maps and oscillators, switching, closed branches, bad cases."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

from slipperjax.analysis.arclength import Pace
from slipperjax.analysis.continuation import continue_motion, extend, switch
from slipperjax.analysis.shooting import PeriodicMotions

from .systems import (
    LOGISTIC,
    Polynomial,
    column,
    follow,
    labels,
    motions,
    only,
    rk4,
    where,
)

PITCHFORK = Polynomial.of({(1, 0): 1.0, (1, 1): 1.0, (3, 0): -1.0})
# x + (x - 1)^2 + (p - 2)^2 - 1/4
CIRCLE = Polynomial.of({(0, 0): 4.75, (0, 1): -4.0, (0, 2): 1.0, (1, 0): -1.0, (2, 0): 1.0})
NOTHING = Polynomial.of({(0, 0): 1.0, (1, 0): 1.0, (2, 0): 1.0})
BURSTING = Polynomial.of({(1, 0): np.nan})
CASCADE = (3.0, 1 + np.sqrt(6), 3.544090359552)
"""Flips of the logistic map to periods 2, 4, 8."""


@pytest.fixture(scope="module")
def whole():
    return follow(LOGISTIC, [0.6], 2.5, (0.5, 3.9))


def test_the_logistic_maps_flips():
    branch = follow(LOGISTIC, [0.6], 2.5, (2.0, 3.2), pace=Pace(most=0.04))
    flips = [only(branch, "PD")]
    for n, (last, value) in enumerate(itertools.pairwise(CASCADE)):
        equations, first = switch(branch, flips[-1], length=0.02 / 4**n)
        assert equations.intervals == 2 ** (n + 1)
        pace = Pace(first=0.01 / 4**n, most=0.05 / 2**n)
        branch = continue_motion(equations, first, (2.0, value + 0.2 * (value - last)), ways=(1,), pace=pace)
        assert branch.ended == ("", "bound")
        flips.append(only(branch, "PD"))
    # measured: 8e-14, at the third
    np.testing.assert_allclose([where(flip) for flip in flips], CASCADE, rtol=0, atol=1e-10)
    np.testing.assert_allclose([flip.multiplier for flip in flips], -1.0, rtol=0, atol=1e-10)  # measured: 4e-14
    assert max(flip.high - flip.low for flip in flips) < 1e-10  # of a step of 0.04 at most 8e-11


def test_the_logistic_branch_through_its_branch_point(whole):
    assert labels(whole) == ["EP", "BP", "PD", "EP"]
    assert whole.ended == ("bound", "bound")
    np.testing.assert_allclose(column(whole.nodes, 0), 1 - 1 / whole.values, rtol=0, atol=1e-9)  # measured: 1e-10
    slopes = np.array([node.multipliers[0] for node in whole.nodes])
    np.testing.assert_allclose(slopes, 2 - whole.values, rtol=0, atol=1e-8)  # measured: 3e-10
    others = np.array([node.label not in ("BP", "PD") for node in whole.nodes])
    np.testing.assert_array_equal(whole.stable[others], ((whole.values > 1) & (whole.values < 3))[others])
    crossing = only(whole, "BP")
    assert abs(where(crossing) - 1) < 1e-8  # measured: 2e-13
    assert abs(crossing.multiplier - 1) < 1e-8
    # the other branch is x = 0
    other = continue_motion(*switch(whole, crossing), (0.5, 2.5))
    assert max(abs(column(other.nodes, 0))) < 1e-9  # measured: 2e-12
    assert labels(other) == ["EP", "BP", "EP"]
    assert abs(where(only(other, "BP")) - 1) < 1e-8  # measured: 1e-12
    np.testing.assert_allclose(sorted(other.values[[0, -1]]), [0.5, 2.5], rtol=0, atol=1e-12)


@pytest.mark.parametrize("x", [0.0, 0.5, -0.3])
def test_a_pitchfork_from_either_branch(x):
    branch = follow(PITCHFORK, [x], x**2 or -0.5, (-0.6, 0.6))
    event = only(branch, "BP")
    assert abs(event.multiplier - 1) < 1e-8
    other = continue_motion(*switch(branch, event), (-0.6, 0.6))
    for one in (branch, other):
        assert labels(one) == ["EP", "BP", "EP"]
        assert abs(where(only(one, "BP"))) < 1e-8  # measured: 8e-14 on the parabola, 1e-14 on the straight branch
    straight, parabola = (column(one.nodes, 0) for one in ((branch, other) if x == 0 else (other, branch)))
    assert max(abs(straight)) < 1e-8  # measured: 1e-10
    values = (other if x == 0 else branch).values
    np.testing.assert_allclose(parabola * (parabola**2 - values), 0.0, rtol=0, atol=1e-9)  # measured: 1e-10
    np.testing.assert_allclose(sorted(parabola[[0, -1]]), [-np.sqrt(0.6), np.sqrt(0.6)], rtol=0, atol=1e-9)


@pytest.mark.parametrize("length", [0.01, 0.02, 0.05])
def test_a_pitchfork_where_steps_end_on_it(length):
    """Points at a distance of the first step or of several from the branch point, whose tangent has no meaning."""
    branch = follow(PITCHFORK, [0.0], -0.1, (-0.15, 0.15))
    equations, first = switch(branch, only(branch, "BP"), length=length)
    for step in (length, length / 2, length / 4):
        other = continue_motion(equations, first, (-0.15, 0.15), pace=Pace(first=step))
        assert labels(other) == ["EP", "BP", "EP"]
        x = column(other.nodes, 0)
        assert x.min() < -0.35
        assert x.max() > 0.35
        assert abs(where(only(other, "BP"))) < 1e-8  # measured: 5e-12


@pytest.mark.parametrize("angle", [0.3, 1.5, 4.0])
def test_a_closed_branch_has_two_folds(angle):
    branch = follow(CIRCLE, [1 + 0.5 * np.sin(angle)], 2 + 0.5 * np.cos(angle), (0.0, 4.0))
    assert branch.ended == ("", "closed")
    assert labels(branch) == ["LP", "LP"]
    folds = sorted(where(event) for event in branch.events)
    np.testing.assert_allclose(folds, [1.5, 2.5], rtol=0, atol=1e-8)  # measured: 0
    angles = np.unwrap(np.arctan2(column(branch.nodes, 0) - 1, branch.values - 2))
    # once around, and not over the start
    assert 1.9 * np.pi < abs(angles[-1] - angles[0]) < 2 * np.pi
    with pytest.raises(ValueError, match=r"`event` must be a flip \(PD\) or a branch point \(BP\), but is LP"):
        switch(branch, branch.events[0])


# Duffing's equation x'' + 0.1 x' + x + 0.05 x^3 = cos(w t), and its harmonic balance
DAMPING, CUBIC, ORDER = 0.1, 0.05, 12
HARMONICS = 2 * np.arange(ORDER) + 1
ANGLES = np.outer(HARMONICS, np.arange(8 * ORDER) * 2 * np.pi / (8 * ORDER))
WAVES = np.concatenate([np.cos(ANGLES), np.sin(ANGLES)])


def duffing(w):
    field = lambda s, t: jnp.stack([s[1], jnp.cos(w * t) - DAMPING * s[1] - s[0] - CUBIC * s[0] ** 3])
    return lambda s, k: rk4(field, s, 2 * jnp.pi / w, 400)


def balance(both, w):
    """Gives the residual of coefficients of cosines and sines, and its derivative."""
    x, n = both @ WAVES, w * HARMONICS
    linear = np.kron(np.eye(2), np.diag(1 - n**2)) + np.kron([[0, 1], [-1, 0]], np.diag(DAMPING * n))
    share = 2 * WAVES / ANGLES.shape[1] * CUBIC
    return linear @ both + share @ x**3 - np.eye(2 * ORDER)[0], linear + (3 * share * x**2) @ WAVES.T


def at_fold(unknowns):
    """Gives the residual of a frequency, the coefficients and a null vector of length one at a fold."""
    w, both, null = unknowns[0], *np.split(unknowns[1:], 2)
    missed, slope = balance(both, w)
    return np.concatenate([missed, slope @ null, [null @ null - 1]])


def harmonics(z):
    """Coefficients near those of a state (x, v, w) at t = 0, as if there were one harmonic."""
    return np.eye(2 * ORDER)[0] * z[0] + np.eye(2 * ORDER)[ORDER] * z[1] / z[2]


def test_duffings_response_curve_and_folds():
    branch = follow(duffing, [1.0, 0.0], 0.5, (0.3, 3.0), pace=Pace(most=0.2))
    assert labels(branch) == ["EP", "LP", "LP", "EP"]
    assert {node.outside for node in branch.nodes if not node.label} == {0, 1}
    for event in branch.events[1:3]:
        guess, w = harmonics(event.node.z), where(event)
        null = np.linalg.svd(balance(guess, w)[1])[2][-1]
        exact = root(at_fold, np.concatenate([[w], guess, null]), tol=1e-13)
        assert np.abs(exact.fun).max() < 1e-11
        assert abs(w - exact.x[0]) < 1e-6  # measured: 7e-10, of the integration
        assert event.converged
        assert event.high - event.low < 1e-8  # measured: 3e-15
    # the amplitude, and the state at t = 0, all along the curve
    sizes = []
    for node in branch.nodes[::8]:
        z = node.z
        both = root(balance, harmonics(z), (z[2],), jac=True, tol=1e-13).x
        state = [both[:ORDER].sum(), z[2] * (HARMONICS * both[ORDER:]).sum()]
        np.testing.assert_allclose(z[:2], state, rtol=0, atol=1e-6)  # measured: 4e-7
        sizes.append(np.abs(both @ WAVES).max())
    assert max(sizes) > 5  # the resonance
    # the backbone's single harmonic at the upper fold: force = damping w amplitude
    assert abs(max(sizes) * DAMPING * where(branch.events[1]) - 1) < 0.05  # measured: 0.02


NEAR, WITHIN = "`start` must be near a periodic motion", "`start` must lie within the bounds 3 and 4, but is"


@pytest.mark.parametrize(
    ("family", "start", "bounds", "options", "words"),
    [
        (NOTHING, ([0.6], 2.0), (1, 3), {}, f"{NEAR}, but is at a residual of [0-9]"),
        (BURSTING, ([0.6], 2.0), (1, 3), {}, f"{NEAR}, but is at a residual of inf"),
        (LOGISTIC, ([0.6], 2.5), (3, 4), {}, f"{WITHIN} 2.5"),
        (LOGISTIC, ([0.6], 2.5), (3, 2), {}, r"`bounds` must be two numbers, the smaller first, but is \(3, 2\)"),
        (LOGISTIC, ([0.6, 0.6], 2.5), (2, 3), {}, "`state` must have 1 numbers as `like` has, but has 2"),
    ],
)
def test_wrong_arguments_are_named(family, start, bounds, options, words):
    with pytest.raises(ValueError, match=words):
        continue_motion(motions(family), (jnp.asarray(start[0]), start[1]), bounds, **options)


def test_an_interruption_returns_what_was_found_which_goes_on(whole):
    def stop(node):
        if node.z[-1] > 3.2:
            raise KeyboardInterrupt

    part = follow(LOGISTIC, [0.6], 2.5, (0.5, 3.9), on_point=stop)
    assert part.ended == ("count", "interrupted")  # neither end is finished
    assert labels(part)[0] == "PD"
    assert 3.2 < part.values[-1] < 3.5
    further = extend(part, (0.5, 3.9))
    assert further.ended == ("bound", "bound")
    np.testing.assert_array_equal(further.values, whole.values)


def test_a_branch_ends_after_the_event_that_is_looked_for_and_goes_on(whole):
    part = follow(LOGISTIC, [0.6], 2.5, (0.5, 3.9), until=("PD",))
    assert part.ended == ("bound", "event")
    assert labels(part)[-1] == "PD"
    assert part.nodes[-2].label == "PD"  # the point after it is kept
    np.testing.assert_array_equal(extend(part, (0.5, 3.9)).values, whole.values)


def test_ends_by_count_on_bounds_and_at_the_start():
    branch = follow(LOGISTIC, [0.6], 2.5, (-np.inf, np.inf), points=5)
    assert branch.ended == ("count", "count")
    assert len(branch.nodes) == 11
    branch = follow(LOGISTIC, [0.6], 2.5, (2.0, 2.9), ways=(-1,))
    assert branch.ended == ("bound", "")
    np.testing.assert_allclose(branch.values[[0, -1]], [2.0, 2.5], rtol=0, atol=1e-12)
    on_bound = follow(LOGISTIC, [0.6], 2.5, (2.5, 2.9))
    assert on_bound.ended == ("bound", "bound")
    assert on_bound.values.max() == pytest.approx(2.9, abs=1e-12)
    assert labels(continue_motion(branch.equations, branch.nodes[3], (2.0, 2.9))) == ["EP", "EP"]


@pytest.mark.full
def test_an_end_without_convergence_says_why():
    """A square-root map whose motion grazes at a = 0, and a start where two branches cross."""
    root = lambda a: lambda s, k: a - jnp.sqrt(jnp.where(s > 0, s, jnp.nan))
    grazing = continue_motion(PeriodicMotions(root, jnp.zeros(1), 1.0), (jnp.array([1.0]), 2.0), (-1.0, 2.5))
    (end,) = [event for event in grazing.events if event.label == "MX"]
    assert abs(end.value) < 1e-5  # measured 1.4e-6
    assert "as at a grazing" in end.note
    assert "MX at 1.43" in repr(grazing)
    assert "as at a grazing" in repr(grazing)
    logistic = lambda a: lambda s, k: a * s * (1 - s)
    crossing = continue_motion(PeriodicMotions(logistic, jnp.zeros(1), 1.0), (jnp.zeros(1), 1.0), (0.5, 2.5))
    assert {event.label for event in crossing.events} == {"MX"}
    assert all("begin beside it" in event.note for event in crossing.events)
