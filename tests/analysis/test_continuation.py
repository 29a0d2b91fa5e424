"""Branches of periodic motions: events of textbook maps and oscillators, switching, closed branches, bad cases."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax.analysis.continuation import continue_motion, extend_motion, switch
from slipperjax.analysis.curves import Pace
from slipperjax.analysis.floquet import multipliers

from .systems import follow, found, motions, only, rk4, where


def logistic(rate):
    return lambda x, k: rate * x * (1 - x)


def delayed(rate):
    return lambda s, k: jnp.stack([rate * s[0] * (1 - s[1]), s[0]])


def henon(a):
    return lambda s, k: jnp.stack([a - s[0] ** 2 + 0.3 * s[1], s[0]])


def pitchfork(p):
    return lambda x, k: x + p * x - x**3


def imperfect(p):
    return lambda x, k: x + p * x - x**3 + 0.01


def circle(p):
    return lambda x, k: x + (x - 1) ** 2 + (p - 2) ** 2 - 0.25


CASCADE = (3.0, 1 + np.sqrt(6), 3.544090359552, 3.564407266095, 3.568759419544)
"""Flips of the logistic map to periods 2, 4, 8, 16, 32."""


def test_the_logistic_maps_flips():
    branch = follow(logistic, [0.6], 2.5, (2.0, 3.2))
    flips = [only(branch, "PD")]
    for n, (last, value) in enumerate(itertools.pairwise(CASCADE)):
        equations, first = switch(branch, flips[-1], length=0.02 / 4**n)
        assert equations.intervals == 2 ** (n + 1)
        bounds = 2.0, value + 0.2 * (value - last)
        pace = Pace(first=0.01 / 4**n, most=0.05 / 2**n)
        branch = continue_motion(equations, first, bounds, ways=(1,), pace=pace)
        assert branch.ended == ("", "bound")
        flips.append(only(branch, "PD"))
    # measured: 4e-13, at the fifth
    np.testing.assert_allclose([where(flip) for flip in flips], CASCADE, rtol=0, atol=1e-10)
    np.testing.assert_allclose([flip.multiplier for flip in flips], -1.0, rtol=0, atol=1e-10)  # measured: 7e-13
    assert max(flip.high - flip.low for flip in flips) < 1e-10  # measured: 5e-14


def test_the_logistic_branch_through_its_branch_point():
    branch = follow(logistic, [0.6], 2.5, (0.5, 3.9))
    assert [label for label, _ in found(branch)] == ["EP", "BP", "PD", "EP"]
    assert branch.ended == ("bound", "bound")
    x = np.array([node.spot.z[0] for node in branch.nodes])
    np.testing.assert_allclose(x, 1 - 1 / branch.values, rtol=0, atol=1e-9)  # measured: 1e-10
    slopes = np.array([node.multipliers[0] for node in branch.nodes])
    np.testing.assert_allclose(slopes, 2 - branch.values, rtol=0, atol=1e-8)  # measured: 3e-10
    stable = np.array([node.label == "" and 1 < node.spot.z[-1] < 3 for node in branch.nodes])
    others = np.array([node.label in ("BP", "PD") for node in branch.nodes])
    np.testing.assert_array_equal(branch.stable[~others], stable[~others])
    crossing = only(branch, "BP")
    assert abs(where(crossing) - 1) < 1e-8  # measured: 2e-13
    assert abs(crossing.multiplier - 1) < 1e-8
    # the other branch is x = 0
    equations, first = switch(branch, crossing)
    other = continue_motion(equations, first, (0.5, 2.5))
    assert max(abs(node.spot.z[0]) for node in other.nodes) < 1e-9  # measured: 2e-12
    assert [label for label, _ in found(other)] == ["EP", "BP", "EP"]
    assert abs(where(only(other, "BP")) - 1) < 1e-8  # measured: 1e-12
    np.testing.assert_allclose(sorted([other.values[0], other.values[-1]]), [0.5, 2.5], rtol=0, atol=1e-12)


def test_a_neimark_sacker_of_the_delayed_logistic_map():
    """Maynard Smith's map: at r = 2 the multipliers are exp(+-i pi/3)."""
    branch = follow(delayed, [1 / 3, 1 / 3], 1.5, (1.2, 2.5))
    assert [label for label, _ in found(branch)] == ["EP", "NS", "EP"]
    event = only(branch, "NS")
    assert abs(where(event) - 2) < 1e-8  # measured: 4e-16
    assert abs(event.multiplier - np.exp(1j * np.pi / 3)) < 1e-8  # measured: 4e-16


