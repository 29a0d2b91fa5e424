"""Sensors read what closed forms say, and the same as the vibration environment."""

import dataclasses

import jax
import numpy as np
import pytest
import scipy.signal

import slipperjax as sj
from slipperjax.model.dynamics import Args
from slipperjax.model.kinematics import rotation
from slipperjax.model.sensors import Channels, Rig, channels, interpolated, low_pass


def seen_at(count=1, **values) -> Channels:
    motion = np.zeros((count, 10))
    acceleration = np.zeros((count, 5))
    for name, value in values.items():
        if name == "motion":
            motion[:] = value
        else:
            acceleration[:] = value
    return Channels(motion, acceleration, np.tile([3.0, 4.0], (count, 1)), np.zeros((count, 2, 0)))


def first(seen: Channels) -> Channels:
    return jax.tree.map(lambda a: a[0], seen)


@jax.jit
def signals(sensors, seen):
    """The signals of several sensors, in one program."""
    return [sensor.signal(seen) for sensor in sensors]


def test_cubics_are_interpolated_exactly():
    x = np.arange(9.0)
    cubic = lambda x: 1 - 2 * x + 0.3 * x**2 - 0.01 * x**3
    place = np.array([0.0, 0.3, 3.5, 7.9, 8.0])
    np.testing.assert_allclose(jax.jit(interpolated)(cubic(x), place), cubic(place), rtol=1e-13)


@pytest.mark.parametrize("cutoff", [0.02, 0.2])
def test_the_filter_is_scipys_butterworth(cutoff):
    signal = np.random.default_rng(0).normal(size=300)
    signal[:2] = 0.0  # so that both begin at rest
    filtered = scipy.signal.lfilter(*scipy.signal.butter(2, 2 * cutoff), signal)
    np.testing.assert_allclose(jax.jit(low_pass)(signal, cutoff), filtered, rtol=1e-12, atol=1e-13)


def test_accelerations_of_a_place_are_those_of_a_rigid_body():
    seen = first(seen_at(motion=[0, 0, 0, 0, 0, 0, 0, 0.1, -2.0, 3.0], acceleration=[5.0, 6.0, 7.0, 8.0, 9.0]))
    place = np.array([0.4, -0.2, 0.1])
    spin, turning = np.array([0.1, -2.0, 3.0]), np.array([7.0, 8.0, 9.0])
    expected = np.array([0, 5.0, 6.0]) + np.cross(turning, place) + np.cross(spin, np.cross(spin, place))
    # the last along a vector of any length
    sensors = [sj.model.Sensor("a", place=place, direction=along) for along in (*"xyz", (0.0, 3.0, 4.0))]
    oblique = 0.6 * expected[1] + 0.8 * expected[2]
    np.testing.assert_allclose(signals(sensors, seen), [*expected, oblique], rtol=1e-14)


def test_displacements_turn_with_the_body():
    motion = sj.Motion.from_euler(y=1e-3, z=-2e-3, roll=0.02, pitch=0.01, yaw=-0.03)
    numbers = [getattr(motion, name) for name in ("y", "z", "q_x", "q_y", "q_z")]
    seen = first(seen_at(motion=[*numbers, 0, 0, 0, 0, 0]))
    place = np.array([0.1, 0.02, -0.03])
    expected = np.array(rotation(motion)) @ place - place + [0.0, 1e-3, -2e-3]
    gauges = [sj.model.Sensor("d", "displacement", place, axis) for axis in "yz"]
    np.testing.assert_allclose(signals(gauges, seen), expected[1:], rtol=1e-12)


def test_gyroscopes_and_load_cells():
    seen = first(seen_at(motion=[0, 0, 0, 0, 0, 0, 0, 0.1, -2.0, 3.0]))
    sensors = [sj.model.Sensor("w", "angular_velocity", direction="y"), sj.model.Sensor("f", "force", direction="z")]
    assert signals(sensors, seen) == [-2.0, 4.0]


def test_gain_bias_and_delay():
    time = np.linspace(0.0, 1.0, 41)
    seen = seen_at(41)
    seen = seen._replace(force=np.stack([0 * time, time**2], axis=1))
    cell = sj.model.Sensor("f", "force", gain=2.0, bias=0.5, delay=0.1)
    at = np.array([0.2, 0.55, 0.9])
    np.testing.assert_allclose(jax.jit(lambda *given: cell.read(*given))(seen, time, at), 2 * ((at - 0.1) ** 2 + 0.5))


def test_channels_are_those_of_the_equations_of_motion():
    scene = sj.paper_scene()
    state = sj.initial_state(scene, sj.table_2_start())
    args = Args(scene, 0.0)
    seen, now = jax.jit(lambda state: (channels(args, 0.0, state), sj.model.reactions(0.0, state, args)))(state)
    # the same sums in another order
    np.testing.assert_allclose(seen.acceleration, now.acceleration, rtol=1e-12)
    weight = scene.slipper.mass * (0.0 if scene.gravity is None else scene.gravity)
    np.testing.assert_allclose(
        seen.force, scene.slipper.mass * seen.acceleration[:2] + np.array([0, weight]), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (dict(name="front left"), "`name` must be a word"),
        (dict(direction="up"), "`direction` must be one of x, y, z"),
        (dict(direction=(0, 0, 0)), "`direction` must be a vector, but is zero"),
        (dict(measures="force", direction="x"), "`direction` must be across the rail for a force"),
    ],
)
def test_bad_sensors_are_refused_in_one_line(arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        sj.model.Sensor(**{"name": "a"} | arguments)
    assert "\n" not in str(error.value)


def test_sensors_have_different_names():
    one = sj.model.Sensor("a")
    assert Rig.of([one]).names == ("a",)
    with pytest.raises(ValueError, match="different names"):
        Rig.of([one, dataclasses.replace(one, gain=2.0)])
    with pytest.raises(ValueError, match="a list of slipperjax"):
        Rig.of([1])
