"""The registry of quantities: every name has a unit, a check and a place in the scene."""

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.model.kinematics import MOTION_SCALES, scaled_size
from slipperjax.model.quantities import (
    ACCELERATIONS,
    COORDINATE_SCALES,
    COORDINATES,
    PARAMETERS,
    SECTIONS,
    STARTS,
    quantity,
)

from ..common import SCALES


def test_parameters_are_set_and_read_by_name():
    scene = sj.paper_scene()
    values = dict(speed=900.0, clearance=2e-3, length=0.3, mass=12.0, stiffness=1e9, restitution=0.5)
    values |= dict(amplitude=5e-4, roll_amplitude=1e-3, inertia_x=0.05, inertia_y=0.06, inertia_z=0.07)
    values |= dict(gravity=9.81)
    changed = scene.replace(**values)
    for name, value in values.items():
        assert float(changed.value(name)) == pytest.approx(value, rel=1e-15)
    assert set(values) == set(PARAMETERS)
    with pytest.raises(ValueError, match="`gravity` has no value: the scene has no gravitational acceleration"):
        scene.value("gravity")


def test_values_may_have_an_axis_of_cases():
    scene = sj.paper_scene().replace(clearance=np.array([1e-3, 2e-3]), speed=np.array([900.0, 1000.0]))
    np.testing.assert_allclose(scene.section.play, [[0.5e-3] * 5, [1e-3] * 5])
    assert scene.speed.shape == (2,)


def test_scales_of_states_stand_in_one_place():
    np.testing.assert_array_equal(COORDINATE_SCALES, SCALES)
    # a rotation of 10 mrad has the scaled size 1, in Euler angles and in the quaternion
    turned = sj.Motion.from_euler(roll=1e-2)
    assert float(scaled_size(turned)) == pytest.approx(1.0, rel=1e-4)
    assert jax.tree.leaves(MOTION_SCALES)[2:5] == [5e-3] * 3


def test_every_name_has_unit_and_description():
    for known in (PARAMETERS, COORDINATES, ACCELERATIONS):
        for name, q in known.items():
            assert quantity(name) is q
            assert q.attributes["units"]
            assert q.long_name
    assert quantity("start_v_y") is STARTS["v_y"]
    assert quantity("start_v_y").long_name == "lateral velocity at the start"
    assert set(SECTIONS) | set(SECTIONS.values()) == set(COORDINATES)
    assert PARAMETERS["clearance"].shown(1e-3) == pytest.approx(1.0)
    assert PARAMETERS["roll_amplitude"].from_shown(0.2) == pytest.approx(np.radians(0.2))
    with pytest.raises(KeyError):
        quantity("colour")