def test_fold_and_flip_of_henons_map():
    branch = follow(henon, [0.6, 0.6], 0.78, (-1.0, 1.0))
    assert [label for label, _ in found(branch)] in (["EP", "PD", "LP", "EP"], ["EP", "LP", "PD", "EP"])
    assert abs(where(only(branch, "LP")) + 0.7**2 / 4) < 1e-8  # measured: 1e-17
    assert abs(where(only(branch, "PD")) - 3 * 0.7**2 / 4) < 1e-8  # measured: 6e-17
    x = np.array([node.spot.z[0] for node in branch.nodes])
    np.testing.assert_allclose(x**2 + 0.7 * x, branch.values, rtol=0, atol=1e-9)  # measured: 2e-13


@pytest.mark.parametrize("state", [[0.0], [0.5], [-0.3]])
def test_a_pitchfork_from_either_branch(state):
    value = state[0] ** 2 or -0.5
    branch = follow(pitchfork, state, value, (-0.6, 0.6))
    assert [label for label, _ in found(branch)] == ["EP", "BP", "EP"]
    event = only(branch, "BP")
    # measured: 8e-14 on the parabola, 3e-17 on the straight branch
    assert abs(where(event)) < 1e-8
    assert abs(event.multiplier - 1) < 1e-8
    equations, first = switch(branch, event)
    other = continue_motion(equations, first, (-0.6, 0.6))
    assert [label for label, _ in found(other)] == ["EP", "BP", "EP"]
    assert abs(where(only(other, "BP"))) < 1e-8  # measured: 1e-14
    straight, parabola = (branch, other) if state[0] == 0 else (other, branch)
    assert max(abs(node.spot.z[0]) for node in straight.nodes) < 1e-8  # measured: 1e-10
    x = np.array([node.spot.z[0] for node in parabola.nodes])
    np.testing.assert_allclose(x * (x**2 - parabola.values), 0.0, rtol=0, atol=1e-9)  # measured: 1e-10
    np.testing.assert_allclose(sorted([x[0], x[-1]]), [-np.sqrt(0.6), np.sqrt(0.6)], rtol=0, atol=1e-9)


def test_a_pitchfork_where_steps_end_on_it():
    """Points at a distance of the first step or of several from the branch point, whose tangent has no meaning."""
    for length in (0.01, 0.02, 0.05):
        branch = follow(pitchfork, [0.0], -0.5, (-0.6, 0.6))
        equations, first = switch(branch, only(branch, "BP"), length=length)
        for step in (length, length / 2, length / 4):
            other = continue_motion(equations, first, (-0.6, 0.6), pace=Pace(first=step))
            assert [label for label, _ in found(other)] == ["EP", "BP", "EP"]
            x = np.array([node.spot.z[0] for node in other.nodes])
            assert x.min() < -0.7
            assert x.max() > 0.7
            assert abs(where(only(other, "BP"))) < 1e-8  # measured: 5e-12


def test_an_imperfect_pitchfork_has_a_fold():
    whole = follow(imperfect, [0.8], 0.6, (-0.6, 0.6))
    assert [label for label, _ in found(whole)] == ["EP", "EP"]
    broken = follow(imperfect, [-0.7], 0.5, (-0.6, 0.6))
    assert [label for label, _ in found(broken)] == ["EP", "LP", "EP"]
    assert abs(where(only(broken, "LP")) - 3 * 0.005 ** (2 / 3)) < 1e-8  # measured: 5e-14


