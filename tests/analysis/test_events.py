"""Events of branches: several within a step, grazings in closed form, corners and gaps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

from slipperjax.analysis.arclength import Observation, Pace
from slipperjax.analysis.continuation import continue_motion
from slipperjax.analysis.floquet import rounding_errors

from ..common import among
from .systems import (
    HENON_AT,
    Fixed,
    Polynomial,
    Stopped,
    delayed,
    follow,
    henon,
    labels,
    motions,
    one_touch,
    only,
    where,
)


def coupled(p):
    """Flips at p = 0 and p = 0.001, a Neimark-Sacker at 0.002, a branch point at 0.003."""
    c, s = jnp.cos(1.0), jnp.sin(1.0)

    def step(x, k):
        pair = (0.998 + p) * jnp.stack([c * x[2] - s * x[3], s * x[2] + c * x[3]])
        return jnp.concatenate([jnp.stack([-(1 + p) * x[0], -(0.999 + p) * x[1]]), pair, (0.997 + p) * x[4:]])

    return step


def twin(p):
    return lambda x, k: -(1 + p) * x


def kicked(kick):
    """An area-preserving map over a parameter: a momentum that is kicked, and a place that it moves."""

    def family(p):
        def step(s, k):
            momentum = s[1] + kick(s[0], p)
            return jnp.stack([s[0] + momentum, momentum])

        return step

    return family


STANDARD = kicked(lambda x, p: p * jnp.sin(x))


def driven(p):
    """A damped motion that an area-preserving one drives: it has the multipliers of that, and one more."""
    return lambda s, k: jnp.append(now := STANDARD(p)(s[:2], k), 0.5 * s[2] + 0.1 * now[1])


def opposed(c):
    """Two oscillators of energies of opposite sign, coupled by c: 2 - mu - 1/mu is 1.15 +- (0.15^2 - c^2)^(1/2)."""

    def step(s, k):
        x, y, p, q = s
        p, q = p - x - c * y, q + 1.3 * y - c * x
        return jnp.stack([x + p, y - q, p, q])

    return step


IMPERFECT = Polynomial.of({(0, 0): 0.01, (1, 0): 1.0, (1, 1): 1.0, (3, 0): -1.0})
LONG = Pace(first=0.1, most=0.2)
HENON = [("LP", HENON_AT["LP"](0.3)), ("PD", HENON_AT["PD"](0.3))]
CLOSE = [("PD", 0.0), ("PD", 1e-3), ("NS", 2e-3), ("BP", 3e-3)]
TEXTBOOK = {
    "delayed logistic map": (Fixed(delayed, jnp.asarray(0.0)), [1 / 3, 1 / 3], 1.5, (1.2, 2.5), [("NS", 2.0)], 2.0),
    "Henon": (Fixed(henon, jnp.asarray(0.3)), [0.6, 0.6], 0.78, (-1.0, 1.0), HENON, None),
    "imperfect": (IMPERFECT, [-0.7], 0.5, (-0.6, 0.6), [("LP", 3 * 0.005 ** (2 / 3))], None),
    "unbroken": (IMPERFECT, [0.8], 0.6, (-0.6, 0.6), [], None),
    "within a step": (coupled, [0.0] * 5, -0.5, (-0.6, 0.6), CLOSE, 0.0),
    "standard map": (STANDARD, [np.pi, 0.0], 0.5, (0.5, 5.0), [("PD", 4.0)], 4.0),
    "driven by it": (driven, [np.pi, 0.0, 0.0], 0.5, (0.5, 5.0), [("PD", 4.0)], None),
    "fold": (kicked(lambda x, p: p - x**2), [0.5, 0.0], 0.25, (-1.0, 1.0), [("LP", 0.0)], None),
    "pitchfork": (kicked(lambda x, p: p * x - x**3), [0.0, 0.0], -0.5, (-1.0, 1.0), [("BP", 0.0)], 0.0),
    "pairs that meet": (opposed, [0.0] * 4, 0.01, (0.0, 0.3), [("NS", 0.15)], 0.15),
}
"""Families with their start, bounds, events and where they are, and the value below which they are stable."""


EVERY_DAY = ("delayed logistic map", "Henon", "within a step", "driven by it", "pitchfork")


@pytest.mark.parametrize("case", among(TEXTBOOK, *EVERY_DAY))
def test_events_of_textbook_maps_are_where_they_should_be(case):
    family, state, value, bounds, expected, stable = case
    branch = follow(family, state, value, bounds, pace=LONG if family is coupled else Pace())
    inside = sorted((where(event), event.label) for event in branch.events if event.label != "EP")
    assert branch.ended == ("bound", "bound")
    assert [label for _, label in inside] == [label for label, _ in expected]
    # measured: 1e-11 and less
    np.testing.assert_allclose([place for place, _ in inside], [place for _, place in expected], rtol=0, atol=1e-9)
    for event in branch.events:
        assert event.converged
    if stable is not None:
        others = [not node.label or node.label == "EP" for node in branch.nodes]
        np.testing.assert_array_equal(branch.stable[others], branch.values[others] < stable)


def test_coinciding_flips_are_told():
    event = follow(twin, [0.0, 0.0], -0.5, (-0.6, 0.6)).events[1]
    assert abs(where(event)) < 1e-8
    assert "multipliers jump from -1+0j, -1+0j" in event.note


class Forces(eqx.Module):
    """An oscillator with a stop, for forces."""

    system: Stopped

    def __call__(self, force):
        return eqx.tree_at(lambda system: system.force, self.system, force)


@eqx.filter_jit
def _touches(family, z):
    return family(z[-1]).followed(z[:-1])[1:]


def stopped(frequency, gap, upto, stop=np.inf, restitution=0.0):
    """A branch of an oscillator with a stop, and the force at which it grazes; it begins at six tenths of it."""
    family = Forces(Stopped(*map(jnp.asarray, (0.1, frequency, 1.0, gap, stop, restitution))))

    def observe(node):
        touches, margin = _touches(family, jnp.asarray(node.z))
        return Observation((int(touches),), (float(margin),))

    grazing = gap * abs(1 - frequency**2 + 0.2j * frequency)
    start = jnp.stack(family(jnp.asarray(0.6 * grazing)).arc(0.0).steady(0.0)), 0.6 * grazing
    pace = Pace(first=0.02 * grazing, most=0.2 * grazing)
    bounds = 0.3 * grazing, upto * grazing
    return continue_motion(motions(family, 2), start, bounds, observe=observe, pace=pace), grazing


def test_a_grazing_is_located():
    """The free motion has the amplitude force / |1 - w^2 + 2 i d w|, and grazes where this is the gap."""
    branch, grazing = stopped(2.8, 0.1, 1.2, stop=5.0)
    assert labels(branch) == ["EP", "GR", "PD", "EP"]
    event = only(branch, "GR")
    assert event.low <= grazing + 1e-12
    assert grazing - 1e-12 <= event.high
    assert event.high - event.low < 1e-9  # measured: 5e-12
    assert abs(where(event) - grazing) < 1e-8  # measured: 7e-13
    for node in branch.nodes:
        if not node.label:
            assert node.view.counts == (int(node.z[-1] > grazing),)

    # the flip behind it, from the instants and speeds at the stop
    def flipping(unknowns):
        missed, through, _ = one_touch(0.1, 2.8, 0.1, 5.0, *unknowns)
        return np.append(missed, np.linalg.det(through + np.eye(2)))

    exact = root(flipping, (0.726, 0.985, 1.2, 0.09, -0.09), tol=1e-14)
    assert np.abs(exact.fun).max() < 1e-12
    assert abs(where(only(branch, "PD")) - exact.x[0]) < 1e-8  # measured: 4e-15


def test_a_branch_ends_where_a_rigid_stop_is_grazed():
    branch, grazing = stopped(2.3, 0.1, 2.0, restitution=0.5)
    assert branch.ended == ("bound", "no convergence")
    event = branch.events[-1]
    assert event.label == "MX"
    assert not event.converged
    assert 0 < grazing - where(event) < 1e-5  # measured: 7e-7, the least step


class Kinked(eqx.Module):
    """x -> slope x + p, with one slope below zero and another above."""

    below: jax.Array
    above: jax.Array

    def __call__(self, p):
        return lambda x, k: jnp.where(x > 0, self.above, self.below) * x + p


def kinked(below, above):
    return Kinked(jnp.asarray(below), jnp.asarray(above))


def sides(node):
    return Observation((int(node.z[0] > 0),), (abs(float(node.z[0])),))


@pytest.mark.full
@pytest.mark.parametrize("above", [-0.8, -1.5])
def test_a_corner_is_passed_and_located(above):
    family, over = kinked(-0.5, above), above < -1
    branch = follow(family, [-1 / 3], -0.5, (-0.6, 0.6), observe=sides)
    assert labels(branch) == ["EP", "GR", "EP"]
    event = only(branch, "GR")
    assert abs(where(event)) < 1e-8  # measured: 4e-12
    assert ("multipliers jump from -0.5+0j to -1.5+0j" in event.note) == over
    assert abs(branch.nodes[-1].z[0] - 0.6 / (1 - above)) < 1e-9
    # without an observation the jump of the multiplier over -1 is found, and not taken for a flip
    unseen = follow(family, [-1 / 3], -0.5, (-0.6, 0.6))
    assert [(event.label, event.converged) for event in unseen.events[1:-1]] == [("PD", False)] * over


def test_a_branch_that_ends_in_a_corner_says_so():
    branch = follow(kinked(0.5, 3.0), [-0.3], -0.15, (-0.6, 0.6), observe=sides)
    assert branch.ended == ("bound", "no convergence")
    assert branch.events[-1].label == "MX"
    assert 0 < -where(branch.events[-1]) < 1e-5  # measured: 4e-7


def leaping(p):
    return lambda x, k: jnp.where(p < 1, 0.5, 0.7) + 0.3 * (x - 0.5)


def ending(p):
    return lambda x, k: 0.5 * x + jnp.sqrt(1 - p)


@pytest.mark.parametrize(("family", "state"), [(leaping, 0.5), (ending, 2 * np.sqrt(0.5))])
def test_a_branch_does_not_pass_gaps(family, state):
    branch = follow(family, [state], 0.5, (0.0, 2.0))
    assert branch.ended == ("bound", "no convergence")
    event = branch.events[-1]
    assert (event.label, event.converged) == ("MX", False)
    assert "as where a motion grazes a surface" in event.note
    assert 0 <= 1 - where(event) < 1e-5  # measured: 4e-7, the least step
    assert branch.values.max() < 1


COUNTED = Polynomial.of({(1, 0): 0.01005 - 1, (1, 1): -1.0})


def thresholds(node):
    """Two kinds of events that change near a flip at 0.01005, one of them twice."""
    p, places = float(node.z[-1]), np.array([0.01, 0.0101, 0.0102])
    gaps = np.abs(p - places)
    return Observation((int(p > places[0]) + int(p > places[2]), int(p > places[1])), (gaps[::2].min(), gaps[1]))


def test_grazings_and_flips_within_one_step_are_separated():
    branch = follow(COUNTED, [0.0], -0.5, (-0.6, 0.6), observe=thresholds, pace=Pace(first=0.1, most=0.2))
    assert labels(branch) == ["EP", "GR", "PD", "GR", "GR", "EP"]
    values = [where(event) for event in branch.events[1:-1]]
    np.testing.assert_allclose(values, [0.01, 0.01005, 0.0101, 0.0102], rtol=0, atol=1e-8)  # measured: 9e-12
    for event in branch.events:
        assert event.converged
        assert event.low <= event.high < event.low + 1e-8


def leapfrog(force, s, t, h):
    """Conserves areas to rounding."""
    x = s[0] + h / 2 * s[1]
    v = s[1] + h * force(x, t + h / 2)
    return jnp.stack([x + h / 2 * v, v])


def heun(force, s, t, h):
    """Makes areas grow by its error."""
    one = jnp.stack([s[1], force(s[0], t)])
    end = s + h * one
    return s + h / 2 * (one + jnp.stack([end[1], force(end[0], t + h)]))


@pytest.mark.parametrize(("method", "steps", "least", "most"), [(leapfrog, 60, 0.0, 1e-14), (heun, 400, 1e-8, 2e-7)])
@pytest.mark.parametrize("swing", among({"pendulum": jnp.sin, "stiffening": lambda x: x + x**3}, "pendulum"))
def test_an_undamped_oscillator_is_neutral_to_the_error_of_its_integration(swing, method, steps, least, most):
    def family(w):
        h, force = 2 * jnp.pi / w / steps, lambda x, t: 0.1 * jnp.cos(w * t) - swing(x)
        step = lambda s, i: (method(force, s, i * h, h), None)
        return lambda s, k: jax.lax.scan(step, s, jnp.arange(float(steps)))[0]

    branch = follow(family, [-0.03, 0.0], 2.3, (2.1, 3.2))
    assert labels(branch) == ["EP", "EP"]
    assert np.all(branch.stable)
    off = [abs(mu) - 1 for node in branch.nodes for mu in node.multipliers]
    assert least < max(off) < most


def test_errors_by_rounding_follow_the_condition_of_multipliers():
    # a double multiplier has the root of the error
    double = np.array([[[1.0, 1.0], [0.0, 1.0]]])
    assert 1e-8 < rounding_errors(np.linalg.eigvals(double[0]), double).min() < 1e-6
    turn = np.array([[[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]]])
    assert rounding_errors(np.linalg.eigvals(turn[0]), turn).max() < 1e-13
    # units make no difference
    scaled = turn * np.array([[1.0, 1e6], [1e-6, 1.0]])
    assert rounding_errors(np.linalg.eigvals(scaled[0]), scaled).max() < 1e-13
    assert np.all(rounding_errors(np.ones(2), turn * np.nan) < 1e-13)


@pytest.mark.full
@pytest.mark.parametrize(
    ("angle", "name"), [(0.03, "1:1"), (2.088, "1:3"), (1.58, "1:4"), (3.13, "1:2"), (0.4, ""), (1.0, ""), (2.5, "")]
)
def test_a_neimark_sacker_beside_a_strong_resonance_is_told(angle, name):
    turn = jnp.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    branch = follow(lambda p: lambda s, k: (1 + p) * turn @ s, [0.0, 0.0], -0.1, (-0.2, 0.2))
    note = only(branch, "NS").note
    assert note == (f"near the strong resonance {name}: a torus need not branch off" if name else "")
