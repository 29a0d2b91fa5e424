"""Every number of a scene is a parameter: by name or by path, checked, and with its unit."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.paths import parameter

SCENE = sj.paper_scene()


@pytest.mark.parametrize(
    ("path", "unit", "leaf"),
    [
        ("section.play.2", "m", lambda s: s.section.play[2]),
        ("section.points.D.1", "m", lambda s: s.section.points[3, 1]),
        ("section.points.3.1", "m", lambda s: s.section.points[3, 1]),
        ("slipper.inertia.1", "kg m^2", lambda s: s.slipper.inertia[1]),
        ("track.wavelengths.0", "m", lambda s: s.track.wavelengths[0]),
        ("contact.stiffness", "N/m^1.5", lambda s: s.contact.stiffness),
    ],
)
def test_paths_lead_to_one_number(path, unit, leaf):
    known = parameter(path, SCENE)
    assert known.unit == unit
    value = 1.01 * float(known.of(SCENE))
    changed = SCENE.replace(**{path: value})
    assert float(leaf(changed)) == value
    assert float(changed.value(path)) == value
    several = SCENE.replace(**{path: np.array([1.0, 1.01]) * float(known.of(SCENE))})
    np.testing.assert_allclose(several.value(path), np.array([1.0, 1.01]) * float(known.of(SCENE)), rtol=1e-15)


def test_two_numbers_of_one_array_vary_side_by_side():
    both = SCENE.replace(**{"section.play.0": np.array([1e-4, 2e-4]), "section.play.1": np.array([3e-4, 4e-4])})
    np.testing.assert_allclose(both.section.play[:, :3], [[1e-4, 3e-4, 5e-4], [2e-4, 4e-4, 5e-4]])


def test_a_part_after_the_whole_changes_it_and_undoes_nothing():
    found = SCENE.replace(**{"clearance": 2e-3, "section.play.2": 4e-4})
    np.testing.assert_allclose(found.section.play, [1e-3, 1e-3, 4e-4, 1e-3, 1e-3])
    with pytest.raises(ValueError, match=r"`section\.play\.2` must not be given with `clearance`"):
        SCENE.replace(**{"section.play.2": 4e-4, "clearance": 2e-3})
    with pytest.raises(ValueError, match=r"`mass` must not be given with `slipper\.mass`"):
        sj.sweep(SCENE, {"mass": [10.0, 11.0], "slipper.mass": [14.0]}, transient=0, periods=1)
    mass = jax.jit(lambda m: SCENE.replace(mass=m, speed=2 * m).slipper.mass)(3.0)
    assert float(mass) == 3.0


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("section.play.5", 1e-3, "must have a number of 0 to 4 in place of '5'"),
        ("section.points.Z.1", 1e-3, "or one of A, B, C"),
        ("section.points.D", 1e-3, "section.points is an array of shape"),
        ("section.names.0", 1e-3, "Section has points, play, but not 'names'"),
        ("track.height", 1e-3, "HarmonicTrack has wavelengths, amplitude, roll_amplitude, but not 'height'"),
        ("slipper.mass.0", 1e-3, "leads to no number"),
        ("slipper", 1e-3, "`slipper` is no parameter"),
        ("section.play.2", -1e-3, "`section.play.2` must be zero or positive, but is -0.001 m"),
        ("slipper.inertia.1", "1", "`slipper.inertia.1` must be positive, but is '1'"),
    ],
)
def test_wrong_paths_and_values_are_named(path, value, words):
    with pytest.raises(ValueError, match="Argument") as caught:
        SCENE.replace(**{path: value})
    assert words in str(caught.value)


def test_a_part_that_was_none_is_added():
    assert float(SCENE.replace(gravity=9.81).gravity) == 9.81
    flat = sj.Scene(
        speed=900.0,
        slipper=SCENE.slipper,
        section=SCENE.section,
        track=sj.HarmonicTrack((8.0,), 1e-3),
        contact=SCENE.contact,
    )
    assert float(flat.replace(roll_amplitude=1e-3).track.roll_amplitude) == 1e-3
    with pytest.raises(ValueError, match="`roll_amplitude` cannot be set: the scene has no"):
        sj.Scene(900.0, SCENE.slipper, SCENE.section, sj.StraightTrack(), SCENE.contact).replace(roll_amplitude=1e-3)
