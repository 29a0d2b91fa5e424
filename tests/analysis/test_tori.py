"""Invariant curves: beside long simulations, with locked rotation, and where they end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slipperjax import analysis

from .systems import delayed

pytestmark = pytest.mark.full


def family(r):
    return delayed(r, 0.0)


def iterates(step, state, count, transient=2000):
    run = lambda s, k: (step(s, k), s)
    return np.asarray(jax.lax.scan(run, state, jnp.arange(float(transient + count)))[1])[transient:]


@pytest.fixture(scope="module")
def tori():
    motions = analysis.PeriodicMotions(family, jnp.zeros(2), 1.0)
    branch = analysis.continue_motion(motions, (jnp.array([0.4, 0.4]), 1.9), (1.8, 2.2))
    (birth,) = [event for event in branch.events if event.label == "NS"]
    return analysis.continue_torus(motions, birth, (1.9, 2.1))


def test_torus_from_its_birth_beside_simulations(tori):
    assert tori.ended == ("Neimark-Sacker", "bound")
    node, r, rotation = tori.nodes[-1], tori.parameters[-1, 0], tori.rotation[-1]
    assert r == 2.1
    states = iterates(family(r), jnp.asarray(tori.at(node).states(node.z))[0], 20_000, 0)
    # measured 4e-16
    np.testing.assert_allclose(analysis.rotation_number(states), rotation, rtol=0, atol=1e-10)
    spectrum = analysis.map_spectrum(family(r), states[-1], 20_000)
    # measured 8e-12, from the simulation's weighted mean
    np.testing.assert_allclose(tori.exponents[-1], np.asarray(spectrum.weighted), rtol=0, atol=1e-9)
    # at the birth the angle of the multipliers is 60 degrees
    assert tori.rotation[0] == pytest.approx(1 / 6, abs=1e-4)


def test_torus_from_simulated_states(tori):
    motions = tori.equations.motions
    states = iterates(family(2.1), jnp.array([0.4, 0.45]), 2000)
    again = analysis.continue_torus(motions, (states, 2.1), (2.05, 2.1))
    at_start = np.argmax(again.parameters[:, 0])
    assert again.rotation[at_start] == pytest.approx(tori.rotation[-1], abs=1e-10)


def test_fixed_rotation_number():
    motions = analysis.PeriodicMotions(delayed, jnp.zeros(2), jnp.ones(2))
    states = iterates(delayed(2.08, 1e-3), jnp.array([0.4, 0.45]), 2000)
    tori = analysis.continue_torus(motions, (states, 2.08, 1e-3), ((2.0, 2.2), (0.0, 0.01)))
    assert np.ptp(tori.rotation) == 0
    r, c = tori.parameters[-1]
    assert abs(c - 1e-3) > 1e-3
    found = analysis.rotation_number(iterates(delayed(r, c), jnp.array([0.4, 0.45]), 20_000))
    # measured 1e-15
    np.testing.assert_allclose(found, tori.rotation[-1], rtol=0, atol=1e-10)


def resonant(turn):
    """A circle that is turned, with a term that locks the rotation on to 1:5."""

    def step(s, k):
        z = s[0] + 1j * s[1]
        z = jnp.exp(2j * jnp.pi * turn) * z * (1.25 - jnp.abs(z) ** 2) + 0.2 * jnp.conj(z) ** 4
        return jnp.stack([z.real, z.imag])

    return step


def test_locking():
    motions = analysis.PeriodicMotions(resonant, jnp.zeros(2), 1.0)
    states = iterates(resonant(0.19), jnp.array([0.5, 0.0]), 2000)
    tori = analysis.continue_torus(motions, (states, 0.19), (0.185, 0.215))
    (plateau,) = [event for event in tori.events if event.note == "locked 1:5"]
    # the rotation numbers of simulations within the plateau are 1/5, and outside they are not
    for turn, inside in [
        (plateau.low - 1e-4, False),
        (plateau.low + 1e-4, True),
        (plateau.high - 1e-4, True),
        (plateau.high + 1e-4, False),
    ]:
        found = analysis.rotation_number(iterates(resonant(turn), jnp.array([0.5, 0.0]), 20_000))
        assert (abs(found - 0.2) < 1e-9) == inside
    # followed beyond the plateau
    assert tori.rotation[0] < 0.2 < tori.rotation[-1]
    assert tori.ended == ("bound", "bound")


def test_lost_torus_ends_with_a_reason(tori):
    node = tori.nodes[-1]
    equations = tori.equations.motions
    simulated = iterates(family(2.1), jnp.asarray(tori.at(node).states(node.z))[0], 2000, 0)
    lost = analysis.continue_torus(equations, (simulated, 2.1), (2.09, 2.15), points=41, most=100)
    assert lost.ended == ("bound", "resolution")
    ahead = analysis.continue_torus(equations, (simulated, 2.1), (2.09, 2.4))
    assert ahead.ended[1] == "locked 1:7"
    (plateau,) = ahead.events
    within = iterates(family((plateau.low + plateau.high) / 2), jnp.array([0.4, 0.45]), 20_000)
    assert abs(analysis.rotation_number(within) - 1 / 7) < 1e-9
    for start, most, words in (
        (np.random.default_rng(0).random((500, 2)), 127, "`start` must be states on a closed curve"),
        (simulated, 63, "`most` must be enough states for the accuracy at the start, but is 63"),
    ):
        with pytest.raises(ValueError, match=words):
            analysis.continue_torus(equations, (start, 2.1), (2.0, 2.4), points=41, most=most)
