"""Tracks as functions of distance, and the speeds at which the rail approaches the slipper."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.layout import coordinates
from slipperjax.model.quantities import COORDINATE_SCALES
from slipperjax.model.step_size import contact_duration

from ..common import fine
from ..families import facts_of, irregularity_of, motion_of


class SineTrack(sj.model.AbstractTrack):
    """A user-defined track without roll, whose lateral and vertical irregularities differ."""

    amplitude: float = 1e-3

    @property
    def wavelength(self):
        return jnp.asarray(8.0)

    def irregularity(self, distance):
        angle = 2 * jnp.pi * distance / self.wavelength
        return sj.model.Irregularity(self.amplitude * jnp.sin(angle), 0.5 * self.amplitude * jnp.cos(angle), None)


class Plain(SineTrack):
    """One that gives an array."""

    def irregularity(self, distance):
        return 1e-3 * distance


class Rising(SineTrack):
    """One that does not recur, and is steepest after two waves."""

    def irregularity(self, distance):
        return sj.model.Irregularity(1e-4 * distance + 9e-4 * jnp.maximum(distance - 20.0, 0.0), 0.0 * distance, None)


def scene_with(track):
    return eqx.tree_at(lambda s: s.track, sj.paper_scene(), track)


def test_harmonic_irregularity_and_its_slope():
    track = sj.HarmonicTrack((8.0, 12.0), 1e-3, 2e-3)
    distance = np.array([0.3, 2.0, 805.7])
    here, slope = motion_of(track, distance)
    shape = np.sin(2 * np.pi * distance / 8) + np.sin(2 * np.pi * distance / 12)
    rate = 2 * np.pi * (np.cos(2 * np.pi * distance / 8) / 8 + np.cos(2 * np.pi * distance / 12) / 12)
    np.testing.assert_allclose(here.lateral, 1e-3 * shape, rtol=0, atol=1e-15)
    np.testing.assert_allclose(here.roll, 2e-3 * shape, rtol=0, atol=1e-15)
    np.testing.assert_allclose(slope.vertical, 1e-3 * rate, rtol=0, atol=1e-15)


def test_an_own_track_gets_the_steps_of_its_slope():
    """Not of the least approach speed: equal sines of two classes get equal steps."""
    ours, theirs = scene_with(SineTrack()), scene_with(sj.HarmonicTrack((8.0,), 1e-3))
    for scene in (ours, theirs):
        assert float(scene.track.approach_speed(scene.speed)) == pytest.approx(2 * np.pi * 1e-3 * 1250 / 8, rel=1e-9)
    assert float(contact_duration(ours)) == pytest.approx(float(contact_duration(theirs)), rel=1e-9)
    stiff = [s.replace(stiffness=1e11) for s in (ours, theirs)]
    assert sj.model.default_steps_per_period(stiff[0]) == sj.model.default_steps_per_period(stiff[1]) > 200


TRACKS = {
    "one wave": (sj.HarmonicTrack((8.0,), 1e-3), 8, 2 * np.pi / 8000, 8.0),
    "two waves": (sj.HarmonicTrack((10.0, 12.0), 1e-3), 60, 2 * np.pi * (1 / 10 + 1 / 12) / 1000, 10.0),
    "a divisor": (sj.HarmonicTrack((8.0, 2.0), 1e-3), 8, 2 * np.pi * (1 / 8 + 1 / 2) / 1000, 2.0),
    "no ratio": (sj.HarmonicTrack((8.0, 5.0001), 1e-3), np.inf, 2 * np.pi * (1 / 8 + 1 / 5.0001) / 1000, 5.0001),
    "straight": (sj.model.StraightTrack(), 0, 0.0, 8.0),
    "a user's": (SineTrack(), 8, 2 * np.pi / 8000, 8.0),
    "a rising one": (Rising(), np.inf, 1e-3, 8.0),
}


@pytest.mark.full
@pytest.mark.parametrize("name", TRACKS)
def test_tracks_say_whether_they_recur_how_steep_and_how_short_they_are(name):
    track, *needed = TRACKS[name]
    np.testing.assert_allclose(facts_of(track), needed, rtol=1e-9)
    # the least number of first wavelengths by its definition, which a straight rail does without
    places = np.arange(97) / 97 + np.arange(7)[:, None]
    heights = np.asarray(irregularity_of(track, float(track.wavelength) * places).lateral)
    equal = np.max(np.abs(heights[1:] - heights[0]), axis=1) < 1e-12
    if needed[0]:
        assert (np.flatnonzero(equal)[0] + 1 if equal.any() else np.inf) == needed[0] / float(track.wavelength)


def test_short_waves_get_more_steps():
    short = lambda ratio: sj.model.default_steps_per_period(
        sj.paper_scene(wavelengths=(8.0, 8.0 / ratio), amplitude=1e-4)
    )
    assert [short(ratio) for ratio in (1, 4, 16)] == [40, 40, 160]


def test_waves_shorter_than_the_slipper_are_said():
    with pytest.warns(sj.ImplausibleWarning, match="has waves of 0.15 m, shorter than the slipper of 0.2 m"):
        sj.paper_scene(wavelengths=(8.0, 0.15), amplitude=1e-4)


@pytest.mark.full
def test_default_steps_resolve_a_short_second_wave():
    """With steps for the first wave alone the error was 6.8e-2 (and 0.36 with 0.2 m)."""
    for wave, bound in ((0.4, 2e-3), (0.2, 2e-3)):  # measured 1.1e-3 and 9.0e-4
        scene = sj.paper_scene(400.0, wavelengths=(8.0, wave), restitution=0.7)
        coarse, fine = (coordinates(sj.simulate(scene, 1, steps_per_period=n).end) for n in (None, 3200))
        assert np.max(np.abs(coarse - fine) / COORDINATE_SCALES) < bound


def test_short_waves_get_more_steps_where_impacts_are_damped():
    """See `slipperjax.model.step_size.damped_waves`."""
    sine = sj.paper_scene(1000.0)
    rail = dataclasses.replace(sine, track=sj.RandomTrack.sled(length=200.0))
    steps = lambda scene: [
        sj.model.default_steps_per_period(scene.replace(restitution=r)) for r in (0.9, 0.7, 0.5, 0.3)
    ]
    assert (steps(rail), steps(sine)) == ([120, 200, 320, 480], [40, 40, 40, 80])


def test_default_steps_are_there_for_every_law():
    """Those without memory have no rate at touchdown to compare with."""
    scene = sj.paper_scene(1000.0)
    of = lambda law: sj.model.default_steps_per_period(dataclasses.replace(scene, contact=law))
    assert of(sj.model.HertzSpring(1e8)) == 40
    assert of(sj.model.ConstantDamping(1e8, 0.5)) == 40
    assert of(sj.model.ConstantDamping(1e8, 10.0)) > 40  # its damping force is seven times the elastic one


@pytest.mark.full
def test_lateral_and_vertical_are_separate():
    """Gaps change by the rail's displacement along the normals."""
    scene = scene_with(SineTrack())
    state = sj.initial_state(scene, sj.Motion(z=5e-4))
    normals, seen = np.asarray(scene.section.normals), []
    gaps = sj.jit(lambda t: sj.model.reactions(t, state, sj.model.Args(scene)).gap)
    for t, shift in ((0.0, (0.0, 5e-4)), (0.25, (1e-3, 0.0)), (0.5, (0.0, -5e-4))):
        here = irregularity_of(scene.track, np.array(8.0 * t))
        np.testing.assert_allclose((here.lateral, here.vertical), shift, rtol=0, atol=1e-15)
        # of the front; the rear is 0.2 m behind
        seen.append(np.asarray(gaps(t))[0] + normals @ shift)
    np.testing.assert_allclose(seen, [seen[0]] * 3, rtol=0, atol=1e-6)
    assert np.all(
        np.isfinite(jax.tree.leaves(sj.model.vector_field(scene).evaluate(0.0, state, sj.model.Args(scene)).motion))
    )


@pytest.mark.full
def test_wrong_tracks_and_starts_are_named():
    with pytest.raises(ValueError, match=r"`irregularity` must be a .*Irregularity, but is"):
        sj.simulate(scene_with(Plain()), 1)
    run = fine(sj.paper_scene())
    with pytest.raises(ValueError, match=r"`start` must be of one instant, such as `\.end` of a .* but has 1201"):
        sj.simulate(sj.paper_scene(), 1, start=run.state)
