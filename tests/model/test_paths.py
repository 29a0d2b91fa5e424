"""Every number of a scene is a parameter: by name or by path, checked, and with its unit."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.kinematics import MOTION_SCALES, accuracy_scales, scaled_size
from slipperjax.model.parameters import PARAMETERS, STARTS, parameter, quantity
from slipperjax.model.quantities import ACCELERATIONS, COORDINATE_SCALES, COORDINATES

from ..common import SCALES

SCENE = sj.paper_scene()
MOUNTS = [sj.Mount(x=0.5, rail="left", play=np.full(5, 5e-4)), sj.Mount(x=-0.5, rail="left"), sj.Mount(rail="right")]
SLED = dataclasses.replace(
    SCENE,
    slipper=sj.Sled(30.0, (0.2, 3.0, 3.0), MOUNTS, modes=sj.model.Modes([90.0], [0.01], np.ones((1, 3, 3)) / 10)),
)


PATHS = {
    "section.play.2": (SCENE, lambda s: s.section.play[2]),
    "section.points.D.1": (SCENE, lambda s: s.section.points[3, 1]),
    "slipper.inertia.1": (SCENE, lambda s: s.slipper.inertia[1]),
    "slipper.mounts.left2.x": (SLED, lambda s: s.slipper.mounts[1].x),
    "slipper.mounts.1.x": (SLED, lambda s: s.slipper.mounts[1].x),
    "slipper.mounts.left1.play.2": (SLED, lambda s: s.slipper.mounts[0].play[2]),
    "slipper.mounts.right1.x": (SLED, lambda s: s.slipper.mounts[2].x),
    "slipper.modes.damping.0": (SLED, lambda s: s.slipper.modes.damping[0]),
    "mass": (SLED, lambda s: s.slipper.mass),
    "inertia_z": (SLED, lambda s: s.slipper.inertia[2]),
    "length": (SLED, lambda s: s.slipper.length),
    "clearance": (SLED, lambda s: 2 * s.section.play[0]),
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.filterwarnings("ignore:Argument `clearance`")
def test_paths_lead_to_one_number_by_name_or_place(path):
    scene, leaf = PATHS[path]
    changed = scene.replace(**{path: 0.125})
    assert float(leaf(changed)) == float(changed.value(path)) == 0.125


def test_paths_have_the_units_of_their_fields_and_take_an_axis_of_cases():
    for path, unit in (("section.play.2", "m"), ("section.points.D.1", "m"), ("slipper.inertia.1", "kg m^2")):
        assert parameter(path, SCENE).unit == unit
        values = np.array([0.125, 0.126])
        np.testing.assert_allclose(SCENE.replace(**{path: values}).value(path), values, rtol=1e-15)


def test_a_slipper_s_own_section_is_reached():
    own = eqx.tree_at(lambda m: m[1].section, SLED.slipper.mounts, SCENE.section, is_leaf=lambda part: part is None)
    scene = dataclasses.replace(SLED, slipper=dataclasses.replace(SLED.slipper, mounts=own))
    changed = scene.replace(**{"slipper.mounts.left2.section.play.2": 1e-4})
    assert float(changed.slipper.mounts[1].section.play[2]) == 1e-4
    assert float(changed.section.play[2]) == 5e-4


WRONG = [
    (SLED, "slipper.mounts.left3.x", "a number of 0 to 2 or one of left1, left2, right1 in place of 'left3'"),
    (SLED, "slipper.mounts.3.x", "a number of 0 to 2 or one of left1, left2, right1 in place of '3'"),
    (SLED, "slipper.mounts.left2.play.2", "slipper.mounts.1.play is absent from the scene"),
    (SLED, "slipper.mounts.left2.rail", "Mount has x, y, z, section, length, play, but not 'rail'"),
    (SLED, "slipper.mounts.left2", "slipper.mounts.1 is Mount"),
    (SCENE, "section.play.D", "must have a number of 0 to 4 in place of 'D'"),
    (SCENE, "section.play.5", "must have a number of 0 to 4 in place of '5'"),
    (SCENE, "section.points.Z.1", "or one of A, B, C"),
    (SCENE, "section.points.D", "section.points is an array of shape"),
    (SCENE, "section.names.0", "Section has points, play, but not 'names'"),
]


@pytest.mark.parametrize(("scene", "path", "words"), WRONG)
def test_wrong_paths_are_told(scene, path, words):
    with pytest.raises(ValueError, match="Argument") as caught:
        scene.replace(**{path: 0.1})
    assert words in str(caught.value)


def test_a_value_is_checked_by_its_path():
    with pytest.raises(ValueError, match=r"`section\.play\.2` must be zero or positive, but is -0\.001 m"):
        SCENE.replace(**{"section.play.2": -1e-3})


@pytest.mark.full
def test_places_of_slippers_are_varied_and_differentiated():
    """In a sweep, also from no place at all; and by a tangent, against runs at places that differ by little."""
    scene = dataclasses.replace(SLED, slipper=dataclasses.replace(SLED.slipper, modes=None))
    how = dict(steps_per_period=100, periods=1, transient=0, record="rms")
    name = "slipper.mounts.right1.x"
    both = sj.sweep(scene, {name: [0.0, 0.2]}, **how)
    one = sj.sweep(scene.replace(**{name: 0.2}), {"mass": [30.0]}, **how)
    # equal bits; 3.5e-2 apart from that at no place
    assert float(both.rms_a_z[1]) == pytest.approx(float(one.rms_a_z[0]), rel=1e-9)
    assert abs(float(both.rms_a_z[0]) / float(one.rms_a_z[0]) - 1) > 1e-3

    name = "slipper.mounts.left1.x"
    end = jax.jit(lambda x: sj.simulate(scene.replace(**{name: x}), 1, steps_per_period=100, probe=0).end.motion.z)
    slope = float(jax.jvp(end, (0.5,), (1.0,))[1])
    step = 1e-5
    # 9.0e-5 m per m, measured 2e-9 apart
    assert slope == pytest.approx(float(end(0.5 + step) - end(0.5 - step)) / (2 * step), rel=1e-7)
    assert slope > 1e-5


def test_names_are_set_and_read():
    values = dict(speed=900.0, clearance=2e-3, length=0.3, mass=12.0, stiffness=1e9, restitution=0.5, gravity=9.81)
    values |= dict(amplitude=5e-4, roll_amplitude=1e-3, inertia_x=0.05, inertia_y=0.06, inertia_z=0.07)
    changed = SCENE.replace(**values)
    for name, value in values.items():
        assert float(changed.value(name)) == pytest.approx(value, rel=1e-15)
    # the plays along both axes are parts of the clearance, see test_plays
    assert {*values, "play.vertical", "play.lateral"} == set(PARAMETERS)
    with pytest.raises(ValueError, match="`gravity` has no value: the scene has no gravitational acceleration"):
        SCENE.value("gravity")


def test_values_may_have_an_axis_of_cases():
    both = SCENE.replace(clearance=np.array([1e-3, 2e-3]), speed=np.array([900.0, 1000.0]))
    np.testing.assert_allclose(both.section.play, [[0.5e-3] * 5, [1e-3] * 5])
    assert both.speed.shape == (2,)
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


def test_a_part_that_was_none_is_added():
    with_track = lambda track: eqx.tree_at(lambda s: s.track, SCENE, track)
    assert float(SCENE.replace(gravity=9.81).gravity) == 9.81
    rolling = with_track(sj.HarmonicTrack((8.0,), 1e-3)).replace(roll_amplitude=1e-3)
    assert float(rolling.track.roll_amplitude) == 1e-3
    with pytest.raises(ValueError, match="`roll_amplitude` cannot be set: the scene has no"):
        with_track(sj.model.StraightTrack()).replace(roll_amplitude=1e-3)


@pytest.mark.parametrize(
    ("play", "share"),
    [(5e-4, 1.0), (5e-3, 1.0), (5e-5, 0.1), ([5e-3, 5e-5, 0, 0, 5e-4], 0.1), (1e-6, 5e-3), (0.0, 1.0)],
)
def test_errors_are_judged_by_the_play_where_it_is_less_than_a_scale(play, share):
    """By that of the tightest face that has any; 5e-6 m count as the least."""
    scene = sj.paper_scene()
    scene = eqx.tree_at(lambda s: s.section.play, scene, np.broadcast_to(np.asarray(play, float), 5))
    scales, usual = (np.array(jax.tree.leaves(s)) for s in (accuracy_scales(scene), MOTION_SCALES))
    np.testing.assert_allclose(scales, usual * np.array([share] * 5 + [1.0] * 5), rtol=1e-12)
    if share == 1.0:
        np.testing.assert_array_equal(scales, usual)


def test_rotations_that_turn_far_slippers_are_judged_by_how_far_these_move():
    """Ends of slippers 1.3 m from the centre of mass; those of the paper's are 0.1 m from it."""
    sled = sj.Sled(400.0, (80.0, 320.0, 380.0), [sj.Mount(x=1.2), sj.Mount(x=-1.2)])
    scene = dataclasses.replace(sj.paper_scene(), slipper=sled)
    scales, usual = (np.array(jax.tree.leaves(s)) for s in (accuracy_scales(scene), MOTION_SCALES))
    near = [0.1 / 1.3] * 3
    np.testing.assert_allclose(scales, usual * np.array([1.0, 1.0, *near, 1.0, 1.0, *near]), rtol=1e-12)


def test_scales_of_states_stand_in_one_place():
    np.testing.assert_array_equal(COORDINATE_SCALES, SCALES)
    # a rotation of 10 mrad has the scaled size 1, in Euler angles and in the quaternion
    turned = sj.Motion.from_euler(roll=1e-2)
    assert float(scaled_size(turned)) == pytest.approx(1.0, rel=1e-4)
    assert jax.tree.leaves(MOTION_SCALES)[2:5] == [5e-3] * 3


def test_every_name_has_unit_and_description():
    for known in (PARAMETERS, COORDINATES, ACCELERATIONS):
        assert all(quantity(name) is q and q.attributes["units"] and q.long_name for name, q in known.items())
    assert quantity("start_v_y").long_name == STARTS["start_v_y"].long_name == "lateral velocity at the start"
    assert PARAMETERS["clearance"].shown(1e-3) == pytest.approx(1.0)
    assert PARAMETERS["roll_amplitude"].from_shown(0.2) == pytest.approx(np.radians(0.2))
    with pytest.raises(KeyError):
        quantity("colour")