@pytest.mark.parametrize("angle", [0.3, 1.5, 4.0])
def test_a_closed_branch_has_two_folds(angle):
    start = [1 + 0.5 * np.sin(angle)], 2 + 0.5 * np.cos(angle)
    branch = follow(circle, *start, (0.0, 4.0))
    assert branch.ended == ("", "closed")
    assert sorted(label for label, _ in found(branch)) == ["LP", "LP"]
    folds = sorted(where(event) for event in branch.events)
    np.testing.assert_allclose(folds, [1.5, 2.5], rtol=0, atol=1e-8)  # measured: 0
    angles = np.unwrap([np.arctan2(node.spot.z[0] - 1, node.spot.z[1] - 2) for node in branch.nodes])
    # once around, and not over the start
    assert 1.9 * np.pi < abs(angles[-1] - angles[0]) < 2 * np.pi


# Duffing's equation x'' + 0.1 x' + x + 0.05 x^3 = cos(w t)
DAMPING, CUBIC, ORDER = 0.1, 0.05, 12


def duffing(w):
    field = lambda s, t: jnp.stack([s[1], jnp.cos(w * t) - DAMPING * s[1] - s[0] - CUBIC * s[0] ** 3])
    return lambda s, k: rk4(field, s, 2 * jnp.pi / w, 400)


HARMONICS = 2 * np.arange(ORDER) + 1
ANGLES = np.arange(8 * ORDER) * 2 * np.pi / (8 * ORDER)
COS, SIN = np.cos(np.outer(HARMONICS, ANGLES)), np.sin(np.outer(HARMONICS, ANGLES))


@jax.jit
def balance(both, w):
    """The harmonic balance: what the coefficients of cosines and sines miss."""
    a, b = both[:ORDER], both[ORDER:]
    cubes = CUBIC * (a @ COS + b @ SIN) ** 3
    force = jnp.zeros(ORDER).at[0].set(1.0)
    n = w * HARMONICS
    return jnp.concatenate(
        [
            (1 - n**2) * a + DAMPING * n * b + 2 * (COS @ cubes) / len(ANGLES) - force,
            (1 - n**2) * b - DAMPING * n * a + 2 * (SIN @ cubes) / len(ANGLES),
        ]
    )


@jax.jit
def at_fold(unknowns):
    """What the frequency, the coefficients and a null vector of length one miss at a fold."""
    w, both, null = unknowns[0], unknowns[1 : 2 * ORDER + 1], unknowns[2 * ORDER + 1 :]
    along = jax.jvp(lambda x: balance(x, w), (both,), (null,))
    return jnp.concatenate([*along, jnp.sum(null**2)[None] - 1])


def newton(misses, unknowns, *values):
    for _ in range(30):
        miss, slope = misses(unknowns, *values), _slope(misses, unknowns, *values)
        unknowns = unknowns - np.linalg.solve(slope, miss)
        if np.abs(miss).max() < 1e-13:
            return unknowns
    raise AssertionError("the harmonic balance has no solution near the guess")


@functools.partial(jax.jit, static_argnums=0)
def _slope(misses, unknowns, *values):
    return jax.jacfwd(misses)(unknowns, *values)


def harmonic_guess(z):
    """Coefficients from a state (x, v, w) at t = 0, as if there were one harmonic."""
    return np.zeros(2 * ORDER) + np.eye(2 * ORDER)[0] * z[0] + np.eye(2 * ORDER)[ORDER] * z[1] / z[2]


def test_duffings_response_curve_and_folds():
    branch = follow(duffing, [1.0, 0.0], 0.5, (0.3, 3.0), pace=Pace(most=0.2))
    assert [label for label, _ in found(branch)] == ["EP", "LP", "LP", "EP"]
    for event in branch.events[1:3]:
        guess = harmonic_guess(event.node.spot.z)
        w = where(event)
        null = np.linalg.svd(jax.jacfwd(balance)(guess, w))[2][-1]
        exact = newton(at_fold, np.concatenate([[w], guess, null]))
        assert abs(w - exact[0]) < 1e-6  # measured: 7e-10, of the integration
        assert event.converged
        assert event.high - event.low < 1e-8  # measured: 3e-15
    # the amplitude, and the state at t = 0, all along the curve
    sizes = []
    for node in branch.nodes[::8]:
        z = node.spot.z
        both = newton(balance, harmonic_guess(z), z[2])
        state = [both[:ORDER].sum(), z[2] * (HARMONICS * both[ORDER:]).sum()]
        np.testing.assert_allclose(z[:2], state, rtol=0, atol=1e-6)  # measured: 4e-7
        sizes.append(np.abs(both[:ORDER] @ COS + both[ORDER:] @ SIN).max())
    assert max(sizes) > 5  # the resonance
    outside = [node.outside for node in branch.nodes if not node.label]
    assert set(outside) == {0, 1}
    # the backbone's single harmonic at the upper fold: force = damping w amplitude
    w = where(branch.events[1])
    assert abs(max(sizes) * DAMPING * w - 1) < 0.05  # measured: 0.02


