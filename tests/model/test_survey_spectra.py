"""Random rails like a survey, which is made of a known spectrum, coherence and lines."""

import contextlib
import dataclasses
import functools
import itertools

import equinox as eqx
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.scene_files import scene_from_json, scene_from_toml, scene_to_json

from ..families import facts_of, irregularity_of, largest

LENGTH, SPACING, FIRST = 800.0, 0.1, 300.0
ROUGH, COHERENCE = 6e-10, -0.6
PLACES = np.arange(0.0, LENGTH + SPACING / 2, SPACING)
# joints with two harmonics, and another line that is lateral alone
LINES = sj.model.FourierTrack(
    (1.32, 0.66, 0.44, 2.1),
    (0.0, 0.0, 0.0, 9e-5),
    (8e-5, 6e-5, 4e-5, 0.0),
    lateral_phase=(0.0, 0.0, 0.0, -2.0),
    vertical_phase=(0.3, 1.1, 2.5, 0.0),
)
OCTAVES = 2.0 ** np.arange(-1, 6)
"""Ends of bands of wavelengths [m]."""


def made(lines=LINES, length=LENGTH, seed=11, **options):
    """A survey of a rail with the density A k^-2 and lines, which begins within a much longer rail."""
    rail = sj.RandomTrack.power_law(ROUGH, 2.0, band=(0.2, 800.0), length=1600.0, seed=seed, coherence=COHERENCE)
    places = PLACES[: round(length / SPACING) + 1]
    random, sines = irregularity_of(rail, 400.0 + places), irregularity_of(lines, places)
    channels = random.lateral + sines.lateral, random.vertical + sines.vertical
    return sj.model.SampledTrack(FIRST + places, *channels, **options)


SURVEY = made(ends="error")


@functools.cache
def alike():
    return sj.RandomTrack.like(SURVEY)


@eqx.filter_jit
def rms_in_octaves(spectrum):
    return [spectrum.rms(band) for band in itertools.pairwise(OCTAVES.tolist())]


CLOSED = ROUGH * (OCTAVES[1:] - OCTAVES[:-1])
"""Variances of A k^-2 in octaves [m^2]."""
SPREAD = 1 / np.sqrt(LENGTH * (1 / OCTAVES[:-1] - 1 / OCTAVES[1:]))
"""Standard deviation of a variance in a band, of one rail over its mean: each wave of the length has two numbers."""


def test_spectra_and_coherence_are_those_of_what_surveys_were_made_of():
    """Of twelve surveys: without bias, and with no more scatter than the length allows."""
    errors = []
    coherence = []
    for seed in range(12):
        like = sj.RandomTrack.like(made(seed=seed))
        for spectrum in (like.lateral, like.vertical):
            errors.append(np.array(rms_in_octaves(spectrum)) ** 2 / CLOSED - 1)
        coherence.append(float(like.coherence))
    # the scatter of the mean is a fifth of that of one
    assert np.all(np.abs(np.mean(errors, axis=0)) < 3 * SPREAD / np.sqrt(24))  # measured 2.1 of 3
    np.testing.assert_allclose(np.std(errors, axis=0), SPREAD, rtol=0.4)  # measured 0.83 to 1.15
    # (1 - c^2) / sqrt(two numbers for each wave) is the scatter of one, 0.01
    assert np.mean(coherence) == pytest.approx(COHERENCE, abs=0.01)  # measured 0.0058
    assert np.std(coherence) < 0.015  # measured 0.0097


def waves(track, name):
    """Wavenumbers of a track's lines and complex amplitudes in one direction, in the order of the wavenumbers."""
    order = np.argsort(-np.asarray(track.wavelengths))
    size = np.asarray(getattr(track, name)) * np.exp(1j * np.asarray(getattr(track, f"{name}_phase")))
    return 1 / np.asarray(track.wavelengths)[order], size[order]