def well(force):
    """x'' + 0.3 x' - x + x^3 = force cos(1.2 t)."""
    field = lambda s, t: jnp.stack([s[1], force * jnp.cos(1.2 * t) - 0.3 * s[1] + s[0] - s[0] ** 3])
    return lambda s, k: rk4(field, s, 2 * jnp.pi / 1.2, 200)


def test_duffings_flip_and_its_doubled_branch():
    state, period = jnp.array([1.0, 0.0]), jax.jit(well(0.25))
    for _ in range(60):
        state = period(state, 0.0)
    branch = follow(well, state, 0.25, (0.2, 0.32))
    flip = only(branch, "PD")
    value = where(flip)
    gaps, firsts = [], []
    for length in (0.04, 0.02, 0.01):
        equations, first = switch(branch, flip, length=length)
        firsts.append(first)
        gaps.append(first.z[-1] - value)
    # the branch leaves as the root of the distance: half the length, a quarter of the distance
    np.testing.assert_allclose([gaps[0] / gaps[1], gaps[1] / gaps[2]], 4.0, rtol=0, atol=0.02)  # measured: 0.004
    # its leading multiplier starts at (-1)^2 and falls by a multiple of the distance
    lead = np.array([multipliers(np.asarray(first.extra))[0].real for first in firsts])
    np.testing.assert_allclose((1 - lead[:-1]) / (1 - lead[1:]), 4.0, rtol=0, atol=0.05)  # measured: 0.01
    assert abs(lead[-1] - 1) < 0.005  # measured: 0.004
    doubled = continue_motion(equations, firsts[-1], (0.2, 0.32), pace=Pace(first=0.01, most=0.05))
    # the flip is a pitchfork of the doubled map; both halves are the same motions, a period apart
    labels = [label for label, _ in found(doubled)]
    assert labels == ["EP", "PD", "BP", "PD", "EP"]
    assert abs(where(doubled.events[2]) - value) < 1e-8  # measured: 7e-13
    assert abs(where(doubled.events[1]) - where(doubled.events[3])) < 1e-8  # measured: 1e-14
    for node in doubled.nodes[::4]:
        if node.label == "BP":
            continue
        step = jax.jit(well(node.spot.z[-1]))
        once = np.asarray(step(jnp.asarray(node.spot.z[:2]), 0.0))
        twice = np.asarray(step(jnp.asarray(once), 0.0))
        np.testing.assert_allclose(twice, node.spot.z[:2], rtol=0, atol=1e-8)  # measured: 3e-11
        assert np.abs(once - node.spot.z[:2]).max() > 5e-3
    # where the doubled motion is stable, a simulation finds it
    node = next(node for node in doubled.nodes if value + 0.008 < node.spot.z[-1] < 0.286 and node.outside == 0)
    state, step = jnp.array([0.5, 0.3]), jax.jit(well(node.spot.z[-1]))
    for _ in range(400):
        state = step(state, 0.0)
    pair = np.stack([state, step(state, 0.0)])
    assert np.abs(pair - node.spot.z[:2]).max(axis=1).min() < 1e-8  # measured: 3e-15


def nothing(p):
    return lambda x, k: x + 1 + x**2


def bursting(p):
    return lambda x, k: x * jnp.nan