def test_lines_have_their_wavelengths_amplitudes_and_phases():
    for name in ("lateral", "vertical"):
        (found, sizes), (exact, exact_sizes) = (waves(track, name) for track in (alike().lines, LINES))
        # amplitude that the random part has in one wave of the survey
        noise = np.sqrt(2 * ROUGH / exact**2 / LENGTH)
        # phases are at the survey's beginning, where wavenumbers that are a little wrong tell
        assert np.all(np.abs(sizes - exact_sizes) < 4 * noise)  # measured 1.3 of 4
        # cycles that are too many over the survey
        np.testing.assert_allclose(LENGTH * found, LENGTH * exact, atol=0.05)  # measured 0.0035
    # a random rail alone has none
    assert sj.RandomTrack.like(made(sj.model.FourierTrack((1.32,), (0.0,), (0.0,)))).lines is None
    # slopes of lines come on top
    steepest = [float(facts_of(track)[1]) for track in (alike(), dataclasses.replace(alike(), lines=None))]
    assert steepest[0] > steepest[1]


@pytest.mark.full
def test_joints_keep_their_shape_in_every_seed():
    """The mean over the joints of each rail is the shape of one, in waves of three samples and longer."""
    joints = sj.model.LocalTrack(place=[0.66], height=[-3e-4], length=0.6, shape="joint", every=1.32)
    like = sj.RandomTrack.like(made(joints), ends="error")
    across = 1.32 * np.arange(64) / 64
    harmonics = np.fft.rfft(irregularity_of(joints, across).vertical)
    harmonics[0] = 0.0
    harmonics[5:] = 0.0
    exact = np.fft.irfft(harmonics)
    places = FIRST + (1.32 * np.arange(600))[:, None] + across
    for seed in (1, 2):
        shape = np.mean(irregularity_of(dataclasses.replace(like, seed=seed), places).vertical, axis=0)
        # of 0.26 mm
        np.testing.assert_allclose(shape - shape.mean(), exact, rtol=0, atol=1e-5)  # measured 3.6e-6


@pytest.mark.full
def test_rails_lie_where_the_survey_does_and_go_on_as_it_does():
    assert alike().bounds == (FIRST, FIRST + LENGTH)
    assert alike().ends == "error"
    for ends, ramp in (("straight", 5.0), ("repeat", 6.0)):
        with pytest.warns(sj.ImplausibleWarning) if ends == "repeat" else contextlib.nullcontext():
            survey = made(ends=ends, ramp=ramp)
        like = sj.RandomTrack.like(survey)
        both = sj.model.TrackSet([survey, like, dataclasses.replace(like, seed=2)], 1)
        places = FIRST + np.linspace(-5.0, LENGTH + 5.0, 997)
        assert (
            largest(irregularity_of(both, places)[:2], irregularity_of(like, places)[:2]) < 1e-15
        )  # measured 2.5e-16
        assert eqx.tree_equal(like.ramp, survey.ramp) == (ends == "straight")
    # lines fit into a rail that repeats, so that nothing jumps where it begins again
    around = np.asarray(irregularity_of(like, FIRST + np.array([-0.01, 0.0, 0.01, LENGTH, LENGTH + 0.01])).vertical)
    np.testing.assert_allclose(around[3:], around[1:3], rtol=0, atol=1e-15)
    assert abs(around[0] - 2 * around[1] + around[2]) < 4e-6  # measured 1.1e-6
    counts = LENGTH / np.asarray(like.lines.wavelengths)
    np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)


def test_other_lengths_and_files():
    longer = sj.RandomTrack.like(SURVEY, length=3000.0, seed=4)
    assert longer.bounds == (FIRST, FIRST + 3000.0)
    scene = dataclasses.replace(sj.paper_scene(), track=longer)
    assert eqx.tree_equal(scene_from_json(scene_to_json(scene)), scene)
    assert eqx.tree_equal(scene_from_toml(scene.to_toml()).scene, scene)
    without = sj.RandomTrack.like(SURVEY, lines=None)
    assert without.lines is None


@pytest.mark.parametrize(
    ("survey", "words"),
    [
        (sj.RandomTrack.sled(), "`survey` must be a rail of samples such as slipperjax.load_rail returns"),
        (made(length=20.0), "`survey` must have 256 samples or more, which show a spectrum, but has 201"),
    ],
)
def test_what_shows_no_spectrum_is_refused(survey, words):
    with pytest.raises(ValueError, match=words):
        sj.RandomTrack.like(survey)