@pytest.mark.parametrize(
    ("family", "start", "bounds", "options", "words"),
    [
        (
            nothing,
            ([0.6], 2.0),
            (1, 3),
            {},
            "`start` must be near a periodic motion, but Newton's method ended with a",
        ),
        (bursting, ([0.6], 2.0), (1, 3), {}, "`start` must be near a periodic motion, but .* residual of inf"),
        (logistic, ([np.nan], 2.0), (1, 3), {}, "`start` must be near a periodic motion"),
        (logistic, ([0.6], 2.5), (3, 4), {}, "`start` must lie within the bounds 3 and 4, but is 2.5"),
        (logistic, ([0.6], np.nan), (3, 4), {}, "`start` must lie within the bounds 3 and 4, but is nan"),
        (logistic, ([0.6], 2.5), (3, 2), {}, r"`bounds` must be two numbers, the smaller first, but is \(3, 2\)"),
        (logistic, ([0.6], 2.5), (np.nan, 3), {}, "`bounds` must be two numbers"),
        (logistic, ([0.6], 2.5), (1, 2, 3), {}, "`bounds` must be two numbers"),
        (logistic, ([0.6], 2.5), 3, {}, "`bounds` must be two numbers"),
        (logistic, ([0.6, 0.6], 2.5), (2, 3), {}, "`state` must have 1 numbers as `like` has, but has 2"),
        (logistic, ([0.6], 2.5), (2, 3), {"points": 0}, "`points` must be a whole number of 1 or more, but is 0"),
    ],
)
def test_wrong_arguments_are_named(family, start, bounds, options, words):
    with pytest.raises(ValueError, match=words):
        continue_motion(motions(family), (jnp.asarray(start[0]), start[1]), bounds, **options)


def test_only_flips_and_branch_points_are_switched():
    branch = follow(circle, [1.5], 2.0, (0.0, 4.0))
    with pytest.raises(ValueError, match=r"`event` must be a flip \(PD\) or a branch point \(BP\), but is LP"):
        switch(branch, branch.events[0])


def test_an_interruption_returns_what_was_found():
    seen = []

    def stop(node):
        seen.append(node)
        if node.spot.z[-1] > 3.2:
            raise KeyboardInterrupt

    branch = follow(logistic, [0.6], 2.5, (0.5, 3.9), on_point=stop)
    assert branch.ended == ("count", "interrupted")  # neither end is finished
    assert found(branch)[0][0] == "PD"
    plain = [node for node in branch.nodes[1:] if not node.label]
    assert len(plain) == len(seen)
    assert branch.values[-1] > 3.2
    only(branch, "PD")


def test_points_are_limited_and_bounds_may_be_infinite():
    branch = follow(logistic, [0.6], 2.5, (-np.inf, np.inf), points=5)
    assert branch.ended == ("count", "count")
    assert len(branch.nodes) == 11
    assert "Branch(11 points" in repr(branch)


def test_a_branch_ends_after_the_event_that_is_looked_for():
    whole = follow(logistic, [0.6], 2.5, (0.5, 3.9))
    part = follow(logistic, [0.6], 2.5, (0.5, 3.9), until=("PD",))
    assert part.ended == ("bound", "event")
    assert [label for label, _ in found(part)][-1] == "PD"
    assert len(part.nodes) < len(whole.nodes)
    assert part.nodes[-2].label == "PD"  # the point after it is kept
    further = extend_motion(part, (0.5, 3.9))
    assert further.ended == ("bound", "bound")
    np.testing.assert_array_equal(further.values, whole.values)


def test_other_starts_and_ways():
    branch = follow(logistic, [0.6], 2.5, (2.0, 2.9), ways=(-1,))
    assert branch.ended == ("bound", "")
    assert branch.values[0] == pytest.approx(2.0, abs=1e-12)
    assert branch.values[-1] == pytest.approx(2.5, abs=1e-12)
    on_bound = follow(logistic, [0.6], 2.5, (2.5, 2.9))
    assert on_bound.ended == ("bound", "bound")
    assert on_bound.values.max() == pytest.approx(2.9, abs=1e-12)
    resumed = continue_motion(dataclasses.replace(branch.equations), branch.nodes[3].spot, (2.0, 2.9))
    assert [label for label, _ in found(resumed)] == ["EP", "EP"]
